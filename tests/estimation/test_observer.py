"""The gain of the average linearisation against scipy's Riccati solver and against averages by hand."""

import casadi as ca
import numpy as np
import pytest
from nonlinear_models import explicit_from, linear_servo, oscillator
from scipy.linalg import expm, solve_discrete_are

from daest.estimation.nonlinear.observer import AverageModel, average_model, observer, sampled_average


def van_loan(A, Q, h):
    n = A.shape[0]
    block = expm(h * np.block([[-A, Q], [np.zeros((n, n)), A.T]]))
    transition = block[n:, n:].T
    return transition, transition @ block[:n, n:]


def test_average_over_a_linear_model_is_the_model():
    explicit = linear_servo()
    rng = np.random.default_rng(0)
    states, inputs = rng.standard_normal((50, 4)), rng.standard_normal((50, 1))
    found = average_model(explicit, explicit.flat.theta_values, 0.01 * np.arange(50), states, inputs)
    theta = explicit.flat.theta_values

    def rates(x, w):
        return np.array(explicit.rhs(x, [0.0], [], w, theta, 0.0)).ravel()

    assert pytest.approx(np.column_stack([rates(e, np.zeros(2)) for e in np.eye(4)]), abs=1e-9) == found.A
    assert pytest.approx(np.column_stack([rates(np.zeros(4), e) for e in np.eye(2)]), abs=1e-9) == found.G
    assert pytest.approx(np.array([[1.0, 0, 0, 0], [0, 0, 0, 1.0]])) == found.C
    assert found.period == pytest.approx(0.01)


def test_average_is_the_mean_slope_along_the_motion():
    explicit = oscillator()
    x = np.linspace(-1.0, 1.0, 101)
    states = np.column_stack([x, 0 * x])
    found = average_model(
        explicit, explicit.flat.theta_values, 0.1 * np.arange(101), states, np.zeros((101, 1))
    )
    assert found.A[1] == pytest.approx([-4.0 - 3 * 2.0 * np.mean(x**2), -0.5])


def test_angle_behind_a_gear_that_no_output_sees_stays_unseen():
    """The mean of equal slopes is the slope, or the rounding of the sum would show the speeds where the
    shafts stand, and nothing would hold the stationary covariance of that."""
    ratio, c, d, Jr, Jg = 0.05, 44661.69774936412, 131.9398018963725, 314.8399791773138, 0.6340781245947232
    explicit = explicit_from(
        ("phi", "w", "phi_g", "w_g"), {},
        lambda x, u, w, theta, t: [
            x[1],
            (w[0] - c * (x[0] - ratio * x[2]) - d * (x[1] - ratio * x[3])) / Jr,
            x[3],
            ratio * (c * (x[0] - ratio * x[2]) + d * (x[1] - ratio * x[3])) / Jg,
        ],
        {"speed": lambda x, u, theta: x[1], "speed_g": lambda x, u, theta: x[3]}, ("w",),
    )  # fmt: skip
    states, time = np.random.default_rng(0).standard_normal((1000, 4)), 0.02 * np.arange(1000)
    none = np.zeros(0)
    found = average_model(explicit, none, time, states, np.zeros((1000, 1)))
    of_two = average_model(explicit, none, time[:2], states[:2], np.zeros((2, 1)))
    assert found.exact is not None and np.array_equal(found.exact.A, of_two.A)
    assert observer(found, np.array([1e3]), np.array([0.005, 0.1])) is not None


def test_friction_has_the_slope_it_has_over_the_motion():
    """tanh(v / 0.01): enormous at rest, none while moving."""
    explicit = explicit_from(
        ("v",), {"stick": 0.2}, lambda x, u, w, theta, t: [u[0] + w[0] - theta[0] * ca.tanh(x[0] / 0.01)],
        {"y": lambda x, u, theta: x[0]}, ("w",),
    )  # fmt: skip
    v = np.linspace(-1.0, 1.0, 2001)
    found = average_model(explicit, np.array([0.2]), 0.1 * np.arange(2001), v[:, None], np.zeros((2001, 1)))
    # The mean slope over an interval is the difference of the ends over its length.
    assert found.A[0, 0] == pytest.approx(-0.2 * np.tanh(100.0) / 1.0, rel=0.01)


def test_gain_is_scipys():
    A = np.array([[0.0, 1.0], [-4.0, -0.5]])
    G, C = np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    model = AverageModel(A, G, C, 0.1)
    found = observer(model, np.array([0.3]), np.array([0.05]))
    transition, Q = van_loan(A, 0.3 * G @ G.T, 0.1)
    P = solve_discrete_are(transition.T, C.T, Q, np.array([[0.0025]]))
    S = C @ P @ C.T + 0.0025
    assert found.innovation_cov == pytest.approx(S, rel=1e-8)
    assert found.gain == pytest.approx(P @ C.T / S, rel=1e-8)
    sampled = sampled_average(model, np.array([0.3]), np.array([0.05]))
    assert sampled.transition == pytest.approx(transition, rel=1e-9)
    assert sampled.process_cov == pytest.approx(Q, rel=1e-7)


def test_gain_depends_on_the_ratio_of_the_noises_only():
    model = AverageModel(np.array([[-1.0]]), np.eye(1), np.eye(1), 0.1)
    one, ten = (observer(model, np.array([0.3 * k]), np.array([0.1 * np.sqrt(k)])) for k in (1.0, 10.0))
    assert one.gain == pytest.approx(ten.gain, rel=1e-9)
    assert 10 * one.innovation_cov == pytest.approx(ten.innovation_cov, rel=1e-9)


def test_integrator_without_noise_is_known_beside_what_noise_drives():
    """The charge of a cell, whose start is estimated, and a polarisation that a load drives."""
    A, noisy = np.diag([0.0, -0.2]), np.array([[0.0], [1.0]])
    found = observer(AverageModel(A, noisy, np.array([[1.0, -1.0]]), 0.1), np.array([0.3]), np.array([0.1]))
    alone = observer(
        AverageModel(A[1:, 1:], noisy[1:], np.array([[-1.0]]), 0.1), np.array([0.3]), np.array([0.1])
    )
    np.testing.assert_allclose(found.gain, np.vstack([[[0.0]], alone.gain]), rtol=1e-10)
    np.testing.assert_allclose(found.innovation_cov, alone.innovation_cov, rtol=1e-10)
    still = observer(AverageModel(np.zeros((1, 1)), np.ones((1, 1)), np.eye(1), 0.1), np.zeros(1), np.ones(1))
    np.testing.assert_array_equal(still.gain, 0.0)


def test_mode_that_grows_without_noise_is_held():
    growing = AverageModel(np.array([[0.5]]), np.ones((1, 1)), np.eye(1), 0.1)
    held = observer(growing, np.zeros(1), np.array([0.1]))
    assert abs(np.exp(0.05) * (1.0 - held.gain[0, 0])) == pytest.approx(np.exp(-0.05))


def test_infinite_jacobian_has_no_gain():
    assert (
        observer(AverageModel(np.array([[np.inf]]), np.eye(1), np.eye(1), 0.1), np.ones(1), np.ones(1))
        is None
    )
