"""Helpers of the oracles: exact simulation and likelihood of linear systems, and tables with limits.

Nothing here uses daest: matrices are sampled by one matrix exponential (Van Loan 1978), and the likelihood
is that of the stationary Kalman filter by scipy's Riccati solver, with the initial state eliminated by least
squares.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import minimize
from scipy.stats import beta

RECURSIONS = 1000  # of the Riccati equation, where it is not solved at once


@dataclass(frozen=True)
class Linear:
    """dx = (A x + B u) dt + G dw, y = C x + D u + e; intensity (n_w,) of w and standard deviation (n_y,) of
    e."""

    A: np.ndarray
    B: np.ndarray
    G: np.ndarray
    C: np.ndarray
    D: np.ndarray
    intensity: np.ndarray
    std: np.ndarray


def sampled(model: Linear, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Transition, input matrix of a held input, and covariance of the process noise over one period."""
    n, n_u = model.A.shape[0], model.B.shape[1]
    held = np.zeros((n + n_u, n + n_u))
    held[:n, :n], held[:n, n:] = model.A, model.B
    block = expm(held * period)
    Q = (model.G * model.intensity) @ model.G.T
    van_loan = np.zeros((2 * n, 2 * n))
    van_loan[:n, :n], van_loan[:n, n:], van_loan[n:, n:] = -model.A, Q, model.A.T
    grown = expm(van_loan * period)
    cov = grown[n:, n:].T @ grown[:n, n:]
    return block[:n, :n], block[:n, n:], (cov + cov.T) / 2


def simulated(
    model: Linear, inputs: np.ndarray, period: float, rng: np.random.Generator, x0: np.ndarray
) -> np.ndarray:
    """Outputs (n_samples, n_y) with process and measurement noise; inputs (n_samples, n_u) are held."""
    Phi, Gamma, Q = sampled(model, period)
    values, vectors = np.linalg.eigh(Q)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    x, y = x0.copy(), np.empty((len(inputs), model.C.shape[0]))
    for k, u in enumerate(inputs):
        y[k] = model.C @ x + model.D @ u
        x = Phi @ x + Gamma @ u + root @ rng.standard_normal(x.size)
    return y + model.std * rng.standard_normal(y.shape)


def binary(n_samples: int, held: int, size: float, rng: np.random.Generator) -> np.ndarray:
    """A random binary input (n_samples, 1) of +-size, held for `held` samples."""
    signs = rng.integers(0, 2, -(-n_samples // held)) * 2.0 - 1.0
    return size * np.repeat(signs, held)[:n_samples, None]


def log_likelihood(model: Linear, inputs: np.ndarray, outputs: np.ndarray, period: float) -> float:
    """Of the stationary Kalman filter that starts at the initial state which suits the record best."""
    Phi, Gamma, Q = sampled(model, period)
    R = np.diag(model.std**2)
    n, (n_samples, n_y) = Phi.shape[0], outputs.shape
    if np.any(model.intensity > 0.0) and model.G.size:
        P = stationary_covariance(Phi, model.C / model.std[:, None], Q)
        S = model.C @ P @ model.C.T + R
        K = Phi @ P @ model.C.T @ np.linalg.inv(S)
    else:
        S, K = R, np.zeros((n, n_y))
    whitening = np.linalg.inv(np.linalg.cholesky(S))
    closed, known = Phi - K @ model.C, outputs - inputs @ model.D.T
    drive = np.zeros((n_samples, n))
    drive[1:] = inputs[:-1] @ Gamma.T + known[:-1] @ K.T
    at_zero = (known - accumulated(closed, drive) @ model.C.T) @ whitening.T
    starts = np.zeros((n, n_samples, n))
    starts[:, 0] = np.eye(n)
    response = np.stack([accumulated(closed, start) for start in starts], axis=-1)
    slopes = whitening @ model.C @ response
    table = slopes.reshape(-1, n)
    scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    x0 = np.linalg.lstsq(table / scale, at_zero.ravel(), rcond=1e-8)[0]
    rest = at_zero.ravel() - (table / scale) @ x0
    log_det = np.linalg.slogdet(S)[1] * n_samples
    return float(-(rest @ rest + log_det + rest.size * np.log(2 * np.pi)) / 2)


def accumulated(closed: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """x[k] = closed x[k - 1] + drive[k] for all k, (n_samples, n), by doubling the reach of the sums."""
    x, power, reach = drive.copy(), closed, 1
    while reach < len(x):
        x[reach:] = x[reach:] + x[:-reach] @ power.T
        power, reach = power @ power, 2 * reach
    return x


def stationary_covariance(Phi: np.ndarray, C: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Predicted covariance (n, n) of the Kalman filter for outputs with unit noise: scipy's, or the limit of
    the recursion where the pencil is too near the unit circle for it."""
    unit = np.eye(C.shape[0])
    try:
        return solve_discrete_are(Phi.T, C.T, Q, unit)
    except np.linalg.LinAlgError:
        P = Q * RECURSIONS
        for _ in range(RECURSIONS):
            gain = np.linalg.solve(C @ P @ C.T + unit, C @ P @ Phi.T)
            P = Phi @ P @ Phi.T - Phi @ P @ C.T @ gain + Q
        return (P + P.T) / 2


def best_log_likelihood(
    model_at: Callable[[np.ndarray], Linear],
    start: np.ndarray,
    inputs: np.ndarray,
    outputs: np.ndarray,
    period: float,
) -> tuple[float, np.ndarray]:
    """Largest log-likelihood over the arguments of `model_at` near `start`, by scipy without derivatives of
    ours."""

    def value(z: np.ndarray) -> float:
        try:
            with np.errstate(all="ignore"):
                found = -log_likelihood(model_at(z), inputs, outputs, period)
        except (np.linalg.LinAlgError, ValueError):
            return 1e12
        return found if np.isfinite(found) else 1e12

    found = minimize(value, start, method="L-BFGS-B", bounds=[(z - 12.0, z + 12.0) for z in start])
    return -float(found.fun), found.x


def limits(hits: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson limits of a share."""
    tail = (1.0 - level) / 2
    low = beta.ppf(tail, hits, n - hits + 1) if hits else 0.0
    high = beta.ppf(1.0 - tail, hits + 1, n - hits) if hits < n else 1.0
    return float(low), float(high)


def share(flags: Iterable[bool]) -> str:
    """Percentage with its 95 % limits and the count."""
    flags = list(flags)
    if not flags:
        return "-"
    low, high = limits(sum(flags), len(flags))
    return f"{100 * sum(flags) / len(flags):.1f} % ({100 * low:.1f} to {100 * high:.1f}; n = {len(flags)})"


def print_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """A table in Markdown."""
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(str(cell) for cell in row) + " |")


def kept(path: Path | None) -> list[dict]:
    """Results of earlier slices of a study, one JSON object a line."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path and path.exists() else []


def keep(path: Path | None, result: dict) -> None:
    """Append one result to a study."""
    if path is not None:
        with path.open("a") as file:
            file.write(json.dumps(result) + "\n")
