"""Thinning keeps what a viewer must see: ends, peaks and gaps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daest.report.page.plots import thinned


@given(st.integers(0, 5000), st.integers(200, 2000), st.integers(0, 2**31))
def test_ends_and_extremes_stay_and_no_more_than_allowed(n, most, seed):
    values = np.random.default_rng(seed).normal(size=n)
    at = thinned(values, most)
    assert at.size <= max(most, 0) or n <= most
    assert np.all(np.diff(at) > 0)
    if n:
        assert at[0] == 0 and at[-1] == n - 1
        assert values[at].min() == values.min() and values[at].max() == values.max()


@pytest.mark.parametrize("where", [1, 4999, 9998])
def test_a_single_spike_stays(where):
    values = np.zeros(10_000)
    values[where] = 1.0
    assert where in thinned(values, 400)


def test_a_gap_stays_a_gap():
    values = np.ones(10_000)
    values[3000:6000] = np.nan
    drawn = values[thinned(values, 400)]
    assert np.isnan(drawn).sum() > 50 and np.isfinite(drawn).sum() > 100


def test_short_series_are_whole():
    assert thinned(np.array([3.0, np.nan, 1.0]), 200).tolist() == [0, 1, 2]
