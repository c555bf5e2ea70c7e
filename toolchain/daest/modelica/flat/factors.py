"""Factors of parameters in bare equations: what a row is divided by, which plain factor an expression is,
and how Modelica writes one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from daest.model.flat import FlatModel
from daest.modelica.language.text import factor_number

ONE = ca.SX(1.0)
_N_POINTS = 3  # at which expressions must agree
_TOLERANCE = 1e-9  # relative, of what rounding alone makes differ
_SEED = 20040102
_SUM, _PRODUCT, _POWER = 1, 2, 3  # precedence
_INFIX = {
    ca.OP_ADD: ("+", _SUM),
    ca.OP_SUB: ("-", _SUM),
    ca.OP_MUL: ("*", _PRODUCT),
    ca.OP_DIV: ("/", _PRODUCT),
}


class Entry(NamedTuple):
    """Where the flow of an effect enters a model: the `row` of its equations, on the left for the `sign` +1,
    and the `factor` of parameters that it has there."""

    row: int
    sign: float
    factor: ca.SX = ONE

    @property
    def in_residual(self) -> ca.SX:
        """By what the flow is multiplied in the residual."""
        return self.sign * self.factor

    def term(self, name: str, flat: FlatModel) -> str | None:
        """The flow `name` with its factor, as Modelica writes it; None where that has no text."""
        written = factor_text(self.factor, flat)
        return None if written is None else multiplied(name, written)


def multiplied(name: str, factor: str) -> str:
    """A variable times a factor as `factor_text` writes it.

    >>> multiplied("w", ""), multiplied("w", "r"), multiplied("w", "1/n")
    ('w', 'r*w', 'w/n')
    """
    if factor.startswith("1/"):
        return name + factor[1:]
    return f"{factor}*{name}" if factor else name


def is_of_parameters(flat: FlatModel, expression: ca.SX) -> bool:
    """Whether nothing but parameters changes the values of an expression."""
    moving = ca.vertcat(flat.xi, flat.derivatives, flat.u, flat.w, flat.time)
    return not ca.depends_on(expression, moving)


def given_value(flat: FlatModel, expression: ca.SX) -> float:
    """The value of a scalar expression of the parameters, at those of the model."""
    return float(ca.Function("value", [flat.theta], [expression])(flat.theta_values))


def divisors(expression: ca.SX) -> Iterator[ca.SX]:
    """What is divided by anywhere in a scalar expression, and holds symbols."""
    seen: set[int] = set()
    left = [expression]
    while left:
        one = left.pop()
        if one.element_hash() in seen:
            continue
        seen.add(one.element_hash())
        parts = [one.dep(i) for i in range(one.n_dep())]
        if one.op() in (ca.OP_DIV, ca.OP_INV) and not parts[-1].is_constant():
            yield parts[-1]
        left += parts


def factors(product: ca.SX) -> Iterator[ca.SX]:
    """The factors of a product, of a product of products all."""
    for part in (product.dep(i) for i in range(product.n_dep())) if product.op() == ca.OP_MUL else (product,):
        yield from factors(part) if part.op() == ca.OP_MUL else (part,)


def sum_around(expression: ca.SX, symbol: ca.SX) -> ca.SX | None:
    """The largest sum within a scalar expression that a symbol is a term of, which stands once in it; None
    where it stands several times, or where nothing is done with the sum."""
    above: dict[int, list[ca.SX]] = {}
    left, seen = [expression], {expression.element_hash()}
    while left:
        one = left.pop()
        for part in (one.dep(i) for i in range(one.n_dep())):
            above.setdefault(part.element_hash(), []).append(one)
            if part.element_hash() not in seen:
                seen.add(part.element_hash())
                left.append(part)
    term, is_sum = symbol, True
    while is_sum:
        users = above.get(term.element_hash(), [])
        if len(users) != 1:
            return None
        is_sum = users[0].op() in (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG)
        term = users[0] if is_sum else term
    return term


def at_points(flat: FlatModel, expression: ca.SX, theta: np.ndarray | None = None) -> np.ndarray:
    """The values of an expression (n, m) at random points of the variables, and of the parameters unless
    `theta` (n_theta,) has them, (n, m, n_points)."""
    everything = [flat.xi, flat.derivatives, flat.u, flat.w]
    evaluate = ca.Function("values", [*everything, flat.theta, flat.time], [expression])
    rng = np.random.default_rng(_SEED)

    def drawn(symbols: ca.SX) -> np.ndarray:
        return rng.uniform(0.5, 1.5, symbols.numel())

    values = []
    for _ in range(_N_POINTS):
        point = [drawn(symbols) for symbols in everything]
        values.append(evaluate(*point, drawn(flat.theta) if theta is None else theta, 0.7).full())
    return np.stack(values, axis=-1)


def are_same(flat: FlatModel, one: ca.SX, other: ca.SX, theta: np.ndarray | None = None) -> bool:
    """Whether two scalar expressions have the same values, at random points of the variables and of the
    parameters unless `theta` (n_theta,) has them."""
    a, b = at_points(flat, ca.vertcat(one, other), theta)[:, 0]
    return bool(np.allclose(a, b, rtol=_TOLERANCE, atol=0.0))


def plain_factor(flat: FlatModel, expression: ca.SX) -> ca.SX | None:
    """The number, the parameter or one over a parameter that an expression of the parameters is, with its
    sign, be it written as it may; None where it is none of them."""
    value = at_points(flat, expression)[0, 0]
    if not np.all(np.isfinite(value)):
        return None
    if np.allclose(value, value[0], rtol=_TOLERANCE, atol=0.0):
        return ca.SX(float(value[0]))
    for symbol in ca.vertsplit(flat.theta):
        for simple in (symbol, -symbol, 1.0 / symbol, -(1.0 / symbol)):
            if are_same(flat, expression, simple):
                return simple
    return None


def signed(factor: ca.SX) -> tuple[float, ca.SX]:
    """The sign of a plain factor, and its size."""
    if factor.is_constant():
        return (-1.0, -factor) if float(factor) < 0.0 else (1.0, factor)
    return (-1.0, factor.dep(0)) if factor.op() == ca.OP_NEG else (1.0, factor)


def signed_text(factor: ca.SX, flat: FlatModel) -> tuple[str, str | None]:
    """The sign of a plain factor and its size as `factor_text` writes it."""
    sign, size = signed(factor)
    return "-" if sign < 0.0 else "+", factor_text(size, flat)


def factor_text(factor: ca.SX, flat: FlatModel) -> str | None:
    """A factor of parameters as Modelica writes it before a `*`: empty for one; None for anything but sums,
    products, ratios and squares."""
    if factor.is_constant() and float(factor) == 1.0:
        return ""
    written = _written(factor, _names(flat.theta, flat.parameter_names))
    if written is None:
        return None
    text, precedence = written
    return text if precedence >= _PRODUCT else f"({text})"


def variables_text(expression: ca.SX, flat: FlatModel, instead: Mapping[str, str]) -> str | None:
    """An expression of variables and parameters as Modelica writes it, with other texts for the variables
    that `instead` names; None as that of `factor_text`."""
    names: dict[int, str] = {}
    for symbols, own in (
        (flat.theta, flat.parameter_names),
        (flat.xi, flat.unknown_names),
        (flat.u, flat.input_names),
    ):
        names |= _names(symbols, [instead.get(name, name) for name in own])
    written = _written(expression, names)
    return None if written is None else written[0]


def _names(symbols: ca.SX, names: Sequence[str]) -> dict[int, str]:
    """Names by the hash of their symbols."""
    return {symbols[k].element_hash(): name for k, name in enumerate(names)}


def _written(one: ca.SX, names: dict[int, str]) -> tuple[str, int] | None:
    """The text of an expression, and its precedence."""
    if one.is_constant():
        value = float(one)
        shown = factor_number(value)
        return (shown, _POWER) if value >= 0.0 else (f"({shown})", _POWER)
    if one.is_symbolic():
        name = names.get(one.element_hash())
        return None if name is None else (name, _POWER)
    parts = [_written(one.dep(i), names) for i in range(one.n_dep())]
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    if one.op() in _INFIX:
        mark, own = _INFIX[one.op()]
        (a, left), (b, right) = known
        is_tight = right > own or (right == own and mark in "+*")
        spaced = f" {mark} " if own == _SUM else mark
        return f"{a if left >= own else f'({a})'}{spaced}{b if is_tight else f'({b})'}", own
    (a, inner) = known[0]
    tight = a if inner > _PRODUCT else f"({a})"
    if one.op() == ca.OP_NEG:
        return f"(-{tight})", _POWER
    if one.op() == ca.OP_SQ:
        return f"{tight}^2", _PRODUCT
    if one.op() == ca.OP_INV:
        return f"1/{tight}", _PRODUCT
    if one.op() == ca.OP_TWICE:
        return f"2*{tight}", _PRODUCT
    return None
