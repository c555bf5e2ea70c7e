"""Proofs beside each other: which is best, which cannot be told from it, which could still compete."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import starmap

import numpy as np

from daest.diagnosis.built_in.settled import LOST
from daest.diagnosis.built_in.trials import Trial
from daest.diagnosis.evidence.reasons import NO_BEND, NOT_SIGNIFICANT, STRAIGHT, is_significant
from daest.diagnosis.evidence.unseen import is_worse
from daest.diagnosis.gates import GATES
from daest.diagnosis.screening.candidates import scaled_shapes
from daest.model.diagnosis import Ahead, Candidate, Proof, Screen
from daest.model.effects import EffectParameter
from daest.model.fit import FittedParameter, error_ratios, most_lasting


def could_compete(trial: Trial, best: Proof | None, screen: Screen) -> bool:
    """Whether a candidate may come near the best accepted one, to judge by their scores.

    Where the best leaves nothing, its response is all that is missing, and a candidate whose response has the
    correlation ρ with it gains about ρ² of what it gains. Where it leaves a part of the load, one whose
    places, such as those of stops, the screen has only tried on a grid may say more than it does there. One
    that the screen sees better than the best itself has not been beaten.
    """
    if best is None or best.left is None or is_significant(best.left, best.delta_log_likelihood):
        return True
    if may_be_of_the_kink(best, trial.candidate):
        return True
    names = [entry.candidate.name for entry in screen.entries]
    if not {best.candidate.name, trial.candidate.name} <= set(names):
        return True
    own, other = names.index(best.candidate.name), names.index(trial.candidate.name)
    if screen.entries[other].score > screen.entries[own].score:
        return True
    correlation = screen.correlation[own, other]
    is_shaped = any(p.estimate and p.role == "shape" for p in trial.candidate.effect.parameters)
    if is_shaped and best.explained < GATES.all_explained and correlation**2 >= GATES.min_alike_response:
        return True
    return bool((1.0 - correlation**2) * best.delta_log_likelihood < GATES.hopeless_log_likelihood)


def least_hope(leader: Proof | None, candidate: Candidate) -> float:
    """The log-likelihood below which the refit of another `candidate` is not pursued."""
    if leader is None or may_be_of_the_kink(leader, candidate):
        return -np.inf
    return leader.fit.log_likelihood - GATES.hopeless_log_likelihood


def ranked(proofs: Sequence[Proof]) -> tuple[Proof, ...]:
    """Best first. Accepted candidates that are rivals of the best (`_is_rival`) are not separable from it: of
    them, those come first that foresee unseen data clearly better, then the likeliest. A law that the best
    one only rounds otherwise (`_is_rounded_otherwise`) is not separable from it, either. Where a refused one
    is far more likely, none is the explanation."""
    kept = _without_outrun(_without_imitations(proofs))
    compared = _on_one_basis(_without_hopeless(kept))
    order = sorted(compared, key=lambda p: (p.verdict == "rejected", -_bic(p)))
    accepted = [p for p in order if p.verdict == "supported"]
    if not accepted:
        return tuple(order)
    best = _simplest(accepted)
    instead = _what_refuses_all(order, best)
    if instead:
        refused = (p if p.verdict == "rejected" else _refused(p, instead) for p in order)
        return tuple(sorted(refused, key=lambda p: -p.delta_bic))
    close = [p for p in accepted if _is_rival(p, best) or _is_bent_otherwise(p, best)]
    same = [p for p in accepted if p is not best and _is_same_equation(p, best)]
    close = [p for p in close if p not in same]
    forms = [p for p in close if p is not best and _is_other_form(p, best)]
    close = [p for p in close if p not in forms]
    nested = [p for p in close if _is_same_beside_a_load(p, best)]
    close = [p for p in close if p not in nested]
    twins = [p for p in close if p is not best and _is_twin(p, best)]
    close = [p for p in close if p not in twins]
    idle = [p for p in close if _is_idle(p, best)]
    close = [p for p in close if p not in idle]
    doubted = [
        p
        for p in order
        if p not in close
        and (
            _is_rounded_otherwise(p, best)
            or _is_as_likely(p, best)
            or _is_at_limit(best, p)
            or _is_hardly_less(p, best)
        )
    ]
    close += doubted
    result = []
    for proof in order:
        if proof.verdict == "rejected" and proof not in doubted:
            result.append(proof)
        elif proof in twins:
            result.append(
                _refused(proof, f"the data do not tell it from the same effect at {best.candidate.site.name}")
            )
        elif proof in forms:
            result.append(_refused(proof, f"the data do not tell it from {best.candidate.label}"))
        elif proof in nested:
            result.append(
                _refused(proof, f"beside a constant load it says no more than {best.candidate.label}")
            )
        elif proof in close:
            others = tuple(p.candidate.label for p in close if p is not proof)
            alike = tuple(p.candidate.site.name for p in twins if proof is best)
            result.append(
                replace(
                    proof,
                    equivalent=(*proof.equivalent, *(name for name in alike if name not in proof.equivalent)),
                    not_separable_from=others,
                    verdict="not separable" if others else "supported",
                    reason="",
                    same_as=(*proof.same_as, *(p.candidate.label for p in same + forms if proof is best)),
                )
            )
        elif proof in idle:
            result.append(_refused(proof, f"{best.candidate.label} says as much with fewer parameters"))
        elif proof in same:
            result.append(_refused(proof, f"it is the same equation as {best.candidate.label}"))
        else:
            worse = _bic(best) - _bic(proof)
            reason = f"{best.candidate.label} explains the data better (BIC {worse:.0f})"
            if worse < 0.0:
                reason = f"{best.candidate.label} says nearly as much with fewer parameters"
            result.append(_refused(proof, reason))
    return tuple(sorted(result, key=partial(_place, best)))


def _refused(proof: Proof, reason: str) -> Proof:
    return replace(proof, verdict="rejected", reason=reason)


def _without_imitations(proofs: Sequence[Proof]) -> list[Proof]:
    """Laws with states are refused that say no more than a simpler lag or delay which is too short to be told
    from others, or only comes near: a flexible part with three parameters imitates the lag of a sensor; and
    any law that says less than such a one with no more parameters. So is a lag with which unseen data are
    simulated far worse than with another one that is too short: a part that swings is neither. And a law with
    states of a signal that says no more than a lag there whose time nobody knows: a limit of its rate."""
    lags, result = [p for p in proofs if p.is_any_dynamics or p.comes_near], []
    unknown = [p for p in proofs if _is_unknown_lag(p)]
    for proof in proofs:
        there = [p for p in unknown if p.candidate.site == proof.candidate.site and p is not proof]
        imitated = (*lags, *there) if proof.candidate.effect.n_states else lags
        simpler = [p for p in imitated if is_simpler(p.candidate, proof.candidate)]
        more = GATES.same_bic if proof.candidate.effect.n_states else -GATES.same_bic
        same = next((p for p in simpler if proof.delta_bic <= p.delta_bic + more), None)
        if proof.verdict != "rejected" and same is not None:
            fewer = len(same.candidate.estimated) < len(proof.candidate.estimated)
            how = " with fewer parameters" if fewer else ""
            much = "as much" if more > 0.0 else "more"
            reason = f"{same.candidate.label} says {much}{how}, but {same.reason}"
            is_such = same.is_any_dynamics and not fewer and abs(proof.delta_bic - same.delta_bic) <= more
            proof = replace(proof, verdict="rejected", reason=reason, is_any_dynamics=is_such)
        nearer = next((p for p in lags if _is_lag_far_nearer(p, proof)), None)
        if proof.verdict != "rejected" and nearer is not None:
            reason = f"{nearer.candidate.label} simulates unseen data far better, but {nearer.reason}"
            proof = _refused(proof, reason)
        result.append(proof)
    return result


def _without_outrun(proofs: Sequence[Proof]) -> list[Proof]:
    """Laws that leave the load as it was and errors that last are refused where one at their place with no
    more parameters takes the load, and simulates unseen data far better, though the likelihood beside a load
    shows nothing of it: a slow load is as good as a constant torque, and a ripple that is not there then says
    more than that."""
    taking = [p for p in proofs if _takes_load_unseen(p)]
    result = []
    for proof in proofs:
        outrunning = [p for p in taking if _outruns(p, proof)]
        nearer = min(outrunning, key=partial(_unseen_ratio, proof), default=None)
        if proof.verdict != "rejected" and nearer is not None:
            label = nearer.candidate.label
            reason = f"{label} takes the load, and simulates unseen data far better, but {nearer.reason}"
            proof = _refused(proof, reason)
        result.append(proof)
    return result


def _takes_load_unseen(proof: Proof) -> bool:
    """Whether a law is refused for nothing but the likelihood beside a load, most of which it takes."""
    is_found = proof.delta_log_likelihood > -LOST and proof.delta_bic < GATES.min_bic_gain
    return proof.verdict == "rejected" and is_found and proof.explained >= GATES.min_explained


def _outruns(one: Proof, other: Proof) -> bool:
    a, b = one.candidate, other.candidate
    if a.site != b.site or len(a.estimated) > len(b.estimated) or not leaves_load_and_errors(other):
        return False
    ratios = error_ratios(other.told.simulated, one.told.simulated)
    return bool(ratios) and max(ratios) < GATES.max_told_ratio


def leaves_load_and_errors(proof: Proof) -> bool:
    """Whether a law that is judged beside loads leaves them as they were, and errors of a simulation of
    unseen data that last."""
    return not proof.is_by_use and proof.explained < GATES.min_explained and errors_last(proof)


def _is_unknown_lag(proof: Proof) -> bool:
    """Whether a lag or delay of a signal is refused since nobody knows its time, or not well enough."""
    is_unknown = proof.is_vague or proof.reason.startswith(NOT_SIGNIFICANT)
    return is_unknown and proof.candidate.is_of_signal and proof.candidate.is_dynamic


def _is_lag_far_nearer(short: Proof, lag: Proof) -> bool:
    """Whether a lag or delay of a signal that is too short to be told from others simulates unseen data far
    better than another one."""
    dynamic = all(p.candidate.is_of_signal and p.candidate.is_dynamic for p in (short, lag))
    ratios = error_ratios(lag.told.simulated, short.told.simulated) if dynamic else ()
    return short.is_any_dynamics and bool(ratios) and max(ratios) < GATES.max_told_ratio


def is_simpler(lag: Candidate, law: Candidate) -> bool:
    """Whether a lag has fewer parameters than a law, or as many as one by which something follows late in
    another way: play has a width, a coil an inductance."""
    few, many = len(lag.estimated), len(law.estimated)
    return few < many or (few == many and not (law.is_of_signal and law.is_dynamic))


def _is_at_limit(rich: Proof, plain: Proof) -> bool:
    """Whether the shapes of a law are within a standard error of nothing, and another law without one, of the
    same size, gains much of what it does: a spring whose loop closes within no length is dry friction, which
    holds at rest better than one whose kink is rounded."""
    open_shapes = _open_shapes(rich)
    sizes = [p for p in _told_of_effect(rich) if p not in open_shapes]
    plain_sizes = _told_of_effect(plain)
    if not open_shapes or len(sizes) != 1 or len(plain_sizes) != 1 or not _is_size(rich, sizes[0]):
        return False
    is_same = sizes[0].unit == plain_sizes[0].unit and _agree(sizes[0], plain_sizes[0])
    return is_same and plain.delta_log_likelihood > GATES.min_doubted_gain * rich.delta_log_likelihood


def _is_idle(rich: Proof, best: Proof) -> bool:
    """Whether a law has more parameters than the best one, of them shapes within a standard error of nothing,
    and is no likelier: a soft coupling without damping is an inductance in front of it."""
    is_richer = len(rich.candidate.estimated) > len(best.candidate.estimated)
    more = rich.delta_log_likelihood - best.delta_log_likelihood
    return is_richer and bool(_open_shapes(rich)) and more < GATES.same_bic / 2.0


def _is_hardly_less(simple: Proof, best: Proof) -> bool:
    """Whether an accepted law with fewer parameters gains nearly what the best one does, which is ahead by a
    length or a time that is hardly off zero: a soft coupling whose damping is over within microseconds is the
    inductance in front of it, and whatever else is a little wrong may ask for that."""
    is_simpler_law = len(simple.candidate.estimated) < len(best.candidate.estimated)
    gains_enough = simple.delta_log_likelihood > GATES.min_simpler_gain * best.delta_log_likelihood
    is_accepted = simple.verdict != "rejected"
    return (
        is_accepted
        and is_simpler_law
        and gains_enough
        and bool(_open_shapes(best, GATES.min_leading_significance))
    )


def _open_shapes(proof: Proof, significance: float = 1.0) -> list[FittedParameter]:
    """The lengths and times of a law, which cannot be below zero, that are within so many standard errors of
    it."""
    own = {
        f"{proof.candidate.name}.{p.name}"
        for p in proof.candidate.effect.parameters
        if p.role == "shape" and p.min is not None and p.min >= 0.0
    }
    return [
        p
        for p in _told_of_effect(proof)
        if p.name in own and p.std_error and p.value <= significance * p.std_error
    ]


def _is_size(proof: Proof, parameter: FittedParameter) -> bool:
    """Whether a parameter of a law is one of its sizes."""
    sizes = {f"{proof.candidate.name}.{p.name}" for p in proof.candidate.effect.sizes}
    return parameter.name in sizes


def _without_hopeless(proofs: Sequence[Proof]) -> list[Proof]:
    """Laws that are accepted for their simulation are refused where beside loads an accepted one is far more
    likely, by much more than they simulate better, or is likelier and simulates unseen data better, too."""
    seen = [p for p in proofs if p.verdict != "rejected" and not p.is_by_use]
    best = max(seen, key=lambda p: p.fit.log_likelihood + p.in_use.gain, default=None)
    if best is None:
        return list(proofs)
    most, result = best.fit.log_likelihood + best.in_use.gain, []
    for proof in proofs:
        behind = most - proof.fit.log_likelihood - proof.in_use.gain
        if proof.verdict != "rejected" and proof.is_by_use and behind > GATES.hopeless_log_likelihood:
            reason = f"{best.candidate.label} explains the data far better (log-likelihood {behind:.0f})"
            proof = _refused(proof, reason)
        better = next((p for p in seen if _is_better_both_ways(p, proof)), None)
        if proof.verdict != "rejected" and proof.is_by_use and better is not None:
            reason = f"{better.candidate.label} is likelier beside loads, and simulates unseen data better"
            proof = _refused(proof, reason)
        result.append(proof)
    return result


def _is_better_both_ways(one: Proof, other: Proof) -> bool:
    """Whether a law is clearly likelier than another one beside loads, and simulates every output of unseen
    data clearly better."""
    ratios = error_ratios(other.told.simulated, one.told.simulated)
    is_likelier = one.fit.log_likelihood > other.fit.log_likelihood + GATES.min_richer_gain
    return is_likelier and bool(ratios) and max(ratios) < GATES.max_rival_error


def _on_one_basis(proofs: Sequence[Proof]) -> list[Proof]:
    """Where a law is accepted for what its simulation gains, all that are accepted count by that: with an
    observer, much of the same law goes into the loads, and its gain is another one. An open law that its
    simulation shows more clearly than all of them is then accepted, too, whatever it leaves for the loads.

    All count for as many independent samples, the fewest of any. How many a law has goes with how long its
    errors last: one that leaves slow ones alone would gain less than one that leaves more of every kind."""
    if not any(p.is_by_use and p.verdict != "rejected" for p in proofs):
        return list(proofs)
    known = [p.in_use for p in proofs if _is_compared(p) and p.in_use.n_independent]
    fewest = min(used.n_independent for used in known), min(used.n_unseen for used in known)
    found = [_by_use(p, *fewest) if _is_compared(p) else p for p in proofs]
    pairs = list(zip(proofs, found, strict=True))
    least = GATES.same_bic + max(
        new.delta_bic for old, new in pairs if old.verdict != "rejected" and new.is_by_use
    )
    return [old if old.verdict == "rejected" and new.delta_bic <= least else new for old, new in pairs]


def _is_compared(proof: Proof) -> bool:
    """Whether a law counts by its simulation where laws do: one that is accepted, or open and shown by it."""
    return proof.verdict != "rejected" or (proof.is_open and proof.is_shown)


def _by_use(proof: Proof, n_independent: float, n_unseen: float) -> Proof:
    """The proof with the evidence of its simulation for that many independent samples; as it is where that
    is unknown."""
    if not proof.in_use.n_independent:
        return proof
    used = replace(proof.in_use.by_output, n_independent=n_independent, n_unseen=n_unseen)
    return replace(
        proof,
        delta_log_likelihood=used.gain,
        delta_bic=used.bic(proof.candidate.n_unknowns),
        verdict="supported",
        reason="",
        is_by_use=True,
    )


def _place(best: Proof, proof: Proof) -> tuple[bool, float, int, float, float, float]:
    """What a proof is ranked by, smallest first. Of laws that foresee unseen data clearly better and alike,
    the one with the fewest parameters of any kind is first; of those whose simulation says as much, the one
    that takes more of the load."""
    is_same = _is_vague(proof, best) and not _is_far_nearer(proof, best)
    ratio = 1.0 if proof.verdict == "rejected" or is_same else _unseen_ratio(best, proof)
    n_parameters = len(proof.candidate.effect.parameters) if ratio < GATES.max_rival_error else 0
    ratio = round(min(ratio, GATES.max_rival_error), 2)
    is_as_likely = proof.is_by_use and proof.verdict != "rejected"
    step = round(_bic(proof) / GATES.same_bic) * GATES.same_bic if is_as_likely else _bic(proof)
    explained = proof.explained if is_as_likely else 0.0
    return proof.verdict == "rejected", ratio, n_parameters, -step, -explained, -_bic(proof)


def is_same_load(one: Proof, other: Proof) -> bool:
    """Whether a parameter that changes with a variable does what a law of the same variable does: what a
    temperature of the surroundings gains with the speed of a fan is a heat flow in proportion to that. The
    parameter itself makes up for the middle of the variable, and is another one."""
    a, b = one.candidate, other.candidate
    if a.effect.is_of_variable == b.effect.is_of_variable or len(_own_sizes(one)) != len(_own_sizes(other)):
        return False
    apart = abs(one.delta_log_likelihood - other.delta_log_likelihood)
    return set(a.inputs.values()) == set(b.inputs.values()) and apart <= GATES.same_fit


def _is_same_equation(one: Proof, other: Proof) -> bool:
    """Whether two laws do the same under two names: as a heat flow into a node and a gain in proportion to
    it; or as an offset and a dead zone of which the recordings show one side alone. Two searches for one end
    a little apart beside the loads, and without these at the same values, with sizes that are as certain."""
    if is_same_load(one, other):
        return True
    apart = abs(one.delta_log_likelihood - other.delta_log_likelihood)
    if apart <= GATES.same_equation:
        return _has_same_values(one, other)
    if apart > GATES.same_equation_share * other.delta_log_likelihood:
        return False
    one, other = (replace(p, fit=p.told) for p in (one, other))
    sizes = list(zip(_own_sizes(one), _own_sizes(other), strict=False))
    return bool(sizes) and _has_same_values(one, other) and all(starmap(_are_as_certain, sizes))


def _is_other_form(one: Proof, best: Proof) -> bool:
    """Whether two laws are two forms of one finding: a parameter that changes with the same variable."""
    a, b = one.candidate, best.candidate
    of_variable = a.effect.is_of_variable and b.effect.is_of_variable
    return of_variable and a.site == b.site and a.inputs == b.inputs


def _has_same_values(one: Proof, other: Proof) -> bool:
    """Whether two laws with as many sizes leave the parameters of the model where they are."""
    values, others = (_values_of_model(p) for p in (one, other))
    return len(_own_sizes(one)) == len(_own_sizes(other)) and all(
        abs(a.value - b.value) <= GATES.same_equation * (a.std_error or 0.0)
        for a, b in zip(values, others, strict=True)
    )


def _are_as_certain(a: FittedParameter, b: FittedParameter) -> bool:
    """Whether two sizes, each in its own unit, are as many standard errors off zero."""
    one, other = (abs(p.value) / p.std_error if p.std_error else 0.0 for p in (a, b))
    return abs(one - other) <= GATES.same_equation * max(one, other)


def _is_same_beside_a_load(richer: Proof, simple: Proof) -> bool:
    """Whether a law goes beyond one for the same quantity by parameters that only make up for a constant
    load: where each recording has one, both foresee unseen data alike."""
    if simple.steady_error is None or richer.steady_error is None:
        return False
    units, others = ([p.unit for p in law.candidate.effect.sizes] for law in (richer, simple))
    return (
        units == others
        and len(_own_sizes(richer)) > len(_own_sizes(simple))
        and richer.steady_error > (1.0 - GATES.same_unseen_error) * simple.steady_error
    )


def _is_twin(one: Proof, other: Proof) -> bool:
    """Whether two laws are the same effect at two places that the data hardly tell apart, with the same
    estimates: which effect it is is known, where it is not."""
    is_near = abs(one.delta_log_likelihood - other.delta_log_likelihood) <= GATES.same_fit_elsewhere
    return is_near and _is_same_law(one, other)


def _is_same_where_alike(refused: Proof, best: Proof) -> bool:
    """Whether a refused law is the accepted one at a place where the sensors see it alike, with the same
    estimates. What makes it likelier is then where the unknown loads come in, before or behind it, and it is
    no other explanation."""
    are_alike = (
        refused.candidate.site.name in best.equivalent or best.candidate.site.name in refused.equivalent
    )
    return are_alike and _is_same_law(refused, best)


def _is_same_law(one: Proof, other: Proof) -> bool:
    """Whether two laws are the same effect with the same estimates, wherever it is."""
    if one.candidate.effect.class_name != other.candidate.effect.class_name:
        return False
    values, others = ({p.name.rpartition(".")[2]: p for p in _told_of_effect(law)} for law in (one, other))
    return values.keys() == others.keys() and all(
        a.unit == others[name].unit and _agree(a, others[name]) for name, a in values.items()
    )


def _told_of_effect(proof: Proof) -> list[FittedParameter]:
    return [p for p in proof.told.parameters if p.name in proof.candidate.estimated]


def _agree(a: FittedParameter, b: FittedParameter) -> bool:
    """Whether two estimates are within one standard error of their difference."""
    return abs(a.value - b.value) <= np.hypot(a.std_error or 0.0, b.std_error or 0.0)


def _values_of_model(proof: Proof) -> list[FittedParameter]:
    """The parameters but those of the effect, which each law counts in its own unit."""
    own = f"{proof.candidate.name}."
    return [p for p in proof.fit.parameters if not p.name.startswith(own)]


def best_accepted(proofs: Sequence[Proof]) -> Proof | None:
    """The first of `ranked` proofs that is accepted, be it separable from others or not; None where all are
    rejected."""
    return next((p for p in proofs if p.verdict != "rejected"), None)


def _what_refuses_all(order: Sequence[Proof], best: Proof) -> str:
    """Why no law is the explanation, though the best one is accepted; empty where it is."""
    stronger = _far_more_likely(order, best)
    if stronger is not None:
        worse = stronger.delta_bic - best.delta_bic
        better = f"{stronger.candidate.label} explains the data far better (BIC {worse:.0f})"
        return f"{better}, but {stronger.reason}"
    better_one = _better_in_both(order, best)
    if better_one is not None:
        better = f"{better_one.candidate.label} simulates unseen data better and is likelier beside the loads"
        return f"{better}, but {better_one.reason}"
    return ""


def _better_in_both(order: Sequence[Proof], best: Proof) -> Proof | None:
    """A law that is refused for nothing but how much of the load is left, beside a best one that its
    simulation alone shows: it simulates unseen data better, and makes the recordings likelier beside the
    loads."""
    if not best.is_by_use:
        return None
    better = [
        p
        for p in order
        if p.verdict == "rejected"
        and p.takes_little
        and p.fit.log_likelihood > best.fit.log_likelihood
        and _unseen_ratio(best, p) < 1.0
    ]
    return min(better, key=lambda p: _unseen_ratio(best, p), default=None)


def _far_more_likely(order: Sequence[Proof], best: Proof) -> Proof | None:
    """A refused candidate beside which the best accepted one explains little; not one that foresees unseen
    data clearly worse: it owes its likelihood to what does not last. One that unseen data speak against where
    their predictions are compared, and not where their simulation is, contradicts itself: until it is known
    why, none is the explanation."""
    refused = [p for p in order if p.verdict == "rejected" and (_is_in_the_way(p, best) or _is_torn(p, best))]
    strongest = max(refused, key=lambda p: p.delta_log_likelihood, default=None)
    if strongest is None or GATES.min_refused_gain * strongest.delta_log_likelihood < _gain(best, strongest):
        return None
    return strongest


def _gain(best: Proof, refused: Proof) -> float:
    """What the best law gains, to be held against what a refused one gains beside loads: there, too, where it
    is accepted for its simulation, of which a few independent samples gain less than all predictions."""
    if not best.is_by_use or refused.is_by_use:
        return best.delta_log_likelihood
    beside = refused.delta_log_likelihood + best.fit.log_likelihood - refused.fit.log_likelihood
    return max(best.delta_log_likelihood, beside)


def _is_in_the_way(refused: Proof, best: Proof) -> bool:
    # What does most of what is missing is in the way of what does little of it, whichever law it stands for;
    # so is what foresees unseen data clearly better.
    does_more = (
        refused.explained >= GATES.min_explained or _unseen_ratio(best, refused) < GATES.max_rival_error
    )
    if not (refused.is_open or (refused.is_vague and does_more)) or _ends_in_a_simpler_law(refused, best):
        return False
    if _is_same_where_alike(refused, best) or is_straight_there(refused, best):
        return False
    # Of a law that shows too little of its form the data say nothing but that something small is left.
    if not refused.is_known and best.explained >= GATES.all_explained:
        return False
    return _is_likelier_part(refused, best) or not _unseen_ratio(refused, best) < GATES.max_rival_error


def is_straight_there(refused: Proof, best: Proof) -> bool:
    """Whether a law that the recordings show without its bend stands where the best one is a gain or an
    offset: it is both together, and so speaks for either and for no other law."""
    is_straight = refused.reason.startswith(NO_BEND) and best.candidate.effect.class_name in STRAIGHT
    return is_straight and refused.candidate.site == best.candidate.site


def _ends_in_a_simpler_law(refused: Proof, best: Proof) -> bool:
    """Whether a law with more parameters at the place of the best one has come to a bound of one of them: it
    is the same law there, rounded otherwise, and no other that acts."""
    own = f"{refused.candidate.name}."
    rests = any(p.at_bound for p in refused.fit.parameters if p.name.startswith(own))
    more = len(refused.candidate.estimated) > len(best.candidate.estimated)
    unit = refused.candidate.effect.sizes[0].unit == best.candidate.effect.sizes[0].unit
    return rests and more and unit and refused.candidate.site == best.candidate.site


def _is_likelier_part(refused: Proof, best: Proof) -> bool:
    """Whether the best law is the sum of another one and something besides, and yet less likely than that
    alone: what it owes to the other part belongs to a third effect that the model lacks, too."""
    one, other = refused.candidate, best.candidate
    is_part = one.effect.name in other.effect.sum_of and one.site == other.site
    return is_part and refused.delta_bic > best.delta_bic + GATES.same_bic


def _is_torn(refused: Proof, best: Proof) -> bool:
    """Whether predictions of unseen data speak against a law, and their simulation, those over the longest
    horizon, or their likelihood do not: that is better than the best law's, or as good."""
    if not any(is_worse(one) for one in refused.ahead):
        return False
    is_longer = _unseen_ratio(best, refused) < GATES.max_rival_error or _lasts(best, refused)
    return is_longer or _is_confirmed_more(refused, best)


def _is_confirmed_more(refused: Proof, best: Proof) -> bool:
    """Whether a law makes unseen data clearly likelier, and likelier than the best one does. How likely a
    best law makes their predictions is not known where its simulation shows it: one that simulates unseen
    data clearly worse is not confirmed more than that."""
    if best.is_by_use and _unseen_ratio(refused, best) < GATES.max_rival_error:
        return False
    is_clear = refused.confirmed.certainty > GATES.likelier_significance
    return is_clear and refused.confirmed.gain > best.confirmed.gain


def _lasts(best: Proof, refused: Proof) -> bool:
    """Whether a refused law simulates no output of unseen data clearly worse than the best one, and foresees
    them over the longest horizon better than the model without it."""
    if refused.adds_up or max(refused.ahead, key=lambda one: one.samples).ratio >= 1.0:
        return False
    ratios = error_ratios(best.told.simulated, refused.told.simulated)
    return bool(ratios) and max(ratios) <= 1.0 + GATES.clear_unseen_error


def _is_rival(one: Proof, best: Proof) -> bool:
    """Whether an accepted law is not put aside by the best one: it is as likely; or it foresees unseen data
    clearly better, which counts where the rest of the model is not right either; or predictions speak for it
    by more than simulations do for the best one. One that goes beyond the best by parameters that nobody
    knows is a rival where they make it likelier, since without them it is the best one, which no data could
    tell it from; or as likely, if unseen data are simulated far better: then it is another one. A law that is
    better in one output and worse in another is missing besides."""
    if _is_of_the_kink(one, best):
        return False
    if _is_vague(one, best):
        return _bic(one) > _bic(best) or _is_far_nearer(one, best)
    return (
        abs(_bic(best) - _bic(one)) <= GATES.same_bic
        or _unseen_ratio(best, one) < GATES.max_rival_error
        or _is_as_good(best, one)
        or _is_foretold_better(one, best)
    )


def _is_foretold_better(one: Proof, best: Proof) -> bool:
    """Whether a law, of two that their simulations show, is so much likelier beside loads that it is clearly
    ahead by both together, for the price of its parameters: an outlet that takes a parameter's drift along
    simulates better than the constant flow that is there, and predicts worse."""
    if not (one.is_by_use and best.is_by_use) or one.in_use.piece or best.in_use.piece:
        return False
    beside = one.fit.log_likelihood - best.fit.log_likelihood
    used = one.delta_log_likelihood - best.delta_log_likelihood
    price = 2.0 * used - (one.delta_bic - best.delta_bic)
    return 2.0 * (beside + used) - price >= GATES.min_bic_gain


def _is_far_nearer(one: Proof, best: Proof) -> bool:
    """Whether a law is as likely as the best one, and simulates unseen data far better."""
    is_as_likely = abs(_bic(best) - _bic(one)) <= GATES.same_bic
    return is_as_likely and _unseen_ratio(best, one) < GATES.max_told_ratio


def _is_contradicted(best: Proof, one: Proof) -> bool:
    """Whether unseen data speak against the best law, not against the other, make that the likelier of both,
    and are simulated no worse by it: an outlet had bent to what a leak does in the recordings alone."""
    against, other = (p.confirmed.certainty < -GATES.likelier_significance for p in (best, one))
    gain = one.confirmed.gain - best.confirmed.gain
    is_likelier = gain > _bic(best) - _bic(one) and _unseen_ratio(best, one) <= 1.0
    return against and not other and is_likelier


def _is_as_good(best: Proof, one: Proof) -> bool:
    """Whether another law with as many parameters foresees unseen data as well, in every output or in the
    mean over them, and is not very much less likely: the drift of a sensor and a constant load on a body
    that turns freely."""
    is_other = best.candidate.effect.class_name != one.candidate.effect.class_name
    if not is_other or len(_own_sizes(best)) != len(_own_sizes(one)):
        return False
    is_near = abs(_bic(best) - _bic(one)) <= GATES.min_bic_gain
    return is_near and (_is_foreseen_alike(best, one) or _foresees_more(best, one))


def _foresees_more(best: Proof, one: Proof) -> bool:
    """Whether the simulation of unseen data is no worse with another law in the mean of the logarithms over
    the outputs: they would make that the likelier one. One that adds up counts where nothing else is
    known."""
    ratios = error_ratios(best.told.simulated, one.told.simulated)
    is_known = bool(ratios) and bool(np.all(np.isfinite(ratios))) and min(ratios) > 0.0
    is_told = is_known and not (one.adds_up and ahead_of(best.ahead, one.ahead))
    return is_told and float(np.mean(np.log(ratios))) <= 0.0


def _is_foreseen_alike(best: Proof, one: Proof) -> bool:
    """Whether two laws have the same errors on unseen data, in every output or at every horizon."""
    if one.adds_up:
        ratios = list(ahead_of(best.ahead, one.ahead).values())
    else:
        ratios = list(error_ratios(best.told.simulated, one.told.simulated))
    return bool(ratios) and all(abs(r - 1.0) <= GATES.same_unseen_error for r in ratios)


def _is_as_likely(refused: Proof, best: Proof) -> bool:
    """Whether a law is refused for nothing but how much of the load it leaves, while it is as likely as the
    best one, foresees unseen data alike and takes a good part of what that takes: which of them is on the
    other side of the limit is chance."""
    return (
        refused.takes_little
        and refused.explained >= GATES.min_as_explained * best.explained
        and _bic(refused) >= _bic(best) - GATES.same_bic
        and _is_foreseen_alike(best, refused)
    )


def ahead_of(best: Sequence[Ahead], one: Sequence[Ahead]) -> dict[int, float]:
    """Errors of predictions of unseen data relative to those of the best law, by horizon in samples, where
    both are known."""
    known = {a.samples: a.ratio for a in best}
    return {a.samples: a.ratio / known[a.samples] for a in one if a.samples in known}


def _unseen_ratio(best: Proof, one: Proof) -> float:
    """Error of `one` on unseen data relative to that of `best`: of the whole simulation, or of predictions at
    the longest horizon where the simulation is dead reckoning. inf where it is unknown, or an output gets
    worse. A law that is better by no more than a constant load is not better: where it is known, that with
    one counts (`with_steady_error`)."""
    if one.adds_up:
        ahead = ahead_of(best.ahead, one.ahead)
        return ahead[max(ahead)] if ahead else np.inf
    ratios = error_ratios(best.told.simulated, one.told.simulated)
    if not ratios or max(ratios) > 1.0 + GATES.same_unseen_error:
        return np.inf
    whole = float(np.sqrt(np.mean(np.square(ratios))))
    if best.steady_error and one.steady_error is not None:
        return max(whole, one.steady_error / best.steady_error)
    return whole


def _is_vague(richer: Proof, simple: Proof) -> bool:
    """Whether a law at the place of a simple one goes beyond it by parameters of which the data leave one
    undetermined: it may stand for the way in which the simple law is rounded."""
    known = {p.name.rpartition(".")[2] for p in _own_sizes(simple)}
    more = [p for p in _own_sizes(richer) if p.name.rpartition(".")[2] not in known]
    return (
        richer.candidate.site == simple.candidate.site
        and len(_own_sizes(richer)) > len(known)
        and simple.delta_log_likelihood > GATES.min_vague_gain * richer.delta_log_likelihood
        and any(p.at_bound or abs(p.value) < GATES.min_significance * (p.std_error or np.inf) for p in more)
    )


def _is_of_the_kink(richer: Proof, simple: Proof) -> bool:
    """Whether a law at the place of a simple one for the same quantity has its form within what its own kink
    is rounded over: it says how the kink is, which is sharper than either is rounded, and no more."""
    gains_enough = simple.delta_log_likelihood > GATES.min_kinked_gain * richer.delta_log_likelihood
    return gains_enough and may_be_of_the_kink(richer, simple.candidate)


def _is_rounded_otherwise(simple: Proof, best: Proof) -> bool:
    """Whether a law that is refused, or less likely, may be so for nothing but how its kink is rounded."""
    least = GATES.min_kinked_gain if simple.verdict == "rejected" else GATES.min_doubted_gain
    gains_enough = simple.delta_log_likelihood > least * best.delta_log_likelihood
    return gains_enough and may_be_of_the_kink(best, simple.candidate)


def _is_bent_otherwise(one: Proof, best: Proof) -> bool:
    """Whether another accepted law bends the same signal and gains nearly as much as the best one, whose kink
    is rounded over so much of where it lies that a smooth bend is seen, and no kink: a thrust that goes with
    the square of a command is as well a dead zone with wide corners."""
    law = best.candidate
    bends = law.is_of_signal and not law.is_dynamic and not one.candidate.is_dynamic
    if one is best or not bends or one.candidate.site != law.site:
        return False
    gains_enough = one.delta_log_likelihood > GATES.min_kinked_gain * best.delta_log_likelihood
    theta, own = best.told.theta, law.effect.parameters
    values = {p.name: abs(theta.get(f"{law.name}.{p.name}", np.nan)) for p in own}
    ranges = [values[p.name] for p in own if p.role != "sharpness" and p.signal_unit == "u"]
    kinks = [values[p.name] for p in own if p.role == "sharpness"]
    return gains_enough and any(k > GATES.max_seen_kink * r for k in kinks for r in ranges)


def may_be_of_the_kink(richer: Proof, simple: Candidate) -> bool:
    one = richer.candidate
    is_beyond = len(one.estimated) > len(simple.estimated)
    is_alike = one.site == simple.site and one.effect.sizes[0].unit == simple.effect.sizes[0].unit
    return is_beyond and is_alike and _has_form_in_kink(richer)


def _has_form_in_kink(proof: Proof) -> bool:
    effect, theta = proof.candidate.effect, proof.told.theta
    value = {p.name: theta.get(f"{proof.candidate.name}.{p.name}", np.nan) for p in effect.parameters}
    kinks = {p.scale_of: value[p.name] for p in effect.parameters if p.role == "sharpness"}
    forms = [p for p in scaled_shapes(proof.candidate) if p.scale_of in kinks]
    return any(abs(value[p.name]) < GATES.max_form_in_kink * kinks[p.scale_of] for p in forms)


def _own_sizes(proof: Proof) -> list[FittedParameter]:
    """The parameters of a law, but for sizes that are all that there can be: they were no choice."""
    whole = _whole_sizes(proof)
    own = f"{proof.candidate.name}."
    return [p for p in proof.fit.parameters if p.name.startswith(own) and p not in whole]


def _whole_sizes(proof: Proof) -> list[FittedParameter]:
    """Sizes that are all that there can be as far as the data tell, and far from nothing: all of an excess is
    cut."""
    fitted = {p.name: p for p in proof.fit.parameters}
    sizes = ((fitted.get(f"{proof.candidate.name}.{p.name}"), p) for p in proof.candidate.effect.sizes)
    return [p for p, declared in sizes if p is not None and _is_whole(p, declared)]


def _is_whole(size: FittedParameter, declared: EffectParameter) -> bool:
    if declared.max is None or size.at_bound == "max":
        return declared.max is not None
    error = GATES.min_significance * (size.std_error or np.inf)
    return declared.max - size.value <= error < size.value - (declared.null or 0.0)


def _bic(proof: Proof) -> float:
    """The BIC gain of a law beside others: with sizes that are all that there can be held there, which costs
    the likelihood half of the square of their distance in standard errors."""
    whole = _whole_sizes(proof)
    if not whole or not proof.candidate.n_unknowns:
        return proof.delta_bic
    each = (2.0 * proof.delta_log_likelihood - proof.delta_bic) / proof.candidate.n_unknowns
    maxima = {f"{proof.candidate.name}.{p.name}": p.max for p in proof.candidate.effect.sizes}
    return proof.delta_bic + sum(each - _distance(p, maxima[p.name]) ** 2 for p in whole)


def _distance(size: FittedParameter, maximum: float | None) -> float:
    """Standard errors between a size and the largest there can be."""
    if size.at_bound or maximum is None or not size.std_error:
        return 0.0
    return (maximum - size.value) / size.std_error


def _simplest(accepted: Sequence[Proof]) -> Proof:
    """The best by BIC, or one at the same place with fewer parameters that gains nearly as much: with much
    data, the way in which a law is rounded is significant, too (`_is_of_the_kink`). Of laws that are the same
    on these data, the one with the fewest parameters of any kind, and then with the fewest connectors: what
    runs over is lost, as long as nothing tells where it goes."""
    same = [p for p in accepted if p is accepted[0] or _is_same_equation(p, accepted[0])]
    best = min(same, key=lambda p: (len(p.candidate.effect.parameters), len(p.candidate.effect.connectors)))
    simpler = [
        p
        for p in accepted
        if _is_same_beside_a_load(best, p)
        or _is_of_the_kink(best, p)
        or (
            p.candidate.site == best.candidate.site
            and _n_chosen(p) < _n_chosen(best)
            and (
                p.delta_log_likelihood > GATES.min_simpler_gain * best.delta_log_likelihood
                or _is_vague(best, p)
                or _is_contradicted(best, p)
            )
        )
    ]
    return min(simpler, key=_n_chosen, default=best)


def _n_chosen(proof: Proof) -> int:
    """How many parameters a fit with a law had to choose."""
    return len(proof.fit.parameters) - len(_whole_sizes(proof))


def leader_of(proofs: Sequence[Proof]) -> Proof | None:
    """The most likely candidate that is supported."""
    supported = [p for p in proofs if p.verdict == "supported"]
    return max(supported, key=lambda p: p.fit.log_likelihood, default=None)


def is_settled(proofs: Sequence[Proof]) -> bool:
    """Whether the best candidate is accepted and leaves little that follows a variable."""
    best = best_accepted(proofs)
    if best is None or best.left is None:
        return False
    return not is_significant(best.left, best.delta_log_likelihood)


def most_likely(proofs: Sequence[Proof]) -> Proof | None:
    return max(
        (p for p in proofs if p.delta_bic > GATES.min_bic_gain), key=lambda p: p.delta_bic, default=None
    )


def best_start(proofs: Sequence[Proof]) -> Proof | None:
    """The candidate from which a richer law would start: the best accepted one, or the most likely of those
    that say too little."""
    return best_accepted(proofs) or most_likely(proofs)


def errors_last(proof: Proof) -> bool:
    """Whether what a simulation of unseen data leaves lasts: something else is missing, or acts besides."""
    return most_lasting(proof.told.simulated)[1] >= GATES.told_rest


def leaves_something(proof: Proof) -> bool:
    """Whether the rest of the load follows a variable a little more than by chance: a richer law may do."""
    return proof.left is None or proof.left.p_value < GATES.richer_level
