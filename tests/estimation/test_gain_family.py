"""Gains as a function of noise levels: their slopes, and what a search of them with the parameters rests
on."""

from dataclasses import replace

import numpy as np
import pytest
from nonlinear_models import experiment_of, oscillator

from daest.estimation.fitting.coordinates import Unknowns, objective, parameter_coordinate
from daest.estimation.nonlinear.gain_family import Levels, gain_family
from daest.estimation.nonlinear.noise_levels import average_along
from daest.estimation.nonlinear.observer import AverageModel, observer
from daest.estimation.nonlinear.trajectories import TrajectoryProblem
from daest.systems.events.integration import Correction
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.simulate import simulate


@pytest.fixture(scope="module")
def case():
    """A nonlinear predictor with all its gains, and a point of its search."""
    explicit = oscillator()
    flat = explicit.flat
    rng = np.random.default_rng(4)
    time = 0.05 * np.arange(200)
    u = np.repeat(rng.choice([-5.0, 5.0], 8), 25)[:, None]
    y = simulate(explicit, (time, u), hold="zoh", noise=True, seed=4, intensities={"w": 0.05}).outputs
    data = experiment_of(explicit, time, u, y + 0.02 * rng.standard_normal(y.shape))
    names = [p.name for p in flat.parameters]
    coordinates = tuple(
        parameter_coordinate(flat, n, 1.1 * flat.theta_values[i], (0.0, None)) for i, n in enumerate(names)
    )
    n_w, n_y, n = len(flat.noises), len(flat.outputs), explicit.n_states
    unknowns = Unknowns(coordinates, flat.theta_values, np.zeros(n_w), np.ones(n_y))
    problem = TrajectoryProblem(
        integrator(explicit, names), (data,), "zoh", unknowns, np.ones(n), np.full(n_y, np.nan), rtol=1e-9
    )
    z = np.concatenate([unknowns.start, np.full(n, 0.1)])
    levels = Levels(np.full(n_w, 0.05), np.full(n_y, 0.02))
    average = average_along(problem, z)
    family = gain_family(average, levels, np.arange(n_w), np.arange(n_y))
    return replace(problem, family=family), np.concatenate([z, np.zeros(family.n_logs)]), average, levels


def test_gains_and_their_slopes(case):
    problem, _, average, levels = case
    family, logs = problem.family, np.array([0.4, -0.3])
    found = family.at(logs)
    same = observer(average, levels.intensity * np.exp(0.4), levels.measurement_std * np.exp(-0.3))
    np.testing.assert_allclose(found.gain, same.gain, rtol=1e-8)
    np.testing.assert_allclose(found.innovation_cov, same.innovation_cov, rtol=1e-8)
    slopes = family.slopes(logs, found)
    for i, step in enumerate(1e-4 * np.eye(2)):
        change = (family.at(logs + step).gain - family.at(logs - step).gain) / 2e-4
        np.testing.assert_allclose(slopes[i], change, rtol=1e-5, atol=1e-9)


def test_slopes_of_gains_beside_a_state_that_no_noise_reaches():
    """The charge of a cell beside a polarisation: nothing of it settles."""
    A, G, C = np.diag([0.0, -0.2]), np.array([[0.0], [1.0]]), np.array([[1.0, -1.0]])
    levels = Levels(np.array([0.3]), np.array([0.1]))
    family = gain_family(AverageModel(A, G, C, 0.1), levels, np.arange(1), np.arange(1))
    slopes = family.slopes(np.zeros(2), family.at(np.zeros(2)))
    for i, step in enumerate(1e-4 * np.eye(2)):
        change = (family.at(step).gain - family.at(-step).gain) / 2e-4
        np.testing.assert_allclose(slopes[i], change, rtol=1e-5, atol=1e-12)


def test_the_objective_has_exact_slopes_over_parameters_states_and_levels(case):
    problem, z, _, _ = case
    evaluate = objective(problem)
    here = evaluate(z, True)
    assert here.gradient.shape == z.shape and here.value == pytest.approx(evaluate(z, False).value)
    for i, step in enumerate(1e-5 * np.eye(z.size)):
        change = (evaluate(z + step, False).value - evaluate(z - step, False).value) / 2e-5
        assert here.gradient[i] == pytest.approx(change, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("compiled", [True, False])
def test_sensitivities_to_a_gain_and_to_initial_states_alone(case, compiled):
    problem, z, _, _ = case
    (data,), n = problem.experiments, 30
    model = integrator(problem.model.explicit, problem.model.names, compiled=compiled)
    gain = problem.family.at(np.zeros(2)).gain
    slopes = np.random.default_rng(0).standard_normal((2, *gain.shape)) * np.abs(gain).mean()

    def run(gain, **options):
        return integrate(
            model, data.time[:n], data.inputs[:n], problem.theta(z), problem.initial_states(z)[0], hold="zoh",
            correction=Correction(data.outputs[:n], gain, slopes), rtol=1e-9, **options,
        )  # fmt: skip

    whole, states = run(gain, sensitivities=True), run(gain, sensitivities=True, by_parameter=False)
    assert states.sensitivities.shape[2] == problem.n_states + 2
    np.testing.assert_allclose(
        whole.sensitivities[:, :, len(model.names) :], states.sensitivities, rtol=1e-9, atol=1e-12
    )
    for i, slope in enumerate(slopes):
        change = (run(gain + 1e-5 * slope).outputs - run(gain - 1e-5 * slope).outputs) / 2e-5
        np.testing.assert_allclose(states.sensitivities[:, :, i - 2], change, rtol=1e-4, atol=1e-5)
