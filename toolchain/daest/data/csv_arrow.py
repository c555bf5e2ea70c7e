"""Large CSV files of nothing but numbers, by Arrow: only the columns and the times that are wanted.

What a file looks like is told from its first lines as for any other (`csv_file`). The rest must then be rows
of as many numbers; where it is not, the file is read cell by cell, which finds what is wrong and where.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from daest.data.grid import MISSING
from daest.data.table import Column, Part, Table, cut_unit, time_column
from daest.quantities import conversion

BLOCK = 1 << 20  # bytes that are read at a time
# Relative to the times: rows this close to an end of the window are read, and judged by whoever cuts exactly.
WINDOW_SLACK = 1e-6


def read_numbers(path: Path, head: Table, separator: str, decimal: str, part: Part) -> Table | None:
    """The table of which `head` holds the first rows; None where a line is anything but a row of numbers.

    Rows outside of the times of `part` are left out, and those after them are not looked at; a window that is
    next to empty, or times that do not increase, are given whole, so that it can be told.
    """
    import pyarrow as pa

    if head.lines is None or len(head.columns) < 2 or any(column.texts for column in _chosen(head, part)):
        return None
    try:
        table, is_told = _read(path, head, separator, decimal, part)
        if not is_told:
            table, _ = _read(path, head, separator, decimal, replace(part, start=None, stop=None))
    except pa.ArrowInvalid:
        return None
    clock = time_column(table, part.time)
    return None if clock is not None and np.isnan(clock.values).any() else table  # rows without anything


def _read(path: Path, head: Table, separator: str, decimal: str, part: Part) -> tuple[Table, bool]:
    """The part of the table, and whether the window has rows whose times increase."""
    assert head.lines is not None
    chosen = _chosen(head, part)
    clock = time_column(head, part.time)
    window = _Window(part, clock, chosen)
    reader = _reader(_body(path, int(head.lines[0])), head, chosen, separator, decimal)
    columns = _columns(chosen, list(window.cut(map(_numbers, reader))))
    first = int(head.lines[0]) + window.n_before
    lines = range(first, first + columns[0].values.size)
    unread = tuple(c.name for c in head.columns if c.position not in {c.position for c in chosen})
    return replace(head, columns=columns, lines=lines, unread=unread), window.is_told(len(lines))


def _reader(body: Any, head: Table, chosen: list[Column], separator: str, decimal: str) -> Any:
    """Record batches of the chosen columns."""
    import pyarrow as pa
    from pyarrow import csv

    names = [f"f{i}" for i in range(len(head.columns))]
    missing = ["", *(form(word) for word in sorted(MISSING) for form in (str, str.upper, str.title))]
    return csv.open_csv(
        body,
        csv.ReadOptions(block_size=BLOCK, column_names=names),
        csv.ParseOptions(delimiter=separator, quote_char=False, ignore_empty_lines=False),
        csv.ConvertOptions(
            column_types=dict.fromkeys(names, pa.float64()),
            include_columns=[f"f{column.position - 1}" for column in chosen],
            null_values=missing,
            decimal_point=decimal,
        ),
    )


def _chosen(head: Table, part: Part) -> list[Column]:
    """The columns to read, with that of the time."""
    clock = time_column(head, part.time)
    if part.names is None or clock is None:
        return list(head.columns)
    wanted = (clock, *map(head.find, part.names))
    positions = {column.position for column in wanted if column is not None}
    return [column for column in head.columns if column.position in positions]


def _body(path: Path, first: int) -> Any:
    """The bytes from line `first` on, without the white space at their end."""
    import pyarrow as pa

    with pa.memory_map(str(path)) as file:
        whole = file.read_buffer(os.path.getsize(path))
    view = memoryview(whole)
    begin, end = 0, len(view)
    with path.open("rb") as lines:
        for _ in range(first - 1):
            begin += len(lines.readline())
    while end > begin and view[end - 1] in b" \t\r\n":
        end -= 1
    return pa.BufferReader(whole.slice(begin, end - begin))


def _numbers(batch: Any) -> np.ndarray:
    """A record batch as (n_columns, n_rows), NaN where a cell is missing."""
    return np.stack([_array(column) for column in batch.columns])


def _array(column: Any) -> np.ndarray:
    """From the buffer, because Arrow's own way loads pandas where there is one."""
    if column.null_count:
        from pyarrow import compute

        column = compute.fill_null(column, np.nan)
    values = np.frombuffer(column.buffers()[1], dtype=np.float64)
    return values[column.offset : column.offset + len(column)]


class _Window:
    """Cuts blocks (n_columns, n_rows) to the times of `part`; `n_before` rows have been left out before."""

    def __init__(self, part: Part, clock: Column | None, chosen: list[Column]) -> None:
        self.start = -np.inf if part.start is None else part.start
        self.stop = np.inf if part.stop is None else part.stop
        self.row = None if clock is None else [c.position for c in chosen].index(clock.position)
        unit = (
            None if clock is None else cut_unit(replace(clock, unit=part.units.get(clock.name, clock.unit)))
        )
        self.seconds = None if unit is None else conversion(unit, "s")
        self.n_before = 0
        self.has_order = True

    def is_told(self, n_rows: int) -> bool:
        is_open = self.start == -np.inf and self.stop == np.inf
        return is_open or (self.has_order and n_rows > 1)

    def cut(self, blocks: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
        for block in blocks:
            if self.row is None or self.seconds is None:
                yield block
                continue
            time = self.seconds(block[self.row])
            self.has_order = self.has_order and not np.any(np.diff(time) <= 0)
            slack = WINDOW_SLACK * float(np.nanmax(np.abs(time), initial=0.0))
            early, late = time < self.start - slack, time > self.stop + slack
            self.n_before += int(early.sum())
            yield block[:, ~(early | late)]
            if late.any():
                return


def _columns(chosen: list[Column], blocks: list[np.ndarray]) -> tuple[Column, ...]:
    """The columns of all blocks, one after another: each is held twice only while it is put together."""
    values = []
    for row in range(len(chosen)):
        values.append(np.concatenate([block[row] for block in blocks]))
    return tuple(replace(column, values=v, texts=()) for column, v in zip(chosen, values, strict=True))
