"""Residual statistics against exact covariances and their own distribution."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import kstest

from daest.numerics.statistics import autoregression, coloured_moment, weighted_past, whiteness_p_value


def test_p_values_of_white_noise_are_uniform():
    rng = np.random.default_rng(0)
    seen = np.ones(800, dtype=bool)
    p_values = [whiteness_p_value(rng.standard_normal(800), seen) for _ in range(200)]
    assert kstest(p_values, "uniform").pvalue > 0.01


def test_p_values_with_missing_samples_are_uniform():
    rng = np.random.default_rng(1)
    seen = rng.random(800) > 0.2
    p_values = [whiteness_p_value(rng.standard_normal(800), seen) for _ in range(200)]
    assert kstest(p_values, "uniform").pvalue > 0.01


def test_coloured_noise_is_not_white():
    e = np.random.default_rng(2).standard_normal(800)
    assert whiteness_p_value(lfilter([1.0], [1.0, -0.3], e), np.ones(800, dtype=bool)) < 1e-6


def test_too_short_a_sequence_tells_nothing():
    assert whiteness_p_value(np.array([1.0, 2.0, 3.0]), np.ones(3, dtype=bool)) == 1.0


def test_autoregression_finds_a_known_one():
    rng = np.random.default_rng(3)
    A = np.array([[0.6, 0.2], [-0.1, 0.8]])
    cov = np.array([[1.0, 0.3], [0.3, 0.5]])
    r = np.zeros((20_000, 2))
    for k in range(1, len(r)):
        r[k] = A @ r[k - 1] + np.linalg.cholesky(cov) @ rng.standard_normal(2)
    coefficients, found = autoregression(r)
    assert np.allclose(coefficients[0], A, atol=0.03)
    assert np.allclose(found, cov, atol=0.03)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.95])
def test_coloured_moment_is_the_quadratic_form_with_the_exact_covariance(rho):
    rng = np.random.default_rng(4)
    n_samples = 4000
    e = rng.standard_normal(n_samples + 1000)
    r = lfilter([1.0], [1.0, -rho], e)[1000:, None]
    time = np.arange(n_samples)
    slopes = np.stack([np.sin(0.01 * time), np.cos(0.3 * time), np.ones(n_samples)])[:, :, None]
    covariance = toeplitz(rho**time) / (1 - rho**2)
    expected = slopes[:, :, 0] @ covariance @ slopes[:, :, 0].T
    found = coloured_moment(slopes, r)
    size = np.sqrt(np.diagonal(expected))
    # The spectrum itself is estimated from 4000 samples.
    assert np.max(np.abs(found - expected) / np.outer(size, size)) < 0.25


@pytest.mark.parametrize("shape", [(40,), (3, 40), (2, 3)])
def test_weighted_past_is_a_filter(shape):
    rng = np.random.default_rng(3)
    weights, values = rng.normal(size=5), rng.normal(size=shape)
    np.testing.assert_allclose(weighted_past(weights, values), lfilter(weights, [1.0], values), atol=1e-14)
