"""Stationary covariances against closed forms."""

import warnings

import numpy as np
import pytest

from daest.numerics.riccati import filter_riccati

UNIT = 1e6  # of the third state: a slope of the second that is counted in millionths


@pytest.mark.parametrize("q", [1e-26, 1e-23])
def test_next_to_no_noise_on_an_integrator_is_solved_without_a_warning(q):
    # An unstable mode without noise needs the Schur method: P = (a² - 1) R. An integrator: P = √(q R).
    Phi, R = np.array([[1.1, 0.0, 0.0], [0.0, 1.0, UNIT], [0.0, 0.0, 0.5]]), 1e-4
    Q = np.diag([0.0, q, 1e-6 * q / UNIT**2])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        P = filter_riccati(Phi, np.eye(3)[:2], Q, R * np.eye(2), np.zeros((3, 2)))
    assert np.diagonal(P)[:2] == pytest.approx([(1.1**2 - 1.0) * R, np.sqrt(q * R)], rel=1e-4)
