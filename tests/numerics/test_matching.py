"""Graphs of index reduction against SciPy's structural rank, brute force and the defining inequalities."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import structural_rank

from daest.numerics.matching import (
    block_triangular,
    canonical_offsets,
    find_defect,
    maximum_matching,
    tear,
)


def random_incidence(rng, n, density):
    return sp.csr_array(sp.random_array((n, n), density=density, rng=rng, format="csr"))


@pytest.mark.parametrize("seed", range(20))
def test_defect_is_found_exactly_when_the_structural_rank_is_deficient(seed):
    rng = np.random.default_rng(seed)
    incidence = random_incidence(rng, 12, 0.18)
    defect = find_defect(incidence)
    rank = structural_rank(sp.csr_matrix(incidence))
    assert (defect is None) == (rank == 12)
    if defect is not None:
        assert len(defect.over_rows) - len(defect.over_columns) == 12 - rank
        assert len(defect.under_columns) - len(defect.under_rows) == 12 - rank
        # The unknowns of the competing equations are listed completely.
        rows = incidence[list(defect.over_rows)]
        assert set(rows.indices.tolist()) == set(defect.over_columns)


@pytest.mark.parametrize("seed", range(20))
def test_blocks_need_only_unknowns_of_earlier_blocks(seed):
    rng = np.random.default_rng(seed)
    shuffled = rng.permutation(15)
    incidence = random_incidence(rng, 15, 0.1) + sp.csr_array(
        (np.ones(15), (np.arange(15), shuffled)), shape=(15, 15)
    )
    blocks = block_triangular(sp.csr_array(incidence), maximum_matching(incidence))
    known: set[int] = set()
    for rows, columns in blocks:
        known |= set(columns.tolist())
        for row in rows:
            needed = incidence.indices[incidence.indptr[row] : incidence.indptr[row + 1]]
            assert set(needed.tolist()) <= known
    assert sorted(np.concatenate([rows for rows, _ in blocks]).tolist()) == list(range(15))


def test_offsets_of_the_pendulum():
    # Unknowns x, y, vx, vy, F; Pryce (2001): constraint twice, kinematic equations once.
    entries = {
        (0, 0): 1, (0, 2): 0, (1, 1): 1, (1, 3): 0, (2, 2): 1, (2, 4): 0, (2, 0): 0, (3, 3): 1, (3, 4): 0,
        (3, 1): 0, (4, 0): 0, (4, 1): 0,
    }  # fmt: skip
    rows, columns = np.array(list(entries)).T
    orders = np.array(list(entries.values()))
    offsets = canonical_offsets(rows, columns, orders, 5)
    assert offsets.rows.tolist() == [1, 1, 0, 0, 2]
    assert offsets.columns.tolist() == [2, 2, 1, 1, 0]


@pytest.mark.parametrize("seed", range(10))
def test_offsets_are_the_smallest_that_satisfy_the_inequalities(seed):
    rng = np.random.default_rng(seed)
    n = 4
    present = rng.random((n, n)) < 0.5
    present[np.arange(n), rng.permutation(n)] = True
    rows, columns = np.nonzero(present)
    orders = rng.integers(0, 2, rows.size)
    offsets = canonical_offsets(rows, columns, orders, n)
    c, d = offsets.rows, offsets.columns
    assert np.all(d[columns] - c[rows] >= orders)
    on_transversal = [orders[(rows == i) & (columns == offsets.column_of[i])][0] for i in range(n)]
    assert np.array_equal(d[offsets.column_of] - c, on_transversal)
    assert c.min() == 0 if np.any(c) else True
    for smaller in np.ndindex(*(c + 1)):
        if tuple(smaller) == tuple(c):
            continue
        # Any smaller choice breaks an inequality once equality holds on the transversal.
        trial = np.array(smaller)
        highest = np.empty(n, dtype=int)
        highest[offsets.column_of] = trial + np.array(on_transversal)
        assert np.any(highest[columns] - trial[rows] < orders)


def test_tearing_a_ring_needs_one_guess():
    n = 8
    incidence = [{i, (i + 1) % n} for i in range(n)]
    tearing = tear(incidence, incidence, n)
    assert len(tearing.tears) == 1
    assert len(tearing.residual_rows) == 1
    assert len(tearing.causal) == n - 1
    known = set(tearing.tears)
    for row, column in tearing.causal:
        assert incidence[row] - {column} <= known
        known.add(column)
