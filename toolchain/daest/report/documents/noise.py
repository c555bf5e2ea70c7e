"""The document of `daest noise`."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from daest.model.linear import LinearDAE, Matrix
from daest.model.noise import NoiseAlong, NoisePlace, NoisePlaceAlong, NoiseReport
from daest.report.documents.parts import decision_entry, equation_entry

SCHEMA = "daest/noise/1"


def document(report: NoiseReport, along: NoiseAlong | None = None) -> dict[str, Any]:
    """JSON-ready verdicts of Theorem 3.1: per equation, per noise of the model (`annotated`), per place that
    was asked for (`asked`). `equations` of a noise are indices into `equations`, from 0. `along` holds the
    verdicts at the points of a trajectory, where they were asked for."""
    judged = {} if along is None else {"along": along_document(along)}
    return {
        **_document(report),
        **judged,
    }


def along_document(along: NoiseAlong) -> dict[str, Any]:
    """The verdicts along a trajectory: all noises and places that were asked for, and of the equations those
    that are not admissible everywhere."""
    return {
        "times": list(along.times),
        "unjudged": [{"time": time, "reason": reason} for time, reason in along.unjudged],
        "structures": [{"n_dynamic": n, "index": index} for n, index in along.structures],
        "same_everywhere": along.same_everywhere,
        "equations": [
            {"index": i, **_along(place)} for i, place in enumerate(along.places) if not place.admissible
        ],
        "annotated": [{"equations": list(p.equations), **_along(p)} for p in along.annotated],
        "asked": [{"equations": list(p.equations), **_along(p)} for p in along.asked],
        "all_admissible": along.all_admissible,
    }


def _along(place: NoisePlaceAlong) -> dict[str, Any]:
    return {
        "name": place.name,
        "admissible": place.admissible,
        "admissible_at_start": place.at_start,
        "forbidden_share": place.forbidden_share,
        "first_time": place.first_time,
        "largest_norm": place.largest_norm,
        "differentiated": list(place.verdict.differentiated),
        "n_differentiated": place.verdict.n_differentiated,
        "advice": place.verdict.advice,
    }


def _document(report: NoiseReport) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "n_equations": len(report.equations),
        "n_dynamic": report.n_dynamic,
        "index": report.index,
        "N_singular_values": list(report.N_singular_values),
        "equations": [
            {**equation_entry(i, equation), **_verdict(place)}
            for i, (equation, place) in enumerate(zip(report.equations, report.places, strict=True))
        ],
        "n_forbidden": report.n_forbidden,
        "annotated": [_noise(place) for place in report.annotated],
        "asked": [_noise(place) for place in report.asked],
        "all_admissible": report.all_admissible,
        "tolerance": report.tolerance,
        "decisions": [decision_entry(decision) for decision in report.decisions],
    }


def structure(dae: LinearDAE) -> dict[str, Any]:
    """Unknowns with their units, and the places [row, column] of E and J that are not zero."""
    return {
        "unknowns": [{"name": v.name, "unit": v.unit} for v in dae.unknowns],
        "E": _pattern(dae.E),
        "J": _pattern(dae.J),
    }


def _pattern(matrix: Matrix) -> list[list[int]]:
    return np.column_stack(sp.csr_array(matrix).nonzero()).tolist()


def _noise(place: NoisePlace) -> dict[str, Any]:
    return {"name": place.name, "equations": list(place.equations), **_verdict(place)}


def _verdict(place: NoisePlace) -> dict[str, Any]:
    return {
        "admissible": place.admissible,
        "projection_norm": place.projection_norm,
        "order": place.order,
        "differentiated": list(place.differentiated),
        "n_differentiated": place.n_differentiated,
        "white_outputs": list(place.white_outputs),
        "advice": place.advice,
    }
