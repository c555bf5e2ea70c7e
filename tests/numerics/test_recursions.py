"""linear_recursion against the plain loop and against scipy.signal."""

import time

import numpy as np
import pytest
from scipy.signal import lfilter

from daest.numerics import recursions
from daest.numerics.recursions import (
    linear_recursion,
    products_along,
    varying_recursion,
)


def plain_loop(A, drive, x0):
    states = [x0]
    for row in drive:
        states.append(A @ states[-1] + row)
    return np.array(states)


def matrix_with_radius(rng, n, radius):
    A = rng.standard_normal((n, n))
    return A * (radius / np.max(np.abs(np.linalg.eigvals(A))))


@pytest.fixture(params=[True, False], ids=["compiled", "in blocks"])
def engine(request, monkeypatch):
    if not request.param:
        monkeypatch.setattr(recursions, "_library", lambda _: None)


@pytest.mark.parametrize("radius", [0.3, 0.99, 1.0, 1.02])
@pytest.mark.parametrize("n_steps", [1, 7, 48, 49, 1000, 5003])
@pytest.mark.parametrize("n", [1, 4, 11, 40])
def test_states_equal_the_plain_loop(engine, n, n_steps, radius):
    rng = np.random.default_rng(n * n_steps)
    A = matrix_with_radius(rng, n, radius)
    drive = rng.standard_normal((n_steps, n))
    x0 = rng.standard_normal(n)
    expected = plain_loop(A, drive, x0)
    states = linear_recursion(A, drive, x0)
    assert states.shape == (n_steps + 1, n)
    scale = np.maximum.accumulate(np.max(np.abs(expected), axis=1))
    assert np.max(np.abs(states - expected) / scale[:, None]) < 1e-10


def test_scalar_case_equals_scipy_lfilter():
    rng = np.random.default_rng(3)
    drive = rng.standard_normal(10_000)
    states = linear_recursion(np.array([[0.97]]), drive[:, None], np.zeros(1))
    assert np.allclose(states[1:, 0], lfilter([1.0], [1.0, -0.97], drive), rtol=1e-11, atol=1e-11)


def test_right_hand_sides_are_independent():
    rng = np.random.default_rng(5)
    A = matrix_with_radius(rng, 3, 0.95)
    drive = rng.standard_normal((2, 4, 700, 3))
    x0 = rng.standard_normal((4, 3))
    states = linear_recursion(A, drive, x0)
    assert states.shape == (2, 4, 701, 3)
    for i in range(2):
        for j in range(4):
            assert np.allclose(states[i, j], plain_loop(A, drive[i, j], x0[j]), rtol=1e-10, atol=1e-10)


def test_unexcited_unstable_mode_stays_at_zero():
    A = np.diag([3.0, 0.5])
    drive = np.zeros((5000, 2))
    drive[:, 1] = 1.0
    states = linear_recursion(A, drive, np.zeros(2))
    assert np.all(states[:, 0] == 0.0)
    assert states[-1, 1] == pytest.approx(2.0)


def test_no_states_and_no_steps():
    assert linear_recursion(np.zeros((0, 0)), np.zeros((5, 0)), np.zeros(0)).shape == (6, 0)
    assert linear_recursion(np.eye(2), np.zeros((0, 2)), np.ones(2)).tolist() == [[1.0, 1.0]]


def test_a_million_samples_take_a_fraction_of_a_second():
    rng = np.random.default_rng(7)
    A = matrix_with_radius(rng, 4, 0.98)
    drive = rng.standard_normal((1_000_000, 4))
    started = time.process_time()
    linear_recursion(A, drive, np.zeros(4))
    # About 0.1 s on a free core; a Python step per sample would take more than 2 s.
    assert time.process_time() - started < 1.0


def test_matrices_that_vary_equal_the_plain_loop(engine):
    rng = np.random.default_rng(4)
    for n, n_y in ((1, 1), (5, 2), (16, 16), (17, 3)):
        A = 0.4 * rng.standard_normal((60, n, n)) / np.sqrt(n)
        drive = rng.standard_normal((3, 60, n))
        x = rng.standard_normal((3, n))
        states = varying_recursion(A, drive, x)
        np.testing.assert_array_equal(varying_recursion(A, drive)[:, 0], np.zeros((3, n)))
        for k in range(60):
            x = x @ A[k].T + drive[:, k]
            np.testing.assert_allclose(states[:, k + 1], x, rtol=1e-12, atol=1e-12)
        C = rng.standard_normal((61, n_y, n))
        expected = np.einsum("kyn,rkn->rky", C, states)
        np.testing.assert_allclose(products_along(states, C), expected, rtol=1e-12, atol=1e-12)
