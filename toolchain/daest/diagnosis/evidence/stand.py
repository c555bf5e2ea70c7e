"""What is examined: the model as it is, fitted beside unknown loads, and what unseen data say of it."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import LinAlgWarning

from daest.diagnosis.built_in.settled import FAILURES, better_of, fit_by_simulation, settled
from daest.diagnosis.evidence.open_loop import Simulated, simulated_errors
from daest.diagnosis.evidence.proof import Reference, bic_gain
from daest.diagnosis.evidence.unseen import adds_up, foreseen, steady_outputs
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import (
    Null,
    are_elsewhere,
    as_recorded,
    at_fit,
    falls_over,
    farthest,
    fit_null,
    known_values,
    moved_apart,
    refit,
)
from daest.diagnosis.options import DiagnoseOptions, Progress
from daest.diagnosis.screening.clipping import with_clipped_sensors
from daest.errors import EstimationError
from daest.estimation.fitting.records import part_of
from daest.estimation.fitting.signals import is_constant
from daest.estimation.identify import absorbed_parameters, identify, tied_parameters
from daest.model.diagnosis import Proof
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions, error_ratios, follows_all
from daest.model.flat import FlatModel
from daest.model.holds import FOH, Hold
from daest.model.parts import Parameter
from daest.numerics.statistics import chi2


@dataclass(frozen=True)
class Stand:
    """What is examined: the model as the user declared it (`declared`), the null made from it (with the
    effects that were accepted so far), the null's fit on the same terms as those of its rivals (`baseline`),
    the one without coloured loads (`reference`), and the validation data, with those for the other hold where
    they differ. Of every set of parameters in `tied`, which can change together without any effect on the
    outputs, the first is held; of one name, that a free initial state makes up for, it is."""

    declared: FlatModel
    null: Null
    baseline: FitResult
    validation: tuple[Experiment, ...]
    began: float
    reference: Reference | None = None
    other_validation: tuple[Experiment, ...] | None = None
    tied: tuple[tuple[str, ...], ...] = ()

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

    def null_of(quiet: FlatModel, near: Mapping[str, float]) -> Null:
        coarse = None if held is None else held[0]
        given = (options.hold or options.tried, coarse, options.slowest_load, near or options.near)
        null = fit_null(quiet, load_sites(flat), both[0], *given, None if near else options.known)
        return replace(null, is_hold_given=options.hold is not None)

    def unseen(hold: Hold | None) -> tuple[Experiment, ...]:
        return both[1] if held is None or hold is None else as_recorded(both[1], held[1], hold)

    def unseen_by(null: Null) -> tuple[Experiment, ...]:
        return unseen(null.recorded_hold)

    def fitted() -> Stand:
        free, tied = scaled(without_noises(flat), both[0])
        null, baseline, reference = _fitted(free, null_of, unseen_by, both[0])
        other = unseen(null.other_hold) if held is not None and null.other_hold else None
        declared = replace(flat, parameters=free.parameters)
        return Stand(declared, null, baseline, unseen_by(null), began, reference, other, tied)

    parts = (options.hold, options.tried, options.slowest_load, *sorted(options.near.items()))
    return replace(options.step("null", parts, flat, fitted), began=began)


def _begun_where_it_runs(
    null_near: Callable[[Mapping[str, float]], Null], flat: FlatModel, experiments: Sequence[Experiment]
) -> Null:
    """The null that is searched for from the given values; where the model cannot be simulated from there, as
    a tank that runs empty since its outlet is taken too large, near those of a search that cuts the
    recordings into pieces."""
    try:
        return null_near({})
    except EstimationError as error:
        if error.code != "identify-no-start":
            raise
        with suppress(*FAILURES):
            if known := known_values(identify(flat, experiments, IdentifyOptions(method="oe"))):
                return null_near(known)
        raise


def scaled(
    flat: FlatModel, experiments: Sequence[Experiment]
) -> tuple[FlatModel, tuple[tuple[str, ...], ...]]:
    """The model with one parameter held of each set of them that can change together without any effect on
    the outputs, and those that free initial states make up for; and these sets: a torque constant with all
    torques, say. Loads would let such a scale go anywhere, and no size would be known. The one that the data
    know least is let pass its bounds: at another scale than the machine's a small friction beside that of the
    motor's voltage may have to be below zero."""
    tied: list[tuple[str, ...]] = [(name,) for name in _absorbed(flat, experiments)]
    parameters = (replace(p, estimate=p.estimate and (p.name,) not in tied) for p in flat.parameters)
    flat = replace(flat, parameters=tuple(parameters))
    while together := _changing_together(flat, experiments):
        tied.append(together)
        held, *_, least = together
        flat = replace(flat, parameters=tuple(_at_scale(p, held, least) for p in flat.parameters))
    return flat, tuple(tied)


def _absorbed(flat: FlatModel, experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """Estimated parameters that do nothing but what free initial states do, at the given values and beside
    them."""
    absorbed = absorbed_parameters(flat, experiments, FOH)
    beside = absorbed_parameters(moved_apart(flat), experiments, FOH) if absorbed else ()
    return tuple(name for name in absorbed if name in beside)


def _at_scale(parameter: Parameter, held: str, least: str) -> Parameter:
    if parameter.name == held:
        return replace(parameter, estimate=False)
    return replace(parameter, scale="linear", min=None, max=None) if parameter.name == least else parameter


def _changing_together(flat: FlatModel, experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """Estimated parameters that can change together without any effect on the outputs, at the given values
    and beside them, where those of equal parts no longer do the same; none where there are none."""
    if sum(p.estimate for p in flat.parameters) < 2 or not tied_parameters(flat, experiments, FOH):
        return ()
    return tied_parameters(moved_apart(flat), experiments, FOH)


def _fitted(
    flat: FlatModel,
    null_of: Callable[[FlatModel, Mapping[str, float]], Null],
    unseen_by: Callable[[Null], tuple[Experiment, ...]],
    experiments: Sequence[Experiment] = (),
) -> tuple[Null, FitResult, Reference | None]:
    """The null that `null_of` makes of the model, near values if any are known, and its `_told_fits` on the
    experiments `unseen_by` it; from the values without coloured loads where these are likelier
    (`_not_astray`), and with the parameters held where loads would take over what the inputs do
    (`_simulated_better`)."""
    null = _begun_where_it_runs(lambda near: null_of(flat, near), flat, experiments)
    baseline, reference = _told_fits(null, unseen_by(null))
    if baseline.log_likelihood > null.fit.log_likelihood + GATES.min_load_gain:
        null = at_fit(null, baseline)
    null, baseline, reference = _not_astray(
        null, baseline, reference, lambda near: null_of(flat, near), unseen_by
    )
    known = _simulated_better(flat, null, reference)
    if known is not None:
        with suppress(*FAILURES):  # a simulation may end at values beside which no load can be fitted
            fixed = null_of(known, {})
            again = _told_fits(fixed, unseen_by(fixed))
            if again[1] is not None and _is_driven(again[1]) and not _foresees_worse(reference, again[1]):
                return fixed, *again
    return null, baseline, reference


def _is_driven(reference: Reference) -> bool:
    """Whether the inputs say what the outputs do: nothing of a simulation adds up, or it follows what was
    recorded all the same, as the voltage of a battery that is discharged once."""
    follows = follows_all(reference.fit.simulated, "estimation", GATES.min_taken_fit)
    return follows or not reference.adds_up


def _not_astray(
    null: Null,
    baseline: FitResult,
    reference: Reference | None,
    null_near: Callable[[Mapping[str, float]], Null],
    unseen_by: Callable[[Null], tuple[Experiment, ...]],
) -> tuple[Null, FitResult, Reference | None]:
    """The null with its fits, searched for once more near the parameters without coloured loads where these
    make the recordings likelier: a model with such loads holds the one without them, so that its search went
    astray. That of a pendulum ends where a load does what gravity does."""
    if reference is None or reference.fit.log_likelihood < null.fit.log_likelihood + GATES.min_load_gain:
        return null, baseline, reference
    known = known_values(reference.fit)
    if not known:
        return null, baseline, reference
    with suppress(*FAILURES):
        other = null_near(known)
        if other.fit.log_likelihood > null.fit.log_likelihood:
            return other, *_told_fits(other, unseen_by(other))
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
        fit = null.alone or identify(flat, null.experiments, IdentifyOptions(method="oe", hold=null.hold))
    except FAILURES:
        return None
    is_held = falls_over(null.explicit, null.experiments)
    if is_held and not are_elsewhere(fit.theta, null.fit.theta, null.estimated):
        return None  # its simulation falls whatever its parameters are, but for that in segments
    given = {p.name: p.value for p in flat.parameters if p.name in null.estimated}
    apart = farthest(fit.theta, given)
    if apart > GATES.elsewhere and apart > farthest(null.fit.theta, given):
        return None  # it has bent to what is missing, as a bearing without friction does to a constant torque
    if not _far_smaller(error_ratios(reference.fit.simulated, fit.simulated, "estimation")):
        return None
    fixed = flat.with_theta(fit.theta)
    return replace(fixed, parameters=tuple(replace(p, estimate=False) for p in fixed.parameters))


def _foresees_worse(reference: Reference | None, other: Reference) -> bool:
    """Whether the other fit simulates an output of unseen data worse: what it gained on the data of the fit,
    a machine that turns over at another moment gives by chance."""
    before = {} if reference is None else reference.fit.simulated
    return max(error_ratios(before, other.fit.simulated), default=0.0) > GATES.same_unseen_ratio


def _far_smaller(ratios: Sequence[float]) -> bool:
    """Whether errors of the outputs, in ratios, have become far smaller and none larger. The likelihood of a
    simulation goes with their product: a noisy speed says little beside an angle."""
    least = GATES.max_adrift_ratio ** len(ratios)
    return bool(ratios) and max(ratios) <= 1.0 and float(np.prod(ratios)) < least


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

    def null_of(quiet: FlatModel, near: Mapping[str, float]) -> Null:
        nodes = load_sites(stand.declared)
        null = fit_null(quiet, nodes, known.experiments, known.hold, slowest=known.slowest, near=near)
        return replace(
            null,
            other_hold=known.other_hold,
            hold_lead=known.hold_lead,
            other_experiments=known.other_experiments,
            recorded_hold=known.recorded_hold,
            is_hold_given=known.is_hold_given,
        )

    def fitted() -> Stand:
        quiet = without_noises(found.flat)
        null, baseline, reference = _fitted(quiet, null_of, lambda _: stand.validation, known.experiments)
        return replace(stand, null=null, baseline=baseline, reference=reference)

    parts = (known.hold, known.recorded_hold, known.other_hold, *(law.name for law in found.laws))
    grown = replace(options.step("limited", parts, found.flat, fitted), began=stand.began)
    gain = grown.baseline.log_likelihood - stand.baseline.log_likelihood
    n_own = len(found.laws)
    proofs = tuple(
        Proof(
            candidate=law,
            flat=grown.null.flat,
            fit=grown.baseline,
            delta_log_likelihood=gain,
            delta_bic=bic_gain(gain, n_own, stand.null),
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


def reference_of(null: Null, fit: FitResult, validation: Sequence[Experiment]) -> Reference | None:
    """What unseen data say of the model of `null`, whose `fit` is that beside its loads; None where it cannot
    be fitted without coloured ones."""
    with quiet():
        found = settled(null, fit, null.flat, null.explicit, null.experiments, validation)
        if found is None:
            return None
        white, observer = found
        # A simulation whose errors add up tells little of what the model lacks.
        reckons = adds_up(observer)
        if reckons:
            return Reference(
                white, foreseen(observer, validation), adds_up=True, holding=steady_outputs(observer)
            )
        opened = fit_by_simulation(null, white, null.flat, null.experiments, validation)
        told = better_of(white, opened)
        errors = None if opened is None else _errors_of(null, opened, told, validation)
        return Reference(told, foreseen(observer, validation), simulated=errors, opened=opened)


def _errors_of(
    null: Null, opened: FitResult, told: FitResult, validation: Sequence[Experiment]
) -> Simulated | None:
    """Errors of the fit by simulation, those of unseen data of the fit that is `told`, which simulates them
    best; None where there are none."""
    errors = simulated_errors(at_fit(null, opened), validation)
    if errors is None or told.method == "oe":
        return errors
    others = simulated_errors(at_fit(null, told), validation)
    return errors if others is None else replace(errors, unseen=others.unseen)


@contextmanager
def quiet() -> Iterator[None]:
    """A search tries models that overflow and gains that are nearly singular; it steps back from them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        warnings.simplefilter("ignore", LinAlgWarning)
        yield


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


def _divided_otherwise(experiments: Sequence[Experiment], validation: Sequence[Experiment]) -> str:
    """How recordings that are long enough as a whole may be divided, by a share of their time; empty where
    they are not, or where others validate, which a share would leave out."""
    later = {e.name.removesuffix(" (validation)"): e for e in validation}
    if len(later) != len(validation) or len(validation) != len(experiments):
        return ""
    times = []
    for e in experiments:
        rest = later.get(e.name.removesuffix(" (estimation)"))
        if rest is None or rest.time[0] <= e.time[-1]:
            return ""
        times.append(np.concatenate([e.time, rest.time]))
    share = least_share(times)
    whole = sum(t.size for t in times)
    return "" if share is None else f", or let more of the {whole} that there are estimate: --split {share:g}"


def least_share(times: Sequence[np.ndarray]) -> float | None:
    """The least share of the time of recordings, from a half on, that is enough to diagnose from, their
    samples being at `times` (n,); None where too little would be kept for validation."""
    for percent in range(50, int(100.0 * (1.0 - GATES.least_kept_back)) + 1):
        edges = [t[0] + percent / 100.0 * (t[-1] - t[0]) for t in times]
        if sum(int(np.sum(t <= edge)) for t, edge in zip(times, edges, strict=True)) >= GATES.min_samples:
            return percent / 100.0
    return None


def is_enough(sizes: Sequence[int]) -> bool:
    """Whether recordings of that many samples are enough to diagnose from."""
    return sum(sizes) >= GATES.min_samples


def _needed_in_all(kept: float) -> str:
    """How many samples it takes where the share `kept` of them validates, and with the least that may be."""
    least = GATES.least_kept_back

    def in_all(share: float) -> int:
        return int(np.ceil(round(GATES.min_samples / (1.0 - share), 6)))

    whole = f"{in_all(kept)} samples in all ({kept:.0%} of them are kept for validation"
    return f"{whole})" if kept <= least else f"{whole}; {in_all(least)} where it is {least:.0%})"


def _divided(
    experiments: tuple[Experiment, ...], validation: tuple[Experiment, ...]
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:
    has_own = bool(validation) and not any(e.name.endswith(" (validation)") for e in validation)
    experiments, validation = halved(experiments, validation)
    n_samples = sum(e.n_samples for e in experiments)
    if n_samples < GATES.min_samples:
        needed = f"{GATES.min_samples} samples beside those that validate"
        if not has_own:
            kept = sum(e.n_samples for e in validation)
            is_half = abs(kept - n_samples) <= len(experiments)  # an odd number has no halves
            needed = _needed_in_all(0.5 if is_half else kept / (n_samples + kept))
        raise EstimationError(
            "diagnose-too-short",
            f"{n_samples} samples to diagnose from cannot tell a missing effect from noise",
            remedy=f"record at least {needed} that "
            "move the machine through its whole range, in both directions and through rest"
            + _divided_otherwise(experiments, validation),
        )
    signals = [y[np.isfinite(y)] for e in experiments for y in e.outputs.T]
    if all(is_constant(y) for y in signals if y.size):
        names = ", ".join(f"`{name}`" for name in experiments[0].output_names)
        raise EstimationError(
            "diagnose-unseen",
            f"the measured outputs never change in the recordings for estimation: {names}",
            remedy="choose recordings, or a part of them (--from, --to), in which the machine moves; "
            "daest check tells what is wrong with them",
        )
    return experiments, validation
