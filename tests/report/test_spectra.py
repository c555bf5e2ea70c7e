"""Spectra and correlations against what is known of sines and of white noise."""

import numpy as np
import pytest

from daest.report.spectra import autocorrelation, spectrum


def test_the_power_of_a_sine_stands_at_its_frequency():
    time = np.arange(8192) * 0.01
    found = spectrum(time, 3.0 * np.sin(2 * np.pi * 5.0 * time))
    assert found is not None
    frequency, amplitude = found
    assert frequency[np.argmax(amplitude)] == pytest.approx(5.0, abs=0.1)
    assert np.sum(amplitude**2) * (frequency[1] - frequency[0]) == pytest.approx(4.5, rel=0.02)


def test_white_noise_is_flat_at_its_variance():
    values = 0.2 * np.random.default_rng(0).standard_normal(20_000)
    found = spectrum(np.arange(20_000) * 0.1, values)
    assert found is not None
    # One-sided density of white noise: variance / (half the sampling rate).
    assert np.median(found[1]) ** 2 == pytest.approx(0.04 / 5.0, rel=0.1)


def test_uneven_or_short_recordings_have_none():
    time = np.sort(np.random.default_rng(1).uniform(0, 10, 500))
    assert spectrum(time, np.sin(time)) is None
    assert spectrum(np.arange(20.0), np.ones(20)) is None
    assert spectrum(np.arange(200.0), np.full(200, np.nan)) is None


def test_white_errors_stay_in_the_band_and_coloured_ones_do_not():
    rng = np.random.default_rng(2)
    white = rng.standard_normal(4000)
    values, band = autocorrelation([white])
    assert band == pytest.approx(2.576 / np.sqrt(4000))
    assert np.mean(np.abs(values) < band) > 0.9
    coloured, _ = autocorrelation([np.convolve(white, np.ones(5) / 5, "valid")])
    assert coloured[0] == pytest.approx(0.8, abs=0.05)
