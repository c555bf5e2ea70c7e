"""Groups of rows of the inverse of a pencil, against its coefficients by values."""

import numpy as np
import pytest
import scipy.sparse as sp

from daest.numerics.laurent import expand_at_infinity, inverse_columns
from daest.numerics.proportional import proportional_rows
from daest.numerics.sparse_columns import column_entries, column_norms, product, ungrouped


def constrained(seed: int, n_bodies: int = 6) -> tuple[sp.csr_array, sp.csr_array]:
    """Bodies x' = v, v' = f - g, coupled rigidly by forces with copies, x_i = r x_(i+1); all shuffled."""
    rng = np.random.default_rng(seed)
    E, J, m = [], [], 0
    n = 4 * n_bodies + (n_bodies - 1)
    for i in range(n_bodies):
        x, v, f, g = 4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3
        E += [(m, x, 1.0), (m + 1, v, rng.uniform(0.5, 2.0))]
        J += [(m, v, 1.0), (m + 1, f, 1.0), (m + 1, g, -1.0)]
        m += 2
        if i == 0:
            J += [(m, f, 1.0)]  # nothing pulls the first
            m += 1
        if i == n_bodies - 1:
            J += [(m, g, 1.0), (m, x, rng.uniform(1.0, 3.0))]  # the last one is on a spring
            m += 1
        else:
            copy = 4 * n_bodies + i
            ratio = rng.uniform(0.5, 2.0)
            J += [(m, x, 1.0), (m, x + 4, -ratio)]
            J += [(m + 1, g, 1.0), (m + 1, copy, -1.0), (m + 2, copy, 1.0), (m + 2, f + 4, -1.0 / ratio)]
            m += 3
    rows, columns = rng.permutation(n), rng.permutation(n)

    def matrix(entries):
        i, j, value = (np.array(part) for part in zip(*entries, strict=True))
        return sp.csr_array((value, (rows[i.astype(int)], columns[j.astype(int)])), shape=(n, n))

    return matrix(E), matrix(J)


@pytest.mark.parametrize("seed", range(8))
def test_rows_are_the_multiples_that_are_told(seed):
    E, J = constrained(seed)
    expansion = expand_at_infinity(E, J)
    found = inverse_columns(expansion, np.arange(E.shape[0]), [1, 2])
    told = proportional_rows(E, J)
    assert told.representatives.size < 0.75 * E.shape[0]
    assert np.all(np.abs(told.factor) <= 1.0)
    by_column = proportional_rows(sp.csr_array(E.T), sp.csr_array(J.T))
    for m in (1, 2):
        exact = found[m].toarray()
        assert np.abs(exact).max() > 0.1
        rebuilt = told.factor[:, None] * np.vstack([exact[told.representatives], 0 * exact[:1]])[told.group]
        np.testing.assert_allclose(rebuilt, exact, atol=1e-12 * np.abs(exact).max())
        columns = np.hstack([exact[:, by_column.representatives], 0 * exact[:, :1]])
        np.testing.assert_allclose(columns[:, by_column.group] * by_column.factor, exact, atol=1e-12)
        some = inverse_columns(expansion, np.arange(E.shape[0]), [m], told.representatives)[m]
        np.testing.assert_array_equal(some.toarray(), exact[told.representatives])


def test_a_derivative_of_a_constant_tells_nothing():
    """x = w1, y - x' = w2: y contains w1', although one equation determines x alone."""
    E, J = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[1.0, 0.0], [0.0, 1.0]])
    told = proportional_rows(sp.csr_array(E), sp.csr_array(J))
    assert told.group.tolist() == [-1, 0] and told.factor.tolist() == [0.0, 1.0]


def test_products_with_groups():
    rng = np.random.default_rng(2)
    dense = rng.standard_normal((5, 5)) * (rng.random((5, 5)) < 0.6)
    plain = ungrouped(sp.csc_array(dense))
    group, factor = np.array([1, -1, 0, 1, 4]), np.array([2.0, 0.0, 1.0, -0.5, 3.0])
    grouped = type(plain)(plain.core, group, factor, group[::-1], factor[::-1])
    whole = factor[:, None] * dense[group][:, group[::-1]] * factor[::-1]
    left, right, b = rng.uniform(0.1, 9.0, 5), rng.uniform(0.1, 9.0, 5), rng.standard_normal(5)
    for matrix, exact in ((plain, dense), (grouped, whole)):
        np.testing.assert_allclose(product(matrix, b), exact @ b, atol=1e-14)
        rows, values = column_entries(matrix, 2)
        np.testing.assert_array_equal(values, exact[rows, 2])
        assert set(np.flatnonzero(exact[:, 2])) <= set(rows.tolist())
        norms = np.linalg.norm(left[:, None] * exact * right, axis=0)
        np.testing.assert_allclose(column_norms(matrix, left, right), norms, rtol=1e-14)


def test_places_in_large_matrices_beyond_32_bits():
    """x' = -x with 50 000 names for x: places in an n x n matrix exceed the 32 bits of indices."""
    n = 50_000
    E = sp.csr_array(sp.diags_array(np.append(np.zeros(n - 1), 1.0)))
    J = sp.csr_array(sp.diags_array([np.append(np.ones(n - 1), -1.0), -np.ones(n - 1)], offsets=[0, 1]))
    for matrix in (E, J):
        matrix.indices, matrix.indptr = matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    found = proportional_rows(E, J)
    assert not found.group.any()
    assert np.array_equal(found.factor, np.ones(n))
    assert found.representatives.size == 1
