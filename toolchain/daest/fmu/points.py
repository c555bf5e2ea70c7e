"""Points to linearise at, and differences between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

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


class Movable(Protocol):
    """A thing whose variables can be read and set by value reference."""

    def get(self, references: Sequence[int]) -> np.ndarray: ...

    def set(self, references: Sequence[int], values: Sequence[float] | np.ndarray) -> None: ...


def probe_point(size: int, seed: int) -> np.ndarray:
    """A fixed point without symmetry, entries between 0.5 and 1.5."""
    return 0.5 + np.random.default_rng(seed).random(size)


def point_value(given: dict[str, float], name: str, start: float | None) -> float:
    """The value of `name` in an operating point, taken out of `given`; else its start, else zero."""
    return float(given.pop(name, start if start is not None else 0.0))


def difference(these: Sequence[np.ndarray], those: Sequence[np.ndarray], floor: float = 0.0) -> float:
    """Largest difference between two lists of matrices, relative to the largest entry in the same row.

    Rows have their own units (volt here, newton there), so a difference counts against its own row only; but
    no row counts as smaller than `floor` times the largest entry of its matrix, because a row that is zero in
    truth is nothing but rounding in finite differences.
    """
    largest = 0.0
    for a, b in zip(these, those, strict=True):
        if a.size == 0:
            continue
        a, b = np.atleast_2d(a), np.atleast_2d(b)
        sizes = np.maximum(np.abs(a), np.abs(b))
        scale = np.maximum(sizes.max(axis=1, keepdims=True), floor * sizes.max())
        scale[scale == 0.0] = 1.0
        largest = max(largest, float((np.abs(a - b) / scale).max()))
    return largest


def central_differences(
    rows: Callable[[], np.ndarray], unit: Movable, known: int, nominal: float | None
) -> np.ndarray:
    """∂rows/∂known by central differences with a step relative to the value and its nominal size."""
    value = float(unit.get([known])[0])
    step = STEP * max(abs(value), abs(nominal or 1.0))
    sides = []
    for side in (value + step, value - step):
        unit.set([known], [side])
        sides.append(rows())
    unit.set([known], [value])
    return (sides[0] - sides[1]) / ((value + step) - (value - step))
