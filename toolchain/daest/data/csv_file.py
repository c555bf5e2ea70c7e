"""CSV files as any tool writes them: separator, decimal mark, encoding, comments and header are found.

Large files of nothing but numbers are read by Arrow: only the columns and the times that are wanted.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from daest.data.grid import MISSING, Grid, cell_number, grid_table
from daest.data.table import Column, Part, Table, cut_unit, empty_file, time_column, unreadable_file
from daest.errors import DataError, Place
from daest.quantities import conversion

SPACES = " "  # any white space between cells
SEPARATORS = (",", ";", "\t", "|", SPACES)
COMMENTS = ("#", "%", "//")
ENCODINGS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}
LARGE = 1 << 20  # bytes from which on Arrow is worth loading
HEAD = 1 << 16  # bytes from which the look of a large file is told
ALL = Part()
_LOOKED_AT = 400  # lines, spread over the file, from which separator and decimal mark are told
_EXCEL = re.compile(r"sep=(.)\r?$")  # first line of a CSV file of Excel
_GAP = re.compile(r"\s+(?![\[(])")  # a unit in brackets belongs to the name before it


def read_csv(path: Path, part: Part = ALL) -> Table:
    """The table of a CSV file; of a large one of plain numbers only `part`.

    Cells are parted by , ; | tab or white space, whichever makes most of them numbers; a decimal comma is
    read where commas do not part cells. Lines that begin with # % or // are comments. The text is UTF-8,
    UTF-16 with a byte order mark, or else Windows-1252. Raises DataError `data-empty-file`, `data-encoding`,
    `data-unreadable-file`, and what `grid_table` raises.
    """
    if path.stat().st_size > LARGE:
        table = _large(path, part)
        if table is not None:
            return table
    return _table(*_decoded(path.read_bytes(), path), path)[0]


def _large(path: Path, part: Part) -> Table | None:
    """The table of a large file of plain numbers, told from its first lines; None where it is not plain."""
    with path.open("rb") as file:
        raw = file.read(HEAD)
    raw = raw[: raw.rfind(b"\n") + 1]
    if b'"' in raw or b"\0" in raw or b"\r" in raw.replace(b"\r\n", b""):
        return None
    try:
        head, separator, decimal = _table(raw.decode("utf-8-sig"), (), path)
    except (DataError, UnicodeDecodeError):
        return None
    if separator == SPACES or len(head.columns) != len(_cells(_line(raw, head), separator)):
        return None
    return read_numbers(path, head, separator, decimal, part)


def _line(raw: bytes, head: Table) -> str:
    """The first row of numbers."""
    assert head.lines is not None
    return raw.decode("utf-8-sig").splitlines()[int(head.lines[0]) - 1] if len(head.lines) else ""


def _table(text: str, notes: tuple[str, ...], path: Path) -> tuple[Table, str, str]:
    """The table of a text with its separator and decimal mark."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    excel = _EXCEL.match(lines[0])
    if excel:
        lines[0] = ""
    shown = [line for line in lines if line.strip() and not _is_comment(line)]
    if not shown:
        raise empty_file(path, "the file is empty")
    separator = excel[1] if excel else _separator(shown)
    decimal = _decimal(shown, separator)
    if decimal == ",":
        notes = (*notes, "numbers read with a decimal comma")
    try:
        rows, numbers = _rows(lines, separator)
    except csv.Error as error:
        remedy = "look for a quotation mark that is not closed, or save the recording again"
        raise unreadable_file(path, f"not a CSV file: {error}", remedy) from error
    if not rows:
        raise empty_file(path, "the file is empty")
    remarks = _remarks(lines, separator, numbers[0])
    return grid_table(Grid(rows, numbers, decimal, remarks, notes), path), separator, decimal


def _decoded(raw: bytes, path: Path) -> tuple[str, tuple[str, ...]]:
    encoding = next((name for mark, name in ENCODINGS.items() if raw.startswith(mark)), "utf-8")
    notes: tuple[str, ...] = ()
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding == "utf-16" or b"\0" in raw:
            raise _not_text(path, raw, error) from error
        try:
            text = raw.decode("cp1252")
        except UnicodeDecodeError as other:
            raise _not_text(path, raw, other) from other
        notes = ("the text is not UTF-8; read as Windows-1252",)
    if "\0" in text:
        raise _not_text(path, raw, None)
    if not text.strip():
        raise empty_file(path, "the file is empty")
    return text, notes


def _not_text(path: Path, raw: bytes, error: UnicodeDecodeError | None) -> DataError:
    at = error.start if error is not None else max(raw.find(b"\0"), 0)
    return DataError(
        "data-encoding",
        f"byte {raw[at]:#04x} is not UTF-8 text",
        where=Place(str(path), raw.count(b"\n", 0, at) + 1),
        remedy="save the file as UTF-8",
    )


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS)


def _cells(line: str, separator: str) -> list[str]:
    """One line as cells; a cell of several lines is not looked at here."""
    if separator == SPACES:
        return _GAP.split(line.strip())
    if '"' in line:
        with suppress(csv.Error):  # such as a cell of more than 131072 characters
            return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return line.split(separator)


def _separator(lines: list[str]) -> str:
    """The separator with which the largest share of the cells are numbers; in doubt the one that the first
    line uses most."""
    sample = lines[:: max(1, len(lines) // _LOOKED_AT)]
    scores = {}
    for separator in SEPARATORS:
        rows = [_cells(line, separator) for line in sample]
        scores[separator] = max(_score(rows, decimal) for decimal in (".", ","))
    best = max(SEPARATORS, key=lambda separator: scores[separator])
    if scores[best] > 0:
        return best
    return max(SEPARATORS[:-1], key=lines[0].count)


def _score(rows: list[list[str]], decimal: str) -> float:
    """Share of the written cells in rows of two or more cells that are numbers, over all rows."""
    wide = [row for row in rows if len(row) > 1]
    cells = [cell.strip() for row in wide for cell in row if cell.strip()]
    numbers = sum(cell_number(cell, decimal) is not None for cell in cells)
    return len(wide) / len(rows) * numbers / len(cells) if cells else 0.0


def _decimal(lines: list[str], separator: str) -> str:
    """The comma where some numbers have one and none has a point. Where it parts the cells, too, it stands
    between quotes: in most lines, with other than three digits behind it, or it is a slip or parts thousands.
    """
    if not any("," in line and (separator != "," or '"' in line) for line in lines):
        return "."
    cells = [cell.strip() for line in lines for cell in _cells(line, separator)]
    commas = [cell for cell in cells if "," in cell and cell_number(cell, ",") is not None]
    points = sum("." in cell and cell_number(cell, ".") is not None for cell in cells)
    if separator == "," and (
        2 * sum('"' in line for line in lines[1:]) < len(lines)
        or all(len(cell.rpartition(",")[2]) == 3 for cell in commas)
    ):
        return "."
    return "," if commas and not points else "."


def _rows(lines: list[str], separator: str) -> tuple[list[list[str]], list[int]]:
    """Rows with anything in them, and the line where each ends."""
    if separator == SPACES:
        found = [(_GAP.split(line.strip()), n) for n, line in enumerate(_shown(lines), 1)]
    else:
        reader = csv.reader(_shown(lines), delimiter=separator, skipinitialspace=True)
        found = [(row, reader.line_num) for row in reader]
    kept = [(row, n) for row, n in found if any(cell.strip() for cell in row)]
    return [row for row, _ in kept], [n for _, n in kept]


def _shown(lines: list[str]) -> Iterator[str]:
    """The lines with comments blank, so that they keep their numbers."""
    for line in lines:
        yield "\n" if _is_comment(line) else f"{line}\n"


def _remarks(lines: list[str], separator: str, first: int) -> list[tuple[list[str], int]]:
    """Comment lines above line `first`, without their mark, as cells."""
    found = []
    for number, line in enumerate(lines[: first - 1], 1):
        if _is_comment(line):
            found.append((_cells(line.lstrip(" \t#%/"), separator), number))
    return found


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
