"""FMUs that remember: discrete variables that events change, and histories of steps."""

import numpy as np
import pytest
from ball_fmu import ball
from relay_fmu import expected, relay

from daest.estimation.filter import run_filter
from daest.fmu.binary_model import binary_model
from daest.model.estimates import FilterOptions
from daest.model.experiment import Experiment
from daest.modelica.change import declare
from daest.systems.linear.linearize import has_affine_dynamics, is_affine_model
from daest.systems.reduction.reduce import dynamics
from daest.systems.simulation.simulate import simulate

TIME = 0.05 + 0.1 * np.arange(40)  # no sample falls on an event
TIME[0] = 0.0
INPUT = 0.7 * np.sin(1.3 * TIME)


@pytest.mark.parametrize("memory", ["RELAY", "STUCK", "UNREAD", "CLOCK", "STEPS", "DELAY"])
def test_outputs_of_a_simulation_are_those_with_its_memory(tmp_path, memory):
    flat = binary_model(relay(tmp_path, memory))
    assert not is_affine_model(flat) and not has_affine_dynamics(dynamics(flat))
    found = simulate(flat, (TIME, INPUT[:, None]))
    truth = expected(memory, TIME, INPUT)
    # A step event is late by up to one step of the integrator; a delay passes corners of the input on.
    away = np.abs(found["y"] - truth) > {"STEPS": 0.05, "DELAY": 3e-3}.get(memory, 1e-3)
    assert not np.any(away), TIME[away]
    assert np.ptp(truth - found["x"]) > 0.5  # the memory is seen


def test_variables_at_states_of_a_filter_fit_these(tmp_path):
    """Along states that no simulation gives, discrete variables follow the states."""
    flat = binary_model(relay(tmp_path, "RELAY"))
    x = np.where(np.arange(40) % 2, 0.8, -0.8)
    found = flat.form.variables_along(flat, TIME, INPUT[:, None], flat.theta_values, x[:, None], "foh")
    np.testing.assert_allclose(found[:, 1], x - np.sign(x))


def test_filter_tells_what_it_does_not_follow(tmp_path):
    flat = binary_model(relay(tmp_path, "RELAY"))
    data = Experiment("run", TIME, INPUT[:, None], expected("RELAY", TIME, INPUT)[:, None], ("u",), ("y",))
    found = run_filter(
        dynamics(flat),
        data,
        "ekf",
        FilterOptions(process_intensity=np.zeros(0), longest=np.inf, measurement_cov=np.array([0.01])),
    )
    assert any("states that jump" in message for message in found.messages)


def test_noisy_simulation_tells_what_it_does_not_follow(tmp_path):
    flat = declare(binary_model(relay(tmp_path, "RELAY")), noises={"der(x)": 1e-4})
    found = simulate(flat, (TIME, INPUT[:, None]), noise=True, seed=1)
    assert "states that jump are not followed" in found.method


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_held_and_straight_inputs_of_co_simulation(tmp_path, hold):
    """The mean of straight lines, or what is held: the ball falls accordingly."""
    flat = binary_model(ball(tmp_path, "CoSimulation"))
    time, theta = np.linspace(0.0, 1.0, 6), np.array([0.0, 0.7, 0.0])
    force = np.array([0.0, 5.0, 0.0, 0.0, 0.0, 0.0])
    found = simulate(flat, (time, force[:, None]), theta=theta, hold=hold)
    pushed = 1.0  # 5 m/s2 for 0.2 s, or a triangle of the same area
    np.testing.assert_allclose(found["v"][-1], pushed, rtol=1e-9)
    np.testing.assert_allclose(found["v"][2], pushed, rtol=1e-9)
    np.testing.assert_allclose(found["v"][1], 0.0 if hold == "zoh" else 0.5, atol=1e-9)
