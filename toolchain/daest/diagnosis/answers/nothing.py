"""The verdict where nothing is left to explain, and what would have shown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daest.diagnosis.answers.decided import Decided, Evidence, reasons_told
from daest.diagnosis.gates import GATES
from daest.model.diagnosis import (
    Candidate,
    Proof,
    Screened,
)
from daest.quantities import with_unit


def nothing_missing(evidence: Evidence) -> Decided:
    moved = _moved(evidence)
    if moved:
        return Decided(
            "parameters off",
            f"No effect is missing, but the data contradict the given values: {', '.join(moved)}. "
            "Refit the model." + _still_significant(evidence),
        )
    small = _likelier(evidence)
    if small:
        return _too_small(evidence, small)
    seen = [e for e in evidence.screen.entries if not e.absorbed and np.isfinite(e.detectable)]
    if _is_blind(seen):
        return Decided(
            "cannot tell",
            f"None of {evidence.screen.n_screened} candidates was supported, but beside unknown loads these "
            "recordings would show none: not even what cuts a signal would be seen, though it cut all that "
            f"lies beyond its limit. It would take, for instance: {_smallest(seen)}.",
            "Record with larger inputs and less noise, or measure another quantity.",
        )
    shown = _smallest([entry for entry in seen if not _is_beyond(entry)])
    return Decided(
        "nothing missing",
        f"Nothing is missing at this noise level: none of {evidence.screen.n_screened} candidates was "
        f"supported (p = {evidence.screen.p_value:.2g} for the whole search)."
        + _still_significant(evidence)
        + (f" It would have shown, for instance: {shown}." if shown else ""),
    )


def _smallest(seen: Sequence[Screened]) -> str:
    """The sizes from which the first few laws that are `seen` would show, each law once."""
    smallest: dict[str, str] = {}
    for entry in seen:
        size = entry.candidate.effect.sizes[0]
        law, label = entry.candidate.effect.name, entry.candidate.label + _of_form(entry.candidate)
        seen_from = with_unit(f"{entry.detectable:.2g}", entry.candidate.size_unit)
        smallest.setdefault(law, f"{label} from {size.name} = {seen_from}")
    return "; ".join(list(smallest.values())[:4])


def _is_beyond(entry: Screened) -> bool:
    """Whether an effect would be seen only beyond its largest size, as a share of more than all."""
    most = entry.candidate.effect.sizes[0].max
    return most is not None and 0.0 < most < entry.detectable


def _of_form(candidate: Candidate) -> str:
    """The form of a law whose size is a share, which tells nothing without it: where a signal is cut."""
    if not candidate.effect.sizes[0].is_share:
        return ""
    forms = [
        f"{p.name} = {with_unit(f'{candidate.shape[p.name]:.3g}', candidate.units.get(p.name) or p.unit)}"
        for p in candidate.effect.parameters
        if p.role == "shape" and p.estimate and p.name in candidate.shape
    ]
    return f" ({', '.join(forms)})" if forms else ""


def _likelier(evidence: Evidence) -> list[Proof]:
    """The rejected candidates that make the data likelier, where the whole search is sure that something is
    missing; none where it is not."""
    if evidence.screen.p_value >= GATES.missing_level:
        return []
    return [p for p in evidence.proofs if p.delta_bic > GATES.min_told_bic_gain]


def _too_small(evidence: Evidence, near: Sequence[Proof]) -> Decided:
    """The verdict where a simulation is as good as predictions, and the search has seen something: what is
    missing is too small to be named, and it is not nothing."""
    return Decided(
        "cannot tell",
        f"Something small is missing (p = {evidence.screen.p_value:.1g} for the whole search): a simulation "
        "without it is nearly as good as predictions from sample to sample, and these data do not prove what "
        f"it is. {reasons_told(near)}.",
        "Record longer and with larger amplitudes: the effect is small beside the noise of this record.",
    )


def _still_significant(evidence: Evidence) -> str:
    """A sentence where the search is sure of something that no refit confirms; empty where it is not."""
    if evidence.screen.p_value >= GATES.missing_level:
        return ""
    return (
        f" The search has seen something (p = {evidence.screen.p_value:.1g}), but it hardly matters: a "
        "simulation is nearly as good as predictions from sample to sample."
    )


def _is_blind(seen: Sequence[Screened]) -> bool:
    """Whether those of the effects that have a largest size would only be seen beyond it."""
    most = [(entry.detectable, entry.candidate.effect.sizes[0].max) for entry in seen]
    ratios = [size / limit for size, limit in most if limit]
    return bool(ratios) and min(ratios) > 1.0


def _moved(evidence: Evidence) -> list[str]:
    """Parameters of an earlier fit that these data contradict."""
    result = []
    for p in (evidence.told or evidence.baseline).parameters:
        given = evidence.fitted.get(p.name)
        if given is None or not p.std_error:
            continue
        if abs(p.value - given) > GATES.changed_significance * p.std_error:
            result.append(
                f"{p.name} = {given:.4g} given, {p.value:.4g} ± {p.std_error:.2g} {p.unit} found".rstrip()
            )
    return result
