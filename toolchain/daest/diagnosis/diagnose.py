"""Diagnose: whether something is missing, where, and what it is.

Null hypothesis -> screen of all candidates -> proof of the best -> verdict. See DESIGN.md section 6 for why a
null without coloured loads, or evidence from smoothed disturbances alone, would find effects that are not
there.
"""

from __future__ import annotations

import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import LinAlgWarning
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from daest.diagnosis import verdict as verdicts
from daest.diagnosis.black_box import diagnose_black_box
from daest.diagnosis.candidates import fed, keeping_order, pairs
from daest.diagnosis.clipping import share_at_limit, with_clipped_sensors
from daest.diagnosis.disturbance import SmoothedLoad, place_gains, smoothed_load
from daest.diagnosis.free_forms import free_forms
from daest.diagnosis.gates import GATES
from daest.diagnosis.learned import learned_load, said, with_formula
from daest.diagnosis.loads import load_sites
from daest.diagnosis.next_experiment import Asked, computed
from daest.diagnosis.null import (
    Null,
    as_recorded,
    fit_null,
    grown,
    open_hold,
    refit,
    refitted,
    with_other_hold,
)
from daest.diagnosis.open_loop import ITERATIONS as IN_USE
from daest.diagnosis.open_loop import (
    driven_share,
    fitted_in_use,
    is_far_behind,
    open_screen,
    simulated_errors,
)
from daest.diagnosis.options import REFIT_SECONDS, DiagnoseOptions, Progress
from daest.diagnosis.proof import (
    GENTLE,
    Prepared,
    Reference,
    Searched,
    Trial,
    at_full_size,
    best_accepted,
    bic_gain,
    by_simulation,
    clipping_trials,
    could_compete,
    from_simulation,
    has_lost_its_way,
    is_below_null,
    is_significant,
    least_hope,
    may_be_likelier,
    moved,
    prepare,
    proof_of,
    ranked,
    searched,
    trials,
    with_steady_error,
)
from daest.diagnosis.rivals import (
    DynamicFits,
    Simulation,
    bent_fits,
    best_dynamic,
    best_simulation,
    dynamic_fits,
    no_richer_ones,
    nominal_simulation,
    not_begun_by,
    other_forms,
    reduced_laws,
    richer_laws,
    rounded,
    signal_laws,
    simpler_laws,
    simplest_first,
    storage_fits,
)
from daest.diagnosis.screen import NullObserver, run_null, screen
from daest.diagnosis.settled import FAILURES, settled, simulated
from daest.diagnosis.switching import diagnose_switching
from daest.diagnosis.unseen import adds_up, foreseen, innovations
from daest.errors import DaestError, EstimationError
from daest.estimation.identify import identify
from daest.estimation.records import part_of
from daest.fmu.binary_model import BinaryModel
from daest.model.diagnosis import (
    Candidate,
    Diagnosis,
    FreeForm,
    LearnedLoad,
    Proof,
    Screen,
    Unproved,
    VerdictName,
)
from daest.model.effects import Effect, Site
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions, error_ratios
from daest.model.flat import FlatModel, Model, with_equations
from daest.model.holds import Hold, hold_text
from daest.modelica.sites import sites
from daest.numerics.deadline import OutOfTimeError, until
from daest.numerics.parallel import Outcome, Workers, workers
from daest.numerics.statistics import chi2
from daest.systems.linearize import has_affine_dynamics
from daest.systems.reduce import reduce_index

TIME_IS_UP = "it was not refitted: the time was up"
MORE_TRIALS = 4  # where none of those is accepted, or the best leaves a curve over some variable
AGAIN = "with the effect, {} after all: once more"
BACK = "that says less: on as if {}"
IN_VAIN = "nothing was accepted: once more as if {}"
DYNAMIC_PARTS = 3  # tasks that the fits of the effects with states are
MOST_IN_USE = 3  # trials that lead the screen in open loop
FIRST_TRIALS = 2  # are refitted in any case, the second one alone where the first is not supported
FIRST_IN_USE = 5  # iterations of a simulation's fit, after which it may be far behind the leader
MOST_PLACES = 5  # that the sensors see alike, where a refit is tried again
ITERATIONS = 15  # of the simulation's fit from which one is tried again
CURVE_TIMES = 20.0  # those of the fit of the model as it is, that a refit with a curve may take
CURVE_SECONDS = 60.0  # and that it may take in any case
LOOP = 3  # times the time of a run where a loop is solved by iterations at every point


@threadpool_limits.wrap(limits=1)  # many small matrices: a second thread only waits
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
    options = (options or DiagnoseOptions()).begun()
    if isinstance(flat, BinaryModel):
        return diagnose_black_box(flat, library, *halved(experiments, validation), options, progress)
    flat = with_equations(flat, "a diagnosis from inside")
    if flat.events is not None:
        return diagnose_switching(
            *switching_case(flat, library, experiments, validation, options), options, progress
        )
    stand, limits = limited(begin(flat, experiments, validation, options, progress), library, options)
    holds = _Holds(stand, options)

    def held(hold: Hold) -> tuple[Sequence[Proof], Diagnosis]:
        again = replace(options, hold=hold)
        there, its_limits = limited(begin(flat, experiments, validation, again, progress), library, again)
        second = examine(there, library, again, progress)
        return second.proofs, beside_limits(second, there, its_limits)

    try:
        found = examine(stand, library, options, progress, holds.watched)
    except _HeldOtherwiseError as shown:
        progress(AGAIN.format(hold_text(shown.hold)))
        proofs, told = held(shown.hold)
        if says_as_much(proofs, shown.proofs):
            return replace(told, seconds=time.perf_counter() - stand.began)
        found = examine(stand, library, options, progress)
        return beside_limits(found, stand, limits)
    better, other = holds.better(found.proofs), unsettled_hold(stand, found)
    hold = better or other
    if hold is None or options.is_over:
        return beside_limits(found, stand, limits)
    progress((AGAIN if better else IN_VAIN).format(hold_text(hold)))
    proofs, told = held(hold)
    is_second = says_as_much(proofs, found.proofs) if better else says_more(proofs, stand)
    best = told if is_second else beside_limits(found, stand, limits)
    return replace(best, seconds=found.seconds + told.seconds)


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
    return quiet, _chosen(library, sites(quiet), estimation, options), tuple(estimation), tuple(unseen)


class _HeldOtherwiseError(Exception):
    """With the best of the first refits, `proofs`, the inputs were held as `hold` has it: the others would be
    refitted in vain."""

    def __init__(self, hold: Hold, proofs: Sequence[Proof]) -> None:
        super().__init__(hold_text(hold))
        self.hold, self.proofs = hold, tuple(proofs)


@dataclass(frozen=True)
class _Holds:
    """Asks candidates for the other hold, each once: `known` are the answers, by the name of the candidate
    and its log-likelihood."""

    stand: Stand
    options: DiagnoseOptions
    known: dict[tuple[str, float] | None, Hold | None] = field(default_factory=dict)

    def better(self, proofs: Sequence[Proof]) -> Hold | None:
        """As `better_hold`."""
        best = best_start(proofs)
        key = None if best is None else (best.candidate.name, best.fit.log_likelihood)
        if key not in self.known:
            self.known[key] = better_hold(self.stand, proofs)
        return self.known[key]

    def watched(self, proofs: Sequence[Proof]) -> None:
        """Raises _HeldOtherwiseError where the other hold is the better one, and there is time for it."""
        hold = None if self.options.is_over else self.better(proofs)
        if hold is not None:
            raise _HeldOtherwiseError(hold, proofs)


def better_hold(stand: Stand, proofs: Sequence[Proof]) -> Hold | None:
    """The other hold, where the best candidate fits better with it: the best accepted one, or else the most
    likely, which unseen data may refuse for nothing but the wrong hold."""
    null, best = stand.null, best_start(proofs)
    hold = None if best is None else open_hold(null, best.delta_log_likelihood)
    if best is None or hold is None:
        return None
    other = with_other_hold(null)
    other = replace(other, experiments=fed(other.experiments, best.candidate))
    names = tuple(p.name for p in best.fit.parameters)
    try:
        hopeless = best.fit.log_likelihood - GATES.hopeless_log_likelihood
        flat = with_equations(best.flat, "a refit")
        fit = refitted(flat, reduce_index(flat), names, other, hopeless=hopeless).fit
    except DaestError:
        return None
    return hold if fit.log_likelihood > best.fit.log_likelihood + GATES.min_hold_gain else None


def unsettled_hold(stand: Stand, found: Diagnosis) -> Hold | None:
    """The other hold, where something is missing, no candidate was accepted, and the data have not clearly
    refused it: with the wrong hold half a sample of delay is left, and the right law is refused for that."""
    if best_accepted(found.proofs) is not None or found.verdict in ("nothing missing", "parameters off"):
        return None
    return open_hold(stand.null)


def says_more(proofs: Sequence[Proof], stand: Stand) -> bool:
    """Whether a candidate was accepted that fits better than the model as it is with the hold of `stand`."""
    best = best_accepted(proofs)
    return best is not None and best.fit.log_likelihood > stand.baseline.log_likelihood + GATES.min_hold_gain


def says_as_much(proofs: Sequence[Proof], first: Sequence[Proof]) -> bool:
    """Whether an accepted candidate is at least as likely as the one of the `first` proofs, with whose law
    the other hold looked better: in a search of its own that hold may have no use for the law."""
    before, best = best_accepted(first), best_accepted(proofs)
    if before is None or best is None:
        return before is None
    return best.fit.log_likelihood >= before.fit.log_likelihood


@dataclass(frozen=True)
class Stand:
    """What is examined: the model as the user declared it (`declared`), the null made from it (with the
    effects that were accepted so far), the null's fit on the same terms as those of its rivals (`baseline`),
    the one without coloured loads (`reference`), and the validation data, with those for the other hold where
    they differ."""

    declared: FlatModel
    null: Null
    baseline: FitResult
    validation: tuple[Experiment, ...]
    began: float
    reference: Reference | None = None
    other_validation: tuple[Experiment, ...] | None = None

    @property
    def told(self) -> FitResult:
        """The fit of the model as it is whose errors are told."""
        return self.baseline if self.reference is None else self.reference.fit


def begin(
    flat: FlatModel,
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    options: DiagnoseOptions,
    progress: Progress = lambda _: None,
) -> Stand:
    """Fit the model as it is, with unknown loads. Raises as `diagnose`."""
    began = time.perf_counter()
    both = _divided(tuple(experiments), tuple(validation))
    held = None if options.held is None else _divided(*map(tuple, options.held))
    progress("fitting the model as it is, with unknown loads")

    def null_of(quiet: FlatModel) -> Null:
        coarse = None if held is None else held[0]
        return fit_null(quiet, load_sites(flat), both[0], options.hold, coarse, options.slowest_load)

    def unseen(hold: Hold | None) -> tuple[Experiment, ...]:
        return both[1] if held is None or hold is None else as_recorded(both[1], held[1], hold)

    def unseen_by(null: Null) -> tuple[Experiment, ...]:
        return unseen(null.recorded_hold)

    def fitted() -> Stand:
        null, baseline, reference = _fitted(without_noises(flat), null_of, unseen_by)
        other = unseen(null.other_hold) if held is not None and null.other_hold else None
        return Stand(flat, null, baseline, unseen_by(null), began, reference, other)

    return replace(options.step("null", (options.hold, options.slowest_load), flat, fitted), began=began)


def _fitted(
    flat: FlatModel, null_of: Callable[[FlatModel], Null], unseen_by: Callable[[Null], tuple[Experiment, ...]]
) -> tuple[Null, FitResult, Reference | None]:
    """The null that `null_of` makes of the model, and its `_told_fits` on the experiments `unseen_by` it;
    with the parameters held where loads would take over what the inputs do (`_simulated_better`)."""
    null = null_of(flat)
    baseline, reference = _told_fits(null, unseen_by(null))
    known = _simulated_better(flat, null, reference)
    if known is not None:
        fixed = null_of(known)
        again = _told_fits(fixed, unseen_by(fixed))
        if again[1] is not None and not again[1].adds_up:
            return fixed, *again
    return null, baseline, reference


def _simulated_better(flat: FlatModel, null: Null, reference: Reference | None) -> FlatModel | None:
    """The model with its parameters fixed at those of a fit by simulation, where that simulates far better
    than the null without its loads, whose errors add up: loads may have taken over what the inputs do, and
    have made of a machine that something holds one that drifts. None where the parameters stay free."""
    if not null.estimated or reference is None or not reference.adds_up:
        return None
    before = reference.fit.simulated.get("estimation")
    if (
        before is None
        or max(percent or 0.0 for percent in before.fit_percent.values()) > GATES.min_driven_fit
    ):
        return None
    try:
        fit = identify(flat, null.experiments, IdentifyOptions(method="oe", hold=null.hold))
    except FAILURES:
        return None
    after = fit.simulated["estimation"].rms
    if not all(after[name] < GATES.max_adrift_ratio * rms for name, rms in before.rms.items()):
        return None
    fixed = flat.with_theta(fit.theta)
    return replace(fixed, parameters=tuple(replace(p, estimate=False) for p in fixed.parameters))


def _told_fits(null: Null, validation: Sequence[Experiment]) -> tuple[FitResult, Reference | None]:
    """The fit of the null's model on the terms of its rivals, and what unseen data say of that model."""
    baseline = refit(null.flat, null.explicit, null.estimated, null, validation=validation)
    return baseline, reference_of(null, baseline, validation)


def limited(
    stand: Stand, library: Sequence[Effect], options: DiagnoseOptions
) -> tuple[Stand, tuple[Proof, ...]]:
    """The stand with the limits of the sensors that are certain to clip, and the proofs of these."""
    clips = options.clips([*stand.null.experiments, *stand.validation])
    found = with_clipped_sensors(stand.declared, library, clips)
    if not found.laws:
        return stand, ()

    known = stand.null

    def null_of(quiet: FlatModel) -> Null:
        nodes = load_sites(stand.declared)
        null = fit_null(quiet, nodes, known.experiments, known.hold, slowest=known.slowest)
        return replace(
            null,
            other_hold=known.other_hold,
            hold_lead=known.hold_lead,
            other_experiments=known.other_experiments,
            recorded_hold=known.recorded_hold,
        )

    def fitted() -> Stand:
        quiet = without_noises(found.flat)
        null, baseline, reference = _fitted(quiet, null_of, lambda _: stand.validation)
        return replace(stand, null=null, baseline=baseline, reference=reference)

    parts = (known.hold, known.recorded_hold, known.other_hold, *(law.name for law in found.laws))
    grown = replace(options.step("limited", parts, found.flat, fitted), began=stand.began)
    gain = grown.baseline.log_likelihood - stand.baseline.log_likelihood
    n_observed = sum(int(np.isfinite(e.outputs).sum()) for e in stand.null.experiments)
    n_own = len(found.laws)
    proofs = tuple(
        Proof(
            candidate=law,
            flat=grown.null.flat,
            fit=grown.baseline,
            delta_log_likelihood=gain,
            delta_bic=2.0 * gain - n_own * float(np.log(n_observed)),
            p_value=float(chi2.sf(2.0 * max(gain, 0.0), n_own)),
            explained=0.0,
            equivalent=(),
            not_separable_from=(),
            verdict="supported",
            reason="",
            final=grown.told,
        )
        for law in found.laws
    )
    return grown, proofs


def limit_told(stand: Stand, proof: Proof) -> str:
    """How the recordings show that a sensor cuts."""
    output = proof.candidate.site.name
    limit = proof.candidate.shape["limit"]
    share = share_at_limit(stand.null.experiments, output, limit)
    return f"{output} stays at {limit:.6g} in {100.0 * share:.2g} % of the samples, where its noise ends"


def beside_limits(found: Diagnosis, stand: Stand, limits: Sequence[Proof]) -> Diagnosis:
    """The diagnosis of a model that was given the limits of its sensors, with these told."""
    if not limits:
        return found
    told = "; ".join(limit_told(stand, proof) for proof in limits)
    text = f"The recordings show that a sensor cuts: {told}. The model was given that limit"
    if found.verdict in ("nothing missing", "parameters off"):
        name: VerdictName = "supported"
        labels = ", ".join(proof.candidate.label for proof in limits)
        message = f"{labels}; supported. {text}; beside it: {found.message}"
    else:
        name, message = found.verdict, f"{found.message} {text}, and what is said is beside it."
    return replace(found, verdict=name, message=message, proofs=(*limits, *found.proofs))


def reference_of(null: Null, fit: FitResult, validation: Sequence[Experiment]) -> Reference | None:
    """What unseen data say of the model of `null`, whose `fit` is that beside its loads; None where it cannot
    be fitted without coloured ones."""
    with _quiet():
        found = settled(null, fit, null.flat, null.explicit, null.experiments, validation)
        if found is None:
            return None
        white, observer = found
        # A simulation whose errors add up tells little of what the model lacks.
        reckons = adds_up(observer)
        told = white if reckons else simulated(null, white, null.flat, null.experiments, validation)
        errors = None
        if not reckons and told.method == "oe":
            flat = null.flat.with_theta(told.theta)
            explicit = replace(null.explicit, flat=flat)
            errors = simulated_errors(null, flat, explicit, told, null.experiments, validation)
        return Reference(told, foreseen(observer, validation), reckons, simulated=errors)


def examine(
    stand: Stand,
    library: Sequence[Effect],
    options: DiagnoseOptions,
    progress: Progress = lambda _: None,
    watched: Callable[[Sequence[Proof]], None] = lambda _: None,
) -> Diagnosis:
    """Screen, proof and verdict for a fitted null. `watched` sees the first refits, best first, and may end
    the examination by what it raises."""
    with _quiet():
        return _examined(stand, library, options, progress, watched)


@contextmanager
def _quiet() -> Iterator[None]:
    """A search tries models that overflow and gains that are nearly singular; it steps back from them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        warnings.simplefilter("ignore", LinAlgWarning)
        yield


def _examined(
    stand: Stand,
    library: Sequence[Effect],
    options: DiagnoseOptions,
    progress: Progress,
    watched: Callable[[Sequence[Proof]], None],
) -> Diagnosis:
    candidates = _chosen(library, sites(stand.declared), stand.null.experiments, options)
    progress(f"screening {len(candidates)} effect{'' if len(candidates) == 1 else 's'} at places")

    def screened() -> tuple[Stand, tuple[Candidate, ...], NullObserver, Screen, Screen | None]:
        null, reference = stand.null, stand.reference
        run, known = run_null(null), keeping_order(null.flat, null.explicit, candidates)
        found = screen(null, run, known, options.seed)
        if reference is None or reference.adds_up:
            return stand, known, run, found, None
        return stand, known, run, found, open_screen(null, reference.fit, known, options.seed)

    # All together: what comes from an earlier run shares its symbols.
    names, began = [candidate.label for candidate in candidates], stand.began
    parts = (stand.null.recorded_hold, stand.null.other_hold, names)
    stand, candidates, run, found, used = options.step("screen", parts, stand.null.flat, screened)
    stand = replace(stand, began=began)
    if stand.reference is not None and stand.validation:
        known = replace(stand.reference, innovations=innovations(run, stand.validation))
        stand = replace(stand, reference=known)
    null = stand.null
    chosen_library = [
        e for e in library if not options.effects or {e.name, e.class_name} & set(options.effects)
    ]
    gains = place_gains(null, run)
    load = smoothed_load(null, run, gains)
    forms = free_forms(null, run)
    form = next(iter(forms), None)
    loads = verdicts.Loads(stand.declared, null, run, gains, form)
    proofs, unproved, is_whole = _proofs(
        stand, loads, load, (found, used), candidates, chosen_library, options, progress, watched
    )
    form = _told_by_rest(forms, proofs)
    loads = replace(loads, form=form)
    evidence = verdicts.Evidence(stand.baseline, found, proofs, options.fitted, loads, stand.told, unproved)
    decided = verdicts.decide(evidence)
    learned = None
    is_curve = decided.name == "unknown effect" and form is not None and form.p_value < GATES.missing_level
    if is_curve and form is not None and not options.is_over:
        progress(f"refitting with the load as a curve over {form.label}")
        longest = max(CURVE_SECONDS, CURVE_TIMES * stand.baseline.seconds)
        with suppress(OutOfTimeError), until(time.monotonic() + longest):
            learned = _learned(stand, run, form)
        if learned is not None and learned.against:
            decided = verdicts.decide(replace(evidence, rest=replace(loads, against_form=learned.against)))
        elif learned is not None:
            learned = with_formula(learned)
    message = decided.message + (said(learned) if learned and decided.name == "unknown effect" else "")
    message += _said_of_inputs(null) if decided.name not in ("supported", "nothing missing") else ""
    return Diagnosis(
        verdict=decided.name,
        message=message if is_whole else f"{message} The time was up before all of them were refitted.",
        baseline=stand.told,
        proofs=decided.proofs,
        unproved=unproved,
        screen=found,
        places=gains,
        disturbance=form,
        validation=stand.told.simulated.get("validation"),
        next_experiment=_next_experiment(stand, decided, options),
        seconds=time.perf_counter() - stand.began,
        learned=learned if decided.name == "unknown effect" else None,
        is_held=not null.estimated,
        is_whole=is_whole,
        is_by_colour=decided.is_by_colour,
    )


def _said_of_inputs(null: Null) -> str:
    """A sentence on inputs that hardly move the fitted model; empty where they do."""
    share = driven_share(null)
    if share is None or share >= GATES.min_driven:
        return ""
    return (
        f" The recorded inputs move the fitted model by {share:.1%} of what its outputs do: check their "
        "columns and units, and the noise on them."
    )


def _next_experiment(stand: Stand, decided: verdicts.Decided, options: DiagnoseOptions) -> str:
    """The experiment of the verdict; computed, where candidates are left that could not be told apart."""
    null = stand.null
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
    if hold is None:
        return learned
    validation = stand.validation if stand.other_validation is None else stand.other_validation
    again = with_other_hold(null)
    other = learned_load(again, run, stand.baseline, form, validation, stand.reference)
    if other is None or other.fit is None:
        return learned
    return other if other.fit.log_likelihood > learned.fit.log_likelihood + GATES.min_hold_gain else learned


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


def accept(stand: Stand, proof: Proof, jobs: int = 1) -> Stand:
    """The stand with the effect of `proof` in the model. With two `jobs`, its two fits run together."""
    null = stand.null
    experiments = fed(null.experiments, proof.candidate)
    flat = with_equations(proof.flat, "a further round")
    model = grown(null, flat, reduce_index(flat), proof.fit, experiments)
    validation = fed(stand.validation, proof.candidate)
    # The refit of the proof has not predicted the unseen data, by which a later round sees that it is at the
    # noise of the sensors.
    fits: list[Callable[[], Any]] = [
        partial(refit, model.flat, model.explicit, model.estimated, model, validation=validation),
        partial(reference_of, model, proof.fit, validation),
    ]
    with workers(jobs) as pool:
        baseline, reference = (o.get() for o in pool.map(_called, fits, seconds=stand.baseline.seconds))
    if reference is not None and proof.final is not None:
        # What was told of the effect stays true of the model that holds it.
        ratios = error_ratios(reference.fit.simulated, proof.final.simulated)
        if ratios and np.mean(np.square(ratios)) < 1.0:
            reference = replace(reference, fit=proof.final)
    return Stand(stand.declared, model, baseline, validation, time.perf_counter(), reference)


def proved_again(stand: Stand, proof: Proof, values: Mapping[str, float]) -> Proof:
    """The proof of the same effect beside another model, that of `stand`, started from the parameter `values`
    of a fit. Raises what refits raise."""
    candidate = proof.candidate
    own = {p.name: values.get(f"{candidate.name}.{p.name}") for p in candidate.effect.parameters}
    shape = {name: v for name in candidate.shape if (v := own[name]) is not None}
    shaped = replace(candidate, shape={**candidate.shape, **shape})
    trial = Trial(shaped, tuple(own[p.name] or p.start for p in candidate.effect.sizes), ())
    found = proved_beside(stand, trial, values)
    return replace(found, equivalent=proof.equivalent, not_separable_from=proof.not_separable_from)


def gains_beside(stand: Stand, first: Proof, trial: Trial, sharper: float = 1.0) -> bool:
    """Whether a further effect, the `trial`, makes the model with that of `first` as much likelier as
    evidence must: a refit without the judgement of `proved_beside`. Raises what refits raise."""
    null = stand.null
    with _quiet():
        flat = with_equations(first.flat, "a further round")
        model = grown(null, flat, reduce_index(flat), first.fit, fed(null.experiments, first.candidate))
        prepared = prepare(model.flat, model.estimated, trial, sharper=sharper)
        model = replace(model, experiments=fed(model.experiments, trial.candidate))
        fit = refitted(prepared.flat, reduce_index(prepared.flat), prepared.names, model).fit
    gain = fit.log_likelihood - first.fit.log_likelihood
    return bic_gain(gain, len(prepared.names) - len(model.estimated), model) >= GATES.min_bic_gain


def proved_beside(stand: Stand, trial: Trial, values: Mapping[str, float], sharper: float = 1.0) -> Proof:
    """The proof of one candidate in the model of `stand`, whose parameters start from `values` where these
    have them; its kinks are `sharper` than those of the trial. Raises what refits raise."""
    null = stand.null
    with _quiet():
        run = run_null(null)
        load = smoothed_load(null, run, place_gains(null, run))
        form = next(iter(free_forms(null, run)), None)
        if stand.reference is not None and stand.validation:
            known = replace(stand.reference, innovations=innovations(run, stand.validation))
            stand = replace(stand, reference=known)
        flat = null.flat.with_theta({n: values[n] for n in null.estimated if n in values})
        prepared = prepare(flat, null.estimated, trial, sharper=sharper)
        return _found_somehow(_Search(stand, run, load, form, 1), prepared)


def without_noises(flat: FlatModel) -> FlatModel:
    """The model with its declared noises at zero: the null has loads of its own."""
    silent = ca.SX.zeros(flat.w.numel())
    residual, outputs = ca.substitute([flat.residual, flat.output_expressions], [flat.w], [silent])
    events = flat.events
    if events is not None:
        parts = {name: part for name, part in vars(events).items() if isinstance(part, ca.SX)}
        quiet = ca.substitute(list(parts.values()), [flat.w], [silent])
        changed: dict[str, Any] = dict(zip(parts, quiet, strict=True))
        events = replace(events, **changed)
    return replace(
        flat, noises=(), w=ca.SX.sym("w", 0), residual=residual, output_expressions=outputs, events=events
    )


def halved(
    experiments: Sequence[Experiment], validation: Sequence[Experiment]
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:
    """Without validation data, the first halves of the experiments and the second ones."""
    if validation:
        return tuple(experiments), tuple(validation)
    cuts = [e.n_samples // 2 for e in experiments]
    first = tuple(part_of(e, 0, cut) for e, cut in zip(experiments, cuts, strict=True))
    second = tuple(part_of(e, cut, e.n_samples) for e, cut in zip(experiments, cuts, strict=True))
    return first, second


def _divided(
    experiments: tuple[Experiment, ...], validation: tuple[Experiment, ...]
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:
    experiments, validation = halved(experiments, validation)
    n_samples = sum(e.n_samples for e in experiments)
    if n_samples < GATES.min_samples:
        raise EstimationError(
            "diagnose-too-short",
            f"{n_samples} samples to diagnose from cannot tell a missing effect from noise",
            remedy=f"record at least {2 * GATES.min_samples} samples (half are kept for validation) that "
            "move the machine through its whole range, in both directions and through rest",
        )
    return experiments, validation


def _chosen(
    library: Sequence[Effect],
    places: Sequence[Site],
    experiments: Sequence[Experiment],
    options: DiagnoseOptions,
) -> tuple[Candidate, ...]:
    columns = [name for name in experiments[0].extra if _is_new_signal(name, experiments)]
    whole = pairs(library, places, columns)
    return tuple(
        c
        for c in whole
        if (not options.effects or c.effect.name in options.effects or c.effect.class_name in options.effects)
        and (not options.places or {c.site.name, *c.site.aliases} & set(options.places))
    )


def _is_new_signal(name: str, experiments: Sequence[Experiment]) -> bool:
    """Whether an unused column could be a cause: it moves in every experiment, and it is not just another
    form of an input or of a measured output (a command in other units, the reference of a control loop, a
    speed beside a measured angle)."""
    for experiment in experiments:
        if name not in experiment.extra or np.ptp(np.nan_to_num(experiment.extra[name])) == 0.0:
            return False
    column = np.concatenate([np.nan_to_num(e.extra[name]) for e in experiments])
    known = np.concatenate([_known_signals(e) for e in experiments])
    table = np.column_stack([np.ones(column.size), known])
    rest = column - table @ np.linalg.lstsq(table, column, rcond=None)[0]
    return bool(np.sum(rest**2) > GATES.max_known_variance * np.sum((column - column.mean()) ** 2))


def _known_signals(experiment: Experiment) -> np.ndarray:
    """Inputs, outputs and rates of outputs (n_samples, n)."""
    outputs = np.nan_to_num(experiment.outputs)
    return np.hstack([experiment.inputs, outputs, np.gradient(outputs, experiment.time, axis=0)])


@dataclass(frozen=True)
class _Search:
    """What every refit of a round needs; the `leader` is the best supported candidate of earlier stages."""

    stand: Stand
    run: NullObserver
    load: SmoothedLoad | None
    form: FreeForm | None
    n_screened: int
    leader: Proof | None = None


def _refitted(search: _Search, prepared: Prepared) -> Proof:
    """The proof of a candidate. Where its refit fails, it is tried again at places that the sensors do not
    tell from its own, unless it only loses its way, which it would there, too; then from a small and gentle
    effect; one that is `by_shooting`, from a simulation's fit alone. One that replaces a sensor is tried at
    its full size first. Of several ends the likeliest is judged. Raises the error of the first attempt."""
    errors: list[Exception] = []
    with _quiet():
        for ends in _tried(search, prepared, errors):
            best = _judged(search, ends, errors)
            if best is None:
                continue
            best = _found_again(search, prepared, best)
            if prepared.trial.is_seen_in_use and best.verdict == "rejected":
                is_hopeless = _is_hopeless_in_use(search, prepared)
                return best if is_hopeless else _shown_in_use(search, prepared, best)
            return best
    raise errors[0]


def _found_somehow(search: _Search, prepared: Prepared) -> Proof:
    """The proof of a candidate, by shooting where a search from the screen does not find it. Raises the error
    of the first attempt."""
    proof, error = None, None
    try:
        proof = _refitted(search, prepared)
    except FAILURES as failure:
        error = failure
    if proof is not None and not is_below_null(proof):
        return proof
    with suppress(*FAILURES):
        again = _refitted(search, replace(prepared, by_shooting=True))
        proof = again if proof is None else max(proof, again, key=lambda p: p.delta_log_likelihood)
    if proof is None:
        assert error is not None
        raise error
    return proof


def _tried(search: _Search, prepared: Prepared, errors: list[Exception]) -> Iterator[list[Searched]]:
    """The ends of the attempts so far, whenever one of them has not lost its way, and at last; with the
    `errors` of those that failed."""
    ends: list[Searched] = []
    at_full = () if prepared.by_shooting else at_full_size(search.stand.null, prepared)
    elsewhere = _elsewhere(search, prepared)
    for attempt in (*at_full, *_attempts(search, prepared, elsewhere)):
        if ends and attempt in elsewhere:
            continue
        try:
            end = _searched(search, attempt())
        except FAILURES as error:
            errors.append(error)
            continue
        ends.append(end)
        if attempt not in at_full and not has_lost_its_way(end, prepared.simulation):
            yield ends
    yield ends


def _judged(search: _Search, ends: list[Searched], errors: list[Exception]) -> Proof | None:
    """The proof of the likeliest of some ends that can be judged; None where none can, which leaves none of
    them in `ends`."""
    while ends:
        best = max(ends, key=lambda end: end.gain)
        try:
            return _proof_of(search, best)
        except FAILURES as error:
            errors.append(error)
            ends.remove(best)
    return None


def _shown_in_use(search: _Search, prepared: Prepared, beside: Proof, accepted: Proof | None = None) -> Proof:
    """The proof of a candidate by its simulation; that `beside` the loads where a simulation does not show
    it. `accepted` is a law that does show there what the candidate may be.

    The screen tells places apart by what a law of hardly any size does there. A dead zone of finite width
    before a pump that cannot draw is not one behind the sensor: of the places that the screen sees alike,
    the one with the likeliest simulation is taken, and those that simulate as well are equivalent."""
    stand = search.stand
    if stand.reference is None or stand.reference.simulated is None:
        return beside
    found: list[tuple[Prepared, FitResult]] = []
    for make in [None, *_elsewhere(search, prepared)]:
        with suppress(*FAILURES):
            here = prepared if make is None else make()
            fit = _fitted_there(stand, stand.reference, here, found[:1])
            if fit is not None:
                found.append((here, fit))
    if not found:
        return beside
    most = max(fit.log_likelihood for _, fit in found)
    best, *others = [pair for pair in found if pair[1].log_likelihood >= most - GATES.same_fit]
    there, fit = best
    candidate = there.trial.candidate
    proof = beside if candidate.site == beside.candidate.site else _beside_loads(search, there)
    if proof is None:
        return beside
    null = replace(stand.null, experiments=fed(stand.null.experiments, candidate))
    validation = fed(stand.validation, candidate)
    shown = by_simulation(null, there, proof, fit, validation, stand.reference, search.n_screened, accepted)
    if shown.verdict == "rejected":
        return beside
    return replace(shown, equivalent=tuple(other.trial.candidate.site.name for other, _ in others))


def _beside_loads(search: _Search, prepared: Prepared) -> Proof | None:
    """The proof of a candidate beside the loads, from a gentle effect where the search loses its way; None
    where it cannot be refitted."""
    null = search.stand.null
    gentle = partial(prepare, null.flat, null.estimated, prepared.trial, share=GENTLE, sharper=1.0)
    ends: list[Searched] = []
    for start in (partial(_same, prepared), gentle):
        with suppress(*FAILURES):
            ends.append(_searched(search, start()))
            if not has_lost_its_way(ends[-1]):
                break
    return _judged(search, ends, [])


def _fitted_there(
    stand: Stand,
    reference: Reference,
    here: Prepared,
    first: Sequence[tuple[Prepared, FitResult]],
) -> FitResult | None:
    """The best simulation of a law at one of its places: from where it ends at the `first` one, if there is
    one and it does the same here; else from its own starts."""
    if first:
        with suppress(*FAILURES):
            again = _fitted_in_use(stand, reference, here, _as_begun(first[0], here))
            if again and abs(again.log_likelihood - first[0][1].log_likelihood) < GATES.same_fit:
                return again
    return _fitted_in_use(stand, reference, here)


def _as_begun(first: tuple[Prepared, FitResult], here: Prepared) -> dict[str, float]:
    """The parameters of a law at another place, at the values that simulate best at the `first` one."""
    own, other = (one.trial.candidate.name for one in (here, first[0]))
    names = {name: name.replace(f"{own}.", f"{other}.", 1) for name in here.names}
    return {name: first[1].theta[before] for name, before in names.items() if before in first[1].theta}


def _is_hopeless_in_use(search: _Search, prepared: Prepared) -> bool:
    """Whether a few iterations leave the simulation of a candidate far behind that of the leader, of what it
    is fitted to and of unseen data alike: the rest of its search would be in vain."""
    stand, leader = search.stand, search.leader
    if leader is None or leader.final is None or leader.adds_up or stand.reference is None:
        return False
    try:
        first = _fitted_in_use(stand, stand.reference, prepared, iterations=FIRST_IN_USE)
    except FAILURES:
        return False
    return first is not None and is_far_behind(first.simulated, leader.final.simulated)


def _fitted_in_use(
    stand: Stand,
    reference: Reference,
    prepared: Prepared,
    begun: Mapping[str, float] | None = None,
    iterations: int = IN_USE,
) -> FitResult | None:
    """The best simulation of a candidate, or the one from where it has `begun`, if that is known; None where
    there is none."""
    candidate = prepared.trial.candidate
    return fitted_in_use(
        stand.null,
        prepared.flat,
        prepared.names,
        [f"{candidate.name}.{p.name}" for p in candidate.effect.sizes],
        reference.fit,
        fed(stand.null.experiments, candidate),
        fed(stand.validation, candidate),
        begun,
        iterations,
    )


def _found_again(search: _Search, prepared: Prepared, best: Proof) -> Proof:
    """The proof, or that from its estimates without loads, where it has lost a parameter: the one that makes
    the recordings and the unseen data likelier together."""
    stand, again = search.stand, from_simulation(prepared, best)
    if again is None:
        return best
    try:
        end = _searched(search, again)
        if end.refit.fit.log_likelihood < least_hope(search.leader, again.trial.candidate):
            return best  # it would be judged in brief
        unseen = fed(stand.validation, prepared.trial.candidate)
        if not may_be_likelier(stand.null, end, best, unseen, stand.reference):
            return best
        proof = _proof_of(search, end)
    except FAILURES:
        return best
    return max(best, proof, key=lambda p: p.delta_log_likelihood + p.confirmed.gain)


def _elsewhere(search: _Search, prepared: Prepared) -> list[Callable[[], Prepared]]:
    """The candidate at the other places where the sensors would see it alike."""
    null, trial = search.stand.null, prepared.trial
    numbers = range(min(len(trial.alike), MOST_PLACES))
    return [partial(prepare, null.flat, null.estimated, moved(trial, number)) for number in numbers]


def _attempts(
    search: _Search, prepared: Prepared, elsewhere: Sequence[Callable[[], Prepared]]
) -> Iterator[Callable[[], Prepared]]:
    null, trial = search.stand.null, prepared.trial
    gentle = partial(prepare, null.flat, null.estimated, trial, share=GENTLE, sharper=1.0)
    if prepared.by_shooting:
        yield partial(_by_shooting, search, prepared)
        return
    if prepared.simulation is not None:
        # Its loads may be as large as those of the null, or hardly there.
        starts = (replace(prepared, simulation=None), prepared)
        needs_none = prepared.simulation.log_likelihood > search.stand.baseline.log_likelihood
        for start in reversed(starts) if needs_none else starts:
            yield partial(_same, start)
        # Beside the loads, the null is near to a small effect.
        yield gentle
        return
    yield partial(_same, prepared)
    if prepared.similar is not None:
        return
    yield from elsewhere
    yield gentle


def _same(prepared: Prepared) -> Prepared:
    return prepared


def _by_shooting(search: _Search, prepared: Prepared) -> Prepared:
    """The candidate started from the best simulation. Raises what `identify` raises."""
    null = search.stand.null
    quick = null.shortest_times
    options = IdentifyOptions(
        method="oe",
        estimate=prepared.names,
        fix=quick,
        hold=null.hold,
        max_iterations=ITERATIONS,
        second_look=False,  # the refit from there looks for itself
    )
    fit = identify(prepared.flat, fed(null.experiments, prepared.trial.candidate), options)
    values = {name: fit.theta[name] for name in prepared.names}
    return replace(prepared, flat=prepared.flat.with_theta(values))


def _searched(search: _Search, prepared: Prepared) -> Searched:
    stand = search.stand
    experiments = fed(stand.null.experiments, prepared.trial.candidate)
    return searched(stand.null, stand.baseline, prepared, experiments, search.leader)


def _proof_of(search: _Search, found: Searched) -> Proof:
    stand = search.stand
    return proof_of(
        stand.null,
        stand.baseline,
        found,
        fed(stand.validation, found.prepared.trial.candidate),
        search.run,
        search.load,
        search.n_screened,
        search.leader,
        search.form,
        stand.reference,
    )


def _dynamic(null: Null, wanted: Sequence[Candidate], simulation: Simulation) -> DynamicFits:
    with _quiet():
        return dynamic_fits(null, wanted, simulation)


def _bent(
    null: Null, found: Screen, candidate: Candidate, nominal: FitResult, lags: DynamicFits
) -> DynamicFits:
    with _quiet():
        return bent_fits(null, found, [candidate], nominal, lags)


def _called(task: Callable[[], Any]) -> Any:
    return task()


@dataclass(frozen=True)
class _Stages:
    """Refits stage by stage. What is clearly worse than the best of the stages before is cut short: what runs
    beside it makes no difference, so that the result does not depend on the number of workers. Trials for
    which the time does not suffice are `late`, candidates that no search from the screen has found `lost`."""

    search: _Search
    pool: Workers
    options: DiagnoseOptions
    progress: Progress
    failed: list[tuple[Trial, str]] = field(default_factory=list)
    late: list[Trial] = field(default_factory=list)
    lost: list[Prepared] = field(default_factory=list)

    def prepared(self, found: Iterable[Trial]) -> list[Prepared]:
        """The trials that can be built into the model, of the places where the sensors would see them alike
        at the first without an implicit loop, else at the first of all."""
        null, result = self.search.stand.null, []
        for trial in found:
            reason, built = "", None
            for number in range(-1, min(len(trial.alike), MOST_PLACES)):
                try:
                    here = prepare(null.flat, null.estimated, trial if number < 0 else moved(trial, number))
                    is_explicit = not null.explicit.is_symbolic or reduce_index(here.flat).is_symbolic
                except DaestError as error:
                    reason = reason or error.what
                    continue
                if is_explicit or built is None:
                    built = replace(here, has_loop=not is_explicit)
                if is_explicit:
                    break
            if built is None:
                self.failed.append((trial, f"it cannot be built into the model: {reason}"))
            else:
                result.append(built)
        return result

    def proved(
        self, stage: Sequence[Prepared], before: Sequence[Proof], beside: Sequence[Callable[[], Any]] = ()
    ) -> tuple[list[Proof], list[Any]]:
        """Proofs of the candidates that can be refitted, and the results of the tasks `beside` them. What
        cannot be refitted is put down in `failed`; a task without a result has None."""
        search = replace(self.search, leader=_leader(before))
        keeper = self.options.keeper
        known = {i: p for i, one in enumerate(stage) if keeper and (p := keeper.found(one))}
        # The longest first, so that no worker is left with one alone in the end.
        missing = sorted((i for i in range(len(stage)) if i not in known), key=lambda i: -_length(stage[i]))
        tasks: list[Callable[[], Any]] = [*(partial(_refitted, search, stage[i]) for i in missing), *beside]

        outcomes: dict[int, Outcome[Any]] = {}

        def arrived(number: int, outcome: Outcome[Any]) -> None:
            if isinstance(outcome.error, OutOfTimeError):
                return
            outcomes[number] = outcome
            if keeper and number < len(missing) and outcome.error is None:
                keeper.keep(stage[missing[number]], outcome.get())

        seconds = REFIT_SECONDS * self.search.stand.baseline.seconds
        for i in missing:
            self.progress(f"refitting with {stage[i].trial.candidate.label}")
        with suppress(OutOfTimeError), until(self.options.until):
            deque(self.pool.map(_called, tasks, seconds=seconds, arrived=arrived), maxlen=0)
        for number, i in enumerate(missing):
            if number not in outcomes:
                self.late.append(stage[i].trial)
                self.failed.append((stage[i].trial, TIME_IS_UP))
            elif isinstance(outcomes[number].error, FAILURES):
                what = _what(outcomes[number].error)
                if not stage[i].by_shooting:
                    self.failed.append((stage[i].trial, f"it could not be refitted: {what}"))
                self.lost.append(stage[i])
            else:
                known[i] = outcomes[number].get()
        self.lost.extend(stage[i] for i in sorted(known) if is_below_null(known[i]))
        others = [outcomes[i].get() if i in outcomes else None for i in range(len(missing), len(tasks))]
        return [known[i] for i in sorted(known)], others

    def second_tries(self, proofs: Sequence[Proof], found: Screen) -> list[Proof]:
        """All laws, those that are `lost` from the start of a simulation by multiple shooting, which takes
        longer than all other searches, as long as they may still be what is missing: none that is far from an
        accepted law that leaves nothing."""
        best = best_accepted(ranked(proofs))
        names = {entry.candidate.name for entry in found.entries}
        is_told = best is not None and best.candidate.name not in names and _is_settled([best])
        again = [
            replace(one, by_shooting=True)
            for one in self.lost
            if one.similar is None and one.simulation is None and not one.by_shooting
            if not is_told and could_compete(one.trial, best, found)
        ]
        self.lost.clear()
        result = list(proofs)
        for proof in self.proved(again, proofs)[0]:
            same = next((p for p in result if _is_same_law(proof, p)), None)
            if same is None or proof.delta_log_likelihood > same.delta_log_likelihood:
                result = [*(p for p in result if p is not same), proof]
        self.lost.clear()
        return result

    @cached_property
    def simulation(self) -> Simulation | None:
        """The fit of the model as it is by its simulation, from which those of effects with states start."""
        with _quiet():
            return best_simulation(self.search.stand.null)

    def dynamic(self, candidates: Sequence[Candidate]) -> list[DynamicFits | None]:
        """The fits of the effects that change the order of the model, in a few parts, None where the time did
        not suffice; none where there are no such effects. Dead times are fitted where a lag shows itself."""
        wanted = [c for c in candidates if c.is_dynamic and not c.inputs]
        simplest = [c for c in wanted if not _says_more_of_signal(c, wanted)]
        fits = self._dynamic(simplest)
        shown = {one.trial.candidate.site for part in _whole(fits) for _, one in part}
        return [*fits, *self._dynamic([c for c in wanted if c not in simplest and c.site in shown])]

    def _dynamic(self, wanted: Sequence[Candidate]) -> list[DynamicFits | None]:
        if not wanted or self.simulation is None:
            return []
        size = -(-len(wanted) // DYNAMIC_PARTS)
        parts = [wanted[i : i + size] for i in range(0, len(wanted), size)]
        tasks = [partial(_dynamic, self.search.stand.null, part, self.simulation) for part in parts]
        return self.proved((), (), tasks)[1]

    def by_what_they_simulate(self, dynamic: Sequence[Prepared]) -> tuple[list[Prepared], list[Prepared]]:
        """Effects with states whose simulation leaves so little of the errors of the model as it is that they
        lead all other candidates; and the others."""
        if self.simulation is None:
            return [], list(dynamic)
        n_observed = sum(int(np.isfinite(e.outputs).sum()) for e in self.search.stand.null.experiments)
        least = self.simulation[0] - n_observed * np.log(GATES.max_leading_ratio)
        ahead = [one for one in dynamic if one.simulated > least]
        return ahead, [one for one in dynamic if one.simulated <= least]

    def storage(
        self, found: Screen, candidates: Sequence[Candidate], proofs: Sequence[Proof]
    ) -> tuple[Prepared, ...]:
        """Effects with states of their own that a simulation shows and no refit has come to."""
        wanted = [c for c in _with_states(candidates, proofs) if not c.is_dynamic]
        if not wanted or self.simulation is None:
            return ()
        with _quiet():
            null = self.search.stand.null
            return best_dynamic(null, [storage_fits(null, found, wanted, self.simulation)])

    def bent(
        self, found: Screen, candidates: Sequence[Candidate], proofs: Sequence[Proof]
    ) -> tuple[Prepared, ...]:
        """Effects with states beside a model that is not affine, those that its simulation shows. Laws with
        kinks, such as friction with bristles, are left to the screen."""
        null, reference = self.search.stand.null, self.search.stand.reference
        if reference is None or has_affine_dynamics(null.explicit):
            return ()
        wanted = [
            c
            for c in _with_states(candidates, proofs)
            if not any(p.role == "sharpness" for p in c.effect.parameters)
        ]
        with _quiet():
            nominal = nominal_simulation(null, reference.fit) if wanted else None
        # Where errors add up, a simulation tells of a lag only if it follows the machine all the same.
        if nominal is None or (reference.adds_up and not _follows(nominal)):
            return ()
        simplest = [c for c in wanted if not _says_more_of_signal(c, wanted)]
        parts = self._simulated(simplest, found, nominal)
        lags = [pair for part in parts for pair in part]
        shown = {prepared.trial.candidate.site for _, prepared in lags}
        richer = [c for c in wanted if c not in simplest and c.site in shown]
        return best_dynamic(null, [*parts, *self._simulated(richer, found, nominal, lags)])

    def _simulated(
        self, wanted: Sequence[Candidate], found: Screen, nominal: FitResult, lags: DynamicFits = ()
    ) -> list[DynamicFits]:
        """`bent_fits` of each of the wanted effects; without those for which the time does not suffice."""
        for candidate in wanted:
            self.progress(f"simulating with {candidate.label}")
        null = self.search.stand.null
        parts = self.proved((), (), [partial(_bent, null, found, one, nominal, lags) for one in wanted])[1]
        return [part for part in parts if part is not None]

    def shown_in_use(self, proofs: Sequence[Proof]) -> list[Proof]:
        """All laws; those that are likelier than what is accepted, and refused since a load is left beside
        them, by their simulation where that shows them: beside a load that may take any course a law keeps
        no more than the load leaves it, a stiffening spring half of its size."""
        null, reference = self.search.stand.null, self.search.stand.reference
        if reference is None or reference.simulated is None or reference.adds_up or self.options.is_over:
            return list(proofs)
        best = best_accepted(ranked(proofs))
        least = GATES.min_bic_gain if best is None else best.delta_bic
        doubted = [
            p
            for p in sorted(proofs, key=lambda p: -p.delta_bic)
            if p.is_open and p.explained < GATES.min_explained and p.delta_bic > least
        ]
        tasks = []
        known = None if best is None or not best.is_by_use else best
        wanted = {p.candidate.name: p for p in (*doubted[:MOST_IN_USE], *_beside_in_use(best, proofs))}
        for proof in wanted.values():
            candidate = proof.candidate
            sizes = tuple(proof.fit.theta[f"{candidate.name}.{p.name}"] for p in candidate.effect.sizes)
            flat = with_equations(proof.flat, "a simulation").with_theta(proof.fit.theta)
            prepared = Prepared(Trial(candidate, sizes, ()), flat, (*null.estimated, *candidate.estimated))
            self.progress(f"simulating with {candidate.label}")
            tasks.append(partial(_shown_in_use, self.search, prepared, proof, known))
        found = self.proved((), proofs, tasks)[1] if tasks else []
        shown = {p.candidate.name: p for p in found if p is not None}
        return [shown.get(p.candidate.name, p) for p in proofs]

    def steadied(self, proofs: Sequence[Proof]) -> list[Proof]:
        """All laws; those that are not separable with the errors of unseen data beside constant loads, by
        which they may be."""
        null, validation = self.search.stand.null, self.search.stand.validation
        close = {p.candidate.name for p in ranked(proofs) if p.verdict == "not separable" and not p.adds_up}
        if not validation or not close or not null.loads or self.options.is_over:
            return list(proofs)
        tasks = [
            partial(with_steady_error, null, proof, validation)
            for proof in proofs
            if proof.candidate.name in close
        ]
        found = {p.candidate.name: p for p in self.proved((), proofs, tasks)[1] if p is not None}
        return [found.get(p.candidate.name, p) for p in proofs]


def _says_more_of_signal(candidate: Candidate, others: Sequence[Candidate]) -> bool:
    """Whether another candidate delays the same signal with fewer states: where a lag is nothing, no dead
    time is worth its simulations."""
    return candidate.is_of_signal and any(
        other.is_of_signal
        and other.site == candidate.site
        and other.effect.n_states < candidate.effect.n_states
        for other in others
    )


def _follows(fit: FitResult) -> bool:
    """Whether a simulation says most of what every output does."""
    percents = fit.simulated["estimation"].fit_percent.values()
    return all(percent is not None and percent > GATES.min_driven_fit for percent in percents)


def _beside_in_use(best: Proof | None, proofs: Sequence[Proof]) -> list[Proof]:
    """The refused laws that bend a signal as the accepted `best` one does: loads take from a dead zone what
    they leave to a gain that grows with the signal, and a simulation has none."""
    if best is None or not best.candidate.is_of_signal or best.candidate.is_dynamic:
        return []
    return [
        p
        for p in proofs
        if p.verdict == "rejected"
        and p.candidate.is_of_signal
        and not p.candidate.is_dynamic
        and not p.in_use.n_independent
    ]


def _with_states(candidates: Sequence[Candidate], proofs: Sequence[Proof]) -> list[Candidate]:
    """The candidates with states, their own or those that they add to the model, that need no further signal
    and that no refit has come to."""
    tried = {p.candidate.label for p in proofs if p.delta_bic > GATES.min_bic_gain}
    return [
        c for c in candidates if (c.is_dynamic or c.effect.n_states) and not c.inputs and c.label not in tried
    ]


def _length(prepared: Prepared) -> int:
    """How long a refit takes beside others, roughly: what it multiplies its runs by, and their number."""
    return (LOOP if prepared.has_loop else 1) * len(prepared.names)


def _whole(fits: Sequence[DynamicFits | None]) -> list[DynamicFits]:
    """The fits for which the time sufficed."""
    return [part for part in fits if part is not None]


def _by_states(chosen: Sequence[Prepared]) -> tuple[list[Prepared], list[Prepared]]:
    """The trials without states of their own, and those with; of these the first alone leads
    where none is without."""
    quick = [one for one in chosen if not one.trial.candidate.effect.n_states]
    slow = [one for one in chosen if one.trial.candidate.effect.n_states]
    return (quick, slow) if quick else (slow[:1], slow[1:])


def _leader(proofs: Sequence[Proof]) -> Proof | None:
    """The most likely candidate that is supported."""
    supported = [p for p in proofs if p.verdict == "supported"]
    return max(supported, key=lambda p: p.fit.log_likelihood, default=None)


def _proofs(
    stand: Stand,
    loads: verdicts.Loads,
    load: SmoothedLoad | None,
    screens: tuple[Screen, Screen | None],
    candidates: Sequence[Candidate],
    library: Sequence[Effect],
    options: DiagnoseOptions,
    progress: Progress,
    watched: Callable[[Sequence[Proof]], None],
) -> tuple[tuple[Proof, ...], tuple[Unproved, ...], bool]:
    """The best candidates refitted: the first few, those that lead the screen in open loop, and of the others
    those that could compete with them; the leaders of the screen that were not, each with the reason; and
    whether the time sufficed. `screens` are that of the innovations and that in open loop, if there is
    one."""
    null, run, (found, used) = stand.null, loads.run, screens
    wanted = trials(found, GATES.screen_level, options.most_trials + MORE_TRIALS)
    wanted, n_used = _with_leaders(wanted, used)
    given = clipping_trials(null, candidates, options.clips([*null.experiments, *stand.validation]))
    with workers(options.jobs, options.cluster) as pool:
        stages = _Stages(_Search(stand, run, load, loads.form, found.n_screened), pool, options, progress)
        leading = stages.prepared(wanted[: options.most_trials])
        chosen, richer = simplest_first(leading)
        n_used = sum(any(one is other for other in chosen) for one in leading[:n_used])
        fits = stages.dynamic(candidates)
        ahead, dynamic = stages.by_what_they_simulate(best_dynamic(null, _whole(fits)))
        proofs: list[Proof] = []
        for one in ahead:
            proofs += stages.proved([one], proofs)[0]
        if proofs:
            watched(ranked(proofs))
        # Those whose runs are short lead: beside them, the others need not be pursued as far.
        n_first = min(max(n_used, 1 if fits else FIRST_TRIALS), len(chosen))
        quick, slow = _by_states(chosen[:n_first])
        proofs += stages.proved([*stages.prepared(given), *quick], proofs)[0]
        proofs += stages.proved(slow, proofs)[0]
        rest = chosen[n_first:FIRST_TRIALS]
        if rest and _leader(proofs) is None:
            proofs += stages.proved(rest, proofs)[0]
            rest = []
        proofs = stages.proved(dynamic, proofs)[0] + proofs
        watched(ranked(proofs))
        best = best_accepted(ranked(proofs))
        others = [*chosen[max(FIRST_TRIALS, n_first) :], *not_begun_by(best, richer)]
        rest += [p for p in others if could_compete(p.trial, best, found)]
        proofs += stages.proved(rest, proofs)[0]
        proofs = stages.second_tries(proofs, found)
        if not _is_settled(ranked(proofs)):
            proofs += stages.proved(stages.prepared(wanted[options.most_trials :]), proofs)[0]
            proofs = stages.second_tries(proofs, found)
        best = most_likely(proofs)
        if best is not None and best.verdict == "rejected":
            proofs += stages.proved(stages.prepared(simpler_laws(best, found, proofs)), proofs)[0]
            proofs = stages.second_tries(proofs, found)
        best = best_accepted(ranked(proofs))
        if best is not None:
            proofs += stages.proved(stages.prepared(signal_laws(best, found, proofs)), ())[0]
        best = best_start(ranked(proofs))
        if best is not None:
            doubted = [best] if _leaves_something(best) else []
            doubted += no_richer_ones(best, proofs)
            proofs = _with_better_kinks(proofs, stages.proved(rounded(null, doubted), ())[0])
            best = best_start(ranked(proofs))
        if best is not None and _leaves_something(best):
            again = stages.proved(other_forms(null, best), ())[0]
            proofs = _with_second_tries(proofs, again)
            best = best_start(ranked(proofs))
        if best is not None and best.verdict != "rejected":
            again = stages.proved(reduced_laws(null, best, found), ())[0]
            proofs = _with_second_tries(proofs, again)
            best = best_start(ranked(proofs))
        if best is not None and _leaves_something(best):
            # They start from the best: a first pass that is worse has only not come back to it yet.
            again = stages.proved(richer_laws(null, run, best, library, proofs), ())[0]
            proofs = _with_second_tries(proofs, again)
        evidence = verdicts.Evidence(stand.baseline, found, tuple(proofs), options.fitted, loads, stand.told)
        is_open = best_accepted(ranked(proofs)) is None and not loads.is_explained(evidence)
        if is_open and not options.is_over:
            proofs += stages.proved(stages.storage(found, candidates, proofs), proofs)[0]
            proofs += stages.proved(stages.bent(found, candidates, proofs), proofs)[0]
        proofs = stages.shown_in_use(proofs)
        proofs = stages.steadied(proofs)
    order = ranked(proofs)
    is_whole = not stages.late and None not in fits
    return order, _unproved(found, wanted, order, stages.failed), is_whole


def _with_leaders(wanted: Sequence[Trial], used: Screen | None) -> tuple[tuple[Trial, ...], int]:
    """The trials, behind the first of them those that lead the screen in open loop; and how many of the
    first ones that makes."""
    if used is None:
        return tuple(wanted), 1
    leaders = [replace(trial, is_seen_in_use=True) for trial in trials(used, GATES.screen_level, MOST_IN_USE)]
    marked = [
        replace(trial, is_seen_in_use=any(_is_same(one, trial.candidate) for one in leaders))
        for trial in wanted
    ]
    first = marked[:1]
    known = [trial for trial in marked[1:] if trial.is_seen_in_use]
    new = [one for one in leaders if not any(_is_same(one, trial.candidate) for trial in marked)]
    rest = [trial for trial in marked[1:] if not trial.is_seen_in_use]
    ahead = (*first, *known, *new)
    return (*ahead, *rest), len(ahead)


def _with_second_tries(proofs: Sequence[Proof], again: Sequence[Proof]) -> list[Proof]:
    """All laws, each once: of two refits of one law at one place, from different starts, the likelier."""

    def law(proof: Proof) -> tuple[str, str]:
        return proof.candidate.effect.class_name, proof.candidate.site.name

    tried = {law(proof) for proof in again}
    likeliest = {
        law(proof): proof
        for proof in sorted((*proofs, *again), key=lambda p: p.fit.log_likelihood)
        if law(proof) in tried
    }
    return [*(p for p in proofs if law(p) not in tried), *likeliest.values()]


def _with_better_kinks(proofs: Sequence[Proof], rounded: Sequence[Proof]) -> list[Proof]:
    """All laws, those with estimated kinks in place of the same ones without where they are worth their
    parameters, and are not refused for what the others are not: a kink may become so sharp that no observer
    follows it. A law that is refused for what it leaves is so with another kink that leaves the same."""
    better = {
        proof.candidate.name: _as_refused(proof, before)
        for proof in rounded
        for before in proofs
        if before.candidate.name == proof.candidate.name
        and proof.delta_bic > before.delta_bic
        and _standing(proof) >= _standing(before)
    }
    return [better.get(proof.candidate.name, proof) for proof in proofs]


def _as_refused(rounded: Proof, before: Proof) -> Proof:
    """The proof with a rounded kink, refused where the same law without was for a form that it leaves, and
    this one leaves it as significantly."""
    if before.verdict != "rejected" or before.left is None or rounded.left is None:
        return rounded
    forms = [(form.load, form.variable, form.sign_of) for form in (before.left, rounded.left)]
    if forms[0] != forms[1] or not is_significant(rounded.left, rounded.delta_log_likelihood):
        return rounded
    return replace(rounded, verdict="rejected", reason=before.reason, is_open=before.is_open)


def _standing(proof: Proof) -> int:
    """2 where a law is accepted, 1 where it is refused though nothing speaks against it, else 0."""
    return 2 if proof.verdict != "rejected" else int(proof.is_open)


def _unproved(
    found: Screen, wanted: Sequence[Trial], proofs: Sequence[Proof], failed: Sequence[tuple[Trial, str]]
) -> tuple[Unproved, ...]:
    """Leaders of the screen without a refit, and other candidates whose refit failed."""
    entries = {entry.candidate.name: entry for entry in found.entries}
    result = []
    reasons = {trial.candidate.name: (trial, reason) for trial, reason in failed}
    best = best_accepted(proofs)
    for trial in wanted:
        if trial.candidate.name in reasons:
            continue
        reason = "not refitted: others came first"
        if best is not None:
            reason = f"not refitted: {best.candidate.label} says what it could say"
        reasons[trial.candidate.name] = (trial, reason)
    broken = {trial.candidate.name for trial, _ in failed}
    for name, (trial, reason) in reasons.items():
        if any(_is_same(trial, p.candidate) for p in proofs):
            continue
        entry = entries.get(name)
        result.append(
            Unproved(
                candidate=trial.candidate,
                equivalent=tuple(c.site.name for c in trial.alike),
                score=0.0 if entry is None else entry.score,
                p_value=1.0 if entry is None else entry.p_value,
                sizes=trial.sizes,
                reason=reason,
                has_failed=name in broken,
            )
        )
    return tuple(sorted(result, key=lambda u: -u.score))


def _is_same(trial: Trial, candidate: Candidate) -> bool:
    """Whether a candidate is the trial, at its place or at one that the sensors see alike."""
    places = {trial.candidate.site.name, *(c.site.name for c in trial.alike)}
    return trial.candidate.effect.class_name == candidate.effect.class_name and candidate.site.name in places


def _is_same_law(one: Proof, other: Proof) -> bool:
    """Whether two proofs are of one effect at one place, or at places that the sensors see alike."""
    places = {one.candidate.site.name, *one.equivalent}
    return one.candidate.effect.class_name == other.candidate.effect.class_name and bool(
        places & {other.candidate.site.name, *other.equivalent}
    )


def _what(error: Exception | None) -> str:
    return error.what if isinstance(error, DaestError) else f"the search fails numerically ({error})"


def _is_settled(proofs: Sequence[Proof]) -> bool:
    """Whether the best candidate is accepted and leaves little that follows a variable."""
    best = best_accepted(proofs)
    if best is None or best.left is None:
        return False
    return not is_significant(best.left, best.delta_log_likelihood)


def most_likely(proofs: Sequence[Proof]) -> Proof | None:
    return max(
        (p for p in proofs if p.delta_bic > GATES.min_bic_gain), key=lambda p: p.delta_bic, default=None
    )


def best_start(proofs: Sequence[Proof]) -> Proof | None:
    """The candidate from which a richer law would start: the best accepted one, or the most likely of those
    that say too little."""
    return best_accepted(proofs) or most_likely(proofs)


def _leaves_something(proof: Proof) -> bool:
    """Whether the rest of the load follows a variable a little more than by chance: a richer law may do."""
    return proof.left is None or proof.left.p_value < GATES.richer_level
