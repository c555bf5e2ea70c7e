"""Scores: normal when nothing is missing, right derivatives, and the hidden effect on top."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import (
    DAMPING,
    INERTIA,
    NOISE,
    PERIOD,
    SENSOR,
    library,
    model,
    quiet,
    rotor_null,
    rotor_record,
    rubbing,
    some_effects,
)
from scipy.stats import kstest, norm

from daest.diagnosis.answers.verdict import two_alike
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import loads_of
from daest.diagnosis.null_model.null_observer import _followed, run_null
from daest.diagnosis.screening import candidates as candidates_module
from daest.diagnosis.screening import screen as screening
from daest.diagnosis.screening.candidates import attachable, attached, in_shapes, pairs, with_shapes
from daest.diagnosis.screening.responses import _responses, nuisance, size_names
from daest.diagnosis.screening.scores import DRAWS, TAIL, _p_value, projected, promising_pairs
from daest.diagnosis.screening.screen import (
    _in_one_model,
    _in_own_components,
    _without_sums,
    already_there,
    screen,
)
from daest.diagnosis.screening.size_slopes import sizes_of
from daest.errors import EstimationError, ModelError
from daest.model.diagnosis import Screen, Screened
from daest.modelica.effects.attach import attach
from daest.modelica.places.sites import sites
from daest.systems.events.integration import Correction
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator

EFFECTS = (
    "CoulombFriction",
    "QuadraticDrag",
    "Unbalance",
    "ConstantLoad",
    "Gain",
    "Drift",
    "ViscousFriction",
)


def candidates(*names):
    return pairs(some_effects(*names), sites(model()))


@cache
def true_null():
    """The null with the rotor's own values and noises: white torque as a load of two sampling periods."""
    null, _ = quiet()
    T = 2 * PERIOD
    values = {"J": INERTIA, "d": DAMPING, "load_1.T": T}
    parameters = tuple(replace(p, value=values.get(p.name, p.value)) for p in null.flat.parameters)
    noises = tuple(replace(n, value=NOISE / T**2 if n.kind == "process" else SENSOR) for n in null.fit.noises)
    fit = replace(null.fit, noises=noises, theta={**null.fit.theta, **values})
    flat = replace(null.flat, parameters=parameters)
    return replace(null, flat=flat, explicit=reduce_index(flat), fit=fit, loads=loads_of(fit, null.places))


def screened(record):
    """The screen at the true values: no fit of its own."""
    null = replace(true_null(), experiments=(record,))
    return screen(null, run_null(null), candidates(*EFFECTS))


@pytest.mark.slow
@pytest.mark.parametrize("n_records", [6, 150])
def test_scores_are_standard_normal_when_nothing_is_missing(n_records):
    found = [screened(rotor_record(500, seed=100 + seed)[0]) for seed in range(n_records)]
    signed = ("ConstantLoad at rotor.flange_a", "Drift at u", "Drift at phi")
    squares = np.array([[e.score**2 for e in s.entries if e.candidate.label in signed] for s in found])
    assert squares.shape == (n_records, len(signed))
    # Squares of a standard normal variable have mean 1 and standard deviation √2; means of the three count as
    # one, since they may be alike.
    assert abs(squares.mean() - 1.0) < 3.0 * np.sqrt(2.0 / n_records)
    p_values = [s.p_value for s in found]
    assert kstest(p_values, "uniform").pvalue > 0.01
    assert np.mean(np.array(p_values) < 0.05) < 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / n_records)


def test_gain_of_a_sensor_is_not_found_where_it_is_right():
    """The innovation of a sample must not enter its own response."""
    scores = [
        next(
            e.score
            for e in screened(rotor_record(500, seed=200 + seed)[0]).entries
            if e.candidate.label == "Gain at phi"
        )
        for seed in range(2)
    ]
    assert np.max(scores) < 3.5


@pytest.mark.slow  # test_absorbed.py
def test_viscous_friction_is_absorbed_by_the_parameter():
    null, run = quiet()
    found = screen(null, run, candidates("ViscousFriction"))
    assert all(e.absorbed and e.score == 0.0 and e.p_value == 1.0 for e in found.entries)


def test_coulomb_friction_comes_first():
    stand = rubbing()
    found = screen(stand.null, run_null(stand.null), pairs(library(), sites(model())))
    best = [e for e in found.entries if e.score > found.entries[0].score - 0.5]
    assert "CoulombFriction" in {e.candidate.effect.name for e in best}
    assert found.p_value < 1e-6
    coulomb = next(e for e in found.entries if e.candidate.effect.name == "CoulombFriction")
    assert coulomb.sizes[0] == pytest.approx(0.15, rel=0.3)
    assert found.n_screened > 50


def test_all_shapes_in_one_model_do_what_components_of_their_own_do():
    null, run = quiet()
    one, filtered = null.experiments[0], run.observed[0].filtered
    states = dict(zip(run.state_names, filtered.T, strict=True))
    usable, _, explicit = attachable(null.flat, candidates("Unbalance", "StribeckFriction", "Gain"))
    shaped = in_shapes(null.flat, usable, explicit, one.time, states, one.inputs)
    shown = [(c, shape) for c, shapes in zip(usable, shaped, strict=True) for shape in shapes]
    assert len(shown) > len(usable)
    together = _in_one_model(null, run, explicit, shown)
    apart = _in_own_components(null, run, [shape for _, shape in shown])
    assert together.candidates == apart.candidates
    assert together.responses == pytest.approx(apart.responses, rel=1e-9, abs=1e-9)


def test_responses_are_derivatives_of_the_predictor():
    """Against finite differences of the predictor with the effect at a small size, gain held."""
    null, run = quiet()
    shaped, _ = with_shapes(
        null.flat,
        candidates("Unbalance", "QuadraticDrag", "Gain", "ConstantLoad", "LuGreFriction"),
        null.experiments[0].time,
        dict(zip(run.state_names, run.observed[0].filtered.T, strict=True)),
        null.experiments[0].inputs,
    )
    chosen = {c.label: c for c in shaped if c.effect.name != "Unbalance" or c.shape["phi_0"] == 0.0}
    usable, _, explicit = attachable(null.flat, tuple(chosen.values()))
    names = [name for c in usable for name in size_names(c)]
    responses = _responses(null, run, explicit, sizes_of(explicit, names))
    ends = np.cumsum([0, *(len(c.effect.sizes) for c in usable)])
    rows = [slice(begin, end) for begin, end in pairwise(ends.tolist())]
    one = null.experiments[0]
    start = null.initial_states[0]
    x0 = np.array([start.get(name, 0.0) for name in explicit.state_names])
    gain = np.zeros((x0.size, run.gain.shape[1]))
    for i, name in enumerate(explicit.state_names):
        if name in run.state_names:  # others are those of the effects, which no sensor corrects
            gain[i] = run.gain[run.state_names.index(name)]
    grown = reduce_index(explicit.flat)
    names = [p.name for p in grown.flat.parameters]

    def predicted(candidate, size):
        theta = grown.flat.theta_values.copy()
        theta[names.index(f"{candidate.name}.{candidate.effect.sizes[0].name}")] += size
        return integrate(
            integrator(grown), one.time, one.inputs, theta, x0,
            hold="zoh", correction=Correction(one.outputs, gain), rtol=1e-9,
        ).outputs  # fmt: skip

    assert "LuGreFriction" in {c.effect.name for c in usable}
    for candidate, row in zip(usable, rows, strict=True):
        step = 1e-5
        slope = (predicted(candidate, step) - predicted(candidate, -step)) / (2 * step)
        exact = (slope @ run.root.T).ravel()
        found = responses[row.start]
        # Effects are held over a sample, which is all that differs.
        assert np.linalg.norm(found - exact) < 0.1 * np.linalg.norm(exact), candidate.label


def test_loops_of_effects_are_written_out_to_the_first_order_where_all_vanish():
    null, _ = quiet()
    chosen, _, at_null = attachable(null.flat, candidates("LoadDependentFriction", "CoulombFriction"))
    whole = reduce_index(attached(null.flat, chosen))
    assert at_null.is_symbolic and not whole.is_symbolic
    assert at_null.state_names == whole.state_names
    names = [p.name for p in whole.flat.parameters]
    sizes = [names.index(name) for c in chosen for name in size_names(c)]
    x = np.random.default_rng(0).normal(size=whole.n_states)
    point = (x, [0.3], np.zeros(whole.rhs.numel_in(2)), np.zeros(whole.rhs.numel_in(3)))
    point = (*point, whole.flat.theta_values, 0.0)
    for name in ("rhs", "outputs", "variables"):
        exact, found = getattr(whole, name), getattr(at_null, name)
        np.testing.assert_allclose(found(*point).full(), exact(*point).full(), rtol=1e-9, atol=1e-12)
        slopes = [f.jacobian()(*point, f(*point))[4].full()[:, sizes] for f in (found, exact)]
        assert np.any(slopes[1]) or name == "outputs"
        np.testing.assert_allclose(*slopes, rtol=1e-9, atol=1e-12)


def test_projection_leaves_nothing_of_the_parameters():
    null, run = quiet()
    directions = nuisance(run, len(null.estimated))
    rest, share = projected(directions, directions)
    assert np.max(share[np.linalg.norm(directions, axis=1) > 0.0]) < 1e-5
    white = np.random.default_rng(0).standard_normal((1, directions.shape[1]))
    rest, _ = projected(white, directions)
    scaled = directions / np.linalg.norm(directions, axis=1)[:, None]
    assert np.max(np.abs(scaled @ rest[0])) < 1e-5


def entry_of(candidate, score, size):
    return Screened(candidate, score, (size,), 0.5, False, 1.0, size_error=abs(size) / score)


def test_two_effects_that_say_little_alone_and_much_together_are_a_pair():
    drag, friction, gain = (candidates(n)[0] for n in ("QuadraticDrag", "CoulombFriction", "Gain"))
    rho = np.array([[1.0, -0.9, 0.1], [-0.9, 1.0, 0.0], [0.1, 0.0, 1.0]])
    # Two opposed responses hide each other.
    hidden = Screen(
        (entry_of(drag, 4.0, 1.0), entry_of(friction, 3.0, 1.0), entry_of(gain, 1.0, 2.0)), rho, 1.0, 3, ()
    )
    ((one, other),) = promising_pairs(hidden)
    assert (one.candidate, other.candidate) == (drag, friction)
    # The joint statistic by linear algebra.
    z = np.array([4.0, 3.0])
    assert 0.5 * (z @ np.linalg.inv(rho[:2, :2]) @ z - 16.0) > GATES.min_bic_gain
    # Of two that hide each other, the sizes are those beside each other.
    assert [one.sizes[0], other.sizes[0]] == pytest.approx(np.linalg.inv(rho[:2, :2]) @ z * [1 / 4, 1 / 3])
    # Nothing is said of two that are not alike; of one effect at two places, both are named.
    assert two_alike(hidden) == ""
    elsewhere = replace(drag, site=replace(drag.site, name="elsewhere"))
    alike = replace(hidden, entries=(hidden.entries[0], entry_of(elsewhere, 3.0, 1.0), hidden.entries[2]))
    assert drag.label in two_alike(alike) and "elsewhere" in two_alike(alike)
    # The input and the output of what lies between are no parts that are alike.
    behind = replace(drag, site=replace(elsewhere.site, kind="output"))
    assert (
        two_alike(replace(alike, entries=(alike.entries[0], entry_of(behind, 3.0, 1.0), *alike.entries[2:])))
        == ""
    )
    # Friction that would have to drive has no score alone; what it says against it counts beside the other.
    braking = replace(entry_of(friction, 4.0, -1.0), score=0.0)
    against = replace(hidden, entries=(hidden.entries[0], braking, hidden.entries[2]))
    assert promising_pairs(against) == []
    # Friction that drives is none, and what is the same is no pair.
    opposed = replace(hidden, entries=(hidden.entries[0], entry_of(friction, 3.0, -1.0), hidden.entries[2]))
    assert promising_pairs(opposed) == []
    same = replace(hidden, correlation=np.where(np.eye(3) == 1.0, 1.0, 0.99 * np.sign(rho)))
    assert promising_pairs(same) == []
    weak = replace(hidden, correlation=np.eye(3))
    assert promising_pairs(weak) == []
    absorbed = replace(hidden, entries=tuple(replace(e, absorbed=True) for e in hidden.entries))
    assert promising_pairs(absorbed) == []
    # One effect with two shapes, which a model holds once, does not come before two effects.
    other_shape = replace(drag, shape={"speed": 1.0})
    twice = np.array(
        [[1.0, -0.95, -0.9, 0.0], [-0.95, 1.0, 0.9, 0.0], [-0.9, 0.9, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    )
    shapes = (*hidden.entries[:1], entry_of(other_shape, 4.0, 1.0), *hidden.entries[1:])
    first, *_ = promising_pairs(Screen(shapes, twice, 1.0, 4, ()))
    assert {entry.candidate.effect.name for entry in first} == {"QuadraticDrag", "CoulombFriction"}


def test_no_candidate_is_an_error():
    null, run = quiet()
    with pytest.raises(EstimationError) as caught:
        screen(null, run, ())
    assert caught.value.code == "diagnose-no-candidate"


def test_law_that_the_model_estimates_already_is_not_looked_for_again():
    null = true_null()
    (first, *_) = candidates("CoulombFriction")
    flat = attach(null.flat, first.effect, first.site, "rubs")
    held = replace(null, flat=flat)
    assert set(already_there(held, [first])) == {""}  # its values are given: others may be right
    size = replace(null.fit.parameters[0], name="rubs.tau_c")
    fitted = replace(held, fit=replace(null.fit, parameters=(*null.fit.parameters, size)))
    assert already_there(fitted, [first]) == ["the model contains it already: `rubs`"]


@pytest.mark.parametrize("how", ["contained", "absorbed"])
def test_friction_in_one_direction_is_dry_friction_beside_a_constant_load(how):
    null, run = quiet()
    names = ("CoulombFriction", "AsymmetricFriction", "ConstantLoad")
    found = screen(null, run, candidates(*names))
    assert {e.candidate.effect.name for e in found.entries} == set(names)  # no constant in the model
    loads = {e.candidate.label for e in found.entries if e.candidate.effect.name == "ConstantLoad"}
    if how == "absorbed":
        entries = tuple(replace(e, absorbed=e.candidate.label in loads) for e in found.entries)
        found, loads = replace(found, entries=entries), set()
    kept = _without_sums(found, loads)
    assert {e.candidate.effect.name for e in kept.entries} == {"CoulombFriction", "ConstantLoad"}
    assert kept.correlation.shape == (len(kept.entries),) * 2
    assert any("the same as CoulombFriction" in reason for _, reason in kept.skipped)


def test_friction_in_the_one_direction_in_which_a_rotor_turns_is_dry_friction():
    record, _ = rotor_record(400, seed=3, drive=lambda u: abs(u) + 0.5, coulomb=lambda phi: 0.1)
    null, run = rotor_null(replace(record, inputs=np.abs(record.inputs) + 0.5))
    found = screen(null, run, candidates("CoulombFriction", "AsymmetricFriction"))
    assert {e.candidate.effect.name for e in found.entries} == {"CoulombFriction"}
    assert any("AsymmetricFriction" in label and "do not tell" in reason for label, reason in found.skipped)


@pytest.mark.parametrize("alike", [1.0, 0.9])
def test_damping_in_the_one_direction_of_all_motion_is_viscous_friction(alike):
    found = screen(*quiet(), candidates("ViscousFriction", "AsymmetricDamper"))
    names = {e.candidate.effect.name for e in found.entries}
    kept = _without_sums(replace(found, correlation=np.full_like(found.correlation, alike)), set())
    expected = names if alike < 1.0 else {"ViscousFriction"}
    assert {e.candidate.effect.name for e in kept.entries} == expected and len(names) == 2
    told = [reason for label, reason in kept.skipped if label.startswith("AsymmetricDamper")]
    assert all("do not tell it from ViscousFriction" in reason for reason in told)
    assert bool(told) == (alike == 1.0)


def test_effects_with_states_alone_leave_the_screen_empty():
    null, run = quiet()
    found = screen(null, run, candidates("Lag"))
    assert not found.entries and found.p_value == 1.0 and "order of the model" in found.skipped[0][1]


@pytest.mark.slow
def test_detectable_size_is_about_what_is_found():
    """A friction of twice the detectable size is found in a new record; p-values are of the whole search."""
    null, run = quiet()
    entry = next(
        e
        for e in screen(null, run, candidates(*EFFECTS)).entries
        if e.candidate.effect.name == "CoulombFriction"
    )
    record, _ = rotor_record(600, seed=7, coulomb=lambda phi: 2.0 * entry.detectable)
    rubbed, again = rotor_null(record)
    assert screen(rubbed, again, candidates(*EFFECTS)).p_value < 0.05


def test_gain_that_runs_away_is_shortened():
    null, run = quiet()
    starts = [np.array([state[name] for name in run.state_names]) for state in null.initial_states]
    follower = integrator(null.explicit, null.estimated)
    gain, _, errors = _followed(null, follower, starts, 40.0 * run.gain)
    shares = gain / run.gain
    assert np.allclose(shares, shares[0, 0])
    assert 0.0 < shares[0, 0] < 40.0
    assert np.all(np.abs(errors[0]) < GATES.observer_runaway * null.experiments[0].outputs.std(axis=0))
    assert _followed(null, follower, starts, run.gain)[0] is run.gain


def test_corrected_p_values_go_on_beyond_the_draws_as_those_of_the_largest_of_many_scores():
    n = 60
    draws = np.abs(np.random.default_rng(5).standard_normal((DRAWS, n)))
    largest = np.sort(draws.max(axis=1))
    for p in (1e-3, 1e-5, 1e-9):
        score = norm.isf(-np.expm1(np.log1p(-p) / n) / 2.0)
        assert _p_value(score, largest) == pytest.approx(p, rel=0.35)
    near = largest[-TAIL]
    assert _p_value(near + 1e-9, largest) == pytest.approx(_p_value(near - 1e-9, largest), rel=0.02)
    assert _p_value(60.0, largest) == 0.0 and _p_value(0.0, np.zeros(DRAWS)) == 1.0


def test_candidates_that_cannot_stand_beside_each_other_are_told_apart(monkeypatch):
    """Each of two leaves a model that can be solved, both do not: the first one stays."""
    flat = model()
    chosen = pairs(some_effects("CoulombFriction", "QuadraticDrag"), sites(flat))[:4]
    solved = candidates_module.explicit_at_null

    def explicit(flat, kept):
        if chosen[1] in kept and chosen[3] in kept:
            raise ModelError("singular-after-reduction", "they depend on each other", remedy="-")
        return solved(flat, kept)

    monkeypatch.setattr(candidates_module, "explicit_at_null", explicit)
    kept, refused, _ = attachable(flat, chosen)
    assert kept == chosen[:3] and refused == ((chosen[3].label, "they depend on each other"),)


@pytest.mark.parametrize("n_possible", [2, 3])
def test_what_cannot_be_attached_beside_others_is_screened_in_a_further_model(monkeypatch, n_possible):
    """A capacity at a node where every branch has got an inductance, of which no voltage is free."""
    candidates = [SimpleNamespace(label=label) for label in "abc"]

    def responding(null, run, static, pool):
        first, *left = static
        kept = (first,) if first in candidates[:n_possible] else ()
        left = tuple(left if kept else static)
        refused = tuple((c.label, "depends on others") for c in left)
        return screening._Responding(kept, np.zeros((len(kept), 4)), refused, left)

    monkeypatch.setattr(screening, "_responding", responding)
    parts = screening._in_models(None, None, candidates, None)
    assert [c.label for part in parts for c in part.candidates] == list("abc"[:n_possible])
    assert [label for part in parts for label, _ in part.refused] == list("abc"[n_possible:])


def test_candidates_are_in_as_few_models_as_can_hold_them(monkeypatch):
    """A drop of voltage in every branch at a node leaves no place for a capacity there; some have none at
    all."""
    clashing = {"b": {"a"}, "c": set(), "d": {"a", "b", "c", "d"}}

    def attachable(flat, some):
        kept = []
        for one in some:
            if not clashing.get(one, set()) & {*kept, one}:
                kept.append(one)
        return tuple(kept), (), "+".join(kept)

    monkeypatch.setattr(candidates_module, "attachable", attachable)
    assert candidates_module.in_models(None, list("abcd")) == ((("a", "c"), "a+c"), (("b",), "b"))
