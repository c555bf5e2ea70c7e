"""The verdict: one of a closed list, with the sentence that says why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain

from daest.diagnosis.answers.decided import OTHER_AMPLITUDES, Decided, Evidence, error_ratio, listed
from daest.diagnosis.answers.held_values import OtherValue
from daest.diagnosis.answers.nothing import nothing_missing
from daest.diagnosis.answers.parts import Parts
from daest.diagnosis.answers.told_laws import (
    certainty_told,
    errors_told,
    importance_told,
    left_by_set,
    spoilt,
    supported,
    told_of,
)
from daest.diagnosis.evidence.law_values import errors_last
from daest.diagnosis.evidence.noise_level import RECORDED
from daest.diagnosis.evidence.ranking import is_settled
from daest.diagnosis.evidence.reasons import is_significant, told_values
from daest.diagnosis.evidence.unseen import is_better, is_worse
from daest.diagnosis.gates import GATES
from daest.diagnosis.recordings.recorded_late import EarlierInputs
from daest.diagnosis.screening.scores import promising_pairs
from daest.model.diagnosis import (
    Proof,
    Screen,
    Unproved,
)
from daest.model.effects import Domain
from daest.model.fit import Agreement, FitResult

MEASURED: dict[Domain, str] = {  # what could be measured between two places
    "rotational": "an angle, a speed or a torque",
    "translational": "a motion or a force",
    "electrical": "a voltage or a current",
    "thermal": "a temperature or a flow of heat",
    "hydraulic": "a pressure or a flow",
    "amount": "an amount, a concentration or a rate",
}
MOVING = (
    "Validate with data in which the machine moves: another share of the recording (--split), a part of it "
    "(--from, --to), or another recording."
)
BESIDE_SENSOR = "Calibrate the sensor, or measure the same quantity by another one."
STEP_SIZES = "Drive `{name}` by steps of several sizes: a limited rate takes longer for larger ones."
EARLIER = (
    "The recording is likelier, by {gain:.0f} in log-likelihood, if {names} {time} before they are "
    "recorded: no law comes before its cause, and none says more."
)
AT_ONCE = (
    "Find out whether the logger writes an input at the end of the interval in which it acts; if so, shift "
    "its column up by one row."
)
SOONER = (
    "Find out whether the clocks of all columns agree, and how late the sensor of {names} is; if it is, "
    "shift the column by as much, {time}."
)
ADD_PARTS = (
    "Add both to the model (daest extend) and diagnose it again: neither is the answer without the other."
)
SPOILT = (
    "Look at what else acts on {name}, and at the given values there; daest improve goes on with the law and "
    "looks for what is missing besides."
)
LARGER = "Record again with larger amplitudes, which show more of the form of the law."


def decide(evidence: Evidence) -> Decided:
    """The verdict, with the proofs as it leaves them. A claim needs a candidate that passed every gate of the
    proof, unseen data in which something moves, and no leader of the screen that could not be tried."""
    if evidence.still:
        rejected = tuple(_refused(p, evidence.still) for p in evidence.proofs)
        decided = decide(replace(evidence, proofs=rejected, still=""))
        return decided if rejected == evidence.proofs else replace(decided, next_experiment=MOVING)
    if evidence.earlier.gain:
        return _beside_earlier(evidence)
    accepted = [p for p in evidence.proofs if p.verdict != "rejected"]
    leader = _untried_leader(evidence, accepted)
    if accepted and leader is not None:
        why, how = _says_more(leader), _by_hand(evidence, leader)
        return _beside(evidence, accepted, leader.candidate.label, why, how)
    better = _far_better(evidence, accepted)
    if better is not None:
        return _beside(evidence, accepted, better.candidate.label, _explains_more(evidence, better), LARGER)
    taking = _takes_and_simulates(evidence, accepted)
    if taking is not None:
        decided = _beside(evidence, accepted, taking.candidate.label, _takes_more(evidence, taking), LARGER)
        # None of them goes into a model: `improve` would go on with what simulates far worse.
        proofs = tuple(_refused(p, _taken_by(evidence, taking)) for p in evidence.proofs)
        return replace(decided, proofs=proofs)
    decided = _decided(evidence, accepted, leader)
    return replace(decided, proofs=decided.proofs or evidence.proofs)


def _refused(proof: Proof, reason: str) -> Proof:
    return proof if proof.verdict == "rejected" else replace(proof, verdict="rejected", reason=reason)


def _beside_earlier(evidence: Evidence) -> Decided:
    """The verdict where the inputs may act before they are recorded: no claim for what says no more than
    that, which takes no parameter."""
    earlier = evidence.earlier
    gain, names = earlier.gain, " and ".join(f"`{name}`" for name in earlier.names)
    if earlier.samples == 1:
        told, following = EARLIER.format(gain=gain, names="its inputs act", time="one sample"), AT_ONCE
    else:
        time = f"{earlier.seconds:.3g} {evidence.clock}"
        acts = f"{names} {'act' if len(earlier.names) > 1 else 'acts'}"
        told = EARLIER.format(gain=gain, names=acts, time=time)
        following = SOONER.format(names=names, time=time)
    says = f"inputs that act before they are recorded say as much (log-likelihood + {gain:.0f})"
    least = 2.0 * gain
    proofs = tuple(p if p.delta_bic > least else _refused(p, says) for p in evidence.proofs)
    decided = decide(replace(evidence, proofs=proofs, earlier=EarlierInputs()))
    if decided.name == "supported" or any(p.delta_bic > least for p in proofs):
        return decided
    if decided.name in ("nothing missing", "parameters off"):
        return replace(decided, message=f"{decided.message} {told}", next_experiment=following)
    return Decided("cannot tell", told, following, decided.proofs or proofs)


def _untried_leader(evidence: Evidence, accepted: Sequence[Proof]) -> Unproved | None:
    """A candidate whose refit failed, with a score that none of the accepted ones reaches: in the screen, or
    by far in its refit, which leaves nothing that follows a variable. A score s foresees a gain of s² / 2.
    One for which the time did not suffice may win with less: many refits go beyond what the screen foresees.
    """
    scores = {entry.candidate.name: entry.score for entry in evidence.screen.entries}
    best = max((scores.get(p.candidate.name, 0.0) for p in accepted), default=0.0)
    gained = max((p.delta_log_likelihood for p in accepted if is_settled([p])), default=0.0)
    failed = [
        u
        for u in evidence.unproved
        if u.has_failed and u.p_value < GATES.missing_level and (u.score > best or u.is_late)
        if u.score**2 / 2.0 > GATES.max_untried_promise * gained
    ]
    return max(failed, key=lambda u: u.score, default=None)


def _far_better(evidence: Evidence, accepted: Sequence[Proof]) -> Proof | None:
    """A rejected candidate beside which no accepted one is what is missing: the best of them has a small
    share of its likelihood gain alone, and foresees unseen data far worse, in a simulation or over some
    horizon; or it has hardly any share, and all of the accepted ones leave what follows a variable and lasts.
    In a whole simulation what is missing besides may add up to more than what either does."""
    if not accepted:
        return None
    gain = max(p.delta_bic for p in accepted)
    limit = GATES.max_told_ratio * min(error_ratio(evidence, p) for p in accepted)
    better = [
        p
        for p in evidence.proofs
        if p.verdict == "rejected"
        and gain < GATES.min_share_of_better * p.delta_bic
        and (
            error_ratio(evidence, p) < limit
            or _foresees_far_better(p, accepted)
            or (gain < GATES.min_share_of_refused * p.delta_bic and all(map(_leaves_much, accepted)))
        )
    ]
    return max(better, key=lambda p: p.delta_bic, default=None)


def _takes_and_simulates(evidence: Evidence, accepted: Sequence[Proof]) -> Proof | None:
    """A rejected candidate that gains likelihood, too, takes more of the load than twice what any of the
    accepted ones takes, and simulates unseen data far better than they: the best of them at that. What takes
    nothing of the load is likelier where a signal rests at one value: a sensor that saturates there says what
    friction does that holds a drive just short of its goal, and simulates none of its ways to it."""
    if not accepted:
        return None
    limit = GATES.max_told_ratio * min(error_ratio(evidence, p) for p in accepted)
    taken = max(p.explained for p in accepted)
    found = [
        p
        for p in evidence.proofs
        if p.verdict == "rejected"
        and p.is_known
        and p.delta_bic > GATES.min_bic_gain
        and taken < GATES.min_share_of_better * p.explained
        and error_ratio(evidence, p) < limit
    ]
    return min(found, key=lambda p: error_ratio(evidence, p), default=None)


def _leaves_much(proof: Proof) -> bool:
    """Whether what a law leaves of the loads follows a variable, and what its simulation leaves lasts."""
    if proof.left is None or proof.adds_up:
        return False
    return errors_last(proof) and is_significant(proof.left, proof.delta_log_likelihood)


def _foresees_far_better(proof: Proof, accepted: Sequence[Proof]) -> bool:
    """Whether predictions of unseen data are far better with a candidate than with any of the accepted ones
    over some horizon, and clearly worse than without it over none."""
    best = [_least_ahead(p) for p in accepted]
    return not any(map(is_worse, proof.ahead)) and _least_ahead(proof) < GATES.max_told_ratio * min(best)


def _least_ahead(proof: Proof) -> float:
    """The smallest error of predictions of unseen data, relative to that without the candidate, that is
    clearly smaller; 1 where none is."""
    return min((one.ratio for one in proof.ahead if is_better(one)), default=1.0)


def _beside(
    evidence: Evidence, accepted: Sequence[Proof], label: str, why: str, next_experiment: str
) -> Decided:
    """No claim for the accepted candidates beside the one called `label`, for the reason `why`."""
    names = listed(tuple(_named(p) for p in accepted))
    proofs = tuple(
        p
        if p.verdict == "rejected"
        else replace(p, verdict="not separable", not_separable_from=(*p.not_separable_from, label))
        for p in evidence.proofs
    )
    return Decided("cannot tell", f"{names} would do, but {why}.", next_experiment, proofs)


def _named(proof: Proof) -> str:
    """A law with the other names that it has on these recordings: of a speed that only falls, dry friction
    may stand behind gravity, and nobody looks for it there."""
    same = f" (here the same equation as {listed(proof.same_as)})" if proof.same_as else ""
    return f"{proof.candidate.label}{same}"


def _says_more(leader: Unproved) -> str:
    says = "may say as much" if leader.is_late else "says more in the screen"
    return f"{leader.candidate.label} {says} (p = {leader.p_value:.1g}), and {leader.reason}"


def _explains_more(evidence: Evidence, better: Proof) -> str:
    whole, ahead = error_ratio(evidence, better), _least_ahead(better)
    errors = f"error of unseen data times {whole:.2g}"
    if ahead < min(whole, 1.0):
        errors = f"error of predictions of unseen data times {ahead:.2g}"
    return (
        f"{better.candidate.label} explains far more (BIC gain {better.delta_bic:.3g}, {errors}), although "
        f"{better.reason}: the law that acts looks more like that one"
    )


def _takes_more(evidence: Evidence, taking: Proof) -> str:
    return f"{_taken_by(evidence, taking)}, although {taking.reason}"


def _taken_by(evidence: Evidence, taking: Proof) -> str:
    return (
        f"{taking.candidate.label} takes more of the unexplained load ({100 * taking.explained:.0f} %), and "
        f"simulates unseen data far better (error times {error_ratio(evidence, taking):.2g})"
    )


def _by_hand(evidence: Evidence, one: Unproved) -> str:
    if evidence.is_closed:
        return "Record again with smaller amplitudes, at which the model can be simulated with it."
    if one.is_late:
        return f"Run the same command again, which goes on with {one.candidate.label}, or give it more time."
    if one.is_present:
        return (
            "Estimate what the model has there with given values, too (estimate = true under [parameters] of "
            "daest.toml; --estimate alone would hold all others), and run again."
        )
    return (
        f"Add {one.candidate.label} to the model (daest extend) and identify it, from sizes that make "
        "sense in the machine."
    )


def _decided(evidence: Evidence, accepted: Sequence[Proof], leader: Unproved | None) -> Decided:
    if len(accepted) == 1:
        return (
            _as_well_inside(evidence, accepted[0])
            or _spoils(evidence, accepted[0])
            or Decided("supported", supported(evidence, accepted[0]))
        )
    if accepted:
        return _cannot_tell(evidence, accepted)
    if evidence.rest.is_explained(evidence) and not any(p.is_any_dynamics for p in evidence.proofs):
        return _contradicted(evidence) or nothing_missing(evidence)
    if leader is not None:
        return Decided(
            "cannot tell",
            f"Something is missing. {leader.candidate.label} leads the screen "
            f"(p = {leader.p_value:.1g}), but {leader.reason}.",
            _by_hand(evidence, leader),
        )
    return evidence.rest.verdict(evidence)


def _as_well_inside(evidence: Evidence, proof: Proof) -> Decided | None:
    """No claim for a law of a sensor that is the same equation as one in the machine before it, or for one of
    an input that is the same as others for steps of one size; None where it is none."""
    if not proof.inside:
        return None
    why = f"on these recordings it is the same equation as {proof.inside} ({told_values(proof)})"
    site = proof.candidate.site
    following = STEP_SIZES.format(name=site.name) if site.kind == "input" else BESIDE_SENSOR
    decided = _beside(evidence, [proof], proof.inside, why, following)
    told = errors_told(evidence, proof) + importance_told(evidence, proof) + certainty_told(evidence, proof)
    return replace(decided, message=decided.message + told)


def _spoils(evidence: Evidence, proof: Proof) -> Decided | None:
    """No claim for a law that takes errors from one output and gives them to another; None where it does not.
    It may stand for something else, or be one of two things that are wrong."""
    name, ratio = spoilt(evidence, proof)
    if not name:
        return None
    told = replace(
        proof, verdict="not separable", not_separable_from=(*proof.not_separable_from, f"what acts on {name}")
    )
    return Decided(
        "cannot tell",
        f"{proof.candidate.label} would do ({told_values(proof)}), but the simulation of {name} of unseen "
        f"data gets {ratio:.3g} times worse with it: something else is missing or off besides, or instead."
        + told_of(evidence, proof),
        SPOILT.format(name=name),
        tuple(told if p is proof else p for p in evidence.proofs),
    )


def beside_value(evidence: Evidence, decided: Decided, other: OtherValue) -> Decided:
    """What was `decided`, where `other` says as much as one of the accepted laws, and is another answer
    beside all of them: a parameter makes no claim of a law."""
    law = next(p for p in decided.proofs if p.verdict != "rejected")
    proofs = tuple(
        p
        if p.verdict == "rejected"
        else replace(
            p,
            verdict="not separable",
            not_separable_from=(*p.not_separable_from, other.answer),
            given_values=(*p.given_values, *other.given),
        )
        for p in decided.proofs
    )
    says = f"{other.answer}, says as much: {other.advice}."
    if decided.name != "supported":
        message = f"{decided.message} {says[0].upper()}{says[1:]}"
        return replace(decided, message=message, proofs=proofs)
    message = f"{law.candidate.label} would do ({told_values(law)}), but {says}" + told_of(evidence, law)
    return Decided("cannot tell", message, other.settled_by, proofs)


def beside_parts(evidence: Evidence, decided: Decided, law: Proof, parts: Parts) -> Decided:
    """What was `decided`, where the parts of an accepted law that is their sum are likelier than it, with
    sizes of their own: clearly, so that it only stands for them, or hardly."""
    if parts.puts_aside:
        better = f"explain the data better (BIC {parts.more:.0f})"
        told = replace(law, verdict="rejected", reason=f"{parts.text}, {better}", stands_for=parts.labels)
        message = (
            f"Both laws that {law.candidate.label} is the sum of seem to be missing, each with a size of its "
            f"own: {parts.told} {better}."
        )
        following = ADD_PARTS
    else:
        told = replace(law, verdict="not separable", not_separable_from=(*law.not_separable_from, parts.told))
        message = f"{law.candidate.label} would do ({told_values(law)}), but {parts.text}, say as much."
        message += told_of(evidence, law)
        following = OTHER_AMPLITUDES
    proofs = tuple(told if p is law else p for p in decided.proofs)
    if decided.name != "supported":
        return replace(decided, message=f"{decided.message} {message}", proofs=proofs)
    return Decided("cannot tell", message, following, proofs)


def two_alike(screen: Screen) -> str:
    """Effects of one kind at two places that say much more together than any effect alone, as dead zones of
    two drives of one kind; empty where there are none. An input and an output are no such parts: gains of
    both are a bend or a start in disguise."""
    for one, other in promising_pairs(screen):
        is_of_one_kind = one.candidate.effect is other.candidate.effect
        places = one.candidate.site, other.candidate.site
        if is_of_one_kind and places[0] != places[1] and places[0].kind == places[1].kind:
            return (
                f" {one.candidate.label} and {other.candidate.site.name} say much more together than any "
                "effect alone, as where two parts are alike: daest improve tries such pairs."
            )
    return ""


def _cannot_tell(evidence: Evidence, accepted: Sequence[Proof]) -> Decided:
    names = [_named(p) for p in accepted] + [p.inside for p in accepted if p.inside]
    differ = {p.candidate.site.name for p in accepted}
    is_mechanical = accepted[0].candidate.site.domain in ("rotational", "translational")
    separate = (
        "Run the machine slowly and at several constant speeds, and with amplitudes from small to large: "
        "friction, elasticity and play differ there most."
        if len(differ) == 1 and is_mechanical
        else OTHER_AMPLITUDES
        if len(differ) == 1 or evidence.is_closed
        else _to_tell_places(accepted)
    )
    return Decided(
        "cannot tell",
        f"One of {listed(tuple(names))} is missing; these data do not separate them."
        + left_by_set(evidence, accepted),
        separate,
    )


def _to_tell_places(accepted: Sequence[Proof]) -> str:
    """The measurement that tells laws at several places apart: of quantities of their domains; of sensors and
    actuators alone, that each is tried by itself."""
    # A place between two others is called by both, of which another law may sit at one.
    ends = chain.from_iterable(p.candidate.site.name.split(", ") for p in accepted)
    places = listed(tuple(dict.fromkeys(ends)))
    domains = dict.fromkeys(p.candidate.site.domain for p in accepted)
    known = [MEASURED[domain] for domain in domains if domain in MEASURED]
    if not known:
        return f"Try the sensors and actuators of {places} apart from the machine, one by one."
    return f"Measure {' or '.join(known)} between {places}."


def _contradicted(evidence: Evidence) -> Decided | None:
    """What is to be said where unseen data are both foreseen and simulated far worse than those of the fit,
    in which nothing is missing; None where they are not. An observer alone may take long to find the start of
    unseen data, and a simulation alone may run away."""
    told = evidence.told or evidence.baseline
    foreseen, simulated = _unseen_excess(evidence.baseline.one_step), _unseen_excess(told.simulated)
    worse = {name: min(ratio, simulated.get(name, 0.0)) for name, ratio in foreseen.items()}
    name = max(worse, key=worse.__getitem__, default="")
    if not name or worse[name] < GATES.min_contradiction:
        return None
    own, unseen = (told.simulated[data].rms[name] for data in RECORDED)
    return Decided(
        "cannot tell",
        "Nothing is missing in the data of the fit, but unseen data contradict the model: the error of the "
        f"simulated {name} is {unseen:.3g} there and {own:.3g} in the fit. What acts there has not acted "
        f"before.{_hardly_known(told)}",
        "Exchange the data that estimate and those that validate, or estimate from recordings of both kinds.",
    )


def _hardly_known(fit: FitResult) -> str:
    """A sentence on the parameters that the data of the fit hardly tell, as of a vent that is never open
    there; empty where there are none."""
    open_ones = tuple(
        f"`{p.name}` (± {100.0 * p.std_error / abs(p.value):.0f} %)"
        for p in fit.parameters
        if p.std_error and p.value and p.std_error > GATES.open_parameter * abs(p.value)
    )
    if not open_ones:
        return ""
    return f" The data of the fit hardly tell {listed(open_ones)}, which may be all that it is."


def _unseen_excess(agreements: Mapping[str, Agreement]) -> dict[str, float]:
    """Of each output the ratio of the errors on unseen data to those on the data of the fit."""
    own, unseen = (agreements[data].rms if data in agreements else {} for data in RECORDED)
    pairs = {name: (own.get(name), error) for name, error in unseen.items()}
    return {name: error / before for name, (before, error) in pairs.items() if before and error is not None}
