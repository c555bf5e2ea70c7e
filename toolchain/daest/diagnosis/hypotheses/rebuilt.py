"""Hypotheses built again: an earlier effect left out, in a simpler form, or with another one in its place.

What was added first bent to what was missing still. Each further effect asks again for those before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.reasons import not_determined
from daest.diagnosis.evidence.stand import Stand
from daest.diagnosis.evidence.unseen import is_worse
from daest.diagnosis.gates import GATES
from daest.diagnosis.hypotheses.hypothesis import (
    Hypothesis,
    Task,
    doubtful_steps,
    is_accepted,
    label_of,
    remark_on,
    simulates_worse,
)
from daest.diagnosis.refits.rounds import accept, proved_again, with_kinks
from daest.model.diagnosis import Diagnosis, Proof, Step
from daest.model.fit import FitResult
from daest.numerics.deadline import OutOfTimeError, until

MOST_SIMPLER = 2  # simpler laws that are tried in place of one


def with_kinks_refitted(task: Task, path: Hypothesis) -> Hypothesis:
    """The path with the kinks of its effects as the recordings have them, now that there are several: what is
    left at the kink of one would be taken for a further law of its kind."""
    proofs = [step.proof for step in path.steps if step.proof is not None]
    if len(proofs) < 2:
        return path
    try:
        stand = with_kinks(path.stand, [proof.candidate for proof in proofs])
    except FAILURES:
        return path
    if stand is None:
        return path
    return refitted(path, stand, "kinks refitted beside it")


def refitted(path: Hypothesis, stand: Stand, remark: str) -> Hypothesis:
    """The path with the values of the `stand` in its last step, whose model was fitted again, as the `remark`
    says; and that nothing is known of the sizes in that fit, where it is so."""
    last = path.steps[-1]
    assert last.proof is not None
    before, gain = path.steps[-2:][0].fit, last.proof.delta_log_likelihood
    if not_determined(last.proof.candidate, stand.told, before, gain=gain):
        remark += ", with which the data determine none of its parameters"
    proof = replace(last.proof, flat=stand.null.flat, fit=stand.baseline, final=stand.told)
    said = last.remark if last.remark.endswith(remark) else f"{last.remark}; {remark}"
    step = replace(last, proof=proof, fit=stand.told, remark=said)
    return replace(path, stand=stand, steps=(*path.steps[:-1], step))


def without_superfluous(task: Task, path: Hypothesis) -> Hypothesis:
    """The path without the effects that the last one has made superfluous, one at a time."""
    for number in doubtful_steps(path.steps):
        shorter = _rebuilt(task, path, number)
        # A kink that is too sharp would count against the model that has fewer effects.
        shorter = shorter and with_kinks_refitted(task, shorter)
        if shorter is None or shorter.bic > path.bic + GATES.min_bic_gain or simulates_worse(path, shorter):
            continue
        label = label_of(path.steps[number])
        task.progress(f"{label} is no longer needed")
        last = shorter.steps[-1]
        said = f"{last.remark}; {label} is no longer needed and was taken out"
        return replace(shorter, steps=(*shorter.steps[:-1], replace(last, remark=said)))
    return path


def with_simpler(task: Task, path: Hypothesis) -> Hypothesis:
    """The path with a law of fewer parameters in place of an earlier one of which the last effect leaves a
    part uncertain, where the model is likelier with it: while that effect was missing, the richer law bent to
    it, as a Stribeck curve does to a drag."""
    for number in range(len(task.first), len(path.steps) - 1):
        for law in _simpler_laws(path.steps[number], path.steps[-1].fit)[:MOST_SIMPLER]:
            former = label_of(path.steps[number])
            task.progress(f"refitting with {law.candidate.label} in place of {former}")
            other = _rebuilt(task, path, number, law)
            if (
                other is None
                or not is_accepted(other)
                or other.bic > path.bic
                or simulates_worse(path, other)
            ):
                continue
            said = f"{remark_on(law)} in place of {former}, which had bent to {label_of(path.steps[-1])}"
            steps = list(other.steps)
            steps[number] = replace(steps[number], remark=said)
            return replace(other, steps=tuple(steps))
    return path


def _simpler_laws(step: Step, fit: FitResult) -> list[Proof]:
    """What a step's round had refused beside its law for no more than that this is likelier, likeliest first:
    laws of fewer parameters at the same place, where a parameter of the law is uncertain in the `fit`."""
    if step.proof is None or step.diagnosis is None or not _is_partly_uncertain(step.proof, fit):
        return []
    candidate, places = step.proof.candidate, step.proof.places
    simpler = [
        proof
        for proof in step.diagnosis.proofs
        if proof.is_known
        and proof.delta_bic > GATES.min_bic_gain
        and proof.candidate.n_unknowns < candidate.n_unknowns
        and not places.isdisjoint(proof.places)
    ]
    return sorted(simpler, key=lambda proof: proof.delta_bic, reverse=True)


def _is_partly_uncertain(proof: Proof, fit: FitResult) -> bool:
    """Whether an estimated parameter of the effect is not certainly off zero in the `fit`."""
    own = proof.candidate.estimated
    return any(
        p.std_error is None or abs(p.value) < GATES.still_needed * p.std_error
        for p in fit.parameters
        if p.name in own
    )


def exchanged(task: Task, path: Hypothesis, diagnosis: Diagnosis) -> Hypothesis | None:
    """The path with an effect of its last round in place of one that was added before and has stood for it:
    beside that, unseen data are foreseen no better with the likelier effect, and no worse. None where there
    is no such effect, or the model is not likelier with it instead."""
    likely = [
        proof
        for proof in diagnosis.proofs
        if proof.is_known
        and proof.ahead
        and proof.delta_bic > GATES.min_bic_gain
        and not any(is_worse(one) for one in proof.ahead)
    ]
    best = max(likely, key=lambda proof: proof.delta_bic, default=None)
    if best is None or task.options.is_over:
        return None
    steps = (*path.steps, Step(best, best.told, diagnosis, ""))
    with suppress(OutOfTimeError), until(task.options.until):
        for number in _ambiguous(steps):
            former = label_of(path.steps[number])
            task.progress(f"refitting with {best.candidate.label} in place of {former}")
            other = _rebuilt(task, replace(path, steps=steps), number)
            if other is not None and _is_instead(other, path):
                said = f"supported in place of {former}, which had stood for it"
                last = replace(other.steps[-1], remark=said)
                return replace(other, steps=(*other.steps[:-1], last))
    return None


def _ambiguous(steps: Sequence[Step]) -> list[int]:
    """Earlier steps that may stand for what the last one does: those that were not separable from others when
    they were added, and those that have lost their certainty beside it."""
    doubtful = doubtful_steps(steps)
    return [
        number
        for number, step in enumerate(steps[:-1])
        if number in doubtful or (step.diagnosis and step.proof and step.proof.not_separable_from)
    ]


def _is_instead(other: Hypothesis, path: Hypothesis) -> bool:
    """Whether a path with as many effects takes the place of another: its last effect is accepted, it is
    likelier, and does not simulate unseen data worse."""
    return (
        is_accepted(other) and other.bic < path.bic - GATES.min_bic_gain and not simulates_worse(path, other)
    )


def _rebuilt(task: Task, path: Hypothesis, number: int, instead: Proof | None = None) -> Hypothesis | None:
    """The path built again from the model as it is, without one of its effects or with another one `instead`;
    None where that fails."""
    values = {**(instead.told.theta if instead is not None else {}), **path.steps[-1].fit.theta}
    built = Hypothesis(task.root, task.first)
    for at, step in enumerate(path.steps[len(task.first) :], start=len(task.first)):
        wanted = instead if at == number else step.proof
        if wanted is None:
            continue
        try:
            proof = proved_again(built.stand, wanted, values)
            stand = accept(built.stand, proof, task.options.jobs)
        except FAILURES:
            return None
        again = replace(step, proof=proof, fit=proof.told)
        built = Hypothesis(stand, (*built.steps, again))
    return built
