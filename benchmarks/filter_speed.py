"""Filters beside statsmodels and numpy: rows of `speed.py`."""

from __future__ import annotations

from collections.abc import Iterator

import nonlinear_speed as servo
import numpy as np
import scipy.linalg as sla
from timed import Row, in_turn

from daest.estimation.filter_engines.ekf import ekf_likelihood
from daest.estimation.filter_engines.filter_task import Noise, Start, Task
from daest.estimation.filter_engines.filter_task import record as prepared
from daest.estimation.filter_engines.kalman import kalman_filter
from daest.estimation.filter_engines.particle import ContinuousPoints, run_particles, systematic
from daest.model.estimates import InitialState
from daest.model.experiment import Experiment
from daest.model.linear import DiscreteModel
from daest.numerics.recursions import linear_recursion
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.local_linear import local_model

PERIOD = 0.01
EQUAL = 1e-9  # relative difference of two log-likelihoods of one problem
# States, samples, share of the values that are missing, runs.
KALMAN = (
    (4, 1000, 0.0, 15),
    (4, 100_000, 0.0, 5),
    (4, 20_000, 0.1, 5),
    (20, 2000, 0.0, 7),
    (100, 500, 0.0, 5),
    (400, 500, 0.0, 1),
)
PARTICLES, SAMPLES = 1000, 1000


def chain(n: int) -> DiscreteModel:
    """n / 2 masses between damped springs; noise forces on the first and the last, which are measured."""
    m = n // 2
    K = 2 * np.eye(m) - np.eye(m, k=1) - np.eye(m, k=-1)
    A = np.block([[np.zeros((m, m)), np.eye(m)], [-100 * K, -0.5 * K - 0.1 * np.eye(m)]])
    B, C = np.zeros((n, 2)), np.zeros((2, n))
    B[m, 0] = B[n - 1, 1] = C[0, 0] = C[1, m - 1] = 1.0
    Phi = sla.expm(PERIOD * A)
    G = np.sqrt(PERIOD) * (Phi @ B).T
    none, small = np.zeros((n, 0)), np.zeros((2, 0))
    return DiscreteModel(
        transition=Phi, input_now=none, input_next=none, drift=np.zeros(n), output=C, feedthrough=small,
        output_offset=np.zeros(2), process_cov=G.T @ G, measurement_cov=1e-4 * np.eye(2),
        cross_cov=np.zeros((n, 2)), noise_cov=np.eye(2), noise_process_cov=G,
        noise_measurement_cov=np.zeros((2, 2)), period=PERIOD, hold="zoh",
    )  # fmt: skip


def record(model: DiscreteModel, n_samples: int, missing: float) -> Experiment:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((n_samples - 1, 2)) @ model.noise_process_cov
    states = linear_recursion(model.transition, noise, np.zeros(model.transition.shape[0]))
    y = states @ model.output.T + 0.01 * rng.standard_normal((n_samples, 2))
    y[rng.uniform(size=y.shape) < missing] = np.nan
    return Experiment(
        "chain", PERIOD * np.arange(n_samples), np.zeros((n_samples, 0)), y, (), ("first", "last")
    )


def statsmodels_filter(model: DiscreteModel, experiment: Experiment):
    from statsmodels.tsa.statespace.kalman_filter import KalmanFilter

    n = model.transition.shape[0]
    peer = KalmanFilter(k_endog=2, k_states=n)
    peer.bind(experiment.outputs.copy())
    peer["design"], peer["obs_cov"] = model.output, model.measurement_cov
    peer["transition"], peer["selection"], peer["state_cov"] = model.transition, np.eye(n), model.process_cov
    peer.initialize_known(np.zeros(n), np.eye(n))
    return peer


def kalman_rows() -> Iterator[Row]:
    for n, n_samples, missing, repeat in KALMAN:
        model = chain(n)
        experiment, known = record(model, n_samples, missing), InitialState.known(np.zeros(n), 1.0)
        peer = statsmodels_filter(model, experiment)
        if abs(kalman_filter(model, experiment, known).log_likelihood / peer.loglike() - 1.0) > EQUAL:
            raise SystemExit(f"the log-likelihoods of {n} states differ: not the same problem")
        runs = [lambda m=model, e=experiment, k=known: kalman_filter(m, e, k), peer.filter]
        ours, theirs = (1e3 * seconds for seconds in in_turn(runs, repeat))
        what = f"{n} states, {n_samples} samples" + (", 10 % missing" if missing else "")
        yield Row(f"Kalman filter, {what}", "ms", ours, "statsmodels", theirs)


def plain_bootstrap(y: np.ndarray, u: np.ndarray, theta: np.ndarray, noise: Noise) -> None:
    """A bootstrap filter as one writes it in numpy: two Runge-Kutta steps of order 4 a sample."""
    import casadi as ca

    x, v, p = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("p", 8)
    flow = ca.Function("f", [x, v, p], [servo.rates(x, v, p)]).map(PARTICLES)
    rng, h = np.random.default_rng(0), servo.PERIOD / 2
    points = 0.1 * rng.standard_normal((4, PARTICLES))
    reach = np.sqrt(noise.intensity * servo.PERIOD)[:, None] / theta[:2, None]
    for k in range(y.shape[0]):
        error = y[k][:, None] - points[[0, 3]]
        log_weight = -0.5 * np.sum(error**2 / noise.variance[:, None], axis=0)
        weight = np.exp(log_weight - log_weight.max())
        points = points[:, systematic(weight / weight.sum(), rng)]
        for _ in range(2):
            rate = lambda at, k=k: flow(at, u[k], theta).full()  # noqa: E731
            k1 = rate(points)
            k2 = rate(points + h / 2 * k1)
            k3 = rate(points + h / 2 * k2)
            points = points + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(points + h * k3))
        points[[0, 2]] += reach * rng.standard_normal((2, PARTICLES))


def nonlinear_rows() -> Iterator[Row]:
    explicit = servo.servo()
    theta = explicit.flat.theta_values
    t, u = servo.drive(SAMPLES)
    solved = integrate(integrator(explicit), t, u, theta, np.zeros(4), hold="zoh", rtol=servo.RTOL)
    y = solved.outputs + np.array([0.1, 0.01]) * np.random.default_rng(1).standard_normal((SAMPLES, 2))
    data = prepared(local_model(explicit), t, u, y, "zoh")
    model = local_model(explicit)
    noise, start = Noise(np.array([1e-4, 1e-4]), np.array([1e-2, 1e-4])), Start(np.zeros(4), 0.01 * np.eye(4))
    (seconds,) = in_turn([lambda: ekf_likelihood(model, data, theta, noise, start)], 9)
    yield Row("extended filter of a servo, a sample and state", "us", 1e6 * seconds / SAMPLES / 4)
    points = ContinuousPoints(Task.of(model, data, theta, noise, start, np.inf))
    runs = [
        lambda: run_particles(points, data.outputs, noise.variance, start, PARTICLES, 0, "bootstrap"),
        lambda: plain_bootstrap(y, u, theta, noise),
    ]
    ours, theirs = (SAMPLES * PARTICLES / 1e3 / seconds for seconds in in_turn(runs, 3))
    name = f"particle filter, {PARTICLES} particles, {SAMPLES} samples"
    yield Row(name, "particles a ms", ours, "plain numpy", theirs, is_rate=True)
