"""Where results go: stdout or a file, as text or JSON; files whole or not at all."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from daest import files
from daest.cli.streams import is_closed, leave_stdout, say
from daest.errors import ConfigError, Place, printable

Document = dict[str, Any]
UNWRITABLE = "output-unwritable"
# Columns where nobody looks at a terminal (a pipe, a file, a test), so that output does not depend on it.
PIPE_WIDTH = 100
CHOOSE_FOLDER = "choose a folder that can be written, with -o"
LATEST = "fit.json"  # in the results folder: the fit that was made last
IMPROVED = "improve"  # in the results folder: the models that were extended, and
LEDGER = "ledger.json"  # what was added to them


def to_json(document: Mapping[str, Any]) -> str:
    """The document as JSON text: arrays as lists, NaN and infinities as null."""
    return _written(_plain(document), "") + "\n"


def with_schema(document: Mapping[str, Any], command: str) -> Document:
    """The document with `schema` first."""
    content = {key: value for key, value in document.items() if key != "schema"}
    return {"schema": f"daest/{command}/1", **content}


def emit(
    document: Mapping[str, Any], command: str, form: str, output: Path | None, as_text: Callable[..., str]
) -> None:
    """Write the result where and how it was asked for; a file that ends in .json gets JSON.

    `as_text(document, width=..., color=...)` renders the text form.
    """
    result = Result(document, command, as_text)
    to_file = output is not None and str(output) != "-"
    if form == "json" or (to_file and str(output).endswith(".json")):
        text = result.json()
    elif to_file:
        text = result.text(PIPE_WIDTH, False)
    else:
        text = result.text(_terminal_width(), _is_terminal())
    write_text(text, output)


@dataclass(frozen=True)
class Result:
    """What a command has found, in the forms in which it is told."""

    document: Mapping[str, Any]
    command: str
    as_text: Callable[..., str]

    def json(self) -> str:
        return to_json(with_schema(self.document, self.command))

    def text(self, width: int, color: bool) -> str:
        return self.as_text(self.document, width=width, color=color)


def write_text(text: str, output: Path | None) -> None:
    """Write to a file, or to stdout where `output` is None or `-`. A reader that has gone is no error."""
    if output is not None and str(output) != "-":
        with whole_file(output) as temporary:
            temporary.write_text(text, encoding="utf-8")
        return
    if is_closed(sys.stdout):
        note("stdout is closed: the result is not shown; files that were written are whole")
        return
    try:
        click.echo(text, nl=False, color=True)
        sys.stdout.flush()
    except BrokenPipeError:
        leave_stdout()
    except OSError as error:
        leave_stdout()
        raise _unwritable("stdout", error, "the result can go to a file, with -o") from error


@contextmanager
def telling(tell: Callable[[], None]) -> Iterator[None]:
    """`tell` the result when the block has kept it, and also where the block cannot write its files: that
    error comes after the result."""
    unwritten = None
    try:
        yield
    except ConfigError as problem:
        if problem.code != UNWRITABLE:
            raise
        unwritten = problem
    tell()
    if unwritten is not None:
        raise unwritten


@contextmanager
def whole_file(path: Path, remedy: str = CHOOSE_FOLDER) -> Iterator[Path]:
    """As `daest.files.whole_file`, in a folder that is made where it is missing. Raises ConfigError
    `output-unwritable` where nothing can be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with files.whole_file(path) as temporary:
            yield temporary
    except OSError as error:
        raise _unwritable(path, error, remedy) from error


def keep_inputs(output: Path | None, inputs: Iterable[Path | None]) -> None:
    """Refuse to write over a file that the command reads. Raises ConfigError `output-is-input`."""
    if output is None or str(output) == "-" or not os.path.exists(output):
        return
    for path in inputs:
        if path is not None and os.path.exists(path) and output.samefile(path):
            raise ConfigError(
                "output-is-input",
                "the result would overwrite a file that is read",
                where=Place(str(output)),
                remedy="give another name with -o",
            )


def note(text: str) -> None:
    """A remark for the reader, on stderr."""
    say(f"note: {printable(text)}")


def warn(code: str, text: str) -> None:
    """A doubt about the input that daest explain knows, on stderr."""
    say(f"warning[{code}]: {printable(text)}")


def _unwritable(path: Path | str, error: OSError, remedy: str) -> ConfigError:
    return ConfigError(
        UNWRITABLE,
        f"the result cannot be written: {error.strerror or error}",
        where=Place(str(path)),
        remedy=remedy,
    )


def _is_terminal() -> bool:
    return sys.stdout is not None and sys.stdout.isatty()


def _terminal_width() -> int:
    if not _is_terminal() and "COLUMNS" not in os.environ:
        return PIPE_WIDTH
    return shutil.get_terminal_size().columns


def _written(value: Any, margin: str) -> str:
    """JSON with one entry or one matrix row a line; the standard writer would give every number its own."""
    if isinstance(value, dict) and value:
        inner = margin + "  "
        pairs = (
            f"{inner}{json.dumps(k, ensure_ascii=False)}: {_written(v, inner)}" for k, v in value.items()
        )
        return "{\n" + ",\n".join(pairs) + f"\n{margin}}}"
    if isinstance(value, list) and any(isinstance(entry, list | dict) for entry in value):
        inner = margin + "  "
        return "[\n" + ",\n".join(inner + _written(v, inner) for v in value) + f"\n{margin}]"
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):  # NumPy arrays and scalars
        return _plain(value.tolist())
    if hasattr(value, "toarray"):
        return _plain(value.toarray())
    if isinstance(value, Iterable):
        return [_plain(entry) for entry in value]
    if isinstance(value, Path | os.PathLike):
        return str(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")
