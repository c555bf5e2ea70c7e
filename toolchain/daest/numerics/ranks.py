"""Rank decisions in the open: every rank is returned with its singular values, threshold and gap."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from daest.errors import NumericalError
from daest.model.linear import RankDecision

ROUNDING_FACTOR = 256.0
"""Safety factor on `max(m, n) * eps`. Random pencils of index to 4, turned by matrices of condition 1e3,
leave dropped singular values to 5 n eps and kept ones from 1e9 n eps; the factor stays near the former."""

CLEAR_GAP = 1e3
"""A gap smaller than this makes a decision doubtful: a slightly different threshold would change the rank."""


def default_tolerance(size: int) -> float:
    """Relative tolerance 256 · size · eps for matrices of at most `size` rows or columns."""
    return ROUNDING_FACTOR * max(size, 1) * float(np.finfo(float).eps)


def decide_rank(
    what: str,
    singular_values: np.ndarray,
    size: int,
    norm: float,
    tolerance: float | None = None,
    known: int | None = None,
) -> RankDecision:
    """Count the singular values above `tolerance * norm`; `tolerance` None means `default_tolerance(size)`.

    `norm` is the 2-norm of the whole matrix that rounding errors are relative to, not of the block decided.
    `known` is the rank where exact arithmetic has told it. Shapes: singular_values (k,).
    """
    values = np.sort(np.asarray(singular_values, dtype=float))[::-1]
    if not np.all(np.isfinite(values)):
        raise NumericalError(
            "rank-not-finite",
            f"{what}: the matrix holds an infinite or undefined number.",
            remedy="Check the parameter values: a division by zero gives such entries.",
        )
    threshold = (default_tolerance(size) if tolerance is None else tolerance) * norm
    rank = int(np.count_nonzero(values > threshold)) if known is None else known
    gap = _gap(values, rank)
    return RankDecision(what, tuple(values.tolist()), float(threshold), rank, gap, known is not None)


def _gap(values: np.ndarray, rank: int) -> float:
    """Smallest kept over largest dropped singular value; inf when none or only zeros were dropped."""
    if rank == values.size or values[rank] == 0.0:
        return float("inf")
    kept = values[rank - 1] if rank > 0 else np.inf
    return float(kept / values[rank])


def is_doubtful(decision: RankDecision) -> bool:
    """True when the kept singular values are not clearly above the dropped ones and the threshold."""
    if decision.rank == 0 or len(decision.singular_values) < decision.rank:  # nothing kept, or not computed
        return False
    kept = decision.singular_values[decision.rank - 1]
    return decision.gap < CLEAR_GAP or kept < CLEAR_GAP * decision.threshold


def warning(decision: RankDecision) -> str:
    """A sentence on a doubtful decision, empty when it is clear."""
    if not is_doubtful(decision):
        return ""
    kept = decision.singular_values[decision.rank - 1]
    dropped = next(iter(decision.singular_values[decision.rank :]), 0.0)
    if decision.is_exact:
        return (
            f"{decision.what}: rank {decision.rank} by exact arithmetic; floating point could not tell, "
            f"since the smallest number kept is {kept:.1e}, the largest dropped {dropped:.1e} and the "
            f"threshold {decision.threshold:.1e}: matrices and poles may have few true digits."
        )
    return (
        f"{decision.what}: rank {decision.rank} is doubtful, since the smallest number kept is {kept:.1e}, "
        f"the largest dropped {dropped:.1e} and the threshold {decision.threshold:.1e}."
    )


def range_and_null(
    what: str, matrix: np.ndarray, norm: float, tolerance: float | None = None, known: int | None = None
) -> tuple[np.ndarray, np.ndarray, RankDecision]:
    """Orthonormal bases (V1, V2) of the row space and of the null space of `matrix`, and the decision.

    Shapes (n, rank) and (n, n - rank); [V1 V2] is orthogonal. `known` as in `decide_rank`.
    """
    if min(matrix.shape) == 0:
        decision = decide_rank(what, np.empty(0), 1, norm, tolerance, known)
        return np.empty((matrix.shape[1], 0)), np.eye(matrix.shape[1]), decision
    _, values, vt = sla.svd(matrix, full_matrices=True, lapack_driver="gesvd")
    decision = decide_rank(what, values, max(matrix.shape), norm, tolerance, known)
    return vt[: decision.rank].T, vt[decision.rank :].T, decision


def equilibrated(matrix: np.ndarray) -> np.ndarray:
    """The matrix (m, n) with rows, then columns scaled to largest entry 1, so that units do not decide about
    rank; rows and columns of zeros stay."""
    tiny = np.finfo(float).tiny
    scaled = matrix / np.maximum(np.abs(matrix).max(axis=1, keepdims=True), tiny)
    return scaled / np.maximum(np.abs(scaled).max(axis=0, keepdims=True), tiny)
