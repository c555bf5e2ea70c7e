"""What an FMU lacks, as far as that shows from outside: verdicts on plants whose truth is known."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1] / "fmu"))
from ball_fmu import ball

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.without_equations import coloured
from daest.fmu.binary_model import binary_model
from daest.model.diagnosis import Screened
from daest.model.experiment import Experiment
from daest.modelica.change import declare
from daest.modelica.effects.catalogue import effect_library
from daest.report.documents.diagnose import document

PERIOD, SAMPLES = 0.05, 160


def recording(name, seed, friction=0.0, rough=0.0, gust=0.0, offset=0.0):
    """A ball on a slow drive: with Coulomb friction on its speed, a friction that depends on the place, a
    recorded gust, an offset of the sensor, or none of them."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(SAMPLES)
    phases = rng.uniform(0, 6.3, 6)
    speeds = (0.6, 1.1, 1.9, 2.7, 4.1, 5.3)
    wind = np.repeat(rng.uniform(-1, 1, SAMPLES // 10), 10)
    force = 9.81 + sum(1.5 * np.sin(w * time + p) for w, p in zip(speeds, phases, strict=True))

    def rate(t, x):
        u = np.interp(t, time, force)
        dry = friction + rough * (1.0 + np.sin(2.0 * x[0]))
        push = gust * np.interp(t, time, wind)
        return [x[1], u + push - 9.81 - 0.1 * x[1] * abs(x[1]) - dry * np.tanh(x[1] / 0.03)]

    h = scipy.integrate.solve_ivp(
        rate, (0, time[-1]), [1.0, 0.0], t_eval=time, rtol=1e-8, atol=1e-9, max_step=PERIOD
    ).y[0]
    y = h + offset * time + 0.01 * rng.standard_normal(SAMPLES)
    made = Experiment(name, time, force[:, None], y[:, None], ("u",), ("y",))
    return replace(made, extra={"wind": wind}) if gust else made


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    flat = binary_model(ball(tmp_path_factory.mktemp("ball")))
    return declare(flat, estimate=["d"])


def diagnosed(model, estimation, validation, **options):
    """The document of a diagnosis."""
    chosen = DiagnoseOptions(hold="foh", jobs=1, **options)
    return document(diagnose(model, effect_library(), estimation, validation, chosen))


@pytest.mark.slow  # of equations: test_diagnose.py
def test_nothing_is_missing(model):
    laws = ("CoulombFriction", "QuadraticDrag", "ConstantLoad")
    found = diagnosed(model, [recording("a", 1)], [recording("b", 2)], effects=laws)
    assert found["verdict"] == "nothing missing"
    assert "black box" in found["message"]
    assert found["screen"]["p_value"] > 0.01


@pytest.fixture(scope="module")
def rubbing(model):
    """The diagnosis of a ball with Coulomb friction of 0.8, among some laws."""
    laws = ("CoulombFriction", "ViscousFriction", "QuadraticDrag", "ConstantLoad", "HardeningSpring")
    return diagnosed(model, [recording("a", 1, 0.8)], [recording("b", 2, 0.8)], effects=laws)


@pytest.mark.slow  # tests/cli/test_diagnose_command.py (of an FMU)
def test_friction_is_found_at_the_input(rubbing):
    is_friction(rubbing)


@pytest.mark.slow
def test_friction_is_found_among_all_laws(model):
    is_friction(diagnosed(model, [recording("a", 1, 0.8)], [recording("b", 2, 0.8)]))


def is_friction(found):
    assert found["verdict"] == "supported"
    best = found["candidates"][0]
    assert (best["effect"], best["at"]) == ("CoulombFriction", "u (v)")
    size = best["parameters"]["size"]
    assert abs(size["value"] - 0.8) < 0.1
    assert best["rms"]["validation"]["y"] < 0.5 * found["baseline"]["rms"]["validation"]["y"]


@pytest.mark.slow
def test_recorded_signal_that_pushes(model):
    data = [recording(name, seed, gust=0.8) for name, seed in (("a", 1), ("b", 2))]
    found = diagnosed(model, data[:1], data[1:])
    best = found["candidates"][0]
    assert (found["verdict"], best["effect"], best["at"]) == ("supported", "MeasuredInput", "u (wind)")
    size = best["parameters"]["size"]
    assert abs(size["value"] - 0.8) < 4 * size["std_error"] + 0.02


@pytest.mark.slow
def test_law_that_cannot_be_tried_is_not_called_by_another_name(model):
    data = [recording(name, seed, rough=1.0) for name, seed in (("a", 1), ("b", 2))]
    found = diagnosed(model, data[:1], data[1:])
    assert found["verdict"] == "external disturbance"
    assert found["candidates"], "laws were tried"
    assert all(p["verdict"] == "rejected" and p["reason"] for p in found["candidates"])


@pytest.mark.slow  # its diagnosis is that of the test above
def test_only_the_best_and_what_is_as_good_are_named(rubbing):
    named = [p for p in rubbing["candidates"] if p["verdict"] != "rejected"]
    assert len(named) == 1
    others = [p["reason"] for p in rubbing["candidates"] if p is not named[0]]
    assert others and all(others)


def test_what_can_be_foreseen():
    """Of an AR(1) with coefficient a, 1 / (1 - a^2) - 1 of the innovations' variance; of noise nothing."""
    rng = np.random.default_rng(3)
    white = rng.standard_normal((4000, 1))
    red = lfilter([1.0], [1.0, -0.8], white, axis=0)
    assert coloured.foreseen([red], [white]) == pytest.approx(0.64 / 0.36, rel=0.15)
    assert coloured.foreseen([white], [red]) < 0.02


def test_a_constant_is_worth_a_refit_though_a_filter_takes_it_for_colour():
    def scored(p_value, share, absorbed=False):
        return Screened(None, 0.0, (0.0,), p_value, absorbed, 1.0, share)

    entry, slow = scored(0.5, 0.1), scored(0.5, 0.9)
    assert coloured.worth_a_refit([entry, slow], 3) == [slow]
    assert coloured.worth_a_refit([scored(0.5, 0.9, absorbed=True)], 3) == []
    seen = scored(1e-6, 0.1)
    assert coloured.worth_a_refit([seen, slow], 3) == [seen, slow]
