"""What an FMU lacks, as far as that shows from outside: verdicts on plants whose truth is known."""

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate

sys.path.insert(0, str(Path(__file__).parents[1] / "fmu"))
from ball_fmu import ball

from daest.diagnosis.black_box import diagnose_black_box
from daest.fmu.binary_form import BinaryForm
from daest.model.experiment import Experiment
from daest.modelica.change import declare

PERIOD, SAMPLES = 0.05, 160


def recording(name, seed, friction=0.0):
    """A ball on a slow drive, with Coulomb friction on its speed or without."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(SAMPLES)
    phases = rng.uniform(0, 6.3, 6)
    speeds = (0.6, 1.1, 1.9, 2.7, 4.1, 5.3)
    force = 9.81 + sum(1.5 * np.sin(w * time + p) for w, p in zip(speeds, phases, strict=True))

    def rate(t, x):
        u = np.interp(t, time, force)
        return [x[1], u - 9.81 - 0.1 * x[1] * abs(x[1]) - friction * np.tanh(x[1] / 0.03)]

    h = scipy.integrate.solve_ivp(
        rate, (0, time[-1]), [1.0, 0.0], t_eval=time, rtol=1e-8, atol=1e-9, max_step=PERIOD
    ).y[0]
    y = h + 0.01 * rng.standard_normal(SAMPLES)
    return Experiment(name, time, force[:, None], y[:, None], ("u",), ("y",))


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    flat = BinaryForm(ball(tmp_path_factory.mktemp("ball"))).flat()
    return declare(flat, estimate=["d"])


@pytest.mark.slow
def test_nothing_is_missing(model):
    found = diagnose_black_box(model, [recording("a", 1)], [recording("b", 2)], "foh")
    assert found["verdict"] == "nothing missing"
    assert "black box" in found["message"]
    assert found["screen"]["p_value"] > 0.01


@pytest.mark.slow
def test_friction_is_found_at_the_input(model):
    found = diagnose_black_box(model, [recording("a", 1, 0.8)], [recording("b", 2, 0.8)], "foh")
    assert found["verdict"] == "supported"
    best = found["candidates"][0]
    assert (best["effect"], best["at"]) == ("CoulombFriction", "u (v)")
    size = best["parameters"]["size"]
    assert abs(size["value"] - 0.8) < 0.1
    assert best["rms"]["validation"]["y"] < 0.5 * found["baseline"]["rms"]["validation"]["y"]
