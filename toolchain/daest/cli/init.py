"""`daest init`: a daest.toml for a model and a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from daest.cli.options import class_options, example, format_option, project_option
from daest.cli.output import emit, whole_file


@click.command("init", epilog=example("daest init Servo.mo run1.csv", "daest identify"))
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("data", nargs=-1, type=click.Path(path_type=Path))
@class_options
@project_option
@format_option
def command(
    model: Path,
    data: tuple[Path, ...],
    class_name: str | None,
    libraries: tuple[Path, ...],
    project_file: Path | None,
    form: str,
) -> None:
    """Write a commented daest.toml for MODEL and the recordings DATA.

    Columns are matched with inputs and outputs by name, or proposed by unit. An existing file is not touched.
    """
    from daest.cli.models import load_model
    from daest.data.match import match_columns
    from daest.data.project import FILE_NAME, Project
    from daest.data.read import Signal, read_table
    from daest.data.template import Draft, project_text

    file = project_file or Path(FILE_NAME)
    _refuse_existing(file)
    flat = load_model(Project(Path()), model, class_name, libraries)
    tables = [read_table(path) for path in data]
    inputs = [Signal(v.name, v.unit) for v in flat.inputs]
    outputs = [Signal(y.name, y.unit) for y in flat.outputs]
    matches = match_columns([*inputs, *outputs], tables[0]) if tables else []
    draft = Draft(
        flat,
        _relative(model, file),
        class_name,
        tuple(_relative(path, file) for path in libraries),
        tuple(_relative(path, file) for path in data),
        tuple(matches[: len(inputs)]),
        tuple(matches[len(inputs) :]),
        tuple(column.header for column in tables[0].columns) if tables else (),
    )
    with whole_file(file) as temporary:
        temporary.write_text(project_text(draft), encoding="utf-8")
    emit(_document(file, draft), "init", form, None, _text)


def _refuse_existing(file: Path) -> None:
    from daest.errors import ConfigError, Place

    if file.exists():
        raise ConfigError(
            "config-exists",
            "the file exists and is not overwritten",
            where=Place(str(file)),
            remedy="remove it, or write another one with -p FILE",
        )


def _relative(path: Path, file: Path) -> str:
    return Path(os.path.relpath(path.resolve(), file.resolve().parent)).as_posix()


def _document(file: Path, draft: Any) -> dict[str, Any]:
    return {
        "file": str(file),
        "model": draft.flat.name,
        "inputs": {match.signal.name: match.column for match in draft.inputs},
        "outputs": {match.signal.name: match.column for match in draft.outputs},
        "estimate": [p.name for p in draft.flat.parameters if p.estimate],
        "noises": [noise.name for noise in draft.flat.noises],
    }


def _text(document: Mapping[str, Any], width: int, color: bool) -> str:
    lines = [f"wrote {document['file']} for {document['model']}"]
    for kind in ("inputs", "outputs"):
        for name, column in document[kind].items():
            lines.append(f"  {kind[:-1]} {name}: {column or 'NO COLUMN FITS, please complete the file'}")
    lines.append(f"  estimated parameters: {', '.join(document['estimate']) or 'none marked'}")
    return "\n".join(lines) + "\n"
