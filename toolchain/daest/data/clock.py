"""Faults of time stamps: duplicated ones, steps back, gaps, jumps, jitter."""

from __future__ import annotations

import numpy as np

from daest.model.quality import Finding

# In units of the median step: one beyond JUMP is a pause or two recordings; a shorter one lost samples if it
# is a multiple of the median to WHOLE.
JUMP = 20.0
WHOLE = 0.2
# Spread of the steps (half the distance of their 5 % and 95 % quantiles), in units of their median, above
# which a clock is uneven and tells neither gaps nor a change of its rate.
JITTER = 0.03
# Relative difference of the sampling periods of the two halves that is said.
DRIFT = 0.02
_FEWEST = 8  # steps


def clock_findings(time: np.ndarray) -> list[Finding]:
    """What is wrong with the times (n_samples,) in s, NaN where a row has none."""
    known = time[np.isfinite(time)]
    found = _missing(time, known)
    steps = np.diff(known)
    found += _order(known, steps)
    forward = steps > 0
    if forward.sum() < _FEWEST:
        return found
    step = float(np.median(steps[forward]))
    spread = unevenness(known)
    found += _long_steps(known, steps, step, spread)
    if spread > JITTER:
        low, high = np.quantile(steps[forward], [0.01, 0.99])
        text = f"ticks unevenly: steps of {low:.4g} s to {high:.4g} s, median {step:.4g} s"
        found.append(Finding("check-clock-jitter", "note", None, text))
    else:
        found += _rate(known, steps)
    return found


def unevenness(time: np.ndarray) -> float:
    """Spread of the steps of increasing times (n_samples,), relative to their median: that of the more uneven
    half, because a clock that changes its rate once is even before and after."""
    steps = np.diff(time)
    halves = (half[half > 0] for half in np.array_split(steps, 2))
    quantiles = [np.quantile(half, [0.05, 0.5, 0.95]) for half in halves if half.size]
    return max((float(0.5 * (high - low) / step) for low, step, high in quantiles), default=0.0)


def _missing(time: np.ndarray, known: np.ndarray) -> list[Finding]:
    n = time.size - known.size
    return [Finding("check-clock-order", "warning", None, f"is missing in {n} row(s)", count=n)] if n else []


def _order(time: np.ndarray, steps: np.ndarray) -> list[Finding]:
    found = []
    for code, which, text in (
        ("check-clock-duplicate", steps == 0, "stands still in {} row(s): two samples have one time"),
        ("check-clock-order", steps < 0, "goes back {} time(s)"),
    ):
        rows = np.nonzero(which)[0]
        if rows.size:
            at = float(time[rows[0] + 1])
            found.append(Finding(code, "warning", None, text.format(rows.size), at, int(rows.size)))
    return found


def _long_steps(time: np.ndarray, steps: np.ndarray, step: float, spread: float) -> list[Finding]:
    jumps = np.nonzero(steps > JUMP * step)[0]
    found = []
    if jumps.size:
        text = f"jumps by {steps[jumps].max():.4g} s where a step is {step:.4g} s: a pause, or two recordings"
        found.append(
            Finding("check-clock-jump", "warning", None, text, float(time[jumps[0]]), int(jumps.size))
        )
    long = np.flatnonzero((steps >= 1.5 * step) & (steps <= JUMP * step))
    ratio = steps[long] / step
    whole = np.round(ratio)
    is_gap = (whole >= 2) & (np.abs(ratio - whole) < WHOLE)
    gaps = long[is_gap]
    if gaps.size and spread < JITTER:
        lost = int(np.sum(whole[is_gap] - 1))
        text = (
            f"leaves out about {lost} sample(s) in {gaps.size} gap(s), the longest {steps[gaps].max():.4g} s"
        )
        found.append(Finding("check-clock-gap", "warning", None, text, float(time[gaps[0]]), int(gaps.size)))
    return found


def _rate(time: np.ndarray, steps: np.ndarray) -> list[Finding]:
    middle = steps.size // 2
    first, second = (float(np.median(half[half > 0])) for half in (steps[:middle], steps[middle:]))
    if abs(first - second) <= DRIFT * min(first, second):
        return []
    text = f"changes its rate: a step is {first:.4g} s in the first half and {second:.4g} s in the second"
    return [Finding("check-clock-rate", "warning", None, text, float(time[middle]))]
