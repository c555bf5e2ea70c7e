"""Parameters and constants of a flat model: which are tunable (θ), which are computed, which are fixed
numbers.

- A Real parameter whose binding is a number is tunable, unless it is final or decides a size or a branch.
- A Real parameter whose binding depends on tunable ones is derived: its expression stands in the equations.
- Everything else (constants, Integers, Booleans, enumerations, Strings) is its value.

Parameters with `fixed = false` are decided by the start of the model, not by their declaration.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.modelica.flat.scope import Element, ModelScope, element_names
from daest.modelica.forms.dialect import CONSTRUCTOR
from daest.modelica.language import syntax as s
from daest.modelica.language import values as v
from daest.modelica.language.elements import Sizes, broadcast
from daest.modelica.language.expressions import Evaluator, index_tuples
from daest.modelica.language.specialise import specialised
from daest.modelica.language.text import text
from daest.modelica.language.values import Scalar, Value

EvaluatorFactory = Callable[[ModelScope, s.Span | None], Evaluator]


@dataclass(frozen=True)
class Derived:
    """A computed parameter; the element's symbol is the expression that it stands for."""

    element: Element
    expression: str


@dataclass
class ParameterTable:
    """The result of sorting: tunable elements with their values, and derived ones. `grids` are matrices whose
    first column is the abscissa of a table, which is a number."""

    grids: frozenset[str] = frozenset()
    tunable: list[tuple[Element, float]] = field(default_factory=list)
    derived: list[Derived] = field(default_factory=list)


def is_parameter(variable: s.FlatVariable) -> bool:
    """Whether the declaration is a parameter or a constant."""
    return variable.variability in ("parameter", "constant")


def declared_shapes(source: s.FlatSource) -> dict[str, tuple[int, ...]]:
    """The sizes of all variables, () for a scalar."""
    return {x.name: x.dimensions for x in source.variables}


def numeric_scope(source: s.FlatSource, evaluator: EvaluatorFactory) -> ModelScope:
    """A scope in which every parameter has its present value as a number."""
    scope = ModelScope(tuple(x.name for x in source.variables), dict(source.literals))
    scope.constant_names = frozenset(x.name for x in source.variables if is_parameter(x))
    scope.shapes = declared_shapes(source)
    for variable in source.variables:
        if is_parameter(variable):
            scope.pending[variable.name] = _numeric(variable, scope, evaluator)
    return scope


def _numeric(variable: s.FlatVariable, scope: ModelScope, evaluator: EvaluatorFactory) -> Callable[[], Value]:
    def make() -> Value:
        reader = evaluator(scope, variable.span)
        return shaped(reader.value(_given(variable, reader)), variable, reader)

    return make


def _given(variable: s.FlatVariable, evaluator: Evaluator) -> s.Node:
    """The binding, or the start value where there is no binding (Language Specification 4.4.4, with a
    warning)."""
    if variable.binding is not None:
        return variable.binding
    place = evaluator.locate(_identifier(variable))
    if variable.fixed and not all(variable.fixed):
        raise ModelError(
            "model-parameter-value",
            f"parameter `{variable.name}` has fixed = false: it would be computed by initial equations",
            where=place,
            remedy="Give it a value; mark it with __Daest(estimate = true) if it is unknown.",
        )
    if variable.start is None:
        raise ModelError(
            "model-parameter-value",
            f"{variable.variability} `{variable.name}` has no value",
            where=place,
            remedy=f"Give it one where it is declared or used: `{variable.name.rpartition('.')[2]} = …`.",
        )
    warnings.warn(
        f"{place or ''}: parameter `{variable.name}` has no value; its start value is used", stacklevel=2
    )
    return variable.start


def _identifier(variable: s.FlatVariable) -> s.Span | None:
    """The span of the identifier, at the end of the declaration's span (`Real p`)."""
    if variable.span is None:
        return None
    length = len(variable.name.rpartition(".")[2].encode())
    return s.Span(variable.span.source, variable.span.end - length, variable.span.end)


def _bound(variable: s.FlatVariable) -> s.Node:
    """The node that gives the value, once `_given` has found that there is one."""
    node = variable.binding if variable.binding is not None else variable.start
    assert node is not None
    return node


def shaped(value: Value, variable: s.FlatVariable, evaluator: Evaluator) -> Value:
    """`value` in the declared size; a scalar stands for every element (`each`). Raises ModelError
    `model-arithmetic` where the sizes differ."""
    shape = variable.dimensions
    if isinstance(value, np.ndarray):
        if value.shape != shape:
            raise evaluator.error(
                "model-arithmetic",
                f"`{variable.name}` has size {v.size_text(shape)}, its value {v.size_text(value.shape)}",
                None,
                "Make the sizes equal.",
            )
        return value
    return v.filled(value, shape) if shape else value  # type: ignore[arg-type]


def sort_parameters(
    source: s.FlatSource, numeric: ModelScope, scope: ModelScope, evaluator: EvaluatorFactory
) -> ParameterTable:
    """Put every parameter and constant into `scope`, and tell the tunable and the derived ones."""
    fixed = _fixed_numbers(source, numeric)
    table = ParameterTable(grids=_grids(source))
    for variable in source.variables:
        if is_parameter(variable):
            scope.pending[variable.name] = _symbolic(variable, fixed, numeric, scope, evaluator, table)
    for variable in source.variables:
        if is_parameter(variable):
            scope.lookup(variable.name)
    order = {variable.name: i for i, variable in enumerate(source.variables)}
    table.tunable.sort(key=lambda entry: order[entry[0].variable.name])
    table.derived.sort(key=lambda entry: order[entry.element.variable.name])
    return table


def _fixed_numbers(source: s.FlatSource, numeric: ModelScope) -> frozenset[str]:
    """Names of what stands in the equations as a number: see the head of this module. Real parameters that an
    Integer or Boolean is computed from, or that sizes and branches depend on, are among them."""
    variables = {variable.name: variable for variable in source.variables if is_parameter(variable)}
    roots = [
        name
        for name, x in variables.items()
        if (x.is_discrete and not _is_object(x)) or x.variability == "constant" or name in source.structural
    ]
    roots += _asked_once(source, variables)
    found: set[str] = set()
    while roots:
        name = roots.pop()
        if name in found or name not in variables:
            continue
        found.add(name)
        binding = variables[name].binding
        if binding is not None:
            roots.extend(referenced_names(binding))
    return frozenset(found)


def _asked_once(source: s.FlatSource, parameters: Container[str]) -> list[str]:
    """Names of parameters from which a function computes a Boolean or Integer variable, as
    `ideal = Matrices.isEqual(table, …)`: its loops need numbers."""
    discrete = {x.name for x in source.variables if x.is_discrete and not is_parameter(x)}
    found: list[str] = []
    for equation in source.equations:
        if isinstance(equation.left, s.Name) and equation.left.name in discrete:
            names = referenced_names(equation.right)
            if _calls_function(equation.right) and all(name in parameters for name in names):
                found += names
    return found


def _calls_function(tree: object) -> bool:
    return any(isinstance(one, s.Call) and not one.builtin for one in s.nodes(tree))


def _is_object(variable: s.FlatVariable) -> bool:
    """Whether the parameter is an external object: a table, which may hold tunable numbers."""
    return isinstance(variable.binding, s.Call) and variable.binding.function.endswith(CONSTRUCTOR)


def _grids(source: s.FlatSource) -> frozenset[str]:
    """Names of the matrices that tables are made of."""
    variables = {variable.name: variable for variable in source.variables if is_parameter(variable)}
    waiting = [name for x in variables.values() if _is_object(x) for name in referenced_names(x.binding)]
    found: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in found or name not in variables or len(variables[name].dimensions) != 2:
            continue
        found.add(name)
        waiting += referenced_names(variables[name].binding)
    return frozenset(found)


def referenced_names(tree: object) -> list[str]:
    """All names that occur in a tree."""
    return [one.name for one in s.nodes(tree) if isinstance(one, s.Name)]


def _symbolic(
    variable: s.FlatVariable,
    fixed: frozenset[str],
    numeric: ModelScope,
    scope: ModelScope,
    evaluator: EvaluatorFactory,
    table: ParameterTable,
) -> Callable[[], Value]:
    def make() -> Value:
        reader = evaluator(scope, variable.span)
        number = numeric.lookup(variable.name)
        assert number is not None
        if variable.name in fixed:
            return number
        value = shaped(reader.value(_bound(variable)), variable, reader)
        if isinstance(value, v.Record):
            return value
        names = element_names(variable.name, variable.dimensions)
        made = [
            _element(Element(name, i, variable, v.symbolic(x)), table, reader.size)
            for i, (name, x) in enumerate(zip(names, v.elements(value), strict=True))
        ]
        return v.from_flat(made, variable.dimensions) if variable.dimensions else made[0]

    return make


def _expression_text(element: Element, size: Sizes) -> str:
    variable = element.variable
    node = _bound(variable)
    at = index_tuples(variable.dimensions)[element.position] if variable.dimensions else ()
    return text(broadcast(node, tuple(i - 1 for i in at), size) if at else node)


def _element(element: Element, table: ParameterTable, size: Sizes) -> Scalar:
    """Sort one scalar; `element.symbol` is its value as it was read."""
    variable = element.variable
    value = v.constant(element.symbol)
    if isinstance(value, ca.SX):
        table.derived.append(Derived(element, _expression_text(element, size)))
        return value
    is_abscissa = variable.name in table.grids and element.position % variable.dimensions[1] == 0
    if variable.is_final or is_abscissa:
        return value
    symbol = ca.SX.sym(element.name)
    table.tunable.append((replace(element, symbol=symbol), float(value)))
    return symbol


def number(
    node: s.Node | None, element: int, scope: ModelScope, evaluator: EvaluatorFactory, span: s.Span | None
) -> float | None:
    """The value of an attribute (`start`, `min`, …) for the element at the flat position `element`. Raises
    ModelError `model-arithmetic` for what is no number while the model is read."""
    if node is None:
        return None
    made = v.elements(evaluator(scope, span).value(node))
    value = v.constant(made[element] if len(made) > 1 else made[0])
    if isinstance(value, ca.SX | str):
        raise evaluator(scope, span).error(
            "model-arithmetic",
            f"`{text(node)}` is no number when the model is read",
            node,
            "Let it depend on parameters and constants only.",
        )
    return float(value)


def with_settled_parameters(source: s.FlatSource) -> s.FlatSource:
    """The source without loose parameters. One that an initial equation or algorithm computes from other
    parameters gets that as its binding; any other one becomes a variable that keeps its value, der(p) = 0,
    and that the initial equations determine (Language Specification 8.6)."""
    open_ones = {x.name: x for x in source.variables if _is_loose(x)}
    if not open_ones:
        return source
    parameters = {x.name for x in source.variables if is_parameter(x)}
    bindings: dict[str, s.Node] = {}
    for algorithm in source.initial_algorithms:
        bindings.update(_computed(algorithm.body, open_ones, parameters))
    # A Boolean or Integer one that nothing computes cannot become a variable that keeps its value.
    loose = {name: x for name, x in open_ones.items() if name in bindings or not x.is_discrete}
    used: set[int] = set()
    counts = Counter(name for algorithm in source.initial_algorithms for name in _targets(algorithm.body))
    for algorithm in source.initial_algorithms:
        for statement in algorithm.body:
            if not isinstance(statement, s.Assign) or counts[statement.target.name] > 1:
                continue
            if statement.target.name in bindings:
                continue
            if _binds(statement.target, statement.value, loose, parameters):
                bindings[statement.target.name] = statement.value
    for equation in source.initial_equations:
        for left, right in ((equation.left, equation.right), (equation.right, equation.left)):
            if left is None or right is None or id(equation) in used:
                continue
            if _binds(left, right, loose, parameters) and _name(left) not in bindings:
                bindings[_name(left)] = right
                used.add(id(equation))
    settled = frozenset(loose) - set(bindings)
    following = _following(source, settled)
    return replace(
        source,
        variables=tuple(
            _settled(x, bindings)
            if x.name in loose
            else replace(x, variability="continuous", fixed=(), start=None)
            if x.name in following
            else x
            for x in source.variables
        ),
        equations=(*source.equations, *(_kept(x) for x in loose.values() if x.name not in bindings)),
        initial_equations=tuple(e for e in source.initial_equations if id(e) not in used),
        settled=settled,
    )


def _following(source: s.FlatSource, settled: frozenset[str]) -> frozenset[str]:
    """Real parameters whose bindings follow from those that the start settles: they are variables as well."""
    known = set(settled)
    bound = {
        x.name: set(referenced_names(x.binding))
        for x in source.variables
        if settled and is_parameter(x) and x.binding is not None and not x.is_discrete
    }
    while found := {name for name, used in bound.items() if used & known and name not in known}:
        known |= found
    return frozenset(known - settled)


def _computed(
    body: Sequence[s.Statement], loose: Mapping[str, s.FlatVariable], parameters: Container[str]
) -> dict[str, s.Node]:
    """What an initial algorithm of assignments and branches makes of loose parameters, from other parameters
    alone; nothing where it has more than that."""
    made = _after(body, {})
    if made is None:
        return {}
    names = [name for node in made.values() for name in referenced_names(node)]
    is_all = all(name in loose for name in made) and not any(name in made for name in names)
    return made if is_all and all(name in parameters for name in names) else {}


def _after(body: Sequence[s.Statement], before: Mapping[str, s.Node]) -> dict[str, s.Node] | None:
    """The values of what statements assign, as expressions; None where they do more than assign and branch,
    or assign something on one way only."""
    known = dict(before)
    for statement in body:
        match statement:
            case s.Assign(target, value) if not target.subscripts:
                known[target.name] = specialised(value, known, _undecided)
            case s.If(branches, otherwise):
                ways = [_after(one, known) for one in (*(one for _, one in branches), otherwise)]
                if any(way is None or way.keys() != (ways[0] or {}).keys() for way in ways):
                    return None
                *cases, last = [way for way in ways if way is not None]
                conditions = [specialised(condition, known, _undecided) for condition, _ in branches]
                for name in last:
                    chosen = tuple((c, way[name]) for c, way in zip(conditions, cases, strict=True))
                    known[name] = s.Conditional(chosen, last[name], statement.span)
            case s.Assert():
                continue
            case _:
                return None
    return known


def _undecided(node: s.Node) -> None:
    return None


def _targets(node: object) -> Iterator[str]:
    """The names that statements assign, each as often as they do."""
    if isinstance(node, s.Assign):
        yield node.target.name
    elif isinstance(node, s.AssignCall):
        yield from (target.name for target in node.targets if target is not None)
    elif isinstance(node, tuple):
        for part in node:
            yield from _targets(part)
    elif isinstance(node, s.For | s.While):
        yield from _targets(node.body)
    elif isinstance(node, s.If | s.When):
        yield from _targets((*(body for _, body in node.branches), getattr(node, "otherwise", ())))


def _is_loose(variable: s.FlatVariable) -> bool:
    is_open = variable.variability == "parameter" and variable.binding is None
    return is_open and bool(variable.fixed) and not any(variable.fixed)


def _name(node: s.Node) -> str:
    return node.name if isinstance(node, s.Name) and not node.subscripts else ""


def _binds(left: s.Node, right: s.Node, loose: dict[str, s.FlatVariable], parameters: set[str]) -> bool:
    """Whether `left = right` computes a loose parameter from others."""
    names = referenced_names(right)
    return _name(left) in loose and _name(left) not in names and all(n in parameters for n in names)


def _settled(variable: s.FlatVariable, bindings: dict[str, s.Node]) -> s.FlatVariable:
    if variable.name in bindings:
        return replace(variable, binding=bindings[variable.name], fixed=())
    return replace(variable, variability="continuous", fixed=())


def _kept(variable: s.FlatVariable) -> s.FlatEquation:
    rate = s.Call("der", (s.Name(variable.name),), builtin=True, span=variable.span)
    origin = variable.name.rpartition(".")[0]
    nothing: s.Node = s.Constant(0)
    for size in reversed(variable.dimensions):
        nothing = s.Array((nothing,) * size)
    return s.FlatEquation(rate, nothing, "component", origin, variable.span)
