"""The Kalman filter of `kalman` one sample at a time, for any steps, missing outputs and an unknown start.

The unknown part δ of x[0] is carried along as in `flat_start`: the state is m + A δ and the innovation ν - V
δ. As soon as the outputs determine δ well, its estimate and covariance are put into m and P, and from there
the recursion is the ordinary one, report (47); the result is that of the filter of a whole record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from daest.estimation.filter_engines.flat_start import solve_root, whitening
from daest.estimation.filter_engines.kalman import reference_start
from daest.estimation.filter_engines.stationary import stationary_filter, without_unseen
from daest.estimation.filters.case import square
from daest.estimation.gates import FIT
from daest.estimation.streaming.online import checked_arrays
from daest.model.estimates import Estimate, FilterKind, InitialState, Sample, singular_innovation
from daest.model.holds import Hold, causal_hold
from daest.model.linear import DiscreteModel, StateSpace
from daest.numerics.gaussian import undetermined
from daest.numerics.riccati import forgetting
from daest.systems.linear.state_space import sample

ROUNDING = 4.0 * float(np.finfo(float).eps)  # of the difference of two times, relative to them
KEPT_MODELS = 64  # sampled models that are remembered; a stream with ever new steps samples anew
LOG_2_PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class KalmanMemory:
    """The prediction of the last sample and the sample itself: its outputs are used once more with the step
    that follows it, because white noise that reaches an output is held over that step.

    `mean` (n,), `cov` (n, n): of x at the last sample before its outputs, for δ = 0. `sensitivity` (n, q) to
    δ, whose first columns have the information `root` (p, p + 1) = [R r] before those outputs, R δ = r.
    `time` NaN: no sample yet. `step`: the last step.
    """

    time: float
    step: float
    inputs: np.ndarray
    outputs: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    sensitivity: np.ndarray
    root: np.ndarray
    log_density: float


@dataclass(frozen=True)
class _Update:
    """What the outputs of one sample change: innovation of δ = 0 and its slope, gain in x, and so on."""

    innovation: np.ndarray
    slope: np.ndarray
    whitening: np.ndarray
    present: np.ndarray
    output: np.ndarray
    root: np.ndarray


@dataclass(frozen=True)
class OnlineKalman:
    """The filter of `model` for white noises of intensity (n_w, n_w) and measurement noise of covariance
    `measurement_cov` (n_y, n_y), with all outputs of `model`. `period` [s] is the step that is expected.

    `variables` (n_v, n + n_w + n_ū + 1) are rows of the internal variables over (x, w̄, ū, 1).
    """

    model: StateSpace
    intensity: np.ndarray
    measurement_cov: np.ndarray
    period: float
    hold: Hold
    noise: Literal["white", "held"]
    names: tuple[str, ...]
    units: tuple[str, ...]
    variables: np.ndarray
    first: KalmanMemory
    scale: np.ndarray
    kind: FilterKind
    notes: tuple[str, ...] = ()
    _models: dict[int, DiscreteModel] = field(default_factory=dict, compare=False, repr=False)

    @property
    def input_names(self) -> tuple[str, ...]:
        return self.model.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        return self.model.output_names

    def begin(self) -> KalmanMemory:
        return self.first

    def sampled(self, step: float, time: float = 0.0) -> DiscreteModel:
        """The model over a step [s] at `time`, whose rounding it need not follow; equal steps share it."""
        grid = FIT.same_step * self.period
        is_nominal = abs(step - self.period) <= ROUNDING * abs(time)
        number = round(1.0 / FIT.same_step) if is_nominal else max(round(step / grid), 1)
        found = self._models.pop(number, None)
        if found is None:
            found = sample(
                self.model, number * grid, self.hold, self.intensity, self.measurement_cov, self.noise
            )
            found = self._settling(found)
        self._models[number] = found
        if len(self._models) > KEPT_MODELS:
            del self._models[next(iter(self._models))]
        return found

    def _settling(self, model: DiscreteModel) -> DiscreteModel:
        """A stationary filter forgets what no output sees at every step, so that its covariance settles."""
        if self.kind != "stationary":
            return model
        return replace(model, transition=forgetting(model.transition, model.output))

    def advance(self, memory: KalmanMemory, sample: Sample) -> tuple[KalmanMemory, Estimate]:
        """Raises EstimationError `filter-singular-innovation`."""
        now = memory
        if np.isfinite(memory.time):
            now = self._predicted(memory, sample)
        ubar = self._ubar(memory, sample)
        now = replace(now, time=sample.time, inputs=ubar, outputs=sample.outputs)
        model = self.sampled(now.step, sample.time)
        update = self._update(now, model)
        return now, self._estimate(now, model, update)

    def _ubar(self, memory: KalmanMemory, sample: Sample) -> np.ndarray:
        """Inputs and the slopes that the model needs: those of the last step."""
        sources = [source for source, _ in self.model.input_derivatives]
        if not sources:
            return sample.inputs
        if not np.isfinite(memory.time):
            return np.concatenate([sample.inputs, np.zeros(len(sources))])
        n_u = sample.inputs.size
        rise = (sample.inputs - memory.inputs[:n_u]) / (sample.time - memory.time)
        return np.concatenate([sample.inputs, rise[sources]])

    def _predicted(self, memory: KalmanMemory, following: Sample) -> KalmanMemory:
        """The prediction of the sample that follows, from the one that is remembered."""
        step = following.time - memory.time
        model = self.sampled(step, following.time)
        update = self._update(memory, model)
        S12 = model.cross_cov * update.present
        Phi, P, C = model.transition, memory.cov, update.output
        gain = (Phi @ P @ C.T + S12) @ update.whitening.T @ update.whitening
        closed = Phi - gain @ C
        R = _masked(model.measurement_cov, update.present)
        cross = gain @ S12.T
        cov = closed @ P @ closed.T + model.process_cov + gain @ R @ gain.T - cross - cross.T
        n_u, n_v = following.inputs.size, len(self.model.input_derivatives)
        following_ubar = np.concatenate([following.inputs, np.zeros(n_v)])
        assert following_ubar.size == n_u + n_v
        mean = (
            Phi @ memory.mean + model.input_now @ memory.inputs + model.input_next @ following_ubar
            + model.drift + gain @ update.innovation
        )  # fmt: skip
        sensitivity = memory.sensitivity  # of a stationary filter: the directions that no output sees
        if self.kind != "stationary":
            sensitivity = Phi @ sensitivity - gain @ update.slope
        density = memory.log_density + _log_density(update)
        after = replace(
            memory, step=step, mean=mean, cov=(cov + cov.T) / 2, sensitivity=sensitivity, root=update.root,
            log_density=density,
        )  # fmt: skip
        return _collapsed(after)

    def _update(self, memory: KalmanMemory, model: DiscreteModel) -> _Update:
        present = np.isfinite(memory.outputs)
        C = model.output * present[:, None]
        known = model.output @ memory.mean + model.feedthrough @ memory.inputs + model.output_offset
        innovation = np.where(present, memory.outputs - known, 0.0)
        S = C @ memory.cov @ C.T + _masked(model.measurement_cov, present)
        try:
            white = whitening(S)
        except np.linalg.LinAlgError:
            raise singular_innovation(f"at t = {memory.time:g} s") from None
        if not np.all(np.isfinite(white)):
            raise singular_innovation(f"at t = {memory.time:g} s")
        slope, p = C @ memory.sensitivity, memory.root.shape[0]
        root = memory.root
        if p:
            rows = np.column_stack([white @ slope[:, :p], white @ innovation])
            root = np.asarray(np.linalg.qr(np.vstack([root, rows]), mode="r"))[:p]
        return _Update(innovation, slope, white, present, C, root)

    def _estimate(self, memory: KalmanMemory, model: DiscreteModel, update: _Update) -> Estimate:
        n, n_w = memory.mean.size, self.intensity.shape[0]
        C, present = update.output, update.present
        N_e = model.noise_measurement_cov * present
        weight = update.whitening.T @ update.whitening
        reach = np.vstack([memory.cov @ C.T, N_e])
        gain = reach @ weight
        prior = np.zeros((n + n_w, n + n_w))
        prior[:n, :n], prior[n:, n:] = memory.cov, model.noise_cov
        total = np.hstack([C, np.zeros((C.shape[0], n_w))])
        closed = np.eye(n + n_w) - gain @ total
        R = _masked(model.measurement_cov, present)
        mixed = np.vstack([np.zeros((n, C.shape[0])), N_e])
        cross = closed @ mixed @ gain.T
        cov = closed @ prior @ closed.T + gain @ R @ gain.T - cross - cross.T
        mean = np.concatenate([memory.mean, np.zeros(n_w)]) + gain @ update.innovation
        load = np.vstack([memory.sensitivity, np.zeros((n_w, memory.sensitivity.shape[1]))])
        load = load - gain @ update.slope
        delta, factor, free = _known_start(update.root, memory.sensitivity.shape[1])
        mean = mean + load @ delta
        spread, open_directions = load @ factor, load @ free
        rows = self.variables[:, : n + n_w]
        values = rows @ mean + self.variables[:, n + n_w : -1] @ memory.inputs + self.variables[:, -1]
        variance = np.einsum("ij,jk,ik->i", rows, cov, rows) + np.sum((rows @ spread) ** 2, axis=1)
        scale = np.concatenate([self.scale, np.sqrt(np.diagonal(model.noise_cov))])
        is_open = undetermined(open_directions, rows, scale)
        std = np.sqrt(np.maximum(variance, 0.0))
        innovations, whitened, dof = self._innovations(memory, update)
        return Estimate(
            memory.time,
            np.where(is_open, np.nan, values),
            np.where(is_open, np.inf, std),
            innovations,
            whitened,
            float(np.nansum(whitened**2)) if dof else float("nan"),
            dof,
            memory.log_density + _log_density(update) + _evidence(update.root),
        )

    def _innovations(self, memory: KalmanMemory, update: _Update) -> tuple[np.ndarray, np.ndarray, int]:
        """Innovations and whitened ones given the past about δ, and how many outputs could be predicted."""
        delta, factor, free = _known_start(memory.root, memory.sensitivity.shape[1])
        innovation = update.innovation - update.slope @ delta
        spread = update.slope @ factor
        white = update.whitening
        if spread.size:
            root = np.linalg.inv(white)
            white = whitening(root @ root.T + spread @ spread.T)
        whitened = white @ innovation
        is_open = undetermined(
            update.slope @ free, np.eye(innovation.size), np.abs(update.output) @ self.scale
        )
        hidden = ~update.present | is_open
        innovation = np.where(hidden, np.nan, innovation)
        # Only where every present output is predictable have they a joint distribution.
        dof = 0 if np.any(is_open) else int(update.present.sum())
        return innovation, np.where(hidden | (dof == 0), np.nan, whitened), dof

    def stored(self, memory: KalmanMemory) -> dict[str, np.ndarray]:
        return {name: np.asarray(value) for name, value in vars(memory).items()}

    def restored(self, arrays: Mapping[str, np.ndarray]) -> KalmanMemory:
        n, n_y = self.first.mean.size, self.first.outputs.size
        p_at_most = self.first.root.shape[0]
        shapes: dict[str, tuple[int | None, ...]] = {
            "time": (), "step": (), "inputs": (self.first.inputs.size,), "outputs": (n_y,), "mean": (n,),
            "cov": (n, n), "sensitivity": (n, None), "root": (None, None), "log_density": (),
        }  # fmt: skip
        found = checked_arrays(arrays, shapes)
        p, columns = found["root"].shape
        if p > p_at_most or columns != p + 1 or p > found["sensitivity"].shape[1]:
            raise ValueError(f"'root' has shape {(p, columns)}")
        plain = {name: float(found[name]) for name in ("time", "step", "log_density")}
        return KalmanMemory(**{**found, **plain})  # type: ignore[arg-type]


def online_kalman(
    model: StateSpace,
    intensity: np.ndarray,
    measurement_cov: np.ndarray,
    period: float,
    *,
    kind: FilterKind = "time-varying",
    hold: Hold = "foh",
    initial: InitialState | None = None,
    units: Mapping[str, str] | None = None,
) -> OnlineKalman:
    """The filter of `model` with all its outputs, for steps of about `period` [s].

    `intensity` (n_w,) or (n_w, n_w), `measurement_cov` (n_y,) or (n_y, n_y); `initial` None is an unknown
    start, and zero for the stationary kind. `units`: of the variables by name. Smooth inputs run
    straight, since later samples are not known. Errors of `stationary_filter`, `sample` and `kalman_filter`.
    """
    intensity = square(intensity, len(model.noise_names))
    measurement_cov = square(measurement_cov, len(model.output_names))
    direct = model.H @ intensity @ model.H.T
    noise: Literal["white", "held"] = "held" if np.any(np.diagonal(direct) > 0.0) else "white"
    hold = causal_hold(hold)
    nominal = sample(model, period, hold, intensity, measurement_cov, noise)
    first, scale = _first(model, nominal, kind, initial)
    names, rows = variable_rows(model)
    all_units = tuple((units or {}).get(name, "") for name in names)
    return OnlineKalman(
        model, intensity, measurement_cov, period, hold, noise, names, all_units, rows, first, scale, kind,
        _notes(model, noise),
    )  # fmt: skip


def variable_rows(model: StateSpace) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and rows over (x, w, ū, 1) of the internal variables, then of the outputs that are none of
    them."""
    extra = [i for i, name in enumerate(model.output_names) if name not in model.unknown_names]
    rows = np.vstack(
        [
            np.hstack([model.X, model.W, model.U, model.x0[:, None]]),
            np.hstack([model.C, model.H, model.D, model.d[:, None]])[extra],
        ]
    )
    return (*model.unknown_names, *(model.output_names[i] for i in extra)), rows


def _notes(model: StateSpace, noise: str) -> tuple[str, ...]:
    notes = []
    if noise == "held":
        notes.append("White noise reaches an output directly; it is held over each sample.")
    if model.input_derivatives and np.any(model.D[:, len(model.input_names) :]):
        notes.append("An output contains the slope of an input: that of the last step is used.")
    return tuple(notes)


def _first(
    model: StateSpace, nominal: DiscreteModel, kind: FilterKind, initial: InitialState | None
) -> tuple[KalmanMemory, np.ndarray]:
    """The memory before the first sample, and the size of each state."""
    n = nominal.transition.shape[0]
    if kind == "stationary":
        still, unseen = without_unseen(nominal, np.ones(nominal.output.shape[0], dtype=bool))
        P = stationary_filter(still, model.state_names).predicted_cov
        mean = np.zeros(n) if initial is None else initial.mean
        start, p, scale = (mean, P), 0, np.sqrt(np.diagonal(P))
        share = np.abs(unseen) / np.where(scale > 0.0, scale, 1.0)[:, None]
        sensitivity = unseen / np.max(share, axis=0, initial=np.finfo(float).tiny)
    else:
        wanted = InitialState.unknown(n) if initial is None else initial
        if np.any(wanted.is_unknown):
            found = reference_start(nominal, wanted)
            start, sensitivity = (found.mean, found.cov), found.sensitivity
            p, scale = found.n_observable, found.scale
        else:
            start, sensitivity, p = (wanted.mean, wanted.cov), np.zeros((n, 0)), 0
            scale = np.sqrt(np.diagonal(wanted.cov))
    n_ubar, n_y = model.B.shape[1], len(model.output_names)
    # The flat prior has density one per unit of the state, not of δ.
    log_size = float(np.sum(np.log(np.linalg.svd(sensitivity[:, :p], compute_uv=False))))
    memory = KalmanMemory(
        np.nan, nominal.period, np.zeros(n_ubar), np.full(n_y, np.nan), *start, sensitivity,
        np.zeros((p, p + 1)), log_size,
    )  # fmt: skip
    return memory, scale


def _masked(R: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Unit rows where an output is missing."""
    return np.where(present[:, None] & present[None, :], R, 0.0) + np.diag(np.where(present, 0.0, 1.0))


def _known_start(root: np.ndarray, q: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (q,), factor (q, q) and free directions (q, q) of δ from the information root."""
    p = root.shape[0]
    mean, factor, free = np.zeros(q), np.zeros((q, q)), np.zeros((q, q))
    free[p:, p:] = np.eye(q - p)
    if p:
        mean[:p], factor[:p, :p], free[:p, :p], _ = solve_root(root[:, :p], root[:, p])
    return mean, factor, free


def _log_density(update: _Update) -> float:
    """log N(ν; 0, S) of the present outputs for δ = 0."""
    white = update.whitening @ update.innovation
    n_present = int(update.present.sum())
    return float(np.sum(np.log(np.diagonal(update.whitening))) - 0.5 * (white @ white + n_present * LOG_2_PI))


def _evidence(root: np.ndarray) -> float:
    """log ∫ exp(δᵀ s - δᵀ Λ δ / 2) dδ with Λ = RᵀR, s = Rᵀ r; NaN while δ is not determined."""
    p = root.shape[0]
    if p == 0:
        return 0.0
    if not np.all(np.isfinite(solve_root(root[:, :p], root[:, p])[3])):
        return float("nan")
    R, r = root[:, :p], root[:, p]
    return float(0.5 * (r @ r + p * LOG_2_PI) - np.sum(np.log(np.abs(np.diagonal(R)))))


def _collapsed(memory: KalmanMemory) -> KalmanMemory:
    """The memory with δ put into mean and covariance, if it is well determined."""
    p = memory.root.shape[0]
    if p == 0:
        return memory
    mean, factor, _, condition = solve_root(memory.root[:, :p], memory.root[:, p])
    if condition > FIT.well_conditioned:
        return memory
    A = memory.sensitivity[:, :p]
    spread = A @ factor
    return replace(
        memory,
        mean=memory.mean + A @ mean,
        cov=memory.cov + spread @ spread.T,
        sensitivity=memory.sensitivity[:, p:],
        root=np.zeros((0, 1)),
        log_density=memory.log_density + _evidence(memory.root),
    )
