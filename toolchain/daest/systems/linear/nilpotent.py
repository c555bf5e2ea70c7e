"""What N of the standard form says of noise: its rank and singular values, and the row space of N P2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from daest.model.linear import GroupedMatrix, LinearDAE, RankDecision, SparseForm, StandardForm
from daest.numerics.pencils import Scaling
from daest.numerics.ranks import decide_rank
from daest.numerics.selected_inverse import inverse_diagonal
from daest.numerics.sparse_basis import independent_block
from daest.numerics.sparse_columns import largest_entries, product

LARGEST_RANK = 2000
"""Rank of N up to which the singular values of a sparse form are computed: dense algebra of this size."""

DENSE_SHARE = 0.05
"""From this share of non-zero entries on, products are formed as those of dense matrices."""

CHUNK = 256
"""Columns that are projected at a time."""

SELECTED = 200
"""From so many columns on the lengths of their projections are diagonal entries of an inverse."""

WORTH_FEWER = 0.9
"""Where the rank of T is below this part of its columns, as many columns take their place: dense algebra
grows with the third power of their number."""

LARGEST_SHARE, LEFT_OVER = 10.0, 1e-13
"""Columns are sums of others with factors up to the first; what is left of them is below the second part of
the largest entry."""

SMALL_SQUARE = 1e-6
"""Squares of lengths below this have lost digits: these columns are projected."""


class RowSpace(Protocol):
    """The row space of N P2: columns b that are orthogonal to it are admissible."""

    def norm(self, b: np.ndarray) -> float:
        """|(I - M M⁺) b|, (40): the length of the part of b (n,) in the row space."""
        ...

    def unit_norms(self) -> np.ndarray:
        """`norm` of every unit column, shape (n,)."""
        ...


@dataclass(frozen=True)
class OrthonormalRows:
    """A row space by orthonormal `rows` (rank N, n)."""

    rows: np.ndarray

    def norm(self, b: np.ndarray) -> float:
        return float(np.linalg.norm(self.rows @ b))

    def unit_norms(self) -> np.ndarray:
        return np.linalg.norm(self.rows, axis=0)


@dataclass(frozen=True)
class Complement:
    """The row space of N P2: what is orthogonal to the range of M = [J ker E, E Q1], the admissible columns.

    `matrix` is [[I, M], [M', 0]], whose `factors` give b - M M⁺ b for (b, 0); None where nothing is
    forbidden. Equations of a group of `differentiated`, the coefficient of s, have parallel projections.
    """

    n: int
    matrix: sp.csc_array | None
    factors: Any
    differentiated: GroupedMatrix

    def norm(self, b: np.ndarray) -> float:
        if self.factors is None or not np.any(product(self.differentiated, b)):
            return 0.0
        size = self.factors.shape[0]
        return float(np.linalg.norm(self.factors.solve(np.append(b, np.zeros(size - self.n)))[: self.n]))

    def unit_norms(self) -> np.ndarray:
        norms = np.zeros(self.n)
        if self.factors is None:
            return norms
        group, factor = self.differentiated.column_group, np.abs(self.differentiated.column_factor)
        reaching = np.append(largest_entries(self.differentiated.core) > 0.0, False)
        used = np.flatnonzero(reaching[group])
        order = used[np.lexsort((-factor[used], group[used]))]
        first = order[np.flatnonzero(np.diff(group[order], prepend=-1))]
        found = np.zeros(reaching.size)
        found[group[first]] = self._lengths(first) / factor[first]
        norms[used] = found[group[used]] * factor[used]
        return norms

    def _lengths(self, equations: np.ndarray) -> np.ndarray:
        """Lengths of the projections of unit columns, whose squares are diagonal entries of the projector."""
        squares = None
        if equations.size >= SELECTED:
            squares = inverse_diagonal(self.matrix, self.factors, equations)
        if squares is None:
            return self._projected(equations)
        lengths = np.sqrt(np.maximum(squares, 0.0))
        small = squares < SMALL_SQUARE
        lengths[small] = self._projected(equations[small])
        return lengths

    def _projected(self, equations: np.ndarray) -> np.ndarray:
        lengths = np.empty(equations.size)
        for start in range(0, equations.size, CHUNK):
            some = equations[start : start + CHUNK]
            unit = np.zeros((self.factors.shape[0], some.size))
            unit[some, np.arange(some.size)] = 1.0
            lengths[start : start + CHUNK] = np.linalg.norm(self.factors.solve(unit)[: self.n], axis=0)
        return lengths


@dataclass(frozen=True)
class Nilpotent:
    """Singular values of N, zeros for the dropped ones, the decision on its rank, and the row space of N P2.

    No values are given where the rank of a sparse form is above `LARGEST_RANK`.
    """

    singular_values: np.ndarray
    decision: RankDecision
    row_space: RowSpace


def nilpotent_part(dae: LinearDAE, form: StandardForm | SparseForm, scaling: Scaling) -> Nilpotent:
    """Of a standard form of `dae`; `scaling` is the `unit_scaling` of the model."""
    if isinstance(form, StandardForm):
        return _of_dense(dae, form)
    return _of_sparse(dae, form, scaling)


def _of_dense(dae: LinearDAE, form: StandardForm) -> Nilpotent:
    n1, n = form.n_dynamic, form.left.shape[0]
    values, vectors = sla.svd(form.N)[1:] if form.N.size else (np.empty(0), np.empty((0, 0)))
    # N = P2 E Q2: rounding errors are relative to the sums that it is made of, which N itself need not show
    P2, Q2 = np.abs(form.left[n1:]), np.abs(form.right[:, n1:])
    size = float(sla.norm(P2 @ (abs(sp.csr_array(dae.E)) @ Q2))) if form.N.size else 0.0
    decision = decide_rank(
        "N of the standard form",
        values,
        1,
        max(size, float(values.max(initial=0.0))),
        known=form.exact.rank_of_n if form.exact else None,
    )
    rank = decision.rank
    rows = sla.qr((vectors[:rank] @ form.left[n1:]).T, mode="economic")[0].T
    kept = np.where(np.arange(values.size) < rank, values, 0.0)
    return Nilpotent(kept, decision, OrthonormalRows(rows if rank else np.empty((0, n))))


def _of_sparse(dae: LinearDAE, form: SparseForm, scaling: Scaling) -> Nilpotent:
    n = dae.n
    if form.index < 2:
        decision = RankDecision("N of the standard form", (), 0.0, 0, float("inf"))
        nothing = GroupedMatrix(
            sp.csc_array((0, 0)), np.full(n, -1), np.zeros(n), np.full(n, -1), np.zeros(n)
        )
        return Nilpotent(np.zeros(n - form.n_dynamic), decision, Complement(n, None, None, nothing))
    kernel = _kernel(sp.csr_array(dae.E), scaling)
    rank = n - kernel.shape[1] - form.n_dynamic  # P E Q = diag(I, N)
    values = np.zeros(n - form.n_dynamic if rank <= LARGEST_RANK else 0)
    if values.size:
        values[:rank] = _singular_values(dae, form, rank)
    decision = RankDecision("N of the standard form", tuple(values.tolist()), 0.0, rank, float("inf"))
    matrix = _normal_matrix(dae, form, kernel)
    return Nilpotent(values, decision, Complement(n, matrix, spla.splu(matrix), form.maps[1]))


def _kernel(E: sp.csr_array, scaling: Scaling) -> sp.csc_array:
    """A basis (n, n - rank) of the null space of E: unit vectors but for unknowns whose derivatives occur
    only in combinations."""
    comparable = sp.csr_array(sp.diags_array(scaling.rows) @ E @ sp.diags_array(scaling.columns))
    rows, columns = independent_block(comparable)
    others = np.setdiff1d(np.arange(E.shape[1]), columns)
    places = (others, np.arange(others.size))
    basis = sp.csc_array((np.ones(others.size), places), shape=(E.shape[1], others.size))
    rest = sp.csc_array(E[rows][:, others])
    if rest.nnz:
        shares = sp.coo_array(spla.spsolve(sp.csc_array(E[rows][:, columns]), rest))
        basis = basis - sp.csc_array(
            (shares.data, (columns[shares.coords[0]], shares.coords[1])), basis.shape
        )
    return sp.csc_array(basis)


def _normal_matrix(dae: LinearDAE, form: SparseForm, kernel: sp.csc_array) -> sp.csc_array:
    """[[I, M], [M', 0]] with the columns of M at unit length."""
    M = sp.csc_array(sp.hstack([sp.csr_array(dae.J) @ kernel, sp.csr_array(dae.E) @ form.right_dynamic]))
    M = M @ sp.diags_array(1.0 / np.sqrt(M.multiply(M).sum(axis=0)).ravel())
    return sp.csc_array(sp.block_array([[sp.eye_array(dae.n), M], [M.T, None]]))


def _singular_values(dae: LinearDAE, form: SparseForm, rank: int) -> np.ndarray:
    """The `rank` largest singular values of N, where |z2| is the distance of ξ from the range of Q1.

    They are those of (I - Q1 Q1⁺) T J, T = -Q2 N P2 the coefficient of s, from Gram matrices of the size of
    its groups: small ones are accurate to 1e-8 of the largest.
    """
    T = form.maps[1]
    used = np.flatnonzero(largest_entries(T.core) > 0.0)
    left = _expansion(T.row_group, T.row_factor, T.core.shape[0])
    right = _expansion(T.column_group, T.column_factor, T.core.shape[1])[:, used].T @ sp.csr_array(dae.J)
    columns = sp.csc_array(T.core[:, used])
    if rank < WORTH_FEWER * used.size:
        columns, shares = _few_columns(columns)
        right = sp.csr_array(shares @ right)
    reached = sp.csc_array(left @ columns)
    left_gram = _full(_product(reached.T, reached)) - _inside(form.right_dynamic, reached)
    root = _root(right)
    squares = sla.eigvalsh(root.T @ left_gram @ root)[::-1]
    return np.sqrt(np.maximum(squares[:rank], 0.0))


def _few_columns(matrix: sp.csc_array) -> tuple[sp.csc_array, sp.csr_array]:
    """columns (m, r) and shares (r, n) with columns · shares = matrix (m, n): as many of its columns as its
    rank, where that goes without large shares, else all."""
    rows, chosen = independent_block(matrix)
    whole = matrix, sp.csr_array(sp.eye_array(matrix.shape[1]))
    if chosen.size in (0, matrix.shape[1]):
        return whole
    columns = sp.csc_array(matrix[:, chosen])
    shares = sp.csr_array(spla.splu(sp.csc_array(columns[rows])).solve(matrix[rows].toarray()))
    left = abs(columns @ shares - matrix).max()
    is_good = abs(shares).max() <= LARGEST_SHARE and left <= LEFT_OVER * abs(matrix).max()
    return (columns, shares) if is_good else whole


def _root(rows: sp.csr_array) -> np.ndarray:
    """A matrix R, as high as `rows` (m, n), with R R' = rows · rows'."""
    lengths = np.sqrt(rows.multiply(rows).sum(axis=1)).ravel()
    lengths[lengths == 0.0] = 1.0
    rows = sp.csr_array(sp.diags_array(1.0 / lengths) @ rows)
    factor, order, rank, _ = sla.lapack.dpstrf(_full(_product(rows, rows.T)), lower=1)
    root = np.empty((rows.shape[0], rank))
    root[order - 1] = np.tril(factor)[:, :rank]
    return lengths[:, None] * root


def _expansion(group: np.ndarray, factor: np.ndarray, n_groups: int) -> sp.csr_array:
    """The matrix (n, n_groups) that repeats groups with their factors."""
    used = np.flatnonzero(group >= 0)
    return sp.csr_array((factor[used], (used, group[used])), shape=(group.size, n_groups))


def _product(left: sp.csr_array, right: sp.csc_array) -> np.ndarray | sp.csr_array:
    """left · right, by dense algebra where the factors are nearly full."""
    if left.nnz > DENSE_SHARE * left.shape[0] * left.shape[1]:
        return np.asarray(left.toarray() @ right.toarray())
    return left @ right


def _full(matrix: np.ndarray | sp.csr_array) -> np.ndarray:
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def _inside(Q1: sp.csr_array, columns: sp.csc_array) -> np.ndarray:
    """columns' Q1 Q1⁺ columns."""
    if Q1.shape[1] == 0:
        return np.zeros((columns.shape[1],) * 2)
    lengths = np.sqrt(Q1.multiply(Q1).sum(axis=0)).ravel()
    Q1 = sp.csr_array(Q1 @ sp.diags_array(1.0 / lengths))
    shared = sp.csc_array(Q1.T @ columns)
    return np.asarray(shared.T @ spla.splu(sp.csc_array(Q1.T @ Q1)).solve(shared.toarray()))
