"""The noise levels of a fit are those of its own predictor: an independent filter run with them predicts the
same."""

from dataclasses import replace

import numpy as np
import pytest
from nonlinear_models import experiment_of, linear_servo, oscillator, setup_of

from daest.estimation.filter_engines.ekf import run_ekf
from daest.estimation.filter_engines.filter_task import Noise, Start, record
from daest.estimation.fitting.coordinates import Unknowns, parameter_coordinate
from daest.estimation.nonlinear.identify_nonlinear import identify_nonlinear
from daest.estimation.nonlinear.noise_levels import NO_GAIN, SCAN, _searched_logs
from daest.model.fit import IdentifyOptions
from daest.systems.simulation.local_linear import local_model
from daest.systems.simulation.simulate import simulate


def recorded(explicit, intensities, stds, period, seed, n=1500):
    rng = np.random.default_rng(seed)
    time = period * np.arange(n)
    u = np.repeat(rng.choice([-5.0, 5.0], n // 25), 25)[:, None]
    options = {"noise": True, "seed": seed, "intensities": intensities}
    y = simulate(explicit, (time, u), hold="zoh", **options).outputs
    return experiment_of(explicit, time, u, y + np.array(stds) * rng.standard_normal(y.shape))


def fitted(explicit, experiment, names, intensity=None, std=None, second_look=False):
    """pem fit of `names`; intensity and std where given are held."""
    flat = explicit.flat
    values = dict(zip((p.name for p in flat.parameters), flat.theta_values, strict=True))
    coordinates = tuple(parameter_coordinate(flat, n, 1.2 * values[n], (0.0, None)) for n in names)
    n_w, n_y = len(flat.noises), len(flat.outputs)
    unknowns = Unknowns(coordinates, flat.theta_values, np.zeros(n_w), np.ones(n_y))
    q = np.full(n_w, np.nan) if intensity is None else np.array(intensity)
    s = np.full(n_y, np.nan) if std is None else np.array(std)
    options = IdentifyOptions(hold="zoh", second_look=second_look)
    return identify_nonlinear(explicit, setup_of(unknowns, [experiment], "pem", q, np.isnan(q), s, options))


def levels_of(fit):
    return [np.array([n.value for n in fit.noises if n.kind == kind]) for kind in ("process", "measurement")]


def filtered(explicit, experiment, fit):
    """The extended Kalman filter at the estimate, started as the fit started."""
    model = local_model(explicit, ())
    theta = np.array([fit.theta[p.name] for p in explicit.flat.parameters])
    intensity, std = levels_of(fit)
    data = record(model, experiment.time, experiment.inputs, experiment.outputs, fit.hold)
    noise = Noise(intensity, std**2)
    start = fit.initial_states[0].values
    # The fit predicts with the stationary gain from the first sample on.
    settled = run_ekf(model, data, theta, noise, Start(start, 1e-4 * np.eye(start.size))).predicted_cov[-1]
    return run_ekf(model, data, theta, noise, Start(start, settled))


def assert_same_predictions(explicit, experiment, fit, rms, log_likelihood):
    run = filtered(explicit, experiment, fit)
    found = np.sqrt(np.mean(run.innovations**2, axis=0))
    assert found == pytest.approx(np.array(list(fit.one_step["estimation"].rms.values())), rel=rms)
    assert run.log_likelihood == pytest.approx(fit.log_likelihood, abs=log_likelihood)


SERVO_NOISE, SERVO_STD = {"motor_noise": 1e-4, "disc_noise": 1e-4}, [0.02, 0.01]


def servo_record():
    explicit = linear_servo()
    return explicit, recorded(explicit, SERVO_NOISE, SERVO_STD, 0.01, 3)


@pytest.mark.slow
@pytest.mark.parametrize("given", [{}, {"std": SERVO_STD}, {"intensity": [1e-4, 1e-4]}], ids=str)
def test_filter_of_a_linear_model_predicts_as_the_fit(given):
    """The same but for the first samples, where the filter settles a little later than the fit. Four free
    levels have many gains that predict nearly alike: the second look finds the likely ones among them."""
    explicit, experiment = servo_record()
    fit = fitted(explicit, experiment, ("c", "d", "k"), **given, second_look=True)
    assert_same_predictions(explicit, experiment, fit, 0.003, 2.0)
    intensity, std = levels_of(fit)
    assert list(given.get("std", std)) == list(std)
    assert list(given.get("intensity", intensity)) == list(intensity)
    estimated = [n.estimated for n in fit.noises]
    assert estimated == [("intensity" not in given)] * 2 + [("std" not in given)] * 2
    # Noises act on the speed a hundred times more than its sensor, which tells little of the latter.
    assert intensity == pytest.approx(list(SERVO_NOISE.values()), rel=0.4)
    assert std[1] == pytest.approx(SERVO_STD[1], rel=0.05)


@pytest.mark.slow
def test_filter_of_a_smooth_nonlinear_model_predicts_nearly_as_the_fit():
    """The gain of the filter follows the motion, that of the fit is constant."""
    explicit = oscillator()
    experiment = recorded(explicit, {"w": 0.3}, [0.02], 0.05, 3, n=500)
    fit = fitted(explicit, experiment, ("k", "d", "k3"))
    assert_same_predictions(explicit, experiment, fit, 0.005, 5.0)
    intensity, std = levels_of(fit)
    assert intensity == pytest.approx([0.3], rel=0.3) and std == pytest.approx([0.02], rel=0.1)


def test_noise_where_every_other_sample_is_missing_is_found_and_doubted(recwarn):
    explicit = oscillator()
    experiment = recorded(explicit, {"w": 0.3}, [0.02], 0.05, 3, n=500)
    outputs = experiment.outputs.copy()
    outputs[1::2] = np.nan
    fit = fitted(explicit, replace(experiment, outputs=outputs), ("k", "d", "k3"))
    assert not recwarn.list
    intensity, std = levels_of(fit)
    assert 0.2 < intensity[0] < 1.2 and std == pytest.approx([0.02], rel=0.3)
    assert "50 % of the samples are missing" in fit.notes[0] and "--likelihood ekf" in fit.notes[0]
    whole = fitted(explicit, experiment, ("k", "d", "k3"))
    assert not [note for note in whole.notes if "missing" in note]


@pytest.mark.parametrize("reached", [NO_GAIN, 1.0])
def test_levels_without_a_gain_are_neither_searched_nor_compared(reached, recwarn):
    asked = []

    def value(logs):
        asked.append(logs)
        return reached if len(asked) <= len(SCAN) + 1 else NO_GAIN

    found = _searched_logs(value, 1, 1, 30)
    assert found == pytest.approx([SCAN[0], 0.0])
    assert (len(asked) <= len(SCAN) + 1) == (reached == NO_GAIN)
    assert not recwarn
