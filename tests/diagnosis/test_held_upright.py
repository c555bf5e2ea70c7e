"""A pendulum that a controller holds upright while it is recorded, and a ball under a magnet: no simulation
keeps them there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden_plants import some_effects
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence.stand import begin, halved
from daest.diagnosis.null_model import null_observer
from daest.diagnosis.null_model.null import falls_over, with_noise
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.disturbance import place_gains
from daest.errors import NumericalError
from daest.estimation.fitting.records import part_of
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.numerics.statistics import whiteness_p_value
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.simulate import simulate

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


def held(wanted, state, period, act, rates):
    """Inputs (n,) with which a controller holds what it `wanted`, by `act` of a state and a goal, and the
    states (n, 2) at their samples; `rates` are of a state under an input."""
    inputs, states = [], []
    for goal in wanted:
        u = act(state, goal)
        inputs.append(u)
        states.append(state)
        motion = solve_ivp(lambda _, x, u=u: rates(x, u), (0.0, period), state, rtol=1e-10, atol=1e-13)
        state = motion.y[:, -1]
    return np.array(inputs), np.array(states)


def recorded(period, u, y, names):
    return Experiment("held", period * np.arange(len(u)), u[:, None], y[:, None], (names[0],), (names[1],))


def record(n: int = 800) -> Experiment:
    """Every ten samples the controller begins to hold another angle."""
    rng = np.random.default_rng(3)
    tau, states = held(
        np.repeat(rng.uniform(-0.1, 0.1, n // 10), 10),
        np.array([0.05, 0.0]),
        PERIOD,
        lambda x, goal: -4.0 * (x[0] - goal) - 0.6 * x[1],
        lambda x, u: [x[1], (u + 1.5 * np.sin(x[0]) - D * x[1]) / J],
    )
    return recorded(PERIOD, tau, states[:, 0] + 0.001 * rng.normal(size=n), ("tau", "angle"))


def assert_white(run):
    (observed,) = run.observed
    assert whiteness_p_value(observed.whitened[:, 0], np.ones(len(observed.whitened), dtype=bool)) > 0.01


@pytest.mark.slow
def test_observer_is_that_of_the_machine_where_it_was_held_and_not_where_it_falls_to():
    flat = compile_text(UPRIGHT.encode(), Path("Upright.mo"))
    run = run_null(begin(flat, *halved((record(),), ()), DiagnoseOptions(hold="zoh")).null)
    fastest = np.max(np.linalg.eigvals(run.average.A).real)
    assert abs(fastest / (np.sqrt(1.5 / J + (D / J / 2.0) ** 2) - D / J / 2.0) - 1.0) < 0.05
    assert_white(run)


@pytest.mark.slow
def test_observer_beside_loads_of_next_to_nothing_is_made_where_the_machine_was_held():
    """Averaged along its fall, the pendulum hangs most of the time, and needs no observer."""
    null = begin(
        compile_text(UPRIGHT.encode(), Path("Upright.mo")),
        *halved((record(),), ()),
        DiagnoseOptions(hold="zoh"),
    ).null
    for intensity in (1e-12, 0.0):
        loads = np.full(len(null.intensity), intensity)
        run = run_null(with_noise(null, loads, null.measurement_std))
        assert np.any(run.gain)
        assert_white(run)


def test_observer_whose_gain_lets_the_machine_fall_is_made_where_it_was_held(monkeypatch):
    """An average along the fall may need next to no gain: that of an arm whose pendulum hangs."""
    null = begin(
        compile_text(UPRIGHT.encode(), Path("Upright.mo")),
        *halved((record(),), ()),
        DiagnoseOptions(hold="zoh"),
    ).null
    whole = null_observer._whole_gain

    def too_little_along_a_fall(null, average):
        grows = float(np.max(np.linalg.eigvals(average.A).real))
        return (1.0 if grows > 4.76 else 0.2) * whole(null, average)

    monkeypatch.setattr(null_observer, "_whole_gain", too_little_along_a_fall)
    assert_white(run_null(with_noise(null, np.full(len(null.intensity), 1e-12), null.measurement_std)))


def test_only_what_falls_over_within_a_record_is_first_simulated_in_segments():
    upright = reduce_index(compile_text(UPRIGHT.encode(), Path("Upright.mo")))
    hanging = reduce_index(compile_text(UPRIGHT.replace("+ 1.5*", "- 1.5*").encode(), Path("Upright.mo")))
    assert falls_over(upright, [record()]) and not falls_over(hanging, [record()])
    assert not falls_over(upright, [part_of(record(), 0, 50)])


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
    rng, rest = np.random.default_rng(5), 0.009 * np.sqrt(0.35 * 9.81 / K)
    i, states = held(
        np.repeat(rng.uniform(0.008, 0.010, n // 20), 20),
        np.array([0.009, 0.0]),
        TICK,
        lambda x, goal: max(0.0, rest + 400.0 * (x[0] - goal) + 14.0 * x[1]),
        lambda x, u: [x[1], 9.81 - K * (u / x[0]) ** 2 / 0.35],
    )
    return recorded(TICK, i, 1e3 * states[:, 0] + 0.01 * rng.normal(size=n), ("i", "gap"))


@pytest.mark.slow
def test_model_that_falls_into_a_singularity_is_led_by_the_record():
    """With a coefficient 5 % too large the ball is at the magnet before a tenth of the record has passed."""
    flat, record = compile_text(MAGNET.encode(), Path("Magnet.mo")), ball()
    with pytest.raises(NumericalError):
        simulate(flat, (record.time, record.inputs), hold="zoh")
    null = begin(flat, *halved((record,), ()), DiagnoseOptions(hold="zoh")).null
    assert null.fit.theta["k"] == pytest.approx(K, rel=0.003)
    assert_white(run_null(null))


@pytest.mark.slow
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


@pytest.mark.slow
def test_simulation_in_segments_leaves_nothing_to_loads_of_a_machine_held_upright():
    flat = compile_text(UPRIGHT.encode(), Path("Upright.mo"))
    null = begin(flat, *halved((record(),), ()), DiagnoseOptions(hold="zoh")).null
    assert null.is_likelier_alone
    assert all(gain.log_likelihood_gain == 0.0 for gain in place_gains(null, run_null(null)))
    assert null.theta[list(null.flat.parameter_names).index("J")] == pytest.approx(J, rel=0.02)
