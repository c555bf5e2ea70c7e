"""What is done to a recording before it is used: resampling, detrending, splitting.

The order is fixed: cut (while reading), resample, split, detrend each part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np

from daest.data.limits import DATA
from daest.errors import ConfigError, DataError
from daest.model.holds import FOH, ZOH, Hold, held_inputs

if TYPE_CHECKING:
    import scipy.sparse as sp
    from scipy.interpolate import CubicSpline

    from daest.model.experiment import Experiment

# The anti-alias filter, by Kaiser's formulas for a stop band between 50 dB and beyond.
HALF_WIDTH = 0.5 * (DATA.attenuation - 8.0) / (2.285 * DATA.transition * np.pi)  # periods
BETA = 0.1102 * (DATA.attenuation - 8.7)
STOP = 0.5 * (DATA.cutoff + DATA.transition)  # frequency, in units of 1 / period, beyond which nothing passes
KERNEL_STEP = 1.0 / 64.0  # periods between the tabulated values of a kernel
SEGMENT = 8192  # samples, the longest part whose spectrum is taken
_RESAMPLED = "resampled to"
TAKEN_STRAIGHT = (
    "nobody says what the inputs did between the samples of the recording: taken as straight lines; --hold "
    "zoh where they were held"
)

Detrend = Literal["none", "mean", "linear"]


@dataclass(frozen=True)
class Preparation:
    """`start`, `stop` (s) cut the recording; `period` (s) resamples it; `detrend` removes mean or trend of
    inputs and outputs; `split` (0 to 1) is the share that is kept for estimation, the rest being
    validation. `hold` is what the inputs did between the samples of the recording (None: not known)."""

    start: float | None = None
    stop: float | None = None
    period: float | None = None
    detrend: Detrend = "none"
    split: float | None = None
    hold: Hold | None = None

    def __post_init__(self) -> None:
        if self.period is not None and not (np.isfinite(self.period) and self.period > 0):
            raise ConfigError(
                "option-resample",
                f"a period of {self.period} s is not positive",
                remedy="give seconds, e.g. 0.05",
            )
        if self.split is not None and not 0 < self.split < 1:
            raise ConfigError(
                "option-split",
                f"a split at {self.split} leaves one part empty",
                remedy="give the share for estimation, between 0 and 1, e.g. 0.5",
            )


def on_clock(experiment: Experiment) -> Experiment:
    """The recording on the uniform clock through its time stamps, if there is one (`_clock`): rows that it
    left out have no outputs, and inputs on straight lines between their neighbours; notes say so."""
    clock = _clock(experiment.time)
    if clock is None:
        return experiment
    time, rows, notes = clock
    experiment = replace(experiment, notes=(*experiment.notes, *notes))
    if time.size == experiment.n_samples:
        return replace(experiment, time=time)
    is_lost = np.ones((time.size, 1), dtype=bool)
    is_lost[rows] = False

    def spread(values: np.ndarray) -> np.ndarray:
        whole = np.full((time.size, values.shape[1]), np.nan)
        whole[rows] = values
        return whole

    def filled(values: np.ndarray) -> np.ndarray:
        return bridged(spread(values), np.broadcast_to(is_lost, (time.size, values.shape[1])))

    return replace(
        experiment,
        time=time,
        inputs=filled(experiment.inputs),
        outputs=spread(experiment.outputs),
        extra={name: filled(values[:, None])[:, 0] for name, values in experiment.extra.items()},
    )


def whole_period(time: np.ndarray) -> float | None:
    """The period [s] of the uniform clock of the stamps `time` (n_samples,) that leave out none of it."""
    found = _clock(time)
    if found is None or found[0].size != time.size:
        return None
    return float(f"{found[0][1] - found[0][0]:.9g}")


def _clock(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]] | None:
    """The times (n,) of a uniform clock of which the stamps `time` (n_samples,) [s] leave out at most
    `DATA.most_lost` of all and no more than a pause in one place, if none is off by more than `DATA.grid` and
    the last decimal of that stamp; the place (n_samples,) of every stamp among them; and notes on stamps that
    were not uniform already. None where there is no such clock."""
    if time.size < 3:
        return None
    steps = np.diff(time)
    with np.errstate(over="ignore"):  # times may be anything
        counts = np.round(steps / np.median(steps))
    if not (counts.min() >= 1 and counts.max() <= DATA.pause):
        return None
    rows = np.concatenate([[0], np.cumsum(counts)]).astype(int)
    n = int(rows[-1]) + 1
    n_lost = n - time.size
    is_told = steps.size >= DATA.clock_steps and n_lost <= DATA.most_lost * n
    if n_lost and not is_told:
        return None
    slope = np.polyfit(rows, time - time[0], 1)[0]
    period = float(f"{slope:.9g}")
    grid = time[0] + period * np.arange(n)
    distance = np.abs(grid[rows] - time)
    off = float(np.max(distance)) / period
    rounding = 0.0 if off <= DATA.grid else _last_decimals(time, DATA.last_decimal * period)
    if np.any(distance > DATA.grid * period + rounding):
        return None
    notes = []
    # Below 1e-6 of a period it is the rounding of the decimals in the file, not worth a word.
    if off > 1e-6:
        notes.append(
            f"time stamps taken as uniform, period {period:.9g} s (off by at most {100 * off:.2g} % of it)"
        )
    if n_lost:
        notes.append(
            f"{n_lost} of {n} rows are left out on a clock of {period:.9g} s: outputs are missing there, "
            "inputs lie on straight lines between their neighbours"
        )
    return grid, rows, tuple(notes)


def _last_decimals(time: np.ndarray, most: float) -> np.ndarray:
    """What the last decimal of every stamp (n_samples,) is worth [s], `most` at most: the same power of ten
    for all of them, or, where all are written in as many digits, less for those nearer to zero. Zeros where
    that is none down to a thousandth of `most`."""
    size = np.abs(time)
    decade = np.floor(np.log10(np.where(size > 0.0, size, size.max())))
    first = int(np.floor(np.log10(most)))
    for exponent in range(first, first - 3, -1):
        for worth in (np.full(time.size, 10.0**exponent), 10.0 ** (exponent + decade - decade.max())):
            counts = time / worth
            if np.allclose(counts, np.round(counts), rtol=0.0, atol=1e-3):
                return worth
    return np.zeros(time.size)


def prepare(experiment: Experiment, preparation: Preparation) -> Experiment:
    """Resampled and, unless a split follows, detrended; notes say so, and what is not known of the inputs."""
    if preparation.period is not None:
        experiment = resample(experiment, preparation.period, preparation.hold or FOH)
        if preparation.hold is None and experiment.input_names and is_resampled(experiment):
            experiment = replace(experiment, notes=(*experiment.notes, TAKEN_STRAIGHT))
    return experiment if preparation.split is not None else detrend(experiment, preparation.detrend)


def split(experiment: Experiment, preparation: Preparation) -> tuple[Experiment, Experiment]:
    """The first share `preparation.split` of the time for estimation and the rest for validation, each
    detrended by itself. Raises DataError `data-split-too-short` if a part has fewer than 2 rows."""
    assert preparation.split is not None
    edge = experiment.time[0] + preparation.split * (experiment.time[-1] - experiment.time[0])
    first = experiment.time <= edge
    if first.sum() < 2 or (~first).sum() < 2:
        raise DataError(
            "data-split-too-short",
            f"a split at {preparation.split} of {experiment.n_samples} rows leaves a part with fewer than 2",
            where=experiment.name,
            remedy="move the split, or give a longer recording",
        )
    parts = (_rows(experiment, first, "estimation"), _rows(experiment, ~first, "validation"))
    return tuple(detrend(part, preparation.detrend) for part in parts)  # type: ignore[return-value]


def split_all(
    experiments: Sequence[Experiment], preparation: Preparation
) -> tuple[list[Experiment], list[Experiment]]:
    """All estimation parts and all validation parts; the second list is empty without a split."""
    if preparation.split is None:
        return list(experiments), []
    pairs = [split(experiment, preparation) for experiment in experiments]
    return [pair[0] for pair in pairs], [pair[1] for pair in pairs]


def detrend(experiment: Experiment, kind: Detrend) -> Experiment:
    """Without mean (`mean`) or without the least-squares line (`linear`), inputs and outputs alike."""
    if kind == "none":
        return experiment
    degree = {"mean": 0, "linear": 1}[kind]
    return replace(
        experiment,
        inputs=_without_trend(experiment.time, experiment.inputs, degree),
        outputs=_without_trend(experiment.time, experiment.outputs, degree),
        notes=(*experiment.notes, f"{'mean' if kind == 'mean' else 'linear trend'} of all signals removed"),
    )


def sufficient_period(
    estimation: Sequence[Experiment], validation: Sequence[Experiment] = (), modes: Sequence[float] = ()
) -> float | None:
    """A period [s] that keeps all that the outputs show of much finer recordings, a multiple of their own;
    None where they are not that much finer, or uneven. `modes` are the natural frequencies of the model [Hz].

    White sensor noise is content up to the Nyquist frequency: a recording with it is never too fine. Where
    nothing is left up there, what little there is tells of filters and of the number format, and a
    likelihood that takes it for sensor noise would trust it above all.
    """
    experiments = [*estimation, *validation]
    periods = [e.period for e in experiments]
    if not periods or any(period is None for period in periods):
        return None
    own = max(period for period in periods if period is not None)
    bands = np.array([_bands(e) for e in experiments])
    band, still = bands.max(axis=0)
    if not 0.0 < band * DATA.much_finer < 0.5 / own:
        return None
    shown = max((mode for mode in modes if mode <= DATA.misplaced_mode * still), default=0.0)
    by_samples = min(
        sum(e.n_samples for e in estimation) // DATA.kept_samples,
        min(e.n_samples for e in experiments) // DATA.kept_in_one,
    )
    factor = min(int(0.5 / (max(DATA.kept_band * band, DATA.kept_mode * shown) * own)), by_samples)
    return factor * own if factor > 1 else None


def clear_period(estimation: Sequence[Experiment], modes: Sequence[float] = ()) -> float | None:
    """A period [s] that keeps what the outputs show above the white noise of their sensors, and the `modes`
    [Hz] that lie there, a multiple of the recordings' own (median) one; None where no coarser one does. What
    lies below the noise is not lost behind the filter of `resample`: of many samples it keeps the mean."""
    own = max(e.median_step for e in estimation)
    band = max(_clear_band(e) for e in estimation)
    shown = max((mode for mode in modes if mode <= DATA.misplaced_mode * band), default=0.0)
    fastest = max(DATA.kept_above_noise * band, DATA.kept_mode * shown)
    most = sum(e.n_samples for e in estimation) // DATA.kept_samples
    factor = min(int(0.5 / (fastest * own)), most) if fastest > 0.0 else 1
    return factor * own if factor > 1 else None


def _clear_band(experiment: Experiment) -> float:
    """The frequency [Hz] up to which an output shows more than its noise, by octaves; 0 where none does."""
    values = bridged(experiment.outputs, ~np.isfinite(experiment.outputs))
    highest = 0.0
    for column in values.T:
        frequencies, density = _spectrum(column, experiment.median_step)
        top = float(frequencies[-1])
        noise = float(np.median(density[frequencies >= top / 2.0]))  # tones up there are no noise
        while top > 2.0 * frequencies[1]:
            octave = density[(frequencies >= top / 2.0) & (frequencies <= top)]
            if np.mean(octave) > DATA.above_noise * noise:
                highest = max(highest, top)
                break
            top /= 2.0
    return highest


def _bands(experiment: Experiment) -> tuple[float, float]:
    """Frequencies [Hz] below which the rate of every output has `DATA.content_power`, and `DATA.still_power`,
    of its power; 0 where none moves."""
    assert experiment.period is not None
    values = bridged(experiment.outputs, ~np.isfinite(experiment.outputs))
    bands = [(0.0, 0.0)]
    for rate in np.diff(values, axis=0).T:
        if not np.any(rate):
            continue
        frequencies, density = _spectrum(rate, experiment.period)
        power = np.cumsum(density)
        ends = np.searchsorted(power, np.array([DATA.content_power, DATA.still_power]) * power[-1])
        bands.append((float(frequencies[ends[0]]), float(frequencies[ends[1]])))
    low, high = np.max(bands, axis=0)
    return float(low), float(high)


def _spectrum(values: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and the power at each, up to a factor: Welch's average over Hann windows that overlap
    by half. By the transform of NumPy: `scipy.signal` takes half a second to import."""
    length = min(values.size, SEGMENT)
    starts = range(0, values.size - length + 1, max(length - length // 2, 1))
    segments = np.array([values[i : i + length] for i in starts])
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    segments = (segments - segments.mean(axis=1, keepdims=True)) * window
    power = np.mean(np.abs(np.fft.rfft(segments, axis=1)) ** 2, axis=0)
    power[1 : (length + 1) // 2] *= 2.0  # for the negative frequencies, which 0 and the highest of all lack
    return np.fft.rfftfreq(length, period), power


def is_resampled(experiment: Experiment) -> bool:
    """Whether the signals have gone through the filter of `resample`."""
    return any(note.startswith(_RESAMPLED) for note in experiment.notes)


def hold_after(recordings: Iterable[Experiment], told: Hold | None) -> Hold | None:
    """What inputs do between the samples of `recordings` of which a hold is `told`: straight lines where they
    were resampled, since a filtered input is no longer held."""
    return FOH if any(is_resampled(recording) for recording in recordings) else told


def resample(experiment: Experiment, period: float, hold: Hold = FOH) -> Experiment:
    """The recording at `period` seconds, behind one linear-phase low-pass filter for inputs and outputs
    alike.

    The filter is a Kaiser-windowed sinc without delay: new samples stand at old times, and because all
    signals go through the same filter a linear model that relates them before relates them afterwards.
    Straight lines between samples are smaller than the signal that they stand for, by sinc² of the
    frequency times the period; the samples of the inputs are raised by as much, so that it is the
    straight lines through them that are the filtered input. Inputs that `hold` keeps come half a period of
    the recording later than their samples, as the middle of a step does. Samples nearer to an end than
    half the filter are dropped rather than invented. Unevenly sampled records are first interpolated
    linearly on a grid of half their median step. Raises ConfigError `option-resample` if `period` is
    shorter than the recording's own, DataError `data-too-few-rows` if the record is shorter than the
    filter.

        >>> daest.resample(record, 0.02).period
        0.02
    """
    own = experiment.period or experiment.median_step
    if period < own * (1 - DATA.grid):
        raise ConfigError(
            "option-resample",
            f"a period of {period:.6g} s is shorter than the {own:.6g} s of '{experiment.name}'",
            remedy="resample to a longer period; nothing can be known between the samples",
        )
    if experiment.period is not None and abs(period - own) <= DATA.grid * own:
        return experiment
    even = experiment if experiment.period is not None else _interpolated(experiment, 0.5 * own)
    half_width = _half_width(period)
    first, last = even.time[0] + half_width, even.time[-1] - half_width
    n_new = int(np.floor((last - first) / period * (1 + 1e-12))) + 1 if last >= first else 0
    if n_new < 2:
        raise DataError(
            "data-too-few-rows",
            f"resampled to {period:.6g} s, {max(n_new, 0)} rows are left: the anti-alias filter needs "
            f"{half_width:.3g} s at either end",
            where=experiment.name,
            remedy="choose a shorter period or a longer recording",
        )
    times = _aligned(even, first, n_new, period)
    weights = _filter_matrix(even.time, times, period, _low_pass)
    inputs, extra = _filtered_inputs(even, times, period, own, hold)
    note = (
        f"{_RESAMPLED} {period:.6g} s behind a linear-phase low-pass filter "
        f"(half gain at {0.5 * DATA.cutoff / period:.4g} Hz); {half_width:.3g} s dropped at either end"
    )
    return replace(
        experiment,
        time=times,
        inputs=inputs,
        outputs=_apply(weights, even.outputs),
        extra=extra,
        notes=(*experiment.notes, note),
    )


def _filtered_inputs(
    even: Experiment, times: np.ndarray, period: float, own: float, hold: Hold
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Inputs (n_times, n_u), and the signals that the model does not use yet, which may become inputs: those
    that are held for the recording's `own` period, and the others."""
    held = held_inputs(hold, even.input_names)
    driving = {
        is_held: _filter_matrix(
            even.time + (0.5 * own if is_held else 0.0), times, period, _low_pass_before_lines
        )
        for is_held in {hold == ZOH, *held.tolist()}
    }
    inputs = np.empty((times.size, held.size))
    for is_held, matrix in driving.items():
        inputs[:, held == is_held] = _apply(matrix, even.inputs[:, held == is_held])
    other = driving[hold == ZOH]
    return inputs, {name: _apply(other, values[:, None])[:, 0] for name, values in even.extra.items()}


def _rows(experiment: Experiment, keep: np.ndarray, part: str) -> Experiment:
    return replace(
        experiment,
        name=f"{experiment.name} ({part})",
        time=experiment.time[keep],
        inputs=experiment.inputs[keep],
        outputs=experiment.outputs[keep],
        extra={name: values[keep] for name, values in experiment.extra.items()},
    )


def _without_trend(time: np.ndarray, values: np.ndarray, degree: int) -> np.ndarray:
    result = values.copy()
    for column in result.T:
        known = np.isfinite(column)
        if known.sum() > degree:
            basis = np.vander(time - time[0], degree + 1)
            coefficients = np.linalg.lstsq(basis[known], column[known], rcond=None)[0]
            column -= basis @ coefficients
    return result


def _half_width(period: float) -> float:
    return HALF_WIDTH * period


def _low_pass(lag: np.ndarray) -> np.ndarray:
    """Kernel of the filter at `lag` (periods), zero beyond HALF_WIDTH."""
    window = np.i0(BETA * np.sqrt(np.clip(1.0 - (lag / HALF_WIDTH) ** 2, 0.0, None))) / np.i0(BETA)
    return DATA.cutoff * np.sinc(DATA.cutoff * lag) * window


def _low_pass_before_lines(lag: np.ndarray) -> np.ndarray:
    """Kernel whose samples, joined by straight lines, are the signal behind the filter: the response of the
    filter over that of the lines, sinc²."""
    return np.asarray(_raised_kernel()(np.abs(lag)))


@cache
def _raised_kernel() -> CubicSpline:
    from scipy.interpolate import CubicSpline

    lags = np.arange(0.0, HALF_WIDTH + 2.0 * KERNEL_STEP, KERNEL_STEP)
    frequencies = np.linspace(0.0, STOP, 801)
    # Both kernels and their responses are even: cosine transforms by the trapezoidal rule.
    waves = 2.0 * np.cos(2.0 * np.pi * np.outer(frequencies, lags))
    response = np.trapezoid(waves * _low_pass(lags), dx=KERNEL_STEP, axis=1)
    raised = response / np.sinc(frequencies) ** 2
    return CubicSpline(lags, np.trapezoid(waves * raised[:, None], frequencies, axis=0))


def _aligned(even: Experiment, first: float, n_new: int, period: float) -> np.ndarray:
    """New times that begin on an old one, the first at or after `first`, at most `n_new`."""
    index = int(np.searchsorted(even.time, first - 1e-9 * period))
    times = even.time[index] + period * np.arange(n_new)
    limit = even.time[-1] - _half_width(period)
    return times[times <= limit + 1e-9 * period]


def _filter_matrix(
    old: np.ndarray, new: np.ndarray, period: float, kernel: Callable[[np.ndarray], np.ndarray]
) -> sp.csr_array:
    """Weights (n_new, n_old), rows with sum 1: the kernel, a function of the lag in periods, at every old
    time within the filter's half width."""
    import scipy.sparse as sp

    half_width = _half_width(period)
    low = np.searchsorted(old, new - half_width)
    high = np.searchsorted(old, new + half_width, side="right")
    counts = high - low
    rows = np.repeat(np.arange(new.size), counts)
    columns = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(low, counts)
    weights = kernel((old[columns] - new[rows]) / period)
    matrix = sp.csr_array((weights, (rows, columns)), shape=(new.size, old.size))
    return sp.csr_array(sp.diags_array(1.0 / matrix.sum(axis=1)) @ matrix)


def _apply(weights: sp.csr_array, values: np.ndarray) -> np.ndarray:
    missing = ~np.isfinite(values)
    result = np.asarray(weights @ bridged(values, missing))
    if missing.any():
        lost = (
            np.asarray(abs(weights) @ missing.astype(float)) / np.asarray(abs(weights).sum(axis=1))[:, None]
        )
        result[lost > DATA.missing_weight] = np.nan
    return result


def bridged(values: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """`values` (n_samples, n) with those that are `missing`, of the same shape, replaced by linear
    interpolation, so that single gaps do not spread; zeros where a column has none."""
    result = values.copy()
    for column, gaps in zip(result.T, missing.T, strict=True):
        if gaps.any() and not gaps.all():
            index = np.arange(column.size)
            column[gaps] = np.interp(index[gaps], index[~gaps], column[~gaps])
    result[:, missing.all(axis=0)] = 0.0
    return result


def _interpolated(experiment: Experiment, step: float) -> Experiment:
    """Linear interpolation on a uniform grid; a point is missing where a neighbour that it needs is."""
    n = int(np.floor((experiment.time[-1] - experiment.time[0]) / step)) + 1
    grid = experiment.time[0] + step * np.arange(n)

    def at_grid(values: np.ndarray) -> np.ndarray:
        rows = [np.interp(grid, experiment.time, column) for column in values.T]
        return np.array(rows).reshape(values.shape[1], n).T

    return replace(
        experiment,
        time=grid,
        inputs=at_grid(experiment.inputs),
        outputs=at_grid(experiment.outputs),
        extra={name: np.interp(grid, experiment.time, values) for name, values in experiment.extra.items()},
    )
