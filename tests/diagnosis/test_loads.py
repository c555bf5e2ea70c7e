"""Where loads may act, and the model with loads: transfer functions by hand."""

import re
from pathlib import Path

import numpy as np
import pytest
from hidden_plants import model

from daest.diagnosis.evidence.stand import without_noises
from daest.diagnosis.null_model.loads import load_places, load_sites, with_loads
from daest.diagnosis.null_model.null import pinned
from daest.modelica.compile import compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.flat.clock import clock_unit
from daest.modelica.places.sites import find_site, sites
from daest.systems.linear.state_space import state_space, state_space_family
from daest.systems.reduction.reduce import reduce_index


def places_of(name, **options):
    flat = without_noises(model(name))
    return flat, load_places(flat, [s for s in sites(flat) if s.kind == "node"])


SLOWING = b"""model Slowing
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = 2e-6, w(start = 3000));
  Daest.Mechanics.Rotational.Components.Damper bearing(d = 2e-6);
  Daest.Mechanics.Rotational.Components.Fixed housing;
  output Real speed(unit = "rad/s") = rotor.w;
equation
  connect(rotor.flange_b, bearing.flange_a);
  connect(bearing.flange_b, housing.flange);
end Slowing;
"""


def test_rotor_has_one_place_in_newton_metres():
    _, places = places_of("Rotor")
    assert [(p.names, p.unit) for p in places] == [(("rotor.flange_a",), "N.m")]


def test_places_that_a_rigid_gear_joins_are_one():
    _, places = places_of("TwoMass")
    assert {p.names for p in places} == {("motor.flange_a", "gear.flange_b"), ("disc.flange_a",)}


def test_unconnected_flywheel_is_not_seen():
    _, places = places_of("TwoMass")
    assert not any("loose" in name for p in places for name in p.names)


ACCELEROMETER = b"""model Mass
  parameter Real m(unit = "kg") = 2;
  parameter Real c(unit = "N/m") = 50;
  input Real f(unit = "N");
  output Real a(unit = "m/s2");
  Real s(unit = "m");
  Real v(unit = "m/s");
equation
  der(s) = v;
  m*a = f - c*s;
  a = der(v);
end Mass;
"""


def test_load_that_an_accelerometer_sees_at_once_has_its_place():
    flat = compile_text(ACCELEROMETER, Path("Mass.mo"))
    (place,) = load_places(flat, [s for s in sites(flat) if s.kind == "equation"])
    T = 0.7
    space = state_space(state_space_family(with_loads(flat, [place], [T])), np.array([*flat.theta_values, T]))
    response = space.C @ np.linalg.solve(2j * np.eye(3) - space.A, space.G[:, 0])
    # a = s²/(2 s² + 50) times the load, T/(T s + 1) times its noise, at s = 2i
    assert abs(response[0]) * abs(1 + 2j * T) == pytest.approx(4 / 42 * T, rel=1e-6)


COIL = b"""model Coil
  input Real u(unit = "V");
  output Real y(unit = "A");
  Real i(unit = "A");
equation
  0.02*der(i) = u - 2.5*i;
  y = i;
end Coil;
"""


MASSLESS = b"""model Tip
  parameter Real d(unit = "N.m.s/rad") = 2;
  parameter Real k(unit = "N.m/rad") = 4;
  input Real u(unit = "rad");
  output Real y(unit = "rad");
  Daest.Mechanics.Rotational.Sources.Position motor(exact = true, phi_ref = u);
  Daest.Mechanics.Rotational.Components.Spring wire(c = 3);
  Daest.Mechanics.Rotational.Components.SpringDamper tip(c = k, d = d);
  Daest.Mechanics.Rotational.Components.Fixed base;
equation
  connect(motor.flange, wire.flange_a);
  connect(wire.flange_b, tip.flange_b);
  connect(tip.flange_a, base.flange);
  y = tip.phi_rel;
end Tip;
"""


def test_place_without_inertia_takes_a_load_though_its_acceleration_is_told():
    """Under white noise the acceleration that the damper tells would be noise that is differentiated."""
    flat = compile_text(MASSLESS, Path("Tip.mo"))
    places = load_places(flat, [s for s in sites(flat) if s.kind == "node"])
    assert [p.names for p in places] == [("wire.flange_b",)]
    T = 0.7
    space = state_space(state_space_family(with_loads(flat, places, [T])), np.array([*flat.theta_values, T]))
    response = space.C @ np.linalg.solve(2j * np.eye(len(space.A)) - space.A, space.G[:, 0])
    # 1/(2 s + 4 + 3) times the load, T/(T s + 1) times its noise, at s = 2i
    assert abs(response[0]) == pytest.approx(T / abs(1 + 2j * T) / abs(7 + 4j), rel=1e-6)


@pytest.mark.parametrize("text", [COIL, re.sub(rb"\(unit = .*?\)", b"", COIL)])
def test_a_balance_whose_domain_no_unit_tells_takes_a_load(text):
    flat = compile_text(text, Path("Coil.mo"))
    (place,) = load_places(flat, load_sites(flat))
    assert place.names == ("0:i",) and place.row == 0


def test_load_has_a_name_that_the_model_has_not():
    text = ACCELEROMETER.replace(b" m(", b" load_1(").replace(b"m*a", b"load_1*a")
    flat = compile_text(text, Path("Mass.mo"))
    (place,) = load_places(flat, [s for s in sites(flat) if s.kind == "equation"])
    loaded = with_loads(flat, [place], [0.7])
    assert place.load == "load_2"
    assert [p.name for p in loaded.parameters] == ["load_1", "c", "load_2.T"]
    assert [n.name for n in loaded.noises] == ["load_2.w"]


def test_load_passes_through_its_lag():
    flat, places = places_of("Rotor")
    T = 0.7
    space = state_space(state_space_family(with_loads(flat, places, [T])), np.array([*flat.theta_values, T]))
    poles = np.sort(np.linalg.eigvals(space.A).real)
    assert poles == pytest.approx([-1 / T, -0.3 / 0.5, 0.0], abs=1e-9)
    for omega in (0.1, 1.0, 10.0):
        s = 1j * omega
        found = (space.C @ np.linalg.solve(s * np.eye(3) - space.A, space.G))[0, 0]
        assert found == pytest.approx(1 / (s + 1 / T) / (0.5 * s**2 + 0.3 * s), rel=1e-9)


def test_loads_at_two_places_are_two_noises():
    flat, places = places_of("TwoMass")
    loaded = with_loads(flat, places, [0.1, 0.2])
    assert [n.name for n in loaded.noises] == ["load_1.w", "load_2.w"]
    assert [p.value for p in loaded.parameters[-2:]] == [0.1, 0.2]
    space = state_space(state_space_family(loaded), loaded.theta_values)
    assert np.linalg.matrix_rank(space.G) == 2


@pytest.mark.parametrize("equation", ["J*der(w) = u - d*w", "der(w) = (u - d*w)/J"])
def test_a_load_is_a_torque_however_the_equation_is_written(equation):
    """Divided by an inertia of 0.5 kg.m2, loads had come out twice as large, as torques."""
    text = f"""model Rotor
  parameter Real J(unit = "kg.m2") = 0.5;
  parameter Real d(unit = "N.m.s/rad") = 0.3;
  input Real u(unit = "N.m");
  output Real w(unit = "rad/s");
equation
  {equation};
end Rotor;"""
    assert acceleration(text) == ("N.m", pytest.approx(1.0 / 0.5))


def test_a_load_among_flows_in_other_units_is_told_in_that_of_its_domain():
    text = """model Accumulator
  parameter Real C(unit = "l/bar") = 0.02;
  parameter Real k(unit = "l/(min.bar)") = 0.1;
  input Real q(unit = "l/min");
  output Real p(unit = "bar");
equation
  60*C*der(p) = q - k*p;
end Accumulator;"""
    assert acceleration(text) == ("m3/s", pytest.approx(60000.0 / (60 * 0.02)))
    text = """model Room
  parameter Real C(unit = "kJ/K") = 20;
  parameter Real G(unit = "kW/K") = 0.1;
  input Real Q(unit = "kW");
  output Real T(unit = "degC");
equation
  C*der(T) = Q - G*T;
end Room;"""
    assert acceleration(text) == ("W", pytest.approx(1e-3 / 20.0))


def acceleration(text):
    """The unit of the only load of a model of one state, and by what a unit of it changes the rate."""
    flat = compile_text(text.encode(), Path(f"{text.split()[1]}.mo"))
    (place,) = places = load_places(flat, load_sites(flat))
    with_load = with_loads(flat, places, [1.0])
    loaded = state_space(state_space_family(with_load), with_load.theta_values)
    return place.unit, float(np.max(np.abs(loaded.A - np.diag(np.diag(loaded.A)))))


HOURS = b"""model Hours
  parameter Real C(unit = "kW.h/K") = 2;
  input Real u(unit = "kW");
  output Real y(unit = "degC") = T;
  parameter Real G(unit = "kW/K") = 2;
  Real T(unit = "degC");
  Real S(unit = "degC");
equation
  C*der(T) = u - G*(T - S);
  C*der(S) = G*(T - S);
end Hours;
"""


def test_the_times_of_loads_do_not_tell_what_the_model_counts_time_in():
    flat = compile_text(HOURS, Path("Hours.mo"))
    assert clock_unit(flat) == "h"
    places = load_places(flat, load_sites(flat))
    assert clock_unit(with_loads(flat, places, [1.0] * len(places))) == "h"


def test_a_load_between_a_spring_that_is_put_in_and_a_damper_stays_a_state():
    """The damper's speed follows from the load, or the load from that speed; a damper of a few µN.m.s/rad
    makes the first the smaller pivot."""
    flat = compile_text(SLOWING, Path("Slowing.mo"))
    places = load_places(flat, load_sites(flat))
    loaded = with_loads(flat, places, [1.0])
    null = pinned(loaded, reduce_index(loaded))
    effect = find_effect("Rotational.ExtraCompliance")
    grown = attach(null, effect, find_site(null, "rotor.flange_b", effect), values={"e": 1e4, "T": 0.01})
    assert places[0].load in reduce_index(grown).state_names
    assert places[0].load in reduce_index(pinned(grown, reduce_index(grown))).state_names


ROOTS = b"""model Roots
  parameter Real k(unit = "kg/(s.bar)") = 0.6;
  parameter Real C(unit = "kg/bar") = 200;
  input Real supply(unit = "bar", start = 40);
  input Real taken(unit = "kg/s");
  output Real p1(unit = "bar", start = 36);
  output Real p2(unit = "bar", start = 36);
equation
  C*der(p1) = k*sqrt(supply^2 - p1^2) - (if p1 > p2 then k*sqrt(p1^2 - p2^2) else -k*sqrt(p2^2 - p1^2));
  C*der(p2) = (if p1 > p2 then k*sqrt(p1^2 - p2^2) else -k*sqrt(p2^2 - p1^2)) - taken;
end Roots;
"""


def test_places_are_told_apart_where_slopes_are_infinite_at_the_start() -> None:
    flat = compile_text(ROOTS, Path("Roots.mo"))
    assert [p.names for p in load_places(flat, load_sites(flat))] == [("0:p1",), ("1:p2",)]


def test_a_pressure_that_moves_a_liquid_may_be_a_load():
    """A pipe with inertia takes unknown pressures as a body does forces; one without has no motion."""
    text = """model Line
  parameter Real L(unit="kg/m4") = 3.2e8;
  parameter Real R(unit="Pa.s/m3") = 4e7;
  parameter Real C(unit="m3/Pa") = 3e-7;
  input Real pp(unit="Pa");
  output Real q(unit="m3/s");
  output Real p(unit="Pa");
equation
  %s = pp - p - R*q;
  C*der(p) = q;
end Line;"""
    moving, still = (compile_text((text % left).encode(), Path("Line.mo")) for left in ("L*der(q)", "0"))
    assert [site.name for site in load_sites(moving)] == ["1:p", "0:q"]
    assert [site.name for site in load_sites(still)] == ["1:p"]
    assert [place.unit for place in load_places(moving, load_sites(moving))] == ["m3/s", "Pa"]
