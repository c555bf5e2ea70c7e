"""Balances of what is stored, as charge, momentum, volume, mass and heat, whose potential a law gives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from daest import compile_model
from daest.errors import ModelError
from daest.model.flat import FlatModel
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.balances import balances, temperatures
from daest.modelica.places.internal_forces import internal_forces
from daest.modelica.places.place_units import flow_factor
from daest.modelica.places.sites import find_site, sites
from daest.systems.simulation.simulate import simulate

CIRCUIT = """\
model Circuit
  parameter Real R(unit = "Ohm") = 1000;
  parameter Real C(unit = "F") = 1e-4;
  input Real u(unit = "V");
  output Real y(unit = "V");
  Real v(unit = "V"); {declared}
equation
  {equations}
  y = v;
end Circuit;
"""
BODY = """\
model Body
  parameter Real m(unit = "kg") = 2;
  parameter Real d(unit = "N.s/m") = 3;
  input Real F(unit = "N");
  output Real y(unit = "m");
  Real s(unit = "m", start = 0), v(unit = "m/s"), p{unit};
equation
  der(s) = v;
  p = m*v;
  der(p) = F - d*v;
  y = s;
end Body;
"""
VESSEL = """\
model Vessel
  parameter Real A(unit = "m2") = 0.5;
  parameter Real R(unit = "Pa.s/m3") = 1e5;
  input Real q(unit = "m3/s");
  output Real y(unit = "Pa");
  Real p(unit = "Pa"), x(unit = "{unit}", start = 1);
equation
  der(x) = {factor}*(q - p/R);
  {law};
  y = p;
end Vessel;
"""
BLOCK = """\
model Block
  parameter Real C(unit = "J/K") = 500;
  parameter Real G(unit = "W/K") = 2;
  input Real P(unit = "W");
  output Real y(unit = "{out}");
  Real {state};
equation
  {equations}
end Block;
"""


def compiled(folder: Path, text: str) -> FlatModel:
    file = folder / f"{text.split()[1]}.mo"
    file.write_text(text)
    flat = compile_model(str(file))
    assert isinstance(flat, FlatModel)
    return flat


def told(flat: FlatModel) -> list[tuple[str, str | None, float]]:
    """Name, domain and factor of the flow, at the values of the model, of every balance."""
    found = []
    for one in balances(flat):
        factor = flow_factor(flat, one)
        assert factor is not None
        value = ca.Function("value", [flat.theta], [factor])(flat.theta_values)
        found.append((one.name(flat), one.domain(flat), float(value)))
    return found


@pytest.mark.parametrize(
    ("declared", "equations", "row", "factor"),
    [
        ("", "C*der(v) = (u - v)/R;", 0, 1.0),
        ("", "R*C*der(v) = u - v;", 0, 1000.0),
        ('Real i(unit = "A"), Q(unit = "C");', "u = R*i + v; der(Q) = i; Q = C*v;", 1, 1.0),
        ('Real i(unit = "A"), Q(unit = "C");', "u = R*i + v; 0 = i - der(Q); Q = C*v;", 1, 1.0),
    ],
)
def test_a_leak_to_ground_has_a_place_at_the_node_of_a_bare_capacity(
    tmp_path: Path, declared: str, equations: str, row: int, factor: float
) -> None:
    flat = compiled(tmp_path, CIRCUIT.format(declared=declared, equations=equations))
    ((name, domain, times),) = told(flat)
    assert (name, domain) == (f"{row}:v", "electrical") and times == pytest.approx(factor)
    effect = find_effect("GroundLeakage")
    grown = attach(flat, effect, find_site(flat, name, effect), values={"G": 0.01})
    assert grown.n > flat.n


@pytest.mark.parametrize("unit", ["", '(unit = "kg.m/s")', '(unit = "N.s")'])
def test_a_momentum_is_balanced_at_its_speed(tmp_path: Path, unit: str) -> None:
    flat = compiled(tmp_path, BODY.format(unit=unit))
    ((name, domain, factor),) = told(flat)
    assert (name.partition(":")[2], domain, factor) == ("v", "translational", 1.0)
    (balance,) = balances(flat)
    assert flat.unknowns[balance.position].name == "s"


@pytest.mark.parametrize(
    ("unit", "factor", "law", "expected"),
    [
        ("m3", "1", "p = 9810*x/A", 1.0),
        ("l", "1000", "p = 9.81*x/A", 1000.0),
        ("kg", "1000", "p = 9.81*x/A", 1000.0),
    ],
)
def test_a_volume_or_a_mass_is_balanced_at_its_pressure(
    tmp_path: Path, unit: str, factor: str, law: str, expected: float
) -> None:
    flat = compiled(tmp_path, VESSEL.format(unit=unit, factor=factor, law=law))
    assert [(name.partition(":")[2], domain) for name, domain, _ in told(flat)] == [("p", "hydraulic")]
    assert told(flat)[0][2] == pytest.approx(expected)
    assert not [site for site in sites(flat) if site.domain == "amount"]


@pytest.mark.parametrize(("unit", "times", "factor"), [("J", "", 1.0), ("kJ", "1000*", 1.0)])
def test_heat_is_balanced_at_its_temperature(tmp_path: Path, unit: str, times: str, factor: float) -> None:
    state = f'T(unit = "K"), E(unit = "{unit}", start = 146)'
    equations = f"{times}der(E) = P - G*(T - 293.15); E = C*T/({times or '1*'}1); y = T;"
    flat = compiled(tmp_path, BLOCK.format(out="K", state=state, equations=equations))
    ((name, domain, value),) = told(flat)
    assert name.endswith(":T") and domain == "thermal" and value == pytest.approx(factor)


@pytest.mark.parametrize(
    ("out", "law", "offset"),
    [("K", "y = e + 293.15;", 293.15), ("degC", "y = e + 20;", 293.15), ("K", "y = e + 0.5;", None)],
)
def test_a_temperature_above_a_reference_is_absolute_with_it(
    tmp_path: Path, out: str, law: str, offset: float | None
) -> None:
    flat = compiled(
        tmp_path,
        BLOCK.format(out=out, state='e(unit = "K", start = 0)', equations=f"C*der(e) = P - G*e; {law}"),
    )
    found = {i: change.offset for i, change in temperatures(flat).items()}
    assert found == ({} if offset is None else {0: pytest.approx(offset)})


def test_a_sensor_of_a_position_stores_nothing(tmp_path: Path) -> None:
    text = BODY.format(unit="").replace(", p;", ', a(unit = "V");').replace("p = m*v;", "a = 5*s;")
    flat = compiled(tmp_path, text.replace("der(p)", "m*der(v)"))
    assert [domain for _, domain, _ in told(flat)] == ["translational"]


WRITTEN_OUT = """\
model Train
  parameter Real J1(unit = "kg.m2") = 0.5, J2(unit = "kg.m2") = 2, n = 3;
  parameter Real c(unit = "N.m/rad") = 40, d(unit = "N.m.s/rad") = 1.5;
  input Real tau(unit = "N.m");
  output Real y(unit = "rad");
  Real L1(unit = "N.m.s", start = 0), L2(unit = "N.m.s", start = 0), p1(unit = "rad", start = 0),
    p2(unit = "rad", start = 0);
equation
  der(L1) = tau - (c*(p1/n - p2) + d*(L1/J1/n - L2/J2))/n;
  der(L2) = c*(p1/n - p2) + d*(L1/J1/n - L2/J2);
  der(p1) = L1/J1;
  der(p2) = L2/J2;
  y = p2;
end Train;
"""
IN_SPEEDS = (
    WRITTEN_OUT.replace("L1/J1", "w1")
    .replace("L2/J2", "w2")
    .replace("Train", "Usual")
    .replace("der(L1)", "J1*der(w1)")
    .replace("der(L2)", "J2*der(w2)")
    .replace('L1(unit = "N.m.s"', 'w1(unit = "rad/s"')
    .replace('L2(unit = "N.m.s"', 'w2(unit = "rad/s"')
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (WRITTEN_OUT, [("0:L1/J1", "rotational", 1.0), ("1:L2/J2", "rotational", 1.0)]),
        (
            BODY.format(unit='(unit = "kg.m/s")')
            .replace(', v(unit = "m/s")', "")
            .replace("  p = m*v;\n", "")
            .replace("der(s) = v", "der(s) = p/m")
            .replace("d*v", "d*p/m - 9.81*m"),
            [("1:p/m", "translational", 1.0)],
        ),
        (
            CIRCUIT.format(declared='Real Q(unit = "C");', equations="der(Q) = (u - Q/C)/R; v = Q/C;"),
            [("0:v", "electrical", 1.0)],
        ),
        (
            CIRCUIT.format(declared='Real Q(unit = "C");', equations="der(Q) = (u - Q/C)/R;")
            .replace('Real v(unit = "V");', "")
            .replace("y = v", "y = Q/C"),
            [("0:Q/C", "electrical", 1.0)],
        ),
        (
            BLOCK.format(out="K", state='E(unit = "J")', equations="der(E) = P - G*(E/C - 293.15); y = E/C;"),
            [("0:E/C", "thermal", 1.0)],
        ),
        (
            VESSEL.format(unit="m3", factor="1", law="p = 9810*y")
            .replace("y(unit", "h(unit")
            .replace('output Real h(unit = "Pa")', 'output Real y(unit = "m") = x/A')
            .replace("  y = p;\n", ""),
            [("0:x/A", "hydraulic", 1.0)],
        ),
    ],
    ids=["gear", "body", "variable", "charge", "heat", "level"],
)
def test_a_potential_that_is_written_out_is_balanced(
    tmp_path: Path, text: str, expected: list[tuple[str, str, float]]
) -> None:
    assert told(compiled(tmp_path, text)) == expected


def test_a_potential_that_is_written_out_has_a_position_and_forces(tmp_path: Path) -> None:
    flat = compiled(tmp_path, WRITTEN_OUT)
    positions = [flat.unknowns[one.position].name for one in balances(flat)]
    (force,) = internal_forces(flat)
    assert positions == ["p1", "p2"]
    assert force.name(flat) == "0:L1/J1, 1:L2/J2" and force.motion_text(flat) == "p1/n - p2"
    assert force.coefficients(flat) == (("c", "c"), ("d", "d"))


@pytest.mark.parametrize(
    ("name", "place", "values"),
    [
        ("Rotational.QuadraticDrag", "L2", {"k": 0.3}),
        ("Rotational.HardeningSpring", "0:L1/J1, 1:L2/J2", {"c3": 500.0}),
    ],
)
def test_an_effect_at_a_potential_that_is_written_out(
    tmp_path: Path, name: str, place: str, values: dict[str, float]
) -> None:
    """The text that is written says the same as the model in which the effect was put in, and as the model
    with a variable for the speed."""
    flat, effect = compiled(tmp_path, WRITTEN_OUT), find_effect(name)
    site = find_site(flat, place, effect)
    written = extend_model(tmp_path / "Train.mo", "Train", effect, site, values=values).flat
    usual = compiled(tmp_path, IN_SPEEDS)
    there = find_site(usual, place.replace("L1/J1", "w1").replace("L2/J2", "w2").replace("L2", "w2"), effect)
    inputs = np.linspace(0.0, 2.0, 21), np.full((21, 1), 5.0)
    courses = [
        simulate(one, inputs).outputs
        for one in (
            attach(flat, effect, site, values=values),
            written,
            attach(usual, effect, there, values=values),
        )
    ]
    assert np.ptp(courses[0]) > 0.1
    np.testing.assert_allclose(courses[1], courses[0], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(courses[2], courses[0], rtol=1e-5, atol=1e-7)


MOTOR = """\
model Motor
  parameter Real R(unit = "Ohm") = 2, L(unit = "H") = 0.5, k(unit = "N.m/A") = 0.3;
  parameter Real J(unit = "kg.m2") = 0.01, d(unit = "N.m.s/rad") = 0.02;
  input Real u(unit = "V");
  output Real y(unit = "rad/s");
  Real w(unit = "rad/s", start = 0), psi(unit = "{unit}", start = 0);
equation
  der(psi) = u - R*{current} - k*w;
  J*der(w) = k*{current} - d*w;
  y = w;
end Motor;
"""


def test_a_flux_over_an_inductance_is_the_current_of_a_mesh(tmp_path: Path) -> None:
    flat = compiled(tmp_path, MOTOR.format(unit="Wb", current="psi/L"))
    usual = MOTOR.format(unit="A", current="psi").replace("der(psi)", "L*der(psi)").replace("Motor", "Usual")
    effect, values = find_effect("Electrical.BrushVoltageDrop"), {"V_b": 1.5, "i_s": 0.1}
    site = find_site(flat, "0:psi/L", effect)
    written = extend_model(tmp_path / "Motor.mo", "Motor", effect, site, values=values).flat
    inputs = np.linspace(0.0, 2.0, 21), np.full((21, 1), 5.0)
    plain = compiled(tmp_path, usual)
    beside = attach(plain, effect, find_site(plain, "0:psi", effect), values=values)
    models = attach(flat, effect, site, values=values), written, beside
    courses = [simulate(one, inputs).outputs for one in models]
    assert np.ptp(courses[0]) > 0.1
    np.testing.assert_allclose(courses[1], courses[0], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(courses[2], courses[0], rtol=1e-5, atol=1e-7)


FURNACE = """\
model Furnace
  parameter Real Cc(unit = "kJ/K") = 9;
  parameter Real Cm(unit = "kJ/K") = 24;
  parameter Real G(unit = "kW/K") = 0.1;
  input Real P(unit = "kW");
  output Real T(unit = "degC");
  Real Ec(unit = "kJ", start = 1200), Em(unit = "kJ", start = 2900);
equation
  der(Ec) = P - G*(Ec/Cc - Em/Cm);
  der(Em) = G*(Ec/Cc - Em/Cm);
  T = 20 + Em/Cm;
end Furnace;
"""


def places_of(flat):
    return [[part.rpartition(":")[2] for part in s.name.split(", ")] for s in sites(flat) if ":" in s.name]


def test_places_of_stored_heat_stay_beside_an_effect_whose_ports_are_absolute(tmp_path):
    flat, radiation = compiled(tmp_path, FURNACE), find_effect("Thermal.RadiationLoss")
    expected = [["Ec/Cc"], ["Em/Cm"], ["Ec/Cc", "Em/Cm"]]
    assert places_of(flat) == expected
    site = find_site(flat, "Ec/Cc", radiation)
    assert places_of(attach(flat, radiation, site, values={"Gr": 0.3})) == expected
    made = extend_model(tmp_path / "Furnace.mo", None, radiation, site, values={"Gr": 0.3})
    assert places_of(made.flat) == expected
    # A further effect finds its places by the names that they had before the first was written.
    written = tmp_path / "again.mo"
    written.write_text(made.text)
    for name, place in (("WallCapacity", "0:Ec/Cc, 1:Em/Cm"), ("HeatLoss", "0:Ec/Cc")):
        effect = find_effect(f"Thermal.{name}")
        second = extend_model(written, made.class_name, effect, find_site(made.flat, place, effect), "second")
        assert second.text.count("(T = Ec/Cc + 273.15)") == 1


def test_exchange_with_what_the_model_no_longer_has_is_refused(tmp_path):
    flat, wall = compiled(tmp_path, FURNACE), find_effect("Thermal.WallCapacity")
    site = replace(find_site(flat, "Ec/Cc, Em/Cm", wall), name="0:Ec/Cc, 1:gone")
    with pytest.raises(ModelError, match="no place of the model any more"):
        attach(flat, wall, site)
