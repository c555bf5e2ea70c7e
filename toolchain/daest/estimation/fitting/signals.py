"""Whether, and by how much, a recorded signal varies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from daest.estimation.gates import FIT


def is_constant(signal: np.ndarray) -> bool:
    """Whether a signal (n_samples,) has one value, but for rounding."""
    return float(np.ptp(signal)) <= FIT.constant_input * float(np.max(np.abs(signal), initial=0.0))


def fit_percent(measured: Iterable[np.ndarray], squared_error: float) -> float | None:
    """100 (1 - |error| / |measured - mean|) of an output from the sum of its squared errors: `measured` has
    its values in every recording, each (n_samples,) with a mean of its own, NaN where there is none. None
    where nothing varies."""
    recorded = [signal[np.isfinite(signal)] for signal in measured]
    squares = [float(np.sum((y - y.mean()) ** 2)) for y in recorded if y.size and not is_constant(y)]
    spread = sum(squares)
    fit = 100.0 * (1.0 - float(np.sqrt(squared_error / spread))) if spread > 0.0 else np.nan
    return fit if np.isfinite(fit) else None


def still_share(values: np.ndarray) -> float:
    """Of the measured values (n,), those that are exactly the one before."""
    known = values[np.isfinite(values)]
    return float(np.mean(np.diff(known) == 0.0)) if known.size > 1 else 0.0


def white_variance(courses: Iterable[np.ndarray]) -> float:
    """Variance of the part of errors that has no memory, from their courses (n,), NaN where there is none: a
    sixth of the mean square of second differences, in which what is smooth hardly shows. NaN where no course
    has three errors."""
    second = [np.diff(course[np.isfinite(course)], 2) for course in courses]
    together = np.concatenate(second) if second else np.zeros(0)
    return float(np.mean(together**2)) / 6.0 if together.size else np.nan


def white_part(measured: Sequence[np.ndarray], errors: Iterable[np.ndarray]) -> float | None:
    """Standard deviation of the part of the `errors` (n,) of each record that has no memory. None where it is
    not known: too few of them, or an output that stands still between the steps of its sensor, whose errors
    last as it does. `measured`: the output (n,) itself."""
    if not measured or max(still_share(y) for y in measured) >= FIT.max_still:
        return None
    variance = white_variance(errors)
    return float(np.sqrt(variance)) if np.isfinite(variance) else None
