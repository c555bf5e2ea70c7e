"""Turn the cells of a spreadsheet or CSV file into a table: find the header, a row of units and the numbers.

Some tools write extra lines above the header, a row of units below it, or one separator too many at the end
of a row. The notes of the table name everything that was skipped.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daest.data.table import Column, Table, duplicate_columns, raise_collected, split_header
from daest.errors import DataError, Place
from daest.quantities import converts, is_known_unit, is_unit_expression

MISSING = frozenset({"na", "n/a", "#n/a", "nan", "-nan", "null", "none", "-", "--", "---", "<na>"})
_BRACKETS = {"[": "]", "(": ")"}


@dataclass(frozen=True)
class Grid:
    """Rows of cells that hold anything, and the line of the file where each stands. `remarks` are comment
    lines above the first row, split like it: some tools write their header so. `separator` parts the cells;
    `decimal` is the decimal mark."""

    rows: Sequence[Sequence[str]]
    lines: Sequence[int]
    decimal: str = "."
    remarks: Sequence[tuple[Sequence[str], int]] = ()
    notes: tuple[str, ...] = ()


def grid_table(grid: Grid, path: Path) -> Table:
    """The table of a grid with at least one row.

    The header is the last row above the numbers that is no row of units. Raises DataError `data-no-header`,
    `data-ragged-row`, `data-duplicate-column`, `data-unit-twice`, all problems of the rows at once.
    """
    rows = [[cell.strip() for cell in row] for row in grid.rows]
    lines = list(grid.lines)
    width = Counter(len(row) for row in rows).most_common(1)[0][0]
    first = _first_numbers(rows, width, grid.decimal)
    if first == 0:
        header, header_line = _header_in_remarks(grid, width, path, lines[0])
        units, skipped = None, 0
    else:
        at = first - 2 if _has_units(rows, first, width) else first - 1
        header, header_line, skipped = rows[at], lines[at], at
        units = rows[first - 1] if at == first - 2 else None
    body, body_lines = rows[first:], np.array(lines[first:], dtype=int)
    header, body = _without_last_separator(header, body)
    _check_widths(body, body_lines, len(header), path)
    columns = _columns(header, units, body, grid.decimal, Place(str(path), header_line))
    table = Table(str(path), columns, body_lines, header_line, (*grid.notes, *_notes(skipped, units)))
    raise_collected(duplicate_columns(table), str(path))
    return table


def cell_number(cell: str, decimal: str = ".") -> float | None:
    """The number of a cell with the decimal mark `decimal`, NaN for a missing one, None for a text."""
    if not cell or cell.lower() in MISSING:
        return np.nan
    if "_" in cell or (decimal == "," and "." in cell):
        return None  # 1_000 is Python's spelling of a number, not that of a recording
    try:
        return float(cell.replace(",", ".", 1) if decimal == "," else cell)
    except ValueError:
        return None


def _is_written(cell: str, decimal: str) -> bool:
    """Whether the cell holds a number (not an empty cell or a word for a missing one)."""
    return cell_number(cell, decimal) is not None and cell.strip().lower() not in MISSING and cell != ""


def _first_numbers(rows: list[list[str]], width: int, decimal: str) -> int:
    """Index of the first row of numbers: more than half of its cells, or the first one and an end above it.

    The first row is one only if it holds nothing else; 1 where no row looks like numbers.
    """
    if all(cell_number(cell, decimal) is not None for cell in rows[0]):
        return 0
    for index, row in enumerate(rows[1:], start=1):
        known = [cell for cell in row if cell]
        numbers = sum(cell_number(cell, decimal) is not None for cell in known)
        if len(row) == width and known and (2 * numbers > len(known) or _is_written(row[0], decimal)):
            return index
    return 1


def _has_units(rows: list[list[str]], first: int, width: int) -> bool:
    """Whether the row above the numbers holds units and the one above that a name for every cell; one of
    time says that what it measures is the time.

    Oscilloscopes write `,CH1,CH2` above `Second,Volt,Volt`, and end rows of numbers alone with a separator.
    """
    if first < 2:
        return False
    names, units = rows[first - 2 : first]
    if all(len(row) == width and row[-1] == "" for row in rows[first:]):
        width -= 1
        names, units = (row[:width] if row[width:] == [""] else row for row in (names, units))
    if len(names) != width or len(units) != width:
        return False
    if not all(names[: width - 1]) and not (all(names[1:]) and _is_of_time(units[0])):
        return False
    cells = [cell for cell in units if cell and cell != "-"]
    if not cells or not all(is_unit_expression(_bare(cell)) for cell in cells):
        return False
    known = sum(_bare(cell) != cell or is_known_unit(cell) for cell in cells)
    return 2 * known > len(cells)


def _is_of_time(cell: str) -> bool:
    """Whether a cell of the row of units holds one of time."""
    return is_unit_expression(_bare(cell)) and converts(_bare(cell), "s")


def _bare(cell: str) -> str:
    """A unit without its brackets."""
    closing = _BRACKETS.get(cell[:1])
    return cell[1:-1].strip() if closing and cell.endswith(closing) else cell


def _header_in_remarks(grid: Grid, width: int, path: Path, line: int) -> tuple[list[str], int]:
    for cells, at in reversed(grid.remarks):
        names = [cell.strip() for cell in cells]
        if len(names) == width and all(names) and not any(_is_written(n, grid.decimal) for n in names):
            return names, at
    raise DataError(
        "data-no-header",
        "the first row holds numbers, not names",
        where=Place(str(path), line),
        remedy="add a header row such as: time,u,omega [rad/s]",
    )


def _without_last_separator(header: list[str], body: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """Without a last column that has neither name nor values: a separator ends every row."""
    width = len(header) if header[-1] == "" and len(header) > 1 else len(header) + 1
    if body and all(len(row) == width and row[-1] == "" for row in body):
        return header[: width - 1], [row[:-1] for row in body]
    return header, body


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


def _columns(
    header: list[str], units: list[str] | None, body: list[list[str]], decimal: str, place: Place
) -> tuple[Column, ...]:
    cells = list(zip(*body, strict=True)) if body else [()] * len(header)
    problems: list[DataError] = []
    columns = []
    for index, text in enumerate(header):
        name, unit = split_header(text)
        below = _bare(units[index]) if units is not None and index < len(units) else ""
        if below and below != "-":
            if unit is not None and unit != below:
                problems.append(_unit_twice(name, unit, below, place))
            unit = below
            name = name or ("time" if converts(unit, "s") else "")
        columns.append(_column(name, unit, cells[index], decimal, index + 1))
    raise_collected(problems, place.file)
    return tuple(columns)


def _unit_twice(name: str, unit: str, below: str, place: Place) -> DataError:
    return DataError(
        "data-unit-twice",
        f"the header gives '{name}' the unit '{unit}', the row below it '{below}'",
        where=place,
        remedy="keep one of them",
    )


def _column(name: str, unit: str | None, cells: tuple[str, ...], decimal: str, position: int) -> Column:
    if decimal == ".":
        try:
            values = np.array(cells, dtype=float)
            if not any("_" in cell for cell in cells):
                return Column(name, unit, values, (), position)
        except ValueError:
            pass  # a missing value or a text: look at every cell
    numbers = [cell_number(cell, decimal) for cell in cells]
    values = np.array([np.nan if number is None else number for number in numbers], dtype=float)
    texts = tuple((row, cells[row]) for row, number in enumerate(numbers) if number is None)
    return Column(name, unit, values, texts, position)


def _notes(skipped: int, units: list[str] | None) -> tuple[str, ...]:
    above = (f"{skipped} line(s) above the header passed over",) if skipped else ()
    below = ("units taken from the row below the header",) if units is not None else ()
    return (*above, *below)
