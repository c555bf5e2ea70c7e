"""Diagonal entries of sparse inverses against dense ones."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from daest.numerics import selected_inverse
from daest.numerics.selected_inverse import inverse_diagonal


@pytest.mark.parametrize("seed", range(20))
def test_diagonals_of_inverses(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    matrix = sp.csc_array(sp.random_array((n, n), density=0.08, rng=rng) + sp.eye_array(n))
    factors = spla.splu(matrix)
    found = inverse_diagonal(matrix, factors, np.arange(n))
    np.testing.assert_allclose(found, np.diag(np.linalg.inv(matrix.toarray())), rtol=1e-9, atol=1e-9)


def test_entries_that_cancel_are_filled_in():
    """Ones and minus ones: many entries of the factors are zero by their values alone."""
    M = sp.csc_array(np.array([[1.0, 0, -1], [1, 1, 0], [0, 1, 1], [1, 0, 1]]))
    matrix = sp.csc_array(sp.block_array([[sp.eye_array(4), M], [M.T, None]]))
    found = inverse_diagonal(matrix, spla.splu(matrix), np.arange(4))
    np.testing.assert_allclose(found, np.diag(np.linalg.inv(matrix.toarray()))[:4], atol=1e-14)


def test_nothing_is_told_of_factors_that_are_too_large(monkeypatch):
    monkeypatch.setattr(selected_inverse, "MOST_ENTRIES", 3)
    matrix = sp.csc_array(np.eye(5) + 0.1)
    assert inverse_diagonal(matrix, spla.splu(matrix), np.arange(5)) is None
