"""MATLAB files: every vector of one common length is a column; a scalar struct of vectors is looked into.

Result files of Modelica tools (Dymola, OpenModelica) are MATLAB files of version 4 with the matrices Aclass,
name, description, dataInfo, data_1 and data_2. `dataInfo[0, i]` says in which `data_` matrix variable i
stands, `dataInfo[1, i]` in which row, with a minus where it is the negated one (an alias); matrix 1 holds
constants, matrix 2 what changes.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from daest.data.table import Column, Part, Table, unreadable_file
from daest.errors import DataError, Place

_HDF5 = b"\x89HDF\r\n\x1a\n"  # a file of version 7.3 has it behind a header of 512 bytes
_HEADER = 512
_UNREADABLE = "the MATLAB file cannot be read"
_AS_V7 = "save it in MATLAB with: save(name, '-v7')"


def read_mat(path: Path, _: Part) -> Table:
    """The table of a MATLAB file of any version, or of a result of Dymola or OpenModelica.

    Raises DataError `data-unreadable-file`, `data-needs-h5py` or `data-empty-file`.
    """
    with path.open("rb") as file:
        head = file.read(_HEADER + len(_HDF5))
    content = None
    if head.startswith(_HDF5) or head[_HEADER:] == _HDF5:
        vectors = _hdf5_vectors(path)
    else:
        content = _content(path)
        if is_result(content):
            return result_table(content, path)
        vectors = _vectors(content)
    if not vectors:
        tables = {} if content is None else _matrices(content)
        instead = (
            f", but {', '.join(f'{name} ({n} x {m})' for name, (n, m) in tables.items())}" if tables else ""
        )
        example = next(iter(tables), "data")
        raise DataError(
            "data-empty-file",
            f"the MATLAB file holds no numeric vector{instead}",
            where=Place(str(path)),
            remedy=f"save vectors of equal length, one of them called time: time = {example}(:, 1); "
            f"u = {example}(:, 2); save(name, 'time', 'u')",
        )
    # Scalars and odd vectors of settings may stand beside the recording.
    length = Counter(vector.size for vector in vectors.values()).most_common(1)[0][0]
    columns = tuple(
        Column(name, None, vector.astype(float)) for name, vector in vectors.items() if vector.size == length
    )
    left_out = {
        name: f"it has {vector.size} values, where most have {length}"
        for name, vector in vectors.items()
        if vector.size != length
    }
    return Table(str(path), columns, None, left_out=left_out)


def _content(path: Path) -> dict[str, Any]:
    """The variables of a file up to version 7."""
    from scipy.io import loadmat

    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    # A damaged file makes the reader fail in many ways.
    except Exception as error:
        raise unreadable_file(path, f"{_UNREADABLE}: {error}", _AS_V7) from error
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _vectors(content: Mapping[str, Any]) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "fiub":
            found[name] = value
        elif hasattr(value, "_fieldnames"):
            found.update(_vectors({field: getattr(value, field) for field in value._fieldnames}))
    return found


def _matrices(content: Mapping[str, Any]) -> dict[str, tuple[int, int]]:
    """Rows and columns of numeric matrices."""
    return {
        name: (int(value.shape[0]), int(value.shape[1]))
        for name, value in content.items()
        if isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "fiub" and value.size
    }


def _hdf5_vectors(path: Path) -> dict[str, np.ndarray]:
    """The vectors of a file of version 7.3, which is HDF5; structs are groups there."""
    try:
        import h5py
    except ImportError as error:
        raise DataError(
            "data-needs-h5py",
            "reading MATLAB files of version 7.3 needs h5py, which is not installed",
            where=Place(str(path)),
            remedy="pip install 'daest[hdf5]', or save it in MATLAB with: save(name, '-v7')",
        ) from error
    found: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        # MATLAB keeps the targets of its references in #refs#; empty arrays are marked.
        if not isinstance(item, h5py.Dataset) or name.startswith("#") or "MATLAB_empty" in item.attrs:
            return
        if item.dtype.kind in "fiub" and item.size > 1 and item.size == max(item.shape, default=0):
            found[name.rsplit("/", 1)[-1]] = np.asarray(item).ravel()

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except Exception as error:
        raise unreadable_file(path, f"{_UNREADABLE}: {error}", _AS_V7) from error
    return found


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
        names, descriptions, info, data = _named_matrices(content)
        columns = _columns(names, descriptions, info, data)
    except (IndexError, ValueError, TypeError) as error:
        what = f"the result file is damaged: {error}"
        raise unreadable_file(path, what, "simulate again, or export the result as CSV") from error
    last_of_event = np.append(np.diff(columns[0].values) > 0, True)
    dropped = int((~last_of_event).sum())
    kept = tuple(Column(c.name, c.unit, c.values[last_of_event]) for c in columns)
    notes = (f"{dropped} row(s) at events left out, the later one kept",) if dropped else ()
    return Table(str(path), kept, None, notes=notes)


def _named_matrices(content: Mapping[str, Any]) -> tuple[list[str], list[str], np.ndarray, np.ndarray]:
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
    columns = [Column("time", None, data[0])]  # in what the model counts
    for i, name in enumerate(names):
        matrix, row = info[0, i], info[1, i]
        if matrix != _CHANGING or name.lower() == "time" or abs(row) <= 1:
            continue
        unit = _UNIT.search(descriptions[i]) if i < len(descriptions) else None
        values = np.sign(row) * data[abs(row) - 1]
        columns.append(Column(name, unit[1].strip() if unit and unit[1].strip() else None, values))
    return columns
