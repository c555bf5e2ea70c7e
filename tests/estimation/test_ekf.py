"""Extended Kalman filter: against the Kalman filter on linear models, finite differences, and the loop in
NumPy."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from nonlinear_models import (
    experiment_of,
    explicit_from,
    friction_servo,
    linear_servo,
    oscillator,
    random_record,
    time_grid,
)

from daest.errors import EstimationError, ModelError
from daest.estimation.filter_engines.ekf import ekf_likelihood, run_ekf
from daest.estimation.filter_engines.filter_task import Directions, Noise, Start, record
from daest.estimation.filter_engines.kalman import kalman_filter
from daest.estimation.filter_engines.nonlinear_smoother import smooth_ekf
from daest.estimation.filter_engines.smoother import smooth
from daest.model.estimates import InitialState
from daest.modelica.compile import compile_model
from daest.systems.events.integration import IntegrationError
from daest.systems.linear.state_space import sample, state_space, state_space_family
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.local_linear import local_model

NOISE = Noise(np.array([1e-3, 2e-3]), np.array([0.01, 0.02]))
START = Start(np.array([0.1, 0.0, -0.1, 0.2]), 0.01 * np.diag([1.0, 2.0, 3.0, 4.0]))
EQUAL = 1e-8  # in standard deviations


def kalman(explicit, time, u, y, hold):
    """The filter of linear models, sampled exactly for every interval."""
    ss = state_space(state_space_family(explicit), explicit.flat.theta_values)
    models = [
        sample(ss, float(step), hold, np.diag(NOISE.intensity), np.diag(NOISE.variance))
        for step in np.diff(time)
    ]
    return kalman_filter(models, experiment_of(explicit, time, u, y), InitialState(START.mean, START.cov))


def test_is_the_kalman_filter_on_a_linear_model():
    explicit, n = linear_servo(), 300
    model = local_model(explicit)
    for hold, irregular in (("zoh", False), ("foh", False), ("zoh", True), ("foh", True)):
        time = time_grid(n, 0.005, irregular)
        u, y = random_record(n, 2)
        known = kalman(explicit, time, u, y, hold)
        found = run_ekf(model, record(model, time, u, y, hold), explicit.flat.theta_values, NOISE, START)
        std = np.sqrt(np.diagonal(found.filtered_cov, axis1=1, axis2=2))
        pair = std[:, :, None] * std[:, None, :]
        assert np.max(np.abs(found.filtered - known.filtered.mean[:, :4]) / std) < EQUAL
        assert np.max(np.abs(found.filtered_cov - known.filtered.cov.array()[:, :4, :4]) / pair) < EQUAL
        assert np.max(np.abs(found.predicted - known.predicted.mean) / std) < EQUAL
        assert found.log_likelihood == pytest.approx(known.log_likelihood, abs=EQUAL)


def test_smoother_is_that_of_the_linear_model():
    explicit, n = linear_servo(), 200
    time, (u, y) = time_grid(n, 0.005), random_record(n, 2)
    model = local_model(explicit)
    data = record(model, time, u, y, "foh")
    joint = smooth_ekf(run_ekf(model, data, explicit.flat.theta_values, NOISE, START), data, NOISE)
    known = smooth(kalman(explicit, time, u, y, "foh")).smoothed
    std = np.sqrt(np.diagonal(known.cov.array(), axis1=1, axis2=2))
    pair = std[:, :, None] * std[:, None, :]
    assert np.max(np.abs(joint.mean - known.mean) / std) < EQUAL
    assert np.max(np.abs(joint.cov - known.cov.array()) / pair) < EQUAL


def test_substeps_do_not_matter_on_a_linear_model():
    explicit = linear_servo()
    model = local_model(explicit)
    time, (u, y) = time_grid(50, 0.02), random_record(50, 2)
    data = record(model, time, u, y, "foh")
    one, many = (
        run_ekf(model, data, explicit.flat.theta_values, NOISE, START, longest) for longest in (np.inf, 0.003)
    )
    assert np.allclose(one.filtered, many.filtered, rtol=1e-9, atol=1e-12)
    assert np.allclose(one.transition, many.transition, rtol=1e-9, atol=1e-12)
    assert np.allclose(one.noise, many.noise, rtol=1e-9, atol=1e-14)


def directions_of(explicit, names):
    """One direction per chosen parameter (its own size), one per intensity, variance and initial state."""
    theta = dict(zip([p.name for p in explicit.flat.parameters], explicit.flat.theta_values, strict=True))
    p, n = len(names), explicit.n_states
    n_w, n_y = len(explicit.flat.noises), len(explicit.flat.outputs)
    blocks = [
        np.diag([theta[name] for name in names]),
        np.diag(NOISE.intensity[:n_w]),
        np.diag(NOISE.variance[:n_y]),
    ]
    blocks.append(0.1 * np.eye(n))
    rows = np.cumsum([0, p, n_w, n_y, n])
    tables = []
    for k, block in enumerate(blocks):
        table = np.zeros((rows[-1], block.shape[1]))
        table[rows[k] : rows[k + 1]] = block
        tables.append(table)
    return Directions(*tables)


def test_gradient_is_that_of_finite_differences():
    explicit, names = friction_servo(), ("J1", "c", "stick", "width")
    model = local_model(explicit, names, tangents=True)
    n, longest = 150, 0.003
    time, (u, y) = time_grid(n, 0.005, irregular=True), random_record(n, 2)
    data = record(model, time, u, y, "foh")
    along = directions_of(explicit, names)
    found = ekf_likelihood(model, data, explicit.flat.theta_values, NOISE, START, longest, along)
    columns = [[p.name for p in explicit.flat.parameters].index(name) for name in names]

    def value(step):
        theta = explicit.flat.theta_values.copy()
        theta[columns] += step @ along.parameters
        noise = Noise(NOISE.intensity + step @ along.intensity, NOISE.variance + step @ along.variance)
        start = Start(START.mean + step @ along.mean, START.cov)
        return ekf_likelihood(model, data, theta, noise, start, longest)

    h = 1e-5
    scale = np.max(np.abs(found.gradient))
    for d, step in enumerate(h * np.eye(along.n)):
        up, down = value(step), value(-step)
        slope = (up.log_likelihood - down.log_likelihood) / (2 * h)
        assert found.gradient[d] == pytest.approx(slope, rel=1e-6, abs=1e-7 * scale)
        assert np.allclose(
            found.whitened_slopes[:, d], (up.whitened - down.whitened) / (2 * h), rtol=1e-5, atol=1e-6
        )


def test_loop_without_compiler_gives_the_same():
    explicit, names = friction_servo(), ("J2", "stick")
    time, (u, y) = time_grid(25, 0.005, irregular=True), random_record(25, 2)
    along = directions_of(explicit, names)
    results = []
    for compiled in (True, False):
        model = local_model(explicit, names, tangents=True, compiled=compiled)
        assert (model.library is not None) == compiled
        data = record(model, time, u, y, "foh")
        theta = explicit.flat.theta_values
        results.append(
            (
                ekf_likelihood(model, data, theta, NOISE, START, 0.003, along),
                run_ekf(model, data, theta, NOISE, START, 0.003),
            )
        )
    (likelihood, run), (plain, plain_run) = results
    assert np.allclose(likelihood.gradient, plain.gradient, rtol=1e-10)
    assert np.allclose(likelihood.log_variance_slopes, plain.log_variance_slopes, rtol=1e-9, atol=1e-12)
    for name in run.__dataclass_fields__:
        own, other = getattr(run, name), getattr(plain_run, name)
        assert (own is None) == (other is None), name
        assert own is None or np.allclose(own, other, rtol=1e-9, atol=1e-13, equal_nan=True), name


def test_filters_a_model_with_a_newton_loop():
    """x' = -z + u + w with z + z³/3 = x: the loop has no closed form that the reduction would find."""
    path = Path(__file__).parent / "models" / "Loop.mo"
    explicit = reduce_index(compile_model(path))
    assert not explicit.is_symbolic
    theta, noise = explicit.flat.theta_values, Noise(np.array([1e-2]), np.array([1e-2]))
    model = local_model(explicit, ("a",), tangents=True)
    n = 60
    time, (u, y) = time_grid(n, 0.1), random_record(n, 1)
    data = record(model, time, u, y, "zoh")
    start = Start(np.array([0.3]), np.array([[0.1]]))
    along = Directions(np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))
    found = ekf_likelihood(model, data, theta, noise, start, np.inf, along)
    h = 1e-5
    slope = np.subtract(
        *[ekf_likelihood(model, data, theta + e, noise, start).log_likelihood for e in (h, -h)]
    ) / (2 * h)
    assert found.gradient[0] == pytest.approx(slope, rel=1e-5)


def test_information_is_that_of_the_score():
    """Over repeated records the covariance of the score at the truth is the Fisher information."""
    explicit = explicit_from(
        ("x",),
        {"a": 1.0},
        lambda x, u, w, theta, t: [u[0] + w[0] - theta[0] * x[0]],
        {"y": lambda x, u, theta: x[0]},
        ("w",),
    )
    model = local_model(explicit, ("a",), tangents=True)
    noise, n, runs = Noise(np.array([0.1]), np.array([0.01])), 100, 200
    ss = state_space(state_space_family(explicit), explicit.flat.theta_values)
    step = sample(ss, 0.1, "zoh", np.diag(noise.intensity), np.diag(noise.variance))
    along = Directions(
        *(
            np.array(rows, dtype=float)
            for rows in ([[1.0], [0], [0]], [[0], [0.1], [0]], [[0], [0], [0.01]], [[0], [0], [0]])
        )
    )
    rng = np.random.default_rng(5)
    scores, informations = [], []
    u = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10)[:, None]
    for _ in range(runs):
        x, y = 0.0, np.empty((n, 1))
        for k in range(n):
            y[k] = x + 0.1 * rng.standard_normal()
            x = (
                step.transition[0, 0] * x
                + step.input_now[0, 0] * u[k, 0]
                + np.sqrt(step.process_cov[0, 0]) * rng.standard_normal()
            )
        data = record(model, 0.1 * np.arange(n), u, y, "zoh")
        start = Start(np.zeros(1), np.zeros((1, 1)))
        found = ekf_likelihood(model, data, explicit.flat.theta_values, noise, start, np.inf, along)
        scores.append(found.gradient)
        informations.append(found.information)
    information = np.mean(informations, axis=0)
    spread = np.array(scores).T @ np.array(scores) / runs
    # The standard deviation of a mean square over `runs` records is sqrt(2 / runs) of it; the band is four of
    # them.
    assert np.allclose(np.diagonal(spread) / np.diagonal(information), 1.0, atol=4 * np.sqrt(2 / runs))


def test_steps_of_linearisation_are_of_second_order():
    explicit = oscillator()
    model = local_model(explicit)
    n = 60
    time, (u, y) = time_grid(n, 0.2), random_record(n, 1)
    data = record(model, time, 3 * u, y, "foh")
    certain = Start(np.array([1.0, 0.0]), np.zeros((2, 2)))
    unsure = Start(certain.mean, 0.01 * np.eye(2))
    for start, intensity in ((certain, 0.0), (unsure, 0.1)):
        noise = Noise(np.array([intensity]), np.array([0.01]))
        runs = [
            run_ekf(model, data, explicit.flat.theta_values, noise, start, 0.2 / k).filtered
            for k in (8, 16, 256)
        ]
        coarse, fine = (np.max(np.abs(run - runs[2])) for run in runs[:2])
        assert coarse / fine == pytest.approx(4.0, rel=0.35)


def test_failures_are_named():
    explicit = linear_servo()
    model = local_model(explicit)
    time, (u, y) = time_grid(20, 0.005), random_record(20, 2, missing=0.0)
    data = record(model, time, u, y, "zoh")
    theta = explicit.flat.theta_values
    silent = Noise(np.zeros(2), np.zeros(2))
    with pytest.raises(EstimationError) as singular:
        run_ekf(model, data, theta, silent, Start(np.zeros(4), np.zeros((4, 4))))
    assert singular.value.code == "filter-singular-innovation"
    with pytest.raises(IntegrationError) as failed:
        run_ekf(model, data, np.full_like(theta, np.nan), NOISE, START)
    assert failed.value.time == time[0]
    with pytest.raises(ModelError) as unknown:
        local_model(explicit, ("nothing",))
    assert unknown.value.code == "unknown-parameter"


def test_refuses_white_noise_in_an_output():
    explicit = oscillator()
    arguments = explicit.outputs.sx_in()
    noisy = replace(
        explicit, outputs=ca.Function("y", arguments, [explicit.outputs(*arguments) + arguments[3]])
    )
    with pytest.raises(EstimationError) as refused:
        local_model(noisy)
    assert refused.value.code == "output-white-noise"
