"""The examination of a fitted null: screen, proof, verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from daest.diagnosis.answers.changing_values import changing_value
from daest.diagnosis.answers.decided import FROM_ELSEWHERE, Decided, Evidence
from daest.diagnosis.answers.held_values import OtherValue, other_value, value_besides
from daest.diagnosis.answers.learned import learned_load, said, with_formula
from daest.diagnosis.answers.next_experiment import Asked, computed
from daest.diagnosis.answers.parts import parts_of
from daest.diagnosis.answers.told_laws import nearest_in_pieces
from daest.diagnosis.answers.unexplained import Loads
from daest.diagnosis.answers.verdict import beside_parts, beside_value, decide, two_alike
from daest.diagnosis.built_in.chosen import chosen_candidates, temperatures_of
from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.law_values import errors_last
from daest.diagnosis.evidence.load_starts import starts_from_nowhere
from daest.diagnosis.evidence.open_loop import driven_share, open_screen
from daest.diagnosis.evidence.ranking import best_accepted, is_settled
from daest.diagnosis.evidence.reasons import is_significant, unmoved
from daest.diagnosis.evidence.stand import Stand, quiet
from daest.diagnosis.evidence.unseen import innovations
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, grown, open_hold, with_other_hold
from daest.diagnosis.null_model.null_observer import NullObserver, run_null
from daest.diagnosis.options import REFIT_SECONDS, DiagnoseOptions, Progress
from daest.diagnosis.recordings.faulty import (
    EMPTY,
    EXPLAINED,
    PAUSED,
    faults_counted,
    faults_told,
    pauses_told,
)
from daest.diagnosis.recordings.jittered import TRUE_TIMES, Jitter, jitter
from daest.diagnosis.recordings.recorded_late import (
    EarlierInputs,
    earlier_inputs,
    gain_of_earlier_inputs,
    simulates_better,
)
from daest.diagnosis.refits.course import Course
from daest.diagnosis.refits.stages import DynamicTasks, dynamic_effects
from daest.diagnosis.screening.candidates import keeping_order
from daest.diagnosis.screening.disturbance import place_gains, smoothed_load
from daest.diagnosis.screening.free_forms import free_forms, keep_forms
from daest.diagnosis.screening.passed_once import back_on_their_way
from daest.diagnosis.screening.screen import screen
from daest.model.diagnosis import Candidate, Diagnosis, FreeForm, LearnedLoad, Proof, Screen
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, error_ratios
from daest.modelica.effects.attach import names_of
from daest.modelica.flat.clock import clock_unit
from daest.modelica.places.sites import sites_left, unused_inputs
from daest.numerics.deadline import OutOfTimeError, until
from daest.numerics.parallel import Workers, called, workers

LATE_TIMES = 20.0  # those of the fit of the model as it is, that a curve or other given values may take
LATE_SECONDS = 60.0  # and that they may take in any case
VALUES_LATE = " The time was up before it was known whether another given value says as much."
TIME_UP = " The time was up before all of them were refitted."
OPEN = ("external disturbance", "unknown effect", "cannot tell")


def examine(
    stand: Stand,
    library: Sequence[Effect],
    options: DiagnoseOptions,
    progress: Progress = lambda _: None,
    watched: Callable[[Sequence[Proof]], None] = lambda _: None,
    *,
    wants_law: bool = False,
) -> Diagnosis:
    """Screen, proof and verdict for a fitted null. `watched` sees the first refits, best first, and may end
    the examination by what it raises. One that `wants_law` is of use with an accepted law only: without one
    it ends when that is known, and tells no more than the proofs."""
    with quiet(), workers(options.jobs, options.cluster) as pool:
        return _examined(stand, library, options, progress, watched, pool, wants_law)


def _examined(
    stand: Stand,
    library: Sequence[Effect],
    options: DiagnoseOptions,
    progress: Progress,
    watched: Callable[[Sequence[Proof]], None],
    pool: Workers,
    wants_law: bool,
) -> Diagnosis:
    beside: list[_Beside] = []
    places = sites_left(stand.declared, stand.null.flat)
    candidates = chosen_candidates(
        library,
        places,
        stand.null.experiments,
        options,
        names_of(stand.null.flat),
        unused_inputs(stand.null.flat),
        temperatures_of(stand.declared),
        {x.name: x.unit for x in stand.null.flat.inputs},
    )
    progress(f"screening {len(candidates)} effect{'' if len(candidates) == 1 else 's'} at places")

    def screened() -> tuple[Stand, tuple[Candidate, ...], NullObserver, Screen, Screen | None]:
        null, reference = stand.null, stand.reference
        run = run_null(null)
        beside.append(_Beside(stand, run, pool))
        known, once = back_on_their_way(run, keeping_order(null.flat, null.explicit, candidates))
        beside[0].begin_simulations(known)
        is_only = reference is None or reference.adds_up
        # A screen in open loop asks this process for the models that the first one has made.
        found = screen(null, run, known, options.seed, pool if is_only else None)
        found = replace(found, skipped=(*found.skipped, *once))
        if reference is None or is_only:
            return stand, known, run, found, None
        return stand, known, run, found, open_screen(null, reference.start_in_use, known, options.seed)

    # All together: what comes from an earlier run shares its symbols.
    names, began = [candidate.label for candidate in candidates], stand.began
    parts = (stand.null.recorded_hold, stand.null.other_hold, names)
    stand, candidates, run, found, used = options.step("screen", parts, stand.null.flat, screened)
    stand = replace(stand, began=began)
    if stand.reference is not None and stand.validation:
        known = replace(stand.reference, innovations=innovations(run, stand.validation))
        stand = replace(stand, reference=known)
    null = stand.null
    values = _Values(stand, run, pool)
    if found.p_value < GATES.missing_level and not wants_law:
        values.begin()
    chosen_library = [
        e for e in library if not options.effects or {e.name, e.class_name} & set(options.effects)
    ]
    gains = place_gains(null, run)
    load = smoothed_load(null, run, gains)
    forms = beside[0].free_forms() if beside else free_forms(null, run)
    keep_forms(null, forms)
    form = next(iter(forms), None)
    bought = null.fit.log_likelihood - stand.told.log_likelihood
    starts = starts_from_nowhere(null, bought, sum(one.log_likelihood_gain for one in gains))
    loads = Loads(stand.declared, null, run, gains, form, starts=starts, without=stand.told)
    course = Course(
        stand, loads, load, (found, used), candidates, chosen_library, options, progress, watched, pool,
        beside[0].simulated if beside else None,
    )  # fmt: skip
    proofs, unproved, is_whole = course.proofs()
    form = _told_by_rest(forms, proofs)
    loads = replace(loads, form=form)
    evidence = Evidence(
        stand.baseline,
        found,
        proofs,
        options.fitted,
        loads,
        stand.told,
        unproved,
        still=unmoved(null.experiments, stand.validation),
        clock=clock_unit(stand.declared),
    )
    if proofs and not options.is_over:
        evidence = replace(evidence, earlier=_earlier(stand, proofs))
    if wants_law:
        decided = decide(evidence)
        if _is_without_law(stand, decided, loads):
            return _plain(stand, decided, evidence, loads, is_whole)
    evidence, decided, learned = _decided(stand, run, evidence, loads, options, progress)
    if decided.name in OPEN and not _says_most(stand, learned):
        proofs, is_in_time = course.in_pieces(proofs)
        is_whole = is_whole and is_in_time
        evidence = replace(evidence, proofs=proofs)
        decided = decide(evidence)
    decided = _with_changes(stand, run, evidence, decided, library, options)
    decided = _with_parts(stand, evidence, decided, library, options)
    decided, beside_values = _with_values(stand, values.get, evidence, decided, options, progress)
    message = decided.message + (said(learned) if learned and decided.name == "unknown effect" else "")
    message += beside_values
    if decided.name == "supported" and not options.is_over:
        message += value_besides(stand, next(p for p in decided.proofs if p.verdict == "supported"))
    if decided.name not in ("supported", "nothing missing"):
        message += _said_of_inputs(null, stand.told)
    off = _off(stand) if decided.name != "supported" else None
    if off is not None:
        message += off.told(evidence.clock)
    if decided.name not in EXPLAINED:
        message += nearest_in_pieces(decided.proofs, evidence.clock)
        message += two_alike(found) if decided.name == "external disturbance" else ""
    faults = "" if decided.name in EXPLAINED else faults_told(null.experiments)
    pauses = "" if decided.name in EXPLAINED else pauses_told(null.experiments)
    counted = "" if faults else faults_counted(decided.name, null.experiments, stand.validation)
    told = EMPTY if faults else PAUSED if pauses else TRUE_TIMES if off else ""
    following = told or _next_experiment(stand, decided, options)
    return replace(
        _plain(stand, decided, evidence, loads, is_whole),
        message=message + faults + pauses + counted + ("" if is_whole else TIME_UP),
        disturbance=form,
        next_experiment=following,
        learned=learned if decided.name == "unknown effect" else None,
    )


def _plain(stand: Stand, decided: Decided, evidence: Evidence, loads: Loads, is_whole: bool) -> Diagnosis:
    """What was found and `decided`, without what is told besides."""
    return Diagnosis(
        verdict=decided.name,
        message=decided.message,
        baseline=stand.told,
        proofs=decided.proofs,
        unproved=evidence.unproved,
        screen=evidence.screen,
        places=loads.gains,
        disturbance=None,
        validation=stand.told.simulated.get("validation"),
        next_experiment=decided.next_experiment,
        seconds=time.perf_counter() - stand.began,
        is_held=not stand.null.estimated,
        is_whole=is_whole,
        is_by_colour=decided.is_by_colour,
        is_of_starts=decided.is_of_starts,
    )


def _is_without_law(stand: Stand, decided: Decided, loads: Loads) -> bool:
    """Whether no law is accepted, nor will be by anything that comes behind the refits: by a simulation in
    pieces, where errors add up, or beside a load that begins with the recordings."""
    may_be_shown = stand.reference is not None and stand.reference.adds_up
    if may_be_shown or loads.starts:
        return False
    return all(proof.verdict == "rejected" for proof in decided.proofs)


def _says_most(stand: Stand, learned: LearnedLoad | None) -> bool:
    """Whether a curve takes most of the errors of simulated unseen data away."""
    if learned is None or learned.against or learned.fit is None:
        return False
    ratios = error_ratios(stand.told.simulated, learned.fit.simulated)
    return bool(ratios) and max(ratios) <= GATES.max_most_ratio


def _off(stand: Stand) -> Jitter | None:
    """The time stamps that are off, where a simulation shows it."""
    if stand.reference is None or stand.reference.adds_up:
        return None
    with suppress(*FAILURES):
        found = jitter(stand.null, stand.reference.fit)
        return found if found is not None and found.is_shown else None
    return None


def _earlier(stand: Stand, proofs: Sequence[Proof]) -> EarlierInputs:
    """The inputs that act before they are recorded, where simulations are better for it, too: by many samples
    only of a model without effects, where no law says all that there is to say, since that takes refits."""
    null = stand.null
    best = best_accepted(proofs)
    says_all = best is not None and is_settled([best]) and not errors_last(best)
    if stand.declared.attached or says_all:
        found = EarlierInputs(gain_of_earlier_inputs(null))
    else:
        found = earlier_inputs(null)
    return found if found.gain and simulates_better(null, found) else EarlierInputs()


def _decided(
    stand: Stand,
    run: NullObserver,
    evidence: Evidence,
    loads: Loads,
    options: DiagnoseOptions,
    progress: Progress,
) -> tuple[Evidence, Decided, LearnedLoad | None]:
    """The evidence, what it says, and the load as a curve where that is an effect of no known law; the curve
    may speak against that, and the evidence then tells it."""
    decided, form = decide(evidence), loads.form
    is_curve = decided.name == "unknown effect" and not decided.is_dynamic
    if not is_curve or form is None or form.p_value >= GATES.missing_level or options.is_over:
        return evidence, decided, None
    progress(f"refitting with the load as a curve over {form.label}")
    learned, longest = None, max(LATE_SECONDS, LATE_TIMES * stand.baseline.seconds)
    not_asked = (
        f"a model in which it follows {form.variable} depends on itself, or does not have that as its inputs "
        "are held"
    )
    try:
        with until(time.monotonic() + longest):
            learned = _learned(stand, run, form)
    except OutOfTimeError:
        not_asked = "the time was up"
    if learned is None:
        evidence = replace(evidence, rest=replace(loads, not_asked=not_asked))
        return evidence, decide(evidence), None
    if learned.against:
        evidence = replace(evidence, rest=replace(loads, against_form=learned.against))
        return evidence, decide(evidence), learned
    return evidence, decided, with_formula(learned)


class _Beside:
    """What asks nothing of the screen, and is begun beside it by other processes: the forms of the loads, and
    fits of effects with states by simulation."""

    def __init__(self, stand: Stand, run: NullObserver, pool: Workers) -> None:
        self.simulated = DynamicTasks(stand.null)
        self._pool, self._seconds = pool, REFIT_SECONDS * stand.baseline.seconds
        self._forms = [partial(_quiet_forms, stand.null, run)]
        pool.begin(called, self._forms, seconds=self._seconds)

    def begin_simulations(self, candidates: Sequence[Candidate]) -> None:
        tasks = self.simulated.of(dynamic_effects(candidates)[1])
        self._pool.begin(called, tasks, seconds=self._seconds)

    def free_forms(self) -> tuple[FreeForm, ...]:
        """Those of `free_forms`."""
        return next(self._pool.map(called, self._forms, seconds=self._seconds)).get()


def _quiet_forms(null: Null, run: NullObserver) -> tuple[FreeForm, ...]:
    with quiet():
        return free_forms(null, run)


class _Values:
    """The value that the model holds of which another one says most, which asks nothing of the refits and may
    begin beside them in another process."""

    def __init__(self, stand: Stand, run: NullObserver, pool: Workers) -> None:
        self._tasks = [partial(_quiet_values, stand, run)]
        self._pool, self._seconds = pool, REFIT_SECONDS * stand.baseline.seconds

    def begin(self) -> None:
        self._pool.begin(called, self._tasks, seconds=self._seconds)

    def get(self) -> OtherValue | None:
        """As `other_value` tells it. Raises OutOfTimeError."""
        return next(self._pool.map(called, self._tasks, seconds=self._seconds)).get()


def _quiet_values(stand: Stand, run: NullObserver) -> OtherValue | None:
    with quiet():
        return other_value(stand, run)


def _with_values(
    stand: Stand,
    values: Callable[[], OtherValue | None],
    evidence: Evidence,
    decided: Decided,
    options: DiagnoseOptions,
    progress: Progress,
) -> tuple[Decided, str]:
    """What is decided beside the value that the model holds of which another one says most, and a sentence on
    one that comes near where no law was found; empty where none does."""
    laws = [p for p in decided.proofs if p.verdict != "rejected"]
    law = next(iter(laws), None)
    if decided.name in ("nothing missing", "parameters off") or (options.is_over and law is None):
        return decided, ""
    # No law is claimed before it is known whether another value says as much, though the time be up.
    longest = 0.0 if law is None else max(LATE_SECONDS, LATE_TIMES * stand.baseline.seconds)
    progress("estimating what the model holds")
    # Dead reckoning tells two models of one equation alike, and else which of two comes near.
    adds_up = stand.reference is not None and stand.reference.adds_up
    try:
        with until(max(options.until, time.monotonic() + longest)):
            other = values()
    except OutOfTimeError:
        return decided, "" if law is None else VALUES_LATE
    if other is None:
        return decided, ""
    if law is None:
        if other.says_much and other.is_all:
            return _by_value_alone(decided, other), ""
        near = f" Another value of {other.text}, comes near: {other.remedy}."
        return decided, near if other.says_much and not adds_up else ""
    terms = [
        (one, stand.baseline, stand.null, error_ratios(stand.told.simulated, one.told.simulated))
        for one in laws
    ]
    if not adds_up and other.puts_aside(*terms[0]):
        return _by_value(decided, law, other), ""
    # What says as much as one of the laws that are not told apart is another answer beside them all.
    if not any(other.says_as_much_as(*of_one) for of_one in terms):
        return decided, ""
    return beside_value(evidence, decided, other), ""


def _with_changes(
    stand: Stand,
    run: NullObserver,
    evidence: Evidence,
    decided: Decided,
    library: Sequence[Effect],
    options: DiagnoseOptions,
) -> Decided:
    """What is decided beside the parameter that may change with time, where a law of the time is accepted."""
    law = next((p for p in decided.proofs if p.verdict != "rejected"), None)
    if law is None or options.is_over:
        return decided
    with suppress(OutOfTimeError), until(options.until):
        changing = changing_value(stand, run, law, library)
        ratios = error_ratios(stand.told.simulated, law.told.simulated)
        if changing is not None and changing.says_as_much_as(law, stand.baseline, stand.null, ratios):
            return beside_value(evidence, decided, changing)
    return decided


def _with_parts(
    stand: Stand,
    evidence: Evidence,
    decided: Decided,
    library: Sequence[Effect],
    options: DiagnoseOptions,
) -> Decided:
    """What is decided beside the parts, with sizes of their own, of an accepted law that is their sum."""
    law = next((p for p in decided.proofs if p.verdict != "rejected" and p.candidate.effect.sum_of), None)
    if law is None or options.is_over:
        return decided
    with suppress(OutOfTimeError), until(options.until):
        parts = parts_of(stand.null, law, library)
        if parts is not None and (parts.puts_aside or parts.says_as_much):
            return beside_parts(evidence, decided, law, parts)
    return decided


def _by_value(decided: Decided, law: Proof, other: OtherValue) -> Decided:
    """The verdict where another value of what the model holds says more than the accepted `law`."""
    reason = f"another value of {other.text}, explains the data better"
    proofs = tuple(
        p if p.verdict == "rejected" else replace(p, verdict="rejected", reason=reason)
        for p in decided.proofs
    )
    message = (
        f"The data contradict a given value. Another one of {other.text}, explains them better than "
        f"{law.candidate.label}: {other.remedy}."
    )
    return Decided("parameters off", message, proofs=proofs)


def _by_value_alone(decided: Decided, other: OtherValue) -> Decided:
    """The verdict where no law is accepted, and none is missing with another given value."""
    message = (
        f"The data contradict a given value. With another one of {other.text}, the model simulates all "
        f"recordings to their noise, and no effect is missing: {other.remedy}."
    )
    return Decided("parameters off", message, proofs=decided.proofs)


def _said_of_inputs(null: Null, told: FitResult) -> str:
    """A sentence on inputs that hardly move the fitted model; empty where they do, or move it with the
    estimates that are `told`, without coloured loads: loads may have taken over what they do."""
    share = driven_share(null)
    if share is None or share >= GATES.min_driven:
        return ""
    alone = driven_share(grown(null, null.flat, null.explicit, told, null.experiments))
    if alone is not None and alone >= GATES.min_driven:
        return ""
    remedy = ": check their columns and units, and the noise on them."
    if _are_steady(null.experiments):
        remedy = ", since they hardly change: record while they do."
    return f" The recorded inputs move the fitted model by {share:.1%} of what its outputs do{remedy}"


def _are_steady(experiments: Sequence[Experiment]) -> bool:
    """Whether every input keeps one level in all recordings."""
    u = np.concatenate([experiment.inputs for experiment in experiments])
    return bool(np.all(np.std(u, axis=0) < GATES.min_driven * np.abs(np.mean(u, axis=0))))


def _next_experiment(stand: Stand, decided: Decided, options: DiagnoseOptions) -> str:
    """The experiment of the verdict; computed, where candidates are left that could not be told apart. Where
    the model has no input, none is asked for."""
    null = stand.null
    if not null.flat.inputs:
        return FROM_ELSEWHERE.get(decided.next_experiment, decided.next_experiment)
    if decided.name != "cannot tell":
        return decided.next_experiment
    asked = Asked(decided.proofs, null.experiments, null.hold, options.seed)
    return computed(asked, decided.next_experiment)


def _learned(stand: Stand, run: NullObserver, form: FreeForm) -> LearnedLoad | None:
    """The load as a curve, with the other hold where the curve settles that it is the better one."""
    null = stand.null
    learned = learned_load(null, run, stand.baseline, form, stand.validation, stand.reference)
    if learned is None or learned.fit is None:
        return learned
    hold = open_hold(null, learned.fit.log_likelihood - stand.baseline.log_likelihood)
    kept = replace(learned, keeps_hold=True)
    if hold is None:
        return kept
    validation = stand.validation if stand.other_validation is None else stand.other_validation
    again = with_other_hold(null)
    other = learned_load(again, run, stand.baseline, form, validation, stand.reference)
    if other is None or other.fit is None:
        return kept
    return other if other.fit.log_likelihood > learned.fit.log_likelihood + GATES.min_hold_gain else kept


def _told_by_rest(forms: Sequence[FreeForm], proofs: Sequence[Proof]) -> FreeForm | None:
    """The form over the variable that the most likely wrong law leaves, if it says much; else the first.

    Forms with the same sign share most of what they say, that of dry friction. What is beyond it shows beside
    a law that takes that part."""
    wrong = [p for p in proofs if p.left is not None and is_significant(p.left, p.delta_log_likelihood)]
    nearest = max(wrong, key=lambda p: p.delta_log_likelihood, default=None)
    if nearest is None or nearest.left is None or not forms:
        return next(iter(forms), None)
    key = (nearest.left.load, nearest.left.variable, nearest.left.sign_of)
    same = [f for f in forms if (f.load, f.variable, f.sign_of) == key]
    return next(
        (f for f in same if f.log_likelihood_gain > GATES.min_same_form * forms[0].log_likelihood_gain),
        forms[0],
    )
