"""Time that is written as a date: seconds from the first row."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

import numpy as np

from daest.data.table import Column

_ANY_DAY = "2000-01-01T"  # of clock times without a date


def with_seconds(column: Column) -> Column:
    """The column with dates (`2026-11-21 08:15:00.25`) or clock times turned into seconds from the first row.

    A column that holds anything else, numbers too, is returned as it is. Dates without a zone are taken as
    they stand: a change to summer time in between shows as a jump of the clock.
    """
    if not column.texts or len(column.texts) != column.values.size:
        return column
    stamps = [_stamp(text) for _, text in column.texts]
    known = [stamp for stamp in stamps if stamp is not None]
    if len(known) != len(stamps) or len({stamp.tzinfo is None for stamp in known}) > 1:
        return column
    seconds = np.array([(stamp - known[0]).total_seconds() for stamp in known])
    return replace(column, values=seconds, texts=(), unit="s")


def _stamp(text: str) -> datetime | None:
    for form in (text, f"{_ANY_DAY}{text}"):
        try:
            return datetime.fromisoformat(form)
        except ValueError:
            continue
    return None
