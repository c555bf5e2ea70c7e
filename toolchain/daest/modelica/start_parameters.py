"""Parameters with `fixed = false`: the start of the model decides them, not their declaration."""

from __future__ import annotations

from dataclasses import replace

from daest.modelica import syntax as s
from daest.modelica.parameters import is_parameter, referenced_names


def with_settled_parameters(source: s.FlatSource) -> s.FlatSource:
    """The source without loose parameters. One that an initial equation or algorithm computes from other
    parameters gets that as its binding; any other one becomes a variable that keeps its value, der(p) = 0,
    and that the initial equations determine (Language Specification 8.6)."""
    loose = {x.name: x for x in source.variables if _is_loose(x)}
    if not loose:
        return source
    parameters = {x.name for x in source.variables if is_parameter(x)}
    bindings: dict[str, s.Node] = {}
    used: set[int] = set()
    for algorithm in source.initial_algorithms:
        for statement in algorithm.body:
            if isinstance(statement, s.Assign) and _binds(
                statement.target, statement.value, loose, parameters
            ):
                bindings[statement.target.name] = statement.value
    for equation in source.initial_equations:
        for left, right in ((equation.left, equation.right), (equation.right, equation.left)):
            if left is None or right is None or id(equation) in used:
                continue
            if _binds(left, right, loose, parameters) and _name(left) not in bindings:
                bindings[_name(left)] = right
                used.add(id(equation))
    return replace(
        source,
        variables=tuple(_settled(x, bindings) if x.name in loose else x for x in source.variables),
        equations=(*source.equations, *(_kept(x) for x in loose.values() if x.name not in bindings)),
        initial_equations=tuple(e for e in source.initial_equations if id(e) not in used),
        settled=frozenset(loose) - set(bindings),
    )


def _is_loose(variable: s.FlatVariable) -> bool:
    is_open = variable.variability == "parameter" and variable.binding is None and not variable.is_discrete
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
