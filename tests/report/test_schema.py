"""Schemas that are made from typed dictionaries."""

from __future__ import annotations

import doctest
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import pytest
from jsonschema import Draft202012Validator

from daest.report.documents import parts
from daest.report.schema import document_schema

_Reserved = TypedDict("_Reserved", {"class": str})


class Leaf(_Reserved):
    value: Annotated[float | None, "in V"]
    side: NotRequired[Literal["left", "right"] | None]


class Tree(TypedDict):
    """Things that grow.

    More about them.
    """

    leaves: dict[str, Leaf]
    first: Leaf | None
    matrix: list[list[float]] | Leaf
    branches: NotRequired[list[Tree]]
    rest: NotRequired[dict[str, Any]]


GOOD = {
    "schema": "daest/tree/1",
    "leaves": {"a": {"class": "L", "value": 1.5, "side": "left"}},
    "first": None,
    "matrix": [[1.0, 2]],
}
LEAF = {"class": "L", "value": None}


def accepts(document: dict) -> bool:
    schema = document_schema("tree", Tree)
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema).is_valid(document)


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"first": LEAF},
        {"first": {**LEAF, "side": None}},
        {"matrix": LEAF},
        {"branches": [GOOD], "rest": {"anything": [1, "two"]}},
        {"more": "keys may be added"},
    ],
)
def test_accepts(change):
    assert accepts({**GOOD, **change})


@pytest.mark.parametrize(
    "change",
    [
        {"schema": "daest/tree/2"},
        {"leaves": [LEAF]},
        {"leaves": {"a": {"value": 1.0}}},
        {"first": {**LEAF, "value": "1.0"}},
        {"first": {**LEAF, "side": "middle"}},
        {"matrix": [1.0]},
        {"branches": [{**GOOD, "matrix": None}]},
        {"rest": []},
    ],
)
def test_refuses(change):
    assert not accepts({**GOOD, **change})


@pytest.mark.parametrize("key", ["schema", "leaves", "first", "matrix"])
def test_refuses_without(key):
    assert not accepts({k: v for k, v in GOOD.items() if k != key})


def test_words_for_the_reader():
    schema = document_schema("tree", Tree)
    assert (schema["$id"], schema["title"]) == ("daest/tree/1", "Things that grow")
    assert schema["$defs"]["Leaf"]["properties"]["value"]["description"] == "in V"


class Branch:
    class Leaf(TypedDict):
        value: int


class Bush(TypedDict):
    a: Leaf
    b: Branch.Leaf


class Wave(TypedDict):
    amplitude: complex


def test_no_two_dictionaries_of_one_name():
    with pytest.raises(TypeError, match="Leaf"):
        document_schema("bush", Bush)


def test_what_has_no_json_form_is_refused():
    with pytest.raises(TypeError, match="complex"):
        document_schema("wave", Wave)


class Fallen(TypedDict):
    height: Annotated[float | None, parts.Fact("from {} m", 2)]
    speed: NotRequired[Annotated[float, "in m/s", parts.Fact("at {} m/s")]]
    color: str


@pytest.mark.parametrize(
    ("document", "told"),
    [
        ({"height": 1.234, "speed": 4.9, "color": "red"}, ["from 1.2 m", "at 4.9 m/s"]),
        ({"height": None, "color": "red"}, ["from - m"]),
    ],
)
def test_facts_are_told_by_their_marks(document, told):
    assert parts.facts(Fallen, document) == told


def test_example_of_an_entry():
    assert doctest.testmod(parts) == (0, 3)
