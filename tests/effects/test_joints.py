"""Connectors that call their variables otherwise than the library: known by their units, and joined."""

import re

import numpy as np
import pytest
from effect_rig import characteristic, finite_poles

from daest.errors import ModelError
from daest.modelica.compile import compile_model
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import find_site, fits, sites
from daest.systems.simulation.simulate import simulate

OWN = """package Own "Connectors with names of their own"
  connector Heat Real T(unit = "degC"); flow Real Q(unit = "W"); end Heat;
  connector Pole Real u(unit = "V"); flow Real j(unit = "A"); end Pole;
  connector Shaft Real angle(unit = "rad"); flow Real torque(unit = "N.m"); end Shaft;
  connector Bus Real x(unit = "1"); flow Real y(unit = "1"); end Bus;
  model Body Heat h; parameter Real C(unit = "J/K") = 50; equation C*der(h.T) = h.Q; end Body;
  model Wall Heat a; Heat b; parameter Real G(unit = "W/K") = 2; equation
    a.Q = G*(a.T - b.T); a.Q + b.Q = 0; end Wall;
  model Outside Heat h; equation h.T = 10; end Outside;
  model Source Pole p; Pole n; input Real u(unit = "V"); equation p.u - n.u = u; p.j + n.j = 0; end Source;
  model Coil Pole p; Pole n; Shaft shaft; equation
    p.u - n.u = 3*p.j + 0.1*der(p.j) + 0.4*der(shaft.angle); p.j + n.j = 0; shaft.torque = -0.4*p.j; end Coil;
  model Earth Pole p; equation p.u = 0; end Earth;
  model Disc Shaft shaft; Real w(unit = "rad/s"); equation
    w = der(shaft.angle); 0.02*der(w) = shaft.torque - 0.01*w; end Disc;
  model Port Bus bus; equation bus.x = 1; end Port;
  model Machine "A motor, and a room beside it"
    input Real u(unit = "V");
    output Real w(unit = "rad/s") = disc.w;
    output Real T(unit = "degC") = room.h.T;
    Body room; Wall wall; Outside outside; Source source(u = u); Coil coil; Earth earth; Disc disc; Port port;
  equation
    connect(room.h, wall.a); connect(wall.b, outside.h);
    connect(source.p, coil.p); connect(coil.n, earth.p); connect(source.n, earth.p);
    connect(coil.shaft, disc.shaft);
  end Machine;
end Own;
"""


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    file = tmp_path_factory.mktemp("own") / "Own.mo"
    file.write_text(OWN)
    return file


def test_connectors_are_known_by_their_units(own):
    found = {s.domain for s in sites(compile_model(own, "Own.Machine")) if s.connectors or s.kind == "node"}
    assert found == {"thermal", "electrical", "rotational"}


@pytest.mark.parametrize(
    ("effect", "place", "n_joints"),
    [
        ("Thermal.HeatLoss", "room.h", 1),
        ("Thermal.Conduction", "room.h, outside.h", 2),
        ("Rotational.CoulombFriction", "disc.shaft", 1),
        ("Electrical.BrushVoltageDrop", "coil.p", 2),
        ("Electrical.Leakage", "coil", 2),
    ],
)
def test_written_model_has_the_equations_of_the_attached_effect(own, effect, place, n_joints):
    flat = compile_model(own, "Own.Machine")
    law = find_effect(effect)
    site = find_site(flat, place, law)
    values = {p.name: 0.7 * (p.start or 1.0) for p in law.sizes}
    made = extend_model(own, "Own.Machine", law, site, values=values)
    assert made.added.count(".own, ") == n_joints
    assert made.added.count('"Joins connectors whose variables have other names"') == min(n_joints, 1)
    merged = attach(flat, law, site, values=values)
    assert finite_poles(made.flat) == pytest.approx(finite_poles(merged), rel=1e-6, abs=1e-9)
    assert characteristic(made.flat) == pytest.approx(characteristic(merged), rel=1e-6)


def test_connector_whose_class_is_in_another_file_is_refused(own, tmp_path):
    file = tmp_path / "Plant.mo"
    file.write_text("model Plant extends Own.Machine; end Plant;")
    flat = compile_model(file, "Plant", [own.parent])
    law = find_effect("Thermal.HeatLoss")
    with pytest.raises(ModelError) as caught:
        extend_model(file, "Plant", law, find_site(flat, "room.h", law), libraries=[own.parent])
    assert caught.value.code == "effect-not-writable" and "is not in this file" in caught.value.what


def test_parameter_below_its_bound_takes_the_bound_along(tmp_path):
    """At a scale that no sensor shows a small friction may come out below zero."""
    file = tmp_path / "Rotor.mo"
    file.write_text(
        """model Rotor
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.1;
  parameter Real J(unit = "kg.m2", min = 0) = 0.2;
  input Real u(unit = "N.m");
  Real w(unit = "rad/s");
equation
  J*der(w) = u - d*w;
end Rotor;
"""
    )
    flat, law = compile_model(file), find_effect("Rotational.CoulombFriction")
    made = extend_model(file, "Rotor", law, find_site(flat, "w", law), parameters={"d": -0.01, "J": 0.3})
    found = {p.name: (p.value, p.min) for p in made.flat.parameters}
    assert found["d"] == (-0.01, -0.01) and found["J"] == (0.3, 0.0)


AIR = """package Air "A gas, of which masses flow"
  connector Port Real p(unit = "Pa"); flow Real m(unit = "kg/s"); end Port;
  model Vessel Port port; parameter Real k(unit = "kg/Pa") = 6e-7; Real p(unit = "Pa", start = 4e5);
    equation port.p = p; k*der(p) = port.m; end Vessel;
  model Line Port a; Port b; parameter Real G(unit = "kg/(s.Pa)") = 1.5e-8;
    equation a.m = G*(a.p - b.p); a.m + b.m = 0; end Line;
  model Feed Port port; input Real m(unit = "kg/s"); equation port.m = -m; end Feed;
  model Rig input Real m(unit = "kg/s"); output Real p(unit = "Pa") = second.p;
    Vessel first, second; Line line; Feed feed(m = m);
    equation connect(feed.port, first.port); connect(first.port, line.a); connect(line.b, second.port);
  end Rig;
end Air;
"""


TANKS = """package Tanks "Open tanks, whose ports have a level"
  connector Port Real h(unit = "m"); flow Real q(unit = "m3/s"); end Port;
  model Tank Port port; parameter Real A(unit = "m2") = 0.02; Real h(unit = "m", start = 0.5);
    equation port.h = h; A*der(h) = port.q; end Tank;
  model Line Port a; Port b; parameter Real G(unit = "m2/s") = 1e-5;
    equation a.q = G*(a.h - b.h); a.q + b.q = 0; end Line;
  model Rig output Real h(unit = "m") = second.h; Tank first, second; Line line;
    equation connect(first.port, line.a); connect(line.b, second.port);
  end Rig;
end Tanks;
"""


@pytest.mark.parametrize(
    ("text", "effect", "place", "units"),
    [
        (AIR, "Hydraulic.Leak", "second.port", {"G": "kg/(s.Pa)"}),
        (AIR, "Hydraulic.Orifice", "line.a", {"k": "Pa.s2/kg2", "q_s": "kg/s"}),
        (AIR, "Hydraulic.TurbulentLine", "line", {"k": "kg/s", "p_1": "Pa", "p_s": "Pa"}),
        (TANKS, "Hydraulic.FreeOutlet", "second.port", {"k": "m3/s", "p_0": "m", "p_1": "m", "p_s": "m"}),
        (TANKS, "Hydraulic.Overflow", "second.port", {"k": "m3/(s.m)", "p_max": "m", "p_s": "m"}),
        (TANKS, "Hydraulic.LaminarLine", "line", {"G": "m3/(s.m)"}),
        (AIR, "Hydraulic.LaminarGasLine", "line", {"b": "kg/(s.Pa2)"}),
    ],
)
def test_laws_of_flows_are_those_of_what_ports_carry(tmp_path, text, effect, place, units):
    """Of masses where these flow, and of levels in place of pressures."""
    rig = "Air.Rig" if text is AIR else "Tanks.Rig"
    file = tmp_path / "Rig.mo"
    file.write_text(text)
    flat, law = compile_model(file, rig), find_effect(effect)
    site = find_site(flat, place, law)
    assert units_at(flat, law, site) == units
    made = extend_model(file, rig, law, site, name="law", values={p.name: 1e-9 for p in law.sizes})
    written = {p.name: p.unit for p in made.flat.parameters if p.name.startswith("law.")}
    assert written == {f"law.{name}": unit for name, unit in units.items()}
    attached = attach(flat, law, site, name="law", values={p.name: 1e-9 for p in law.sizes})
    assert {p.name: p.unit for p in attached.parameters if p.name in written} == written


def test_free_outlet_empties_a_tank_by_the_root_of_its_level(tmp_path):
    """dh/dt = -k/A*sqrt(h) where nothing else flows: the root of h falls by k/(2 A) a second."""
    file = tmp_path / "Tanks.mo"
    file.write_text(TANKS.replace("= 1e-5", "= 0"))
    flat, law = compile_model(file, "Tanks.Rig"), find_effect("Hydraulic.FreeOutlet")
    sizes = {"k": 5e-5, "p_0": 0.0, "p_s": 1e-6}
    made = extend_model(file, "Tanks.Rig", law, find_site(flat, "second.port", law), values=sizes)
    time = np.linspace(0.0, 200.0, 11)
    left = simulate(made.flat, (time, np.zeros((11, 0)))).outputs[:, 0]
    np.testing.assert_allclose(left, (np.sqrt(0.5) - 5e-5 / 0.04 * time) ** 2, rtol=1e-4)


def test_leak_empties_a_vessel_of_gas(tmp_path):
    """dp/dt = -G*p/k where nothing else flows."""
    file = tmp_path / "Air.mo"
    file.write_text(AIR.replace("= 1.5e-8", "= 0"))
    flat, law = compile_model(file, "Air.Rig"), find_effect("Hydraulic.Leak")
    made = extend_model(file, "Air.Rig", law, find_site(flat, "second.port", law), values={"G": 1.2e-9})
    left = simulate(made.flat, (np.linspace(0.0, 100.0, 11), np.zeros((11, 1)))).outputs[:, 0]
    np.testing.assert_allclose(left, 4e5 * np.exp(-1.2e-9 / 6e-7 * np.linspace(0.0, 100.0, 11)), rtol=1e-6)


@pytest.mark.parametrize(
    ("potential", "flow", "is_gas"),
    [
        ("Pa", "kg/s", True),
        ("mbar", "mbar.l/s", True),
        ("Pa", "m3/s", False),
        ("bar", "l/min", False),
        ("m", "m3/s", False),
    ],
)
def test_a_law_of_a_gas_fits_where_masses_flow_and_not_where_volumes_do(tmp_path, potential, flow, is_gas):
    text = re.sub(r"\bm\b", "q", AIR).replace("kg/s", flow).replace('"Pa"', f'"{potential}"')
    file = tmp_path / "Air.mo"
    file.write_text(text)
    places = sites(compile_model(file, "Air.Rig"))
    fitting = [
        [site.name for site in places if fits(find_effect(f"Hydraulic.{law}"), site)]
        for law in ("LaminarLine", "LaminarGasLine")
    ]
    assert fitting == [["line"], ["line"] if is_gas else []]


def test_gas_flows_through_a_capillary_by_the_squares_of_the_pressures(tmp_path):
    """Beside a line of conductance G, the sum S of the pressures of two vessels stays, and their difference
    falls as exp(-2 (G + b S) t/k)."""
    file = tmp_path / "Air.mo"
    file.write_text(AIR.replace("first, second", "first(p(start = 6e5)), second(p(start = 2e5))"))
    flat, law = compile_model(file, "Air.Rig"), find_effect("Hydraulic.LaminarGasLine")
    site = find_site(flat, "line", law)
    made = extend_model(file, "Air.Rig", law, site, values={"b": 1e-14}).flat
    time = np.linspace(0.0, 60.0, 11)
    expected = 4e5 - 2e5 * np.exp(-2 * (1.5e-8 + 1e-14 * 8e5) / 6e-7 * time)
    for model in (made, attach(flat, law, site, values={"b": 1e-14})):
        right = simulate(model, (time, np.zeros((11, 1)))).outputs[:, 0]
        np.testing.assert_allclose(right, expected, rtol=1e-5)


@pytest.mark.parametrize(("text", "is_gas"), [(AIR, True), (TANKS, False)])
def test_a_pair_that_is_named_and_not_listed_may_carry_a_gas_as_well(tmp_path, text, is_gas):
    file, ends = tmp_path / "Rig.mo", "feed.port, second.port" if is_gas else "first.port, line.b"
    file.write_text(text)
    flat, law = compile_model(file, "Air.Rig" if is_gas else "Tanks.Rig"), "Hydraulic.LaminarGasLine"
    assert ends not in [site.name for site in sites(flat)]
    named = find_site(flat, ends, find_effect("Hydraulic.LaminarLine"))
    assert named.kind == "pair" and fits(find_effect(law), named) == is_gas
