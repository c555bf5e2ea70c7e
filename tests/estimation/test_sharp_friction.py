"""The extended filter and its likelihood on Coulomb friction that is rounded over less than the state is
known: the truth is a simulation under noise held over steps much shorter than the friction's own time."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from nonlinear_models import SERVO, experiment_of, explicit_from, friction_servo, setup_of
from scipy.stats import chi2

from daest.estimation.filter_engines.ekf import run_ekf
from daest.estimation.filter_engines.filter_task import Noise, Start, record
from daest.estimation.fitting.coordinates import Coordinate, Unknowns
from daest.estimation.nonlinear.ekf_likelihood import identify_by_ekf
from daest.model.fit import IdentifyOptions
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.local_linear import local_model

WIDTH = 0.02  # rad/s, over which the friction is rounded; the noise moves the speed by 0.13 rad/s per sample
INTENSITY, STD = np.full(2, 1e-4), np.array([0.02, 0.01])
PERIOD, FINE = 0.005, 60  # noise steps per sample: half the friction's time constant of 0.18 ms
TRUE = {"stick": SERVO["stick"], "k": SERVO["k"], "J2": SERVO["J2"]}


@cache
def with_torques():
    """The servo with its noises as inputs."""

    def rhs(x, u, w, theta, t):
        J1, J2, d, c, k, R, stick, width = (theta[i] for i in range(8))
        torque = c * (x[1] - x[3]) + d * (x[0] - x[2])
        motor = 30 * k * (u[0] - 30 * k * x[0]) / R - 30 * stick * ca.tanh(x[0] / width)
        return [(motor - torque + u[1]) / J1, x[0], (torque + u[2]) / J2, x[2]]

    outputs = {"speed": lambda x, u, theta: x[0], "angle": lambda x, u, theta: x[3]}
    explicit = explicit_from(
        ("omega", "gear", "disc", "phi"), {**SERVO, "width": WIDTH}, rhs, outputs, (), ("u", "w1", "w2")
    )
    return integrator(explicit)


def recorded(seed, n=600):
    """Time, input, outputs with noise, true states."""
    engine, rng = with_torques(), np.random.default_rng(seed)
    u = 3.0 * np.sin(2 * np.pi * PERIOD * np.arange(n))
    held = rng.standard_normal((n * FINE, 2)) * np.sqrt(INTENSITY * FINE / PERIOD)
    inputs = np.column_stack([np.repeat(u, FINE), held])
    time = PERIOD / FINE * np.arange(n * FINE)
    theta = engine.explicit.flat.theta_values
    run = integrate(engine, time, inputs, theta, np.zeros(4), hold="zoh", rtol=1e-5)
    outputs = run.outputs[::FINE] + STD * rng.standard_normal((n, 2))
    return PERIOD * np.arange(n), u[:, None], outputs, run.states[::FINE]


def model():
    return friction_servo(stiffening=0.0, width=WIDTH)


def identified(seed):
    time, u, y, _ = recorded(seed)
    explicit = model()
    names = [p.name for p in explicit.flat.parameters]
    starts = {"stick": 0.015, "k": 0.055, "J2": 0.022}
    coordinates = tuple(
        Coordinate(name, "parameter", names.index(name), value, True, 1.0, 0.0, np.inf)
        for name, value in starts.items()
    )
    unknowns = Unknowns(coordinates, explicit.flat.theta_values, INTENSITY, STD)
    return identify_by_ekf(
        explicit,
        setup_of(
            unknowns,
            [experiment_of(explicit, time, u, y)],
            "pem",
            np.full(2, np.nan),
            np.ones(2, dtype=bool),
            STD,
            IdentifyOptions(hold="zoh"),
        ),
    )


def test_innovations_and_errors_have_the_size_that_the_filter_says():
    time, u, y, truth = recorded(3, n=1500)
    explicit = model()
    compiled = local_model(explicit)
    data = record(compiled, time, u, y, "zoh")
    start = Start(np.zeros(4), 1e-6 * np.eye(4))
    run = run_ekf(compiled, data, explicit.flat.theta_values, Noise(INTENSITY, STD**2), start, PERIOD / 16)
    nis = np.mean(run.innovations**2 / run.variances, axis=0)
    assert np.all((nis > 0.88) & (nis < 1.12))  # 1500 samples: one standard deviation is 0.037
    slow = np.abs(truth[:, 0]) < 0.1  # where the friction turns over
    assert slow.sum() > 100
    predicted = run.innovations[slow, 0] ** 2 / run.variances[slow, 0]
    assert 0.7 < np.mean(predicted) < 1.3


def errors_in_std(fit):
    p = len(TRUE)
    std = np.array([q.std_error for q in fit.parameters])
    cov = fit.correlation[:p, :p] * np.outer(std, std)
    error = np.array([q.value for q in fit.parameters]) - list(TRUE.values())
    return error / std, float(error @ np.linalg.solve(cov, error))


@pytest.mark.slow
def test_likelihood_finds_friction_and_noises():
    fit = identified(0)
    assert fit.status == "converged"
    assert any("extended Kalman filter" in note for note in fit.notes)
    assert errors_in_std(fit)[1] < chi2.ppf(0.999, len(TRUE))
    assert fit.parameters[0].std_error < 0.05 * TRUE["stick"]
    motor, disc = (noise.value for noise in fit.noises if noise.kind == "process")
    assert 0.7e-4 < motor < 1.4e-4 and 0.4e-4 < disc < 2.5e-4


@pytest.mark.slow
def test_friction_has_no_bias_and_an_honest_error_in_20_seeds():
    runs = 20
    found = [errors_in_std(identified(seed)) for seed in range(runs)]
    low, high = chi2.ppf([0.001, 0.999], runs * len(TRUE))
    assert low < sum(square for _, square in found) < high
    mean = np.mean([z for z, _ in found], axis=0)
    assert np.all(np.abs(mean) < 3.3 / np.sqrt(runs))  # two-sided, 0.1 %
