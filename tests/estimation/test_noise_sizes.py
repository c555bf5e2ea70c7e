"""The sizes of noises that a gain leaves open."""

from types import SimpleNamespace

import numpy as np
import pytest

from daest.estimation.gain_family import Levels
from daest.estimation.noise_levels import at_size_of_innovations


def sized(expected, found, has_free_size=True):
    """Of levels (0.1; 1, 8), where the model expects those variances of the innovations and the recording has
    `found`."""
    return at_size_of_innovations(
        SimpleNamespace(has_free_size=has_free_size),
        SimpleNamespace(covariance=np.diag(found)),
        Levels(np.array([0.1]), np.array([1.0, 8.0])),
        SimpleNamespace(innovation_cov=np.diag(expected)),
    )


def test_outputs_that_no_process_noise_reaches_have_sizes_of_their_own():
    levels = sized(expected=[1.0001, 64.0001], found=[4.0, 9.0])
    assert levels.measurement_std == pytest.approx([2.0, 3.0], rel=1e-4)


def test_process_noise_has_the_size_of_the_outputs_that_it_reaches():
    levels = sized(expected=[2.0, 64.0], found=[8.0, 9.0])
    assert levels.measurement_std == pytest.approx([2.0, 3.0])
    assert levels.intensity == pytest.approx([0.4])


def test_noises_that_are_all_told_by_the_gain_share_one_size():
    levels = sized(expected=[2.0, 128.0], found=[8.0, 512.0])
    assert levels.measurement_std == pytest.approx([2.0, 16.0]) and levels.intensity == pytest.approx([0.4])


def test_given_sizes_stay():
    levels = sized([1.0, 64.0], [4.0, 9.0], has_free_size=False)
    assert levels.measurement_std.tolist() == [1.0, 8.0]
