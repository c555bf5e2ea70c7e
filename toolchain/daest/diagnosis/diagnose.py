"""Diagnose: whether something is missing, where, and what it is.

Null hypothesis -> screen of all candidates -> proof of the best -> verdict. A null without coloured loads, or
evidence from smoothed disturbances alone, would find effects that are not there.

The files of a search, each using only those behind it: diagnose (which hold) -> examine (screen and verdict)
-> course (which candidates in which order) -> stages (some together) -> attempts (one, from several starts)
-> in_use (one, by its simulation) -> search (its end) -> proof (its judgement) -> reasons, ranking -> trials.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from daest.diagnosis.answers.told_beside import told_whole
from daest.diagnosis.built_in.chosen import chosen_candidates, temperatures_of
from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.load_starts import QUICK, says_as_much_as_starts
from daest.diagnosis.evidence.ranking import best_accepted
from daest.diagnosis.evidence.stand import Stand, begin, halved, limited, without_noises
from daest.diagnosis.examine import examine
from daest.diagnosis.null_model.null import known_values, without_memory
from daest.diagnosis.options import DiagnoseOptions, Progress
from daest.diagnosis.recordings.contradicted import contradicted
from daest.diagnosis.recordings.holds import (
    AGAIN,
    IN_VAIN,
    HeldOtherwiseError,
    Holds,
    is_unsettled,
    says_as_much,
    says_more,
    unsettled_hold,
)
from daest.diagnosis.refits.elsewhere import ELSEWHERE, is_apart, led_elsewhere
from daest.diagnosis.refits.held_back import (
    is_needed_beside,
    is_seen_beside,
    lag_instead,
    lags_in_the_way,
    laws_in_the_way,
    told_beside,
    with_both,
    without,
)
from daest.diagnosis.refits.rounds import accept
from daest.diagnosis.without_equations.black_box import diagnose_black_box
from daest.diagnosis.without_equations.switching import diagnose_switching
from daest.fmu.binary_model import BinaryModel
from daest.model.diagnosis import Candidate, Diagnosis, Proof
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel, Model, with_equations
from daest.model.holds import Hold, hold_text
from daest.modelica.places.sites import sites, unused_inputs
from daest.numerics.threads import one_thread

NO_OTHER_LOOK = (
    " The time was up before it was known whether another look says more, with the inputs held otherwise, "
    "other loads or other starts."
)


@one_thread()  # many small matrices: a second thread only waits
def diagnose(
    flat: Model,
    library: Sequence[Effect],
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment] = (),
    options: DiagnoseOptions | None = None,
    progress: Progress = lambda _: None,
) -> Diagnosis:
    """Diagnose the model on the experiments (signals in the order of the model; unused columns in `extra`).

    Without `validation`, the second half of every experiment is kept for it. An FMU without equations is
    diagnosed from outside (`diagnosis.black_box`), a model with events by its simulation
    (`diagnosis.switching`). Raises EstimationError
    `diagnose-too-short`, `diagnose-no-place`, `diagnose-no-candidate`, and what identification raises.
    """
    began = time.perf_counter()
    options = (options or DiagnoseOptions()).begun()
    to_mend = contradicted(flat, *halved(experiments, validation), options.hold)
    if to_mend is not None:
        return to_mend
    if isinstance(flat, BinaryModel):
        return diagnose_black_box(flat, library, *halved(experiments, validation), options, progress)
    flat = with_equations(flat, "a diagnosis from inside")
    if flat.events is not None:
        return diagnose_switching(
            *switching_case(flat, library, experiments, validation, options), options, progress
        )
    found = _from_inside(flat, library, experiments, validation, options, progress)
    if options.is_over and found.is_whole and is_unsettled(found):
        found = replace(found, message=found.message + NO_OTHER_LOOK, is_whole=False)
    return replace(found, seconds=time.perf_counter() - began)


def _from_inside(
    flat: FlatModel,
    library: Sequence[Effect],
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    options: DiagnoseOptions,
    progress: Progress,
) -> Diagnosis:
    """The diagnosis of a model without events: where the first look leaves it open, by other loads, beside a
    lag, or with the inputs held otherwise."""
    asis = begin(flat, experiments, validation, options, progress)
    stand, limits = limited(asis, library, options)
    holds = Holds(stand, options)

    def begun(other: DiagnoseOptions) -> tuple[Stand, tuple[Proof, ...]]:
        return limited(begin(flat, experiments, validation, other, progress), library, other)

    def examined(
        other: DiagnoseOptions, there: Stand, its_limits: tuple[Proof, ...], wants_law: bool = False
    ) -> tuple[Sequence[Proof], Diagnosis]:
        second = examine(there, library, other, progress, wants_law=wants_law)
        second = _beside_another(there, second, library, other, progress) or second
        return second.proofs, told_whole(second, there, its_limits)

    def again(other: DiagnoseOptions, wants_law: bool = False) -> tuple[Sequence[Proof], Diagnosis]:
        return examined(other, *begun(other), wants_law)

    def held(hold: Hold, wants_law: bool = False) -> tuple[Sequence[Proof], Diagnosis]:
        known = asis.null.other_fit if hold == asis.null.other_hold else None
        return again(replace(options, tried=hold, near=known_values(asis.null.fit), known=known), wants_law)

    try:
        found = examine(stand, library, options, progress, holds.watched)
    except HeldOtherwiseError as shown:
        progress(AGAIN.format(hold_text(shown.hold)))
        proofs, told = held(shown.hold, wants_law=best_accepted(shown.proofs) is not None)
        if says_as_much(proofs, shown.proofs):
            return told
        found = examine(stand, library, options, progress)
        return told_whole(found, stand, limits)
    if found.is_of_starts and options.slowest_load is None and not options.is_over:
        progress(QUICK)
        limit = without_memory(stand.null.experiments)
        proofs, told = again(replace(options, slowest_load=limit, near=known_values(asis.null.fit)))
        if says_as_much_as_starts(stand.null, proofs):
            return told
    beside = _beside_another(stand, found, library, options, progress)
    if beside is not None:
        return told_whole(beside, stand, limits)
    elsewhere = led_elsewhere(stand, found, options)
    if elsewhere is not None:
        there, its_limits = begun(elsewhere)
        if is_apart(there, stand):
            progress(ELSEWHERE)
            proofs, told = examined(elsewhere, there, its_limits, wants_law=True)
            if says_more(proofs, found.proofs, stand):
                return told
    better, other = holds.better(found.proofs), unsettled_hold(stand, found)
    hold = better or other
    if hold is None or options.is_over:
        return told_whole(found, stand, limits)
    progress((AGAIN if better else IN_VAIN).format(hold_text(hold)))
    proofs, told = held(hold, wants_law=not better or best_accepted(found.proofs) is not None)
    is_second = says_as_much(proofs, found.proofs) if better else says_more(proofs, found.proofs, stand)
    return told if is_second else told_whole(found, stand, limits)


def _beside_another(
    stand: Stand,
    found: Diagnosis,
    library: Sequence[Effect],
    options: DiagnoseOptions,
    progress: Progress,
) -> Diagnosis | None:
    """The diagnosis once more beside a lag of a sensor, or a law, that holds another law back; None where
    there is none, or nothing is accepted there either."""

    def examined(first: Proof) -> Diagnosis | None:
        progress(f"looking once more, with {first.candidate.label} in the model")
        try:
            beside = accept(stand, first, options.jobs)
        except FAILURES:
            return None
        second = examine(beside, library, options, progress, wants_law=True)
        return with_both(second, told_beside(first, stand, beside), stand, found)

    if options.is_over:
        return None
    lags = lags_in_the_way(found)
    first = next(iter(lags or laws_in_the_way(found)), None)
    second = None if first is None else examined(first)
    if first is None or second is None:
        return None
    if not lags:
        return second if is_seen_beside(stand, first, second.proofs[0], options) else None
    other = None if options.is_over else lag_instead(stand, lags[1:], second.proofs[0], options)
    if other is not None:
        first, second = (other, again) if (again := examined(other)) is not None else (first, second)
    return second if is_needed_beside(stand, first, second.proofs[0], options) else without(second, first)


def switching_case(
    flat: FlatModel,
    library: Sequence[Effect],
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    options: DiagnoseOptions,
) -> tuple[FlatModel, tuple[Candidate, ...], tuple[Experiment, ...], tuple[Experiment, ...]]:
    """Of a model with events what is diagnosed by its simulation: the model without its noises, the
    candidates, the data for estimation and those for validation."""
    quiet, (estimation, unseen) = without_noises(flat), halved(experiments, validation)
    unused = unused_inputs(quiet)
    return (
        quiet,
        chosen_candidates(
            library,
            sites(quiet),
            estimation,
            options,
            unused=unused,
            temperatures=temperatures_of(quiet),
            input_units={x.name: x.unit for x in quiet.inputs},
        ),
        tuple(estimation),
        tuple(unseen),
    )
