"""Two tanks and the pipe between them, of components: what has states of its own at a tank, and in a line."""

import numpy as np
import pytest
from scipy.linalg import expm

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library

TANKS = """model Tanks
  parameter Real R(unit = "Pa.s/m3", min = 0) = 2e7 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R0(unit = "Pa.s/m3", min = 0) = 4e7 annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput q(unit = "m3/s");
  Daest.Blocks.Interfaces.RealOutput h1(unit = "m");
  Daest.Blocks.Interfaces.RealOutput h2(unit = "m");
  Daest.Hydraulic.Components.Tank tank1(A = 0.03);
  Daest.Hydraulic.Components.Tank tank2(A = 0.02);
  Daest.Hydraulic.Components.LinearResistance pipe(R = R);
  Daest.Hydraulic.Components.LinearResistance drain(R = R0);
  Daest.Hydraulic.Sources.PrescribedFlow pump;
  Daest.Hydraulic.Sources.FixedPressure sump(p = 0);
equation
  connect(q, pump.q);
  connect(pump.port, tank1.inlet);
  connect(tank1.outlet, pipe.port_a);
  connect(pipe.port_b, tank2.outlet);
  connect(tank2.outlet, drain.port_a);
  connect(drain.port_b, sump.port);
  h1 = tank1.level;
  h2 = tank2.level;
end Tanks;
"""
WEIGHT = 998 * 9.80665  # of a cubic metre of water, N
# Beside a law that bends over the level, the pressure of a tank had become a state in its place.
ASKED = ("FluidInertia", "HiddenVessel", "WideningTank", "Overflow")


def recorded(A, B, dt: float) -> Experiment:
    """Levels h1, h2, the first two of the states of x' = A x + B q, under a pump on steps."""
    rng = np.random.default_rng(8)
    n = A.shape[0]
    whole = expm(np.block([[A, B], [np.zeros((1, n + 1))]]) * dt)
    q = np.repeat(rng.uniform(0.0, 2e-4, 32), 25)
    x, levels = -np.linalg.solve(A, B[:, 0] * 1e-4), []
    for value in q:
        levels.append(x[:2])
        x = whole[:n, :n] @ x + whole[:n, n] * value
    measured = np.array(levels) + rng.normal(0.0, 0.0015, (q.size, 2))
    return Experiment("run", dt * np.arange(q.size), q[:, None], measured, ("q",), ("h1", "h2"))


def found(tmp_path, record: Experiment):
    (tmp_path / "Tanks.mo").write_text(TANKS)
    options = DiagnoseOptions(effects=ASKED, hold="zoh")
    return diagnose(compile_model(tmp_path / "Tanks.mo"), effect_library(), [record], (), options)


def sizes(found) -> dict[str, tuple[float, float]]:
    best = found.proofs[0]
    return {p.name.rpartition(".")[2]: (p.value, p.std_error) for p in best.told.parameters}


@pytest.mark.slow
def test_a_long_pipe_swings(tmp_path):
    R, R0, L = 1.4e7, 3.2e7, 2.5e8
    A = np.array([[0, 0, -1 / 0.03], [0, -WEIGHT / R0 / 0.02, 1 / 0.02], [WEIGHT / L, -WEIGHT / L, -R / L]])
    answer = found(tmp_path, recorded(A, np.array([[1 / 0.03], [0], [0]]), 1.0))
    assert answer.verdict == "supported", answer.message
    assert answer.proofs[0].candidate.label in ("FluidInertia at tank1.outlet", "FluidInertia at pipe.port_a")
    value, error = sizes(answer)["L"]
    assert abs(value - L) < 3.5 * error


@pytest.mark.slow
def test_a_side_chamber_beside_a_tank(tmp_path):
    R, R0, G, T = 1.4e7, 3.2e7, 4e-8, 30.0
    a, b, c = WEIGHT / R, WEIGHT / R0, WEIGHT * G
    A = np.array([[-a / 0.03, a / 0.03, 0], [a / 0.02, -(a + b + c) / 0.02, c / 0.02], [0, 1 / T, -1 / T]])
    answer = found(tmp_path, recorded(A, np.array([[1 / 0.03], [0], [0]]), 4.0))
    assert answer.verdict == "supported", answer.message
    assert answer.proofs[0].candidate.label == "HiddenVessel at pipe.port_b"
    assert not [reason for _, reason in answer.screen.skipped if "states" in reason]
    for name, true in (("G", G), ("T", T)):
        value, error = sizes(answer)[name]
        assert abs(value - true) < 3.5 * error
