"""Integrals of large systems, by series and doubling, against the exponentials of block matrices."""

import numpy as np
import pytest
from scipy.linalg import expm

from daest.numerics import exponential
from daest.numerics.exponential import (
    LARGE,
    balanced,
    covariance_integral,
    covariance_integral_derivatives,
    transition_integral_derivatives,
    transition_integrals,
)


def chain(n: int, stiffness: float) -> np.ndarray:
    """Masses on springs."""
    half = n // 2
    laplace = 2.0 * np.eye(half) - np.eye(half, k=1) - np.eye(half, k=-1)
    return np.block([[np.zeros((half, half)), np.eye(half)], [-stiffness * laplace, -0.3 * np.eye(half)]])


@pytest.mark.parametrize("stiffness", [4.0, 4e4])
def test_large_systems_in_unlike_units_agree_with_exponentials_of_blocks(stiffness, monkeypatch):
    n, period = LARGE + 4, 0.3
    A, G = chain(n, stiffness), np.zeros((n, 2))
    G[[n // 2 + 1, n - 3], [0, 1]] = 0.7, 1.9
    unit = np.where(np.arange(n) % 3 == 0, 1e5, 1.0)  # x = unit · z
    A_z, Q_z = A * unit / unit[:, None], G @ G.T / np.outer(unit, unit)
    found, cov = transition_integrals(A_z, period), covariance_integral(A_z, Q_z, period)
    full = covariance_integral(A, np.eye(n) + G @ G.T, period)
    monkeypatch.setattr(exponential, "LARGE", 10 * n)
    exact, plain = transition_integrals(A, period), covariance_integral(A, G @ G.T, period)
    for name in ("transition", "first", "second"):
        wanted, given = getattr(exact, name), getattr(found, name) * unit[:, None] / unit
        np.testing.assert_allclose(given, wanted, atol=1e-11 * np.abs(wanted).max(), rtol=0.0)
    size = np.sqrt(np.diagonal(plain))
    size = np.maximum(size, 1e-12 * size.max())  # the noise hardly reaches far masses
    assert np.all(np.abs(cov * np.outer(unit, unit) - plain) <= 1e-10 * np.outer(size, size))
    np.testing.assert_allclose(
        full, covariance_integral(A, np.eye(n) + G @ G.T, period), rtol=1e-9, atol=1e-12
    )


def test_the_covariance_of_few_noises_keeps_small_states():
    """A chain of integrators behind one noise: ∫ s^(i+j) / (i! j!) ds, many orders of magnitude."""
    n, period = LARGE, 0.5
    A = np.eye(n, k=-1)
    Q = np.zeros((n, n))
    Q[0, 0] = 2.0
    powers = np.arange(6)
    factorial = np.array([1.0, 1.0, 2.0, 6.0, 24.0, 120.0])
    total = powers[:, None] + powers
    exact = 2.0 * period ** (total + 1) / (total + 1) / np.outer(factorial, factorial)
    np.testing.assert_allclose(covariance_integral(A, Q, period)[:6, :6], exact, rtol=1e-12)
    np.testing.assert_allclose(transition_integrals(A, period).transition, expm(A * period), atol=1e-14)


def test_slopes_do_not_depend_on_units():
    A = np.array([[0.0, 1.0, 0.0], [-20.0, -0.5, 3.0], [1.0, 0.0, -2.0]])
    dA = np.array([[[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]])
    Q = np.diag([0.0, 1.0, 0.1])
    unit = np.array([1e8, 1.0, 1e-6])  # x = unit · z
    around, pair = unit[:, None] / unit, np.outer(unit, unit)
    plain = transition_integral_derivatives(A, dA, 0.02)
    found = transition_integral_derivatives(A / around, dA / around, 0.02)
    for name in ("transition", "first", "second"):
        np.testing.assert_allclose(getattr(found, name) * around, getattr(plain, name), rtol=1e-9, atol=1e-18)
    nothing = np.zeros((1, 3, 3))
    wanted = covariance_integral_derivatives(A, Q, dA, nothing, 0.02)
    given = covariance_integral_derivatives(A / around, Q / pair, dA / around, nothing, 0.02)
    np.testing.assert_allclose(given * pair, wanted, rtol=1e-9, atol=1e-20)


def test_balancing_tells_no_warning_about_units(recwarn):
    A = np.array([[-1.0, 1e40], [1e-40, -2.0]])
    scaled, size = balanced(A)
    assert scaled == pytest.approx(A * size / size[:, None])
    assert abs(scaled[0, 1]) == pytest.approx(abs(scaled[1, 0]), rel=15.0)
    assert not recwarn


@pytest.mark.parametrize("value", [np.inf, np.nan, 1e300])
def test_rates_that_overflow_have_no_transition(value, capfd, recwarn):
    A, Q = np.array([[0.0, 1.0], [-value, -1.0]]), np.eye(2)
    dA = np.stack([np.eye(2)])
    parts = transition_integrals(A, 0.1), transition_integral_derivatives(A, dA, 0.1)
    covs = covariance_integral(A, Q, 0.1), covariance_integral_derivatives(A, Q, dA, dA, 0.1)
    if not np.isfinite(value):  # else nothing but silence is asked for
        assert all(np.isnan(part.transition).all() for part in parts)
        assert all(np.isnan(cov).all() for cov in covs)
    assert capfd.readouterr() == ("", "")
    assert not recwarn


def test_rates_and_periods_whose_product_overflows():
    """A decay that is over at once: the noise has come to rest."""
    A, Q = np.array([[-1e300]]), np.array([[1.0]])
    for period in (1e-3, 1e10):
        np.testing.assert_allclose(covariance_integral(A, Q, period), 0.5e-300)


def test_nodes_of_periods_sum_to_what_every_period_has():
    rng = np.random.default_rng(3)
    A = np.array([[-1.0, 30.0], [-30.0, -1.0]])
    periods = np.concatenate([rng.uniform(0.05, 0.3, 200), np.full(5, 0.7), [0.7 + 1e-13]])
    found = np.full((periods.size, 2, 2), np.nan)
    groups = exponential.nodes_of_periods(A, periods, 1e-9)
    for group in groups:
        values = np.array([expm(A * node) for node in group.nodes])
        found[group.at] = np.tensordot(group.weights, values, 1)
    assert np.allclose(found, [expm(A * one) for one in periods], rtol=0.0, atol=1e-10)
    assert groups[-1].nodes.size == 1 and sum(group.nodes.size for group in groups) <= 4 * 20 + 1
    few = exponential.nodes_of_periods(A, periods[:150], 1e-9)
    assert len({tuple(one.nodes) for one in few} & {tuple(one.nodes) for one in groups}) >= 2


def test_models_without_states_have_no_transition_at_any_time():
    """The force of a spring that is stretched at uneven times had been an internal error."""
    assert exponential.beside(np.zeros((0, 0)), np.linspace(0.1, 0.11, 20)) is None


def test_dynamics_that_no_parameter_moves_have_derivatives_in_no_direction():
    """A battery between pulses, sampled as its voltage moves, with all time constants held, had been an
    internal error."""
    near = exponential.beside(np.diag([-1.0, -2.0]), np.linspace(0.1, 0.11, 20))
    none = np.zeros((0, 2, 2))
    assert near.derivatives(none).transition.shape == (20, 0, 2, 2)
    assert near.covariance_derivatives(np.eye(2), none, none).shape == (20, 0, 2, 2)
