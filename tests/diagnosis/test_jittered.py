"""Time stamps that are off, of a pendulum whose samples are taken a little before or after them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.recordings.jittered import TRUE_TIMES
from daest.model.diagnosis import Diagnosis
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library

PENDULUM = """model Pendulum
  parameter Real c(unit = "N.m/rad", min = 0) = 20 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.2 annotation(__Daest(estimate = true));
  parameter Real J(unit = "kg.m2", min = 0) = 0.5;
  input Real tau(unit = "N.m");
  Real phi(unit = "rad", start = 0);
  Real w(unit = "rad/s", start = 0);
  output Real y(unit = "rad") = phi annotation(__Daest(std = 0.002));
  output Real v(unit = "rad/s") = w annotation(__Daest(std = 0.02));
equation
  der(phi) = w;
  J*der(w) = tau - c*phi - d*w;
end Pendulum;
"""
H, N = 0.05, 600


def diagnosed(folder: Path, off: float, stiffens: float = 0.0) -> Diagnosis:
    """Torques of a second each; times that are off by as much, uniformly, in samples."""
    rng = np.random.default_rng(7)
    nominal = H * np.arange(N)
    taken = nominal + H * off * np.r_[0.0, rng.uniform(-1.0, 1.0, N - 1)]
    torques = rng.uniform(-4.0, 4.0, N // 20)

    def rates(t: float, x: np.ndarray) -> list[float]:
        tau = torques[min(int(t), torques.size - 1)]
        return [x[1], (tau - 22.0 * x[0] - stiffens * x[0] ** 3 - 0.25 * x[1]) / 0.5]

    course = solve_ivp(rates, (0.0, N * H), [0.0, 0.0], max_step=0.01, rtol=1e-8, dense_output=True).sol
    outputs = course(np.clip(taken, 0.0, None)).T + rng.normal(size=(N, 2)) * [0.002, 0.02]
    inputs = np.repeat(torques, 20)[:, None]
    record = Experiment("run", nominal, inputs, outputs, ("tau",), ("y", "v"))
    (folder / "Pendulum.mo").write_text(PENDULUM)
    options = DiagnoseOptions(effects=("CoulombFriction", "QuadraticDrag"), hold="zoh")
    return diagnose(compile_model(folder / "Pendulum.mo"), effect_library(), [record], (), options)


def test_time_stamps_that_are_off_are_told_with_their_deviation(tmp_path) -> None:
    found = diagnosed(tmp_path, 0.3)
    assert found.verdict != "supported"
    assert "as time stamps make them that are off by" in found.message
    share = float(found.message.partition("s (")[2].partition(" of a sample")[0])
    assert share == pytest.approx(0.3 / np.sqrt(3.0), rel=0.2)
    assert found.next_experiment == TRUE_TIMES


@pytest.mark.parametrize(("off", "stiffens"), [pytest.param(0.0, 300.0, marks=pytest.mark.slow), (0.0, 0.0)])
def test_a_law_that_is_missing_and_nothing_are_no_time_stamps(tmp_path, off: float, stiffens: float) -> None:
    found = diagnosed(tmp_path, off, stiffens)
    assert found.verdict not in ("supported",) and "time stamps" not in found.message
    assert (found.verdict == "nothing missing") == (not stiffens)
