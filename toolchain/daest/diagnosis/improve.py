"""Improve: diagnose, put the best effect in, and again, until nothing is missing or nothing helps.

Where a round leaves several effects that it cannot tell apart, each of the best is pursued until a further
effect decides between them. After every addition, effects that were added before and are not needed beside
it are taken out again. Where the time is up, the best model so far is the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from daest.diagnosis.answers.held_values import in_project, other_value
from daest.diagnosis.answers.told_beside import held_told, limit_told
from daest.diagnosis.built_in.certainty import certainty_of
from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.built_in.trials import SHARPER, Trial
from daest.diagnosis.diagnose import switching_case
from daest.diagnosis.evidence.load_starts import QUICK, says_as_much_as_starts
from daest.diagnosis.evidence.proof import bic_gain
from daest.diagnosis.evidence.reasons import not_determined, unmoved
from daest.diagnosis.evidence.stand import Stand, begin, halved, limited, quiet
from daest.diagnosis.evidence.unseen import is_better, is_likelier, is_worse
from daest.diagnosis.examine import examine
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import known_values, without_memory
from daest.diagnosis.null_model.null_observer import run_null
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
from daest.diagnosis.refits.held_back import (
    foresees_no_better,
    is_needed_beside,
    is_seen_beside,
    lag_instead,
    lags_in_the_way,
    laws_in_the_way,
    told_beside,
)
from daest.diagnosis.refits.rounds import accept, gains_beside, proved_again, proved_beside, with_kinks
from daest.diagnosis.screening.candidates import fed
from daest.diagnosis.screening.scores import promising_pairs
from daest.diagnosis.without_equations.switching import diagnose_switching
from daest.errors import EstimationError
from daest.estimation.fitting.records import n_observed
from daest.model.defaults import MOST_EFFECTS
from daest.model.diagnosis import Candidate, Diagnosis, Improvement, Proof, Screen, Screened, Step
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, error_ratios
from daest.model.flat import FlatModel, with_equations
from daest.model.holds import Hold, hold_text
from daest.numerics.deadline import OutOfTimeError, until
from daest.numerics.threads import one_thread

MOST_SIMPLER = 2  # simpler laws that are tried in place of one
MOST_PATHS = 2  # hypotheses that are pursued side by side
MOST_TAKEN_UP = 2  # of those that were put aside, after an end with something missing
OUT_OF_TIME = "The time was up"


@dataclass(frozen=True)
class _Path:
    """A hypothesis: the model with the effects of `steps`. `last` and `reason` are those of its end."""

    stand: Stand
    steps: tuple[Step, ...]
    last: Diagnosis | None = None
    reason: str = ""

    @property
    def bic(self) -> float:
        """Up to a constant that all paths share."""
        fit = self.stand.baseline
        n = n_observed(self.stand.null.experiments)
        return float(len(fit.parameters) * np.log(n) - 2.0 * fit.log_likelihood)

    def ended(self, last: Diagnosis, reason: str) -> _Path:
        return replace(self, last=last, reason=reason)


class _OtherHoldError(Exception):
    """The inputs are better taken with the other hold: all is to be done again; `path` is what there was."""

    def __init__(self, hold: Hold, found: Diagnosis, path: _Path) -> None:
        super().__init__(hold)
        self.hold = hold
        self.found = found
        self.path = path


@dataclass(frozen=True)
class _Task:
    """What the rounds of all paths share; `root` is the model as it is, with the limits of its sensors, and
    `first` the steps up to it."""

    root: Stand
    first: tuple[Step, ...]
    library: Sequence[Effect]
    options: DiagnoseOptions
    most_effects: int
    progress: Progress


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
    task = _Task(stand, tuple(steps), library, options, most_effects, progress)
    try:
        found = _searched(task)
    except _OtherHoldError as other:
        progress(AGAIN.format(hold_text(other.hold)))
        again = replace(options, tried=other.hold, near=near)
        held = _improved(flat, library, experiments, validation, again, most_effects, progress)
        if says_as_much(_last_added(held), other.found.proofs):
            return held
        if options.is_over:
            path = _late(task, _with_best(task, other.path, other.found), "another effect was looked for")
            return _told(path)
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
        best = next((proof for proof in accepted if _helps(steps[-1].fit, proof)), None)
        if best is None:
            reason = found.message
            if accepted:
                label = accepted[0].candidate.label
                reason = f"{label} is supported, but it does not lower the validation error."
            break
        steps.append(Step(best, best.told, found, _remark(best)))
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


def _told(path: _Path) -> Improvement:
    assert path.last is not None
    reason = f"{path.reason} {_beside_values(path)} {held_told(path.stand)}".rstrip()
    return Improvement(path.steps, path.last, reason, path.stand.null.recorded_hold)


def _beside_values(path: _Path) -> str:
    """What is to be done about effects beside which another given value says as much; empty without any."""
    names = {
        name: _label(step)
        for step in path.steps
        if step.proof is not None
        for name in step.proof.given_values
    }
    return " ".join(
        f"{label} may stand for another value of `{name}`: before it is believed, estimate that, too "
        f"({in_project(name)}), and repeat this."
        for name, label in names.items()
    )


def _late(task: _Task, path: _Path, before: str) -> _Path:
    """The path, ended by the time that is up `before` something could be done."""
    last = path.last or path.steps[-1].diagnosis
    assert last is not None
    kept = " What was done is kept, and the same command goes on from there." if task.options.keeper else ""
    return path.ended(last, f"{OUT_OF_TIME} before {before}.{kept}")


def _last_added(found: Improvement) -> list[Proof]:
    """The proof of the last effect that a round added, if any did."""
    added = [step.proof for step in found.steps if step.proof is not None and step.diagnosis is not None]
    return added[-1:]


def _searched(task: _Task) -> _Path:
    """The best path, followed to its end. Where it ends and something is missing still, one that begins with
    another law, and paths that it has put aside, are followed: what was not separable from its effects may be
    what goes on. Raises _OtherHoldError, and what `examine` raises."""
    paths = [_Path(task.root, task.first)]
    put_aside: list[_Path] = []
    n_taken_up, is_begun_anew = 0, False
    while True:
        while any(path.last is None for path in paths):
            grown = [
                one for path in paths for one in ([path] if path.last is not None else _continued(task, path))
            ]
            paths = _leading(grown)
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
        task.progress(f"going on with {_label(other.steps[-1])} instead")
        paths = [*paths, other]


def _begun_otherwise(task: _Task, paths: Sequence[_Path]) -> list[_Path]:
    """A path that begins with another law than the best one does: with the one that leads the screen, or that
    of the other kind that leads there, of a signal in place of one in the machine or the other way round. It
    is to explain nearly as much alone: of two laws that are missing at once, a third may do most of what both
    do, and a law bends to the other. None where there is none, or it was begun with already."""
    number = len(task.first)
    first = next(iter(paths[0].steps[number:]), None)
    if first is None or first.proof is None or first.diagnosis is None:
        return []
    known = {_label(path.steps[number]) for path in paths if len(path.steps) > number}
    for entry in _other_leaders(first.diagnosis.screen, first.proof.candidate):
        if entry.candidate.label in known:
            continue
        task.progress(f"refitting with {entry.candidate.label} in place of {_label(first)}")
        with suppress(*FAILURES, OutOfTimeError), until(task.options.until):
            proof = proved_beside(task.root, Trial(entry.candidate, entry.sizes, ()), {})
            begun = _begun_with(task, proof, first.proof, first.diagnosis)
            if begun:
                return begun
    return []


def _begun_with(task: _Task, proof: Proof, first: Proof, diagnosis: Diagnosis) -> list[_Path]:
    """The paths that begin with a law in place of the `first`: by itself where it is accepted and explains
    nearly as much; together with what follows where it was refused, and is likelier than the first."""
    begin = _Path(task.root, task.first)
    if proof.verdict != "rejected" and _helps(task.root.told, proof):
        is_near = proof.delta_log_likelihood > GATES.min_doubted_gain * first.delta_log_likelihood
        return [_extended(task, begin, proof, diagnosis)] if is_near else []
    is_likely = proof.is_known and proof.delta_bic > first.delta_bic
    return _with_unproven(task, begin, diagnosis, proof) if is_likely else []


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


def _beside_others(paths: Sequence[_Path]) -> _Path:
    """The best path, which tells the others beside which nothing is missing, either, and that are not clearly
    worse: a list of effects that explains all is not yet the one that acts."""
    best, *others = paths
    if best.last is None or best.last.verdict != "nothing missing":
        return best
    alike = [_labels(path) for path in others if path.last and path.last.verdict == best.last.verdict]
    rivals = [labels for labels in dict.fromkeys(alike) if labels and set(labels) != set(_labels(best))]
    if not rivals:
        return best
    told = " or ".join(f"{', then '.join(labels)}" for labels in rivals)
    return replace(best, reason=f"{best.reason} These data do not tell this list from {told}.")


def _labels(path: _Path) -> tuple[str, ...]:
    return tuple(_label(step) for step in path.steps if step.proof is not None)


def _continued(task: _Task, path: _Path) -> list[_Path]:
    """The path with one more effect, several times where its round leaves several that are not separable; or
    ended."""
    stand = path.stand
    if task.options.is_over and path.steps[-1].diagnosis is not None:
        return [_late(task, path, "another effect was looked for")]
    try:
        diagnosis = examine(stand, task.library, task.options, task.progress)
    except EstimationError as error:
        last = path.steps[-1].diagnosis
        if error.code != "diagnose-no-candidate" or last is None:
            raise
        return [path.ended(last, "No other effect was to be searched for.")]
    accepted = [proof for proof in diagnosis.proofs if proof.verdict != "rejected"]
    if not diagnosis.is_whole:
        if diagnosis.verdict == "supported" and _helps(stand.told, accepted[0]):
            with suppress(*FAILURES):
                grown = _with_best(task, path, diagnosis)
                path = path if _displaces(path, grown) else grown
        return [_late(task, replace(path, last=diagnosis), "all candidates of a round were refitted")]
    if not accepted and unmoved(stand.null.experiments, stand.validation):
        return [path.ended(diagnosis, diagnosis.message)]
    if not accepted:
        other = _exchanged(task, path, diagnosis) or _with_pair(task, path, diagnosis)
        if other is not None:
            return [other]
        return _beside_another(task, path, diagnosis) or [path.ended(diagnosis, diagnosis.message)]
    beside = _beside_another(task, path, diagnosis)
    if beside:
        return beside
    if all(proof.candidate.is_of_parameter for proof in accepted):
        # A parameter that changes does the work of laws that are seen only together.
        other = _with_pair(task, path, diagnosis)
        if other is not None:
            return [other]
    helpful = [proof for proof in accepted if _helps(stand.told, proof)]
    if not helpful:
        labels = accepted[0].candidate.label
        return [path.ended(diagnosis, f"{labels} is supported, but it does not lower the validation error.")]
    hold = None if task.options.is_over else better_hold(stand, diagnosis.proofs)
    if hold is not None:
        raise _OtherHoldError(hold, diagnosis, path)
    further: list[_Path] = []
    for proof in helpful[:MOST_PATHS]:
        with suppress(*FAILURES):
            further.append(_extended(task, path, proof, diagnosis))
    if not further:
        label = helpful[0].candidate.label
        return [path.ended(diagnosis, f"{label} is supported, but no further fit of the model with it ends.")]
    kept = [one for one in further if not _displaces(path, one)]
    for label in [_label(one.steps[-1]) for one in further if all(one is not other for other in kept)]:
        task.progress(f"{label} is taken out again")
    return kept or [path.ended(diagnosis, _displaced(path, further[0]))]


def _displaces(path: _Path, grown: _Path) -> bool:
    """Whether a further effect leaves nothing certain of one that was added before, and yet simulates unseen
    data worse than that one does: it stands for it, and is the worse of the two."""
    return bool(_newly_doubtful(path, grown)) and _is_worse(path, grown)


def _newly_doubtful(path: _Path, grown: _Path) -> list[int]:
    """Steps whose effects have lost their certainty by the last one of a path that has grown by it."""
    if len(grown.steps) != len(path.steps) + 1:
        return []
    before = _uncertain(path.steps, path.steps[-1].fit)
    return [number for number in _doubtful(grown.steps) if number not in before]


def _displaced(path: _Path, grown: _Path) -> str:
    """Why a path ends before an effect that displaces others (`_displaces`)."""
    former = " and ".join(_label(grown.steps[number]) for number in _newly_doubtful(path, grown))
    return (
        f"{_label(grown.steps[-1])} would be supported, but it leaves nothing certain of {former}, and "
        f"simulates unseen data {_ratio(path, grown):.3g} times worse: it stands for what is in the model."
    )


def _with_best(task: _Task, path: _Path, diagnosis: Diagnosis) -> _Path:
    """The path with the best accepted effect of its last round."""
    best = next(proof for proof in diagnosis.proofs if proof.verdict != "rejected")
    return _extended(task, path, best, diagnosis)


def _extended(task: _Task, path: _Path, proof: Proof, diagnosis: Diagnosis) -> _Path:
    step = Step(proof, proof.told, diagnosis, _remark(proof))
    task.progress(f"added {proof.candidate.label}")
    grown = _Path(accept(path.stand, proof, task.options.jobs), (*path.steps, step))
    hold = grown.stand.null.hold
    if hold != path.stand.null.hold:
        # What is written is fitted with the hold that the ledger tells.
        grown = _refitted(grown, grown.stand, f"refitted: {hold_text(hold)}")
    with suppress(OutOfTimeError), until(task.options.until):
        grown = _with_kinks(task, _without_superfluous(task, grown))
        # Only with kinks as they are is it seen what they leave of a form.
        simpler = _with_simpler(task, grown)
        grown = grown if simpler is grown else _with_kinks(task, simpler)
    grown = _noted(path, grown)
    if len(grown.steps) - len(task.first) >= task.most_effects:
        return grown.ended(diagnosis, f"The limit of {task.most_effects} effects is reached.")
    return grown


def _remark(proof: Proof) -> str:
    inside = [proof.inside] if proof.inside and proof.inside not in proof.not_separable_from else []
    others, same = ", ".join([*proof.not_separable_from, *inside]), ", ".join(proof.same_as)
    said = f"not separable from {others}" if others else "supported"
    return f"{said}, and the same equation as {same}" if same else said


def _noted(path: _Path, grown: _Path) -> _Path:
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


def _with_kinks(task: _Task, path: _Path) -> _Path:
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
    return _refitted(path, stand, "kinks refitted beside it")


def _refitted(path: _Path, stand: Stand, remark: str) -> _Path:
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


def _with_pair(task: _Task, path: _Path, diagnosis: Diagnosis) -> _Path | None:
    """The path with two effects of which none is accepted alone, but each beside the other; None where the
    screen names no such pair, nor the diagnosis the parts of a sum, or where the refits refuse it, or other
    values of the parameters do."""
    pairs = _parts_of_a_sum(diagnosis) or promising_pairs(diagnosis.screen)
    if diagnosis.verdict == "parameters off" or not pairs:
        return None
    if task.options.is_over or len(path.steps) - len(task.first) + 2 > task.most_effects:
        return None
    (one, other), jobs = pairs[0], task.options.jobs
    task.progress(f"refitting with {one.candidate.label} and {other.candidate.label} together")
    try:
        with until(task.options.until):
            found = _in_turn(path.stand, one, other, jobs)
            if found is None or _in_turn(path.stand, other, one, jobs) is None:
                return None
    except (*FAILURES, OutOfTimeError):
        return None
    first, beside, last = found
    if not _helps(path.stand.told, last) or _value_says_as_much(path.stand, first, last):
        return None
    told = replace(first, verdict="supported", reason="")
    steps = (
        Step(told, told.told, diagnosis, f"only together with {last.candidate.label}"),
        Step(last, last.told, diagnosis, "supported"),
    )
    task.progress(f"added {first.candidate.label} and {last.candidate.label}")
    grown = _Path(accept(beside, last, task.options.jobs), (*path.steps, *steps))
    with suppress(OutOfTimeError), until(task.options.until):
        grown = _without_superfluous(task, grown)
    return grown


def _value_says_as_much(stand: Stand, first: Proof, last: Proof) -> bool:
    """Whether another value than one that is given makes the model of `stand` as likely as two effects do: an
    inertia that is 2 % off is two gains of the pressures before and behind it."""
    null = stand.null
    n_own = first.candidate.n_unknowns + last.candidate.n_unknowns
    gain = bic_gain(last.fit.log_likelihood - stand.baseline.log_likelihood, n_own, null)
    with suppress(*FAILURES), quiet():
        other = other_value(stand, run_null(null))
        return other is not None and other.delta_bic > gain - GATES.same_bic
    return False


def _parts_of_a_sum(diagnosis: Diagnosis) -> list[tuple[Screened, Screened]]:
    """The two laws for which a rejected one stood that is their sum, as the screen has them; none where there
    is no such."""
    entries = {entry.candidate.label: entry for entry in diagnosis.screen.entries}
    sums = (proof.stands_for for proof in diagnosis.proofs if len(proof.stands_for) == 2)
    return [(entries[one], entries[other]) for one, other in sums if {one, other} <= entries.keys()]


def _beside_another(task: _Task, path: _Path, diagnosis: Diagnosis) -> list[_Path]:
    """The paths with a lag of a sensor, or another law, and with what is accepted beside it; none where none
    holds a law back, or where one is in the model already that holds nothing back: two unproven lags, which
    trade with each other, let almost any law in."""
    if (
        path.steps[-1].is_unproven
        or task.options.is_over
        or len(path.steps) - len(task.first) + 2 > task.most_effects
    ):
        return []
    lags = lags_in_the_way(diagnosis)
    first = next(iter(lags or laws_in_the_way(diagnosis)), None)
    if first is None:
        return []
    grown, n_before = _with_unproven(task, path, diagnosis, first), len(path.steps) + 1
    if not lags:
        pairs = [(one, one.steps[n_before].proof) for one in grown]
        return [one for one, law in pairs if law and is_seen_beside(path.stand, first, law, task.options)]
    law = grown[0].steps[n_before].proof if grown else None
    if law is not None and not task.options.is_over:
        other = lag_instead(path.stand, lags[1:], law, task.options)
        if other is not None:
            again = _with_unproven(task, path, diagnosis, other)
            lags, grown = ([other], again) if again else (lags, grown)
            law = grown[0].steps[n_before].proof
    if law is not None and not is_needed_beside(path.stand, lags[0], law, task.options):
        return _without_unproven(task, path, diagnosis, law) or grown
    return grown


def _without_unproven(task: _Task, path: _Path, diagnosis: Diagnosis, law: Proof) -> list[_Path]:
    """The paths with a law that was accepted beside a lag which nothing proves, without that; none where it
    cannot be put in."""
    try:
        alone = proved_again(path.stand, law, law.fit.theta)
        told = replace(alone, verdict=law.verdict, reason="")
        beside = accept(path.stand, told, task.options.jobs)
    except FAILURES:
        return []
    return _continued(task, _Path(beside, (*path.steps, Step(told, told.told, diagnosis, law.verdict))))


def _with_unproven(task: _Task, path: _Path, diagnosis: Diagnosis, first: Proof) -> list[_Path]:
    """The paths with a law that shows together with others alone, and with what is accepted beside it; none
    where nothing is."""
    try:
        beside = accept(path.stand, first, task.options.jobs)
    except FAILURES:
        return []
    told = told_beside(first, path.stand, beside)
    step = Step(told, told.told, diagnosis, "only together with what follows", is_unproven=True)
    grown = _continued(task, _Path(beside, (*path.steps, step)))
    n_before = len(path.steps) + 1
    laws = [(one, one.steps[n_before].proof) for one in grown if len(one.steps) > n_before]
    return [one for one, law in laws if law is None or not foresees_no_better(law, diagnosis)]


def _in_turn(stand: Stand, one: Screened, other: Screened, jobs: int) -> tuple[Proof, Stand, Proof] | None:
    """The proof of one candidate alone, the stand with it, and the proof of the other one beside it; None
    where that one is refused. Raises what refits raise."""
    trials = [Trial(entry.candidate, entry.sizes, ()) for entry in (one, other)]
    first = proved_beside(stand, trials[0], {}, SHARPER)
    # Alone it may have gone where it vanishes, from where no search finds back.
    sizes = zip(one.candidate.effect.sizes, one.sizes, strict=True)
    values = {**first.fit.theta, **{f"{one.candidate.name}.{p.name}": size for p, size in sizes}}
    if not gains_beside(stand, first, trials[1], values, SHARPER):
        return None
    beside = accept(stand, first, jobs)
    last = proved_beside(beside, trials[1], values, SHARPER)
    return None if last.verdict == "rejected" else (first, beside, last)


def _exchanged(task: _Task, path: _Path, diagnosis: Diagnosis) -> _Path | None:
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
            former = _label(path.steps[number])
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
    doubtful = _doubtful(steps)
    return [
        number
        for number, step in enumerate(steps[:-1])
        if number in doubtful or (step.diagnosis and step.proof and step.proof.not_separable_from)
    ]


def _is_instead(other: _Path, path: _Path) -> bool:
    """Whether a path with as many effects takes the place of another: its last effect is accepted, it is
    likelier, and does not simulate unseen data worse."""
    return _is_accepted(other) and other.bic < path.bic - GATES.min_bic_gain and not _is_worse(path, other)


def _without_superfluous(task: _Task, path: _Path) -> _Path:
    """The path without the effects that the last one has made superfluous, one at a time."""
    for number in _doubtful(path.steps):
        shorter = _rebuilt(task, path, number)
        # A kink that is too sharp would count against the model that has fewer effects.
        shorter = shorter and _with_kinks(task, shorter)
        if shorter is None or shorter.bic > path.bic + GATES.min_bic_gain or _is_worse(path, shorter):
            continue
        label = _label(path.steps[number])
        task.progress(f"{label} is no longer needed")
        last = shorter.steps[-1]
        said = f"{last.remark}; {label} is no longer needed and was taken out"
        return replace(shorter, steps=(*shorter.steps[:-1], replace(last, remark=said)))
    return path


def _doubtful(steps: Sequence[Step]) -> list[int]:
    """Earlier steps whose effects have lost the certainty of all their sizes."""
    return _uncertain(steps[:-1], steps[-1].fit)


def _uncertain(steps: Sequence[Step], fit: FitResult) -> list[int]:
    """Steps whose effects have no size that is certain in the `fit`, alone or beside a parameter."""
    sizes = {p.name: p for p in fit.parameters}
    found = []
    for number, step in enumerate(steps):
        if step.proof is None or step.diagnosis is None:
            continue
        candidate = step.proof.candidate
        now = [(p, sizes.get(f"{candidate.name}.{p.name}")) for p in candidate.effect.sizes]
        before, gain = steps[number - 1].fit, step.proof.delta_log_likelihood
        if all(
            one is None or certainty_of(candidate, fit, one, p, before, gain) < GATES.still_needed
            for p, one in now
        ):
            found.append(number)
    return found


def _with_simpler(task: _Task, path: _Path) -> _Path:
    """The path with a law of fewer parameters in place of an earlier one of which the last effect leaves a
    part uncertain, where the model is likelier with it: while that effect was missing, the richer law bent to
    it, as a Stribeck curve does to a drag."""
    for number in range(len(task.first), len(path.steps) - 1):
        for law in _simpler_laws(path.steps[number], path.steps[-1].fit)[:MOST_SIMPLER]:
            former = _label(path.steps[number])
            task.progress(f"refitting with {law.candidate.label} in place of {former}")
            other = _rebuilt(task, path, number, law)
            if other is None or not _is_accepted(other) or other.bic > path.bic or _is_worse(path, other):
                continue
            said = f"{_remark(law)} in place of {former}, which had bent to {_label(path.steps[-1])}"
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


def _is_accepted(path: _Path) -> bool:
    last = path.steps[-1].proof
    return last is not None and last.verdict != "rejected"


def _rebuilt(task: _Task, path: _Path, number: int, instead: Proof | None = None) -> _Path | None:
    """The path built again from the model as it is, without one of its effects or with another one `instead`;
    None where that fails."""
    values = {**(instead.told.theta if instead is not None else {}), **path.steps[-1].fit.theta}
    built = _Path(task.root, task.first)
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
        built = _Path(stand, (*built.steps, again))
    return built


def _leading(paths: Sequence[_Path]) -> list[_Path]:
    """The paths that may still turn out to be the best, the best first; at most MOST_PATHS."""
    best = paths[0]
    for path in paths[1:]:
        best = path if _is_ahead(path, best) else best
    others = [path for path in paths if path is not best and not _is_ahead(best, path)]
    others.sort(key=lambda path: path.bic)
    return [best, *others[: MOST_PATHS - 1]]


def _is_ahead(one: _Path, other: _Path) -> bool:
    """Whether a hypothesis is clearly better: by the errors of its simulation of unseen data, or, where these
    do not differ clearly, by its likelihood; not by what it owes to an effect of whose size nothing is known
    any more. One of fewer effects need not be clearly likelier: three laws do what two others do."""
    if _ratio(other, one) < GATES.max_rival_error:
        return True
    if _ratio(one, other) < GATES.max_rival_error:
        return False
    least = 0.0 if len(one.steps) < len(other.steps) else GATES.min_bic_gain
    return one.bic < other.bic - least and not _doubtful(one.steps)


def _is_worse(path: _Path, other: _Path) -> bool:
    """Whether the other model simulates unseen data worse."""
    return _ratio(path, other) > 1.0 / GATES.max_round_ratio


def _ratio(before: _Path, after: _Path) -> float:
    """Errors on unseen data of the second model relative to those of the first; 1 where the whole simulation
    is dead reckoning, or unknown."""
    reference = before.stand.reference
    if reference is not None and reference.adds_up:
        return 1.0
    return _together(error_ratios(before.stand.told.simulated, after.stand.told.simulated))


def _together(ratios: Sequence[float]) -> float:
    """The rms of ratios of errors; 1 where none is known."""
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else 1.0


def _label(step: Step) -> str:
    return "" if step.proof is None else step.proof.candidate.label


def _helps(before: FitResult, best: Proof) -> bool:
    """Whether unseen data are foreseen better at some horizon or likelier, or the simulation error on
    validation data falls for some output and rises for none by as much, or falls clearly for all together:
    beside a second effect that is still missing, one of them may rise by a few per cent, not by a tenth."""
    if "validation" not in before.simulated or "validation" not in best.told.simulated:
        return True
    ratios = error_ratios(before.simulated, best.told.simulated)
    falls = bool(ratios) and min(ratios) < GATES.max_round_ratio and max(ratios) < 1.0 / GATES.max_round_ratio
    grows_little = max(ratios, default=0.0) <= 1.0 / GATES.max_clear_ratio
    falls = falls or (_together(ratios) <= GATES.max_clear_ratio and grows_little)
    return falls or any(is_better(one) for one in best.ahead) or is_likelier(best.confirmed)
