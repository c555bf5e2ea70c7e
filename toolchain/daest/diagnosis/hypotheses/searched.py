"""Hypotheses side by side, each continued round by round until nothing more is found."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.built_in.trials import Trial
from daest.diagnosis.evidence.reasons import unmoved
from daest.diagnosis.examine import examine
from daest.diagnosis.gates import GATES
from daest.diagnosis.hypotheses.extended import displaced, displaces, extended, with_best
from daest.diagnosis.hypotheses.hypothesis import (
    MOST_PATHS,
    OUT_OF_TIME,
    Hypothesis,
    Task,
    helps,
    label_of,
    labels_of,
    leading,
)
from daest.diagnosis.hypotheses.rebuilt import exchanged
from daest.diagnosis.hypotheses.together import beside_another, with_pair, with_unproven
from daest.diagnosis.recordings.holds import better_hold
from daest.diagnosis.refits.rounds import proved_beside
from daest.errors import EstimationError
from daest.model.diagnosis import Candidate, Diagnosis, Proof, Screen, Screened
from daest.model.holds import Hold
from daest.numerics.deadline import OutOfTimeError, until

MOST_TAKEN_UP = 2  # of those that were put aside, after an end with something missing


class OtherHoldError(Exception):
    """The inputs are better taken with the other hold: all is to be done again; `path` is what there was."""

    def __init__(self, hold: Hold, found: Diagnosis, path: Hypothesis) -> None:
        super().__init__(hold)
        self.hold = hold
        self.found = found
        self.path = path


def searched(task: Task) -> Hypothesis:
    """The best path, followed to its end. Where it ends and something is missing still, one that begins with
    another law, and paths that it has put aside, are followed: what was not separable from its effects may be
    what goes on. Raises OtherHoldError, and what `examine` raises."""
    paths = [Hypothesis(task.root, task.first)]
    put_aside: list[Hypothesis] = []
    n_taken_up, is_begun_anew = 0, False
    while True:
        while any(path.last is None for path in paths):
            grown = [
                one for path in paths for one in ([path] if path.last is not None else _continued(task, path))
            ]
            paths = leading(grown)
            kept = {id(path) for path in paths}
            put_aside += [path for path in grown if path.last is None and id(path) not in kept]
        last = paths[0].last
        if last is None or last.verdict == "nothing missing" or task.options.is_over:
            return _beside_others(paths)
        if not is_begun_anew:
            is_begun_anew = True
            put_aside = [*_begun_otherwise(task, [*paths, *put_aside]), *put_aside]
        if not put_aside or n_taken_up == MOST_TAKEN_UP:
            return _beside_others(paths)
        n_taken_up += 1
        other = put_aside.pop(0)
        task.progress(f"going on with {label_of(other.steps[-1])} instead")
        paths = [*paths, other]


def _continued(task: Task, path: Hypothesis) -> list[Hypothesis]:
    """The path with one more effect, several times where its round leaves several that are not separable; or
    ended."""
    stand = path.stand
    if task.options.is_over and path.steps[-1].diagnosis is not None:
        return [ended_by_time(task, path, "another effect was looked for")]
    try:
        diagnosis = examine(stand, task.library, task.options, task.progress)
    except EstimationError as error:
        last = path.steps[-1].diagnosis
        if error.code != "diagnose-no-candidate" or last is None:
            raise
        return [path.ended(last, "No other effect was to be searched for.")]
    accepted = [proof for proof in diagnosis.proofs if proof.verdict != "rejected"]
    if not diagnosis.is_whole:
        if diagnosis.verdict == "supported" and helps(stand.told, accepted[0]):
            with suppress(*FAILURES):
                grown = with_best(task, path, diagnosis)
                path = path if displaces(path, grown) else grown
        return [ended_by_time(task, replace(path, last=diagnosis), "all candidates of a round were refitted")]
    if not accepted and unmoved(stand.null.experiments, stand.validation):
        return [path.ended(diagnosis, diagnosis.message)]
    if not accepted:
        other = exchanged(task, path, diagnosis) or with_pair(task, path, diagnosis)
        if other is not None:
            return [other]
        return beside_another(task, path, diagnosis, _continued) or [path.ended(diagnosis, diagnosis.message)]
    beside = beside_another(task, path, diagnosis, _continued)
    if beside:
        return beside
    if all(proof.candidate.is_of_parameter for proof in accepted):
        # A parameter that changes does the work of laws that are seen only together.
        other = with_pair(task, path, diagnosis)
        if other is not None:
            return [other]
    helpful = [proof for proof in accepted if helps(stand.told, proof)]
    if not helpful:
        labels = accepted[0].candidate.label
        return [path.ended(diagnosis, f"{labels} is supported, but it does not lower the validation error.")]
    hold = None if task.options.is_over else better_hold(stand, diagnosis.proofs)
    if hold is not None:
        raise OtherHoldError(hold, diagnosis, path)
    further: list[Hypothesis] = []
    for proof in helpful[:MOST_PATHS]:
        with suppress(*FAILURES):
            further.append(extended(task, path, proof, diagnosis))
    if not further:
        label = helpful[0].candidate.label
        return [path.ended(diagnosis, f"{label} is supported, but no further fit of the model with it ends.")]
    kept = [one for one in further if not displaces(path, one)]
    for label in [label_of(one.steps[-1]) for one in further if all(one is not other for other in kept)]:
        task.progress(f"{label} is taken out again")
    return kept or [path.ended(diagnosis, displaced(path, further[0]))]


def ended_by_time(task: Task, path: Hypothesis, before: str) -> Hypothesis:
    """The path, ended by the time that is up `before` something could be done."""
    last = path.last or path.steps[-1].diagnosis
    assert last is not None
    kept = " What was done is kept, and the same command goes on from there." if task.options.keeper else ""
    return path.ended(last, f"{OUT_OF_TIME} before {before}.{kept}")


def _begun_otherwise(task: Task, paths: Sequence[Hypothesis]) -> list[Hypothesis]:
    """A path that begins with another law than the best one does: with the one that leads the screen, or that
    of the other kind that leads there, of a signal in place of one in the machine or the other way round. It
    is to explain nearly as much alone: of two laws that are missing at once, a third may do most of what both
    do, and a law bends to the other. None where there is none, or it was begun with already."""
    number = len(task.first)
    first = next(iter(paths[0].steps[number:]), None)
    if first is None or first.proof is None or first.diagnosis is None:
        return []
    known = {label_of(path.steps[number]) for path in paths if len(path.steps) > number}
    for entry in _other_leaders(first.diagnosis.screen, first.proof.candidate):
        if entry.candidate.label in known:
            continue
        task.progress(f"refitting with {entry.candidate.label} in place of {label_of(first)}")
        with suppress(*FAILURES, OutOfTimeError), until(task.options.until):
            proof = proved_beside(task.root, Trial(entry.candidate, entry.sizes, ()), {})
            begun = _begun_with(task, proof, first.proof, first.diagnosis)
            if begun:
                return begun
    return []


def _begun_with(task: Task, proof: Proof, first: Proof, diagnosis: Diagnosis) -> list[Hypothesis]:
    """The paths that begin with a law in place of the `first`: by itself where it is accepted and explains
    nearly as much; together with what follows where it was refused, and is likelier than the first."""
    begin = Hypothesis(task.root, task.first)
    if proof.verdict != "rejected" and helps(task.root.told, proof):
        is_near = proof.delta_log_likelihood > GATES.min_doubted_gain * first.delta_log_likelihood
        return [extended(task, begin, proof, diagnosis)] if is_near else []
    is_likely = proof.is_known and proof.delta_bic > first.delta_bic
    return with_unproven(task, begin, diagnosis, proof, _continued) if is_likely else []


def _other_leaders(screen: Screen, first: Candidate) -> list[Screened]:
    """Of the screened laws without states of their own that of the highest score, and that of those of the
    other kind than the `first`: at signals or in the machine; without the `first` itself."""
    entries = [
        entry
        for entry in screen.entries
        if entry.p_value < GATES.screen_level
        and not (entry.absorbed or entry.candidate.is_dynamic or entry.candidate.is_of_parameter)
    ]
    others = [entry for entry in entries if entry.candidate.is_of_signal != first.is_of_signal]
    return [e for e in (*entries[:1], *others[:1]) if e.candidate.label != first.label]


def _beside_others(paths: Sequence[Hypothesis]) -> Hypothesis:
    """The best path, which tells the others beside which nothing is missing, either, and that are not clearly
    worse: a list of effects that explains all is not yet the one that acts."""
    best, *others = paths
    if best.last is None or best.last.verdict != "nothing missing":
        return best
    alike = [labels_of(path) for path in others if path.last and path.last.verdict == best.last.verdict]
    rivals = [labels for labels in dict.fromkeys(alike) if labels and set(labels) != set(labels_of(best))]
    if not rivals:
        return best
    told = " or ".join(f"{', then '.join(labels)}" for labels in rivals)
    return replace(best, reason=f"{best.reason} These data do not tell this list from {told}.")
