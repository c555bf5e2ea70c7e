"""The variables of a model: inputs, noises and unknowns with their symbols, and variables that stand for an
expression (bound inputs of components; Boolean, Integer and enumeration variables)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.modelica.flat.parameters import is_parameter
from daest.modelica.flat.reading import Reading
from daest.modelica.flat.scope import Element, element_names, symbols
from daest.modelica.language import syntax as s
from daest.modelica.language import values as v
from daest.modelica.language.expressions import indexed
from daest.modelica.language.operators import integer
from daest.modelica.language.text import text
from daest.modelica.language.values import Value

# One way a discrete variable, or one element of it, is defined: the equation (None: the binding), and its
# right side.
Definition = tuple[s.FlatEquation | None, s.Node]


@dataclass
class Declared:
    """Scalars by their role; `derivatives` are the symbols of der() of the unknowns. `defining` are
    equations that define a discrete variable and so give no row; `substitutes` are the expressions of bound
    inputs."""

    inputs: list[Element] = field(default_factory=list)
    noises: list[Element] = field(default_factory=list)
    unknowns: list[Element] = field(default_factory=list)
    derivatives: list[ca.SX] = field(default_factory=list)
    defining: list[s.FlatEquation] = field(default_factory=list)
    substitutes: dict[str, s.Node] = field(default_factory=dict)
    held: list[Element] = field(default_factory=list)  # unknowns that keep their values between events
    definitions: dict[str, list[Definition]] = field(default_factory=dict)  # of discrete variables


def declare_variables(reading: Reading) -> Declared:
    """Symbols for all variables, put into the scope of `reading`. Raises ModelError."""
    declared = Declared()
    definitions = declared.definitions = _definitions(reading, declared)
    for variable in reading.source.variables:
        if is_parameter(variable):
            continue
        if reading.is_noise(variable):
            declared.noises += _elements(variable, reading)
        elif variable.name in reading.targets and variable.is_discrete:
            assert reading.events is not None
            reading.events.remember(variable)
        elif variable.causality == "input" and variable.is_top_level:
            declared.inputs += _elements(variable, reading)
        elif variable.name in definitions:
            reading.scope.pending[variable.name] = _Maker(reading, variable, definitions[variable.name])
        else:
            restarted = variable.name in reading.restarted
            shown = replace(variable, state_select="always") if restarted else variable
            elements = _elements(shown, reading)
            declared.unknowns += elements
            declared.derivatives += _derivatives(variable, reading)
            if variable.name in reading.source.settled and reading.events is not None:
                reading.events.hold(element.name for element in elements)
            if variable.name in reading.targets:
                assert reading.events is not None
                reading.events.hold(element.name for element in elements)
                declared.held += elements
    return declared


def _elements(variable: s.FlatVariable, reading: Reading) -> list[Element]:
    names = element_names(variable.name, variable.dimensions)
    value = symbols(names, variable.dimensions)
    reading.scope.values[variable.name] = value
    return [
        Element(name, i, variable, v.symbolic(symbol))
        for i, (name, symbol) in enumerate(zip(names, v.elements(value), strict=True))
    ]


def _derivatives(variable: s.FlatVariable, reading: Reading) -> list[ca.SX]:
    names = [f"der({name})" for name in element_names(variable.name, variable.dimensions)]
    value = symbols(names, variable.dimensions)
    reading.scope.derivatives[variable.name] = value
    return [v.symbolic(symbol) for symbol in v.elements(value)]


def _definitions(reading: Reading, declared: Declared) -> dict[str, list[Definition]]:
    found: dict[str, list[Definition]] = {}
    for variable in reading.source.variables:
        if is_parameter(variable) or variable.binding is None:
            continue
        is_bound_input = variable.causality == "input" and not variable.is_top_level
        if is_bound_input and not variable.dimensions and not reading.is_noise(variable):
            declared.substitutes[variable.name] = variable.binding
        if is_bound_input or variable.name in reading.discrete:
            found[variable.name] = [(None, variable.binding)]
    open_ends: list[s.FlatEquation] = []
    backward: list[s.FlatEquation] = []
    for equation in reading.source.equations:
        left, right = equation.left, equation.right
        if (names := _discrete_elements(left, right, reading)) and right is not None:
            # `a.b = expression` of an array of components: {a[1].b, a[2].b} = expression.
            for i, one in enumerate(names):
                part = s.Index(right, (s.Constant(i + 1),))
                found.setdefault(one.name, []).append((replace(equation, left=one, right=part), part))
            declared.defining.append(equation)
            continue
        if not isinstance(left, s.Name) or left.name not in reading.discrete or right is None:
            if _is_discrete(right, reading):
                backward.append(equation)
            continue
        is_connection = equation.kind == "connection" and isinstance(right, s.Name)
        is_link = is_connection and right.name in reading.discrete  # type: ignore[union-attr]
        if is_link or (_is_discrete(left, reading) and _is_discrete(right, reading) and not equation.bound):
            open_ends.append(equation)
        elif left.name in reading.targets:
            continue  # an equation for what stands on the right
        else:
            found.setdefault(left.name, []).append((equation, right))
        declared.defining.append(equation)
    for equation in backward:
        # `expression = b` defines b where nothing else does; otherwise b is given, and the rest follows.
        assert isinstance(equation.right, s.Name)
        if equation.right.name not in found and equation.right.name not in reading.targets:
            turned = replace(equation, left=equation.right, right=equation.left)
            found[equation.right.name] = [(turned, equation.left)]
            declared.defining.append(equation)
    known = _connect(found, open_ends, reading)
    for name in sorted(reading.discrete - reading.targets):
        _check_is_defined(reading, name, known)
    return found


def _discrete_elements(left: s.Node, right: s.Node | None, reading: Reading) -> list[s.Name]:
    """The discrete variables of which an array on the left of an equation is made, none of them assigned by
    events; empty where it is something else."""
    if not isinstance(left, s.Array) or left.is_matrix or right is None:
        return []
    names = [x for x in left.elements if isinstance(x, s.Name) and x.name in reading.discrete]
    is_all = len(names) == len(left.elements) and not any(x.name in reading.targets for x in names)
    return names if is_all else []


def _is_discrete(node: s.Node | None, reading: Reading) -> bool:
    """Whether a node is a whole discrete variable."""
    return isinstance(node, s.Name) and not node.subscripts and node.name in reading.discrete


Key = tuple[str, tuple[int, ...]]  # an element of a variable, by its indices from 1; of a scalar (name, ())


def _connect(
    found: dict[str, list[Definition]], connections: list[s.FlatEquation], reading: Reading
) -> set[Key]:
    """Discrete variables that an equation `a = b` equates get their definition from the end that has one,
    element by element where not all of them have it from one place. Returns all elements that are defined."""
    given = {x.name for x in reading.source.variables if x.causality == "input" and x.is_top_level}
    known: set[Key] = set()
    for name in (*reading.targets, *(given & reading.discrete)):
        known.update(_keys(s.Name(name), (), reading))
    for name, definitions in found.items():
        for equation, _ in definitions:
            left = s.Name(name) if equation is None else equation.left
            bound = () if equation is None else equation.bound
            known.update(_keys(left, bound, reading) if isinstance(left, s.Name) else ())
    ends = [
        (one, _keys(one.left, one.bound, reading), _keys(one.right, one.bound, reading))
        for one in connections
        if isinstance(one.left, s.Name) and isinstance(one.right, s.Name)
    ]
    before = -1
    while len(known) > before:
        before = len(known)
        for connection, here, there in ends:
            if len(here) == len(there):
                _pass_on(connection, here, there, known, found)
    return known


def _pass_on(
    equation: s.FlatEquation,
    left: list[Key],
    right: list[Key],
    known: set[Key],
    found: dict[str, list[Definition]],
) -> None:
    """Definitions for those elements of both ends of a connection of which only the other end has one."""
    for node, mine, other, theirs in (
        (equation.left, left, equation.right, right),
        (equation.right, right, equation.left, left),
    ):
        assert isinstance(node, s.Name) and isinstance(other, s.Name)
        new = [(a, b) for a, b in zip(mine, theirs, strict=True) if a not in known and b in known]
        if len(new) == len(mine) and not node.subscripts and not equation.bound:
            found[node.name] = [(replace(equation, left=node, right=other), other)]
        else:
            for to, source in new:
                made = replace(equation, left=_element(to), right=_element(source), bound=())
                found.setdefault(node.name, []).append((made, _element(source)))
        known.update(a for a, _ in new)


def _element(key: Key) -> s.Name:
    name, indices = key
    return s.Name(name, tuple(s.Constant(index) for index in indices))


def _keys(node: s.Node | None, bound: tuple[tuple[str, int], ...], reading: Reading) -> list[Key]:
    """The elements that a name stands for, in order; `bound` are values of for-iterators."""
    assert isinstance(node, s.Name)
    shape = reading.scope.declared_shape(node.name) or ()
    if not shape:
        return [(node.name, ())]
    every = np.empty(shape, dtype=object)
    for position in np.ndindex(*shape):
        every[position] = (node.name, tuple(i + 1 for i in position))
    evaluator = reading.evaluator(reading.scope, node.span)
    with evaluator.bound([name for name, _ in bound], [value for _, value in bound]):
        subscripts = [None if isinstance(x, s.Colon) else evaluator.value(x) for x in node.subscripts]
    chosen = indexed(every, subscripts)
    return [*chosen.flat] if isinstance(chosen, np.ndarray) else [chosen]  # type: ignore[list-item]


def _check_is_defined(reading: Reading, name: str, known: set[Key]) -> None:
    """Raise ModelError where the discrete variable, or an element of it, has no definition."""
    missing = next((key for key in _keys(s.Name(name), (), reading) if key not in known), None)
    if missing is None:
        return
    variable = next(x for x in reading.source.variables if x.name == name)
    shown = text(_element(missing))
    raise ModelError(
        "model-unsupported",
        f"{variable.type_name} variable `{shown}` has no equation of the form `{shown} = expression`",
        where=reading.declared_at(variable),
        remedy="Define it by one equation, or use a Real variable.",
    )


@dataclass(frozen=True)
class _Maker:
    """Makes the value of a defined variable when it is first used."""

    reading: Reading
    variable: s.FlatVariable
    definitions: list[Definition]

    def __call__(self) -> Value:
        equation, node = self.definitions[0]
        if equation is None or not isinstance(equation.left, s.Name) or not equation.left.subscripts:
            return self._value(equation, node)
        made = v.filled(0, self.variable.dimensions)
        for one, right in self.definitions:
            assert one is not None and isinstance(one.left, s.Name)
            at = tuple(integer(self._value(one, subscript)) - 1 for subscript in one.left.subscripts)
            made[at] = self._value(one, right)
        return made

    def _value(self, equation: s.FlatEquation | None, node: s.Node) -> Value:
        span = self.variable.span if equation is None else equation.span
        bound = {} if equation is None else dict(equation.bound)
        evaluator = self.reading.evaluator(self.reading.scope, span)
        with evaluator.bound(list(bound), list(bound.values())):
            return evaluator.value(node)
