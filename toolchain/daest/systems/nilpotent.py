"""What N of the standard form says of noise: its rank and singular values, and the row space of N P2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from daest.model.linear import LinearDAE, RankDecision, SparseForm, StandardForm
from daest.numerics.pencils import Scaling
from daest.numerics.ranks import decide_rank
from daest.numerics.sparse_basis import different_rows, independent_block
from daest.numerics.sparse_columns import scaled

LARGEST_RANK = 2000
"""Rank of N up to which the singular values of a sparse form are computed: dense algebra of this size."""


DENSE_SHARE = 0.05
"""From this share of non-zero entries on, products are formed as those of dense matrices."""


@dataclass(frozen=True)
class RowSpace:
    """The row space of N P2: columns b that `rows` (rank N, n) maps to zero are admissible. `gram` solves
    with rows · rows'; None where the rows are orthonormal."""

    rows: sp.csr_array
    gram: Any

    def norm(self, b: np.ndarray) -> float:
        """|(I - M M⁺) b|, (40): the length of the part of b in the row space."""
        part = self.rows @ b
        return float(np.sqrt(max(part @ (part if self.gram is None else self.gram.solve(part)), 0.0)))

    def unit_norms(self) -> np.ndarray:
        """`norm` of every unit column, shape (n,)."""
        if self.gram is None:
            return np.sqrt(self.rows.multiply(self.rows).sum(axis=0)).ravel()
        first, group, factor = different_rows(sp.csr_array(self.rows.T))
        columns = sp.csc_array(self.rows)[:, first].toarray()
        norms = np.sqrt(np.maximum(np.sum(columns * self.gram.solve(columns), axis=0), 0.0))
        return np.abs(factor) * np.append(norms, 0.0)[group]


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
        return _of_dense(form)
    return _of_sparse(dae, form, scaling)


def _of_dense(form: StandardForm) -> Nilpotent:
    values, vectors = sla.svd(form.N)[1:] if form.N.size else (np.empty(0), np.empty((0, 0)))
    decision = decide_rank(
        "N of the standard form", values, max(form.N.shape[0], 1), float(values.max(initial=0.0))
    )
    rank, n = decision.rank, form.left.shape[0]
    rows = sla.qr((vectors[:rank] @ form.left[form.n_dynamic :]).T, mode="economic")[0].T
    kept = np.where(np.arange(values.size) < rank, values, 0.0)
    return Nilpotent(kept, decision, RowSpace(sp.csr_array(rows if rank else np.empty((0, n))), None))


def _of_sparse(dae: LinearDAE, form: SparseForm, scaling: Scaling) -> Nilpotent:
    n = dae.n
    if form.index < 2:
        decision = RankDecision("N of the standard form", (), 0.0, 0, float("inf"))
        return Nilpotent(np.zeros(n - form.n_dynamic), decision, RowSpace(sp.csr_array((0, n)), None))
    comparable = scaled(form.maps[1], 1.0 / scaling.columns, 1.0 / scaling.rows)
    rows, columns = independent_block(comparable)
    del comparable  # as large as the map itself
    rank = rows.size
    values = np.zeros(n - form.n_dynamic if rank <= LARGEST_RANK else 0)
    if values.size:
        values[:rank] = _singular_values(dae, form, rows, columns)
    decision = RankDecision("N of the standard form", tuple(values.tolist()), 0.0, rank, float("inf"))
    return Nilpotent(values, decision, _row_space(sp.csr_array(form.maps[1][rows])))


def _row_space(rows: sp.csr_array) -> RowSpace:
    lengths = np.sqrt(rows.multiply(rows).sum(axis=1)).ravel()
    rows = sp.csr_array(sp.diags_array(1.0 / lengths) @ rows)
    return RowSpace(rows, _factors(_gram(rows)))


@dataclass(frozen=True)
class _DenseFactors:
    """LU factors of a dense matrix, with the `solve` of SuperLU."""

    factors: tuple[np.ndarray, np.ndarray]

    def solve(self, right: np.ndarray) -> np.ndarray:
        return np.asarray(sla.lu_solve(self.factors, right))


def _factors(matrix: np.ndarray | sp.csr_array) -> Any:
    if isinstance(matrix, np.ndarray):
        return _DenseFactors(sla.lu_factor(matrix))
    return spla.splu(sp.csc_array(matrix))


def _gram(rows: sp.csr_array) -> np.ndarray | sp.csr_array:
    """rows · rows'; columns that are multiples of each other are taken together."""
    first, group, factor = different_rows(sp.csr_array(rows.T))
    used = group >= 0
    sizes = np.sqrt(np.bincount(group[used], factor[used] ** 2, minlength=first.size))
    core = sp.csc_array(rows)[:, first] @ sp.diags_array(sizes)
    return _product(sp.csr_array(core), sp.csc_array(core.T))


def _product(left: sp.csr_array, right: sp.csc_array) -> np.ndarray | sp.csr_array:
    """left · right, by dense algebra where the factors are nearly full."""
    if left.nnz > DENSE_SHARE * left.shape[0] * left.shape[1]:
        return np.asarray(left.toarray() @ right.toarray())
    return left @ right


def _singular_values(dae: LinearDAE, form: SparseForm, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """The singular values of N that are not zero, where |z2| is the distance of ξ from the range of Q1.

    They are those of (I - Q1 Q1⁺) T J, T = -Q2 N P2 = T_c T_rc⁻¹ T_r, from Gram matrices of the size of the
    rank: small ones are accurate to 1e-8 of the largest.
    """
    T = form.maps[1]
    T_c, T_r = sp.csc_array(T[:, columns]), sp.csr_array(T[rows])
    right = T_r @ sp.csr_array(dae.J)
    left_gram = _full(_product(T_c.T, T_c)) - _inside(form.right_dynamic, T_c)
    lengths = np.sqrt(right.multiply(right).sum(axis=1)).ravel()
    right = sp.csr_array(sp.diags_array(1.0 / lengths) @ right)
    right_gram = _full(_product(right, right.T))
    root = lengths[:, None] * sla.cholesky(right_gram, lower=True)
    middle = spla.splu(sp.csc_array(T_r[:, columns])).solve(root)
    squares = sla.eigvalsh(middle.T @ left_gram @ middle)[::-1]
    return np.sqrt(np.maximum(squares, 0.0))


def _full(matrix: np.ndarray | sp.csr_array) -> np.ndarray:
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def _inside(Q1: sp.csr_array, T_c: sp.csc_array) -> np.ndarray:
    """T_c' Q1 Q1⁺ T_c."""
    if Q1.shape[1] == 0:
        return np.zeros((T_c.shape[1],) * 2)
    lengths = np.sqrt(Q1.multiply(Q1).sum(axis=0)).ravel()
    Q1 = sp.csr_array(Q1 @ sp.diags_array(1.0 / lengths))
    shared = sp.csc_array(Q1.T @ T_c)
    return np.asarray(shared.T @ spla.splu(sp.csc_array(Q1.T @ Q1)).solve(shared.toarray()))
