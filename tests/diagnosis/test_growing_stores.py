"""Stores that grow with their level: a supercapacitor and a funnel, in closed form."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.candidates import attachable, keeping_order, pairs
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.sites import find_site, sites
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.simulate import simulate

CELL = """\
model Cell
  parameter Real C(unit = "F", min = 0, nominal = 20) = 25 annotation(__Daest(estimate = true));
  parameter Real R(unit = "Ohm") = 0.05;
  input Real current(unit = "A");
  output Real voltage(unit = "V") annotation(__Daest(std = 2e-3));
  Real v(unit = "V", start = 3);
equation
  C*der(v) = current;
  voltage = v + R*current;
end Cell;
"""
FUNNEL = """\
model Funnel
  parameter Real A(unit = "m2", min = 0) = 0.1;
  parameter Real k(unit = "m2/s", min = 0) = 0.02;
  input Real q(unit = "m3/s");
  output Real level(unit = "m");
  Real h(unit = "m", start = 0.5);
equation
  A*der(h) = q - k*h;
  level = h;
end Funnel;
"""
CIRCUIT = """\
model Circuit
  Daest.Blocks.Interfaces.RealInput u(unit = "V");
  Daest.Blocks.Interfaces.RealOutput y(unit = "V") = capacitor.v;
  Daest.Electrical.Analog.Sources.SignalVoltage source;
  Daest.Electrical.Analog.Basic.Resistor first(R = 2);
  Daest.Electrical.Analog.Basic.Resistor second(R = 3);
  Daest.Electrical.Analog.Basic.Capacitor capacitor(C = 1);
  Daest.Electrical.Analog.Basic.Ground ground;
equation
  connect(u, source.v);
  connect(source.p, first.p);
  connect(first.n, second.p);
  connect(second.n, capacitor.p);
  connect(capacitor.n, ground.p);
  connect(source.n, ground.p);
end Circuit;
"""


def discharged(current: float, period: float, seed: int) -> Experiment:
    """A capacity of 20 F + 3 F/V, discharged with a constant current: charge is quadratic in the voltage."""
    time = period * np.arange(105)
    C, k, rng = 20.0, 3.0, np.random.default_rng(seed)
    charge = C * 2.9 + 0.5 * k * 2.9**2 - current * time
    v = (np.sqrt(C**2 + 2.0 * k * charge) - C) / k - 0.05 * current
    read = v + 2e-3 * rng.standard_normal(time.size)
    inputs = np.full((time.size, 1), -current)
    return Experiment(f"{current} A", time, inputs, read[:, None], ("current",), ("voltage",))


@pytest.mark.slow  # the law: the test below
def test_capacity_that_grows_with_its_voltage_is_found() -> None:
    records = [discharged(3.0, 0.22, 1), discharged(0.5, 1.3, 2)]
    flat = compile_text(CELL.encode(), Path("Cell.mo"))
    options = DiagnoseOptions(effects=("QuadraticGain", "GrowingCapacity"))
    found = diagnose(flat, effect_library(), records, [discharged(1.5, 0.44, 3)], options)
    best = found.proofs[0]
    assert found.verdict == "supported" and best.candidate.label == "GrowingCapacity at 0:v", found.message
    own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.k")
    assert abs(own.value - 3.0) < 4.0 * own.std_error < 0.6


@pytest.mark.parametrize("name", ["GrowingCapacity", "WideningTank"])
def test_what_is_written_does_what_the_law_says(tmp_path, name) -> None:
    is_cell = name == "GrowingCapacity"
    text, package = (CELL, "Electrical") if is_cell else (FUNNEL, "Hydraulic")
    path = tmp_path / ("Cell.mo" if is_cell else "Funnel.mo")
    path.write_text(text)
    effect = find_effect(f"{package}.{name}")
    site = find_site(compile_model(path), "0:v" if is_cell else "0:h", effect)
    made = extend_model(path, None, effect, site, values={"k": 3.0 if is_cell else 0.4})
    u = -2.0 if is_cell else 0.03

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        return u / (25.0 + 3.0 * x) if is_cell else (u - 0.02 * x) / (0.1 + 0.4 * x)

    time = np.linspace(0.0, 20.0, 41)
    true = solve_ivp(rate, (0.0, 20.0), [3.0 if is_cell else 0.5], t_eval=time, rtol=1e-10).y[0]
    run = simulate(made.flat, (time, np.full((41, 1), u)))
    np.testing.assert_allclose(run.outputs[:, 0], true + (0.05 * u if is_cell else 0.0), rtol=1e-5)


def test_where_nothing_stores_nothing_grows() -> None:
    """Between two resistors a capacity would be one that the model has not."""
    flat = compile_text(CIRCUIT.encode(), Path("Circuit.mo"))
    library = [e for e in effect_library() if e.name == "GrowingCapacity"]
    found = pairs(library, sites(flat))
    kept = keeping_order(flat, reduce_index(flat), found)
    assert len(found) > len(kept) == 1
    assert "capacitor.p" in (kept[0].site.name, *kept[0].site.aliases) and kept[0].keeps_order


DRIVE = """\
model Drive
  Daest.Electrical.Analog.Sources.SignalVoltage driver;
  Daest.Electrical.Analog.Basic.Ground ground;
  Daest.Electrical.Analog.Basic.Resistor coil(R = 2.4);
  Daest.Electrical.Analog.Basic.RotationalEMF motor(k = 0.2);
  Daest.Mechanics.Rotational.Components.Inertia wheel(J = 0.003);
  input Real u(unit = "V");
  output Real w(unit = "rad/s") = wheel.w;
equation
  driver.v = u;
  connect(driver.p, coil.p);
  connect(coil.n, motor.p);
  connect(motor.n, driver.n);
  connect(driver.n, ground.p);
  connect(motor.flange, wheel.flange_a);
end Drive;
"""


def test_what_cannot_stand_beside_another_is_refused_alone() -> None:
    """A capacity at the motor is its inertia seen from the coil; where its ground may move, it is none. Each
    can be attached, both cannot be."""
    flat = compile_text(DRIVE.encode(), Path("Drive.mo"))
    names = {"GrowingCapacity": "coil.n", "Inductance": "ground.p"}
    chosen = [c for c in pairs(effect_library(), sites(flat)) if names.get(c.effect.name) == c.site.name]
    assert len(chosen) == 2 and all(not attachable(flat, [one])[1] for one in chosen)
    for order in (chosen, chosen[::-1]):
        kept, refused, explicit = attachable(flat, tuple(order))
        assert [c.effect.name for c in kept] == ["Inductance"] and len(refused) == 1
        assert refused[0][0] == "GrowingCapacity at coil.n"
        assert any(name.startswith(f"{kept[0].name}.") for name in explicit.flat.unknown_names)


def test_voltage_that_a_speed_induces_is_no_store() -> None:
    """What acts on it acts on the shaft."""
    flat = compile_text(DRIVE.encode(), Path("Drive.mo"))
    library = [e for e in effect_library() if e.name == "GrowingCapacity"]
    found = pairs(library, sites(flat))
    assert found and keeping_order(flat, reduce_index(flat), found) == ()
