"""A wall as a resistance alone, in which the machine stores heat: the model has no states, and with them no
time constant. Simulated by the closed solution of a filter."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter, lsim

from daest.diagnosis.diagnose import diagnose
from daest.model.diagnosis import Diagnosis
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library

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


def _diagnosed(folder: Path, u: np.ndarray, q: np.ndarray, *names: str) -> Diagnosis:
    """Of Ti and Te, u (n, 2), and the flow q (n,), to which noise of 0.05 W comes."""
    (folder / "Wall.mo").write_text(WALL)
    q = q + 0.05 * np.random.default_rng(8).normal(size=q.size)
    experiment = Experiment("wall", PERIOD * np.arange(len(u)), u, q[:, None], ("Ti", "Te"), ("q",))
    effects = [effect for effect in effect_library() if effect.name in names]
    return diagnose(compile_model(folder / "Wall.mo"), effects, [experiment])


@pytest.mark.slow
def test_lag_is_found_where_the_model_has_no_time_constant(tmp_path: Path) -> None:
    steps = np.repeat(np.random.default_rng(7).normal(size=(70, 2)), 12, axis=0)
    u = np.array([21.0, 10.0]) + steps * [1.0, 4.0]
    keeps = np.exp(-PERIOD / LAG)
    late = lfilter([0.0, 1.0 - keeps], [1.0, -keeps], u[:, 1] - u[0, 1]) + u[0, 1]
    found = _diagnosed(tmp_path, u, (u[:, 0] - late) / R, "Lag", "Offset")
    assert found.verdict == "supported"
    best = found.proofs[0]
    assert best.candidate.label == "Lag at Te"
    assert best.told.theta[f"{best.candidate.name}.T"] == pytest.approx(LAG, rel=0.1)


@pytest.mark.slow  # without states: the test above
def test_store_at_a_temperature_that_is_an_input_needs_its_slope(tmp_path: Path) -> None:
    """The wall takes up heat behind the meter, at the temperature inside."""
    rng = np.random.default_rng(7)
    u = np.array([21.0, 10.0]) + lfilter([0.1, 0.1], [1.0, -0.9], rng.normal(size=(1200, 2)), axis=0) * [
        2.0,
        4.0,
    ]
    conductance = 0.3
    rising = lsim(([LAG, 0.0], [LAG, 1.0]), u[:, 0] - u[0, 0], PERIOD * np.arange(len(u)))[1]
    flow = (u[:, 0] - u[:, 1]) / R + conductance * rising
    found = _diagnosed(tmp_path, u, flow, "ExtraHeatCapacity", "Offset")
    assert found.verdict == "supported"
    best = found.proofs[0]
    assert best.candidate.label == "ExtraHeatCapacity at meter.port_b"
    values = {name.rpartition(".")[2]: best.told.theta[name] for name in best.candidate.estimated}
    assert values == {"G": pytest.approx(conductance, rel=0.1), "T": pytest.approx(LAG, rel=0.2)}
