"""See that the column of an input is what a controller was told to make of an output, and not what drives the
machine.

A controller that integrates brings its output to its set point: once all is settled, the numbers of the two
columns are the same at every level, whatever the machine is, and nothing is added. Between two quantities of
different kinds no physics makes just that gain, but the numbers of a machine may do it by chance; then its
model has it, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from daest.data.limits import DATA
from daest.errors import DaestError
from daest.model.experiment import Experiment, Finding
from daest.model.flat import Model
from daest.quantities import Conversion, converts

N_RATES = 8  # of the filters that take out of an input what is not settled
SLOWEST = 0.05  # of the recording, the time of the slowest of them


@dataclass(frozen=True)
class SetPoint:
    """An `input` that `output` follows with `gain` in the units in which both were recorded, where the model
    at its values has `of_model`."""

    input: str
    output: str
    gain: float
    of_model: float

    @property
    def text(self) -> str:
        """A sentence without its subject, the input."""
        return (
            f"is probably the set point of {self.output}, and not what drives the machine: settled, "
            f"{self.output} is {self.gain:.3f} times {self.input} in the numbers of the recording, at all "
            f"levels and with nothing added, where the model has {self.of_model:.3g} times"
        )


@dataclass(frozen=True)
class _Settled:
    """What an output is once settled: `gain` ± `std` times an input, plus `offset`; `left`, the standard
    deviation that this and what settles leave."""

    gain: float
    std: float
    offset: float
    left: float


def set_point_findings(flat: Model, experiment: Experiment) -> list[Finding]:
    """The `set_points` as findings."""
    return [
        Finding("check-set-point", "warning", one.input, one.text) for one in set_points(flat, experiment)
    ]


def set_points(flat: Model, experiment: Experiment) -> list[SetPoint]:
    """The inputs that an output of another kind of quantity follows in numbers, unless the model at its
    values does so, too. None where it cannot be simulated."""
    likely = [
        (name, output, settled)
        for name, output in _pairs(flat, experiment)
        if (settled := _followed(experiment, name, output)) is not None
    ]
    if not likely:
        return []
    from daest.systems.simulation.simulate import simulate

    try:
        simulated = simulate(flat, experiment).outputs
    except DaestError:
        return []
    found = []
    for name, output, settled in likely:
        of_model = _settled(experiment, name, output, simulated[:, experiment.output_names.index(output)])
        if abs(of_model.gain - 1.0) > DATA.natural_gain:
            found.append(SetPoint(name, output, settled.gain, of_model.gain))
    return found


def _pairs(flat: Model, experiment: Experiment) -> Iterator[tuple[str, str]]:
    """The inputs that take several values, each with the outputs of another kind of quantity that are
    recorded; what has no unit may be of the same one."""
    units = {v.name: v.unit for variables in (flat.inputs, flat.outputs) for v in variables}
    for name in experiment.input_names:
        if np.unique(experiment.input(name)).size < DATA.set_levels:
            continue
        for output in experiment.output_names:
            given, wanted = units.get(name), units.get(output)
            is_recorded = np.isfinite(experiment.output(output)).sum() >= DATA.told_values
            if is_recorded and given and wanted and not converts(given, wanted):
                yield name, output


def _followed(experiment: Experiment, name: str, output: str) -> _Settled | None:
    """What a recorded output is once settled, where that is the input, and hardly anything else moves it."""
    values = experiment.output(output)
    settled = _settled(experiment, name, output, values)
    spread = float(np.nanstd(_as_recorded(experiment, output, values)))
    is_sure = settled.std < 0.5 * DATA.set_gain and settled.left < DATA.set_left * spread
    is_one = abs(settled.gain - 1.0) < DATA.set_gain and abs(settled.offset) < DATA.set_offset * spread
    return settled if is_sure and is_one else None


def _settled(experiment: Experiment, name: str, output: str, values: np.ndarray) -> _Settled:
    """What the `values` (n,) of an output are once settled, by least squares over all inputs and what filters
    of the first order make of them, which may have begun anywhere; both in the units of their columns."""
    time, step = experiment.time, experiment.median_step
    grid = np.arange(time[0], time[-1] + 0.5 * step, step)
    rates = np.geomspace(1.0 / (SLOWEST * np.ptp(time)), 1.0 / step, N_RATES)
    order = [name, *(other for other in experiment.input_names if other != name)]
    inputs = [np.interp(grid, time, _as_recorded(experiment, one, experiment.input(one))) for one in order]
    passing = [_passing(move, rate * step) for rate in rates for move in inputs]
    decays = [np.exp(-rate * (grid - grid[0])) for rate in rates]
    basis = np.column_stack([inputs[0], np.ones_like(grid), *inputs[1:], *passing, *decays])
    known = np.isfinite(values)
    measured = np.interp(grid, time[known], _as_recorded(experiment, output, values[known]))
    scales = np.maximum(np.linalg.norm(basis, axis=0), np.finfo(float).tiny)
    factors, triangle = np.linalg.qr(basis / scales)
    inverse = np.linalg.pinv(triangle)
    coefficients = inverse @ (factors.T @ measured) / scales
    errors = measured - basis @ coefficients
    left = float(np.std(errors))
    alike = float(np.clip(errors[1:] @ errors[:-1] / max(errors @ errors, np.finfo(float).tiny), 0.0, 0.9999))
    std = left * float(np.linalg.norm(inverse[0])) / scales[0] * np.sqrt((1.0 + alike) / (1.0 - alike))
    return _Settled(float(coefficients[0]), float(std), float(coefficients[1]), left)


def _passing(values: np.ndarray, rate: float) -> np.ndarray:
    """What a filter of the first order, with a `rate` a sample, has not settled of values (n,).

    In Python: `scipy.signal` takes half a second to import."""
    kept = float(np.exp(-rate))
    followed = accumulate(values.tolist(), lambda before, value: value + kept * (before - value))
    return values - np.fromiter(followed, float, values.size)


def _as_recorded(experiment: Experiment, name: str, values: np.ndarray) -> np.ndarray:
    """Values of a signal in the unit of its column."""
    change = experiment.read_by.get(name, Conversion())
    return (values - change.offset) / change.scale
