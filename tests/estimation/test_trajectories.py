"""Prediction errors of nonlinear models against scipy, and their slopes against finite differences."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from nonlinear_models import experiment_of, oscillator, time_grid
from scipy.integrate import solve_ivp

from daest.estimation.fitting.coordinates import Unknowns, objective, parameter_coordinate
from daest.estimation.nonlinear import trajectories
from daest.estimation.nonlinear.trajectories import TrajectoryProblem, prediction_errors, whitened
from daest.modelica.compile import compile_text
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrator

TIME = time_grid(120, 0.1)
INPUTS = np.repeat(np.random.default_rng(3).standard_normal(12), 10)[:, None]
MODEL = oscillator()
NAMES = ("k", "d", "k3")


TWO_UNITS = b"""model Cylinder
  parameter Real c(unit = "N/m") = 2e4;
  input Real F(unit = "N");
  Real s(unit = "m", start = 0), v(unit = "m/s", start = 0);
  output Real x(unit = "m"), p(unit = "Pa");
equation
  der(s) = v;
  40*der(v) = F - 300*v - c*s;
  x = s;
  p = 1e9*s;
end Cylinder;"""


def true_positions(theta=(4.0, 0.5, 2.0), x0=(0.2, 0.0)):
    """Independent integration, input held between samples."""
    x, result = np.array(x0), []
    for k in range(TIME.size):
        result.append(x[0])

        def rhs(_, x, u=INPUTS[k, 0]):
            return [x[1], u - theta[0] * x[0] - theta[1] * x[1] - theta[2] * x[0] ** 3]

        x = solve_ivp(rhs, (0.0, 0.1), x, rtol=1e-10, atol=1e-12).y[:, -1]
    return np.array(result)


def problem(missing=(), gain=None, n_records=1, std=np.nan):
    y = true_positions()[:, None] + 0.02 * np.random.default_rng(4).standard_normal((TIME.size, 1))
    y[list(missing)] = np.nan
    record = experiment_of(MODEL, TIME, INPUTS, y)
    coordinates = tuple(
        parameter_coordinate(MODEL.flat, name, value, (None, None))
        for name, value in zip(NAMES, (3.5, 0.6, 2.5), strict=True)
    )
    unknowns = Unknowns(coordinates, MODEL.flat.theta_values, np.zeros(1), np.zeros(1))
    return TrajectoryProblem(
        integrator(MODEL, NAMES), (record,) * n_records, "zoh", unknowns, np.array([0.5, 2.0]),
        np.array([std]), gain, rtol=1e-9,
    )  # fmt: skip


def start(p):
    x0 = [0.2 / 0.5, 0.0] * len(p.experiments)
    return np.concatenate([p.unknowns.start, x0])


def test_simulation_is_that_of_scipy():
    p = problem()
    p = replace(
        p, unknowns=Unknowns((), MODEL.flat.theta_values, np.zeros(1), np.zeros(1)), model=integrator(MODEL)
    )
    found = prediction_errors(p, np.array([0.4, 0.0]))
    assert found.trajectories[0].outputs[:, 0] == pytest.approx(true_positions(), abs=1e-6)


def test_likelihood_is_the_gaussian_one_with_its_best_variance():
    p = problem(missing=(3, 50))
    found = prediction_errors(p, start(p))
    e = found.errors[0][np.isfinite(found.errors[0])]
    variance = np.mean(e**2)
    assert found.covariance[0, 0] == pytest.approx(variance)
    expected = 0.5 * np.sum(e**2 / variance + np.log(2 * np.pi * variance))
    assert found.negative_log_likelihood == pytest.approx(expected, rel=1e-12)
    assert np.isnan(found.errors[0][3, 0]) and e.size == TIME.size - 2


def test_given_standard_deviation_is_kept():
    found = prediction_errors(problem(std=0.3), start(problem()))
    assert found.covariance == pytest.approx(np.array([[0.09]]))


@pytest.mark.parametrize("gain", [None, np.array([[0.3], [0.5]])])
@pytest.mark.parametrize("missing", [(), (7, 8, 60)])
@pytest.mark.parametrize("n_records", [1, 2])
def test_gradient_is_that_of_finite_differences(gain, missing, n_records):
    p = problem(missing, gain, n_records)
    z = start(p) + 0.01 * np.arange(start(p).size)
    evaluate = objective(p)
    step = 1e-5
    slopes = [
        (evaluate(z + step * e, False).value - evaluate(z - step * e, False).value) / (2 * step)
        for e in np.eye(z.size)
    ]
    assert evaluate(z, True).gradient == pytest.approx(slopes, rel=1e-3, abs=1e-3 * np.max(np.abs(slopes)))


def test_whitened_errors_have_the_slopes_of_finite_differences():
    p = problem(missing=(7,), gain=np.array([[0.3], [0.5]]), std=0.02)
    z, step = start(p), 1e-6
    residuals, slopes = whitened(p, prediction_errors(p, z, with_slopes=True), z)
    assert residuals[7] == 0.0 and np.all(slopes[:, 7] == 0.0)
    for i, e in enumerate(np.eye(z.size)):
        ahead, back = (
            np.nan_to_num(prediction_errors(p, z + s * e).errors[0]).ravel() for s in (step, -step)
        )
        assert slopes[i] == pytest.approx((ahead - back) / (2 * step) / 0.02, rel=2e-3, abs=2e-3)


def test_gain_that_trusts_the_output_removes_a_wrong_start():
    p = problem()
    z = start(p)
    z[3:] = [3.0, 1.0]
    far, corrected = prediction_errors(p, z), prediction_errors(replace(p, gain=np.array([[0.8], [2.0]])), z)
    assert corrected.negative_log_likelihood < far.negative_log_likelihood - 50.0
    assert np.std(corrected.errors[0][40:]) < 0.1


def test_runaway_is_no_value():
    p = problem()
    z = start(p)
    z[1] += 12.0  # of a damping in logarithms or scales: the other parameters turn it around
    unstable = replace(
        p,
        unknowns=replace(p.unknowns, theta=np.array([4.0, -60.0, 2.0]), coordinates=()),
        model=integrator(MODEL),
    )
    assert objective(unstable)(np.array([0.4, 0.0]), False) is None


def test_errors_of_outputs_in_units_far_apart_have_not_run_away():
    model = reduce_index(compile_text(TWO_UNITS, Path("Cylinder.mo")))
    rng = np.random.default_rng(5)
    y = rng.standard_normal((TIME.size, 2)) * [1e-4, 1e5]
    record = experiment_of(model, TIME, 100.0 * INPUTS, y)
    unknowns = Unknowns((), model.flat.theta_values, np.zeros(0), np.zeros(2))
    p = TrajectoryProblem(integrator(model), (record,), "zoh", unknowns, np.ones(2), np.full(2, np.nan), None)
    found = prediction_errors(p, np.zeros(2))
    assert found is not None and found.covariance[1, 1] > 1e15 * found.covariance[0, 0]


def counted_runs(monkeypatch):
    """The recordings that are integrated from now on."""
    runs, integrate_all = [], trajectories.integrate_all

    def counted(model, records, *given, **options):
        runs.extend(records)
        return integrate_all(model, records, *given, **options)

    monkeypatch.setattr(trajectories, "integrate_all", counted)
    return runs


@pytest.mark.parametrize("gain", [None, np.array([[0.3], [0.5]])])
def test_what_was_run_with_slopes_is_not_run_again_without(gain, monkeypatch):
    p, runs = problem(gain=gain), counted_runs(monkeypatch)
    z = start(p)
    first = prediction_errors(p, z, with_slopes=True)
    again = prediction_errors(p, z)
    assert len(runs) == 1
    assert again.negative_log_likelihood == first.negative_log_likelihood
    assert again.trajectories[0].sensitivities.shape == (TIME.size, 1, 0)
    trajectories._kept.clear()
    anew = prediction_errors(p, z)
    assert len(runs) == 2
    assert np.array_equal(anew.trajectories[0].states, first.trajectories[0].states)
    for other in (replace(p, rtol=1e-8), replace(p, gain=np.array([[0.1], [0.2]])), problem(missing=(3,))):
        n = len(runs)
        prediction_errors(other, z)
        assert len(runs) == n + 1


@pytest.mark.parametrize("gain", [None, np.array([[0.3], [0.5]])])
def test_what_was_run_last_with_slopes_is_not_run_again(gain, monkeypatch):
    p, runs = problem(gain=gain), counted_runs(monkeypatch)
    z = start(p)
    trajectories._kept.clear()
    first = prediction_errors(p, z, with_slopes=True)
    again = prediction_errors(p, z, with_slopes=True)
    assert len(runs) == 1
    assert np.array_equal(again.trajectories[0].sensitivities, first.trajectories[0].sensitivities)
    held = prediction_errors(replace(p, holds_parameters=True), z, with_slopes=True)
    assert len(runs) == 2
    assert held.trajectories[0].sensitivities.shape[2] < first.trajectories[0].sensitivities.shape[2]
    prediction_errors(p, z, with_slopes=True)  # the sensitivities of the last runs alone are kept
    assert len(runs) == 3


@pytest.mark.parametrize("n_values", [0, 10**9])
def test_long_trajectories_are_kept_without_their_slopes(n_values, monkeypatch):
    monkeypatch.setattr(trajectories, "KEPT_VALUES", n_values)
    p = problem()
    trajectories._kept.clear()
    for shift in range(trajectories.MOST_KEPT + 3):
        prediction_errors(p, start(p) + 0.01 * shift, with_slopes=True)
    expected = trajectories.MOST_KEPT if n_values else trajectories.LEAST_KEPT
    assert len(trajectories._kept) == expected
    assert [one.along is not None for one in trajectories._kept] == [False] * (expected - 1) + [n_values > 0]


@pytest.mark.parametrize(("n_y", "missing"), [(1, 0.0), (1, 0.2), (2, 0.0), (2, 0.2)])
def test_whitened_errors_and_slopes_are_those_of_every_sample(n_y, missing):
    """Against the definition: two parameters, two states of each of two records, one log of a gain."""
    rng, z = np.random.default_rng(7), np.array([0.3, -0.2, 0.1, 0.4, 0.2, -0.5, 0.7])
    per_z, scale = np.array([2.0, -0.5]), np.array([3.0, 0.25])
    problem = SimpleNamespace(
        unknowns=SimpleNamespace(coordinates=(None, None), slopes=lambda _: per_z),
        n_states=2,
        state_scale=scale,
        family=SimpleNamespace(n_logs=1),
    )
    lengths, mixed = (6, 4), rng.standard_normal((n_y, n_y))
    sens = [rng.standard_normal((n, n_y, 5)) for n in lengths]
    errors = [rng.standard_normal((n, n_y)) for n in lengths]
    for table in errors:
        table[rng.uniform(size=table.shape) < missing] = np.nan
    found = SimpleNamespace(
        covariance=mixed @ mixed.T + np.eye(n_y),
        errors=errors,
        trajectories=[SimpleNamespace(sensitivities=one) for one in sens],
    )
    residuals, slopes = whitened(problem, found, z)
    root = np.linalg.inv(np.linalg.cholesky(found.covariance))
    column = 0
    for number, (table, one) in enumerate(zip(errors, sens, strict=True)):
        for error, by in zip(table, one, strict=True):
            seen = np.isfinite(error)
            wanted = np.zeros((z.size, n_y))
            wanted[[0, 1, 2 + 2 * number, 3 + 2 * number, 6]] = -(by * [*per_z, *scale, 1.0]).T
            columns = slice(column, column + n_y)
            assert np.allclose(residuals[columns], root @ np.where(seen, error, 0.0), rtol=1e-13)
            assert np.allclose(slopes[:, columns], np.where(seen, wanted, 0.0) @ root.T, rtol=1e-13)
            column += n_y
