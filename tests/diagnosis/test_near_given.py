"""Laws near the given values of a model whose parameters are driven off by what it lacks."""

from dataclasses import is_dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from daest.diagnosis.evidence import near_given
from daest.diagnosis.evidence.near_given import fit_near_given
from daest.diagnosis.evidence.proof import Reference
from daest.diagnosis.null_model import null as null_module
from daest.diagnosis.null_model.null import are_driven_off
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.refits import course as course_module
from daest.diagnosis.refits.course import Course
from daest.errors import EstimationError
from daest.model.parts import Parameter

GIVEN = {"m": 0.35, "b": -2.0, "x0": 0.0}
LAWS = ("spring", "friction")


@pytest.mark.parametrize(
    ("found", "is_off"),
    [
        ({"m": 0.5, "b": -3.0, "x0": 8.0, "load.T": 1e9}, False),
        ({"m": 74.0, "b": -2.0}, True),
        ({"m": 0.01, "b": -2.0}, True),
        ({"m": 0.35, "b": 1.0}, True),  # of the other sign
    ],
)
def test_parameters_are_driven_off_by_their_ratio_to_the_given_values(found: Any, is_off: bool) -> None:
    assert are_driven_off(found, GIVEN) is is_off


def null(limits: Any) -> Any:
    # The values of the null are those of its fit, not the given ones.
    parameters = (
        Parameter("m", 74.0, min=limits[0], max=limits[1], scale="log", estimate=True),
        Parameter("b", -9.0, estimate=True),
        Parameter("x0", 4.0, estimate=True),
        Parameter("g", 9.81),
    )
    flat = Parameters(parameters)
    return SimpleNamespace(
        flat=flat, estimated=("m", "b", "x0"), experiments=(), hold="zoh", shortest_times={"load.T": 0.1}
    )


class Parameters:
    """A model, as far as its parameters go."""

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters


@pytest.mark.parametrize(
    ("limits", "wanted"), [((None, None), (0.35 / 3.0, 1.05)), ((0.2, 0.5), (0.2, 0.5)), ((0.0, 9.0), None)]
)
def test_model_is_fitted_within_three_times_the_given_values(
    monkeypatch: Any, limits: Any, wanted: Any
) -> None:
    monkeypatch.setattr(near_given, "replace", lambda one, **parts: _replaced(one, parts))
    monkeypatch.setattr(near_given, "identify", lambda flat, _, options: (flat, options))
    flat, options = cast(Any, fit_near_given(null(limits), GIVEN))
    known = {p.name: p for p in flat.parameters}
    assert (known["m"].min, known["m"].max) == pytest.approx(wanted or (0.35 / 3.0, 1.05))
    assert known["m"].value == 0.35 and known["g"].value == 9.81
    assert (known["b"].min, known["b"].max) == pytest.approx((-6.0, -2.0 / 3.0))
    assert known["x0"].min is None and known["x0"].max is None
    assert options.start == GIVEN and options.fix == {"load.T": 0.1} and options.method == "oe"


def _replaced(one: Any, parts: Any) -> Any:
    return replace(one, **parts) if is_dataclass(one) else Parameters(**parts)


def test_model_that_cannot_be_simulated_near_the_given_values_has_no_fit(monkeypatch: Any) -> None:
    def fails(*_: Any) -> Any:
        raise EstimationError("identify-no-start", "It runs empty.", remedy="Give other values.")

    monkeypatch.setattr(near_given, "replace", lambda one, **parts: _replaced(one, parts))
    monkeypatch.setattr(near_given, "identify", fails)
    assert fit_near_given(null((None, None)), GIVEN) is None


def proof(name: str, verdict: str = "rejected") -> Any:
    return SimpleNamespace(candidate=SimpleNamespace(name=name, label=name), verdict=verdict)


@pytest.mark.parametrize(
    ("found", "is_open", "leaves_most", "wanted"),
    [
        (74.0, True, False, ["spring: near", "friction: near"]),
        (74.0, False, True, ["spring: near", "friction: near"]),
        (74.0, False, False, None),  # a law is accepted that is enough
        (0.5, True, True, None),  # the parameters are near the given ones
    ],
)
def test_leaders_near_the_given_values_are_simulated_from_there(
    monkeypatch: Any, found: float, is_open: bool, leaves_most: bool, wanted: Any
) -> None:
    fit = cast(Any, SimpleNamespace(theta={"m": found}))
    near = cast(Any, SimpleNamespace(theta={"m": 0.4}, name="near"))
    parameters = (Parameter("m", 0.35, estimate=True), Parameter("g", 9.81))
    stand = Stand(SimpleNamespace(parameters=parameters), SimpleNamespace(estimated=("m",)), fit)
    leaders = [SimpleNamespace(candidate=proof(name).candidate) for name in LAWS]
    asked: list[str] = []

    class Stages:
        def shown_by_leaders(self, begun: Any, trials: Any, others: Any) -> Any:
            # The refit of the spring from where the model was driven off to is none of the others.
            assert [p.candidate.name for p in others] == ["lag"]
            asked.extend(f"{one.candidate.label}: {begun.reference.start_in_use.name}" for one in trials)
            return [*others, proof("spring", "supported")]

    monkeypatch.setattr(course_module, "fit_near_given", lambda *_: near)
    monkeypatch.setattr(course_module, "open_screen", lambda *_: "screen")
    monkeypatch.setattr(course_module, "_leaders_in_use", lambda *_: leaders)
    monkeypatch.setattr(course_module, "is_same", lambda one, other: one.candidate.label == other.label)
    monkeypatch.setattr(course_module, "replace", lambda one, **parts: _with(one, parts))
    monkeypatch.setattr(Course, "_stages", lambda *_: Stages())
    monkeypatch.setattr(Course, "_is_open", lambda *_: is_open)
    monkeypatch.setattr(Course, "_leaves_most", lambda *_: leaves_most)
    nothing = cast(Any, None)
    course = Course(
        cast(Any, stand), nothing, nothing, cast(Any, (None, "used")), (), (), DiagnoseOptions(), nothing,
        nothing, nothing,
    )  # fmt: skip
    before = [proof("lag"), proof("spring")]
    after = course._with_leaders_near_given(cast(Any, before))
    if wanted is None:
        assert after is before and not asked
        return
    assert asked == wanted
    assert [(p.candidate.name, p.verdict) for p in after] == [("lag", "rejected"), ("spring", "supported")]


class Stand:
    """What is examined, as far as this asks for it."""

    def __init__(self, declared: Any, null: Any, fit: Any, opened: Any = None) -> None:
        self.declared, self.null, self.fit = declared, null, fit
        self.reference = Reference(fit, cast(Any, ()), simulated=cast(Any, "errors"), opened=opened)


def _with(one: Any, parts: Any) -> Any:
    if isinstance(one, Stand):
        return Stand(one.declared, one.null, one.fit, parts["reference"].opened)
    return Reference(one.fit, one.foreseen, simulated=one.simulated, opened=parts["opened"])


@pytest.mark.parametrize(
    ("beside", "alone", "values"),
    [
        ({"m": 40.0, "b": -2.0}, {"m": 0.4, "b": -2.1}, {"m": 0.4, "b": -2.1}),
        ({"m": 0.5, "b": -2.0}, {"m": 0.4, "b": -2.1}, {}),
        ({"m": 40.0, "b": -2.0}, {"m": 30.0, "b": -2.1}, {}),
    ],
)
def test_what_loads_drive_off_begins_again_where_the_model_alone_stays_near(
    monkeypatch: pytest.MonkeyPatch, beside: Any, alone: Any, values: Any
) -> None:
    """A pendulum on an arm, balanced: beside loads its arm had weighed a hundred times as much."""
    given = [SimpleNamespace(name=name, value=value, estimate=True) for name, value in GIVEN.items()]
    fit = SimpleNamespace(status="converged", theta=alone, parameters=())
    asked = []
    monkeypatch.setattr(null_module, "identify", lambda *_: asked.append(1) or fit)
    flat, loaded = SimpleNamespace(parameters=given), SimpleNamespace(theta=beside)
    simulated = null_module._Alone(cast(Any, flat), lambda hold: ((), hold))
    assert simulated.values_near("zoh", cast(Any, loaded)) == values
    assert simulated.values_near("zoh", cast(Any, loaded)) == values and len(asked) <= 1


def test_a_simulation_that_comes_to_no_end_is_not_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def fails(*_: Any) -> Any:
        asked.append("")
        raise EstimationError("identify-start", "no")

    monkeypatch.setattr(null_module, "identify", fails)
    flat = SimpleNamespace(parameters=[SimpleNamespace(name="m", value=1.0, estimate=True)])
    simulated = null_module._Alone(cast(Any, flat), lambda hold: ((), hold))
    loaded = cast(Any, SimpleNamespace(theta={"m": 40.0}))
    assert simulated.upright(("zoh",)) is None and simulated.values_near("zoh", loaded) == {}
    assert len(asked) == 1
