"""Functions along recordings, against calls sample by sample."""

import casadi as ca
import numpy as np

from daest.numerics.evaluator import along


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
