"""Trajectories and sensitivities of FMUs without events by the compiled integrator."""

import sys

import numpy as np
import pytest
from ball_fmu import ball
from scipy.integrate import solve_ivp
from tank_fmu import levels, tank

from daest.errors import FmuError
from daest.fmu import binary_form
from daest.fmu.binary_model import binary_model
from daest.fmu.engine import engine_library
from daest.fmu.runner import Runner
from daest.systems.events.integration import Correction, IntegrationError
from daest.systems.reduction.reduce import dynamics
from daest.systems.simulation.integrate import integrate, integrator

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="built for Linux")

TIME = np.linspace(0.0, 2.0, 21)
INFLOW = np.full((21, 1), 0.3)
STEP = 1e-5  # of the differences of exact trajectories


def along_tank(path, k=0.5, h0=1.0, **options):
    flat = binary_model(path)
    model = integrator(dynamics(flat), ("k",))
    return flat.form, integrate(model, TIME, INFLOW, np.array([k]), np.array([h0]), hold="zoh", **options)


def ball_with_slopes(force, d=0.1, g=9.81):
    """h, v and their slopes by d (n, 4), from the variational equations, interval by interval."""

    def rate(t, x, u):
        return [x[1], u - g - d * x[1] * abs(x[1]), x[3], -x[1] * abs(x[1]) - 2 * d * abs(x[1]) * x[3]]

    x = [np.array([1.0, 0.0, 0.0, 0.0])]
    for start, end, u in zip(TIME[:-1], TIME[1:], force[:-1], strict=True):
        x.append(solve_ivp(rate, (start, end), x[-1], "LSODA", args=(u,), rtol=1e-10, atol=1e-12).y[:, -1])
    return np.array(x)


@pytest.mark.parametrize("only_once", [False, True])
def test_sensitivities_are_those_of_the_solution(tmp_path, only_once):
    given, found = along_tank(tank(tmp_path, only_once), sensitivities=True)
    by_k = (levels(0.5 + STEP, TIME) - levels(0.5 - STEP, TIME)) / STEP  # y = 2 h
    by_h = (levels(0.5, TIME, 1.0 + STEP) - levels(0.5, TIME, 1.0 - STEP)) / STEP
    assert given.method.startswith("CVODE" if only_once else "Radau IIA")
    np.testing.assert_allclose(found.outputs[:, 0], 2 * levels(0.5, TIME), rtol=1e-6)
    # Of one instance alone there are differences of whole solutions by CVODE.
    tolerance = 5e-4 if only_once else 1e-6  # rtol of 1e-7, over steps of 5e-4
    np.testing.assert_allclose(found.sensitivities[:, 0, 0], by_k, atol=tolerance)
    np.testing.assert_allclose(found.sensitivities[:, 0, 1], by_h, atol=tolerance)


def test_fmu_that_hears_of_steps(tmp_path):
    flat = binary_model(ball(tmp_path))
    assert flat.form.model.reports_steps
    force = 9.81 + 3.0 * np.sin(3.0 * TIME)[:, None]
    x0, theta = np.array([1.0, 0.0]), np.array([0.1, 0.7, 9.81])
    model = integrator(dynamics(flat), ("d",))
    found = integrate(model, TIME, force, theta, x0, hold="zoh", sensitivities=True)
    expected = ball_with_slopes(force[:, 0])
    assert flat.form.method.startswith("Radau IIA")
    np.testing.assert_allclose(found.outputs[:, 0], expected[:, 0], atol=1e-6)
    np.testing.assert_allclose(found.sensitivities[:, 0, 0], expected[:, 2], rtol=1e-5, atol=1e-6)


def test_fmu_that_remembers_its_steps_is_simulated_one_by_one(tmp_path):
    flat = binary_model(ball(tmp_path, REMEMBERS=1))
    x0, theta = np.array([1.0, 0.0]), np.array([0.1, 0.7, 9.81])
    model = integrator(dynamics(flat), ("d",))
    integrate(model, TIME, np.zeros((21, 1)), theta, x0, hold="zoh", sensitivities=True)
    assert flat.form.method.startswith("CVODE")


def test_observer_and_missing_samples_as_by_cvode(tmp_path, monkeypatch):
    y = 2 * levels(0.4, TIME)[:, None]
    y[5] = np.nan
    correction = Correction(y, np.array([[0.1]]))
    path = tank(tmp_path)
    _, found = along_tank(path, sensitivities=True, correction=correction)
    monkeypatch.setattr(binary_form, "engine_library", lambda *_: None)
    given, expected = along_tank(path, sensitivities=True, correction=correction)
    assert given.method.startswith("CVODE")
    np.testing.assert_allclose(found.outputs, expected.outputs, atol=1e-5)
    np.testing.assert_allclose(found.states, expected.states, atol=1e-5)
    np.testing.assert_allclose(found.sensitivities, expected.sensitivities, atol=1e-4)


def test_instances_that_share_their_values_are_simulated_one_by_one(tmp_path):
    given, found = along_tank(tank(tmp_path, SHARED=1), sensitivities=True)
    by_k = (levels(0.5 + STEP, TIME) - levels(0.5 - STEP, TIME)) / STEP
    assert given.method.startswith("CVODE")
    np.testing.assert_allclose(found.outputs[:, 0], 2 * levels(0.5, TIME), rtol=1e-5)
    np.testing.assert_allclose(found.sensitivities[:, 0, 0], by_k, atol=1e-4)


def test_refusal_of_the_fmu_is_told_in_its_words(tmp_path):
    with pytest.raises(IntegrationError, match="no level below zero"):
        along_tank(tank(tmp_path), h0=-1.0)
    _, again = along_tank(tank(tmp_path), h0=1.0)
    assert np.all(np.isfinite(again.outputs))


def test_no_evaluation_goes_over_the_wire(tmp_path, monkeypatch):
    """A whole trajectory with its sensitivities is one request."""
    asked = []
    ask = Runner._ask
    monkeypatch.setattr(Runner, "_ask", lambda self, header, arrays: (
        asked.append(header["request"]) or ask(self, header, arrays)
    ))  # fmt: skip
    along_tank(tank(tmp_path), sensitivities=True)
    assert asked == ["follow"]


def test_no_compiler_is_no_obstacle(monkeypatch):
    def missing(*_, **__):
        raise FmuError("no-c-compiler", "There is none.")

    monkeypatch.setattr("daest.fmu.engine.build_shared", missing)
    engine_library.cache_clear()
    assert engine_library(3, 1, 1, 1, 1) is None
    engine_library.cache_clear()


@pytest.mark.parametrize(
    ("trap", "code"), [("CRASH", "fmu-crashed"), ("HANG", "fmu-hangs"), ("EXIT", "fmu-exited")]
)
def test_what_an_fmu_does_in_the_compiled_loop_ends_in_one_message(tmp_path, monkeypatch, trap, code):
    monkeypatch.setenv("DAEST_FMU_SECONDS", "1" if trap == "HANG" else "5")
    flat = binary_model(ball(tmp_path, TRAP=trap))
    with pytest.raises(FmuError) as caught:
        integrate(
            integrator(dynamics(flat)), TIME, np.zeros((21, 1)), np.array([0.1, 0.7, 9.81]),
            np.array([1.0, 0.0]), hold="zoh",
        )  # fmt: skip
    assert caught.value.code == code
