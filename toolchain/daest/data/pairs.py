"""What two columns say about each other: the same quantity, or a motion and its rate, late or upside down.

Machines lag and turn things round, too, so that what is found here are notes, not warnings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from daest.errors import DataError
from daest.model.quality import Finding
from daest.quantities import conversion

# Two columns tell the same where one explains this share of the other at the best lag.
SAME = 0.98
# A lag is said where it leaves less than this share of what is unexplained without it.
BETTER = 0.25
LONGEST_LAG = 0.1  # share of the recording
MOST_COLUMNS = 16
# A column is computed from another one where this share of its standard deviation is left: two sensors of one
# quantity leave their noise, files leave the rounding of their digits.
COMPUTED = 1e-4
FEWEST = 50  # samples
ENOUGH = 20_000  # samples that tell whether a column is computed
LONGEST = 200_000  # samples


@dataclass(frozen=True)
class Series:
    """Values (n,) without gaps on a uniform grid of times, and their unit."""

    name: str
    unit: str
    values: np.ndarray


def pair_findings(series: Sequence[Series], period: float) -> list[Finding]:
    """Lags and opposite signs between the columns, sampled every `period` s, and columns that are computed
    from others."""
    shown = [s for s in series if s.values.size <= LONGEST and np.ptp(s.values) > 0][:MOST_COLUMNS]
    found = [finding for a, b in combinations(shown, 2) for finding in _computed(a, b, period)]
    for a, b in combinations([s for s in shown if s.unit], 2):
        if _converts(a.unit, b.unit):
            found += _compared(a, b, _centred(a.values), _centred(b.values), "", period)
        elif _converts(f"({a.unit})/s", b.unit):
            found += _compared(a, b, *_with_integral(a, b), "the rate of ", period)
        elif _converts(f"({b.unit})/s", a.unit):
            found += _compared(b, a, *_with_integral(b, a), "the rate of ", period)
    return found


def _computed(a: Series, b: Series, period: float) -> list[Finding]:
    """A column that holds nothing new beside another one: the same values, scaled or late, or the difference
    quotients of them."""
    a, b = replace(a, values=a.values[:ENOUGH]), replace(b, values=b.values[:ENOUGH])
    if min(np.unique(a.values).size, np.unique(b.values).size) < FEWEST:
        return []  # a switch or a constant
    for early, late in ((a, b), (b, a)):
        if _is_difference(early.values, late.values):
            return [_nothing_new(late, f"is the difference quotient of {early.name}, computed")]
    x, y = _centred(a.values), _centred(b.values)
    lags, correlation = _correlation(x, y)
    lag = int(lags[np.argmax(np.abs(correlation))])
    n = x.size - abs(lag)
    if n < FEWEST or _left(x[max(-lag, 0) :][:n], y[max(lag, 0) :][:n]) > COMPUTED:
        return []
    late, early = (b, a) if lag >= 0 else (a, b)
    after = f", {abs(lag) * period:.4g} s late" if lag else ""
    return [_nothing_new(late, f"is a copy of {early.name}{after}")]


def _nothing_new(column: Series, what: str) -> Finding:
    text = f"{what}: it holds nothing new; as two outputs they would be counted twice"
    return Finding("check-computed", "note", column.name, text)


def _is_difference(motion: np.ndarray, rate: np.ndarray) -> bool:
    """Whether the rate is the difference of the motion: forward, backward, or over two steps."""
    steps = np.diff(motion)
    pairs = ((steps, rate[:-1]), (steps, rate[1:]), (motion[2:] - motion[:-2], rate[1:-1]))
    return steps.size > FEWEST and any(_left(x, y) < COMPUTED for x, y in pairs)


def _left(x: np.ndarray, y: np.ndarray) -> float:
    """Share of the standard deviation of y that a straight line of x leaves; 1 where one of them is
    constant."""
    x, y = _centred(x), _centred(y)
    sizes = np.linalg.norm(x), np.linalg.norm(y)
    if not min(sizes) > 0.0:
        return 1.0
    return float(np.linalg.norm(y / sizes[1] - x / sizes[0] * np.sign(x @ y)))


def _with_integral(motion: Series, rate: Series) -> tuple[np.ndarray, np.ndarray]:
    """The motion and the integral of the rate, both without their trend: an offset of the rate drifts."""
    integral = np.append(0.0, np.cumsum(0.5 * (rate.values[1:] + rate.values[:-1])))
    return _detrended(motion.values), _detrended(integral)


def _compared(a: Series, b: Series, x: np.ndarray, y: np.ndarray, how: str, period: float) -> list[Finding]:
    lags, correlation = _correlation(x, y)
    best = int(np.argmax(np.abs(correlation)))
    at_best, at_zero = float(correlation[best]), float(correlation[np.nonzero(lags == 0)[0][0]])
    found: list[Finding] = []
    if at_best**2 < SAME:
        return found
    if at_best < 0:
        text = f"is {how}{a.name} with the opposite sign"
        found.append(Finding("check-polarity", "note", b.name, text))
    if lags[best] != 0 and 1 - at_best**2 < BETTER * (1 - at_zero**2):
        late, early = (b, a) if lags[best] > 0 else (a, b)
        text = f"follows {early.name} by {abs(lags[best]) * period:.4g} s: the machine, or clocks that differ"
        found.append(Finding("check-lag", "note", late.name, text))
    return found


def _correlation(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lags (samples by which y is late) and the correlation at each."""
    from scipy.signal import correlate

    most = max(1, int(LONGEST_LAG * x.size))
    whole = correlate(y, x, method="fft") / (np.linalg.norm(x) * np.linalg.norm(y))
    middle = x.size - 1
    return np.arange(-most, most + 1), whole[middle - most : middle + most + 1]


def _centred(values: np.ndarray) -> np.ndarray:
    return values - values.mean()


def _detrended(values: np.ndarray) -> np.ndarray:
    from scipy.signal import detrend

    return np.asarray(detrend(values))


def _converts(given: str, wanted: str) -> bool:
    try:
        conversion(given, wanted)
    except DataError:
        return False
    return True
