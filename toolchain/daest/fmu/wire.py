"""Messages between daest and the process that runs an FMU: a JSON header and arrays of doubles.

Nothing that a message holds is executed, so that a process with foreign code in it can be listened to.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

_LENGTH = struct.Struct("<Q")
# A message beyond this is no answer to anything that daest asks: the sender writes rubbish.
LARGEST_HEADER = 64 * 1024**2
LARGEST_ARRAY = 8 * 1024**3


def write_message(
    stream: BinaryIO, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray] | None = None
) -> None:
    """Send a header and arrays, converted to doubles. Arrays of any shape."""
    tables = {name: np.ascontiguousarray(array, dtype=np.float64) for name, array in (arrays or {}).items()}
    shapes = {name: list(np.shape((arrays or {})[name])) for name in tables}
    text = json.dumps({"header": dict(header), "shapes": shapes}).encode()
    stream.write(_LENGTH.pack(len(text)) + text)
    for table in tables.values():
        stream.write(table.tobytes())
    stream.flush()


def read_message(stream: BinaryIO) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of the next message. Raises EOFError at the end, ValueError for rubbish. Arrays have
    the shapes that they were sent with."""
    (length,) = _LENGTH.unpack(_exactly(stream, _LENGTH.size))
    if length > LARGEST_HEADER:
        raise ValueError("the header of a message is too long")
    content = json.loads(_exactly(stream, length).decode())
    arrays = {}
    for name, shape in content["shapes"].items():
        size = 8
        for extent in shape:
            size *= int(extent)
        if not 0 <= size <= LARGEST_ARRAY:
            raise ValueError("an array of a message is too large")
        arrays[name] = np.frombuffer(_exactly(stream, size), dtype=np.float64).reshape(shape).copy()
    return content["header"], arrays


def _exactly(stream: BinaryIO, count: int) -> bytes:
    parts, left = [], count
    while left:
        part = stream.read(left)
        if not part:
            raise EOFError("the other side has gone")
        parts.append(part)
        left -= len(part)
    return b"".join(parts)
