"""ARX models and start values: the report's way to k, (9)-(11), on simulated data of the report's plant."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import hand_models as hand
import numpy as np
import pytest
from scipy.signal import lfilter

from daest.estimation.fitting.coordinates import Unknowns, parameter_coordinate
from daest.estimation.fitting.records import make_record
from daest.estimation.linear.arx import (
    fit_long_arx,
    matched_start,
    physical_orders,
    transfer_function,
)
from daest.estimation.linear.linear_predictors import Problem
from daest.model.experiment import Experiment
from daest.model.parts import Parameter
from daest.modelica.compile import compile_text
from daest.systems.linear.state_space import sample, state_space, state_space_family
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.simulate import simulate

# Table 1 of the report, with its sign: u > 0 turns the speed negative.
REPORT = {"d": 5.87e-4, "c": 0.0341, "J1": 6.30e-6, "J2": 4.17e-4, "R": 4.60, "k": -0.0599, "n": 30.0}


def theta_of(family, values):
    return np.array([values[p.name] for p in family.parameters])


def report_data(period=0.05, n_samples=1600, seed=3, std=(0.02, 0.01)):
    family = hand.servo(REPORT, sign=-1.0)
    u = hand.multisine(n_samples, period, 1, top=6.0)[:, None]
    return hand.recording(
        sample(state_space(family, theta_of(family, REPORT)), period), u, std, seed, x0=[1.0, 0.1, 0.0, 0.5]
    )


def start_values(family, run, names):
    theta = np.array([p.value for p in family.parameters])
    bounds = {p.name: (p.min, p.max) for p in family.parameters}
    value = dict(zip(bounds, theta, strict=True))
    coordinates = tuple(parameter_coordinate(family, name, value[name], bounds[name]) for name in names)
    unknowns = Unknowns(coordinates, theta, np.zeros(0), np.zeros(0))
    z = matched_start(Problem(family, (make_record(run, family),), "foh", unknowns, np.zeros(0)))
    return None if z is None else dict(zip(names, unknowns.natural(z), strict=True))


def test_orders_are_those_of_the_report():
    family = hand.servo(REPORT, sign=-1.0)
    ss = state_space(family, theta_of(family, REPORT))
    # Three poles and two zeros to the speed (10); one more pole, at zero, and one zero less to the angle.
    assert physical_orders(ss, 0) == (3, 2)
    assert physical_orders(ss, 1) == (4, 1)


def test_static_gain_of_the_transfer_function_gives_k():
    family = hand.servo({**REPORT, "k": -0.2}, sign=-1.0)
    num, den, fit = transfer_function(make_record(report_data(), family), 0, (3, 2))
    # (11): k = a0 / (-30 b0).
    assert -den[-1] / (30.0 * num[-1]) == pytest.approx(-0.0599, abs=5e-4)
    assert fit > 95.0


def test_transfer_function_has_the_physical_poles():
    family = hand.servo(REPORT, sign=-1.0)
    # With 0.02 rad/s of noise the resonance, almost cancelled by zeros, does not show in the speed.
    _, den, _ = transfer_function(make_record(report_data(std=(1e-3, 1e-3)), family), 0, (3, 2))
    poles = np.sort_complex(np.roots(den))
    expected = np.sort_complex(
        [p for p in np.linalg.eigvals(state_space(family, theta_of(family, REPORT)).A) if abs(p) > 1e-6]
    )
    assert np.all(np.abs(poles - expected) < 0.02 * np.abs(expected))


def test_start_value_of_k_is_about_minus_six_hundredths():
    family = hand.servo({**REPORT, "k": -0.2}, sign=-1.0)
    start = start_values(family, report_data(), ["k"])
    assert start == {"k": pytest.approx(-0.06, abs=5e-4)}


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_all_parameters_start_near_the_truth_from_far_away(seed):
    names = ("d", "c", "J1", "J2", "k")
    factors = 10.0 ** np.random.default_rng(seed).choice([-1, 1], 5)
    far = {n: REPORT[n] * f for n, f in zip(names, factors, strict=True)}
    start = start_values(hand.servo({**REPORT, **far}, sign=-1.0), report_data(), names)
    assert start["k"] == pytest.approx(REPORT["k"], rel=0.02)
    assert start["J1"] == pytest.approx(REPORT["J1"], rel=0.1)
    # Spring, damper and disc are known only up to a common factor: their ratios.
    assert start["c"] / start["J2"] == pytest.approx(REPORT["c"] / REPORT["J2"], rel=0.05)
    assert start["d"] / start["J2"] == pytest.approx(REPORT["d"] / REPORT["J2"], rel=0.2)


def test_long_arx_finds_the_response_of_a_known_filter():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(6000)
    a, b = np.array([1.0, -1.5, 0.7]), np.array([0.0, 1.0, 0.5])
    y = lfilter(b, a, u) + lfilter([0.05], a, rng.standard_normal(6000)) + 3.0
    family = hand.servo(REPORT, outputs=("omega",))
    record = make_record(
        Experiment("filter", 0.1 * np.arange(6000), u[:, None], y[:, None], ("u",), ("omega",)), family
    )
    arx = fit_long_arx(record, 0, order=4)
    omega = np.linspace(0.1, 30.0, 50)
    z = np.exp(-0.1j * omega)
    expected = (z + 0.5 * z**2) / (1 - 1.5 * z + 0.7 * z**2)
    assert np.allclose(arx.response(omega)[:, 0], expected, rtol=0.02)


def test_gaps_do_not_spoil_the_start_values():
    run = report_data()
    holes = np.where(np.random.default_rng(1).random(run.outputs.shape) < 0.1, np.nan, run.outputs)
    family = hand.servo({**REPORT, "k": -0.2}, sign=-1.0)
    start = start_values(family, replace(run, outputs=holes), ["k"])
    assert start["k"] == pytest.approx(-0.0599, rel=0.03)


def two_inputs():
    return hand.family_from(
        [("x", "1")], ["u", "v"], [], ["y"], [Parameter("a", 9.0, min=0.0), Parameter("g", 0.1, min=0.0)],
        lambda x, u, w, p: ca.vertcat(-p[0] * x[0] + u[0] + p[1] * u[1]), lambda x, u, w, p: x[0],
    )  # fmt: skip


def test_two_inputs_are_told_apart():
    family = two_inputs()
    rng = np.random.default_rng(2)
    u = rng.standard_normal((3000, 2))
    model = sample(state_space(family, np.array([2.0, 0.7])), 0.1)
    run = hand.recording(model, u, [0.02], 1, inputs=("u", "v"), outputs=("y",))
    start = start_values(family, run, ["a", "g"])
    assert start["a"] == pytest.approx(2.0, rel=0.1)
    assert start["g"] == pytest.approx(0.7, rel=0.1)


TRAILER = b"""model Trailer "A body on two springs with dampers, whose ends are moved"
  parameter Real k1(unit = "N/m", min = 0) = 900;
  parameter Real k2(unit = "N/m", min = 0) = 100;
  input Real r1(unit = "m");
  input Real r2(unit = "m");
  output Real y(unit = "m") = z;
  Real z(unit = "m");
  Real v(unit = "m/s");
  Real e1(unit = "m") = z - r1;
  Real e2(unit = "m") = z - r2;
equation
  der(z) = v;
  10*der(v) = -k1*e1 - 60*der(e1) - k2*e2 - 20*der(e2);
end Trailer;
"""


def test_inputs_that_act_by_their_derivatives_are_no_further_inputs():
    flat = compile_text(TRAILER, Path("Trailer.mo"))
    family, time = state_space_family(reduce_index(flat)), 0.02 * np.arange(3000)
    assert family.input_derivatives
    ends = np.column_stack(
        [np.convolve(hand.multisine(3000, 0.02, seed), np.ones(5) / 5, "same") for seed in (1, 2)]
    )
    y = simulate(flat.with_theta({"k1": 300.0, "k2": 500.0}), (time, ends), hold="foh").outputs
    run = Experiment("ends", time, ends, y, ("r1", "r2"), ("y",))
    start = start_values(family, run, ["k1", "k2"])
    assert start == {"k1": pytest.approx(300.0, rel=0.05), "k2": pytest.approx(500.0, rel=0.05)}


def uneven(run):
    shaken = run.time + 0.01 * np.random.default_rng(0).random(run.time.size)
    return replace(run, time=shaken)


def test_uneven_samples_have_no_start_values():
    assert start_values(hand.servo(REPORT), uneven(report_data(n_samples=200)), ["k"]) is None
