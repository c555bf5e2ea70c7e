"""Where effects can sit: nodes, components, cuts and signals, in models of any library."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from effect_rig import MODELS, characteristic, finite_poles, rig, rig_sites

from daest.errors import ModelError
from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.balances import balances
from daest.modelica.places.sites import find_site, fits, number_of, sites

SERVO = Path(__file__).resolve().parents[2] / "examples" / "servo" / "Servo.mo"


@cache
def machine():
    return compile_model(MODELS / "Own.mo", "Machine")


def names(found, kind: str) -> set[str]:
    return {site.name for site in found if site.kind == kind}


def test_nodes_are_bodies_and_what_lies_between() -> None:
    found = sites(compile_model(SERVO))
    mechanical = {s.name for s in found if s.kind == "node" and s.domain == "rotational"}
    assert mechanical == {"motor.flange_a", "gear.flange_b", "disc.flange_a"}
    motor = next(s for s in found if s.name == "motor.flange_a" and s.kind == "node")
    assert {"emf.flange", "motor.flange_b", "gear.flange_a"} <= set(motor.aliases)
    assert "motor" in motor.aliases
    assert names(found, "input") == {"u"} and names(found, "output") == {"omega", "phi"}
    assert names(found, "component") == {"source", "resistor", "emf", "spring"}
    assert "d" in names(found, "parameter") and "disturbance.intensity" not in names(found, "parameter")


def test_held_and_idle_connectors() -> None:
    """No flow moves the ground, the wall or a reservoir, and a sensor carries none."""
    found = rig_sites()
    connectors = {c for s in found if s.kind == "node" for c in s.connectors}
    assert not connectors & {"ground.p", "wall.flange", "drain.port", "outside.port"}
    assert "sensor.flange" not in names(found, "connector")
    assert {"resistor.p", "source.p"} & names(found, "connector")
    pairs = {frozenset(s.connectors) for s in found if s.kind == "pair"}
    assert frozenset(("room.port", "window.port_b")) not in pairs  # the window joins them
    assert all(
        "tank" in s.name or "pump" in s.name for s in found if s.kind == "pair" and s.domain == "hydraulic"
    )


def test_a_rigid_gear_is_two_nodes_and_no_component() -> None:
    servo = compile_model(SERVO)
    assert "gear" not in names(sites(servo), "component")
    assert find_site(servo, "gear.flange_a").name != find_site(servo, "gear.flange_b").name


def test_connectors_of_ones_own_and_composites() -> None:
    found = sites(machine())
    nodes = {frozenset(s.connectors) for s in found if s.kind == "node"}
    assert nodes == {
        frozenset(("train.body.end_a", "train.twist.end_a")),
        frozenset(("train.twist.end_b", "train.out", "load.end_a")),
    }
    twist = next(s for s in found if s.kind == "component")
    assert (twist.name, twist.connectors) == ("train.twist", ("train.twist.end_a", "train.twist.end_b"))
    assert twist.given == {"k": "train.twist.k"}


def test_effects_act_in_composites_alike() -> None:
    """Extra inertia on either side of the composite's connector is inertia of the load; a flow sum inside of
    the composite has the opposite sign for its connector."""
    effect = find_effect("ExtraInertia")
    reference = compile_model(MODELS / "Own.mo", "Machine", overrides={"load.J": 1.2})
    expected = characteristic(reference)
    for name in ("train.out", "load.end_a", "train.twist.end_b"):
        site = find_site(machine(), name, effect)
        for connector in (name, *site.connectors):
            moved = type(site)(site.name, "node", site.domain, (connector,))
            flat = attach(machine(), effect, moved, values={"J": 0.5})
            assert characteristic(flat) == pytest.approx(expected, rel=1e-6)


def test_series_at_the_connector_of_a_composite() -> None:
    effect = find_effect("Rotational.ExtraCompliance")
    softer = compile_model(MODELS / "Own.mo", "Machine", overrides={"train.twist.k": 1 / (1 / 5 + 0.4)})
    expected = sorted(finite_poles(softer), key=abs)
    for name in ("train.out", "train.twist.end_a"):
        flat = attach(machine(), effect, find_site(machine(), name, effect), values={"e": 0.4, "T": 1e-9})
        found = sorted((p for p in finite_poles(flat) if abs(p) < 1e4), key=abs)
        assert found == pytest.approx(expected, abs=1e-5)


def test_fits_by_domain_and_kind() -> None:
    for effect in effect_library():
        for site in rig_sites():
            if fits(effect, site):
                assert effect.domain == site.domain
    backlash = find_effect("Rotational.Backlash")
    assert fits(backlash, find_site(rig(), "shaft"))
    damper = find_site(rig(), "damper")
    assert not fits(find_effect("Translational.Backlash"), damper)  # it has no stiffness
    assert fits(find_effect("Translational.HardeningSpring"), damper)
    assert not fits(find_effect("AbsoluteValueSensor"), find_site(rig(), "torque"))
    assert fits(find_effect("AbsoluteValueSensor"), find_site(rig(), "angle"))
    assert not fits(find_effect("Translational.Gravity"), damper)


def test_place_of_an_effect_in_series_may_be_a_component() -> None:
    effect = find_effect("BrushVoltageDrop")
    assert find_site(rig(), "resistor", effect).kind == "connector"
    assert find_site(rig(), "resistor.p", effect) == find_site(rig(), "source.p", effect)


@pytest.mark.parametrize(
    ("name", "effect", "code", "says"),
    [
        ("rotr", "Rotational.CoulombFriction", "effect-place", "Did you mean `rotor`"),
        ("rotr", None, "effect-place", "`rotor"),
        ("room", "Rotational.CoulombFriction", "effect-fit", "It fits at: `rotor.flange_a`"),
        ("rotor", "BrushVoltageDrop", "effect-fit", "a rotational node"),
        ("damper", "Translational.Backlash", "effect-fit", "which has no parameter c"),
        ("torque", "AbsoluteValueSensor", "effect-fit", "the input"),
        ("room, rotor.flange_a", "Conduction", "effect-place", "no place"),
    ],
)
def test_places_that_are_none(name, effect, code, says) -> None:
    with pytest.raises(ModelError) as caught:
        find_site(rig(), name, find_effect(effect) if effect else None)
    assert caught.value.code == code and says in str(caught.value)
    named = caught.value.remedy.split(": ")[-1].split(", ")
    assert len(named) == len(set(named))


BARE = """\
model Bare "A cart, a wheel and a room in bare equations"
  parameter Real m(unit = "kg") = 2 "Mass";
  parameter Real J(unit = "kg.m2") = 0.5 "Inertia";
  input Real F(unit = "N", start = 0) "Force";
  Real s(unit = "m", start = 0) "Position";
  Real v(unit = "m/s", start = 0) "Velocity";
  Real a(unit = "m/s2") "Acceleration";
  Real w(unit = "rad/s", start = 0) "Speed of the wheel";
  Real T(unit = "degC", start = 20) "Temperature";
  Real x(start = 0) "Something";
equation
  v = der(s);
  a = der(v);
  F - 40*s = m*a;
  J*der(w) = -0.1*w;
  1000*der(T) = 10*(5 - T);
  der(x) = -x;
end Bare;
"""


def bare(tmp_path):
    (tmp_path / "Bare.mo").write_text(BARE)
    return compile_model(tmp_path / "Bare.mo")


def test_balances_of_bare_equations(tmp_path) -> None:
    flat = bare(tmp_path)
    found = {s.name: (s.domain, s.aliases[0]) for s in sites(flat) if s.kind == "equation"}
    assert found == {
        "2:v": ("translational", "F - 40*s = m*a"),
        "3:w": ("rotational", "J*der(w) = -0.1*w"),
        "4:T": ("thermal", "1000*der(T) = 10*(5 - T)"),
    }
    # Without a unit the effect tells what the variable means.
    assert find_site(flat, "5:x", find_effect("Rotational.ViscousFriction")).domain == "rotational"
    with pytest.raises(ModelError) as caught:
        find_site(flat, "3:v", find_effect("Rotational.ViscousFriction"))
    assert caught.value.code == "effect-place" and "3:w" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "place", "values", "poles"),
    [
        ("Translational.ViscousFriction", "2:v", {"d": 4.0}, np.roots([2, 4, 40])),
        ("Translational.LearnedSpring", "2:v", {}, np.roots([2, 0, 40])),
        ("Rotational.ViscousFriction", "3:w", {"d": 0.3}, [-0.4 / 0.5]),
        ("Translational.ExtraMass", "2:v", {"m": 3.0}, np.roots([5, 0, 40])),
    ],
)
def test_term_of_a_bare_equation_has_the_sign_of_nature(tmp_path, name, place, values, poles) -> None:
    flat, effect = bare(tmp_path), find_effect(name)
    made = attach(flat, effect, find_site(flat, place, effect), values=values)
    for pole in poles:
        assert np.abs(finite_poles(made) - pole).min() < 1e-7
    with pytest.raises(ModelError) as caught:
        attach(made, effect, find_site(made, place, effect))
    assert caught.value.code == "effect-present"


def test_a_load_is_no_definition_of_a_rate() -> None:
    text = b"""model Ball
      Real s(unit = "m"), v(unit = "m/s"), load;
    equation
      der(s) = v;
      der(v) = load;
      der(load) = -load;
    end Ball;"""
    flat = compile_text(text, Path("Ball.mo"))
    assert {b.name(flat) for b in balances(flat)}.isdisjoint({"1:v", "0:s"})  # load may well be the rate of v
    from_outside = replace(flat.equations[2], origin="load")
    flat = replace(flat, equations=(*flat.equations[:2], from_outside))
    assert "1:v" in {b.name(flat) for b in balances(flat)}


def test_a_speed_in_a_balance_is_no_rate_of_its_position() -> None:
    text = b"""model Cylinder
      parameter Real A(unit = "m2") = 1e-3, C(unit = "m3/Pa") = 2e-12;
      input Real q(unit = "m3/s");
      Real s(unit = "m"), v(unit = "m/s"), p(unit = "Pa");
    equation
      der(s) = v;
      40*der(v) = A*p - 300*v;
      C*der(p) = q - A*v;
    end Cylinder;"""
    flat = compile_text(text, Path("Cylinder.mo"))
    found = {site.name: site.domain for site in sites(flat) if site.kind == "equation"}
    assert found == {"1:v": "translational", "2:p": "hydraulic"}


def test_of_several_rates_in_a_row_those_of_its_unit_are_balanced() -> None:
    text = b"""model Balance
      parameter Real m(unit = "kg") = 0.2, l(unit = "m") = 0.3;
      input Real F(unit = "N");
      Real s(unit = "m"), v(unit = "m/s"), a(unit = "rad"), w(unit = "rad/s");
    equation
      der(s) = v;
      der(a) = w;
      5*m*der(v) + m*l*cos(a)*der(w) = F + m*l*w^2*sin(a);
      m*l*cos(a)*der(v) + m*l^2*der(w) = m*9.81*l*sin(a);
    end Balance;"""
    found = [site.name for site in sites(compile_text(text, Path("Balance.mo"))) if site.kind == "equation"]
    assert found == ["2:v", "3:w"]


def test_an_acceleration_with_a_name_is_a_rate_beside_others() -> None:
    """A trolley whose balance holds its own acceleration by name and the one of its load by `der`."""
    text = """model Crane
      parameter Real mt(unit = "kg") = 6, ml(unit = "kg") = 2, l(unit = "m") = 0.8;
      input Real F(unit = "N");
      Real v(unit = "m/s"); Real w(unit = "rad/s"); Real th(unit = "rad"); Real a(unit = "m/s2");
      output Real y = v;
    equation
      der(v) = a; der(th) = w;
      (mt + ml)*a + ml*l*der(w)*cos(th) - ml*l*w^2*sin(th) = F;
      ml*l^2*der(w) + ml*l*a*cos(th) + ml*9.81*l*sin(th) = 0;
    end Crane;"""
    found = sites(compile_text(text.encode(), Path("Crane.mo")))
    assert [(s.name, s.domain) for s in found if s.kind == "equation"] == [
        ("2:v", "translational"),
        ("3:w", "rotational"),
    ]


def test_heat_of_a_bare_equation_in_celsius(tmp_path) -> None:
    flat, effect = bare(tmp_path), find_effect("ConstantHeatGain")
    made = attach(flat, effect, find_site(flat, "4:T", effect), name="gain")
    texts = {e.text for e in made.equations}
    assert {"1000*der(T) + gain.port.Q_flow = 10*(5 - T)", "gain.port.T = T + 273.15"} <= texts


def test_model_without_places() -> None:
    text = (
        b"model Lag input Real u(start = 0); output Real y; Real x; equation der(x) = u - x; y = x; end Lag;"
    )
    flat = compile_text(text, Path("Lag.mo"))
    assert {s.kind for s in sites(flat)} == {"input", "output"}
    with pytest.raises(ModelError, match="fit"):
        find_site(flat, "u", find_effect("Rotational.CoulombFriction"))


COUPLED = """model Arm "Two links, whose inertias are coupled"
  parameter Real a(unit = "kg.m2") = 0.4;
  parameter Real b(unit = "kg.m2") = 0.1;
  input Real t1(unit = "N.m");
  input Real t2(unit = "N.m");
  output Real y(unit = "rad") = q2;
  Real q1(unit = "rad"), q2(unit = "rad"), w1(unit = "rad/s"), w2(unit = "rad/s");
equation
  der(q1) = w1;
  der(q2) = w2;
  a*der(w1) + b*cos(q2)*der(w2) = t1;
  b*cos(q2)*der(w1) + b*der(w2) = t2;
end Arm;
"""


def test_a_rate_that_another_equation_needs_is_balanced_there_alone() -> None:
    """An arm that its pendulum does not move, and the pendulum that the arm moves."""
    text = COUPLED.replace(" + b*cos(q2)*der(w2) = t1", " = t1").encode()
    found = [site.name for site in sites(compile_text(text, Path("Arm.mo"))) if site.kind == "equation"]
    assert found == ["2:w1", "3:w2"]
    both = [site.name for site in sites(compile_text(COUPLED.encode(), Path("Arm.mo")))]
    assert {"2:w1", "2:w2", "3:w1", "3:w2"} <= set(both)


def test_an_effect_in_one_of_coupled_equations_does_not_move_the_next_one(tmp_path) -> None:
    """Both equations hold the rates of both speeds, and get other rows when an effect is put in."""
    (tmp_path / "Arm.mo").write_text(COUPLED)
    flat = compile_model(tmp_path / "Arm.mo")
    effect = find_effect("Rotational.CoulombFriction")
    first, second = (find_site(flat, name, effect) for name in ("2:w1", "3:w2"))
    made = extend_model(tmp_path / "Arm.mo", "Arm", effect, first)
    numbers = [number_of(flat, site, effect) for site in (first, second)]
    assert numbers == [0, 1]
    found = [find_site(made.flat, "3:w2", effect, number) for number in numbers]
    assert [site.aliases[0].endswith(end) for site, end in zip(found, ("= t1", "= t2"), strict=True)] == [
        True
    ] * 2


READING = """model Reading
  input Real force(unit = "N"); output Real acc; output Real v(unit = "m/s", start = 0);
equation
  2*der(v) = force - 3*v;
  acc = der(v)/9.81;
end Reading;
"""
INVERSE = """model Inverse
  input Real v(unit = "m/s"); output Real force(unit = "N");
  Real w(unit = "m/s");
equation
  w = v;
  force = 2*der(w) + 3*w;
end Inverse;
"""


@pytest.mark.parametrize(("text", "known"), [(READING, ["0:v"]), (INVERSE, ["1:w"])])
def test_a_reading_of_a_rate_that_another_equation_balances_is_no_place(text, known):
    """Friction had a place in an accelerometer, too."""
    flat = compile_text(text.encode(), Path("Model.mo"))
    assert [site.name for site in sites(flat) if site.kind == "equation"] == known
