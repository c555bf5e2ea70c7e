"""Columns of sparse matrices against dense algebra."""

import numpy as np
import scipy.sparse as sp

from daest.numerics.sparse_columns import compressed, largest_entries, scaled, scaled_norms


def matrix(seed=1):
    rng = np.random.default_rng(seed)
    dense = rng.standard_normal((7, 5)) * (rng.random((7, 5)) < 0.5)
    dense[:, [0, 3]] = 0.0  # the first and an inner column are empty
    return dense, rng.uniform(0.1, 9.0, 7), rng.uniform(0.1, 9.0, 5)


def test_columns_agree_with_dense_algebra():
    dense, left, right = matrix()
    found = compressed(np.asfortranarray(dense))
    assert found.nnz == np.count_nonzero(dense) and np.array_equal(found.toarray(), dense)
    product = left[:, None] * dense * right
    np.testing.assert_allclose(scaled(found, left, right).toarray(), product, rtol=1e-15)
    np.testing.assert_allclose(scaled_norms(found, left, right), np.linalg.norm(product, axis=0), rtol=1e-14)
    assert np.array_equal(largest_entries(found), np.abs(dense).max(axis=0))


def test_matrix_without_entries():
    assert not largest_entries(sp.csc_array((3, 2))).any() and compressed(np.zeros((3, 0))).shape == (3, 0)
