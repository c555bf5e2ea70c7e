"""Compiled Kalman steps are those in numpy, which are the textbook's."""

import numpy as np
import pytest

from daest.numerics import kalman_pass
from daest.numerics.kalman_pass import StepMatrices, Stop, kalman_steps


def drawn(n, n_y, n_w, n_modes, seed=0):
    """A stable model with correlated noise, and others with outputs that are missing."""
    rng = np.random.default_rng(seed)
    Phi = np.linalg.qr(rng.standard_normal((n, n)))[0] * rng.uniform(0.2, 0.95, n)
    C, G, H = rng.standard_normal((n_y, n)), rng.standard_normal((n, n_w)), rng.standard_normal((n_y, n_w))
    R = H @ H.T + np.diag(rng.uniform(0.1, 1.0, n_y))
    seen = rng.integers(0, 2, (n_modes, n_y)).astype(float)
    seen[0] = 1.0
    many = np.ones((n_modes, 1, 1))
    return StepMatrices(
        Phi * many,
        C * seen[:, :, None],
        (G @ G.T) * many,
        (G @ H.T) * seen[:, None, :],
        R * seen[:, :, None] * seen[:, None, :] + np.eye(n_y) * (1.0 - seen[:, :, None]),
        np.eye(n_w) * many,
        (H.T * many) * seen[:, None, :],
    )


@pytest.mark.parametrize(
    ("n", "n_y", "n_w", "columns"),
    [
        (1, 1, 1, 1),
        (4, 2, 2, 1),
        (4, 3, 1, 5),
        (7, 2, 3, 4),
        (11, 3, 2, 1),
        (19, 1, 2, 3),
        (37, 3, 2, 1),
        pytest.param(203, 2, 2, 1, marks=pytest.mark.slow),
    ],
)
def test_compiled_steps_are_those_of_numpy(monkeypatch, n, n_y, n_w, columns):
    rng = np.random.default_rng(n)
    matrices, mode = drawn(n, n_y, n_w, 3), np.r_[np.zeros(40, dtype=np.int64), rng.integers(0, 3, 60)]
    signals = rng.standard_normal((100, n_y)), rng.standard_normal((100, n))
    start = rng.standard_normal((n, columns)), 3.0 * np.eye(n)
    if kalman_pass._library(n) is None:
        pytest.skip("no C compiler")
    compiled = kalman_steps(matrices, mode, *signals, *start)
    monkeypatch.setattr(kalman_pass, "_library", lambda _: None)
    expected = kalman_steps(matrices, mode, *signals, *start)
    for name, value in vars(expected).items():
        found = getattr(compiled, name)
        assert (found is None) == (value is None)
        if isinstance(value, np.ndarray):
            assert np.max(np.abs(found - value), initial=0.0) <= 1e-11 * np.max(np.abs(value), initial=1.0)


@pytest.mark.parametrize(
    ("slow", "compiled"),
    [(0.9, True), (0.9, False), (0.999, True), pytest.param(0.999, False, marks=pytest.mark.slow)],
)
def test_stop_is_as_close_to_the_limit_as_it_says(monkeypatch, compiled, slow):
    """A slow mode next to fast ones: small changes alone would end the transient too early."""
    if not compiled:
        monkeypatch.setattr(kalman_pass, "_library", lambda _: None)
    n, limit, n_samples = 4, 1e-9, 40_000
    Phi = np.diag([slow, 0.5, 0.3, 0.1])
    one = [np.array(a)[None] for a in (Phi, np.ones((1, n)), 1e-6 * np.eye(n), np.zeros((n, 1)), [[1.0]])]
    matrices = StepMatrices(*one, np.zeros((1, 0, 0)), np.zeros((1, 0, 1)))
    mode, zeros = np.zeros(n_samples, dtype=np.int64), np.zeros((n_samples, n))
    stop = Stop(limit, np.ones(n_samples, dtype=bool), np.zeros((0, n, n)), np.zeros(0, dtype=bool))
    found = kalman_steps(
        matrices, mode, zeros[:, :1], zeros, zeros[:1].T * np.ones((n, 1)), np.eye(n), stop=stop
    )
    assert found.is_stationary and found.gain.shape[0] < n_samples
    P = found.cov[-1]
    from scipy.linalg import solve_discrete_are

    exact = solve_discrete_are(Phi.T, np.ones((n, 1)), 1e-6 * np.eye(n), np.eye(1))
    size = np.sqrt(np.diagonal(exact))
    assert np.max(np.abs(P - exact) / np.outer(size, size)) < 2 * limit


def test_outputs_without_any_noise_are_told():
    matrices = drawn(3, 1, 1, 1)
    still = StepMatrices(*(0.0 * part for part in matrices.arrays()))
    zeros = np.zeros((5, 3))
    found = kalman_steps(
        still, np.zeros(5, dtype=np.int64), zeros[:, :1], zeros, zeros[:1].T + np.zeros((3, 1)), np.eye(3)
    )
    assert found.failed == 0


@pytest.mark.parametrize("n", [3, 4])
def test_constant_gain(monkeypatch, n):
    rng = np.random.default_rng(n)
    shapes = [(n, n), (n, 2), (2, n), (2, 2), (n + 1, 2)]
    closed, gain, output, root, filter_gain = (0.3 * rng.standard_normal(shape) for shape in shapes)
    steps = kalman_pass.ConstantGain(closed, gain, output, np.tril(root), filter_gain)
    z, drive, x = rng.standard_normal((300, 2)), rng.standard_normal((300, n)), rng.standard_normal(n)
    for known in (drive, np.broadcast_to(0.0, drive.shape)):
        shapes = [(300, n), (300, 2), (300,), (300, n + 1)]
        found, expected = ([np.empty(shape) for shape in shapes] for _ in range(2))
        found.append(steps.over(z, known, x, tuple(found)))
        with monkeypatch.context() as patch:
            patch.setattr(kalman_pass, "_library", lambda _: None)
            expected.append(steps.over(z, known, x, tuple(expected)))
        for one, other in zip(found, expected, strict=True):
            assert np.allclose(one, other, rtol=0, atol=1e-12)
