"""Improve: diagnose, put the best effect in, and again, until nothing is missing or nothing helps.

Where a round leaves several effects that it cannot tell apart, each of the best is pursued until a further
effect decides between them. After every addition, effects that were added before and are not needed beside
it are taken out again. Where the time is up, the best model so far is the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from daest.diagnosis.answers.held_values import in_project
from daest.diagnosis.answers.told_beside import held_told, limit_told
from daest.diagnosis.diagnose import switching_case
from daest.diagnosis.evidence.load_starts import QUICK, says_as_much_as_starts
from daest.diagnosis.evidence.stand import Stand, begin, halved, limited
from daest.diagnosis.hypotheses.extended import with_best
from daest.diagnosis.hypotheses.hypothesis import OUT_OF_TIME, Hypothesis, Task, helps, label_of, remark_on
from daest.diagnosis.hypotheses.searched import OtherHoldError, ended_by_time, searched
from daest.diagnosis.null_model.null import known_values, without_memory
from daest.diagnosis.options import DiagnoseOptions, Progress
from daest.diagnosis.recordings.contradicted import contradicted
from daest.diagnosis.recordings.holds import (
    AGAIN,
    BACK,
    IN_VAIN,
    better_hold,
    says_as_much,
    says_more,
    unsettled_hold,
)
from daest.diagnosis.refits.elsewhere import ELSEWHERE, is_apart, led_elsewhere
from daest.diagnosis.screening.candidates import fed
from daest.diagnosis.without_equations.switching import diagnose_switching
from daest.errors import EstimationError
from daest.model.defaults import MOST_EFFECTS
from daest.model.diagnosis import Candidate, Diagnosis, Improvement, Proof, Step
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel, with_equations
from daest.model.holds import hold_text
from daest.numerics.threads import one_thread


@one_thread()  # many small matrices: a second thread only waits
def improve(
    flat: FlatModel,
    library: Sequence[Effect],
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment] = (),
    options: DiagnoseOptions | None = None,
    most_effects: int = MOST_EFFECTS,
    progress: Progress = lambda _: None,
) -> Improvement:
    """Add effects one by one. Every round goes into the ledger, also the last one, which adds nothing. To a
    model with events the best effect of each round is added, judged by the whole simulation."""
    options = (options or DiagnoseOptions()).begun()
    to_mend = contradicted(flat, *halved(experiments, validation), options.hold)
    if to_mend is not None:
        step = Step(None, to_mend.baseline, None, "the model as it is")
        return Improvement((step,), to_mend, to_mend.message, to_mend.baseline.hold)
    return _improved(flat, library, experiments, validation, options, most_effects, progress)


def _improved(
    flat: FlatModel,
    library: Sequence[Effect],
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    options: DiagnoseOptions,
    most_effects: int,
    progress: Progress,
    begun: Stand | None = None,
) -> Improvement:
    """As `improve`, of recordings that do not contradict the model, from where it has `begun`; again with
    another hold, with quick loads, or where a simulation leads, where that says more."""
    if flat.events is not None:
        case = switching_case(flat, library, experiments, validation, options)
        return _improved_switching(_Rounds(*case, options, progress), most_effects)
    asis = begun or begin(flat, experiments, validation, options, progress)
    stand, limits = limited(asis, library, options)
    steps = [Step(None, asis.told, None, "the model as it is")]
    steps += [
        Step(one, one.told, None, f"seen in the recordings: {limit_told(stand, one)}") for one in limits
    ]
    near = known_values(asis.null.fit)
    task = Task(stand, tuple(steps), library, options, most_effects, progress)
    try:
        found = searched(task)
    except OtherHoldError as other:
        progress(AGAIN.format(hold_text(other.hold)))
        again = replace(options, tried=other.hold, near=near)
        held = _improved(flat, library, experiments, validation, again, most_effects, progress)
        if says_as_much(_last_added(held), other.found.proofs):
            return held
        if options.is_over:
            path = with_best(task, other.path, other.found)
            return _told(ended_by_time(task, path, "another effect was looked for"))
        progress(BACK.format(hold_text(stand.null.hold)))
        again = replace(options, tried=stand.null.hold, near=near)
        return _improved(flat, library, experiments, validation, again, most_effects, progress)
    nothing = _told(found)
    is_of_starts = nothing.last.is_of_starts and len(found.steps) == len(steps)
    if is_of_starts and options.slowest_load is None and not options.is_over:
        progress(QUICK)
        again = replace(options, slowest_load=without_memory(stand.null.experiments), near=near)
        quick = _improved(flat, library, experiments, validation, again, most_effects, progress)
        if says_as_much_as_starts(stand.null, _last_added(quick)):
            return quick
    if len(found.steps) > len(steps) or options.hold or options.tried or options.is_over:
        return nothing
    elsewhere = led_elsewhere(stand, nothing.last, options)
    if elsewhere is not None:
        there = begin(flat, experiments, validation, elsewhere, progress)
        if is_apart(there, stand):
            progress(ELSEWHERE)
            led = _improved(flat, library, experiments, validation, elsewhere, most_effects, progress, there)
            if says_more(_last_added(led), nothing.last.proofs, stand):
                return led
    hold = better_hold(stand, nothing.last.proofs) or unsettled_hold(stand, nothing.last)
    if hold is None:
        return nothing
    progress(IN_VAIN.format(hold_text(hold)))
    again = replace(options, tried=hold, near=near)
    other_way = _improved(flat, library, experiments, validation, again, most_effects, progress)
    return other_way if says_more(_last_added(other_way), nothing.last.proofs, stand) else nothing


@dataclass(frozen=True)
class _Rounds:
    """What `diagnose_switching` takes: the model with the effects that were added, and the rest."""

    flat: FlatModel
    candidates: tuple[Candidate, ...]
    estimation: tuple[Experiment, ...]
    validation: tuple[Experiment, ...]
    options: DiagnoseOptions
    progress: Progress

    def diagnosis(self) -> Diagnosis:
        return diagnose_switching(
            self.flat, self.candidates, self.estimation, self.validation, self.options, self.progress
        )

    def beside(self, proof: Proof) -> _Rounds:
        """The next round, with the effect of the proof in the model and the columns that feed it."""
        return replace(
            self,
            flat=with_equations(proof.flat, "a further round"),
            estimation=fed(self.estimation, proof.candidate),
            validation=fed(self.validation, proof.candidate),
        )


def _improved_switching(task: _Rounds, most_effects: int) -> Improvement:
    """Rounds of a model with events. Raises what the first diagnosis raises."""
    found = task.diagnosis()
    steps = [Step(None, found.baseline, None, "the model as it is")]
    while True:
        accepted = [proof for proof in found.proofs if proof.verdict != "rejected"]
        best = next((proof for proof in accepted if helps(steps[-1].fit, proof)), None)
        if best is None:
            reason = found.message
            if accepted:
                label = accepted[0].candidate.label
                reason = f"{label} is supported, but it does not lower the validation error."
            break
        steps.append(Step(best, best.told, found, remark_on(best)))
        task.progress(f"added {best.candidate.label}")
        if len(steps) > most_effects or task.options.is_over:
            reason = f"The limit of {most_effects} effects is reached."
            if task.options.is_over:
                reason = f"{OUT_OF_TIME} before another effect was looked for."
            break
        task = task.beside(best)
        try:
            found = task.diagnosis()
        except EstimationError as error:
            if error.code != "diagnose-no-candidate":
                raise
            reason = "No other effect was to be searched for."
            break
    return Improvement(tuple(steps), found, reason, found.baseline.hold)


def _told(path: Hypothesis) -> Improvement:
    assert path.last is not None
    reason = f"{path.reason} {_beside_values(path)} {held_told(path.stand)}".rstrip()
    return Improvement(path.steps, path.last, reason, path.stand.null.recorded_hold)


def _beside_values(path: Hypothesis) -> str:
    """What is to be done about effects beside which another given value says as much; empty without any."""
    names = {
        name: label_of(step)
        for step in path.steps
        if step.proof is not None
        for name in step.proof.given_values
    }
    return " ".join(
        f"{label} may stand for another value of `{name}`: before it is believed, estimate that, too "
        f"({in_project(name)}), and repeat this."
        for name, label in names.items()
    )


def _last_added(found: Improvement) -> list[Proof]:
    """The proof of the last effect that a round added, if any did."""
    added = [step.proof for step in found.steps if step.proof is not None and step.diagnosis is not None]
    return added[-1:]
