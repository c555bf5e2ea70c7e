"""Inputs on smooth curves between their samples: a body on a spring and a damper over a ground that moves in
a few waves, each sampled about eight times, against scipy with the ground as a function of time."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flat_models import Draft
from scipy.integrate import solve_ivp

from daest.data.prepare import resample
from daest.estimation.filter import run_filter
from daest.estimation.identify import identify
from daest.estimation.linear.hold_search import is_smooth
from daest.estimation.streaming.online_filter import online_filter
from daest.model.estimates import FilterOptions
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.systems.linear.state_space import (
    family_for,
    sample,
    sample_derivatives,
    space_for,
    state_space,
    state_space_derivatives,
    state_space_family,
)
from daest.systems.simulation.simulate import simulate

PERIOD, N = 0.02, 600
TRUTH = {"c": 300.0, "d": 8.0}
WAVES = np.array([1.1, 2.3, 3.7, 6.1])  # [Hz]
PHASES = np.array([0.3, 1.9, 4.1, 5.2])


def ground(t):
    return 0.01 * np.sin(2 * np.pi * np.multiply.outer(t, WAVES) + PHASES).sum(-1)


def ground_speed(t):
    return 0.01 * (2 * np.pi * WAVES * np.cos(2 * np.pi * np.multiply.outer(t, WAVES) + PHASES)).sum(-1)


def body(cubic=0.0, start=None):
    values = {"m": 2.0, **(start or TRUTH), "c3": cubic}
    draft = Draft("Body", parameters=values, unknowns=["s", "v", "e"], inputs=["z"])
    draft.outputs = {"e_seen": "e", "a": "(0 - c*e - c3*e**3 - d*der(e))/m"}
    draft.equation("e = s - z")
    draft.equation("der(s) = v")
    draft.equation("m*der(v) = 0 - c*e - c3*e**3 - d*der(e)")
    return draft.flat()


@cache
def by_scipy(cubic=0.0):
    """Outputs (N, 2) without noise, from rest at the first sample."""

    def acceleration(t, s, v):
        e = s - ground(t)
        return (-TRUTH["c"] * e - cubic * e**3 - TRUTH["d"] * (v - ground_speed(t))) / 2.0

    time = PERIOD * np.arange(N)
    found = solve_ivp(
        lambda t, x: [x[1], acceleration(t, *x)], (0, time[-1]), [0.0, 0.0], t_eval=time,
        method="DOP853", rtol=1e-10, atol=1e-12,
    ).y  # fmt: skip
    return np.column_stack([found[0] - ground(time), acceleration(time, *found)])


def recording(cubic=0.0, noise=(2e-5, 5e-3)):
    time = PERIOD * np.arange(N)
    y = by_scipy(cubic) + np.array(noise) * np.random.default_rng(3).normal(size=(N, 2))
    return Experiment("run", time, ground(time)[:, None], y, ("z",), ("e_seen", "a"))


@pytest.mark.parametrize("cubic", [pytest.param(0.0, marks=pytest.mark.slow), 4e4])
def test_simulation_is_that_of_scipy_where_straight_lines_are_not(cubic):
    time, truth = PERIOD * np.arange(N), by_scipy(cubic)
    size, x0 = np.std(truth, axis=0), {"s": 0.0, "v": 0.0}
    error = {}
    for hold in ("smooth", "foh"):
        run = simulate(body(cubic), (time, ground(time)[:, None]), hold=hold, x0=x0, rtol=1e-9)
        # A spline without a slope given at its ends is good behind a few samples.
        error[hold] = np.std((run.outputs - truth)[10:-10], axis=0) / size
    assert np.all(error["smooth"] < 4e-3)
    assert np.all(error["foh"] > 3 * error["smooth"])
    assert error["foh"][1] > 0.03


@pytest.mark.parametrize("cubic", [pytest.param(0.0, marks=pytest.mark.slow), 4e4])
def test_identification_takes_smooth_inputs_and_finds_the_truth(cubic):
    flat = body(cubic, start={"c": 200.0, "d": 5.0})
    names = ("c", "d")
    data, once = [recording(cubic, (1e-4, 5e-2))], IdentifyOptions(estimate=names, second_look=False)
    fit = identify(flat, data, once)
    assert fit.hold == "smooth"
    straight = identify(flat, data, replace(once, hold="foh"))
    assert fit.log_likelihood > straight.log_likelihood + 50
    for name in names:
        found = next(p for p in fit.parameters if p.name == name)
        assert abs(found.value - TRUTH[name]) < 4 * found.std_error


def test_slopes_of_smooth_steps_are_those_of_differences():
    """Of the sampled matrices by a parameter, with a slope that acts and one that does not."""
    flat = body()
    family = family_for(state_space_family(flat), "smooth")
    theta, h = flat.theta_values, 1e-4
    place = [p.name for p in flat.parameters].index("d")
    step = np.eye(theta.size)[place] * h
    derivatives = state_space_derivatives(family, theta, ["d"])
    found = sample_derivatives(state_space(family, theta), derivatives, PERIOD, "smooth")
    above, below = (sample(state_space(family, theta + sign * step), PERIOD, "smooth") for sign in (1, -1))
    for name in ("input_now", "input_next", "feedthrough"):
        by_difference = (getattr(above, name) - getattr(below, name)) / (2 * h)
        np.testing.assert_allclose(getattr(found, name)[0], by_difference, rtol=1e-6, atol=1e-9)


def test_slopes_that_a_model_lacks_are_padded_alike():
    family = state_space_family(lag())
    theta = lag().theta_values
    found = [
        sample_derivatives(
            state_space(one, theta), state_space_derivatives(one, theta, ["T"]), PERIOD, "smooth"
        )
        for one in (family, family_for(family, "smooth"))
    ]
    assert found[0].input_now.shape == (1, 1, 2)
    for name in ("input_now", "input_next", "feedthrough"):
        assert np.array_equal(getattr(found[0], name), getattr(found[1], name))


def lag():
    draft = Draft("Lag", parameters={"T": 0.1}, unknowns=["x"], inputs=["u"])
    draft.outputs = {"y": "x"}
    draft.equation("T*der(x) = u - x")
    return draft.flat()


def test_matrices_get_the_slopes_that_they_lack():
    flat = lag()
    plain = state_space_family(flat)
    padded = family_for(plain, "smooth")
    assert plain.input_derivatives == () and padded.input_derivatives == ((0, 1),)
    assert family_for(padded, "smooth") is padded and family_for(plain, "foh") is plain
    ss = space_for(state_space(plain, flat.theta_values), "smooth")
    assert np.array_equal(ss.B, state_space(padded, flat.theta_values).B)
    # On u = t^3 with its true slopes the lag is exact: x = t^3 - 3 T t^2 + 6 T^2 t - 6 T^3 + 6 T^3 e^(-t/T).
    model, t = sample(ss, 0.05, "smooth"), 0.05 * np.arange(30)
    u, x, T = np.column_stack([t**3, 3 * t**2]), np.zeros(1), 0.1
    for k in range(29):
        x = model.transition @ x + model.input_now @ u[k] + model.input_next @ u[k + 1] + model.drift
    exact = t**3 - 3 * T * t**2 + 6 * T**2 * t - 6 * T**3 * (1 - np.exp(-t / T))
    assert abs(x[0] - exact[-1]) < 1e-12


def test_filter_follows_smooth_inputs_and_a_stream_runs_straight():
    flat = body()
    data = recording()
    options = {
        hold: FilterOptions(hold=hold, measurement_cov=np.array([2e-5, 5e-3]) ** 2)
        for hold in ("smooth", "foh")
    }
    found = {hold: run_filter(flat, data, options=one) for hold, one in options.items()}
    assert found["smooth"].log_likelihood > found["foh"].log_likelihood + 1000
    online = online_filter(flat, PERIOD, options=options["smooth"])
    assert online.hold == "foh"


def test_smooth_courses_are_told_from_others():
    time, rng = 0.1 * np.arange(400), np.random.default_rng(0)
    wave = np.sin(2 * np.pi * 0.7 * time)
    assert is_smooth(time, wave)
    assert is_smooth(time, wave + 1e-3 * rng.normal(size=400))
    for other in (
        np.sign(wave),
        np.repeat(rng.normal(size=40), 10),
        rng.normal(size=400),
        np.interp(time, time[::8], rng.normal(size=50)),
        0.8 * np.round(wave / 0.8),
        np.full(400, 3.0),
        wave[:10],
    ):
        assert not is_smooth(time[: other.size], other)


def test_inputs_made_for_straight_lines_are_not_tried_as_smooth():
    data = resample(recording(noise=(1e-4, 5e-2)), 2 * PERIOD)
    fit = identify(body(), [data], IdentifyOptions(estimate=("c", "d")))
    assert fit.hold == "foh"
