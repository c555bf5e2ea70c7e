"""Rivals of the best law: richer, simpler and bent ones, at its place and at others.

A richer law at the same place often hides behind the simple one (Stribeck behind Coulomb friction): it starts
from the simple one's fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import casadi as ca
import numpy as np

from daest.diagnosis.built_in.dead_times import DELAY
from daest.diagnosis.built_in.late_signals import LAG, MOST_LATE, SECOND_ORDER, is_late
from daest.diagnosis.built_in.trials import SHARPER, Prepared, Trial, prepare, trials, with_kinks_bounded
from daest.diagnosis.evidence.law_values import errors_last
from daest.diagnosis.evidence.proof import bic_gain
from daest.diagnosis.evidence.ranking import most_likely
from daest.diagnosis.evidence.reasons import NO_BEND, RATE_LIMIT, STRAIGHT, TURNS_BACK, unseen_scales
from daest.diagnosis.evidence.rival_laws import may_be_of_the_kink
from daest.diagnosis.evidence.same_laws import is_linear_law
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import RTOL, NullObserver
from daest.diagnosis.screening.candidates import pairs, with_shapes
from daest.errors import DaestError
from daest.estimation.fitting.coordinates import Unknowns
from daest.estimation.nonlinear.trajectories import TrajectoryProblem, prediction_errors
from daest.model.diagnosis import Candidate, Proof, Screen, Screened
from daest.model.effects import Effect
from daest.model.fit import FittedParameter
from daest.model.flat import with_equations
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrator

MOST_RICHER = 2
OTHER_SIZES = (0.5, 2.0)  # times that of a refit, from which it is searched again
MOST_SIMPLER = 2
MOST_SHAPED = 2  # of the place of an accepted law, beside it
MOST_ROUNDED = 2  # laws at other places
MOST_ELSEWHERE = 3  # laws at places that the sensors see alike


def no_richer_ones(best: Proof, tried: Sequence[Proof]) -> list[Proof]:
    """Other laws for the same at the place of `best`, with no more parameters, that are not much less likely
    than it."""
    return [
        p
        for p in tried
        if p.candidate.site == best.candidate.site
        and _is_related(p.candidate.effect, best.candidate.effect)
        and len(p.candidate.estimated) <= len(best.candidate.estimated)
        and p.fit.log_likelihood > best.fit.log_likelihood - GATES.hopeless_log_likelihood
    ]


def kinked_elsewhere(best: Proof, tried: Sequence[Proof]) -> list[Proof]:
    """The likeliest laws at other places whose kinks are rounded as the screen had them, where the kink of
    `best` is as round as the recordings have it: dry friction behind a controller is much like a dead zone in
    it, and which of the two they are tells the kink."""
    if not _fitted_kinks(best):
        return []
    least = GATES.min_doubted_gain * best.delta_log_likelihood
    doubted = [
        p
        for p in tried
        if p.candidate.site != best.candidate.site
        and p.delta_log_likelihood > least
        and any(own.role == "sharpness" for own in p.candidate.effect.parameters)
        and not _fitted_kinks(p)
    ]
    return sorted(doubted, key=lambda p: -p.delta_log_likelihood)[:MOST_ROUNDED]


def _fitted_kinks(proof: Proof) -> list[str]:
    """The parameters that round a kink of the law and were fitted."""
    candidate, fitted = proof.candidate, {p.name for p in proof.fit.parameters}
    names = [f"{candidate.name}.{p.name}" for p in candidate.effect.parameters if p.role == "sharpness"]
    return [name for name in names if name in fitted]


def rounded(null: Null, proofs: Sequence[Proof]) -> tuple[Prepared, ...]:
    """The laws once more, with their kinks as round as the recordings have them.

    A kink that is rounder or sharper than the machine's leaves something at every change of sign, which a
    richer law, or a further round, would take for more than that.
    """
    found = []
    for proof in proofs:
        candidate = proof.candidate
        kinks = [f"{candidate.name}.{p.name}" for p in candidate.effect.parameters if p.role == "sharpness"]
        if kinks:
            trial = Trial(candidate, proof.sizes, _at_other_places(candidate, proof))
            flat = with_kinks_bounded(with_equations(proof.flat, "a refit"), [candidate])
            names = (*null.estimated, *candidate.estimated, *kinks)
            # Without its parameters' worth it does not take the place of the law that it starts from.
            useless = proof.fit.log_likelihood - 0.5 * bic_gain(0.0, len(kinks), null)
            found.append(Prepared(trial, flat, names, similar=proof.fit, useless=useless))
    return tuple(found)


def with_held_shapes(null: Null, proofs: Sequence[Proof]) -> Prepared | None:
    """Of laws that were refused for shapes of theirs the likeliest, once more with these held: a shape that
    came to its bound there, with it what the data no longer know (bristles whose friction is no larger at low
    speed are the model of Dahl); a scale of which the recordings show too little, with numbers that count for
    something on that scale alone as the law declares them. None where there is none."""
    refused = [p for p in proofs if p.verdict == "rejected" and p.delta_bic > GATES.min_bic_gain]
    for proof in sorted(refused, key=lambda p: -p.delta_bic):
        held = _at_bounds(proof) or _without_unseen_scales(null, proof)
        if held:
            return _with_held(null, proof, held)
    return None


def _at_bounds(proof: Proof) -> dict[str, float]:
    shapes = _fitted_shapes(proof)
    if not any(shape.at_bound for shape in shapes.values()):
        return {}
    return {n: p.value for n, p in shapes.items() if p.at_bound or p.std_error is None}


def _without_unseen_scales(null: Null, proof: Proof) -> dict[str, float]:
    """The scales of which the recordings show too little, with the numbers at which the law does without
    them; empty where it needs one of them at any value of these."""
    candidate, shapes = proof.candidate, _fitted_shapes(proof)
    declared = {p.name: p for p in candidate.effect.parameters if p.name in shapes}
    numbers = {
        name: 0.0 for name, p in declared.items() if p.start == 0.0 and not p.scale_of and not p.periods_over
    }
    if not numbers:
        return {}
    flat = with_equations(proof.flat, "a refit")
    model = replace(null, flat=flat, explicit=reduce_index(flat))
    scales = {name: value for name, (value, _) in unseen_scales(model, candidate, proof.told).items()}
    symbols = dict(zip(flat.parameter_names, ca.vertsplit(flat.theta), strict=True))
    given = ca.vertcat(*(symbols[f"{candidate.name}.{name}"] for name in numbers))
    without = ca.substitute(flat.residual, given, ca.SX.zeros(given.numel()))
    needed = [name for name in scales if ca.depends_on(without, symbols[f"{candidate.name}.{name}"])]
    return {} if needed or not scales else {**scales, **numbers}


def _with_held(null: Null, proof: Proof, held: Mapping[str, float]) -> Prepared:
    candidate = proof.candidate
    parameters = tuple(
        replace(p, estimate=p.estimate and p.name not in held) for p in candidate.effect.parameters
    )
    simpler = replace(
        candidate,
        effect=replace(candidate.effect, parameters=parameters),
        shape={**candidate.shape, **held},
    )
    trial = Trial(simpler, proof.sizes, _at_other_places(simpler, proof))
    values = {f"{candidate.name}.{name}": value for name, value in held.items()}
    flat = with_equations(proof.flat, "a refit").with_theta(values)
    return Prepared(trial, flat, (*null.estimated, *simpler.estimated), similar=proof.fit)


def _fitted_shapes(proof: Proof) -> dict[str, FittedParameter]:
    """Those of the law's shapes that were estimated, by name."""
    candidate, found = proof.candidate, {p.name: p for p in proof.fit.parameters}
    shapes = [p.name for p in candidate.effect.parameters if p.role == "shape"]
    return {name: found[own] for name in shapes if (own := f"{candidate.name}.{name}") in found}


def other_forms(null: Null, best: Proof) -> tuple[Prepared, ...]:
    """The law of `best` in its other forms, between which no number leads: a damper that stands behind a play
    or bridges it, friction that is larger in one direction or in the other. A small effect hardly tells them
    apart, so that the screen may have taken the wrong one."""
    candidate, found = best.candidate, []
    for p in candidate.effect.parameters:
        is_choice = p.role == "shape" and not p.estimate and not p.scale_of and not p.periods_over
        for value in p.grid if is_choice else ():
            if value != candidate.shape.get(p.name, p.start):
                other = replace(candidate, shape={**candidate.shape, p.name: value})
                flat = with_equations(best.flat, "a refit").with_theta({f"{candidate.name}.{p.name}": value})
                trial = Trial(other, best.sizes, _at_other_places(other, best))
                found.append(Prepared(trial, flat, (*null.estimated, *candidate.estimated)))
    return tuple(found)


def richer_laws(
    null: Null, run: NullObserver, best: Proof, library: Sequence[Effect], tried: Sequence[Proof]
) -> tuple[Prepared, ...]:
    """Effects with more parameters and a size of the same unit in place of `best`, started from its fit in
    the shape that simulates best; those that were fitted from a worse start are tried again."""
    simple = best.candidate
    n_own = len(simple.estimated)
    rivals = [
        Candidate(effect, simple.site, f"{simple.name}_{i + 1}")
        for i, effect in enumerate(library)
        if _is_related(effect, simple.effect)
        and not effect.is_dynamic
        and not effect.inputs
        and sum(p.estimate for p in effect.parameters) > n_own
    ]
    # A richer law that came no further than the simple one has found just that.
    least = best.fit.log_likelihood + GATES.min_richer_gain
    further = {p.candidate.effect.class_name for p in tried if p.fit.log_likelihood > least}
    rivals = [r for r in rivals if r.effect.class_name not in further]
    known_laws = [p for p in tried if p.candidate.site == simple.site]
    likeliest = {
        name: max(p.fit.log_likelihood for p in known_laws if p.candidate.effect.class_name == name)
        for name in {p.candidate.effect.class_name for p in known_laws}
    }
    if not rivals:
        return ()
    first, filtered = null.experiments[0], run.observed[0].filtered
    states = dict(zip(run.state_names, filtered.T, strict=True))
    shaped, _ = with_shapes(null.flat, rivals, first.time, states, first.inputs)
    size = best.fit.theta[f"{simple.name}.{simple.effect.sizes[0].name}"]
    scored: dict[str, tuple[float, Prepared]] = {}
    for candidate in shaped:
        prepared = _in_place(null, best, candidate, size)
        value = None if prepared is None else _simulation_value(null, best, prepared)
        known = scored.get(candidate.effect.class_name)
        if prepared is not None and value is not None and (known is None or value < known[0]):
            useless = likeliest.get(candidate.effect.class_name, -np.inf)
            scored[candidate.effect.class_name] = (value, replace(prepared, useless=useless))
    order = sorted(scored.values(), key=lambda pair: pair[0])
    return tuple(prepared for _, prepared in order[:MOST_RICHER])


def shortest_of(class_name: str, proofs: Sequence[Proof]) -> Proof | None:
    """The lag, or dead time, that is refused for nothing but that it is short beside the model, where it is
    the likeliest of all such but those at places that the sensors see alike, which are the same; None where
    there is none."""
    short = [p for p in proofs if p.is_any_dynamics]
    best = max(short, key=lambda p: p.delta_bic, default=None)
    if best is None or best.candidate.effect.class_name != class_name:
        return None
    others = [p.delta_bic for p in short if p is not best and not p.places & best.places]
    return best if best.delta_bic >= max(others, default=0.0) + GATES.min_bic_gain else None


def begun_by_the_other(null: Null, proofs: Sequence[Proof]) -> list[Prepared]:
    """The lag and the dead time of the likeliest signals where both pay for their parameters, each to start
    from the parameters of the model and the time that the other has ended with; none at a signal where both
    have ended with the same within their errors."""
    late = [p for p in proofs if is_late(p.candidate) and p.delta_bic >= GATES.min_bic_gain]
    late.sort(key=lambda p: p.delta_bic, reverse=True)
    sites = list(dict.fromkeys(p.candidate.site for p in late))
    pairs = [[p for p in late if p.candidate.site == site][:2] for site in sites]
    apart = [pair for pair in pairs if len(pair) == 2 and _are_apart(null, *pair)]
    return [_begun_by(null, *way) for one, other in apart[:MOST_LATE] for way in ((one, other), (other, one))]


def _begun_by(null: Null, proof: Proof, other: Proof) -> Prepared:
    """A lag or a dead time to start from where the other at its signal has ended."""
    law = proof.candidate
    flat = with_equations(proof.flat, "a refit").with_theta({n: other.fit.theta[n] for n in null.estimated})
    trial = Trial(law, other.sizes, _at_other_places(law, proof))
    own = dict(zip(law.estimated, other.sizes, strict=True))
    return Prepared(trial, flat.with_theta(own), (*null.estimated, *law.estimated))


def _are_apart(null: Null, one: Proof, other: Proof) -> bool:
    """Whether two refits have ended with other values of the model's parameters than their errors allow."""
    at = [{p.name: p for p in proof.fit.parameters if p.name in null.estimated} for proof in (one, other)]
    return any(
        abs(a.value - b.value) > GATES.min_significance * max(a.std_error or 0.0, b.std_error or 0.0)
        for a, b in ((at[0][name], at[1][name]) for name in at[0].keys() & at[1].keys())
    )


def straight_laws(candidates: Sequence[Candidate], proofs: Sequence[Proof]) -> list[Trial]:
    """A gain and an offset where the likeliest of all laws is refused since it bends nothing: the screen
    leaves out what refitted parameters do nearly all of, and what they cannot do of it may say most."""
    best = most_likely(proofs)
    if best is None or best.verdict != "rejected" or not best.reason.startswith(NO_BEND):
        return []
    return [
        Trial(one, tuple(one.effect.null_values.values()), ())
        for one in candidates
        if one.effect.class_name in STRAIGHT and one.site == best.candidate.site
    ]


def told_apart(late: Proof, others: Sequence[Proof], least: float) -> Proof:
    """The lag or dead time `late`, accepted where the likeliest of `others` at its signal is behind it by at
    `least` so much in log-likelihood; as it is where none could be refitted."""
    behind = [late.fit.log_likelihood - p.fit.log_likelihood for p in others]
    if not behind or min(behind) < least:
        return late
    return replace(late, verdict="supported", reason="", is_any_dynamics=False)


def leading_late(best: Proof | None, proofs: Sequence[Proof]) -> Proof | None:
    """The lag or dead time that leads all laws: the `best` accepted one; the likeliest at the signal of a
    limit of the rate, which is much like them, where that is the best; where nothing is accepted, the
    likeliest that is short beside the model. None where another law leads."""
    if best is None:
        return shortest_of(LAG, proofs) or shortest_of(DELAY, proofs)
    if best.candidate.effect.class_name == RATE_LIMIT:
        return most_likely([p for p in proofs if is_late(p.candidate) and p.places & best.places])
    return best if is_late(best.candidate) else None


def second_order_for(null: Null, late: Proof) -> Prepared | None:
    """A lag of second order at the signal of a dead time, to start from where that has ended: it is as late,
    and as late to second order in frequency."""
    law = next(iter(pairs([find_effect(SECOND_ORDER)], [late.candidate.site])), None)
    if law is None:
        return None
    prepared = prepare(null.flat, null.estimated, Trial(law, late.sizes, ()))
    flat = prepared.flat.with_theta({n: late.fit.theta[n] for n in null.estimated})
    return replace(prepared, flat=flat)


def told_from_second_order(late: Proof, seconds: Sequence[Proof], others: Sequence[Proof]) -> Proof:
    """The lag or dead time `late` beside lags of second order at its signal. A dead time that is refused for
    being short is accepted where they, and the lags among the `others` there, are far less likely; not where
    the search of that of second order has ended behind the first order, which is one of them."""
    lags = [p for p in others if p.candidate.effect.class_name == LAG]
    if late in lags or not late.is_any_dynamics or not seconds:
        return late
    best = max(p.fit.log_likelihood for p in seconds)
    if any(p.fit.log_likelihood > best for p in lags):
        return late
    is_told = not lags or told_apart(late, lags, GATES.min_told_lag) is not late
    return told_apart(late, seconds, GATES.min_told_dead_time) if is_told else late


def told_as_second_order(second: Proof, others: Sequence[Proof]) -> Proof:
    """The lag of second order, which is refused for nothing but being short: accepted where the lag and the
    dead time at its signal are among the `others` and far less likely. Any fast dynamics are one of these, to
    second order in frequency."""
    are_both = len({p.candidate.effect.class_name for p in others}) > 1
    return told_apart(second, others, GATES.min_told_lag) if are_both and second.is_any_dynamics else second


def with_likelier_lags(proofs: Sequence[Proof]) -> list[Proof]:
    """All laws; lags and dead times that are refused since any other as short would do are accepted where
    another of these, less likely, is accepted at their signal."""
    lags = [p for p in proofs if p.candidate.is_of_signal and p.candidate.is_dynamic]
    accepted = [p for p in lags if p.verdict != "rejected"]

    def is_likelier(one: Proof) -> bool:
        there = [p for p in accepted if p.candidate.site == one.candidate.site]
        return any(one.fit.log_likelihood > p.fit.log_likelihood for p in there)

    return [
        replace(p, verdict="supported", reason="", is_any_dynamics=False)
        if p.is_any_dynamics and any(p is lag for lag in lags) and is_likelier(p)
        else p
        for p in proofs
    ]


def simplest_first(chosen: Sequence[Prepared]) -> tuple[list[Prepared], list[Prepared]]:
    """The chosen candidates without those that say more of what a simpler one of them says, and these: at one
    place, of laws for the same, the one with the fewest parameters goes first. From its fit a richer one ends
    sooner and elsewhere than from the screen, and is not needed where the simple one leaves nothing."""
    is_richer = [any(_goes_beyond(one, other.trial.candidate) for other in chosen) for one in chosen]
    pairs = list(zip(chosen, is_richer, strict=True))
    return [one for one, richer in pairs if not richer], [one for one, richer in pairs if richer]


def not_begun_by(best: Proof | None, richer: Sequence[Prepared]) -> list[Prepared]:
    """Of `richer` laws those that are not started from the fit of `best` (`richer_laws`)."""
    return [one for one in richer if best is None or not _goes_beyond(one, best.candidate)]


def _goes_beyond(richer: Prepared, simple: Candidate) -> bool:
    rich = richer.trial.candidate
    is_related = rich.site == simple.site and _is_related(rich.effect, simple.effect)
    return is_related and len(rich.estimated) > len(simple.estimated)


def simpler_laws(best: Proof, screen: Screen, tried: Sequence[Proof]) -> tuple[Trial, ...]:
    """Effects with fewer parameters and a size of the same unit at the place of `best`, which were not tried:
    what a law with too many parameters cannot prove, a simpler one may."""
    known = {p.candidate.effect.class_name for p in tried if p.candidate.site == best.candidate.site}
    found = [
        Trial(entry.candidate, entry.sizes, _at_other_places(entry.candidate, best))
        for entry in _simpler_ones(best.candidate, screen)
        if entry.candidate.effect.class_name not in known and not entry.absorbed
    ]
    return tuple(found[:MOST_SIMPLER])


def from_other_sizes(best: Proof, screen: Screen, tried: Sequence[Proof]) -> tuple[Trial, ...]:
    """Laws with fewer parameters than the accepted `best` at its place, of which the screen saw more and
    whose refits have ended behind it, once more from other sizes: a play has an optimum at half its width,
    where soft stops take its place."""
    scores = {entry.candidate.name: entry.score for entry in screen.entries}
    own = best.candidate
    behind = [
        proof
        for proof in tried
        if proof.candidate.site == own.site
        and proof.candidate.n_unknowns < own.n_unknowns
        and GATES.min_bic_gain < proof.delta_bic < best.delta_bic
        and scores.get(proof.candidate.name, 0.0) > scores.get(own.name, 0.0)
    ]
    return tuple(
        Trial(proof.candidate, tuple(factor * size for size in proof.sizes), ())
        for proof in behind[:MOST_SIMPLER]
        for factor in OTHER_SIZES
    )


def signal_laws(best: Proof, screen: Screen, tried: Sequence[Proof]) -> tuple[Trial, ...]:
    """The other laws without states for the signal that `best` bends, and its own law for the other signals,
    which were not tried. The screen scores them at hardly any size, where a dead zone is a step; one of a
    third of the range is nearer to a gain that grows with the signal. And what bends the output of a slow
    machine bends its input as well, unless the data show its transients. Where `best` makes the signal late
    and leaves a part, those that bend with states at its place: what is late by more after a larger step
    follows a limit of its rate."""
    own = best.candidate
    if not own.is_of_signal or (own.is_dynamic and not _is_partial(best)):
        return ()

    def is_wanted(entry: Screened) -> bool:
        one = entry.candidate
        is_mirrored = one.is_of_signal and one.effect.class_name == own.effect.class_name
        if not (one.site == own.site or is_mirrored):
            return False
        return _is_late_and_bends(one) if own.is_dynamic else _is_static(entry)

    return _untried_laws(screen, tried, is_wanted)


def _untried_laws(
    screen: Screen, tried: Sequence[Proof], is_wanted: Callable[[Screened], bool]
) -> tuple[Trial, ...]:
    """Every law at a place that was not tried there, in the first of its shapes that is wanted."""
    known = {(p.candidate.effect.class_name, p.candidate.site.name) for p in tried}
    found: dict[tuple[str, str], Trial] = {}
    for entry in screen.entries:
        law = entry.candidate.effect.class_name, entry.candidate.site.name
        if law not in known and is_wanted(entry):
            found.setdefault(law, Trial(entry.candidate, entry.sizes, ()))
    return tuple(found.values())


def other_bends(best: Proof | None, screen: Screen, tried: Sequence[Proof]) -> tuple[Trial, ...]:
    """The other laws without states that bend a signal and were not tried, where the likeliest law is one
    that turns it back, refused for that, and likelier than the accepted `best`: the first term of a bend says
    that there is one, and not which."""
    turned = [p for p in tried if p.verdict == "rejected" and p.reason.startswith(TURNS_BACK)]
    likeliest = most_likely(turned)
    if likeliest is None or (best is not None and likeliest.delta_bic <= best.delta_bic):
        return ()
    site = likeliest.candidate.site
    return _untried_laws(screen, tried, lambda entry: entry.candidate.site == site and _is_static(entry))


def _is_static(entry: Screened) -> bool:
    """Whether a law needs no state and no further signal, and the parameters do not do what it does."""
    return not (entry.candidate.effect.n_states or entry.candidate.inputs or entry.absorbed)


def _is_partial(best: Proof) -> bool:
    """Whether an accepted law leaves a part of the loads, and the errors of its simulation last, or would
    whatever the law, where they add up."""
    return best.explained < GATES.all_explained and (best.adds_up or errors_last(best))


def _is_late_and_bends(one: Candidate) -> bool:
    """Whether a law of a signal holds it back by states of its own, in a form that is estimated."""
    return bool(one.effect.n_states) and _has_shapes(one) and not one.is_dynamic


def laws_at_its_place(best: Proof, screen: Screen, tried: Sequence[Proof]) -> tuple[Trial, ...]:
    """Laws without states at the place of the accepted `best` that show in the screen and were not tried.
    Those with fewer parameters: an outlet over any pressure bends to what a leak does, and the screen, which
    has seen it at other pressures, tells the two apart. And those with shapes, where it leaves a part of the
    loads and the errors of a simulation last: a spring that hardens bends over all of its travel to what a
    stop does at the ends, which the screen has tried at a few places alone. And those with kinks, where it
    has none and no fewer parameters: dry friction of a shaft that turns one way is a constant torque once its
    kink is as sharp as the data have it, and the screen has it rounded. And linear ones that the screen takes
    for one with it, where it is not linear, whether they show or not: a loss of heat is radiation where that
    says more. Laws of signals have `signal_laws`."""
    own = best.candidate
    if own.is_of_signal:
        return ()
    is_partial = _is_partial(best)
    known = {p.candidate.effect.class_name for p in tried if p.candidate.site == own.site}
    plainer: dict[str, Trial] = {}
    shaped: dict[str, Trial] = {}
    kinked: dict[str, Trial] = {}
    linear: dict[str, Trial] = {}
    for entry in screen.entries:
        one, law = entry.candidate, entry.candidate.effect.class_name
        if one.site != own.site or law in known or not _is_static(entry):
            continue
        is_straighter = is_linear_law(one.effect) and not is_linear_law(own.effect)
        if is_straighter and _is_alike(one, own, screen, GATES.same_place_correlation**2):
            linear.setdefault(law, Trial(one, entry.sizes, ()))
        elif entry.p_value >= GATES.screen_level:
            continue
        elif _has_shapes(own) and one.n_unknowns < own.n_unknowns:
            plainer.setdefault(law, Trial(one, entry.sizes, ()))
        elif is_partial and _has_shapes(one):
            shaped.setdefault(law, Trial(one, entry.sizes, ()))
        elif (
            _is_kinked(one)
            and not _is_kinked(own)
            and _is_alike(one, own, screen, GATES.min_rounded_response)
        ):
            kinked.setdefault(law, Trial(one, entry.sizes, ()))
    lists = ((linear, MOST_SIMPLER), (plainer, MOST_SIMPLER), (shaped, MOST_SHAPED), (kinked, MOST_SIMPLER))
    return tuple(trial for found, most in lists for trial in list(found.values())[:most])


def own_law_elsewhere(best: Proof, screen: Screen, tried: Sequence[Proof]) -> tuple[Trial, ...]:
    """The law of the accepted `best` at other places that were not tried, where it leaves a part of the loads
    and the screen foresees a good part of the gain there that it does here. A motor that cogs before a shaft
    is much like a drum that does behind it, to a screen that scores both beside loads, and how often it does
    in a turn it has tried at a few numbers alone. Laws of signals have `signal_laws`."""
    own = best.candidate
    if own.is_of_signal or own.is_of_parameter or best.explained >= GATES.all_explained:
        return ()
    scores = {entry.candidate.name: entry.score for entry in screen.entries}
    known = {p.candidate.site.name for p in tried if p.candidate.effect.class_name == own.effect.class_name}
    known |= best.places
    found = [
        trial
        for trial in trials(screen, GATES.screen_level, len(screen.entries))
        if trial.candidate.effect.class_name == own.effect.class_name
        and not known & {place.site.name for place in (trial.candidate, *trial.alike)}
        and trial.promised >= GATES.min_elsewhere * 0.5 * scores.get(own.name, 0.0) ** 2
    ]
    return tuple(found[:MOST_SIMPLER])


def alike_elsewhere(best: Proof, screen: Screen, tried: Sequence[Proof]) -> tuple[Trial, ...]:
    """Laws that respond as the accepted `best` does to the screen, but ended less likely, at those of their
    places that were not tried; then `best` at those of its own. The first of places that the sensors see
    alike beside the model as it is speaks for all, and with the law in it, the model may have parameters that
    tell them apart: the sun on a wall that stores heat and on the room behind are one as long as nothing
    shows that it stores any."""
    at = {entry.candidate.name: i for i, entry in enumerate(screen.entries)}
    own = at.get(best.candidate.name)
    if own is None or best.candidate.is_of_parameter:
        return ()
    alike = np.abs(screen.correlation[own]) > GATES.same_place_correlation
    least = best.delta_log_likelihood - GATES.same_fit_elsewhere
    behind = [
        p
        for p in tried
        if p.candidate.name in at and alike[at[p.candidate.name]] and p.delta_log_likelihood < least
    ]
    known = {(_law(p.candidate), p.candidate.site.name) for p in tried}
    found: dict[tuple[tuple[str, ...], str], Trial] = {}
    for one in (*behind, best) if behind else ():
        for entry in screen.entries:
            law, place = _law(entry.candidate), entry.candidate.site.name
            if law == _law(one.candidate) and place in one.equivalent and (law, place) not in known:
                found.setdefault((law, place), Trial(entry.candidate, entry.sizes, ()))
    return tuple(found.values())[:MOST_ELSEWHERE]


def told_from_places(proofs: Sequence[Proof]) -> list[Proof]:
    """The proofs without those of their places that the sensors see alike where the same law was refitted and
    ended clearly more or less likely."""
    by_place = {(_law(p.candidate), p.candidate.site.name): p for p in proofs}

    def is_alike(proof: Proof, place: str) -> bool:
        other = by_place.get((_law(proof.candidate), place))
        if other is None:
            return True
        apart = abs(other.delta_log_likelihood - proof.delta_log_likelihood)
        return apart <= GATES.same_fit_elsewhere

    return [replace(p, equivalent=tuple(name for name in p.equivalent if is_alike(p, name))) for p in proofs]


def _law(candidate: Candidate) -> tuple[str, ...]:
    """The law of a candidate, with what is supplied to it."""
    return (candidate.effect.class_name, *chain.from_iterable(sorted(candidate.inputs.items())))


def _is_kinked(one: Candidate) -> bool:
    return any(p.role == "sharpness" for p in one.effect.parameters)


def _is_alike(one: Candidate, own: Candidate, screen: Screen, least: float) -> bool:
    """Whether a law has no more parameters than `own` and a response like that, rounded as in the screen, of
    which it says at `least` such a share."""
    names = [entry.candidate.name for entry in screen.entries]
    if own.name not in names or one.n_unknowns > own.n_unknowns:
        return False
    correlation = screen.correlation[names.index(own.name), names.index(one.name)]
    return bool(correlation**2 >= least)


def _has_shapes(one: Candidate) -> bool:
    return any(p.estimate and p.role == "shape" for p in one.effect.parameters)


def reduced_laws(null: Null, best: Proof, screen: Screen) -> list[Prepared]:
    """Laws with fewer parameters at the place of `best`, from its estimates, where the data leave one of its
    own undetermined, or it may say no more than how their kink is: a search of a simpler law from the screen
    may have ended elsewhere."""
    rich = best.candidate
    own = {p.name: p for p in best.fit.parameters if p.name in rich.estimated}
    known = [p for p in own.values() if p.std_error and abs(p.value) > GATES.min_significance * p.std_error]
    size = own.get(f"{rich.name}.{rich.effect.sizes[0].name}")
    if size is None:
        return []
    is_open = len(known) < len(own)
    simpler = [entry.candidate for entry in _simpler_ones(rich, screen)]
    simple = [one for one in simpler if is_open or may_be_of_the_kink(best, one)]
    found = [_in_place(null, best, candidate, size.value) for candidate in simple]
    return [prepared for prepared in found if prepared is not None][:MOST_SIMPLER]


def _simpler_ones(rich: Candidate, screen: Screen) -> list[Screened]:
    """Of every related effect with fewer parameters at the place of `rich`, the entry with the best shape."""
    found: dict[str, Screened] = {}
    for entry in screen.entries:
        simple = entry.candidate
        if (
            simple.site == rich.site
            and _is_related(simple.effect, rich.effect)
            and len(simple.estimated) < len(rich.estimated)
        ):
            found.setdefault(simple.effect.class_name, entry)
    return list(found.values())


def _is_related(effect: Effect, other: Effect) -> bool:
    """Whether two effects are laws for the same: attached alike, with one size of the same unit, and shapes
    over the same variable."""
    variables = [{p.scale_of for p in e.parameters if p.scale_of} for e in (effect, other)]
    return bool(variables[0] & variables[1]) and (
        effect.class_name != other.class_name
        and effect.attach == other.attach
        and effect.domain == other.domain
        and len(effect.sizes) == len(other.sizes) == 1
        and effect.sizes[0].unit == other.sizes[0].unit
    )


def _at_other_places(candidate: Candidate, best: Proof) -> tuple[Candidate, ...]:
    return tuple(replace(candidate, site=replace(candidate.site, name=name)) for name in best.equivalent)


def _in_place(null: Null, best: Proof, candidate: Candidate, size: float) -> Prepared | None:
    effect = candidate.effect
    sharp = {
        p.name: SHARPER * candidate.shape[p.name]
        for p in effect.parameters
        if p.role == "sharpness" and p.name in candidate.shape
    }
    fitted = {p.name: p.value for p in best.fit.parameters}
    own = {name: f"{best.candidate.name}.{name}" for name in sharp}
    kept = {name: fitted[full] for name, full in own.items() if full in fitted}
    values = {**candidate.shape, **sharp, **kept, effect.sizes[0].name: size}
    try:
        flat = attach(null.flat, effect, candidate.site, candidate.name, values)
    except DaestError:
        return None
    at_fit = flat.with_theta({name: best.fit.theta[name] for name in null.estimated})
    trial = Trial(candidate, (size,), _at_other_places(best.candidate, best))
    is_richer = len(candidate.estimated) > len(best.candidate.estimated) and best.verdict != "rejected"
    names = (*null.estimated, *candidate.estimated)
    return Prepared(trial, at_fit, names, similar=best.fit, simpler=best if is_richer else None)


def _simulation_value(null: Null, best: Proof, prepared: Prepared) -> float | None:
    """Negative log-likelihood of the simulation from the simple law's initial states."""
    try:
        explicit = prepared.reduced()
    except DaestError:
        return None
    n_w = len(prepared.flat.noises)
    unknowns = Unknowns((), prepared.flat.theta_values, np.zeros(n_w), np.ones(len(prepared.flat.outputs)))
    starts = [dict(zip(s.names, s.values, strict=True)) for s in best.fit.initial_states]
    z = np.concatenate([[float(s.get(name, 0.0)) for name in explicit.state_names] for s in starts])
    problem = TrajectoryProblem(
        integrator(explicit),
        null.experiments,
        null.hold,
        unknowns,
        np.ones(explicit.n_states),
        np.full(len(prepared.flat.outputs), np.nan),
        rtol=RTOL,
    )
    errors = prediction_errors(problem, z)
    return None if errors is None else errors.negative_log_likelihood
