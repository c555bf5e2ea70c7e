"""Kalman filter of the sampled DAE, Gerdin & Schön (47) and (54): time-varying and stationary.

The covariance runs through a compiled Joseph step until it is near (FIT.settled_covariance) the solution of
the Riccati equation, or of the limit that its own changes foretell; from there the gain is constant and the
states follow a linear recursion over whole blocks. A missing output or another step length starts a new
transient. An unknown initial state is exact, no large prior: the pass runs from a proper reference start (the
stationary covariance, so that the gain is constant at once) and carries along the sensitivity A[k] of its
states to x[0]; the innovations are then a linear regression on x[0] (Rosenberg 1973, de Jong 1991), and its
solution corrects states, covariances and likelihood at every sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines.flat_start import (
    correct,
    flat_evidence,
    flat_start,
    one_earlier,
    whitening,
)
from daest.estimation.filter_engines.modes import (
    LONG_RUN,
    Models,
    by_index,
    known_parts,
    mode_model,
    models_by_interval,
    modes_of,
    select_outputs,
)
from daest.estimation.filter_engines.stationary import (
    StationaryFilter,
    stationary_filter,
    try_stationary_filter,
)
from daest.estimation.gates import FIT
from daest.model.estimates import (
    FilterKind,
    FilterPass,
    FlatStart,
    GaussianSequence,
    InitialState,
    KalmanResult,
    Modes,
    Varying,
    singular_innovation,
)
from daest.model.experiment import Experiment
from daest.model.linear import DiscreteModel
from daest.numerics.gaussian import CHUNK, FREE_TOLERANCE, undetermined
from daest.numerics.kalman_pass import (
    ConstantGain,
    KalmanSteps,
    StepMatrices,
    Stop,
    kalman_steps,
    side_by_side,
)
from daest.numerics.riccati import predictor_gain, unobservable_subspace

SETTLING = 1000  # samples after which the Riccati equation is asked where a covariance has not settled
CHUNK_NUMBERS = 1 << 28  # of covariances in a block of steps: 2 GB, of which only those used are touched
GAIN_BLOCK = 4096  # samples whose gains are compared with the stationary one at a time


@dataclass(frozen=True)
class PassStart:
    """x[0] = mean + sensitivity δ + N(0, cov); `scale` (n,) is the size of a state. `stationary` is the
    covariance of the stationary filter of `observed`, the model with the outputs that are ever present, where
    it is known."""

    mean: np.ndarray
    cov: np.ndarray
    sensitivity: np.ndarray
    n_observable: int
    scale: np.ndarray
    observed: DiscreteModel
    stationary: StationaryFilter | None = None


def kalman_filter(
    model: Models,
    experiment: Experiment,
    initial: InitialState | None = None,
    kind: FilterKind = "time-varying",
    state_names: tuple[str, ...] | None = None,
) -> KalmanResult:
    """Filter a record with the sampled model (47).

    `model` is one DiscreteModel for a uniform record, one per interval in order (n_samples - 1), or a mapping
    from step length [s]. `experiment.inputs` are the columns of ū (inputs and their slopes, see
    `stacked_inputs`); NaN outputs are missing. `initial` None is an unknown initial state (for kind
    "stationary": zero). kind "stationary" starts with the stationary covariance, so that the gain is
    constant; after missing outputs it takes its own transient. Errors (EstimationError):
    `filter-uneven-samples`, `filter-initial-state`, `filter-singular-innovation`, and those of
    `stationary_filter` for the stationary kind.
    """
    forward, start = _pass_over(model, experiment, initial, kind, state_names)
    return _assemble(kind, experiment.time, forward, flat_start(forward), start)


def _pass_over(
    model: Models,
    experiment: Experiment,
    initial: InitialState | None,
    kind: FilterKind,
    state_names: tuple[str, ...] | None,
) -> tuple[FilterPass, PassStart]:
    models, which = models_by_interval(model, experiment.time)
    modes = modes_of(models, which, experiment.outputs)
    known, drive = known_parts(models, which, experiment)
    z = experiment.outputs - known
    if not np.all(modes.present):
        z[np.isnan(z)] = 0.0
    start = _start(models, modes, initial, kind, state_names)
    return _forward_pass(modes, z, drive, start), start


def _start(
    models: list[DiscreteModel],
    modes: Modes,
    initial: InitialState | None,
    kind: FilterKind,
    state_names: tuple[str, ...] | None,
) -> PassStart:
    typical = models[int(np.argmax(np.bincount(modes.model[modes.index])))]
    n = typical.transition.shape[0]
    observed = _with_rows(typical, np.asarray(modes.present.any(axis=0)))
    if kind == "stationary":
        if len(models) > 1:
            raise EstimationError(
                "filter-uneven-samples",
                "a stationary filter needs equal steps",
                remedy="use the time-varying filter, or resample the record",
            )
        stationary = stationary_filter(observed, state_names)
        P = stationary.predicted_cov
        mean = np.zeros(n) if initial is None else initial.mean
        return PassStart(mean, P, np.zeros((n, 0)), 0, np.sqrt(np.diagonal(P)), observed, stationary)
    initial = InitialState.unknown(n) if initial is None else initial
    _check_initial(initial, n)
    unknown = initial.is_unknown
    if not np.any(unknown):
        scale = np.sqrt(np.diagonal(initial.cov))
        return PassStart(initial.mean, initial.cov, np.zeros((n, 0)), 0, scale, observed)
    return reference_start(observed, initial)


def reference_start(model: DiscreteModel, initial: InitialState) -> PassStart:
    """A reference start whose covariance is the stationary one where it exists: any other gives the same
    result."""
    unknown = initial.is_unknown
    stationary = try_stationary_filter(model)
    P = np.zeros_like(model.transition) if stationary is None else stationary.predicted_cov
    size = np.sqrt(np.diagonal(P))
    information = information_scale(model)
    scale = np.where(size > FIT.forgotten_start * information, size, information)
    cov = np.where(unknown[:, None] | unknown[None, :], 0.0, initial.cov)
    if np.all(unknown):
        cov = P + np.diag(scale**2 - size**2)
    else:
        cov[unknown, unknown] = scale[unknown] ** 2
    columns = np.diag(scale)[:, unknown]
    observable, _ = unobservable_subspace(model.transition, model.output)
    basis, n_observable = observable_first(observable @ columns)
    mean = np.where(unknown, 0.0, initial.mean)
    return PassStart(mean, cov, columns @ basis, n_observable, scale, model, stationary)


def observable_first(rows: np.ndarray) -> tuple[np.ndarray, int]:
    """Orthonormal basis of δ whose first columns are seen by `rows` (r, q) and whose other columns are
    not."""
    q = rows.shape[1]
    if rows.shape[0] == 0:
        return np.eye(q), 0
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    _, values, directions = np.linalg.svd(rows)
    rank = int(np.sum(values > FIT.start_rank * values[0]))
    return (np.eye(q), q) if rank == q else (directions.T, rank)


def information_scale(model: DiscreteModel) -> np.ndarray:
    """Standard deviation (n,) of each state alone from a few outputs: a size in the state's unit, 1 if
    unseen."""
    noise = np.diagonal(model.measurement_cov)
    rows = model.output / np.sqrt(np.where(noise > 0, noise, 1.0))[:, None]
    total = np.zeros(model.transition.shape[0])
    for _ in range(10 * total.size):
        total += np.sum(rows**2, axis=0)
        rows = rows @ model.transition
    return np.where(total > 0, 1.0 / np.sqrt(np.where(total > 0, total, 1.0)), 1.0)


def _with_rows(model: DiscreteModel, rows: np.ndarray) -> DiscreteModel:
    """The model with the outputs `rows` (n_y,) bool only: an output that is never present observes
    nothing."""
    if np.all(rows):
        return model
    return select_outputs(model, np.flatnonzero(rows))


def _check_initial(initial: InitialState, n: int) -> None:
    unknown = initial.is_unknown
    off_diagonal = initial.cov - np.diag(np.diagonal(initial.cov)) if not np.any(unknown) else None
    shapes = initial.mean.shape == (n,) and initial.cov.shape == (n, n)
    if off_diagonal is None and shapes:
        rest = np.where(np.eye(n, dtype=bool), 0.0, initial.cov)
        shapes = not np.any(rest[unknown])
    if not shapes:
        raise EstimationError(
            "filter-initial-state",
            f"the initial state needs a mean of {n} numbers and an {n} x {n} covariance; states with "
            "infinite variance have no covariance with others",
        )


class _Recorder:
    """Collects a pass: arrays by sample, and the distinct matrices in order of appearance."""

    def __init__(self, n_samples: int, n: int, n_y: int, n_w: int) -> None:
        shapes = [(n_samples, n), (n_samples, n_y), (n_samples,), (n_samples, n + n_w)]
        self.predicted, self.innovations, self.nis, self.filtered = side_by_side(shapes)
        self.index = np.empty(n_samples, dtype=np.int64)
        self.parts: list[KalmanSteps] = []
        self.mode: list[np.ndarray] = []
        self.sensitivity: list[np.ndarray] = []
        self.n_distinct = 0
        self.stationary_from: int | None = None

    def of(self, block: slice) -> tuple[np.ndarray, ...]:
        """Where the predictions, innovations, νᵀ S⁻¹ ν and filtered means of these samples go."""
        return self.predicted[block], self.innovations[block], self.nis[block], self.filtered[block]

    def add(self, steps: KalmanSteps, mode: np.ndarray, begin: int, n_samples: int) -> None:
        """The matrices of `steps` with their modes; those of the samples from `begin` on, or the only ones of
        n_samples."""
        count = steps.gain.shape[0]
        self.index[begin : begin + n_samples] = self.n_distinct + np.arange(count)
        self.parts.append(steps)
        self.mode.append(mode)
        self.n_distinct += count

    def all(self, name: str) -> np.ndarray:
        """The distinct matrices of one kind, empty where they were not asked for."""
        found = [getattr(part, name) for part in self.parts]
        kept = [part for part in found if part is not None]
        return (kept[0] if len(kept) == 1 else np.concatenate(kept)) if kept else np.zeros((0, 0, 0))


def _forward_pass(modes: Modes, z: np.ndarray, drive: np.ndarray, start: PassStart) -> FilterPass:
    n_samples, n_y = z.shape
    recorder = _Recorder(n_samples, start.mean.size, n_y, modes.noise_cov.shape[1])
    plan = _Plan(modes, start)
    k, M, P = 0, np.column_stack([start.mean, start.sensitivity]), start.cov
    while k < n_samples:
        end = int(plan.run_end[k])
        is_long = end - k >= LONG_RUN or plan.is_last_stationary
        target = plan.target(k, P) if is_long else None
        if target is not None:
            M = _stationary_phase(recorder, plan, z, drive, k, end, M, target, start.scale)
            P, k = target.predicted_cov, end
            plan.is_last_stationary = False
        else:
            k, M, P = _transient(recorder, plan, z, drive, k, M, P)
        if M.shape[1] > 1 and _is_forgotten(M[:, 1:], start.scale):
            M = M[:, :1]
    return _as_pass(recorder, modes, start)


class _Plan:
    """What a pass needs to know ahead: matrices and ends of runs, and the stationary filter of each mode.

    That is the solution of the Riccati equation where it is known, or where many samples have not led to it;
    else the sequence of covariances itself tells that it has settled.
    """

    def __init__(self, modes: Modes, start: PassStart) -> None:
        self.modes = modes
        self.matrices = StepMatrices(
            modes.transition, modes.output, modes.process_cov, modes.cross_cov, modes.measurement_cov,
            modes.noise_cov, modes.noise_measurement_cov,
        )  # fmt: skip
        self.run_end = _run_ends(modes.index)
        self.begins_long = self.run_end - np.arange(self.run_end.size) >= LONG_RUN
        self._known: dict[int, StationaryFilter | None] = {}
        self._patience = SETTLING
        if len(modes.present) == 1 and start.stationary is not None:
            self._known[0] = start.stationary
        self.is_last_stationary = False  # the last sample that was done, of the run that goes on

    def target(self, k: int, P: np.ndarray) -> StationaryFilter | None:
        """The stationary filter from sample k on, if P is its covariance."""
        mode = int(self.modes.index[k])
        if self.is_last_stationary:
            return _filter_at(self.modes, mode, P)
        if mode not in self._known and self._patience <= 0:
            self._known[mode] = try_stationary_filter(mode_model(self.modes, mode))
        found = self._known.get(mode)
        return found if found is not None and _is_close(P, found.predicted_cov) else None

    def stop(self, begin: int, end: int) -> Stop:
        """Where the steps over the samples begin … end - 1 end early."""
        shape = self.modes.transition.shape
        known = np.array([self._known.get(m) is not None for m in range(shape[0])])
        targets = np.zeros(shape)
        for m in np.flatnonzero(known):
            targets[m] = self._known[int(m)].predicted_cov  # type: ignore[union-attr]
        return Stop(FIT.settled_covariance, self.begins_long[begin:end], targets, known)

    def hear(self, count: int, is_stationary: bool) -> None:
        """That `count` steps were done, and whether the last was stationary."""
        self._patience -= count
        self.is_last_stationary = is_stationary


def _filter_at(modes: Modes, mode: int, P: np.ndarray) -> StationaryFilter:
    Phi, C = modes.transition[mode], modes.output[mode]
    gain, S = predictor_gain(P, Phi, C, modes.measurement_cov[mode], modes.cross_cov[mode])
    return StationaryFilter(gain, P, S, Phi - gain @ C)


def _run_ends(index: np.ndarray) -> np.ndarray:
    """For every sample, the end of the run of equal modes it belongs to."""
    edges = np.append(np.flatnonzero(np.diff(index)) + 1, index.size)
    return np.repeat(edges, np.diff(edges, prepend=0))


def _is_close(P: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Whether P (..., n, n) is the target to FIT.settled_covariance in standard deviations."""
    size = np.sqrt(np.maximum(np.diagonal(P, axis1=-2, axis2=-1), np.diagonal(target)))
    limit = FIT.settled_covariance * size[..., :, None] * size[..., None, :]
    return np.all(np.abs(P - target) <= limit, axis=(-2, -1))


def _is_forgotten(A: np.ndarray, scale: np.ndarray) -> bool:
    return bool(np.all(np.abs(A) <= FIT.forgotten_start * scale[:, None]))


def _stationary_phase(
    recorder: _Recorder,
    plan: _Plan,
    z: np.ndarray,
    drive: np.ndarray,
    begin: int,
    end: int,
    M: np.ndarray,
    target: StationaryFilter,
    scale: np.ndarray,
) -> np.ndarray:
    """Samples begin … end - 1 with a constant gain; returns [m A] at `end`."""
    modes, mode = plan.modes, int(plan.modes.index[begin])
    block = slice(begin, end)
    if plan.is_last_stationary:
        recorder.index[block] = recorder.n_distinct - 1
    else:
        one = slice(begin, begin + 1)
        now = (plan.matrices, modes.index[one], z[one], drive[one], M[:, :1], target.predicted_cov)
        recorder.add(kalman_steps(*now), np.array([mode]), begin, end - begin)
    last = recorder.parts[-1]
    gains = target.closed_loop, target.gain, modes.output[mode], last.whitening[-1], last.filter_gain[-1]
    after = ConstantGain(*gains).over(z[block], drive[block], M[:, 0], recorder.of(block))
    if recorder.stationary_from is None:
        recorder.stationary_from = begin - plan.is_last_stationary
    A = _decay(recorder, target.closed_loop, M[:, 1:], end - begin, scale)
    return np.column_stack([after, A])


def _decay(
    recorder: _Recorder, closed_loop: np.ndarray, A: np.ndarray, n_steps: int, scale: np.ndarray
) -> np.ndarray:
    """Record F^i A for the samples of a stationary phase, until it is forgotten; returns A after it."""
    if A.shape[1] == 0:
        return A
    powers = [np.eye(A.shape[0])]
    for _ in range(CHUNK):
        powers.append(closed_loop @ powers[-1])
    stacked = np.stack(powers)
    done = 0
    while done < n_steps and not _is_forgotten(A, scale):
        count = min(CHUNK, n_steps - done)
        block = stacked[: count + 1] @ A
        recorder.sensitivity.append(block[:-1])
        A, done = block[-1], done + count
    return A


def _transient(
    recorder: _Recorder,
    plan: _Plan,
    z: np.ndarray,
    drive: np.ndarray,
    begin: int,
    M: np.ndarray,
    P: np.ndarray,
) -> tuple[int, np.ndarray, np.ndarray]:
    """A number of samples with their own covariance each; stops early where a stationary phase begins."""
    n, columns = M.shape
    most = CHUNK if columns > 1 else max(CHUNK, CHUNK_NUMBERS // max(1, n**2))
    end = min(begin + most, z.shape[0])
    block, index = slice(begin, end), plan.modes.index
    steps = kalman_steps(
        plan.matrices,
        index[block],
        z[block],
        drive[block],
        M,
        P,
        stop=plan.stop(begin, end),
    )
    if steps.failed is not None:
        raise singular_innovation(f"near sample {begin + steps.failed}")
    count = steps.predicted.shape[0]
    done = slice(begin, begin + count)
    recorder.predicted[done], recorder.innovations[done] = steps.predicted, steps.innovations
    recorder.nis[done] = steps.nis
    recorder.filtered[done] = by_index(steps.filter_gain, np.arange(count), steps.innovations)
    recorder.filtered[done, :n] += steps.predicted
    recorder.add(steps, index[done], begin, count)
    if columns > 1:
        recorder.sensitivity.append(steps.sensitivity)
    plan.hear(count, steps.is_stationary)
    return begin + count, steps.after, steps.after_cov


def _as_pass(recorder: _Recorder, modes: Modes, start: PassStart) -> FilterPass:
    n, q = start.sensitivity.shape
    A = np.concatenate(recorder.sensitivity) if recorder.sensitivity else np.zeros((0, n, q))
    if q == 0:
        A = np.zeros((0, n, 0))
    V = modes.output[modes.index[: A.shape[0]]] @ A
    V[:, :, start.n_observable :] = 0.0
    return FilterPass(
        modes=modes,
        predicted=recorder.predicted,
        innovations=recorder.innovations,
        nis=recorder.nis,
        filtered=recorder.filtered,
        index=recorder.index,
        cov=recorder.all("cov"),
        innovation_cov=recorder.all("innovation_cov"),
        whitening=recorder.all("whitening"),
        gain=recorder.all("gain"),
        filter_gain=recorder.all("filter_gain"),
        filtered_cov=recorder.all("filtered_cov"),
        mode=np.concatenate(recorder.mode),
        sensitivity=A,
        innovation_sensitivity=V,
        n_observable=start.n_observable,
        stationary_from=recorder.stationary_from,
    )


def _assemble(
    kind: FilterKind,
    time: np.ndarray,
    forward: FilterPass,
    flat: FlatStart,
    start: PassStart,
) -> KalmanResult:
    noise_size = np.sqrt(np.max(np.diagonal(forward.modes.noise_cov, axis1=1, axis2=2), axis=0))
    scale = np.concatenate([start.scale, noise_size])
    before = one_earlier(flat)
    predicted = correct(
        forward.predicted.copy() if forward.sensitivity.size else forward.predicted,
        forward.cov, forward.index, forward.sensitivity, before, start.scale,
    )  # fmt: skip
    innovations, innovation_cov, nis, dof = _innovations(forward, before, start.scale)
    return KalmanResult(
        kind=kind,
        time=time,
        predicted=predicted,
        filtered=_filtered(forward, flat, scale),
        innovations=innovations,
        innovation_cov=innovation_cov,
        nis=nis,
        nis_dof=dof,
        log_likelihood=_log_likelihood(forward, flat, start),
        stationary_from=forward.stationary_from,
        observed=start.observed,
        forward=forward,
        flat_start=flat,
        scale=scale,
    )


def filtered_moments(
    modes: Modes, mode: np.ndarray, P: np.ndarray, white: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gain (n + n_w, n_y) and covariance of (x[k], w̄[k]) given y up to k for known δ, by distinct entry.

    The gain is [P Cᵀ; R12] S⁻¹, (53); the covariance of x is in Joseph form.
    """
    C, R, N_e = modes.output[mode], modes.measurement_cov[mode], modes.noise_measurement_cov[mode]
    n, n_w = P.shape[1], N_e.shape[1]
    reach = np.concatenate([P @ np.swapaxes(C, 1, 2), N_e], axis=1)
    gain = (reach @ np.swapaxes(white, 1, 2)) @ white
    K = np.ascontiguousarray(gain[:, :n])
    rest = np.eye(n) - K @ C
    cov: np.ndarray = np.zeros((mode.size, n + n_w, n + n_w))
    cov[:, :n, :n] = rest @ P @ np.swapaxes(rest, 1, 2) + K @ R @ np.swapaxes(K, 1, 2)
    cov[:, n:, n:] = modes.noise_cov[mode]
    if np.any(N_e):
        cov[:, :n, n:] = -K @ np.swapaxes(N_e, 1, 2)
        cov[:, n:, :n] = np.swapaxes(cov[:, :n, n:], 1, 2)
        cov[:, n:, n:] -= gain[:, n:] @ np.swapaxes(N_e, 1, 2)
    return gain, cov


def filtered_loads(forward: FilterPass) -> np.ndarray:
    """Sensitivity (n_kept, n + n_w, q) of the filtered (x[k], w̄[k]) to δ."""
    n_kept, n, _ = forward.sensitivity.shape
    loads = -forward.filter_gain[forward.index[:n_kept]] @ forward.innovation_sensitivity
    loads[:, :n] += forward.sensitivity
    return loads


def _filtered(forward: FilterPass, flat: FlatStart, scale: np.ndarray) -> GaussianSequence:
    mean = forward.filtered.copy() if forward.sensitivity.size else forward.filtered
    return correct(mean, forward.filtered_cov, forward.index, filtered_loads(forward), flat, scale)


def _innovations(
    forward: FilterPass, before: FlatStart, scale: np.ndarray
) -> tuple[np.ndarray, Varying, np.ndarray, np.ndarray]:
    """One-step prediction errors, their covariances, νᵀ S⁻¹ ν and its degrees of freedom, sample by
    sample."""
    modes = forward.modes
    n_y = modes.present.shape[1]
    sequence = correct(
        forward.innovations.copy(), forward.innovation_cov, forward.index,
        -forward.innovation_sensitivity, before, np.ones(n_y),
    )  # fmt: skip
    is_corrected = sequence.cov.distinct is not forward.innovation_cov
    nis = forward.nis
    if is_corrected:
        white = by_index(whitening(sequence.cov.distinct), sequence.cov.index, sequence.mean)
        nis = np.einsum("ky,ky->k", white, white)
    dof = modes.present.sum(axis=1)[modes.index]
    if np.all(modes.present) and not sequence.free.distinct.shape[2]:
        return sequence.mean, sequence.cov, nis, dof
    hidden = ~modes.present[modes.index]
    if sequence.free.distinct.shape[2]:
        n_kept = forward.sensitivity.shape[0]
        rows = modes.output[modes.index[:n_kept]]
        seen = np.linalg.norm(sequence.free.distinct[sequence.free.index[:n_kept]], axis=-1)
        open_ = seen > FREE_TOLERANCE * (np.abs(rows) @ scale)
        hidden[:n_kept] |= open_
        dof[:n_kept][np.any(open_, axis=1)] = 0
    nis = np.where(dof == 0, np.nan, nis)
    sequence.mean[hidden] = np.nan
    return sequence.mean, sequence.cov, nis, dof


def _log_likelihood(forward: FilterPass, flat: FlatStart, start: PassStart) -> float:
    """log p(y), or log ∫ p(y | x0) dx0 over the determined unknown states (density one per unit of the
    state)."""
    squares = np.sum(forward.nis)
    log_root = np.sum(np.log(np.diagonal(forward.whitening, axis1=1, axis2=2)), axis=1)
    counts = np.bincount(forward.index, minlength=log_root.size)
    n_present = int(counts @ forward.modes.present[forward.mode].sum(axis=1))
    value = counts @ log_root - 0.5 * (squares + n_present * np.log(2 * np.pi))
    if forward.n_observable == 0:
        return float(value)
    return float(value) + flat_evidence(flat, forward, start.sensitivity)


def unobservable_states(result: KalmanResult) -> np.ndarray:
    """Basis (n, r) of the state combinations that no output ever shows."""
    return unobservable_subspace(result.observed.transition, result.observed.output)[1]


def steady_sample(result: KalmanResult) -> int | None:
    """First sample with all outputs whose gain is within FIT.steady_gain of the stationary gain, or None.

    The distance is the Frobenius norm with states and innovations in their stationary standard deviations.
    """
    forward, predicted = result.forward, result.predicted
    full = np.flatnonzero(forward.modes.present.all(axis=1))
    if np.unique(forward.modes.model).size > 1 or full.size == 0:
        return None
    mode = int(full[0])
    target = try_stationary_filter(mode_model(forward.modes, mode))
    if target is None:
        return None
    matrices = (
        forward.modes.transition[mode],
        forward.modes.output[mode],
        forward.modes.measurement_cov[mode],
        forward.modes.cross_cov[mode],
    )
    size = np.sqrt(np.diagonal(target.predicted_cov))
    weight = np.sqrt(np.diagonal(target.innovation_cov)) / np.where(size > 0, size, np.inf)[:, None]
    limit = FIT.steady_gain * np.linalg.norm(target.gain * weight)
    index = forward.modes.index
    for begin in range(0, index.size, GAIN_BLOCK):
        block = begin + np.flatnonzero(index[begin : begin + GAIN_BLOCK] == mode)
        numbers, first = np.unique(predicted.cov.index[block], return_index=True)
        gains, _ = predictor_gain(predicted.cov.distinct[numbers], *matrices)
        near = np.linalg.norm((gains - target.gain) * weight, axis=(1, 2)) <= limit
        free = predicted.free.distinct[predicted.free.index[block[first]]]
        near &= ~np.any(undetermined(free, np.eye(size.size), predicted.scale), axis=-1)
        if np.any(near):
            return int(np.min(block[first[near]]))
    return None
