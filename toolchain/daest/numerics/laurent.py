"""Expansion of (sE - J)⁻¹ in powers of s at infinity, for large sparse pencils: one sparse factorisation.

With the canonical offsets c, d of the signature matrix (J. Pryce, BIT 41, 2001) the matrix diag(s^c) (sE - J)
diag(s^-d) = Â0 + Â1 s⁻¹ + … has no positive powers, and where Â0, the system Jacobian, is regular, so has its
inverse X0 + X1 s⁻¹ + …:

    X0 = Â0⁻¹,  Xk = -Â0⁻¹ (Â1 X(k-1) + … + Âk X0),  [(sE - J)⁻¹]_ji = Σk Xk_ji s^(c_i - d_j - k).

So det(sE - J) has degree Σd - Σc, and no rank of a subspace is ever decided: the only decision is that Â0 is
regular. Where values cancel what the structure promises, it is not, and the dense staircase must be used.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from daest.errors import NumericalError
from daest.model.linear import RankDecision
from daest.numerics.matching import Offsets, canonical_offsets, find_defect
from daest.numerics.ranks import default_tolerance
from daest.numerics.sparse_columns import compressed, largest_entries, pencil_entries
from daest.numerics.sparse_parts import reached, submatrix

CHUNK = 64
"""Columns that are solved for at a time: memory is this many dense vectors per order."""

ROUNDING = 1e-13
"""Entries below this part of the largest of their column of all Xk are rounding errors of its solution."""


@dataclass(frozen=True)
class SparseSystem:
    """A regular sparse matrix (n, n), its factors, `partner`: the column matched to every row, and `graph`:
    the edge i -> k where row k contains the partner of row i."""

    matrix: sp.csr_array
    factors: Any
    partner: np.ndarray
    graph: sp.csr_array

    def solve(self, right: sp.csc_array) -> sp.csc_array:
        """matrix⁻¹ right, restricted to the rows that `right` reaches: what it does not reach is exactly
        zero. Many columns are solved for in chunks of neighbours, which reach few rows together."""
        if right.shape[1] <= CHUNK:
            return self._solved(right)
        order = np.argsort(_first_rows(right), kind="stable")
        chunks = [order[start : start + CHUNK] for start in range(0, order.size, CHUNK)]
        return _joined([self._solved(right[:, chunk]) for chunk in chunks], chunks, right.shape)

    def _solved(self, right: sp.csc_array) -> sp.csc_array:
        rows = reached(self.graph, np.unique(right.indices))
        if 2 * rows.size > right.shape[0]:
            return compressed(self.factors.solve(right.toarray()))
        if rows.size == 0:
            return sp.csc_array(right.shape)
        unknowns = self.partner[rows]
        values = np.zeros((rows.size, right.shape[1]))
        column = np.repeat(np.arange(right.shape[1]), np.diff(right.indptr))
        values[np.searchsorted(rows, right.indices), column] = right.data
        found = compressed(spla.splu(submatrix(self.matrix, rows, unknowns)).solve(values))
        result = sp.csc_array((found.data, unknowns[found.indices], found.indptr), shape=right.shape)
        result.sort_indices()
        return result


def _first_rows(matrix: sp.csc_array) -> np.ndarray:
    """The smallest row index stored in every column (m,), 0 for columns without entries."""
    first = np.zeros(matrix.shape[1], dtype=int)
    used = np.flatnonzero(np.diff(matrix.indptr))
    if used.size:
        first[used] = np.minimum.reduceat(matrix.indices, matrix.indptr[used])
    return first


@dataclass(frozen=True)
class Expansion:
    """`rows` and `columns` are the offsets c and d; `lower` holds Â1, Â2, …; `jacobian` is Â0."""

    rows: np.ndarray
    columns: np.ndarray
    jacobian: SparseSystem
    lower: tuple[sp.csr_array, ...]
    decision: RankDecision

    @property
    def degree(self) -> int:
        """Degree of det(sE - J): the number of finite eigenvalues."""
        return int(self.columns.sum() - self.rows.sum())

    @property
    def highest_power(self) -> int:
        """No higher power of s occurs in the inverse."""
        return int(self.rows.max(initial=0))

    @property
    def transposed(self) -> Expansion:
        """The expansion of (sE - J)⁻ᵀ in the same form: offsets -d and -c."""
        partner = np.argsort(self.jacobian.partner)
        system = sparse_system(sp.csr_array(self.jacobian.matrix.T), partner)
        return Expansion(
            -self.columns, -self.rows, system, tuple(sp.csr_array(m.T) for m in self.lower), self.decision
        )


def expand_at_infinity(E: sp.csr_array, J: sp.csr_array, tolerance: float | None = None) -> Expansion:
    """Expansion for square sparse E and J, scaled to entries of about one.

    Â0 counts as regular when 1 / ‖Â0⁻¹‖₁ (estimated) exceeds `tolerance` ‖Â0‖₁, None for 256 n eps. Raises
    NumericalError `system-jacobian-singular` otherwise, and where no assignment of equations to unknowns
    exists. Shapes: E and J (n, n).
    """
    entries, offsets = _offsets(E, J)
    row, column, power, value = entries
    lag = offsets.columns[column] - offsets.rows[row] - power
    n = E.shape[0]
    parts = [
        sp.csr_array((value[lag == k], (row[lag == k], column[lag == k])), shape=(n, n))
        for k in range(int(lag.max(initial=0)) + 1)
    ]
    system = sparse_system(parts[0], offsets.column_of)
    return Expansion(offsets.rows, offsets.columns, system, tuple(parts[1:]), _regular(system, tolerance))


def _offsets(
    E: sp.csr_array, J: sp.csr_array
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], Offsets]:
    """All entries (row, column, power of s, value) of sE - J, and the canonical offsets."""
    row, column, power, value = pencil_entries(E, J)
    n = E.shape[0]
    highest = sp.coo_array(sp.csr_array((power + 1, (row, column)), shape=(n, n)))  # 3: both E and J have one
    if find_defect(sp.csr_array(highest)) is not None:
        raise _singular("no assignment of equations to unknowns exists")
    orders = np.minimum(highest.data, 2) - 1
    return (row, column, power, value), canonical_offsets(highest.coords[0], highest.coords[1], orders, n)


def sparse_system(matrix: sp.csr_array, partner: np.ndarray) -> SparseSystem:
    """The system of a regular matrix whose row i is matched to column partner[i]: a perfect matching. Shapes:
    matrix (n, n), partner (n,).

    Raises NumericalError `system-jacobian-singular` when a pivot is zero.
    """
    try:
        factors = spla.splu(sp.csc_array(matrix))
    except RuntimeError as error:  # the way in which SuperLU tells of a zero pivot
        raise _singular("a pivot is zero") from error
    return SparseSystem(matrix, factors, partner, sp.csr_array(matrix[:, partner].T))


def _regular(system: SparseSystem, tolerance: float | None) -> RankDecision:
    """The decision that Â0 is regular, by its smallest singular value in the 1-norm."""
    n = system.matrix.shape[0]
    inverse: Any = spla.LinearOperator(
        (n, n),
        matvec=system.factors.solve,
        rmatvec=lambda x: system.factors.solve(x, trans="T"),
        dtype=float,
    )
    norm = float(abs(system.matrix).sum(axis=0).max())
    smallest = 1.0 / float(spla.onenormest(inverse))
    threshold = (default_tolerance(n) if tolerance is None else tolerance) * norm
    if not smallest > threshold:
        raise _singular(f"1 / |inverse| is {smallest:.1e}, threshold {threshold:.1e}")
    return RankDecision("system Jacobian, 1 / |inverse|", (smallest,), threshold, 1, float("inf"))


def _singular(reason: str) -> NumericalError:
    return NumericalError(
        "system-jacobian-singular",
        f"The structure alone does not tell the index: the system Jacobian is singular ({reason}).",
        remedy="Look for equations that repeat others, or state the model with fewer of them.",
    )


def inverse_columns(
    expansion: Expansion, wanted: np.ndarray, powers: Sequence[int], rows: np.ndarray | None = None
) -> dict[int, sp.csc_array]:
    """Columns `wanted` of the coefficients of s^m in (sE - J)⁻¹, m in `powers`; each (n, len(wanted)), or
    (len(rows), len(wanted)) where only these rows are asked for. Shapes: wanted (k,), rows (m,) or None for
    all n."""
    parts: dict[int, list[sp.csc_array]] = {m: [] for m in powers}
    chunks = list(_chunks(expansion.rows[wanted]))
    rows = np.arange(expansion.rows.size) if rows is None else rows
    for chunk in chunks:
        offset = int(expansion.rows[wanted[chunk[0]]])
        for m, block in _chunk(expansion, wanted[chunk], offset, powers, rows):
            parts[m].append(block)
    shape = (rows.size, wanted.size)
    return {m: _joined(parts.pop(m), chunks, shape) for m in powers}


def _chunks(offsets: np.ndarray) -> Iterator[np.ndarray]:
    """Positions with equal offsets, at most `CHUNK` of them at a time."""
    for offset in np.unique(offsets):
        members = np.flatnonzero(offsets == offset)
        for start in range(0, members.size, CHUNK):
            yield members[start : start + CHUNK]


def inverse_rows(expansion: Expansion, wanted: np.ndarray, powers: Sequence[int]) -> dict[int, sp.csr_array]:
    """Rows `wanted` of the coefficients of s^m in (sE - J)⁻¹, m in `powers`; each (len(wanted), n). Shapes:
    wanted (k,)."""
    found = inverse_columns(expansion.transposed, wanted, powers)
    return {m: sp.csr_array(part.T) for m, part in found.items()}


def apply_inverse(expansion: Expansion, right: np.ndarray, power: int) -> np.ndarray:
    """The coefficient of s^power in (sE - J)⁻¹ times `right` (n, r), rounding errors set to zero.

    With R_c, the rows of `right` at equations of offset c, T_t = Σ X(c+t) R_c follows the recursion of the
    Xk: Â0 T_t = R_(-t) - Â1 T_(t-1) - …; row j of the product is that of T_t, t = -d_j - power.
    """
    terms: list[np.ndarray] = []
    result, largest = np.zeros_like(right), np.zeros(right.shape[1])
    for t in range(-int(expansion.rows.max()), 1 - int(expansion.columns.min()) - power):
        known = np.where(expansion.rows[:, None] == -t, right, 0.0)
        for lower, term in zip(expansion.lower, terms[::-1], strict=False):
            known -= lower @ term
        terms.append(expansion.jacobian.factors.solve(known))
        largest = np.maximum(largest, np.abs(terms[-1]).max(axis=0))
        own = expansion.columns == -t - power
        result[own] = terms[-1][own]
    return np.where(np.abs(result) > ROUNDING * largest, result, 0.0)


def _chunk(
    expansion: Expansion, wanted: np.ndarray, offset: int, powers: Sequence[int], rows: np.ndarray
) -> Iterator[tuple[int, sp.csc_array]]:
    """Coefficients for columns that share the offset c: those of s^m stand in row j of X_k, k = c - d_j -
    m. Rounding errors are set to zero."""
    lag = offset - expansion.columns
    n_terms = int(lag.max(initial=0)) - min(powers) + 1
    terms = _terms(expansion, wanted, n_terms)
    largest = np.max([largest_entries(term) for term in terms], axis=0) if terms else np.zeros(wanted.size)
    for m in powers:
        yield m, _rows_of_terms(terms, lag - m, ROUNDING * largest, rows)


def _rows_of_terms(
    terms: Sequence[sp.csc_array], term_of: np.ndarray, limits: np.ndarray, rows: np.ndarray
) -> sp.csc_array:
    """Row rows[j] of terms[term_of[rows[j]]] for all j, entries above the limit of their column; rows of no
    term are zero."""
    place = np.full(term_of.size, -1, dtype=np.int32)
    place[rows] = np.arange(rows.size)
    term_of = np.where(place >= 0, term_of, -1)
    shape, found = (rows.size, limits.size), []
    for k, term in enumerate(terms):
        column = np.repeat(np.arange(limits.size, dtype=np.int32), np.diff(term.indptr))
        kept = (term_of[term.indices] == k) & (np.abs(term.data) > limits[column])
        if np.any(kept):
            pointers = np.concatenate([[0], np.cumsum(np.bincount(column[kept], minlength=limits.size))])
            found.append(sp.csc_array((term.data[kept], place[term.indices[kept]], pointers), shape=shape))
    return sp.csc_array(sum(found[1:], found[0])) if found else sp.csc_array(shape)


def _terms(expansion: Expansion, wanted: np.ndarray, n_terms: int) -> list[sp.csc_array]:
    """Columns `wanted` of X0, X1, …."""
    places = (wanted, np.arange(wanted.size))
    right = sp.csc_array((np.ones(wanted.size), places), shape=(expansion.rows.size, wanted.size))
    terms: list[sp.csc_array] = []
    for k in range(max(n_terms, 0)):
        if k:
            parts = [
                expansion.lower[i - 1] @ terms[k - i] for i in range(1, min(k, len(expansion.lower)) + 1)
            ]
            right = sp.csc_array(-sum(parts[1:], parts[0])) if parts else sp.csc_array(right.shape)
            right.eliminate_zeros()
        terms.append(expansion.jacobian.solve(right) if right.nnz else sp.csc_array(right.shape))
    return terms


def _joined(
    blocks: list[sp.csc_array], columns: Sequence[np.ndarray], shape: tuple[int, int]
) -> sp.csc_array:
    """The matrix whose columns `columns[i]` are those of block i. Blocks are given up one by one: together
    they are as large as the matrix."""
    counts = np.zeros(shape[1], dtype=np.int64)
    for block, members in zip(blocks, columns, strict=True):
        counts[members] = np.diff(block.indptr)
    pointers = np.concatenate([[0], np.cumsum(counts)])
    indices, data = np.empty(pointers[-1], dtype=np.int32), np.empty(pointers[-1])
    for members in columns:
        block = blocks.pop(0)
        shift = np.repeat(pointers[members] - block.indptr[:-1], np.diff(block.indptr))
        places = shift + np.arange(block.nnz)
        indices[places], data[places] = block.indices, block.data
    return sp.csc_array((data, indices, pointers), shape=shape)
