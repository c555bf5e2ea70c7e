"""CSV files: one header row, then numbers; an empty cell is a missing value."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from daest.data.problems import raise_collected
from daest.data.table import Column, Table, duplicate_columns, split_header
from daest.errors import DataError, Place

_SEPARATORS = (",", ";", "\t")


def read_csv(path: Path) -> Table:
    """The table of a CSV file. The separator is the one of , ; or tab that the header uses most.

    Raises DataError: `data-empty-file`, `data-encoding`, `data-no-header`, `data-ragged-row`,
    `data-duplicate-column`, all problems of the rows at once.
    """
    text = _decoded(path)
    header_text = text.split("\n", 1)[0]
    separator = max(_SEPARATORS, key=header_text.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True)
    rows, lines = [], []
    for row in reader:
        if row and any(cell.strip() for cell in row):
            rows.append(row)
            lines.append(reader.line_num)
    header = [cell.strip() for cell in rows[0]]
    _check_header(header, path)
    body, body_lines = rows[1:], np.array(lines[1:], dtype=int)
    _check_widths(body, body_lines, len(header), path)
    cells = list(zip(*body, strict=True)) if body else [()] * len(header)
    columns = tuple(_column(i, header[i], cells[i]) for i in range(len(header)))
    table = Table(str(path), columns, body_lines)
    raise_collected(duplicate_columns(table), str(path))
    return table


def _decoded(path: Path) -> str:
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise DataError(
            "data-encoding",
            f"byte {raw[error.start]:#04x} is not UTF-8 text",
            where=Place(str(path), line),
            remedy="save the file as UTF-8",
        ) from error
    if not text.strip():
        raise DataError(
            "data-empty-file",
            "the file is empty",
            where=Place(str(path)),
            remedy="a recording needs a header row and at least two rows of numbers",
        )
    return text


def _check_header(header: list[str], path: Path) -> None:
    if all(_number(cell) is not None for cell in header):
        raise DataError(
            "data-no-header",
            "the first row holds numbers, not names",
            where=Place(str(path), 1),
            remedy="add a header row such as: time,u,omega [rad/s]",
        )


def _check_widths(rows: list[list[str]], lines: np.ndarray, width: int, path: Path) -> None:
    problems = [
        DataError(
            "data-ragged-row",
            f"{len(row)} cells where the header has {width}",
            where=Place(str(path), int(line)),
            remedy="write every row with as many cells as the header (an empty cell is a missing value)",
        )
        for row, line in zip(rows, lines, strict=True)
        if len(row) != width
    ]
    raise_collected(problems, str(path))


def _column(index: int, header: str, cells: tuple[str, ...]) -> Column:
    name, unit = split_header(header)
    try:
        return Column(name, unit, np.array(cells, dtype=float), (), index + 1)
    except ValueError:
        pass  # a missing value or a text: look at every cell
    numbers = [_number(cell) for cell in cells]
    values = np.array([np.nan if number is None else number for number in numbers], dtype=float)
    texts = tuple(
        (row, cell.strip())
        for row, (cell, number) in enumerate(zip(cells, numbers, strict=True))
        if number is None and cell.strip()
    )
    return Column(name, unit, values, texts, index + 1)


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
