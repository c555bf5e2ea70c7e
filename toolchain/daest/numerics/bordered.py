"""Symmetric matrices of a band with a border: what belongs to one record or one segment meets its neighbours
alone, what belongs to all meets everything."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded


@dataclass(frozen=True)
class Bordered:
    """The lower `band` (width + 1, n_inner) of the coordinates `inner`, row d its d-th diagonal; their
    `sides` (n_inner, n_border) and the `corner` (n_border, n_border) of the `border`."""

    inner: np.ndarray
    border: np.ndarray
    band: np.ndarray
    sides: np.ndarray
    corner: np.ndarray

    def factor(self, damping: float) -> Callable[[np.ndarray], np.ndarray]:
        """What solves (matrix + damping I) x = b, of cost n_inner width² (Golub & Van Loan, Matrix
        Computations, section 4.3). Raises LinAlgError where that is not positive definite. Shapes of the
        result's argument and answer: (n,)."""
        band = self.band.copy()
        band[:1] += damping
        held = cholesky_banded(band, lower=True, check_finite=False) if self.inner.size else band
        pulled = self._inside(held, self.sides)
        left = self.corner + damping * np.eye(self.border.size) - self.sides.T @ pulled
        rest = cho_factor(left, lower=True) if self.border.size else None

        def solve(b: np.ndarray) -> np.ndarray:
            x = np.empty_like(b)
            if rest is not None:
                x[self.border] = cho_solve(rest, b[self.border] - pulled.T @ b[self.inner])
            x[self.inner] = self._inside(held, b[self.inner]) - pulled @ x[self.border]
            return x

        return solve

    def _inside(self, held: np.ndarray, b: np.ndarray) -> np.ndarray:
        return cho_solve_banded((held, True), b, check_finite=False) if b.size else b


def bordered(matrix: np.ndarray) -> Bordered:
    """A symmetric matrix, with the coordinates that meet more than half of the others as its border. Shapes:
    matrix (n, n)."""
    met = matrix != 0.0
    is_border = np.count_nonzero(met, axis=1) > matrix.shape[0] / 2
    inner, border = np.flatnonzero(~is_border), np.flatnonzero(is_border)
    core = matrix[np.ix_(inner, inner)]
    rows, columns = np.nonzero(met[np.ix_(inner, inner)])
    width = int(np.max(rows - columns, initial=0))
    band = np.zeros((width + 1, inner.size))
    for d in range(width + 1):
        band[d, : inner.size - d] = np.diagonal(core, -d)
    return Bordered(inner, border, band, matrix[np.ix_(inner, border)], matrix[np.ix_(border, border)])
