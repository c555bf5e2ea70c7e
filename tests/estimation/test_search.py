"""Bounded Fisher scoring against SciPy and closed forms."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from daest.estimation.fitting import search
from daest.estimation.fitting.search import Evaluation, Found, _Course, _leaped, minimise, whole_step
from daest.estimation.nonlinear.nonlinear_start import _as_far_as_seen

FREE = np.full(2, np.inf)


def squares(residuals, jacobian, fails=lambda z: False):
    """Objective |residuals|² / 2 that has no value where `fails`."""

    def objective(z, with_slopes):
        if fails(z):
            return None
        r = residuals(z)
        if not with_slopes:
            return Evaluation(float(r @ r) / 2)
        J = jacobian(z)
        return Evaluation(float(r @ r) / 2, J.T @ r, J.T @ J)

    return objective


def rosenbrock(z):
    return np.array([10.0 * (z[1] - z[0] ** 2), 1.0 - z[0]])


def rosenbrock_slopes(z):
    return np.array([[-20.0 * z[0], 10.0], [-1.0, 0.0]])


@pytest.mark.parametrize("start", [(-1.2, 1.0), (3.0, -4.0), (-8.0, 60.0)])
def test_curved_valley_is_followed_to_its_minimum(start):
    found = minimise(squares(rosenbrock, rosenbrock_slopes), np.array(start), -FREE, FREE, 200)
    assert found.reason == "converged"
    # The search stops when the next step would gain less than 1e-6.
    assert np.allclose(found.z, 1.0, atol=5e-3)


def test_search_ends_where_its_goal_is_out_of_reach():
    objective, calls = squares(rosenbrock, rosenbrock_slopes), []

    def counted(z, with_slopes):
        calls.append(z)
        return objective(z, with_slopes)

    start = np.array([-1.2, 1.0])
    whole = minimise(counted, start, -FREE, FREE, 200)
    n_whole = len(calls)
    # All there is to gain is less than 20; the minimum is 0.
    assert objective(start, False).value < 20.0
    missed = minimise(counted, start, -FREE, FREE, 200, goal=-1e6)
    assert missed.reason == "stalled" and len(calls) - n_whole == 1
    reached = minimise(counted, start, -FREE, FREE, 200, goal=1e-6)
    assert reached.reason == "converged" and np.array_equal(reached.z, whole.z)


def test_search_ends_where_its_last_steps_have_gained_too_little_to_reach_its_goal():
    """Where the surface is rough, each step promises more than it brings: here 0.5 for 0.11."""

    def rough(z, with_slopes):
        return Evaluation(0.11 * float(z[0]), *((np.ones(1), np.eye(1)) if with_slopes else ()))

    start, free = np.array([1000.0]), np.full(1, np.inf)
    whole = minimise(rough, start, -free, free, 40)
    assert whole.iterations == 40 and whole.evaluation.value > 100.0
    missed = minimise(rough, start, -free, free, 40, goal=90.0)  # 40 steps promise 20
    assert missed.reason == "stalled" and missed.iterations < 20
    reached = minimise(rough, start, -free, free, 40, goal=whole.evaluation.value)
    assert reached.iterations == 40


def test_bounded_minimum_equals_scipy():
    upper = np.array([0.5, np.inf])
    found = minimise(squares(rosenbrock, rosenbrock_slopes), np.array([-1.2, 1.0]), -FREE, upper, 200)
    expected = least_squares(rosenbrock, [-1.2, 1.0], bounds=(-FREE, upper), xtol=1e-12, gtol=1e-12)
    assert found.reason == "converged"
    assert np.allclose(found.z, expected.x, atol=1e-3)
    assert found.z[0] == 0.5


def test_steps_into_places_without_a_value_are_shortened():
    # log(z) has no value at z <= 0; the full first step from 3 leads to -0.3.
    objective = squares(
        lambda z: np.array([np.log(z[0])]), lambda z: np.array([[1.0 / z[0]]]), lambda z: z[0] <= 0.0
    )
    found = minimise(objective, np.array([3.0]), -FREE[:1], FREE[:1])
    assert found.reason == "converged"
    assert found.z[0] == pytest.approx(1.0, abs=2e-3)


def test_a_start_without_a_value_is_told():
    objective = squares(rosenbrock, rosenbrock_slopes, lambda z: True)
    assert minimise(objective, np.zeros(2), -FREE, FREE) is None


def test_a_coordinate_without_influence_stays():
    objective = squares(lambda z: np.array([z[0] - 2.0]), lambda z: np.array([[1.0, 0.0]]))
    found = minimise(objective, np.array([0.0, 7.0]), -FREE, FREE)
    assert found.reason == "converged"
    assert found.z == pytest.approx([2.0, 7.0], abs=2e-3)


def test_a_wrong_gradient_ends_as_stalled():
    objective = squares(rosenbrock, lambda z: -rosenbrock_slopes(z))
    assert minimise(objective, np.array([-1.2, 1.0]), -FREE, FREE).reason == "stalled"


def test_few_iterations_are_told():
    objective = squares(rosenbrock, rosenbrock_slopes)
    found = minimise(objective, np.array([-1.2, 1.0]), -FREE, FREE, max_iterations=2)
    assert found.reason == "iteration limit"
    assert found.iterations == 2


def test_no_point_is_evaluated_twice_where_every_first_trial_is_better():
    asked = []

    def told(z, with_slopes):
        asked.append((float(z[0]), with_slopes))
        return squares(lambda z: z - 5.0, lambda z: np.eye(1))(z, with_slopes)

    found = minimise(told, np.array([-3.0]), -FREE[:1], FREE[:1])
    assert found.reason == "converged" and found.z[0] == pytest.approx(5.0, abs=2e-3)
    assert len(asked) == found.iterations + 1 and all(with_slopes for _, with_slopes in asked)


def test_slopes_that_do_not_exist_stop_no_search():
    def objective(z, with_slopes):
        is_edge = abs(z[0]) < 1.0 and with_slopes
        return None if is_edge else squares(lambda z: z - 5.0, lambda z: np.eye(1))(z, with_slopes)

    found = minimise(objective, np.array([-3.0]), -FREE[:1], FREE[:1])
    assert found.z[0] == pytest.approx(5.0, abs=2e-3)


def test_the_end_of_a_search_always_has_slopes():
    """The minimum itself has none: the search ends at the last point that has."""

    def objective(z, with_slopes):
        is_edge = abs(z[0] - 5.0) < 1.0 and with_slopes
        return None if is_edge else squares(lambda z: z - 5.0, lambda z: np.eye(1))(z, with_slopes)

    found = minimise(objective, np.array([-3.0]), -FREE[:1], FREE[:1])
    assert found.reason != "converged"
    assert objective(found.z, True).value == found.evaluation.value


def narrow_ring(z):
    """A valley along a circle, a thousand times steeper than its floor, which falls towards (1, 0)."""
    radius, angle = np.hypot(*z), np.arctan2(z[1], z[0])
    return np.array([1e3 * (radius - 1.0), angle])


def narrow_ring_slopes(z):
    radius = np.hypot(*z)
    return np.array([1e3 * z / radius, np.array([-z[1], z[0]]) / radius**2])


def test_a_search_leaps_along_a_valley_that_bends():
    """Steps along it are short: without leaps it takes 281 of them."""
    start = np.array([np.cos(2.0), np.sin(2.0)])
    found = minimise(squares(narrow_ring, narrow_ring_slopes), start, -FREE, FREE, 100)
    assert found.reason == "converged"
    assert np.allclose(found.z, [1.0, 0.0], atol=2e-3)


def test_leap_to_where_a_coordinate_does_nothing_goes_on_without_it():
    """Beyond its rim a tank tells nothing of the rim: its information there is zero."""

    def far(z, with_slopes):
        information = np.diag([1.0, 0.0])
        return Evaluation(0.5 * (z[0] - 100.0) ** 2 + 1e4, np.array([z[0] - 100.0, 0.0]), information)

    course = _Course(tuple(np.array([x, 1.0]) for x in (0.0, 1.0, 2.0, 3.0)))
    here = Evaluation(2e4, np.ones(2), np.eye(2))
    bounds = np.full(2, 1e6)
    z, there = _leaped(far, here, 1e9, -bounds, bounds, course)
    assert there.value < here.value and z[1] == 1.0
    here = Evaluation(1e4, np.ones(2), np.eye(2))  # better than all that the way back finds
    assert _leaped(far, here, 1e9, -bounds, bounds, course) is None


def test_whole_step_goes_to_the_minimum_however_far():
    """Over the coordinates that are free; also where these do nearly alike, and a damped one would be
    short."""
    nearly_alike = np.array([[1.0, 0.0, 0.3], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0 + 1e-2]])
    H = nearly_alike.T @ nearly_alike
    z, best = np.zeros(3), np.array([3.0, 1e3, -2e3])
    here = Evaluation(0.5 * best @ H @ best, -H @ best, H)
    step, promised = whole_step(here, np.ones(3, dtype=bool))
    assert z + step == pytest.approx(best, rel=1e-6) and promised == pytest.approx(here.value, rel=1e-6)
    step, promised = whole_step(here, np.array([True, False, False]))
    assert step[1:] == pytest.approx([0.0, 0.0]) and promised < here.value


def segments(n, bend):
    """A curve through n points of which neighbours are tied, bent by one coordinate that all share."""
    rng = np.random.default_rng(5)
    seen = np.sin(np.arange(n) / 7.0) + 0.1 * rng.normal(size=n)

    def residuals(z):
        x, shared = z[:n], z[n]
        return np.concatenate([x + np.exp(shared) - seen, 3.0 * (np.diff(x) + bend * x[1:] ** 3), [shared]])

    def slopes(z):
        J = np.zeros((2 * n, n + 1))
        i = np.arange(n - 1)
        J[np.arange(n), np.arange(n)], J[:n, n] = 1.0, np.exp(z[n])
        J[n + i, i], J[n + i, i + 1] = -3.0, 3.0 + 9.0 * bend * z[i + 1] ** 2
        J[-1, n] = 1.0
        return J

    return residuals, slopes


def test_many_coordinates_end_where_least_squares_does(monkeypatch):
    residuals, slopes = segments(200, 2.0)
    start, free = np.full(201, 3.0), np.full(201, np.inf)
    expected = least_squares(residuals, start, slopes, xtol=1e-14, ftol=1e-14, gtol=1e-12)
    monkeypatch.setattr(search._SpectralSteps, "__init__", None)  # is not asked
    found = minimise(squares(residuals, slopes), start, -free, free, 200, converged_gain=1e-16)
    assert np.allclose(found.z, expected.x, atol=1e-6)
    assert np.isclose(found.evaluation.value, expected.cost, rtol=1e-12)


def test_steps_by_factors_are_those_by_eigenvalues():
    residuals, slopes = segments(120, 2.0)
    here, free = squares(residuals, slopes)(np.full(121, 3.0), True), np.ones(121, dtype=bool)
    by_factors, spectrum = (
        search._steps(here, free),
        search._SpectralSteps(here, free, *search._scaled(here, free)),
    )
    assert isinstance(by_factors, search._FactoredSteps)
    assert np.isclose(by_factors.gain, spectrum.gain, rtol=1e-9)
    longest = spectrum.length_at(0.0)
    for share in (2.0, 0.5, 1e-2, 1e-4):
        step, length = spectrum.within(share * longest)
        other, longer = by_factors.within(share * longest)
        assert length <= longer * (1.0 + 1e-9) and longer <= 1.1 * length
        assert np.linalg.norm(other - step) < 0.15 * np.linalg.norm(step)


def test_indefinite_information_goes_downhill_among_many_coordinates():
    n = 100

    def saddle(z, with_slopes):
        x, y = z[0], z[1]
        value = float(np.sum((z[2:] - 1.0) ** 2) / 2 + (x**2 + y**2) / 2 - 1.5 * x * y + (x**4 + y**4) / 8)
        gradient = np.concatenate([[x - 1.5 * y + x**3 / 2, y - 1.5 * x + y**3 / 2], z[2:] - 1.0])
        information = np.eye(n)
        information[:2, :2] = [[1.0 + 1.5 * x**2, -1.5], [-1.5, 1.0 + 1.5 * y**2]]
        return Evaluation(value, gradient, information)

    free = np.full(n, np.inf)
    found = minimise(saddle, np.full(n, 0.1), -free, free, 100)
    assert np.allclose(found.z, 1.0, atol=2e-3)


@pytest.mark.parametrize(
    ("far", "expected"),
    [
        (80.0, 0.0),  # gone before the second sample
        (2000.0, 2000.0),  # so far that the samples tell it
        (2.0, 2.0),  # within a step
    ],
)
def test_initial_states_go_no_further_than_the_samples_tell(far, expected):
    curvature, end = np.diag([1e3, 1e-5]), np.array([0.5, far])

    def value(z, with_slopes):
        away = z - end
        slopes = (curvature @ away, curvature) if with_slopes else ()
        return Evaluation(float(away @ curvature @ away / 2), *slopes)

    found = Found(end, value(end, True), "converged", 3, 0.0)
    assert np.allclose(_as_far_as_seen(value, found, np.zeros(2)), [0.5, expected])
