"""Source places that mean something on another machine."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from daest.errors import Place
from daest.model.flat import FlatModel

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
