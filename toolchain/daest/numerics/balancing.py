"""Diagonal similarity that gives the rows and columns of a matrix like sizes, whatever their units."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack


def balanced(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T⁻¹ A T and the diagonal (n,) of T, powers of 2; x = T · balanced x.

    Nothing is permuted: LAPACK would set the rows of single eigenvalues aside, and then scale them by what
    suits the others, which may blow them up. `scipy.linalg.matrix_balance` reads the scales as permutations
    too, and warns of an invalid cast where units differ by more than 2^63. What is not finite stays as
    it is.
    """
    if not A.size or not np.all(np.isfinite(A)):
        return A, np.ones(A.shape[0])
    scaled, _, _, size, _ = lapack.dgebal(A, scale=1, permute=0)
    return scaled, size
