"""Jacobians with full rows beside full columns, against CasADi's own."""

import casadi as ca
import numpy as np

from daest.systems.reduction.expand import MANY, sparse_jacobian


def test_full_rows_beside_full_columns():
    n = 3 * MANY
    x = ca.SX.sym("x", n)
    rows = [x[k] * x[n - 1] + ca.sin(x[(k + 1) % n]) for k in range(n)]
    rows.insert(7, ca.sum1(x**2))
    rows.insert(40, ca.sum1(x[: MANY + 3] * 2.0))
    expression = ca.vertcat(*rows)
    function = ca.Function("f", [x], [sparse_jacobian(expression, x), ca.jacobian(expression, x)])
    ours, casadis = function(np.random.default_rng(1).standard_normal(n))
    assert ours.sparsity() == casadis.sparsity()
    np.testing.assert_array_equal(ours.full(), casadis.full())
    light = ca.vertcat(*rows[:5])
    assert ca.is_equal(sparse_jacobian(light, x), ca.jacobian(light, x), 9)
