"""Evidence in open loop: how it counts, and a slow law that an observer hides."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from daest.diagnosis.evidence.open_loop import (
    Simulated,
    _certainty,
    _independent,
    _independent_in_mean,
    driven_share,
    in_use,
    is_far_behind,
    leaves_an_output,
    rivals_in_use,
    says_more_in_use,
    speaks_for,
)
from daest.diagnosis.evidence.reasons import undriven
from daest.diagnosis.examine import _said_of_inputs
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import fit_null
from daest.model.diagnosis import InUse
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FittedNoise
from daest.modelica.compile import compile_text


def lasting(n, seed, memory=0.9, size=1.0):
    rng = np.random.default_rng(seed)
    steps = np.concatenate([[0.0], np.sqrt(1.0 - memory**2) * rng.standard_normal(n - 1)])
    return size * lfilter([1.0], [1.0, -memory], steps)[:, None]


def simulated(size, seed, memory=0.9, n=2000):
    return Simulated((lasting(n, seed, memory, size),), (lasting(n, seed + 1, memory, size),))


def test_errors_that_last_count_as_few_samples():
    white, slow = (in_use(simulated(2.0, 1, m), simulated(1.0, 3, m)) for m in (0.0, 0.95))
    assert white.n_independent == pytest.approx(2000, rel=0.35)
    # Of squares: n (1 - a²)/(1 + a²)
    assert slow.n_independent == pytest.approx(2000 * (1 - 0.95**2) / (1 + 0.95**2), rel=0.4)
    assert white.ratio == pytest.approx(0.5, rel=0.1) and slow.ratio == pytest.approx(0.5, rel=0.3)
    assert white.gain > 5 * slow.gain > 0 and white.certainty > slow.certainty > 2.5
    assert speaks_for(white, 1) and speaks_for(slow, 1)


@pytest.mark.parametrize("memory", [pytest.param(0.0, marks=pytest.mark.slow), 0.95])
def test_a_law_that_does_nothing_is_seldom_better_in_use(memory):
    found = [in_use(simulated(1.0, 10 * i, memory), simulated(1.0, 10 * i + 5, memory)) for i in range(60)]
    certainties = np.array([one.certainty for one in found])
    assert abs(certainties.mean()) < 0.4 and 0.7 < certainties.std() < 1.3
    assert sum(speaks_for(one, 1) for one in found) <= 2


@pytest.mark.parametrize(
    ("explained", "voltage", "is_left"),
    [(0.02, 0.144, True), (0.02, 0.05, False), (0.3, 0.144, False), (0.3, 0.16, True), (0.4, 0.16, False)],
)
def test_a_law_that_leaves_an_output_as_wrong_as_it_was_shows_nothing(explained, voltage, is_left):
    def fit(*rms):
        noises = [
            FittedNoise(name, "measurement", std, None, "", True, None)
            for name, std in (("iL", 0.01), ("v", 0.05))
        ]
        seen = Agreement({}, dict(zip(("iL", "v"), rms, strict=True)))
        return SimpleNamespace(noises=noises, simulated={"validation": seen})

    before, after = fit(0.06, 0.147), fit(0.024, voltage)
    assert leaves_an_output(explained, after, before, after) == is_left
    # What is noise is no error that a law could have taken away.
    assert not leaves_an_output(0.02, after, fit(0.06, 0.052), fit(0.024, 0.051))


def test_a_law_that_is_worse_where_it_was_fitted_is_better_elsewhere_by_chance():
    shown = InUse(0.02, 0.7, 47.0, 47.0, 2.7)
    assert speaks_for(shown, 1) and not speaks_for(replace(shown, fitted=-0.02), 1)


def agreements(fitted, unseen):
    parts = {"estimation": fitted, "validation": unseen}
    return {name: Agreement({"y": 50.0}, {"y": rms}) for name, rms in parts.items()}


def test_far_behind_is_worse_on_all_data():
    leader = agreements(1.0, 1.0)
    assert is_far_behind(agreements(4.0, 3.0), leader)
    assert not is_far_behind(agreements(4.0, 1.5), leader)
    assert not is_far_behind(agreements(1.5, 4.0), leader)
    assert not is_far_behind({"estimation": leader["estimation"]}, leader)


def test_every_output_counts_for_itself_where_laws_are_compared():
    """A gain that does away with the error of one output is more than a bend that takes half of both."""
    rng = np.random.default_rng(3)
    errors = rng.standard_normal((1000, 2))

    def left(*shares):
        return Simulated(*[(errors * np.array(shares),) for _ in range(2)])

    before = left(1.0, 1.0)
    gain, bend = in_use(before, left(0.1, 1.0)), in_use(before, left(0.5, 0.5))
    assert gain.apart == pytest.approx((np.log(10.0), np.log(10.0)))
    assert gain.unseen < bend.unseen and gain.by_output.unseen > bend.by_output.unseen
    assert bend.by_output.bic(2) == pytest.approx(bend.bic(2))
    assert gain.by_output.n_unseen == gain.n_unseen and InUse().by_output == InUse()


def test_a_constant_beside_a_slow_error_is_as_uncertain_as_that_error_is_slow():
    """Its mean square is known from twice as many samples as its mean, with which a constant goes."""
    slow = lasting(4000, 1, 0.99)[:, 0]
    gap = 2.0 * slow - 1.0
    by_mean, by_square = (one(gap - gap.mean()) for one in (_independent_in_mean, _independent))
    assert by_mean < 0.7 * by_square
    assert _independent_in_mean(np.zeros(10)) == 0.0


def test_what_is_not_known_says_nothing():
    nothing = in_use(None, simulated(1.0, 1))
    assert nothing == InUse() and not speaks_for(nothing, 1)
    fitted = simulated(1.0, 1)
    gone = Simulated(fitted.fitted, (np.full((2000, 1), np.nan),))
    assert in_use(fitted, gone) == InUse()


def test_worse_on_one_side_is_no_evidence():
    better_fitted = Simulated(simulated(0.5, 3).fitted, simulated(1.1, 3).unseen)
    assert not speaks_for(in_use(simulated(1.0, 1), better_fitted), 1)


SPRING = b"""model Spring
  parameter Real J(unit = "kg.m2", min = 0) = 0.1 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real c(unit = "N.m/rad", min = 0) = 2 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.05 annotation(__Daest(estimate = true, scale = "log"));
  input Real u(unit = "N.m");
  Real phi(unit = "rad", start = 0);
  Real w(unit = "rad/s", start = 0);
  output Real y(unit = "rad");
equation
  der(phi) = w;
  J*der(w) = u - c*phi - d*w;
  y = phi;
end Spring;
"""


@pytest.mark.parametrize("is_recorded", [True, False])
def test_a_model_that_its_inputs_do_not_move_is_told(is_recorded):
    """The machine is moved by a torque; what is recorded is that, or noise that has nothing to do with it."""
    rng, dt = np.random.default_rng(8), 0.05
    acts, noise = np.repeat(rng.normal(0.0, 1.0, (2, 80)), 10, axis=1)
    whole = expm(np.array([[0.0, 1.0, 0.0], [-20.0, -0.5, 10.0], [0.0, 0.0, 0.0]]) * dt)
    x, angle = np.zeros(2), []
    for torque in acts:
        angle.append(x[0])
        x = whole[:2, :2] @ x + whole[:2, 2] * torque
    measured = np.array(angle) + rng.normal(0.0, 1e-3, acts.size)
    recorded = (acts if is_recorded else noise)[:, None]
    record = Experiment("run", dt * np.arange(acts.size), recorded, measured[:, None], ("u",), ("y",))
    flat = compile_text(SPRING, Path("Spring.mo"))
    null = fit_null(flat, load_sites(flat), [record], "zoh")
    share = driven_share(null)
    assert share == pytest.approx(1.0, abs=0.1) if is_recorded else share < GATES.min_driven
    assert bool(undriven(null)) == bool(_said_of_inputs(null, null.fit)) == (not is_recorded)
    assert is_recorded or "check their columns and units" in _said_of_inputs(null, null.fit)
    # Without its loads the inputs move the model: these have taken over what the inputs do.
    told = replace(null.fit, theta={**null.fit.theta, "J": 0.1, "c": 2.0, "d": 0.05})
    heavy = replace(null, flat=null.flat.with_theta({**null.fit.theta, "J": 1e4, "c": 2e5, "d": 5e3}))
    assert driven_share(heavy) < GATES.min_driven
    assert not _said_of_inputs(heavy, told)
    # One level tells nothing, nor does what a filter leaves of it by rounding.
    for level in (0.0 * recorded, 0.05 + 1e-15 * noise[:, None]):
        assert driven_share(replace(null, experiments=(replace(record, inputs=level),))) is None


@pytest.mark.slow  # what inputs move: the test above
def test_inputs_that_were_switched_before_the_recordings_move_the_model():
    """A torque that is on in one recording and off in the other, with the noise of its sensor."""
    rng, dt, n = np.random.default_rng(9), 0.05, 200
    time = dt * np.arange(n)
    swing = np.exp(-0.25 * time) * np.cos(np.sqrt(20.0) * time)
    records = []
    for name, torque, angle in (("on", 1.0, 0.5 * (1.0 - swing)), ("off", 0.0, 0.5 * swing)):
        u = torque + rng.normal(0.0, 1e-3, (n, 1))
        y = angle[:, None] + rng.normal(0.0, 1e-3, (n, 1))
        records.append(Experiment(name, time, u, y, ("u",), ("y",)))
    flat = compile_text(SPRING, Path("Spring.mo"))
    null = fit_null(flat, load_sites(flat), records, "zoh")
    assert driven_share(null) > GATES.min_driven and not undriven(null)
    # One level from a known start tells as much as a swing without any input.
    alone = replace(null, experiments=(records[0],))
    assert driven_share(alone) > GATES.min_driven and not undriven(alone)
    moved = replace(records[0], outputs=records[0].outputs + np.sin(1.3 * time)[:, None])
    other = replace(null, experiments=(moved,))
    assert driven_share(other) < GATES.min_driven
    assert "since they hardly change: record while they do" in _said_of_inputs(other, null.fit)


BASIN = b"""model Basin
  parameter Real A(unit = "m2") = 2;
  parameter Real k(unit = "m2/s", min = 0) = 0.2 annotation(__Daest(estimate = true, scale = "log"));
  input Real valve(unit = "1");
  output Real h(unit = "m", start = 1);
equation
  A*der(h) = -k*valve*h;
end Basin;
"""


@pytest.mark.parametrize("empties", [True, False])
def test_what_a_recording_begins_with_moves_a_model_as_inputs_do(empties):
    """A basin that empties behind a valve, opened before the second sample; and one whose level does what it
    will while the valve stands open."""
    rng, time = np.random.default_rng(4), 0.5 * np.arange(120)
    valve = np.minimum(np.arange(120.0), 1.0)[:, None]
    level = np.exp(-0.1 * time) if empties else 1.0 + np.cumsum(rng.normal(0.0, 0.2, 120))
    measured = (level + rng.normal(0.0, 0.01, 120))[:, None]
    record = Experiment("run", time, valve, measured, ("valve",), ("h",))
    flat = compile_text(BASIN, Path("Basin.mo"))
    null = fit_null(flat, load_sites(flat), [record], "zoh")
    null = replace(null, flat=null.flat.with_theta({**null.fit.theta, "k": 0.2}))
    assert bool(undriven(null)) is not empties


def test_few_independent_samples_say_nothing_on_either_data():
    """A single decay is one event, however many samples it has."""
    shown = InUse(fitted=4.0, unseen=1.1, n_independent=14.0, n_unseen=8.0, certainty=4.1)
    assert speaks_for(shown, 2)
    for few in ({"n_unseen": 4.2}, {"n_independent": 4.2}):
        assert not speaks_for(replace(shown, **few), 2)


def test_law_that_says_more_than_one_that_is_shown_needs_no_certainty_of_its_own():
    """Which of two laws bends a signal is a question of how much each explains, not of chance."""
    shown = InUse(fitted=0.7, unseen=0.9, n_independent=46.0, n_unseen=25.0, certainty=2.6)
    better = InUse(fitted=0.8, unseen=1.1, n_independent=48.0, n_unseen=20.0, certainty=2.2)
    assert speaks_for(shown, 1) and not speaks_for(better, 1)
    assert says_more_in_use(better, shown)
    for worse in ({"fitted": 0.6}, {"unseen": 0.8}, {"certainty": -0.1}, {"n_independent": 1.0}):
        assert not says_more_in_use(replace(better, **worse), shown)
    assert not says_more_in_use(better, InUse())


def test_law_that_says_as_much_as_one_that_is_shown_is_its_rival():
    shown = InUse(fitted=0.35, unseen=0.58, n_independent=34.0, n_unseen=23.0, certainty=2.6)
    # As good over fewer independent samples: the other one counts for as few.
    alike = replace(shown, n_independent=28.0, n_unseen=18.0, certainty=1.8)
    assert alike.bic(1) < shown.bic(1) - 4.0
    assert rivals_in_use(alike, 1, shown, 1)
    assert rivals_in_use(replace(alike, fitted=0.6, unseen=0.8), 3, shown, 1)
    for worse in (
        {"fitted": 0.2, "unseen": 0.25},
        {"unseen": 0.1, "fitted": 0.6},
        {"certainty": -0.1},
        {"n_independent": 4.0},
    ):
        assert not rivals_in_use(replace(alike, **worse), 1, shown, 1)
    assert not rivals_in_use(InUse(), 1, shown, 1)


def test_few_large_errors_leave_a_law_certain_that_takes_them_and_all_others():
    """After a turn over the top a pendulum is far off for a while; without it the law is as clear."""
    rng = np.random.default_rng(2)
    n = 2000
    once = np.ones(n)
    once[300:420] = 30.0
    before = (once * lasting(n, 1)[:, 0])[:, None]
    after = 0.2 * lasting(n, 2) + 0.01 * rng.standard_normal((n, 1))
    found = in_use(Simulated((before,), (before,)), Simulated((after,), (after,)))
    gap = (before**2 - after**2)[:, 0] / np.mean(before**2)
    assert _certainty(gap) < GATES.unseen_significance < found.certainty
    assert speaks_for(found, 1)
    # It is no better where the law is worse in all of the rest.
    rest = np.where(once > 1.0, 0.2, 1.3)[:, None] * lasting(n, 1)
    partly = in_use(Simulated((before,), (before,)), Simulated((rest,), (rest,)))
    assert partly.certainty < GATES.unseen_significance


@pytest.mark.parametrize(("leaves", "is_certain"), [(0.0, True), (0.3, False)])
def test_one_long_excursion_is_no_chance_where_a_law_leaves_noise_of_it(
    leaves: float, is_certain: bool
) -> None:
    """A fan runs fast once: its drag is nearly all of the error of that recording, and the squares of the
    error there are as uncertain as a single one."""
    rng, t = np.random.default_rng(11), np.arange(3000.0)
    course = 0.2 * np.sin(0.015 * t) + 3.0 * np.exp(-0.5 * ((t - 1500.0) / 200.0) ** 2)
    noise = [0.2 * rng.normal(size=(t.size, 1)) for _ in range(2)]
    before, after = (
        Simulated(*((share * course[:, None] + own,) for own in noise)) for share in (1.0, leaves)
    )
    found = in_use(before, after)
    assert found.ratio < 0.5 and (found.certainty > GATES.unseen_significance) == is_certain
    assert found.leaves_noise == is_certain
