"""Parquet files, through pandas and pyarrow (an optional part of the installation)."""

from __future__ import annotations

from pathlib import Path

from daest.data.frame import frame_table
from daest.data.problems import unreadable_file
from daest.data.table import Table
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
        what = f"the Parquet file cannot be read: {error}"
        raise unreadable_file(path, what, "save it again, or as CSV") from error
    return frame_table(frame, str(path))
