"""Models whose states constraints tie (a pendulum in Cartesian coordinates), through full turns: noisy
simulation, the gradient of the filter's likelihood, identification, ties of initial states."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from nonlinear_models import experiment_of, friction_servo

from daest.estimation.filter_engines.ekf import ekf_likelihood
from daest.estimation.filter_engines.filter_task import Directions, Noise, Start, record
from daest.estimation.fitting.coordinates import Coordinate, Unknowns
from daest.estimation.fitting.search import Evaluation
from daest.estimation.fitting.ties import Beginning, with_ties
from daest.estimation.identify import identify
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_model, compile_text
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.reduce import reduce_index
from daest.systems.reduction.redundant import good_everywhere, redundant_model
from daest.systems.simulation.local_linear import local_model
from daest.systems.simulation.simulate import simulate

TRUE = np.array([0.5, 1.0, 0.05])  # m, L, d


@cache
def pendulum():
    return good_everywhere(reduce_index(compile_model(Path(__file__).parent / "models" / "Pendulum.mo")))


def push(n, period=0.02):
    """A push that takes the pendulum over the top more than once."""
    time = period * np.arange(n)
    u = 0.5 * np.sin(1.3 * time)[:, None]
    u[:25] = -8.0
    return time, u


def turned(n=150, seed=1, intensity=1e-3, noise=True):
    time, u = push(n)
    found = simulate(pendulum(), (time, u), hold="zoh", noise=noise, seed=seed, intensities={"w": intensity})
    names = list(found.variable_names)
    x, y = (found.variables[:, names.index(name)] for name in ("x", "y"))
    assert np.ptp(np.unwrap(np.arctan2(x, -y))) > 2 * np.pi
    return time, u, found, np.column_stack([x, y])


@pytest.mark.slow
def test_noisy_simulation_turns_over_on_its_constraint():
    _, _, found, places = turned(500)
    assert found.with_noise and "constraints" in found.method
    assert np.max(np.abs(np.sum(places**2, axis=1) - 1.0)) < 1e-8
    names = list(found.variable_names)
    v = np.column_stack([found.variables[:, names.index(name)] for name in ("vx", "vy")])
    assert np.max(np.abs(np.sum(places * v, axis=1))) < 1e-8  # the velocity is tangential, too


@pytest.mark.slow
def test_noise_of_a_simulation_has_the_spread_of_polar_coordinates():
    """From rest at the bottom the velocity after a short time t has the variance q t / m²."""
    n, q, period = 5, 1e-3, 0.01
    time = period * np.arange(n)
    ends = []
    for seed in range(120):
        found = simulate(
            pendulum(),
            (time, np.zeros((n, 1))),
            hold="zoh",
            noise=True,
            seed=seed,
            intensities={"w": q},
            x0={"x": 0.0},
        )
        ends.append(found.variables[-1, list(found.variable_names).index("vx")])
    expected = np.sqrt(q * time[-1]) / TRUE[0]
    assert np.std(ends) == pytest.approx(expected, rel=0.25)  # 3.9 standard errors of 120 runs


def test_a_model_with_free_states_is_left_alone():
    explicit = friction_servo()
    assert good_everywhere(explicit) is explicit and explicit.invariants is None


def test_initial_point_is_on_the_constraints():
    x0, xi = initial_point(pendulum(), given={"x": 0.28})
    assert pendulum().state_names == ("x", "y", "vx", "vy")
    assert np.allclose(x0, [0.28, -0.96, 0.0, 0.0], atol=1e-9)
    assert xi[4] == pytest.approx(0.5 * 9.81 * 0.96)  # the rod carries the weight along it


@pytest.mark.parametrize("compiled", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_gradient_of_the_likelihood_is_that_of_finite_differences(compiled):
    time, u, found, _ = turned(150)
    rows = slice(0, 30 if compiled else 3)
    model = local_model(pendulum(), ("m", "L", "d"), tangents=True, compiled=compiled)
    assert (model.library is not None) == compiled
    data = record(model, time[rows], u[rows], found.outputs[rows], "zoh")
    x0, P = np.array([0.6, -0.81, 0.01, 0.02]), 1e-3 * np.eye(4)  # off the circle: the pull counts too
    q, r = np.array([1e-3]), np.full(2, 4e-4)

    def value(z):
        start = Start(x0 + z[6:], P)
        noise = Noise(q + z[3:4], r + z[4:6])
        return ekf_likelihood(model, data, TRUE + z[:3], noise, start, 0.01).log_likelihood

    eye = np.eye(10)
    along = Directions(eye[:, :3], eye[:, 3:4], eye[:, 4:6], eye[:, 6:])
    whole = ekf_likelihood(model, data, TRUE, Noise(q, r), Start(x0, P), 0.01, along)
    step = np.array([1e-6] * 3 + [1e-8] + [1e-8] * 2 + [1e-6] * 4)
    slopes = [(value(h * e) - value(-h * e)) / (2 * h) for h, e in zip(step, eye, strict=True)]
    assert np.allclose(whole.gradient, slopes, rtol=1e-4, atol=1e-4 * np.max(np.abs(slopes)))


def options(method, **start):
    return IdentifyOptions(hold="zoh", method=method, estimate=("m", "L", "d"), start=start)


def assert_found(fit, width=4.0):
    assert fit.status == "converged"
    for parameter, true in zip(fit.parameters, TRUE, strict=True):
        assert abs(parameter.value - true) < width * parameter.std_error < 0.2 * width * true
    assert fit.initial_states[0].names == ("x", "y", "vx", "vy")
    x0 = fit.initial_states[0].values
    assert np.hypot(x0[0], x0[1]) == pytest.approx(fit.theta["L"], rel=1e-3)


def test_output_error_finds_length_mass_and_friction_over_full_turns():
    time, u, found, _ = turned(intensity=0.0)
    experiment = experiment_of(pendulum(), time, u, found.outputs)
    fit = identify(pendulum().flat, [experiment], options("oe", m=0.52, L=1.02, d=0.045))
    assert_found(fit)
    assert fit.parameters[1].std_error < 0.005


FAR = {"m": 0.6, "L": 1.05, "d": 0.07}


@pytest.mark.slow
@pytest.mark.parametrize("start", [{"m": 0.52, "L": 1.02, "d": 0.045}, FAR])
def test_likelihood_finds_them_with_process_noise_also_from_a_start_that_turns_once_too_often(start):
    time, u, found, _ = turned(400)
    experiment = experiment_of(pendulum(), time, u, found.outputs)
    fit = identify(pendulum().flat, [experiment], options("pem", **start))
    assert_found(fit)
    assert any("extended Kalman filter" in note for note in fit.notes)  # no observer has a constant gain


def test_ties_hold_an_initial_state_on_the_constraint_and_nothing_else():
    explicit = pendulum()
    names = [p.name for p in explicit.flat.parameters]
    length = Coordinate("L", "parameter", names.index("L"), 1.0, False, 1.0, 0.0, np.inf)
    unknowns = Unknowns((length,), explicit.flat.theta_values, np.zeros(1), np.ones(2))
    scale = np.array([1.0, 1.0, 5.0, 5.0])

    def flat(z, with_slopes):
        return Evaluation(0.0, np.zeros(5), np.zeros((5, 5))) if with_slopes else Evaluation(0.0)

    beginning = [Beginning(np.zeros(1), np.zeros(0), 0.0)]
    tied = with_ties(flat, explicit, unknowns, scale, beginning)
    on = np.array([1.0, 0.6, -0.8, 0.16, 0.12])  # L, then x0 / scale
    assert tied(on, False).value == pytest.approx(0.0, abs=1e-20)
    off = on + np.array([0.0, 0.006, -0.008, 0.0, 0.0])  # along the radius, by 0.01
    assert tied(off, False).value == pytest.approx((10.0 * 0.01) ** 2 / 2, rel=0.02)
    here = tied(off, True)
    step = 1e-6 * np.eye(5)
    slopes = [(tied(off + h, False).value - tied(off - h, False).value) / 2e-6 for h in step]
    assert np.allclose(here.gradient, slopes, rtol=0.05, atol=0.02)  # first order in the distance
    along = np.array([0.0, 0.8, 0.6, -0.12, 0.16])  # a turn of place and velocity along the circle
    assert along @ tied(on, True).information @ along < 1e-9
    free = friction_servo()
    assert with_ties(flat, free, unknowns, scale, beginning) is flat


CHAIN = """model Chain "Orientations that follow one another from an angle"
  Real phi(start = 0.3, fixed = true, stateSelect = StateSelect.prefer);
  Real w(start = 0, fixed = true, stateSelect = StateSelect.prefer);
  Real c;
  Real s;
  Real y;
  Real v;
  input Real u;
  output Real q = y;
equation
  c = cos(phi);
  s = sin(phi);
  y = 0.5*s*c + s;
  der(phi) = w;
  der(y) = v;
  2*der(w) = u - w - der(v);
end Chain;
"""


def test_what_follows_from_an_angle_one_after_the_other_needs_no_other_states():
    """Coefficients move, but none on the diagonal of the triangular form: the angle is good everywhere."""
    flat = compile_text(CHAIN.encode(), Path("Chain.mo"))
    explicit, every = reduce_index(flat), redundant_model(flat)
    assert good_everywhere(explicit) is explicit
    assert explicit.state_names == ("phi", "w") and len(every.state_names) == 6
    t = np.arange(60) * 0.05
    runs = [simulate(form, (t, np.sin(t)[:, None])).outputs for form in (explicit, every)]
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-8)
