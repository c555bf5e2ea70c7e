"""Whether, and by how much, a recorded signal varies."""

from __future__ import annotations

from collections.abc import Iterable

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
