"""Signals as CSV text, with names and units in the header."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def csv_text(time: np.ndarray, names: Sequence[str], units: Sequence[str], values: np.ndarray) -> str:
    """A CSV table, header `name [unit]`, times with 12 and values with 9 significant digits, NaN as an empty
    cell.

    `values` (n_samples, n_names).
    """
    header = ["time [s]", *(_header(name, unit) for name, unit in zip(names, units, strict=True))]
    lines = [",".join(header)]
    for t, row in zip(time.tolist(), values.tolist(), strict=True):
        lines.append(",".join([f"{t:.12g}", *("" if v != v else f"{v:.9g}" for v in row)]))
    return "\n".join(lines) + "\n"


def _header(name: str, unit: str) -> str:
    text = f"{name} [{unit}]" if unit else name
    return f'"{text}"' if "," in text else text
