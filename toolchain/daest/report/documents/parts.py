"""Entries that several documents share."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from types import UnionType
from typing import (
    TYPE_CHECKING,
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

from daest.model.linear import RankDecision
from daest.model.parts import Equation
from daest.numerics.ranks import warning
from daest.report.console import number

if TYPE_CHECKING:
    from daest.model.fit import Agreement

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


@dataclass(frozen=True)
class Of:
    """Marks a key whose field has another name: `Annotated[float, Of("std")]`, or `Of("effect.name")` for the
    name of the effect of a value."""

    path: str


@dataclass(frozen=True)
class Fact:
    """Marks a number that the text and the page tell: `Annotated[float, Fact("{} s", 3)]`, with so many
    digits."""

    words: str
    digits: int = 4


def facts(kind: type, document: Mapping[str, Any]) -> list[str]:
    """What the marks `Fact` of a typed dictionary tell of a document of it; nothing of keys that it lacks."""
    told = []
    for key, _, hint, *_ in _keys(cast(Hashable, kind)):
        for mark in getattr(hint, "__metadata__", ()):
            if isinstance(mark, Fact) and key in document:
                told.append(mark.words.format(number(document[key], mark.digits)))
    return told


def entry(kind: type[Entry], value: object, /, **others: object) -> Entry:
    """A result as the typed dictionary `kind` spells it: every key is one of `others`, or the field of
    `value` that has its name or that its `Of` names. A key that is not required is left out where it is
    neither, or where it is None and may not be null.

    Values inside are spelt by their types: a dictionary of values that have names is keyed by the names, and
    a number that JSON has no word for is None. Raises AttributeError where a required key has no field.

    Example:

        >>> from daest.model.diagnosis import Ahead
        >>> from daest.report.documents.diagnose import AheadEntry
        >>> entry(AheadEntry, Ahead(10, 0.1, 0.5, 3.2), certainty=float("nan"))
        {'seconds': 0.1, 'samples': 10, 'ratio': 0.5, 'certainty': None}
    """
    found = {}
    for name, path, hint, is_required, is_nullable in _keys(cast(Hashable, kind)):
        if name not in others and not is_required and not hasattr(value, path[0]):
            continue
        own = others[name] if name in others else reduce(getattr, path, value)
        if own is not None or is_required or is_nullable:
            found[name] = _spelt(hint, own)
    return cast(Entry, found)


@cache
def _keys(kind: Any) -> list[tuple[str, list[str], Any, bool, bool]]:
    """Of each key its name, the way to its field, its type, whether it must be there, and whether it may be
    null."""
    keys = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        is_required = get_origin(hint) is not NotRequired
        inner = hint if is_required else get_args(hint)[0]
        bare, *marks = get_args(inner) if get_origin(inner) is Annotated else (inner,)
        path = next((mark.path for mark in marks if isinstance(mark, Of)), name)
        keys.append((name, path.split("."), inner, is_required, type(None) in get_args(bare)))
    return keys


def _spelt(hint: Any, value: Any) -> Any:
    """A value as JSON has it, by the type of its key."""
    origin, inner = get_origin(hint), get_args(hint)
    if value is None:
        return None
    if origin is Annotated:
        return _spelt(inner[0], value)
    if origin in (Union, UnionType):
        kinds = [one for one in inner if one is not type(None)]
        if isinstance(value, dict):  # beside a list, as the entries of a large matrix beside its rows
            kinds = [one for one in kinds if is_typeddict(one) or get_origin(one) is dict]
        return _spelt(kinds[0], value)
    if isinstance(value, np.ndarray):
        known = np.isfinite(value)
        if known.all():
            return value.tolist()
        spelt = value.astype(object)
        spelt[~known] = None
        return spelt.tolist()
    if is_typeddict(hint):
        return entry(hint, None, **value) if isinstance(value, dict) else entry(hint, value)
    if origin is list:
        return [_spelt(inner[0], one) for one in value]
    if origin is dict:
        pairs = value.items() if isinstance(value, Mapping) else ((one.name, one) for one in value)
        return {key: _spelt(inner[1], one) for key, one in pairs}
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def equation_entry(index: int, equation: Equation) -> EquationEntry:
    """`index` counts from 0, as the rows of E do; `place` is `file:line`, None where it is not known."""
    place = equation.place
    where = None if place is None else f"{place.file}:{place.line}" if place.line is not None else place.file
    return entry(EquationEntry, equation, index=index, place=where)


def decision_entry(decision: RankDecision) -> Decision:
    """A rank decision; `gap` is None where nothing but zeros was dropped, `warning` None where it is
    clear."""
    return entry(Decision, decision, warning=warning(decision) or None)


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
