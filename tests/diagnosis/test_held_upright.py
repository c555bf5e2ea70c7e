"""A pendulum that a controller holds upright while it is recorded, and a ball under a magnet: no simulation
keeps them there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden_plants import some_effects
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screen import run_null
from daest.diagnosis.stand import begin, halved
from daest.errors import NumericalError
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.numerics.statistics import whiteness_p_value
from daest.systems.simulate import simulate

UPRIGHT = """model Upright
  parameter Real J(unit = "kg.m2", min = 0) = 0.05 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.02 annotation(__Daest(estimate = true));
  input Real tau(unit = "N.m");
  output Real angle(unit = "rad") annotation(__Daest(std = 0.001));
  Real phi(unit = "rad", start = 0);
  Real w(unit = "rad/s", start = 0);
equation
  der(phi) = w;
  J*der(w) = tau + 1.5*sin(phi) - d*w;
  angle = phi;
end Upright;
"""
J, D, PERIOD = 0.06, 0.03, 0.01


def record(n: int = 800) -> Experiment:
    """Every ten samples the controller begins to hold another angle."""
    rng, state, rows = np.random.default_rng(3), np.array([0.05, 0.0]), []
    wanted = np.repeat(rng.uniform(-0.1, 0.1, n // 10), 10)
    for goal in wanted:
        angle = state[0] + 0.001 * rng.normal()
        tau = -4.0 * (state[0] - goal) - 0.6 * state[1]
        rows.append([tau, angle])
        motion = solve_ivp(
            lambda _, x, tau=tau: [x[1], (tau + 1.5 * np.sin(x[0]) - D * x[1]) / J],
            (0.0, PERIOD), state, rtol=1e-9, atol=1e-12,
        )  # fmt: skip
        state = motion.y[:, -1]
    tau, angle = np.array(rows).T
    return Experiment("held", PERIOD * np.arange(n), tau[:, None], angle[:, None], ("tau",), ("angle",))


def test_observer_is_that_of_the_machine_where_it_was_held_and_not_where_it_falls_to():
    flat = compile_text(UPRIGHT.encode(), Path("Upright.mo"))
    run = run_null(begin(flat, *halved((record(),), ()), DiagnoseOptions(hold="zoh")).null)
    fastest = np.max(np.linalg.eigvals(run.average.A).real)
    assert abs(fastest / (np.sqrt(1.5 / J + (D / J / 2.0) ** 2) - D / J / 2.0) - 1.0) < 0.05
    (observed,) = run.observed
    assert whiteness_p_value(observed.whitened[:, 0], np.ones(len(observed.whitened), dtype=bool)) > 0.01


MAGNET = """model Magnet
  parameter Real k(unit = "N.m2/A2", min = 0) = 2.2e-4 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real m(unit = "kg") = 0.35;
  input Real i(unit = "A");
  output Real gap(unit = "mm") annotation(__Daest(std = 0.01));
  Real g(unit = "m", start = 0.009);
  Real v(unit = "m/s", start = 0);
equation
  der(g) = v;
  m*der(v) = m*9.81 - k*(i/g)^2;
  gap = 1000*g;
end Magnet;
"""
K, TICK = 2.1e-4, 0.002


def ball(n: int = 800) -> Experiment:
    """The gap of a ball that a controller holds under a magnet, with noise of 0.01 mm."""
    rng, state, rows = np.random.default_rng(5), np.array([0.009, 0.0]), []
    for goal in np.repeat(rng.uniform(0.008, 0.010, n // 20), 20):
        i = max(0.0, 0.009 * np.sqrt(0.35 * 9.81 / K) + 400.0 * (state[0] - goal) + 14.0 * state[1])
        rows.append([i, 1e3 * state[0] + 0.01 * rng.normal()])
        motion = solve_ivp(
            lambda _, x, i=i: [x[1], 9.81 - K * (i / x[0]) ** 2 / 0.35],
            (0.0, TICK), state, rtol=1e-10, atol=1e-13,
        )  # fmt: skip
        state = motion.y[:, -1]
    i, gap = np.array(rows).T
    return Experiment("ball", TICK * np.arange(n), i[:, None], gap[:, None], ("i",), ("gap",))


def test_model_that_falls_into_a_singularity_is_led_by_the_record():
    """With a coefficient 5 % too large the ball is at the magnet before a tenth of the record has passed."""
    flat, record = compile_text(MAGNET.encode(), Path("Magnet.mo")), ball()
    with pytest.raises(NumericalError):
        simulate(flat, (record.time, record.inputs), hold="zoh")
    null = begin(flat, *halved((record,), ()), DiagnoseOptions(hold="zoh")).null
    assert null.fit.theta["k"] == pytest.approx(K, rel=0.003)
    (observed,) = run_null(null).observed
    assert whiteness_p_value(observed.whitened[:, 0], np.ones(len(observed.whitened), dtype=bool)) > 0.01


def test_sensor_of_a_ball_under_a_magnet_is_found_though_no_simulation_holds_it():
    record = ball()
    shifted = replace(record, outputs=record.outputs + 0.4)
    found = diagnose(
        compile_text(MAGNET.encode(), Path("Magnet.mo")),
        some_effects("Offset"),
        [shifted],
        options=DiagnoseOptions(hold="zoh", places=("gap",)),
    )
    (proof,) = found.proofs
    assert found.verdict == "supported", found.message
    (b,) = (p for p in proof.told.parameters if p.name.endswith(".b"))
    assert b.std_error is not None and b.value == pytest.approx(0.4, abs=4 * b.std_error)
