"""Effects in equations whose variables are in other units than those of the library: rpm, degrees, bar."""

import numpy as np
import pytest

from daest.modelica.compile import compile_model
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.balances import base_unit, domain_of
from daest.modelica.places.place_units import flow_unit, units_at
from daest.modelica.places.sites import find_site
from daest.systems.simulation.simulate import simulate

PI = "3.141592653589793"
# Machines in several units: the variable of the balance, declarations and equations.
MACHINES = {
    "rad/s": ("w", 'Real w(unit="rad/s"); input Real u(unit="N.m");', "J*der(w) = u - 0.02*w;"),
    "over J": ("w", 'Real w(unit="rad/s"); input Real u(unit="N.m");', "der(w) = (u - 0.02*w)/J;"),
    "geared": (
        "w",
        'parameter Real i = 3; Real w(unit="rad/s"), tau(unit="N.m"); input Real u(unit="N.m");',
        "tau = 0.02*w; 4*J*der(w) = 4*i*u/3 - 4*tau;",
    ),
    "rpm": (
        "n",
        'Real n(unit="rpm"); input Real u(unit="N.m");',
        f"J*{PI}/30*der(n) = u - 0.02*n*{PI}/30;",
    ),
    "solved": ("n", 'Real n(unit="rpm"); input Real u(unit="N.m");', f"der(n) = 30/{PI}*u/J - 0.02*n/J;"),
    "deg/s": (
        "w",
        'Real w(unit="deg/s"), phi(unit="deg"); input Real u(unit="mN.m");',
        f"der(phi) = w; J*der(w) = (u/1000 - 0.02*w*{PI}/180)*180/{PI};",
    ),
    "Pa": ("p", 'Real p(unit="Pa"); input Real u(unit="m3/s");', "J*1e-9*der(p) = u - 1e-8*p;"),
    "bar": ("p", 'Real p(unit="bar"); input Real u(unit="l/min");', "J*1e-4*der(p) = u/60000 - 1e-3*p;"),
    "leaving": (
        "p",
        'Real p(unit="bar"), q(unit="l/min"); input Real u(unit="l/min");',
        "q = 60*p; 6*J*der(p) = u - q;",
    ),
    "K": (
        "T",
        'Real T(unit="K", start=300); input Real u(unit="W");',
        "J*100*der(T) = u - 0.3*(T - 293.15);",
    ),
    "degF": (
        "T",
        'Real T(unit="degF", start=80.33); input Real u(unit="kW");',
        "J*100*5/9*der(T) = 1000*u - 0.3*5/9*(T - 68);",
    ),
}
# The same machine twice, an effect with its size, the input of the first, how many units of the second its
# input and output are, and the zero of its output.
PAIRS = [
    ("rad/s", "rpm", "Rotational.CoulombFriction", 0.4, 2.0, 1.0, 30.0 / np.pi, 0.0),
    # No parameter has a unit, but a torque that stands there has.
    ("rad/s", "over J", "Rotational.CoulombFriction", 0.4, 2.0, 1.0, 1.0, 0.0),
    ("rad/s", "geared", "Rotational.CoulombFriction", 0.4, 2.0, 1.0, 1.0, 0.0),
    ("rad/s", "solved", "Rotational.CoulombFriction", 0.4, 2.0, 1.0, 30.0 / np.pi, 0.0),
    pytest.param(
        *("rad/s", "deg/s", "Rotational.QuadraticDrag", 0.03, 2.0, 1e3, 180.0 / np.pi, 0.0),
        marks=pytest.mark.slow,
    ),
    ("Pa", "bar", "Hydraulic.Leak", 2e-8, 2e-3, 6e4, 1e-5, 0.0),
    ("Pa", "leaving", "Hydraulic.Leak", 2e-8, 2e-3, 6e4, 1e-5, 0.0),
    ("K", "degF", "Thermal.RadiationLoss", 2.0, 30.0, 1e-3, 1.8, -459.67),
]


def machine(folder, unit):
    name, declared, equations = MACHINES[unit]
    file = folder / f"M{len(list(folder.iterdir()))}.mo"
    file.write_text(
        f'model M parameter Real J(unit="1") = 0.5; {declared} output Real y = {name};\n'
        f"equation {equations} end M;\n"
    )
    return file, name


def course(flat, u):
    """The output over 3 s under an input that is `u`, then turned round; (61,)."""
    time = np.linspace(0.0, 3.0, 61)
    return simulate(flat, (time, np.where(time < 1.5, u, -u)[:, None]), hold="zoh").outputs[:, 0]


@pytest.mark.parametrize(("own", "unit", "effect_name", "size", "u", "of_u", "of_y", "zero"), PAIRS)
def test_effect_does_the_same_in_another_unit(tmp_path, own, unit, effect_name, size, u, of_u, of_y, zero):
    effect = find_effect(effect_name)
    values = {effect.sizes[0].name: size}

    def with_effect(unit):
        file, name = machine(tmp_path, unit)
        flat = compile_model(file)
        return (
            file,
            flat,
            find_site(flat, name, effect),
            attach(flat, effect, find_site(flat, name, effect), values=values),
        )

    expected = course(with_effect(own)[3], u)
    without = course(compile_model(machine(tmp_path, own)[0]), u)
    assert np.ptp(expected - without) > 0.03 * np.ptp(without)
    file, flat, site, other = with_effect(unit)
    reached = float(np.ptp(expected)) * of_y
    assert course(other, of_u * u) == pytest.approx(of_y * expected + zero, abs=2e-3 * reached)
    # What is written is the same model.
    written = extend_model(file, None, effect, site, values=values)
    assert course(written.flat, of_u * u) == pytest.approx(
        course(other, of_u * u), rel=1e-6, abs=1e-6 * reached
    )
    assert flow_unit(flat, site)
    assert units_at(flat, effect, site) == {p.name: p.unit for p in effect.parameters}


LEVELS = {
    "m": 'Real h(unit="m", start=0.4); input Real u(unit="m3/s");',
    "cm": 'Real h(unit="cm", start=40); input Real u(unit="cm3/s");',
    "mm": 'Real h(unit="mm", start=400); input Real u(unit="l/min");',
}
BALANCES = {
    "m": "0.02*der(h) = u - 0.001*h;",
    "cm": "200*der(h) = u - 10*h;",
    "mm": "1.2*der(h) = u - 0.06*h;",
}


@pytest.mark.parametrize(("unit", "of_u", "of_y"), [("cm", 1e6, 1e2), ("mm", 6e4, 1e3)])
def test_a_level_may_be_in_any_unit_of_length(tmp_path, unit, of_u, of_y):
    """The tanks of the textbooks are in cm and cm3/s: no law of a domain had a place in them."""
    effect = find_effect("Hydraulic.Overflow")
    values = {"k": 2e-3, "p_max": 0.35}

    def grown(unit):
        file = tmp_path / f"{unit}.mo"
        file.write_text(f"model M {LEVELS[unit]} output Real y = h;\nequation {BALANCES[unit]} end M;\n")
        flat = compile_model(file)
        site = find_site(flat, "h", effect)
        return file, flat, site, attach(flat, effect, site, values=values)

    expected = course(grown("m")[3], 4e-4)
    file, flat, site, other = grown(unit)
    assert (site.kind, site.domain) == ("equation", "hydraulic")
    assert units_at(flat, effect, site) == {"k": "m3/(s.m)", "p_max": "m", "p_s": "m"}
    assert course(other, of_u * 4e-4) == pytest.approx(of_y * expected, rel=1e-4)
    written = extend_model(file, None, effect, site, values=values)
    assert course(written.flat, of_u * 4e-4) == pytest.approx(of_y * expected, rel=1e-4)


def test_units_of_one_quantity_are_of_one_domain():
    bases = {"rpm": "rad/s", "deg/s": "rad/s", "rev/min": "rad/s", "km/h": "m/s", "bar": "Pa"}
    assert {unit: base_unit(unit) for unit in bases} == bases
    assert domain_of("degF") == "thermal" and domain_of("mV") == "electrical"
    # What is once a time may be anything, as what has no unit.
    for unit in ("1/s", "Hz", "1/min", "", "1", "nonsense", "kg", "rad"):
        assert domain_of(unit) is None


def test_size_has_no_unit_where_no_flow_stands_in_the_equation(tmp_path):
    file = tmp_path / "M.mo"
    file.write_text(
        'model M input Real u(unit="V"); output Real n(unit="rpm"); equation der(n) = 300*u - 4*n; end M;'
    )
    flat, effect = compile_model(file), find_effect("Rotational.CoulombFriction")
    site = find_site(flat, "n", effect)
    assert not flow_unit(flat, site)
    found = units_at(flat, effect, site)
    assert found["tau_c"] == "" and found["w_s"] == "rad/s"
