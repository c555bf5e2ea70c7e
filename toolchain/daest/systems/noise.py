"""Where white noise may enter a linear DAE: Theorem 3.1 of Gerdin & Schön, equation by equation.

b is admissible when N P2 b = 0 (23), which is b in the range of M = P⁻¹ diag(I, V2) (26). The orthogonal
complement of that range is the row space of V1' P2, so that I - M M⁺ of (40) is the projection onto these few
rows.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from daest.errors import ConfigError
from daest.model.linear import LinearDAE, RankDecision, SparseForm, StandardForm
from daest.model.noise import NoisePlace, NoiseReport
from daest.numerics.pencils import unit_scaling
from daest.numerics.ranks import decide_rank, default_tolerance
from daest.numerics.sparse_columns import scaled_norms
from daest.systems.nilpotent import Nilpotent, RowSpace, nilpotent_part
from daest.systems.standard_form import standard_form

NO_NOISE = 1e-9
"""Part of the largest gain from a noise to differentiated noise in an unknown, in scaled equations and
unknowns, up to which a gain counts as zero. True gains are ratios of coefficients, rounding is near 1e-14."""

NAMED_PLACES = 2
"""Admissible equations that an advice proposes."""

NAMED_UNKNOWNS = 100
"""Unknowns with differentiated noise that the verdict on an equation names: in a large model noise on each of
n equations may reach n unknowns."""


@dataclass(frozen=True)
class NoiseGains:
    """What a noise (or an input) with the column b (n,) does to ξ without a state between, in model units.

    ξ = Q1 z1 + Σ maps[i] b w^(i), where maps[i] = -Q2 N^i P2 (n, n), i = 0 … index-1: from `maps[1]` on the
    noise is differentiated; `maps[0]` of a large model is restricted as in `SparseForm`. `forbidden`.norm(b)
    is the projection norm of (41). `rows` and `columns` scale equations and unknowns to comparable size;
    `norms`[i] (n,) are the lengths of the scaled columns of maps[i].
    """

    forbidden: RowSpace
    maps: tuple[sp.csc_array, ...]
    rows: np.ndarray
    columns: np.ndarray
    norms: tuple[np.ndarray, ...]

    @cached_property
    def largest(self) -> tuple[float, ...]:
        """The largest scaled column of every map: what rounding errors are relative to."""
        return tuple(float(norms.max(initial=0.0)) for norms in self.norms)

    def part(self, i: int, b: np.ndarray) -> np.ndarray:
        """maps[i] b (n,), rounding errors set to zero."""
        value = self._product(i, b)
        limit = (NO_NOISE if i else default_tolerance(len(b))) * self.largest[i]
        return np.where(np.abs(value) > limit * np.linalg.norm(self.rows * b) * self.columns, value, 0.0)

    def strength(self, b: np.ndarray) -> float:
        """Size of the first derivative of the noise in ξ, scaled; 1 is the most that one equation could
        give."""
        size = np.linalg.norm(self.rows * b) * self.largest[1] if len(self.maps) > 1 else 0.0
        return float(np.linalg.norm(self._product(1, b) / self.columns) / size) if size > 0 else 0.0

    def unit_strengths(self) -> np.ndarray:
        """`strength` of every equation, shape (n,)."""
        if len(self.maps) < 2 or self.largest[1] == 0.0:
            return np.zeros(self.rows.size)
        return self.norms[1] / self.largest[1]

    def unit_part(self, i: int, equation: int) -> tuple[np.ndarray, np.ndarray]:
        """`part` of the unit column of one equation: the unknowns concerned, in order, and the values."""
        matrix = self.maps[i]
        span = slice(matrix.indptr[equation], matrix.indptr[equation + 1])
        unknowns, values = matrix.indices[span], matrix.data[span]
        limit = (NO_NOISE if i else default_tolerance(self.rows.size)) * self.largest[i]
        kept = np.abs(values) > limit * self.rows[equation] * self.columns[unknowns]
        return unknowns[kept], values[kept]

    def _product(self, i: int, b: np.ndarray) -> np.ndarray:
        """maps[i] b over the few equations that b acts on."""
        matrix, value = self.maps[i], np.zeros(b.size)
        for k in np.flatnonzero(b):
            span = slice(matrix.indptr[k], matrix.indptr[k + 1])
            value[matrix.indices[span]] += matrix.data[span] * b[k]
        return value


def in_outputs(C: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """C times `unknowns` (n,); sums that cancel to rounding are zero."""
    used = np.flatnonzero(unknowns)
    return _in_outputs(C, used, unknowns[used])


def _in_outputs(C: np.ndarray, used: np.ndarray, values: np.ndarray) -> np.ndarray:
    """C times a column with `values` at the unknowns `used`."""
    if used.size == 0:
        return np.zeros(C.shape[0])
    value, size = C[:, used] @ values, np.abs(C[:, used]) @ np.abs(values)
    return np.where(np.abs(value) > default_tolerance(C.shape[1]) * size, value, 0.0)


@threadpool_limits.wrap(limits=1)  # many small solutions: a second thread only waits
def noise_report(
    dae: LinearDAE,
    form: StandardForm | SparseForm | None = None,
    at: Sequence[int | str] = (),
    tolerance: float | None = None,
) -> NoiseReport:
    """Verdict, projection norm and advice for every equation, every noise of the model, and every place of
    `at`.

    `at` holds equation indices (from 0, as number or text), names of noises, of components (all their own
    equations) and of unknowns (the flow balance for a flow variable, else the equations that contain it).

    By default an equation is forbidden when noise on it reaches some unknown differentiated, decided on
    scaled equations and unknowns (`NO_NOISE`): units make no difference. With `tolerance` it is forbidden
    when the projection norm of the model as it stands exceeds it.
    """
    form = standard_form(dae) if form is None else form
    nilpotent = nilpotent_part(dae, form, unit_scaling(dae.E, dae.J))
    gains = noise_gains(dae, form, nilpotent)
    verdicts = _unit_verdicts(dae, gains, tolerance)
    allowed = [place.admissible for place in verdicts]
    neighbours = neighbourhood(dae)
    places = tuple(_with_advice(dae, place, allowed, neighbours) for place in verdicts)
    noises = {
        noise.name: _with_advice(dae, verdict(dae, gains, column, noise.name, tolerance), allowed, neighbours)
        for noise, column in zip(dae.noises, dae.B.T, strict=True)
    }
    return NoiseReport(
        equations=dae.equations,
        places=places,
        annotated=tuple(noises.values()),
        asked=tuple(_asked(dae, gains, at, places, noises)),
        n_dynamic=form.n_dynamic,
        index=form.index,
        N_singular_values=tuple(nilpotent.singular_values.tolist()),
        decisions=(*form.decisions, nilpotent.decision, _verdict_decision(gains, places, tolerance)),
        tolerance=tolerance,
    )


def noise_gains(
    dae: LinearDAE, form: StandardForm | SparseForm, nilpotent: Nilpotent | None = None
) -> NoiseGains:
    """The maps from a noise column to differentiated noise and to outputs."""
    scaling = unit_scaling(dae.E, dae.J)
    nilpotent = nilpotent_part(dae, form, scaling) if nilpotent is None else nilpotent
    maps = form.maps if isinstance(form, SparseForm) else _dense_maps(form)
    maps = maps or (sp.csc_array((dae.n, dae.n)),)
    norms = tuple(scaled_norms(part, 1.0 / scaling.columns, 1.0 / scaling.rows) for part in maps)
    return NoiseGains(nilpotent.row_space, maps, scaling.rows, scaling.columns, norms)


def _dense_maps(form: StandardForm) -> tuple[sp.csc_array, ...]:
    P2, Q2 = form.left[form.n_dynamic :], form.right[:, form.n_dynamic :]
    maps, power = [], np.eye(form.N.shape[0])
    for _ in range(max(form.index, 1)):
        maps.append(sp.csc_array(-Q2 @ power @ P2))
        power = form.N @ power
    return tuple(maps)


def verdict(
    dae: LinearDAE, gains: NoiseGains, b: np.ndarray, name: str, tolerance: float | None = None
) -> NoisePlace:
    """Verdict on the noise column b (n,), without advice."""
    size = float(np.linalg.norm(b))
    norm = gains.forbidden.norm(b) / size if size > 0 else 0.0
    admissible = gains.strength(b) <= NO_NOISE if tolerance is None else norm <= tolerance

    def part(i: int) -> tuple[np.ndarray, np.ndarray]:
        value = gains.part(i, b)
        return np.flatnonzero(value), value[value != 0.0]

    place = NoisePlace(name, tuple(np.flatnonzero(b).tolist()), admissible, norm, 0, (), (), "")
    own = [k for k, noise in enumerate(dae.noises) if noise.name == name]
    return _with_reach(dae, place, part, len(gains.maps), dae.H[:, own[0]] if own else None, None)


def _unit_verdicts(dae: LinearDAE, gains: NoiseGains, tolerance: float | None) -> list[NoisePlace]:
    """`verdict` on noise on every single equation."""
    norms = gains.forbidden.unit_norms()
    admissible = gains.unit_strengths() <= NO_NOISE if tolerance is None else norms <= tolerance
    return [
        _unit_verdict(dae, gains, k, bool(admissible[k]), float(norms[k]), NAMED_UNKNOWNS)
        for k in range(dae.n)
    ]


def _unit_verdict(
    dae: LinearDAE, gains: NoiseGains, k: int, admissible: bool, norm: float, named: int | None
) -> NoisePlace:
    place = NoisePlace(dae.equations[k].text, (k,), admissible, norm, 0, (), (), "")
    return _with_reach(dae, place, lambda i: gains.unit_part(i, k), len(gains.maps), None, named)


def _with_reach(
    dae: LinearDAE,
    place: NoisePlace,
    part: Callable[[int], tuple[np.ndarray, np.ndarray]],
    n_maps: int,
    direct: np.ndarray | None,
    named: int | None,
) -> NoisePlace:
    """The place with what the noise reaches: unknowns through its derivatives, or outputs by itself.

    `part(i)` are the unknowns, and the values, that contain the derivative i; `direct` (n_y,) is what the
    noise adds to outputs without an unknown between; at most `named` unknowns are named.
    """
    if place.admissible:
        value = _in_outputs(dae.C, *part(0)) + (0.0 if direct is None else direct)
        return replace(place, white_outputs=tuple(dae.outputs[k].name for k in np.flatnonzero(value)))
    is_reached, order = np.zeros(dae.n, dtype=bool), 0
    for i in range(1, n_maps):
        unknowns = part(i)[0]
        is_reached[unknowns] = True
        order = i if unknowns.size else order
    reached = np.flatnonzero(is_reached)
    return replace(
        place,
        order=order,
        differentiated=tuple(dae.unknowns[j].name for j in reached[:named].tolist()),
        n_differentiated=reached.size,
    )


def _verdict_decision(
    gains: NoiseGains, places: Sequence[NoisePlace], tolerance: float | None
) -> RankDecision:
    """The decision between forbidden and admissible equations, in the numbers it was made on."""
    if tolerance is not None:
        norms = np.array([place.projection_norm for place in places])
        return decide_rank("projection norms of the equations", norms, 1, 1.0, tolerance)
    strengths = gains.unit_strengths()
    return decide_rank("differentiated noise, equation by equation (scaled)", strengths, 1, 1.0, NO_NOISE)


@dataclass(frozen=True)
class Neighbourhood:
    """Which unknowns an equation contains, which equations contain an unknown, and which equations contain
    derivatives."""

    by_equation: sp.csr_array
    by_unknown: sp.csr_array
    has_derivative: np.ndarray


def neighbourhood(dae: LinearDAE) -> Neighbourhood:
    """The graph of equations and unknowns of a model."""
    E = sp.csr_array(sp.csr_array(dae.E) != 0)
    pattern = sp.csr_array(E + sp.csr_array(sp.csr_array(dae.J) != 0))
    return Neighbourhood(pattern, sp.csr_array(pattern.T), np.diff(E.indptr) > 0)


def _with_advice(
    dae: LinearDAE, place: NoisePlace, allowed: Sequence[bool], neighbours: Neighbourhood
) -> NoisePlace:
    return replace(place, advice=_advice(dae, place, allowed, neighbours))


def _advice(dae: LinearDAE, place: NoisePlace, allowed: Sequence[bool], neighbours: Neighbourhood) -> str:
    """What to do instead, or what to mind; empty where nothing is to be said."""
    if place.admissible:
        if not place.white_outputs:
            return ""
        return f"The noise itself, through no state, is part of the output {', '.join(place.white_outputs)}."
    filters = (
        "a first-order low-pass filter" if place.order < 2 else f"a low-pass filter of order {place.order}"
    )
    coloured = f"pass the noise through {filters} first (coloured noise)"
    near = _nearest_admissible(neighbours, place.equations, allowed)
    if not near:
        return f"No equation nearby may carry white noise: {coloured}."
    texts = " or ".join(f"`{dae.equations[i].text}`" for i in near)
    return f"Put the noise on {texts}, where it is integrated before it gets here, or {coloured}."


def _nearest_admissible(
    neighbours: Neighbourhood, start: Sequence[int], allowed: Sequence[bool]
) -> list[int]:
    """The nearest admissible equations with a derivative, by steps over shared unknowns; the nearest ring
    only."""
    seen, ring = set(start), list(start)
    while ring:
        unknowns = {j for i in ring for j in _row(neighbours.by_equation, i)}
        ring = sorted({i for j in unknowns for i in _row(neighbours.by_unknown, j)} - seen)
        seen.update(ring)
        found = [i for i in ring if allowed[i] and neighbours.has_derivative[i]]
        if found:
            return found[:NAMED_PLACES]
    return []


def _row(pattern: sp.csr_array, i: int) -> list[int]:
    return pattern.indices[pattern.indptr[i] : pattern.indptr[i + 1]].tolist()


def _asked(
    dae: LinearDAE,
    gains: NoiseGains,
    at: Sequence[int | str],
    places: Sequence[NoisePlace],
    noises: dict[str, NoisePlace],
) -> list[NoisePlace]:
    asked: list[NoisePlace] = []
    for item in at:
        if str(item) in noises:
            asked.append(noises[str(item)])
        else:
            asked += [_with_all_names(dae, gains, places[i]) for i in place_equations(dae, item)]
    return asked


def _with_all_names(dae: LinearDAE, gains: NoiseGains, place: NoisePlace) -> NoisePlace:
    full = _unit_verdict(dae, gains, place.equations[0], place.admissible, place.projection_norm, None)
    return replace(place, differentiated=full.differentiated)


def place_equations(dae: LinearDAE, item: int | str) -> list[int]:
    """Equations that a place of `noise_report` means. Raises ConfigError `noise-place-unknown`."""
    text = str(item)
    if text.isdigit() and int(text) < dae.n:
        return [int(text)]
    own = [i for i, e in enumerate(dae.equations) if e.origin == text and e.kind == "component"]
    same = [i for i, e in enumerate(dae.equations) if e.text == text]
    if own or same:
        return own or same
    names = [unknown.name for unknown in dae.unknowns]
    if text in names:
        return _equations_of_unknown(dae, names.index(text))
    known = [*names, *(noise.name for noise in dae.noises), *(e.origin for e in dae.equations)]
    close = difflib.get_close_matches(text, list(dict.fromkeys(known)), n=3)
    raise ConfigError(
        "noise-place-unknown",
        f"{text} is no equation (0 to {dae.n - 1}), noise, component or unknown of the model",
        remedy="nearest names: " + ", ".join(close) if close else "`daest noise` lists all equations",
    )


def _equations_of_unknown(dae: LinearDAE, column: int) -> list[int]:
    """The balance of a flow variable, else every equation that contains the unknown."""
    used = sum(abs(sp.csc_array(matrix)[:, [column]]).toarray().ravel() for matrix in (dae.E, dae.J))
    rows = [int(i) for i in np.flatnonzero(used)]
    balance = [i for i in rows if dae.equations[i].kind in ("flow", "unconnected")]
    return balance or rows
