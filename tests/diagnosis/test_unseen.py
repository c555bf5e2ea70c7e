"""What two models foresee of unseen data, compared where they differ."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cart_data import recording

from daest.diagnosis.evidence.free_starts import steady_misfit
from daest.diagnosis.evidence.unseen import (
    Foreseen,
    Innovations,
    _kept,
    _stretches,
    adds_up,
    compared,
    confirmed,
    foreseen,
    foretold_drift,
    is_better,
    is_silent,
    is_worse,
    judged,
    steady_outputs,
    unconfirmed,
)
from daest.diagnosis.null_model.loads import load_places, load_sites, with_loads
from daest.diagnosis.null_model.null import Null, fit_null
from daest.diagnosis.null_model.null_observer import run_null
from daest.estimation.fitting.coordinates import Unknowns
from daest.estimation.fitting.records import part_of
from daest.estimation.nonlinear.nonlinear_start import fit_initial_states
from daest.estimation.nonlinear.observer import AverageModel
from daest.estimation.nonlinear.trajectories import TrajectoryProblem
from daest.model.diagnosis import Ahead, Confirmed, Load
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FittedNoise
from daest.modelica.compile import compile_text
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator


def errors(rng, sizes):
    """(n_stretches, 10, 1)"""
    return rng.standard_normal((len(sizes), 10, 1)) * np.asarray(sizes)[:, None, None]


def told(samples, made, kept=10.0):
    """The errors of values that stay what they are have the size `kept`."""
    return Foreseen({samples: made}, {samples: np.full(made.shape, kept)})


def test_better_worse_and_chance():
    rng = np.random.default_rng(1)
    base = errors(rng, [1.0] * 40)
    large, small = told(10, base + 1.0), told(10, base)
    (one,) = compared(large, small, 0.1)
    assert one.samples == 10 and one.seconds == pytest.approx(1.0)
    assert is_better(one) and not is_worse(one) and one.ratio == pytest.approx(1 / np.sqrt(2), rel=0.1)
    (back,) = compared(small, large, 0.1)
    assert is_worse(back) and not is_better(back)
    found = [compared(told(1, errors(rng, [1.0] * 40)), told(1, errors(rng, [1.0] * 40)), 1.0)[0]
             for _ in range(100)]  # fmt: skip
    assert sum(is_better(a) for a in found) <= 3 and sum(is_worse(a) for a in found) <= 3
    assert compared(None, small, 1.0) == () == compared(small, None, 1.0)


def test_what_is_foreseen_best_by_its_last_value_speaks_against_nothing():
    base = errors(np.random.default_rng(1), [1.0] * 40)
    (one,) = compared(told(1, base, kept=0.5), told(1, 3.0 * base), 0.1)
    assert not is_worse(one) and one.kept == pytest.approx(0.5, rel=0.1) and one.ratio > 2.9
    (other,) = compared(told(1, base, kept=2.0), told(1, 3.0 * base), 0.1)
    assert is_worse(other)


def test_values_that_are_kept_are_the_last_ones_measured_before_a_stretch():
    y = np.arange(200.0)[:, None]
    y[105] = np.nan
    one = _kept(y, 1)
    assert one.shape == (9, 20, 1) and np.all(one[:4] == 1.0)
    assert np.isnan(one[4, 5, 0]) and one[4, 6, 0] == 2.0
    three = _kept(y, 3)
    assert np.array_equal(three[0].ravel(), [1.0, 2.0, 3.0])


def test_recordings_that_are_shorter_than_a_stretch_are_one_each():
    """Halves of 28 and of 22 samples stand beside each other, whatever their lengths."""
    errors_of = [_kept(np.arange(float(n))[:, None], 1) for n in (14, 11, 45)]
    assert [one.shape for one in errors_of] == [(1, 20, 1), (1, 20, 1), (2, 20, 1)]
    assert np.concatenate(errors_of).shape == (4, 20, 1)
    short = errors_of[0].ravel()
    assert np.all(short[1:14] == 1.0) and np.all(np.isnan(short[14:]))


def test_effect_that_acts_seldom_is_judged_where_it_acts():
    rng = np.random.default_rng(2)
    rest = errors(rng, [1.0] * 200)
    without = rest.copy()
    without[:8] += 4.0
    (one,) = compared(told(10, without), told(10, rest), 1.0)
    assert is_better(one) and one.ratio < 0.35, "not the 0.8 of the whole record"


def fit_with(rms, percent=None):
    return SimpleNamespace(simulated={"validation": Agreement({"y": percent}, {"y": rms})})


def ahead(ratio, certainty):
    return Ahead(1, 0.1, ratio, certainty)


@pytest.mark.parametrize(
    "steps, whole, adds_up, reason",
    [
        ([ahead(0.8, 5.0)], 0.95, False, ""),
        ([ahead(0.995, 5.0), ahead(0.9, 1.0)], 0.99, False, "no better"),
        ([ahead(0.8, 5.0), ahead(1.2, -4.0)], 0.5, False, "1.2 times worse over 0.1 s"),
        ([ahead(0.8, 5.0)], 1.5, False, "simulation of unseen data gets 1.5 times worse"),
        ([ahead(0.8, 5.0)], 1.5, True, ""),  # dead reckoning
        ([ahead(1.0, 0.0)], 1.5, True, "1.5 times worse"),
        ([], 0.8, False, ""),
    ],
)
def test_unseen_data_must_be_foreseen_as_well_at_all_horizons_and_better_at_one(
    steps, whole, adds_up, reason
):
    found, is_clear, _ = judged(steps, fit_with(1.0), fit_with(whole), adds_up)
    assert reason in found and bool(reason) == bool(found) and is_clear == (not reason)


@pytest.mark.parametrize(
    "percent, whole, is_refused", [(99.0, 3.0, True), (99.0, 1.5, False), (60.0, 3.0, False)]
)
def test_dead_reckoning_is_no_excuse_where_the_model_had_followed_the_machine(percent, whole, is_refused):
    found, _, _ = judged([ahead(0.8, 5.0)], fit_with(1.0, percent), fit_with(whole), True)
    assert ("3 times worse" in found) == is_refused == bool(found)


def test_simulation_may_stray_as_far_as_its_own_noises_foretell():
    """The one without the law may have come as near as it did by chance."""
    before, after = fit_with(1.0, 99.0), fit_with(3.0)
    found = [judged([ahead(0.8, 5.0)], before, after, True, drift={"y": d})[0] for d in (2.0, 1.0)]
    assert found[0] == "" and "3 times worse" in found[1]


def test_drift_of_a_free_body_is_that_of_its_noise():
    """A position whose acceleration is white noise of intensity W has the variance W*t^3/3, which is W*T^3/12
    over a time T."""
    intensity, last = 0.3, 40.0
    average = AverageModel(np.eye(2, k=1), np.array([[0.0], [1.0]]), np.eye(1, 2), period=0.01)
    null = SimpleNamespace(
        intensity=np.array([intensity]), flat=SimpleNamespace(output_names=("y",)), experiments=()
    )
    run = SimpleNamespace(average=average, null=null, root=np.eye(1))
    time = np.array([0.0, last])
    experiment = Experiment("run", time, np.zeros((2, 0)), np.zeros((2, 1)), (), ("y",))
    found = foretold_drift(run, [experiment])
    assert found == {"y": pytest.approx(np.sqrt(intensity * last**3 / 12.0), rel=0.01)}


@pytest.mark.parametrize(
    "told, whole, reason",
    [
        (Confirmed(30.0, 4.0, 30.0), 0.98, ""),
        (Confirmed(30.0, 4.0, 30.0), 1.0, "no better"),  # no error is any smaller: it matters to nobody
        (Confirmed(1.0, 0.5, 4.0), 1.0, ""),  # what is missing does not show there
        (Confirmed(-8.0, -3.0, 4.0), 1.0, "no better"),
        (Confirmed(2.0, 0.4, 40.0), 0.98, "no better"),  # it ought to show there, and does not
    ],
)
def test_likelihood_of_unseen_data_speaks_where_their_errors_are_noise(told, whole, reason):
    found, is_clear, _ = judged([ahead(1.0, 0.0)], fit_with(1.0), fit_with(whole), False, told)
    assert reason in found and bool(reason) == bool(found) and is_clear == (not reason)


@pytest.mark.parametrize("size", [0.05, 0.3])
def test_right_law_gains_the_likelihood_that_is_expected_of_it(size):
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((200, 20, 1))
    law = size * np.sign(rng.standard_normal((200, 20, 1)))
    found = confirmed(Innovations(noise + law, 0.0), Innovations(noise, 0.0))
    expected = 0.5 * size**2 * noise.size
    assert found.expected == pytest.approx(expected)
    assert found.gain == pytest.approx(expected, abs=3.0 * np.sqrt(2.0 * expected))
    assert is_silent(found) == (size == 0.05) and (size == 0.05 or found.certainty > 5.0)
    wrong = confirmed(Innovations(noise, 0.0), Innovations(noise + law, 0.0))
    assert wrong.gain == pytest.approx(-found.gain) and wrong.certainty < 0.0
    # A wider band of the innovations costs what the density says.
    wider = confirmed(Innovations(noise, 0.0), Innovations(0.5 * noise, -np.log(2.0)))
    assert wider.gain < -500.0
    assert confirmed(None, Innovations(noise, 0.0)).certainty == 0.0


ANGLE = np.array([[0.0, 1.0], [0.0, -2.0]])  # d/dt of an angle that nothing holds, and of its speed
HELD = np.array([[0.0, 1.0], [-9.0, -2.0]])
FREE = np.array([[0.0, 1.0], [0.0, 0.0]])


@pytest.mark.parametrize(
    "A, seen, expected",
    [(ANGLE, 0, True), (ANGLE, 1, False), (HELD, 0, False), (FREE, 1, True)],
    ids=["angle", "its speed", "held", "free speed"],
)
def test_errors_add_up_where_the_outputs_see_what_keeps_them(A, seen, expected):
    assert adds_up(observer_of(A, [seen])) == expected


def observer_of(A, seen, names=()):
    """An observer of an angle and its speed with dynamics A (2, 2), of which the outputs `names` show those
    that are `seen`, beside a load with a long memory, which is none of the model's."""
    whole = np.zeros((3, 3))
    whole[1:, 1:], whole[2, 0], whole[0, 0] = A, 1.0, -1e-3
    experiment = SimpleNamespace(time=np.linspace(0.0, 10.0, 11))
    flat = SimpleNamespace(output_names=names)
    null = SimpleNamespace(experiments=[experiment], loads=[SimpleNamespace(name="load_1")], flat=flat)
    average = SimpleNamespace(A=whole, C=np.eye(3)[[1 + row for row in seen]])
    return SimpleNamespace(null=null, average=average, state_names=("load_1", "phi", "w"))


@pytest.mark.parametrize("A, expected", [(ANGLE, ("w",)), (HELD, ("phi", "w")), (FREE, ())])
def test_outputs_that_do_not_see_what_keeps_errors(A, expected):
    assert steady_outputs(observer_of(A, [0, 1], ("phi", "w"))) == expected


@pytest.mark.parametrize("angle, twist, reason", [(1.5, 0.9, ""), (1.5, 1.3, "of twist"), (0.5, 1.05, "")])
def test_dead_reckoning_of_one_output_excuses_no_other_one(angle, twist, reason):
    before, after = (
        SimpleNamespace(simulated={"validation": Agreement({"phi": 60.0, "twist": 60.0}, errors)})
        for errors in ({"phi": 1.0, "twist": 1.0}, {"phi": angle, "twist": twist})
    )
    found, is_clear, _ = judged([ahead(0.8, 5.0)], before, after, True, holding=("twist",))
    assert reason in found and bool(reason) == bool(found) and is_clear == (not reason)


@pytest.mark.parametrize("speed, is_told", [(0.26, True), (0.95, False)])
def test_what_is_simulated_far_better_beside_dead_reckoning_tells_a_law(speed, is_told):
    """A car takes a command late: its speed is simulated far better with that, its heading adds up, and one
    sample ahead an observer that follows the speed closely is foreseen no better."""
    before, after = (
        SimpleNamespace(simulated={"validation": Agreement({"v": 60.0, "psi": 60.0}, errors)})
        for errors in ({"v": 1.0, "psi": 1.0}, {"v": speed, "psi": 1.3})
    )
    found, is_clear, _ = judged([ahead(1.34, -2.1)], before, after, True, holding=("v",))
    assert is_clear == is_told == (not found)


RUB = """
model Rub
  input Real F;
  Real s(start = 0, fixed = true);
  Real v(start = 0, fixed = true);
  output Real y = s;
equation
  der(s) = v;
  der(v) = F - 10*s - 0.8*v - 0.5*tanh(v/0.006);
end Rub;
"""


def test_a_law_that_sticks_is_followed_from_the_middle_of_a_motion():
    """Its observer does not correct it where nothing but noise is left, and from rest it has no slopes."""
    model = reduce_index(compile_text(RUB.encode(), Path("Rub.mo")))
    time, force, position = recording(800, 1, friction=0.5)[400:].T
    unseen = Experiment("unseen", time, force[:, None], position[:, None], ("F",), ("y",))
    null = SimpleNamespace(
        explicit=model, theta=model.flat.theta_values, hold="zoh", loads=(), measurement_std=np.array([0.002])
    )
    run = SimpleNamespace(null=null, gain=np.zeros((2, 1)), root=np.array([[500.0]]), sizes=np.ones(2))
    found = foreseen(run, [unseen])
    assert found is not None
    assert np.sqrt(np.mean(found.errors[1] ** 2)) == pytest.approx(0.002, rel=0.15)


ROLLS = """
model Rolls
  input Real F;
  Real s(start = 0, fixed = true);
  Real v(start = 0, fixed = true);
  output Real speed = v;
  output Real place = s;
equation
  der(s) = v;
  der(v) = F - 20*v - 0.2*sin(s);
end Rolls;
"""


def test_the_start_is_found_where_the_fit_leaves_the_noise_of_a_sensor_open():
    """An observer that corrects nothing is the same for any noise of a sensor, and a fit that needs no load
    may end with one that is beyond all that the sensor shows: what is a start worth then?"""
    model = reduce_index(compile_text(ROLLS.encode(), Path("Rolls.mo")))
    theta, rng = model.flat.theta_values, np.random.default_rng(2)
    time, force = 0.02 * np.arange(400), rng.normal(size=(400, 1))
    exact = integrate(integrator(model), time, force, theta, np.array([3.0, -0.2]), hold="zoh").outputs
    measured = exact + rng.normal(size=exact.shape) * [0.01, 0.02]
    measured[40:60, 1] = np.nan
    unseen = Experiment("unseen", time, force, measured, ("F",), ("speed", "place"))
    null = SimpleNamespace(
        explicit=model, theta=theta, hold="zoh", loads=(), measurement_std=np.array([0.01, 1e4])
    )
    run = SimpleNamespace(null=null, gain=np.zeros((2, 2)), root=np.diag([100.0, 50.0]), sizes=np.ones(2))
    found = foreseen(run, [unseen])
    assert found is not None
    assert np.sqrt(np.nanmean(found.errors[1] ** 2, axis=(0, 1))) == pytest.approx([0.01, 0.02], rel=0.15)


TURNS = """
model Turns "An arm that turns over"
  input Real tau(unit = "N.m");
  parameter Real d(unit = "N.m.s/rad") = 0.05;
  Real phi(unit = "rad", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
  output Real angle(unit = "rad") = phi;
equation
  der(phi) = w;
  der(w) = tau - 10*sin(phi) - d*w;
end Turns;
"""


@cache
def turning():
    """The arm as a null whose loads are nothing, with a damping that is 2 % too small; and a recording that
    begins three turns up."""
    flat = compile_text(TURNS.encode(), Path("Turns.mo"))
    rng = np.random.default_rng(3)
    time, torque = 0.02 * np.arange(1200), np.repeat(rng.uniform(-9.0, 9.0, 30), 40)[:, None]
    arm = reduce_index(flat)
    start = np.array([18.9 if name == "phi" else -3.0 for name in arm.state_names])
    exact = integrate(integrator(arm), time, torque, np.array([0.051]), start, hold="zoh").outputs
    assert np.ptp(exact) > 4.0 * np.pi
    measured = exact + rng.normal(0.0, 0.003, exact.shape)
    record = Experiment("turning", time, torque, measured, ("tau",), ("angle",))
    places = load_places(flat, load_sites(flat))
    loaded = with_loads(flat, places, [0.01] * len(places))
    values = dict(zip(arm.state_names, start, strict=True))
    noises = (FittedNoise("load_1.w", "process", 1e-12, None, "", True, None),)
    noises += (FittedNoise("angle", "measurement", 0.003, None, "", True, None),)

    @dataclass
    class Fit:
        parameters = ()
        noises: tuple
        initial_states = (SimpleNamespace(names=tuple(values), values=tuple(values.values())),)

    loads = (Load("load_1", "1:w", ("1:w",), 0.01, 1e-6, "N.m"),)
    explicit = reduce_index(loaded)
    return arm, record, Null(loaded, explicit, Fit(noises), loads, places, (record,), "zoh")


def test_the_first_samples_tell_the_turn_that_an_arm_is_in():
    arm, record, _ = turning()
    unknowns = Unknowns((), arm.flat.theta_values, np.zeros(0), np.ones(1))
    problem = TrajectoryProblem(integrator(arm), (record,), "zoh", unknowns, np.ones(2), np.array([np.nan]))
    z = fit_initial_states(problem, np.zeros(2), np.full(2, -100.0), np.full(2, 100.0))
    assert z[arm.state_names.index("phi")] == pytest.approx(18.9, abs=0.01)


def test_a_law_is_judged_from_states_that_are_known():
    """Where no load is left the observer corrects nothing, and a small error adds up to whole turns."""
    _, record, null = turning()
    first = replace(null, experiments=(part_of(record, 0, 150),))
    lost = run_null(first)
    lost = replace(lost, gain=np.zeros_like(lost.gain))
    errors = _stretches(lost, integrator(null.explicit), record, _start_of(null), 1)
    assert np.sqrt(np.mean(errors**2)) > 0.1
    found = foreseen(lost, [record])
    assert found is not None
    assert np.sqrt(np.mean(found.errors[1] ** 2)) < 0.006


def _start_of(null):
    return np.array([null.initial_states[0].get(name, 0.0) for name in null.explicit.state_names])


def test_constant_load_of_every_recording_is_no_law():
    whole, steady = fit_with(1.05), 0.8
    assert judged([ahead(0.9, 1.5)], fit_with(1.0), whole, False)[0] != ""
    assert judged([ahead(0.9, 1.5)], fit_with(1.0), whole, False, steady=steady)[0] == ""
    assert "1.2 times worse" in judged([ahead(1.2, -4.0)], fit_with(1.0), whole, False, steady=steady)[0]


def test_a_constant_load_excuses_no_law_of_which_no_prediction_is_known():
    """A board that cools, of which 40 readings are unseen: radiation simulates them three times worse."""
    assert "2.97 times worse" in judged([], fit_with(1.0), fit_with(2.97), False, steady=0.4)[0]
    assert judged([ahead(0.9, 1.5)], fit_with(1.0), fit_with(2.97), False, steady=0.4)[0] == ""


@pytest.mark.parametrize(
    "confirmed, is_refused",
    [
        (Confirmed(-1.0, -0.09, 27.0), True),
        (Confirmed(25.0, 5.0, 27.0), False),
        (Confirmed(-1.0, -0.5, 5.0), False),
    ],
)
def test_a_constant_load_excuses_no_law_that_the_unseen_data_deny(confirmed, is_refused):
    """Gas that clings to the wall of a chamber and comes off again is no outlet, though one simulates better
    beside a constant flow of each recording: it would make the unseen data likelier by 27, and does not."""
    found, _, _ = judged([ahead(0.97, 0.3)], fit_with(1.0), fit_with(1.06), False, confirmed, steady=0.83)
    assert bool(found) == is_refused


@pytest.mark.parametrize("own, is_refused", [(1.0, False), (2.3, True)])
def test_a_constant_load_excuses_nothing_that_a_law_costs_its_own_recordings(own, is_refused):
    """Of five thermometers along a rod one reads too low. That another reads too high a constant
    heat flow into each piece of the rod excuses, but it simulates the others worse in its own recordings."""
    before, after = fit_with(1.0), fit_with(2.3)
    before.simulated["estimation"] = Agreement({}, {"y": 1.0})
    after.simulated["estimation"] = Agreement({}, {"y": own})
    found, _, _ = judged([ahead(0.8, 5.0)], before, after, False, steady=0.87)
    assert bool(found) == is_refused


ROOM = """model Room
  parameter Real C(unit = "J/K", min = 0) = 1e5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real G(unit = "W/K", min = 0) = 20 annotation(__Daest(estimate = true, scale = "log"));
  input Real u(unit = "W");
  Real T(unit = "K", start = 290);
  output Real y(unit = "K");
equation
  C*der(T) = u - G*(T - 290);
  y = T;
end Room;
"""


def test_colder_room_does_not_count_against_the_model():
    """The outside is 3 K colder in the unseen recordings, so that 60 W more are lost."""
    rng = np.random.default_rng(4)
    time, sigma = 60.0 * np.arange(400), 0.02

    def recorded(outside):
        u = np.repeat(rng.uniform(0.0, 400.0, 20), 20)
        x, states = outside, []
        for value in u:
            states.append(x)
            end = outside + value / 20.0
            x = end + (x - end) * np.exp(-60.0 * 20.0 / 1e5)
        y = np.array(states) + sigma * rng.standard_normal(400)
        return Experiment("run", time, u[:, None], y[:, None], ("u",), ("y",))

    flat = compile_text(ROOM.encode(), Path("Room.mo"))
    null = fit_null(flat, load_sites(flat), [recorded(290.0)], "zoh")
    same, colder = ([recorded(outside)] for outside in (290.0, 287.0))
    true = null.flat.with_theta({"C": 1e5, "G": 20.0})
    misfits = [steady_misfit(null, true, null.explicit, unseen) for unseen in (same, colder)]
    noise = null.measurement_std[0]
    assert np.sqrt(np.array(misfits) / 400) * noise == pytest.approx([sigma, sigma], rel=0.1)
    slow = null.flat.with_theta({"C": 2e5, "G": 20.0})
    assert steady_misfit(null, slow, null.explicit, colder) > 100.0 * misfits[1]


def test_a_law_that_takes_little_of_the_load_needs_unseen_data_that_are_foreseen_clearly_better():
    """Play where a contact opens, and an outlet of a tight chamber, which had both been supported."""
    slightly = (Ahead(1, 0.005, 0.98, 0.9), Ahead(100, 0.5, 0.85, 1.7))
    reason = "it explains only 35 % of the unexplained load, and unseen data are foreseen clearly better"
    assert unconfirmed(0.354, slightly, Confirmed(2.0, 0.7, 9.0)).startswith(reason)
    assert unconfirmed(0.6, slightly, Confirmed()) == ""
    assert unconfirmed(0.354, (), Confirmed()) == ""
    assert unconfirmed(0.354, slightly, Confirmed(9.0, 2.7, 12.0)) == ""
    assert unconfirmed(0.354, (*slightly, Ahead(30, 0.15, 0.9, 3.1)), Confirmed()) == ""
