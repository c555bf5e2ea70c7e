"""Modelica source to `FlatModel`: the public face of this room."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from daest.model.flat import FlatModel
from daest.modelica.assemble import assemble
from daest.modelica.change import declare, with_values
from daest.modelica.compiler import Job, compile_source, with_room
from daest.modelica.library import library_roots
from daest.modelica.select import select_class
from daest.modelica.source import read_source

__all__ = ["compile_model", "declare", "with_values"]


def compile_model(
    path: str | Path,
    class_name: str | None = None,
    libraries: Sequence[str | Path] = (),
    overrides: Mapping[str, float] | None = None,
) -> FlatModel:
    """The equation list of a Modelica model.

    `class_name` may be left out when the file holds one model that is not partial. `libraries` are folders that
    contain libraries; MODELICAPATH and the bundled library are searched after them. `overrides` are parameter
    values; an Integer, Boolean or structural one compiles the model again. Raises ModelError.
    """
    path = Path(path)
    text = read_source(path)
    job = Job(path, text, select_class(text, path, class_name), library_roots(libraries))
    flat = with_room(lambda: assemble(compile_source(job), str(path)))
    return with_values(flat, overrides) if overrides else flat
