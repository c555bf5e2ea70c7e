"""Parquet files, through pandas and pyarrow (an optional part of the installation)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from daest.data.table import Column, Table, split_header
from daest.errors import DataError, Place


def read_parquet(path: Path) -> Table:
    """The table of a Parquet file. Raises DataError `data-needs-pyarrow` or `data-unreadable-file`."""
    try:
        import pandas as pd

        frame = pd.read_parquet(path)
    except ImportError as error:
        raise DataError(
            "data-needs-pyarrow",
            "reading Parquet files needs pandas and pyarrow, which are not installed",
            where=Place(str(path)),
            remedy="pip install 'daest[parquet]', or save the recording as CSV",
        ) from error
    except (OSError, ValueError) as error:
        raise DataError(
            "data-unreadable-file",
            f"the Parquet file cannot be read: {error}",
            where=Place(str(path)),
            remedy="save it again, or as CSV",
        ) from error
    return Table(str(path), tuple(_column(str(name), frame[name]) for name in frame.columns), None)


def _column(header: str, series: object) -> Column:
    import pandas as pd

    name, unit = split_header(header)
    numbers = pd.to_numeric(series, errors="coerce")
    values = np.asarray(numbers, dtype=float)
    given = np.asarray(pd.notna(series))
    texts = tuple((int(row), str(series.iloc[row])) for row in np.nonzero(given & np.isnan(values))[0])  # type: ignore[attr-defined]
    return Column(name, unit, values, texts)
