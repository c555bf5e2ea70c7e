"""Long series drawn with fewer points, so that no peak is lost."""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def thinned(values: np.ndarray, most: int) -> np.ndarray:
    """Indices, increasing, of at most `most` samples of `values` (n,): first and last, and the smallest and
    the largest of every stretch of equal length. All of them where they are no more than that.

    A stretch without a finite value keeps its first sample, so that a gap stays a gap.
    """
    n = values.size
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, max((most - 2) // 2, 1) + 1).astype(int)
    chosen = {0, n - 1}
    for low, high in pairwise(edges.tolist()):
        part = values[low:high]
        if not np.isfinite(part).any():
            chosen.add(low)
            continue
        chosen |= {low + int(np.nanargmin(part)), low + int(np.nanargmax(part))}
    return np.array(sorted(chosen))
