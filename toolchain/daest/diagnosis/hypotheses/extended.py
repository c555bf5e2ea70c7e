"""A hypothesis with one more effect, and what that does to the effects before it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.hypotheses.hypothesis import (
    Hypothesis,
    Task,
    doubtful_steps,
    error_ratio,
    label_of,
    remark_on,
    simulates_worse,
    uncertain_steps,
)
from daest.diagnosis.hypotheses.rebuilt import (
    refitted,
    with_kinks_refitted,
    with_simpler,
    without_superfluous,
)
from daest.diagnosis.refits.rounds import accept
from daest.model.diagnosis import Diagnosis, Proof, Step
from daest.model.fit import error_ratios
from daest.model.holds import hold_text
from daest.numerics.deadline import OutOfTimeError, until


def with_best(task: Task, path: Hypothesis, diagnosis: Diagnosis) -> Hypothesis:
    """The path with the best accepted effect of its last round."""
    best = next(proof for proof in diagnosis.proofs if proof.verdict != "rejected")
    return extended(task, path, best, diagnosis)


def extended(task: Task, path: Hypothesis, proof: Proof, diagnosis: Diagnosis) -> Hypothesis:
    step = Step(proof, proof.told, diagnosis, remark_on(proof))
    task.progress(f"added {proof.candidate.label}")
    grown = Hypothesis(accept(path.stand, proof, task.options.jobs), (*path.steps, step))
    hold = grown.stand.null.hold
    if hold != path.stand.null.hold:
        # What is written is fitted with the hold that the ledger tells.
        grown = refitted(grown, grown.stand, f"refitted: {hold_text(hold)}")
    with suppress(OutOfTimeError), until(task.options.until):
        grown = with_kinks_refitted(task, without_superfluous(task, grown))
        # Only with kinks as they are is it seen what they leave of a form.
        simpler = with_simpler(task, grown)
        grown = grown if simpler is grown else with_kinks_refitted(task, simpler)
    grown = _noted(path, grown)
    if len(grown.steps) - len(task.first) >= task.most_effects:
        return grown.ended(diagnosis, f"The limit of {task.most_effects} effects is reached.")
    return grown


def _noted(path: Hypothesis, grown: Hypothesis) -> Hypothesis:
    """The path that has grown by a step, of which the ledger says so where the simulation of unseen data has
    got worse by it and its errors add up: it is supported by predictions, which nobody would expect."""
    last = grown.steps[-1]
    ratios = error_ratios(path.stand.told.simulated, last.fit.simulated)
    whole = float(np.sqrt(np.mean(np.square(ratios)))) if ratios else 1.0
    if last.proof is None or not last.proof.adds_up or not whole > 1.0 + GATES.same_unseen_error:
        return grown
    said = (
        f"{last.remark}; unseen data are foreseen better, but the whole simulation, whose errors add up, "
        f"gets {whole:.3g} times worse"
    )
    return replace(grown, steps=(*grown.steps[:-1], replace(last, remark=said)))


def displaces(path: Hypothesis, grown: Hypothesis) -> bool:
    """Whether a further effect leaves nothing certain of one that was added before, and yet simulates unseen
    data worse than that one does: it stands for it, and is the worse of the two."""
    return bool(_newly_doubtful(path, grown)) and simulates_worse(path, grown)


def _newly_doubtful(path: Hypothesis, grown: Hypothesis) -> list[int]:
    """Steps whose effects have lost their certainty by the last one of a path that has grown by it."""
    if len(grown.steps) != len(path.steps) + 1:
        return []
    before = uncertain_steps(path.steps, path.steps[-1].fit)
    return [number for number in doubtful_steps(grown.steps) if number not in before]


def displaced(path: Hypothesis, grown: Hypothesis) -> str:
    """Why a path ends before an effect that displaces others (`displaces`)."""
    former = " and ".join(label_of(grown.steps[number]) for number in _newly_doubtful(path, grown))
    return (
        f"{label_of(grown.steps[-1])} would be supported, but it leaves nothing certain of {former}, and "
        f"simulates unseen data {error_ratio(path, grown):.3g} times worse: it stands for what is in the "
        "model."
    )
