"""MATLAB files: every vector of one common length is a column; a scalar struct of vectors is looked into."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from daest.data.table import Column, Table
from daest.errors import DataError, Place


def read_mat(path: Path) -> Table:
    """The table of a MATLAB file up to version 7. Raises DataError `data-unreadable-file` or
    `data-empty-file`."""
    from scipy.io import loadmat

    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    except (NotImplementedError, ValueError, OSError) as error:
        raise DataError(
            "data-unreadable-file",
            f"the MATLAB file cannot be read: {error}",
            where=Place(str(path)),
            remedy="save it in MATLAB with: save(name, '-v7')",
        ) from error
    vectors = _vectors({name: value for name, value in content.items() if not name.startswith("__")})
    if not vectors:
        raise DataError(
            "data-empty-file",
            "the MATLAB file holds no numeric vector",
            where=Place(str(path)),
            remedy="save vectors of equal length, one of them called time",
        )
    # Scalars and odd vectors of settings may stand beside the recording.
    length = Counter(vector.size for vector in vectors.values()).most_common(1)[0][0]
    columns = tuple(
        Column(name, None, vector.astype(float)) for name, vector in vectors.items() if vector.size == length
    )
    return Table(str(path), columns, None)


def _vectors(content: dict[str, object]) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "fiub":
            found[name] = value
        elif hasattr(value, "_fieldnames"):
            found.update(_vectors({field: getattr(value, field) for field in value._fieldnames}))
    return found
