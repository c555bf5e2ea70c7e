"""Excel workbooks (.xlsx): the first sheet that holds anything, read like a CSV file."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

from daest.data.grid import Grid, grid_table
from daest.data.table import Part, Table, empty_file, unreadable_file
from daest.errors import DataError, Place


def read_excel(path: Path, _: Part) -> Table:
    """The table of a workbook. Raises DataError `data-needs-openpyxl`, `data-unreadable-file`,
    `data-empty-file`, and what `grid_table` raises."""
    try:
        import openpyxl
    except ImportError as error:
        raise DataError(
            "data-needs-openpyxl",
            "reading Excel files needs openpyxl, which is not installed",
            where=Place(str(path)),
            remedy="pip install 'daest[excel]', or save the recording as CSV",
        ) from error
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheets = [(sheet.title, list(sheet.iter_rows(values_only=True))) for sheet in book.worksheets]
        book.close()
    # A damaged archive makes the reader fail in many ways.
    except Exception as error:
        what = f"the Excel file cannot be read: {error}"
        raise unreadable_file(path, what, "save it again, or as CSV") from error
    for title, sheet in sheets:
        rows = [[_text(value) for value in row] for row in sheet]
        numbered = [(row, line) for line, row in enumerate(rows, 1) if any(row)]
        if numbered:
            notes = (f"sheet '{title}' of {len(sheets)}",) if len(sheets) > 1 else ()
            return grid_table(Grid([r for r, _ in numbered], [n for _, n in numbered], notes=notes), path)
    raise empty_file(path, "the workbook is empty")


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    return repr(value) if isinstance(value, float) else str(value).strip()
