"""Problems of the public Test Set for IVP Solvers: values at the end, whatever the tolerance and the output
points."""

import sys
from pathlib import Path

import numpy as np
import pytest

ORACLES = Path(__file__).parents[2] / "benchmarks" / "oracles"
sys.path.insert(0, str(ORACLES))

from dae_problems import problems  # noqa: E402
from dae_test_set import POINTS, RTOLS, Case  # noqa: E402

EVERY = problems()
QUICK = [
    ("VanDerPol", 1e-8, 11),
    ("Orego", 1e-8, 11),
    ("Robertson", 1e-6, 11),
    ("CarAxis", 1e-6, 11),
    ("SliderCrank", 1e-6, 2001),
]


def _is_right(case, rtol, points):
    error, _ = case.daest(rtol, points)
    assert error <= case.problem.tolerance, f"{case.problem.model}: {error:.3g} times rtol {rtol:g}"


@pytest.mark.parametrize("name, rtol, points", QUICK)
def test_the_end_value_is_right(name, rtol, points):
    _is_right(Case(EVERY[name]), rtol, points)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(EVERY))
def test_the_end_value_is_right_at_every_tolerance(name):
    case = Case(EVERY[name])
    for rtol in RTOLS:
        for points in POINTS:
            _is_right(case, rtol, points)


def test_output_points_do_not_decide_how_far_a_simulation_comes():
    case = Case(EVERY["Orego"])
    ends = [case.daest(1e-8, points)[0] for points in (2, 11, 401)]
    assert np.ptp(ends) < 30.0
