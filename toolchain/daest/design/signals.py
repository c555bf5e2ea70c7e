"""Families of inputs, as signals between -1 and 1, brought within the limits of the inputs.

Each family has a few shapes over the time scales that an experiment of its length can show: dwell times and
bands in steps of a factor. Several inputs get signals that are independent of each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from daest.model.design import Limits

PIECES = (8, 20, 50, 125, 300)  # of constant level in the length of an experiment
HIGHEST = (5.0, 20.0, 80.0, 320.0)  # frequencies of a band, in cycles over the length
MOST_LINES = 200  # of a multisine
USABLE = 0.4  # of the sampling rate: the highest frequency that a sampled input shows
LEVELS = 5  # of steps, on either side of the middle
REVERSALS = (2, 6, 15)  # ramps up and down in the length
SMALLER = (0.5, 0.2)  # amplitudes that the best shape of a family is also tried at


@dataclass(frozen=True)
class Shape:
    """A shape of a family: its name, and one signal (n_samples, n_u) between -1 and 1."""

    name: str
    signal: np.ndarray


Maker = Callable[[Limits, int], Iterator[Shape]]


def steps(limits: Limits, seed: int) -> Iterator[Shape]:
    """Random levels, held."""
    for pieces in _pieces(limits):
        signal = _held(limits, seed, pieces, np.arange(-LEVELS, LEVELS + 1) / LEVELS)
        yield Shape(f"{limits.length / pieces:.3g} s a step", signal)


def random_binary(limits: Limits, seed: int) -> Iterator[Shape]:
    """One of the two limits, drawn anew after every piece."""
    for pieces in _pieces(limits):
        signal = _held(limits, seed, pieces, np.array([-1.0, 1.0]))
        yield Shape(f"clock {limits.length / pieces:.3g} s", signal)


def multisine(limits: Limits, seed: int) -> Iterator[Shape]:
    """Sines of equal size at multiples of 1/length with phases of low crest factor (Schroeder 1970); several
    inputs take the lines in turn."""
    n_u = len(limits.inputs)
    for low, high in _bands(limits):
        lines = np.arange(max(1, round(low * limits.length)), round(high * limits.length) + 1)
        lines = np.unique(lines[np.linspace(0, lines.size - 1, min(lines.size, MOST_LINES)).astype(int)])
        if lines.size < n_u:
            continue
        parts = [_sines(limits, lines[i::n_u]) for i in range(n_u)]
        yield Shape(f"{lines.size} lines, {low:.3g} to {high:.3g} Hz", np.column_stack(parts))


def chirp(limits: Limits, seed: int) -> Iterator[Shape]:
    """A sine whose frequency rises by equal factors in equal times; further inputs sweep backwards and
    shifted."""
    time = limits.time
    for low, high in _bands(limits):
        rate = np.log(high / low) / limits.length
        phase = 2.0 * np.pi * low * np.expm1(rate * time) / rate
        parts = []
        for i in range(len(limits.inputs)):
            one = np.sin(phase + i)
            parts.append(one if i % 2 == 0 else one[::-1])
        yield Shape(f"{low:.3g} to {high:.3g} Hz", np.column_stack(parts))


def ramps(limits: Limits, seed: int) -> Iterator[Shape]:
    """Slow ramps that reverse, with an amplitude that grows from a fifth to the whole."""
    if limits.length < 4.0 * _dwell(limits):
        return
    part = limits.time / limits.length
    for reversals in REVERSALS:
        columns = []
        for i in range(len(limits.inputs)):
            phase = part * (reversals + i)
            columns.append((0.2 + 0.8 * part) * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * phase)))
        yield Shape(f"{reversals} times up and down", np.column_stack(columns))


FAMILIES: dict[str, Maker] = {
    "steps": steps,
    "multisine": multisine,
    "chirp": chirp,
    "random binary": random_binary,
    "slow ramps": ramps,
}
# What is not periodic has parts at all low frequencies.
KEEPS_LOWEST = ("multisine", "chirp")


def within(limits: Limits, signal: np.ndarray, amplitude: float = 1.0, *, keeps_form: bool) -> np.ndarray:
    """Inputs (n_samples, n_u) in their units. Where a rate is limited, a signal that `keeps_form` gets
    smaller; of another one the levels are reached on ramps."""
    columns = []
    for one, column in zip(limits.inputs, signal.T, strict=True):
        wanted = amplitude * one.half * column
        largest = one.rate * limits.period
        fastest = float(np.max(np.abs(np.diff(wanted)), initial=0.0))
        if fastest > largest:
            wanted = wanted * (largest / fastest) if keeps_form else slewed(wanted, largest)
        columns.append(one.middle + wanted)
    return np.column_stack(columns)


def with_piece(limits: Limits, inputs: np.ndarray, column: int, piece: slice, level: float) -> np.ndarray:
    """The inputs with the samples `piece` of one of them at a level between its lowest (0) and highest (1)
    value, reached on ramps where the rate is limited. Shapes: inputs (n_samples, n_u)."""
    one, changed = limits.inputs[column], inputs.copy()
    changed[piece, column] = one.low + level * (one.high - one.low)
    if np.isfinite(one.rate):
        changed[:, column] = slewed(changed[:, column], one.rate * limits.period)
    return changed


def slewed(wanted: np.ndarray, largest: float) -> np.ndarray:
    """The signal that follows `wanted` in steps of at most `largest`. Shapes: wanted and result
    (n_samples,)."""
    result, value = np.empty_like(wanted), float(wanted[0])
    for k, target in enumerate(wanted.tolist()):
        value += min(max(target - value, -largest), largest)
        result[k] = value
    return result


def _dwell(limits: Limits) -> float:
    """The shortest time [s] for which a level is held."""
    return max(2.0 * limits.period, 0.5 / limits.band[1])


def _pieces(limits: Limits) -> list[int]:
    most = int(limits.length / _dwell(limits))
    return sorted({min(pieces, most) for pieces in PIECES if min(pieces, most) >= 2})


def _bands(limits: Limits) -> list[tuple[float, float]]:
    top = min(limits.band[1], USABLE / limits.period)
    low = max(limits.band[0], 1.0 / limits.length)
    highest = sorted({min(cycles / limits.length, top) for cycles in HIGHEST} | {top})
    return [(low, high) for high in highest if high > low]


def _held(limits: Limits, seed: int, pieces: int, levels: np.ndarray) -> np.ndarray:
    """One signal per input, of random `levels` that are held over equal pieces."""
    which = np.minimum((limits.time / limits.length * pieces).astype(int), pieces - 1)
    count = range(len(limits.inputs))
    return np.column_stack([np.random.default_rng([seed, i]).choice(levels, pieces)[which] for i in count])


def _sines(limits: Limits, lines: np.ndarray) -> np.ndarray:
    numbers = np.arange(lines.size)
    phases = -np.pi * numbers * (numbers + 1) / lines.size
    cycles = np.outer(limits.time / limits.length, lines)
    signal = np.cos(2.0 * np.pi * cycles + phases).sum(axis=1)
    return signal / np.max(np.abs(signal))


def first_half(inputs: np.ndarray) -> np.ndarray:
    """Of a recording's inputs (n, n_u): what `daest diagnose` fits."""
    return inputs[: max(2, inputs.shape[0] // 2)]
