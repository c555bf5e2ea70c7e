"""The document of `daest filter`, and its table of estimates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NotRequired, TypedDict

import numpy as np

from daest.errors import EstimationError
from daest.model.estimates import FilterResult
from daest.model.experiment import Experiment
from daest.model.holds import Hold
from daest.near import near_names
from daest.report.documents.parts import entry


class Nis(TypedDict):
    mean: float | None
    low: float | None
    high: float | None
    inside: bool | None
    n_innovations: NotRequired[int]


class Compared(TypedDict):
    fit_percent: float | None
    rms: float | None
    n_samples: NotRequired[int]


class ProcessNoise(TypedDict):
    names: list[str]
    units: NotRequired[list[str]]
    rms: NotRequired[list[float | None]]
    std: list[float | None]


class SampleSize(TypedDict):
    median: float
    least: float


class FilterDocument(TypedDict):
    """Summary of a filter run; the estimates are a CSV file."""

    kind: str
    smoothed: NotRequired[bool]
    measure: NotRequired[list[str]]
    hold: Hold
    noise: NotRequired[Literal["white", "held"]]
    n_samples: int
    log_likelihood: float | None
    nis: Nis
    compared: dict[str, Compared]
    process_noise: ProcessNoise
    steady_after: float | None
    effective_sample_size: NotRequired[SampleSize | None]
    undetermined: NotRequired[list[str]]
    messages: NotRequired[list[str]]
    notes: NotRequired[list[str]]


class ColumnEntry(TypedDict):
    name: str
    unit: str
    measured: bool
    used: bool


def document(result: FilterResult) -> FilterDocument:
    """JSON content: the summary; the estimates themselves are in `table`. Numbers that do not exist are
    None."""
    noise, effective = result.process_noise, result.effective_sample_size
    rms, std = np.sqrt(np.mean(noise.values**2, axis=0)), np.median(noise.std, axis=0)
    return entry(
        FilterDocument,
        result,
        n_samples=result.time.size,
        process_noise=entry(ProcessNoise, noise, rms=rms, std=std),
        effective_sample_size=None
        if effective is None
        else {"median": float(np.median(effective)), "least": float(effective.min())},
        undetermined=[result.names[i] for i in np.flatnonzero(np.isinf(result.std[-1]))],
    )


def shown(result: FilterResult, experiment: Experiment, only: Sequence[str] = ()) -> list[str]:
    """The variables that a picture shows: `only`, else the measured outputs."""
    return list(only) or [name for name in experiment.output_names if name in result.names]


def described(result: FilterResult, experiment: Experiment, names: Sequence[str]) -> list[ColumnEntry]:
    """What the columns of `series` are."""
    return [
        {
            "name": name,
            "unit": result.units[_column(result, name)],
            "measured": name in experiment.output_names,
            "used": name in result.measure,
        }
        for name in names
    ]


def series(result: FilterResult, experiment: Experiment, names: Sequence[str]) -> dict[str, np.ndarray]:
    """`time` (n_samples,), and `values`, `std` and `measured` (n_samples, n_names), NaN where nothing is
    known."""
    columns = [_column(result, name) for name in names]
    measured = [
        experiment.output(name) if name in experiment.output_names else np.full(result.time.size, np.nan)
        for name in names
    ]
    return {
        "time": result.time,
        "values": result.values[:, columns],
        "std": result.std[:, columns],
        "measured": np.array(measured).reshape(len(names), -1).T,
    }


def table(result: FilterResult, only: Sequence[str] | None = None) -> tuple[list[str], np.ndarray]:
    """Header `time`, `name`, `name.std`, … and rows (n_samples, 1 + 2 n_names); NaN where nothing is known.

    `only` selects variables by name. Error (EstimationError): `filter-unknown-variable`.
    """
    chosen = list(result.names) if only is None else list(only)
    columns = [_column(result, name) for name in chosen]
    header, rows = ["time"], np.empty((result.time.size, 1 + 2 * len(chosen)))
    rows[:, 0] = result.time
    for place, (name, column) in enumerate(zip(chosen, columns, strict=True)):
        header += [name, f"{name}.std"]
        rows[:, 1 + 2 * place] = result.values[:, column]
        rows[:, 2 + 2 * place] = result.std[:, column]
    rows[np.isinf(rows)] = np.nan
    return header, rows


def chosen_columns(names: Sequence[str], only: Sequence[str] | None) -> list[int]:
    """Positions in `names` of the variables `only`, of all without them. Raises EstimationError
    `filter-unknown-variable`."""
    return list(range(len(names))) if only is None else [_position(names, name) for name in only]


def _column(result: FilterResult, name: str) -> int:
    return _position(result.names, name)


def _position(names: Sequence[str], name: str) -> int:
    if name in names:
        return list(names).index(name)
    near = near_names(name, names, 3)
    raise EstimationError(
        "filter-unknown-variable",
        f"the model has no variable {name}",
        where=name,
        remedy=f"similar names: {', '.join(near)}" if near else "without --only the table names all of them",
    )
