"""Rank decisions: thresholds, gaps and warnings."""

import numpy as np
import pytest
from scipy.linalg import hilbert

from daest.errors import NumericalError
from daest.numerics.ranks import decide_rank, default_tolerance, is_doubtful, range_and_null, warning


def test_clear_decision_has_its_gap_and_no_warning():
    decision = decide_rank("a", np.array([2.0, 1.0, 1e-17]), size=3, norm=2.0)
    assert decision.rank == 2
    assert decision.gap == pytest.approx(1e17)
    assert decision.threshold == pytest.approx(2.0 * default_tolerance(3))
    assert not is_doubtful(decision)
    assert warning(decision) == ""


def test_hilbert_matrix_is_doubtful():
    # Singular values of the 15 x 15 Hilbert matrix fall by a factor of about 30 each: no rank is clear.
    values = np.linalg.svd(hilbert(15), compute_uv=False)
    decision = decide_rank("hilbert", values, 15, values[0])
    assert 0 < decision.rank < 15
    assert "doubtful" in warning(decision)


def test_tolerance_of_the_user_is_relative_to_the_norm():
    values = np.array([10.0, 0.5, 0.01])
    assert [decide_rank("a", values, 3, 10.0, tolerance=t).rank for t in (0.1, 0.01, 1e-4)] == [1, 2, 3]


def test_zero_matrix_has_rank_zero_and_empty_matrix_is_fine():
    assert decide_rank("zero", np.zeros(3), 3, 0.0).rank == 0
    row_space, null_space, decision = range_and_null("empty", np.zeros((0, 4)), 0.0)
    assert (row_space.shape, null_space.shape, decision.rank) == ((4, 0), (4, 4), 0)


def test_range_and_null_are_orthonormal_complements():
    rng = np.random.default_rng(1)
    matrix = rng.normal(size=(6, 3)) @ rng.normal(size=(3, 8))
    row_space, null_space, decision = range_and_null("product", matrix, np.linalg.norm(matrix, 2))
    both = np.hstack([row_space, null_space])
    assert decision.rank == 3
    np.testing.assert_allclose(both.T @ both, np.eye(8), atol=1e-14)
    np.testing.assert_allclose(matrix @ null_space, 0, atol=1e-13)


def test_nan_is_an_error():
    with pytest.raises(NumericalError) as caught:
        decide_rank("broken", np.array([np.nan, 1.0]), 2, 1.0)
    assert caught.value.code == "rank-not-finite"
