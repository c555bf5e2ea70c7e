"""Profile likelihood against closed forms, brute force, and coverage of the truth."""

from dataclasses import replace

import casadi as ca
import hand_models as hand
import numpy as np
import pytest
from nonlinear_models import experiment_of, explicit_from, oscillator, setup_of
from scipy.optimize import minimize_scalar
from scipy.stats import binom, chi2

from daest.errors import EXPLANATIONS, EstimationError
from daest.estimation.fitting.coordinates import Coordinate, Unknowns, parameter_coordinate
from daest.estimation.fitting.profile import Searched, with_profiles
from daest.estimation.fitting.search import Evaluation, minimise
from daest.estimation.identify import identify
from daest.estimation.nonlinear.ekf_likelihood import identify_by_ekf
from daest.estimation.nonlinear.identify_nonlinear import identify_nonlinear
from daest.model.fit import IdentifyOptions, NoiseChoice
from daest.report.documents.fit import document
from daest.systems.linear.state_space import sample, state_space
from daest.systems.simulation.simulate import simulate

TRUE = {"d": 0.0226, "c": 1.4367, "J1": 6.838e-6, "J2": 0.02054, "R": 4.316, "k": 0.0675, "n": 30.0}
THRESHOLD = chi2.ppf(0.95, 1)


def recorded(seed=1, n_samples=600):
    family = hand.servo(TRUE)
    theta = np.array([TRUE[p.name] for p in family.parameters])
    model = sample(state_space(family, theta), 0.01, "zoh")
    return hand.recording(model, hand.multisine(n_samples, 0.01, seed)[:, None], (0.02, 0.01), seed)


@pytest.fixture(scope="module")
def plain_fit():
    options = IdentifyOptions(hold="zoh", profile=("all",), estimate=("d", "c", "J2", "k"))
    told = []
    fit = identify(hand.servo(TRUE), [recorded()], options, tell=told.append)
    return fit, told


# A likelihood in closed form: -log L = f(z), so that every profile can be written down.


def searched(value, gradient, information, start, names, is_log=False, bounds=(-np.inf, np.inf)):
    coordinates = tuple(Coordinate(n, "parameter", i, 1.0, is_log, 1.0, *bounds) for i, n in enumerate(names))
    unknowns = Unknowns(coordinates, np.ones(len(names)), np.zeros(0), np.zeros(0))

    def objective(z, with_slopes):
        return Evaluation(value(z), gradient(z), information(z)) if with_slopes else Evaluation(value(z))

    found = minimise(objective, np.array(start, dtype=float), unknowns.lower, unknowns.upper)
    return Searched(objective, unknowns, unknowns.lower, unknowns.upper, found)


def profiles_of(search, plain_fit, names=("all",)):
    """With the frame of some result; standard errors have no part in it."""
    own = plain_fit[0].parameters[: len(search.unknowns.coordinates)]
    parameters = tuple(
        replace(p, name=c.name, std_error=None) for p, c in zip(own, search.unknowns.coordinates, strict=True)
    )
    result = replace(plain_fit[0], parameters=parameters, profiles=())
    return with_profiles(result, search, names, lambda _: None)


def test_gaussian_likelihood_gives_the_closed_form(plain_fit):
    information = np.array([[4.0, 1.5], [1.5, 1.0]])

    def shift(z):
        return z - np.array([0.3, -0.2])

    search = searched(
        lambda z: shift(z) @ information @ shift(z) / 2, lambda z: information @ shift(z),
        lambda z: information, [0.0, 0.0], ("a", "b"),
    )  # fmt: skip
    half = np.sqrt(THRESHOLD * np.diagonal(np.linalg.inv(information)))
    for profile, centre, width in zip(
        profiles_of(search, plain_fit).profiles, (0.3, -0.2), half, strict=True
    ):
        assert (profile.lower_end, profile.upper_end) == ("found", "found")
        assert profile.lower == pytest.approx(centre - width, abs=0.01 * width)
        assert profile.upper == pytest.approx(centre + width, abs=0.01 * width)
        assert profile.drops == pytest.approx((profile.values - centre) ** 2 / width**2 * THRESHOLD, abs=0.01)
        assert np.all(np.diff(profile.values) > 0.0) and profile.threshold == pytest.approx(THRESHOLD)


def test_saturating_likelihood_is_open_on_one_side(plain_fit):
    """f = (1 - exp(-z))² grows without limit to the left and to 1 on the right, less than 3.84 / 2."""
    height = 1.0
    search = searched(
        lambda z: height * (1 - np.exp(-z[0])) ** 2,
        lambda z: 2 * height * (1 - np.exp(-z)) * np.exp(-z),
        lambda z: 2 * height * np.exp(-2 * z)[:, None],
        [0.1], ("a",), is_log=True, bounds=(0.0, np.inf),
    )  # fmt: skip
    (profile,) = profiles_of(search, plain_fit).profiles
    assert (profile.lower_end, profile.upper_end, profile.upper) == ("found", "open", None)
    exact = -np.log(1 + np.sqrt(THRESHOLD / 2 / height))
    assert np.log(profile.lower) == pytest.approx(exact, abs=0.01)
    assert profile.values[-1] > 500.0


def test_bound_inside_the_interval_is_told(plain_fit):
    search = searched(
        lambda z: z[0] ** 2 / 2, lambda z: z, lambda z: np.eye(1), [0.3], ("a",), bounds=(-1.0, 5.0)
    )
    (profile,) = profiles_of(search, plain_fit).profiles
    assert (profile.lower_end, profile.lower) == ("bound", -1.0)
    assert profile.upper_end == "found" and profile.upper == pytest.approx(np.sqrt(THRESHOLD), rel=0.01)


def test_where_the_objective_ends_the_interval_fails(plain_fit):
    search = searched(lambda z: z[0] ** 2 / 2, lambda z: z, lambda z: np.eye(1), [0.3], ("a",))
    cut = replace(search, objective=lambda z, s: None if z[0] > 0.9 else search.objective(z, s))
    (profile,) = profiles_of(cut, plain_fit).profiles
    assert (profile.upper_end, profile.upper) == ("failed", None) and profile.values[-1] <= 0.9
    assert profile.lower == pytest.approx(-np.sqrt(THRESHOLD), rel=0.01)


def test_better_optimum_on_the_way_is_told(plain_fit):
    def value(z):
        return 10 * np.cos(3 * z[0]) * -0.1 + 0.02 * (z[0] - 4.2) ** 2

    search = searched(
        value, lambda z: 3 * np.sin(3 * z) + 0.04 * (z - 4.2), lambda z: np.array([[9.0]]), [0.0], ("a",)
    )
    result = profiles_of(search, plain_fit)
    assert result.profiles[0].drops.min() < -0.1
    assert any("a better optimum lies near a = " in note for note in result.notes)


# Linear models


def test_profile_of_a_servo_is_the_brute_force_one(plain_fit):
    fit, told = plain_fit
    assert [p.name for p in fit.profiles] == ["d", "c", "J2", "k"]
    assert told == [f"profile of {n} ({i} of 4)" for i, n in enumerate(("d", "c", "J2", "k"), start=1)]
    for profile, parameter in zip(fit.profiles, fit.parameters, strict=True):
        assert profile.drops[profile.values == parameter.value] == pytest.approx(0.0)
        # Precise data: the profile is a parabola in log or linear scale.
        half = 1.96 * parameter.std_error
        assert profile.upper - parameter.value == pytest.approx(half, rel=0.05)
        assert parameter.value - profile.lower == pytest.approx(half, rel=0.05)


def test_one_value_of_a_profile_is_the_best_of_all_others():
    """Two unknowns: at one value of d the optimum over k by scipy."""
    experiment = recorded()
    options = IdentifyOptions(hold="zoh", profile=("d",), estimate=("d", "k"))
    fit = identify(hand.servo(TRUE), [experiment], options)
    (profile,) = fit.profiles
    value = profile.values[-1]

    def loss(k):
        held = identify(
            hand.servo({**TRUE, "k": k}), [experiment],
            IdentifyOptions(hold="zoh", estimate=("d",), start={"d": value}, max_iterations=0),
        )  # fmt: skip
        return -held.log_likelihood

    best = minimize_scalar(loss, bracket=(0.067, 0.068), options={"xtol": 1e-8})
    assert profile.drops[-1] == pytest.approx(2 * (best.fun + fit.log_likelihood), abs=0.01)


def test_document_holds_the_profiles(plain_fit):
    content = document(plain_fit[0])["profiles"]
    assert list(content) == ["d", "c", "J2", "k"]
    assert set(content["d"]) == {
        "level", "lower", "upper", "lower_end", "upper_end", "threshold", "values", "drops",
    }  # fmt: skip
    assert content["d"]["lower"] < content["d"]["upper"] and content["d"]["level"] == 0.95


def test_prediction_error_profiles_reach_over_the_noises():
    family = hand.servo(TRUE, noise={"intensity": 1e-5, "estimate": True})
    model = sample(
        state_space(family, np.array([TRUE[p.name] for p in family.parameters])),
        0.01,
        "zoh",
        np.array([1e-5]),
    )
    experiment = hand.recording(model, hand.multisine(600, 0.01, 2)[:, None], (0.02, 0.01), 2)
    options = IdentifyOptions(hold="zoh", profile=("c",), estimate=("c", "k"))
    fit = identify(family, [experiment], options)
    (profile,), parameter = fit.profiles, fit.parameters[0]
    assert profile.upper - profile.lower == pytest.approx(2 * 1.96 * parameter.std_error, rel=0.1)
    assert profile.lower < TRUE["c"] < profile.upper


@pytest.mark.parametrize(("name", "code"), [("R", "profile-not-estimated"), ("x", "profile-not-estimated")])
def test_profile_of_something_else(name, code):
    with pytest.raises(EstimationError) as caught:
        identify(hand.servo(TRUE), [recorded()], IdentifyOptions(hold="zoh", profile=(name,)))
    assert caught.value.code == code and code in EXPLANATIONS and caught.value.where == name


# Nonlinear models


def duffing(function, method, intensity, seed=5):
    explicit = oscillator()
    rng = np.random.default_rng(seed)
    time = 0.05 * np.arange(400)
    u = np.repeat(rng.choice([-6.0, 6.0], 20), 20)[:, None]
    options = {"noise": intensity > 0.0, "seed": seed, "intensities": {"w": intensity}}
    y = simulate(explicit, (time, u), hold="zoh", **options).outputs
    y = y + 0.02 * rng.standard_normal(y.shape)
    coordinates = tuple(
        parameter_coordinate(explicit.flat, n, v, (0.0, None)) for n, v in (("k", 3.5), ("k3", 1.5))
    )
    unknowns = Unknowns(coordinates, explicit.flat.theta_values, np.ones(1), np.ones(1))
    nothing = np.array([np.nan])
    return function(
        explicit,
        setup_of(
            unknowns,
            [experiment_of(explicit, time, u, y)],
            method,
            nothing,
            np.array([True]),
            nothing,
            IdentifyOptions(hold="zoh", profile=("k3",), second_look=False),
        ),
    )


@pytest.mark.parametrize(
    ("function", "method", "intensity"),
    [
        pytest.param(identify_nonlinear, "oe", 0.0, id="simulation"),
        pytest.param(identify_by_ekf, "pem", 0.3, id="ekf", marks=pytest.mark.slow),
        pytest.param(identify_nonlinear, "pem", 0.3, id="observer", marks=pytest.mark.slow),
    ],
)
def test_nonlinear_profile_agrees_with_the_standard_error(function, method, intensity):
    fit = duffing(function, method, intensity)
    (profile,) = fit.profiles
    found = {p.name: p for p in fit.parameters}["k3"]
    assert profile.upper - profile.lower == pytest.approx(2 * 1.96 * found.std_error, rel=0.1)
    assert profile.lower < found.value < profile.upper


def test_effect_that_the_record_never_reaches_is_open_below():
    """A spring that hardens beyond 1 rad: a record within that says only that it does not begin earlier."""

    def rhs(x, u, w, theta, t):
        beyond = ca.fmax(x[0] ** 2 - 1.0, 0.0)
        return [x[1], u[0] + w[0] - 4.0 * x[0] - theta[0] * x[1] - theta[1] * beyond * x[0]]

    explicit = explicit_from(("x", "v"), {"d": 0.8, "k": 0.1}, rhs, {"y": lambda x, u, theta: x[0]}, ("w",))
    rng = np.random.default_rng(0)
    time = 0.05 * np.arange(400)
    u = np.repeat(rng.choice([-3.0, 3.0], 20), 20)[:, None]
    y = simulate(explicit, (time, u), hold="zoh").outputs
    assert 1.0 < np.max(np.abs(y)) < 1.6
    y = y + 0.2 * rng.standard_normal(y.shape)
    coordinates = tuple(
        parameter_coordinate(explicit.flat, n, v, (0.0, None)) for n, v in (("d", 1.0), ("k", 0.1))
    )
    unknowns = Unknowns(coordinates, explicit.flat.theta_values, np.ones(1), np.ones(1))
    nothing = np.array([np.nan])
    fit = identify_nonlinear(
        explicit,
        setup_of(
            unknowns,
            [experiment_of(explicit, time, u, y)],
            "oe",
            nothing,
            np.array([True]),
            nothing,
            IdentifyOptions(hold="zoh", profile=("k",)),
        ),
    )
    (profile,) = fit.profiles
    assert (profile.lower_end, profile.lower) == ("open", None)
    assert profile.upper_end == "found" and profile.upper > 0.1


@pytest.mark.slow
def test_interval_covers_the_truth_in_95_of_100_runs():
    """50 runs of 60 samples, where the parabola is crude: inside the 99.9 % band of the binomial."""
    family = hand.servo(TRUE)
    theta = np.array([TRUE[p.name] for p in family.parameters])
    model = sample(state_space(family, theta), 0.01, "zoh")
    hits, runs = 0, 50
    for seed in range(runs):
        u = hand.multisine(60, 0.01, seed)[:, None]
        experiment = hand.recording(model, u, (0.02, 0.01), 100 + seed)
        given = {n: NoiseChoice(s, False) for n, s in (("omega", 0.02), ("phi", 0.01))}
        options = IdentifyOptions(
            hold="zoh", profile=("d",), estimate=("d", "c"), measurement_noise=given, second_look=False
        )
        (profile,) = identify(family, [experiment], options).profiles
        low = -np.inf if profile.lower is None else profile.lower
        high = np.inf if profile.upper is None else profile.upper
        hits += low <= TRUE["d"] <= high
    assert binom.ppf(0.0005, runs, 0.95) <= hits <= binom.ppf(0.9995, runs, 0.95)
