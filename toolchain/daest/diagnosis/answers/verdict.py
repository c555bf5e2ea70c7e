"""The verdict: one of a closed list, with the sentence that says why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Protocol

import numpy as np

from daest.diagnosis.answers.held_values import OtherValue
from daest.diagnosis.answers.parts import Parts
from daest.diagnosis.evidence.load_starts import LoadStart, takes_over
from daest.diagnosis.evidence.noise_level import RECORDED, simulates_to_noise
from daest.diagnosis.evidence.ranking import errors_last, is_settled, is_straight_there
from daest.diagnosis.evidence.reasons import is_significant, told_values
from daest.diagnosis.evidence.unseen import is_better, is_likelier, is_silent, is_worse
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, slowest_at
from daest.diagnosis.recordings.recorded_late import EarlierInputs
from daest.diagnosis.screening.screen import NullObserver, promising_pairs
from daest.estimation.fitting.signals import still_share
from daest.estimation.gates import FIT
from daest.model.diagnosis import (
    Candidate,
    FreeForm,
    PlaceGain,
    Proof,
    Screen,
    Screened,
    Unproved,
    VerdictName,
)
from daest.model.effects import Domain
from daest.model.fit import Agreement, FitResult, error_ratios, most_lasting, ratios_by_output
from daest.model.flat import FlatModel
from daest.numerics.statistics import whiteness_p_value
from daest.quantities import spoken_duration, with_unit

MEASURED: dict[Domain, str] = {  # what could be measured between two places
    "rotational": "an angle, a speed or a torque",
    "translational": "a motion or a force",
    "electrical": "a voltage or a current",
    "thermal": "a temperature or a flow of heat",
    "hydraulic": "a pressure or a flow",
    "amount": "an amount, a concentration or a rate",
}
WIDER_BAND = (
    "Excite the machine over a wider band of frequencies, and measure another quantity between input and "
    "output."
)
OTHER_AMPLITUDES = "Excite the inputs at other amplitudes and speeds, where these laws differ."
FROM_ELSEWHERE = {  # what to do instead where the model has no input
    WIDER_BAND: "Begin from other states, and measure another quantity besides: no input drives the model.",
    OTHER_AMPLITUDES: "Begin from other states, closer to rest and further from it, where these laws differ.",
}
MOVING = (
    "Validate with data in which the machine moves: another share of the recording (--split), a part of it "
    "(--from, --to), or another recording."
)
BESIDE_SENSOR = "Calibrate the sensor, or measure the same quantity by another one."
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
LARGER = "Record again with larger amplitudes, which show more of the form of the law."


class Rest(Protocol):
    """What is left where no candidate is accepted, as the null hypothesis of a diagnosis tells it."""

    def is_explained(self, evidence: Evidence) -> bool:
        """Whether the null hypothesis explains the data, so that nothing is missing."""

    def verdict(self, evidence: Evidence) -> Decided:
        """The verdict where it does not."""


@dataclass(frozen=True)
class Evidence:
    """All that the verdict rests on. `fitted` are values of an earlier fit, `still` tells why unseen data
    confirm nothing (`reasons.unmoved`)."""

    baseline: FitResult
    screen: Screen
    proofs: tuple[Proof, ...]
    fitted: Mapping[str, float]
    rest: Rest
    told: FitResult | None = None  # of the model as it is, without coloured loads
    unproved: tuple[Unproved, ...] = ()
    is_closed: bool = False  # nothing can be put, or measured, between the parts of the model
    still: str = ""
    earlier: EarlierInputs = field(default_factory=EarlierInputs)
    clock: str = "s"  # what the model counts time in


@dataclass(frozen=True)
class Loads:
    """The rest where unknown loads stand beside the model as it is. `form` is what the load follows best,
    `against_form` why unseen data speak against a curve over its variable, `starts` those that begin with the
    recording from nowhere."""

    flat: FlatModel
    null: Null
    run: NullObserver
    gains: tuple[PlaceGain, ...]
    form: FreeForm | None
    against_form: str = ""
    starts: tuple[LoadStart, ...] = ()

    @property
    def is_related(self) -> bool:
        return self.form is not None and self.form.p_value < GATES.missing_level

    def is_explained(self, evidence: Evidence) -> bool:
        return not self.starts and self.is_silent(evidence)

    def is_silent(self, evidence: Evidence) -> bool:
        """Whether nothing is left to explain but how the recording begins."""
        return simulates_to_noise(self.null, evidence.baseline, evidence.told) or (
            not self._is_unobserved
            and evidence.screen.p_value > GATES.missing_level
            and not self.is_related
            and not _has_unexpected_load(self)
        )

    @property
    def _is_unobserved(self) -> bool:
        """Whether loads act that no observer follows, and what they do is left in what the screen saw."""
        is_followed = bool(np.any(self.run.gain)) or not np.any(self.null.intensity)
        return not is_followed and _is_coloured(self)

    def verdict(self, evidence: Evidence) -> Decided:
        if self.starts and self.is_silent(evidence):
            return _of_starts(evidence, self.starts)
        return _of_loads(evidence, self)


@dataclass(frozen=True)
class Decided:
    """`is_by_colour`: that prediction errors are correlated in time is all that the verdict rests on.
    `is_of_starts`: that loads begin with the recordings is.
    `is_dynamic`: what is missing is a state, and no curve over any variable."""

    name: VerdictName
    message: str
    next_experiment: str = ""
    proofs: tuple[Proof, ...] = ()
    is_by_colour: bool = False
    is_of_starts: bool = False
    is_dynamic: bool = False


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
    by far in its refit, which leaves nothing that follows a variable. A score s foresees a gain of s² / 2."""
    scores = {entry.candidate.name: entry.score for entry in evidence.screen.entries}
    best = max((scores.get(p.candidate.name, 0.0) for p in accepted), default=0.0)
    gained = max((p.delta_log_likelihood for p in accepted if is_settled([p])), default=0.0)
    failed = [
        u
        for u in evidence.unproved
        if u.has_failed and u.p_value < GATES.missing_level and u.score > best
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
    limit = GATES.max_told_ratio * min(_error_ratio(evidence, p) for p in accepted)
    better = [
        p
        for p in evidence.proofs
        if p.verdict == "rejected"
        and gain < GATES.min_share_of_better * p.delta_bic
        and (
            _error_ratio(evidence, p) < limit
            or _foresees_far_better(p, accepted)
            or (gain < GATES.min_share_of_refused * p.delta_bic and all(map(_leaves_much, accepted)))
        )
    ]
    return max(better, key=lambda p: p.delta_bic, default=None)


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
    names = _listed(tuple(_named(p) for p in accepted))
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
    same = f" (here the same equation as {_listed(proof.same_as)})" if proof.same_as else ""
    return f"{proof.candidate.label}{same}"


def _says_more(leader: Unproved) -> str:
    return f"{leader.candidate.label} says more in the screen (p = {leader.p_value:.1g}), and {leader.reason}"


def _explains_more(evidence: Evidence, better: Proof) -> str:
    whole, ahead = _error_ratio(evidence, better), _least_ahead(better)
    errors = f"error of unseen data times {whole:.2g}"
    if ahead < min(whole, 1.0):
        errors = f"error of predictions of unseen data times {ahead:.2g}"
    return (
        f"{better.candidate.label} explains far more (BIC gain {better.delta_bic:.3g}, {errors}), although "
        f"{better.reason}: the law that acts looks more like that one"
    )


def _by_hand(evidence: Evidence, one: Unproved) -> str:
    if evidence.is_closed:
        return "Record again with smaller amplitudes, at which the model can be simulated with it."
    if one.is_late:
        return f"Run the same command again, which goes on with {one.candidate.label}, or give it more time."
    if one.is_present:
        return "Estimate what the model has there with given values (--estimate), and run again."
    return (
        f"Add {one.candidate.label} to the model (daest extend) and identify it, from sizes that make "
        "sense in the machine."
    )


def _decided(evidence: Evidence, accepted: Sequence[Proof], leader: Unproved | None) -> Decided:
    if len(accepted) == 1:
        return _as_well_inside(evidence, accepted[0]) or Decided(
            "supported", _supported(evidence, accepted[0])
        )
    if accepted:
        return _cannot_tell(evidence, accepted)
    if evidence.rest.is_explained(evidence) and not any(p.is_any_dynamics for p in evidence.proofs):
        return _contradicted(evidence) or _nothing(evidence)
    if leader is not None:
        return Decided(
            "cannot tell",
            f"Something is missing. {leader.candidate.label} leads the screen "
            f"(p = {leader.p_value:.1g}), but {leader.reason}.",
            _by_hand(evidence, leader),
        )
    return evidence.rest.verdict(evidence)


def _as_well_inside(evidence: Evidence, proof: Proof) -> Decided | None:
    """No claim for a law of a sensor that is the same equation as one in the machine before it; None where it
    is none."""
    if not proof.inside:
        return None
    why = f"on these recordings it is the same equation as {proof.inside} ({told_values(proof)})"
    decided = _beside(evidence, [proof], proof.inside, why, BESIDE_SENSOR)
    told = _errors(evidence, proof) + _importance(evidence, proof) + _certainty(evidence, proof)
    return replace(decided, message=decided.message + told)


def beside_value(evidence: Evidence, decided: Decided, law: Proof, other: OtherValue) -> Decided:
    """What was `decided`, where `other` says as much as an accepted law: a parameter makes no claim of a
    law."""
    told = replace(law, verdict="not separable", not_separable_from=(*law.not_separable_from, other.answer))
    proofs = tuple(told if p is law else p for p in decided.proofs)
    says = f"{other.answer}, says as much: {other.advice}."
    if decided.name != "supported":
        message = f"{decided.message} {says[0].upper()}{says[1:]}"
        return replace(decided, message=message, proofs=proofs)
    message = f"{law.candidate.label} would do ({told_values(law)}), but {says}" + _told_of(evidence, law)
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
        message += _told_of(evidence, law)
        following = OTHER_AMPLITUDES
    proofs = tuple(told if p is law else p for p in decided.proofs)
    if decided.name != "supported":
        return replace(decided, message=f"{decided.message} {message}", proofs=proofs)
    return Decided("cannot tell", message, following, proofs)


def _of_loads(evidence: Evidence, loads: Loads) -> Decided:
    short = [p for p in evidence.proofs if p.is_any_dynamics]
    form = loads.form
    may_be_curve = loads.is_related and not loads.against_form
    nearest = _nearest_dynamics(evidence, short, form if may_be_curve else None)
    if nearest is not None:
        return _comes_near(evidence, nearest)
    if short:
        return _any_dynamics(evidence, short)
    if form is not None and loads.is_related:
        return _no_law(evidence, loads, form) if loads.against_form else _unknown(evidence, loads, form)
    if _is_coloured(loads):
        return Decided(
            "unknown effect",
            "Something dynamic is missing: the prediction errors stay correlated in time although loads "
            f"were admitted at {_load_places(loads)}, and no effect of the library explains them.",
            WIDER_BAND,
            is_by_colour=True,
        )
    near = [p for p in evidence.proofs if p.delta_bic > GATES.min_told_bic_gain]
    if evidence.screen.p_value < GATES.missing_level and near:
        return _not_proven(evidence, near)
    slow = slowest_at(loads.null, _largest_load(loads).group)
    if slow is not None:
        return _too_slow_to_tell(evidence, loads, slow)
    return Decided(
        "external disturbance",
        f"An unexplained load acts at {_load_places(loads)}, but it is related to no variable of the "
        "model and no effect of the library explains it." + foreseen_by(evidence, None),
        "Repeat the same experiment: what comes back in the same way belongs to the machine.",
    )


def _too_slow_to_tell(evidence: Evidence, loads: Loads, time_constant: float) -> Decided:
    """An external disturbance that may as well be none: with a load that comes and goes hardly once, its
    relation to any variable is told by hardly one sample."""
    slow = spoken_duration(time_constant, evidence.clock)
    return Decided(
        "external disturbance",
        f"An unexplained load acts at {_load_places(loads)}, and no effect of the library explains it. It "
        f"changes so slowly (over {slow} and more) that these recordings hardly tell whether it follows a "
        "variable of the model." + foreseen_by(evidence, None),
        f"Record for several times as long, and change what the machine does every {slow} or so: a law "
        "comes back with its variable, a load from outside does not.",
    )


def _of_starts(evidence: Evidence, starts: Sequence[LoadStart]) -> Decided:
    """Loads that begin with the recording, and effects that would do the same: nothing else is missing."""
    begun = _listed(
        tuple(
            f"a load at {start.load.place} that begins with the recording ({start.value:.3g} "
            f"{start.load.unit}, gone by a factor e after "
            f"{spoken_duration(start.load.time_constant, evidence.clock)})"
            for start in starts
        )
    )
    instead = [p for p in evidence.proofs if any(takes_over(start, p) for start in starts)]
    again = "Record again with several steps, up and down, from a machine that has been at rest for long."
    if not instead:
        return Decided(
            "external disturbance",
            f"The data ask for {begun}: the machine was left with something that the model does not have.",
            again,
            is_of_starts=True,
        )
    labels = tuple(p.candidate.label for p in instead)
    would = "; ".join(f"{p.candidate.label}: {told_values(p)}" for p in instead)
    alike = "a load that begins with the recording does the same"
    others = {p.candidate.label: tuple(n for n in labels if n != p.candidate.label) for p in instead}
    proofs = tuple(
        replace(p, verdict="not separable", reason=alike, not_separable_from=others[p.candidate.label])
        if p.candidate.label in others
        else p
        for p in evidence.proofs
    )
    return Decided(
        "cannot tell",
        f"Either {_listed(labels)} is missing, or {begun} acts: these data do not separate them ({would}).",
        again,
        proofs,
    )


def _nearest_dynamics(evidence: Evidence, short: Sequence[Proof], form: FreeForm | None) -> Proof | None:
    """The likeliest lag or delay that leaves something dynamic, where that does away with most of the load
    and is clearly likelier than those that are too `short` to be told apart and than a curve of the `form`
    that the load follows, if unseen data do not speak against that; None where there is none."""
    others = [0.0, *(p.delta_bic for p in short)]
    if form is not None:
        others.append(2.0 * form.log_likelihood_gain)
    near = [p for p in evidence.proofs if p.comes_near and p.explained >= GATES.min_explained]
    best = max(near, key=lambda p: p.delta_bic, default=None)
    return best if best is not None and best.delta_bic > max(others) + GATES.min_bic_gain else None


def _comes_near(evidence: Evidence, near: Proof) -> Decided:
    """A lag or a delay that does most of what is missing, and not all."""
    return Decided(
        "unknown effect",
        f"Something dynamic is missing: {near.candidate.label} comes nearest ({told_values(near)}), but what "
        f"it leaves still follows {'something' if near.left is None else near.left.label}."
        + _errors(evidence, near)
        + _importance(evidence, near),
        WIDER_BAND,
        is_dynamic=True,
    )


def _any_dynamics(evidence: Evidence, short: Sequence[Proof]) -> Decided:
    """Lags, delays and other stores that do away with what is missing, and are too short to be told from one
    another. Those that the data speak clearly against are told apart."""
    best = short[0]
    near = [p for p in short if best.delta_bic - p.delta_bic <= GATES.min_bic_gain]
    labels = _listed(tuple(p.candidate.label for p in near))
    would = f"{labels if len(near) == 1 else f'any of {labels}'} would do ({told_values(best)})"
    behind = [f"{p.candidate.label} (BIC {best.delta_bic - p.delta_bic:.0f})" for p in short if p not in near]
    return Decided(
        "unknown effect",
        f"Something dynamic is missing, and it is fast: {would}, but {best.reason}."
        + (f" Clearly less likely: {', '.join(behind)}." if behind else "")
        + _errors(evidence, best)
        + _importance(evidence, best),
        WIDER_BAND,
        is_dynamic=True,
    )


def _no_law(evidence: Evidence, loads: Loads, form: FreeForm) -> Decided:
    """A load that seems to follow a variable, though no curve over it foresees anything."""
    near = _nearest(evidence)
    text = (
        f"An unexplained load acts at {_load_places(loads)}. It seems to follow {form.label} (p = "
        f"{form.p_value:.1g}), but with a curve over that in the model {loads.against_form}: it is noise "
        "or a load from outside, or a law that this recording does not show well enough."
    )
    return Decided(
        "external disturbance",
        text + _told_nearest(near) + foreseen_by(evidence, near),
        "Repeat the same experiment: what comes back in the same way belongs to the machine.",
    )


def _supported(evidence: Evidence, proof: Proof) -> str:
    return f"{proof.candidate.label}: {told_values(proof)}; supported." + _told_of(evidence, proof)


def _told_of(evidence: Evidence, proof: Proof) -> str:
    """What is to be said of a law beside its values."""
    text = ""
    if proof.equivalent:
        text += f" The sensors cannot tell it from the same effect at {_listed(proof.equivalent)}."
    if proof.same_as:
        text += f" On these recordings it is the same equation as {_listed(proof.same_as)}."
    text += _of_both(evidence, proof)
    if proof.left is not None and is_significant(proof.left, proof.delta_log_likelihood):
        text += f" Something else is missing besides: what is left follows {proof.left.label}."
    ratio = _error_ratio(evidence, proof)
    told = _errors(evidence, proof) + _importance(evidence, proof) + _left_over(evidence, proof)
    told += _certainty(evidence, proof)
    return text + told + foreseen_by(evidence, proof, GATES.max_told_ratio * min(ratio, 1.0))


def _of_both(evidence: Evidence, proof: Proof) -> str:
    """That a signal is off in gain and offset together, where a law without its bend says more of it than the
    one of both that is accepted; empty where none does."""
    likelier = [
        p
        for p in evidence.proofs
        if is_straight_there(p, proof) and p.delta_bic > proof.delta_bic + GATES.same_bic
    ]
    if not likelier:
        return ""
    both = max(likelier, key=lambda p: p.delta_bic)
    says = f"{both.candidate.label} says more (BIC {both.delta_bic - proof.delta_bic:.0f})"
    return f" Gain and offset are off together: {says}, but {both.reason}."


def _importance(evidence: Evidence, proof: Proof) -> str:
    """How much the effect matters: share of the error on unseen data that it removes, at the horizon where it
    removes most, and in the whole simulation."""
    parts = []
    if proof.ahead:
        best = min(proof.ahead, key=lambda one: one.ratio)
        ahead = spoken_duration(best.seconds, evidence.clock)
        parts.append(f"{_removed(best.ratio)} of the error of predictions {ahead} ahead")
    if proof.is_by_use and proof.in_use.piece:
        over = spoken_duration(proof.in_use.piece, evidence.clock)
        removed = _removed(proof.in_use.ratio)
        parts.append(f"{removed} of the error of simulations over {over}, each from a start of its own,")
    ratio = _error_ratio(evidence, proof)
    is_larger = np.isfinite(ratio) and ratio > 1.0 + GATES.same_unseen_error
    if np.isfinite(ratio) and not is_larger:
        least, output = _most_removed(evidence, proof)
        parts.append(
            f"{_removed(least)} of {'that' if parts else 'the error'} of the whole simulation{output}"
        )
    text = f" Importance: it removes {' and '.join(parts).removesuffix(',')}." if parts else ""
    if is_larger:
        text += f" The error of the whole simulation gets {ratio:.3g} times larger"
        text += ": nothing holds what is measured, so that it adds up" if proof.adds_up else ""
        text += _removed_of_steady(evidence, proof) + "."
    return text


def _removed_of_steady(evidence: Evidence, proof: Proof) -> str:
    """The share that the effect removes of the error of an output beside those that add up; empty where there
    is none that gets smaller."""
    before, after = _told(evidence, proof)
    ratios = _of_steady(proof, ratios_by_output(before.simulated, after.simulated)) if proof.adds_up else {}
    name = min(ratios, key=ratios.__getitem__, default="")
    if not name or ratios[name] > 1.0 - GATES.same_unseen_error:
        return ""
    return f"; that of {name}, which does not, gets {_removed(ratios[name])} smaller"


def _most_removed(evidence: Evidence, proof: Proof) -> tuple[float, str]:
    """Error of the candidate on unseen data relative to that of the model as it is, of the output where it is
    smallest, and which one that is; empty where it is the only one."""
    before, after = _told(evidence, proof)
    ratios = ratios_by_output(before.simulated, after.simulated)
    name = min(ratios, key=ratios.__getitem__)
    return ratios[name], f" of {name}" if len(ratios) > 1 else ""


def _left_over(evidence: Evidence, proof: Proof) -> str:
    """A sentence on the output of which a simulation with the effect leaves most, beside its noise; empty
    where it leaves little more, or the errors of all outputs add up."""
    after = _told(evidence, proof)[1]
    ratios = _of_steady(proof, ratios_by_output(after.one_step, after.simulated))
    name = max(ratios, key=ratios.__getitem__, default="")
    if name and GATES.told_rest <= ratios[name] < np.inf:
        return (
            f" What a simulation leaves of {name} is {ratios[name]:.2g} times its error one sample ahead: "
            "something else is missing, or acts besides."
        )
    return _lasting(proof, after, GATES.told_rest)


def _of_steady(proof: Proof, ratios: Mapping[str, float]) -> dict[str, float]:
    """The ratios of the outputs whose errors do not add up."""
    return {name: one for name, one in ratios.items() if not proof.adds_up or name in proof.holding}


def _lasting(proof: Proof, after: FitResult, limit: float) -> str:
    """A sentence on the output whose errors in a simulation of unseen data last longest; empty where none is
    more than `limit` times its part without memory, or they add up. The error one sample ahead says nothing
    of it where no load can take the place of what is missing: the noise of the sensor then stands for it."""
    name, ratio = most_lasting(after.simulated)
    if proof.adds_up or ratio < limit:
        return ""
    return (
        f" What a simulation leaves of {name} lasts: it is {ratio:.2g} times its part without memory, "
        "so that something else is missing, or acts besides, or the noise of that sensor is slow."
    )


def _left_by_set(evidence: Evidence, accepted: Sequence[Proof]) -> str:
    """What is to be said of the simulations with laws that are not told apart: their errors, and what every
    one of them leaves, which may be since none of them is what acts."""
    text = _errors(evidence, accepted[0])
    left = [
        _left_over(evidence, p) or _lasting(p, _told(evidence, p)[1], GATES.told_rest_of_set)
        for p in accepted
    ]
    return text + (f"{left[0]} It may be none of them." if all(left) else "")


def two_alike(screen: Screen) -> str:
    """Effects of one kind at two places that say much more together than any effect alone, as dead zones of
    two drives of one kind; empty where there are none."""
    for one, other in promising_pairs(screen):
        if one.candidate.effect is other.candidate.effect and one.candidate.site != other.candidate.site:
            return (
                f" {one.candidate.label} and {other.candidate.site.name} say much more together than any "
                "effect alone, as where two parts are alike: daest improve tries such pairs."
            )
    return ""


def nearest_in_pieces(proofs: Sequence[Proof], clock: str = "s") -> str:
    """A sentence on the law that simulations of pieces of the records show best, where none is accepted;
    empty where there is none. One whose size nobody knows lives on how its states begin: a mass of nothing
    that swings is a sine of any origin."""
    is_open = all(p.verdict == "rejected" for p in proofs)
    known = [p for p in proofs if is_open and p.in_use.piece and _has_known_size(p)]
    best = max(known, key=lambda p: p.in_use.bic(p.candidate.n_unknowns), default=None)
    if best is None:
        return ""
    return (
        f" In simulations over {spoken_duration(best.in_use.piece, clock)}, each from a start of its own, "
        f"{best.candidate.label} comes nearest ({told_values(best)}): it removes "
        f"{_removed(best.in_use.ratio)} of their error on unseen data."
    )


def _has_known_size(proof: Proof) -> bool:
    """Whether any size of a law has a standard error."""
    own = {f"{proof.candidate.name}.{size.name}" for size in proof.candidate.effect.sizes}
    return any(p.std_error is not None for p in proof.told.parameters if p.name in own)


def _removed(ratio: float) -> str:
    return f"{100.0 * max(1.0 - ratio, 0.0):.0f} %"


def _certainty(evidence: Evidence, proof: Proof) -> str:
    """How sure the effect is, however little it matters."""
    text = f" Certainty: BIC gain {proof.delta_bic:.3g} over {evidence.screen.n_screened} candidates"
    if proof.ahead:
        surest = max(proof.ahead, key=lambda one: one.certainty)
        better = surest.certainty > 0.0
        text += ", unseen data foreseen "
        text += f"better by {surest.certainty:.2g} standard errors" if better else "no better"
    elif proof.is_by_use:
        text += f", unseen data simulated better by {proof.in_use.certainty:.2g} standard errors"
    if is_silent(proof.confirmed):
        text += ", though unseen data hardly show it"
    elif is_likelier(proof.confirmed):
        text += f", and likelier by {proof.confirmed.certainty:.2g}"
    return text + "."


def _errors(evidence: Evidence, proof: Proof) -> str:
    """Validation errors before and after, per output."""
    before, after = (fit.simulated.get("validation") for fit in _told(evidence, proof))
    if before is None or after is None:
        return ""
    parts = [
        f"{name} {b:.3g} -> {after.rms[name]:.3g}"
        for name, b in before.rms.items()
        if b is not None and after.rms.get(name) is not None
    ]
    return f" Validation error (rms): {', '.join(parts)}." if parts else ""


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
        f"One of {_listed(tuple(names))} is missing; these data do not separate them."
        + _left_by_set(evidence, accepted),
        separate,
    )


def _to_tell_places(accepted: Sequence[Proof]) -> str:
    """The measurement that tells laws at several places apart: of quantities of their domains; of sensors and
    actuators alone, that each is tried by itself."""
    # A place between two others is called by both, of which another law may sit at one.
    ends = chain.from_iterable(p.candidate.site.name.split(", ") for p in accepted)
    places = _listed(tuple(dict.fromkeys(ends)))
    domains = dict.fromkeys(p.candidate.site.domain for p in accepted)
    known = [MEASURED[domain] for domain in domains if domain in MEASURED]
    if not known:
        return f"Try the sensors and actuators of {places} apart from the machine, one by one."
    return f"Measure {' or '.join(known)} between {places}."


def _not_proven(evidence: Evidence, near: list[Proof]) -> Decided:
    return Decided(
        "cannot tell",
        f"Something is missing (p = {evidence.screen.p_value:.1g} for the whole search), but these data do "
        f"not prove what. {_reasons(near)}.",
        "Record longer and with larger amplitudes: the effect is small beside the noise and the loads of "
        "this record.",
    )


def _has_unexpected_load(loads: Loads) -> bool:
    """Whether the data ask for a load that the model's declared noise does not account for."""
    declared = max((n.intensity or 0.0 for n in loads.flat.noises), default=0.0)
    for gain, load in zip(loads.gains, loads.null.loads, strict=True):
        # The correlation function size² exp(-|τ|/T) has the spectral density 2 size² T at low frequency.
        if (
            gain.log_likelihood_gain > GATES.min_load_gain
            and 2.0 * load.size**2 * load.time_constant > GATES.expected_noise * declared
        ):
            return True
    return False


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
    return f" The data of the fit hardly tell {_listed(open_ones)}, which may be all that it is."


def _unseen_excess(agreements: Mapping[str, Agreement]) -> dict[str, float]:
    """Of each output the ratio of the errors on unseen data to those on the data of the fit."""
    own, unseen = (agreements[data].rms if data in agreements else {} for data in RECORDED)
    pairs = {name: (own.get(name), error) for name, error in unseen.items()}
    return {name: error / before for name, (before, error) in pairs.items() if before and error is not None}


def _nothing(evidence: Evidence) -> Decided:
    moved = _moved(evidence)
    if moved:
        return Decided(
            "parameters off",
            f"No effect is missing, but the data contradict the given values: {', '.join(moved)}. "
            "Refit the model." + _still_significant(evidence),
        )
    small = _likelier(evidence)
    if small:
        return _too_small(evidence, small)
    seen = [e for e in evidence.screen.entries if not e.absorbed and np.isfinite(e.detectable)]
    if _is_blind(seen):
        return Decided(
            "cannot tell",
            f"None of {evidence.screen.n_screened} candidates was supported, but beside unknown loads these "
            "recordings would show none: not even what cuts a signal would be seen, though it cut all that "
            f"lies beyond its limit. It would take, for instance: {_smallest(seen)}.",
            "Record with larger inputs and less noise, or measure another quantity.",
        )
    shown = _smallest([entry for entry in seen if not _is_beyond(entry)])
    return Decided(
        "nothing missing",
        f"Nothing is missing at this noise level: none of {evidence.screen.n_screened} candidates was "
        f"supported (p = {evidence.screen.p_value:.2g} for the whole search)."
        + _still_significant(evidence)
        + (f" It would have shown, for instance: {shown}." if shown else ""),
    )


def _smallest(seen: Sequence[Screened]) -> str:
    """The sizes from which the first few laws that are `seen` would show, each law once."""
    smallest: dict[str, str] = {}
    for entry in seen:
        size = entry.candidate.effect.sizes[0]
        law, label = entry.candidate.effect.name, entry.candidate.label + _of_form(entry.candidate)
        seen_from = with_unit(f"{entry.detectable:.2g}", entry.candidate.size_unit)
        smallest.setdefault(law, f"{label} from {size.name} = {seen_from}")
    return "; ".join(list(smallest.values())[:4])


def _is_beyond(entry: Screened) -> bool:
    """Whether an effect would be seen only beyond its largest size, as a share of more than all."""
    most = entry.candidate.effect.sizes[0].max
    return most is not None and 0.0 < most < entry.detectable


def _of_form(candidate: Candidate) -> str:
    """The form of a law whose size is a share, which tells nothing without it: where a signal is cut."""
    if not candidate.effect.sizes[0].is_share:
        return ""
    forms = [
        f"{p.name} = {with_unit(f'{candidate.shape[p.name]:.3g}', candidate.units.get(p.name) or p.unit)}"
        for p in candidate.effect.parameters
        if p.role == "shape" and p.estimate and p.name in candidate.shape
    ]
    return f" ({', '.join(forms)})" if forms else ""


def _likelier(evidence: Evidence) -> list[Proof]:
    """The rejected candidates that make the data likelier, where the whole search is sure that something is
    missing; none where it is not."""
    if evidence.screen.p_value >= GATES.missing_level:
        return []
    return [p for p in evidence.proofs if p.delta_bic > GATES.min_told_bic_gain]


def _too_small(evidence: Evidence, near: Sequence[Proof]) -> Decided:
    """The verdict where a simulation is as good as predictions, and the search has seen something: what is
    missing is too small to be named, and it is not nothing."""
    return Decided(
        "cannot tell",
        f"Something small is missing (p = {evidence.screen.p_value:.1g} for the whole search): a simulation "
        "without it is nearly as good as predictions from sample to sample, and these data do not prove what "
        f"it is. {_reasons(near)}.",
        "Record longer and with larger amplitudes: the effect is small beside the noise of this record.",
    )


def _still_significant(evidence: Evidence) -> str:
    """A sentence where the search is sure of something that no refit confirms; empty where it is not."""
    if evidence.screen.p_value >= GATES.missing_level:
        return ""
    return (
        f" The search has seen something (p = {evidence.screen.p_value:.1g}), but it hardly matters: a "
        "simulation is nearly as good as predictions from sample to sample."
    )


def _reasons(near: Sequence[Proof]) -> str:
    """Why the first of the candidates that come near are not accepted."""
    return "; ".join(f"{p.candidate.label}: {p.reason}" for p in near[:2])


def _is_blind(seen: Sequence[Screened]) -> bool:
    """Whether those of the effects that have a largest size would only be seen beyond it."""
    most = [(entry.detectable, entry.candidate.effect.sizes[0].max) for entry in seen]
    ratios = [size / limit for size, limit in most if limit]
    return bool(ratios) and min(ratios) > 1.0


def _moved(evidence: Evidence) -> list[str]:
    """Parameters of an earlier fit that these data contradict."""
    result = []
    for p in (evidence.told or evidence.baseline).parameters:
        given = evidence.fitted.get(p.name)
        if given is None or not p.std_error:
            continue
        if abs(p.value - given) > GATES.changed_significance * p.std_error:
            result.append(
                f"{p.name} = {given:.4g} given, {p.value:.4g} ± {p.std_error:.2g} {p.unit} found".rstrip()
            )
    return result


def _unknown(evidence: Evidence, loads: Loads, form: FreeForm) -> Decided:
    nearest = _nearest(evidence)
    text = (
        f"An effect that the library does not hold acts at {_group(loads.gains[form.load])}: the "
        f"unexplained load follows {form.label} (p = {form.p_value:.1g}); the curve is given."
    )
    text += _told_nearest(nearest) + foreseen_by(evidence, nearest)
    record = f"Record {form.variable} over a wider range, slowly and in both directions, to tell its form."
    return Decided("unknown effect", text, record)


def _nearest(evidence: Evidence) -> Proof | None:
    """The likeliest law that may be told as the nearest to what acts; None where there is none."""
    return next((p for p in evidence.proofs if _may_be_near(p)), None)


def _told_nearest(proof: Proof | None) -> str:
    """A sentence on the nearest law; empty where there is none."""
    return f" The nearest of the library is {proof.candidate.label}, but {proof.reason}." if proof else ""


def _may_be_near(proof: Proof) -> bool:
    """Whether a law may be told as the nearest to what acts: it gains likelihood, the data show it, it does
    away with a part of the load, and unseen data do not speak plainly against it."""
    worst = max((a.ratio for a in proof.ahead), default=0.0)
    is_seen = proof.is_known and proof.explained > GATES.min_told_explained
    return is_seen and proof.delta_bic > GATES.min_told_bic_gain and worst < GATES.max_nearest_ratio


def foreseen_by(evidence: Evidence, named: Proof | None, limit: float = GATES.max_told_ratio) -> str:
    """The rejected candidates other than `named` whose error on unseen data is below `limit` times that of
    the model as it is, those about as good as the best of them, as a sentence; empty where there is none. An
    unknown load that is free enough takes the likelihood from a law that is right; a simulation has no such
    load. None that the data do not show: it stands for any other that does the same."""
    others = [p for p in evidence.proofs if p is not named and p.verdict == "rejected" and p.is_known]
    ratios = [_error_ratio(evidence, proof) for proof in others]
    best = min(ratios, default=np.inf)
    if not best < limit:
        return ""
    found = [
        proof for proof, ratio in zip(others, ratios, strict=True) if ratio <= GATES.same_unseen_ratio * best
    ]
    labels = tuple(dict.fromkeys(p.candidate.label for p in found))
    names, verb = _listed(labels), "foresees" if len(labels) == 1 else "foresee"
    return (
        f" {names} {verb} the validation data far better (error times {best:.2g}) and may be what acts "
        f"there, although {found[0].reason}."
    )


def _error_ratio(evidence: Evidence, proof: Proof) -> float:
    """Error of the candidate on unseen data relative to that of the model as it is, of the output where it is
    largest; inf where it is unknown."""
    before, after = _told(evidence, proof)
    return max(error_ratios(before.simulated, after.simulated), default=np.inf)


def _told(evidence: Evidence, proof: Proof) -> tuple[FitResult, FitResult]:
    """The fits without and with the effect that are told, as in the table: without coloured loads where they
    are known so."""
    return evidence.told or evidence.baseline, proof.final or proof.fit


def _is_coloured(loads: Loads) -> bool:
    """Whether the null leaves innovations that are certainly not white, and not by the steps of a sensor: one
    that stands still from sample to sample rounds what is between, and its errors last."""
    p_values = [
        whiteness_p_value(o.whitened[:, j], np.isfinite(o.whitened[:, j]))
        for experiment, o in zip(loads.null.experiments, loads.run.observed, strict=True)
        for j in range(o.whitened.shape[1])
        if still_share(experiment.outputs[:, j]) < FIT.max_still
    ]
    return bool(p_values) and min(p_values) * len(p_values) < GATES.white_level


def _load_places(loads: Loads) -> str:
    return _group(_largest_load(loads))


def _largest_load(loads: Loads) -> PlaceGain:
    """The place whose load the data ask for most."""
    return max(loads.gains, key=lambda g: g.log_likelihood_gain)


def _group(gain: PlaceGain) -> str:
    others = (
        f" (or {_listed(gain.group[1:])}, which the sensors cannot tell apart)" if len(gain.group) > 1 else ""
    )
    return f"{gain.group[0]}{others}"


def _listed(names: tuple[str, ...], most: int = 4) -> str:
    shown = list(names[:most])
    rest = len(names) - len(shown)
    if rest:
        shown.append(f"{rest} more")
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + " and " + shown[-1]
