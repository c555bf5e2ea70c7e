"""Long series drawn with fewer points, so that no peak is lost."""

from __future__ import annotations

import numpy as np


def thinned(values: np.ndarray, most: int) -> np.ndarray:
    """Indices, increasing, of at most `most` samples of `values` (n,): first and last, and the smallest and
    the largest of every stretch of equal length. All of them where they are no more than that.

    A stretch without a finite value keeps its first sample, so that a gap stays a gap.
    """
    n = values.size
    if n <= most:
        return np.arange(n)
    length = -(-n // max((most - 2) // 2, 1))  # of a stretch; the last may be shorter
    padded = np.full((-(-n // length), length), np.nan)
    padded.flat[:n] = values
    finite = np.isfinite(padded)
    first = length * np.arange(len(padded))
    smallest = first + np.argmin(np.where(finite, padded, np.inf), axis=1)
    largest = first + np.argmax(np.where(finite, padded, -np.inf), axis=1)
    return np.unique(np.concatenate([[0, n - 1], smallest, largest]))
