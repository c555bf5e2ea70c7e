"""From the flat source to the `FlatModel`: symbols, rows, outputs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from daest.errors import Place
from daest.model.events import Events
from daest.model.flat import FlatModel
from daest.model.parts import Equation, Variable
from daest.modelica.flat.balance import unbalanced
from daest.modelica.flat.clocks import without_clocks
from daest.modelica.flat.connectors import without_empty_members
from daest.modelica.flat.delays import without_delays
from daest.modelica.flat.events import Kept, finished, kept
from daest.modelica.flat.functions import run_algorithm
from daest.modelica.flat.metadata import (
    derived_of,
    noise_of,
    output_of,
    parameter_of,
    start_rows,
    variable_of,
)
from daest.modelica.flat.parameters import (
    ParameterTable,
    is_parameter,
    number,
    sort_parameters,
    with_settled_parameters,
)
from daest.modelica.flat.reading import Reading
from daest.modelica.flat.rows import (
    ConnectClauses,
    NamedOutput,
    Row,
    algorithm_rows,
    named_outputs,
    rows_of,
    used_texts,
)
from daest.modelica.flat.scope import Element, element_names
from daest.modelica.flat.unknowns import Declared, declare_variables
from daest.modelica.language import syntax as s
from daest.modelica.language import values as v
from daest.modelica.language.expressions import refusal
from daest.modelica.language.values import Value, column


@dataclass(frozen=True)
class _Parts:
    """All rows and symbols of a model, before outputs are told from unknowns."""

    reading: Reading
    parameters: ParameterTable
    declared: Declared
    rows: list[Row]
    initial: list[Row]
    memory_starts: dict[str, ca.SX]
    starts: dict[str, Row]
    xi: ca.SX
    derivatives: ca.SX


def assemble(source: s.FlatSource, file: str) -> FlatModel:
    """The FlatModel of a flat source. Raises ModelError with place and remedy."""
    source = without_delays(without_clocks(without_empty_members(with_settled_parameters(source))))
    reading = Reading(source)
    for what, span in _refused_statements(source):
        raise refusal(what, reading.sources.place(span))
    parameters = sort_parameters(source, reading.numeric, reading.scope, reading.evaluator)
    if reading.events is not None:
        reading.events.parameters = frozenset(element.name for element, _ in parameters.tunable)
    declared = declare_variables(reading)
    rows = _all_rows(reading, declared)
    initial, starts_of_memory = _initial(reading, declared)
    if reading.events is not None:
        reading.events.complete()
    parts = _Parts(
        reading=reading,
        parameters=parameters,
        declared=declared,
        rows=rows,
        initial=initial,
        memory_starts=starts_of_memory,
        starts=start_rows(declared.unknowns, reading),
        xi=column([element.symbol for element in declared.unknowns]),
        derivatives=column(declared.derivatives),
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
    if reading.events is not None:
        reading.events.read(reading.source.whens, reading.evaluator(reading.scope, None))
        rows += [_held(element, reading) for element in declared.held]
    return rows


def _held(element: Element, reading: Reading) -> Row:
    """A Real variable that events assign keeps its value between them."""
    variable = element.variable
    rate = v.elements(reading.scope.derivatives[variable.name])[element.position]
    origin = variable.name.rpartition(".")[0]
    equation = s.FlatEquation(s.Name(element.name), None, "component", origin, variable.span)
    return Row(v.symbolic(rate), f"der({element.name}) = 0 between events", equation)


def _initial(reading: Reading, declared: Declared) -> tuple[list[Row], dict[str, ca.SX]]:
    """The initial equations for variables, and the values of initial equations and algorithms for what is
    remembered between events, by name."""
    rows: list[s.FlatEquation] = []
    equal: list[tuple[str, str]] = []
    starts: dict[str, ca.SX] = {}
    evaluator = reading.evaluator(reading.scope, None)
    held = {element.variable.name for element in declared.held}
    for equation in reading.source.initial_equations:
        name, other = _remembered(equation.left, reading), _remembered(equation.right, reading)
        if name and other and not {name, other} & held:
            equal.append((name, other))
            continue
        if (element := _remembered_element(equation, reading)) and element[0] not in held:
            assert reading.events is not None and equation.right is not None
            reading.events.pre(element[0])
            evaluator.at = equation.span
            with evaluator.bound(*_iterators(equation)):
                one = v.symbolic(evaluator.scalar(equation.right))
            starts |= {f"pre({element[1]})": one, element[1]: one}
            continue
        if not name or equation.right is None or name in held:
            rows.append(equation)
            continue
        evaluator.at = equation.span
        value = evaluator.value(equation.right)
        for same in _same(name, declared):
            _start(starts, same, value, reading)
    _equal_starts(starts, equal, reading)
    made = _rows(reading, declared, rows)
    for algorithm in reading.source.initial_algorithms:
        made += _initial_algorithm(algorithm, reading, starts)
    return made, starts


def _same(name: str, declared: Declared) -> Iterable[str]:
    """The discrete variable, and those that it equals at the start: what its definition `x = y` or
    `x = pre(y)` names."""
    seen: list[str] = []
    while name not in seen:
        seen.append(name)
        definitions = declared.definitions.get(name, [])
        node = definitions[0][1] if len(definitions) == 1 else None
        if isinstance(node, s.Call) and node.function == "pre":
            node = node.arguments[0]
        if isinstance(node, s.Name) and not node.subscripts:
            name = node.name
    return seen


def _equal_starts(starts: dict[str, ca.SX], equal: list[tuple[str, str]], reading: Reading) -> None:
    """Start values that the initial equations `a = b` pass on from one discrete variable to another."""
    evaluator = reading.evaluator(reading.scope, None)
    while equal:
        known = [(a, b) for a, b in equal if f"pre({a})" in starts or f"pre({b})" in starts]
        for a, b in known or equal[:1]:
            new, given = (b, a) if f"pre({a})" in starts else (a, b)
            equal.remove((a, b))
            if f"pre({new})" not in starts:
                before = s.Call("pre", (s.Name(given),), builtin=True)
                _start(starts, new, starts.get(f"pre({given})", evaluator.value(before)), reading)


def _remembered(node: s.Node | None, reading: Reading) -> str:
    """The name of a discrete variable `x`, also in pre(x); empty for any other node."""
    if isinstance(node, s.Call) and node.function == "pre":
        node = node.arguments[0]
    known = isinstance(node, s.Name) and not node.subscripts and reading.events is not None
    return node.name if known and node.name in reading.discrete | reading.targets else ""  # type: ignore[union-attr]


def _iterators(equation: s.FlatEquation) -> tuple[list[str], list[Value]]:
    """Names and values of the for-iterators around an equation."""
    return [name for name, _ in equation.bound], [value for _, value in equation.bound]


def _remembered_element(equation: s.FlatEquation, reading: Reading) -> tuple[str, str] | None:
    """The array and the name of its element, where an initial equation `x[i] = …`, also with pre(x[i]), is
    for an element of a discrete array."""
    node = equation.left
    if isinstance(node, s.Call) and node.function == "pre":
        node = node.arguments[0]
    is_element = isinstance(node, s.Name) and node.subscripts and reading.events is not None
    if not is_element or equation.right is None or node.name not in reading.discrete:  # type: ignore[union-attr]
        return None
    assert isinstance(node, s.Name)
    evaluator = reading.evaluator(reading.numeric, equation.span)
    with evaluator.bound(*_iterators(equation)):
        at = [evaluator.value(one) for one in node.subscripts]
    if not all(isinstance(one, int) for one in at):
        return None
    return node.name, f"{node.name}[{','.join(map(str, at))}]"


def _start(starts: dict[str, ca.SX], name: str, value: Value, reading: Reading) -> None:
    assert reading.events is not None
    reading.events.pre(name)  # what an initial equation sets is remembered, even where nobody asks for it
    names = element_names(name, reading.scope.declared_shape(name) or ())
    for one, element in zip(names, v.elements(value), strict=True):
        starts[f"pre({one})"] = v.symbolic(element)
        starts[one] = v.symbolic(element)


def _initial_algorithm(algorithm: s.FlatAlgorithm, reading: Reading, starts: dict[str, ca.SX]) -> list[Row]:
    shapes = {variable.name: variable.dimensions for variable in reading.source.variables}
    evaluator = reading.evaluator(reading.scope, algorithm.span)
    body = tuple(x for x in algorithm.body if not _is_settled(x, reading))
    left = replace(algorithm, body=body)
    with evaluator.at_events():
        results = run_algorithm(left, shapes, evaluator, reading.library(reading.scope), reading.targets)
    made: list[Row] = []
    for name, value in results.items():
        if name in reading.discrete:
            _start(starts, name, value, reading)
            continue
        present = evaluator.value(s.Name(name))
        equation = s.FlatEquation(s.Name(name), None, "component", algorithm.origin, algorithm.span)
        pairs = zip(v.elements(present), v.elements(value), strict=True)
        made += [Row(v.symbolic(v.subtract(a, b)), f"{name} = (algorithm)", equation) for a, b in pairs]
    return made


def _is_settled(statement: s.Statement, reading: Reading) -> bool:
    """Whether a statement computes a parameter, which has that as its binding, or only checks."""
    if isinstance(statement, s.Assign):
        return statement.target.name in reading.scope.constant_names
    if isinstance(statement, s.If):
        inner = (*(one for _, body in statement.branches for one in body), *statement.otherwise)
        return all(isinstance(one, s.Assert) or _is_settled(one, reading) for one in inner)
    return isinstance(statement, s.AssignCall) and not any(statement.targets)


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
    memory = _memory(parts)
    if len(parts.rows) != len(declared.unknowns):
        residual = column([row.residual for row in parts.rows])
        raise unbalanced(equations, declared.unknowns, residual, parts.xi, parts.derivatives, file)
    outputs = [i for i, element in enumerate(declared.unknowns) if _is_output(element)]
    named = _named(outputs, len(declared.unknowns), parts)
    shown = [named[i].expression if i in named else declared.unknowns[i].symbol for i in outputs]
    gone = {one.row for one in named.values()}
    kept = [i for i in range(len(declared.unknowns)) if i not in named]
    initial = [*parts.initial, *parts.starts.values()]
    kept_rows = [i for i in range(len(parts.rows)) if i not in gone]
    return FlatModel(
        name=reading.source.name,
        unknowns=tuple(_unknown(declared.unknowns[i], parts) for i in kept),
        inputs=tuple(variable_of(element, reading) for element in declared.inputs),
        noises=tuple(noise_of(element, reading) for element in declared.noises),
        parameters=(
            *(parameter_of(element, value, reading) for element, value in table.tunable),
            *(() if memory is None else memory.parameters),
        ),
        outputs=tuple(output_of(declared.unknowns[i], reading) for i in outputs),
        equations=tuple(equations[i] for i in kept_rows),
        derivatives=column([declared.derivatives[i] for i in kept]),
        xi=column([declared.unknowns[i].symbol for i in kept]),
        u=column([element.symbol for element in declared.inputs]),
        w=column([element.symbol for element in declared.noises]),
        theta=_theta(table, memory),
        time=reading.time,
        residual=_now(column([parts.rows[i].residual for i in kept_rows]), parts),
        output_expressions=_now(column(shown), parts),
        initial_equations=tuple(_equations(initial, reading)),
        initial_residual=_now(_initial_residual(initial, named, declared.unknowns), parts),
        events=_events(parts, memory, [declared.unknowns[i].name for i in kept], named),
        derived_parameters=tuple(
            derived_of(one.element.name, one.element.variable, one.expression, reading)
            for one in table.derived
        ),
        derived_values=column([one.element.symbol for one in table.derived]),
        source=file,
        description=reading.source.description,
    )


def _memory(parts: _Parts) -> Kept | None:
    """What keeps its value between events, with its start values."""
    reading = parts.reading
    if reading.events is None:
        return None
    starts: dict[str, float] = {}
    for variable in reading.source.variables:
        if is_parameter(variable) or variable.start is None:
            continue
        for i, name in enumerate(element_names(variable.name, variable.dimensions)):
            value = number(variable.start, i, reading.numeric, reading.evaluator, variable.span)
            starts[name] = 0.0 if value is None else value
    return kept(reading.events, starts, len(parts.parameters.tunable))


def _theta(table: ParameterTable, memory: Kept | None) -> ca.SX:
    own = column([element.symbol for element, _ in table.tunable])
    return own if memory is None else ca.vertcat(own, memory.symbols)


def _now(expression: ca.SX, parts: _Parts) -> ca.SX:
    """Between events pre(x) of a Real variable that events assign is x."""
    recorder = parts.reading.events
    if recorder is None:
        return expression
    pairs = [
        (v.symbolic(before), v.symbolic(now))
        for name in recorder.before
        if name in {element.variable.name for element in parts.declared.held}
        for before, now in zip(
            v.elements(recorder.before[name]), v.elements(recorder.scope.values[name]), strict=True
        )
    ]
    if not pairs or not expression.numel():
        return expression
    return ca.substitute(expression, column([a for a, _ in pairs]), column([b for _, b in pairs]))


def _events(
    parts: _Parts, memory: Kept | None, unknowns: Sequence[str], named: dict[int, NamedOutput]
) -> Events | None:
    recorder = parts.reading.events
    if recorder is None or memory is None:
        return None
    events = finished(
        recorder, memory.slots, {name: i for i, name in enumerate(unknowns)}, parts.memory_starts
    )
    if not named:
        return events
    gone = column([parts.declared.unknowns[i].symbol for i in named])
    instead = column([one.expression for one in named.values()])
    changed: dict[str, Any] = {
        key: ca.substitute(getattr(events, key), gone, instead)
        for key in ("values", "wholes", "conditions", "assigned", "sources", "restarted", "starts")
        if getattr(events, key).numel()
    }
    return replace(events, **changed)


def _unknown(element: Element, parts: _Parts) -> Variable:
    made = variable_of(element, parts.reading)
    return replace(made, fixed=False) if element.name in parts.starts else made


def _named(outputs: Sequence[int], n: int, parts: _Parts) -> dict[int, NamedOutput]:
    """The outputs that only name an expression, by their unknown. A model that has nothing else keeps
    them as unknowns: without any there is no equation to which an effect or a noise could be added."""
    named = named_outputs(outputs, parts.rows, parts.xi, parts.derivatives)
    return {} if len(named) == n else {one.unknown: one for one in named}


def _initial_residual(
    initial: Sequence[Row], named: dict[int, NamedOutput], unknowns: Sequence[Element]
) -> ca.SX:
    """Initial equations with the expressions of outputs that are no unknowns put in."""
    residual = column([row.residual for row in initial])
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
