"""Structure of a DAE: which equations must be differentiated how often, or why the structure is singular.

The counts are those of Pantelides (1988), computed as canonical offsets of the signature matrix (Pryce 2001):
both give the smallest numbers of differentiations after which the highest derivatives are matched to the
equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.errors import ModelError, Place
from daest.model.flat import FlatModel
from daest.model.parts import Equation, Variable
from daest.numerics.matching import Defect, canonical_offsets, find_defect

LISTED = 8  # equations or unknowns that a message names before it says how many more there are


@dataclass(frozen=True)
class Signature:
    """Finite entries of the signature matrix: unknown `columns[e]` occurs in equation `rows[e]` with highest
    derivative `orders[e]` (0 or 1). `n` equations and unknowns."""

    rows: np.ndarray
    columns: np.ndarray
    orders: np.ndarray
    n: int

    @property
    def incidence(self) -> sp.csr_array:
        return sp.csr_array((np.ones(self.rows.size), (self.rows, self.columns)), shape=(self.n, self.n))


@dataclass(frozen=True)
class Differentiations:
    """`equations[i]`: how often equation i is differentiated; `unknowns[j]`: highest derivative of unknown j
    then. Degrees of freedom: sum(unknowns) - sum(equations)."""

    equations: np.ndarray
    unknowns: np.ndarray

    @property
    def structural_index(self) -> int:
        """Pryce's structural index: an upper estimate of the differentiation index, exact for most models."""
        deepest = int(self.equations.max(initial=0))
        return deepest + (1 if np.any(self.unknowns == 0) else 0)


def signature(residual: ca.SX, derivatives: ca.SX, unknowns: ca.SX) -> Signature:
    """Signature of residual(derivatives, unknowns, …) with as many rows as unknowns."""
    n = residual.numel()
    order = sp.lil_array((n, n), dtype=int)  # stored value is order + 1
    for value, symbols in ((1, unknowns), (2, derivatives)):
        rows, columns = ca.jacobian_sparsity(residual, symbols).get_triplet()
        order[rows, columns] = value
    entries = sp.coo_array(order)
    return Signature(entries.row, entries.col, entries.data - 1, n)


def differentiations(sigma: Signature) -> Differentiations:
    """Differentiation counts of a structurally regular signature (`check_structure` first)."""
    offsets = canonical_offsets(sigma.rows, sigma.columns, sigma.orders, sigma.n)
    return Differentiations(offsets.rows, offsets.columns)


def check_structure(
    sigma: Signature, equations: tuple[Equation, ...], unknowns: tuple[Variable, ...], model_name: str
) -> None:
    """Raise `structurally-singular` with the equations and unknowns concerned unless all can be matched."""
    defect = find_defect(sigma.incidence)
    if defect is None:
        return
    places = [equations[i].place for i in (*defect.over_rows, *defect.under_rows)]
    raise ModelError(
        "structurally-singular",
        "\n".join(
            [
                f"the equations of {model_name} cannot determine its unknowns",
                *_defect_lines(defect, equations, unknowns),
            ]
        ),
        where=next((place for place in places if place is not None), None),
        remedy="remove one of the equations that compete, and add what fixes the unknowns that nothing "
        "determines: a missing connection, ground or fixed point is the usual reason",
    )


def _defect_lines(
    defect: Defect, equations: tuple[Equation, ...], unknowns: tuple[Variable, ...]
) -> list[str]:
    lines = []
    if defect.over_rows:
        names = name_unknowns(unknowns, defect.over_columns)
        few = f"only {_counted(len(defect.over_columns), 'unknown')} ({names})" if names else "no unknown"
        lines.append(f"{_counted(len(defect.over_rows), 'equation')} for {few}:")
        lines += name_equations(equations, defect.over_rows)
    if defect.under_columns:
        rows = len(defect.under_rows)
        few = f"only {_counted(rows, 'equation')}" if rows else "no equation"
        names = name_unknowns(unknowns, defect.under_columns)
        lines.append(f"{_counted(len(defect.under_columns), 'unknown')} with {few}: {names}")
        lines += name_equations(equations, defect.under_rows)
    return lines


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def name_equations(equations: tuple[Equation, ...], rows: tuple[int, ...]) -> list[str]:
    """One indented line `text  (place)` per equation, at most `LISTED`."""
    lines = [_equation_line(equations[i].text, equations[i].place) for i in rows[:LISTED]]
    if len(rows) > LISTED:
        lines.append(f"    … and {len(rows) - LISTED} more")
    return lines


def _equation_line(text: str, place: Place | None) -> str:
    return f"    {text}" + (f"  ({place})" if place is not None else "")


def name_unknowns(unknowns: tuple[Variable, ...], columns: tuple[int, ...]) -> str:
    """Names, at most `LISTED` of them, separated by commas."""
    names = ", ".join(unknowns[j].name for j in columns[:LISTED])
    return names + (f", … and {len(columns) - LISTED} more" if len(columns) > LISTED else "")


def flat_signature(flat: FlatModel) -> Signature:
    """Signature of the flat model as it stands in the source."""
    return signature(flat.residual, flat.derivatives, flat.xi)
