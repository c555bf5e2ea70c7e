"""The extended and the unscented Kalman filter one sample at a time: `run_ekf` and `run_ukf` over one
interval.

The interval begins at the filtered state of the sample before, with no output there, and ends at the new
sample: the recursion is that of a whole record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines.ekf import run_ekf
from daest.estimation.filter_engines.filter_task import Noise, Record, Start, Task
from daest.estimation.filter_engines.interpreted import project
from daest.estimation.filter_engines.ukf import run_ukf
from daest.estimation.filters.local import MODES_FOLLOWED, discrete_names, discrete_slots, in_states_of
from daest.estimation.streaming.online import checked_arrays
from daest.model.estimates import Estimate, InitialState, Sample
from daest.model.flat import Dynamics, ExplicitModel
from daest.model.holds import Hold, causal_hold
from daest.systems.events.event_functions import EventFunctions
from daest.systems.events.event_update import Mode, settled_start
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.redundant import good_everywhere
from daest.systems.simulation.integrate import interval_inputs
from daest.systems.simulation.local_linear import LocalModel, internal_function, internal_names, local_model

SUBSTEPS = 4  # of the local linearisation in an expected step
Kind = Literal["ekf", "ukf"]


@dataclass(frozen=True)
class GaussianMemory:
    """Mean (n,) and covariance (n, n) of the state at the last sample, with its outputs; `inputs` (n_u,) and
    `time` of that sample, NaN before the first; `step`: the last step; `mode`: `Mode.stored` of a model with
    events, else empty."""

    time: float
    step: float
    inputs: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    log_likelihood: float
    mode: np.ndarray


@dataclass(frozen=True)
class OnlineGaussian:
    """The filter of `model` at `theta` with `noise`; `inside` gives internal variables and their slopes.
    Substeps are no longer than `longest` seconds."""

    kind: Kind
    model: LocalModel
    theta: np.ndarray
    noise: Noise
    hold: Hold
    longest: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    first: GaussianMemory
    inside: ca.Function
    notes: tuple[str, ...] = ()

    @property
    def input_names(self) -> tuple[str, ...]:
        return self.model.explicit.flat.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        return self.model.explicit.flat.output_names

    def begin(self) -> GaussianMemory:
        return self.first

    def advance(self, memory: GaussianMemory, sample: Sample) -> tuple[GaussianMemory, Estimate]:
        """Raises IntegrationError where the model has no finite value, and EstimationError
        `filter-singular-innovation`."""
        is_first = not np.isfinite(memory.time)
        data = self._record(memory, sample, is_first)
        start = Start(memory.mean, memory.cov)
        if is_first and self.model.hold is not None:
            task = Task.of(self.model, data, self.theta, self.noise, start, np.inf)
            start = Start(*project(task, start.mean, start.cov, data.u0[0], sample.time)[:2])
        run: Any = run_ekf if self.kind == "ekf" else run_ukf
        mode = None if is_first else self._mode(memory)
        found = run(self.model, data, self.theta, self.noise, start, self.longest, mode=mode)
        step = memory.step if is_first else sample.time - memory.time
        after = GaussianMemory(
            sample.time,
            step,
            sample.inputs,
            found.filtered[-1],
            found.filtered_cov[-1],
            memory.log_likelihood + found.log_likelihood,
            np.zeros(0) if found.last_mode is None else found.last_mode.stored(),
        )
        innovations = np.asarray(found.innovations[-1])
        whitened = self._whitened(found, innovations)
        values, std = self._variables(after, data.u1[-1])
        dof = int(np.isfinite(whitened).sum())
        nis = float(np.nansum(whitened**2)) if dof else float("nan")
        return after, Estimate(
            sample.time, values, std, innovations, whitened, nis, dof, after.log_likelihood
        )

    def _mode(self, memory: GaussianMemory) -> Mode | None:
        """That of the last sample; None for a model without events."""
        events = self.model.explicit.flat.events
        if events is None:
            return None
        return Mode.of_stored(
            memory.mode, self.theta.size, events.conditions.numel(), self.model.explicit.n_tears
        )

    def _record(self, memory: GaussianMemory, sample: Sample, is_first: bool) -> Record:
        """The interval before the sample, without outputs at its begin; the first sample is alone."""
        explicit = self.model.explicit
        if is_first:
            ubar = np.concatenate([sample.inputs, np.zeros(len(explicit.input_derivatives))])[None]
            return Record(np.array([sample.time]), ubar, ubar.copy(), sample.outputs[None].astype(float))
        time = np.array([memory.time, sample.time])
        inputs = np.vstack([memory.inputs, sample.inputs])
        u0, u1 = interval_inputs(explicit, time, inputs, self.hold)
        last = np.hstack([inputs[-1:], u1[-1:, inputs.shape[1] :]])
        outputs = np.vstack([np.full(sample.outputs.size, np.nan), sample.outputs])
        return Record(time, np.vstack([u0, last]), np.vstack([u1, last]), outputs)

    def _whitened(self, found: Any, innovations: np.ndarray) -> np.ndarray:
        if self.kind == "ekf":
            return np.asarray(innovations / np.sqrt(found.variances[-1]))
        there = np.isfinite(innovations)
        white = np.full(innovations.size, np.nan)
        if np.any(there):
            root = np.linalg.cholesky(found.innovation_cov[-1][np.ix_(there, there)])
            white[there] = np.linalg.solve(root, innovations[there])
        return white

    def _variables(self, memory: GaussianMemory, ubar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n, n_w, n_u = memory.mean.size, self.noise.intensity.size, memory.inputs.size
        mode = self._mode(memory)
        theta = self.theta if mode is None else mode.theta
        value, slopes = self.inside(memory.mean, ubar[:n_u], ubar[n_u:], np.zeros(n_w), theta, memory.time)
        self.model.explicit.raise_failure()
        rows = np.array(slopes)
        cov = np.zeros((n + n_w, n + n_w))
        cov[:n, :n] = memory.cov
        cov[np.arange(n, n + n_w), np.arange(n, n + n_w)] = self.noise.intensity / memory.step
        variance = np.einsum("ij,jk,ik->i", rows, cov, rows)
        std = np.sqrt(np.maximum(variance, 0.0))
        kept = theta[discrete_slots(self.model.explicit)]
        return np.append(np.array(value).ravel(), kept), np.append(std, np.full(kept.size, np.nan))

    def stored(self, memory: GaussianMemory) -> dict[str, np.ndarray]:
        return {name: np.asarray(value) for name, value in vars(memory).items()}

    @property
    def _mode_size(self) -> int:
        events = self.model.explicit.flat.events
        return (
            0
            if events is None
            else self.theta.size
            + events.conditions.numel()
            + self.model.explicit.n_tears
            + events.ticks.numel()
        )

    def restored(self, arrays: Mapping[str, np.ndarray]) -> GaussianMemory:
        n = self.first.mean.size
        shapes: dict[str, tuple[int | None, ...]] = {
            "time": (), "step": (), "inputs": (len(self.input_names),), "mean": (n,), "cov": (n, n),
            "log_likelihood": (), "mode": (self._mode_size,),
        }  # fmt: skip
        found = checked_arrays(arrays, shapes)
        plain = {name: float(found[name]) for name in ("time", "step", "log_likelihood")}
        return GaussianMemory(**{**found, **plain})  # type: ignore[arg-type]


def online_gaussian(
    explicit: Dynamics,
    theta: np.ndarray,
    intensity: np.ndarray,
    std: np.ndarray,
    period: float,
    *,
    kind: Kind = "ekf",
    hold: Hold = "foh",
    initial: InitialState | None = None,
    longest: float | None = None,
) -> OnlineGaussian:
    """The filter of `explicit` with all its outputs, for steps of about `period` [s].

    intensity (n_w,), std (n_y,) in the order of the model. `initial` None is an unknown start: the consistent
    initial point of the model, with the size of each state as its standard deviation. The states are those of
    `good_everywhere`. `longest` [s]: of the substeps (None: a SUBSTEPS-th of the period).

    Raises EstimationError `filter-initial-state`, `output-white-noise`; ModelError of the initial point.
    """
    start, notes = _start(explicit, theta, initial)
    has_events = explicit.flat.events is not None
    used = explicit if has_events else good_everywhere(explicit)
    if used is not explicit:
        start = _in_other_states(used, explicit, start, theta)
        explicit = used
    model = local_model(explicit)
    names = internal_names(explicit)
    units = {o.name: o.unit for o in explicit.flat.outputs} | {v.name: v.unit for v in explicit.flat.unknowns}
    discrete = discrete_names(explicit)
    names, units = (*names, *discrete), {**units, **dict.fromkeys(discrete, "")}
    notes = (*notes, MODES_FOLLOWED) if has_events else notes
    hold = causal_hold(hold)
    first = GaussianMemory(
        float("nan"), period, np.zeros(len(explicit.flat.inputs)), start.mean, start.cov, 0.0, np.zeros(0)
    )
    return OnlineGaussian(
        kind, model, np.asarray(theta, float), Noise(np.asarray(intensity, float), np.asarray(std, float) **
        2), hold, period / SUBSTEPS if longest is None else longest, names, tuple(units[name] for name in
        names), first, inside_function(explicit), notes, )  # fmt: skip


def _in_other_states(used: Dynamics, explicit: Dynamics, start: Start, theta: np.ndarray) -> Start:
    """The start in the states of `used`, with inputs at zero."""
    time, inputs = np.arange(2.0), np.zeros((2, len(explicit.flat.inputs)))
    mean, cov = in_states_of(used, explicit, start.mean, start.cov, theta, time, inputs)
    assert cov is not None  # all of it is finite
    return Start(mean, cov)


def _first_point(explicit: Dynamics, theta: np.ndarray) -> np.ndarray:
    """The start of the model itself, with inputs at zero."""
    if isinstance(explicit, ExplicitModel) and explicit.flat.events is not None:
        none = np.zeros(explicit.rhs.numel_in(1) + explicit.rhs.numel_in(2))
        return settled_start(EventFunctions(explicit), theta, none, 0.0)[0]
    return initial_point(explicit, theta)[0]


def inside_function(explicit: Dynamics) -> ca.Function:
    """(x, u, v, w, theta, t) -> internal variables (n_v,) and their slopes (n_v, n + n_w) by x and w."""
    kind: Any = ca.SX if explicit.is_symbolic else ca.MX
    arguments = [kind.sym(f"a{i}", explicit.rhs.numel_in(i)) for i in range(6)]
    value = internal_function(explicit)(*arguments)
    slopes = ca.densify(ca.jacobian(value, ca.vertcat(arguments[0], arguments[3])))
    return ca.Function("inside", arguments, [value, slopes])


def _start(
    explicit: Dynamics, theta: np.ndarray, initial: InitialState | None
) -> tuple[Start, tuple[str, ...]]:
    n = explicit.n_states
    if initial is not None and (initial.mean.shape != (n,) or initial.cov.shape != (n, n)):
        raise EstimationError(
            "filter-initial-state",
            f"the initial state needs a mean of {n} numbers and an {n} x {n} covariance",
            remedy=f"the states are {', '.join(explicit.state_names)}",
        )
    if initial is not None and not np.any(initial.is_unknown):
        return Start(initial.mean, initial.cov), ()
    x0 = _first_point(explicit, theta)
    nominal = {v.name: v.nominal for v in explicit.flat.unknowns}
    size = np.array([abs(nominal.get(name) or 0.0) for name in explicit.state_names])
    size = np.maximum(size, np.abs(x0))
    size = np.where(size > 0.0, size, 1.0)
    unknown = np.ones(n, bool) if initial is None else initial.is_unknown
    mean = x0 if initial is None else np.where(unknown, x0, initial.mean)
    cov = np.diag(size**2)
    if initial is not None:
        cov = np.where(unknown[:, None] | unknown[None, :], cov, initial.cov)
    told = ", ".join(
        f"{name} {m:.3g} ± {s:.3g}"
        for name, m, s, is_open in zip(explicit.state_names, mean, size, unknown, strict=True)
        if is_open
    )
    note = f"The initial state is unknown: the filter starts at {told} (initial point and nominal value)."
    return Start(mean, cov), (note,)
