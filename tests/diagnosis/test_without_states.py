"""A wall as a resistance alone, in which the machine stores heat: the model has no states, and with them no
time constant. Simulated by the closed solution of a filter."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from daest.diagnosis.diagnose import diagnose
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects import effect_library

WALL = """model Wall
  parameter Real R(unit = "K/W", min = 0) = 3 annotation(__Daest(estimate = true));
  Daest.Blocks.Interfaces.RealInput Ti(unit = "degC");
  Daest.Blocks.Interfaces.RealInput Te(unit = "degC");
  Daest.Blocks.Interfaces.RealOutput q(unit = "W");
  Daest.Thermal.HeatTransfer.Celsius.PrescribedTemperature inside;
  Daest.Thermal.HeatTransfer.Celsius.PrescribedTemperature outside;
  Daest.Thermal.HeatTransfer.Sensors.HeatFlowSensor meter;
  Daest.Thermal.HeatTransfer.Components.ThermalResistor wall(R = R);
equation
  connect(Ti, inside.T);
  connect(Te, outside.T);
  connect(inside.port, meter.port_a);
  connect(meter.port_b, wall.port_a);
  connect(wall.port_b, outside.port);
  connect(meter.Q_flow, q);
end Wall;
"""
PERIOD, R, LAG = 600.0, 4.0, 6000.0


def _measured() -> Experiment:
    """Ten days of a wall that feels outside late, the flow measured with noise of 0.05 W."""
    rng = np.random.default_rng(7)
    steps = np.repeat(rng.normal(size=(120, 2)), 12, axis=0)
    u = np.array([21.0, 10.0]) + steps * [1.0, 4.0]
    keeps = np.exp(-PERIOD / LAG)
    late = lfilter([0.0, 1.0 - keeps], [1.0, -keeps], u[:, 1] - u[0, 1]) + u[0, 1]
    y = (u[:, 0] - late) / R + 0.05 * rng.normal(size=len(u))
    return Experiment("wall", PERIOD * np.arange(len(u)), u, y[:, None], ("Ti", "Te"), ("q",))


def test_lag_is_found_where_the_model_has_no_time_constant(tmp_path: Path) -> None:
    (tmp_path / "Wall.mo").write_text(WALL)
    effects = [effect for effect in effect_library() if effect.name in ("Lag", "Offset")]
    found = diagnose(compile_model(tmp_path / "Wall.mo"), effects, [_measured()])
    assert found.verdict == "supported"
    best = found.proofs[0]
    assert best.candidate.label == "Lag at Te"
    assert best.told.theta[f"{best.candidate.name}.T"] == pytest.approx(LAG, rel=0.1)
