"""Recordings that are a part of another one."""

import numpy as np

from daest.data.repeated import repeated_findings, repeated_rows
from daest.model.experiment import Experiment


def recording(name, rows, start=0.0):
    time = start + 0.04 * np.arange(len(rows))
    return Experiment(name, time, rows[:, :1], rows[:, 1:], ("u",), ("y",))


def course(seed, n):
    """A motion and a rest, in the steps of a converter, some readings missing."""
    rng = np.random.default_rng(seed)
    rows = np.round(np.cumsum(rng.normal(size=(n, 2)), axis=0), 1)
    rows[n // 3 : n // 3 + 8] = [0.0, 1.2]
    rows[::7, 1] = np.nan
    return rows


def test_a_part_of_the_other_is_told_where_it_stands():
    whole = course(0, 600)
    parts = repeated_rows(whole[:300], whole[100:500])
    assert parts[:200].all() and not parts[200:].any()
    found = repeated_findings([recording("bank", whole[:300])], [recording("rudder", whole[100:], 4.0)])
    (name, finding) = found[0]
    assert len(found) == 1 and name == "rudder" and finding.count == 200 and finding.at == 4.0
    assert "200 of the 500 samples that validate in common with bank" in finding.sentence


def test_rest_and_another_run_are_nothing_in_common():
    first, second = course(1, 600), course(2, 600)
    assert not repeated_rows(first, second).any()
    assert not repeated_rows(first, np.tile([0.0, 1.2], (400, 1))).any()
    assert not repeated_rows(first[:10], first[:10]).any()
    parts = [recording(f"run ({part})", first) for part in ("estimation", "validation")]
    assert not repeated_findings(parts[:1], parts[1:])


def test_two_runs_that_hunt_between_the_steps_of_a_sensor_have_nothing_in_common():
    """A controlled motor, whose speed is told in steps of 9 rpm: the same orders of two values come again."""
    speeds = np.array([85.0, 94.0])
    runs = [np.random.default_rng(seed).integers(0, 2, 1500) for seed in (3, 4)]
    runs[1][700:760] = runs[0][200:260]
    first, second = (np.column_stack([np.full(1500, 100.0), speeds[run]]) for run in runs)
    assert not repeated_rows(first, second).any()
