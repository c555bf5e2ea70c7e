"""Index, modes and forbidden equations of a linear DAE by exact arithmetic: at its numbers, and for almost
every θ.

Entries are evaluated in two prime fields: at its parameters, read as the decimal numbers that they are, and
at random ones. A statement that holds at random elements of a field of some 9e18 holds for all θ but those of
a surface, and the two evaluations are wrong together with a probability below (d / 9e18)² (Schwartz and
Zippel), d being the degree of the determinants in θ: 1e-28 for 1e5.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.model.linear import LinearDAE, Matrix
from daest.numerics.exact_numbers import prime, read_number, residue
from daest.numerics.exact_units import Entry, simple_in_other_units
from daest.numerics.field_values import Field, FieldValue, Tape, evaluate, tape
from daest.numerics.modular_pencil import DenseInfinity, ModularPencil, SingularPencil, dense_infinity
from daest.numerics.pencils import unit_scaling
from daest.numerics.sparse_infinity import SparseInfinity, TooDense, sparse_infinity

ATTEMPTS = 12
"""Fields that are tried for one in which no quotient is undefined and no square root missing: one root is
there with a chance of a half."""

EVALUATIONS = 5
"""Evaluations at most until two agree."""

DENSE_LIMIT = 500
"""From this many equations on exact arithmetic is sparse, and does not tell which unknowns every single
equation reaches."""

Reading = Literal["numbers", "parameters", "generic"]


@dataclass(frozen=True)
class ExactStructure:
    """What exact arithmetic says of sE - J: a `Structure`. `is_certain`: every number was read as a decimal
    text or simple fraction, so that nothing is a rounding error.

    `noise_orders`: the highest derivative of every noise of the model in any unknown, 0 for none. `columns`
    are B and K beside each other (n, n_w + n_u), `residues` the same in the field.
    """

    infinity: DenseInfinity | SparseInfinity
    noise_orders: tuple[int, ...]
    reading: Reading
    is_certain: bool
    columns: np.ndarray
    residues: tuple[tuple[tuple[int, int], ...], ...]

    @property
    def n_dynamic(self) -> int:
        return self.infinity.n_dynamic

    @property
    def index(self) -> int:
        return self.infinity.index

    @cached_property
    def orders(self) -> np.ndarray:
        """(n,) the highest derivative of a noise on each equation in any unknown; 0: none."""
        return self.infinity.orders()

    @property
    def level_sizes(self) -> tuple[int, ...]:
        """Dimensions by which ker N, ker N², … grow."""
        ranks = [self.infinity.n - self.n_dynamic, *self.infinity.ranks, 0]
        return tuple(a - b for a, b in pairwise(ranks)) if self.index else ()

    @property
    def rank_of_n(self) -> int:
        return self.infinity.ranks[0] if self.infinity.ranks else 0

    @property
    def forbidden(self) -> list[int]:
        """Equations that may not carry white noise."""
        return np.flatnonzero(self.orders).tolist()

    def reached(self, m: int) -> np.ndarray | None:
        """Which entries (n, n) of the coefficient of s^m in (sE - J)⁻¹ are not zero; None: too many."""
        if isinstance(self.infinity, SparseInfinity):
            return None
        return self._reached[m - 1] if 1 <= m < self.index else np.zeros((self.infinity.n,) * 2, dtype=bool)

    @cached_property
    def _reached(self) -> list[np.ndarray]:
        assert isinstance(self.infinity, DenseInfinity)
        return [self.infinity.reached(m) for m in range(1, self.index)]

    def agrees(self, other: ExactStructure) -> bool:
        """Whether the verdicts are the same."""
        return (
            (self.n_dynamic, self.index, self.infinity.ranks, self.noise_orders)
            == (other.n_dynamic, other.index, other.infinity.ranks, other.noise_orders)
        ) and np.array_equal(self.orders, other.orders)

    def response(self, m: int, b: np.ndarray) -> np.ndarray | None:
        """Which entries (n,) of that coefficient times b (n,) are not zero; None where b is no column of B
        or K."""
        for own, residues in zip(self.columns.T, self.residues, strict=True):
            if np.array_equal(own, b):
                return self.infinity.response(m, residues) if m < self.index else np.zeros(b.size, dtype=bool)
        return None


def exact_structure(dae: LinearDAE) -> ExactStructure | None:
    """Of the model at its numbers: None where a number has no exact value, or what is exactly singular may
    be so by rounding.

    Raises SingularPencil.
    """
    entries = _of_family(dae, frozenset()) if _has_family(dae) else None
    return _agreed(dae, entries or _of_numbers(dae), "parameters" if entries else "numbers")


def generic_structure(dae: LinearDAE, free: Iterable[int] | None = None) -> ExactStructure | None:
    """For almost every value of the parameters `free` (None: all), the others at their values.

    None where the equations contain no parameter (or are not there), and where a pencil is singular for all.
    """
    if not _has_family(dae):
        return None
    chosen = frozenset(range(len(dae.parameters)) if free is None else free)
    return _agreed(dae, _of_family(dae, chosen), "generic")


@dataclass(frozen=True)
class _Entries:
    """`at(k)` gives the pencil in the k-th field, and whether all its numbers were read."""

    at: Callable[[int], tuple[ModularPencil, bool]]


def _agreed(dae: LinearDAE, entries: _Entries | None, reading: Reading) -> ExactStructure | None:
    """The first structure that two fields agree on."""
    if entries is None:
        return None
    found: list[ExactStructure] = []
    singular = 0
    for k in range(EVALUATIONS):
        try:
            pencil, is_certain = entries.at(k)
            structure = _structure(dae, pencil, is_certain, reading, k)
        except (ZeroDivisionError, TooDense):  # a quotient without a value, or too long a computation
            return None
        except SingularPencil:
            singular += 1
            if singular < 2:
                continue
            if reading == "generic" or not is_certain:
                return None
            raise
        if any(structure.agrees(other) for other in found):
            return structure
        found.append(structure)
    return None


def _structure(
    dae: LinearDAE, pencil: ModularPencil, is_certain: bool, reading: Reading, seed: int
) -> ExactStructure:
    infinity = dense_infinity(pencil, seed) if pencil.n < DENSE_LIMIT else sparse_infinity(pencil)
    orders = tuple(infinity.order(column) for column in pencil.right[: len(dae.noises)])
    columns = np.hstack([dae.B, dae.K])
    return ExactStructure(infinity, orders, reading, is_certain, columns, pencil.right)


def _of_numbers(dae: LinearDAE) -> _Entries:
    """The numbers of E, J, B and K: simple as they are, or in other units, or else their binary values."""
    scaling = unit_scaling(dae.E, dae.J)
    kept = [
        (i, j, float(value), part)
        for part, matrix in enumerate((dae.E, dae.J, np.hstack([dae.B, dae.K])))
        for i, j, value in zip(*_triplets(matrix), strict=True)
    ]
    numbers = [read_number(value) for _, _, value, _ in kept]
    values, is_simple = [number.value for number in numbers], all(number.is_simple for number in numbers)
    if not is_simple:
        columns = np.concatenate([scaling.columns, np.ones(len(dae.noises) + len(dae.inputs))])
        time = (scaling.time, 1.0, 1.0)
        entries = []
        for i, j, value, part in kept:
            place = j + dae.n if part == 2 else j
            size = float(scaling.rows[i] * columns[place] * time[part])
            entries.append(Entry(i, place, value * size, int(part == 0)))
        simple = simple_in_other_units(entries)
        values, is_simple = (values, False) if simple is None else (simple, True)

    def at(k: int) -> tuple[ModularPencil, bool]:
        residues = [residue(value, prime(k)) for value in values]
        entries = ((i, j, part, value) for (i, j, _, part), value in zip(kept, residues, strict=True))
        n_right = len(dae.noises) + len(dae.inputs)
        return _pencil(dae.n, prime(k), entries, n_right), is_simple and dae.is_affine

    return _Entries(at)


def _triplets(matrix: Matrix) -> tuple[list[int], list[int], list[float]]:
    entries = sp.coo_array(matrix)
    used = entries.data != 0.0
    row, column = (index[used].tolist() for index in entries.coords)
    return row, column, entries.data[used].tolist()


def _has_family(dae: LinearDAE) -> bool:
    """Whether the entries depend on parameters, and the numbers in E and J are still those of the family."""
    if dae.family is None or not dae.parameters:
        return False
    values = dae.family(np.array([parameter.value for parameter in dae.parameters]))
    same = all(_is_same(own, values[k]) for own, k in ((dae.E, 0), (dae.J, 1), (dae.K, 2), (dae.B, 3)))
    return same and any(dae.family.sparsity_jac(0, i).nnz() for i in (0, 1))


def _is_same(own: Matrix, of_family: ca.DM) -> bool:
    other = sp.csr_array(sp.csc_array(of_family.sparse()))
    return own.shape == other.shape and abs(sp.csr_array(own) - other).sum() == 0.0


def _of_family(dae: LinearDAE, free: frozenset[int]) -> _Entries | None:
    """The entries at the values of the parameters, those of `free` at random."""
    if dae.family is None:
        return None
    function: ca.Function = dae.family
    try:
        program = tape(function)
    except RuntimeError:  # not made of scalar instructions
        return None
    return _Entries(lambda k: _in_field(dae, function, program, free, k))


def _in_field(
    dae: LinearDAE, function: ca.Function, program: Tape, free: frozenset[int], k: int
) -> tuple[ModularPencil, bool]:
    """The pencil in the first of `ATTEMPTS` fields that has all roots, else in the last one with a value."""
    best: tuple[Field, list[list[FieldValue]]] | None = None
    failure: ZeroDivisionError | None = None
    for attempt in range(ATTEMPTS):
        f = Field(prime(k * ATTEMPTS + attempt), seed=k * ATTEMPTS + attempt)
        theta = [
            FieldValue(f.independent("parameter", i), p.value) if i in free else f.constant(p.value)
            for i, p in enumerate(dae.parameters)
        ]
        try:
            values = evaluate(program, theta, f)
        except ZeroDivisionError as error:
            failure = error
            continue
        best = f, values
        if not f.missing_roots:
            break
    if best is None:
        raise failure or ZeroDivisionError
    f, values = best
    n_noises = len(dae.noises)
    entries = (
        (i, j + shift, part, value.residue)
        for output, part, shift in ((0, 0, 0), (1, 1, 0), (3, 2, 0), (2, 2, n_noises))  # E, J, B, K
        for i, j, value in zip(*function.sparsity_out(output).get_triplet(), values[output], strict=True)
    )
    n_right = n_noises + len(dae.inputs)
    return _pencil(dae.n, f.prime, entries, n_right), dae.is_affine and f.all_simple


def _pencil(
    n: int, modulus: int, entries: Iterable[tuple[int, int, int, int]], n_right: int
) -> ModularPencil:
    """Of entries (row, column, part, residue), the parts being E, J and what is on their right."""
    places: dict[tuple[int, int], list[int]] = {}
    right: list[list[tuple[int, int]]] = [[] for _ in range(n_right)]
    for i, j, part, value in entries:
        if part == 2:
            right[j].append((i, value))
        else:
            places.setdefault((i, j), [0, 0])[part] = value
    return ModularPencil(
        n,
        modulus,
        [i for i, _ in places],
        [j for _, j in places],
        [value[0] for value in places.values()],
        [value[1] for value in places.values()],
        tuple(map(tuple, right)),
    )
