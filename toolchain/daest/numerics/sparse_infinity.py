"""What a large sparse pencil sE - J does at infinity, over a prime field: exact, sparse from end to end.

As in `numerics.laurent`, diag(s^c) A(s) diag(s^-d) = Â0 + Â1 s⁻¹ + …, with the canonical offsets c, d of the
structure, and det A has the degree Σd - Σc where Â0 is regular. Where values cancel what the structure
promises, u' Â0 = 0 for some u, the equation of the smallest offset in u is replaced by Σ u_i s^(c_i - c_r)
times equation i, which lowers Σd - Σc and divides no determinant but by a constant; that is repeated
(K. Murota, Computing the degree of determinants via combinatorial relaxation, SIAM J. Comput. 24, 1995).
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.sparse as sp

from daest.numerics.matching import Offsets, canonical_offsets, find_defect
from daest.numerics.modular_pencil import ModularPencil, SingularPencil

Row = dict[int, int]
"""Residues by column."""

PolynomialRow = dict[tuple[int, int], int]
"""Residues by column and power of s."""

Series = dict[int, Row]
"""A vector of polynomials in s: residues by place, by power."""

MOST_ENTRIES = 3_000_000
"""Elimination gives up where it has made more entries than these."""

MOST_REPLACEMENTS = 200
"""Rounds of replaced equations at most."""


class TooDense(Exception):
    """Elimination would fill the matrix."""


@dataclass(frozen=True)
class _Step:
    """A pivot: its row and column, its inverse, the rest of its row, and the multiples that were taken from
    other rows."""

    row: int
    column: int
    inverse: int
    entries: Row
    taken: list[tuple[int, int]]


@dataclass(frozen=True)
class Factors:
    """Sparse Gaussian elimination of a matrix modulo `prime`; `dependent` rows vanished."""

    prime: int
    steps: list[_Step]
    dependent: list[int]

    def solve(self, right: Row) -> Row:
        """matrix⁻¹ right."""
        p, right = self.prime, dict(right)
        result: Row = {}
        for step in self.steps:
            value = right.get(step.row)
            if value:
                for row, factor in step.taken:
                    right[row] = (right.get(row, 0) - factor * value) % p
        for step in reversed(self.steps):
            value = right.get(step.row, 0)
            for column, entry in step.entries.items():
                if column in result:
                    value -= entry * result[column]
            value = value * step.inverse % p
            if value:
                result[step.column] = value
        return result

    def solve_transposed(self, right: Row) -> Row:
        """matrix⁻ᵀ right."""
        p, right = self.prime, dict(right)
        middle: Row = {}
        for step in self.steps:
            value = right.get(step.column, 0) * step.inverse % p
            if value:
                middle[step.row] = value
                for column, entry in step.entries.items():
                    right[column] = (right.get(column, 0) - entry * value) % p
        return self._combined(middle)

    def null_vector(self, row: int) -> Row:
        """The combination of rows, among them the dependent `row`, that vanishes."""
        return self._combined({row: 1})

    def _combined(self, weights: Row) -> Row:
        p, result = self.prime, dict(weights)
        for step in reversed(self.steps):
            value = result.get(step.row, 0)
            for row, factor in step.taken:
                if row in result:
                    value -= factor * result[row]
            value %= p
            if value:
                result[step.row] = value
            else:
                result.pop(step.row, None)
        return result


def factorise(rows: Sequence[Row], prime: int) -> Factors:
    """The shortest row is next, for the column with the fewest entries. Raises TooDense."""
    table = [dict(row) for row in rows]
    members: dict[int, set[int]] = {}
    for i, row in enumerate(table):
        for column in row:
            members.setdefault(column, set()).add(i)
    heap = [(len(row), i) for i, row in enumerate(table)]
    heapq.heapify(heap)
    steps: list[_Step] = []
    done, dependent, made = [False] * len(table), [], 0
    while heap:
        length, i = heapq.heappop(heap)
        row = table[i]
        if done[i] or length != len(row):
            continue
        done[i] = True
        if not row:
            dependent.append(i)
            continue
        column = min(row, key=lambda c: (len(members[c]), c))
        inverse = pow(row.pop(column), -1, prime)
        for c in row:
            members[c].discard(i)
        taken = []
        for other in members.pop(column):
            if other == i:
                continue
            factor = table[other].pop(column) * inverse % prime
            taken.append((other, factor))
            made += len(row)
            _subtract(table[other], row, factor, other, members, prime)
            heapq.heappush(heap, (len(table[other]), other))
        if made > MOST_ENTRIES:
            raise TooDense
        steps.append(_Step(i, column, inverse, row, taken))
    return Factors(prime, steps, dependent)


def _subtract(
    target: Row, pivot: Row, factor: int, name: int, members: dict[int, set[int]], prime: int
) -> None:
    for column, value in pivot.items():
        old = target.get(column)
        new = ((old or 0) - factor * value) % prime
        if new:
            target[column] = new
            if old is None:
                members[column].add(name)
        elif old is not None:
            del target[column]
            members[column].discard(name)


Replacement = tuple[int, list[tuple[int, int, int]]]
"""A row, and the (row, weight, power of s) whose sum takes its place."""


@dataclass(frozen=True)
class SparseInfinity:
    """The coefficients of s^m in (sE - J)⁻¹, m ≥ 0, from A = U (sE - J) with a regular Â0.

    `rounds` are the replacements that make U, one after the other. `lower` holds the entries of Â1, Â2, …
    (row, column, residue).
    """

    n: int
    prime: int
    offsets: Offsets
    factors: Factors
    lower: list[list[tuple[int, int, int]]]
    rounds: list[list[Replacement]]
    rank_of_e: int

    @property
    def n_dynamic(self) -> int:
        return int(self.offsets.columns.sum() - self.offsets.rows.sum())

    @property
    def index(self) -> int:
        highest = int(self._orders.max(initial=0))
        return highest + 1 if self.n_dynamic < self.n else 0

    @property
    def ranks(self) -> tuple[int, ...]:
        """The rank of N alone."""
        return (self.rank_of_e - self.n_dynamic,) if self.index > 1 else ()

    def orders(self) -> np.ndarray:
        """(n,) the highest derivative of a noise on each equation in any unknown; 0: none."""
        return self._orders

    @cached_property
    def _orders(self) -> np.ndarray:
        """By a random combination of all unknowns."""
        chance = random.Random(self.prime)
        weights = {j: chance.randrange(1, self.prime) for j in range(self.n)}
        lowest = 1 - sum(max(shift for _, terms in r for *_, shift in terms) for r in self.rounds)
        answer = self._solve({0: weights}, lowest, transposed=True)
        for replacements in reversed(self.rounds):
            answer = _applied(answer, replacements, self.prime, transposed=True)
        result = np.zeros(self.n, dtype=int)
        for power in sorted(answer):
            if power >= 1:
                result[[i for i, value in answer[power].items() if value]] = power
        return result

    def response(self, m: int, b: Sequence[tuple[int, int]]) -> np.ndarray:
        """Which entries (n,) of the coefficient of s^m times the column b are not zero."""
        right: Series = {0: {row: value for row, value in b if value}}
        for replacements in self.rounds:
            right = _applied(right, replacements, self.prime, transposed=False)
        found = self._solve(right, m, transposed=False).get(m, {})
        result = np.zeros(self.n, dtype=bool)
        result[[j for j, value in found.items() if value]] = True
        return result

    def order(self, b: Sequence[tuple[int, int]]) -> int:
        """The highest derivative of a noise with the column b in any unknown."""
        return max((m for m in range(1, self.index) if self.response(m, b).any()), default=0)

    def _solve(self, right: Series, lowest: int, transposed: bool) -> Series:
        """Powers from `lowest` on of A⁻¹ right, or A⁻ᵀ right: Â0 z_P = right_P - Â1 z_(P+1) - …, for levels P
        of c_i + power on the right and d_j + power on the left."""
        c, d = self.offsets.rows, self.offsets.columns
        on_right, on_left = (-d, -c) if transposed else (c, d)
        solve = self.factors.solve_transposed if transposed else self.factors.solve
        levels: Series = {}
        for power, entries in right.items():
            for place, value in entries.items():
                levels.setdefault(int(on_right[place]) + power, {})[place] = value
        result: Series = {}
        found: Series = {}
        if not levels:
            return result
        for level in range(max(levels), int(on_left.min()) + lowest - 1, -1):
            known = dict(levels.get(level, {}))
            for lag, part in enumerate(self.lower, start=1):
                before = found.get(level + lag)
                if before:
                    _take(known, part, before, transposed, self.prime)
            if any(known.values()):
                found[level] = solve(known)
                for place, value in found[level].items():
                    power = level - int(on_left[place])
                    if power >= lowest:
                        result.setdefault(power, {})[place] = value
        return result


def _take(
    known: Row, entries: Iterable[tuple[int, int, int]], vector: Row, transposed: bool, prime: int
) -> None:
    for i, j, value in entries:
        target, source = (j, i) if transposed else (i, j)
        factor = vector.get(source)
        if factor:
            known[target] = (known.get(target, 0) - value * factor) % prime


def _applied(series: Series, replacements: Iterable[Replacement], prime: int, transposed: bool) -> Series:
    """U · series of one round, or series' · U where `transposed`."""
    result = {power: dict(entries) for power, entries in series.items()}
    for row, _ in replacements:
        for entries in result.values():
            entries.pop(row, None)
    for row, terms in replacements:
        for other, weight, shift in terms:
            source, target = (row, other) if transposed else (other, row)
            for power, entries in series.items():
                if source in entries:
                    place = result.setdefault(power + shift, {})
                    place[target] = (place.get(target, 0) + weight * entries[source]) % prime
    return result


def sparse_infinity(pencil: ModularPencil) -> SparseInfinity:
    """Raises SingularPencil, and TooDense."""
    n, p = pencil.n, pencil.prime
    rows: list[PolynomialRow] = [{} for _ in range(n)]
    rates: list[Row] = [{} for _ in range(n)]
    for i, j, e, value in zip(pencil.rows, pencil.columns, pencil.e, pencil.j, strict=True):
        if e % p:
            rows[i][j, 1] = rates[i][j] = e % p
        if value % p:
            rows[i][j, 0] = -value % p
    rank_of_e = len(factorise(rates, p).steps)
    rounds: list[list[Replacement]] = []
    while len(rounds) <= MOST_REPLACEMENTS:
        offsets = _offsets(rows)
        parts = _parts(rows, offsets)
        leading: list[Row] = [{} for _ in range(n)]
        for i, j, value in parts[0]:
            leading[i][j] = value
        factors = factorise(leading, p)
        if not factors.dependent:
            return SparseInfinity(n, p, offsets, factors, parts[1:], rounds, rank_of_e)
        rounds.append(_replacements(factors, offsets))
        _replace(rows, rounds[-1], p)
    raise TooDense


def _offsets(rows: Sequence[PolynomialRow]) -> Offsets:
    """The canonical offsets of the highest powers of s."""
    highest: dict[tuple[int, int], int] = {}
    for i, row in enumerate(rows):
        for j, power in row:
            highest[i, j] = max(power, highest.get((i, j), 0))
    if not highest:
        raise SingularPencil
    places = np.array(list(highest), dtype=np.int64)
    orders = np.fromiter(highest.values(), dtype=np.int64, count=len(highest))
    found = _known_offsets(places.tobytes(), orders.tobytes(), len(rows))
    if found is None or found.columns.sum() < found.rows.sum():
        raise SingularPencil
    return found


@lru_cache(maxsize=8)
def _known_offsets(places: bytes, orders: bytes, n: int) -> Offsets | None:
    """None without a perfect matching. Several fields ask for the same."""
    row, column = np.frombuffer(places, dtype=np.int64).reshape(-1, 2).T
    if find_defect(sp.csr_array((np.ones(row.size), (row, column)), shape=(n, n))) is not None:
        return None
    return canonical_offsets(row, column, np.frombuffer(orders, dtype=np.int64), n)


def _parts(rows: Sequence[PolynomialRow], offsets: Offsets) -> list[list[tuple[int, int, int]]]:
    """Entries of Â0, Â1, …"""
    c, d = offsets.rows.tolist(), offsets.columns.tolist()
    parts: list[list[tuple[int, int, int]]] = [[]]
    for i, row in enumerate(rows):
        for (j, power), value in row.items():
            lag = d[j] - c[i] - power
            while len(parts) <= lag:
                parts.append([])
            parts[lag].append((i, j, value))
    return parts


def _replacements(factors: Factors, offsets: Offsets) -> list[Replacement]:
    """Of null vectors of Â0 that do not touch the rows that others replace."""
    c = offsets.rows.tolist()
    used: set[int] = set()
    replaced: set[int] = set()
    found: list[Replacement] = []
    for dependent in factors.dependent:
        vector = factors.null_vector(dependent)
        row = min(vector, key=lambda i: (c[i], i != dependent, i))
        if row in used or replaced & vector.keys():
            continue
        found.append((row, [(i, value, c[i] - c[row]) for i, value in vector.items()]))
        used.update(vector)
        replaced.add(row)
    return found


def _replace(rows: list[PolynomialRow], replacements: Iterable[Replacement], prime: int) -> None:
    for row, terms in replacements:
        total: PolynomialRow = {}
        for i, weight, shift in terms:
            for (j, power), value in rows[i].items():
                place = (j, power + shift)
                total[place] = (total.get(place, 0) + weight * value) % prime
        rows[row] = {place: value for place, value in total.items() if value}
