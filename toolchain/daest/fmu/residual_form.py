"""E, J, K, B, C from the binary alone, through the residuals of fmi-ls-dae."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daest.errors import FmuError
from daest.fmu import words
from daest.fmu.layout import derivative_name
from daest.fmu.points import (
    AFFINE_TOLERANCE,
    DIFFERENCE_FLOOR,
    DIFFERENCE_NOISE,
    central_differences,
    difference,
    moved_points,
    point_value,
    probe_point,
)
from daest.fmu.runner import Points, Runner, refused, running
from daest.fmu.semi_explicit import changed_parameters, refuse_hidden
from daest.model.fmu import FmuModel
from daest.model.linear import LinearDAE


@dataclass(frozen=True)
class ResidualForm:
    """Value references of F(ξ', ξ, u, w, θ, t) = 0, y = h: `rates[j]` is that of ξ'_j, None for algebraic
    ξ_j.

    `explicit` are the states x whose derivatives the FMU computes itself (semi-explicit form x' = f).
    """

    unknowns: tuple[int, ...]
    rates: tuple[int | None, ...]
    explicit: tuple[int, ...]
    residuals: tuple[int, ...]
    inputs: tuple[int, ...]
    noises: tuple[int, ...]
    outputs: tuple[int, ...]


@dataclass(frozen=True)
class _Point:
    """Values of the unknowns ξ, their derivatives ξ' (0 for algebraic ones) and inputs u; noise is zero."""

    xi: np.ndarray
    rates: np.ndarray
    u: np.ndarray
    time: float


def residual_form(model: FmuModel) -> ResidualForm:
    """The DAE that the manifest describes. FmuError `fmu-dae-not-square` if it is not one."""
    manifest = model.manifest
    if manifest is None or not manifest.residuals:
        raise FmuError(
            "fmu-without-residuals",
            "The FMU carries no residuals (fmi-ls-dae).",
            where=str(model.path),
            remedy="Export it with daest, or take another source: `directional derivatives`.",
        )
    explicit = tuple(s for r in manifest.derivatives if (s := model.variables[r].derivative_of) is not None)
    rate_of = _rates(model) if not explicit else {}
    unknowns = tuple(sorted({*explicit, *rate_of, *manifest.algebraic} & set(model.variables)))
    inputs, _, noises = words.inputs_and_noises(model)
    form = ResidualForm(
        unknowns=unknowns,
        rates=tuple(rate_of.get(vr) for vr in unknowns),
        explicit=explicit,
        residuals=tuple(r.value_reference for r in manifest.residuals),
        inputs=tuple(inputs),
        noises=tuple(noises),
        outputs=tuple(words.outputs_in_order(model)),
    )
    missing = [r for r in form.residuals if r not in model.variables]
    if missing or len(form.residuals) + len(explicit) != len(unknowns):
        raise FmuError(
            "fmu-dae-not-square",
            f"The FMU has {len(form.residuals) + len(explicit)} equations for {len(unknowns)} unknowns.",
            where=str(model.path),
            remedy="Report it to the tool that wrote the FMU.",
        )
    return form


def _rates(model: FmuModel) -> dict[int, int]:
    """unknown -> its derivative, for the derivatives that the residuals depend on.

    Where the manifest does not tell dependencies, a derivative counts unless it belongs to another
    derivative.
    """
    assert model.manifest is not None
    told = [r.dependencies for r in model.manifest.residuals]
    found = {}
    for reference, variable in model.variables.items():
        base = variable.derivative_of
        if base is None or base not in model.variables:
            continue
        is_known = (
            any(reference in (known or ()) for known in told)
            if None not in told
            else model.variables[base].derivative_of is None
        )
        if is_known:
            found[base] = reference
    return found


def linearize_residuals(
    model: FmuModel, theta: np.ndarray, at: Mapping[str, float] | None, runner: Runner | None = None
) -> LinearDAE:
    """The linear DAE through the FMU's residuals, by `runner` if it is given. See `linearize_fmu`. Shapes:
    theta (n_theta,)."""
    form = residual_form(model)
    start = _start_point(model, form, at)
    refuse_hidden(model, "linear model")
    with running(model, runner) as worker:
        instance = _Residuals(worker, form, changed_parameters(model, theta))
        zero = _Point(
            np.zeros(len(form.unknowns)), np.zeros(len(form.unknowns)), np.zeros(len(form.inputs)), 0.0
        )
        matrices = _matrices_if_affine(instance, zero)
        is_affine = matrices is not None
        if matrices is None:
            matrices = _matrices(instance, start)
        offset, output_offset = _offsets(instance, zero if is_affine else start, matrices)
    E, J, K, B, C, D, H = matrices
    explicit = [model.variables[vr] for vr in form.explicit]
    equations = [words.equation_of(model.variables[vr]) for vr in form.residuals]
    return LinearDAE(
        equations=(*[words.rate_equation(v) for v in explicit], *equations),
        **words.declared(model, form.unknowns, form.inputs, form.noises, form.outputs, theta.tolist()),
        E=E,
        J=J,
        K=K,
        B=B,
        C=C,
        D=D,
        H=H,
        offset=offset,
        output_offset=output_offset,
        source="fmi-ls-dae",
        is_affine=is_affine,
        notes=words.point_notes(is_affine, at),
    )


def _start_point(model: FmuModel, form: ResidualForm, at: Mapping[str, float] | None) -> _Point:
    given = dict(at or {})
    names = [model.variables[vr] for vr in form.unknowns]
    xi = np.array([point_value(given, v.name, words.variable_of(v).start) for v in names])
    rates = np.array([point_value(given, derivative_name(v.name), None) for v in names])
    u = np.array(
        [point_value(given, model.variables[vr].name, model.variables[vr].start) for vr in form.inputs]
    )
    words.refuse_unknown_names(given, model)
    return _Point(xi, rates, u, 0.0)


@dataclass(frozen=True)
class _Residuals:
    """The FMU in DAE mode with its parameter values."""

    runner: Runner
    form: ResidualForm
    parameters: tuple[tuple[int, ...], np.ndarray]

    @property
    def model(self) -> FmuModel:
        return self.runner.model

    @property
    def set(self) -> tuple[int, ...]:
        """What a point sets: rates, unknowns, inputs, noises."""
        form = self.form
        rates = [r for r in form.rates if r is not None]
        return (*rates, *form.unknowns, *form.inputs, *form.noises)

    @property
    def read(self) -> tuple[int, ...]:
        """The right-hand sides of the states the FMU computes, then residuals, then outputs."""
        rates = [_rate_reference(self.model, s) for s in self.form.explicit]
        return (*rates, *self.form.residuals, *self.form.outputs)

    @property
    def sign(self) -> np.ndarray:
        """Rows are (-f; F; h)."""
        sign = np.ones(len(self.read))
        sign[: len(self.form.explicit)] = -1.0
        return sign

    def values_at(self, point: _Point) -> np.ndarray:
        """Values of `set`."""
        rates = [value for r, value in zip(self.form.rates, point.rates, strict=True) if r is not None]
        return np.concatenate([rates, point.xi, point.u, np.zeros(len(self.form.noises))])

    def points(self, rows: np.ndarray, time: float) -> Points:
        return Points(self.set, rows, np.zeros((len(rows), 0)), np.full(len(rows), time))

    def rows(self, values: np.ndarray, time: float) -> np.ndarray:
        """(-f; F; h) at every row of values of `set`. FmuError `fmu-call-failed`."""
        found = self.runner.evaluate(self.points(values, time), self.read, self.parameters, dae_mode=True)
        if found.problem is not None:
            raise refused(self.model, found.problem)
        return found.values[0] * self.sign

    def slopes(self, point: _Point) -> dict[int, np.ndarray]:
        """Known value reference -> the derivative of all rows with respect to it."""
        values = self.values_at(point)
        if self.model.provides_directional_derivatives:
            table = self.runner.differentiate(
                self.points(values[None], point.time), self.read, self.set, self.parameters, dae_mode=True
            )[0, 0]
            table = table * self.sign[:, None]
        else:
            moved = moved_points(values, [self.model.variables[vr].nominal for vr in self.set])
            table = central_differences(moved, self.rows(moved, point.time))
        return dict(zip(self.set, table.T, strict=True))


def _rate_reference(model: FmuModel, state: int) -> int:
    return next(vr for vr, v in model.variables.items() if v.derivative_of == state)


def _matrices(instance: _Residuals, point: _Point) -> tuple[np.ndarray, ...]:
    """E, J, K, B, C, D, H at a point."""
    form = instance.form
    slopes, n = instance.slopes(point), len(form.unknowns)

    def columns(references: Sequence[int | None]) -> np.ndarray:
        empty = np.zeros(n + len(form.outputs))
        found = [empty if r is None else slopes[r] for r in references]
        return np.array(found).reshape(len(found), empty.size).T

    E = columns(form.rates)[:n]
    for row, state in enumerate(form.explicit):
        E[row, form.unknowns.index(state)] = 1.0
    by_xi, by_u, by_w = columns(form.unknowns), columns(form.inputs), columns(form.noises)
    return E, 0.0 - by_xi[:n], 0.0 - by_u[:n], 0.0 - by_w[:n], by_xi[n:], by_u[n:], by_w[n:]


def _matrices_if_affine(instance: _Residuals, zero: _Point) -> tuple[np.ndarray, ...] | None:
    """The matrices at zero if they are the same at a far point and another time, else None."""
    n, n_u = len(instance.form.unknowns), len(instance.form.inputs)
    far = _Point(probe_point(n, 1), probe_point(n, 2), probe_point(n_u, 3), 1.0)
    try:
        here, there = _matrices(instance, zero), _matrices(instance, far)
    except FmuError:
        return None  # a model that cannot be evaluated at such points is not affine
    if not all(np.isfinite(m).all() for m in (*here, *there)):
        return None
    if instance.model.provides_directional_derivatives:
        is_same = difference(here, there) <= AFFINE_TOLERANCE
    else:
        is_same = difference(here, there, DIFFERENCE_FLOOR) <= DIFFERENCE_NOISE
    return here if is_same else None


def _offsets(
    instance: _Residuals, point: _Point, matrices: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """What is left of E ξ' = J ξ + K u + offset and y = C ξ + D u + output_offset when the signals are
    zero.
    """
    E, J, K, _, C, D, _ = matrices
    form = instance.form
    n = len(form.unknowns)
    rows = instance.rows(instance.values_at(point)[None], point.time)[0]
    known = np.zeros(
        n
    )  # the rates that stand in F; where the FMU computes x' itself, x' is not part of the row
    known[:] = np.where([r is not None for r in form.rates], point.rates, 0.0)
    return (
        E @ known - J @ point.xi - K @ point.u - rows[:n],
        rows[n:] - C @ point.xi - D @ point.u,
    )
