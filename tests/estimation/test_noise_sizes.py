"""The sizes of noises that a gain leaves open."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from nonlinear_models import experiment_of, explicit_from

from daest.estimation.fitting.coordinates import Unknowns
from daest.estimation.fitting.search import Evaluation, Found
from daest.estimation.nonlinear.gain_family import Levels, gain_family
from daest.estimation.nonlinear.noise_levels import at_size_of_innovations, average_along, without_family
from daest.estimation.nonlinear.trajectories import TrajectoryProblem
from daest.systems.simulation.integrate import integrator
from daest.systems.simulation.simulate import simulate


def sized(expected, found, has_free_size=True):
    """Of levels (0.1; 1, 8), where the model expects those variances of the innovations and the recording has
    `found`."""
    return at_size_of_innovations(
        SimpleNamespace(has_free_size=has_free_size),
        SimpleNamespace(covariance=np.diag(found)),
        Levels(np.array([0.1]), np.array([1.0, 8.0])),
        SimpleNamespace(innovation_cov=np.diag(expected)),
    )


def test_outputs_that_no_process_noise_reaches_have_sizes_of_their_own():
    levels = sized(expected=[1.0001, 64.0001], found=[4.0, 9.0])
    assert levels.measurement_std == pytest.approx([2.0, 3.0], rel=1e-4)


def test_process_noise_has_the_size_of_the_outputs_that_it_reaches():
    levels = sized(expected=[2.0, 64.0], found=[8.0, 9.0])
    assert levels.measurement_std == pytest.approx([2.0, 3.0])
    assert levels.intensity == pytest.approx([0.4])


def test_noises_that_are_all_told_by_the_gain_share_one_size():
    levels = sized(expected=[2.0, 128.0], found=[8.0, 512.0])
    assert levels.measurement_std == pytest.approx([2.0, 16.0]) and levels.intensity == pytest.approx([0.4])


def test_given_sizes_stay():
    levels = sized([1.0, 64.0], [4.0, 9.0], has_free_size=False)
    assert levels.measurement_std.tolist() == [1.0, 8.0]


def test_noise_that_has_no_part_in_another_output_comes_back_to_its_innovations():
    """Of two tanks that share nothing, no gain tells the ratio of the noises: a search ended at a noise of
    20 000 where the sensor had 0.05, and was taken for one that had run away."""
    explicit = explicit_from(
        ("a", "b"),
        {"k": 1.0},
        lambda x, u, w, theta, t: [u[0] + w[0] - theta[0] * x[0], u[0] + w[1] - 2.0 * x[1]],
        {"y": lambda x, u, theta: x[0], "z": lambda x, u, theta: x[1]},
        ("v", "w"),
    )
    time = 0.05 * np.arange(600)
    u = np.repeat(np.random.default_rng(1).choice([-5.0, 5.0], 24), 25)[:, None]
    truth = {"noise": True, "seed": 1, "intensities": {"v": 0.01, "w": 0.04}}
    y = simulate(explicit, (time, u), hold="zoh", **truth).outputs
    y = y + np.array([0.02, 0.05]) * np.random.default_rng(2).standard_normal(y.shape)
    unknowns = Unknowns((), explicit.flat.theta_values, np.zeros(2), np.ones(2))
    data = (experiment_of(explicit, time, u, y),)
    problem = TrajectoryProblem(
        integrator(explicit, []), data, "zoh", unknowns, np.ones(2), np.full(2, np.nan), rtol=1e-8
    )
    start = np.zeros(2)
    lost = Levels(np.array([0.01, 0.04e10]), np.array([0.02, 0.05e5]))
    family = gain_family(average_along(problem, start), lost, np.arange(2), np.array([1]))
    wide = replace(problem, family=family)
    found = Found(np.zeros(5), Evaluation(0.0, np.zeros(5), np.eye(5)), "converged", 1, 0.0)
    end = without_family(SimpleNamespace(has_free_size=True), wide, found)
    assert end.levels.measurement_std == pytest.approx([0.02, 0.05], rel=0.15)
    assert end.levels.intensity == pytest.approx([0.01, 0.04], rel=0.3)
