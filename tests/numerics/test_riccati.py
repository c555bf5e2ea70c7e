"""Stationary covariances against closed forms."""

import warnings

import numpy as np
import pytest

from daest.numerics import recursions, riccati
from daest.numerics.exponential import covariance_integral, transition_integrals
from daest.numerics.riccati import (
    NoiseModel,
    filter_riccati,
    predictor_gain,
    unobservable_subspace,
    varying_gains,
)

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


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])  # of the last state
def test_a_state_that_no_noise_reaches_is_known_in_the_end(unit):
    # The temperature of a body, a load on it, and a lag of its heater, which nothing but the input drives.
    Phi = np.array([[0.99682, 1.6525e-3, 2.2782 / unit], [0.0, 0.60653, 0.0], [0.0, 0.0, 0.97243]])
    Q = np.zeros((3, 3))
    Q[:2, :2] = [[1.6597e-3, 1.05], [1.05, 1.0202e3]]
    C, R = np.array([[1.0, 0.0, 0.0]]), np.array([[5.565e-4]])
    P = filter_riccati(Phi, C, Q, R, np.zeros((3, 1)))
    alone = filter_riccati(Phi[:2, :2], C[:, :2], Q[:2, :2], R, np.zeros((2, 1)))
    assert P[:2, :2] == pytest.approx(alone, rel=1e-12)
    assert not P[2].any()
    assert not P[:, 2].any()


def test_pressures_in_pascals_beside_flows_that_hardly_any_noise_drives_are_solved():
    """Two oil volumes behind a hose, a moving mass, and loads at each: the filter had no gain there."""
    stiff, area, mass, passes = 6.5733e8, 0.0079, 1300.0, 1.0 / 2.708e8
    a, b = stiff / 0.003, stiff / 0.02385
    A = np.zeros((7, 7))
    A[0, [0, 2, 4]] = -a * (passes + 5e-12), a * passes, a
    A[1, 3] = 1.0
    A[2, [0, 2, 3, 5]] = b * passes, -b * passes, -area * b, b
    A[3, [2, 3, 6]] = area / mass, -5031.0 / mass, 1.0 / mass
    A[[4, 5, 6], [4, 5, 6]] = -50.0
    W = np.diag([0.0, 0.0, 0.0, 0.0, 7.1e-13, 9.9e-14, 7.93e6])
    C = np.eye(2, 7)
    Phi, Q = transition_integrals(A, 0.01).transition, covariance_integral(A, W, 0.01)
    arrays = (Phi, C, Q, np.diag([4.7e4**2, 1.04e-3**2]), np.zeros((7, 2)))
    P = filter_riccati(*arrays)
    assert P is not None
    K, S = predictor_gain(P, *(arrays[i] for i in (0, 1, 3, 4)))
    size = np.sqrt(P.diagonal())
    rest = Phi @ P @ Phi.T + Q - K @ S @ K.T - P
    assert np.max(np.abs(rest) / (size[:, None] * size)) < 1e-9
    assert np.sqrt(S[0, 0]) == pytest.approx(5.54e4, rel=0.01)


def test_a_state_that_no_noise_reaches_and_that_grows_is_followed_all_the_same():
    Phi, R = np.array([[0.9, 1.0], [0.0, 1.1]]), np.array([[1e-4]])
    P = filter_riccati(Phi, np.array([[1.0, 0.0]]), np.diag([1.0, 0.0]), R, np.zeros((2, 1)))
    assert P[1, 1] > 0.0


@pytest.mark.parametrize(
    ("Phi", "Q"),
    [
        ([[1.0, 0.0], [0.3, 0.8]], [[0.0, 0.0], [0.0, 0.1]]),
        ([[0.9, 0.1], [0.1, 0.9]], [[1.0, -1.0], [-1.0, 1.0]]),  # the noise reaches the difference alone
    ],
)
def test_a_mode_on_the_unit_circle_without_noise_is_refused_at_once(Phi, Q, monkeypatch):
    """Here the Schur method, which a search over parameters would ask for at every point, finds nothing."""
    C, R, S12 = np.eye(2), np.eye(2), np.zeros((2, 2))
    assert filter_riccati(np.array(Phi), C, np.array(Q), R, S12) is None
    monkeypatch.setattr(riccati, "_schur", lambda *_: pytest.fail("asked for"))
    assert filter_riccati(np.array(Phi), C, np.array(Q), R, S12) is None


def test_schur_vectors_that_leave_the_innovations_singular_are_no_solution(monkeypatch):
    """As here with P = -R, the step that refines P cannot divide by C P Cᵀ + R: a search for what a water
    turbine lacks, with values far off, ended with an internal error."""
    one = np.ones((1, 1))
    monkeypatch.setattr(riccati.scipy.linalg, "solve_discrete_are", lambda *_, **__: -one)
    monkeypatch.setattr(riccati, "_doubled", lambda *_: None)
    assert riccati.filter_riccati(1.5 * one, one, one, one, 0.0 * one) is None


def test_what_no_output_sees_is_found_once_for_one_model():
    Phi, C = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.0, 1.0]])
    _, hidden = unobservable_subspace(Phi, C)
    assert hidden[:, 0] / hidden[0, 0] == pytest.approx([1.0, 0.0], abs=1e-12)
    assert unobservable_subspace(Phi.copy(), C.copy())[1] is hidden
    assert unobservable_subspace(Phi, C[:, ::-1])[1].shape == (2, 0)


@pytest.mark.parametrize("varies", [False, True])
@pytest.mark.parametrize(("n", "n_y"), [(1, 1), (4, 2), (5, 3), (2, 16)])
def test_compiled_slopes_of_varying_gains_are_those_of_the_plain_steps(n, n_y, varies, monkeypatch):
    rng = np.random.default_rng(10 * n + n_y)
    p, n_samples = 3, 40
    steps = (n_samples - 1,) if varies else ()

    def covariance(size, *lead):
        root = rng.standard_normal((*lead, size, size))
        return root @ np.swapaxes(root, -1, -2)

    noise = NoiseModel(
        0.5 * rng.standard_normal((*steps, n, n)) / np.sqrt(n),
        rng.standard_normal((n_y, n)),
        covariance(n, *steps),
        covariance(n_y) + np.eye(n_y),
        0.1 * rng.standard_normal((*steps, n, n_y)),
    )
    change = NoiseModel(
        rng.standard_normal((p, *steps, n, n)),
        rng.standard_normal((p, n_y, n)),
        covariance(n, p, *steps),
        covariance(n_y, p),
        rng.standard_normal((p, *steps, n, n_y)),
    )
    observed = rng.random((n_samples, n_y)) > 0.2
    start = np.eye(n), covariance(n, p)
    compiled, moved = varying_gains(noise, change, observed, *start)
    monkeypatch.setattr(recursions, "_gain_library", lambda _: None)
    plain, expected = varying_gains(noise, change, observed, *start)
    for found, known in ((moved.K, expected.K), (moved.S, expected.S), (moved.P, expected.P)):
        assert found.shape == known.shape
        assert np.allclose(found, known, rtol=1e-9, atol=1e-9 * np.max(np.abs(known)))
    assert np.allclose(compiled.K, plain.K)
    # Of values alone nothing is computed sample by sample but these.
    monkeypatch.delattr(riccati, "_varying_slopes")
    none = NoiseModel(*(part[:0] for part in (change.Phi, change.C, change.Q, change.R, change.S12)))
    alone, nothing = varying_gains(noise, none, observed, start[0], start[1][:0])
    assert np.array_equal(alone.K, plain.K) and np.array_equal(alone.S, plain.S)
    assert [part.shape for part in (nothing.K, nothing.S, nothing.P)] == [
        (0, *part.shape) for part in (plain.K, plain.S, plain.P)
    ]
