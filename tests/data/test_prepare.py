"""Resampling, splitting and detrending against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from daest.data.prepare import (
    Preparation,
    clear_period,
    detrend,
    on_clock,
    resample,
    split_all,
    sufficient_period,
)
from daest.errors import ConfigError, DataError
from daest.model.experiment import Experiment


def recording(time, u, *outputs):
    y = np.column_stack(outputs)
    return Experiment("run", time, u[:, None], y, ("u",), tuple(f"y{i}" for i in range(y.shape[1])))


def test_resampled_sine_keeps_phase_and_amplitude_in_the_pass_band():
    time = np.arange(4000) * 0.01
    slow = np.sin(2 * np.pi * 1.0 * time)
    result = resample(recording(time, slow, slow), 0.05)
    assert result.period == pytest.approx(0.05)
    # A filter of 60 dB ripples by 1e-3; a delay of one old sample would show as 0.06.
    assert result.outputs[:, 0] == pytest.approx(np.sin(2 * np.pi * result.time), abs=2e-3)
    assert any("resampled to 0.05 s" in note for note in result.notes)


@pytest.mark.parametrize("frequency", [1.0, 3.0, 6.0])
def test_straight_lines_through_a_resampled_input_are_the_input(frequency):
    """Below 7 Hz the filter lets all pass; samples of the input itself would lack 29 % at 6 Hz."""
    time = np.arange(40_000) * 0.001
    wave = np.sin(2 * np.pi * frequency * time)
    result = resample(recording(time, wave, wave), 0.05)
    inner = (time > result.time[0]) & (time < result.time[-1])
    lines = np.interp(time[inner], result.time, result.inputs[:, 0])
    turns = 2 * np.pi * frequency * time[inner]
    basis = np.column_stack([np.sin(turns), np.cos(turns)])
    amplitude, quadrature = np.linalg.lstsq(basis, lines, rcond=None)[0]
    assert amplitude == pytest.approx(1.0, abs=3e-3) and abs(quadrature) < 3e-3


def test_held_input_comes_half_a_period_later():
    """dy/dt = u - y with u held between the samples of the recording: its exact response, filtered, is that
    to the straight lines through the filtered input."""
    h, n = 0.01, 6000
    u = np.repeat(np.random.default_rng(3).standard_normal(n // 25), 25)
    decay = np.exp(-h)
    y = lfilter([0.0, 1.0 - decay], [1.0, -decay], u)
    errors = []
    for hold in ("zoh", "foh"):
        result = resample(recording(h * np.arange(n), u, y), 0.05, hold)
        keep = np.exp(-result.period)
        old, new = (1.0 - keep) / result.period - keep, 1.0 - (1.0 - keep) / result.period
        lines = result.inputs[:, 0]
        y0, first = result.outputs[0, 0], [keep * result.outputs[0, 0] + old * lines[0]]
        rest = lfilter([new, old], [1.0, -keep], lines[1:], zi=first)[0]
        errors.append(np.sqrt(np.mean((np.append(y0, rest) - result.outputs[:, 0]) ** 2)))
    assert errors[0] < 8e-4 < 4e-3 < errors[1]


def moved(noise, period=0.001, n=20_000, band=1.0):
    """An output that moves below `band` Hz, with white noise."""
    time = np.arange(n) * period
    rng = np.random.default_rng(1)
    y = sum(np.sin(2 * np.pi * f * time + rng.uniform(0, 6)) for f in np.linspace(0.1, band, 5))
    return recording(time, y, y + noise * rng.standard_normal(n))


def test_much_too_fine_recording_has_a_sufficient_period():
    period = sufficient_period([moved(1e-6), moved(1e-6, band=2.0)])
    # Twenty samples in the period of the fastest part, but for the resolution of the spectrum.
    assert period == pytest.approx(1.0 / 40.0, rel=0.1)
    assert period / 0.001 == pytest.approx(round(period / 0.001))


def test_coarser_period_leaves_samples_enough():
    assert sufficient_period([moved(1e-6, n=8_000)]) == pytest.approx(0.008)  # of 1000 for estimation
    assert sufficient_period([moved(1e-6, n=8_000)], [moved(1e-6, n=1_200)]) == pytest.approx(0.004)


def test_fast_mode_keeps_its_samples_where_the_outputs_show_it():
    """A resonance at 15 Hz, hardly larger than a thousandth of the motion, has hardly any power beside it."""
    slow = moved(0.0, n=60_000)
    ringing = replace(slow, outputs=slow.outputs + 3e-3 * np.sin(2 * np.pi * 15.0 * slow.time)[:, None])
    assert sufficient_period([ringing]) == pytest.approx(0.045, rel=0.2)
    assert sufficient_period([ringing], modes=[15.0]) == pytest.approx(0.006)  # eleven in its period
    assert sufficient_period([slow], modes=[15.0]) == pytest.approx(0.045, rel=0.2)  # it does not show


def test_noisy_recording_has_a_period_that_keeps_what_is_above_the_noise():
    assert 0.03 <= clear_period([moved(0.02, n=60_000)]) <= 0.125  # the Nyquist frequency is 4 Hz or more
    assert clear_period([moved(0.02), moved(0.02, band=20.0)]) <= 0.00625
    assert clear_period([moved(0.02, n=3_000)]) == pytest.approx(0.003)  # 1000 samples are left
    slow = moved(0.02, n=60_000)
    ringing = replace(slow, outputs=slow.outputs + 0.2 * np.sin(2 * np.pi * 15.0 * slow.time)[:, None])
    assert clear_period([ringing]) < 0.25 / 15.0
    assert clear_period([ringing], modes=[30.0]) <= 0.1 / 30.0
    assert clear_period([moved(0.02, band=400.0)]) is None


def test_sensor_noise_and_uneven_times_keep_their_period():
    assert sufficient_period([moved(0.02)]) is None
    assert sufficient_period([moved(1e-6), moved(0.02)]) is None
    assert sufficient_period([moved(1e-6, period=0.05, n=2_000)]) is None  # as fine as need be
    shaken = moved(1e-6)
    time = shaken.time + 2e-4 * np.random.default_rng(0).random(shaken.n_samples)
    assert sufficient_period([replace(shaken, time=time)]) is None
    assert sufficient_period([replace(shaken, outputs=0.0 * shaken.outputs)]) is None
    assert sufficient_period([]) is None


def test_resampling_does_not_alias():
    time = np.arange(4000) * 0.01
    fast = np.sin(2 * np.pi * 19.0 * time)  # would fold to 1 Hz at 0.05 s
    result = resample(recording(time, fast, fast), 0.05)
    assert np.abs(result.outputs).max() < 2e-3


def test_ratio_need_not_be_an_integer():
    time = np.arange(4000) * 0.01
    result = resample(recording(time, np.cos(time), np.cos(time)), 0.0333)
    assert result.period == pytest.approx(0.0333)
    assert result.outputs[:, 0] == pytest.approx(np.cos(result.time), abs=2e-3)


def test_uneven_times_become_even():
    rng = np.random.default_rng(4)
    time = np.cumsum(rng.uniform(0.004, 0.006, 4000))
    result = resample(recording(time, np.sin(time), np.sin(time)), 0.02)
    assert result.period == pytest.approx(0.02)
    assert result.outputs[:, 0] == pytest.approx(np.sin(result.time), abs=2e-3)


def test_constant_stays_exact_and_missing_samples_stay_local():
    time = np.arange(2000) * 0.01
    y = np.full(2000, 3.0)
    y[1000] = np.nan
    y[500:700] = np.nan
    result = resample(recording(time, np.ones(2000), y), 0.05)
    assert result.inputs == pytest.approx(np.ones_like(result.inputs), abs=1e-12)
    gone = np.isnan(result.outputs[:, 0])
    inside = (result.time >= 5.0) & (result.time < 6.99)
    assert gone[inside].all()
    far = (result.time < 4.5) | (result.time > 7.5)
    near_single = np.abs(result.time - 10.0) < 0.06
    assert not gone[far & ~near_single].any()
    assert result.outputs[~gone, 0] == pytest.approx(3.0)


def test_resampling_refuses_what_cannot_be_known():
    time = np.arange(100) * 0.01
    with pytest.raises(ConfigError, match="shorter than"):
        resample(recording(time, time, time), 0.001)
    with pytest.raises(DataError) as caught:
        resample(recording(time, time, time), 0.2)
    assert caught.value.code == "data-too-few-rows"


def test_same_period_changes_nothing():
    time = np.arange(100) * 0.01
    given = recording(time, time, time)
    assert resample(given, 0.01) is given


def test_detrend():
    time = np.arange(50) * 0.1
    wave = np.sin(time)
    y = wave + 3 + 2 * time
    y[7] = np.nan
    known = np.isfinite(y)
    centred = detrend(recording(time, wave + 5, y), "mean")
    assert centred.inputs.mean() == pytest.approx(0, abs=1e-12)
    assert np.nanmean(centred.outputs) == pytest.approx(0, abs=1e-12)
    straight = detrend(recording(time, wave, y), "linear").outputs[known, 0]
    expected = (wave - np.polyval(np.polyfit(time[known], wave[known], 1), time))[known]
    assert straight == pytest.approx(expected, abs=1e-12)


def test_split_and_detrend_each_part_by_itself():
    time = np.arange(100) * 0.1
    given = recording(time, time, np.where(time < 5, 1.0, 9.0))
    first, second = split_all([given], Preparation(split=0.5, detrend="mean"))
    assert first[0].n_samples + second[0].n_samples == 100
    assert first[0].time[-1] < second[0].time[0]
    assert first[0].outputs == pytest.approx(0, abs=1e-12)
    assert second[0].outputs == pytest.approx(0, abs=1e-12)
    assert split_all([given], Preparation())[1] == []
    with pytest.raises(DataError):
        split_all([given], Preparation(split=0.001))


def test_unused_columns_are_resampled_like_inputs():
    """Each may become one: a command in volts stays proportional to the force that it stands for."""
    time = np.arange(4000) * 0.01
    force = np.sign(np.sin(2 * np.pi * 0.7 * time))
    record = replace(recording(time, force, force), extra={"command": force / 35.0})
    result = resample(record, 0.05)
    assert result.extra["command"] == pytest.approx(result.inputs[:, 0] / 35.0, rel=1e-12)


@pytest.mark.parametrize(
    ("period", "slip", "is_uniform"),
    [
        (0.1, 0.001, True),  # a millisecond in stamps of milliseconds, once in the recording
        (0.1, 0.005, False),
        (0.02, 0.001, False),  # too much of a period
    ],
)
def test_stamps_off_by_their_last_decimal_are_rounded(period, slip, is_uniform):
    time = period * np.arange(2000)
    time[700:] -= slip
    found = on_clock(recording(np.round(time, 3), time, time))
    assert bool(found.notes) is is_uniform
    assert (found.period is not None) is is_uniform


@pytest.mark.parametrize(
    ("digits", "slip", "is_uniform"), [(6, 0.0, True), (6, 2e-4, False), (5, 0.0, False)]
)
def test_stamps_of_so_many_digits_are_rounded(digits, slip, is_uniform):
    """Of a period of 0.02197 s, six digits are off by 0.002 periods from 10 s on, and five by too much."""
    time = 0.02196954 * np.arange(1300)
    time[200] += slip
    found = on_clock(recording(np.array([float(f"{t:.{digits}g}") for t in time]), time, time))
    assert (found.period is not None) is is_uniform
    if is_uniform:
        assert found.period == pytest.approx(0.02196954, rel=1e-6)


def test_rows_that_a_clock_leaves_out_have_no_outputs_and_inputs_between_their_neighbours():
    rng = np.random.default_rng(4)
    kept = np.sort(np.concatenate([[0, 499], 1 + rng.permutation(498)[:430]]))
    lost = np.setdiff1d(np.arange(500), kept)
    time = 2.0 + 0.01 * np.arange(500)
    u, y = np.cumsum(rng.normal(size=500)), rng.normal(size=500)
    whole = replace(recording(time, u, y), extra={"angle": 3.0 * u})
    found = on_clock(
        replace(
            whole,
            time=whole.time[kept],
            inputs=whole.inputs[kept],
            outputs=whole.outputs[kept],
            extra={"angle": 3.0 * u[kept]},
        )
    )
    assert found.period == pytest.approx(0.01) and found.n_samples == 500
    assert found.time == pytest.approx(time)
    np.testing.assert_array_equal(found.outputs[kept], whole.outputs[kept])
    assert np.isnan(found.outputs[lost]).all()
    between = np.interp(time, time[kept], u[kept])
    np.testing.assert_allclose(found.inputs[:, 0], between, atol=1e-12)
    np.testing.assert_allclose(found.extra["angle"], 3.0 * between, atol=1e-12)
    assert found.notes[-1].startswith("68 of 500 rows are left out on a clock of 0.01 s")


@pytest.mark.parametrize(
    "time",
    [
        np.arange(500)[np.random.default_rng(1).uniform(size=500) < 0.4],  # most are left out
        np.concatenate([np.arange(100), np.arange(150, 300)]),  # a pause
        np.cumsum(np.random.default_rng(2).uniform(0.5, 2.5, size=300)),  # no clock
    ],
    ids=["few", "pause", "jitter"],
)
def test_times_that_no_clock_gives_stay_uneven(time):
    record = recording(0.01 * time, np.sin(time), np.cos(time))
    assert on_clock(record) is record
