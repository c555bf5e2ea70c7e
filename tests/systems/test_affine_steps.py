"""Exact steps of affine models against the Radau integration of the same model."""

import numpy as np
import pytest
from flat_models import Draft

from daest.systems.events.integration import Correction
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import AffineIntegrator, integrate, integrator

NAMES = ("J", "c", "gain")
PERIOD = 0.02


def oscillator():
    """Inertia on a spring with damping, a constant load and an output that a parameter scales."""
    values = {"J": 0.02, "d": 0.05, "c": 2.0, "gain": 1.5, "load": 0.3}
    draft = Draft("Oscillator", parameters=values, unknowns=["phi", "w"], inputs=["u"])
    draft.outputs = {"angle": "gain*phi", "torque": "c*phi + u + load"}
    draft.equation("der(phi) = w")
    draft.equation("J*der(w) = u - c*phi - d*w - load")
    return reduce_index(draft.flat())


def recording(n=200):
    rng = np.random.default_rng(1)
    return PERIOD * np.arange(n), rng.normal(size=(n, 1)), rng.normal(size=(n, 2))


def both(correction, time, u, hold="foh"):
    """The exact run and that of Radau, with sensitivities."""
    explicit = oscillator()
    exact = integrator(explicit, NAMES)
    assert isinstance(exact, AffineIntegrator)
    x0, theta = np.array([0.1, -0.2]), explicit.flat.theta_values
    return [
        integrate(
            engine, time, u, theta, x0,
            hold=hold, sensitivities=True, correction=correction, rtol=1e-10, max_steps=100_000,
        )
        for engine in (exact, exact.stepped)
    ]  # fmt: skip


@pytest.mark.parametrize("hold", ["zoh", "foh", "smooth"])
@pytest.mark.parametrize("is_corrected", [False, True])
def test_trajectories_and_sensitivities_are_those_of_radau(hold, is_corrected):
    time, u, y = recording()
    slopes = np.array([[[0.3, 0.0], [0.1, 0.2]]])
    gain = np.array([[0.2, 0.05], [0.4, 0.1]])
    correction = Correction(y, gain, slopes) if is_corrected else None
    exact, stepped = both(correction, time, u, hold)
    np.testing.assert_allclose(exact.states, stepped.states, atol=1e-7)
    np.testing.assert_allclose(exact.outputs, stepped.outputs, atol=1e-7)
    assert exact.sensitivities.shape == stepped.sensitivities.shape
    scale = np.max(np.abs(stepped.sensitivities), axis=(0, 1))
    assert np.max(np.abs(exact.sensitivities - stepped.sensitivities) / scale) < 1e-6


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("is_corrected", [False, True])
@pytest.mark.parametrize("spread", ["jitter", "pauses"])
def test_steps_of_many_lengths_are_exact_too(hold, is_corrected, spread):
    """A logger that is late by parts of a period, and one that pauses for up to a hundred of them."""
    _, u, y = recording()
    rng = np.random.default_rng(2)
    intervals = 8.0 * PERIOD * rng.uniform(0.6, 1.4, len(u) - 1)
    if spread == "pauses":
        intervals[rng.choice(len(u) - 1, 5)] *= np.array([2.0, 5.0, 10.0, 50.0, 100.0])
    time = np.concatenate([[1.0], 1.0 + np.cumsum(intervals)])
    slopes = np.array([[[0.3, 0.0], [0.1, 0.2]]])
    correction = Correction(y, np.array([[0.2, 0.05], [0.4, 0.1]]), slopes) if is_corrected else None
    exact, stepped = both(correction, time, u, hold)
    assert exact.n_steps == len(u) - 1 < stepped.n_steps
    np.testing.assert_allclose(exact.states, stepped.states, atol=1e-7)
    np.testing.assert_allclose(exact.outputs, stepped.outputs, atol=1e-7)
    scale = np.max(np.abs(stepped.sensitivities), axis=(0, 1))
    assert np.max(np.abs(exact.sensitivities - stepped.sensitivities) / scale) < 1e-6


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_slopes_by_initial_states_alone(jitter):
    explicit, (_, u, _) = oscillator(), recording(50)
    exact = integrator(explicit, NAMES)
    time = 8.0 * PERIOD * (np.arange(50) + jitter * np.sin(np.arange(50.0)))
    x0, theta = np.array([0.1, -0.2]), explicit.flat.theta_values
    every, alone = (
        integrate(exact, time, u, theta, x0, sensitivities=True, by_parameter=by) for by in (True, False)
    )
    np.testing.assert_allclose(alone.sensitivities, every.sensitivities[:, :, len(NAMES) :], atol=1e-12)


def test_missing_samples_and_steps_of_many_octaves_or_slow_ones_are_left_to_radau():
    time, u, y = recording(30)
    y[7, 1] = np.nan
    exact, stepped = both(Correction(y, np.full((2, 2), 0.1)), time, u)
    np.testing.assert_array_equal(exact.outputs, stepped.outputs)
    for time in (1e-9 * 2.0 ** np.arange(30), 1e-3 * (np.arange(30.0) + 0.1 * np.sin(np.arange(30.0)))):
        exact, stepped = both(None, time, u)
        np.testing.assert_array_equal(exact.outputs, stepped.outputs)


def test_a_nonlinear_model_has_no_exact_steps():
    draft = Draft("Drag", parameters={"k": 1.0}, unknowns=["v"], inputs=["u"])
    draft.outputs = {"v": "v"}
    draft.equation("der(v) = u - k*v*v")
    assert not isinstance(integrator(reduce_index(draft.flat()), ("k",)), AffineIntegrator)
