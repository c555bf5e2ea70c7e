"""Inputs of all families keep their limits; the gradient is exact, and the free input is the best."""

import time

import numpy as np
import pytest
from driven import driven, flat, limits

from daest.design import signals
from daest.design.aims import ParameterAim
from daest.design.design import Task, design
from daest.design.prepared import Subject, explainer
from daest.design.safety import Guard
from daest.design.search import Budget, best_of_families, free_input
from daest.errors import EstimationError
from daest.model.design import Limits, Range


def aim(criterion="D", interest=(0, 1, 2)):
    return ParameterAim(driven("Cart"), interest, criterion, np.zeros((3, 3)))


def budget(seconds=20.0):
    return Budget(time.perf_counter() + seconds)


def searched(one, allowed, guard=None):
    guard = guard or Guard(one.driven, allowed.safe)
    families = best_of_families(one, allowed, guard, 0, budget())
    return families, free_input(one, allowed, guard, families[0], budget())


@pytest.mark.parametrize("family", list(signals.FAMILIES))
@pytest.mark.parametrize("rate", [np.inf, 3.0])
def test_families_keep_amplitude_and_rate(family, rate):
    two = (Range("a", "V", -1.0, 3.0, rate), Range("b", "V", 0.0, 2.0, rate))
    allowed = Limits(two, 30.0, 0.1)
    shapes = list(signals.FAMILIES[family](allowed, 3))
    assert shapes
    for shape in shapes:
        inputs = signals.within(allowed, shape.signal, keeps_form=family in ("multisine", "chirp"))
        for one, column in zip(two, inputs.T, strict=True):
            assert one.low - 1e-9 <= column.min() < column.max() <= one.high + 1e-9
            assert np.max(np.abs(np.diff(column))) <= rate * allowed.period * (1 + 1e-9)
        assert abs(np.corrcoef(inputs.T)[0, 1]) < 0.95  # nothing tells two inputs apart that move together


def test_multisine_and_chirp_keep_the_band():
    allowed = Limits((Range("a", "V", -1.0, 1.0),), 40.0, 0.05, band=(0.5, 2.0))
    frequencies = np.fft.rfftfreq(allowed.time.size - 1, allowed.period)
    inside = (frequencies > 0.45) & (frequencies < 2.1)
    for family in ("multisine", "chirp"):
        for shape in signals.FAMILIES[family](allowed, 0):
            power = np.abs(np.fft.rfft(shape.signal[:-1, 0])) ** 2
            assert power[inside].sum() > 0.97 * power.sum()


@pytest.mark.parametrize("criterion", ["D", "A", "worst"])
def test_gradient_is_that_of_differences(criterion):
    allowed, one = limits(), aim(criterion, (0, 1))
    force = signals.within(allowed, next(signals.steps(allowed, 1)).signal, keeps_form=False)
    slopes = one.gradient(force)
    for k in (7, 100, 333):
        up, down = force.copy(), force.copy()
        up[k] += 1e-3
        down[k] -= 1e-3
        assert slopes[k, 0] == pytest.approx((one.merit(up) - one.merit(down)) / 2e-3, rel=1e-4, abs=1e-9)


def test_the_free_input_is_at_least_as_good():
    allowed = limits()
    families, free = searched(aim(), allowed)
    assert [f.value for f in families] == sorted(f.value for f in families)
    assert free.value < 0.9 * families[0].value
    assert np.max(np.abs(free.inputs)) <= 4.0 + 1e-9


def test_the_free_input_keeps_rate_and_band():
    allowed = limits(rate=20.0, band=(0.0, 2.0))
    families, free = searched(aim(), allowed)
    assert free.value <= families[0].value
    assert np.max(np.abs(free.inputs)) <= 4.0 + 1e-6
    assert np.max(np.abs(np.diff(free.inputs[:, 0]))) <= 20.0 * allowed.period + 1e-6


def test_most_information_is_at_the_resonance():
    """Of a weakly damped cart the friction shows at its resonance, 0.8 Hz, and there alone."""
    _, free = searched(aim("worst", (1,)), limits(length=40.0))
    power = np.abs(np.fft.rfft(free.inputs[:-1, 0])) ** 2
    strongest = np.fft.rfftfreq(free.inputs.shape[0] - 1, 0.05)[np.argmax(power)]
    assert strongest == pytest.approx(np.sqrt(30.0 / 1.2) / (2 * np.pi), abs=0.05)


@pytest.mark.slow
def test_safe_ranges_hold():
    safe = (Range("x", "m", -0.05, 0.05),)
    allowed = limits(safe=safe)
    guard = Guard(aim().driven, safe)
    families, free = searched(aim(), allowed, guard)
    for played in (*families, free):
        low, high = guard.reach(driven("Cart"), played.inputs)[0]
        assert -0.05 <= low < high <= 0.05
        assert max(-low, high) > 0.03  # and they are used


def test_limits_that_allow_nothing_are_told():
    with pytest.raises(EstimationError, match="no input") as problem:
        Limits((), 10.0, 0.1)
    assert problem.value.code == "design-no-input"
    for bad in (
        {"low": 1.0, "high": -1.0},
        {"low": 2.0, "high": 2.0},
        {"rate": 0.0},
        {"band": (5.0, 1.0)},
        {"band": (30.0, 40.0)},
        {"safe": (Range("x", "m", 1.0, 0.0),)},
        {"low": float("nan"), "high": float("nan")},
    ):
        with pytest.raises(EstimationError) as problem:
            limits(**bad)
        assert problem.value.code == "design-limit"
    with pytest.raises(EstimationError) as problem:
        limits(length=0.1)
    assert problem.value.code == "design-too-short"


def test_what_no_input_tells_and_what_would():
    """Mass, friction, spring and the gain of the drive are told up to a common factor by the motion alone; a
    sensor of the force on the mass tells them all."""
    model = flat("Pushed")
    subject = Subject(model, ("m", "b", "c", "g"))
    one = ParameterAim(explainer(subject, 0.05, "zoh"), (0, 1, 2, 3), "D", np.zeros((4, 4)))
    found = design(Task(one, (subject,), limits(), seconds=0.6))
    (direction,) = found.open_directions
    assert np.isinf(direction.relative_std) and set(direction.combination) == {"m", "b", "c", "g"}
    assert all(weight == 1.0 for weight in direction.combination.values())
    assert all(error is None for error in found.expected.std_errors.values())
    assert [s.variables[0] for s in found.sensors if s.closes] == ["f"]
    (note,) = [n for n in found.notes if n.startswith("no input tells")]
    assert "m · b · c · g" in note and "a sensor at f" in note


def test_a_recording_that_there_is_counts():
    """What is known already needs no input: the criterion is that of both recordings together."""
    allowed = limits()
    force = signals.within(allowed, next(signals.steps(allowed, 0)).signal, keeps_form=False)
    known = 1e8 * np.eye(3)
    alone, together = aim(), ParameterAim(driven("Cart"), (0, 1, 2), "D", known)
    assert together.value(together.merit(force)) == pytest.approx(1e-4, rel=0.02)
    assert alone.value(alone.merit(force)) > 1e-3


@pytest.mark.slow
def test_d_optimal_levels_of_a_saturating_law():
    """Half of the samples at the largest input, half at K / (2 K + 1): known in closed form. No gradient is
    known for a nonlinear model; pieces are exchanged."""
    subject = Subject(flat("Saturating"), ("V", "K"))
    allowed = Limits((Range("u", "", 0.0, 1.0),), 3.0, 0.05, hold="zoh")
    one = ParameterAim(explainer(subject, 0.05, "zoh"), (0, 1), "D", np.zeros((2, 2)))
    levels = np.where(np.arange(allowed.time.size) % 2, 1.0, 0.3 / 1.6)[:, None]
    best = one.value(one.merit(levels))
    families, free = searched(one, allowed)
    assert families[0].value > 1.1 * best
    assert free.value < 1.05 * best


def test_exchanged_pieces_keep_the_limits():
    allowed = limits(rate=20.0)
    rest = np.zeros((allowed.time.size, 1))
    changed = signals.with_piece(allowed, rest, 0, slice(100, 140), 1.0)
    assert changed.max() == 4.0 and changed[0] == 0.0
    assert np.max(np.abs(np.diff(changed[:, 0]))) <= 20.0 * allowed.period + 1e-12


def test_a_machine_rests_at_zero():
    """Not in the middle of a recorded range that is no more than nearly symmetric."""
    assert Range("u", "V", -10.1, 8.8).rest == 0.0 and Range("u", "V", 1.0, 3.0).rest == 2.0
    allowed = limits(low=-10.1, high=8.8, safe=(Range("y", "m", -0.1, 0.1),))
    guard = Guard((driven("Cart"),), allowed.safe)
    guard = guard.with_room(allowed)
    calm = guard.kept_safe(np.full((allowed.time.size, 1), 8.8), allowed)
    assert calm is not None and 0.0 < calm.max() < 8.8
