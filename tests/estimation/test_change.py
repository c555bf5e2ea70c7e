"""Sequential tests: false alarms at the stated rate, changes found, references that are not white."""

import numpy as np
import pytest

from daest.estimation.streaming.change import (
    CHARTS,
    Usual,
    crossing,
    increments,
    simulated_run_length,
    start_of_charts,
    threshold_for,
    update_charts,
    usual_of,
)
from daest.estimation.streaming.watch import QUIET, Watch
from daest.model.estimates import Estimate

THRESHOLD_OF_TWO = 9.57  # nats: of two outputs and 30 000 samples between false alarms


def estimate(time, whitened):
    dof = int(np.isfinite(whitened).sum())
    nothing = np.zeros(0)
    return Estimate(time, nothing, nothing, whitened, whitened, float(np.nansum(whitened**2)), dof, 0.0)


def test_increments_are_log_likelihood_ratios():
    """Their exponentials have mean one under the model, whatever came before (without the clip)."""
    rng = np.random.default_rng(0)
    z = np.clip(rng.standard_normal(400_000), -4, 4)
    for before in (-1.5, 0.0, 2.0):
        means = np.mean(np.exp(increments(z, np.full(z.size, before))), axis=0)
        np.testing.assert_allclose(means, 1.0, atol=0.01)
    assert np.all(increments(np.array([np.nan]), np.array([0.0])) == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("n_outputs", [1, 2, 4])
def test_false_alarms_come_at_the_stated_rate(n_outputs):
    """The threshold is extrapolated from run lengths below 10 000 samples; other random numbers judge it."""
    usual, wanted = Usual.white(n_outputs), 30_000.0
    found = simulated_run_length(usual, threshold_for(usual, wanted), np.random.default_rng(9), 1500, 4000)
    assert 0.7 < found / wanted < 1.5


@pytest.mark.slow
def test_threshold_of_white_innovations():
    assert threshold_for(Usual.white(2), 30_000.0) == pytest.approx(THRESHOLD_OF_TWO, abs=0.3)


def delay(change, begins=2000, seed=0):
    """Samples from a change until a watch of two outputs alarms, and the alarm."""
    rng = np.random.default_rng(seed)
    watch = Watch(("a", "b"), Usual.white(2), THRESHOLD_OF_TWO)
    state, before = watch.begin(), np.zeros(2)
    for k in range(begins + 5000):
        z = rng.standard_normal(2)
        if k >= begins:
            z[1] = change(z[1], before[1])
        before = z
        state, alarm = watch.look(state, estimate(0.1 * k, z))
        if alarm is not None:
            return k - begins, alarm
    return None, None


@pytest.mark.parametrize(
    ("change", "chart", "longest"),
    [
        (lambda z, before: z + 1.0, "mean above", 60),
        pytest.param(lambda z, before: z - 0.5, "mean below", 200, marks=pytest.mark.slow),
        (lambda z, before: 2.0 * z, "spread", 60),
        (lambda z, before: 0.6 * before + 0.8 * z, "correlation", 150),
        pytest.param(lambda z, before: -0.6 * before + 0.8 * z, "alternation", 150, marks=pytest.mark.slow),
    ],
)
def test_changes_are_found_and_dated(change, chart, longest):
    for seed in range(3):
        late, alarm = delay(change, seed=seed)
        assert alarm is not None and 0 < late < longest
        assert alarm.output == "b"
        assert abs(alarm.since - 200.0) < 0.1 * longest
        assert alarm.chart == chart or chart in ("correlation", "alternation")


def test_a_change_is_told_again_while_it_lasts():
    """Crossings soon after an alarm belong to it."""
    watch = Watch(("a",), Usual.white(1), 8.0)
    rng, state, alarms = np.random.default_rng(1), watch.begin(), []
    for k in range(6000):
        shift = 1.5 if 1000 <= k < 1700 or 4000 <= k < 4100 else 0.0
        state, alarm = watch.look(state, estimate(float(k), rng.standard_normal(1) + shift))
        alarms += [] if alarm is None else [alarm.time]
    assert len(alarms) == 3
    assert 1000 < alarms[0] < 1050 and QUIET <= alarms[1] - alarms[0] < QUIET + 50 and 4000 < alarms[2] < 4050


def test_missing_outputs_change_nothing():
    usual = Usual.white(2)
    state = start_of_charts(usual)
    state = update_charts(state, np.array([1.0, np.nan]), 0.0, usual)
    assert np.all(state.sums[1] == 0.0) and state.sums[0, CHARTS.index("mean above")] > 0
    later = update_charts(state, np.array([np.nan, np.nan]), 1.0, usual)
    np.testing.assert_array_equal(later.sums, state.sums)
    assert crossing(later, 1.0) is None


def test_a_coloured_heavy_tailed_reference():
    """Innovations of a model that is a little wrong: no alarm while they stay as they were."""
    rng = np.random.default_rng(4)

    def coloured(n):
        z, e = np.zeros(n), rng.standard_t(5, n)
        for k in range(1, n):
            z[k] = 0.3 + 0.6 * (z[k - 1] - 0.3) + e[k]
        return z

    usual = usual_of(coloured(6000)[:, None])
    assert usual.coefficients[0, 0] == pytest.approx(0.6, abs=0.05)
    assert usual.mean[0] == pytest.approx(0.3, abs=0.2)
    watch = Watch(("a",), usual, threshold_for(usual, 1e5))
    state, stream = watch.begin(), coloured(6000)
    stream[4000:] += 1.5
    for k, z in enumerate(stream):
        state, alarm = watch.look(state, estimate(float(k), np.array([z])))
        if alarm is not None:
            break
    assert alarm is not None and 4000 < alarm.time < 4200
