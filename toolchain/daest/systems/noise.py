"""Where white noise may enter a linear DAE: Theorem 3.1 of Gerdin & Schön, equation by equation.

b is admissible when N P2 b = 0 (23), which is b in the range of M = P⁻¹ diag(I, V2) (26). The orthogonal
complement of that range is the row space of V1' P2, so that I - M M⁺ of (40) is the projection onto these few
rows.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp

from daest.errors import ConfigError
from daest.model.linear import LinearDAE, RankDecision, StandardForm
from daest.model.noise import NoisePlace, NoiseReport
from daest.numerics.pencils import unit_scaling
from daest.numerics.ranks import decide_rank, default_tolerance
from daest.systems.split import split

NO_NOISE = 1e-9
"""Part of the largest gain from a noise to differentiated noise in an unknown, in scaled equations and
unknowns, up to which a gain counts as zero. True gains are ratios of coefficients, rounding is near 1e-14."""

NAMED_PLACES = 2
"""Admissible equations that an advice proposes."""


@dataclass(frozen=True)
class NoiseGains:
    """What a noise (or an input) with the column b (n,) does to ξ without a state between, in model units.

    ξ = Q1 z1 + Σ maps[i] b w^(i), where maps[i] = -Q2 N^i P2 (n, n), i = 0 … index-1: from `maps[1]` on the
    noise is differentiated. `forbidden` (rank N, n): orthonormal rows, |forbidden b| is the projection norm
    of (41). `rows` and `columns` scale equations and unknowns to comparable size; `largest`[i] is the largest
    scaled column of maps[i], what rounding errors are relative to.
    """

    forbidden: np.ndarray
    maps: tuple[np.ndarray, ...]
    rows: np.ndarray
    columns: np.ndarray
    largest: tuple[float, ...]

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

    def _product(self, i: int, b: np.ndarray) -> np.ndarray:
        """maps[i] b over the few equations that b acts on."""
        used = np.flatnonzero(b)
        return self.maps[i][:, used] @ b[used]


def in_outputs(C: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """C times `unknowns` (n,); sums that cancel to rounding are zero."""
    value, size = C @ unknowns, np.abs(C) @ np.abs(unknowns)
    return np.where(np.abs(value) > default_tolerance(len(unknowns)) * size, value, 0.0)


def noise_report(
    dae: LinearDAE,
    form: StandardForm | None = None,
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
    form = split(dae) if form is None else form
    singular_values, decision = _nilpotent_rank(form)
    gains = noise_gains(dae, form, decision.rank)
    identity = np.eye(dae.n)
    verdicts = [verdict(dae, gains, b, dae.equations[i].text, tolerance) for i, b in enumerate(identity)]
    allowed = [place.admissible for place in verdicts]
    places = tuple(_with_advice(dae, place, allowed) for place in verdicts)
    noises = {
        noise.name: _with_advice(dae, verdict(dae, gains, column, noise.name, tolerance), allowed)
        for noise, column in zip(dae.noises, dae.B.T, strict=True)
    }
    return NoiseReport(
        equations=dae.equations,
        places=places,
        annotated=tuple(noises.values()),
        asked=tuple(_asked(dae, at, places, noises)),
        n_dynamic=form.n_dynamic,
        index=form.index,
        N_singular_values=tuple(singular_values.tolist()),
        decisions=(*form.decisions, decision, _verdict_decision(gains, places, tolerance)),
        tolerance=tolerance,
    )


def _nilpotent_rank(form: StandardForm) -> tuple[np.ndarray, RankDecision]:
    """Singular values of N, zeros for the dropped ones, and the decision."""
    values = sla.svdvals(form.N) if form.N.size else np.empty(0)
    norm = float(values.max(initial=0.0))
    decision = decide_rank("N of the standard form", values, max(form.N.shape[0], 1), norm)
    return np.where(np.arange(values.size) < decision.rank, values, 0.0), decision


def noise_gains(dae: LinearDAE, form: StandardForm, rank: int | None = None) -> NoiseGains:
    """The maps from a noise column to differentiated noise and to outputs; `rank` is that of N."""
    n1 = form.n_dynamic
    P2, Q2 = form.left[n1:], form.right[:, n1:]
    rank = _nilpotent_rank(form)[1].rank if rank is None else rank
    V1 = sla.svd(form.N)[2][:rank] if rank else np.empty((0, P2.shape[0]))
    forbidden = sla.qr((V1 @ P2).T, mode="economic")[0].T if rank else np.empty((0, dae.n))
    maps, power = [], np.eye(form.N.shape[0])
    for _ in range(max(form.index, 1)):
        maps.append(-Q2 @ power @ P2)
        power = form.N @ power
    scaling = unit_scaling(dae.E, dae.J)
    scaled = [part / scaling.columns[:, None] / scaling.rows for part in maps]
    largest = tuple(_largest_column(part) for part in scaled)
    return NoiseGains(forbidden, tuple(maps), scaling.rows, scaling.columns, largest)


def _largest_column(matrix: np.ndarray) -> float:
    return float(np.linalg.norm(matrix, axis=0).max(initial=0.0))


def verdict(
    dae: LinearDAE, gains: NoiseGains, b: np.ndarray, name: str, tolerance: float | None = None
) -> NoisePlace:
    """Verdict on the noise column b (n,), without advice."""
    size = float(np.linalg.norm(b))
    norm = float(np.linalg.norm(gains.forbidden @ b)) / size if size > 0 else 0.0
    admissible = gains.strength(b) <= NO_NOISE if tolerance is None else norm <= tolerance
    orders = [] if admissible else [gains.part(i, b) != 0.0 for i in range(1, len(gains.maps))]
    reached = np.any(orders, axis=0) if orders else np.zeros(dae.n, dtype=bool)
    return NoisePlace(
        name=name,
        equations=tuple(int(i) for i in np.flatnonzero(b)),
        admissible=admissible,
        projection_norm=norm,
        order=max((i for i, present in enumerate(orders, start=1) if present.any()), default=0),
        differentiated=tuple(dae.unknowns[i].name for i in np.flatnonzero(reached)),
        white_outputs=_white_outputs(dae, gains, b, name) if admissible else (),
        advice="",
    )


def _white_outputs(dae: LinearDAE, gains: NoiseGains, b: np.ndarray, name: str) -> tuple[str, ...]:
    """Outputs that contain the noise itself, through ξ or, for a noise of the model, through H."""
    value = in_outputs(dae.C, gains.part(0, b))
    names = [noise.name for noise in dae.noises]
    if name in names:
        value = value + dae.H[:, names.index(name)]
    return tuple(output.name for output, v in zip(dae.outputs, value, strict=True) if v != 0.0)


def _verdict_decision(
    gains: NoiseGains, places: Sequence[NoisePlace], tolerance: float | None
) -> RankDecision:
    """The decision between forbidden and admissible equations, in the numbers it was made on."""
    if tolerance is not None:
        norms = np.array([place.projection_norm for place in places])
        return decide_rank("projection norms of the equations", norms, 1, 1.0, tolerance)
    strengths = np.array([gains.strength(b) for b in np.eye(len(places))])
    return decide_rank("differentiated noise, equation by equation (scaled)", strengths, 1, 1.0, NO_NOISE)


def _with_advice(dae: LinearDAE, place: NoisePlace, allowed: Sequence[bool]) -> NoisePlace:
    return replace(place, advice=_advice(dae, place, allowed))


def _advice(dae: LinearDAE, place: NoisePlace, allowed: Sequence[bool]) -> str:
    """What to do instead, or what to mind; empty where nothing is to be said."""
    if place.admissible:
        if not place.white_outputs:
            return ""
        return f"The noise itself, through no state, is part of the output {', '.join(place.white_outputs)}."
    filters = (
        "a first-order low-pass filter" if place.order < 2 else f"a low-pass filter of order {place.order}"
    )
    coloured = f"pass the noise through {filters} first (coloured noise)"
    near = _nearest_admissible(dae, place.equations, allowed)
    if not near:
        return f"No equation nearby may carry white noise: {coloured}."
    texts = " or ".join(f"`{dae.equations[i].text}`" for i in near)
    return f"Put the noise on {texts}, where it is integrated before it gets here, or {coloured}."


def _nearest_admissible(dae: LinearDAE, start: Sequence[int], allowed: Sequence[bool]) -> list[int]:
    """The nearest admissible equations with a derivative, by steps over shared unknowns; the nearest ring
    only."""
    pattern = sp.csr_array((np.abs(sp.csr_array(dae.E)) + np.abs(sp.csr_array(dae.J))) != 0)
    by_unknown = sp.csr_array(pattern.T)
    has_derivative = np.diff(sp.csr_array(sp.csr_array(dae.E) != 0).indptr) > 0
    seen, ring = set(start), list(start)
    while ring:
        unknowns = np.unique(np.concatenate([_row(pattern, i) for i in ring]))
        ring = sorted({int(i) for j in unknowns for i in _row(by_unknown, j)} - seen)
        seen.update(ring)
        found = [i for i in ring if allowed[i] and has_derivative[i]]
        if found:
            return found[:NAMED_PLACES]
    return []


def _row(pattern: sp.csr_array, i: int) -> np.ndarray:
    return pattern.indices[pattern.indptr[i] : pattern.indptr[i + 1]]


def _asked(
    dae: LinearDAE, at: Sequence[int | str], places: Sequence[NoisePlace], noises: dict[str, NoisePlace]
) -> list[NoisePlace]:
    asked: list[NoisePlace] = []
    for item in at:
        if str(item) in noises:
            asked.append(noises[str(item)])
        else:
            asked += [places[i] for i in place_equations(dae, item)]
    return asked


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
