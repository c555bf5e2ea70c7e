"""The smoother against the dense joint Gaussian and a Rauch-Tung-Striebel loop."""

import numpy as np
import pytest
from dense_gaussian import DenseRecord, random_model, simulate_record
from numpy.testing import assert_allclose
from test_kalman import assert_moments, random_case, record_with_gaps, textbook

from daest.estimation.filter_engines.kalman import kalman_filter
from daest.estimation.filter_engines.smoother import smooth
from daest.model.estimates import InitialState


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("is_known", [True, False])
def test_states_and_process_noise_equal_the_dense_joint_gaussian(seed, is_known):
    models, experiment, initial = random_case(seed)
    n, n_w = models[0].transition.shape[0], models[0].noise_cov.shape[0]
    mean0 = initial.mean if is_known else np.zeros(n)
    dense = DenseRecord(models, experiment, mean0, initial.cov if is_known else None)
    model = models if seed % 3 == 2 else models[0]
    result = smooth(kalman_filter(model, experiment, initial if is_known else None))
    for k in range(experiment.n_samples):
        both = np.vstack([dense.states[k], dense.noises[k]])
        posterior = dense.condition(both, experiment.n_samples)
        assert_moments(result.smoothed, k, posterior, np.append(dense.state_offsets[k], np.zeros(n_w)))


def test_stationary_phases_and_gaps_equal_rauch_tung_striebel():
    model, experiment, _ = record_with_gaps()
    uncorrelated = type(model)(**{**model.__dict__, "cross_cov": np.zeros((3, 2))})
    initial = InitialState.known(np.ones(3), 2.0)
    (m, P, x, V), _ = textbook(uncorrelated, experiment, initial)
    for k in range(len(x) - 2, -1, -1):
        gain = V[k] @ uncorrelated.transition.T @ np.linalg.inv(P[k + 1])
        x[k] += gain @ (x[k + 1] - m[k + 1])
        V[k] += gain @ (V[k + 1] - P[k + 1]) @ gain.T
    result = smooth(kalman_filter(uncorrelated, experiment, initial)).smoothed
    assert_allclose(result.mean[:, :3], x, atol=1e-7)
    assert_allclose(result.cov.array()[:, :3, :3], V, atol=1e-8)
    assert result.cov.distinct.shape[0] < 900


def test_an_unknown_start_is_the_limit_of_large_variances_over_a_long_record():
    model, experiment, _ = record_with_gaps(5)
    unknown = smooth(kalman_filter(model, experiment)).smoothed
    large = smooth(kalman_filter(model, experiment, InitialState.known(np.zeros(3), 1e3))).smoothed
    std = np.sqrt(np.diagonal(unknown.cov.array(), axis1=1, axis2=2))
    assert np.all(np.abs(unknown.mean - large.mean) < 1e-3 * std)
    difference = np.abs(unknown.cov.array() - large.cov.array())
    assert np.all(difference < 1e-3 * std[:, :, None] * std[:, None, :])


def test_smoothing_explains_the_record_better_than_filtering():
    rng = np.random.default_rng(8)
    model = random_model(rng, 3, 1, 2, 1)
    experiment, states = simulate_record(rng, [model], 2000, np.zeros(3))
    result = kalman_filter(model, experiment)
    error = [
        np.mean((sequence.mean[50:, :3] - states[50:]) ** 2)
        for sequence in (result.filtered, smooth(result).smoothed)
    ]
    assert error[1] < error[0]
