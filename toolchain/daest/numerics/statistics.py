"""Tests and moments of residual sequences.

Tails and quantiles of distributions, on `scipy.special`.

They have the names and the values of `scipy.stats`, whose import alone takes most of a second.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import special

WHITENESS_LAGS = 20
LARGEST_ORDER = 32  # of the autoregression that describes residuals
ORDERS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, LARGEST_ORDER)


def whiteness_p_value(residuals: np.ndarray, observed: np.ndarray) -> float:
    """Ljung-Box p-value that a sequence (n_samples,) is white; missing samples (observed False) are left out.

    The smallest of lags 1 … WHITENESS_LAGS enter as one chi-square sum; 1.0 for sequences too short to tell.
    """
    lags = min(WHITENESS_LAGS, residuals.size // 5)
    if lags < 1 or int(observed.sum()) < 3:
        return 1.0
    return float(chi2.sf(ljung_box(residuals, observed, lags), lags))


def ljung_box(residuals: np.ndarray, observed: np.ndarray, lags: int) -> float:
    """Q = n (n + 2) Σ r_l² / (n - l) over lags 1 … `lags` of a sequence (n_samples,); 0 for zeros.

    With missing samples (observed False) n - l is the number of observed pairs. White: chi-square of `lags`.
    """
    count = int(observed.sum())
    centred = np.where(observed, residuals, 0.0)
    variance = float(centred @ centred) / max(count, 1)
    if variance == 0.0:
        return 0.0
    statistic = 0.0
    for lag in range(1, lags + 1):
        pairs = int(np.sum(observed[lag:] & observed[:-lag]))
        if pairs:
            correlation = float(centred[lag:] @ centred[:-lag]) / pairs / variance
            statistic += pairs * correlation**2 * (count + 2) / count
    return statistic


def weighted_past(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Σ_i weights[i] v[k-i] along the last axis of `values` (…, n_samples); zero before the first sample.
    Shapes: weights (n_lags,)."""
    total = weights[0] * values
    for lag, weight in enumerate(weights[1:], start=1):
        total[..., lag:] += weight * values[..., :-lag]
    return total


def autoregression(residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vector autoregression r[k] = Σ A_i r[k-i] + e[k] of the order with the smallest AIC.

    residuals (n_samples, n_y). Returns A (order, n_y, n_y) and cov(e) (n_y, n_y).
    """
    n_samples, n_y = residuals.shape
    best: tuple[float, np.ndarray, np.ndarray] | None = None
    for order in ORDERS:
        rows = n_samples - LARGEST_ORDER
        if rows < 4 * n_y * order + 10 and best is not None:
            break
        past = [residuals[LARGEST_ORDER - i : n_samples - i] for i in range(1, order + 1)] if rows > 0 else []
        target = residuals[LARGEST_ORDER:] if rows > 0 else residuals
        regressors = np.hstack(past) if past else np.zeros((target.shape[0], 0))
        coefficients = np.linalg.lstsq(regressors, target, rcond=None)[0]
        errors = target - regressors @ coefficients
        cov = errors.T @ errors / target.shape[0]
        size = np.linalg.slogdet(cov + np.eye(n_y) * np.finfo(float).tiny)[1]
        criterion = target.shape[0] * size + 2 * n_y**2 * order
        if best is None or criterion < best[0]:
            best = (criterion, coefficients.reshape(-1, n_y, n_y).transpose(0, 2, 1), cov)
    assert best is not None
    return best[1], best[2]


def coloured_moment(slopes: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """cov(Σ_k slopes[:, k] · r[k]) (p, p) for a stationary coloured r with the spectrum of `residuals`.

    slopes (p, n_samples, n_y), residuals (n_samples, n_y). The spectrum is that of a vector
    autoregression, which reaches further than a kernel estimate of the same number of lags.
    """
    coefficients, cov = autoregression(residuals)
    n_samples = residuals.shape[0]
    length = 2 * int(2 ** np.ceil(np.log2(n_samples)))
    transformed = np.fft.rfft(slopes, length, axis=1)
    frequencies = np.arange(transformed.shape[1]) / length
    delays = np.exp(-2j * np.pi * np.outer(frequencies, np.arange(1, len(coefficients) + 1)))
    filters = np.eye(residuals.shape[1]) - np.tensordot(delays, coefficients, 1)
    root = np.linalg.solve(filters, np.broadcast_to(_root(cov), filters.shape))
    coloured = np.einsum("pfa,fab->pfb", transformed.conj(), root)
    weights = np.full(frequencies.size, 2.0)
    weights[0] = weights[-1] = 1.0
    weighted = coloured * np.sqrt(weights)[:, None]
    flat = weighted.reshape(slopes.shape[0], int(np.prod(weighted.shape[1:])))
    return np.real(flat @ flat.conj().T) / length


def _root(cov: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))


class chi2:
    """The chi-squared distribution of `df` degrees of freedom."""

    @staticmethod
    def sf(x: Any, df: Any) -> Any:
        """P(X > x)."""
        return special.chdtrc(df, np.maximum(x, 0.0))

    @staticmethod
    def logsf(x: Any, df: Any) -> Any:
        """log P(X > x), -inf where that is below the smallest number."""
        with np.errstate(divide="ignore"):
            return np.log(chi2.sf(x, df))

    @staticmethod
    def ppf(p: Any, df: Any) -> Any:
        """x with P(X ≤ x) = p."""
        return 2.0 * special.gammaincinv(np.divide(df, 2.0), p)

    @staticmethod
    def isf(p: Any, df: Any) -> Any:
        """x with P(X > x) = p."""
        return special.chdtri(df, p)


class norm:
    """The standard normal distribution."""

    @staticmethod
    def sf(x: Any) -> Any:
        """P(X > x)."""
        return special.ndtr(np.negative(x))

    @staticmethod
    def ppf(p: Any) -> Any:
        """x with P(X ≤ x) = p."""
        return special.ndtri(p)

    @staticmethod
    def isf(p: Any) -> Any:
        """x with P(X > x) = p."""
        return -special.ndtri(p)


class beta:
    """The beta distribution with the parameters `a` and `b`."""

    @staticmethod
    def sf(x: Any, a: Any, b: Any) -> Any:
        """P(X > x)."""
        return special.betaincc(a, b, np.clip(x, 0.0, 1.0))
