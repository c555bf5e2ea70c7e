"""Where the error is: planted places are found and named, and nothing is said when nothing is there."""

import numpy as np
import pytest

from daest.diagnosis.comparison.where import ErrorSeries, Signal, distinct, where
from daest.diagnosis.gates import GATES

N, PERIOD = 4000, 0.01
TIME = PERIOD * np.arange(N)


def signals(seed=0):
    """A smooth speed that changes sign, twice as a position would see it, and a temperature."""
    rng = np.random.default_rng(seed)
    kernel = np.hanning(80)
    speed = np.convolve(rng.normal(size=N + 79), kernel, "valid")
    speed /= speed.std()
    warm = 20.0 + np.convolve(rng.normal(size=N + 799), np.hanning(800), "valid") / 20
    return (
        Signal("omega", "rad/s", speed),
        Signal("gear.w", "rad/s", 30.0 * speed),
        Signal("T", "degC", warm),
    )


def series(error, kind="one-step", seed=0):
    return ErrorSeries("phi", kind, error, TIME, np.zeros(N, dtype=int), ("run",), signals(seed))


def noise(seed):
    return np.random.default_rng(100 + seed).normal(size=N)


def test_region_of_small_speed_is_named_with_its_share():
    speed = signals()[0].values
    slow = np.abs(speed) < 0.2
    error = noise(1) * np.where(slow, 4.0, 1.0)
    error[5] = np.nan
    finding = where([series(error)])[0]
    assert (finding.kind, finding.variable, finding.unit) == ("region", "omega", "rad/s")
    assert finding.low == -finding.high and 0.1 < finding.high < 0.3
    inside = np.abs(speed) < finding.high
    seen = np.isfinite(error)
    share = np.sum(error[inside & seen] ** 2) / np.nansum(error**2)
    assert finding.share == pytest.approx(share, rel=1e-9)
    assert finding.expected == pytest.approx(inside[seen].mean(), rel=1e-9)
    assert "% of the one-step error of phi while |omega| < " in finding.text and "rad/s" in finding.text


def test_time_window_is_named():
    error = noise(2) * np.where((TIME >= 20.0) & (TIME < 22.5), 3.0, 1.0)
    finding = where([series(error)])[0]
    assert finding.kind == "time" and finding.experiment == "run"
    assert finding.low == pytest.approx(20.0, abs=0.1) and finding.high == pytest.approx(22.5, abs=0.1)


def test_narrow_band_is_named_only_for_one_step_errors():
    error = noise(3) + 0.6 * np.sin(2 * np.pi * 4.0 * TIME)
    bands = [f for f in where([series(error)]) if f.kind == "frequency"]
    assert len(bands) == 1 and (bands[0].low or 0.0) < 4.0 < bands[0].high and bands[0].unit == "Hz"
    assert not [f for f in where([series(error, "simulation")]) if f.kind == "frequency"]


@pytest.mark.slow
def test_slow_bands_are_told_by_their_periods():
    hours = 600.0 * np.arange(N)
    error = noise(4) + 0.5 * np.sin(2 * np.pi * hours / 86400.0)
    one = ErrorSeries("T", "one-step", error, hours, np.zeros(N, dtype=int), ("run",), signals())
    assert "at periods of" in where([one])[0].text or "at periods above" in where([one])[0].text


def test_a_finding_in_one_of_two_recordings_names_it():
    error = noise(5) * np.where(TIME >= 20.0, 1.8, 1.0)
    record = (TIME >= 20.0).astype(int)
    one = ErrorSeries("phi", "one-step", error, TIME, record, ("first", "second"), signals())
    times = [f for f in where([one]) if f.kind == "time"]
    assert all(f.experiment == "second" and "of second" in f.text for f in times)


@pytest.mark.slow
def test_nothing_is_said_when_nothing_is_there():
    """White and slowly changing errors that have nothing to do with the signals."""
    said = 0
    for seed in range(8):
        slow = np.convolve(noise(200 + seed), np.hanning(60), "same")
        said += bool(where([series(noise(seed), seed=seed), series(slow, "simulation", seed=seed)]))
    # At GATES.where_level = 2 % three of 8 have a probability of 4e-4.
    assert GATES.where_level == 0.02 and said <= 2


def test_copies_and_constants_are_left_out():
    given = (*signals(), Signal("fixed", "rad", np.full(N, 3.0)))
    assert [s.name for s in distinct(given)] == ["omega", "T"]


def test_short_and_empty_errors_say_nothing():
    assert where([]) == ()
    assert where([series(np.full(N, np.nan))]) == () and where([series(np.zeros(N))]) == ()
