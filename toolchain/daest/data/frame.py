"""Recordings that are in memory already: a pandas DataFrame, an xarray Dataset, or a mapping of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from daest.data.table import Column, Table, split_header
from daest.errors import DataError

DATES = "mM"  # numpy kinds of dates and durations


def is_frame(data: object) -> bool:
    """Whether `data` is a DataFrame, a Dataset or a dictionary, told without importing pandas or xarray."""
    if isinstance(data, dict):
        return True
    package = type(data).__module__.partition(".")[0]
    return (package, type(data).__name__) in {("pandas", "DataFrame"), ("xarray", "Dataset")}


def frame_table(data: Any, name: str) -> Table:
    """The table of a DataFrame, of a Dataset whose variables have one dimension in common, or of a mapping of
    arrays {"time": t, "u [V]": u}.

    An index (a coordinate) that is called time, or holds dates, is the column `time`; dates become seconds
    from the first row. Units stand in the column names as in a file, `omega [rad/s]`, or in the attribute
    `units` of a variable of a Dataset. Raises DataError `data-frame` for a Dataset of several dimensions, and
    for arrays of several lengths.
    """
    if isinstance(data, dict):
        return _of_arrays(data, name)
    if type(data).__name__ == "Dataset":
        return _of_dataset(data, name)
    columns = [_column(str(header), data[header], None) for header in data.columns]
    return Table(name, (*_index(data.index, columns), *columns), None)


def _of_arrays(data: Mapping[Any, Any], name: str) -> Table:
    arrays = {str(header): np.atleast_1d(np.asarray(values)) for header, values in data.items()}
    sizes = {header: "x".join(map(str, values.shape)) for header, values in arrays.items()}
    if len(set(sizes.values())) != 1 or any(values.ndim != 1 for values in arrays.values()):
        told = ", ".join(f"{header} {size}" for header, size in sizes.items()) or "none"
        raise DataError(
            "data-frame",
            f"the arrays have the sizes: {told}",
            where=name,
            remedy="give one-dimensional arrays of one length, with the time among them",
        )
    return Table(name, tuple(_column(header, values, None) for header, values in arrays.items()), None)


def _of_dataset(data: Any, name: str) -> Table:
    if len(data.dims) != 1:
        raise DataError(
            "data-frame",
            f"the Dataset has the dimensions {', '.join(map(str, data.dims)) or 'none'}",
            where=name,
            remedy="select variables with the dimension time alone",
        )
    series = {str(key): value for key, value in data.variables.items() if value.ndim == 1}
    columns = [_column(key, value.to_numpy(), value.attrs.get("units")) for key, value in series.items()]
    (dimension,) = map(str, data.dims)
    columns = [_as_time(c, np.asarray(series[c.name])) if c.name == dimension else c for c in columns]
    return Table(name, tuple(columns), None)


def _index(index: Any, columns: list[Column]) -> list[Column]:
    """The index as a column, if it is one: named, or of dates."""
    if index.name is None and index.dtype.kind not in DATES:
        return []
    column = _column(str(index.name or "time"), index.to_series(), None)
    if any(c.name == column.name for c in columns):
        return []
    return [_as_time(column, np.asarray(index))]


def _as_time(column: Column, values: np.ndarray) -> Column:
    """Dates are the time, whatever the name."""
    return Column("time", "s", column.values) if values.dtype.kind in DATES else column


def _column(header: str, series: Any, unit: str | None) -> Column:
    name, in_header = split_header(header)
    unit = in_header if unit is None else str(unit)
    raw = np.asarray(series)
    if raw.dtype.kind in DATES:
        start = raw[0] if raw.dtype.kind == "M" and raw.size else np.timedelta64(0, "ns")
        seconds = (raw - start) / np.timedelta64(1, "s")
        return Column(name, "s", seconds.astype(float))
    if raw.dtype.kind in "fiub":
        return Column(name, unit, raw.astype(float))
    return _mixed(name, unit, series)


def _mixed(name: str, unit: str | None, series: Any) -> Column:
    """A column of texts and numbers, or with pandas' own missing values."""
    import pandas as pd

    series = pd.Series(series)
    values = np.asarray(pd.to_numeric(series, errors="coerce"), dtype=float)
    given = np.asarray(pd.notna(series))
    rows = np.nonzero(given & np.isnan(values))[0]
    return Column(name, unit, values, tuple((int(row), str(series.iloc[row])) for row in rows))
