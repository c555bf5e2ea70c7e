"""Unscented Kalman filter: the Kalman filter on linear models, filterpy on a nonlinear one, the loop in
NumPy."""

import numpy as np
import pytest
from nonlinear_models import friction_servo, linear_servo, oscillator, random_record, time_grid
from test_ekf import EQUAL, NOISE, START, kalman

from daest.estimation.filter_engines.ekf import run_ekf
from daest.estimation.filter_engines.filter_task import Noise, Start, record
from daest.estimation.filter_engines.nonlinear_smoother import smooth_ekf, smooth_ukf
from daest.estimation.filter_engines.ukf import SigmaPoints, run_ukf
from daest.systems.simulation.local_linear import local_model


@pytest.mark.parametrize("points", [SigmaPoints(), SigmaPoints(0.5, 2.0, 0.0)])
def test_is_the_kalman_filter_on_a_linear_model(points):
    explicit, n = linear_servo(), 300
    model = local_model(explicit)
    for hold, irregular in (("zoh", False), ("foh", True)):
        time, (u, y) = time_grid(n, 0.005, irregular), random_record(n, 2)
        known = kalman(explicit, time, u, y, hold)
        data = record(model, time, u, y, hold)
        found = run_ukf(model, data, explicit.flat.theta_values, NOISE, START, points=points)
        std = np.sqrt(np.diagonal(found.filtered_cov, axis1=1, axis2=2))
        pair = std[:, :, None] * std[:, None, :]
        assert np.max(np.abs(found.filtered - known.filtered.mean[:, :4]) / std) < EQUAL
        assert np.max(np.abs(found.filtered_cov - known.filtered.cov.array()[:, :4, :4]) / pair) < EQUAL
        assert found.log_likelihood == pytest.approx(known.log_likelihood, abs=EQUAL)
        assert np.allclose(found.nis, np.nan_to_num(known.nis), rtol=1e-7)


def test_smoother_is_that_of_the_extended_filter_on_a_linear_model():
    explicit, n = linear_servo(), 200
    time, (u, y) = time_grid(n, 0.005), random_record(n, 2)
    model = local_model(explicit)
    data, theta = record(model, time, u, y, "foh"), explicit.flat.theta_values
    known = smooth_ekf(run_ekf(model, data, theta, NOISE, START), data, NOISE)
    found = smooth_ukf(run_ukf(model, data, theta, NOISE, START), data, NOISE)
    std = np.sqrt(np.diagonal(known.cov, axis1=1, axis2=2))
    pair = std[:, :, None] * std[:, None, :]
    assert np.max(np.abs(found.mean - known.mean) / std) < EQUAL
    assert np.max(np.abs(found.cov - known.cov) / pair) < EQUAL


def test_update_and_spread_are_those_of_filterpy():
    """One interval of the oscillator with fine steps: filterpy's points through scipy's integrator."""
    filterpy = pytest.importorskip("filterpy.kalman")
    from scipy.integrate import solve_ivp

    explicit = oscillator()
    model = local_model(explicit)
    time, u = np.array([0.0, 0.3, 0.6]), np.array([[1.0], [1.0], [1.0]])
    y = np.array([[0.8], [0.5], [0.1]])
    start = Start(np.array([1.0, 0.0]), np.array([[0.2, 0.05], [0.05, 0.3]]))
    silent = Noise(np.zeros(1), np.array([0.01]))
    theta = explicit.flat.theta_values
    found = run_ukf(
        model, record(model, time, u, y, "zoh"), theta, silent, start, 0.3 / 500, SigmaPoints(1.0, 2.0, 1.0)
    )
    peer = filterpy.UnscentedKalmanFilter(
        2, 1, 0.3, lambda x: x[:1],
        lambda x, dt: solve_ivp(
            lambda t, s: [s[1], 1.0 - theta[0] * s[0] - theta[1] * s[1] - theta[2] * s[0] ** 3],
            (0, dt), x, rtol=1e-10, atol=1e-12,
        ).y[:, -1],
        filterpy.MerweScaledSigmaPoints(2, 1.0, 2.0, 1.0),
    )  # fmt: skip
    peer.x, peer.P, peer.R, peer.Q = start.mean.copy(), start.cov.copy(), np.array([[0.01]]), np.zeros((2, 2))
    for k in range(3):
        # filterpy updates with the points of its last prediction; drawn anew they are those of the
        # covariance.
        peer.sigmas_f = peer.points_fn.sigma_points(peer.x, peer.P)
        peer.update(y[k])
        assert np.allclose(found.filtered[k], peer.x, atol=2e-6)
        assert np.allclose(found.filtered_cov[k], peer.P, atol=2e-6)
        peer.predict()


def test_loop_without_compiler_gives_the_same():
    explicit = friction_servo()
    time, (u, y) = time_grid(20, 0.005, irregular=True), random_record(20, 2)
    runs = []
    for compiled in (True, False):
        model = local_model(explicit, compiled=compiled)
        runs.append(
            run_ukf(model, record(model, time, u, y, "foh"), explicit.flat.theta_values, NOISE, START, 0.003)
        )
    for name in set(runs[0].__dataclass_fields__) - {"modes", "last_mode"}:
        assert np.allclose(*(getattr(r, name) for r in runs), rtol=1e-9, atol=1e-13, equal_nan=True), name


def test_a_certain_state_stays_certain():
    """A start without uncertainty and no process noise: singular covariances all the way."""
    explicit = oscillator()
    model = local_model(explicit)
    time, (u, y) = time_grid(30, 0.1), random_record(30, 1, missing=0.0)
    certain = Start(np.array([1.0, 0.0]), np.zeros((2, 2)))
    found = run_ukf(
        model,
        record(model, time, u, y, "zoh"),
        explicit.flat.theta_values,
        Noise(np.zeros(1), np.ones(1)),
        certain,
    )
    rounding = 1e-28  # squares of the rounding of a weighted mean
    assert np.max(np.abs(found.filtered_cov)) < rounding
    assert np.allclose(found.filtered, found.predicted, rtol=0, atol=1e-13)
