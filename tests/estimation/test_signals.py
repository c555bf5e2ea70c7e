"""How much of a recorded signal is followed, and signals that follow nothing."""

import numpy as np
import pytest

from daest.estimation.signals import fit_percent


def test_fit_is_that_of_the_field_with_a_mean_for_every_recording():
    rng = np.random.default_rng(1)
    first, second = rng.normal(2.0, 1.0, 50), rng.normal(-30.0, 2.0, 80)
    second[7] = np.nan
    left = 0.1 * np.hstack([first - first.mean(), second[np.isfinite(second)] - np.nanmean(second)])
    assert fit_percent([first, second], float(np.sum(left**2))) == pytest.approx(90.0)


@pytest.mark.parametrize("signal", [np.full(570, -0.02607767), np.zeros(9), np.full(4, np.nan)])
def test_nothing_is_followed_of_a_signal_that_stands_still(signal):
    assert fit_percent([signal], 1.0) is None
