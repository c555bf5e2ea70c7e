"""One element of an array expression, as an expression: for the texts of array equations."""

from __future__ import annotations

from collections.abc import Callable

from daest.modelica.language import syntax as s

# The size of a node's value, () for a scalar.
Sizes = Callable[[s.Node], tuple[int, ...]]

_ELEMENTWISE = ("+", "-", ".+", ".-", ".*", "./", ".^")
_ELEMENTWISE_CALLS = ("der", "abs", "sign", "sqrt", "sin", "cos", "tan", "exp", "log", "tanh", "noEvent")

# A product of matrices with more terms per element is shown as `(A*x)[i]`.
_SHOWN_TERMS = 6


def broadcast(node: s.Node, at: tuple[int, ...], size: Sizes) -> s.Node:
    """`element`, or the node itself where it is a scalar that goes with every element."""
    return element(node, at, size) if size(node) else node


def element(node: s.Node, at: tuple[int, ...], size: Sizes) -> s.Node:
    """The node of element `at` (from 0) of an array expression: `{a, b}*k` at (1,) -> `b*k`."""
    match node:
        case s.Array(elements, False) if at[0] < len(elements):
            return element(elements[at[0]], at[1:], size) if len(at) > 1 else elements[at[0]]
        case s.Array(rows, True) if (found := _matrix_entry(rows, at, size)) is not None:
            return found
        case s.Unary(operator, operand):
            return s.Unary(operator, element(operand, at, size))
        case s.Binary(operator, left, right) if operator in _ELEMENTWISE or _scales(node, size):
            return s.Binary(operator, broadcast(left, at, size), broadcast(right, at, size))
        case s.Binary("*", left, right) if size(left)[-1] <= _SHOWN_TERMS:
            return _product_entry(left, right, at, size)
        case s.Call(function, (argument,), True) if function in _ELEMENTWISE_CALLS:
            return s.Call(function, (element(argument, at, size),), True)
        case s.Conditional(branches, otherwise):
            chosen = tuple((condition, broadcast(value, at, size)) for condition, value in branches)
            return s.Conditional(chosen, broadcast(otherwise, at, size))
        case s.Constant():
            return node
        case s.Name(name, subscripts) if (inner := _inner_subscripts(subscripts, at)) is not None:
            return s.Name(name, inner)
    return s.Index(node, tuple(s.Constant(i + 1) for i in at))


def _matrix_entry(rows: tuple[s.Node, ...], at: tuple[int, ...], size: Sizes) -> s.Node | None:
    """An entry of `[a, b; c, d]` whose parts are all scalars."""
    lists = [row.elements if isinstance(row, s.Array) else (row,) for row in rows]
    if len(at) != 2 or any(size(part) for row in lists for part in row):
        return None
    return lists[at[0]][at[1]]


def _scales(node: s.Binary, size: Sizes) -> bool:
    """A product with a scalar, or a quotient, goes element by element."""
    return node.operator in ("*", "/") and (size(node.left) == () or size(node.right) == ())


def _product_entry(left: s.Node, right: s.Node, at: tuple[int, ...], size: Sizes) -> s.Node:
    """`(A*x)` at (0,) -> `A[1,1]*x[1] + A[1,2]*x[2]`."""
    row = at[:1] if len(size(left)) == 2 else ()
    column = at[-1:] if len(size(right)) == 2 else ()
    terms = [
        s.Binary("*", element(left, (*row, k), size), element(right, (k, *column), size))
        for k in range(size(left)[-1])
    ]
    made: s.Node = terms[0]
    for term in terms[1:]:
        made = s.Binary("+", made, term)
    return made


def _inner_subscripts(subscripts: tuple[s.Node, ...], at: tuple[int, ...]) -> tuple[s.Node, ...] | None:
    """Subscripts of an element: `x` at (1,) -> `x[2]`, `x[3:4]` at (1,) -> `x[4]`; None when that is not
    plain."""
    left = list(at)
    made: list[s.Node] = []
    for node in subscripts:
        match node:
            case s.Constant():
                made.append(node)
            case s.Colon() if left:
                made.append(s.Constant(left.pop(0) + 1))
            case s.Range(s.Constant(int(first)), None, _) if left:
                made.append(s.Constant(first + left.pop(0)))
            case _:
                return None
    return (*made, *(s.Constant(i + 1) for i in left))
