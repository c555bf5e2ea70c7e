"""Where white noise may enter a nonlinear model along a trajectory: Theorem 3.1 at many points of it.

A verdict at one operating point says little where the coefficients of the constraints move: an entry that is
zero at the start may let a noise through into a differentiated equation later.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.errors import ModelError, NumericalError
from daest.model.experiment import Experiment, Simulation
from daest.model.flat import Dynamics, FlatModel
from daest.model.holds import Hold
from daest.model.noise import NoiseAlong, NoiseMode, NoisePlace, NoisePlaceAlong, NoiseReport
from daest.systems.events.modes import frozen, mode_slots, mode_text, without_noise
from daest.systems.linear.linearize import is_affine_model, linearize
from daest.systems.linear.noise import noise_report
from daest.systems.reduction.reduce import reduce_index
from daest.systems.reduction.redundant import good_everywhere
from daest.systems.simulation.integrate import interval_inputs
from daest.systems.simulation.simulate import simulate, simulate_modes

POINTS = 25  # of the trajectory, the first and the last among them
MOST_MODES = 40  # modes that are judged; those that occur first


def noise_along(
    flat: FlatModel,
    recording: Experiment | tuple[np.ndarray, np.ndarray],
    at: Sequence[int | str] = (),
    *,
    hold: Hold = "foh",
    tolerance: float | None = None,
    points: int = POINTS,
) -> NoiseAlong:
    """Verdicts on the equations and noises of `flat`, and on the places `at`, at points of its simulation
    under the inputs of `recording`.

    `at` and `tolerance` as in `noise_report`. Points are spread evenly over the samples. An affine model is
    judged once; one with events in each of its modes that occurs, at one point of it or more. Raises what
    `simulate` raises, and NumericalError `noise-nowhere-regular` where the linearised model is singular at
    every point. A recording given as arrays is time (n_samples,) [s] and inputs (n_samples, n_u)."""
    if flat.events is None and is_affine_model(flat):
        report = noise_report(linearize(flat), at=at, tolerance=tolerance)
        return _gathered([_Judged(0.0, 0, report)], (), same_everywhere=True)
    passed, visited = (
        _operating_points(flat, recording, hold, points)
        if flat.events is None
        else _points_of_modes(flat, recording, hold, points)
    )
    reports: list[_Judged] = []
    unjudged: list[tuple[float, str]] = []
    for point in passed:
        try:
            report = noise_report(linearize(point.flat, at=point.values), at=at, tolerance=tolerance)
        except (ModelError, NumericalError) as error:
            unjudged.append((point.time, error.what.splitlines()[0]))
        else:
            reports.append(_Judged(point.time, point.mode, report))
    if not reports:
        raise NumericalError(
            "noise-nowhere-regular",
            f"the linearised model is singular at every point of the trajectory: {unjudged[0][1]}",
            remedy="check the parameters and the inputs; `daest linearize --at` shows one point",
        )
    found = _gathered(reports, tuple(unjudged), same_everywhere=False)
    return replace(found, modes=tuple(_of_mode(i, mode, reports) for i, mode in enumerate(visited)))


@dataclass(frozen=True)
class _Point:
    """Where the model is linearised: `flat` is the smooth model of mode number `mode`."""

    time: float
    mode: int
    values: dict[str, float]
    flat: FlatModel


@dataclass(frozen=True)
class _Judged:
    time: float
    mode: int
    report: NoiseReport


@dataclass(frozen=True)
class _Mode:
    """A mode that occurs: in words, its share of the samples and the first time."""

    text: str
    share: float
    first_time: float


def _of_mode(number: int, mode: _Mode, reports: Sequence[_Judged]) -> NoiseMode:
    own = [one.report for one in reports if one.mode == number]
    forbidden = {i for report in own for i, place in enumerate(report.places) if not place.admissible}
    named = [p.name for report in own for p in (*report.annotated, *report.asked) if not p.admissible]
    return NoiseMode(
        mode=mode.text,
        share=mode.share,
        first_time=mode.first_time,
        structures=tuple(sorted({(report.n_dynamic, report.index) for report in own})),
        n_forbidden=len(forbidden),
        forbidden=tuple(dict.fromkeys(named)),
    )


def _operating_points(
    flat: FlatModel, recording: Experiment | tuple[np.ndarray, np.ndarray], hold: Hold, points: int
) -> tuple[list[_Point], list[_Mode]]:
    """Times, with the values of all unknowns, their derivatives and the inputs there. A derivative that would
    need more derivatives of an input than there are counts as zero."""
    # A noise that would be differentiated has no simulation, and none is needed here.
    explicit = good_everywhere(reduce_index(without_noise(flat)))
    found = simulate(explicit, recording, hold=hold)
    theta = np.tile(flat.theta_values, (found.n_samples, 1))
    return [_Point(float(found.time[k]), 0, _values(explicit, found, theta, k), flat) for k in
            _spread(found.n_samples, points)], []  # fmt: skip


def _spread(n: int, points: int) -> list[int]:
    return [int(k) for k in np.unique(np.linspace(0, n - 1, points).round().astype(int))]


def _points_of_modes(
    flat: FlatModel, recording: Experiment | tuple[np.ndarray, np.ndarray], hold: Hold, points: int
) -> tuple[list[_Point], list[_Mode]]:
    """The same of a model with events, at least one point in each mode that occurs; and these modes."""
    explicit, found, theta = simulate_modes(without_noise(flat), recording, hold=hold)
    slots = mode_slots(flat)
    _, first, number = np.unique(theta[:, slots], axis=0, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))  # as they occur
    number = order[number.ravel()]
    chosen = set(_spread(found.n_samples, points))
    first = np.sort(first)[:MOST_MODES]
    for i in range(first.size):
        rows = np.flatnonzero(number == i)
        chosen.add(int(rows[rows.size // 2]))
    modes = [
        _Mode(mode_text(flat, theta[k], slots), float(np.mean(number == i)), float(found.time[k]))
        for i, k in enumerate(first)
    ]
    smooth = [frozen(flat, theta[k]) for k in first]
    return [
        _Point(float(found.time[k]), int(number[k]), _values(explicit, found, theta, k), smooth[number[k]])
        for k in sorted(chosen)
        if number[k] < MOST_MODES
    ], modes


def _values(explicit: Dynamics, found: Simulation, theta: np.ndarray, k: int) -> dict[str, float]:
    """All unknowns, their derivatives, the inputs and the time at sample k."""
    u0, _ = interval_inputs(explicit, found.time, found.inputs, found.hold)
    row = min(k, len(u0) - 1)
    slopes = u0[row, found.inputs.shape[1] :] if len(u0) else np.zeros(0)
    time, names = float(found.time[k]), explicit.flat.unknown_names
    at = (found.states[k], found.inputs[k], slopes, np.zeros(0), theta[k], time)
    rates = np.nan_to_num(np.array(explicit.variable_derivatives(*at)).ravel())
    values = dict(zip(names, found.variables[k].tolist(), strict=False))
    values |= dict(zip(found.input_names, found.inputs[k].tolist(), strict=True))
    values |= {f"der({name})": float(rate) for name, rate in zip(names, rates, strict=True)}
    return {**values, "time": time}


def _gathered(
    reports: list[_Judged],
    unjudged: tuple[tuple[float, str], ...],
    *,
    same_everywhere: bool,
) -> NoiseAlong:
    def along(of: Callable[[NoiseReport], Sequence[NoisePlace]]) -> tuple[NoisePlaceAlong, ...]:
        rows = [[(one.time, place) for place in of(one.report)] for one in reports]
        return tuple(_place(list(column)) for column in zip(*rows, strict=True))

    exact = Counter(one.report.generic for one in reports if one.report.generic is not None).most_common(1)
    generic, generic_points = exact[0] if exact else (None, 0)
    return NoiseAlong(
        times=tuple(one.time for one in reports),
        unjudged=unjudged,
        structures=tuple(sorted({(one.report.n_dynamic, one.report.index) for one in reports})),
        places=along(lambda report: report.places),
        annotated=along(lambda report: report.annotated),
        asked=along(lambda report: report.asked),
        same_everywhere=same_everywhere,
        generic=generic,
        generic_points=generic_points,
    )


def _place(verdicts: list[tuple[float, NoisePlace]]) -> NoisePlaceAlong:
    """One place over the points."""
    forbidden = [(time, place) for time, place in verdicts if not place.admissible]
    start = verdicts[0][1]
    return NoisePlaceAlong(
        name=start.name,
        equations=start.equations,
        at_start=start.admissible,
        forbidden_share=len(forbidden) / len(verdicts),
        first_time=forbidden[0][0] if forbidden else None,
        verdict=forbidden[0][1] if forbidden else start,
        largest_norm=max(place.projection_norm for _, place in verdicts),
    )
