"""Matrices turned over in memory."""

import numpy as np
import pytest

from daest.numerics.tables import turned


@pytest.mark.parametrize("shape", [(2, 5), (3, 2, 5), (4, 1, 3, 2)])
def test_matrices_are_turned_over_in_memory_of_their_own(shape):
    matrices = np.random.default_rng(1).standard_normal(shape)
    found = turned(matrices)
    assert found.flags.c_contiguous
    np.testing.assert_array_equal(found, np.swapaxes(matrices, -1, -2))
    rows = np.random.default_rng(2).standard_normal((3000, shape[-1]))
    np.testing.assert_allclose(rows @ found, rows @ np.swapaxes(matrices, -1, -2), rtol=1e-13, atol=1e-13)
