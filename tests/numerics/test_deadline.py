"""Searches that end at a deadline, in this process and in others."""

import time

import numpy as np
import pytest

from daest.estimation.fitting.search import Evaluation, minimise
from daest.numerics.deadline import OutOfTimeError, check, left, until
from daest.numerics.parallel import workers


def test_nothing_ends_without_a_deadline_and_the_first_of_two_holds():
    check()
    assert left() is None
    now = time.monotonic()
    with until(now + 50.0), until(now + 100.0):
        assert left() <= 50.0
        check()
    assert left() is None


def test_search_ends_at_its_deadline():
    def slow(z, _):
        time.sleep(0.02)
        return Evaluation(float(z[0] ** 4), 4.0 * z**3, np.array([[1e3]]))

    with pytest.raises(OutOfTimeError), until(time.monotonic() + 0.1):
        minimise(slow, np.ones(1), np.array([-9.0]), np.array([9.0]), max_iterations=10**6)


@pytest.mark.parametrize(("jobs", "seconds"), [(1, 0.3), (2, 60.0)])
def test_tasks_of_which_the_time_is_up_are_given_up(jobs, seconds):
    began = time.monotonic()
    with workers(jobs) as pool, pytest.raises(OutOfTimeError), until(began + 1.0):
        list(pool.map(time.sleep, [seconds] * 9, seconds=100.0))
    assert time.monotonic() - began < 30.0
