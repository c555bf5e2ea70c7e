"""Functions along recordings, against calls sample by sample."""

import casadi as ca
import numpy as np

from daest.numerics.evaluator import along, repeated


def test_function_along_samples_is_that_of_every_sample():
    x, theta, t = ca.SX.sym("x", 2), ca.SX.sym("theta", 3), ca.SX.sym("t")
    table = ca.SX(2, 2)
    table[0, 0], table[1, 1] = theta[0] * x[0] ** 2, ca.sin(x[1] + t)
    law = ca.Function("law", [x, theta, t], [table, ca.vertcat(theta[1] + x[0], theta[2])])
    rng = np.random.default_rng(1)
    states, values, time = rng.normal(size=(7, 2)), rng.normal(size=3), np.arange(7.0)
    sparse, dense = along(law, [states, values, time[:, None]])
    assert sparse.shape == (7, 2) and dense.shape == (7, 2)
    for k in range(7):
        whole, column = law(states[k], values, time[k])
        np.testing.assert_allclose(np.diag(np.array(whole)), sparse[k])
        np.testing.assert_allclose(np.array(column).ravel(), dense[k])


def test_repeated_steps_are_those_one_after_the_other():
    x, u, theta = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("theta", 2)
    step = ca.Function("step", [x, u, theta], [ca.vertcat(x[1] + u, ca.sin(x[0]) * theta[0])])
    u_all, start, values = np.linspace(-1.0, 1.0, 9)[:, None], np.array([0.3, -0.2]), np.array([0.7, 0.0])
    states = repeated(step, start, [u_all, values])
    assert states.shape == (10, 2)
    np.testing.assert_array_equal(states[0], start)
    for k in range(9):
        np.testing.assert_allclose(states[k + 1], np.array(step(states[k], u_all[k], values)).ravel())
