"""Spectra and correlations of errors, for figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

LAGS = 40  # of a drawn autocorrelation
BAND_99 = 2.576  # standard deviations to either side of a 99 % band
UNIFORM = 0.01  # relative deviation of a step from the median up to which a spectrum is drawn
SEGMENTS = 8  # half-overlapping parts of a recording over which a spectrum is averaged
LONGEST = 8192  # samples of such a part
LEAST = 64  # samples below which no spectrum is drawn


def autocorrelation(residuals: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Autocorrelation at lags 1 … `LAGS` over all recordings, each (n,), and half the width of its 99 % band
    if white."""
    known = [np.nan_to_num(r) for r in residuals]
    count = max(sum(int(np.isfinite(r).sum()) for r in residuals), 1)
    power = sum(float(r @ r) for r in known)
    lags = range(1, max(min(LAGS, count // 4), 1) + 1)
    values = [sum(float(r[lag:] @ r[:-lag]) for r in known) / power if power else 0.0 for lag in lags]
    return np.array(values), BAND_99 / float(np.sqrt(count))


def spectrum(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Frequencies [Hz] without 0 and the amplitude density [unit/√Hz] of `values` at `time` (n,), by Welch's
    method; missing samples are drawn through on straight lines. None for a recording that is short, uneven
    or empty."""
    steps = np.diff(time)
    known = np.isfinite(values)
    if values.size < LEAST or known.sum() < LEAST or np.ptp(steps) > UNIFORM * np.median(steps):
        return None
    from scipy.signal import welch

    whole = np.interp(time, time[known], values[known])
    length = min(max(LEAST, 2 * whole.size // (SEGMENTS + 1)), LONGEST)
    frequency, density = welch(whole, 1.0 / float(np.median(steps)), nperseg=length)
    return frequency[1:], np.sqrt(density[1:])
