"""Built-in operators and functions of Modelica on values (Language Specification 3.7 and 10.3)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from daest.modelica.language.values import (
    Scalar,
    ShapeError,
    Value,
    add,
    array,
    combined,
    divide,
    filled,
    from_flat,
    is_symbolic,
    mapped,
    multiply,
    product,
    subtract,
    total,
)

# Operators that a model with events gives a meaning to.
EVENTFUL = ("pre", "edge", "change", "sample", "initial", "terminal")

# Operators that need a memory or an event: the equation list of a differential-algebraic model has neither.
REFUSED = (
    "pre",
    "edge",
    "change",
    "reinit",
    "sample",
    "initial",
    "terminal",
    "delay",
    "spatialDistribution",
    "Clock",
    "previous",
    "hold",
    "subSample",
    "superSample",
    "shiftSample",
    "backSample",
    "noClock",
    "firstTick",
    "interval",
    "inStream",
    "actualStream",
)

STILL = 1e-13  # flow, in its own unit, below which `semiLinear` mixes what is before and behind

Function = Callable[[Sequence[Value]], Value]


def _unary(number: Callable[[float], float], symbol: Callable[[ca.SX], ca.SX]) -> Function:
    def one(x: Scalar) -> Scalar:
        return symbol(x) if isinstance(x, ca.SX) else number(float(x))

    return lambda arguments: mapped(one, arguments[0])


def _sign(x: Scalar) -> Scalar:
    return ca.sign(x) if isinstance(x, ca.SX) else (x > 0) - (x < 0)  # type: ignore[operator]


def _abs(x: Scalar) -> Scalar:
    return ca.fabs(x) if isinstance(x, ca.SX) else abs(x)  # type: ignore[arg-type]


def _floor(x: Scalar) -> Scalar:
    return ca.floor(x) if isinstance(x, ca.SX) else math.floor(x)  # type: ignore[arg-type]


def _ceil(x: Scalar) -> Scalar:
    return ca.ceil(x) if isinstance(x, ca.SX) else math.ceil(x)  # type: ignore[arg-type]


def _truncated_division(x: Scalar, y: Scalar) -> Scalar:
    quotient = divide(x, y)
    if isinstance(quotient, ca.SX):
        return ca.if_else(quotient >= 0, ca.floor(quotient), ca.ceil(quotient))
    return math.trunc(quotient)  # type: ignore[arg-type]


def _mod(x: Scalar, y: Scalar) -> Scalar:
    return subtract(x, multiply(_floor(divide(x, y)), y))


def _rem(x: Scalar, y: Scalar) -> Scalar:
    return subtract(x, multiply(_truncated_division(x, y), y))


def _atan2(y: Scalar, x: Scalar) -> Scalar:
    return ca.atan2(y, x) if is_symbolic(y) or is_symbolic(x) else math.atan2(y, x)  # type: ignore[arg-type]


def _smaller(a: Scalar, b: Scalar) -> Scalar:
    return ca.fmin(a, b) if is_symbolic(a) or is_symbolic(b) else min(a, b)  # type: ignore


def _larger(a: Scalar, b: Scalar) -> Scalar:
    return ca.fmax(a, b) if is_symbolic(a) or is_symbolic(b) else max(a, b)  # type: ignore


def _binary(operation: Callable[[Scalar, Scalar], Scalar]) -> Function:
    return lambda arguments: combined(operation, arguments[0], arguments[1])


def _extreme(operation: Callable[[Scalar, Scalar], Scalar], empty: float) -> Function:
    def reduced(arguments: Sequence[Value]) -> Value:
        if len(arguments) == 2:
            return combined(operation, arguments[0], arguments[1])
        values = _flat(arguments[0])
        if not values:
            return empty
        made = values[0]
        for value in values[1:]:
            made = operation(made, value)
        return made

    return reduced


def _flat(value: Value) -> list[Scalar]:
    return list(value.flat) if isinstance(value, np.ndarray) else [value]  # type: ignore[list-item]


def _multiply_all(arguments: Sequence[Value]) -> Value:
    made: Scalar = 1
    for value in _flat(arguments[0]):
        made = multiply(made, value)
    return made


def _semi_linear(arguments: Sequence[Value]) -> Value:
    x, positive, negative = arguments
    if isinstance(x, ca.SX):
        # Where nothing flows the state of what flows is undetermined between two such equations: a flow too
        # small to matter mixes both.
        flow = ca.fmax(ca.fabs(x), STILL)
        return 0.5 * (x * (positive + negative) + flow * (positive - negative))  # type: ignore[operator]
    return multiply(positive if x >= 0 else negative, x)  # type: ignore[operator, arg-type]


def integer(value: Value) -> int:
    """The value as a size or index. Raises ValueError when it is symbolic or not whole."""
    if isinstance(value, bool | int):
        return int(value)
    if isinstance(value, float) and value.is_integer():
        return int(value)
    raise ValueError("a size or index must be a constant whole number")


def _shape(value: Value) -> tuple[int, ...]:
    return value.shape if isinstance(value, np.ndarray) else ()


def _size(arguments: Sequence[Value]) -> Value:
    shape = _shape(arguments[0])
    if len(arguments) == 1:
        return array(list(shape))
    at = integer(arguments[1])
    if not 1 <= at <= len(shape):
        raise ShapeError(f"size(x, {at}) of an array with {len(shape)} dimensions")
    return shape[at - 1]


def _vector(arguments: Sequence[Value]) -> Value:
    values = _flat(arguments[0])
    return from_flat(values, (len(values),))


def _scalar(arguments: Sequence[Value]) -> Value:
    values = _flat(arguments[0])
    if len(values) != 1:
        raise ShapeError(f"scalar() of {len(values)} elements")
    return values[0]


def _matrix(arguments: Sequence[Value]) -> Value:
    value = arguments[0]
    if not isinstance(value, np.ndarray):
        return filled(value, (1, 1))  # type: ignore[arg-type]
    return value[:, np.newaxis] if value.ndim == 1 else value


def diagonal(values: Sequence[Scalar]) -> np.ndarray:
    """The square matrix with the values on its diagonal. Shapes: values (n,); matrix (n, n)."""
    n = len(values)
    return from_flat((values[i] if i == j else 0 for i in range(n) for j in range(n)), (n, n))


def _fill(value: Value, sizes: Sequence[Value]) -> Value:
    shape = tuple(integer(size) for size in sizes)
    if isinstance(value, np.ndarray):
        made = np.empty(shape + value.shape, dtype=object)
        made[...] = value
        return made
    return filled(value, shape)  # type: ignore[arg-type]


def _linspace(arguments: Sequence[Value]) -> Value:
    first, last, count = arguments[0], arguments[1], integer(arguments[2])
    if count < 2:
        raise ValueError("linspace needs at least two points")
    step = divide(subtract(last, first), count - 1)  # type: ignore[arg-type]
    return from_flat((add(first, multiply(i, step)) for i in range(count)), (count,))  # type: ignore[arg-type]


def _transpose(arguments: Sequence[Value]) -> Value:
    value = arguments[0]
    if not isinstance(value, np.ndarray) or value.ndim < 2:
        raise ShapeError("transpose() needs a matrix")
    return np.swapaxes(value, 0, 1)


def _outer(arguments: Sequence[Value]) -> Value:
    a, b = _flat(arguments[0]), _flat(arguments[1])
    return from_flat((multiply(x, y) for x in a for y in b), (len(a), len(b)))


def _symmetric(arguments: Sequence[Value]) -> Value:
    value = arguments[0]
    assert isinstance(value, np.ndarray)
    n = value.shape[0]
    return from_flat((value[min(i, j), max(i, j)] for i in range(n) for j in range(n)), (n, n))


def _skew(arguments: Sequence[Value]) -> Value:
    x, y, z = _flat(arguments[0])
    return from_flat((0, -z, y, z, 0, -x, -y, x, 0), (3, 3))  # type: ignore[operator]


def _cross(arguments: Sequence[Value]) -> Value:
    return product(_skew(arguments[:1]), arguments[1])


def _concatenate(arguments: Sequence[Value]) -> Value:
    axis = integer(arguments[0]) - 1
    parts = [value if isinstance(value, np.ndarray) else filled(value, (1,)) for value in arguments[1:]]  # type: ignore[arg-type]
    return np.concatenate(parts, axis=axis)


def matrix_of_rows(rows: Sequence[Sequence[Value]]) -> np.ndarray:
    """`[a, b; c, d]`: scalars and vectors become columns, then rows are put side by side and below each
    other. Shapes: parts (k_i, m_j) become (Σ k_i, Σ m_j)."""
    made = [np.concatenate([_as_matrix(value) for value in row], axis=1) for row in rows]
    return np.concatenate(made, axis=0)


def _as_matrix(value: Value) -> np.ndarray:
    made = _matrix([value])
    assert isinstance(made, np.ndarray)
    return made


def _ndims(arguments: Sequence[Value]) -> Value:
    return len(_shape(arguments[0]))


BUILTINS: dict[str, Function] = {
    "abs": lambda a: mapped(_abs, a[0]),
    "sign": lambda a: mapped(_sign, a[0]),
    "sqrt": _unary(math.sqrt, ca.sqrt),
    "div": _binary(_truncated_division),
    "mod": _binary(_mod),
    "rem": _binary(_rem),
    "floor": lambda a: mapped(_floor, a[0]),
    "ceil": lambda a: mapped(_ceil, a[0]),
    "integer": lambda a: mapped(_floor, a[0]),
    "min": _extreme(_smaller, math.inf),
    "max": _extreme(_larger, -math.inf),
    "sin": _unary(math.sin, ca.sin),
    "cos": _unary(math.cos, ca.cos),
    "tan": _unary(math.tan, ca.tan),
    "asin": _unary(math.asin, ca.asin),
    "acos": _unary(math.acos, ca.acos),
    "atan": _unary(math.atan, ca.atan),
    "atan2": _binary(_atan2),
    "sinh": _unary(math.sinh, ca.sinh),
    "cosh": _unary(math.cosh, ca.cosh),
    "tanh": _unary(math.tanh, ca.tanh),
    "exp": _unary(math.exp, ca.exp),
    "log": _unary(math.log, ca.log),
    "log10": _unary(math.log10, ca.log10),
    "noEvent": lambda a: a[0],
    "smooth": lambda a: a[1],
    "homotopy": lambda a: a[0],
    "semiLinear": _semi_linear,
    "sum": lambda a: total(_flat(a[0])),
    "product": _multiply_all,
    "ndims": _ndims,
    "size": _size,
    "scalar": _scalar,
    "vector": _vector,
    "matrix": _matrix,
    "identity": lambda a: diagonal([1] * integer(a[0])),
    "diagonal": lambda a: diagonal(_flat(a[0])),
    "zeros": lambda a: _fill(0, a),
    "ones": lambda a: _fill(1, a),
    "fill": lambda a: _fill(a[0], a[1:]),
    "linspace": _linspace,
    "transpose": _transpose,
    "outerProduct": _outer,
    "symmetric": _symmetric,
    "cross": _cross,
    "skew": _skew,
    "cat": _concatenate,
}
