"""Sensors that bend what they show: what counts as one, and the observer whose gain follows its slope."""

import casadi as ca
import numpy as np
import pytest
from nonlinear_models import explicit_from

from daest.systems.events.integration import Correction
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.sensor_laws import sensor_laws, slopes_along, steepest_slopes


def rounded(x):
    return ca.sqrt(x**2 + 1e-6)


def seen_by(sensor):
    """A slow oscillator whose speed is seen by `sensor`, and its position as it is."""
    return explicit_from(
        ("x", "v"), {"c": 4.0, "d": 0.3},
        lambda x, u, w, theta, t: [x[1], u[0] + w[0] - theta[0] * x[0] - theta[1] * x[1]],
        {"y": lambda x, u, theta: sensor(x[1]), "p": lambda x, u, theta: x[0]}, ("f",), ("w",),
    )  # fmt: skip


LAWS = {
    "magnitude": rounded,
    "cut": lambda v: v - (rounded(v - 2.0) + v - 2.0) / 2.0,
    "dead zone": lambda v: v + (rounded(v - 0.1) - rounded(v + 0.1)) / 2.0,
}


@pytest.mark.parametrize("sensor", LAWS.values(), ids=LAWS)
def test_gain_is_that_of_the_sensor_where_it_shows_most(sensor):
    explicit = seen_by(sensor)
    laws = sensor_laws(explicit)
    assert laws is not None and laws.references[1] is None
    at = (explicit.flat.theta_values, np.zeros(1), np.zeros((1, 2)), np.zeros((1, 1)))
    found = steepest_slopes(explicit, laws, *at)
    assert np.abs(found) == pytest.approx(np.array([[0.0, 1.0], [1.0, 0.0]]), abs=1e-4)


@pytest.mark.parametrize(
    "sensor",
    [lambda v: 3.0 * v + 1.0, lambda v: v**2, lambda v: v * rounded(v)],
    ids=["linear", "square", "drag"],
)
def test_a_sensor_without_a_largest_slope_is_no_such_law(sensor):
    assert sensor_laws(seen_by(sensor)) is None


def test_slope_has_the_sign_that_the_sensor_lost():
    explicit = seen_by(rounded)
    v = np.array([-2.0, -0.5, 0.0, 0.5, 2.0])
    s = slopes_along(
        explicit, explicit.flat.theta_values, np.arange(5.0), np.column_stack([0 * v, v]), np.zeros((5, 1))
    )
    assert s[:, 0] * s[-1, 0] == pytest.approx([-1.0, -1.0, 0.0, 1.0, 1.0], abs=1e-5)
    assert s[:, 1] == pytest.approx(1.0)


@pytest.mark.parametrize("compiled", [True, False])
def test_observer_follows_through_zero_and_its_slopes_are_exact(compiled):
    """From a wrong start, with a sensor that has lost the sign; slopes against differences of whole runs."""
    model = integrator(seen_by(rounded), ("c", "d"), compiled=compiled)
    n = 200 if compiled else 60  # the interpreter takes its time
    time = 0.05 * np.arange(n)
    inputs, theta = np.sin(0.9 * time)[:, None], np.array([4.0, 0.3])
    true = integrate(model, time, inputs, theta, np.array([0.3, 0.4]), rtol=1e-9)
    gain = np.array([[0.0, 0.0], [0.3, 0.0]])
    laws = sensor_laws(model.explicit)
    gain[1, 0] *= steepest_slopes(model.explicit, laws, theta, time[:1], np.zeros((1, 2)), inputs[:1])[0, 1]
    measured = np.column_stack([np.abs(true.states[:, 1]), true.states[:, 0]])

    def run(theta, x0):
        return integrate(
            model, time, inputs, theta, x0,
            correction=Correction(measured, gain), sensitivities=True, rtol=1e-10,
        )  # fmt: skip

    start = np.array([0.3, 0.1])
    found = run(theta, start)
    assert np.min(true.states[:, 1]) < -0.3
    assert found.states[n // 2 :, 1] == pytest.approx(true.states[n // 2 :, 1], abs=0.02)
    off = np.array([4.1, 0.35])
    found, step = run(off, start), 1e-6
    for direction in range(0, 4, 1 if compiled else 3):
        change = step * np.eye(4)[direction]
        ends = [run(off + s * change[:2], start + s * change[2:]).outputs for s in (1.0, -1.0)]
        difference = (ends[0] - ends[1]) / (2.0 * step)
        assert found.sensitivities[:, :, direction] == pytest.approx(difference, rel=1e-3, abs=2e-4)
