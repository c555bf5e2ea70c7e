"""Matrices with a border against dense linear algebra."""

import numpy as np
import pytest

from daest.numerics.bordered import bordered


def banded(rng, n, width, n_border):
    """Positive definite, of a band with a border in scattered places."""
    root = np.tril(rng.normal(size=(n, n))) * (np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= width)
    root[-n_border or n :] = rng.normal(size=(n_border, n))
    matrix = root @ root.T + 0.1 * np.eye(n)
    order = np.concatenate([np.arange(n - n_border, n), np.arange(n - n_border)])
    return matrix[np.ix_(order, order)]


@pytest.mark.parametrize("width, n_border", [(0, 0), (3, 0), (3, 4), (29, 0)])
def test_solution_is_that_of_the_dense_matrix(width, n_border):
    rng = np.random.default_rng(3)
    matrix, b = banded(rng, 30, width, n_border), rng.normal(size=30)
    parts = bordered(matrix)
    assert parts.border.size == (n_border if width < 15 else 30)
    assert parts.band.shape[0] == (width + 1 if width < 15 else 1)
    assert np.allclose(parts.factor(0.5)(b), np.linalg.solve(matrix + 0.5 * np.eye(30), b), rtol=1e-10)


@pytest.mark.parametrize("place", [0, 20])
def test_indefinite_matrix_has_no_factor(place):
    matrix = banded(np.random.default_rng(3), 30, 3, 4)
    matrix[place, place] = -1.0
    with pytest.raises(np.linalg.LinAlgError):
        bordered(matrix).factor(1e-3)
