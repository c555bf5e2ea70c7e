"""Comparison of models against the closed form of a first-order lag."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from daest.diagnosis.compare import Candidate, compare_models
from daest.model.experiment import Experiment
from daest.model.flat import Equation, FlatModel, Output, Parameter, Variable

TIME_CONSTANT, GAIN, START, PERIOD = 0.5, 2.0, 0.7, 0.05


def lag(time_constant=TIME_CONSTANT, noise_std=None) -> FlatModel:
    x, dx, u, theta = ca.SX.sym("x"), ca.SX.sym("dx"), ca.SX.sym("u"), ca.SX.sym("theta", 2)
    return FlatModel(
        name="Lag",
        unknowns=(Variable("x", "V"),),
        inputs=(Variable("u", "V"),),
        noises=(),
        parameters=(Parameter("T", time_constant), Parameter("k", GAIN)),
        outputs=(Output("y", "V", noise_std=noise_std),),
        equations=(Equation("T*der(x) = k*u - x", "component", "lag"),),
        derivatives=dx,
        xi=x,
        u=u,
        w=ca.SX(0, 1),
        theta=theta,
        time=ca.SX.sym("t"),
        residual=theta[0] * dx - theta[1] * u + x,
        output_expressions=x,
    )


def exact(n_samples):
    """Time, held input and response from the initial value START."""
    u = np.repeat(np.random.default_rng(0).normal(size=n_samples // 5 + 1), 5)[:n_samples]
    x, keep = np.full(n_samples, START), np.exp(-PERIOD / TIME_CONSTANT)
    for i in range(1, n_samples):
        x[i] = keep * x[i - 1] + (1 - keep) * GAIN * u[i - 1]
    return PERIOD * np.arange(n_samples), u, x


def experiment(time, u, y):
    return Experiment("run", time, u[:, None], y[:, None], ("u",), ("y",))


def test_true_model_simulates_the_record_from_its_own_initial_value():
    time, u, x = exact(200)
    y = x.copy()
    y[20:40] = np.nan
    trial = compare_models([Candidate("lag", lag(), 2, "zoh")], [experiment(time, u, y)]).models[0]
    # Where nothing was measured the model still says what it was.
    assert trial.simulated[0][:, 0] == pytest.approx(x, abs=1e-9)
    assert trial.simulation.fit_percent["y"] == pytest.approx(100.0, abs=1e-6)


def test_wrong_model_is_judged_by_the_measured_samples():
    time, u, x = exact(300)
    y = x + 0.05 * np.random.default_rng(1).standard_normal(300)
    candidates = [Candidate("wrong", lag(5.0), 2, "zoh"), Candidate("true", lag(), 2, "zoh")]
    wrong, true = compare_models(candidates, [experiment(time, u, y)]).models
    for trial in (wrong, true):
        error = y - trial.simulated[0][:, 0]
        assert trial.simulation.rms["y"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
        spread = np.linalg.norm(y - y.mean())
        fit = 100 * (1 - np.linalg.norm(error) / spread)
        assert trial.simulation.fit_percent["y"] == pytest.approx(fit, rel=1e-9)
    assert true.simulation.fit_percent["y"] > wrong.simulation.fit_percent["y"]
    assert true.bic < wrong.bic


def test_likelihood_without_process_noise_is_that_of_independent_errors():
    time, u, x = exact(300)
    y = x + 0.05 * np.random.default_rng(1).standard_normal(300)
    trial = compare_models(
        [Candidate("true", lag(noise_std=0.05), 2, "zoh")], [experiment(time, u, y)]
    ).models[0]
    error = y - trial.simulated[0][:, 0]
    expected = -0.5 * np.sum((error / 0.05) ** 2) - 300 * np.log(0.05 * np.sqrt(2 * np.pi))
    assert trial.log_likelihood == pytest.approx(expected, rel=1e-9)
    assert trial.bic == pytest.approx(2 * np.log(300) - 2 * expected, rel=1e-9)


def test_nonlinear_model_is_simulated_from_its_own_initial_value():
    """T x' = -x³ without input has the solution x = 1/sqrt(1/x0² + 2 t/T)."""
    linear = lag()
    x = linear.xi
    cubic = replace(linear, residual=linear.theta[0] * linear.derivatives - 0.0 * linear.u + x**3)
    time = 0.05 * np.arange(100)
    truth = 1.0 / np.sqrt(1.0 / START**2 + 2.0 * time / TIME_CONSTANT)
    y = truth.copy()
    y[10:15] = np.nan
    trial = compare_models([Candidate("cubic", cubic, 1)], [experiment(time, 0.0 * time, y)]).models[0]
    # The integrator works at a relative tolerance of 1e-8.
    assert trial.simulated[0][:, 0] == pytest.approx(truth, abs=1e-5)
    assert trial.simulation.fit_percent["y"] > 99.99
    # Without process noise the prediction is the simulation.
    assert np.array_equal(trial.predicted[0], trial.simulated[0])
