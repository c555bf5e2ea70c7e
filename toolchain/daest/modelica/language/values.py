"""Values that expressions take: numbers, CasADi SX scalars, arrays of them (NumPy object arrays) and records.

A constant stays a Python number, so that sizes, loop bounds and `if` conditions on constants are decided
while the model is read. Arithmetic follows chapter 10.6 of the Modelica Language Specification.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class Record:
    """Field values of a record in the order of its declaration."""

    fields: dict[str, Value]


Scalar = float | int | bool | str | ca.SX
Value = Scalar | np.ndarray | Record | tuple

Operation = Callable[..., Scalar]


class ShapeError(ValueError):
    """Two arrays do not fit together; the text names their sizes."""


def column(parts: Sequence[ca.SX]) -> ca.SX:
    """The symbols or expressions one below the other, (n, 1); (0, 1) of none."""
    return ca.vertcat(*parts) if parts else ca.SX(0, 1)


def array(elements: Sequence[Value]) -> np.ndarray:
    """The array with `elements` along a new first dimension. Raises ShapeError when their sizes differ.
    Shapes: n elements (...) become (n, ...)."""
    shapes = {e.shape if isinstance(e, np.ndarray) else () for e in elements}
    if len(shapes) > 1:
        raise ShapeError(f"elements of sizes {', '.join(sorted(map(size_text, shapes)))} in one array")
    inner: tuple[int, ...] = next(iter(shapes), ())
    made = np.empty((len(elements), *inner), dtype=object)
    for i, element in enumerate(elements):
        if isinstance(element, np.ndarray):
            made[i, ...] = element
        else:
            made[i] = element
    return made


def filled(value: Scalar, shape: tuple[int, ...]) -> np.ndarray:
    """An array of `shape` with `value` everywhere."""
    made = np.empty(shape, dtype=object)
    for i in range(made.size):
        made.flat[i] = value
    return made


def from_flat(elements: Iterable[Scalar], shape: tuple[int, ...]) -> np.ndarray:
    """The array of `shape` whose elements, the last index running fastest, are given."""
    made = np.empty(shape, dtype=object)
    for i, element in enumerate(elements):
        made.flat[i] = element
    return made


def size_text(shape: tuple[int, ...]) -> str:
    """The size of an array in words of a message."""
    return "scalar" if not shape else "[" + ", ".join(map(str, shape)) + "]"


def is_symbolic(value: Value) -> bool:
    """Whether the value depends on a symbol."""
    return isinstance(value, ca.SX)


def constant(value: Scalar) -> Scalar:
    """`value` as a number where it is an SX without symbols, else unchanged."""
    if isinstance(value, ca.SX) and value.is_constant():
        return float(value)
    return value


def symbolic(value: Scalar) -> ca.SX:
    """`value` as an SX scalar."""
    return ca.SX(value)  # type: ignore[arg-type]


def elements(value: Value) -> list[Scalar]:
    """All scalars of a value: arrays row by row, records and tuples field by field."""
    if isinstance(value, np.ndarray):
        return [scalar for e in value.flat for scalar in (elements(e) if isinstance(e, Record) else (e,))]
    if isinstance(value, Record):
        return [e for field in value.fields.values() for e in elements(field)]
    if isinstance(value, tuple):
        return [e for part in value for e in elements(part)]
    return [value]


def mapped(operation: Operation, value: Value) -> Value:
    """`operation` on a scalar, or on each element of an array."""
    if isinstance(value, np.ndarray):
        return from_flat((operation(e) for e in value.flat), value.shape)
    return operation(value)


def combined(operation: Operation, a: Value, b: Value) -> Value:
    """`operation` element by element; a scalar goes with every element. Raises ShapeError."""
    a_array, b_array = isinstance(a, np.ndarray), isinstance(b, np.ndarray)
    if not a_array and not b_array:
        return operation(a, b)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        if a.shape != b.shape:
            raise ShapeError(f"arrays of sizes {size_text(a.shape)} and {size_text(b.shape)}")
        return from_flat((operation(x, y) for x, y in zip(a.flat, b.flat, strict=True)), a.shape)
    if isinstance(a, np.ndarray):
        return from_flat((operation(x, b) for x in a.flat), a.shape)
    assert isinstance(b, np.ndarray)
    return from_flat((operation(a, y) for y in b.flat), b.shape)


def add(a: Scalar, b: Scalar) -> Scalar:
    """The sum of two scalars."""
    return a + b  # type: ignore[operator]


def subtract(a: Scalar, b: Scalar) -> Scalar:
    """The difference of two scalars."""
    return a - b  # type: ignore[operator]


def multiply(a: Scalar, b: Scalar) -> Scalar:
    """The product of two scalars."""
    return a * b  # type: ignore[operator]


def divide(a: Scalar, b: Scalar) -> Scalar:
    """The quotient of two scalars."""
    return a / b  # type: ignore[operator]


NOT_ZERO = 1e-300


def power(a: Scalar, b: Scalar) -> Scalar:
    """a^b; a negative number to a fractional power raises ValueError."""
    if is_symbolic(a) and is_symbolic(b):
        return _power_of_symbols(symbolic(a), symbolic(b))
    if is_symbolic(a) or is_symbolic(b):
        return a**b  # type: ignore[operator]
    made = float(a) ** float(b)
    if isinstance(made, complex):
        raise ValueError(f"{a}^{b} is not real")
    return made


def root_of_positive_part(x: Scalar) -> Scalar:
    """sqrt(max(0, x)), whose slope is 0 where x is not positive: a tank that has run empty. The chain rule
    would multiply the infinite slope of the root by zero there."""
    if not is_symbolic(x):
        return max(0.0, float(x)) ** 0.5
    inside = symbolic(x)
    return ca.if_else(inside > 0, ca.sqrt(ca.if_else(inside > 0, inside, 1.0)), 0.0)


def _power_of_symbols(a: ca.SX, b: ca.SX) -> ca.SX:
    """a^b by the size of a, and its sign where b is whole. The slope along b contains log(a): it would be
    undefined at zero, and where rounding has put an a that is never negative a little below zero."""
    size = ca.if_else(a < 0, -a, a) + NOT_ZERO * (a == 0)
    sign = ca.if_else(ca.floor(b) == b, ca.cos(np.pi * b), np.nan)
    return size**b * ca.if_else(a < 0, sign, 1)


def negate(a: Scalar) -> Scalar:
    """The negative of a scalar."""
    return -a  # type: ignore[operator]


def total(values: Iterable[Scalar]) -> Scalar:
    """The sum; 0 for none."""
    made: Scalar = 0
    for value in values:
        made = value if isinstance(made, int) and made == 0 else add(made, value)
    return made


def product(a: Value, b: Value) -> Value:
    """The Modelica product: scalar times anything, or the matrix product of vectors and matrices. Raises
    ShapeError where the sizes do not fit."""
    if not isinstance(a, np.ndarray) or not isinstance(b, np.ndarray):
        return combined(multiply, a, b)
    if a.shape[-1] != b.shape[0] or a.ndim > 2 or b.ndim > 2:
        raise ShapeError(f"the product of arrays of sizes {size_text(a.shape)} and {size_text(b.shape)}")
    if a.ndim == 1 and b.ndim == 1:
        return total(multiply(x, y) for x, y in zip(a, b, strict=True))
    rows = a if a.ndim == 2 else a[np.newaxis, :]
    columns = b if b.ndim == 2 else b[:, np.newaxis]
    entries = (total(multiply(x, y) for x, y in zip(r, c, strict=True)) for r in rows for c in columns.T)
    shape = (a.shape[:1] if a.ndim == 2 else ()) + (b.shape[1:] if b.ndim == 2 else ())
    return from_flat(entries, shape)


def matrix_power(a: np.ndarray, exponent: int) -> np.ndarray:
    """a^n of a square matrix, n >= 0. Raises ShapeError for any other array. Shapes: a (n, n)."""
    if a.ndim != 2 or a.shape[0] != a.shape[1]:
        raise ShapeError(f"the power of an array of size {size_text(a.shape)}; .^ is element by element")
    n = a.shape[0]
    made: Value = from_flat((float(i == j) for i in range(n) for j in range(n)), (n, n))
    for _ in range(exponent):
        made = product(made, a)
    assert isinstance(made, np.ndarray)
    return made


def choose(condition: ca.SX, yes: Value, no: Value) -> Value:
    """`if condition then yes else no` for a symbolic condition, element by element."""
    if isinstance(yes, Record) and isinstance(no, Record):
        return Record({name: choose(condition, value, no.fields[name]) for name, value in yes.fields.items()})
    if isinstance(yes, tuple) and isinstance(no, tuple):
        return tuple(choose(condition, a, b) for a, b in zip(yes, no, strict=True))
    return combined(lambda a, b: either(condition, a, b), yes, no)


def either(condition: ca.SX, yes: Scalar, no: Scalar) -> Scalar:
    return yes if yes is no else ca.if_else(condition, yes, no)  # type: ignore[arg-type]
