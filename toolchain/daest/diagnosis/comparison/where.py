"""Where a model fails: regions of its variables, time windows and frequency bands that hold more of the error
than they would if it were spread evenly.

Regions and windows are held against permutations of blocks of the squared error: blocks keep what
neighbouring errors have in common, and the largest excess over all places of a permutation pays for the
search. Bands are held against white noise, whose periodogram ordinates are independent and exponential.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from daest.diagnosis.gates import GATES
from daest.model.comparison import Finding
from daest.numerics.statistics import beta
from daest.quantities import spoken_duration

MOST_FINDINGS = 4
MOST_PER_OUTPUT = 2  # of one output and error
SMALLEST_PART = 0.02  # of the time: smaller regions are not looked at
SHARES = (0.05, 0.1, 0.2, 0.3, 0.5)  # of the time that a region covers
WINDOWS = (4, 8, 16)  # parts of a recording
OCTAVES = 8  # bands below the Nyquist frequency
PERMUTATIONS = 999
ROWS_AT_ONCE = 40  # permutations in one matrix product
BLOCKS = 24  # at least, of a record
CORRELATION_TIMES = 4.0  # in a block
SAME_VARIABLE = 0.999  # correlation above which two variables are one
MOST_VARIABLES = 12
SLOW = 1.0 / 120.0  # Hz: below, a period says more than a frequency


@dataclass(frozen=True)
class Signal:
    """A variable over all samples of all recordings, (n_samples,)."""

    name: str
    unit: str
    values: np.ndarray


@dataclass(frozen=True)
class ErrorSeries:
    """Error of one output over all recordings, (n_samples,), NaN where missing; `time` [s] and `record` tell
    where a sample is. `signals` are known without the sample itself."""

    output: str
    kind: Literal["one-step", "simulation"]
    error: np.ndarray
    time: np.ndarray
    record: np.ndarray
    record_names: tuple[str, ...]
    signals: tuple[Signal, ...]


@dataclass(frozen=True)
class Place:
    """Samples `inside` (n,) bool where `variable` is between `low` and `high`."""

    kind: Literal["time", "region"]
    variable: str
    unit: str
    low: float | None
    high: float | None
    inside: np.ndarray
    experiment: str | None = None


def where(series: Sequence[ErrorSeries], seed: int = 0) -> tuple[Finding, ...]:
    """The few most telling findings, best first; `where_level` tells how many good models get any."""
    usable = [one for one in series if np.isfinite(one.error).sum() >= 4 * BLOCKS]
    if not usable:
        return ()
    level = GATES.where_level / (2 * len(usable))
    found = [f for one in usable for f in (*_in_places(one, level, seed), *_in_bands(one, level))]
    found.sort(key=_surprise, reverse=True)
    return tuple(found[:MOST_FINDINGS])


def distinct(signals: Sequence[Signal], most: int = MOST_VARIABLES) -> tuple[Signal, ...]:
    """The first signals that move, without those that are a straight line in an earlier one."""
    chosen: list[Signal] = []
    rows: list[np.ndarray] = []
    for signal in signals:
        v = signal.values
        spread = float(np.std(v))
        if not np.isfinite(spread) or spread <= 1e-9 * float(np.max(np.abs(v), initial=0.0)):
            continue  # constant to rounding
        row = (v - v.mean()) / spread
        if all(abs(float(row @ other)) / v.size < SAME_VARIABLE for other in rows):
            chosen.append(signal)
            rows.append(row)
        if len(chosen) == most:
            break
    return tuple(chosen)


def _in_places(series: ErrorSeries, level: float, seed: int) -> list[Finding]:
    seen = np.isfinite(series.error)
    squares = np.where(seen, series.error, 0.0) ** 2
    places = [p for p in _places(series, seen) if SMALLEST_PART <= p.inside[seen].mean() <= 1 - SMALLEST_PART]
    if not places or not squares.any():
        return []
    squares = squares[seen] / squares.sum()
    inside = np.array([place.inside[seen] for place in places], dtype=float)
    shares, expected = inside @ squares, inside.mean(axis=1)
    drawn = _permuted_shares(squares, inside, seed)
    std = drawn.std(axis=0)
    std = np.where(std > 0.0, std, np.inf)
    scores, largest = (shares - expected) / std, ((drawn - expected) / std).max(axis=1)
    p_values = (1 + (largest[:, None] >= scores).sum(axis=0)) / (1 + PERMUTATIONS)
    telling = (
        (p_values <= level) & (shares >= GATES.min_told_excess * expected) & (shares >= GATES.min_told_share)
    )
    order = sorted(np.flatnonzero(telling), key=lambda i: -_divergence(shares[i], expected[i]))
    kept: list[int] = []
    for i in order:
        others = [
            k
            for k in kept
            if _same_subject(places[i], places[k]) or _overlap(inside[i], inside[k]) > GATES.same_region
        ]
        if len(kept) < MOST_PER_OUTPUT and not others:
            kept.append(int(i))
    return [
        _finding(series, places[i], float(shares[i]), float(expected[i]), float(p_values[i])) for i in kept
    ]


def _permuted_shares(squares: np.ndarray, inside: np.ndarray, seed: int) -> np.ndarray:
    """Share of every place (PERMUTATIONS, n_places) for blocks of the squared error in random order."""
    rng = np.random.default_rng(seed)
    n, length = squares.size, _block_length(squares)
    starts, within = np.arange(0, n, length), np.arange(length)
    twice = np.concatenate([squares, squares])  # from n - k on: turned by k
    drawn = np.empty((PERMUTATIONS, len(inside)))
    for first in range(0, PERMUTATIONS, ROWS_AT_ONCE):
        count = min(ROWS_AT_ONCE, PERMUTATIONS - first)
        pairs = [(rng.integers(n), rng.permutation(starts)) for _ in range(count)]
        order = (np.array([blocks for _, blocks in pairs])[:, :, None] + within).reshape(count, -1)
        if order.shape[1] > n:  # the last block is shorter
            order = order[order < n].reshape(count, n)
        order += n - np.array([turn for turn, _ in pairs])[:, None]
        drawn[first : first + count] = twice[order] @ inside.T
    return drawn


def _block_length(squares: np.ndarray) -> int:
    """CORRELATION_TIMES integrated correlation times (positive sequence), at most n / BLOCKS."""
    n = squares.size
    centred = squares - squares.mean()
    spectrum = np.abs(np.fft.rfft(centred, 2 * n)) ** 2
    correlation = np.fft.irfft(spectrum)[: n // BLOCKS + 1]
    correlation = correlation / correlation[0] if correlation[0] > 0.0 else correlation
    # White squares have correlations within 2 / sqrt(n); the first one below ends the sum.
    ends = np.flatnonzero(correlation < 2.0 / np.sqrt(n))
    stop = int(ends[0]) if ends.size else correlation.size
    time = 1.0 + 2.0 * float(np.sum(correlation[1:stop]))
    return int(np.clip(np.ceil(CORRELATION_TIMES * time), 1, max(n // BLOCKS, 1)))


def _places(series: ErrorSeries, seen: np.ndarray) -> Iterator[Place]:
    for signal in distinct(series.signals):
        yield from _regions(signal, seen)
    for number, name in enumerate(series.record_names):
        rows = series.record == number
        start, stop = series.time[rows][0], series.time[rows][-1]
        for parts in WINDOWS:
            edges = np.linspace(start, stop, parts + 1)
            for low, high in pairwise(edges):
                inside = rows & (series.time >= low) & (series.time <= high)
                yield Place("time", "time", "s", float(low), float(high), inside, name)


def _regions(signal: Signal, seen: np.ndarray) -> Iterator[Place]:
    """Low and high values; for signals that change sign also small and large absolute values."""
    v, unit = signal.values, signal.unit
    changes_sign = np.quantile(v[seen], 0.1) < 0.0 < np.quantile(v[seen], 0.9)
    for share in SHARES:
        low, high = (_rounded(float(np.quantile(v[seen], q))) for q in (share, 1.0 - share))
        yield Place("region", signal.name, unit, None, low, v < low)
        yield Place("region", signal.name, unit, high, None, v > high)
        if changes_sign:
            size = np.abs(v)
            small, large = (_rounded(float(np.quantile(size[seen], q))) for q in (share, 1.0 - share))
            yield Place("region", signal.name, unit, -small, small, size < small)
            yield Place("region", f"abs({signal.name})", unit, large, None, size > large)
    if changes_sign:
        yield Place("region", signal.name, unit, None, 0.0, v < 0.0)
        yield Place("region", signal.name, unit, 0.0, None, v > 0.0)


def _in_bands(series: ErrorSeries, level: float) -> list[Finding]:
    """The octave, or everything below one, that holds more of the one-step error than white noise would.
    Simulation errors are never white."""
    if series.kind == "simulation":
        return []
    power, frequency = _spectrum(series)
    if not power.size or not power.any():
        return []
    top = float(frequency[-1])
    edges = [0.0, *(top / 2.0**i for i in range(OCTAVES, -1, -1))]
    bands = [*pairwise(edges), *((0.0, high) for high in edges[2:-1])]
    tested = []
    for low, high in bands:
        inside = (frequency > low) & (frequency <= high)
        m, rest = int(inside.sum()), int((~inside).sum())
        if m and rest:
            share = float(power[inside].sum() / power.sum())
            p_value = min(float(beta.sf(share, m, rest)) * len(bands), 1.0)
            tested.append((low, high, share, m / power.size, p_value))
    telling = [
        t for t in tested if t[4] <= level and t[2] >= max(GATES.min_told_excess * t[3], GATES.min_told_share)
    ]
    telling.sort(key=lambda t: -_divergence(t[2], t[3]))
    return [_band_finding(series, *t) for t in telling[:1]]


def _spectrum(series: ErrorSeries) -> tuple[np.ndarray, np.ndarray]:
    """Periodogram ordinates of all recordings with the period of the first, and their frequencies [Hz]."""
    powers, frequencies, period = [], [], None
    for number in range(len(series.record_names)):
        rows = series.record == number
        error, steps = series.error[rows], np.diff(series.time[rows])
        seen = np.isfinite(error)
        if steps.size < 2 or seen.sum() < 8:
            continue
        own = float(np.median(steps))
        period = own if period is None else period
        if abs(own - period) > 1e-3 * period:
            continue  # another Nyquist frequency
        centred = np.where(seen, error - error[seen].mean(), 0.0)
        # The first ordinate holds the mean, the last of an even number is no pair.
        inner = slice(1, (error.size + 1) // 2)
        powers.append(np.abs(np.fft.rfft(centred)[inner]) ** 2 / seen.sum())
        frequencies.append(np.fft.rfftfreq(error.size, period)[inner])
    if not powers:
        return np.zeros(0), np.zeros(0)
    order = np.argsort(np.concatenate(frequencies), kind="stable")
    return np.concatenate(powers)[order], np.concatenate(frequencies)[order]


def _finding(series: ErrorSeries, place: Place, share: float, expected: float, p_value: float) -> Finding:
    finding = Finding(
        output=series.output,
        kind=place.kind,
        error=series.kind,
        variable=place.variable,
        unit=place.unit,
        low=place.low,
        high=place.high,
        share=share,
        expected=expected,
        p_value=p_value,
        text="",
        experiment=place.experiment,
    )
    condition = _condition(place)
    if place.kind == "time":
        several = f" of {place.experiment}" if len(series.record_names) > 1 else ""
        condition = f"from {_number(place.low)} to {_number(place.high)} s{several}"
    subject = f"{_percent(share)} % of the {series.kind} error of {series.output}"
    return replace(finding, text=f"{subject} {condition} ({_percent(expected)} % of the time)")


def _band_finding(
    series: ErrorSeries, low: float, high: float, share: float, expected: float, p_value: float
) -> Finding:
    subject = f"{_percent(share)} % of the {series.kind} error of {series.output}"
    return Finding(
        output=series.output,
        kind="frequency",
        error=series.kind,
        variable="frequency",
        unit="Hz",
        low=low or None,
        high=high,
        share=share,
        expected=expected,
        p_value=p_value,
        text=f"{subject} {_band(low, high)} ({_percent(expected)} % if it were white)",
    )


def _band(low: float, high: float) -> str:
    """A band in words; slow ones by their periods."""
    if high < SLOW:
        shortest = spoken_duration(1.0 / high)
        return (
            f"at periods above {shortest}"
            if low == 0.0
            else f"at periods of {shortest} to {spoken_duration(1.0 / low)}"
        )
    return f"below {_number(high)} Hz" if low == 0.0 else f"between {_number(low)} and {_number(high)} Hz"


def _condition(place: Place) -> str:
    unit = f" {place.unit}" if place.unit and place.unit != "1" else ""
    if place.low is None:
        return f"while {place.variable} < {_number(place.high)}{unit}"
    if place.high is None:
        name = f"|{place.variable[4:-1]}|" if place.variable.startswith("abs(") else place.variable
        return f"while {name} > {_number(place.low)}{unit}"
    return f"while |{place.variable}| < {_number(place.high)}{unit}"


def _surprise(finding: Finding) -> float:
    return _divergence(finding.share, finding.expected)


def _divergence(share: float, expected: float) -> float:
    """Kullback-Leibler divergence of (share, rest) from (expected, rest): how much the place tells."""
    share = min(max(share, 1e-12), 1.0 - 1e-12)  # 0 log 0 = 0
    return float(share * np.log(share / expected) + (1 - share) * np.log((1 - share) / (1 - expected)))


def _same_subject(a: Place, b: Place) -> bool:
    return a.variable.removeprefix("abs(").removesuffix(")") == b.variable.removeprefix("abs(").removesuffix(
        ")"
    )


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sum(a * b) / np.sum(np.maximum(a, b)))


def _rounded(value: float) -> float:
    """Two significant digits, so that a reader can use the number."""
    return float(f"{value:.2g}")


def _number(value: float | None) -> str:
    return f"{value:.3g}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g}" if share < 0.995 else f"{100.0 * share:.4g}"
