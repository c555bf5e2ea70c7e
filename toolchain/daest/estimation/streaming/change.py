"""Sequential tests on innovations: when did the model cease to hold? Page (1954), Basseville & Nikiforov
(1993).

Under a true model the whitened innovations are independent with mean 0 and variance 1. For every output five
cumulated sums of log-likelihood ratios (CUSUM) look for a mean above or below, a larger spread, and a
correlation of successive values of either sign. All are in nats, so that one threshold serves all; it is
found by simulation, for a mean number of samples between two false alarms (average run length).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

MEAN_SHIFT = 0.5  # standard deviations that the sums for the mean are tuned to
SPREAD_RATIO = 2.0  # of variances, likewise
CORRELATION = 0.3  # of successive innovations, likewise
CLIP = 4.0  # standard deviations: a single wrong sample is no change of the model
CHARTS = ("mean above", "mean below", "spread", "correlation", "alternation")
# Study of the threshold: streams at a time, samples of each, and thresholds [nats] that are simulated. The
# wanted one lies on the straight line of log run length over threshold through the last two.
STREAMS = 400
SAMPLES = 4000
LEVELS = (5.0, 6.5, 8.0)
BLOCK = 100  # samples whose increments are computed at once
FEWEST_ALARMS = 30  # of a level that is believed
MOST_LAGS = 12  # of the autoregression that whitens a reference

# Coefficients of the log-likelihood ratios, which a stream asks for at every sample.
_LEFT = 1.0 - CORRELATION**2
_HALF = 0.5 * MEAN_SHIFT**2
_SQUARE, _LOG = 0.5 * (1.0 - 1.0 / SPREAD_RATIO), 0.5 * math.log(SPREAD_RATIO)
_CONSTANT_OF_PAIR, _SQUARE_OF_PAIR = -0.5 * math.log(_LEFT), 0.5 * (1.0 - 1.0 / _LEFT)
_PRODUCT, _SQUARE_BEFORE = CORRELATION / _LEFT, 0.5 * CORRELATION**2 / _LEFT


@dataclass(frozen=True)
class Usual:
    """How innovations look while the model holds, per output: z[k] = mean + Σ a_i (z[k-i] - mean) + scale
    e[k].

    `mean`, `scale` (n_y,); `coefficients` (n_y, p); `drawn` (n_y, m): values of e to draw from, or None for
    the standard normal distribution.
    """

    mean: np.ndarray
    scale: np.ndarray
    coefficients: np.ndarray
    drawn: np.ndarray | None = None

    @classmethod
    def white(cls, n_outputs: int) -> Usual:
        """What the theory of the filter says."""
        return cls(np.zeros(n_outputs), np.ones(n_outputs), np.zeros((n_outputs, 0)))

    @property
    def n_outputs(self) -> int:
        return self.mean.size


@dataclass(frozen=True)
class ChartState:
    """The sums (n_y, 5) after a sample, the times [s] at which each last was zero, the last standardised
    value of each output (n_y,), and its last raw values (n_y, p)."""

    sums: np.ndarray
    since: np.ndarray
    last: np.ndarray
    lags: np.ndarray


@dataclass(frozen=True)
class Crossing:
    """The sum that passed the threshold: of `output` and `chart` (positions), its value in nats, and the
    time [s] from which on it grew."""

    output: int
    chart: int
    statistic: float
    since: float


def start_of_charts(usual: Usual) -> ChartState:
    """All sums at zero."""
    n, p = usual.coefficients.shape
    return ChartState(
        np.zeros((n, len(CHARTS))), np.full((n, len(CHARTS)), np.nan), np.full(n, np.nan),
        np.full((n, p), np.nan),
    )  # fmt: skip


def update_charts(state: ChartState, whitened: np.ndarray, time: float, usual: Usual) -> ChartState:
    """The sums after the whitened innovations (n_y,) of one more sample; NaN leaves an output as it is."""
    z = _standardised(whitened, state.lags, usual)
    grown = np.maximum(state.sums + increments(z, state.last), 0.0)
    lags = np.column_stack([whitened, state.lags[:, :-1]]) if state.lags.shape[1] else state.lags
    is_new = (grown == 0.0) | np.isnan(state.since)
    return ChartState(grown, np.where(is_new, time, state.since), z, lags)


def crossing(state: ChartState, threshold: float) -> Crossing | None:
    """The largest sum, if it exceeds the threshold."""
    output, chart = np.unravel_index(int(np.argmax(state.sums)), state.sums.shape)
    value = float(state.sums[output, chart])
    if value <= threshold:
        return None
    return Crossing(int(output), int(chart), value, float(state.since[output, chart]))


def restarted(state: ChartState, time: float) -> ChartState:
    """All sums at zero again."""
    return replace(state, sums=np.zeros_like(state.sums), since=np.full_like(state.since, time))


def increments(z: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Log-likelihood ratios (..., 5) of the values z (...) after the values `before` (...); 0 where z is
    missing, and for a correlation where `before` is."""
    z, before = (np.minimum(np.maximum(a, -CLIP), CLIP) for a in (z, before))
    both = _CONSTANT_OF_PAIR + _SQUARE_OF_PAIR * z * z - _SQUARE_BEFORE * before * before
    linear, product = MEAN_SHIFT * z, _PRODUCT * z * before
    found = np.empty((*z.shape, len(CHARTS)))
    found[..., 0] = linear - _HALF
    found[..., 1] = -linear - _HALF
    found[..., 2] = _SQUARE * z * z - _LOG
    found[..., 3] = both + product
    found[..., 4] = both - product
    found[np.isnan(found)] = 0.0
    return found


def usual_of(whitened: np.ndarray) -> Usual:
    """What is usual in the whitened innovations (n_samples, n_y) of a reference in which the model held as
    well as it can: an autoregression per output, of the order that the BIC chooses, and its residuals."""
    n_y = whitened.shape[1]
    parts = [_autoregression(whitened[:, i]) for i in range(n_y)]
    p = max(a.size for _, _, a, _ in parts)
    coefficients = np.zeros((n_y, p))
    for i, (_, _, a, _) in enumerate(parts):
        coefficients[i, : a.size] = a
    size = min(e.size for *_, e in parts)
    return Usual(
        np.array([mean for mean, *_ in parts]),
        np.array([scale for _, scale, *_ in parts]),
        coefficients,
        np.array([e[:size] for *_, e in parts]),
    )


def threshold_for(usual: Usual, average_run: float, seed: int = 0) -> float:
    """The threshold [nats] with which false alarms come every `average_run` samples in the mean, by
    simulation.

    The logarithm of the run length of a CUSUM grows linearly with its threshold; the line through simulated
    run lengths of 1e2 to 1e4 samples tells those that are too long to be simulated.
    """
    rng = np.random.default_rng(seed)
    levels, logs = [], []
    for level in LEVELS:
        run = simulated_run_length(usual, level, rng, STREAMS, SAMPLES)
        if not np.isfinite(run):
            break
        levels.append(level)
        logs.append(np.log(run))
    if len(levels) < 2:  # hardly any alarm at the lowest levels: the theory's slope of 1 bounds the rest
        return float(max(LEVELS[0], LEVELS[0] + np.log(average_run / (STREAMS * SAMPLES))))
    slope = (logs[-1] - logs[-2]) / (levels[-1] - levels[-2])
    return float(levels[-1] + (np.log(average_run) - logs[-1]) / slope)


def simulated_run_length(
    usual: Usual, threshold: float, rng: np.random.Generator, streams: int, samples: int
) -> float:
    """Mean number of samples between alarms while the model holds; inf with too few of them to tell."""
    sums = np.zeros((streams, usual.n_outputs, len(CHARTS)))
    before, alarms = np.full((streams, usual.n_outputs), np.nan), 0
    for first in range(0, samples, BLOCK):
        z = _drawn(usual, min(BLOCK, samples - first), streams, rng)
        steps = increments(z, np.concatenate([before[None], z[:-1]]))
        for step in steps:
            sums += step
            np.maximum(sums, 0.0, out=sums)
            over = sums.max(axis=(1, 2)) > threshold
            if over.any():
                alarms += int(over.sum())
                sums[over] = 0.0
        before = z[-1]
    return streams * samples / alarms if alarms >= FEWEST_ALARMS else float("inf")


def _drawn(usual: Usual, samples: int, streams: int, rng: np.random.Generator) -> np.ndarray:
    """Standardised values (samples, streams, n_y)."""
    if usual.drawn is None:
        return rng.standard_normal((samples, streams, usual.n_outputs))
    # One sample of all outputs at a time, which keeps what they have in common.
    return usual.drawn.T[rng.integers(usual.drawn.shape[1], size=(samples, streams))]


def _standardised(whitened: np.ndarray, lags: np.ndarray, usual: Usual) -> np.ndarray:
    if not lags.shape[1]:
        return np.asarray((whitened - usual.mean) / usual.scale)
    past = np.where(np.isnan(lags), 0.0, lags - usual.mean[:, None])
    predicted = usual.mean + np.sum(usual.coefficients * past, axis=1)
    return np.asarray((whitened - predicted) / usual.scale)


def _autoregression(z: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Mean, scale, coefficients and standardised residuals by least squares over samples without gaps."""
    known = z[np.isfinite(z)]
    mean = float(np.mean(known)) if known.size else 0.0
    centred = z - mean
    best: tuple[float, np.ndarray, np.ndarray] | None = None
    for p in range(MOST_LAGS + 1):
        rows = np.column_stack([centred[MOST_LAGS - i : centred.size - i] for i in range(p + 1)])
        rows = rows[np.all(np.isfinite(rows), axis=1)]
        if rows.shape[0] < 4 * (p + 1):
            break
        a = np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0] if p else np.zeros(0)
        residual = rows[:, 0] - rows[:, 1:] @ a
        bic = rows.shape[0] * np.log(max(float(np.mean(residual**2)), 1e-300)) + p * np.log(rows.shape[0])
        if best is None or bic < best[0]:
            best = bic, a, residual
    if best is None:
        return mean, 1.0, np.zeros(0), known - mean
    _, a, residual = best
    scale = float(np.std(residual)) or 1.0
    return mean, scale, a, residual / scale
