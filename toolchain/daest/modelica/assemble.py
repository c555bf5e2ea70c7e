"""From the flat source to the `FlatModel`: symbols, rows, annotations, outputs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from daest.errors import ModelError
from daest.model.flat import (
    DerivedParameter,
    Equation,
    FlatModel,
    NoiseInput,
    Output,
    Parameter,
    Variable,
)
from daest.modelica import syntax as s
from daest.modelica import values as v
from daest.modelica.annotations import NONE, Annotation, Role, annotation_of, check_keys
from daest.modelica.expressions import Evaluator, refusal, split_path
from daest.modelica.functions import FunctionLibrary
from daest.modelica.outputs import NamedOutput, named_outputs
from daest.modelica.parameters import ParameterTable, is_parameter, number, numeric_scope, sort_parameters
from daest.modelica.rows import Row, rows_of
from daest.modelica.scope import ModelScope, element_names, symbols
from daest.modelica.source import Sources
from daest.modelica.text import text
from daest.modelica.values import Value

_STATE_SELECT = ("never", "avoid", "default", "prefer", "always")


@dataclass(frozen=True)
class Element:
    """One scalar of a variable: its name, its position in the flattened array, its symbol."""

    name: str
    position: int
    variable: s.FlatVariable
    symbol: ca.SX


def assemble(source: s.FlatSource, file: str) -> FlatModel:
    """The FlatModel of a flat source. Raises ModelError with place and remedy."""
    return _Assembly(source, file).flat_model()


class _Assembly:
    """The values that the steps of one assembly share."""

    def __init__(self, source: s.FlatSource, file: str) -> None:
        self.source = source
        self.file = file
        self.sources = Sources(source.texts)
        self.time = ca.SX.sym("time")
        self.numeric = numeric_scope(source, self.evaluator)
        self.scope = ModelScope(
            tuple(x.name for x in source.variables), {**source.literals, "time": self.time}
        )
        self.scope.constant_names = self.numeric.constant_names
        self.annotations = {x.name: self._annotation(x) for x in source.variables}

    # Reading --------------------------------------------------------------------------------------------------

    def evaluator(self, scope: ModelScope, span: s.Span | None) -> Evaluator:
        library = FunctionLibrary(self.source.functions, self.sources.place, scope.lookup)
        return Evaluator(scope, library, self.sources.place, at=span)

    def _annotation(self, variable: s.FlatVariable) -> Annotation:
        if variable.span is None or variable.span.source not in self.sources.texts:
            return NONE
        file, content = self.sources.texts[variable.span.source]
        if b"__Daest" not in content:
            return NONE
        found = annotation_of(file, content, variable.span.end)
        if found:
            check_keys(found, _role(variable), variable.name)
        return found

    def flat_model(self) -> FlatModel:
        for what, span in self.source.refused:
            raise refusal(what, self.sources.place(span))
        table = sort_parameters(self.source, self.numeric, self.scope, self.evaluator)
        inputs, noises, unknowns = self._declare_variables()
        rows = self._rows(self.source.equations) + self._rows(self._bindings())
        initial = self._rows(self.source.initial_equations)
        xi = _column([element.symbol for element in unknowns])
        derivatives = _column(
            [
                d
                for element in unknowns
                for d in [v.elements(self.scope.derivatives[element.variable.name])[element.position]]
            ]
        )
        outputs = [i for i, element in enumerate(unknowns) if _is_output(element.variable)]
        named = named_outputs(outputs, rows, xi, derivatives)
        return self._made(table, inputs, noises, unknowns, rows, initial, xi, derivatives, named)

    # Symbols --------------------------------------------------------------------------------------------------

    def _declare_variables(self) -> tuple[list[Element], list[Element], list[Element]]:
        """Symbols of inputs, noises and unknowns; what is defined by an expression becomes pending."""
        inputs: list[Element] = []
        noises: list[Element] = []
        unknowns: list[Element] = []
        definitions = self._definitions()
        for variable in self.source.variables:
            if is_parameter(variable):
                continue
            if self._is_noise(variable):
                noises += self._elements(variable)
            elif variable.causality == "input" and variable.is_top_level:
                inputs += self._elements(variable)
            elif variable.name in definitions:
                self._define(variable, definitions[variable.name])
            else:
                unknowns += self._elements(variable)
                self._add_derivatives(variable)
        return inputs, noises, unknowns

    def _is_noise(self, variable: s.FlatVariable) -> bool:
        return self.annotations[variable.name].flag("noise", False)

    def _elements(self, variable: s.FlatVariable) -> list[Element]:
        names = element_names(variable.name, variable.dimensions)
        value = symbols(names, variable.dimensions)
        self.scope.values[variable.name] = value
        return [
            Element(name, i, variable, symbol)  # type: ignore[arg-type]
            for i, (name, symbol) in enumerate(zip(names, v.elements(value), strict=True))
        ]

    def _add_derivatives(self, variable: s.FlatVariable) -> None:
        names = [f"der({name})" for name in element_names(variable.name, variable.dimensions)]
        self.scope.derivatives[variable.name] = symbols(names, variable.dimensions)

    def _definitions(self) -> dict[str, list[tuple[s.FlatEquation | None, s.Node]]]:
        """Variables that are replaced by what defines them: bound inputs of components, and Boolean, Integer and
        enumeration unknowns with the equations that define them."""
        found: dict[str, list[tuple[s.FlatEquation | None, s.Node]]] = {}
        discrete = {x.name for x in self.source.variables if x.is_discrete and not is_parameter(x)}
        for variable in self.source.variables:
            if is_parameter(variable) or variable.binding is None:
                continue
            if variable.name in discrete or (variable.causality == "input" and not variable.is_top_level):
                found[variable.name] = [(None, variable.binding)]
        for equation in self.source.equations:
            if isinstance(equation.left, s.Name) and equation.left.name in discrete and equation.right:
                found.setdefault(equation.left.name, []).append((equation, equation.right))
        for name in discrete - set(found):
            raise self._undefined(name)
        return found

    def _undefined(self, name: str) -> ModelError:
        variable = next(x for x in self.source.variables if x.name == name)
        return ModelError(
            "model-unsupported",
            f"{variable.type_name} variable `{name}` has no equation of the form `{name} = expression`",
            where=self.sources.declaration(variable.span, name.rpartition(".")[2]),
            remedy="Define it by one equation, or use a Real variable.",
        )

    def _define(self, variable: s.FlatVariable, found: list[tuple[s.FlatEquation | None, s.Node]]) -> None:
        self.scope.pending[variable.name] = lambda: self._defined(variable, found)

    def _defined(self, variable: s.FlatVariable, found: list[tuple[s.FlatEquation | None, s.Node]]) -> Value:
        equation, node = found[0]
        if not (equation is not None and isinstance(equation.left, s.Name) and equation.left.subscripts):
            return self._definition(equation, node, variable)
        made = v.filled(0, variable.dimensions)
        for one, right in found:
            assert one is not None and isinstance(one.left, s.Name)
            at = tuple(int(self._definition(one, sub, variable)) - 1 for sub in one.left.subscripts)  # type: ignore[arg-type]
            made[at] = self._definition(one, right, variable)
        return made

    def _definition(self, equation: s.FlatEquation | None, node: s.Node, variable: s.FlatVariable) -> Value:
        bound = dict(equation.bound) if equation is not None else {}
        evaluator = self.evaluator(self.scope, equation.span if equation is not None else variable.span)
        with evaluator.bound(list(bound), list(bound.values())):
            return evaluator.value(node)

    # Rows -----------------------------------------------------------------------------------------------------

    def _bindings(self) -> Iterable[s.FlatEquation]:
        """Declaration equations `Real p = v*i` of unknowns."""
        stated = {equation.left.name for equation in self.source.equations if _is_binding(equation)}  # type: ignore[union-attr]
        for variable in self.source.variables:
            if (
                variable.binding is None
                or variable.name in stated
                or variable.name not in self.scope.derivatives
            ):
                continue
            origin = variable.name.rpartition(".")[0]
            yield s.FlatEquation(s.Name(variable.name), variable.binding, "binding", origin, variable.span)

    def _rows(self, equations: Iterable[s.FlatEquation]) -> list[Row]:
        defined = set(self.scope.pending) | set(self.scope.values) - set(self.scope.derivatives)
        evaluator = self.evaluator(self.scope, None)
        made: list[Row] = []
        for equation in equations:
            left = equation.left
            if isinstance(left, s.Name) and left.name in defined and self._is_discrete(left.name):
                continue
            made += rows_of(equation, evaluator)
        return made

    def _is_discrete(self, name: str) -> bool:
        return name in self._discrete_names()

    def _discrete_names(self) -> frozenset[str]:
        return frozenset(x.name for x in self.source.variables if x.is_discrete and not is_parameter(x))

    # Result ---------------------------------------------------------------------------------------------------

    def _made(
        self,
        table: ParameterTable,
        inputs: list[Element],
        noises: list[Element],
        unknowns: list[Element],
        rows: list[Row],
        initial: list[Row],
        xi: ca.SX,
        derivatives: ca.SX,
        named: list[NamedOutput],
    ) -> FlatModel:
        by_unknown = {one.unknown: one for one in named}
        gone = {one.row for one in named}
        kept = [i for i in range(len(unknowns)) if i not in by_unknown]
        outputs = [i for i, element in enumerate(unknowns) if _is_output(element.variable)]
        kept_rows = [row for i, row in enumerate(rows) if i not in gone]
        return FlatModel(
            name=self.source.name,
            unknowns=tuple(self._variable(unknowns[i]) for i in kept),
            inputs=tuple(self._variable(element) for element in inputs),
            noises=tuple(self._noise(element) for element in noises),
            parameters=tuple(self._parameter(*entry[:2], entry[3]) for entry in table.tunable),
            outputs=tuple(self._output(unknowns[i]) for i in outputs),
            equations=tuple(self._equation(row) for row in kept_rows),
            derivatives=_column([derivatives[i] for i in kept]),
            xi=_column([xi[i] for i in kept]),
            u=_column([element.symbol for element in inputs]),
            w=_column([element.symbol for element in noises]),
            theta=_column([entry[2] for entry in table.tunable]),
            time=self.time,
            residual=_column([row.residual for row in kept_rows]),
            output_expressions=_column(
                [by_unknown[i].expression if i in by_unknown else xi[i] for i in outputs]
            ),
            initial_equations=tuple(self._equation(row) for row in initial),
            initial_residual=_column([row.residual for row in initial]),
            derived_parameters=tuple(self._derived(*entry[:3]) for entry in table.derived),
            derived_values=_column([entry[3] for entry in table.derived]),
            source=self.file,
            description=self.source.description,
        )

    def _number(self, node: s.Node | None, element: Element) -> float | None:
        return number(node, element.position, self.numeric, self.evaluator, element.variable.span)

    def _declared_at(self, variable: s.FlatVariable) -> Any:
        identifier = variable.name.rpartition(".")[2].partition("[")[0]
        return self.sources.declaration(variable.span, identifier)

    def _variable(self, element: Element) -> Variable:
        variable = element.variable
        fixed = variable.fixed
        return Variable(
            name=element.name,
            unit=variable.unit,
            description=variable.description,
            start=self._number(variable.start, element),
            fixed=bool(fixed) and fixed[element.position if len(fixed) > 1 else 0],
            min=self._number(variable.min, element),
            max=self._number(variable.max, element),
            nominal=self._number(variable.nominal, element),
            is_flow=variable.is_flow,
            state_select=variable.state_select if variable.state_select in _STATE_SELECT else "default",  # type: ignore[arg-type]
            place=self._declared_at(variable),
        )

    def _parameter(self, name: str, variable: s.FlatVariable, value: float) -> Parameter:
        annotation = self.annotations[variable.name]
        element = Element(
            name, element_names(variable.name, variable.dimensions).index(name), variable, ca.SX()
        )
        low = self._annotated(annotation, "min", element)
        high = self._annotated(annotation, "max", element)
        return Parameter(
            name=name,
            value=value,
            unit=variable.unit,
            description=variable.description,
            min=low if low is not None else self._number(variable.min, element),
            max=high if high is not None else self._number(variable.max, element),
            nominal=self._number(variable.nominal, element),
            estimate=annotation.flag("estimate", False),
            scale=annotation.scale(),
            place=self._declared_at(variable),
        )

    def _derived(self, name: str, variable: s.FlatVariable, expression: str) -> DerivedParameter:
        annotation = self.annotations[variable.name]
        if annotation.flag("estimate", False):
            what = f"`{name}` is computed as `{expression}` and cannot be estimated"
            raise annotation.error("estimate", what, "Mark what it is computed from.")
        return DerivedParameter(
            name, expression, variable.unit, variable.description, self._declared_at(variable)
        )

    def _noise(self, element: Element) -> NoiseInput:
        annotation = self.annotations[element.variable.name]
        return NoiseInput(
            name=element.name,
            intensity=self._annotated(annotation, "intensity", element),
            unit=element.variable.unit,
            description=element.variable.description,
            estimate=annotation.flag("estimate", False),
            place=self._declared_at(element.variable),
            intensity_parameter=self._annotated_by(annotation, "intensity", element),
        )

    def _output(self, element: Element) -> Output:
        annotation = self.annotations[element.variable.name]
        return Output(
            name=element.name,
            unit=element.variable.unit,
            description=element.variable.description,
            noise_std=self._annotated(annotation, "std", element),
            estimate_noise=annotation.flag("estimate", True),
            place=self._declared_at(element.variable),
            noise_std_parameter=self._annotated_by(annotation, "std", element),
        )

    def _annotated(self, annotation: Annotation, key: str, element: Element) -> float | None:
        """The number of an annotation entry; its names are those of the component that declares the variable."""
        node = annotation.entries.get(key)
        if node is None:
            return None
        component = element.variable.name.rpartition(".")[0]
        return number(qualified(node, component), element.position, self.numeric, self.evaluator, None)

    def _annotated_by(self, annotation: Annotation, key: str, element: Element) -> str:
        """The tunable parameter that alone gives an annotation's number; empty for a number or a formula."""
        node = annotation.entries.get(key)
        if not isinstance(node, s.Name):
            return ""
        name = text(qualified(node, element.variable.name.rpartition(".")[0]))
        value = self.scope.path([(ident, tuple(at)) for ident, at in split_path(name)])
        if isinstance(value, ca.SX) and value.is_symbolic():
            return str(value.name())
        return ""

    def _equation(self, row: Row) -> Equation:
        equation = row.equation
        return Equation(row.text, equation.kind, equation.origin, self.sources.place(equation.span))


def qualified(node: s.Node, component: str) -> s.Node:
    """The node with its names seen from the model: `intensity` of component `noise` -> `noise.intensity`."""
    if not component:
        return node
    match node:
        case s.Name(name, subscripts):
            return s.Name(f"{component}.{name}", subscripts)
        case s.Unary(operator, operand):
            return s.Unary(operator, qualified(operand, component))
        case s.Binary(operator, left, right):
            return s.Binary(operator, qualified(left, component), qualified(right, component))
        case s.Call(function, arguments):
            return s.Call(function, tuple(qualified(a, component) for a in arguments), builtin=True)
        case s.Array(elements):
            return s.Array(tuple(qualified(e, component) for e in elements))
    return node


def _role(variable: s.FlatVariable) -> Role:
    if variable.variability == "parameter":
        return "parameter"
    if variable.causality in ("input", "output"):
        return variable.causality
    return "variable"


def _is_output(variable: s.FlatVariable) -> bool:
    return variable.causality == "output" and variable.is_top_level


def _is_binding(equation: s.FlatEquation) -> bool:
    return equation.kind == "binding" and isinstance(equation.left, s.Name)


def _column(parts: Sequence[ca.SX]) -> ca.SX:
    return ca.vertcat(*parts) if parts else ca.SX(0, 1)
