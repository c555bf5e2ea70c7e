"""Priors against the product of two Gaussian densities, and what they do for unknowns that the data leave
open."""

from dataclasses import replace

import casadi as ca
import hand_models as hand
import numpy as np
import pytest
from nonlinear_models import experiment_of, explicit_from, oscillator, setup_of

from daest.errors import EXPLANATIONS, EstimationError
from daest.estimation.fitting.coordinates import (
    Unknowns,
    coordinate_with_prior,
    parameter_coordinate,
    with_priors,
)
from daest.estimation.fitting.coordinates import objective as objective_of
from daest.estimation.fitting.records import make_record
from daest.estimation.identify import identify
from daest.estimation.linear.linear_predictors import Problem
from daest.estimation.nonlinear.identify_nonlinear import identify_nonlinear
from daest.model.fit import IdentifyOptions, NoiseChoice
from daest.model.parts import Prior
from daest.systems.linear.state_space import sample, state_space
from daest.systems.simulation.simulate import simulate

TRUE = {"d": 0.0226, "c": 1.4367, "J1": 6.838e-6, "J2": 0.02054, "R": 4.316, "k": 0.0675, "n": 30.0}
STD = (0.02, 0.01)


def recorded(seed=1):
    family = hand.servo(TRUE)
    theta = np.array([TRUE[p.name] for p in family.parameters])
    model = sample(state_space(family, theta), 0.01, "zoh")
    return hand.recording(model, hand.multisine(800, 0.01, seed)[:, None], STD, seed)


def fit_of(experiment, method="oe", estimate=("d", "k"), **options):
    """Sensor noise given, so that the log-likelihood is that of a normal density near its top."""
    noise = {"intensity": None, "estimate": True} if method == "pem" else None
    given = {name: NoiseChoice(s, False) for name, s in zip(("omega", "phi"), STD, strict=True)}
    return identify(
        hand.servo(TRUE, noise=noise),
        [experiment],
        IdentifyOptions(
            method=method,
            estimate=estimate,
            measurement_noise=given,
            hold="zoh",
            second_look=False,
            **options,
        ),
    )


def product(mean, std, prior_mean, prior_std):
    """Mean and standard deviation of the product of two normal densities."""
    precision = std**-2 + prior_std**-2
    return (mean * std**-2 + prior_mean * prior_std**-2) / precision, precision**-0.5


@pytest.mark.parametrize(
    ("name", "is_log", "method"),
    [("d", True, "oe"), ("k", False, "oe"), ("d", True, "pem"),
     pytest.param("k", False, "pem", marks=pytest.mark.slow)],
)  # fmt: skip
def test_posterior_of_one_parameter_is_the_product_of_two_densities(method, name, is_log):
    experiment = recorded()
    (plain,) = fit_of(experiment, method, (name,)).parameters
    mean, std = plain.value - 2.0 * plain.std_error, 0.7 * plain.std_error
    fit = fit_of(experiment, method, (name,), prior={name: Prior(mean, std)})
    (found,) = fit.parameters
    if is_log:
        expected = product(np.log(plain.value), plain.std_error / plain.value, np.log(mean), std / mean)
        assert np.log(found.value) == pytest.approx(expected[0], abs=0.02 * expected[1])
        assert found.std_error / found.value == pytest.approx(expected[1], rel=0.02)
    else:
        expected = product(plain.value, plain.std_error, mean, std)
        assert found.value == pytest.approx(expected[0], abs=0.02 * expected[1])
        assert found.std_error == pytest.approx(expected[1], rel=0.02)
    assert found.prior == Prior(mean, std) and fit.status == "converged"


def test_log_likelihood_is_that_of_the_data_alone():
    experiment = recorded()
    fit = fit_of(experiment, prior={"k": Prior(0.06, 1e-5)})
    held = fit_of(experiment, estimate=("d",), start={"k": fit.theta["k"]})
    assert fit.log_likelihood == pytest.approx(held.log_likelihood, abs=1e-3)
    assert fit.theta["k"] < 0.0665  # pulled from 0.0675


def test_prior_settles_what_the_data_leave_open():
    """Only the ratio k/R² moves the outputs alike: without a prior their common change is unidentifiable."""
    experiment = recorded()
    everything = ("d", "c", "J1", "J2", "k", "R")
    with pytest.raises(EstimationError, match="can change together"):
        fit_of(experiment, estimate=everything)
    fit = fit_of(experiment, estimate=everything, prior={"R": Prior(4.3, 0.05)})
    found = {p.name: p for p in fit.parameters}
    assert found["R"].std_error == pytest.approx(0.05, rel=0.02)
    assert found["R"].value == pytest.approx(4.3, abs=1e-3)
    # What is free along the direction inherits the relative uncertainty of R, all torques grow as 1/R.
    assert found["c"].std_error / found["c"].value == pytest.approx(0.05 / 4.3, rel=0.3)


def test_objective_has_the_gradient_of_its_value():
    experiment = recorded()
    family = hand.servo(TRUE)
    theta = np.array([TRUE[p.name] for p in family.parameters])
    coordinates = [parameter_coordinate(family, n, 1.1 * TRUE[n], (0.0, None)) for n in ("d", "k")]
    coordinates[0] = coordinate_with_prior(coordinates[0], Prior(0.03, 1e-3))
    unknowns = Unknowns(tuple(coordinates), theta, np.zeros(0), np.ones(2))
    plain = Unknowns(tuple(replace(c, prior=None) for c in coordinates), theta, np.zeros(0), np.ones(2))
    problem = Problem(family, (make_record(experiment, family),), "zoh", plain, np.ones(2, dtype=bool))
    objective = with_priors(objective_of(problem), unknowns)
    z, h = unknowns.start, 1e-5
    here = objective(z, True)
    numeric = [
        (objective(z + h * e, False).value - objective(z - h * e, False).value) / (2 * h) for e in np.eye(2)
    ]
    assert here.gradient == pytest.approx(numeric, rel=1e-5)
    without = objective_of(problem)(z, True)
    gap = here.information - without.information
    assert gap == pytest.approx(np.diag([(0.03 / 1e-3) ** 2, 0.0]))
    assert here.value - without.value == pytest.approx(((z[0] - np.log(0.03)) * 30.0) ** 2 / 2)


# Nonlinear models


def duffing(prior, method="oe", intensity=0.0):
    explicit = oscillator()
    rng = np.random.default_rng(4)
    time = 0.05 * np.arange(600)
    u = np.repeat(rng.choice([-6.0, 6.0], 30), 20)[:, None]
    options = {"noise": intensity > 0.0, "seed": 1, "intensities": {"w": intensity}}
    y = simulate(explicit, (time, u), hold="zoh", **options).outputs
    y = y + 0.02 * rng.standard_normal(y.shape)
    coordinate = coordinate_with_prior(parameter_coordinate(explicit.flat, "k3", 1.5, (0.0, None)), prior)
    unknowns = Unknowns((coordinate,), explicit.flat.theta_values, np.zeros(1), np.ones(1))
    return identify_nonlinear(
        explicit,
        setup_of(
            unknowns,
            [experiment_of(explicit, time, u, y)],
            method,
            np.array([np.nan]),
            np.array([True]),
            np.array([0.02 if method == "oe" else np.nan]),
            IdentifyOptions(hold="zoh", second_look=False),
        ),
    )


@pytest.mark.parametrize(
    ("method", "intensity"), [("oe", 0.0), pytest.param("pem", 0.3, marks=pytest.mark.slow)]
)
def test_nonlinear_posterior_is_the_product_of_two_densities(method, intensity):
    (plain,) = duffing(None, method, intensity).parameters
    prior = Prior(plain.value + 2.0 * plain.std_error, plain.std_error)
    (found,) = duffing(prior, method, intensity).parameters
    expected = product(
        np.log(plain.value), plain.std_error / plain.value, np.log(prior.mean), prior.std / prior.mean
    )
    # With the noise estimated too, the likelihood is a little wider than a normal density.
    loose = 0.02 if method == "oe" else 0.15
    assert np.log(found.value) == pytest.approx(expected[0], abs=loose * expected[1])
    assert found.std_error / found.value == pytest.approx(expected[1], rel=loose)


def test_prior_settles_a_product_in_a_nonlinear_model():
    def rhs(x, u, w, theta, t):
        return [x[1], u[0] + w[0] - theta[0] * theta[1] * ca.tanh(x[1])]

    explicit = explicit_from(
        ("phi", "w"), {"a": 1.0, "b": 0.5}, rhs, {"angle": lambda x, u, theta: x[0]}, ("torque",)
    )
    rng = np.random.default_rng(0)
    time = 0.05 * np.arange(400)
    u = np.repeat(rng.uniform(-1.0, 1.0, 20), 20)[:, None]
    y = simulate(explicit, (time, u), hold="zoh").outputs + 0.005 * rng.standard_normal((400, 1))
    a, b = (parameter_coordinate(explicit.flat, n, v, (0.0, None)) for n, v in (("a", 1.2), ("b", 0.5)))
    unknowns = Unknowns(
        (coordinate_with_prior(a, Prior(1.0, 0.1)), b), explicit.flat.theta_values, np.zeros(1), np.ones(1)
    )
    fit = identify_nonlinear(
        explicit,
        setup_of(
            unknowns,
            [experiment_of(explicit, time, u, y)],
            "oe",
            np.array([np.nan]),
            np.array([True]),
            np.array([np.nan]),
            IdentifyOptions(hold="zoh"),
        ),
    )
    found = {p.name: p for p in fit.parameters}
    assert found["a"].value == pytest.approx(1.0, rel=1e-3)
    assert found["a"].std_error == pytest.approx(0.1, rel=0.02)
    assert found["a"].value * found["b"].value == pytest.approx(0.5, rel=0.02)


# Bad input


@pytest.mark.parametrize(
    ("prior", "code"),
    [
        ({"d": Prior(0.02, 0.0)}, "prior-std"),
        ({"d": Prior(0.02, -1.0)}, "prior-std"),
        ({"d": Prior(0.02, np.inf)}, "prior-std"),
        ({"d": Prior(0.0, 0.1)}, "prior-mean"),
        ({"d": Prior(-0.02, 0.1)}, "prior-mean"),
        ({"k": Prior(np.nan, 0.1)}, "prior-mean"),
        ({"R": Prior(4.3, 0.1)}, "prior-unused"),
        ({"Rx": Prior(4.3, 0.1)}, "unknown-parameter"),
    ],
)
def test_bad_prior(prior, code):
    with pytest.raises(EstimationError) as caught:
        fit_of(recorded(), prior=prior)
    assert caught.value.code == code and code in EXPLANATIONS
    assert caught.value.where == next(iter(prior)) and caught.value.remedy
