"""What is told beside a verdict of parameters that went far."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from daest.diagnosis.answers.told_beside import far_off_told
from daest.model.fit import FittedParameter
from daest.model.parts import Parameter

CAPACITY = Parameter("C2", 40.0, unit="F", min=0.0, scale="log", estimate=True)
OFFSET = Parameter("b", -2.0, unit="V", estimate=True)


def fit(name: str, value: float, std_error: float | None) -> Any:
    one = FittedParameter(name, value, std_error, value, "F", None, None, None)
    return SimpleNamespace(parameters=(one,))


def told(fitted: Any, declared: Parameter, law: Any = None, verdict: str = "supported") -> str:
    proofs = () if law is None else (SimpleNamespace(verdict=verdict, told=law),)
    return far_off_told(cast(Any, SimpleNamespace(proofs=proofs, baseline=fitted)), [declared])


@pytest.mark.parametrize(
    ("value", "std_error", "is_told"),
    [
        (6.7e4, 9e5, True),
        (90.0, 1.0, False),
        (1e-6, 1e-7, True),
        (1e-6, 30.0, False),  # hardly known: it may be the given one
        (-0.2, 0.1, True),  # where no machine is
    ],
)
def test_parameters_that_go_far_from_what_the_model_gives(
    value: float, std_error: float, is_told: bool
) -> None:
    text = told(fit("C2", value, std_error), CAPACITY)
    assert (f"C2 = {value:.4g} ± {std_error:.2g} F instead of 40 F" in text) is is_told
    assert bool(text) is is_told


@pytest.mark.parametrize(
    ("value", "std_error", "unit", "is_told"),
    [
        (101.0, 3.0, "V", True),  # a physical constant seldom changes its sign
        (101.0, 60.0, "V", False),
        (101.0, None, "V", False),
        (-101.0, 3.0, "V", False),  # without limits it may be of any size
        (101.0, 3.0, "degC", False),
    ],
)
def test_parameters_without_limits_are_far_where_their_sign_has_turned(
    value: float, std_error: float | None, unit: str, is_told: bool
) -> None:
    text = told(fit("b", value, std_error), replace(OFFSET, unit=unit))
    assert ("b = 101 ± 3 F instead of -2 F" in text) is is_told
    assert bool(text) is is_told


@pytest.mark.parametrize("verdict", ["supported", "not separable"])
def test_the_fit_of_the_law_that_is_named_is_looked_at(verdict: str) -> None:
    far, near = fit("C2", 6.7e4, 9.0), fit("C2", 41.0, 1.0)
    assert told(far, CAPACITY, near, verdict) == ""
    assert "instead of 40 F" in told(near, CAPACITY, far, verdict)
    assert told(near, CAPACITY, far, "rejected") == ""
