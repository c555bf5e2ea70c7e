"""Storage behind what is measured: a wall behind a room, the polarisation of a battery, a load that swings.
Simulated by matrix exponentials."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library

ROOM = """model Room
  parameter Real C(unit = "W.s/K", min = 0) = 3e5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R(unit = "K/W", min = 0) = 0.02 annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput heater(unit = "W");
  Daest.Blocks.Interfaces.RealOutput room(unit = "K");
  Daest.Thermal.HeatTransfer.Sources.PrescribedHeatFlow source;
  Daest.Thermal.HeatTransfer.Components.HeatCapacitor air(C = C, T(start = 280));
  Daest.Thermal.HeatTransfer.Components.ThermalResistor wall(R = R);
  Daest.Thermal.HeatTransfer.Sources.FixedTemperature outdoor(T = 280);
equation
  connect(heater, source.Q_flow);
  connect(source.port, air.port);
  connect(air.port, wall.port_a);
  connect(wall.port_b, outdoor.port);
  room = air.T;
end Room;
"""
WEATHER = """model Weather
  parameter Real C(unit = "J/K", min = 0) = 3e5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R(unit = "K/W", min = 0) = 0.02 annotation(__Daest(estimate = true, scale = "log"));
  input Real heater(unit = "W");
  input Real outdoor(unit = "K");
  output Real room(unit = "K");
  Real T(unit = "K", start = 280);
equation
  C*der(T) = heater - (T - outdoor)/R;
  room = T;
end Weather;
"""
BATTERY = """model Battery
  parameter Real C(unit = "F", min = 0) = 1e5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R(unit = "Ohm", min = 0) = 0.06 annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput i(unit = "A");
  Daest.Blocks.Interfaces.RealOutput v(unit = "V");
  Daest.Electrical.Analog.Basic.Capacitor store(C = C, v(start = 12));
  Daest.Electrical.Analog.Basic.Resistor resistor(R = R);
  Daest.Electrical.Analog.Sources.SignalCurrent load;
  Daest.Electrical.Analog.Basic.Ground ground;
equation
  connect(i, load.i);
  connect(store.p, resistor.p);
  connect(resistor.n, load.p);
  connect(load.n, store.n);
  connect(store.n, ground.p);
  v = resistor.n.v;
end Battery;
"""

TROLLEY = """model Trolley
  parameter Real m(unit = "kg", min = 0) = 8 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.s/m", min = 0) = 3 annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput force(unit = "N");
  Daest.Blocks.Interfaces.RealOutput speed(unit = "m/s");
  Daest.Mechanics.Translational.Sources.Force drive;
  Daest.Mechanics.Translational.Components.Mass body(m = m);
  Daest.Mechanics.Translational.Components.Damper damper(d = d);
  Daest.Mechanics.Translational.Components.Fixed rail;
equation
  connect(force, drive.f);
  connect(drive.flange, body.flange_a);
  connect(rail.flange, damper.flange_a);
  connect(damper.flange_b, body.flange_b);
  speed = body.v;
end Trolley;
"""


ONE_MASS = ("FlexibleAppendage",)


def recorded(A, B, C, D, offset, levels, dt, hold_for, noise, shaken, names) -> Experiment:
    """y = C x + D u + offset, x' = A x + B u from zero, inputs drawn from `levels` and held."""
    rng = np.random.default_rng(5)
    n = A.shape[0]
    whole = expm(np.block([[A, B], [np.zeros((1, n + 1))]]) * dt)
    u = np.repeat(rng.choice(levels, 480 // hold_for), hold_for)
    x, outputs = np.zeros(n), []
    for value in u:
        outputs.append(float(C @ x + D * value) + offset)
        x = whole[:n, :n] @ x + whole[:n, n] * value + shaken * rng.normal(size=n)
    measured = np.array(outputs) + rng.normal(0.0, noise, u.size)
    return Experiment("run", dt * np.arange(u.size), u[:, None], measured[:, None], *names)


def found(tmp_path, text: str, record: Experiment, effects: tuple[str, ...]):
    name = text.split()[1]
    (tmp_path / f"{name}.mo").write_text(text)
    options = DiagnoseOptions(effects=effects, hold="zoh")
    return diagnose(compile_model(tmp_path / f"{name}.mo"), effect_library(), [record], (), options)


@pytest.mark.slow
def test_wall_behind_a_room(tmp_path) -> None:
    C, R, G, T = 4e5, 0.02, 80.0, 9000.0
    A = np.array([[-(1.0 / R + G) / C, G / C], [1.0 / T, -1.0 / T]])
    B = np.array([[1.0 / C], [0.0]])
    shaken = np.array([2e-3, 0.0])
    names = (("heater",), ("room",))
    record = recorded(A, B, np.array([1.0, 0.0]), 0.0, 280.0, [0.0, 1500.0], 120.0, 20, 0.03, shaken, names)
    # Behind a constant temperature outdoors nothing tells how deep inside the wall its mass is.
    diagnosis = found(tmp_path, ROOM, record, ("ExtraHeatCapacity", "WallCapacity", "Conduction"))
    assert diagnosis.verdict == "supported", diagnosis.message
    best = diagnosis.proofs[0]
    assert best.candidate.effect.name == "ExtraHeatCapacity"
    for name, true in (("G", G), ("T", T)):
        own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.{name}")
        assert abs(own.value - true) < 4.0 * own.std_error


@pytest.mark.slow
def test_wall_between_a_room_and_the_weather(tmp_path) -> None:
    """The mass is a third of the resistance away from the room: no heat store at the room does the same."""
    C, R, inner, C_wall = 4e5, 0.02, 0.006, 6e5
    share, T_wall = inner / R, C_wall * inner * (R - inner) / R
    conductance = C_wall / T_wall
    A = np.array([[-1.0 / inner / C, 1.0 / inner / C], [1.0 / inner, -1.0 / inner - 1.0 / (R - inner)]])
    A[1] /= C_wall
    B = np.array([[1.0 / C, 0.0], [0.0, 1.0 / (R - inner) / C_wall]])
    rng, dt = np.random.default_rng(7), 300.0
    whole = expm(np.block([[A, B], [np.zeros((2, 4))]]) * dt)
    heater = np.repeat(rng.choice([0.0, 1500.0], 25), 20)
    outdoor = 276.0 + np.cumsum(rng.normal(0.0, 0.4, heater.size))
    x, room = np.full(2, outdoor[0]), []
    for u in np.column_stack([heater, outdoor]):
        room.append(x[0] + rng.normal(0.0, 0.02))
        x = whole[:2, :2] @ x + whole[:2, 2:] @ u
    inputs, names = np.column_stack([heater, outdoor]), (("heater", "outdoor"), ("room",))
    record = Experiment("run", dt * np.arange(heater.size), inputs, np.array(room)[:, None], *names)
    effects = ("ExtraHeatCapacity", "WallCapacity", "Conduction")
    diagnosis = found(tmp_path, WEATHER, record, effects)
    assert diagnosis.verdict == "supported", diagnosis.message
    best = diagnosis.proofs[0]
    assert best.candidate.effect.name == "WallCapacity"
    for name, true in (("G", conductance), ("T", T_wall), ("share", share)):
        own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.{name}")
        assert abs(own.value - true) < 4.0 * own.std_error


@pytest.mark.slow
def test_polarisation_of_a_battery_beside_effects_that_share_its_current(tmp_path) -> None:
    """Of size zero no effect moves the states of another, though the equations let it."""
    R0, R1, T = 0.05, 0.03, 40.0
    A = np.array([[-1.0 / T, 0.0], [0.0, 0.0]])
    B = np.array([[1.0 / T], [-1.0 / 72000.0]])
    output, levels = np.array([-R1, 1.0]), [0.0, 0.0, 2.0, 5.0, -1.0]
    names = (("i",), ("v",))
    record = recorded(A, B, output, -R0, 12.0, levels, 1.0, 40, 2e-3, np.zeros(2), names)
    effects = ("VoltageRelaxation", "TemperatureDependentResistance", "Leakage", "BrushVoltageDrop")
    diagnosis = found(tmp_path, BATTERY, record, effects)
    assert not diagnosis.screen.skipped
    best = diagnosis.proofs[0]
    assert best.candidate.effect.name == "VoltageRelaxation" and best.verdict != "rejected"
    own = {
        p.name.partition(".")[2]: p for p in best.told.parameters if p.name.startswith(best.candidate.name)
    }
    assert own["R"].value == pytest.approx(R1, rel=0.05) and own["T"].value == pytest.approx(T, rel=0.05)


@pytest.mark.slow
def test_load_that_swings_on_a_trolley(tmp_path) -> None:
    """A mass on a spring has two states that move each other."""
    m, d, m2, T, zeta = 6.0, 4.0, 3.0, 1.6, 0.03
    k, b = m2 * (2.0 * np.pi / T) ** 2, m2 * 4.0 * np.pi * zeta / T
    # Speed of the trolley, deflection and speed of the load.
    A = np.array([[-(d + b) / m, k / m, b / m], [-1.0, 0.0, 1.0], [b / m2, -k / m2, -b / m2]])
    B = np.array([[1.0 / m], [0.0], [0.0]])
    names, shaken = (("force",), ("speed",)), np.array([1e-3, 0.0, 0.0])
    output = np.array([1.0, 0.0, 0.0])
    record = recorded(A, B, output, 0.0, 0.0, [-5.0, 5.0], 0.05, 12, 0.01, shaken, names)
    diagnosis = found(tmp_path, TROLLEY, record, ("FlexibleAppendage", "CoulombFriction"))
    assert diagnosis.verdict == "supported", diagnosis.message
    best = diagnosis.proofs[0]
    assert best.candidate.effect.name == "FlexibleAppendage"
    for name, true in (("m", m2), ("T", T), ("zeta", zeta)):
        own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.{name}")
        assert abs(own.value - true) < 4.0 * own.std_error


@pytest.mark.slow  # storage that is found: the wall of a room above
def test_load_that_oil_drags_along_with_a_trolley(tmp_path) -> None:
    """A mass without a spring: one that swings would have to be damped more than critically."""
    m, d, m2, T = 6.0, 4.0, 3.0, 0.5
    c = m2 / T
    A = np.array([[-(d + c) / m, c / m], [c / m2, -c / m2]])  # speed of the trolley, and of the load
    B, output = np.array([[1.0 / m], [0.0]]), np.array([1.0, 0.0])
    names, shaken = (("force",), ("speed",)), np.array([1e-3, 0.0])
    record = recorded(A, B, output, 0.0, 0.0, [-5.0, 5.0], 0.05, 12, 0.01, shaken, names)
    diagnosis = found(tmp_path, TROLLEY, record, ("DraggedMass", *ONE_MASS))
    assert diagnosis.verdict == "supported", diagnosis.message
    best = diagnosis.proofs[0]
    assert best.candidate.effect.name == "DraggedMass"
    for name, true in (("m", m2), ("T", T)):
        own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.{name}")
        assert abs(own.value - true) < 4.0 * own.std_error


@pytest.mark.slow
def test_sine_from_elsewhere_is_no_mass_that_rings(tmp_path) -> None:
    """A mass of nothing that rings without damping from the first sample on may be any sine."""
    m, d, T = 6.0, 4.0, 1.6
    names = (("force",), ("speed",))
    A, B, output = np.array([[-d / m]]), np.array([[1.0 / m]]), np.array([1.0])
    shaken = np.array([1e-3])
    record = recorded(A, B, output, 0.0, 0.0, [-5.0, 5.0], 0.05, 12, 0.01, shaken, names)
    sine = 0.05 * np.sin(2.0 * np.pi * record.time / T)
    diagnosis = found(tmp_path, TROLLEY, replace(record, outputs=record.outputs + sine[:, None]), ONE_MASS)
    assert diagnosis.verdict != "supported", diagnosis.message


@pytest.mark.slow  # of a speed: the test above
def test_sine_in_a_position_that_nothing_holds_is_no_mass_that_rings(tmp_path) -> None:
    """The errors of its simulation add up, those of the predictions tell the same."""
    m, d, T = 6.0, 4.0, 1.6
    names = (("force",), ("position",))
    A, B, output = np.array([[-d / m, 0.0], [1.0, 0.0]]), np.array([[1.0 / m], [0.0]]), np.array([0.0, 1.0])
    shaken = np.array([1e-3, 0.0])
    record = recorded(A, B, output, 0.0, 0.0, [-5.0, 5.0], 0.05, 12, 0.002, shaken, names)
    sine = 0.01 * np.sin(2.0 * np.pi * record.time / T)
    text = TROLLEY.replace("speed", "position").replace("body.v", "body.s")
    diagnosis = found(tmp_path, text, replace(record, outputs=record.outputs + sine[:, None]), ONE_MASS)
    assert diagnosis.verdict != "supported", diagnosis.message
    reasons = [proof.reason for proof in diagnosis.proofs]
    assert any("lives on how its own states begin" in reason for reason in reasons), reasons
