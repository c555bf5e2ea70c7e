"""Filters of one sample at a time against the filters of whole records."""

import io
from dataclasses import replace

import numpy as np
import pytest
from nonlinear_models import experiment_of, friction_servo
from test_filter import random_dae

from daest.estimation.filter import run_filter
from daest.estimation.streaming.online_gaussian import online_gaussian
from daest.estimation.streaming.online_kalman import online_kalman
from daest.model.estimates import FilterOptions, InitialState, Sample
from daest.model.experiment import Experiment

INTENSITY, STD = np.array([0.3, 0.2]), np.array([0.2, 0.4])
KNOWN = InitialState.known(np.array([0.3, -0.2, 0.1]), 0.5)


def dae_record(seed, even, n_samples=60, missing=0.25):
    ss, _, rng = random_dae(seed)
    steps = np.full(n_samples, 0.2) if even else rng.uniform(0.05, 0.4, n_samples)
    u, y = rng.normal(size=(n_samples, 1)), 3.0 * rng.normal(size=(n_samples, 2))
    y[rng.uniform(size=y.shape) < missing] = np.nan
    return ss, Experiment("dae", np.cumsum(steps), u, y, ("u",), ("y0", "y1"))


def options(initial, hold, **more):
    return FilterOptions(
        process_intensity=INTENSITY, measurement_cov=STD**2, initial=initial, hold=hold, **more
    )


def followed(online, experiment, interrupted_at=None):
    """All estimates; the run is stored and taken up again after sample `interrupted_at`."""
    memory, found = online.begin(), []
    for k, time in enumerate(experiment.time):
        if k == interrupted_at:
            file = io.BytesIO()
            np.savez(file, **online.stored(memory))
            file.seek(0)
            memory = online.restored(np.load(file))
        memory, estimate = online.advance(memory, Sample(time, experiment.inputs[k], experiment.outputs[k]))
        found.append(estimate)
    return found


def agree(found, known, tolerance):
    values, std = np.array([e.values for e in found]), np.array([e.std for e in found])
    assert np.array_equal(np.isinf(std), np.isinf(known.std))
    sure = np.isfinite(known.std)
    size = np.where(sure, known.std, 1.0)
    assert np.max(np.abs(values - known.values)[sure] / size[sure]) < tolerance
    assert np.max(np.abs(std[sure] - known.std[sure]) / size[sure]) < tolerance
    innovations = np.array([e.innovations for e in found])
    np.testing.assert_allclose(innovations, known.innovations, rtol=tolerance, atol=tolerance)
    assert sum(e.nis_dof for e in found) == known.nis.n_innovations
    total = np.nansum([e.nis for e in found])
    assert total / known.nis.n_innovations == pytest.approx(known.nis.mean, rel=tolerance)
    assert found[-1].log_likelihood == pytest.approx(known.log_likelihood, rel=tolerance)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("initial", [None, KNOWN], ids=["unknown", "known"])
def test_linear_filter_sample_by_sample_is_the_filter_of_the_record(seed, even, initial):
    """Index 2, noise in outputs, missing outputs, uneven steps, unknown start; interrupted on the way."""
    ss, experiment = dae_record(seed, even)
    known = run_filter(ss, experiment, options=options(initial, "foh"))
    online = online_kalman(ss, INTENSITY, STD**2, 0.2, initial=initial)
    assert online.names == known.names
    if even:
        agree(followed(online, experiment, 2), known, 1e-9)
        return
    # The noise of a direct output is held over the step to come, which the last sample of a stream lacks: the
    # estimates that need it are those of equal steps, all predictions are the same.
    found = followed(online, experiment, 2)
    innovations = np.array([e.innovations for e in found])
    np.testing.assert_allclose(innovations, known.innovations, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("initial", [None, KNOWN], ids=["unknown", "known"])
def test_uneven_steps_without_direct_noise(initial):
    ss, experiment = dae_record(1, even=False)
    ss = replace(ss, H=np.zeros_like(ss.H), W=np.zeros_like(ss.W))
    known = run_filter(ss, experiment, options=options(initial, "zoh"))
    online = online_kalman(ss, INTENSITY, STD**2, 0.2, initial=initial, hold="zoh")
    agree(followed(online, experiment, 30), known, 1e-7)


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_nonlinear_filter_sample_by_sample_is_the_filter_of_the_record(kind):
    explicit = friction_servo()
    n, rng = 80, np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.003, 0.007, n))
    u = 3.0 * np.sign(np.sin(8.0 * time))[:, None]
    y = np.column_stack([np.sin(3.0 * time), np.cos(3.0 * time)]) + 0.1 * rng.standard_normal((n, 2))
    y[rng.uniform(size=y.shape) < 0.2] = np.nan
    intensity, std = np.full(len(explicit.flat.noises), 1e-3), np.array([0.1, 0.05])
    initial = InitialState.known(np.zeros(explicit.n_states), 0.3)
    wanted = FilterOptions(
        process_intensity=intensity, measurement_cov=std**2, initial=initial, hold="zoh", longest=2e-3
    )
    known = run_filter(explicit, experiment_of(explicit, time, u, y), kind, wanted)
    online = online_gaussian(
        explicit, explicit.flat.theta_values, intensity, std, 0.005, kind=kind, hold="zoh", initial=initial,
        longest=2e-3,
    )  # fmt: skip
    found = followed(online, experiment_of(explicit, time, u, y), 40)
    assert np.max(np.abs(np.array([e.values for e in found]) - known.values) / (1e-12 + known.std)) < 1e-9
    np.testing.assert_allclose([e.innovations for e in found], known.innovations, rtol=1e-9, atol=1e-12)
    assert found[-1].log_likelihood == pytest.approx(known.log_likelihood, rel=1e-10)
    assert sum(e.nis for e in found if e.nis_dof) / known.nis.n_innovations == pytest.approx(known.nis.mean)
