"""Improve: diagnose, put the best effect in, and again, until nothing is missing or nothing helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from daest.diagnosis.diagnose import (
    AGAIN,
    IN_VAIN,
    accept,
    begin,
    better_hold,
    examine,
    says_more,
    unsettled_hold,
)
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import DiagnoseOptions, Progress
from daest.diagnosis.proof import best_accepted
from daest.diagnosis.unseen import is_better, is_likelier
from daest.errors import EstimationError
from daest.model.diagnosis import Diagnosis, Improvement, Proof, Step
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, error_ratios
from daest.model.flat import FlatModel


def improve(
    flat: FlatModel,
    library: Sequence[Effect],
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment] = (),
    options: DiagnoseOptions | None = None,
    most_effects: int = 4,
    progress: Progress = lambda _: None,
) -> Improvement:
    """Add effects one by one. Every round goes into the ledger, also the last one, which adds nothing."""
    options = options or DiagnoseOptions()
    stand = begin(flat, experiments, validation, options, progress)
    steps = [Step(None, stand.told, None, "the model as it is")]

    def ended(diagnosis: Diagnosis, reason: str) -> Improvement:
        return Improvement(tuple(steps), diagnosis, reason, stand.null.recorded_hold)

    while True:
        try:
            diagnosis = examine(stand, library, options, progress)
        except EstimationError as error:
            last = steps[-1].diagnosis
            if error.code != "diagnose-no-candidate" or last is None:
                raise
            return ended(last, "No other effect was to be searched for.")
        best = best_accepted(diagnosis.proofs)
        if best is None:
            nothing = ended(diagnosis, diagnosis.message)
            is_first = len(steps) == 1 and options.hold is None
            other = (better_hold(stand, diagnosis) or unsettled_hold(stand, diagnosis)) if is_first else None
            if other is None:
                return nothing
            progress(IN_VAIN[other])
            again = replace(options, hold=other)
            found = improve(flat, library, experiments, validation, again, most_effects, progress)
            proofs = [step.proof for step in found.steps if step.proof is not None]
            return found if says_more(proofs, stand) else nothing
        if not _helps(stand.told, best):
            reason = f"{best.candidate.label} is supported, but it does not lower the validation error."
            return ended(diagnosis, reason)
        hold = better_hold(stand, diagnosis)
        if hold is not None:
            progress(AGAIN[hold])
            again = replace(options, hold=hold)
            return improve(flat, library, experiments, validation, again, most_effects, progress)
        stand = accept(stand, best)
        steps.append(Step(best, best.told, diagnosis, _remark(steps, best)))
        progress(f"added {best.candidate.label}")
        if len(steps) > most_effects:
            return ended(diagnosis, f"The limit of {most_effects} effects is reached.")


def _helps(before: FitResult, best: Proof) -> bool:
    """Whether unseen data are foreseen better at some horizon or likelier, or the simulation error on
    validation data falls for some output and rises for none by as much."""
    if "validation" not in before.simulated or "validation" not in best.told.simulated:
        return True
    ratios = error_ratios(before.simulated, best.told.simulated)
    falls = bool(ratios) and min(ratios) < GATES.max_round_ratio and max(ratios) < 1.0 / GATES.max_round_ratio
    return falls or any(is_better(one) for one in best.ahead) or is_likelier(best.confirmed)


def _remark(steps: Sequence[Step], best: Proof) -> str:
    """What else is to be said of the round: rivals not separated, effects no longer needed."""
    said = []
    if best.not_separable_from:
        said.append(f"not separable from {', '.join(best.not_separable_from)}")
    sizes = {p.name: p for p in best.told.parameters}
    for step in steps:
        if step.proof is None:
            continue
        for parameter in step.proof.candidate.effect.sizes:
            now = sizes.get(f"{step.proof.candidate.name}.{parameter.name}")
            if (
                now
                and now.std_error
                and abs(now.value - (parameter.null or 0.0)) < GATES.still_needed * now.std_error
            ):
                said.append(f"{step.proof.candidate.label} is no longer needed")
    return "; ".join(said) or "supported"
