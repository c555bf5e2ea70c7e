"""Integrals of large systems, by series and doubling, against the exponentials of block matrices."""

import numpy as np
import pytest
from scipy.linalg import expm

from daest.numerics import exponential
from daest.numerics.exponential import LARGE, covariance_integral, transition_integrals


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
