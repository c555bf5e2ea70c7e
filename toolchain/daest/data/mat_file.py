"""MATLAB files: every vector of one common length is a column; a scalar struct of vectors is looked into."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from daest.data.result_file import is_result, result_table
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
