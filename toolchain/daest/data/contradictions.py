"""Where a recording contradicts a model whatever its parameters are: a signal that moves the other way, or is
as many times as large as another unit would make it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from daest.data.limits import DATA
from daest.data.set_points import set_point_findings
from daest.errors import DaestError
from daest.model.experiment import Experiment, Finding
from daest.model.flat import FlatModel, Model
from daest.numerics.deadline import OutOfTimeError, check, until

MOST_PARAMETERS = 8
PATIENCE = 5.0  # times as long as the simulation as recorded may one of changed columns take
LONGEST = 20_000  # samples of the recording that are simulated
UNITS = {  # how many times as large the numbers of one unit are as those of another one
    180.0 / np.pi: "degrees are beside radians",
    30.0 / np.pi: "turns a minute are beside rad/s",
    1e3: "one prefix of a unit is beside the next",
    1e5: "pascals are beside bars",
    1e6: "one prefix of a unit is beside the second next",
}
MOVED = f"with its parameters up to {DATA.moved_parameter:g} times larger or smaller"
TURNED = (
    f"acts against the model: turned, it leaves less than 1/{DATA.other_scale:g} of the errors of a "
    f"simulation, {MOVED}"
)


SIGN_LOST = (
    "is never below zero, and as large where the model has it negative as where it has it positive, "
    f"{MOVED}: probably a sensor of magnitudes; measure the magnitude in the model, too"
)

INPUT_SIGN_LOST = (
    "is never {side} zero, and the model moves {outputs} one way alone with it, "
    f"{MOVED}, while the recording comes back: probably the magnitude of what the machine got, "
    "without its sign"
)


@dataclass(frozen=True)
class Contradiction:
    """What the recorded `signal`, an input or output, is to be multiplied by so that it is as the model has
    it, and in `text` how it contradicts the model."""

    signal: str
    factor: float
    text: str

    @property
    def is_turned(self) -> bool:
        return self.factor < 0.0

    def mended(self, experiment: Experiment) -> Experiment:
        """The experiment as it would be without."""
        inputs, outputs = (
            values * np.where([name == self.signal for name in names], self.factor, 1.0)
            for values, names in (
                (experiment.inputs, experiment.input_names),
                (experiment.outputs, experiment.output_names),
            )
        )
        return replace(experiment, inputs=inputs, outputs=outputs)


def model_findings(flat: Model, experiment: Experiment) -> list[Finding]:
    """What a model says of a recording: its `contradictions` as findings, outputs without their sign, and
    inputs that are set points."""
    found = [
        Finding("check-polarity" if one.is_turned else "check-scale", "warning", one.signal, one.text)
        for one in contradictions(flat, experiment)
    ]
    lost = [Finding("check-sign-lost", "warning", name, SIGN_LOST) for name in lost_signs(flat, experiment)]
    lost += [
        Finding("check-sign-lost", "warning", name, text)
        for name, text in inputs_without_sign(flat, experiment).items()
    ]
    return [*found, *lost, *set_point_findings(flat, experiment.first(LONGEST))]


def contradictions(flat: Model, experiment: Experiment) -> list[Contradiction]:
    """Outputs that move against the model, or the only input if all outputs do, and outputs that move with it
    and are as many times as large as another unit would make them; otherwise one of several inputs that acts
    the other way.

    There are none where the model cannot be simulated, or where it depends on the parameters.
    """
    part = experiment.first(LONGEST)
    try:
        driven = _driven(flat)
    except DaestError:
        return []
    return _of_outputs(flat, driven, part) or _turned_inputs(flat, driven, part)


def perhaps_turned(flat: Model, experiment: Experiment) -> list[Contradiction]:
    """Outputs that move against the model at its values, and with it at none of those that its parameters may
    have: a resonance that stands elsewhere leaves little of either, and a fit has to tell them from healthy
    ones."""
    part = experiment.first(LONGEST)
    if not np.any(np.ptp(part.inputs, axis=0)):
        return []

    def are_against(driven: Any, theta: np.ndarray, k: int) -> np.ndarray:
        (correlation, _), _ = _beside(driven, part, theta)
        return correlation < (0.0 if k else -DATA.upside_down)

    is_against = _at_all_values(flat, np.ones(len(part.output_names), dtype=bool), are_against)
    return _against(part, is_against, len(part.output_names))


def lost_signs(flat: Model, experiment: Experiment) -> list[str]:
    """Outputs that come to zero and never below, and are as large in either direction that the model has them
    move in whatever its parameters are, as those of a sensor of magnitudes are."""
    part = experiment.first(LONGEST)
    may_be = np.array([_may_be_magnitude(values) for values in part.outputs.T])
    if not np.any(may_be) or not np.any(np.ptp(part.inputs, axis=0)):
        return []
    from daest.systems.simulation.simulate import simulate

    def are_magnitudes(driven: Any, theta: np.ndarray, _k: int) -> np.ndarray:
        pairs = zip(part.outputs.T, simulate(driven, part, theta=theta).outputs.T, strict=True)
        return np.array([_is_magnitude(*pair) for pair in pairs])

    is_lost = _at_all_values(flat, may_be, are_magnitudes)
    return [name for name, found in zip(part.output_names, is_lost, strict=True) if found]


def inputs_without_sign(flat: Model, experiment: Experiment) -> dict[str, str]:
    """What is to be said of the only input that moves, by its name, where it stays on one side of zero, the
    model then moves an output one way alone, whatever its parameters are, as the angle of a motor, and the
    recording of that goes there and back: a controller writes its duty beside a pin for the direction."""
    part = experiment.first(LONGEST)
    moving = np.flatnonzero(np.ptp(part.inputs, axis=0))
    if moving.size != 1:
        return {}
    driving = part.inputs[:, moving[0]]
    comes_back = np.array([_is_driven_back(values, driving) for values in part.outputs.T], dtype=bool)
    if driving.min() < 0.0 < driving.max() or not np.any(comes_back):
        return {}
    from daest.systems.simulation.simulate import simulate

    def go_one_way(driven: Any, theta: np.ndarray, _k: int) -> np.ndarray:
        ways = [_least_way(values) for values in simulate(driven, part, theta=theta).outputs.T]
        return np.array([way < DATA.one_way for way in ways])

    is_lost = _at_all_values(flat, comes_back, go_one_way)
    outputs = ", ".join(name for name, found in zip(part.output_names, is_lost, strict=True) if found)
    side = "below" if driving.min() >= 0.0 else "above"
    name = part.input_names[moving[0]]
    return {name: INPUT_SIGN_LOST.format(side=side, outputs=outputs)} if outputs else {}


def _is_driven_back(values: np.ndarray, driving: np.ndarray) -> bool:
    """Whether an output goes there and back, and hardly moves where the input rests at zero: a spring or a
    leak that the model lacks brings it back there, too."""
    rests = np.abs(driving) <= DATA.near_zero * np.max(np.abs(driving))
    rests = rests[:-1] & rests[1:]
    steps = np.nan_to_num(np.abs(np.diff(values)))
    is_still = np.sum(steps[rests]) <= DATA.moves_at_rest * np.sum(steps)
    return bool(is_still and np.mean(rests) >= DATA.least_rest and _least_way(values) >= DATA.come_back)


def _least_way(values: np.ndarray) -> float:
    """The shorter one of the longest ways up and down that a signal goes, as a share of its range; 0 where it
    stands still."""
    known = values[np.isfinite(values)]
    if not known.size or not np.ptp(known):
        return 0.0
    up = np.max(known - np.minimum.accumulate(known))
    down = np.max(np.maximum.accumulate(known) - known)
    return float(min(up, down) / np.ptp(known))


def _at_all_values(
    flat: Model, found: np.ndarray, are_so: Callable[[Any, np.ndarray, int], np.ndarray]
) -> np.ndarray:
    """Which of the outputs `found` (n_y,) are so at the values of the model and at all others that its
    parameters may have, by `are_so` of the model that the inputs drive, the values and their number; none
    where it cannot be simulated."""
    try:
        driven = _driven(flat)
        for k, theta in enumerate(_variants(flat)):
            found = found & are_so(driven, theta, k)
            if not np.any(found):
                break
    except DaestError:
        return np.zeros_like(found)
    return found


def _may_be_magnitude(measured: np.ndarray) -> bool:
    """Whether a recorded output comes to zero, and not below."""
    known = measured[np.isfinite(measured)]
    return bool(known.size and 0.0 <= known.min() <= DATA.near_zero * known.max() and known.max() > 0.0)


def _is_magnitude(measured: np.ndarray, simulated: np.ndarray) -> bool:
    """Whether the measured output is as large where the simulated one is negative as where it is positive,
    each time weighed by the size of the simulated one, and goes with that size and not with its sign."""
    known = np.isfinite(measured) & np.isfinite(simulated)
    measured, simulated = measured[known], simulated[known]
    sides = [np.maximum(sign * simulated, 0.0) for sign in (1.0, -1.0)]
    shares = np.array([side.sum() for side in sides])
    if not shares.min() > DATA.least_side * shares.sum():
        return False
    means = np.array([side @ measured for side in sides]) / shares
    moved = [np.column_stack([measured, one]) for one in (simulated, np.abs(simulated))]
    plain, magnitude = (_correlation(both - both.mean(axis=0))[0] for both in moved)
    return bool(means.min() > DATA.like_side * means.max() and magnitude > plain)


def _of_outputs(flat: Model, driven: Any, part: Experiment) -> list[Contradiction]:
    """What single outputs contradict, or all of them the only input."""
    seen: list[np.ndarray] = []
    is_against = is_scaled = np.ones(len(part.output_names), dtype=bool)
    has_input = bool(np.any(np.ptp(part.inputs, axis=0)))
    try:
        for theta in _variants(flat):
            bare, whole = _beside(driven, part, theta)
            seen.append(bare)
            is_against = is_against & (bare[0] < -DATA.upside_down)  # not where it is NaN
            # a drift may hide that all of it is turned, but what goes along with the model does not
            limit = DATA.upside_down if has_input else -DATA.upside_down  # no input: the trend is theirs, too
            is_against = is_against & (whole[0] < limit)
            is_scaled = is_scaled & (bare[0] > DATA.upside_down) & _is_far(bare[1], whole[1])
            if not np.any(is_against | is_scaled):
                return []  # whatever the other parameter values give
        if not has_input:  # its starts alone move it, and these are free
            for theta in _variants(flat):
                is_against = is_against & ~(_mirrored(driven, part, theta) >= -DATA.upside_down)
    except DaestError:
        return []
    known = np.isfinite(np.stack(seen)[:, 0]).all(axis=0)
    return [*_against(part, is_against, int(known.sum())), *_scaled(part, is_scaled, seen[0][1])]


def _is_far(bare: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Whether the ratios (n_y,) are those of another unit, with and without the trend: of what bends where
    the model hardly does, the bend alone is many times as large."""
    far = np.log(DATA.other_scale)
    low, high = np.minimum(bare, whole), np.maximum(bare, whole)
    return (np.log(low) > far) | (np.log(high) < -far)


def _turned_inputs(flat: Model, driven: Any, part: Experiment) -> list[Contradiction]:
    """The one of several inputs without whose sign the model is far nearer to the recording, whatever its
    parameters are: of two that work against each other, as the voltages at both ends of a line do."""
    moving = np.flatnonzero(np.ptp(part.inputs, axis=0) > 0)[:MOST_PARAMETERS]
    if moving.size < 2:
        return []
    turned = {part.input_names[k]: Contradiction(part.input_names[k], -1.0, TURNED) for k in moving}
    try:
        for theta in _variants(flat):
            error, longest = _timed_error(driven, part, theta)
            turned = {
                name: one
                for name, one in turned.items()
                if _error_within(longest, driven, one.mended(part), theta) < error / DATA.other_scale
            }
            if not turned:
                return []
    except DaestError:
        return []
    return list(turned.values()) if len(turned) == 1 else []


def _timed_error(driven: Any, part: Experiment, theta: np.ndarray) -> tuple[float, float]:
    """The `_relative_error` of a recording as it is, and how long one of a changed recording may take [s]."""
    began = time.monotonic()
    error = _relative_error(driven, part, theta)
    return error, max(PATIENCE * (time.monotonic() - began), 1.0)


def _error_within(longest: float, driven: Any, changed: Experiment, theta: np.ndarray) -> float:
    """The `_relative_error` of a recording that was changed; infinite where that takes longer than `longest`
    [s]: what nothing holds back any more, as a trailer that is pushed, is soon so fast that its simulation
    comes to no end."""
    with suppress(OutOfTimeError), until(time.monotonic() + longest):
        return _relative_error(driven, changed, theta)
    return np.inf


def _relative_error(driven: Any, experiment: Experiment, theta: np.ndarray) -> float:
    """What a simulation leaves of the outputs, as a share of what they do without a trend: the root of the
    mean square over those that move. Raises OutOfTimeError."""
    from daest.systems.simulation.simulate import simulate

    simulated = simulate(driven, experiment, theta=theta, tell=lambda _: check()).outputs
    shares = []
    for measured, values in zip(experiment.outputs.T, simulated.T, strict=True):
        known = np.isfinite(measured) & np.isfinite(values)
        moved = _without_trend(experiment.time[known], np.column_stack([measured, values])[known])
        spread = float(np.linalg.norm(moved[:, 0])) if known.sum() >= 3 else 0.0
        if spread > 0.0:
            shares.append(float(np.linalg.norm(moved[:, 0] - moved[:, 1])) / spread)
    return float(np.sqrt(np.mean(np.square(shares)))) if shares else np.nan


def _without_trend(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Columns (n, …) at the times (n,) without their straight lines: where they drift, they do so for other
    reasons than their inputs."""
    basis = np.vander(time - time[:1], 2)
    return values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]


@dataclass(frozen=True)
class OtherClock:
    """Another `unit` of time, of `seconds` each, in which the model may count what was read in seconds."""

    unit: str
    seconds: float

    def mended(self, experiment: Experiment) -> Experiment:
        """The experiment with its time in that unit."""
        return replace(experiment, time=experiment.time / self.seconds)


CLOCKS = (OtherClock("min", 60.0), OtherClock("h", 3600.0), OtherClock("d", 86400.0))


def other_clock(flat: Model, experiment: Experiment) -> OtherClock | None:
    """The unit of time with which a simulation at the values of the model is far nearer to the recording than
    in seconds; None where there is none. A model whose balances convert by numbers, as in
    `C/3600*der(T) = Q`, does not tell by its units that it counts hours."""
    part = experiment.first(LONGEST)
    with suppress(DaestError):
        driven, theta = _driven(flat), next(iter(_variants(flat)))
        error, longest = _timed_error(driven, part, theta)
        errors = {c: _error_within(longest, driven, c.mended(part), theta) for c in CLOCKS}
        best = min(CLOCKS, key=lambda clock: errors[clock])
        if errors[best] < DATA.nearer_clock * error:
            return best
    return None


@dataclass(frozen=True)
class Exchange:
    """Two inputs, or two outputs, whose columns may be one in place of the other; `is_of_one_unit`: both are
    read in the same unit, so that nothing but what they do tells them apart."""

    signals: tuple[str, str]
    is_of_one_unit: bool = True

    def mended(self, experiment: Experiment) -> Experiment:
        """The experiment with the columns of both exchanged."""
        one, other = self.signals

        def exchanged(names: Sequence[str], values: np.ndarray) -> np.ndarray:
            turned = {one: other, other: one}
            return values[:, [names.index(turned.get(name, name)) for name in names]]

        if one in experiment.input_names:
            return replace(experiment, inputs=exchanged(experiment.input_names, experiment.inputs))
        return replace(experiment, outputs=exchanged(experiment.output_names, experiment.outputs))


def exchanges(flat: Model, experiments: Sequence[Experiment]) -> list[Exchange]:
    """The pairs of inputs and of outputs that are recorded and change: those in the same unit, then those in
    two units of which a simulation at the values of the model is nearer with one in place of the other. An
    angle and its rate move alike, and nobody sees by their numbers which is which."""
    recorded: set[str] = set()
    for e in experiments:
        values = zip((*e.input_names, *e.output_names), (*e.inputs.T, *e.outputs.T), strict=True)
        recorded |= {name for name, column in values if np.nanstd(column) > 0.0}
    groups = ([v for v in variables if v.name in recorded] for variables in (flat.inputs, flat.outputs))
    every = [
        Exchange((a.name, b.name), a.unit == b.unit) for group in groups for a, b in combinations(group, 2)
    ]
    alike = [one for one in every if one.is_of_one_unit]
    return alike + _nearer(flat, experiments, [one for one in every if not one.is_of_one_unit])


def _nearer(flat: Model, experiments: Sequence[Experiment], pairs: Sequence[Exchange]) -> list[Exchange]:
    """Those of the `pairs` with which the first recording is nearer to a simulation at the values of the
    model, the nearest first; none where it cannot be simulated."""
    if not pairs:
        return []
    part, theta = experiments[0].first(LONGEST), flat.theta_values
    nearer: dict[Exchange, float] = {}
    with suppress(DaestError):
        driven = _driven(flat)
        error, longest = _timed_error(driven, part, theta)
        for one in pairs:
            with suppress(DaestError):  # a speed in place of an angle may be one of nothing
                nearer[one] = _error_within(longest, driven, one.mended(part), theta)
        return sorted((one for one in nearer if nearer[one] < error), key=nearer.__getitem__)
    return []


def all_mended(experiment: Experiment, found: Sequence[Contradiction]) -> Experiment:
    """The experiment without any of the contradictions."""
    for one in found:
        experiment = one.mended(experiment)
    return experiment


def _against(part: Experiment, is_against: np.ndarray, n_measured: int) -> list[Contradiction]:
    against = [name for name, found in zip(part.output_names, is_against, strict=True) if found]
    if len(against) == n_measured and len(against) > 1 and len(part.input_names) == 1:
        text = f"drives all {n_measured} outputs the other way than the model: probably its polarity"
        return [Contradiction(part.input_names[0], -1.0, text)]
    return [Contradiction(name, -1.0, f"moves against the model, {MOVED}") for name in against]


def _scaled(part: Experiment, is_scaled: np.ndarray, ratios: np.ndarray) -> Iterator[Contradiction]:
    for name, found, ratio in zip(part.output_names, is_scaled, ratios, strict=True):
        size = max(ratio, 1.0 / ratio) if found else np.nan
        unit = next((f for f in UNITS if abs(np.log(size / f)) < np.log(DATA.same_scale)), None)
        if unit is not None:
            times = f"{size:.3g} times as {'large' if ratio > 1.0 else 'small'}"
            factor = 1.0 / unit if ratio > 1.0 else unit
            yield Contradiction(name, factor, f"is {times} as in the model, {MOVED}, as {UNITS[unit]}")


def _variants(flat: Model) -> Iterator[np.ndarray]:
    """The parameter values of the model, then with each unknown one larger and smaller."""
    theta = flat.theta_values
    yield theta
    unknown = [i for i, p in enumerate(flat.parameters) if p.estimate][:MOST_PARAMETERS]
    for i in unknown:
        for factor in (DATA.moved_parameter, 1.0 / DATA.moved_parameter):
            changed = theta.copy()
            changed[i] *= factor
            yield changed


def _driven(flat: Model) -> Any:
    """The model in the form by which it is driven, made once; with events the start decides on it."""
    from daest.systems.reduction.reduce import dynamics

    return flat if isinstance(flat, FlatModel) and flat.events is not None else dynamics(flat)


def _mirrored(driven: Any, part: Experiment, theta: np.ndarray) -> np.ndarray:
    """Correlation of every measured output with the model's at `theta` where all states start at minus what
    they do, (n_y,); NaN where the model has no such start."""
    from daest.systems.simulation.simulate import simulate

    first = replace(part, time=part.time[:2], inputs=part.inputs[:2], outputs=part.outputs[:2])
    x0 = -simulate(driven, first, theta=theta).states[0]
    try:
        return _beside(driven, part, theta, x0)[0, 0]
    except DaestError:
        return np.full(len(part.output_names), np.nan)


def _beside(
    driven: Any, experiment: Experiment, theta: np.ndarray | None, x0: np.ndarray | None = None
) -> np.ndarray:
    """Correlation of every measured output with the simulated one, and how many times as large it is, without
    a trend and with it, (2, 2, n_y); NaN where one of them stands still."""
    from daest.systems.simulation.simulate import simulate

    simulated = simulate(driven, experiment, theta=theta, x0=x0).outputs
    pairs = zip(experiment.outputs.T, simulated.T, strict=True)
    return np.moveaxis(np.array([_correlations(experiment.time, *pair) for pair in pairs]), 0, -1)


def _correlations(time: np.ndarray, measured: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    """Correlation and ratio of the sizes, first without a trend, then without the mean alone, (2, 2)."""
    known = np.isfinite(measured) & np.isfinite(simulated)
    if known.sum() < 3:
        return np.full((2, 2), np.nan)
    both = np.column_stack([measured, simulated])[known]
    return np.array([_correlation(_without_trend(time[known], both)), _correlation(both - both.mean(axis=0))])


def _correlation(both: np.ndarray) -> tuple[float, float]:
    """Correlation of two columns (n, 2) and the ratio of their sizes."""
    sizes = np.linalg.norm(both, axis=0)
    if not sizes.min() > 0:
        return np.nan, np.nan
    return float(both[:, 0] @ both[:, 1] / np.prod(sizes)), float(sizes[0] / sizes[1])
