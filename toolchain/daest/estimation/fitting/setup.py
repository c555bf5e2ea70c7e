"""What is fitted, whatever predicts: unknown parameters, recordings, and which noises are known.

What makes an identification impossible is found before the search starts: bounds, recordings, parameters
without influence, and equations that jump with the state (derivatives say nothing about a jump, and no search
could see one).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import EstimationError
from daest.estimation.fitting.coordinates import (
    Coordinate,
    Unknowns,
    coordinate_with_prior,
    parameter_coordinate,
)
from daest.estimation.fitting.identifiability import flat_directions, without_influence
from daest.estimation.fitting.records import in_model_order, n_observed, part_of
from daest.estimation.fitting.search import Evaluation
from daest.estimation.fitting.signals import is_constant
from daest.estimation.gates import FIT
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions, Method, NoiseChoice
from daest.model.flat import FlatModel
from daest.model.holds import checked_hold
from daest.model.linear import StateSpaceFamily
from daest.model.parts import prior_unused
from daest.near import near_names

NO_INFLUENCE = "identify-no-influence"
FIRST = 3  # samples, of which at most one is wrong


def known_name(name: str, known: Sequence[str], what: str) -> int:
    """Index of `name`; error `unknown-parameter`, `unknown-noise` or `unknown-output` with the nearest
    names.
    """
    if name in known:
        return known.index(name)
    near = near_names(name, known, n=3)
    raise EstimationError(
        f"unknown-{what}",
        f"the model has no {what} named {name}",
        where=name,
        remedy=f"did you mean {', '.join(near)}?" if near else f"it has: {', '.join(known) or 'none'}",
    )


def check_bounds(coordinate: Coordinate) -> None:
    """Error `start-outside-bounds`."""
    if coordinate.lower <= coordinate.initial <= coordinate.upper:
        return
    raise EstimationError(
        "start-outside-bounds",
        f"the start value {coordinate.initial:.6g} of {coordinate.name} lies outside its bounds "
        f"[{coordinate.lower:.6g}, {coordinate.upper:.6g}]",
        where=coordinate.name,
        remedy="give another start value, or other bounds (min, max)",
    )


def check_records(family: StateSpaceFamily, records: Sequence[Experiment], n_unknowns: int) -> None:
    """Of recordings in the order of the model. Errors `identify-no-data`, `identify-no-output`,
    `identify-too-few-samples`, `identify-constant-input`.
    """
    if not records:
        raise EstimationError(
            "identify-no-data", "there is no recording to identify from", remedy="name a data file"
        )
    where = ", ".join(r.name for r in records)
    n_measured = n_observed(records)
    if n_measured == 0:
        names = ", ".join(family.output_names) or "none"
        raise EstimationError(
            "identify-no-output",
            f"no output of the model has a single measured value; its outputs are: {names}",
            where=where,
            remedy="map a column to an output ([data] outputs), or check the empty cells",
        )
    n_states = len(family.state_names)
    needed = n_unknowns + n_states * len(records)
    if n_measured <= needed:
        raise EstimationError(
            "identify-too-few-samples",
            f"{n_measured} measured values for {needed} unknowns ({n_unknowns} parameters and noises, "
            f"{n_states} initial states per recording)",
            where=where,
            remedy="use a longer recording, or estimate fewer parameters",
        )
    n_inputs = len(family.inputs)
    is_still = n_inputs and all(is_constant(r.inputs[:, j]) for r in records for j in range(n_inputs))
    if is_still and not any(_settles(r.outputs) for r in records):
        names = ", ".join(family.input_names)
        raise EstimationError(
            "identify-constant-input",
            f"the input {names} is constant, and the outputs do not settle from another state: nothing "
            "that is recorded moves the model",
            where=where,
            remedy="record with a varying input, or from before a step on; for a free motion, use a model "
            "without that input",
        )


def check_start(
    unknowns: Unknowns, start: Evaluation | None, n_observed: int, piece: Evaluation | None = None
) -> None:
    """Errors `identify-no-start`, `identify-no-influence`, `identify-unidentifiable`.

    A `piece` of the same data must agree that a direction is flat.
    """
    if start is None:
        raise no_start()
    names = [c.name for c in unknowns.coordinates]
    dead = without_influence(start.information, n_observed)
    if np.any(dead):
        text = ", ".join(name for name, is_dead in zip(names, dead, strict=True) if is_dead)
        raise EstimationError(
            NO_INFLUENCE,
            f"no measured output depends on {text}, or free initial states do all that it does",
            where=text,
            remedy="fix it to a known value (--fix), measure an output that it moves, or start where it acts "
            "(--set)",
        )
    involved = changing_together(unknowns, start, piece)
    if involved:
        raise EstimationError(
            "identify-unidentifiable",
            f"{', '.join(involved)} can change together without any effect on the measured outputs",
            where=", ".join(involved),
            remedy="fix one of them to a known value (--fix NAME=VALUE)",
        )


def changing_together(
    unknowns: Unknowns, start: Evaluation, piece: Evaluation | None = None
) -> tuple[str, ...]:
    """Unknowns that can change together without any effect on the outputs; none where there are none. A
    `piece` of the same data must agree that a direction is flat."""
    flat = flat_directions(start.information)
    if not flat.shape[1] or (piece is not None and not flat_directions(piece.information).shape[1]):
        return ()
    # By what each does to the outputs: a friction of next to nothing changes by far more than the others.
    direction = np.abs(flat[:, 0]) * np.sqrt(np.diagonal(start.information))
    names = [c.name for c in unknowns.coordinates]
    return tuple(n for n, w in zip(names, direction, strict=True) if w > 1e-3 * np.max(direction))


def no_start(reason: str = "") -> EstimationError:
    """Error `identify-no-start`; `reason` is what the integrator said."""
    return EstimationError(
        "identify-no-start",
        "the model cannot be simulated at the start values: "
        + (reason or "it fails, or its outputs are not finite"),
        remedy="check the start values of parameters and states; smooth discontinuities with a width; "
        "an unstable model falls away from its record (pem with a noise of its process leans on that)",
    )


def _settles(outputs: np.ndarray) -> bool:
    """Whether an output (n_samples, n_y) moves much less in the second half of a recording, or begins far
    from where it is then: what follows a step before its first sample, or a release. A short way counts
    little beside the noise of a long rest, and one wrong sample is none."""
    late = outputs[len(outputs) // 2 :]
    return any(_calms(part, whole) for part, whole in zip(late.T, outputs.T, strict=True))


def _calms(late: np.ndarray, whole: np.ndarray) -> bool:
    known = whole[np.isfinite(whole)]
    if np.isfinite(late).sum() <= 1:
        return False
    spread = float(np.nanstd(late))
    begins_off = abs(float(np.median(known[:FIRST])) - float(np.nanmean(late))) > FIT.settled_start * spread
    return begins_off or spread < FIT.settled_share * float(np.nanstd(whole))


POINTS = 5  # random points on each switching surface
NEWTON = 20  # steps onto it
NEAR, NEARER = 1e-5, 1e-8  # distances from it, in units of the random points; a jump is the same at both


def check_jumps(flat: FlatModel) -> None:
    """Error `identify-jump` for the first equation whose residual jumps where the unknowns pass some surface.

    Comparisons, sign, floor and ceil whose arguments contain unknowns are tried; those that only bend the
    equation (an absolute value, a limit) are left alone, and so are jumps in time or with an input, also
    where variables of components hand it on. What is no jump once equations without derivatives hold, as
    `sign(d)*sqrt(abs(a - b))` beside `d = a - b`, is none.
    """
    driven = _driven_variables(flat)
    unknowns = ca.vertcat(flat.derivatives, flat.xi[np.flatnonzero(~driven).tolist()])
    others = ca.vertcat(flat.u, flat.w, flat.time, flat.xi[np.flatnonzero(driven).tolist()])
    expressions = ca.vertcat(flat.residual, flat.output_expressions)
    surfaces = [g for g in _switches(expressions) if ca.depends_on(g, unknowns)]
    if not surfaces:
        return
    residual = ca.Function("residual", [unknowns, others, flat.theta], [expressions])
    moved = set(ca.jacobian_sparsity(flat.residual, flat.derivatives).get_triplet()[0])
    still = np.array([row for row in range(flat.residual.numel()) if row not in moved], dtype=int)

    @cache  # most models have no such point
    def slopes() -> ca.Function:
        return ca.Function("slopes", [unknowns, others, flat.theta], [ca.jacobian(expressions, unknowns)])

    rng = np.random.default_rng(0)
    for g in surfaces:
        surface = ca.Function("surface", [unknowns, others, flat.theta], [g, ca.gradient(g, unknowns)])
        for _ in range(POINTS):
            v = rng.standard_normal(unknowns.numel())
            rest = np.abs(rng.standard_normal(others.numel()))
            rows = _jumping_rows(surface, residual, v, rest, flat.theta_values)
            held = np.setdiff1d(still, rows)
            if rows.size and held.size:
                rows = _jumping_where_held(
                    surface, residual, slopes(), (v, rest, flat.theta_values), rows, held
                )
            if rows.size:
                raise _jump(flat, int(rows[0]))


def _driven_variables(flat: FlatModel) -> np.ndarray:
    """Which of ξ inputs, time and parameters alone give, (n,) bool: an input that connections hand on, and
    what is computed of it.

    An equation without derivatives and with one variable that is not known yet gives that one.
    """
    n = flat.xi.numel()
    moved = set(ca.jacobian_sparsity(flat.residual, flat.derivatives).get_triplet()[0])
    moved |= set(ca.jacobian_sparsity(flat.residual, flat.w).get_triplet()[0])
    open_in: dict[int, set[int]] = {}
    for row, column in zip(*ca.jacobian_sparsity(flat.residual, flat.xi).get_triplet(), strict=True):
        if row not in moved:
            open_in.setdefault(row, set()).add(column)
    rows_of: dict[int, list[int]] = {}
    for row, columns in open_in.items():
        for column in columns:
            rows_of.setdefault(column, []).append(row)
    driven = np.zeros(n, dtype=bool)
    waiting = [row for row, columns in open_in.items() if len(columns) == 1]
    while waiting:
        for column in open_in[waiting.pop()]:
            driven[column] = True
            for row in rows_of[column]:
                open_in[row] = open_in[row] - {column}
                if len(open_in[row]) == 1:
                    waiting.append(row)
    return driven


def _jumping_rows(
    surface: ca.Function, residual: ca.Function, v: np.ndarray, rest: np.ndarray, theta: np.ndarray
) -> np.ndarray:
    """Rows of the residual that differ on both sides of the surface, however close."""
    for _ in range(NEWTON):
        g, slope = (np.array(part).ravel() for part in surface(v, rest, theta))
        size = float(slope @ slope)
        if not np.isfinite(size) or size == 0.0:
            return np.zeros(0, dtype=int)
        v = v - g[0] * slope / size
    return _differing(residual, v, slope / np.sqrt(size), rest, theta)


def _jumping_where_held(
    surface: ca.Function,
    residual: ca.Function,
    slopes: ca.Function,
    at: tuple[np.ndarray, np.ndarray, np.ndarray],
    rows: np.ndarray,
    held: np.ndarray,
) -> np.ndarray:
    """Those of the `rows` that differ on both sides of the surface where the residuals `held` (n,) are zero;
    all of them where no such point of it is found. `at`: unknowns, others and θ, of which the unknowns
    move."""
    v, rest, theta = at
    for _ in range(NEWTON):
        g, slope = (np.array(part).ravel() for part in surface(v, rest, theta))
        left = np.array(residual(v, rest, theta)).ravel()[held]
        by_unknown = np.array(slopes(v, rest, theta).full())[held]
        if not all(np.isfinite(part).all() for part in (slope, left, by_unknown)):
            return rows
        v = v - np.linalg.pinv(np.vstack([slope, by_unknown])) @ np.concatenate([g, left])
    if abs(g[0]) + np.abs(left).max() > NEARER:
        return rows
    across = slope - np.linalg.pinv(by_unknown) @ (by_unknown @ slope)
    size = np.linalg.norm(across)
    if size <= NEARER * np.linalg.norm(slope):  # the equations let nothing pass it
        return np.zeros(0, dtype=int)
    return np.intersect1d(rows, _differing(residual, v, across / size, rest, theta))


def _differing(
    residual: ca.Function, v: np.ndarray, across: np.ndarray, rest: np.ndarray, theta: np.ndarray
) -> np.ndarray:
    """Rows of the residual that differ on both sides of v, along `across`, however close."""

    def difference(distance: float) -> np.ndarray:
        sides = [np.array(residual(v + s * distance * across, rest, theta)).ravel() for s in (1.0, -1.0)]
        return np.abs(sides[0] - sides[1])

    near, nearer = difference(NEAR), difference(NEARER)
    return np.flatnonzero((nearer > FIT.least_jump) & (nearer > FIT.jump_kept * near))


def _switches(expressions: ca.SX) -> Iterator[Any]:
    """Scalar expressions whose zeros may be jumps of `expressions`."""
    stack: list[Any] = list(expressions.elements())
    seen = set()
    while stack:
        node = stack.pop()
        if node.element_hash() in seen:
            continue
        seen.add(node.element_hash())
        inner = [node.dep(i) for i in range(node.n_dep())]
        stack += inner
        operation = node.op() if inner else None
        if operation == ca.OP_SIGN:
            yield inner[0]
        elif operation in (ca.OP_LT, ca.OP_LE):
            yield inner[0] - inner[1]
        elif operation in (ca.OP_FLOOR, ca.OP_CEIL):
            yield ca.sin(np.pi * inner[0])


def _jump(flat: FlatModel, row: int) -> EstimationError:
    n = len(flat.equations)
    where = flat.equations[row].text if row < n else f"output {flat.outputs[row - n].name}"
    place = flat.equations[row].place if row < n else None
    return EstimationError(
        "identify-jump",
        f"`{where}` jumps as the model moves: no derivative tells how a parameter moves the moment of a jump",
        where=place,
        remedy="round the jump over a width that is small beside the motion, as tanh(w/width) for sign(w); "
        "the effects of the library are rounded",
    )


@dataclass(frozen=True)
class Setup:
    """`unknowns` are parameters alone; the recordings have the model's order of signals. `intensity` (n_w,)
    and `std` (n_y,) are those of the noises, NaN where unknown, with those that are estimated, (n_w,) and
    (n_y,) bool. `notes` are what the user is told besides."""

    unknowns: Unknowns
    experiments: tuple[Experiment, ...]
    method: Method
    intensity: np.ndarray
    estimate_intensity: np.ndarray
    std: np.ndarray
    estimate_std: np.ndarray
    options: IdentifyOptions
    validation: tuple[Experiment, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def given_std(self) -> np.ndarray:
        """(n_y,), NaN where estimated."""
        return np.where(self.estimate_std, np.nan, self.std)

    @property
    def has_free_size(self) -> bool:
        """Whether all noises can grow by a common factor."""
        held = self.intensity[~self.estimate_intensity]
        return bool(np.all(np.isnan(self.given_std)) and np.all(np.nan_to_num(held) == 0.0))

    @property
    def n_observed(self) -> int:
        """Measured values of all recordings."""
        return n_observed(self.experiments)


def setup_of(
    family: StateSpaceFamily,
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    options: IdentifyOptions,
) -> Setup:
    """The choices of the model, overruled by the options. Raises EstimationError and DataError of unknown
    names, bounds, priors, and recordings that are missing or too short."""
    options = replace(options, hold=checked_hold(options.hold, family.input_names))
    estimated, held_back = _divided(tuple(experiments), tuple(validation), options.split)
    recordings = tuple(in_model_order(e, family) for e in estimated)
    intensity, process = _noise_choices(
        family.noise_names,
        [NoiseChoice(n.intensity, n.estimate or n.intensity is None) for n in family.noises],
        options.process_noise,
        "noise",
    )
    std, measurement = _noise_choices(
        family.output_names,
        [NoiseChoice(o.noise_std, o.estimate_noise or o.noise_std is None) for o in family.outputs],
        options.measurement_noise,
        "output",
    )
    method: Method = options.method or ("pem" if family.noises else "oe")
    measured = np.array(
        [any(np.isfinite(e.outputs[:, j]).any() for e in recordings) for j in range(std.size)], dtype=bool
    )
    std = np.where(~measured & np.isnan(std), 1.0, std)
    unknowns = _unknowns(family, options, np.where(np.isnan(std), 1.0, std))
    n_noises = int(np.sum(measurement & measured)) + (int(np.sum(process)) if method == "pem" else 0)
    check_records(family, recordings, len(unknowns.coordinates) + n_noises)
    silent = [o.name for o, m in zip(family.outputs, measured, strict=True) if not m]
    return Setup(
        unknowns,
        recordings,
        method,
        intensity,
        process,
        std,
        measurement & measured,
        options,
        tuple(in_model_order(e, family) for e in held_back),
        tuple(f"output {name} has no measured value" for name in silent),
    )


def _divided(
    experiments: tuple[Experiment, ...], validation: tuple[Experiment, ...], split: float | None
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:
    """Estimation and validation records; error `split-out-of-range`."""
    if split is None:
        return experiments, validation
    if not 0.0 < split < 1.0:
        raise EstimationError(
            "split-out-of-range",
            f"the split {split:g} leaves nothing to estimate from or nothing to validate with",
            remedy="give a number between 0 and 1",
        )
    cuts = [max(1, round(split * e.n_samples)) for e in experiments]
    first = tuple(part_of(e, 0, cut) for e, cut in zip(experiments, cuts, strict=True))
    rest = tuple(part_of(e, cut, e.n_samples) for e, cut in zip(experiments, cuts, strict=True))
    return first, (*rest, *validation)


def _unknowns(family: StateSpaceFamily, options: IdentifyOptions, std: np.ndarray) -> Unknowns:
    """The coordinates of the unknown parameters among all of them, with fixed and start values put in; `std`
    stands for the measurement noises until they are found."""
    known = family.parameter_names
    theta = np.array([p.value for p in family.parameters], dtype=float)
    for name, value in {**options.start, **options.fix}.items():
        theta[known_name(name, known, "parameter")] = value
    for name in options.bounds:
        known_name(name, known, "parameter")
    names = options.estimate
    if names is None:
        names = tuple(p.name for p in family.parameters if p.estimate)
    names = tuple(n for n in dict.fromkeys(names) if n not in options.fix)
    for name in options.prior:
        known_name(name, known, "parameter")
        if name not in names:
            raise prior_unused(name)
    indices = [known_name(n, known, "parameter") for n in names]
    if not names and not options.noises_alone:
        raise EstimationError(
            "identify-nothing-to-estimate",
            "no parameter is marked as unknown",
            remedy="mark it in the model (__Daest(estimate = true)) or in daest.toml ([parameters] "
            "NAME = { estimate = true }), or name it (--estimate NAME)",
        )
    coordinates = []
    for name, index in zip(names, indices, strict=True):
        parameter = family.parameters[index]
        bounds = options.bounds.get(name, (parameter.min, parameter.max))
        coordinate = parameter_coordinate(family, name, float(theta[index]), bounds)
        check_bounds(coordinate)
        coordinates.append(coordinate_with_prior(coordinate, options.prior.get(name, parameter.prior)))
    return Unknowns(tuple(coordinates), theta, np.zeros(len(family.noises)), std)


def _noise_choices(
    names: Sequence[str], defaults: Iterable[NoiseChoice], given: Mapping[str, NoiseChoice], what: str
) -> tuple[np.ndarray, np.ndarray]:
    """Values, NaN where unknown, and which are estimated, of the model overruled by the options."""
    choices = list(defaults)
    for name, choice in given.items():
        i = known_name(name, names, what)
        value = choices[i].value if choice.value is None else choice.value
        estimate = choices[i].estimate if choice.estimate is None else choice.estimate
        choices[i] = NoiseChoice(value, bool(estimate) or value is None)
    values = np.array([np.nan if c.value is None else c.value for c in choices], dtype=float)
    return values, np.array([bool(c.estimate) for c in choices], dtype=bool)
