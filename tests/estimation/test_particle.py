"""Particle filter and smoother: the Kalman filter on a linear model, the exact filter on a grid for the
growth model."""

from dataclasses import dataclass

import numpy as np
import pytest
from nonlinear_models import explicit_from, oscillator, random_record

from daest.errors import EstimationError
from daest.estimation.filter_engines.ekf import run_ekf
from daest.estimation.filter_engines.filter_task import Noise, Start, Task, record
from daest.estimation.filter_engines.nonlinear_smoother import smooth_ekf
from daest.estimation.filter_engines.particle import (
    ContinuousPoints,
    run_particles,
    smooth_particles,
    systematic,
)
from daest.systems.simulation.local_linear import local_model
from daest.systems.simulation.simulate import simulate


@dataclass(frozen=True)
class GrowthModel:
    """x[k+1] = x/2 + 25 x/(1+x²) + 8 cos(1.2 (k+1)) + N(0, 10), y = x²/20 + N(0, 1) (Gordon, Salmond &
    Smith)."""

    process_variance: float = 10.0
    has_memory: bool = False

    def select(self, rows):
        pass

    def mean(self, k, x):
        return x / 2 + 25 * x / (1 + x**2) + 8 * np.cos(1.2 * (k + 1))

    def advance(self, k, points):
        root = np.full((points.shape[0], 1, 1), np.sqrt(self.process_variance))
        return self.mean(k, points), root

    def hold(self, k, points):
        return points

    def see(self, k, points):
        return points**2 / 20, (points / 10)[:, :, None]


def growth_record(seed, n=50):
    rng, model = np.random.default_rng(seed), GrowthModel()
    x = np.empty(n)
    x[0] = np.sqrt(5.0) * rng.standard_normal()
    for k in range(n - 1):
        x[k + 1] = model.mean(k, x[k]) + np.sqrt(10.0) * rng.standard_normal()
    return x, x**2 / 20 + rng.standard_normal(n)


def on_grid(y, points=None):
    """Exact filter by numerical integration: means, standard deviations (n,) and log p(y)."""
    x = np.linspace(-60.0, 60.0, 1201) if points is None else points
    width, model = x[1] - x[0], GrowthModel()
    p = np.exp(-0.5 * x**2 / 5.0)
    p /= p.sum() * width
    means, stds, log_likelihood = [], [], 0.0
    for k in range(y.size):
        p = p * np.exp(-0.5 * (y[k] - x**2 / 20) ** 2) / np.sqrt(2 * np.pi)
        total = p.sum() * width
        log_likelihood += np.log(total)
        p /= total
        means.append((x * p).sum() * width)
        stds.append(np.sqrt((x**2 * p).sum() * width - means[-1] ** 2))
        spread = np.exp(-0.5 * (x[:, None] - model.mean(k, x)[None]) ** 2 / 10.0) / np.sqrt(20 * np.pi)
        p = spread @ p * width
    return np.array(means), np.array(stds), log_likelihood


@pytest.mark.slow
@pytest.mark.parametrize("proposal", ["bootstrap", "ekf"])
def test_growth_model_agrees_with_the_exact_filter(proposal):
    """Errors of the particle means are Monte Carlo errors: std / sqrt(effective particles), band of 4."""
    _, y = growth_record(1)
    mean, std, log_likelihood = on_grid(y)
    runs = [
        run_particles(
            GrowthModel(), y[:, None], np.ones(1), Start(np.zeros(1), 5 * np.eye(1)), 4000, seed, proposal
        )
        for seed in range(6)
    ]
    spread = np.std([run.mean[:, 0] for run in runs], axis=0, ddof=1)
    centre = np.mean([run.mean[:, 0] for run in runs], axis=0)
    # Student's t with 5 degrees of freedom; 7 of 50 samples would be outside 2.0 by chance once in a
    # thousand.
    assert np.sum(np.abs(centre - mean) > 4.0 * spread / np.sqrt(6)) <= 4
    assert np.sqrt(np.mean((centre - mean) ** 2)) < 0.1 * np.sqrt(np.mean(std**2))
    values = np.array([run.log_likelihood for run in runs])
    assert abs(values.mean() - log_likelihood) < 5 * values.std(ddof=1) / np.sqrt(6) + 0.05


@pytest.mark.slow
def test_growth_model_error_is_that_of_the_best_estimate():
    """Root mean square error over records against that of the exact filter, which nothing can beat."""
    squares = []
    for seed in range(20):
        x, y = growth_record(seed)
        run = run_particles(
            GrowthModel(), y[:, None], np.ones(1), Start(np.zeros(1), 5 * np.eye(1)), 1000, seed, "bootstrap"
        )
        squares.append((np.mean((run.mean[:, 0] - x) ** 2), np.mean((on_grid(y, GRID)[0] - x) ** 2)))
    particle, exact = np.sqrt(np.mean(squares, axis=0))
    assert particle == pytest.approx(exact, rel=0.03)
    assert 4.0 < exact < 5.5


GRID = np.linspace(-50.0, 50.0, 401)


def linear_case(n=150):
    """A damped oscillator, driven by noise, of which the position is measured."""
    explicit = explicit_from(
        ("x", "v"),
        {"k": 4.0, "d": 0.5},
        lambda x, u, w, theta, t: [x[1], u[0] + w[0] - theta[0] * x[0] - theta[1] * x[1]],
        {"y": lambda x, u, theta: x[0]},
        ("w",),
    )
    time = 0.1 * np.arange(n)
    u = np.sin(time)[:, None]
    sim = simulate(explicit, (time, u), hold="zoh", noise=True, seed=3, intensities={"w": 0.5})
    y = sim.outputs + 0.1 * np.random.default_rng(3).standard_normal((n, 1))
    y[40:50] = np.nan
    noise, start = Noise(np.array([0.5]), np.array([0.01])), Start(np.zeros(2), 0.1 * np.eye(2))
    model = local_model(explicit)
    data = record(model, time, u, y, "zoh")
    return Task.of(model, data, explicit.flat.theta_values, noise, start, np.inf)


@pytest.mark.parametrize("proposal", [pytest.param("bootstrap", marks=pytest.mark.slow), "ekf"])
def test_linear_model_within_its_monte_carlo_band(proposal):
    task, m = linear_case(), 1000
    exact = run_ekf(
        task.model, task.data, task.theta, task.noise, task.start
    )  # the Kalman filter, as tested there
    points = ContinuousPoints(task)
    runs = [
        run_particles(points, task.data.outputs, task.noise.variance, task.start, m, s, proposal)
        for s in range(6)
    ]
    std = np.sqrt(np.diagonal(exact.filtered_cov, axis1=1, axis2=2))
    errors = np.array([(run.mean - exact.filtered) / std for run in runs])
    # A mean of independent particles would be off by 1/sqrt(m); resampling costs a factor, here at most 3.
    assert np.sqrt(np.mean(errors**2)) < 3.0 / np.sqrt(m)
    assert np.sqrt(np.mean(errors.mean(axis=0) ** 2)) < 3.0 / np.sqrt(6 * m)  # no bias beside it
    ratio = np.mean([np.diagonal(run.cov, axis1=1, axis2=2) / std**2 for run in runs], axis=(0, 1))
    assert np.allclose(ratio, 1.0, atol=0.05)
    values = np.array([run.log_likelihood for run in runs])
    assert abs(values.mean() - exact.log_likelihood) < 5 * values.std(ddof=1) / np.sqrt(6) + 0.1
    assert np.mean(runs[0].nis) == pytest.approx(
        np.nanmean(exact.innovations**2 / exact.variances) * 140 / 150, rel=0.05
    )
    if proposal == "ekf":
        plain = run_particles(points, task.data.outputs, task.noise.variance, task.start, m, 0, "bootstrap")
        assert runs[0].effective.min() > plain.effective.min()
        assert np.median(runs[0].effective) > 0.5 * m


def test_smoother_of_a_linear_model():
    task = linear_case(90)
    known = smooth_ekf(
        run_ekf(task.model, task.data, task.theta, task.noise, task.start), task.data, task.noise
    )
    points = ContinuousPoints(task)
    run = run_particles(points, task.data.outputs, task.noise.variance, task.start, 1200, 0)
    found = smooth_particles(points, run, 1)
    assert found.is_simulated
    std = np.sqrt(np.diagonal(known.cov, axis1=1, axis2=2))[:, :2]
    error = (found.states.mean(axis=1) - known.mean[:, :2]) / std
    # 200 trajectories, which share particles: 1/sqrt(200) = 0.07 and more
    assert np.sqrt(np.mean(error**2)) < 0.2
    assert np.allclose(np.mean(found.states.var(axis=1) / std**2, axis=0), 1.0, atol=0.15)


def test_ancestral_lines_where_noise_does_not_reach_every_state():
    task = linear_case(40)
    silent = Task.of(
        task.model, task.data, task.theta, Noise(np.zeros(1), np.array([0.05])), task.start, np.inf
    )
    points = ContinuousPoints(silent)
    run = run_particles(points, silent.data.outputs, silent.noise.variance, silent.start, 2000, 0)
    found = smooth_particles(points, run)
    assert not found.is_simulated
    following, _ = points.advance(0, found.states[0])
    assert np.allclose(following, found.states[1], rtol=1e-9)


def test_seed_decides_and_threads_do_not_matter(monkeypatch):
    task = linear_case(6)

    def run(seed, n_processors):
        monkeypatch.setattr("os.cpu_count", lambda: n_processors)
        points = ContinuousPoints(task)
        return run_particles(points, task.data.outputs, task.noise.variance, task.start, 8005, seed).points

    first = run(7, 1)
    assert np.array_equal(first, run(7, 2))
    assert not np.array_equal(first, run(8, 2))


@pytest.mark.parametrize("proposal", [pytest.param("bootstrap", marks=pytest.mark.slow), "ekf"])
def test_loop_without_compiler_gives_the_same(proposal):
    explicit = oscillator()
    time, (u, y) = 0.1 * np.arange(8), random_record(8, 1, missing=0.2)
    results = []
    for compiled in (True, False):
        model = local_model(explicit, inside=True, compiled=compiled)
        data = record(model, time, u, y, "foh")
        task = Task.of(
            model,
            data,
            explicit.flat.theta_values,
            Noise(np.ones(1), np.ones(1)),
            Start(np.zeros(2), np.eye(2)),
            0.05,
        )
        points = ContinuousPoints(task)
        run = run_particles(points, y, np.ones(1), task.start, 21, 0, proposal)
        results.append((run, points.inside(5, run.points[5], run.weights[5])))
    (run, inside), (plain, plain_inside) = results
    for name in ("points", "innovations", "innovation_cov", "nis", "effective", "ancestors"):
        assert np.allclose(getattr(run, name), getattr(plain, name), rtol=1e-9, atol=1e-12, equal_nan=True)
    assert np.allclose(run.weights, plain.weights, rtol=1e-7)
    assert run.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-9)
    assert np.allclose(inside, plain_inside, rtol=1e-9)
    assert inside[0][0] == pytest.approx(run.mean[5, 0]) and inside[1][0] == pytest.approx(
        np.sqrt(run.cov[5, 0, 0])
    )


def test_systematic_resampling_keeps_the_shares():
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(50))
    counts = np.bincount(systematic(weights, rng), minlength=50)
    assert np.all(np.abs(counts - 50 * weights) < 1.0)


def test_collapse_is_named():
    task = linear_case(20)
    points = ContinuousPoints(task)
    outputs = np.full((20, 1), 1e200)
    with pytest.raises(EstimationError) as collapsed, np.errstate(over="ignore"):
        run_particles(points, outputs, task.noise.variance, task.start, 50, 0, "bootstrap", task.data.time)
    assert collapsed.value.code == "particle-collapse"
    far = run_particles(points, np.full((20, 1), 5.0), np.full(1, 1e-6), task.start, 50, 0, "bootstrap")
    assert far.collapsed.size > 0
