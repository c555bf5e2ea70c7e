"""Stationary covariances against closed forms."""

import warnings

import numpy as np
import pytest

from daest.numerics.riccati import filter_riccati, unobservable_subspace

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


def test_what_no_output_sees_is_found_once_for_one_model():
    Phi, C = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.0, 1.0]])
    _, hidden = unobservable_subspace(Phi, C)
    assert hidden[:, 0] / hidden[0, 0] == pytest.approx([1.0, 0.0], abs=1e-12)
    assert unobservable_subspace(Phi.copy(), C.copy())[1] is hidden
    assert unobservable_subspace(Phi, C[:, ::-1])[1].shape == (2, 0)
