"""Points to linearise at, and differences between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Matrices of an affine model agree at two points up to rounding in the model's own arithmetic; those of a
# nonlinear one differ by far more.
AFFINE_TOLERANCE = 1e-10
# A central difference of an affine model is exact up to rounding over the step; two of them agree to this.
DIFFERENCE_NOISE = 1e-7
# Where differences are compared, entries this much smaller than the largest of all are rounding.
DIFFERENCE_FLOOR = 1e-6
# Central differences are best near the cube root of the machine precision.
STEP = float(np.finfo(float).eps ** (1 / 3))


def probe_point(size: int, seed: int) -> np.ndarray:
    """A fixed point without symmetry, entries between 0.5 and 1.5. Shapes: (size,)."""
    return 0.5 + np.random.default_rng(seed).random(size)


def point_value(given: dict[str, float], name: str, start: float | None) -> float:
    """The value of `name` in an operating point, taken out of `given`; else its start, else zero."""
    return float(given.pop(name, start if start is not None else 0.0))


def difference(these: Sequence[np.ndarray], those: Sequence[np.ndarray], floor: float = 0.0) -> float:
    """Largest difference between two lists of matrices, relative to the largest entry in the same row.

    Rows have their own units (volt here, newton there), so a difference counts against its own row only; but
    no row counts as smaller than `floor` times the largest entry of its matrix, because a row that is zero in
    truth is nothing but rounding in finite differences. NaN where any entry is. Matrices have the same shape
    in both.
    """
    largest = 0.0
    for a, b in zip(these, those, strict=True):
        if a.size == 0:
            continue
        a, b = np.atleast_2d(a), np.atleast_2d(b)
        sizes = np.maximum(np.abs(a), np.abs(b))
        scale = np.maximum(sizes.max(axis=1, keepdims=True), floor * sizes.max())
        scale[scale == 0.0] = 1.0
        largest = float(np.maximum(largest, (np.abs(a - b) / scale).max()))
    return largest


def moved_points(point: np.ndarray, nominal: Sequence[float | None]) -> np.ndarray:
    """Points for central differences at `point` (k,), shape (2 k, k): entry i moved up in row 2 i and down in
    row 2 i + 1, by a step relative to the value and its nominal size."""
    rows = np.repeat(point[None, :], 2 * point.size, axis=0)
    for i, size in enumerate(nominal):
        step = STEP * max(abs(point[i]), abs(size or 1.0))
        rows[2 * i, i] += step
        rows[2 * i + 1, i] -= step
    return rows


def long_points(point: np.ndarray, nominal: Sequence[float | None]) -> np.ndarray:
    """As `moved_points`, by steps of nominal size: exact for an affine model, and with the fewest digits
    lost. Shapes: point (n,); rows (2 n, n)."""
    rows = np.repeat(point[None, :], 2 * point.size, axis=0)
    for i, size in enumerate(nominal):
        rows[2 * i, i] += abs(size or 1.0)
        rows[2 * i + 1, i] -= abs(size or 1.0)
    return rows


def central_differences(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """∂values/∂point (n, k) from the values (2 k, n) at the points of `moved_points`."""
    k = points.shape[1]
    columns = [
        (values[2 * i] - values[2 * i + 1]) / (points[2 * i, i] - points[2 * i + 1, i]) for i in range(k)
    ]
    return np.array(columns).reshape(k, values.shape[1]).T
