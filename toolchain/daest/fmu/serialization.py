"""FlatModel <-> two files: its words as JSON, its expressions as a serialized CasADi function.

The expressions come back as the same sequence of operations, so that everything computed from them is equal
to the bit. A file from elsewhere is checked (size, alphabet, hash, kind, shapes) before and after CasADi
reads it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca

from daest.errors import FmuError, Place
from daest.model.flat import FlatModel
from daest.model.parts import DerivedParameter, Equation, NoiseInput, Output, Parameter, Variable

_TABLES = (
    "unknowns",
    "inputs",
    "noises",
    "parameters",
    "outputs",
    "equations",
    "initial_equations",
    "derived_parameters",
)


def portable(flat: FlatModel) -> FlatModel:
    """The same model with places such as `Servo.mo:12` and `Daest/Blocks/Gain.mo:7`.

    An FMU is handed on, and the folders of the machine that wrote it are nobody's business; nor should they
    make two FMUs of the same model differ.
    """
    short = cache(portable_file)
    tables: dict[str, Any] = {
        name: tuple(_with_short_place(item, short) for item in getattr(flat, name)) for name in _TABLES
    }
    return dataclasses.replace(flat, source=short(flat.source) if flat.source else "", **tables)


def portable_file(file: str) -> str:
    """A file of a Modelica library from its library's folder on; any other by its name alone."""
    path = Path(file)
    top = path.parent
    while (top / "package.mo").is_file() and top != top.parent:
        top = top.parent
    return path.relative_to(top).as_posix()


def _with_short_place(item: Any, short: Callable[[str], str]) -> Any:
    if item.place is None:
        return item
    place: Place = item.place
    return dataclasses.replace(item, place=dataclasses.replace(place, file=short(place.file)))


FOLDER = "extra/org.daest.symbolic-model"
WORDS = "flat.json"
EXPRESSIONS = "flat.casadi"
SCHEMA = "daest/flat-model/1"

# A model of 10 000 equations takes some 20 MB; beyond this a file is not ours.
LARGEST_FILE = 256 * 1024 * 1024
# CasADi writes every byte as two letters a … p; these eight are its check number.
HEADER = "jhpnnagi"
_ALPHABET = re.compile(r"[a-p]*")

_ARGUMENTS = ("derivatives", "xi", "u", "w", "theta", "time")
_RESULTS = ("residual", "output_expressions", "initial_residual", "derived_values")
_LISTS: dict[str, type] = {
    "unknowns": Variable,
    "inputs": Variable,
    "noises": NoiseInput,
    "parameters": Parameter,
    "outputs": Output,
    "equations": Equation,
    "initial_equations": Equation,
    "derived_parameters": DerivedParameter,
}


def serialize(flat: FlatModel) -> dict[str, str]:
    """The files (name -> text) that `deserialize` turns back into `flat`."""
    function = ca.Function(
        "flat",
        [getattr(flat, a) for a in _ARGUMENTS],
        [getattr(flat, r) for r in _RESULTS],
        list(_ARGUMENTS),
        list(_RESULTS),
    )
    expressions = function.serialize()
    words: dict[str, Any] = {
        "schema": SCHEMA,
        "name": flat.name,
        "description": flat.description,
        "source": flat.source,
        "sha256": hashlib.sha256(expressions.encode()).hexdigest(),
    }
    for key in _LISTS:
        words[key] = [_sparse_dict(item) for item in getattr(flat, key)]
    return {WORDS: json.dumps(words, ensure_ascii=False, indent=1), EXPRESSIONS: expressions}


def _sparse_dict(item: Any) -> dict[str, Any]:
    """The fields of a frozen dataclass that differ from their defaults."""
    given: dict[str, Any] = {}
    for field in dataclasses.fields(item):
        value = getattr(item, field.name)
        if value != field.default or field.default is dataclasses.MISSING:
            given[field.name] = dataclasses.asdict(value) if isinstance(value, Place) else value
    return given


def deserialize(files: Mapping[str, str], where: str) -> FlatModel:
    """The FlatModel that `serialize` wrote. `where` names the archive in messages.

    Errors: FmuError `symbolic-model-damaged` if the files do not belong together or are not ours.
    """
    try:
        words = json.loads(files[WORDS])
        function = _read_function(files[EXPRESSIONS], words.get("sha256"), where)
        if words.get("schema") != SCHEMA:
            raise _damaged(where, f"schema is {words.get('schema')!r}, expected {SCHEMA!r}")
        arguments = function.sx_in()
        expressions: dict[str, Any] = dict(zip(_ARGUMENTS, arguments, strict=True))
        expressions |= zip(_RESULTS, function.call(arguments), strict=True)
        lists: dict[str, Any] = {
            key: tuple(_item(kind, entry) for entry in words[key]) for key, kind in _LISTS.items()
        }
        return FlatModel(
            name=words["name"],
            description=words["description"],
            source=words["source"],
            **lists,
            **expressions,
        )
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError, RecursionError) as problem:
        raise _damaged(where, str(problem).splitlines()[0] if str(problem) else repr(problem)) from problem


def _read_function(text: str, expected_hash: str | None, where: str) -> ca.Function:
    """The serialized function, after the checks that keep CasADi's reader from running into foreign bytes."""
    if len(text) > LARGEST_FILE:
        raise _damaged(where, f"{EXPRESSIONS} is larger than {LARGEST_FILE} bytes")
    if not text.startswith(HEADER) or not _ALPHABET.fullmatch(text):
        raise _damaged(where, f"{EXPRESSIONS} is not a serialized CasADi function")
    if hashlib.sha256(text.encode()).hexdigest() != expected_hash:
        raise _damaged(where, f"{EXPRESSIONS} was changed after it was written")
    function = ca.Function.deserialize(text)
    if function.is_null() or not function.is_a("SXFunction"):
        raise _damaged(where, f"{EXPRESSIONS} holds something other than plain expressions")
    if tuple(function.name_in()) != _ARGUMENTS or tuple(function.name_out()) != _RESULTS:
        raise _damaged(where, f"{EXPRESSIONS} has other arguments than expected")
    return function


def _item(kind: type, entry: dict[str, Any]) -> Any:
    place = entry.get("place")
    return kind(**{**entry, "place": Place(**place) if place is not None else None})


def _damaged(where: str, why: str) -> FmuError:
    return FmuError(
        "symbolic-model-damaged",
        f"The symbolic model inside the FMU cannot be read: {why}.",
        where=where,
        remedy="Export the FMU again, or use its binary alone: `--source fmi-ls-dae`.",
    )
