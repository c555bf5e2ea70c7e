"""Effects attached to compiled models: at their null they change nothing, elsewhere they act as closed forms
say."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from effect_rig import examples, finite_poles, first_places, label, placements, rig, rig_sites

from daest.errors import ModelError
from daest.model.effects import Placement
from daest.modelica.effects.attach import attach, attach_all
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.places.sites import find_site
from daest.systems.simulation.simulate import simulate

# Poles of the attached model and the nominal one, relative to the largest.
POLE_TOLERANCE = 1e-8


@cache
def nominal_poles() -> np.ndarray:
    return finite_poles(rig())


def placed(class_name: str, place: str, **values: float):
    effect = find_effect(class_name)
    return attach(rig(), effect, find_site(rig(), place, effect), name="x", values=values)


PLACES = [p for p in first_places() if p[0].attach != "parameter"]
EXAMPLES = examples(PLACES)
OTHERS = [p for p in PLACES if p not in EXAMPLES]


@pytest.mark.parametrize(
    ("effect", "site"),
    [*EXAMPLES, *(pytest.param(*p, marks=pytest.mark.slow) for p in OTHERS)],
    ids=label,
)
def test_null_is_the_nominal_model(effect, site) -> None:
    """Every nominal pole is one of the attached model; others belong to the effect's own states, or to a
    motion that its connector gives a name."""
    flat = attach(rig(), effect, site, values=effect.null_values)
    found, scale = finite_poles(flat), np.abs(nominal_poles()).max()
    rest = list(found)
    for pole in nominal_poles():
        nearest = min(rest, key=lambda p: abs(p - pole))
        assert abs(nearest - pole) < POLE_TOLERANCE * scale
        rest.remove(nearest)
    allowed = effect.n_states + (1 if effect.name == "ExtraCompliance" else 0)
    assert len(rest) <= allowed


@pytest.mark.parametrize(
    "name",
    [
        # One of each domain and kind; the others, which bend alike, among the slow tests.
        *("Rotational.CoulombFriction", "Rotational.Backlash", "Translational.EndStop"),
        *("Electrical.BrushVoltageDrop", "Thermal.Radiation", "Hydraulic.Overflow", "Hydraulic.Orifice"),
        *("Signals.DeadZone", "Signals.OneSidedLimit", "General.DriftingParameter"),
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in (
                "Rotational.LoadDependentFriction",
                "Rotational.LuGreFriction",
                "Hydraulic.Weir",
                "Hydraulic.Downpipe",
                "Signals.Saturation",
                "Signals.AbsoluteValueSensor",
                "Signals.QuadraticGain",
            )
        ),
    ],
)
def test_null_gives_the_nominal_response(name: str) -> None:
    effect = find_effect(name)
    site = next(s for e, s in placements() if e == effect)
    flat = attach(rig(), effect, site, values=effect.null_values)
    expected, got = nominal_response(), response(flat)
    scale = np.abs(expected).max(axis=0) + 1e-9
    assert np.abs((got - expected) / scale).max() < 1e-5  # of the integrators


@cache
def nominal_response() -> np.ndarray:
    return response(rig())


def response(flat) -> np.ndarray:
    """Outputs of the rig for a sine of the torque and a step of the voltage, (n_samples, 4)."""
    grid = np.arange(0, 3, 0.02)
    inputs = {"torque": np.sin(2 * grid), "voltage": np.where(grid > 0.5, 3.0, 0.0)}
    return simulate(flat, (grid, np.column_stack([inputs[x.name] for x in flat.inputs]))).outputs


def test_viscous_friction_moves_the_pole() -> None:
    """Both bodies free of each other: -d/J for the friction on one of them, see the trailer: (damper 3 +
    d)/4."""
    free = placed("Translational.ViscousFriction", "trailer", d=5.0)
    rows, m, c, damper, trailer = finite_poles(free), 2.0, 40.0, 3.0, 4.0
    # m s'' = -c s - D(s' - v), M v' = D (s' - v) - d v
    system = np.array(
        [[0, 1, 0], [-c / m, -damper / m, damper / m], [0, damper / trailer, -(damper + 5) / trailer]]
    )
    for pole in np.linalg.eigvals(system):
        assert np.abs(rows - pole).min() < 1e-8


def test_extra_inertia_adds_up() -> None:
    flat = placed("Rotational.ExtraInertia", "rotor", J=0.25)
    J1, J2, c, d = 0.75, 1.5, 8.0, 0.3
    reduced = J1 * J2 / (J1 + J2)
    for pole in np.roots([reduced, d, c]):
        assert np.abs(finite_poles(flat) - pole).min() < 1e-8


def test_inductance_in_series_adds_up() -> None:
    flat = placed("Electrical.Inductance", "resistor.n", L=0.3)
    assert np.abs(finite_poles(flat) - (-5.0 / (0.2 + 0.3))).min() < 1e-8


def test_compliance_in_series() -> None:
    """Rotor - compliance e with relaxation T - spring damper - load: springs in series."""
    flat = placed("Rotational.ExtraCompliance", "rotor.flange_b", e=0.05, T=1e-9)
    series = 1 / (1 / 8 + 0.05)
    slow = [p for p in finite_poles(flat) if abs(p) < 100 and p.imag > 0.5]
    reduced = 0.5 * 1.5 / 2
    assert any(abs(abs(p) - np.sqrt(series / reduced)) < 0.02 * abs(p) for p in slow)


def test_bridge_between_nodes_of_a_pair_and_leak() -> None:
    flat = placed("Thermal.Conduction", "room.port, outside.port", G=2.0)
    assert np.abs(finite_poles(flat) - (-(10 + 2.0) / 1000)).min() < 1e-10
    leak = placed("Hydraulic.Leak", "tank.outlet", G=5e-8)
    assert np.abs(finite_poles(leak) - (-(5e-8 + 5e-8) * 998 * 9.80665 / 0.01)).min() < 1e-9


def test_friction_across_a_component_acts_on_both_ends() -> None:
    flat = placed("Rotational.ViscousFriction", "shaft", d=1.0)
    reduced = 0.5 * 1.5 / 2
    for pole in np.roots([reduced, 0.3 + 1.0, 8.0]):
        assert np.abs(finite_poles(flat) - pole).min() < 1e-8


def test_signal_effects_scale_the_transfer() -> None:
    from daest.systems.linear.linearize import linearize
    from daest.systems.linear.split import split
    from daest.systems.linear.transfer import transfer_functions

    def gain(flat) -> float:
        dae = linearize(flat)
        ways = transfer_functions(dae, split(dae))
        way = next(w for w in ways if (w.input, w.output) == ("voltage", "current"))
        return float(way.num[-1] / way.den[-1])

    assert gain(rig()) == pytest.approx(1 / 5)
    assert gain(placed("Signals.Gain", "voltage", g=0.5)) == pytest.approx(1.5 / 5)
    assert gain(placed("Signals.Gain", "current", g=-0.5)) == pytest.approx(0.5 / 5)


def test_measured_input_is_a_new_input_or_a_present_one() -> None:
    effect = find_effect("Thermal.MeasuredHeatGain")
    site = find_site(rig(), "room", effect)
    flat = attach(rig(), effect, site, inputs={"u": "sun"})
    sun = flat.inputs[-1]
    assert (sun.name, sun.unit) == ("sun", "W/m2") and flat.u.numel() == 3
    again = attach(rig(), effect, site, inputs={"u": "voltage"})
    assert [x.name for x in again.inputs] == ["torque", "voltage"]
    assert "voltage = measuredHeatGain.u" in {e.text for e in again.equations}


def test_recorded_temperature_is_supplied_in_its_own_unit() -> None:
    """The column stays in degC, in the recording and in the model; the law takes what is absolute."""
    effect = find_effect("Thermal.MeasuredSurroundings")
    site = find_site(rig(), "room", effect)
    assert effect.input_units == ("K",)
    flat = attach(rig(), effect, site, inputs={"u": "T_next"}, input_units={"u": "degC"})
    assert (flat.inputs[-1].name, flat.inputs[-1].unit) == ("T_next", "degC")
    texts = {e.text for e in flat.equations}
    assert "T_next + 273.15 = measuredSurroundings.u" in texts
    # What does not convert is no unit for it.
    other = attach(rig(), effect, site, inputs={"u": "x"}, input_units={"u": "m"})
    assert other.inputs[-1].unit == "K" and "x = measuredSurroundings.u" in {e.text for e in other.equations}


def test_names_parameters_and_texts() -> None:
    flat = placed("Rotational.Backlash", "shaft", gap=0.02)
    names = [p.name for p in flat.parameters]
    assert "x.gap" in names and "x.c" not in names
    gap = flat.parameters[names.index("x.gap")]
    assert gap.value == 0.02 and gap.estimate and gap.min == 0 and gap.unit == "rad"
    given = {p.name: p.expression for p in flat.derived_parameters}
    assert given["x.c"] == "shaft.c" and given["x.d"] == "shaft.d"
    texts = {e.text for e in flat.equations}
    assert "x.x = x.phi_rel - x.phi_rel0" in texts
    assert "rotor.flange_b.tau + shaft.flange_a.tau + x.flange_a.tau = 0" in texts
    assert "rotor.flange_b.phi = x.flange_a.phi" in texts or "shaft.flange_a.phi = x.flange_a.phi" in texts
    assert len({x.name for x in flat.unknowns}) == flat.n
    assert flat.residual.numel() == flat.n == rig().n + 9


def test_several_effects_at_once_are_those_one_after_the_other() -> None:
    chosen = [
        find_effect(n) for n in ("Rotational.CoulombFriction", "Rotational.Backlash", "Electrical.Inductance")
    ]
    places = ["rotor", "shaft", "resistor.p"]
    one_by_one = rig()
    for effect, place in zip(chosen, places, strict=True):
        one_by_one = attach(one_by_one, effect, find_site(one_by_one, place, effect))
    at_once = attach_all(
        rig(), [Placement(e, find_site(rig(), p, e)) for e, p in zip(chosen, places, strict=True)]
    )
    assert [x.name for x in at_once.unknowns] == [x.name for x in one_by_one.unknowns]
    assert [e.text for e in at_once.equations] == [e.text for e in one_by_one.equations]
    point = np.random.default_rng(1).normal(size=2 * at_once.n)
    assert np.array_equal(residual_at(at_once, point), residual_at(one_by_one, point))


def residual_at(flat, point: np.ndarray) -> np.ndarray:
    arguments = [flat.xi, flat.derivatives, flat.u, flat.w, flat.theta, flat.time]
    evaluate = ca.Function("residual", arguments, [flat.residual])
    xi, derivatives = np.split(point, 2)
    values = [xi, derivatives, np.ones(flat.u.numel()), np.ones(flat.w.numel()), flat.theta_values, 0.3]
    return np.array(evaluate(*values).full()).ravel()


def test_everything_at_once_has_unique_names() -> None:
    several = [(e, s, "") for e, s in placements() if s.kind != "parameter"]
    flat = attach_all(rig(), several)
    assert len(several) > 100
    assert len({x.name for x in flat.unknowns}) == flat.n > rig().n + 500


# --- what is refused --------------------------------------------------------------------------------


def refusal(class_name: str, place: str, flat=None, **options) -> ModelError:
    effect, model = find_effect(class_name), flat or rig()
    with pytest.raises(ModelError) as caught:
        attach(model, effect, find_site(model, place, effect), **options)
    return caught.value


def test_the_same_effect_twice_is_refused() -> None:
    for name, place in [
        ("Rotational.CoulombFriction", "rotor"),
        ("Rotational.CoulombFriction", "shaft"),
        ("Rotational.Backlash", "shaft"),
        ("Electrical.BrushVoltageDrop", "resistor.n"),
        ("Signals.DeadZone", "torque"),
    ]:
        effect = find_effect(name)
        once = attach(rig(), effect, find_site(rig(), place, effect), name="x")
        problem = refusal(name, place, once)
        assert problem.code == "effect-present" and "`x`" in str(problem)
    # Another place, or another effect at the same place, is another matter.
    effect = find_effect("Rotational.CoulombFriction")
    twice = attach(once, effect, find_site(once, "rotor", effect))
    assert attach(twice, effect, find_site(twice, "load", effect)).n == twice.n + 6


def test_refusals() -> None:
    brush, node = find_effect("BrushVoltageDrop"), rig_sites()[0]
    wrong = next(s for s in rig_sites() if s.domain == "thermal")
    with pytest.raises(ModelError) as caught:
        attach(rig(), brush, wrong)
    assert caught.value.code == "effect-fit" and node.name
    assert refusal("Rotational.Unbalance", "load", values={"mg": 1}).code == "effect-parameter"
    assert "Did you mean `mgr`" in str(refusal("Rotational.Unbalance", "load", values={"mg": 1}))
    assert refusal("Rotational.Unbalance", "load", values={"mgr": -1}).code == "parameter-outside-bounds"
    assert refusal("Rotational.Unbalance", "load", name="shaft").code == "effect-name"
    assert refusal("Thermal.MeasuredHeatFlow", "room", inputs={"u": "room"}).code == "effect-name"


def test_library_is_used_up() -> None:
    """The rig has a place for every effect."""
    assert {e.class_name for e, _ in placements()} == {e.class_name for e in effect_library()}
