"""Experiments made ready for prediction: signals in the order of the model, on a uniform grid where one
exists.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daest.errors import DataError
from daest.estimation.gates import FIT
from daest.model.experiment import Experiment
from daest.model.flat import Model
from daest.model.holds import FOH, Hold, resampled
from daest.model.linear import StateSpaceFamily
from daest.systems.linear.state_space import stacked_inputs

MAX_GRID_GROWTH = 4  # a grid that would have more than this many samples per recorded one is not used
RUN_LENGTHS = (100, 20)  # samples over which a model is run to be linearised where it gets through no more


def n_observed(experiments: Iterable[Experiment]) -> int:
    """Number of measured values of all recordings."""
    return sum(int(np.isfinite(e.outputs).sum()) for e in experiments)


def longest_duration(experiments: Iterable[Experiment]) -> float:
    """Duration [s] of the longest recording."""
    return max(float(e.time[-1] - e.time[0]) for e in experiments)


@dataclass(frozen=True)
class Record:
    """One experiment on the grid that it is predicted on.

    `inputs` ū (n_samples, n_ū); `outputs` (n_samples, n_y), zero where missing; `observed` (n_samples,
    n_y) tells where not. `period` [s] is None when no uniform grid exists. `recorded` (n_recorded,) are
    the grid indices of the samples of the experiment: the grid may have more, between two of them,
    without outputs.
    """

    name: str
    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    observed: np.ndarray
    period: float | None
    recorded: np.ndarray

    @property
    def n_samples(self) -> int:
        return self.time.shape[0]

    @property
    def n_observed(self) -> np.ndarray:
        """Number of measured values per output, (n_y,)."""
        return self.observed.sum(axis=0)

    @property
    def is_complete(self) -> bool:
        return bool(np.all(self.observed))

    @cached_property
    def octaves(self) -> tuple[list[np.ndarray], np.ndarray]:
        """The different step lengths, ascending, by octave; and which of them each step is, (n_samples - 1,):
        asked for at every point of a search."""
        steps = np.diff(self.time)
        rounded = np.rint(steps / (FIT.equal_periods * np.mean(steps))).astype(np.int64)
        _, first, which = np.unique(rounded, return_index=True, return_inverse=True)
        distinct = steps[first]
        octaves = np.floor(np.log2(distinct / distinct[0]) + 1e-12).astype(int)
        return [distinct[octaves == octave] for octave in np.unique(octaves)], which


def make_record(experiment: Experiment, family: StateSpaceFamily, hold: Hold = FOH) -> Record:
    """A recording `in_model_order`, ready for a linear predictor of a `family_for` that hold.

    Steps that are multiples of the shortest one (dropped rows) give a uniform grid: inputs are straight lines
    between samples, or smooth, and the added grid points have no outputs.
    """
    inputs, outputs = experiment.inputs, experiment.outputs
    time, recorded, period = _grid(experiment)
    if len(time) != experiment.n_samples:
        inputs = resampled(inputs, experiment.time, time, hold)
        filled = np.full((len(time), outputs.shape[1]), np.nan)
        filled[recorded] = outputs
        outputs = filled
    observed = np.isfinite(outputs)
    return Record(
        name=experiment.name,
        time=time,
        inputs=stacked_inputs(inputs, time, family.input_derivatives, hold),
        outputs=np.where(observed, outputs, 0.0),
        observed=observed,
        period=period,
        recorded=recorded,
    )


def observed_counts(records: Sequence[Record]) -> np.ndarray:
    """Measured values per output over all records, (n_y,)."""
    return np.sum([r.n_observed for r in records], axis=0)


def in_model_order(experiment: Experiment, model: Model | StateSpaceFamily) -> Experiment:
    """The experiment with inputs and outputs in the order of the model; outputs not recorded are NaN.

    Errors (DataError): `data-input-missing`, `data-input-gap`.
    """
    inputs = _in_order(experiment, model)
    outputs = np.full((experiment.n_samples, len(model.outputs)), np.nan)
    for column, output in enumerate(model.outputs):
        if output.name in experiment.output_names:
            outputs[:, column] = experiment.output(output.name)
    return replace(
        experiment,
        inputs=inputs,
        outputs=outputs,
        input_names=model.input_names,
        output_names=model.output_names,
    )


def part_of(experiment: Experiment, first: int, last: int) -> Experiment:
    """Samples first … last - 1."""
    rows = slice(first, last)
    return replace(
        experiment,
        time=experiment.time[rows],
        inputs=experiment.inputs[rows],
        outputs=experiment.outputs[rows],
        extra={name: column[rows] for name, column in experiment.extra.items()},
    )


def _in_order(experiment: Experiment, model: Model | StateSpaceFamily) -> np.ndarray:
    columns = []
    for variable in model.inputs:
        if variable.name not in experiment.input_names:
            raise DataError(
                "data-input-missing",
                f"{experiment.name} has no signal for the input {variable.name} of the model",
                where=experiment.name,
                remedy="map a column to it ([data] inputs); "
                f"the recording has: {', '.join(experiment.input_names)}",
            )
        columns.append(experiment.input(variable.name))
        if not np.all(np.isfinite(columns[-1])):
            row = int(np.flatnonzero(~np.isfinite(columns[-1]))[0])
            raise DataError(
                "data-input-gap",
                f"input {variable.name} of {experiment.name} has no value at {experiment.time[row]:.6g} s",
                where=experiment.name,
                remedy="fill the gap, or cut the recording there (--from, --to)",
            )
    return np.column_stack(columns) if columns else np.zeros((experiment.n_samples, 0))


def _grid(experiment: Experiment) -> tuple[np.ndarray, np.ndarray, float | None]:
    """Grid times, grid indices of the recorded samples, and the period of the grid (None: keep the times)."""
    time, period = experiment.time, experiment.period
    every = np.arange(len(time))
    if period is not None or len(time) < 2:
        return time, every, period
    steps = np.diff(time)
    shortest = float(np.median(steps[steps < 1.5 * np.min(steps)]))
    multiples = np.rint(steps / shortest)
    index = np.concatenate([[0], np.cumsum(multiples)]).astype(int)
    unit = (time[-1] - time[0]) / index[-1]
    if index[-1] + 1 > MAX_GRID_GROWTH * len(time):
        return time, every, None
    # Rounded time stamps may drift from the grid by a part of a step that the signals do not notice.
    if np.any(np.abs(time - time[0] - unit * index) > FIT.grid * unit):
        return time, every, None
    return time[0] + unit * np.arange(index[-1] + 1), index, float(unit)
