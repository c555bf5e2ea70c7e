"""Likelihoods and their gradients against the dense joint Gaussian, the Kalman filter and finite
differences.
"""

from dataclasses import replace

import casadi as ca
import hand_models as hand
import numpy as np
import pytest
from dense_gaussian import DenseRecord
from scipy.integrate import solve_ivp

from daest.estimation.filter_engines.kalman import kalman_filter
from daest.estimation.fitting.coordinates import Coordinate, Unknowns, parameter_coordinate
from daest.estimation.fitting.coordinates import objective as objective_of
from daest.estimation.fitting.records import Record, make_record
from daest.estimation.linear.linear_predictors import (
    NoiseLevels,
    Problem,
    _interpolation,
    innovation_slopes,
    matrix_slopes,
    noise_levels,
    predict,
    recursion,
    simulate,
)
from daest.model.estimates import InitialState
from daest.model.experiment import Experiment
from daest.model.parts import Parameter
from daest.numerics.exponential import transition_integrals
from daest.numerics.riccati import NoiseModel, filter_riccati, stationary_gains
from daest.systems.linear.state_space import sample, state_space, state_space_derivatives

TRUE = {"d": 0.0226, "c": 1.4367, "J1": 6.838e-6, "J2": 0.02054, "R": 4.316, "k": 0.0675, "n": 30.0}
START = {**TRUE, **hand.RIG_START}
INTENSITY = 1e-3
STD = np.array([0.03, 0.02])


def theta_of(family, values):
    return np.array([values[p.name] for p in family.parameters])


def record_like(kind, n_samples, hold="foh", seed=3):
    """(family, experiment) of kind "complete", "missing" (5 % of the values), "dropped rows" or "uneven"."""
    family = hand.servo(START, noise={"intensity": INTENSITY, "estimate": True})
    u = hand.multisine(n_samples, 0.01, 1)[:, None]
    model = sample(state_space(family, theta_of(family, TRUE)), 0.01, hold, np.array([1e-4]))
    experiment = hand.recording(model, u, [0.02, 0.01], seed, x0=[0.5, 0.1, 0.2, -1.0])
    rng = np.random.default_rng(seed + 1)
    if kind == "missing":
        gaps = rng.random(experiment.outputs.shape) < 0.05
        return family, replace(experiment, outputs=np.where(gaps, np.nan, experiment.outputs))
    if kind == "dropped rows":
        kept = np.sort(rng.choice(np.arange(1, n_samples), int(0.9 * n_samples), replace=False))
        rows = np.concatenate([[0], kept])
        return family, replace(
            experiment,
            time=experiment.time[rows],
            inputs=experiment.inputs[rows],
            outputs=experiment.outputs[rows],
        )
    if kind == "uneven":
        return family, replace(experiment, time=np.cumsum(rng.uniform(0.006, 0.019, n_samples)))
    return family, experiment


def problem_for(family, experiments, method, hold="foh"):
    names = ("d", "c", "J1", "J2", "k")
    bounds = {p.name: (p.min, p.max) for p in family.parameters}
    coordinates = [parameter_coordinate(family, n, START[n], bounds[n]) for n in names]
    if method == "pem":
        coordinates.append(Coordinate("load.tau", "process", 0, INTENSITY, True, 1.0, 0.0, np.inf))
        coordinates += [
            Coordinate(name, "measurement", j, STD[j], True, 1.0, 0.0, np.inf)
            for j, name in enumerate(("omega", "phi"))
        ]
    unknowns = Unknowns(tuple(coordinates), theta_of(family, START), np.array([INTENSITY]), STD)
    records = tuple(make_record(e, family) for e in experiments)
    return Problem(family, records, hold, unknowns, np.array([True, True]), is_filtered=method == "pem")


def kalman_models(family, record, hold):
    """DiscreteModel of every interval at the start values."""
    ss = state_space(family, theta_of(family, START))
    return [sample(ss, float(h), hold, np.array([INTENSITY]), np.diag(STD**2)) for h in np.diff(record.time)]


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("kind", ["complete", "missing", "dropped rows", "uneven"])
def test_value_is_that_of_the_dense_gaussian(kind, hold):
    family, experiment = record_like(kind, 50, hold)
    problem = problem_for(family, [experiment], "pem", hold)
    record = problem.records[0]
    found = predict(problem, problem.unknowns.start)
    models = kalman_models(family, record, hold)
    typical = NoiseModel(
        np.mean([m.transition for m in models], axis=0),
        models[0].output,
        np.mean([m.process_cov for m in models], axis=0),
        np.diag(STD**2),
        models[0].cross_cov,
    )
    P0 = stationary_gains(typical).P
    on_grid = Experiment(
        "grid",
        record.time,
        record.inputs,
        np.where(record.observed, record.outputs, np.nan),
        ("u",),
        ("omega", "phi"),
    )
    dense = [
        DenseRecord(models, on_grid, found.initial_states[0] + shift, P0).log_likelihood()
        for shift in (0.0, np.array([1e-2, 0, 0, 0]), np.array([0, 0, -1e-3, 0]))
    ]
    assert -found.negative_log_likelihood == pytest.approx(dense[0], rel=1e-9)
    assert dense[0] > max(dense[1:]), "the initial mean maximises the likelihood"


@pytest.mark.parametrize("kind", ["complete", "missing", "uneven"])
def test_value_is_that_of_the_time_varying_kalman_filter(kind):
    family, experiment = record_like(kind, 600)
    problem = problem_for(family, [experiment], "pem")
    found = predict(problem, problem.unknowns.start)
    models = kalman_models(family, problem.records[0], "foh")
    P0 = found.gains[0].P if found.gains[0].P.ndim == 2 else found.gains[0].P[0]
    start = InitialState(found.initial_states[0], P0)
    expected = kalman_filter(models[0] if kind != "uneven" else models, experiment, start)
    assert -found.negative_log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-9)


@pytest.mark.parametrize("kind", ["complete", "missing", "dropped rows", "uneven"])
@pytest.mark.parametrize("method", ["oe", "pem"])
def test_gradient_equals_central_differences(method, kind):
    family, experiment = record_like(kind, 150)
    problem = problem_for(family, [experiment, record_like("complete", 80, seed=9)[1]], method)
    objective = objective_of(problem)
    z, step = problem.unknowns.start, 1e-5
    exact = objective(z, True)
    differences = np.array([
        (objective(z + e, False).value - objective(z - e, False).value) / (2 * step)
        for e in step * np.eye(z.size)
    ])  # fmt: skip
    assert np.allclose(exact.gradient, differences, rtol=1e-5, atol=1e-6 * np.max(np.abs(differences)))
    assert np.all(np.linalg.eigvalsh(exact.information) > 0.0)


@pytest.mark.parametrize("method", ["oe", "pem"])
def test_slopes_of_equal_steps_are_those_of_steps_that_may_differ(method):
    family, experiment = record_like("complete", 120)
    problem = problem_for(family, [experiment], method)
    unknowns, record = problem.unknowns, problem.records[0]
    z = unknowns.start
    theta, intensity, std = unknowns.values(z)
    found = problem.predict(z).found[0]
    noise = noise_levels(problem, intensity, std) if problem.is_filtered else None
    dyn = recursion(state_space(family, theta), record, "foh", noise, matrix_slopes(problem, theta))
    x0 = np.array([0.3, -0.1, 0.2, 0.5])
    if problem.is_filtered:
        found = problem.predict(z, True).found[0]
    equal, any_ = (
        innovation_slopes(replace(dyn, is_constant=is_constant), record, found, x0)
        for is_constant in (True, False)
    )
    np.testing.assert_allclose(equal, any_, rtol=1e-9, atol=1e-11 * np.max(np.abs(any_)))


def test_held_noise_that_reaches_an_output_has_an_exact_gradient():
    family = hand.family_from(
        [("x", "1")], ["u"], [("w", {"intensity": 0.02, "estimate": True})], ["y"],
        [Parameter("a", 0.8, min=0.0, estimate=True), Parameter("g", 1.3, estimate=True)],
        lambda x, u, w, p: ca.vertcat(-p[0] * x[0] + u[0] + p[1] * w[0]),
        lambda x, u, w, p: x[0] + p[1] * w[0],
    )  # fmt: skip
    rng = np.random.default_rng(0)
    u = rng.standard_normal((80, 1))
    experiment = Experiment("held", 0.1 * np.arange(80), u, rng.standard_normal((80, 1)), ("u",), ("y",))
    coordinates = tuple(parameter_coordinate(family, n, v, (None, None)) for n, v in (("a", 0.8), ("g", 1.3)))
    noise = Coordinate("w", "process", 0, 0.02, True, 1.0, 0.0, np.inf)
    unknowns = Unknowns((*coordinates, noise), np.array([0.8, 1.3]), np.array([0.02]), np.array([0.3]))
    problem = Problem(
        family, (make_record(experiment, family),), "foh", unknowns, np.array([True]), sampled="held"
    )
    objective, z, step = objective_of(replace(problem, is_filtered=True)), unknowns.start, 1e-5
    exact = objective(z, True)
    differences = [
        (objective(z + e, False).value - objective(z - e, False).value) / (2 * step) for e in step * np.eye(3)
    ]
    assert np.allclose(exact.gradient, differences, rtol=1e-6)
    dense = DenseRecord(
        [sample(state_space(family, unknowns.theta), 0.1, "foh", np.array([0.02]), np.array([0.09]), "held")],
        experiment,
        predict(problem, z).initial_states[0],
        predict(problem, z).gains[0].P,
    )
    assert exact.value == pytest.approx(-dense.log_likelihood(), rel=1e-9)


def test_output_error_is_the_simulation_by_an_independent_integrator():
    family, experiment = record_like("uneven", 60)
    problem = problem_for(family, [experiment], "oe")
    found = simulate(problem, theta_of(family, START), STD)
    ss = state_space(family, theta_of(family, START))
    time, u = experiment.time, experiment.inputs[:, 0]
    solution = solve_ivp(
        lambda t, x: ss.A @ x + ss.B[:, 0] * np.interp(t, time, u),
        (time[0], time[-1]),
        found.initial_states[0],
        t_eval=time,
        rtol=1e-10,
        atol=1e-12,
        max_step=0.005,
    )
    residuals = found.found[0].at_zero - np.tensordot(found.initial_states[0], found.found[0].response, 1)
    assert np.allclose(experiment.outputs - residuals, solution.y.T @ ss.C.T, atol=1e-7)
    assert np.allclose(found.measurement_std, np.sqrt(np.mean(residuals**2, axis=0)), rtol=1e-8)


def test_dropped_rows_are_predicted_exactly_on_the_grid():
    family, experiment = record_like("dropped rows", 200)
    on_grid = problem_for(family, [experiment], "oe")
    assert on_grid.records[0].period == pytest.approx(0.01)
    assert on_grid.records[0].n_samples > experiment.n_samples
    uneven = replace(experiment, time=experiment.time + 1e-4 * (np.arange(experiment.n_samples) % 2))
    one_by_one = problem_for(family, [uneven], "oe")
    assert one_by_one.records[0].period is None
    z = on_grid.unknowns.start
    same = Problem(
        family,
        (replace(one_by_one.records[0], time=experiment.time),),
        "foh",
        one_by_one.unknowns,
        one_by_one.weigh,
    )
    values = [objective_of(p)(z, False).value for p in (on_grid, same)]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize(("hold", "scale"), [("foh", 0.1), ("zoh", 0.1), ("zoh", 1.0)])
def test_uneven_steps_at_once_are_those_sampled_one_by_one(hold, scale, noisy, monkeypatch):
    rng = np.random.default_rng(4)
    family = hand.servo(TRUE)
    theta = theta_of(family, TRUE)
    ss = state_space(family, theta)
    slopes = state_space_derivatives(family, theta, ("c", "J2"))
    time = np.cumsum(np.concatenate([[0.0], rng.uniform(0.02, 0.03, 30), [0.1, 0.11]]) * scale)
    record = Record(
        "uneven",
        time,
        np.zeros((33, 1)),
        np.zeros((33, 2)),
        np.ones((33, 2), dtype=bool),
        None,
        np.arange(33),
    )
    noise = None
    if noisy:
        ss = replace(ss, G=rng.standard_normal((4, 2)), H=np.zeros((2, 2)))
        slopes |= {"G": rng.standard_normal((2, 4, 2)), "H": np.zeros((2, 2, 2))}
        moved = np.stack([np.zeros((2, 2)), np.eye(2)])
        noise = NoiseLevels(2.0 * np.eye(2), moved, np.eye(2), np.zeros((2, 2, 2)), "white")
    at_once = recursion(ss, record, hold, noise, slopes)
    assert at_once.Q.any() == noisy
    monkeypatch.setattr("daest.estimation.linear.linear_predictors.sample_steps", lambda *_: None)
    one_by_one = recursion(ss, record, hold, noise, slopes)
    assert np.array_equal(at_once.R, one_by_one.R)
    for name in ("Phi", "now", "following", "drift", "Q", "S12"):
        assert np.allclose(getattr(at_once, name), getattr(one_by_one, name), rtol=1e-10, atol=1e-13)
    for name in ("transition", "input_now", "input_next", "drift", "process_cov", "cross_cov"):
        found, known = getattr(at_once.slope, name), getattr(one_by_one.slope, name)
        assert found.shape == known.shape
        assert np.allclose(found, known, rtol=1e-9, atol=1e-12 * np.max(np.abs(known), initial=1.0))


@pytest.mark.parametrize(
    ("low", "high", "more", "most_nodes"),
    [(0.004, 0.07, (), 100), (0.0398, 0.0402, (), 6), (0.0398, 0.0402, (0.05, 0.077), 8)],
)
def test_interpolated_steps_are_sampled_exactly(low, high, more, most_nodes):
    rng = np.random.default_rng(2)
    family = hand.servo(TRUE)
    A = state_space(family, theta_of(family, TRUE)).A
    steps = np.concatenate([more, rng.uniform(low, high, 300)])
    time = np.append(0.0, np.cumsum(steps))
    nothing, at = np.zeros((time.size, 2)), np.arange(time.size)
    nodes, weights = _interpolation(Record("uneven", time, nothing, nothing, nothing == 0.0, None, at))
    assert len(nodes) <= most_nodes
    transitions = np.tensordot(weights, [transition_integrals(A, h).transition for h in nodes], 1)
    for h, Phi in zip(steps[:40], transitions, strict=False):
        assert np.allclose(Phi, transition_integrals(A, h).transition, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("seed", range(6))
def test_stationary_covariance_solves_the_riccati_equation(seed):
    rng = np.random.default_rng(seed)
    n, n_y = 4, 2
    Phi = rng.standard_normal((n, n))
    Phi *= 0.98 / np.max(np.abs(np.linalg.eigvals(Phi)))
    joint = rng.standard_normal((n + n_y, n + n_y))
    joint = joint @ joint.T
    noise = NoiseModel(Phi, rng.standard_normal((n_y, n)), joint[:n, :n], joint[n:, n:], joint[:n, n:])
    schur = filter_riccati(noise.Phi, noise.C, noise.Q, noise.R, noise.S12)
    assert np.allclose(stationary_gains(noise).P, schur, rtol=1e-9, atol=1e-10)


def test_an_integrator_with_hardly_any_noise_has_a_stationary_gain():
    # ẋ = w, y = x + e: P = q/2 + √(q²/4 + q r), in closed form, also where the closed loop is almost 1.
    for q in (1.0, 1e-8, 1e-16):
        noise = NoiseModel(np.eye(1), np.eye(1), np.array([[q]]), np.eye(1), np.zeros((1, 1)))
        assert stationary_gains(noise).P[0, 0] == pytest.approx(q / 2 + np.sqrt(q * q / 4 + q), rel=1e-7)


def test_noise_levels_enter_the_sampled_model():
    family = hand.servo(TRUE, noise={"intensity": 1e-4})
    _, experiment = record_like("complete", 10)
    record = make_record(experiment, family)
    ss = state_space(family, theta_of(family, TRUE))
    levels = NoiseLevels(np.diag([2.0]), np.zeros((0, 1, 1)), np.diag(STD**2), np.zeros((0, 2, 2)), "white")
    dyn = recursion(ss, record, "foh", levels)
    expected = sample(ss, record.period, "foh", np.array([2.0]), STD**2)
    assert np.array_equal(dyn.Q, expected.process_cov)
    assert np.array_equal(dyn.R, expected.measurement_cov)
