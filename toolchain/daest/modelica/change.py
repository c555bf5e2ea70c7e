"""Changes of a model that need no compiler: parameter values, declared outputs, estimated parameters,
noises."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import singledispatch
from typing import Any, TypeVar

import casadi as ca

from daest.errors import ModelError
from daest.model.flat import FlatModel, Model
from daest.model.parts import NoiseInput, Output, Parameter, Prior, prior_unused
from daest.modelica.places.place_names import resolve_place
from daest.near import did_you_mean

AnyModel = TypeVar("AnyModel", bound=Model)


def with_values(flat: AnyModel, values: Mapping[str, float]) -> AnyModel:
    """`flat` with new parameter values. Raises ModelError for a name that is no tunable parameter, and for a
    value outside of its min and max.

        >>> float(daest.with_values(flat, {"R": 5.0}).theta_values[4])
        5.0
    """
    for name in values:
        _tunable(flat, name)
    parameters = tuple(_set(p, values[p.name]) if p.name in values else p for p in flat.parameters)
    noises = tuple(
        replace(noise, intensity=float(values[noise.intensity_parameter]))
        if noise.intensity_parameter in values
        else noise
        for noise in flat.noises
    )
    outputs = tuple(
        replace(output, noise_std=float(values[output.noise_std_parameter]))
        if output.noise_std_parameter in values
        else output
        for output in flat.outputs
    )
    return replace(flat, parameters=parameters, noises=noises, outputs=outputs)


def _tunable(flat: Model, name: str) -> Parameter:
    for parameter in flat.parameters:
        if parameter.name == name and not parameter.is_memory:
            return parameter
    for derived in flat.derived_parameters:
        if derived.name == name:
            raise ModelError(
                "parameter-derived",
                f"parameter `{name}` is computed from `{derived.expression}`",
                where=derived.place,
                remedy="Set what it is computed from instead.",
            )
    known = [p.name for p in flat.parameters if not p.is_memory]
    computed = [p.name for p in flat.derived_parameters]
    hint = did_you_mean(name, known + computed)
    raise ModelError(
        "parameter-unknown",
        f"the model has no tunable parameter `{name}`",
        where=flat.source or None,
        remedy=f"{hint}Tunable: {', '.join(known) if known else 'none'}.",
    )


def _set(parameter: Parameter, value: float) -> Parameter:
    value = float(value)
    if not math.isfinite(value):
        raise _outside(parameter, f"{value} is not a finite number")
    if parameter.min is not None and value < parameter.min:
        raise _outside(parameter, f"{value:g} is below its min = {parameter.min:g}")
    if parameter.max is not None and value > parameter.max:
        raise _outside(parameter, f"{value:g} is above its max = {parameter.max:g}")
    return replace(parameter, value=value)


def _outside(parameter: Parameter, what: str) -> ModelError:
    return ModelError(
        "parameter-outside-bounds",
        f"parameter `{parameter.name}`: {what}",
        where=parameter.place,
        remedy="Choose a value inside, or change min and max in the model.",
    )


def with_choice(
    flat: AnyModel,
    estimate: Iterable[str] | None = None,
    fix: Iterable[str] = (),
    prior: Mapping[str, Prior] | None = None,
) -> AnyModel:
    """`flat` with another choice of the estimated parameters: `estimate` alone (None: those that are marked),
    without those of `fix`; `prior` takes the place of the model's.

    Raises ModelError for a name that is no tunable parameter, and EstimationError `prior-unused` for a prior
    on a parameter that is not estimated.
    """
    prior = dict(prior or {})
    wanted = {p.name for p in flat.parameters if p.estimate} if estimate is None else set(estimate)
    held = set(fix)
    for name in (*sorted(wanted), *held, *prior):
        _tunable(flat, name)
    for name in prior:
        if name not in wanted - held:
            raise prior_unused(name)
    parameters = tuple(
        replace(p, estimate=p.name in wanted - held, prior=prior.get(p.name, p.prior))
        for p in flat.parameters
    )
    return replace(flat, parameters=parameters)


def declare(
    flat: AnyModel,
    outputs: Sequence[str] | Mapping[str, str] | None = None,
    estimate: Iterable[str] | Mapping[str, bool] | None = None,
    noises: Mapping[str, float | None] | None = None,
    noise_std: Mapping[str, float | None] | None = None,
    estimate_noise: Mapping[str, bool] | None = None,
) -> AnyModel:
    """`flat` with what a project file says about it, in place of annotations.

    `outputs` are names of unknowns or of present outputs that are to be the outputs, in this order (a mapping
    gives each its new name: {name: unknown}). `estimate` marks parameters. `noises` maps a place (see
    `resolve_place`) to the intensity of a white noise on its equation, or the name of a present noise to its
    new intensity. `noise_std` maps outputs to the standard deviation of their measurement noise.
    `estimate_noise` maps outputs and noises (by name or place) to whether their size is estimated.
    Raises ModelError.

        >>> known = daest.declare(flat, estimate={"R": True, "d": False})
        >>> [p.name for p in known.parameters if p.estimate]
        ['c', 'J1', 'J2', 'R', 'k']
    """
    if outputs is not None:
        flat = with_outputs(flat, outputs)
    if estimate is not None:
        flat = _with_estimated(flat, estimate)
    if noises is not None:
        flat = with_noises(flat, noises)
    if noise_std is not None:
        flat = _with_noise_std(flat, noise_std)
    return flat if estimate_noise is None else _with_estimated_noise(flat, estimate_noise)


@singledispatch
def with_outputs(model: Model, outputs: Sequence[str] | Mapping[str, str]) -> Any:
    """The model with these outputs, in this order: present ones, or unknowns; {name: unknown} names them
    anew."""
    return replace(model, outputs=tuple(output for output, _ in found_outputs(model, outputs)))


@with_outputs.register
def _with_expressions(flat: FlatModel, outputs: Sequence[str] | Mapping[str, str]) -> FlatModel:
    found = found_outputs(flat, outputs)
    every = ca.vertcat(flat.output_expressions, flat.xi)
    rows = [row for _, row in found]
    return replace(
        flat,
        outputs=tuple(output for output, _ in found),
        output_expressions=every[rows] if rows else ca.SX(0, 1),
    )


def found_outputs(model: Model, outputs: Sequence[str] | Mapping[str, str]) -> list[tuple[Output, int]]:
    """The outputs, each with its row among the present outputs and then the unknowns. ModelError
    `output-unknown`."""
    pairs = outputs.items() if isinstance(outputs, Mapping) else [(name, name) for name in outputs]
    return [_output(model, name, source) for name, source in pairs]


def _output(flat: Model, name: str, source: str) -> tuple[Output, int]:
    for i, output in enumerate(flat.outputs):
        if output.name == source:
            return replace(output, name=name), i
    for i, unknown in enumerate(flat.unknowns):
        if unknown.name == source:
            return Output(name, unknown.unit, unknown.description, place=unknown.place), len(flat.outputs) + i
    known = flat.output_names + flat.unknown_names
    raise _no_such("output-unknown", "output", source, known, flat, "An output is a variable of the model.")


def _with_estimated(flat: AnyModel, estimate: Iterable[str] | Mapping[str, bool]) -> AnyModel:
    marks = dict(estimate) if isinstance(estimate, Mapping) else dict.fromkeys(estimate, True)
    for name in marks:
        _tunable(flat, name)
    parameters = tuple(replace(p, estimate=marks.get(p.name, p.estimate)) for p in flat.parameters)
    return replace(flat, parameters=parameters)


@singledispatch
def with_noises(model: Model, noises: Mapping[str, float | None]) -> Any:
    """The model with white noise of these intensities at its places, by name; None: of unknown size."""
    raise NotImplementedError(type(model).__name__)


@with_noises.register
def _in_equations(flat: FlatModel, noises: Mapping[str, float | None]) -> FlatModel:
    for place, intensity in noises.items():
        at = _noise_index(flat, place)
        if at is None:
            flat = _with_noise(flat, place, intensity)
        else:
            changed = replace(flat.noises[at], intensity=intensity, intensity_parameter="")
            flat = replace(flat, noises=(*flat.noises[:at], changed, *flat.noises[at + 1 :]))
    return flat


def _noise_index(flat: Model, name: str) -> int | None:
    return next((i for i, noise in enumerate(flat.noises) if noise.name in (name, noise_name(name))), None)


def noise_name(place: str) -> str:
    """The name of the noise that `declare` puts at a place."""
    return f"noise({place})"


def _with_noise(flat: FlatModel, place: str, intensity: float | None) -> FlatModel:
    """A new white noise w on the right of one equation: left - right = w."""
    found = resolve_place(flat, place)
    if len(found) != 1:
        listed = "\n".join(f"    {i}: {flat.equations[i].text}" for i in found)
        raise ModelError(
            "model-place",
            f"`{place}` means {len(found)} equations",
            remedy=f"Name one by its index:\n{listed}",
        )
    equation = flat.equations[found[0]]
    symbol = ca.SX.sym(noise_name(place))
    residual = ca.SX(flat.residual)
    residual[found[0]] = residual[found[0]] - symbol
    noise = NoiseInput(
        noise_name(place),
        intensity,
        _unit(flat, place),
        f"white noise on {equation.text}",
        place=equation.place,
    )
    return replace(flat, noises=(*flat.noises, noise), w=ca.vertcat(flat.w, symbol), residual=residual)


def _unit(flat: FlatModel, place: str) -> str:
    """The unit of a flow variable or connector, which its equation has too; unknown for other places."""
    for unknown in flat.unknowns:
        if unknown.is_flow and place in (unknown.name, unknown.name.rpartition(".")[0]):
            return unknown.unit
    return ""


def _with_noise_std(flat: AnyModel, noise_std: Mapping[str, float | None]) -> AnyModel:
    known = flat.output_names
    for name, std in noise_std.items():
        if name not in known:
            raise _no_such(
                "output-unknown", "output", name, known, flat, "Measurement noise belongs to an output."
            )
        if std is not None and not std > 0:
            raise ModelError(
                "noise-std",
                f"the standard deviation of `{name}` is {std:g}",
                where=flat.source or None,
                remedy="Give a positive number.",
            )
    outputs = tuple(
        replace(output, noise_std=noise_std[output.name], noise_std_parameter="")
        if output.name in noise_std
        else output
        for output in flat.outputs
    )
    return replace(flat, outputs=outputs)


def _with_estimated_noise(flat: AnyModel, marks: Mapping[str, bool]) -> AnyModel:
    known = flat.output_names + flat.noise_names
    for name in marks:
        if name not in known and _noise_index(flat, name) is None:
            raise _no_such("noise-unknown", "noise", name, known, flat, "Name an output or a noise.")
    outputs = tuple(replace(y, estimate_noise=marks.get(y.name, y.estimate_noise)) for y in flat.outputs)
    by_noise = {_noise_index(flat, name): mark for name, mark in marks.items()}
    noises = tuple(replace(w, estimate=by_noise.get(i, w.estimate)) for i, w in enumerate(flat.noises))
    return replace(flat, outputs=outputs, noises=noises)


def _no_such(code: str, kind: str, name: str, known: Sequence[str], flat: Model, hint: str) -> ModelError:
    return ModelError(
        code,
        f"the model has no {kind} `{name}`",
        where=flat.source or None,
        remedy=did_you_mean(name, known) + hint,
    )
