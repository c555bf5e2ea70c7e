"""From the flat source to the `FlatModel`: symbols, rows, outputs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from daest.errors import Place
from daest.model.flat import FlatModel
from daest.model.parts import Equation, Variable
from daest.modelica import syntax as s
from daest.modelica.balance import unbalanced
from daest.modelica.connects import ConnectClauses, used_texts
from daest.modelica.expressions import refusal
from daest.modelica.metadata import derived_of, noise_of, output_of, parameter_of, variable_of
from daest.modelica.outputs import NamedOutput, named_outputs
from daest.modelica.parameters import ParameterTable, sort_parameters
from daest.modelica.reading import Reading
from daest.modelica.rows import Row, algorithm_rows, rows_of
from daest.modelica.scope import Element
from daest.modelica.starts import start_rows
from daest.modelica.unknowns import Declared, declare_variables


@dataclass(frozen=True)
class _Parts:
    """All rows and symbols of a model, before outputs are told from unknowns."""

    reading: Reading
    parameters: ParameterTable
    declared: Declared
    rows: list[Row]
    initial: list[Row]
    starts: dict[str, Row]
    xi: ca.SX
    derivatives: ca.SX


def assemble(source: s.FlatSource, file: str) -> FlatModel:
    """The FlatModel of a flat source. Raises ModelError with place and remedy."""
    reading = Reading(source)
    for what, span in (*source.refused, *_refused_statements(source)):
        raise refusal(what, reading.sources.place(span))
    parameters = sort_parameters(source, reading.numeric, reading.scope, reading.evaluator)
    declared = declare_variables(reading)
    parts = _Parts(
        reading=reading,
        parameters=parameters,
        declared=declared,
        rows=_all_rows(reading, declared),
        initial=_rows(reading, declared, source.initial_equations),
        starts=start_rows(declared.unknowns, reading),
        xi=_column([element.symbol for element in declared.unknowns]),
        derivatives=_column(declared.derivatives),
    )
    return _flat_model(parts, file)


def _refused_statements(source: s.FlatSource) -> Iterable[tuple[str, s.Span | None]]:
    for algorithm in source.algorithms:
        for statement in algorithm.body:
            if isinstance(statement, s.Refused):
                yield statement.what, statement.span or algorithm.span


def _all_rows(reading: Reading, declared: Declared) -> list[Row]:
    rows = _rows(reading, declared, (*reading.source.equations, *_bindings(reading)))
    for algorithm in reading.source.algorithms:
        rows += algorithm_rows(algorithm, reading)
    return rows


def _bindings(reading: Reading) -> Iterable[s.FlatEquation]:
    """Declaration equations `Real p = v*i` of unknowns, unless the compiler has made equations of them."""
    stated = {
        equation.left.name
        for equation in reading.source.equations
        if equation.kind == "binding" and isinstance(equation.left, s.Name)
    }
    for variable in reading.source.variables:
        if variable.binding is None or variable.name in stated:
            continue
        if variable.name in reading.scope.derivatives:
            origin = variable.name.rpartition(".")[0]
            yield s.FlatEquation(s.Name(variable.name), variable.binding, "binding", origin, variable.span)


def _rows(reading: Reading, declared: Declared, equations: Iterable[s.FlatEquation]) -> list[Row]:
    skipped = {id(equation) for equation in declared.defining}
    evaluator = reading.evaluator(reading.scope, None)
    made: list[Row] = []
    for equation in equations:
        if id(equation) not in skipped:
            made += rows_of(equation, evaluator, declared.substitutes)
    return made


def _flat_model(parts: _Parts, file: str) -> FlatModel:
    reading, declared, table = parts.reading, parts.declared, parts.parameters
    equations = _equations(parts.rows, reading)
    if len(parts.rows) != len(declared.unknowns):
        residual = _column([row.residual for row in parts.rows])
        raise unbalanced(equations, declared.unknowns, residual, parts.xi, parts.derivatives, file)
    outputs = [i for i, element in enumerate(declared.unknowns) if _is_output(element)]
    named = {one.unknown: one for one in named_outputs(outputs, parts.rows, parts.xi, parts.derivatives)}
    gone = {one.row for one in named.values()}
    kept = [i for i in range(len(declared.unknowns)) if i not in named]
    initial = [*parts.initial, *parts.starts.values()]
    kept_rows = [i for i in range(len(parts.rows)) if i not in gone]
    return FlatModel(
        name=reading.source.name,
        unknowns=tuple(_unknown(declared.unknowns[i], parts) for i in kept),
        inputs=tuple(variable_of(element, reading) for element in declared.inputs),
        noises=tuple(noise_of(element, reading) for element in declared.noises),
        parameters=tuple(parameter_of(element, value, reading) for element, value in table.tunable),
        outputs=tuple(output_of(declared.unknowns[i], reading) for i in outputs),
        equations=tuple(equations[i] for i in kept_rows),
        derivatives=_column([declared.derivatives[i] for i in kept]),
        xi=_column([declared.unknowns[i].symbol for i in kept]),
        u=_column([element.symbol for element in declared.inputs]),
        w=_column([element.symbol for element in declared.noises]),
        theta=_column([element.symbol for element, _ in table.tunable]),
        time=reading.time,
        residual=_column([parts.rows[i].residual for i in kept_rows]),
        output_expressions=_output_expressions(outputs, named, declared.unknowns),
        initial_equations=tuple(_equations(initial, reading)),
        initial_residual=_initial_residual(initial, named, declared.unknowns),
        derived_parameters=tuple(
            derived_of(one.element.name, one.element.variable, one.expression, reading)
            for one in table.derived
        ),
        derived_values=_column([one.element.symbol for one in table.derived]),
        source=file,
        description=reading.source.description,
    )


def _unknown(element: Element, parts: _Parts) -> Variable:
    made = variable_of(element, parts.reading)
    return replace(made, fixed=False) if element.name in parts.starts else made


def _output_expressions(
    outputs: Sequence[int], named: dict[int, NamedOutput], unknowns: Sequence[Element]
) -> ca.SX:
    return _column([named[i].expression if i in named else unknowns[i].symbol for i in outputs])


def _initial_residual(
    initial: Sequence[Row], named: dict[int, NamedOutput], unknowns: Sequence[Element]
) -> ca.SX:
    """Initial equations with the expressions of outputs that are no unknowns put in."""
    residual = _column([row.residual for row in initial])
    if not named or not initial:
        return residual
    symbols = ca.vertcat(*[unknowns[i].symbol for i in named])
    return ca.substitute(residual, symbols, ca.vertcat(*[one.expression for one in named.values()]))


def _equations(rows: Sequence[Row], reading: Reading) -> list[Equation]:
    clauses = ConnectClauses(used_texts(reading.source.texts, _source_numbers(reading)))
    return [_equation(row, reading, clauses) for row in rows]


def _source_numbers(reading: Reading) -> Iterable[int]:
    """The user's own file, which may hold nothing but connect clauses, and all files that declare
    something."""
    yield from reading.source.own
    spans = [equation.span for equation in reading.source.equations]
    spans += [variable.span for variable in reading.source.variables]
    yield from (span.source for span in spans if span is not None)


def _equation(row: Row, reading: Reading, clauses: ConnectClauses) -> Equation:
    equation = row.equation
    place: Place | None = None
    if equation.kind in ("connection", "flow"):
        place = clauses.place(tuple(equation.origin.split(", ")))
    return Equation(row.text, equation.kind, equation.origin, place or reading.sources.place(equation.span))


def _is_output(element: Element) -> bool:
    return element.variable.causality == "output" and element.variable.is_top_level


def _column(parts: Sequence[ca.SX]) -> ca.SX:
    return ca.vertcat(*parts) if parts else ca.SX(0, 1)
