"""Where white noise may enter a linear DAE: Theorem 3.1 of Gerdin & Schön, equation by equation.

b is admissible when N P2 b = 0 (23), which is b in the range of M = P⁻¹ diag(I, V2) (26). The orthogonal
complement of that range is the row space of V1' P2, so that I - M M⁺ of (40) is the projection onto these few
rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from daest.errors import ConfigError
from daest.model.linear import LinearDAE, RankDecision, SparseForm, StandardForm
from daest.model.noise import NoisePlace, NoiseReport
from daest.near import near_names
from daest.numerics.pencils import unit_scaling
from daest.numerics.ranks import decide_rank, default_tolerance
from daest.numerics.threads import one_thread
from daest.systems.linear.exact_structure import generic_structure
from daest.systems.linear.generic_verdict import compared
from daest.systems.linear.nilpotent import nilpotent_part
from daest.systems.linear.noise_gains import NO_NOISE, NoiseGains, in_outputs, noise_gains
from daest.systems.linear.standard_form import standard_form

NAMED_PLACES = 2
"""Admissible equations that an advice proposes."""

NAMED_UNKNOWNS = 100
"""Unknowns with differentiated noise that the verdict on an equation names: in a large model noise on each of
n equations may reach n unknowns."""

ADMISSIBLE = -2
"""In place of a group of equations: equations that reach nothing differentiated."""


@one_thread()  # many small solutions: a second thread only waits
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

    By default an equation is forbidden when noise on it reaches some unknown differentiated: exactly, or,
    where the numbers are results of rounding, on scaled equations and unknowns (`NO_NOISE`), so that units
    make no difference. With `tolerance` it is forbidden when the projection norm of the model as it stands
    exceeds it. Beside that stands what holds for almost every θ.

        >>> report = daest.noise_report(dae, form)
        >>> [place.name for place in report.annotated if place.admissible]
        ['disturbance.w']
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
    report = NoiseReport(
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
    generic = generic_structure(dae) or form.exact
    found, differences = compared(dae, report, generic, form.exact)
    undecided = form.doubts if tolerance is None else ()
    return replace(report, generic=found, differences=differences, undecided=undecided)


def verdict(
    dae: LinearDAE, gains: NoiseGains, b: np.ndarray, name: str, tolerance: float | None = None
) -> NoisePlace:
    """Verdict on the noise column b (n,), without advice."""
    size = float(np.linalg.norm(b))
    norm = gains.forbidden.norm(b) / size if size > 0 else 0.0
    admissible = not gains.differentiated(b) if tolerance is None else norm <= tolerance
    own = [k for k, noise in enumerate(dae.noises) if noise.name == name]
    white: tuple[str, ...] = ()
    if admissible:
        value = in_outputs(dae.C, gains.part(0, b)) + (dae.H[:, own[0]] if own else 0.0)
        white = tuple(dae.outputs[k].name for k in np.flatnonzero(value))
    reach = NOTHING if admissible else _reach(len(gains.maps), lambda i: np.flatnonzero(gains.part(i, b)))
    equations = tuple(np.flatnonzero(b).tolist())
    return _place(dae, name, equations, admissible, norm, reach, _names(dae, reach, None), white)


@dataclass(frozen=True)
class _Reach:
    """Which unknowns noise enters differentiated, and how often at most."""

    unknowns: np.ndarray
    order: int


NOTHING = _Reach(np.empty(0, dtype=int), 0)


def _reach(n_maps: int, enters: Callable[[int], np.ndarray]) -> _Reach:
    """`enters(i)` gives the unknowns (k,) that contain derivative i."""
    found = [enters(i) for i in range(1, n_maps)]
    order = max((i for i, reached in enumerate(found, 1) if reached.size), default=0)
    return _Reach(np.unique(np.concatenate(found)), order) if order else NOTHING


def _names(dae: LinearDAE, reach: _Reach, at_most: int | None) -> tuple[str, ...]:
    return tuple(dae.unknowns[j].name for j in reach.unknowns[:at_most].tolist())


def _place(
    dae: LinearDAE,
    name: str,
    equations: tuple[int, ...],
    admissible: bool,
    norm: float,
    reach: _Reach,
    named: tuple[str, ...],
    white_outputs: tuple[str, ...],
) -> NoisePlace:
    return NoisePlace(
        name=name,
        equations=equations,
        admissible=admissible,
        projection_norm=norm,
        order=reach.order,
        differentiated=named,
        n_differentiated=reach.unknowns.size,
        white_outputs=white_outputs,
        advice="",
    )


def _unit_verdicts(dae: LinearDAE, gains: NoiseGains, tolerance: float | None) -> list[NoisePlace]:
    """`verdict` on noise on every single equation."""
    norms = gains.forbidden.unit_norms()
    admissible = ~gains.unit_differentiated() if tolerance is None else norms <= tolerance
    white = _white_outputs(dae, gains, admissible)
    reaches = _unit_reaches(gains, np.flatnonzero(~admissible))
    names = {key: _names(dae, reach, NAMED_UNKNOWNS) for key, reach in reaches.items()}
    keys = np.where(admissible, ADMISSIBLE, _groups(gains)).tolist()
    return [
        _place(
            dae,
            dae.equations[k].text,
            (k,),
            bool(admissible[k]),
            float(norms[k]),
            reaches[key],
            names[key],
            white.get(k, ()),
        )
        for k, key in enumerate(keys)
    ]


def _groups(gains: NoiseGains) -> np.ndarray:
    """Equations of one group send multiples of the same into the unknowns."""
    return gains.maps[1].column_group if len(gains.maps) > 1 else np.full(gains.rows.size, -1)


def _unit_reaches(gains: NoiseGains, equations: np.ndarray) -> dict[int, _Reach]:
    """What noise on single equations reaches, by group: for all of it, what the strongest of them reaches."""
    found, groups = {ADMISSIBLE: NOTHING}, _groups(gains)
    for k in equations[np.argsort(-gains.unit_strengths()[equations], kind="stable")].tolist():
        if int(groups[k]) not in found:
            found[int(groups[k])] = _unit_reach(gains, k)
    return found


def _unit_reach(gains: NoiseGains, equation: int) -> _Reach:
    return _reach(len(gains.maps), lambda i: gains.reached(i, equation))


def _white_outputs(dae: LinearDAE, gains: NoiseGains, admissible: np.ndarray) -> dict[int, tuple[str, ...]]:
    """The outputs that contain the noise itself, by admissible equation, where there is one."""
    C, direct = sp.csr_array(dae.C), gains.unit_direct()
    found = sp.coo_array(C @ direct)
    output, equation = found.coords
    sizes = sp.csr_array(abs(C) @ abs(direct))[output, equation]
    kept = admissible[equation] & (np.abs(found.data) > default_tolerance(dae.n) * sizes)
    white: dict[int, tuple[str, ...]] = {}
    for i, k in sorted(zip(output[kept].tolist(), equation[kept].tolist(), strict=True)):
        white[k] = (*white.get(k, ()), dae.outputs[i].name)
    return white


def _verdict_decision(
    gains: NoiseGains, places: Sequence[NoisePlace], tolerance: float | None
) -> RankDecision:
    """The decision between forbidden and admissible equations, in the numbers it was made on."""
    if tolerance is not None:
        norms = np.array([place.projection_norm for place in places])
        return decide_rank("projection norms of the equations", norms, 1, 1.0, tolerance)
    known = None if gains.exact is None else int(np.count_nonzero(gains.unit_differentiated()))
    what = "differentiated noise, equation by equation (scaled)"
    return decide_rank(what, gains.unit_strengths(), 1, 1.0, NO_NOISE, known)


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
    if place.admissible:
        return place
    return replace(place, differentiated=_names(dae, _unit_reach(gains, place.equations[0]), None))


def place_equations(dae: LinearDAE, item: int | str) -> list[int]:
    """Equations that a place of `noise_report` means. Raises ConfigError `noise-place-unknown`."""
    text = str(item)
    if text.isdigit() and int(text) < dae.n:
        return [int(text)]
    own = [i for i, e in enumerate(dae.equations) if e.origin == text and e.kind == "component"]
    same = [i for i, e in enumerate(dae.equations) if e.text == text]
    if own or same:
        return own or same
    names = dae.unknown_names
    if text in names:
        return _equations_of_unknown(dae, names.index(text))
    known = [*names, *dae.noise_names, *(e.origin for e in dae.equations)]
    close = near_names(text, list(dict.fromkeys(known)), n=3)
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
