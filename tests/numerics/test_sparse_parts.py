"""Parts of sparse matrices against dense indexing and plain search."""

import numpy as np
import pytest
import scipy.sparse as sp

from daest.numerics import sparse_parts
from daest.numerics.sparse_parts import reached, submatrix


def test_submatrices():
    rng = np.random.default_rng(0)
    dense = np.where(rng.random((7, 9)) < 0.4, rng.standard_normal((7, 9)), 0.0)
    rows, columns = np.array([4, 0, 6]), np.array([8, 1, 3])
    found = submatrix(sp.csr_array(dense), rows, columns)
    np.testing.assert_array_equal(found.toarray(), dense[rows][:, columns])
    assert submatrix(sp.csr_array(dense), rows[:0], columns).shape == (0, 3)


@pytest.mark.parametrize("steps", [1, 40])
def test_vertices_on_paths(steps, monkeypatch):
    """A path 0 -> 1 -> … -> 9 and a loop of two vertices, by rings and vertex by vertex."""
    monkeypatch.setattr(sparse_parts, "SHALLOW", steps)
    source, target = [*range(9), 10, 11], [*range(1, 10), 11, 10]
    graph = sp.csr_array((np.ones(11), (source, target)), shape=(13, 13))
    np.testing.assert_array_equal(reached(graph, np.array([6, 11])), [6, 7, 8, 9, 10, 11])
    np.testing.assert_array_equal(reached(graph, np.array([12])), [12])
