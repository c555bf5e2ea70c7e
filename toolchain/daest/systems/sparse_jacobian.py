"""Jacobians of large expressions that a few rows with many entries would make slow."""

from __future__ import annotations

import casadi as ca
import numpy as np

MANY = 50
"""Entries of a row from which on it is differentiated apart from the others: CasADi takes as many sweeps as
the fullest row, or the fullest column, has entries."""


def sparse_jacobian(expression: ca.SX, symbols: ca.SX) -> ca.SX:
    """∂expression/∂symbols, as `casadi.jacobian`; a flow balance with a thousand currents beside a potential
    that a thousand equations share takes a few sweeps instead of a thousand."""
    counts = np.diff(ca.jacobian_sparsity(expression, symbols).T.colind())
    full = np.flatnonzero(counts >= MANY)
    if full.size == 0:
        return ca.jacobian(expression, symbols)
    rest = np.flatnonzero(counts < MANY)
    order = np.concatenate([rest, full])
    parts = [ca.jacobian(expression[rows.tolist()], symbols) for rows in (rest, full)]
    return ca.vertcat(*parts)[np.argsort(order).tolist(), :]
