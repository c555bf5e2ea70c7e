"""Error dynamics of the null's observer: how a small unknown drive reaches the innovations.

The predicted state's error obeys e[k+1] = Φ[k] (I - K C[k]) e[k] + Γ₀[k] g₀[k] + Γ₁[k] g₁[k] for a drive of
the states' rates that runs straight from g₀ to g₁ within an interval. Where the dynamics are affine, all
matrices are constant. Else they are taken along the recording: an average slope takes friction for damping,
and a law seen through it would not be what refitted parameters, whose slopes are exact, can absorb.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from daest.estimation.nonlinear.observer import AverageModel, jacobians
from daest.model.experiment import Experiment
from daest.model.flat import ExplicitModel
from daest.model.holds import Hold
from daest.numerics.exponential import transition_integrals
from daest.numerics.recursions import linear_recursion, products_along, varying_recursion
from daest.numerics.tables import turned
from daest.systems.events.integration import Correction, IntegrationError
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.simulation.integrate import Integrator, integrate, integrator

MOST_STATES = 20  # beyond, the sensitivities along a recording take more memory than they are worth
PIECE = 2000  # samples whose sensitivities are held at a time
SHIFT, DRIVE, RAMP = "daest_shift_", "daest_drive_", "daest_ramp_"


@dataclass(frozen=True)
class ErrorDynamics:
    """Φ, Γ₀, Γ₁ (n_samples - 1, n, n) of every interval and C (n_samples, n_y, n) at every sample; (1, ...)
    where they are constant."""

    transition: np.ndarray
    at_start: np.ndarray
    at_end: np.ndarray
    C: np.ndarray

    def watched(self, gain: np.ndarray, sensors: np.ndarray | None = None) -> WatchedErrors:
        """With an observer of `gain` (n, n_y), which follows the relative slopes of the `sensors` (n_samples,
        n_y)."""
        s = np.ones((1, gain.shape[1])) if sensors is None or np.all(sensors == 1.0) else sensors[:-1]
        seen = s[:, :, None] * self.C[: max(self.C.shape[0] - 1, 1)]
        return WatchedErrors(self, gain, s, self.transition - self.transition @ gain @ seen)


@dataclass(frozen=True)
class WatchedErrors:
    """`open_loop` under an observer of `gain` (n, n_y) that follows the `slopes` (n_samples - 1 or 1, n_y) of
    the sensors: `closed` (n_samples - 1 or 1, n, n) takes the error of one predicted state to the next."""

    open_loop: ErrorDynamics
    gain: np.ndarray
    slopes: np.ndarray
    closed: np.ndarray

    def errors(self, drive: np.ndarray, direct: np.ndarray | None = None) -> np.ndarray:
        """Errors of the predicted outputs (k, n_samples, n_y) from drives (k, 2, n_samples - 1, n) at the
        starts and ends of the intervals, and `direct` errors (k, n_samples, n_y) of the predictions."""
        change = self._shown(self._pushed(drive, direct))
        return change if direct is None else change + direct

    def state_errors(self, drive: np.ndarray, direct: np.ndarray) -> np.ndarray:
        """Errors of the predicted states (k, n_samples, n) from the same."""
        return self._followed(self._pushed(drive, direct))

    def errors_along(self, courses: np.ndarray, entry: np.ndarray) -> np.ndarray:
        """`errors` of drives that are courses (k, 2, n_samples - 1) times one and the same `entry` (n,)."""
        own = self.open_loop
        pushed = courses[:, 0, :, None] * (own.at_start @ entry)
        pushed += courses[:, 1, :, None] * (own.at_end @ entry)
        return self._shown(pushed)

    def from_start(self, n_samples: int) -> np.ndarray:
        """Errors of the predicted states (n, n_samples, n) from one in each of them at the start."""
        n = self.closed.shape[1]
        return self._followed(np.zeros((n, n_samples - 1, n)), np.eye(n))

    def _pushed(self, drive: np.ndarray, direct: np.ndarray | None) -> np.ndarray:
        """What is added to the errors of the states over each interval (k, n_samples - 1, n)."""
        own = self.open_loop
        pushed = _times(drive[:, 0], own.at_start) + _times(drive[:, 1], own.at_end)
        if direct is not None:
            pushed -= _times((self.slopes * direct[:, :-1]) @ turned(self.gain), own.transition)
        return pushed

    def _followed(self, pushed: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """Errors of the predicted states (k, n_samples, n) from that and from the `start` (k, n)."""
        start = np.zeros(self.closed.shape[1]) if start is None else start
        if self.closed.shape[0] == 1:
            return linear_recursion(self.closed[0], pushed, start)
        return varying_recursion(self.closed, pushed, start)

    def _shown(self, pushed: np.ndarray) -> np.ndarray:
        """Errors of the predicted outputs (k, n_samples, n_y) from it."""
        return _times(self._followed(pushed), self.open_loop.C)


def _times(rows: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Every row (k, m, n) by the matrix of its sample (m, p, n) or by the one matrix (1, p, n)."""
    if matrices.shape[0] == 1:
        return rows @ turned(matrices[0])
    return products_along(rows, matrices)


def average_dynamics(average: AverageModel) -> ErrorDynamics:
    """Of the average linearisation."""
    flow = transition_integrals(average.A, average.period)
    at_start = flow.first - flow.second
    return ErrorDynamics(flow.transition[None], at_start[None], flow.second[None], average.C[None])


def dynamics_along(
    explicit: ExplicitModel,
    average: AverageModel,
    experiments: tuple[Experiment, ...],
    filtered: list[np.ndarray],
    predicted: list[np.ndarray],
    hold: Hold,
    rtol: float,
) -> tuple[ErrorDynamics, ...]:
    """Of every experiment along its filtered states (n_samples, n), predictions starting from them; of the
    average where the model cannot be followed so, as where a filtered state meets a singularity of a law."""
    constant = average_dynamics(average)
    if not is_varying(explicit):
        return (constant,) * len(experiments)
    model = pushed_integrator(explicit)
    slopes = jacobians(explicit).slice("output_slopes", range(4), [2])
    found = []
    for one in zip(experiments, filtered, predicted, strict=True):
        try:
            found.append(_along(explicit, model, slopes, *one, hold, rtol))
        except IntegrationError:
            found.append(constant)
    return tuple(found)


def is_varying(explicit: ExplicitModel) -> bool:
    """Whether the dynamics of errors change along a recording, and are followed."""
    has_few = explicit.invariants is None and explicit.n_states <= MOST_STATES
    return has_few and not has_affine_dynamics(explicit)


def pushed_integrator(explicit: ExplicitModel) -> Integrator:
    """What follows the errors of a model whose dynamics vary."""
    return integrator(_pushed(explicit), _pushes(explicit.n_states), runs_once=True)


def _pushes(n: int) -> tuple[str, ...]:
    return tuple(f"{kind}{i}" for kind in (SHIFT, DRIVE, RAMP) for i in range(n))


def _pushed(explicit: ExplicitModel) -> ExplicitModel:
    """The model with its states as outputs, and parameters (zero) that shift its states and drive their rates
    by a constant and by a multiple of the time."""
    n, flat = explicit.n_states, explicit.flat
    whole = ca.vertcat(flat.theta, ca.SX.sym("pushes", 3 * n))
    extra = tuple(replace(flat.parameters[0], name=name, value=0.0) for name in _pushes(n))
    kind: Any = ca.SX if explicit.is_symbolic else ca.MX
    x, u, v, w = (kind.sym("a", explicit.rhs.numel_in(i)) for i in range(4))
    theta, t = kind.sym("theta", len(flat.parameters) + 3 * n), kind.sym("t")
    own = theta[: len(flat.parameters)]
    shift, drive, ramp = ca.vertsplit(theta[len(flat.parameters) :], [0, n, 2 * n, 3 * n])
    at = [x, u, v, w, theta, t]
    rate = explicit.rhs(x + shift, u, v, w, own, t) + drive + ramp * t
    return replace(
        explicit,
        flat=replace(flat, parameters=(*flat.parameters, *extra), theta=whole),
        rhs=ca.Function("rhs", at, [rate]),
        outputs=ca.Function("outputs", at, [x]),
        near=None,
        of_tears=None,
    )


def _along(
    explicit: ExplicitModel,
    model: Integrator,
    slopes: ca.Function,
    experiment: Experiment,
    filtered: np.ndarray,
    predicted: np.ndarray,
    hold: Hold,
    rtol: float,
) -> ErrorDynamics:
    """Every sample puts the state back to the filtered one, and with it all sensitivities to zero: what is
    seen at the next sample is of one interval."""
    n, n_samples = explicit.n_states, experiment.n_samples
    theta = np.concatenate([explicit.flat.theta_values, np.zeros(3 * n)])
    transition, constant, ramp = (np.empty((n_samples - 1, n, n)) for _ in range(3))
    for first in range(0, n_samples - 1, PIECE):
        piece = slice(first, first + PIECE + 1)
        intervals = slice(first, min(first + PIECE, n_samples - 1))
        sens = integrate(
            model,
            experiment.time[piece],
            experiment.inputs[piece],
            theta,
            filtered[first],
            hold=hold,
            sensitivities=True,
            correction=Correction(filtered[piece], np.eye(n)),
            rtol=rtol,
        ).sensitivities[1:]
        # A shift by δ moves the end by Φ δ, seen from the shifted state by Φ δ - δ.
        transition[intervals] = sens[:, :, :n] + np.eye(n)
        constant[intervals], ramp[intervals] = sens[:, :, n : 2 * n], sens[:, :, 2 * n : 3 * n]
    start, period = experiment.time[:-1, None, None], np.diff(experiment.time)[:, None, None]
    at_end = (ramp - start * constant) / period
    C = _slopes_along(explicit, slopes, experiment, predicted)
    return ErrorDynamics(transition, constant - at_end, at_end, C)


def _slopes_along(
    explicit: ExplicitModel, slopes: ca.Function, experiment: Experiment, states: np.ndarray
) -> np.ndarray:
    """∂h/∂x (n_samples, n_y, n) at the states (n_samples, n); (1, n_y, n) where it is the same at all."""
    n_samples, n = states.shape
    ubar = np.vstack([experiment.inputs.T, np.zeros((explicit.rhs.numel_in(2), n_samples))])
    theta = np.tile(explicit.flat.theta_values[:, None], (1, n_samples))
    rows = slopes.map(n_samples)(states.T, ubar, theta, experiment.time)
    C = np.array(rows).reshape(-1, n_samples, n).transpose(1, 0, 2)
    is_constant = np.array_equal(C, np.broadcast_to(C[:1], C.shape))
    return C[:1] if is_constant else C
