"""Regular matrix pencils sE - J: split into finite and infinite part by a rank-revealing staircase.

The infinite structure is found by orthogonal transformations and rank decisions alone (P. Van Dooren, The
computation of Kronecker's canonical form of a singular pencil, LAA 1979; A. Varga, MatrixPencils), never by
the size of computed eigenvalues: those of a Jordan block of size 3 at infinity scatter to eps^(1/3). The two
parts are then decoupled by a generalized Sylvester equation, as in M. Gerdin, Parameter estimation in linear
descriptor systems, 2004.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from daest.errors import NumericalError
from daest.model.linear import Matrix, RankDecision, StandardForm
from daest.numerics.ranks import decide_rank, range_and_null

MAXIMUM_SWEEPS = 10
"""Sweeps of `equilibrate`; each halves the logarithm of what is left to scale."""

SCALING_ACCURACY = 1e-3
"""Accuracy of the binary logarithms of the scales of `unit_scaling`, which are rounded to integers."""


@dataclass(frozen=True)
class Scaling:
    """Powers of two: rows (n,), columns (n,) and time, so that `time * rows * E * columns` and `rows * J *
    columns` have entries of comparable size. Powers of two: scaling makes no rounding error."""

    rows: np.ndarray
    columns: np.ndarray
    time: float


@dataclass(frozen=True)
class Staircase:
    """left' E right = [[E_f, 0], [E_if, E_i]] and the same for J, by orthogonal `left` and `right`.

    E_f (n_f, n_f) and J_i are regular, J_i is upper triangular, E_i strictly block upper triangular with
    blocks of `sizes` (the Weyr characteristic of the eigenvalue at infinity): exact zeros elsewhere.
    """

    left: np.ndarray
    right: np.ndarray
    E: np.ndarray
    J: np.ndarray
    sizes: tuple[int, ...]
    decisions: tuple[RankDecision, ...]

    @property
    def n_finite(self) -> int:
        return self.E.shape[0] - sum(self.sizes)


def split_pencil(
    E: Matrix, J: Matrix, tolerance: float | None = None, sizes: tuple[int, ...] | None = None
) -> StandardForm:
    """P E Q = diag(I, N), P J Q = diag(A, I) for a regular pencil sE - J, by dense computations.

    N is strictly block upper triangular with exact zeros, so N^index = 0 exactly. The rank decisions are made
    on the pencil scaled by powers of two, so that they do not depend on the units of equations and unknowns;
    the columns of Q for the finite part are orthonormal after that scaling. `tolerance` is relative to the
    norm of the scaled E (or J); None is 256 n eps. `sizes` are those of the levels where they are known.

    Raises NumericalError `pencil-singular` when det(sE - J) vanishes identically (to the tolerance).
    """
    E, J = _dense(E), _dense(J)
    if E.shape != J.shape or E.shape[0] != E.shape[1]:
        raise ValueError(f"E {E.shape} and J {J.shape} must be square and of one size")
    scaling = equilibrate(E, J)
    stair = staircase(*apply_scaling(scaling, E, J), tolerance, sizes)
    left, right, A, N = _normalise(stair, *_decouple(stair))
    n_finite = stair.n_finite
    left[:n_finite] *= scaling.time
    return StandardForm(
        left=left * scaling.rows,
        right=scaling.columns[:, None] * right,
        A=A * scaling.time,
        N=N / scaling.time,
        index=len(stair.sizes),
        decisions=stair.decisions,
    )


def _dense(matrix: Matrix) -> np.ndarray:
    return np.asarray(sp.csr_array(matrix).toarray() if sp.issparse(matrix) else matrix, dtype=float)


def apply_scaling(scaling: Scaling, E: Matrix, J: Matrix) -> tuple[Matrix, Matrix]:
    """The scaled pencil, dense or sparse as given."""
    if sp.issparse(E):
        rows, columns = sp.diags_array(scaling.rows), sp.diags_array(scaling.columns)
        return (rows @ E @ columns * scaling.time).tocsr(), (rows @ J @ columns).tocsr()
    return (
        scaling.time * scaling.rows[:, None] * E * scaling.columns,
        scaling.rows[:, None] * J * scaling.columns,
    )


def equilibrate(E: Matrix, J: Matrix) -> Scaling:
    """Scaling by powers of two that brings the row and column maxima of (|E|, |J|) near one (D. Ruiz, 2001).

    The time scale is the ratio of the geometric means of the entries of E and J. Small entries, which
    may be rounding errors, hardly matter.
    """
    n = E.shape[0]
    (row, column, size), is_e = _entries(E, J)
    rows, columns, time = np.zeros(n), np.zeros(n), 0.0  # logarithms to base 2
    for _ in range(MAXIMUM_SWEEPS):
        scaled = size + rows[row] + columns[column] + time * is_e
        rows -= 0.5 * _maxima(scaled, row, n)
        columns -= 0.5 * _maxima(scaled, column, n)
        if is_e.any() and not is_e.all():
            scaled = size + rows[row] + columns[column]
            time = float(scaled[~is_e].mean() - scaled[is_e].mean())
    return _powers_of_two(rows, columns, time)


def unit_scaling(E: Matrix, J: Matrix) -> Scaling:
    """Scaling by powers of two that undoes any choice of units, for matrices without rounding errors.

    Least-squares fit of all log|entry| by row + column + time (A. Curtis, J. Reid, 1972): scaling equations,
    unknowns or time changes the scales, but not the scaled matrices (to factors of two).
    """
    n = E.shape[0]
    (row, column, size), is_e = _entries(E, J)
    if size.size == 0:
        return Scaling(np.ones(n), np.ones(n), 1.0)
    return _powers_of_two(*_least_squares_scales(row, column, size, is_e, n))


def _powers_of_two(rows: np.ndarray, columns: np.ndarray, time: float) -> Scaling:
    return Scaling(np.exp2(np.round(rows)), np.exp2(np.round(columns)), float(np.exp2(np.round(time))))


def _least_squares_scales(
    row: np.ndarray, column: np.ndarray, size: np.ndarray, is_e: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Logarithms of row, column and time scales that minimise Σ (size + row + column + time · is_e)²."""
    entry = np.arange(size.size)
    index = np.concatenate([row, n + column, np.full(np.count_nonzero(is_e), 2 * n)])
    entries = np.concatenate([entry, entry, entry[is_e]])
    design = sp.csr_array((np.ones(index.size), (entries, index)), shape=(size.size, 2 * n + 1))
    scales = spla.lsqr(design, -size, atol=SCALING_ACCURACY, btol=SCALING_ACCURACY)[0]
    return scales[:n], scales[n : 2 * n], float(scales[2 * n])


def _entries(E: Matrix, J: Matrix) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Row, column and log2 of the size of all non-zero entries of E and then of J; which ones are of E."""
    parts = [sp.coo_array(matrix) for matrix in (E, J)]
    value = np.concatenate([part.data for part in parts])
    row = np.concatenate([part.coords[0] for part in parts])
    column = np.concatenate([part.coords[1] for part in parts])
    is_e = np.arange(value.size) < parts[0].data.size
    keep = value != 0
    if not np.all(np.isfinite(value)):
        raise NumericalError(
            "rank-not-finite",
            "The matrices of the linear model hold an infinite or undefined number.",
            remedy="Check parameter values and operating point: a division by zero gives such entries.",
        )
    return (row[keep], column[keep], np.log2(np.abs(value[keep]))), is_e[keep]


def _maxima(values: np.ndarray, index: np.ndarray, n: int) -> np.ndarray:
    """Maximum of `values` for each index 0 … n-1; 0 where an index has none."""
    result = np.full(n, -np.inf)
    np.maximum.at(result, index, values)
    return np.where(np.isfinite(result), result, 0.0)


def staircase(
    E: np.ndarray, J: np.ndarray, tolerance: float | None = None, known: tuple[int, ...] | None = None
) -> Staircase:
    """Orthogonal reduction that peels the infinite eigenvalues off, one level of the nilpotent part a step.

    Each step: V2 spans the null space of the active E; J V2 has full column rank in a regular pencil, its row
    compression is the next diagonal block of J_i. Thresholds are relative to the norms of the whole E and J:
    orthogonal steps do not amplify rounding errors. `known` sizes are not decided again. Shapes: E and J (n,
    n).
    """
    n = E.shape[0]
    norms = tuple(float(np.linalg.norm(matrix, 2)) if n else 0.0 for matrix in (E, J))
    E, J = E.copy(), J.copy()
    left, right = np.eye(n), np.eye(n)
    sizes: list[int] = []
    decisions: list[RankDecision] = []
    active = n
    while active > 0:
        own = None if known is None else next(iter(known[len(sizes) :]), 0)
        what = f"E of the staircase, level {len(sizes) + 1}"
        row_space, null_space, decision = range_and_null(
            what, E[:active, :active], norms[0], tolerance, None if own is None else active - own
        )
        decisions.append(decision)
        size = null_space.shape[1]
        if size == 0:
            break
        V = np.hstack([row_space, null_space])
        J_null = J[:active, :active] @ null_space
        values = sla.svdvals(J_null)
        decision = decide_rank(
            f"J on the null space of E, level {len(sizes) + 1}", values, active, norms[1], tolerance, own
        )
        if decision.rank < size:
            raise singular_pencil(decision)
        decisions.append(decision)
        U = _rows_last(J_null)
        for matrix in (E, J):
            matrix[:, :active] = matrix[:, :active] @ V
            matrix[:active] = U.T @ matrix[:active]
        right[:, :active] = right[:, :active] @ V
        left[:, :active] = left[:, :active] @ U
        E[:active, active - size : active] = 0.0
        J[: active - size, active - size : active] = 0.0
        active -= size
        sizes.append(size)
    return _ordered(left, right, E, J, sizes, decisions)


def _rows_last(J_null: np.ndarray) -> np.ndarray:
    """Orthogonal U with U' J_null = [0; R], R square and upper triangular."""
    size = J_null.shape[1]
    U, _ = sla.qr(J_null)
    return np.hstack([U[:, size:], U[:, :size]])


def _ordered(
    left: np.ndarray,
    right: np.ndarray,
    E: np.ndarray,
    J: np.ndarray,
    sizes: list[int],
    decisions: list[RankDecision],
) -> Staircase:
    """Put the levels, which were peeled off from the end, into the order 1, 2, …: upper triangular."""
    n = E.shape[0]
    ends = n - np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    order = [np.arange(ends[-1])] + [np.arange(ends[k + 1], ends[k]) for k in range(len(sizes))]
    index = np.concatenate(order).astype(int)
    E, J = E[np.ix_(index, index)], J[np.ix_(index, index)]
    n_finite = int(ends[-1])
    J[n_finite:, n_finite:] = np.triu(J[n_finite:, n_finite:])
    return Staircase(left[:, index], right[:, index], E, J, tuple(sizes), tuple(decisions))


def singular_pencil(decision: RankDecision) -> NumericalError:
    """The error of a pencil whose determinant vanishes for all s."""
    smallest = decision.singular_values[-1] if decision.singular_values else 0.0
    return NumericalError(
        "pencil-singular",
        "det(sE - J) is zero for every s: the equations do not determine the unknowns "
        f"({decision.what}: smallest singular value {smallest:.1e}, threshold {decision.threshold:.1e}).",
        remedy="Look for an equation that repeats others, and for an unknown that no equation fixes.",
    )


def _decouple(stair: Staircase) -> tuple[np.ndarray, np.ndarray]:
    """(X, Y), both (n_i, n_f), with E_if + X E_f + E_i Y = 0 and J_if + X J_f + J_i Y = 0.

    Column by column in the complex generalized Schur form J_f = Z1 S Z2ᴴ, E_f = Z1 T Z2ᴴ, where each column
    is one triangular solve with t J_i - s E_i; no eigenvalue of the infinite part is ever computed.
    """
    n_f = stair.n_finite
    n_i = stair.E.shape[0] - n_f
    if n_f == 0 or n_i == 0:
        return np.zeros((n_i, n_f)), np.zeros((n_i, n_f))
    E_i, J_i = stair.E[n_f:, n_f:], stair.J[n_f:, n_f:]
    S, T, Z1, Z2 = sla.qz(stair.J[:n_f, :n_f], stair.E[:n_f, :n_f], output="complex")
    right_e, right_j = -stair.E[n_f:, :n_f] @ Z2, -stair.J[n_f:, :n_f] @ Z2
    X, Y = np.zeros((n_i, n_f), complex), np.zeros((n_i, n_f), complex)
    for j in range(n_f):
        r_e = right_e[:, j] - X[:, :j] @ T[:j, j]
        r_j = right_j[:, j] - X[:, :j] @ S[:j, j]
        s, t = S[j, j], T[j, j]
        Y[:, j] = sla.solve_triangular(t * J_i - s * E_i, t * r_j - s * r_e)
        from_e = abs(t) >= abs(s)
        X[:, j] = (r_e - E_i @ Y[:, j]) / t if from_e else (r_j - J_i @ Y[:, j]) / s
    return (X @ Z1.conj().T).real, (Y @ Z2.conj().T).real


def _normalise(
    stair: Staircase, X: np.ndarray, Y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(P, Q, A, N) of the scaled pencil; the finite columns of Q are made orthonormal."""
    n_f = stair.n_finite
    finite, infinite = slice(0, n_f), slice(n_f, None)
    right_f, R = sla.qr(stair.right[:, finite] + stair.right[:, infinite] @ Y, mode="economic")
    left_f, A = stair.left[:, finite].T, stair.J[finite, finite]
    if n_f:  # z1' = R z1 is the orthonormal basis of the same subspace
        inverse = sla.lu_factor(stair.E[finite, finite])
        left_f = R @ sla.lu_solve(inverse, left_f)
        A = sla.solve_triangular(R, (R @ sla.lu_solve(inverse, A)).T, trans="T").T
    rows_i = stair.left[:, infinite].T + X @ stair.left[:, finite].T
    J_i = stair.J[infinite, infinite]
    left_i = sla.solve_triangular(J_i, rows_i) if stair.sizes else rows_i
    N = sla.solve_triangular(J_i, stair.E[infinite, infinite]) if stair.sizes else np.empty((0, 0))
    return (
        np.vstack([left_f, left_i]),
        np.hstack([right_f, stair.right[:, infinite]]),
        A,
        _strictly_upper(N, stair.sizes),
    )


def _strictly_upper(N: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """N with exact zeros on and below its block diagonal, where rounding could leave signs of zero."""
    start = 0
    for size in sizes:
        N[start:, start : start + size] = 0.0
        start += size
    return N
