"""Effects that are accepted only together: pairs, and laws that hold others back."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from daest.diagnosis.answers.held_values import other_value
from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.built_in.trials import SHARPER, Trial
from daest.diagnosis.evidence.proof import bic_gain
from daest.diagnosis.evidence.stand import Stand, quiet
from daest.diagnosis.gates import GATES
from daest.diagnosis.hypotheses.hypothesis import Hypothesis, Task, helps
from daest.diagnosis.hypotheses.rebuilt import without_superfluous
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.refits.held_back import (
    foresees_no_better,
    is_needed_beside,
    is_seen_beside,
    lag_instead,
    lags_in_the_way,
    laws_in_the_way,
    told_beside,
)
from daest.diagnosis.refits.rounds import accept, gains_beside, proved_again, proved_beside
from daest.diagnosis.screening.scores import promising_pairs
from daest.model.diagnosis import Diagnosis, Proof, Screened, Step
from daest.numerics.deadline import OutOfTimeError, until

GoOn = Callable[[Task, Hypothesis], list[Hypothesis]]  # continues a hypothesis by a round


def with_pair(task: Task, path: Hypothesis, diagnosis: Diagnosis) -> Hypothesis | None:
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
    if not helps(path.stand.told, last) or _value_says_as_much(path.stand, first, last):
        return None
    told = replace(first, verdict="supported", reason="")
    steps = (
        Step(told, told.told, diagnosis, f"only together with {last.candidate.label}"),
        Step(last, last.told, diagnosis, "supported"),
    )
    task.progress(f"added {first.candidate.label} and {last.candidate.label}")
    grown = Hypothesis(accept(beside, last, task.options.jobs), (*path.steps, *steps))
    with suppress(OutOfTimeError), until(task.options.until):
        grown = without_superfluous(task, grown)
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


def beside_another(task: Task, path: Hypothesis, diagnosis: Diagnosis, go_on: GoOn) -> list[Hypothesis]:
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
    grown, n_before = with_unproven(task, path, diagnosis, first, go_on), len(path.steps) + 1
    if not lags:
        pairs = [(one, one.steps[n_before].proof) for one in grown]
        return [one for one, law in pairs if law and is_seen_beside(path.stand, first, law, task.options)]
    law = grown[0].steps[n_before].proof if grown else None
    if law is not None and not task.options.is_over:
        other = lag_instead(path.stand, lags[1:], law, task.options)
        if other is not None:
            again = with_unproven(task, path, diagnosis, other, go_on)
            lags, grown = ([other], again) if again else (lags, grown)
            law = grown[0].steps[n_before].proof
    if law is not None and not is_needed_beside(path.stand, lags[0], law, task.options):
        return _without_unproven(task, path, diagnosis, law, go_on) or grown
    return grown


def with_unproven(
    task: Task, path: Hypothesis, diagnosis: Diagnosis, first: Proof, go_on: GoOn
) -> list[Hypothesis]:
    """The paths with a law that shows together with others alone, and with what is accepted beside it; none
    where nothing is."""
    try:
        beside = accept(path.stand, first, task.options.jobs)
    except FAILURES:
        return []
    told = told_beside(first, path.stand, beside)
    step = Step(told, told.told, diagnosis, "only together with what follows", is_unproven=True)
    grown = go_on(task, Hypothesis(beside, (*path.steps, step)))
    n_before = len(path.steps) + 1
    laws = [(one, one.steps[n_before].proof) for one in grown if len(one.steps) > n_before]
    return [one for one, law in laws if law is None or not foresees_no_better(law, diagnosis)]


def _without_unproven(
    task: Task, path: Hypothesis, diagnosis: Diagnosis, law: Proof, go_on: GoOn
) -> list[Hypothesis]:
    """The paths with a law that was accepted beside a lag which nothing proves, without that; none where it
    cannot be put in."""
    try:
        alone = proved_again(path.stand, law, law.fit.theta)
        told = replace(alone, verdict=law.verdict, reason="")
        beside = accept(path.stand, told, task.options.jobs)
    except FAILURES:
        return []
    return go_on(task, Hypothesis(beside, (*path.steps, Step(told, told.told, diagnosis, law.verdict))))
