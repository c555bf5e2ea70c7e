"""Rivals of a law: richer and simpler ones for the same."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import library, model, prove, rubbing, some_effects
from scipy.signal import lfilter

from daest.diagnosis.built_in.trials import Trial, prepare, trials
from daest.diagnosis.evidence.ranking import could_compete
from daest.diagnosis.evidence.rival_laws import may_be_of_the_kink
from daest.diagnosis.null_model.null import fit_null
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.refits.dynamic_fits import best_dynamic, best_simulation, dynamic_fits
from daest.diagnosis.refits.rivals import (
    alike_elsewhere,
    begun_by_the_other,
    from_other_sizes,
    kinked_elsewhere,
    laws_at_its_place,
    no_richer_ones,
    not_begun_by,
    other_bends,
    other_forms,
    own_law_elsewhere,
    reduced_laws,
    richer_laws,
    rounded,
    signal_laws,
    simpler_laws,
    simplest_first,
    told_from_places,
)
from daest.diagnosis.screening.candidates import pairs
from daest.diagnosis.screening.disturbance import place_gains, smoothed_load
from daest.diagnosis.screening.screen import screen
from daest.model.diagnosis import Screened
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.places.sites import sites
from daest.systems.simulation.simulate import simulate

LAWS = some_effects("CoulombFriction", "StribeckFriction", "QuadraticDrag", "Unbalance")


@cache
def proved(name):
    stand = rubbing()
    run = run_null(stand.null)
    found = screen(stand.null, run, pairs(LAWS, sites(model())))
    trial = next(t for t in trials(found, 1.0, 9) if t.candidate.effect.name == name)
    load = smoothed_load(stand.null, run, place_gains(stand.null, run))
    proof = prove(
        stand.null,
        stand.baseline,
        prepare(stand.null.flat, stand.null.estimated, trial),
        stand.null.experiments,
        stand.validation,
        run,
        load,
    )
    return found, run, proof


def test_other_laws_of_a_signal_are_tried_beside_the_best_one():
    """A dead zone of finite width may lead no screen, which sees it at no width at all."""
    _, _, proof = proved("CoulombFriction")
    bends = some_effects("QuadraticGain", "DeadZone", "Saturation", "Lag")
    entries = [
        Screened(candidate, 1.0, (0.1,), 0.5, False, 1.0)
        for candidate in pairs(bends, [site for site in sites(model()) if site.kind != "node"])
        if candidate.is_of_signal
    ]
    place = entries[0].candidate.site.name
    best = replace(
        proof,
        candidate=next(e.candidate for e in entries if e.candidate.effect.name == "QuadraticGain"),
    )
    found = signal_laws(best, SimpleNamespace(entries=entries), [best])
    here = [t.candidate for t in found if t.candidate.site.name == place]
    assert {c.effect.name for c in here} == {"DeadZone", "Saturation"}
    # Its own law for the other signals, of which a slow machine tells no difference.
    elsewhere = [t.candidate for t in found if t.candidate not in here]
    others = {e.candidate.site.name for e in entries if e.candidate.is_of_signal} - {place}
    assert others and {c.site.name for c in elsewhere} == others
    assert {c.effect.name for c in elsewhere} == {"QuadraticGain"}
    assert signal_laws(proof, SimpleNamespace(entries=entries), [proof]) == ()


def test_other_laws_are_tried_for_a_signal_that_a_likelier_one_turns_back():
    """A limit of a torque is nearest to a gain that falls with it, where that turns the torque back."""
    _, _, proof = proved("CoulombFriction")
    bends = some_effects("QuadraticGain", "DeadZone", "Saturation", "Lag", "CoulombFriction")
    entries = [
        Screened(candidate, 1.0, (0.1,), 0.5, False, 1.0) for candidate in pairs(bends, sites(model()))
    ]
    screen = SimpleNamespace(entries=entries)
    bend = next(e.candidate for e in entries if e.candidate.effect.name == "QuadraticGain")
    reason = "it turns its signal back beyond 2 (recorded to 4), as no gain does"
    accepted = replace(proof, verdict="supported", delta_bic=100.0)
    turned = replace(proof, candidate=bend, verdict="rejected", reason=reason, delta_bic=150.0)
    for best in (accepted, None):
        found = [trial.candidate for trial in other_bends(best, screen, [accepted, turned])]
        assert {one.effect.name for one in found} == {"DeadZone", "Saturation"}
        assert {one.site for one in found} == {bend.site}
    tried = [accepted, turned, *(replace(proof, candidate=one) for one in found)]
    assert other_bends(accepted, screen, tried) == ()
    for other in (replace(turned, delta_bic=90.0), replace(turned, reason="unseen data are foreseen worse")):
        assert other_bends(accepted, screen, [accepted, other]) == ()


def test_a_plainer_law_at_the_place_of_one_with_a_shape_is_tried():
    """Stribeck's friction, of a speed that the screen has not seen, bends to dry friction and to others."""
    _, _, proof = proved("CoulombFriction")
    laws = some_effects("StribeckFriction", "CoulombFriction", "ViscousFriction", "QuadraticDrag", "Lag")
    entries = [
        Screened(candidate, 1.0, (0.1,) * len(candidate.effect.sizes), 0.01, False, 1.0)
        for candidate in pairs(laws, sites(model()))
    ]
    rich = next(e.candidate for e in entries if e.candidate.effect.name == "StribeckFriction")
    apart = np.eye(len(entries))
    best, screen = replace(proof, candidate=rich), SimpleNamespace(entries=entries, correlation=apart)
    found = laws_at_its_place(best, screen, [best])
    assert found and all(t.candidate.site == rich.site for t in found)
    assert {t.candidate.effect.name for t in found} <= {"CoulombFriction", "ViscousFriction", "QuadraticDrag"}
    tried = [best, *(replace(proof, candidate=t.candidate) for t in found)]
    again = {t.candidate.effect.name for t in laws_at_its_place(best, screen, tried)}
    assert not again & {t.candidate.effect.name for t in found}
    unseen = SimpleNamespace(entries=[replace(e, p_value=0.5) for e in entries], correlation=apart)
    assert laws_at_its_place(best, unseen, [best]) == ()
    # What has no shape has bent to nothing.
    assert laws_at_its_place(replace(proof, explained=1.0), screen, [proof]) == ()


def test_the_law_of_the_best_one_is_tried_at_other_places_that_do_much_the_same():
    """A motor that cogs before a shaft was a drum that does behind it, since the screen saw more of that."""
    _, _, proof = proved("CoulombFriction")
    entries = [
        Screened(candidate, 9.0 - 0.1 * i, (0.1,), 0.01, False, 1.0)
        for i, candidate in enumerate(pairs(some_effects("CoulombFriction", "QuadraticDrag"), sites(model())))
    ]
    own = next(e.candidate for e in entries if e.candidate.effect.name == "CoulombFriction")
    best = replace(proof, candidate=own, explained=0.87, equivalent=())
    others = {
        e.candidate.site.name
        for e in entries
        if e.candidate.effect.class_name == own.effect.class_name and e.candidate.site != own.site
    }
    apart = np.eye(len(entries))
    seen = SimpleNamespace(entries=entries, correlation=apart)
    found = own_law_elsewhere(best, seen, [best])
    assert found and {t.candidate.effect.class_name for t in found} == {own.effect.class_name}
    assert {t.candidate.site.name for t in found} <= others
    tried = [best, *(replace(proof, candidate=t.candidate) for t in found)]
    again = own_law_elsewhere(best, seen, tried)
    assert not {t.candidate.site.name for t in again} & {t.candidate.site.name for t in found}
    assert own_law_elsewhere(replace(best, explained=0.96), seen, [best]) == ()
    assert own_law_elsewhere(replace(best, equivalent=tuple(others)), seen, [best]) == ()
    unseen = SimpleNamespace(entries=[replace(e, p_value=0.5) for e in entries], correlation=apart)
    assert own_law_elsewhere(best, unseen, [best]) == ()
    weak = [e if e.candidate is own else replace(e, score=0.4 * entries[0].score) for e in entries]
    assert own_law_elsewhere(best, SimpleNamespace(entries=weak, correlation=apart), [best]) == ()


def test_a_law_that_only_the_screen_takes_for_the_best_one_is_tried_at_its_other_places():
    """The sun on a wall was one with the sun on the room behind until a refit showed that walls store."""
    _, _, proof = proved("CoulombFriction")
    drag, friction = some_effects("QuadraticDrag", "CoulombFriction")
    entries = [
        Screened(candidate, 9.0, (0.1,), 0.01, False, 1.0)
        for candidate in pairs([drag, friction], sites(model()))
    ]
    names = dict.fromkeys(e.candidate.site.name for e in entries if e.candidate.effect is drag)
    here, *others = [
        name
        for name in names
        if {e.candidate.effect for e in entries if e.candidate.site.name == name} == {drag, friction}
    ]
    at = {(e.candidate.effect.name, e.candidate.site.name): e.candidate for e in entries}
    best = replace(
        proof, candidate=at["CoulombFriction", here], delta_log_likelihood=300.0, equivalent=(others[0],)
    )
    behind = replace(best, candidate=at["QuadraticDrag", here], delta_log_likelihood=200.0)
    one = np.ones((len(entries), len(entries)))
    seen = SimpleNamespace(entries=entries, correlation=one)
    found = [t.candidate for t in alike_elsewhere(best, seen, [best, behind])]
    assert [c.effect.name for c in found] == ["QuadraticDrag", "CoulombFriction"]
    assert {c.site.name for c in found} == {others[0]}
    # What ended as likely is one as well, what responds otherwise is none of its business.
    near = replace(behind, delta_log_likelihood=299.0)
    assert alike_elsewhere(best, seen, [best, near]) == ()
    apart = SimpleNamespace(entries=entries, correlation=np.eye(len(entries)))
    assert alike_elsewhere(best, apart, [best, behind]) == ()
    # What was refitted at both places and ended apart is not seen alike there any more.
    there = replace(behind, candidate=found[0], delta_log_likelihood=300.0, equivalent=())
    told = told_from_places([best, behind, there])
    assert [p.equivalent for p in told] == [(others[0],), (), ()]
    near = replace(there, delta_log_likelihood=200.5)
    assert told_from_places([behind, near])[0].equivalent == (others[0],)


def test_laws_with_shapes_are_tried_at_the_place_of_one_whose_errors_last():
    """A spring that hardens stands for a stop, which the screen has tried at a few places alone."""
    _, _, proof = proved("CoulombFriction")
    laws = some_effects("StribeckFriction", "ViscousFriction", "QuadraticDrag")
    entries = [
        Screened(candidate, 1.0, (0.1,) * len(candidate.effect.sizes), 0.01, False, 1.0)
        for candidate in pairs(laws, [site for site in sites(model()) if site == proof.candidate.site])
    ]
    screen = SimpleNamespace(entries=entries)

    def leaving(white, adds_up=False):
        seen = SimpleNamespace(rms={"phi": 1.0}, white={"phi": white})
        return replace(
            proof, adds_up=adds_up, explained=0.7, final=replace(proof.fit, simulated={"validation": seen})
        )

    tried = laws_at_its_place(leaving(0.1), screen, [proof])
    assert [t.candidate.effect.name for t in tried] == ["StribeckFriction"]
    assert laws_at_its_place(replace(leaving(0.1), explained=0.96), screen, [proof]) == ()
    assert laws_at_its_place(leaving(0.9), screen, [proof]) == ()
    # Errors that add up last whatever the law.
    adding = laws_at_its_place(leaving(0.9, adds_up=True), screen, [proof])
    assert [t.candidate.effect.name for t in adding] == ["StribeckFriction"]


def test_a_law_with_a_kink_is_tried_at_the_place_of_a_smooth_one_that_it_resembles():
    """Dry friction of a shaft that turns one way is a constant torque, once its kink is sharp."""
    _, _, proof = proved("CoulombFriction")
    laws = some_effects("ConstantLoad", "CoulombFriction", "StribeckFriction", "QuadraticDrag")
    candidates = pairs(laws, [proof.candidate.site])
    entries = [Screened(c, 1.0, (0.1,) * len(c.effect.sizes), 0.01, False, 1.0) for c in candidates]
    constant = next(c for c in candidates if c.effect.name == "ConstantLoad")
    best = replace(proof, candidate=constant, explained=1.0)

    def tried(correlation):
        alike = np.full((len(entries), len(entries)), correlation)
        screen = SimpleNamespace(entries=entries, correlation=alike)
        return [t.candidate.effect.name for t in laws_at_its_place(best, screen, [best])]

    assert tried(0.9) == ["CoulombFriction", "QuadraticDrag"], "with no more parameters"
    assert tried(0.6) == []


def test_a_linear_law_is_tried_beside_one_that_the_screen_takes_for_it():
    """A heater's loss of heat behind coloured noise was radiation, since the screen had seen that alone."""
    _, _, proof = proved("CoulombFriction")
    candidates = pairs(
        some_effects("ViscousFriction", "QuadraticDrag", "ConstantLoad"), [proof.candidate.site]
    )
    entries = [Screened(c, 1.0, (0.1,) * len(c.effect.sizes), 0.5, False, 1.0) for c in candidates]
    bent, straight = (
        next(c for c in candidates if c.effect.name == n) for n in ("QuadraticDrag", "ViscousFriction")
    )

    def tried(own, correlation):
        alike = np.full((len(entries), len(entries)), correlation)
        best = replace(proof, candidate=own, explained=1.0)
        found = laws_at_its_place(best, SimpleNamespace(entries=entries, correlation=alike), [best])
        return [t.candidate.effect.name for t in found]

    assert "ViscousFriction" in tried(bent, 0.99) and tried(bent, 0.95) == []
    assert tried(straight, 0.99) == []


def test_kink_of_a_rival_elsewhere_is_fitted_where_that_of_the_leader_is():
    """Friction behind a controller does much what a dead zone in it does: a kink must not decide unfitted."""
    _, _, friction = proved("CoulombFriction")
    zone = next(c for c in pairs(some_effects("DeadZone"), sites(model())) if c.site.kind == "input")
    rounder = replace(friction.fit.parameters[0], name=f"{zone.name}.u_s")
    fit = replace(friction.fit, parameters=(*friction.fit.parameters, rounder))
    leader = replace(friction, candidate=zone, fit=fit)
    half = replace(friction, delta_log_likelihood=0.6 * leader.delta_log_likelihood)
    assert kinked_elsewhere(leader, [leader, half]) == [half]
    assert kinked_elsewhere(replace(leader, fit=friction.fit), [half]) == [], "neither kink is fitted"
    less = replace(half, delta_log_likelihood=0.4 * leader.delta_log_likelihood)
    here = replace(half, candidate=replace(friction.candidate, site=zone.site))
    assert kinked_elsewhere(leader, [less, here]) == []
    others = [replace(half, delta_log_likelihood=f * leader.delta_log_likelihood) for f in (0.7, 0.9, 0.8)]
    assert kinked_elsewhere(leader, others) == [others[1], others[2]]


def late_law(name: str, gain: float, drag: float, time: float):
    """A proof of a lag or a dead time at the input that has ended with these values, certain to 1 %."""
    _, _, proof = proved("CoulombFriction")
    null = rubbing().null
    law = next(c for c in pairs(some_effects(name), sites(model())) if c.site.kind == "input")
    prepared = prepare(null.flat, null.estimated, Trial(law, (time,), ()))
    one = next(p for p in proof.fit.parameters if p.name in null.estimated)
    values = {**dict.fromkeys(null.estimated, drag), law.estimated[0]: time}
    parameters = tuple(replace(one, name=n, value=v, std_error=0.01 * v) for n, v in values.items())
    fit = replace(proof.fit, parameters=parameters, theta={**proof.fit.theta, **values})
    return replace(proof, candidate=law, flat=prepared.flat, fit=fit, delta_bic=gain)


def test_lag_and_dead_time_of_a_signal_that_have_ended_apart_begin_from_each_other():
    """Beside loads that take what a lag does not say, a heater's losses were half of what they are."""
    null = rubbing().null
    lag, dead = late_law("Lag", 200.0, 0.1, 3.0), late_law("Delay", 300.0, 0.2, 2.0)
    again = {p.trial.candidate.effect.name: p for p in begun_by_the_other(null, [lag, dead])}
    assert again.keys() == {"Lag", "Delay"}
    begins = {name: {p.name: p.value for p in prepared.flat.parameters} for name, prepared in again.items()}
    one = null.estimated[0]
    assert begins["Delay"][one] == 0.1 and begins["Delay"][dead.candidate.estimated[0]] == 3.0
    assert begins["Lag"][one] == 0.2 and begins["Lag"][lag.candidate.estimated[0]] == 2.0
    alike = late_law("Delay", 300.0, 0.101, 2.0)
    assert begun_by_the_other(null, [lag, alike]) == []
    idle = late_law("Lag", 0.0, 0.1, 3.0)
    assert begun_by_the_other(null, [idle, dead]) == []


def test_law_is_tried_in_its_other_direction():
    _, _, proof = proved("CoulombFriction")
    null = rubbing().null
    assert other_forms(null, proof) == ()
    both = pairs(some_effects("AsymmetricFriction"), [proof.candidate.site])
    one = next(t for t in trials(screen(null, run_null(null), both), 1.0, 9))
    prepared = prepare(null.flat, null.estimated, one)
    name = f"{one.candidate.name}.direction"
    fit = replace(proof.fit, theta={p.name: p.value for p in prepared.flat.parameters})
    (other,) = other_forms(null, replace(proof, candidate=one.candidate, flat=prepared.flat, fit=fit))
    assert other.names == prepared.names and other.trial.candidate.site == proof.candidate.site
    directions = [{p.name: p.value for p in flat.parameters}[name] for flat in (prepared.flat, other.flat)]
    assert sorted(directions) == [-1.0, 1.0]
    assert other.trial.candidate.shape["direction"] == directions[1]


def test_simple_law_is_tried_where_a_rich_one_was_first():
    found, _, proof = proved("StribeckFriction")
    simple = simpler_laws(proof, found, [proof])
    assert [t.candidate.effect.name for t in simple] == ["CoulombFriction"]
    assert simple[0].candidate.site == proof.candidate.site
    assert {c.site.name for c in simple[0].alike} == set(proof.equivalent)
    tried = replace(proof, candidate=simple[0].candidate)
    assert simpler_laws(proof, found, [proof, tried]) == ()


def test_simple_law_is_tried_from_a_rich_one_that_is_partly_unknown():
    """The plant has no peak at rest, so that nothing tells its width."""
    found, _, proof = proved("StribeckFriction")
    (simple,) = reduced_laws(rubbing().null, proof, found)
    assert simple.trial.candidate.effect.name == "CoulombFriction" and simple.similar is proof.fit
    start = {p.name: p.value for p in simple.flat.parameters}
    assert start[f"{simple.trial.candidate.name}.tau_c"] == proof.fit.theta[f"{proof.candidate.name}.tau_c"]
    certain = replace(proof.fit, parameters=tuple(replace(p, std_error=1e-9) for p in proof.fit.parameters))
    assert reduced_laws(rubbing().null, replace(proof, fit=certain), found) == []


def test_simple_law_is_tried_from_a_rich_one_that_says_how_its_kink_is():
    """A bump at rest that is narrower than the sign is rounded, however certain it is: of a pneumatic axis
    the search of plain friction had lost its way, and friction in one direction was taken for it."""
    found, _, proof = proved("StribeckFriction")
    name = proof.candidate.name
    theta = {**proof.fit.theta, f"{name}.w_st": 0.5 * proof.fit.theta[f"{name}.w_s"]}
    certain = tuple(replace(p, std_error=1e-9) for p in proof.fit.parameters)
    narrow = replace(proof, fit=replace(proof.fit, theta=theta, parameters=certain), final=None)
    (simple,) = reduced_laws(rubbing().null, narrow, found)
    assert simple.trial.candidate.effect.name == "CoulombFriction"
    assert may_be_of_the_kink(narrow, simple.trial.candidate)
    for other in some_effects("AsymmetricFriction", "ConstantLoad"):
        assert not may_be_of_the_kink(narrow, replace(simple.trial.candidate, effect=other))


def test_of_laws_for_the_same_the_simplest_goes_first():
    null = rubbing().null
    found, _, simple = proved("CoulombFriction")
    chosen = [prepare(null.flat, null.estimated, trial) for trial in trials(found, 1.0, 9)]
    first, richer = simplest_first(chosen)
    assert {one.trial.candidate.effect.name for one in richer} == {"StribeckFriction"}
    assert {id(one) for one in (*first, *richer)} == {id(one) for one in chosen}
    assert not_begun_by(None, richer) == richer
    here = [one for one in richer if one.trial.candidate.site == simple.candidate.site]
    assert here and not set(map(id, not_begun_by(simple, richer))) & set(map(id, here))


def test_rich_law_starts_from_the_fit_of_the_simple_one():
    _, run, proof = proved("CoulombFriction")
    (rich,) = richer_laws(rubbing().null, run, proof, LAWS, [proof])
    assert rich.trial.candidate.effect.name == "StribeckFriction"
    start = {p.name: p.value for p in rich.flat.parameters}
    assert start[f"{rich.trial.candidate.name}.tau_c"] == proof.fit.theta[f"{proof.candidate.name}.tau_c"]


def test_kinks_are_as_round_as_the_recording_has_them():
    """The friction of the plant is a tenth as round as the screen's: what estimates that says as much as a
    richer law."""
    _, run, rich = proved("StribeckFriction")
    simple = proved("CoulombFriction")[2]
    assert no_richer_ones(rich, [rich, simple]) == [simple] and no_richer_ones(simple, [rich, simple]) == []
    (once_more,) = rounded(rubbing().null, [simple])
    kink = f"{simple.candidate.name}.w_s"
    assert once_more.names == (*rubbing().null.estimated, f"{simple.candidate.name}.tau_c", kink)
    load = smoothed_load(rubbing().null, run, place_gains(rubbing().null, run))
    stand = rubbing()
    again = prove(stand.null, stand.baseline, once_more, stand.null.experiments, stand.validation, run, load)
    assert again.fit.log_likelihood > simple.fit.log_likelihood - 0.5
    # What the kink gains is less than its worth: the law as it was stays, and this one is not judged.
    assert simple.fit.log_likelihood + 3.0 < once_more.useless < simple.fit.log_likelihood + 4.0
    assert again.delta_bic < simple.delta_bic and again.final is None and "started otherwise" in again.reason
    assert again.fit.theta[f"{simple.candidate.name}.tau_c"] == pytest.approx(
        simple.fit.theta[f"{simple.candidate.name}.tau_c"], rel=0.05
    )
    (sharper,) = richer_laws(stand.null, run, again, LAWS, [again])
    at = {p.name: p.value for p in sharper.flat.parameters}
    assert at[f"{sharper.trial.candidate.name}.w_s"] == again.fit.theta[kink]


def test_unlike_responses_do_not_compete_once_nothing_is_left():
    found, _, proof = proved("CoulombFriction")
    strong = replace(proof, delta_log_likelihood=5000.0)
    by_name = {t.candidate.effect.name: t for t in trials(found, 1.0, 9)}
    assert not could_compete(by_name["Unbalance"], strong, found)
    assert could_compete(by_name["Unbalance"], None, found)
    assert could_compete(by_name["Unbalance"], replace(strong, left=None), found)
    assert could_compete(by_name["Unbalance"], replace(proof, delta_log_likelihood=50.0), found)


def test_law_with_places_of_its_own_competes_where_the_leader_leaves_a_part_of_the_load():
    """The screen has tried its places on a grid alone, where stops look little like a spring that hardens."""
    spring, stops, drag = (
        SimpleNamespace(
            name=name,
            estimated=(),
            site=SimpleNamespace(name=name),
            effect=SimpleNamespace(parameters=parameters, class_name=name, n_states=0),
        )
        for name, parameters in (
            ("spring", ()),
            ("stops", (SimpleNamespace(estimate=True, role="shape"),)),
            ("drag", ()),
        )
    )
    correlation = np.array([[1, 0.69, 0.69], [0.69, 1, 0], [0.69, 0, 1]])
    quiet_rest = SimpleNamespace(p_value=0.5, log_likelihood_gain=1.0, sign_of="")

    def competes(candidate, explained, scores=(9.0, 5.0, 5.0)):
        pairs = zip((spring, stops, drag), scores, strict=True)
        entries = [SimpleNamespace(candidate=one, score=score) for one, score in pairs]
        screen = SimpleNamespace(entries=entries, correlation=correlation)
        best = SimpleNamespace(
            candidate=spring, left=quiet_rest, delta_log_likelihood=2350.0, explained=explained
        )
        return could_compete(SimpleNamespace(candidate=candidate), best, screen)

    assert competes(stops, 0.88) and not competes(stops, 0.99)
    assert not competes(drag, 0.88), "a law without shapes was seen at its best"
    # Play that leads the screen is not put aside by stops that it has at a grid of places.
    assert competes(drag, 0.99, scores=(9.0, 5.0, 9.1))


def best_lags(null, lags):
    return best_dynamic(null, [dynamic_fits(null, pairs(lags, sites(null.flat)), best_simulation(null))])


@pytest.mark.slow
def test_dynamic_effect_in_a_circuit_with_lost_power():
    """Nonlinear only in a variable that no state reads."""
    flat = compile_model(
        Path(__file__).parents[1] / "systems" / "models" / "HeatedServo.mo", "HeatedServo.Circuit"
    )
    known = [replace(p, estimate=p.name in ("winding.J", "winding.k")) for p in flat.parameters]
    flat = replace(flat, parameters=tuple(known))
    time, lag = 0.01 * np.arange(400), 0.05
    u = np.sign(np.sin(7.0 * time + 0.1))[:, None]
    keep = np.exp(-0.01 / lag)
    y = lfilter([1.0 - keep], [1.0, -keep], simulate(flat, (time, u), hold="zoh").outputs, axis=0)
    y += 1e-3 * np.ptp(y) * np.random.default_rng(0).standard_normal(y.shape)
    record = Experiment("record", time, u, y, ("u",), ("y",))
    null = fit_null(flat, [site for site in sites(flat) if site.kind == "node"], [record], "zoh")
    lags = tuple(effect for effect in library() if effect.name == "Lag")
    (found,) = best_lags(null, lags)
    assert found.trial.sizes[0] == pytest.approx(lag, rel=0.2)
    assert {c.site.name for c in (found.trial.candidate, *found.trial.alike)} == {"u", "y"}
    # Beside a free load the parameters of the model may have gone anywhere.
    away = {"winding.J": 300.0 * null.fit.theta["winding.J"], "winding.k": 5.0 * null.fit.theta["winding.k"]}
    (found,) = best_lags(replace(null, flat=null.flat.with_theta(away)), lags)
    assert found.trial.sizes[0] == pytest.approx(lag, rel=0.2)


@pytest.mark.parametrize(
    ("score", "gain", "asked"),
    [
        (9.0, 300.0, [0.05, 0.2]),
        (3.0, 300.0, []),  # the screen saw less of it
        (9.0, 5.0, []),  # it says hardly anything
        (9.0, 3000.0, []),  # it is not behind
    ],
)
def test_simple_law_that_ends_behind_a_richer_one_is_searched_from_other_sizes(score, gain, asked):
    """A play of 0.06 rad had ended at 0.03, far behind soft stops."""

    def law(name, n_unknowns, gain):
        candidate = SimpleNamespace(name=name, site="shaft", n_unknowns=n_unknowns)
        return SimpleNamespace(candidate=candidate, delta_bic=gain, sizes=(0.1,))

    stops, play = law("stops", 3, 2000.0), law("play", 1, gain)
    scored = [SimpleNamespace(candidate=stops.candidate, score=5.0)]
    scored += [SimpleNamespace(candidate=play.candidate, score=score)]
    found = from_other_sizes(stops, SimpleNamespace(entries=scored), [stops, play])
    assert [trial.sizes[0] for trial in found] == pytest.approx(asked)
