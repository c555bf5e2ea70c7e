"""Standard form of a small pencil in arithmetic of many digits, by the pivots that exact arithmetic found.

Ranks are known, and with them regular minors (`DenseInfinity.pivots`), so that nothing is decided here: with
W = (σE - J)⁻¹ E, the kernels of W, W², … are solved for, and the range of W^index. This is the way where
floating point loses its digits: nearly higher index, long chains, and numbers many orders of magnitude apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb_mat, arb_mat, ctx

from daest.errors import NumericalError
from daest.numerics.modular_pencil import DenseInfinity

SHIFT = 0.7390851332151607
"""σ, in units of the scaled pencil: any number that is no pole would do."""

BITS = (512, 2048)
"""Binary digits of the arithmetic; more where the first do not suffice."""

TRUE_DIGITS = 2.0**-60
"""Part of the largest entry of its row up to which an entry must be known."""

NOTHING = 2.0**-200
"""Part of the largest entry of all below which the entries of a row may be unknown: they are zero."""


@dataclass(frozen=True)
class PreciseForm:
    """`left` E `right` = diag(I, N) and `left` J `right` = diag(A, I), rounded to doubles; `poles`
    (n_dynamic,) are the eigenvalues of A before rounding."""

    left: np.ndarray
    right: np.ndarray
    A: np.ndarray
    N: np.ndarray
    poles: np.ndarray
    states: np.ndarray


def precise_form(E: np.ndarray, J: np.ndarray, infinity: DenseInfinity, weights: np.ndarray) -> PreciseForm:
    """Of a pencil of doubles, scaled to entries of about one.

    `states` of the result are the rows of `right` that form an identity, chosen by size times `weights` (n,),
    zero for those that must not be. Raises NumericalError `standard-form-ill-conditioned`.
    """
    for bits in BITS:
        with ctx.workprec(bits):
            try:
                return _form(E, J, infinity, weights)
            except (ZeroDivisionError, _TooFewDigits):
                continue
    raise NumericalError(
        "standard-form-ill-conditioned",
        f"{BITS[-1]} binary digits do not suffice for the standard form",
        remedy="check the parameters for values that are many orders of magnitude too large or too small",
    )


class _TooFewDigits(Exception):
    pass


def _form(E: np.ndarray, J: np.ndarray, infinity: DenseInfinity, weights: np.ndarray) -> PreciseForm:
    e, j = _matrix(E), _matrix(J)
    W = (e * SHIFT - j).inv() * e
    kernel, power = _kernels(W, infinity)
    V, states = _finite(power, infinity, weights)
    n1 = infinity.n_dynamic
    left = _beside(e * V, j * kernel).inv()
    first, second = _part(left, range(n1)), _part(left, range(n1, infinity.n))
    A, N = first * (j * V), second * (e * kernel)
    return PreciseForm(
        left=_doubles(left),
        right=np.hstack([_doubles(V), _doubles(kernel)]),
        A=_doubles(A),
        N=_doubles(N),
        poles=_eigenvalues(A),
        states=np.array(states, dtype=int),
    )


def _kernels(W: Any, infinity: DenseInfinity) -> tuple[Any, Any]:
    """(a basis of ker W^index that begins with those of ker W, ker W², …, W^index)."""
    n = infinity.n
    power, columns = _identity(n), []
    done: set[int] = set()
    for rows, pivots in infinity.pivots:
        power = power * W
        free = [k for k in range(n) if k not in set(pivots) and k not in done]
        done.update(free)
        shares = _part(power, rows, pivots).solve(_part(power, rows, free)).tolist() if pivots else []
        for place, k in enumerate(free):
            column = dict(zip(pivots, (-row[place] for row in shares), strict=True))
            column[k] = 1
            largest = max(abs(float(value)) for value in column.values())
            unit = 2.0 ** -np.round(np.log2(largest))
            columns.append([column.get(i, 0) * unit for i in range(n)])
    entries = [column[i] for i in range(n) for column in columns]
    return arb_mat(n, len(columns), entries), power


def _finite(power: Any, infinity: DenseInfinity, weights: np.ndarray) -> tuple[Any, list[int]]:
    """A basis of the range of W^index with an identity in some rows, and these rows."""
    n = infinity.n
    if infinity.n_dynamic == 0:
        return arb_mat(n, 0), []
    basis = _part(power, range(n), infinity.pivots[-1][1]) if infinity.pivots else _identity(n)
    rows = sorted(_largest_rows(basis, weights))
    return basis * _part(basis, rows).inv(), rows


def _largest_rows(basis: Any, weights: np.ndarray) -> list[int]:
    """Rows of a regular block, by elimination that takes the largest entry of each column, weighted."""
    table = [[value.mid() for value in row] for row in basis.tolist()]
    left = [i for i in range(len(table)) if weights[i] > 0.0]
    chosen: list[int] = []
    for k in range(basis.ncols()):
        best = max(left, key=lambda i: float(abs(table[i][k])) * weights[i])
        left.remove(best)
        chosen.append(best)
        pivot = table[best]
        for i in left:
            factor = table[i][k] / pivot[k]
            table[i][k:] = [a - factor * b for a, b in zip(table[i][k:], pivot[k:], strict=True)]
    return chosen


def _matrix(values: np.ndarray) -> Any:
    return arb_mat(values.shape[0], values.shape[1], values.ravel().tolist())


def _identity(n: int) -> Any:
    return _matrix(np.eye(n))


def _part(matrix: Any, rows: Sequence[int], columns: Sequence[int] | None = None) -> Any:
    kept = range(matrix.ncols()) if columns is None else columns
    table = matrix.tolist()
    return arb_mat(len(rows), len(kept), [table[i][k] for i in rows for k in kept])


def _beside(left: Any, right: Any) -> Any:
    if not left.ncols() or not right.ncols():
        return left if left.ncols() else right
    rows = [[*a, *b] for a, b in zip(left.tolist(), right.tolist(), strict=True)]
    return arb_mat(len(rows), len(rows[0]), [value for row in rows for value in row])


def _doubles(matrix: Any) -> np.ndarray:
    """The entries; those that may be zero are. Raises _TooFewDigits."""
    shape = (matrix.nrows(), matrix.ncols())
    entries = matrix.entries()
    middle = np.array([float(value.mid()) for value in entries]).reshape(shape)
    radius = np.array([float(value.rad()) for value in entries]).reshape(shape)
    if middle.size:
        largest = np.abs(middle).max(axis=1, keepdims=True)
        if not np.all(radius <= np.maximum(TRUE_DIGITS * largest, NOTHING * largest.max())):
            raise _TooFewDigits
    return np.where(np.abs(middle) > radius, middle, 0.0)


def _eigenvalues(A: Any) -> np.ndarray:
    """Of the middle of A; a zero is one to half of the digits."""
    if not A.nrows():
        return np.empty(0, complex)
    values = np.array([complex(value) for value in acb_mat(A.mid()).eig(algorithm="approx")])
    values = np.where(np.abs(values.imag) <= 2.0**-100 * np.abs(values), values.real, values)
    return np.where(np.abs(values) <= 2.0**-100 * np.abs(values).max(), 0.0, values)
