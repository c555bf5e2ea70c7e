"""FMUs without residuals: x' = f(x, u), 0 = z - g(x, u) over all continuous variables z."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daest.errors import FmuError
from daest.fmu import words
from daest.fmu.instance import Instance, open_instance
from daest.fmu.layout import derivative_name
from daest.fmu.points import DIFFERENCE_FLOOR, DIFFERENCE_NOISE, STEP, difference, point_value, probe_point
from daest.model.flat import Equation
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
    differences.
    """

    directional: np.ndarray | None
    differences: np.ndarray


def semi_explicit_form(model: FmuModel) -> SemiExplicitForm:
    inputs, input_rates, noises = words.inputs_and_noises(model)
    outputs = words.outputs_in_order(model)
    taken = {*model.states, *model.derivatives}
    residuals = {r.value_reference for r in model.manifest.residuals} if model.manifest else set()
    inner = [
        vr
        for vr, v in model.variables.items()
        if v.causality in ("local", "output")
        and v.variability == "continuous"
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
    model: FmuModel, theta: np.ndarray, at: Mapping[str, float] | None, allow_directional: bool
) -> LinearDAE:
    """The linear DAE of x' = f, 0 = z - g. See `linearize_fmu`."""
    form = semi_explicit_form(model)
    x, u = _start_point(model, form, at)
    offer = allow_directional and model.provides_directional_derivatives
    with open_instance(model, (model.parameters, theta.tolist())) as instance:
        found = jacobians(instance, form, x, u, offer)
        far = _far_differences(instance, form)
        _go(instance, form, x, u)
        values = _values(instance, form)
    chosen, source, notes = _choose(found, offer)
    apart = np.inf if far is None else difference([found.differences], [far], DIFFERENCE_FLOOR)
    is_affine = apart <= DIFFERENCE_NOISE
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


def jacobians(
    instance: Instance, form: SemiExplicitForm, x: np.ndarray, u: np.ndarray, offer: bool
) -> Jacobians:
    """Both kinds of derivatives at a point; directional ones only where the FMU declares them."""
    differences = _differences(instance, form, x, u)
    directional = None
    if offer:
        _go(instance, form, x, u)
        unknowns = [*form.rates, *form.variables]
        try:
            columns = [instance.directional(unknowns, known) for known in (*form.states, *form.drivers)]
            directional = np.array(columns).reshape(len(columns), len(unknowns)).T
        except FmuError:
            directional = None  # refused for some variable: the differences stand for all
    return Jacobians(directional, differences)


def _choose(found: Jacobians, offer: bool) -> tuple[np.ndarray, str, tuple[str, ...]]:
    if found.directional is None:
        refused = "The FMU declares directional derivatives and refuses them: finite differences are used."
        return found.differences, "finite differences", (refused,) if offer else ()
    apart = difference([found.directional], [found.differences], DIFFERENCE_FLOOR)
    if not np.isfinite(apart) or apart > TRUST:
        note = (
            f"The FMU's directional derivatives are wrong (off by {apart:.1g}): finite differences are used."
        )
        return found.differences, "finite differences", (note,)
    return found.directional, "directional derivatives", ()


def _start_point(
    model: FmuModel, form: SemiExplicitForm, at: Mapping[str, float] | None
) -> tuple[np.ndarray, np.ndarray]:
    given = dict(at or {})

    def values(references: tuple[int, ...]) -> np.ndarray:
        return np.array(
            [point_value(given, model.variables[vr].name, model.variables[vr].start) for vr in references]
        )

    x, u = values(form.states), values(form.inputs)
    # Other variables follow from x and u; naming them in an operating point is no mistake.
    known = {v.name for v in model.variables.values()} | {
        derivative_name(v.name) for v in model.variables.values()
    }
    words.refuse_unknown_names({name: value for name, value in given.items() if name not in known}, model)
    return x, np.concatenate([u, np.zeros(len(form.noises))])


def _go(instance: Instance, form: SemiExplicitForm, x: np.ndarray, u: np.ndarray) -> None:
    instance.set(form.drivers, u)
    instance.set_states(x)


def _values(instance: Instance, form: SemiExplicitForm) -> np.ndarray:
    """(ẋ, z): variables are read before the derivatives, because some tools leave aliases of states stale."""
    z = instance.get(form.variables)
    return np.concatenate([instance.rates(), z])


def _differences(instance: Instance, form: SemiExplicitForm, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    references = (*form.states, *form.drivers)
    nominal = [instance.model.variables[vr].nominal or 1.0 for vr in references]
    point = np.concatenate([x, u])
    columns = []
    for i, size in enumerate(nominal):
        step = STEP * max(abs(point[i]), abs(size))
        sides = []
        for side in (point[i] + step, point[i] - step):
            moved = point.copy()
            moved[i] = side
            _go(instance, form, moved[: x.size], moved[x.size :])
            sides.append(_values(instance, form))
        columns.append((sides[0] - sides[1]) / ((point[i] + step) - (point[i] - step)))
    return np.array(columns).reshape(len(columns), len(form.rates) + len(form.variables)).T


def _far_differences(instance: Instance, form: SemiExplicitForm) -> np.ndarray | None:
    """The same differences at a far point, to see whether the model is affine; None where it cannot be
    evaluated.
    """
    try:
        found = _differences(
            instance, form, probe_point(len(form.states), 1), probe_point(len(form.drivers), 2)
        )
    except FmuError:
        return None
    return found if np.isfinite(found).all() else None


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
    names = [v.name for v in unknowns]
    equations = [words.rate_equation(v) for v in unknowns[:n_x]]
    equations += [Equation(f"{name} = g", "binding", name) for name in names[n_x:]]
    return LinearDAE(
        equations=tuple(equations),
        unknowns=tuple(words.variable_of(v) for v in unknowns),
        inputs=tuple(words.variable_of(model.variables[vr]) for vr in form.inputs),
        noises=tuple(words.noise_of(model.variables[vr]) for vr in form.noises),
        outputs=tuple(words.output_of(model.variables[vr]) for vr in form.outputs),
        parameters=words.parameters_of(model, theta.tolist()),
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
