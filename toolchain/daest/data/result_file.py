"""Result files of Modelica tools (Dymola, OpenModelica): a MATLAB file of version 4 with the matrices Aclass,
name, description, dataInfo, data_1 and data_2.

`dataInfo[0, i]` says in which `data_` matrix variable i stands, `dataInfo[1, i]` in which row, with a minus
where it is the negated one (an alias); matrix 1 holds constants, matrix 2 what changes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from daest.data.table import Column, Table, unreadable_file

_MATRICES = ("Aclass", "name", "description", "dataInfo", "data_2")
_CHANGING = 2
_UNIT = re.compile(r"\[([^\[\]|]*)(?:\|[^\[\]]*)?\](?!.*\[)")  # `[rad]`, `[rad|deg]` at the end


def is_result(content: Mapping[str, Any]) -> bool:
    """Whether the matrices of a MATLAB file are those of a Modelica tool."""
    return all(name in content for name in _MATRICES)


def result_table(content: Mapping[str, Any], path: Path) -> Table:
    """The changing variables of a result file, `time` first.

    Where an event stands in two rows, the later one is kept. Constants and parameters are left out. Raises
    DataError `data-unreadable-file`.
    """
    try:
        names, descriptions, info, data = _matrices(content)
        columns = _columns(names, descriptions, info, data)
    except (IndexError, ValueError, TypeError) as error:
        what = f"the result file is damaged: {error}"
        raise unreadable_file(path, what, "simulate again, or export the result as CSV") from error
    last_of_event = np.append(np.diff(columns[0].values) > 0, True)
    dropped = int((~last_of_event).sum())
    kept = tuple(Column(c.name, c.unit, c.values[last_of_event]) for c in columns)
    notes = (f"{dropped} row(s) at events left out, the later one kept",) if dropped else ()
    return Table(str(path), kept, None, notes=notes)


def _matrices(content: Mapping[str, Any]) -> tuple[list[str], list[str], np.ndarray, np.ndarray]:
    """Names and descriptions, dataInfo (4, n), and the changing data (n_rows of variables, n_times)."""
    transposed = "binTrans" in _texts(content["Aclass"], down=False)
    info, data = np.atleast_2d(content["dataInfo"]), np.atleast_2d(content[f"data_{_CHANGING}"])
    if not transposed:
        info, data = info.T, data.T
    names, descriptions = (_texts(content[key], down=transposed) for key in ("name", "description"))
    return names, descriptions, info.astype(int), data.astype(float)


def _texts(matrix: Any, *, down: bool) -> list[str]:
    """The rows of a matrix of characters, or its columns; scipy joins the characters of a row."""
    rows = [str(row) for row in np.atleast_1d(matrix)]
    if down:
        width = max(len(row) for row in rows)
        rows = ["".join(column) for column in zip(*(row.ljust(width) for row in rows), strict=True)]
    return [row.rstrip(" \0") for row in rows]


def _columns(names: list[str], descriptions: list[str], info: np.ndarray, data: np.ndarray) -> list[Column]:
    columns = [Column("time", "s", data[0])]
    for i, name in enumerate(names):
        matrix, row = info[0, i], info[1, i]
        if matrix != _CHANGING or name.lower() == "time" or abs(row) <= 1:
            continue
        unit = _UNIT.search(descriptions[i]) if i < len(descriptions) else None
        values = np.sign(row) * data[abs(row) - 1]
        columns.append(Column(name, unit[1].strip() if unit and unit[1].strip() else None, values))
    return columns
