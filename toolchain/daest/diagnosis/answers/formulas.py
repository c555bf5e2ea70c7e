"""Short formulas for a curve that no effect of the library explains.

The grammar: sums of at most MOST_TERMS terms, each a coefficient times a function of the curve's variable: a
constant, its sign, powers of it or of its absolute value, sine and cosine of an angle, decaying exponentials,
parts beyond a threshold, saturations. Thresholds and decay lengths stand at knots of the curve. Every sum is
fitted to the curve's values in their standard errors, and the cheapest by the extended BIC is told, if it has
fewer numbers than the table of the curve.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from daest.diagnosis.gates import GATES
from daest.model.diagnosis import Coefficient, Curve, Formula
from daest.quantities import over_power

MOST_TERMS = 3
WELL_FITTED = 12  # sums of two terms that are tried with a third
FEWEST_BEYOND = 2  # certain values of the curve more than a formula has numbers

_X = re.compile(r"\bx\b")

Function = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Term:
    """A function of x: `text` with `x` in it, values, the power of x whose unit it carries, and how many
    numbers it holds besides its coefficient."""

    text: str
    values: Function
    power: float
    n_shapes: int = 0


@dataclass(frozen=True)
class _Sum:
    terms: tuple[Term, ...]
    values: np.ndarray  # of the coefficients
    cov: np.ndarray
    chi_squared: float
    price: float


def formula(
    curve: Curve, unit: str, variable_unit: str, correlation: np.ndarray | None = None
) -> Formula | None:
    """The short formula for a curve whose load has the `unit`, over a variable of `variable_unit`; None where
    there is none in the grammar that comes near to the curve with clearly fewer numbers.

    `correlation` (n, n) is that of the errors of the curve's n values: what they share with parameters of the
    model, as a slope over a speed with a damper, counts for little."""
    certain = np.isfinite(curve.std) & np.isfinite(curve.y)
    x, y = curve.x[certain], curve.y[certain]
    scale = float(np.max(np.abs(y), initial=0.0))
    if x.size <= FEWEST_BEYOND or not scale > 0.0:
        return None
    std = curve.std[certain]
    shared = np.eye(x.size) if correlation is None else correlation[np.ix_(certain, certain)]
    cov = shared * np.outer(std, std) + (GATES.curve_error * scale) ** 2 * np.eye(x.size)
    try:
        weights = np.linalg.inv(np.linalg.cholesky(cov))
    except np.linalg.LinAlgError:
        return None
    found = _cheapest(_terms(x, variable_unit == "rad"), x, y, weights)
    if found is None:
        return None
    rest = y - sum(c * term.values(x) for c, term in zip(found.values, found.terms, strict=True))
    left = float(np.linalg.norm(weights @ rest) / np.linalg.norm(weights @ y))
    if left > GATES.max_formula_left:
        return None
    spread = max(1.0, found.chi_squared / max(x.size - len(found.terms), 1))
    errors = np.sqrt(spread * np.diag(found.cov))
    coefficients = tuple(
        Coefficient(
            _X.sub(lambda _: curve.variable, term.text) or "1",
            float(value),
            float(error),
            over_power(unit, variable_unit, term.power),
        )
        for term, value, error in zip(found.terms, found.values, errors, strict=True)
    )
    return Formula(_text(curve, coefficients), coefficients, _numbers(found.terms), left)


def _cheapest(terms: Sequence[Term], x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> _Sum | None:
    """All sums of one and two terms, and of three those that go on from the best of two."""
    columns = {term.text: weights @ term.values(x) for term in terms}
    wanted, most = weights @ y, x.size - FEWEST_BEYOND
    sums = [
        one
        for n in (1, 2)
        for chosen in combinations(terms, n)
        if (one := _fitted(chosen, columns, wanted, most)) is not None
    ]
    pairs = sorted((s for s in sums if len(s.terms) == 2), key=lambda s: s.price)[:WELL_FITTED]
    for pair in pairs if MOST_TERMS > 2 else ():
        for term in terms:
            if term not in pair.terms:
                one = _fitted((*pair.terms, term), columns, wanted, most)
                sums += [] if one is None else [one]
    return min(sums, key=lambda s: s.price, default=None)


def _fitted(
    terms: tuple[Term, ...], columns: dict[str, np.ndarray], wanted: np.ndarray, most: int
) -> _Sum | None:
    """Weighted least squares; None where the terms are one, or there are too many numbers for the values."""
    n = _numbers(terms)
    if n > most:
        return None
    table = np.column_stack([columns[term.text] for term in terms])
    size = np.linalg.norm(table, axis=0)
    if np.any(size == 0.0):
        return None
    u, s, vt = np.linalg.svd(table / size, full_matrices=False)
    if s[-1] < GATES.formula_rank * s[0]:
        return None
    values = (vt.T / s) @ (u.T @ wanted) / size
    cov = (vt.T / s**2) @ vt / np.outer(size, size)
    chi_squared = float(np.sum((wanted - table @ values) ** 2))
    # Every term was chosen among all of the grammar (extended BIC of Chen and Chen, 2008).
    price = chi_squared + n * float(np.log(wanted.size) + 2.0 * np.log(len(columns)))
    return _Sum(terms, values, cov, chi_squared, price)


def _numbers(terms: Sequence[Term]) -> int:
    return sum(1 + term.n_shapes for term in terms)


def _terms(x: np.ndarray, is_angle: bool) -> tuple[Term, ...]:
    """The grammar over the range of x. An odd and an even function are one on one side of zero."""
    has_both = bool(x.min() < 0.0 < x.max())
    found = [
        Term("", np.ones_like, 0.0),
        Term("x", lambda v: v, 1.0),
        Term("x^2", np.square, 2.0),
        Term("x^3", lambda v: v**3, 3.0),
        Term("sqrt(abs(x))", lambda v: np.sqrt(np.abs(v)), 0.5),
    ]
    if has_both:
        found += [
            Term("sign(x)", np.sign, 0.0),
            Term("abs(x)", np.abs, 1.0),
            Term("x*abs(x)", lambda v: v * np.abs(v), 2.0),
            Term("sign(x)*sqrt(abs(x))", lambda v: np.sign(v) * np.sqrt(np.abs(v)), 0.5),
        ]
    if is_angle:
        found += [
            Term(f"{name}({multiple}x)", _wave(function, order), 0.0)
            for order, multiple in ((1, ""), (2, "2*"), (3, "3*"))
            for name, function in (("sin", np.sin), ("cos", np.cos))
        ]
    return (*found, *_shaped(x, has_both))


def _shaped(x: np.ndarray, has_both: bool) -> Iterator[Term]:
    """Terms with a number that stands at a knot."""
    for at in np.unique(np.round(np.abs(x[x != 0.0]), 12)):
        said = f"{at:.4g}"
        yield Term(f"exp(-abs(x)/{said})", _decay(at), 0.0, 1)
        if has_both:
            yield Term(f"sign(x)*exp(-abs(x)/{said})", _odd(_decay(at)), 0.0, 1)
            if at < np.max(np.abs(x)):
                yield Term(f"max(-{said}, min(x, {said}))", _clipped(at), 1.0, 1)
                yield Term(f"sign(x)*max(abs(x) - {said}, 0)", _odd(_beyond(at)), 1.0, 1)
    for at in x[1:-1]:
        yield Term(f"max(x - {at:.4g}, 0)".replace("- -", "+ "), _above(at), 1.0, 1)


def _wave(function: Function, order: int) -> Function:
    return lambda v: function(order * v)


def _decay(at: float) -> Function:
    return lambda v: np.exp(-np.abs(v) / at)


def _odd(function: Function) -> Function:
    return lambda v: np.sign(v) * function(v)


def _clipped(at: float) -> Function:
    return lambda v: np.clip(v, -at, at)


def _beyond(at: float) -> Function:
    return lambda v: np.maximum(np.abs(v) - at, 0.0)


def _above(at: float) -> Function:
    return lambda v: np.maximum(v - at, 0.0)


def _text(curve: Curve, coefficients: Sequence[Coefficient]) -> str:
    """As Modelica would write it, apart from the numbers' digits."""
    parts = [f"{c.value:.4g}" if c.term == "1" else f"{c.value:.4g}*{c.term}" for c in coefficients]
    whole = " + ".join(parts).replace("+ -", "- ")
    return whole if not curve.sign_of else f"sign({curve.sign_of})*({whole})"
