"""The compiled loop of a step, against the loop in NumPy, finite differences, and the interpreted loop."""

import casadi as ca
import numpy as np
import pytest

from daest.systems.fold import fold, run_fold, run_fold_tangents


def step(s, d, c):
    return np.array([np.cos(s[0]) * c[0] + d[0], s[0] * s[1] * 0.3 + d[1]]), np.array(
        [s[0] - c[1] * s[1] ** 2]
    )


@pytest.fixture(params=[True, False], ids=["compiled", "interpreted"])
def loop(request):
    s, d, c = ca.SX.sym("s", 2), ca.SX.sym("d", 2), ca.SX.sym("c", 2)
    after = ca.vertcat(ca.cos(s[0]) * c[0] + d[0], s[0] * s[1] * 0.3 + d[1])
    made = fold(s, d, c, after, s[0] - c[1] * s[1] ** 2, compiled=request.param)
    assert (made.library is not None) == request.param
    return made


START, CONSTANTS = np.array([0.3, -0.2]), np.array([0.8, 0.4])
DATA = np.random.default_rng(0).standard_normal((40, 2))


def test_is_the_loop(loop):
    found, end = run_fold(loop, START, DATA, CONSTANTS)
    s = START
    for k, d in enumerate(DATA):
        s, out = step(s, d, CONSTANTS)
        assert np.allclose(found[k], out, rtol=1e-12)
    assert np.allclose(end, s, rtol=1e-12)


def test_tangents_are_finite_differences(loop):
    ds0, dc = np.array([[1.0, 0.0], [0.0, 0.0], [0.3, -1.0]]), np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 2.0]])
    found, tangents, _ = run_fold_tangents(loop, START, DATA, CONSTANTS, ds0, dc)
    assert np.allclose(found, run_fold(loop, START, DATA, CONSTANTS)[0])
    h = 1e-6
    for j in range(3):
        up, down = (run_fold(loop, START + e * ds0[j], DATA, CONSTANTS + e * dc[j])[0] for e in (h, -h))
        assert np.allclose(tangents[:, j], (up - down) / (2 * h), rtol=1e-6, atol=1e-8)
