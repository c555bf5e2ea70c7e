"""The names, units and notes of an FMU as values of the toolchain."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from daest.errors import ConfigError, Place
from daest.fmu.description import EQUATION, INPUT, NOISE, OUTPUT, PARAMETER, UNKNOWN
from daest.fmu.layout import derivative_name
from daest.model.fmu import FmuModel, FmuVariable
from daest.model.parts import Equation, NoiseInput, Output, Parameter, Variable


def facts(variable: FmuVariable, kind: str) -> dict[str, Any]:
    """The content of a vendor annotation of daest; empty if there is none that can be read."""
    try:
        told = json.loads(variable.annotations.get(kind, "{}"))
    except (ValueError, RecursionError):
        return {}
    return told if isinstance(told, dict) else {}


def _place(told: dict[str, Any]) -> Place | None:
    place = told.get("place")
    return (
        Place(str(place["file"]), place.get("line"), place.get("column"))
        if isinstance(place, dict) and "file" in place
        else None
    )


def variable_of(variable: FmuVariable) -> Variable:
    """The FMU variable as a variable of a model."""
    told = facts(variable, UNKNOWN) or facts(variable, INPUT)
    start = None if told.get("without_start") else told.get("start", variable.start)
    return Variable(
        name=variable.name,
        unit=variable.unit,
        description=variable.description,
        start=float(start) if isinstance(start, (int, float)) else None,
        fixed=bool(told.get("fixed", False)),
        min=variable.min,
        max=variable.max,
        nominal=variable.nominal,
        is_flow=bool(told.get("flow", False)),
        state_select=told.get("state_select", "default"),
        place=_place(told),
    )


def inputs_and_noises(model: FmuModel) -> tuple[list[int], list[int], list[int]]:
    """Value references of inputs, of inputs that are derivatives of other inputs, and of white noises."""
    known = [model.variables[vr] for vr in model.inputs]
    names = {v.name for v in known}
    derivatives = {derivative_name(name, order) for name in names for order in range(1, len(names) + 2)}
    inputs: list[int] = []
    rates: list[int] = []
    noises: list[int] = []
    for variable in known:
        group = noises if facts(variable, NOISE) else rates if variable.name in derivatives else inputs
        group.append(variable.value_reference)
    return inputs, rates, noises


def noise_of(variable: FmuVariable) -> NoiseInput:
    """The FMU variable as a white noise of a model."""
    told = facts(variable, NOISE)
    intensity, estimate = told.get("intensity"), bool(told.get("estimate", False))
    return NoiseInput(variable.name, intensity, variable.unit, variable.description, estimate, _place(told))


def outputs_in_order(model: FmuModel) -> list[int]:
    """Outputs as the model lists them; the FMU lists those that are unknowns first."""
    return sorted(model.outputs, key=lambda vr: facts(model.variables[vr], OUTPUT).get("order", 0))


def output_of(variable: FmuVariable) -> Output:
    """The FMU variable as an output of a model."""
    told = facts(variable, OUTPUT)
    return Output(
        name=variable.name,
        unit=variable.unit,
        description=told.get("description", variable.description),
        noise_std=told.get("noise_std"),
        estimate_noise=not told.get("fixed_noise", False),
        place=_place(told),
    )


def parameters_of(model: FmuModel, values: Sequence[float]) -> tuple[Parameter, ...]:
    made = []
    for reference, value in zip(model.parameters, values, strict=True):
        variable = model.variables[reference]
        told = facts(variable, PARAMETER)
        made.append(
            Parameter(
                name=variable.name,
                value=float(value),
                unit=variable.unit,
                description=variable.description,
                min=variable.min,
                max=variable.max,
                nominal=variable.nominal,
                estimate=bool(told.get("estimate", False)),
                scale=told.get("scale", "auto"),
                place=_place(told),
            )
        )
    return tuple(made)


def declared(
    model: FmuModel,
    unknowns: Sequence[int],
    inputs: Sequence[int],
    noises: Sequence[int],
    outputs: Sequence[int],
    values: Sequence[float],
) -> dict[str, Any]:
    """What a model says of its signals, given by their references, and of its parameters at `values`: the
    fields unknowns, inputs, noises, outputs and parameters."""
    known = model.variables
    return {
        "unknowns": tuple(variable_of(known[vr]) for vr in unknowns),
        "inputs": tuple(variable_of(known[vr]) for vr in inputs),
        "noises": tuple(noise_of(known[vr]) for vr in noises),
        "outputs": tuple(output_of(known[vr]) for vr in outputs),
        "parameters": parameters_of(model, values),
    }


def explicit_equations(unknowns: Sequence[FmuVariable], n_states: int) -> tuple[Equation, ...]:
    """The equations of what the FMU computes: rates of the first unknowns, which are states, and values of
    the others."""
    rates = [rate_equation(v) for v in unknowns[:n_states]]
    return (*rates, *(Equation(f"{v.name} = g", "binding", v.name) for v in unknowns[n_states:]))


def equation_of(variable: FmuVariable) -> Equation:
    """The equation behind a residual variable; other tools tell its name and description alone."""
    told = facts(variable, EQUATION)
    if "text" not in told:
        return Equation(variable.description or f"{variable.name} = 0", "component", variable.name)
    return Equation(told["text"], told.get("kind", "component"), told.get("origin", ""), _place(told))


def rate_equation(state: FmuVariable) -> Equation:
    """The equation that gives the rate of a state."""
    return Equation(f"der({state.name}) = f", "component", state.name)


def point_notes(is_affine: bool, at: Mapping[str, float] | None) -> tuple[str, ...]:
    if is_affine or at is not None:
        return ()
    return (
        "The model is nonlinear: these are its matrices at the start values "
        "(--at gives another operating point).",
    )


def refuse_unknown_names(left: Mapping[str, float], model: FmuModel) -> None:
    """ConfigError `operating-point-unknown-name` if an operating point names what the FMU does not have."""
    if left:
        raise ConfigError(
            "operating-point-unknown-name",
            f"The operating point names {', '.join(sorted(left))}, which {model.model_name} does not have.",
            remedy="Use names of unknowns and inputs as `daest linearize` lists them, or `der(name)`.",
        )
