"""Parquet files, through pandas (an optional part of the installation) and pyarrow."""

from __future__ import annotations

from pathlib import Path

from daest.data.table import Part, Table, frame_table, is_time, split_header, unreadable_file
from daest.errors import DataError, Place


def read_parquet(path: Path, part: Part) -> Table:
    """The table of a Parquet file, of `part` at least. Raises DataError `data-needs-pyarrow` or
    `data-unreadable-file`."""
    try:
        import pandas as pd

        frame = pd.read_parquet(path, columns=_wanted(path, part))
    except ImportError as error:
        raise DataError(
            "data-needs-pyarrow",
            "reading Parquet files needs pandas, which is not installed",
            where=Place(str(path)),
            remedy="pip install 'daest[parquet]', or save the recording as CSV",
        ) from error
    except (OSError, ValueError) as error:
        what = f"the Parquet file cannot be read: {error}"
        raise unreadable_file(path, what, "save it again, or as CSV") from error
    return frame_table(frame, str(path))


def _wanted(path: Path, part: Part) -> list[str] | None:
    """The headers of the columns to read; None: all."""
    if part.names is None:
        return None
    from pyarrow import parquet

    wanted = {*part.names, part.time}
    headers = parquet.read_schema(path).names
    return [h for h in headers if {h, split_header(h)[0]} & wanted or is_time(split_header(h)[0])]
