"""Lines of a stream: of stdin, or of a file that grows."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from daest.cli.output import note
from daest.cli.streams import is_closed
from daest.errors import ConfigError, DataError, Place
from daest.files import why_no_file

MOST_CHARACTERS = 1 << 20  # of one line; more comes in pieces, which are no samples
POLL = 0.02  # seconds between two looks at a file that may have grown
STDIN = "stdin"


def source_name(path: Path | None) -> str:
    """What messages call the stream."""
    return STDIN if path is None or str(path) == "-" else str(path)


def lines_of(path: Path | None, idle: float | None) -> Iterator[tuple[int, str]]:
    """Numbered lines without their ends; empty ones and comments are left out.

    `path` None or `-`: stdin, to its end. A file: also what is written to it later, until nothing has come
    for `idle` seconds (None: for ever). Raises DataError `data-missing-file`, ConfigError `stream-closed`.
    """
    raw = _of_stdin() if path is None or str(path) == "-" else _of_file(path, idle)
    for number, line in enumerate(raw, 1):
        text = line.decode("utf-8", errors="replace").strip("\r\n\ufeff")
        if text.strip() and not text.lstrip().startswith("#"):
            yield number, text


def _of_stdin() -> Iterator[bytes]:
    if sys.stdin is None or is_closed(sys.stdin):
        raise ConfigError(
            "stream-closed",
            "stdin is closed",
            remedy="pipe the samples into daest, or name a file that grows",
        )
    stream = getattr(sys.stdin, "buffer", None)
    if stream is None:  # a text stream in place of stdin
        for line in sys.stdin:
            yield line.encode()
        return
    while line := stream.readline(MOST_CHARACTERS + 2):
        yield line


def _of_file(path: Path, idle: float | None) -> Iterator[bytes]:
    if (why := why_no_file(path)) is not None:
        raise DataError(
            "data-missing-file",
            f"the recording {why}",
            where=Place(str(path)),
            remedy="check the path; it counts from the current folder",
        )
    with path.open("rb") as stream:
        yield from _grown(stream, path, idle)


def _grown(stream: IO[bytes], path: Path, idle: float | None) -> Iterator[bytes]:
    """Whole lines as they are completed; a file that became shorter is read anew."""
    begun, last = b"", time.monotonic()
    while True:
        piece = stream.readline(MOST_CHARACTERS + 2)
        if piece:
            begun, last = begun + piece, time.monotonic()
            if begun.endswith(b"\n") or len(begun) > MOST_CHARACTERS:
                yield begun
                begun = b""
            continue
        if idle is not None and time.monotonic() - last > idle:
            if begun:
                yield begun
            return
        if path.exists() and path.stat().st_size < stream.tell():
            note(f"{path} became shorter: it is read from its begin")
            stream.seek(0)
            begun = b""
        time.sleep(POLL)
