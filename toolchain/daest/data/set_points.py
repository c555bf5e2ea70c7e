"""See that the column of an input is what a controller was told to make of an output, and not what drives the
machine.

A controller that integrates brings its output to its set point: once all is settled, the numbers of the two
columns are the same at every level, whatever the machine is, and nothing is added. Between two quantities of
different kinds no physics makes just that gain, but the numbers of a machine may do it by chance; then its
model has it, too.
"""

from __future__ import annotations

from collections.abc import Mapping
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
FORGOTTEN = 40.0  # times the time of a filter after which what it began with is below rounding
MOST_EVEN = 10.0  # times the samples that an even grid through a recording with pauses may have


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
    values does so, too. None where it cannot be simulated, or the recording has long pauses."""
    if np.ptp(experiment.time) > MOST_EVEN * experiment.n_samples * experiment.median_step:
        return []
    units = {v.name: v.unit for variables in (flat.inputs, flat.outputs) for v in variables if v.unit}
    likely = []
    for name in _varied(experiment, units):
        settling = _settling(experiment, name)
        for output in _recorded(experiment, units):
            settled = settling.of(output, experiment.output(output))
            # Units last: to know them all takes as long as a hundred of such fits.
            if _is_followed(experiment, output, settled) and not converts(units[name], units[output]):
                likely.append((settling, output, settled))
    if not likely:
        return []
    from daest.systems.simulation.simulate import simulate

    try:
        simulated = simulate(flat, experiment).outputs
    except DaestError:
        return []
    found = []
    for settling, output, settled in likely:
        of_model = settling.of(output, simulated[:, experiment.output_names.index(output)])
        if abs(of_model.gain - 1.0) > DATA.natural_gain:
            found.append(SetPoint(settling.name, output, settled.gain, of_model.gain))
    return found


def _varied(experiment: Experiment, units: Mapping[str, str]) -> list[str]:
    """The inputs of a known unit that take several values; what has none may be of the quantity of an
    output."""
    names = [name for name in experiment.input_names if name in units]
    return [name for name in names if np.unique(experiment.input(name)).size >= DATA.set_levels]


def _recorded(experiment: Experiment, units: Mapping[str, str]) -> list[str]:
    """The outputs of a known unit that are recorded."""
    names = [name for name in experiment.output_names if name in units]
    return [name for name in names if np.isfinite(experiment.output(name)).sum() >= DATA.told_values]


def _is_followed(experiment: Experiment, output: str, settled: _Settled) -> bool:
    """Whether a recorded output, once `settled`, is an input, and hardly anything else moves it."""
    spread = float(np.nanstd(_as_recorded(experiment, output, experiment.output(output))))
    is_sure = settled.std < 0.5 * DATA.set_gain and settled.left < DATA.set_left * spread
    return (
        is_sure and abs(settled.gain - 1.0) < DATA.set_gain and abs(settled.offset) < DATA.set_offset * spread
    )


@dataclass(frozen=True)
class _Settling:
    """Least squares over all inputs, that of `name` first, and what filters of the first order make of them,
    which may have begun anywhere, on an even `grid` of times (m,): the `basis` (m, k) as `factors` (m, k)
    times what has the `inverse` (k, k), its columns over their `scales` (k,)."""

    experiment: Experiment
    name: str
    grid: np.ndarray
    basis: np.ndarray
    scales: np.ndarray
    factors: np.ndarray
    inverse: np.ndarray

    def of(self, output: str, values: np.ndarray) -> _Settled:
        """What the `values` (n,) of an output are once settled, in the units of the columns."""
        known = np.isfinite(values)
        recorded = _as_recorded(self.experiment, output, values[known])
        measured = np.interp(self.grid, self.experiment.time[known], recorded)
        coefficients = self.inverse @ (self.factors.T @ measured) / self.scales
        errors = measured - self.basis @ coefficients
        left = float(np.std(errors))
        memory = errors[1:] @ errors[:-1] / max(errors @ errors, np.finfo(float).tiny)
        alike = float(np.clip(memory, 0.0, 0.9999))
        size = float(np.linalg.norm(self.inverse[0])) / self.scales[0]
        std = left * size * np.sqrt((1.0 + alike) / (1.0 - alike))
        return _Settled(float(coefficients[0]), float(std), float(coefficients[1]), left)


def _settling(experiment: Experiment, name: str) -> _Settling:
    time, step = experiment.time, experiment.median_step
    grid = np.arange(time[0], time[-1] + 0.5 * step, step)
    rates = np.geomspace(1.0 / (SLOWEST * np.ptp(time)), 1.0 / step, N_RATES)
    order = [name, *(other for other in experiment.input_names if other != name)]
    inputs = [np.interp(grid, time, _as_recorded(experiment, one, experiment.input(one))) for one in order]
    passing = [_passing(move, rate * step) for rate in rates for move in inputs]
    decays = [_decay(rate * (grid - grid[0])) for rate in rates]
    basis = np.column_stack([inputs[0], np.ones_like(grid), *inputs[1:], *passing, *decays])
    scales = np.maximum(np.linalg.norm(basis, axis=0), np.finfo(float).tiny)
    factors, triangle = np.linalg.qr(basis / scales)
    return _Settling(experiment, name, grid, basis, scales, factors, np.linalg.pinv(triangle))


def _decay(ages: np.ndarray) -> np.ndarray:
    """e^-age (m,), nothing where that is lost in rounding: numbers too small for their full digits take a
    processor twenty times as long."""
    return np.where(ages < FORGOTTEN, np.exp(-np.minimum(ages, FORGOTTEN)), 0.0)


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
