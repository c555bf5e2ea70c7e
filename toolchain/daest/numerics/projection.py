"""Pull a state onto invariants g(x) = 0: Gauss-Newton steps that are shortest in the sizes of the states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

MOST_STEPS = 8


@dataclass(frozen=True)
class Pulled:
    """The state (n,) on the invariants, with `slopes` R = ∂g/∂x (m, n) and `gain` K = W Rᵀ (R W Rᵀ)⁻¹ (n, m)
    there, W the squared sizes of the states. Small changes are projected by I - K R."""

    x: np.ndarray
    gain: np.ndarray
    slopes: np.ndarray

    @property
    def along(self) -> np.ndarray:
        """I - K R (n, n)."""
        return np.eye(self.x.size) - self.gain @ self.slopes


def pull(
    invariants: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    x: np.ndarray,
    scale: np.ndarray,
    tolerance: float,
) -> Pulled:
    """Steps from x until one is below `tolerance` times `scale` (n,); `invariants` gives g (m,) and R (m, n).

    Raises numpy.linalg.LinAlgError where the invariants depend on each other."""
    weight = scale**2
    for _ in range(MOST_STEPS):
        g, R = invariants(x)
        gain = np.linalg.solve(R * weight @ R.T, R * weight).T
        step = gain @ g
        x = x - step
        if np.max(np.abs(step) / scale) < tolerance:
            break
    return Pulled(x, gain, R)
