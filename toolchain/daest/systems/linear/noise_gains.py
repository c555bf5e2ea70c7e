"""What a noise does to the unknowns of a linear DAE without a state between: white, and differentiated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from daest.model.linear import GroupedMatrix, LinearDAE, SparseForm, StandardForm, Structure
from daest.numerics.pencils import Scaling, unit_scaling
from daest.numerics.ranks import default_tolerance
from daest.numerics.sparse_columns import column_entries, column_norms, product, scaled, ungrouped
from daest.systems.linear.nilpotent import Nilpotent, RowSpace, nilpotent_part

NO_NOISE = 1e-9
"""Part of the largest gain from a noise to differentiated noise in an unknown, in scaled equations and
unknowns, up to which a gain counts as zero. True gains are ratios of coefficients, rounding is near 1e-14."""


@dataclass(frozen=True)
class NoiseGains:
    """What a noise (or an input) with the column b (n,) does to ξ without a state between, in model units.

    ξ = Q1 z1 + Σ maps[i] b w^(i), where maps[i] = -Q2 N^i P2 (n, n), i = 0 … index-1: from `maps[1]` on the
    noise is differentiated; `maps[0]` of a large model is restricted as in `SparseForm`. `forbidden`.norm(b)
    is the projection norm of (41). `rows` and `columns` scale equations and unknowns to comparable size;
    `norms`[i] (n,) are the lengths of the scaled columns of maps[i], and `rounding`[i] (n,) what rounding
    errors may make of them. Where `exact` knows what is zero, sizes decide on nothing.
    """

    forbidden: RowSpace
    maps: tuple[GroupedMatrix, ...]
    rows: np.ndarray
    columns: np.ndarray
    norms: tuple[np.ndarray, ...]
    rounding: tuple[np.ndarray, ...]
    exact: Structure | None

    @cached_property
    def largest(self) -> tuple[float, ...]:
        """The largest scaled column of every map: what rounding errors are relative to."""
        return tuple(float(norms.max(initial=0.0)) for norms in self.norms)

    def part(self, i: int, b: np.ndarray) -> np.ndarray:
        """maps[i] b (n,), rounding errors set to zero."""
        value = product(self.maps[i], b)
        known = None if self.exact is None else self.exact.response(i, b)
        if known is not None:
            return np.where(known, value, 0.0)
        limit = self._negligible(i) * np.linalg.norm(self.rows * b) * self.columns
        return np.where(np.abs(value) > limit, value, 0.0)

    def differentiated(self, b: np.ndarray) -> bool:
        """Whether noise with the column b enters some unknown differentiated. Shapes: b (n,)."""
        if len(self.maps) < 2:
            return False
        known = None if self.exact is None else self.exact.response(1, b)
        return self.strength(b) > NO_NOISE if known is None else bool(known.any())

    def strength(self, b: np.ndarray) -> float:
        """Size of the first derivative of the noise in ξ, scaled; 1 is the most that one equation could
        give. Shapes: b (n,)."""
        size = np.linalg.norm(self.rows * b) * self.largest[1] if len(self.maps) > 1 else 0.0
        value = float(np.linalg.norm(product(self.maps[1], b) / self.columns)) if size > 0 else 0.0
        return value / float(size) if value > float((self.rows * np.abs(b)) @ self.rounding[1]) else 0.0

    def unit_strengths(self) -> np.ndarray:
        """`strength` of every equation, shape (n,)."""
        if len(self.maps) < 2 or self.largest[1] == 0.0:
            return np.zeros(self.rows.size)
        return np.where(self.norms[1] > self.rounding[1], self.norms[1] / self.largest[1], 0.0)

    def unit_differentiated(self) -> np.ndarray:
        """`differentiated` of every equation, shape (n,) bool."""
        return self.unit_strengths() > NO_NOISE if self.exact is None else self.exact.orders > 0

    def unit_direct(self) -> sp.csc_array:
        """`part` 0 of the unit column of every equation, side by side (n, n)."""
        whole = scaled(self.maps[0].core, self.maps[0].row_factor, self.maps[0].column_factor)
        entries = sp.coo_array(whole)
        row, column = entries.coords
        kept = np.abs(entries.data) > self._negligible(0) * self.rows[column] * self.columns[row]
        return sp.csc_array((entries.data[kept], (row[kept], column[kept])), shape=whole.shape)

    def reached(self, i: int, equation: int) -> np.ndarray:
        """Indices (k,) of the unknowns that the noise on one equation enters with derivative i, in order."""
        known = None if self.exact is None else self.exact.reached(i)
        if known is not None:
            return np.flatnonzero(known[:, equation])
        unknowns, values = column_entries(self.maps[i], equation)
        return unknowns[np.abs(values) > self._negligible(i) * self.rows[equation] * self.columns[unknowns]]

    def _negligible(self, i: int) -> float:
        return (NO_NOISE if i else default_tolerance(self.rows.size)) * self.largest[i]


def in_outputs(C: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """C times `unknowns` (n,); sums that cancel to rounding are zero."""
    used = np.flatnonzero(unknowns)
    if used.size == 0:
        return np.zeros(C.shape[0])
    value, size = C[:, used] @ unknowns[used], np.abs(C[:, used]) @ np.abs(unknowns[used])
    return np.where(np.abs(value) > default_tolerance(C.shape[1]) * size, value, 0.0)


def noise_gains(
    dae: LinearDAE, form: StandardForm | SparseForm, nilpotent: Nilpotent | None = None
) -> NoiseGains:
    """The maps from a noise column to differentiated noise and to outputs."""
    scaling = unit_scaling(dae.E, dae.J)
    nilpotent = nilpotent_part(dae, form, scaling) if nilpotent is None else nilpotent
    maps = form.maps if isinstance(form, SparseForm) else _dense_maps(form)
    maps = maps or (ungrouped(sp.csc_array((dae.n, dae.n))),)
    norms = tuple(column_norms(part, 1.0 / scaling.columns, 1.0 / scaling.rows) for part in maps)
    rounding = _rounding(dae, form, scaling) if isinstance(form, StandardForm) else ()
    rounding = rounding or tuple(np.zeros(dae.n) for _ in maps)  # sparse maps come without rounding errors
    return NoiseGains(nilpotent.row_space, maps, scaling.rows, scaling.columns, norms, rounding, form.exact)


def _rounding(dae: LinearDAE, form: StandardForm, scaling: Scaling) -> tuple[np.ndarray, ...]:
    """What rounding may make of the lengths of the scaled columns of Q2 N^i P2, N = P2 E Q2: the same
    products of sizes without any sign, times 256 eps."""
    P2, Q2 = np.abs(form.left[form.n_dynamic :]), np.abs(form.right[:, form.n_dynamic :])
    N = P2 @ (abs(sp.csr_array(dae.E)) @ Q2)
    found, image = [], Q2 / scaling.columns[:, None]
    for _ in range(max(form.index, 1)):
        found.append(default_tolerance(1) * np.linalg.norm(image @ P2, axis=0) / scaling.rows)
        image = image @ N
    return tuple(found)


def _dense_maps(form: StandardForm) -> tuple[GroupedMatrix, ...]:
    P2, Q2 = form.left[form.n_dynamic :], form.right[:, form.n_dynamic :]
    maps, power = [], np.eye(form.N.shape[0])
    for _ in range(max(form.index, 1)):
        maps.append(ungrouped(sp.csc_array(-Q2 @ power @ P2)))
        power = form.N @ power
    return tuple(maps)
