"""Searches that would stop on their way, started where they need not."""

from types import SimpleNamespace

import pytest

from daest.diagnosis.built_in.settled import _is_led_away
from daest.diagnosis.refits.dynamic_fits import _with_simplest


def law(name, site, n_states):
    candidate = SimpleNamespace(
        name=name, site=site, is_of_signal=True, effect=SimpleNamespace(n_states=n_states)
    )
    return SimpleNamespace(trial=SimpleNamespace(candidate=candidate, alike=()))


def test_beside_a_dead_time_the_lag_of_the_same_signal_is_tried():
    lag, other, delay = law("lag", "i", 1), law("lag", "V", 1), law("delay", "i", 10)
    assert _with_simplest([delay], [delay, other, lag]) == [delay, lag]
    assert _with_simplest([delay, lag], [delay, lag, other]) == [delay, lag]
    assert _with_simplest([lag, other], [lag, other, delay]) == [lag, other]


@pytest.mark.parametrize(("inertia", "is_lost"), [(1e-4, False), (7e-2, True), (-1.0, False)])
def test_white_loads_that_lead_a_parameter_far_away_are_noticed(inertia, is_lost):
    white = SimpleNamespace(theta={"J": inertia, "load.T": 1.0})
    beside = SimpleNamespace(theta={"J": 1.1e-4, "load.T": 1e6})
    assert _is_led_away(white, beside, ["J"]) == is_lost
