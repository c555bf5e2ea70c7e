"""Where effects can sit: nodes, components, cuts and signals, in models of any library."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from effect_rig import MODELS, characteristic, finite_poles, rig, rig_sites

from daest.errors import ModelError
from daest.modelica.attach import attach
from daest.modelica.compile import compile_model
from daest.modelica.effects import effect_library, find_effect
from daest.modelica.sites import find_site, fits, sites

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
    assert twist.parameters == ("k",)


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
        ("torque", "AbsoluteValueSensor", "effect-fit", "an input"),
        ("room, rotor.flange_a", "Conduction", "effect-place", "no place"),
    ],
)
def test_places_that_are_none(name, effect, code, says) -> None:
    with pytest.raises(ModelError) as caught:
        find_site(rig(), name, find_effect(effect) if effect else None)
    assert caught.value.code == code and says in str(caught.value)


def test_model_of_bare_equations_has_signals_only(tmp_path) -> None:
    file = tmp_path / "Lag.mo"
    file.write_text(
        "model Lag input Real u(start = 0); output Real y; Real x; equation der(x) = u - x; y = x; end Lag;"
    )
    flat = compile_model(file)
    assert {s.kind for s in sites(flat)} == {"input", "output"}
    with pytest.raises(ModelError, match="fit"):
        find_site(flat, "u", find_effect("Rotational.CoulombFriction"))
