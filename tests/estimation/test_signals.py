"""How much of a recorded signal is followed, and signals that follow nothing."""

import numpy as np
import pytest

from daest.estimation.fitting.signals import fit_percent, white_part


def test_fit_is_that_of_the_field_with_a_mean_for_every_recording():
    rng = np.random.default_rng(1)
    first, second = rng.normal(2.0, 1.0, 50), rng.normal(-30.0, 2.0, 80)
    second[7] = np.nan
    left = 0.1 * np.hstack([first - first.mean(), second[np.isfinite(second)] - np.nanmean(second)])
    assert fit_percent([first, second], float(np.sum(left**2))) == pytest.approx(90.0)


@pytest.mark.parametrize("signal", [np.full(570, -0.02607767), np.zeros(9), np.full(4, np.nan)])
def test_nothing_is_followed_of_a_signal_that_stands_still(signal):
    assert fit_percent([signal], 1.0) is None


def test_only_the_part_of_errors_without_memory_counts_as_white():
    random, t = np.random.default_rng(0), np.linspace(0.0, 20.0, 4000)
    noise = 0.1 * random.standard_normal(t.size)
    measured = np.cos(t) + noise
    assert white_part([measured], [np.sin(t) + noise]) == pytest.approx(0.1, rel=0.05)
    gaps = np.where(t % 1.0 < 0.1, np.nan, measured)
    assert white_part([gaps], [gaps - np.cos(t)]) == pytest.approx(0.1, rel=0.05)
    # The errors of a sensor with wide steps last between them.
    steps = np.round(np.cos(t), 1)
    assert white_part([steps], [steps - np.cos(t)]) is None
    assert white_part([measured[:2]], [noise[:2]]) is None
