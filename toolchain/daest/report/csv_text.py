"""Signals as CSV text."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

import numpy as np


def csv_text(header: Sequence[str], rows: np.ndarray) -> str:
    """A CSV table; `rows` (n_samples, n_columns), the first column the time with 12 significant digits, the
    others with 9; values that are not finite are empty cells."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(header)
    for time, *values in rows.tolist():
        cells = (f"{v:.9g}" if -np.inf < v < np.inf else "" for v in values)
        buffer.write(",".join((f"{time:.12g}", *cells)) + "\n")
    return buffer.getvalue()
