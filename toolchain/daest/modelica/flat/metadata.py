"""Names, units, bounds, start values and annotations of variables and parameters, as the values of
`model.flat`.

A fixed start value that depends on parameters, `x(start = x0, fixed = true)`, is the initial equation `x =
x0`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from daest.errors import ModelError
from daest.model.parts import DerivedParameter, NoiseInput, Output, Parameter, Variable
from daest.modelica.flat.parameters import number
from daest.modelica.flat.reading import Reading
from daest.modelica.flat.rows import Row
from daest.modelica.flat.scope import Element
from daest.modelica.language import syntax as s
from daest.modelica.language import values as v
from daest.modelica.language.expressions import split_path
from daest.modelica.language.parse import Annotation
from daest.modelica.language.text import text


def variable_of(element: Element, reading: Reading) -> Variable:
    """The declaration as a variable of a model."""
    variable = element.variable
    return Variable(
        name=element.name,
        unit=variable.unit,
        description=variable.description,
        start=_number(variable.start, element, reading),
        fixed=is_fixed(element),
        min=_number(variable.min, element, reading),
        max=_number(variable.max, element, reading),
        nominal=_number(variable.nominal, element, reading),
        is_flow=variable.is_flow,
        state_select=variable.state_select,
        place=reading.declared_at(variable),
    )


def is_fixed(element: Element) -> bool:
    """Whether the start value of the declaration is a condition."""
    fixed = element.variable.fixed
    return bool(fixed) and fixed[element.position if len(fixed) > 1 else 0]


def parameter_of(element: Element, value: float, reading: Reading) -> Parameter:
    """Bounds in the annotation go before those of the declaration. Raises ModelError when the value is
    outside."""
    variable = element.variable
    annotation = reading.annotations[variable.name]
    low = _annotated(annotation, "min", element, reading)
    high = _annotated(annotation, "max", element, reading)
    parameter = Parameter(
        name=element.name,
        value=value,
        unit=variable.unit,
        description=variable.description,
        min=low if low is not None else _number(variable.min, element, reading),
        max=high if high is not None else _number(variable.max, element, reading),
        nominal=_number(variable.nominal, element, reading),
        estimate=annotation.flag("estimate", False),
        scale=annotation.scale(),
        place=reading.declared_at(variable),
        null=_annotated(annotation, "null", element, reading),
    )
    _check_bounds(parameter)
    return parameter


def _check_bounds(parameter: Parameter) -> None:
    low, high, value = parameter.min, parameter.max, parameter.value
    if low is not None and high is not None and low > high:
        what = f"min = {low:g} is above max = {high:g}"
    elif low is not None and value < low:
        what = f"its value {value:g} is below its min = {low:g}"
    elif high is not None and value > high:
        what = f"its value {value:g} is above its max = {high:g}"
    else:
        return
    raise ModelError(
        "parameter-outside-bounds",
        f"parameter `{parameter.name}`: {what}",
        where=parameter.place,
        remedy="Change the value or the bounds.",
    )


def derived_of(name: str, variable: s.FlatVariable, expression: str, reading: Reading) -> DerivedParameter:
    """Raises ModelError when the annotation asks for an estimate of what its own declaration computes. Where
    a component or a derived class is given the formula, it takes the place of the value that was marked."""
    annotation = reading.annotations[variable.name]
    if annotation.flag("estimate", False) and annotation.is_of_formula:
        what = f"`{name}` is computed as `{expression}` and cannot be estimated"
        raise annotation.error("estimate", what, "Mark what it is computed from.")
    return DerivedParameter(
        name, expression, variable.unit, variable.description, reading.declared_at(variable)
    )


def noise_of(element: Element, reading: Reading) -> NoiseInput:
    """The declaration as a white noise of a model."""
    annotation = reading.annotations[element.variable.name]
    intensity = _annotated(annotation, "intensity", element, reading)
    if intensity is not None and not intensity >= 0:
        raise annotation.error(
            "intensity", f"intensity = {intensity:g} is negative", "Give a positive number."
        )
    return NoiseInput(
        name=element.name,
        intensity=intensity,
        unit=element.variable.unit,
        description=element.variable.description,
        estimate=annotation.flag("estimate", False),
        place=reading.declared_at(element.variable),
        intensity_parameter=_parameter_behind(annotation, "intensity", element, reading),
    )


def output_of(element: Element, reading: Reading) -> Output:
    """The declaration as an output of a model."""
    annotation = reading.annotations[element.variable.name]
    std = _annotated(annotation, "std", element, reading)
    if std is not None and not std > 0:
        raise annotation.error("std", f"std = {std:g} is not positive", "Give a positive number.")
    return Output(
        name=element.name,
        unit=element.variable.unit,
        description=element.variable.description,
        noise_std=std,
        estimate_noise=annotation.flag("estimate", True),
        place=reading.declared_at(element.variable),
        noise_std_parameter=_parameter_behind(annotation, "std", element, reading),
    )


def _number(node: s.Node | None, element: Element, reading: Reading) -> float | None:
    return number(node, element.position, reading.numeric, reading.evaluator, element.variable.span)


def _annotated(annotation: Annotation, key: str, element: Element, reading: Reading) -> float | None:
    """The number of an annotation entry; its names are those of the component that declares the variable."""
    node = annotation.entries.get(key)
    if node is None:
        return None
    seen = qualified(node, element.variable.name.rpartition(".")[0])
    try:
        return number(seen, element.position, reading.numeric, reading.evaluator, None)
    except ModelError as problem:
        raise annotation.error(key, problem.what, problem.remedy) from None


def _parameter_behind(annotation: Annotation, key: str, element: Element, reading: Reading) -> str:
    """The tunable parameter that alone gives an annotation's number; empty for a number or a formula."""
    node = annotation.entries.get(key)
    if not isinstance(node, s.Name):
        return ""
    name = text(qualified(node, element.variable.name.rpartition(".")[0]))
    value = reading.scope.path([(ident, tuple(indices)) for ident, indices in split_path(name)])
    return str(value.name()) if isinstance(value, ca.SX) and value.is_symbolic() else ""


def qualified(node: s.Node, component: str) -> s.Node:
    """The node with its names seen from the model: `intensity` of component `noise` -> `noise.intensity`."""
    if not component:
        return node
    made = s.rebuilt(node, lambda part: qualified(part, component))
    return replace(made, name=f"{component}.{made.name}") if isinstance(made, s.Name) else made


def start_rows(unknowns: Sequence[Element], reading: Reading) -> dict[str, Row]:
    """Per unknown with a fixed start value that is no number: the initial equation that says the same."""
    made: dict[str, Row] = {}
    for element in unknowns:
        node = element.variable.start
        if node is None or isinstance(node, s.Constant) or not is_fixed(element):
            continue
        found = v.elements(reading.evaluator(reading.scope, element.variable.span).value(node))
        value = v.constant(found[element.position if len(found) > 1 else 0])
        if isinstance(value, ca.SX):
            origin = element.variable.name.rpartition(".")[0]
            equation = s.FlatEquation(s.Name(element.name), node, "binding", origin, element.variable.span)
            made[element.name] = Row(element.symbol - value, f"{element.name} = {text(node)}", equation)
    return made
