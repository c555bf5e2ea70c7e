"""The Kalman filter against the dense joint Gaussian, a plain loop, SciPy, python-control and statsmodels."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from dense_gaussian import DenseRecord, random_model, simulate_record
from numpy.testing import assert_allclose

from daest.errors import EXPLANATIONS, EstimationError
from daest.estimation.filter_engines.kalman import kalman_filter, steady_sample, unobservable_states
from daest.estimation.filter_engines.stationary import stationary_filter
from daest.model.estimates import InitialState
from daest.model.experiment import Experiment
from daest.model.linear import DiscreteModel
from daest.numerics.gaussian import marginals

TOLERANCE = 1e-8


def random_case(seed):
    """Models per interval, a record with missing outputs, a proper start; every third is irregular."""
    rng = np.random.default_rng(seed)
    n, n_y, n_w = rng.integers(1, 6), rng.integers(1, 4), rng.integers(1, 4)
    n_samples = int(rng.integers(15, 25))
    if seed % 3 == 2:
        steps = rng.uniform(0.05, 0.2, n_samples - 1)
        models = [random_model(rng, n, n_y, n_w, 1, step) for step in steps]
        time = np.concatenate([[0.0], np.cumsum(steps)])
    else:
        models, time = [random_model(rng, n, n_y, n_w, 2)] * (n_samples - 1), None
    missing = 0.3 if seed % 2 else 0.0
    experiment, _ = simulate_record(rng, models, n_samples, rng.normal(size=n), missing, time)
    root = rng.normal(size=(n, n))
    return models, experiment, InitialState(rng.normal(size=n), root @ root.T)


def assert_moments(sequence, k, posterior, offset):
    scale = 1.0 + np.max(np.abs(posterior.cov))
    assert_allclose(sequence.mean[k], posterior.mean + offset, rtol=TOLERANCE, atol=TOLERANCE * scale)
    assert_allclose(sequence.cov[k], posterior.cov, rtol=TOLERANCE, atol=TOLERANCE * scale)


@pytest.mark.parametrize("seed", range(12))
def test_proper_start_equals_the_dense_joint_gaussian(seed):
    models, experiment, initial = random_case(seed)
    dense = DenseRecord(models, experiment, initial.mean, initial.cov)
    result = kalman_filter(models if seed % 3 == 2 else models[0], experiment, initial)
    n_w = models[0].noise_cov.shape[0]
    for k in range(experiment.n_samples):
        offset = dense.state_offsets[k]
        assert_moments(result.predicted, k, dense.condition(dense.states[k], k - 1), offset)
        both = np.vstack([dense.states[k], dense.noises[k]])
        assert_moments(result.filtered, k, dense.condition(both, k), np.append(offset, np.zeros(n_w)))
    assert_allclose(result.log_likelihood, dense.log_likelihood(), rtol=TOLERANCE)


@pytest.mark.parametrize("seed", range(12))
def test_unknown_start_equals_the_dense_joint_gaussian_with_a_flat_prior(seed):
    models, experiment, _ = random_case(seed)
    n, n_w = models[0].transition.shape[0], models[0].noise_cov.shape[0]
    dense = DenseRecord(models, experiment, np.zeros(n))
    result = kalman_filter(models if seed % 3 == 2 else models[0], experiment)
    determined = 0
    for k in range(experiment.n_samples):
        seen = np.array([row[:n] for j, row in dense.output_rows if j <= k]).reshape(-1, n)
        is_free = bool(np.any(result.filtered.free[k][:n]))
        assert is_free == (np.linalg.matrix_rank(seen, tol=1e-9) < n)
        if not is_free:
            determined += 1
            both = np.vstack([dense.states[k], dense.noises[k]])
            offset = np.append(dense.state_offsets[k], np.zeros(n_w))
            assert_moments(result.filtered, k, dense.condition(both, k), offset)
    assert determined > 0
    assert_allclose(result.log_likelihood, dense.log_likelihood(), rtol=TOLERANCE)


def test_partly_unknown_start_is_the_limit_of_large_variances():
    models, experiment, _ = random_case(4)
    n = models[0].transition.shape[0]
    assert n >= 2
    cov = np.diag(np.full(n, 0.5))
    cov[0, 0] = np.inf
    result = kalman_filter(models[0], experiment, InitialState(np.ones(n), cov))
    large = cov.copy()
    large[0, 0] = 1e10
    dense = DenseRecord(models, experiment, np.ones(n), large)
    posterior = dense.condition(dense.states[-1], experiment.n_samples)
    assert_allclose(result.filtered.mean[-1][:n], posterior.mean + dense.state_offsets[-1], rtol=1e-5)
    limit = dense.log_likelihood() + 0.5 * np.log(2 * np.pi * 1e10)
    assert result.log_likelihood == pytest.approx(limit, abs=1e-5)


def textbook(model, experiment, initial):
    """Plain loop in covariance form: predicted and filtered states, covariances and the log-likelihood."""
    m, P, value, rows = initial.mean, initial.cov, 0.0, []
    u, Phi, C = experiment.inputs, model.transition, model.output
    for k, y in enumerate(experiment.outputs):
        keep = ~np.isnan(y)
        Ck, Rk, Sk = C[keep], model.measurement_cov[np.ix_(keep, keep)], model.cross_cov[:, keep]
        nu = y[keep] - Ck @ m - model.feedthrough[keep] @ u[k] - model.output_offset[keep]
        S = Ck @ P @ Ck.T + Rk
        inverse = np.linalg.inv(S)
        rows.append((m, P, m + P @ Ck.T @ inverse @ nu, P - P @ Ck.T @ inverse @ Ck @ P))
        value -= 0.5 * (nu @ inverse @ nu + np.linalg.slogdet(2 * np.pi * S)[1])
        K = (Phi @ P @ Ck.T + Sk) @ inverse
        following = u[min(k + 1, len(u) - 1)]
        m = Phi @ m + model.input_now @ u[k] + model.input_next @ following + model.drift + K @ nu
        P = Phi @ P @ Phi.T + model.process_cov - K @ S @ K.T
        P = (P + P.T) / 2
    return [np.array(part) for part in zip(*rows, strict=True)], value


def record_with_gaps(seed=3, n_samples=1500):
    rng = np.random.default_rng(seed)
    model = random_model(rng, 3, 2, 2, 1)
    model = replace(
        model, transition=0.97 * model.transition / np.max(np.abs(np.linalg.eigvals(model.transition)))
    )
    experiment, states = simulate_record(rng, [model], n_samples, np.zeros(3))
    experiment.outputs[600:605, 1] = np.nan
    experiment.outputs[900:1100, 0] = (
        np.nan
    )  # a sensor that fails for a while has a stationary gain of its own
    return model, experiment, states


def test_stationary_phases_and_gaps_equal_the_textbook_loop():
    model, experiment, _ = record_with_gaps()
    initial = InitialState.known(np.ones(3), 2.0)
    (m, P, m_f, P_f), value = textbook(model, experiment, initial)
    result = kalman_filter(model, experiment, initial)
    assert result.stationary_from is not None and result.stationary_from < 200
    assert_allclose(result.predicted.mean, m, atol=1e-8)
    assert_allclose(result.predicted.cov.array(), P, atol=1e-9)
    assert_allclose(result.filtered.mean[:, :3], m_f, atol=1e-8)
    assert_allclose(result.filtered.cov.array()[:, :3, :3], P_f, atol=1e-9)
    assert result.log_likelihood == pytest.approx(value, rel=1e-10)


def test_the_stationary_phase_is_stored_once():
    model, experiment, _ = record_with_gaps(n_samples=5000)
    result = kalman_filter(model, experiment, InitialState.known(np.zeros(3), 1.0))
    assert result.predicted.cov.distinct.shape[0] < 1000
    assert len(result.predicted.cov) == 5000
    assert np.isnan(result.innovations[902, 0]) and np.isfinite(result.innovations[902, 1])
    assert result.nis_dof[902] == 1 and result.nis_dof[10] == 2


def test_stationary_kind_is_the_constant_gain_filter():
    model, experiment, _ = record_with_gaps()
    complete = Experiment(
        "first", experiment.time[:500], experiment.inputs[:500], experiment.outputs[:500],
        experiment.input_names, experiment.output_names,
    )  # fmt: skip
    result = kalman_filter(model, complete, InitialState.known(np.full(3, 5.0)), "stationary")
    P = scipy.linalg.solve_discrete_are(
        model.transition.T, model.output.T, model.process_cov, model.measurement_cov, s=model.cross_cov
    )
    S = model.output @ P @ model.output.T + model.measurement_cov
    K = (model.transition @ P @ model.output.T + model.cross_cov) @ np.linalg.inv(S)
    x, u = np.full(3, 5.0), complete.inputs
    for k in range(499):
        assert_allclose(result.predicted.mean[k], x, atol=1e-8)
        nu = complete.outputs[k] - model.output @ x - model.feedthrough @ u[k] - model.output_offset
        x = model.transition @ x + model.input_now @ u[k] + model.input_next @ u[k + 1] + model.drift + K @ nu
    assert result.predicted.cov.distinct.shape[0] == 1
    assert result.stationary_from == 0 and steady_sample(result) == 0


@pytest.mark.parametrize("seed", range(20))
def test_stationary_gain_equals_scipy(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng, rng.integers(1, 7), rng.integers(1, 3), rng.integers(1, 4), 1)
    P = scipy.linalg.solve_discrete_are(
        model.transition.T, model.output.T, model.process_cov, model.measurement_cov, s=model.cross_cov
    )
    assert_allclose(stationary_filter(model).predicted_cov, P, rtol=1e-7, atol=1e-9 * np.max(np.abs(P)))


def test_stationary_gain_equals_python_control():
    control = pytest.importorskip("control")
    model = random_model(np.random.default_rng(5), 4, 2, 3, 1)
    model = replace(model, cross_cov=np.zeros((4, 2)))
    Q = (model.process_cov + model.process_cov.T) / 2
    gain, P, _ = control.dlqe(model.transition, np.eye(4), model.output, Q, model.measurement_cov)
    found = stationary_filter(model)
    assert_allclose(found.predicted_cov, P, rtol=1e-8)
    assert_allclose(found.gain, gain, rtol=1e-8)


def servo(period, output, intensity=1.0, std=1e-3):
    """Two inertias and a spring, torque noise on the disc; states phi1, w1, phi2, w2."""
    J1, J2, c, d, friction = 5.7e-3, 2e-2, 1.5, 0.02, 5.0
    A = np.array([
        [0, 1, 0, 0],
        [-c / J1, -(d + friction) / J1, c / J1, d / J1],
        [0, 0, 0, 1],
        [c / J2, d / J2, -c / J2, -d / J2],
    ])  # fmt: skip
    G = np.array([[0.0], [0.0], [0.0], [1.0]])
    Phi = scipy.linalg.expm(A * period)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    Q = sum(
        w * (F := scipy.linalg.expm(A * period * (s + 1) / 2) @ G) @ F.T
        for s, w in zip(nodes, weights, strict=True)
    )
    C = np.eye(4)[[output]]
    return DiscreteModel(
        transition=Phi,
        input_now=np.zeros((4, 0)),
        input_next=np.zeros((4, 0)),
        drift=np.zeros(4),
        output=C,
        feedthrough=np.zeros((1, 0)),
        output_offset=np.zeros(1),
        process_cov=Q * period / 2 * intensity,
        measurement_cov=np.array([[std**2]]),
        cross_cov=np.zeros((4, 1)),
        noise_cov=np.array([[intensity / period]]),
        noise_process_cov=np.zeros((1, 4)),
        noise_measurement_cov=np.zeros((1, 1)),
        period=period,
        hold="zoh",
    )


NAMES = ("motor.phi", "motor.w", "disc.phi", "disc.w")


@pytest.mark.parametrize("period", [1e-4, 1e-2, 0.05])
@pytest.mark.parametrize("std", [1e-6, 1e-3, 0.1])
@pytest.mark.parametrize("intensity", [1e-6, 1.0, 1e3])
def test_the_angle_integrator_has_a_stationary_filter_at_any_scale(period, std, intensity):
    model = servo(period, 2, intensity, std)
    found = stationary_filter(model, NAMES)
    P, K, S = found.predicted_cov, found.gain, found.innovation_cov
    residual = model.transition @ P @ model.transition.T + model.process_cov - K @ S @ K.T - P
    assert np.max(np.abs(residual)) < 1e-12 * np.max(np.abs(P))
    assert np.max(np.abs(np.linalg.eigvals(found.closed_loop))) < 1.0


@pytest.mark.parametrize("period", [1e-4, 1e-2, 0.05])
def test_an_angle_that_only_speeds_are_measured_for_is_named(period):
    with pytest.raises(EstimationError) as caught:
        stationary_filter(servo(period, 1), NAMES)
    assert caught.value.code == "filter-unobservable"
    assert "motor.phi and disc.phi" in caught.value.what and "motor.w" not in caught.value.what
    assert caught.value.code in EXPLANATIONS


def test_a_constant_bias_without_noise_is_named():
    model = random_model(np.random.default_rng(0), 2, 1, 1, 1)
    model = replace(
        model,
        transition=np.diag([0.5, 1.0]),
        output=np.ones((1, 2)),
        process_cov=np.diag([1.0, 0.0]),
        cross_cov=np.zeros((2, 1)),
    )
    with pytest.raises(EstimationError) as caught:
        stationary_filter(model, ("x", "bias"))
    assert caught.value.code == "filter-undriven-mode"
    assert "bias" in caught.value.what and "x" not in caught.value.what.split()


def test_a_constant_bias_without_noise_is_averaged_by_the_time_varying_filter():
    rng = np.random.default_rng(1)
    model = random_model(rng, 1, 1, 1, 1)
    model = replace(
        model,
        transition=np.eye(1), process_cov=np.zeros((1, 1)), cross_cov=np.zeros((1, 1)), output=np.eye(1),
        input_now=np.zeros((1, 1)), input_next=np.zeros((1, 1)), drift=np.zeros(1),
        feedthrough=np.zeros((1, 1)), output_offset=np.zeros(1), measurement_cov=np.eye(1) * 4.0,
    )  # fmt: skip
    experiment, _ = simulate_record(rng, [model], 400, np.array([3.0]))
    result = kalman_filter(model, experiment)
    counts = np.arange(1, 401)
    assert_allclose(result.filtered.mean[:, 0], np.cumsum(experiment.outputs[:, 0]) / counts, rtol=1e-10)
    assert_allclose(result.filtered.cov.array()[:, 0, 0], 4.0 / counts, rtol=1e-10)
    assert steady_sample(result) is None and result.stationary_from is None


def test_an_unobservable_angle_gets_no_value_and_the_rest_does():
    model = servo(1e-2, 1)
    rng = np.random.default_rng(2)
    experiment, states = simulate_record(rng, [model], 600, np.array([1.0, 0.0, 1.2, 0.0]))
    result = kalman_filter(model, experiment)
    rows = np.vstack(
        [np.eye(4), [1.0, 0.0, -1.0, 0.0]]
    )  # the twist of the spring is seen, the angles are not
    mean, std = marginals(result.filtered, np.hstack([rows, np.zeros((5, 1))]))
    assert np.all(np.isnan(mean[-1, [0, 2]])) and np.all(np.isinf(std[-1, [0, 2]]))
    truth = states[-1] @ rows.T
    seen = [1, 3, 4]
    assert np.all(np.abs(mean[-1, seen] - truth[seen]) < 5 * std[-1, seen])
    assert np.all(std[-1, seen] < np.array([0.1, 5.0, 1.0]))
    assert unobservable_states(result).shape == (4, 1)


@pytest.mark.parametrize("seed", range(3))
def test_likelihoods_equal_statsmodels(seed):
    statsmodels = pytest.importorskip("statsmodels.tsa.statespace.kalman_filter")
    rng = np.random.default_rng(seed)
    model = random_model(rng, 3, 2, 2, 1)
    model = replace(
        model,
        cross_cov=np.zeros((3, 2)), drift=np.zeros(3), output_offset=np.zeros(2),
        input_now=np.zeros((3, 1)), input_next=np.zeros((3, 1)), feedthrough=np.zeros((2, 1)),
    )  # fmt: skip
    experiment, _ = simulate_record(rng, [model], 300, np.zeros(3), missing=0.1)
    peer = statsmodels.KalmanFilter(k_endog=2, k_states=3, tolerance=0)
    peer.bind(experiment.outputs)
    for name, value in {
        "design": model.output, "obs_cov": model.measurement_cov, "transition": model.transition,
        "selection": np.eye(3), "state_cov": model.process_cov,
    }.items():  # fmt: skip
        peer[name] = value
    peer.initialize_known(np.zeros(3), np.eye(3))
    known = kalman_filter(model, experiment, InitialState.known(np.zeros(3), 1.0))
    assert known.log_likelihood == pytest.approx(peer.loglike(), rel=1e-10)
    peer.initialize_diffuse()  # its prior density is (2 π)^(-n/2) where ours is one
    expected = peer.loglike() + 1.5 * np.log(2 * np.pi)
    assert kalman_filter(model, experiment).log_likelihood == pytest.approx(expected, rel=1e-7)


def test_uneven_samples_are_refused_with_the_place():
    model, experiment, _ = record_with_gaps(n_samples=50)
    time = experiment.time.copy()
    time[30:] += 0.05
    late = Experiment("late", time, experiment.inputs, experiment.outputs, ("u0",), ("y0", "y1"))
    with pytest.raises(EstimationError, match=r"2\.9 s to 3\.05 s") as caught:
        kalman_filter(model, late)
    assert caught.value.code == "filter-uneven-samples"
    longer = replace(model, period=0.15)
    mapped = kalman_filter({0.1: model, 0.15: longer}, late)
    listed = kalman_filter([longer if k == 29 else model for k in range(49)], late)
    assert mapped.log_likelihood == listed.log_likelihood
    with pytest.raises(EstimationError, match="equal steps"):
        kalman_filter({0.1: model, 0.15: longer}, late, None, "stationary")


def test_bad_initial_states_are_refused():
    model, experiment, _ = record_with_gaps(n_samples=20)
    cov = np.full((3, 3), 0.1)
    cov[0, 0] = np.inf
    for initial in (InitialState(np.zeros(2), np.eye(2)), InitialState(np.zeros(3), cov)):
        with pytest.raises(EstimationError) as caught:
            kalman_filter(model, experiment, initial)
        assert caught.value.code == "filter-initial-state"


def test_outputs_without_any_noise_are_refused():
    model, experiment, _ = record_with_gaps(n_samples=20)
    exact = replace(
        model,
        process_cov=np.zeros((3, 3)), cross_cov=np.zeros((3, 2)), measurement_cov=np.zeros((2, 2)),
    )  # fmt: skip
    with pytest.raises(EstimationError) as caught:
        kalman_filter(exact, experiment, InitialState.known(np.zeros(3), 0.0))
    assert caught.value.code == "filter-singular-innovation"


def test_likelihood_does_not_depend_on_the_units_of_the_states():
    rng = np.random.default_rng(7)
    n = 24
    model = random_model(rng, n, 2, 2, 1)
    experiment, _ = simulate_record(rng, [model] * 299, 300, rng.normal(size=n), 0.1, None)
    mean, units = rng.normal(size=n), 10.0 ** rng.uniform(-4.0, 4.0, n)
    scaled = replace(
        model,
        transition=units[:, None] * model.transition / units,
        input_now=units[:, None] * model.input_now,
        input_next=units[:, None] * model.input_next,
        drift=units * model.drift,
        output=model.output / units,
        process_cov=units[:, None] * model.process_cov * units,
        cross_cov=units[:, None] * model.cross_cov,
        noise_process_cov=model.noise_process_cov * units,
    )
    expected = kalman_filter(model, experiment, InitialState.known(mean, 1.0)).log_likelihood
    found = kalman_filter(scaled, experiment, InitialState.known(units * mean, units)).log_likelihood
    assert found == pytest.approx(expected, rel=1e-11)
