"""Pivots by sparse elimination."""

import numpy as np
import scipy.sparse as sp

from daest.numerics.elimination import choose_pivots
from daest.numerics.sparse_basis import different_rows, independent_block

ZERO = 1e-12


def random_system(seed: int, n_rows: int, n_columns: int) -> sp.csr_array:
    rng = np.random.default_rng(seed)
    pattern = rng.random((n_rows, n_columns)) < 3.0 / n_columns
    pattern[np.arange(n_rows), rng.permutation(n_columns)[:n_rows]] = True
    return sp.csr_array(np.where(pattern, rng.choice([-1.0, 1.0, 0.5], (n_rows, n_columns)), 0.0))


def test_pivot_block_is_regular_and_rank_agrees_with_svd():
    for seed in range(30):
        matrix = random_system(seed, 25, 32)
        pivots = choose_pivots(matrix, np.arange(25), np.zeros(32, bool), ZERO)
        assert len(pivots.rows) == np.linalg.matrix_rank(matrix.toarray()), seed
        assert len(pivots.rows) + len(pivots.dependent_rows) == 25
        block = matrix.toarray()[np.ix_(pivots.rows, pivots.columns)]
        assert np.linalg.cond(block) < 1e6, seed


def test_dependent_rows_are_found():
    matrix = random_system(7, 12, 20).toarray()
    matrix[11] = matrix[2] - matrix[5]
    pivots = choose_pivots(sp.csr_array(matrix), np.arange(12), np.zeros(20, bool), ZERO)
    assert len(pivots.dependent_rows) == 12 - np.linalg.matrix_rank(matrix) == 1


def test_avoided_columns_come_last():
    matrix = sp.csr_array(np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]]))
    pivots = choose_pivots(matrix, np.arange(2), np.array([True, False, False]), ZERO)
    assert sorted(pivots.columns) == [1, 2]


def test_small_entries_are_no_pivots():
    matrix = sp.csr_array(np.array([[1e-3, 1.0]]))
    assert choose_pivots(matrix, np.arange(1), np.zeros(2, bool), ZERO).columns[0] == 1
    # Size is compared among the columns that need not be avoided, but not down to rounding errors.
    assert choose_pivots(matrix, np.arange(1), np.array([False, True]), ZERO).columns[0] == 0
    tiny = sp.csr_array(np.array([[1e-11, 1.0]]))
    assert choose_pivots(tiny, np.arange(1), np.array([False, True]), ZERO).columns[0] == 1


def test_a_rounding_error_does_not_stand_for_the_column_that_it_is_parallel_to():
    matrix = sp.csr_array(np.array([[1.0, 0.0, 0.0], [0.0, 5e-17, 1.0]]))
    first, group, factor = different_rows(sp.csr_array(matrix.T))
    assert first.tolist() == [0, 2] and group.tolist() == [0, 1, 1]
    np.testing.assert_allclose(factor, [1.0, 5e-17, 1.0])
    rows, columns = independent_block(matrix)
    assert sorted(rows) == [0, 1] and sorted(columns) == [0, 2]
