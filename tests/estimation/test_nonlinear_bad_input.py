"""What goes wrong with nonlinear models, and the message for it: jumps, coefficients that vanish on the way,
gaps in inputs, parameter values that cannot be simulated."""

import pickle

import casadi as ca
import numpy as np
import pytest
from nonlinear_models import experiment_of, explicit_from

from daest.errors import DataError, EstimationError, ModelError, NumericalError
from daest.estimation.filter import run_filter
from daest.estimation.fitting.coordinates import Coordinate, Unknowns, objective
from daest.estimation.fitting.search import minimise
from daest.estimation.identify import identify
from daest.estimation.nonlinear.trajectories import TrajectoryProblem
from daest.model.estimates import FilterOptions
from daest.model.fit import IdentifyOptions
from daest.systems.events.integration import IntegrationError
from daest.systems.simulation.integrate import integrator
from daest.systems.simulation.simulate import simulate

TIME = 0.02 * np.arange(250)
FORCE = 2.0 * np.sin(TIME)[:, None]


def mass(force, mass_of=lambda x: 1.0):
    """x'' = force(x, v, u, a) / mass, place measured."""
    return explicit_from(
        ("x", "v"),
        {"a": 1.0},
        lambda x, u, w, theta, t: [x[1], (force(x[0], x[1], u[0], theta[0]) + w[0]) / mass_of(x[0])],
        {"y": lambda x, u, theta: x[0]},
        ("w",),
    )


def sharp():
    return mass(lambda x, v, u, a: u - 3.0 * a * ca.sign(v))


def cubic():
    return mass(lambda x, v, u, a: u - a * x - v - x**3)


def test_a_jump_that_is_not_smoothed_stops_a_simulation_with_advice(monkeypatch):
    monkeypatch.setattr("daest.systems.events.hybrid.MOST_DENSE", 50)
    with pytest.raises(NumericalError) as caught:
        simulate(sharp(), (TIME, FORCE))
    assert caught.value.code == "events-chatter" and "switch `0 < x_1`" in caught.value.what
    assert "tanh" in caught.value.remedy


def test_a_jump_that_is_not_smoothed_is_not_identified():
    explicit = sharp()
    experiment = experiment_of(explicit, TIME, FORCE, np.sin(TIME)[:, None])
    with pytest.raises(EstimationError) as caught:
        identify(explicit.flat, [experiment], IdentifyOptions(method="oe", estimate=("a",)))
    assert caught.value.code == "identify-jump"


def test_a_mass_that_vanishes_on_the_way_stops_with_the_time():
    """(x - 1/2) v' = -1 from x = 0, v = 1: v² = 1 - 2 ln(1 - 2 x) has no bound at x = 1/2."""
    explicit = mass(lambda x, v, u, a: -a, lambda x: x - 0.5)
    with pytest.raises(NumericalError) as caught:
        simulate(explicit, (TIME, FORCE), x0=np.array([0.0, 1.0]))
    assert caught.value.code == "simulation-failed" and "coefficient" in caught.value.remedy
    from scipy.integrate import quad

    end = quad(lambda x: 1 / np.sqrt(1 - 2 * np.log(1 - 2 * x)), 0, 0.5)[0]
    time = float(caught.value.what.split("t = ")[1].split(" s")[0])
    assert time == pytest.approx(end, abs=0.021)  # within a sample


@pytest.mark.parametrize("kind", ["ekf", "ukf", "particle"])
def test_a_gap_in_an_input_is_named(kind):
    explicit, u = cubic(), FORCE.copy()
    u[50] = np.nan
    y = np.sin(TIME)[:, None]
    with pytest.raises(DataError) as caught:
        run_filter(
            explicit,
            experiment_of(explicit, TIME, u, y),
            kind,
            FilterOptions(process_intensity=np.array([1e-3]), measurement_cov=np.array([1e-4])),
        )
    assert caught.value.code == "data-input-gap" and "1 s" in caught.value.what
    with pytest.raises(ModelError) as simulated:
        simulate(explicit, (TIME, u))
    assert simulated.value.code == "simulation-input"


def test_a_value_that_cannot_be_simulated_makes_the_search_step_back():
    """x' = a x² from 1 escapes within the record for a > 0.2: the search from a = 0.05 passes that on its way
    to 0.19 when a step is too long, and comes back."""
    explicit = explicit_from(
        ("x",), {"a": 0.19}, lambda x, u, w, theta, t: [theta[0] * x[0] ** 2], {"y": lambda x, u, theta: x[0]}
    )
    y = 1.0 / (1.0 - 0.19 * TIME)[:, None]
    a = Coordinate("a", "parameter", 0, 0.05, False, 1.0, -np.inf, np.inf)
    unknowns = Unknowns((a,), explicit.flat.theta_values, np.zeros(0), np.ones(1))
    experiment = experiment_of(explicit, TIME, np.zeros((250, 1)), y)
    problem = TrajectoryProblem(
        integrator(explicit, ("a",)), (experiment,), "zoh", unknowns, np.ones(1), np.array([0.1])
    )
    evaluate, failed = objective(problem), []

    def counted(z, with_slopes):
        here = evaluate(z, with_slopes)
        if here is None:
            failed.append(float(z[0]))
        return here

    found = minimise(counted, np.array([0.05, 1.0]), np.full(2, -5.0), np.full(2, 5.0))
    assert found.reason == "converged" and found.z[0] == pytest.approx(0.19, abs=1e-5)
    assert failed and max(failed) > 0.2


def test_an_integration_error_survives_pickling():
    error = pickle.loads(pickle.dumps(IntegrationError("no reason at all", 1.5)))
    assert error.time == 1.5 and error.what.count("stopped") == 1
