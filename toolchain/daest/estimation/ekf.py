"""Continuous-discrete extended Kalman filter of an explicit model, and its likelihood with exact gradient.

Between samples the model is replaced by its linearisation at the current estimate, which is then solved
exactly for inputs that run straight (local linearisation: Jimenez & Ozaki, Int. J. Control 2003; used by CTSM): on
an affine model this is the Kalman filter. `substeps` divide a sample interval; each linearises anew. The
measurements of a sample are taken one after the other, which whitens the innovations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.errors import EstimationError
from daest.model.explicit import ExplicitModel
from daest.systems.fold import Fold, fold, run_fold, run_fold_tangents
from daest.systems.integrate import Hold, interval_inputs

TAYLOR_ORDER = 8  # of the exponential over h / 2^doublings
TAYLOR_RADIUS = 0.25  # |A| h / 2^doublings stays below: the first term left out is below 1e-11


@dataclass(frozen=True)
class EkfModel:
    """The compiled filter of a model. State of the loop: (x, vec P); constants: (theta, intensities, stds²)."""

    explicit: ExplicitModel
    loop: Fold
    substeps: int
    doublings: int
    n_details: int  # outputs of the loop beyond the whitened innovations and log variances


@dataclass(frozen=True)
class EkfInitial:
    """Mean (n,) and covariance (n, n) of the state at the first sample, before its measurement."""

    mean: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class EkfLikelihood:
    """log_likelihood, and per sample and output the whitened innovations and log variances (n_samples, n_y) with
    their derivatives (n_samples, n_directions, n_y); `gradient` (n_directions,)."""

    log_likelihood: float
    gradient: np.ndarray
    whitened: np.ndarray
    whitened_tangents: np.ndarray
    log_variance_tangents: np.ndarray


@dataclass(frozen=True)
class EkfRun:
    """Filtered and predicted states and covariances per sample, with what the innovations are made of.

    predicted, filtered (n_samples, n); their covariances (n_samples, n, n); innovations, whitened,
    variances (n_samples, n_y): conditional variance of each output given the ones before it in the sample;
    transition (n_samples, n, n): ∂x̂(k+1|k)/∂x̂(k|k); update (n_samples, n, n): ∂x̂(k|k)/∂x̂(k|k-1);
    sensing (n_samples, n_y, n): -∂(whitened)/∂x̂(k|k-1).
    """

    predicted: np.ndarray
    predicted_cov: np.ndarray
    filtered: np.ndarray
    filtered_cov: np.ndarray
    innovations: np.ndarray
    whitened: np.ndarray
    variances: np.ndarray
    transition: np.ndarray
    update: np.ndarray
    sensing: np.ndarray
    log_likelihood: float


def ekf_model(
    explicit: ExplicitModel, *, fastest: float, substeps: int = 1, details: bool = False, compiled: bool = True
) -> EkfModel:
    """The filter of `explicit`. `fastest`: largest norm of ∂f/∂x times the sample interval that the scaling of
    the exponential must cope with. `details`: also return what `EkfRun` holds (slower).

    Raises EstimationError `output-contains-noise` where an output contains white noise directly.
    """
    if not explicit.is_symbolic:
        raise EstimationError(
            "implicit-model",
            "The extended Kalman filter needs a model whose algebraic loops can be solved in closed form.",
            remedy="Use output error (--method oe), or break the nonlinear loop with a fast state.",
        )
    n, n_y = explicit.n_states, len(explicit.flat.outputs)
    n_u, n_v, n_w = (explicit.rhs.numel_in(i) for i in (1, 2, 3))
    n_theta = explicit.rhs.numel_in(4)
    per_step = max(fastest / substeps, TAYLOR_RADIUS)
    doublings = int(np.ceil(np.log2(per_step / TAYLOR_RADIUS)))
    x, P = ca.SX.sym("x", n), ca.SX.sym("P", n, n)
    u0, u1 = ca.SX.sym("u0", n_u + n_v), ca.SX.sym("u1", n_u + n_v)
    t0, dt = ca.SX.sym("t0"), ca.SX.sym("dt")
    y, mask = ca.SX.sym("y", n_y), ca.SX.sym("mask", n_y)
    theta, intensity = ca.SX.sym("theta", n_theta), ca.SX.sym("q", n_w)
    variance = ca.SX.sym("r", n_y)
    model = _Symbols(explicit, theta)
    xf, Pf, white, raw, variances, update, sensing = _measure(model, x, P, u0, t0, y, mask, variance)
    xp, Pp, transition = xf, Pf, ca.SX.eye(n)
    for i in range(substeps):
        ua, ub = (u0 + (u1 - u0) * (j / substeps) for j in (i, i + 1))
        h = dt / substeps
        xp, Pp, phi = _predict(model, xp, Pp, ua, ub, t0 + i * h, h, intensity, doublings)
        transition = phi @ transition
    outputs = [white, mask * ca.log(variances)]
    if details:
        outputs += [x, ca.vec(P), xf, ca.vec(Pf), raw, variances, ca.vec(transition), ca.vec(update), ca.vec(sensing)]
    loop = fold(
        ca.vertcat(x, ca.vec(P)),
        ca.vertcat(u0, u1, t0, dt, y, mask),
        ca.vertcat(theta, intensity, variance),
        ca.vertcat(xp, ca.vec(Pp)),
        ca.vertcat(*outputs),
        compiled=compiled,
    )
    return EkfModel(explicit, loop, substeps, doublings, sum(o.numel() for o in outputs[2:]))


@dataclass(frozen=True)
class _Symbols:
    explicit: ExplicitModel
    theta: ca.SX

    def split(self, ubar: ca.SX) -> tuple[ca.SX, ca.SX]:
        n_u = self.explicit.rhs.numel_in(1)
        return ubar[:n_u], ubar[n_u:]


def _measure(
    model: _Symbols, x: ca.SX, P: ca.SX, ubar: ca.SX, t: ca.SX, y: ca.SX, mask: ca.SX, variance: ca.SX
) -> tuple[ca.SX, ...]:
    """Measurement update, output by output: exact for independent measurement noises."""
    explicit = model.explicit
    n, n_y = x.numel(), y.numel()
    at, w = ca.SX.sym("at", n), ca.SX.sym("w", explicit.rhs.numel_in(3))
    u, v = model.split(ubar)
    h = explicit.outputs(at, u, v, w, model.theta, t)
    if ca.jacobian(h, w).nnz():
        raise EstimationError(
            "output-contains-noise",
            "An output contains white noise directly; the extended filter cannot weigh it.",
            remedy="Measure another variable, or pass the noise through a filter (Daest.Noise coloured sources).",
        )
    values, slopes = ca.substitute([h, ca.densify(ca.jacobian(h, at))], [at, w], [x, ca.SX.zeros(w.numel())])
    xf, Pf, update = x, P, ca.SX.eye(n)
    white, raw, variances, sensing = [], [], [], []
    for i in range(n_y):
        c = slopes[i, :]
        s = c @ Pf @ c.T + variance[i]
        innovation = mask[i] * (y[i] - values[i] - c @ (xf - x))
        gain = mask[i] * (Pf @ c.T) / s
        white.append(innovation / ca.sqrt(s))
        raw.append(innovation)
        variances.append(s)
        sensing.append(mask[i] * (c @ update) / ca.sqrt(s))
        xf = xf + gain @ innovation
        Pf = Pf - gain @ gain.T * s
        update = update - gain @ (c @ update)
    return xf, Pf, ca.vertcat(*white), ca.vertcat(*raw), ca.vertcat(*variances), update, ca.vertcat(*sensing)


def _predict(
    model: _Symbols,
    x: ca.SX,
    P: ca.SX,
    ua: ca.SX,
    ub: ca.SX,
    t: ca.SX,
    h: ca.SX,
    intensity: ca.SX,
    doublings: int,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Mean, covariance and transition over h of the linearisation at x, with u straight from ua to ub."""
    explicit = model.explicit
    n, n_w = x.numel(), intensity.numel()
    at, ubar, w, time = (
        ca.SX.sym("at", n),
        ca.SX.sym("ubar", ua.numel()),
        ca.SX.sym("w", n_w),
        ca.SX.sym("time"),
    )
    u, v = model.split(ubar)
    f = explicit.rhs(at, u, v, w, model.theta, time)
    parts = [f, ca.jacobian(f, at), ca.jtimes(f, ubar, (ub - ua) / h) + ca.jacobian(f, time), ca.jacobian(f, w)]
    f0, A, ramp, G = ca.substitute(parts, [at, ubar, w, time], [x, ua, ca.SX.zeros(n_w), t])
    diffusion = G @ ca.diag(intensity) @ G.T if n_w else ca.SX(n, n)
    # z = (δx, s, 1): δẋ = A δx + ramp s + f0, ṡ = 1.
    generator = ca.vertcat(ca.horzcat(A, ramp, f0), ca.SX(2, n + 2))
    generator[n, n + 1] = 1
    small = h / 2**doublings
    flow, Q = _taylor(generator * small, n), _taylor_covariance(A, diffusion, small)
    for _ in range(doublings):
        phi = flow[:n, :n]
        Q = Q + phi @ Q @ phi.T
        flow = flow @ flow
    phi = flow[:n, :n]
    P_next = phi @ P @ phi.T + Q
    return x + flow[:n, n + 1], (P_next + P_next.T) / 2, phi


def _taylor(M: ca.SX, n: int) -> ca.SX:
    """exp(M) by Horner's rule."""
    eye = ca.SX.eye(n + 2)
    result = eye
    for k in range(TAYLOR_ORDER, 0, -1):
        result = eye + M @ result / k
    return result


def _taylor_covariance(A: ca.SX, diffusion: ca.SX, h: ca.SX) -> ca.SX:
    """∫ exp(Aτ) diffusion exp(Aᵀτ) dτ over h: the series of the Lyapunov operator L(X) = A X + X Aᵀ."""
    term = diffusion * h
    total = term
    for k in range(2, TAYLOR_ORDER + 1):
        product = A @ term
        term = (product + product.T) * (h / k)
        total = total + term
    return total


def record_data(model: EkfModel, time: np.ndarray, inputs: np.ndarray, outputs: np.ndarray, hold: Hold) -> np.ndarray:
    """What the loop reads per sample; after the last sample the filter predicts over a vanishing interval."""
    u0, u1 = interval_inputs(model.explicit, time, inputs, hold)
    u0, u1 = np.vstack([u0, u1[-1:]]), np.vstack([u1, u1[-1:]])
    steps = np.append(np.diff(time), np.finfo(float).tiny ** 0.25)
    mask = np.isfinite(outputs)
    return np.column_stack([u0, u1, time, steps, np.where(mask, outputs, 0.0), mask])


def constants(
    theta: np.ndarray, process_intensity: np.ndarray, measurement_variance: np.ndarray
) -> np.ndarray:
    return np.concatenate([theta, process_intensity, measurement_variance])


def ekf_likelihood(
    model: EkfModel,
    data: np.ndarray,
    initial: EkfInitial,
    constants: np.ndarray,
    initial_tangents: np.ndarray,
    constant_tangents: np.ndarray,
) -> EkfLikelihood:
    """log p(y) by prediction errors, with derivatives along directions of the initial mean (n_directions, n) and of
    the constants (n_directions, n_constants)."""
    n, n_y = model.explicit.n_states, len(model.explicit.flat.outputs)
    directions = initial_tangents.shape[0]
    s0 = np.concatenate([initial.mean, initial.covariance.T.ravel()])
    ds0 = np.hstack([initial_tangents, np.zeros((directions, n * n))])
    out, dout, _ = run_fold_tangents(model.loop, s0, data, constants, ds0, constant_tangents)
    white, log_variance = out[:, :n_y], out[:, n_y : 2 * n_y]
    dwhite, dlog = dout[:, :, :n_y], dout[:, :, n_y : 2 * n_y]
    gradient = -np.einsum("ki,kdi->d", white, dwhite) - 0.5 * dlog.sum(axis=(0, 2))
    return EkfLikelihood(_log_likelihood(white, log_variance, data, n_y), gradient, white, dwhite, dlog)


def _log_likelihood(white: np.ndarray, log_variance: np.ndarray, data: np.ndarray, n_y: int) -> float:
    n_measured = data[:, data.shape[1] - n_y :].sum()
    return float(-0.5 * (np.sum(white**2) + np.sum(log_variance) + n_measured * np.log(2 * np.pi)))


def run_ekf(model: EkfModel, data: np.ndarray, initial: EkfInitial, constants: np.ndarray) -> EkfRun:
    """Filter a recording (`record_data`) with a model built with `details=True`."""
    n, n_y = model.explicit.n_states, len(model.explicit.flat.outputs)
    s0 = np.concatenate([initial.mean, initial.covariance.T.ravel()])
    out, _ = run_fold(model.loop, s0, data, constants)
    sizes = [n_y, n_y, n, n * n, n, n * n, n_y, n_y, n * n, n * n, n_y * n]
    white, log_variance, xp, Pp, xf, Pf, raw, variances, phi, update, sensing = _columns(out, sizes)
    return EkfRun(
        xp, _matrices(Pp, n, n), xf, _matrices(Pf, n, n), raw, white, variances,
        _matrices(phi, n, n), _matrices(update, n, n), _matrices(sensing, n_y, n),
        _log_likelihood(white, log_variance, data, n_y),
    )  # fmt: skip


def _columns(table: np.ndarray, sizes: Sequence[int]) -> list[np.ndarray]:
    return np.split(table, np.cumsum(sizes)[:-1], axis=1)


def _matrices(columns: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """CasADi stacks columns; give (n_samples, rows, cols)."""
    return columns.reshape(-1, cols, rows).transpose(0, 2, 1)
