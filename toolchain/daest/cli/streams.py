"""The standard streams of a command: some are closed, or lead to a full disk."""

from __future__ import annotations

import errno
import io
import os
import sys
import textwrap
from typing import Any

import click

STANDARD = (0, 1, 2)  # file descriptors of stdin, stdout, stderr
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # what a write meets that has no room


class _Forgiving(io.TextIOWrapper):
    """A stream whose text is lost where it cannot be written: what is said on stderr decides nothing."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError:
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError:
            return


class _Closed(io.StringIO):
    """Stands for a stream that was closed when the program began."""

    def write(self, text: str) -> int:
        return len(text)


NARROWEST = 20  # columns; a terminal that tells fewer is not believed


def say(text: str) -> None:
    """A message on stderr. On a terminal its lines end between words; in a pipe they are whole, for programs
    that look for something in them."""
    click.echo(fitted(text, _columns()) if sys.stderr.isatty() else text, err=True)


def fitted(text: str, width: int) -> str:
    """The text in lines of at most `width`, unless a word alone is longer; what goes on stands further in."""
    return "\n".join(part for line in text.split("\n") for part in _parts(line, width))


def _parts(line: str, width: int) -> list[str]:
    if len(line) <= width:
        return [line]
    margin = " " * (len(line) - len(line.lstrip()))
    further = f"{margin}  "
    return textwrap.wrap(
        line.strip(), width, initial_indent=margin, subsequent_indent=further,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def _columns() -> int:
    """Of the terminal behind stderr."""
    try:
        columns = int(os.environ["COLUMNS"]) if "COLUMNS" in os.environ else os.get_terminal_size(2).columns
    except (OSError, ValueError):
        columns = 80
    return max(columns, NARROWEST)


def prepare_streams() -> None:
    """Make sure that the three standard streams are there, so that no file of ours takes the number of one,
    and that stderr refuses nothing."""
    for descriptor in STANDARD:
        try:
            os.fstat(descriptor)
        except OSError:
            _take(descriptor)
    replaced: Any = sys.stdout  # None where it was closed, whatever its type says
    if replaced is None:
        sys.stdout = _Closed()
    replaced = sys.stderr
    if replaced is None:
        sys.stderr = _Closed()
    elif hasattr(replaced, "detach") and not isinstance(replaced, _Forgiving):
        encoding, errors = replaced.encoding, "backslashreplace"
        sys.stderr = _Forgiving(replaced.detach(), encoding=encoding, errors=errors, line_buffering=True)


def is_closed(stream: Any) -> bool:
    """Whether nobody reads the stream any more."""
    return stream is None or isinstance(stream, _Closed)


def leave_stdout() -> None:
    """Nothing more is written to stdout: its reader has gone (`| head`), or its disk is full. The interpreter
    must not complain at its end."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        return


def _take(descriptor: int) -> None:
    """Open the null device with this number."""
    opened = os.open(os.devnull, os.O_RDWR)
    if opened != descriptor:
        os.dup2(opened, descriptor)
        os.close(opened)
