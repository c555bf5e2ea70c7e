"""A share of another signal in a reading, which jumps with that signal or is none."""

from types import SimpleNamespace

import pytest

from daest.diagnosis.evidence.reasons import is_absent_at_once


def fit(value, std_error):
    return SimpleNamespace(parameters=[SimpleNamespace(name="law.k", value=value, std_error=std_error)])


def candidate(kind="output", inputs=("q",), n_states=0):
    return SimpleNamespace(
        name="law",
        site=SimpleNamespace(kind=kind),
        inputs={name: name for name in inputs},
        effect=SimpleNamespace(n_states=n_states),
    )


def test_a_share_that_loads_leave_nothing_of_is_a_store_that_follows_later():
    assert is_absent_at_once(candidate(), fit(5.5, 2.8), fit(110.0, 18.0))


@pytest.mark.parametrize(
    ("beside", "told"),
    [
        (fit(105.0, 2.8), fit(110.0, 18.0)),  # the same
        (fit(5.5, 60.0), fit(110.0, 18.0)),  # a signal that hardly jumps
        (fit(5.5, None), fit(110.0, 18.0)),  # one that nothing is known of
        (fit(60.0, 2.8), fit(110.0, 5.0)),  # some of it
    ],
)
def test_a_share_that_loads_leave_or_do_not_know_is_one(beside, told):
    assert not is_absent_at_once(candidate(), beside, told)


@pytest.mark.parametrize("other", [{"kind": "input"}, {"inputs": ()}, {"n_states": 1}])
def test_what_acts_on_a_store_or_is_one_may_be_taken_by_loads(other):
    assert not is_absent_at_once(candidate(**other), fit(5.5, 2.8), fit(110.0, 18.0))
