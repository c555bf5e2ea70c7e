"""Lags that are short beside the model: named where the recordings tell their form."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from test_load_starts import _diagnosed, _warmed

from daest.diagnosis.built_in.dead_times import DELAY
from daest.diagnosis.built_in.late_signals import LAG, SECOND_ORDER
from daest.diagnosis.evidence.reasons import RATE_LIMIT, in_place_of_a_parameter, other_dynamics
from daest.diagnosis.refits.rivals import (
    leading_late,
    shortest_of,
    told_apart,
    told_as_second_order,
    told_from_second_order,
    with_likelier_lags,
)


@pytest.mark.slow  # the rule: the tests below
def test_short_lag_is_named_where_no_dead_time_comes_near(tmp_path: Path) -> None:
    """A thermometer 25 s late, in a tank of four minutes, had been "something dynamic, and fast"."""
    found = _diagnosed(tmp_path, _warmed(40.0, [2.0, 0.5, 3.0, 1.0], 300), "Lag", "Delay", "HeatLoss")
    law = found.proofs[0]
    assert found.verdict == "supported" and law.candidate.label == "Lag at P"
    (told,) = [p for p in law.told.parameters if p.name == f"{law.candidate.name}.T"]
    assert told.value == pytest.approx(40.0, abs=4.0 * told.std_error)


@dataclass(frozen=True)
class Refused:
    """What is asked of a proof here, of a lag or a dead time that is short beside the model."""

    law: str
    place: str
    log_likelihood: float
    is_any_dynamics: bool = True
    verdict: str = "rejected"
    reason: str = "it is short"
    equivalent: tuple[str, ...] = ()

    @property
    def candidate(self) -> SimpleNamespace:
        effect = SimpleNamespace(class_name=self.law)
        return SimpleNamespace(effect=effect, site=self.place, is_of_signal=True, is_dynamic=True)

    @property
    def places(self) -> frozenset[str]:
        return frozenset((self.place, *self.equivalent))

    @property
    def fit(self) -> SimpleNamespace:
        return SimpleNamespace(log_likelihood=self.log_likelihood)

    @property
    def delta_bic(self) -> float:
        return 2.0 * self.log_likelihood


@pytest.mark.parametrize(
    ("others", "is_asked"),
    [
        ((), True),
        ((Refused(DELAY, "y", 95.0),), True),  # of the same signal: asked in any case
        ((Refused(LAG, "u", 98.0),), False),  # as likely at another signal
        ((Refused(DELAY, "y", 105.0),), False),  # likelier
        ((Refused(LAG, "u", 105.0, is_any_dynamics=False),), True),
    ],
)
def test_the_likeliest_of_short_lags_is_asked_for(others, is_asked):
    lag = Refused(LAG, "y", 100.0)
    assert (shortest_of(LAG, [*others, lag]) is lag) == is_asked


def test_a_lag_that_the_sensors_see_alike_is_no_other_one():
    """A thermometer that is late behind a heater, and the command of the heater that is."""
    lag = Refused(LAG, "y", 100.0)
    assert shortest_of(LAG, [Refused(LAG, "u", 99.9, equivalent=("y",)), lag]) is lag
    alike = Refused(LAG, "y", 100.0, equivalent=("u",))
    assert shortest_of(LAG, [Refused(LAG, "u", 99.9), alike]) is alike
    assert shortest_of(LAG, [Refused(LAG, "z", 99.9), lag]) is None


@pytest.mark.parametrize(("dead_times", "is_told"), [((40.0, -3.0), True), ((60.0,), False), ((), False)])
def test_a_lag_is_told_where_dead_times_are_far_from_it(dead_times, is_told):
    lag = Refused(LAG, "y", 100.0)
    found = told_apart(lag, [Refused(DELAY, "y", gain) for gain in dead_times], 50.0)
    assert (found.verdict, found.reason == "", found.is_any_dynamics) == (
        ("supported", True, False) if is_told else ("rejected", False, True)
    )


def test_second_order_is_asked_beside_the_law_that_leads():
    """A constant torque behind a flexible part had been a limit of the rate of the input."""
    lag, dead_time, other = Refused(LAG, "u", 50.0), Refused(DELAY, "u", 60.0), Refused(LAG, "y", 90.0)
    limit = Refused(RATE_LIMIT, "u", 99.0, is_any_dynamics=False)
    assert leading_late(limit, [limit, lag, dead_time, other]) is dead_time
    assert leading_late(limit, [limit, other]) is None
    assert leading_late(lag, [lag, other]) is lag
    assert leading_late(Refused("Friction", "u", 99.0), [lag]) is None
    assert leading_late(None, [lag, dead_time]) is dead_time
    assert leading_late(None, [replace(lag, is_any_dynamics=False)]) is None


@pytest.mark.parametrize(
    ("second", "lag", "is_told"),
    [
        (60.0, 20.0, True),
        (60.0, None, True),  # no lag there paid for a refit
        (85.0, 20.0, False),  # a flexible part is nearly as likely
        (60.0, 55.0, False),
        (30.0, 40.0, False),  # the search of the second order has lost its way
        (None, 20.0, False),
    ],
)
def test_a_dead_time_is_told_where_lags_of_both_orders_are_far_from_it(second, lag, is_told):
    late = Refused(DELAY, "u", 100.0)
    seconds = [] if second is None else [Refused(SECOND_ORDER, "u", second)]
    others = [late] if lag is None else [late, Refused(LAG, "u", lag)]
    found = told_from_second_order(late, seconds, others)
    assert (found.verdict == "supported") == is_told and (found is late) == (not is_told)


def test_a_lag_and_a_dead_time_that_is_long_stay_what_they_are_beside_the_second_order():
    lag, long = Refused(LAG, "u", 100.0), Refused(DELAY, "u", 100.0, is_any_dynamics=False)
    second = [Refused(SECOND_ORDER, "u", 10.0)]
    assert told_from_second_order(lag, second, [lag]) is lag
    assert told_from_second_order(long, second, [long]) is long


@pytest.mark.parametrize(
    ("lag", "dead_time", "is_told"), [(40.0, 45.0, True), (60.0, 40.0, False), (40.0, None, False)]
)
def test_second_order_is_told_where_a_lag_and_a_dead_time_are_far_from_it(lag, dead_time, is_told):
    second = Refused(SECOND_ORDER, "u", 100.0)
    others = [Refused(LAG, "u", lag)] + ([] if dead_time is None else [Refused(DELAY, "u", dead_time)])
    assert (told_as_second_order(second, others).verdict == "supported") == is_told
    long = replace(second, is_any_dynamics=False)
    assert told_as_second_order(long, others) is long


@pytest.mark.parametrize(
    ("beside", "ratio", "is_dynamic", "is_refused"),
    [
        ((0.4, 1.3), 0.99, True, True),
        ((0.4, 1.3), 0.8, True, False),  # and yet unseen data are simulated better
        ((9.0, 0.8), 0.99, True, False),  # a store beside another
        ((9.0, 20.0), 0.99, True, False),  # as long as the other
        ((0.4, 1.3), 0.99, False, False),  # friction may do all that a damper did
    ],
)
def test_a_lag_that_does_what_a_parameter_did_is_none(beside, ratio, is_dynamic, is_refused):
    """The time constant of a catchment before its river: it moves in front of the store, which is then none,
    and where the rain is late the load comes at once."""
    lag = SimpleNamespace(name="lag", is_dynamic=is_dynamic, is_of_signal=True)
    before, told = (
        SimpleNamespace(parameters=tuple(SimpleNamespace(**one, unit="h") for one in parameters))
        for parameters in (
            [{"name": "K", "value": 16.9, "std_error": 1.8}],
            [
                {"name": "K", "value": beside[0], "std_error": beside[1]},
                {"name": "lag.T", "value": 15.6, "std_error": 3.7},
            ],
        )
    )
    reason = in_place_of_a_parameter(lag, told, before, (ratio,))
    assert ("it does what K did, which is 0.4 ± 1.3 h beside it and 16.9 ± 1.8 h" in reason) == is_refused
    assert bool(reason) == is_refused and in_place_of_a_parameter(lag, told, before, ()) == ""


@pytest.mark.parametrize(
    ("accepted", "is_told"),
    [(("y", 97.0), True), (("y", 103.0), False), (("u", 97.0), False)],
)
def test_a_short_lag_is_told_beside_a_less_likely_dead_time_of_its_signal(accepted, is_told):
    """A heater 20 s late beside a time constant of 170 s: the dead time was named, and the lag refused, since
    a dead time would do as well."""
    lag = Refused(LAG, "y", 100.0)
    late = Refused(DELAY, *accepted, is_any_dynamics=False, verdict="supported", reason="")
    found = with_likelier_lags([late, lag])
    assert found[0] is late and (found[1].verdict == "supported") == is_told


@pytest.mark.parametrize(
    ("rest", "ratios", "is_right"),
    [
        (4.0, (), True),
        (8.0, (), False),
        (8.0, (0.5, 0.9), False),
        (8.0, (0.5, 0.2), True),
        (12.0, (0.2,), False),
    ],
)
def test_a_lag_leaves_little_where_unseen_data_confirm_it(rest, ratios, is_right):
    left = SimpleNamespace(p_value=4e-3, log_likelihood_gain=rest, label="T")
    assert (other_dynamics(left, 100.0, ratios) == "") == is_right
