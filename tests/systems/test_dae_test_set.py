"""Problems of the public Test Set for IVP Solvers: values at the end, whatever the tolerance and the output
points."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

ORACLES = Path(__file__).parents[2] / "benchmarks" / "oracles"
sys.path.insert(0, str(ORACLES))

from dae_problems import problems  # noqa: E402
from dae_test_set import POINTS, RTOLS, Case  # noqa: E402

import daest  # noqa: E402
from daest.systems.reduction.reduce import reduce_index  # noqa: E402

EVERY = problems()
QUICK = [
    ("VanDerPol", 1e-8, 11),
    ("Orego", 1e-8, 11),
    ("Robertson", 1e-6, 11),
    *(
        pytest.param(*case, marks=pytest.mark.slow)
        for case in (("CarAxis", 1e-6, 11), ("SliderCrank", 1e-6, 401))
    ),
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


@pytest.mark.parametrize("fixed", ["xl xr vxl vxr", "xl yr vxl vyr"])
def test_states_are_chosen_where_the_model_is_not_at_zeros(tmp_path, fixed):
    """The springs of the car axis have no start: at length zero their forces are no numbers, and at the
    start the length of the axle does not change with its height."""
    text = (ORACLES / "models" / "CarAxis.mo").read_text()
    for name in fixed.split():
        text = re.sub(rf"\b{name}\(start = ([-0-9.]+)\)", rf"{name}(start = \1, fixed = true)", text)
    path = tmp_path / "CarAxis.mo"
    path.write_text(text)
    explicit = reduce_index(daest.compile_model(path))
    assert explicit.state_names == ("yl", "yr", "vyl", "vyr")
