"""Expectations of tanh over a Gaussian against quadrature, and the expressions that they are put into."""

import casadi as ca
import numpy as np
import pytest

from daest.systems.simulation.gaussian_average import averaged


def quadrature(f, mean, std):
    nodes = np.linspace(-8.0, 8.0, 100_001)
    return np.trapezoid(f(mean + std * nodes) * np.exp(-(nodes**2) / 2), nodes) / np.sqrt(2 * np.pi)


def of(expression, x, cov):
    return ca.Function("averaged", [x, cov], [averaged(expression, x, cov)])


@pytest.mark.parametrize("mean", [0.0, 0.3, 1.0, 4.0])
@pytest.mark.parametrize("std", [0.0, 0.2, 1.0, 3.0, 30.0])
def test_step_and_its_slope_are_their_expectations(mean, std):
    x, P = ca.SX.sym("x"), ca.SX.sym("P")
    value = averaged(ca.tanh(x / 0.5), x, P)
    both = ca.Function("both", [x, P], [value, ca.jacobian(value, x)])
    found = [float(v) for v in both(0.5 * mean, (0.5 * std) ** 2)]
    assert found[0] == pytest.approx(quadrature(np.tanh, mean, std), abs=0.015)
    slope = quadrature(lambda a: 1 / np.cosh(np.clip(a, -300, 300)) ** 2, mean, std) / 0.5
    assert found[1] == pytest.approx(slope, abs=0.04 * 2.0 / np.sqrt(1 + std**2) + 1e-9)


def test_without_spread_nothing_changes():
    x, P, p = ca.SX.sym("x", 2), ca.SX.sym("P", 2, 2), ca.SX.sym("p")
    expression = ca.vertcat(
        3 * x[0] + ca.tanh(x[1] / p) * x[0] ** 2, ca.fmax(x[0], 2 * p), ca.if_else(x[0] > 0, x[1], p), 7.0
    )
    found = ca.Function("averaged", [x, P, p], [averaged(expression, x, P)])
    plain = ca.Function("plain", [x, p], [expression])
    for point in ([0.3, 0.2], [-0.4, 1.0]):
        assert np.array_equal(found(point, np.zeros((2, 2)), 0.1).full(), plain(point, 0.1).full())


def test_variance_is_that_of_the_argument():
    x, P = ca.SX.sym("x", 2), ca.SX.sym("P", 2, 2)
    cov = np.array([[0.4, -0.3], [-0.3, 0.5]])
    relative = of(ca.tanh(x[0] - 2 * x[1]), x, P)
    variance = np.array([1, -2]) @ cov @ np.array([1, -2])
    assert float(relative([0.7, 0.1], cov)) == pytest.approx(
        quadrature(np.tanh, 0.5, np.sqrt(variance)), abs=0.015
    )


def test_steps_of_inputs_stay_as_they_are():
    x, P, u = ca.SX.sym("x"), ca.SX.sym("P"), ca.SX.sym("u")
    found = ca.Function("averaged", [x, P, u], [averaged(x * ca.tanh(u), x, P)])
    assert float(found(2.0, 9.0, 0.3)) == pytest.approx(2.0 * np.tanh(0.3))


@pytest.mark.parametrize(("mean", "std"), [(0.3, 0.5), (-1.0, 2.0), (0.0, 1.0), (0.4, 0.0), (-0.1, 0.0)])
def test_sign_is_its_expectation(mean, std):
    x, P = ca.SX.sym("x"), ca.SX.sym("P")
    value = averaged(2 * ca.sign(x), x, P)
    found = ca.Function("both", [x, P], [value, ca.jacobian(value, x)])(mean, std**2)
    assert float(found[0]) == pytest.approx(2 * quadrature(np.sign, mean, std), abs=1e-3)
    density = np.exp(-((mean / std) ** 2) / 2) / (std * np.sqrt(2 * np.pi)) if std else 0.0
    assert float(found[1]) == pytest.approx(4 * density, rel=1e-9)
