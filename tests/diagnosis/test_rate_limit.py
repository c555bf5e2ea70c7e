"""A motor whose voltage changes no faster than a limit, or follows a lag. Simulated exactly: straight lines
of voltage between two corners, and exponentials."""

from pathlib import Path

import numpy as np
import pytest
from test_play import MOTOR

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.model.diagnosis import Diagnosis
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library

EFFECTS = ("RateLimit", "Lag", "Delay", "CoulombFriction", "Saturation")
DT, FINE = 0.02, 50
J, K, D = 0.3, 1.2, 0.5


def limited(u: float, goal: float, limit: float, dt: float) -> float:
    return u + min(max(goal - u, -limit * dt), limit * dt)


def late(u: float, goal: float, T: float, dt: float) -> float:
    return goal + (u - goal) * float(np.exp(-dt / T))


def recorded(step, size: float, seed: int, n: int = 900) -> Experiment:
    """Voltages held for a second each, which the machine has as `step` makes them of the last one; none with
    a `size` of nothing."""
    rng, dt = np.random.default_rng(seed), DT / FINE
    asked = np.repeat(rng.uniform(-6.0, 6.0, n // 50), 50)
    u, w, told = asked[0], 0.0, []
    kept = float(np.exp(-D / J * dt))
    for goal in asked:
        told.append(w)
        for _ in range(FINE):
            before, u = u, (step(u, goal, size, dt) if size else goal)
            w = kept * w + (1.0 - kept) * K / D * 0.5 * (u + before if size else 2.0 * u)
    measured = np.array(told) + 0.05 * rng.normal(size=n)
    return Experiment("run", DT * np.arange(n), asked[:, None], measured[:, None], ("u",), ("w",))


def diagnosed(folder: Path, record: Experiment) -> Diagnosis:
    (folder / "Motor.mo").write_text(MOTOR)
    options = DiagnoseOptions(effects=EFFECTS, hold="zoh")
    return diagnose(compile_model(folder / "Motor.mo"), effect_library(), [record], (), options)


@pytest.mark.slow  # a voltage that has none: below
def test_a_limit_of_the_rate_is_found_with_its_size(tmp_path) -> None:
    found = diagnosed(tmp_path, recorded(limited, 15.0, 1))
    best = found.proofs[0]
    assert (found.verdict, best.candidate.label) == ("supported", "RateLimit at u"), found.message
    own = next(p for p in best.told.parameters if p.name.endswith(".limit"))
    assert abs(own.value - 15.0) < 4.0 * own.std_error and own.std_error < 0.3
    assert own.unit == "V/s"


@pytest.mark.slow
def test_a_lag_is_no_limit_of_the_rate(tmp_path) -> None:
    found = diagnosed(tmp_path, recorded(late, 0.15, 2))
    best = found.proofs[0]
    assert (found.verdict, best.candidate.effect.name) == ("supported", "Lag"), found.message
    own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.T")
    assert abs(own.value - 0.15) < 4.0 * own.std_error < 0.01
    limit = next(p for p in found.proofs if p.candidate.effect.name == "RateLimit")
    assert limit.verdict == "rejected"


def test_a_voltage_that_is_followed_at_once_lacks_nothing(tmp_path) -> None:
    found = diagnosed(tmp_path, recorded(late, 0.0, 2))
    assert found.verdict == "nothing missing", found.message
    assert "Saturation at u (limit = " in found.message  # a share alone would tell nothing
