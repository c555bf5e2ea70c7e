"""Laws that are refused beside others: what imitates a simpler one, and what is far behind a refused one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from daest.diagnosis.built_in.settled import LOST
from daest.diagnosis.evidence.law_values import (
    is_less_known,
    is_simpler,
    leaves_load_and_errors,
    unseen_ratio,
)
from daest.diagnosis.evidence.reasons import NO_BEND, NOT_SIGNIFICANT, STRAIGHT
from daest.diagnosis.evidence.same_laws import is_same_where_alike, is_where_alike
from daest.diagnosis.evidence.unseen import SIMULATED_WORSE, is_worse
from daest.diagnosis.gates import GATES
from daest.model.diagnosis import Proof
from daest.model.fit import error_ratios


def refuse(proof: Proof, reason: str) -> Proof:
    return replace(proof, verdict="rejected", reason=reason)


def without_imitations(proofs: Sequence[Proof]) -> list[Proof]:
    """Laws with states are refused that say no more than a simpler lag or delay which is too short to be told
    from others, or only comes near: a flexible part with three parameters imitates the lag of a sensor; and
    any law that says less than such a one with no more parameters; one with states and more parameters also
    where it says a little more, and unseen data are simulated alike. So is a lag with which unseen data are
    simulated far worse than with another one that is too short: a part that swings is neither. And a law with
    states of a signal that says no more than a lag there whose time nobody knows: a limit of its rate."""
    lags, result = [p for p in proofs if p.is_any_dynamics or p.comes_near], []
    unknown = [p for p in proofs if _is_unknown_lag(p)]
    for proof in proofs:
        there = [p for p in unknown if p.candidate.site == proof.candidate.site and p is not proof]
        imitated = (*lags, *there) if proof.candidate.effect.n_states else lags
        simpler = [p for p in imitated if is_simpler(p.candidate, proof.candidate)]
        more = GATES.same_bic if proof.candidate.effect.n_states else -GATES.same_bic
        same = next(
            (p for p in simpler if _bic_as_of(p, proof) <= p.delta_bic + more or _comes_as_near(p, proof)),
            None,
        )
        if proof.verdict != "rejected" and same is not None:
            fewer = len(same.candidate.estimated) < len(proof.candidate.estimated)
            how = " with fewer parameters" if fewer else ""
            much = "as much" if more > 0.0 else "more"
            much = much if _bic_as_of(same, proof) <= same.delta_bic + more else "nearly as much"
            reason = f"{same.candidate.label} says {much}{how}, but {same.reason}"
            is_such = same.is_any_dynamics and not fewer and abs(proof.delta_bic - same.delta_bic) <= more
            proof = replace(proof, verdict="rejected", reason=reason, is_any_dynamics=is_such)
        nearer = next((p for p in lags if _is_lag_far_nearer(p, proof)), None)
        if proof.verdict != "rejected" and nearer is not None:
            reason = f"{nearer.candidate.label} simulates unseen data far better, but {nearer.reason}"
            proof = refuse(proof, reason)
        result.append(proof)
    return result


def _comes_as_near(lag: Proof, law: Proof) -> bool:
    """Whether a law of a place, with states and more parameters, gains little beyond a lag that is too short
    to be told from others, and simulates no output of unseen data clearly better: with three parameters a
    part that swings takes a little of what the lag leaves, too."""
    if law.candidate.is_of_signal or not law.candidate.effect.n_states or not lag.is_any_dynamics:
        return False
    is_near = lag.delta_log_likelihood >= GATES.min_imitated_gain * _gain_as_of(lag, law)
    is_alike = _simulates_no_better(law, lag)
    return is_near and is_alike and len(lag.candidate.estimated) < len(law.candidate.estimated)


def _simulates_no_better(law: Proof, lag: Proof) -> bool:
    """Whether a law simulates no output of unseen data clearly better than a lag."""
    ratios = error_ratios(lag.told.simulated, law.told.simulated)
    return bool(ratios) and min(ratios) >= GATES.max_rival_error


def _gain_as_of(lag: Proof, law: Proof) -> float:
    """What a law gains in log-likelihood, by the evidence that the gain of a lag is of: of a law that its
    simulation shows, and a lag that was not accepted by that and simulates as well, what each gains beside
    loads."""
    if not law.is_by_use or lag.is_by_use or not _simulates_no_better(law, lag):
        return law.delta_log_likelihood
    return lag.delta_log_likelihood + law.fit.log_likelihood - lag.fit.log_likelihood


def _bic_as_of(lag: Proof, law: Proof) -> float:
    """The BIC gain of a law by the evidence that the gain of a lag is of (`_gain_as_of`)."""
    more = _gain_as_of(lag, law) - law.delta_log_likelihood
    if not more:
        return law.delta_bic
    per_unknown = (2.0 * lag.delta_log_likelihood - lag.delta_bic) / lag.candidate.n_unknowns
    return 2.0 * _gain_as_of(lag, law) - law.candidate.n_unknowns * per_unknown


def without_outrun(proofs: Sequence[Proof]) -> list[Proof]:
    """Laws that leave the load as it was and errors that last are refused where one at their place with no
    more parameters takes the load, and simulates unseen data far better, though the likelihood beside a load
    shows nothing of it: a slow load is as good as a constant torque, and a ripple that is not there then says
    more than that."""
    taking = [p for p in proofs if _takes_load_unseen(p)]
    result = []
    for proof in proofs:
        outrunning = [p for p in taking if _outruns(p, proof)]
        nearer = min(outrunning, key=partial(unseen_ratio, proof), default=None)
        if proof.verdict != "rejected" and nearer is not None:
            label = nearer.candidate.label
            reason = f"{label} takes the load, and simulates unseen data far better, but {nearer.reason}"
            proof = refuse(proof, reason)
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


def without_hopeless(proofs: Sequence[Proof]) -> list[Proof]:
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
            proof = refuse(proof, reason)
        better = next((p for p in seen if _is_better_both_ways(p, proof)), None)
        if proof.verdict != "rejected" and proof.is_by_use and better is not None:
            reason = f"{better.candidate.label} is likelier beside loads, and simulates unseen data better"
            proof = refuse(proof, reason)
        result.append(proof)
    return result


def _is_better_both_ways(one: Proof, other: Proof) -> bool:
    """Whether a law is clearly likelier than another one beside loads, and simulates every output of unseen
    data clearly better."""
    ratios = error_ratios(other.told.simulated, one.told.simulated)
    is_likelier = one.fit.log_likelihood > other.fit.log_likelihood + GATES.min_richer_gain
    return is_likelier and bool(ratios) and max(ratios) < GATES.max_rival_error


def what_refuses_all(order: Sequence[Proof], best: Proof) -> str:
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
        and unseen_ratio(best, p) < 1.0
    ]
    return min(better, key=lambda p: unseen_ratio(best, p), default=None)


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
        refused.explained >= GATES.min_explained or unseen_ratio(best, refused) < GATES.max_rival_error
    )
    if not (refused.is_open or (refused.is_vague and does_more)) or _ends_in_a_simpler_law(refused, best):
        return False
    if is_same_where_alike(refused, best) or is_straight_there(refused, best):
        return False
    # Of a law that shows too little of its form the data say nothing but that something small is left.
    if not refused.is_known and best.explained >= GATES.all_explained:
        return False
    return _is_likelier_part(refused, best) or not unseen_ratio(refused, best) < GATES.max_rival_error


def is_straight_there(refused: Proof, best: Proof) -> bool:
    """Whether a law that the recordings show without its bend stands where the best one is a gain or an
    offset: it is both together, and so speaks for either and for no other law."""
    is_straight = refused.reason.startswith(NO_BEND) and best.candidate.effect.class_name in STRAIGHT
    return is_straight and refused.candidate.site == best.candidate.site


def _ends_in_a_simpler_law(refused: Proof, best: Proof) -> bool:
    """Whether a law with more parameters at the place of the best one, or where the sensors see it alike, has
    come to a bound of one of them: it is the same law there, rounded otherwise, and no other that acts."""
    own = f"{refused.candidate.name}."
    rests = any(p.at_bound for p in refused.fit.parameters if p.name.startswith(own))
    more = len(refused.candidate.estimated) > len(best.candidate.estimated)
    unit = refused.candidate.effect.sizes[0].unit == best.candidate.effect.sizes[0].unit
    is_there = refused.candidate.site == best.candidate.site or is_where_alike(refused, best)
    return rests and more and unit and is_there


def _is_likelier_part(refused: Proof, best: Proof) -> bool:
    """Whether the best law is the sum of another one and something besides, and yet less likely than that
    alone: what it owes to the other part belongs to a third effect that the model lacks, too."""
    one, other = refused.candidate, best.candidate
    is_part = one.effect.name in other.effect.sum_of and one.site == other.site
    return is_part and refused.delta_bic > best.delta_bic + GATES.same_bic


def _is_torn(refused: Proof, best: Proof) -> bool:
    """Whether predictions of unseen data speak against a law, and their simulation, those over the longest
    horizon, or their likelihood do not: that is better than the best law's, or as good. Where nothing but
    their whole simulation speaks against it, which adds up what is missing besides, their likelihood may
    contradict that, too. Not where none of its sizes is known, and the best law's is."""
    if is_less_known(refused, best):
        return False
    if not any(is_worse(one) for one in refused.ahead):
        return refused.reason.startswith(SIMULATED_WORSE) and _is_confirmed_more(refused, best)
    is_longer = unseen_ratio(best, refused) < GATES.max_rival_error or _lasts(best, refused)
    return is_longer or _is_confirmed_more(refused, best)


def _is_confirmed_more(refused: Proof, best: Proof) -> bool:
    """Whether a law makes unseen data clearly likelier, and likelier than the best one does. How likely a
    best law makes their predictions is not known where its simulation shows it: one that simulates unseen
    data clearly worse is not confirmed more than that."""
    if best.is_by_use and unseen_ratio(refused, best) < GATES.max_rival_error:
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
