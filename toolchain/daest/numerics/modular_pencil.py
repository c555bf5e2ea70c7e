"""What sE - J does at infinity, over a prime field: exact, without any tolerance. Dense, for small pencils.

With a random shift σ, R = (σE - J)⁻¹ and W = R E, (sE - J)⁻¹ = (I + (s - σ) W)⁻¹ R. Infinite eigenvalues are
zeros of W: on their subspace W is nilpotent, and the powers of s are

    X_m = K S_m H,  S_m = Σ_k (-1)^k binom(k, m) (-σ)^(k-m) M^k,  H = (L K)⁻¹ L R,  M = (L K)⁻¹ L W K,

K and L' spanning the null spaces of W^index and of its transpose. The index is that of W, the number of modes
the rank of W^index, and the rank of N^m that of M^m.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb
from typing import Any

import numpy as np
from flint import nmod_mat


class SingularPencil(Exception):
    """det(sE - J) vanishes at a random point of the field: it is zero for every s."""


@dataclass(frozen=True)
class ModularPencil:
    """sE - J over the field of `prime` elements: `rows`, `columns` and residues `e`, `j` of all entries, and
    the columns that stand on the `right` of it, by (row, residue)."""

    n: int
    prime: int
    rows: Sequence[int]
    columns: Sequence[int]
    e: Sequence[int]
    j: Sequence[int]
    right: tuple[tuple[tuple[int, int], ...], ...] = ()


@dataclass(frozen=True)
class DenseInfinity:
    """The coefficients X_m of s^m in (sE - J)⁻¹, m = 0 … index-1 (`middles` holds S_m)."""

    n: int
    prime: int
    n_dynamic: int
    index: int
    rank_of_e: int
    ranks: tuple[int, ...]  # of N, N², … N^(index-1)
    shifted: Any  # W
    left: Any  # K (n, n - n_dynamic)
    middles: tuple[Any, ...]
    right: Any  # H (n - n_dynamic, n)

    def reached(self, m: int) -> np.ndarray:
        """Which entries (n, n) of X_m are not zero."""
        return _nonzero(self.left * self.middles[m] * self.right)

    def response(self, m: int, b: Sequence[tuple[int, int]]) -> np.ndarray:
        """Which entries (n,) of X_m b are not zero, for the column b of (row, residue)."""
        column = nmod_mat(self.n, 1, self.prime)
        for row, value in b:
            column[row, 0] = value
        return _nonzero(self.left * (self.middles[m] * (self.right * column)))[:, 0]

    def orders(self) -> np.ndarray:
        """(n,) the highest derivative of a noise on each equation in any unknown; 0: none."""
        result = np.zeros(self.n, dtype=int)
        for m in range(1, self.index):
            result[_nonzero(self.middles[m] * self.right).any(axis=0)] = m  # K has full column rank
        return result

    @cached_property
    def pivots(self) -> tuple[tuple[list[int], list[int]], ...]:
        """Rows and columns of a regular block of W, W², … W^index that is as large as the rank."""
        found, power = [], _identity(self.n, self.prime)
        for _ in range(self.index):
            power = power * self.shifted
            found.append((_pivot_columns(power.transpose()), _pivot_columns(power)))
        return tuple(found)

    def order(self, b: Sequence[tuple[int, int]]) -> int:
        """The highest derivative of a noise with the column b in any unknown."""
        return max((m for m in range(1, self.index) if self.response(m, b).any()), default=0)


def dense_infinity(pencil: ModularPencil, seed: int = 0) -> DenseInfinity:
    """Raises SingularPencil."""
    n, prime = pencil.n, pencil.prime
    shift = random.Random(seed).randrange(1, prime)
    E, shifted = nmod_mat(n, n, prime), nmod_mat(n, n, prime)
    for row, column, e, j in zip(pencil.rows, pencil.columns, pencil.e, pencil.j, strict=True):
        E[row, column] = int(E[row, column]) + e
        shifted[row, column] = int(shifted[row, column]) + (shift * e - j) % prime
    try:
        resolvent = shifted.inv() if n else shifted
    except ZeroDivisionError as error:
        raise SingularPencil from error
    W = resolvent * E
    index, power, rank_of_e, rank = _index(W)
    left, right = _null_space(power), _null_space(power.transpose()).transpose()
    n2 = n - rank
    gram = (right * left).inv() if n2 else right * left
    nilpotent = gram * (right * (W * left))
    powers = [_identity(n2, prime)]
    for _ in range(1, index):
        powers.append(powers[-1] * nilpotent)
    middles = tuple(_middle(powers, m, shift, prime) for m in range(max(index, 1)))
    return DenseInfinity(
        n=n,
        prime=prime,
        n_dynamic=rank,
        index=index,
        rank_of_e=rank_of_e,
        ranks=tuple(matrix.rank() for matrix in powers[1:]),
        shifted=W,
        left=left,
        middles=middles,
        right=gram * (right * resolvent),
    )


def _index(W: Any) -> tuple[int, Any, int, int]:
    """(index of the eigenvalue zero of W, W^index, rank of W, rank of W^index)."""
    power, rank, index = _identity(W.nrows(), W.modulus()), W.nrows(), 0
    first = W.rank() if W.nrows() else 0
    following = first
    while following < rank:
        power, rank, index = power * W, following, index + 1
        following = (power * W).rank()
    return index, power, first, rank


def _middle(powers: Sequence[Any], m: int, shift: int, prime: int) -> Any:
    total = powers[0] * 0
    for k in range(m, len(powers)):
        factor = (-1) ** k * comb(k, m) * pow(-shift, k - m, prime)
        total += powers[k] * (factor % prime)
    return total


def _identity(n: int, prime: int) -> Any:
    matrix = nmod_mat(n, n, prime)
    for i in range(n):
        matrix[i, i] = 1
    return matrix


def _null_space(matrix: Any) -> Any:
    """A basis (n, nullity) of the null space."""
    n, prime = matrix.ncols(), matrix.modulus()
    if n == 0:
        return nmod_mat(0, 0, prime)
    basis, nullity = matrix.nullspace()
    kept = [value for row in basis.tolist() for value in row[:nullity]]
    return nmod_mat(n, nullity, kept, prime)


def _pivot_columns(matrix: Any) -> list[int]:
    reduced, rank = matrix.rref()
    return [next(k for k, value in enumerate(row) if int(value)) for row in reduced.tolist()[:rank]]


def _nonzero(matrix: Any) -> np.ndarray:
    shape = (matrix.nrows(), matrix.ncols())
    return np.fromiter(map(bool, matrix.entries()), bool).reshape(shape)
