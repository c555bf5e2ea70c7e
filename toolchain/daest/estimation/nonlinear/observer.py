"""A constant observer gain for a nonlinear model: the stationary Kalman gain of its average linearisation.

Averaging the Jacobians along the trajectory gives a friction or a dead zone the slope that it has over the
motion, where a linearisation at one point would give it none or an enormous one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from daest.estimation.filter_engines.stationary import known_filter
from daest.model.flat import Dynamics
from daest.model.linear import DiscreteModel, StateSpace
from daest.numerics.riccati import forgetting
from daest.systems.linear.state_space import sample
from daest.systems.simulation.sensor_laws import sensor_laws, steepest_slopes

MOST_POINTS = 2000  # of a trajectory that the average is taken over
KEPT = 32  # functions of its Jacobians


@dataclass(frozen=True)
class AverageModel:
    """Mean Jacobians along a trajectory: A (n, n), G (n, n_w), C (n_y, n). Where these have no gain, those
    of the `exact` one may have: its entries that are equal along the trajectory are without the rounding of
    their sum, which may show an angle behind a gear that no output sees."""

    A: np.ndarray
    G: np.ndarray
    C: np.ndarray
    period: float
    exact: AverageModel | None = None


@dataclass(frozen=True)
class Observer:
    """`gain` (n, n_y) corrects the predicted state, x += gain ν, of covariance `predicted_cov` (n, n);
    cov(ν) = innovation_cov."""

    gain: np.ndarray
    innovation_cov: np.ndarray
    predicted_cov: np.ndarray


def average_model(
    explicit: Dynamics,
    theta: np.ndarray,
    time: np.ndarray,
    states: np.ndarray,
    ubar: np.ndarray,
) -> AverageModel:
    """Average linearisation over states (n_samples, n) with inputs ū (n_samples, n_ū)."""
    chosen = np.unique(np.linspace(0, time.size - 1, min(time.size, MOST_POINTS)).astype(int))
    if explicit.is_symbolic:  # asked again and again by a search over noise levels
        along, one = (_jacobians_along(explicit.rhs, explicit.outputs, n) for n in (chosen.size, 1))
    else:  # not kept: it would keep the process of an FMU
        one = jacobians(explicit)
        along = _summed(one, chosen.size)
    sums = along(states[chosen].T, ubar[chosen].T, theta, time[chosen])
    first = one(states[chosen[0]], ubar[chosen[0]], theta, time[chosen[0]])
    means = [np.array(whole) / chosen.size for whole in sums]
    equal = [_with_equal(*pair, chosen.size) for pair in zip(means, first, strict=True)]
    laws = sensor_laws(explicit)
    if laws is not None:
        # The gain of a sensor's steepest slope, which follows the slope along the motion.
        means[2] = equal[2] = steepest_slopes(
            explicit, laws, theta, time[chosen], states[chosen], ubar[chosen]
        )
    period = float(np.median(np.diff(time)))
    (A, G, C), (A_equal, G_equal, C_equal) = means, equal
    return AverageModel(A, G, C, period, exact=AverageModel(A_equal, G_equal, C_equal, period))


def _with_equal(mean: np.ndarray, first: ca.DM, n_samples: int) -> np.ndarray:
    """The `mean` (n, m) of matrices with entries that are the same at all samples as in the `first` of them:
    a sum of n equal numbers is off by up to n rounding errors."""
    once = np.array(first)
    return np.where(np.abs(mean - once) <= n_samples * np.finfo(float).eps * np.abs(once), once, mean)


def jacobians(explicit: Dynamics) -> ca.Function:
    """(x, ū, θ, t) -> ∂f/∂x (n, n), ∂f/∂w (n, n_w), ∂h/∂x (n_y, n) without noise."""
    return _jacobians(explicit.rhs, explicit.outputs, explicit.is_symbolic)


@lru_cache(maxsize=KEPT)
def _jacobians_along(rhs: ca.Function, outputs: ca.Function, n_samples: int) -> ca.Function:
    return _summed(_jacobians(rhs, outputs, True), n_samples)


def _summed(function: ca.Function, n_samples: int) -> ca.Function:
    """(x, ū, θ, t), columns for samples but one θ for all -> the sums of the matrices over the samples."""
    return function.map("along", "serial", n_samples, [2], [0, 1, 2])


def _jacobians(rhs: ca.Function, outputs: ca.Function, is_symbolic: bool) -> ca.Function:
    kind: Any = ca.SX if is_symbolic else ca.MX
    n, n_u, n_v, n_w, n_theta = (rhs.numel_in(i) for i in range(5))
    x, ubar, w = kind.sym("x", n), kind.sym("u", n_u + n_v), kind.sym("w", n_w)
    theta, t = kind.sym("theta", n_theta), kind.sym("t")
    at = (x, ubar[:n_u], ubar[n_u:], w, theta, t)
    f, h = rhs(*at), outputs(*at)
    matrices = [ca.densify(ca.jacobian(f, x)), ca.densify(ca.jacobian(f, w)), ca.densify(ca.jacobian(h, x))]
    with_noise = ca.Function("jacobians", [x, ubar, theta, t, w], matrices)
    return ca.Function(
        "at_rest", [x, ubar, theta, t], with_noise.call([x, ubar, theta, t, kind.zeros(n_w)], True, False)
    )


@np.errstate(over="ignore", invalid="ignore")  # an average that overflows has no gain
def observer(model: AverageModel, intensity: np.ndarray, measurement_std: np.ndarray) -> Observer | None:
    """Stationary gain for `intensity` (n_w,) and `measurement_std` (n_y,); None where none exists."""
    if not np.all(np.isfinite(model.A)):
        return None
    sampled = sampled_average(model, intensity, measurement_std)
    if not np.all(np.isfinite(sampled.transition)) or not np.all(np.isfinite(sampled.process_cov)):
        return None
    found = observer_of(sampled)
    return observer(model.exact, intensity, measurement_std) if found is None and model.exact else found


def observer_of(sampled: DiscreteModel) -> Observer | None:
    """The stationary gain of a sampled model; None where none exists."""
    found = known_filter(sampled)
    if found is None:
        return None
    # The predictor gain is Φ times the gain that corrects the state at the sample itself.
    gain = found.predicted_cov @ sampled.output.T @ np.linalg.inv(found.innovation_cov)
    return Observer(gain, found.innovation_cov, found.predicted_cov)


def sampled_average(model: AverageModel, intensity: np.ndarray, measurement_std: np.ndarray) -> DiscreteModel:
    """The average model sampled, without inputs and without undamped modes that no output sees: those have
    no stationary covariance, and reach no prediction. Shapes: intensity (n_w,), measurement_std (n_y,)."""
    n, n_w, n_y = model.A.shape[0], model.G.shape[1], model.C.shape[0]
    space = StateSpace(
        state_names=("",) * n,
        input_names=(),
        input_derivatives=(),
        noise_names=("",) * n_w,
        output_names=("",) * n_y,
        unknown_names=(),
        A=model.A,
        B=np.zeros((n, 0)),
        G=model.G,
        b=np.zeros(n),
        C=model.C,
        D=np.zeros((n_y, 0)),
        H=np.zeros((n_y, n_w)),
        d=np.zeros(n_y),
        X=np.zeros((0, n)),
        U=np.zeros((0, 0)),
        W=np.zeros((0, n_w)),
        x0=np.zeros(0),
    )
    sampled = sample(space, model.period, "zoh", intensity, measurement_std**2)
    return replace(sampled, transition=forgetting(sampled.transition, sampled.output))
