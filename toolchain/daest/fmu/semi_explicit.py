"""FMUs without residuals: x' = f(x, u), 0 = z - g(x, u) over all continuous variables z."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daest.errors import FmuError
from daest.fmu import words
from daest.fmu.layout import derivative_name
from daest.fmu.points import (
    DIFFERENCE_FLOOR,
    DIFFERENCE_NOISE,
    central_differences,
    difference,
    long_points,
    moved_points,
    point_value,
    probe_point,
)
from daest.fmu.runner import Evaluated, Points, Runner, refused, running
from daest.model.fmu import FmuModel
from daest.model.linear import LinearDAE

# Directional derivatives that differ from central differences by more than this, relative to their row, are
# taken for wrong: some FMUs return zeros without an error, or forget that an output is a state.
TRUST = 1e-4
# Above this number of internal variables only the outputs are kept.
MOST_VARIABLES = 2000


@dataclass(frozen=True)
class SemiExplicitForm:
    """Value references: states x, their derivatives, other continuous variables z, inputs u, outputs y."""

    states: tuple[int, ...]
    rates: tuple[int, ...]
    variables: tuple[int, ...]
    inputs: tuple[int, ...]
    noises: tuple[int, ...]
    outputs: tuple[int, ...]
    notes: tuple[str, ...]

    @property
    def drivers(self) -> tuple[int, ...]:
        """Inputs and noises: everything that can be set from outside."""
        return (*self.inputs, *self.noises)


@dataclass(frozen=True)
class Jacobians:
    """∂(ẋ, z)/∂(x, u, w) by the FMU's directional derivatives (None: not offered) and by central
    differences. `is_complete`: all of `directional` is the FMU's; else rows of internal variables, of which
    FMI promises none, are differences: it refuses them, or (OpenModelica) answers with those of another.
    """

    directional: np.ndarray | None
    differences: np.ndarray
    is_complete: bool = True


def semi_explicit_form(model: FmuModel) -> SemiExplicitForm:
    inputs, input_rates, noises = words.inputs_and_noises(model)
    outputs = words.outputs_in_order(model)
    taken = {*model.states, *model.derivatives}
    residuals = {r.value_reference for r in model.manifest.residuals} if model.manifest else set()
    inner = [
        vr
        for vr, v in model.variables.items()
        if v.causality in ("local", "output")
        and (v.variability == "continuous" or vr in outputs)
        and vr not in taken | residuals
        and (v.derivative_of is None or vr in outputs)
    ]
    notes: tuple[str, ...] = ()
    if len(inner) > MOST_VARIABLES:
        notes = (f"The FMU has {len(inner)} internal variables; only its outputs are kept.",)
        inner = [vr for vr in inner if vr in outputs]
    inner += [vr for vr in outputs if vr in model.derivatives]
    return SemiExplicitForm(
        model.states,
        model.derivatives,
        tuple(inner),
        (*inputs, *input_rates),
        tuple(noises),
        tuple(outputs),
        notes,
    )


def linearize_semi_explicit(
    model: FmuModel,
    theta: np.ndarray,
    at: Mapping[str, float] | None,
    allow_directional: bool,
    runner: Runner | None = None,
) -> LinearDAE:
    """The linear DAE of x' = f, 0 = z - g, by `runner` if it is given. See `linearize_fmu`. Raises FmuError
    `fmu-nothing-continuous`. Shapes: theta (n_theta,)."""
    form = semi_explicit_form(model)
    offer = allow_directional and model.provides_directional_derivatives
    refuse_hidden(model, "linear model")
    if not form.states and not form.variables:
        raise FmuError(
            "fmu-nothing-continuous",
            "The FMU has no continuous state, output or internal variable.",
            where=str(model.path),
            remedy="Export it with its continuous variables.",
        )
    changed = changed_parameters(model, theta)
    with running(model, runner) as worker:
        own = _own_start(worker, form, changed)  # before anything moves its states
        is_affine = is_affine_there(worker, form, changed)
        x, u = _start_point(model, form, at, None if is_affine else own)
        found, values = jacobians(worker, form, x, u, offer, changed)
    chosen, source, notes = _choose(found, offer)
    return _assemble(
        model,
        form,
        theta,
        chosen,
        values,
        (x, u),
        source,
        is_affine,
        (*form.notes, *notes, *words.point_notes(is_affine, at)),
    )


def refuse_hidden(model: FmuModel, what: str) -> None:
    """FmuError `fmu-co-simulation-only` for an FMU that has no states to be seen."""
    if model.kind == "co-simulation":
        raise FmuError(
            "fmu-co-simulation-only",
            "The FMU is for Co-Simulation only: it integrates its equations by itself and hides them; there "
            f"is no {what}.",
            where=str(model.path),
            remedy="Export it for Model Exchange; simulate, identify --method oe and compare work as it is.",
        )


def changed_parameters(model: FmuModel, theta: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
    """The parameters whose values differ from those that the FMU starts with, and these values (1, n)."""
    starts = [model.variables[vr].start for vr in model.parameters]
    pairs = zip(model.parameters, theta, starts, strict=True)
    changed = [(vr, value) for vr, value, start in pairs if value != (0.0 if start is None else start)]
    return tuple(vr for vr, _ in changed), np.array([[value for _, value in changed]])


def jacobians(
    runner: Runner,
    form: SemiExplicitForm,
    x: np.ndarray,
    u: np.ndarray,
    offer: bool,
    parameters: tuple[tuple[int, ...], np.ndarray],
) -> tuple[Jacobians, np.ndarray]:
    """Both kinds of derivatives at a point at time 0, and the values (ẋ, z) there; directional derivatives
    only where the FMU declares them. Raises FmuError where the FMU refuses the point."""
    differences, values, problem = _differences(runner, form, x, u, parameters)
    if not np.all(np.isfinite(values)) and problem is not None:
        raise refused(runner.model, problem)
    if not offer:
        return Jacobians(None, differences), values
    points = Points(form.drivers, u[None], x[None], np.zeros(1))
    references = (*form.rates, *form.variables)
    promised = np.isin(references, (*form.rates, *form.outputs))
    for rows in (np.ones_like(promised), promised):
        found = _directional(runner, form, points, np.array(references)[rows].tolist(), parameters)
        if found is not None:
            directional = differences.copy()
            directional[rows] = found
            return _without_wrong_inner(
                Jacobians(directional, differences, bool(rows.all())), promised
            ), values
    return Jacobians(None, differences), values


def _without_wrong_inner(found: Jacobians, promised: np.ndarray) -> Jacobians:
    """Differences in the rows that are not promised, where these are not what the FMU says they are."""
    assert found.directional is not None
    inner = ~promised
    apart = difference([found.directional[inner]], [found.differences[inner]], DIFFERENCE_FLOOR)
    if apart <= TRUST:
        return found
    mixed = np.where(promised[:, None], found.directional, found.differences)
    return Jacobians(mixed, found.differences, is_complete=False)


def _directional(
    runner: Runner,
    form: SemiExplicitForm,
    points: Points,
    unknowns: Sequence[int],
    parameters: tuple[tuple[int, ...], np.ndarray],
) -> np.ndarray | None:
    """Directional derivatives of the unknowns at one point; None where any is refused."""
    try:
        return runner.differentiate(
            points, unknowns, (*form.states, *form.drivers), parameters,
            settle=_settles(runner.model),
        )[0, 0]  # fmt: skip
    except FmuError as refusal:
        if refusal.code != "fmu-call-failed":
            raise
        return None


def _settles(model: FmuModel) -> bool:
    """Discrete variables must be made to fit a point only where there are events."""
    return model.n_event_indicators > 0


def _choose(found: Jacobians, offer: bool) -> tuple[np.ndarray, str, tuple[str, ...]]:
    if found.directional is None:
        told = "The FMU declares directional derivatives and refuses them: finite differences are used."
        return found.differences, "finite differences", (told,) if offer else ()
    apart = difference([found.directional], [found.differences], DIFFERENCE_FLOOR)
    if not np.isfinite(apart) or apart > TRUST:
        note = (
            f"The FMU's directional derivatives are wrong (off by {apart:.1g}): finite differences are used."
        )
        return found.differences, "finite differences", (note,)
    partly = "The FMU has no directional derivatives of internal variables: theirs are finite differences."
    return found.directional, "directional derivatives", () if found.is_complete else (partly,)


def _start_point(
    model: FmuModel, form: SemiExplicitForm, at: Mapping[str, float] | None, own: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """States and drivers to linearise at: what is given, else the states of the FMU's `own` start (None:
    their start values in the description), and start values of the inputs."""
    given = dict(at or {})

    def values(references: tuple[int, ...]) -> np.ndarray:
        return np.array(
            [point_value(given, model.variables[vr].name, model.variables[vr].start) for vr in references]
        )

    known_states = {model.variables[vr].name for vr in form.states} & given.keys()
    x, u = values(form.states), values(form.inputs)
    if own is not None:
        names = [model.variables[vr].name for vr in form.states]
        x = np.array([v if n in known_states else s for n, v, s in zip(names, x, own, strict=True)])
    # Other variables follow from x and u; naming them in an operating point is no mistake.
    known = {v.name for v in model.variables.values()} | {
        derivative_name(v.name) for v in model.variables.values()
    }
    words.refuse_unknown_names({name: value for name, value in given.items() if name not in known}, model)
    return x, np.concatenate([u, np.zeros(len(form.noises))])


def _own_start(
    runner: Runner, form: SemiExplicitForm, parameters: tuple[tuple[int, ...], np.ndarray]
) -> np.ndarray | None:
    """The states (n_x,) after the FMU's own initialisation: some descriptions tell none, or others. None
    where it has none that is finite."""
    nowhere = Points((), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1))
    found = runner.evaluate(nowhere, form.states, parameters).values[0, 0]
    return found if np.all(np.isfinite(found)) else None


def _differences(
    runner: Runner,
    form: SemiExplicitForm,
    x: np.ndarray,
    u: np.ndarray,
    parameters: tuple[tuple[int, ...], np.ndarray],
) -> tuple[np.ndarray, np.ndarray, str | None]:
    """∂(ẋ, z)/∂(x, u) by central differences, the values (ẋ, z) at the point, and what was refused."""
    references = (*form.states, *form.drivers)
    point = np.concatenate([x, u])
    moved = moved_points(point, [runner.model.variables[vr].nominal for vr in references])
    found, values = _values(runner, form, np.vstack([point, moved]), parameters, 0.0)
    return central_differences(moved, values[1:]), values[0], found.problem


def _values(
    runner: Runner,
    form: SemiExplicitForm,
    points: np.ndarray,
    parameters: tuple[tuple[int, ...], np.ndarray],
    time: float,
) -> tuple[Evaluated, np.ndarray]:
    """What was answered at points (x, u) (m, n_x + n_u), and (ẋ, z) there, (m, n_x + n_z)."""
    n_x, n_z = len(form.states), len(form.variables)
    found = runner.evaluate(
        Points(form.drivers, points[:, n_x:], points[:, :n_x], np.full(len(points), time)), form.variables,
        parameters, rates=True, settle=_settles(runner.model),
    )  # fmt: skip
    # Variables come first: some tools leave aliases of states stale once the derivatives are read.
    values = found.values[0]
    return found, np.hstack([values[:, n_z:], values[:, :n_z]])


def is_affine_there(
    runner: Runner,
    form: SemiExplicitForm,
    parameters: tuple[tuple[int, ...], np.ndarray],
    asked: Sequence[int] | None = None,
) -> bool:
    """Whether differences over long steps are the same at zero and at a far point and another time, and the
    values there what they predict: differences of an affine model are exact, however long. `asked` are rows
    of (rates, variables), None for all.

    A model that cannot be evaluated there, that crashes, or that announces events at times is not affine.
    """
    zero = (np.zeros(len(form.states)), np.zeros(len(form.drivers)))
    far = (probe_point(zero[0].size, 1), probe_point(zero[1].size, 2))
    try:
        here, origin = _long_differences(runner, form, zero, parameters, 0.0)
        there, values = _long_differences(runner, form, far, parameters, 1.0)
    except FmuError:
        return False
    if asked is not None:
        rows = list(asked)
        here, there, values, origin = here[rows], there[rows], values[rows], origin[rows]
    if not all(np.all(np.isfinite(m)) for m in (here, there, values, origin)):
        return False
    point = np.concatenate(far)
    sizes = np.abs(here) @ np.abs(point) + np.abs(origin)
    floor = max(DIFFERENCE_FLOOR * float(np.max(sizes, initial=0.0)), np.finfo(float).tiny)
    apart = np.abs(values - origin - here @ point) / np.maximum(sizes, floor)
    return bool(
        difference([here], [there], DIFFERENCE_FLOOR) <= DIFFERENCE_NOISE
        and np.max(apart, initial=0.0) <= DIFFERENCE_NOISE
    )


def _long_differences(
    runner: Runner,
    form: SemiExplicitForm,
    at: tuple[np.ndarray, np.ndarray],
    parameters: tuple[tuple[int, ...], np.ndarray],
    time: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Differences over steps of nominal size around a point (x, u), and the values at it: NaN where time
    events are announced."""
    point = np.concatenate(at)
    moved = long_points(point, [runner.model.variables[vr].nominal for vr in (*form.states, *form.drivers)])
    found, values = _values(runner, form, np.vstack([point, moved]), parameters, time)
    slopes = central_differences(moved, values[1:])
    # Values between events say nothing about what happens at one.
    return slopes, np.full_like(values[0], np.nan) if found.has_time_events else values[0]


def _assemble(
    model: FmuModel,
    form: SemiExplicitForm,
    theta: np.ndarray,
    jacobian: np.ndarray,
    values: np.ndarray,
    point: tuple[np.ndarray, np.ndarray],
    source: str,
    is_affine: bool,
    notes: tuple[str, ...],
) -> LinearDAE:
    """ξ = (x, z): E = diag(I, 0), J = [A 0; G -I], rows der(x) = f and z = g; y picks from ξ."""
    n_x, n_z, n_u = len(form.states), len(form.variables), len(form.inputs)
    n = n_x + n_z
    E, J = np.zeros((n, n)), np.zeros((n, n))
    E[:n_x, :n_x] = np.eye(n_x)
    J[:, :n_x] = jacobian[:, :n_x]
    J[n_x:, n_x:] = -np.eye(n_z)
    x, u = point
    offset = values - jacobian @ np.concatenate([x, u])
    columns = (*form.states, *form.variables)
    C = np.zeros((len(form.outputs), n))
    for row, reference in enumerate(form.outputs):
        C[row, columns.index(reference)] = 1.0
    unknowns = [model.variables[vr] for vr in columns]
    return LinearDAE(
        equations=words.explicit_equations(unknowns, n_x),
        **words.declared(model, columns, form.inputs, form.noises, form.outputs, theta.tolist()),
        E=E,
        J=J,
        K=jacobian[:, n_x : n_x + n_u],
        B=jacobian[:, n_x + n_u :],
        C=C,
        D=np.zeros((len(form.outputs), n_u)),
        H=np.zeros((len(form.outputs), len(form.noises))),
        offset=offset,
        output_offset=np.zeros(len(form.outputs)),
        source=source,  # type: ignore[arg-type]
        is_affine=is_affine,
        notes=notes,
    )
