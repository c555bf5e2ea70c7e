"""Entries that several documents share."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from functools import cache
from types import UnionType
from typing import (
    Annotated,
    Any,
    NotRequired,
    TypedDict,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np

from daest.model.fit import Agreement, FittedParameter
from daest.model.linear import RankDecision
from daest.model.parts import Equation
from daest.numerics.ranks import warning

ByOutput = dict[str, float | None]
Entry = TypeVar("Entry")


class EquationEntry(TypedDict):
    index: Annotated[int, "row of E, counted from 0"]
    text: str
    kind: NotRequired[Annotated[str, "component, connection, flow, unconnected or binding"]]
    origin: str
    place: Annotated[str | None, "file:line"]


class Decision(TypedDict):
    what: str
    singular_values: list[float]
    threshold: float
    rank: int
    gap: float | None
    warning: str | None


class ByPart(TypedDict):
    estimation: ByOutput
    validation: NotRequired[ByOutput]


class Errors(TypedDict):
    fit_percent: ByPart
    rms: ByPart


class ModelName(TypedDict):
    name: str
    source: str


class Searched(TypedDict):
    effects: list[str]
    places: list[str]


class MadeOf(TypedDict):
    """What a diagnosis was made of."""

    model: NotRequired[ModelName]
    data: NotRequired[list[str]]
    validated_on: NotRequired[list[str]]
    outputs: NotRequired[Annotated[dict[str, str], "units"]]
    searched: NotRequired[Searched]
    notes: NotRequired[list[str]]


class Uncertain(TypedDict):
    value: float
    std_error: float | None
    unit: str


def entry(kind: type[Entry], value: object, **others: object) -> Entry:
    """A result as the typed dictionary `kind` spells it: every key is one of `others`, or the field of
    `value` that has its name; a key that is neither is left out. Values inside are spelt by their types, a
    number that JSON has no word for is None.

    Example: `entry(ProfileEntry, profile)`.
    """
    found = {}
    for name, hint in _hints(cast(Hashable, kind)).items():
        if name in others or hasattr(value, name):
            found[name] = _spelt(hint, others[name] if name in others else getattr(value, name))
    return cast(Entry, found)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _spelt(hint: Any, value: Any) -> Any:
    """A value as JSON has it, by the type of its key."""
    origin, inner = get_origin(hint), get_args(hint)
    if value is None:
        return None
    if origin in (Union, UnionType):
        return _spelt(next(one for one in inner if one is not type(None)), value)
    if is_typeddict(hint):
        return value if isinstance(value, dict) else entry(hint, value)
    if origin is list:
        return [_spelt(inner[0], one) for one in value]
    if origin is dict:
        return {key: _spelt(inner[1], one) for key, one in value.items()}
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def equation_entry(index: int, equation: Equation) -> EquationEntry:
    """`index` counts from 0, as the rows of E do; `place` is `file:line`, None where it is not known."""
    place = equation.place
    where = None if place is None else f"{place.file}:{place.line}" if place.line is not None else place.file
    return {
        "index": index,
        "text": equation.text,
        "kind": equation.kind,
        "origin": equation.origin,
        "place": where,
    }


def decision_entry(decision: RankDecision) -> Decision:
    """A rank decision; `gap` is None where nothing but zeros was dropped, `warning` None where it is
    clear."""
    return {
        "what": decision.what,
        "singular_values": list(decision.singular_values),
        "threshold": decision.threshold,
        "rank": decision.rank,
        "gap": decision.gap if math.isfinite(decision.gap) else None,
        "warning": warning(decision) or None,
    }


def errors_entry(parts: Mapping[str, Agreement]) -> Errors:
    """Agreement with the data for estimation and, where there are any, with those for validation."""
    estimation, validation = parts["estimation"], parts.get("validation")
    errors: Errors = {
        "fit_percent": {"estimation": dict(estimation.fit_percent)},
        "rms": {"estimation": dict(estimation.rms)},
    }
    if validation is not None:
        errors["fit_percent"]["validation"] = dict(validation.fit_percent)
        errors["rms"]["validation"] = dict(validation.rms)
    return errors


def uncertain_entry(parameter: FittedParameter) -> Uncertain:
    return {"value": parameter.value, "std_error": parameter.std_error, "unit": parameter.unit}
