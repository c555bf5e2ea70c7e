"""The document of `daest noise`."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from daest.model.linear import LinearDAE, Matrix
from daest.model.noise import NoisePlace, NoiseReport
from daest.report.documents.parts import decision_entry, equation_entry

SCHEMA = "daest/noise/1"


def document(report: NoiseReport) -> dict[str, Any]:
    """JSON-ready verdicts of Theorem 3.1: per equation, per noise of the model (`annotated`), per place that
    was asked for (`asked`). `equations` of a noise are indices into `equations`, from 0."""
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
        "white_outputs": list(place.white_outputs),
        "advice": place.advice,
    }
