"""Where white noise may enter a nonlinear model along a trajectory: Theorem 3.1 at many points of it.

A verdict at one operating point says little where the coefficients of the constraints move: an entry that is
zero at the start may let a noise through into a differentiated equation later.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from daest.errors import DaestError, ModelError, NumericalError
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel
from daest.model.noise import NoiseAlong, NoisePlace, NoisePlaceAlong, NoiseReport
from daest.systems.integrate import Hold, interval_inputs
from daest.systems.linearize import is_affine_model, linearize
from daest.systems.noise import noise_report
from daest.systems.reduce import reduce_index
from daest.systems.redundant import good_everywhere
from daest.systems.simulate import simulate

POINTS = 25  # of the trajectory, the first and the last among them


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
    judged once. Raises what `simulate` raises, and NumericalError `noise-nowhere-regular` where the
    linearised model is singular at every point."""
    if is_affine_model(flat):
        report = noise_report(linearize(flat), at=at, tolerance=tolerance)
        return _gathered([(0.0, report)], (), same_everywhere=True)
    reports: list[tuple[float, NoiseReport]] = []
    unjudged: list[tuple[float, str]] = []
    for time, point in _operating_points(flat, recording, hold, points):
        try:
            reports.append((time, noise_report(linearize(flat, at=point), at=at, tolerance=tolerance)))
        except (ModelError, NumericalError) as error:
            unjudged.append((time, _first_line(error)))
    if not reports:
        raise NumericalError(
            "noise-nowhere-regular",
            f"the linearised model is singular at every point of the trajectory: {unjudged[0][1]}",
            remedy="check the parameters and the inputs; `daest linearize --at` shows one point",
        )
    return _gathered(reports, tuple(unjudged), same_everywhere=False)


def _first_line(error: DaestError) -> str:
    return error.what.splitlines()[0]


def _operating_points(
    flat: FlatModel, recording: Experiment | tuple[np.ndarray, np.ndarray], hold: Hold, points: int
) -> list[tuple[float, dict[str, float]]]:
    """Times, with the values of all unknowns, their derivatives and the inputs there. A derivative that would
    need more derivatives of an input than there are counts as zero."""
    # A noise that would be differentiated has no simulation, and none is needed here.
    explicit = good_everywhere(reduce_index(_without_noise(flat)))
    found = simulate(explicit, recording, hold=hold)
    first, _ = interval_inputs(explicit, found.time, found.inputs, hold)
    ubar = np.vstack([first, first[-1:]])
    n_u, w = found.inputs.shape[1], np.zeros(0)
    names = list(found.variable_names)
    result = []
    for k in np.unique(np.linspace(0, found.n_samples - 1, points).round().astype(int)):
        time = float(found.time[k])
        at = (found.states[k], found.inputs[k], ubar[k, n_u:], w, flat.theta_values, time)
        rates = np.nan_to_num(np.array(explicit.variable_derivatives(*at)).ravel())
        values = dict(zip(names, found.variables[k].tolist(), strict=True))
        values |= dict(zip(found.input_names, found.inputs[k].tolist(), strict=True))
        values |= {f"der({name})": float(rate) for name, rate in zip(names, rates, strict=True)}
        result.append((time, {**values, "time": time}))
    return result


def _without_noise(flat: FlatModel) -> FlatModel:
    parts = [flat.residual, flat.output_expressions, flat.initial_residual]
    quiet = ca.substitute(parts, [flat.w], [ca.SX.zeros(flat.w.numel())])
    residual, outputs, initial = quiet
    return replace(
        flat,
        noises=(),
        w=ca.SX(0, 1),
        residual=residual,
        output_expressions=outputs,
        initial_residual=initial,
    )


def _gathered(
    reports: list[tuple[float, NoiseReport]],
    unjudged: tuple[tuple[float, str], ...],
    *,
    same_everywhere: bool,
) -> NoiseAlong:
    def along(of: Callable[[NoiseReport], Sequence[NoisePlace]]) -> tuple[NoisePlaceAlong, ...]:
        rows = [[(time, place) for place in of(report)] for time, report in reports]
        return tuple(_place(list(column)) for column in zip(*rows, strict=True))

    exact = Counter(report.generic for _, report in reports if report.generic is not None).most_common(1)
    generic, generic_points = exact[0] if exact else (None, 0)
    return NoiseAlong(
        times=tuple(time for time, _ in reports),
        unjudged=unjudged,
        structures=tuple(sorted({(report.n_dynamic, report.index) for _, report in reports})),
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
