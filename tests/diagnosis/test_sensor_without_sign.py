"""A sensor that has lost the sign, found beside loads that are free enough to imitate it."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis.evidence.stand import begin
from daest.diagnosis.examine import examine
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import find_effect

DRIVE = """
model Drive
  input Real u(unit = "N.m");
  parameter Real J(unit = "kg.m2", min = 0) = 1 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 1 annotation(__Daest(estimate = true, scale = "log"));
  Real w(unit = "rad/s", start = 0);
  Real phi(unit = "rad", start = 0);
  output Real y(unit = "rad/s") = w;
equation
  der(phi) = w;
  J*der(w) = u - d*w;
end Drive;
"""
STEP, J, D, NOISE = 0.05, 0.6, 1.4, 0.01


def recorded(seed: int, n: int = 400) -> Experiment:
    """Random steps of the torque, a slow load from outside, and the magnitude of the speed."""
    rng = np.random.default_rng(seed)
    time = STEP * np.arange(n)
    u = np.repeat(rng.uniform(-2.0, 2.0, n // 10 + 1), 10)[:n]
    load = 0.3 * np.convolve(rng.standard_normal(n + 40), np.exp(-np.arange(41) / 10.0), "valid") / 3.0

    def rate(t, w):
        k = min(int(t / STEP + 1e-9), n - 1)
        return [(u[k] + load[k] - D * w[0]) / J]

    w = solve_ivp(rate, (0.0, time[-1]), [0.5], t_eval=time, max_step=STEP / 2, rtol=1e-6).y[0]
    y = np.abs(w) + NOISE * rng.standard_normal(n)
    return Experiment(f"run {seed}", time, u[:, None], y[:, None], ("u",), ("y",))


@pytest.mark.slow  # 12 s of processor time
def test_sign_that_is_lost_is_found():
    library = [find_effect("AbsoluteValueSensor"), find_effect("Rotational.CoulombFriction")]
    options = DiagnoseOptions(hold="zoh", jobs=1)
    flat = compile_text(DRIVE.encode(), Path("Drive.mo"))
    stand = begin(flat, [recorded(1)], [recorded(2)], options)
    assert stand.reference is not None and not stand.reference.adds_up, "the angle is not seen"
    found = examine(stand, library, options)
    assert found.verdict == "supported", found.message
    best = found.proofs[0]
    assert best.candidate.effect.name == "AbsoluteValueSensor"
    values = best.told.theta
    assert values[f"{best.candidate.name}.share"] == pytest.approx(1.0, abs=0.05)
    assert values["J"] == pytest.approx(J, rel=0.15) and values["d"] == pytest.approx(D, rel=0.15)
