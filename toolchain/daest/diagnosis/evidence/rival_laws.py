"""Rivals of the best law: what the data do not put aside beside it, and what says no more than it."""

from __future__ import annotations

import numpy as np

from daest.diagnosis.evidence.law_values import (
    agree,
    ahead_of,
    bic_beside,
    is_less_known,
    is_size,
    is_undetermined,
    open_shapes,
    own_sizes,
    told_of_effect,
    unseen_ratio,
)
from daest.diagnosis.gates import GATES
from daest.diagnosis.screening.candidates import scaled_shapes
from daest.model.diagnosis import Candidate, Proof
from daest.model.fit import error_ratios


def may_be_instead(one: Proof, best: Proof) -> bool:
    """Whether an accepted law is not put aside by the best one."""
    return _is_rival(one, best) or _is_bent_otherwise(one, best)


def is_doubted(one: Proof, best: Proof) -> bool:
    """Whether a law, also one that is refused, may be behind the best one for nothing that tells them apart:
    how its kink is rounded, how much of the load it leaves by chance, or a parameter that is nearly zero."""
    return (
        _is_rounded_otherwise(one, best)
        or _is_as_likely(one, best)
        or _is_at_limit(best, one)
        or _is_hardly_less(one, best)
    )


def _is_at_limit(rich: Proof, plain: Proof) -> bool:
    """Whether the shapes of a law are within a standard error of nothing, and another law without one, of the
    same size, gains much of what it does: a spring whose loop closes within no length is dry friction, which
    holds at rest better than one whose kink is rounded."""
    unknown = open_shapes(rich)
    sizes = [p for p in told_of_effect(rich) if p not in unknown]
    plain_sizes = told_of_effect(plain)
    if not unknown or len(sizes) != 1 or len(plain_sizes) != 1 or not is_size(rich, sizes[0]):
        return False
    is_same = sizes[0].unit == plain_sizes[0].unit and agree(sizes[0], plain_sizes[0])
    return is_same and plain.delta_log_likelihood > GATES.min_doubted_gain * rich.delta_log_likelihood


def is_idle(rich: Proof, best: Proof) -> bool:
    """Whether a law has more parameters than the best one, of them shapes within a standard error of nothing,
    and is no likelier: a soft coupling without damping is an inductance in front of it."""
    is_richer = len(rich.candidate.estimated) > len(best.candidate.estimated)
    more = rich.delta_log_likelihood - best.delta_log_likelihood
    return is_richer and bool(open_shapes(rich)) and more < GATES.same_bic / 2.0


def _is_hardly_less(simple: Proof, best: Proof) -> bool:
    """Whether an accepted law with fewer parameters gains nearly what the best one does, which is ahead by no
    more than a length or a time of it that is hardly off zero may gain: a soft coupling whose damping is over
    within microseconds is the inductance in front of it, and whatever else is a little wrong may ask for
    that."""
    if simple.verdict == "rejected" or len(simple.candidate.estimated) >= len(best.candidate.estimated):
        return False
    ahead = best.delta_log_likelihood - simple.delta_log_likelihood
    most = min(
        GATES.min_leading_significance**2 / 2.0,
        (1.0 - GATES.min_simpler_gain) * best.delta_log_likelihood,
    )
    return ahead < most and bool(open_shapes(best, GATES.min_leading_significance))


def _is_rival(one: Proof, best: Proof) -> bool:
    """Whether an accepted law is not put aside by the best one: it is as likely; or it foresees unseen data
    clearly better, which counts where the rest of the model is not right either; or predictions speak for it
    by more than simulations do for the best one. One that goes beyond the best by parameters that nobody
    knows is a rival where they make it likelier, since without them it is the best one, which no data could
    tell it from; or as likely, if unseen data are simulated far better: then it is another one. A law that is
    better in one output and worse in another is missing besides."""
    if is_of_the_kink(one, best):
        return False
    if is_vague(one, best):
        return bic_beside(one) > bic_beside(best) or is_far_nearer(one, best)
    return (
        abs(bic_beside(best) - bic_beside(one)) <= GATES.same_bic
        or unseen_ratio(best, one) < GATES.max_rival_error
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


def is_far_nearer(one: Proof, best: Proof) -> bool:
    """Whether a law is as likely as the best one, and simulates unseen data far better."""
    is_as_likely = abs(bic_beside(best) - bic_beside(one)) <= GATES.same_bic
    return is_as_likely and unseen_ratio(best, one) < GATES.max_told_ratio


def is_contradicted(best: Proof, one: Proof) -> bool:
    """Whether unseen data speak against the best law, not against the other, make that the likelier of both,
    and are simulated no worse by it: an outlet had bent to what a leak does in the recordings alone."""
    against, other = (p.confirmed.certainty < -GATES.likelier_significance for p in (best, one))
    gain = one.confirmed.gain - best.confirmed.gain
    is_likelier = gain > bic_beside(best) - bic_beside(one) and unseen_ratio(best, one) <= 1.0
    return against and not other and is_likelier


def _is_as_good(best: Proof, one: Proof) -> bool:
    """Whether another law with as many parameters foresees unseen data as well, in every output or in the
    mean over them, and is not very much less likely: the drift of a sensor and a constant load on a body
    that turns freely."""
    is_other = best.candidate.effect.class_name != one.candidate.effect.class_name
    if not is_other or len(own_sizes(best)) != len(own_sizes(one)):
        return False
    is_near = abs(bic_beside(best) - bic_beside(one)) <= GATES.min_bic_gain
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
        and bic_beside(refused) >= bic_beside(best) - GATES.same_bic
        and _is_foreseen_alike(best, refused)
    )


def is_vague(richer: Proof, simple: Proof) -> bool:
    """Whether a law at the place of a simple one goes beyond it by parameters of which the data leave one
    undetermined: it may stand for the way in which the simple law is rounded. Where no size of it is known
    in what is told, but by its ratio to a parameter of the model, and the simple law's is, it speaks no more
    against that than a law that is refused: a spring that relaxes does much of what dry friction does."""
    known = {p.name.rpartition(".")[2] for p in own_sizes(simple)}
    more = [p for p in own_sizes(richer) if p.name.rpartition(".")[2] not in known]
    if richer.candidate.site != simple.candidate.site or len(own_sizes(richer)) <= len(known):
        return False
    is_blurred = is_less_known(richer, simple)
    least = GATES.min_refused_gain if is_blurred else GATES.min_vague_gain
    gains_enough = simple.delta_log_likelihood > least * richer.delta_log_likelihood
    return gains_enough and (is_blurred or any(map(is_undetermined, more)))


def is_of_the_kink(richer: Proof, simple: Proof) -> bool:
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
    """Whether a law may say how the kink of a simple one is, which has one and is no sum of others: an outlet
    that is free from its first drop on is no constant flow, and friction in one direction, which holds a
    constant load, none that a bump at rest comes down to."""
    one = richer.candidate
    is_beyond = len(one.estimated) > len(simple.estimated)
    is_alike = one.site == simple.site and one.effect.sizes[0].unit == simple.effect.sizes[0].unit
    has_kink = any(p.role == "sharpness" for p in simple.effect.parameters)
    is_plain = has_kink and not simple.effect.sum_of
    return is_beyond and is_alike and is_plain and _has_form_in_kink(richer)


def _has_form_in_kink(proof: Proof) -> bool:
    effect, theta = proof.candidate.effect, proof.told.theta
    value = {p.name: theta.get(f"{proof.candidate.name}.{p.name}", np.nan) for p in effect.parameters}
    kinks = {p.scale_of: value[p.name] for p in effect.parameters if p.role == "sharpness"}
    forms = [p for p in scaled_shapes(proof.candidate) if p.scale_of in kinks]
    return any(abs(value[p.name]) < GATES.max_form_in_kink * kinks[p.scale_of] for p in forms)
