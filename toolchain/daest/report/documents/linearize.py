"""The document of `daest linearize`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import scipy.sparse as sp

from daest.model.linear import LinearDAE, Matrix, SparseForm, StandardForm
from daest.report.documents.parts import decision_entry, equation_entry
from daest.systems.linearize import ThetaEntry
from daest.systems.transfer import HIGHEST_ORDER, TransferFunction, poles

SCHEMA = "daest/linearize/1"

MATRICES = ("E", "J", "K", "B", "C", "D", "H")


def document(
    dae: LinearDAE,
    form: StandardForm | SparseForm,
    functions: Sequence[TransferFunction] = (),
    theta: Sequence[ThetaEntry] = (),
    cross_check: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """JSON-ready linear DAE E ξ' = J ξ + K u + B w + offset, y = C ξ + D u + H w + output_offset.

    Rows are `equations`, columns of E and J `unknowns`. Polynomials have the highest power first.
    `cross_check` maps pairs of sources, and `largest`, to relative differences; it becomes a number and the
    mapping `cross_checks`.
    """
    differences = dict(cross_check or {})
    return {
        "schema": SCHEMA,
        "equations": [equation_entry(i, equation) for i, equation in enumerate(dae.equations)],
        "unknowns": [v.name for v in dae.unknowns],
        "inputs": [v.name for v in dae.inputs],
        "outputs": [v.name for v in dae.outputs],
        "noises": [v.name for v in dae.noises],
        "units": _units(dae),
        "parameters": [
            {
                "name": p.name,
                "value": p.value,
                "unit": p.unit,
                "min": p.min,
                "max": p.max,
                "estimate": p.estimate,
            }
            for p in dae.parameters
        ],
        "matrix_format": "triplets" if sp.issparse(dae.E) else "rows",
        **{name: _matrix(getattr(dae, name), sp.issparse(dae.E)) for name in MATRICES},
        "offset": dae.offset.tolist(),
        "output_offset": dae.output_offset.tolist(),
        "n_equations": dae.n,
        "n_dynamic": form.n_dynamic,
        "index": form.index,
        "poles": [[float(p.real), float(p.imag)] for p in poles(form)],
        "transfer_functions": [
            {"input": g.input, "output": g.output, "num": list(g.num), "den": list(g.den)} for g in functions
        ],
        "theta": [{**asdict(entry), "parameters": list(entry.parameters)} for entry in theta],
        "source": dae.source,
        "is_affine": dae.is_affine,
        "cross_check": differences.get("largest"),
        "cross_checks": {pair: value for pair, value in differences.items() if pair != "largest"},
        "decisions": [decision_entry(decision) for decision in form.decisions],
        "notes": _notes(dae, form),
    }


def _units(dae: LinearDAE) -> dict[str, str]:
    return {
        **{v.name: v.unit for v in (*dae.unknowns, *dae.inputs)},
        **{y.name: y.unit for y in dae.outputs},
        **{w.name: w.unit for w in dae.noises},
    }


def _matrix(matrix: Matrix, is_large: bool) -> list[list[float]] | dict[str, Any]:
    """Rows of numbers; of large models the entries that are not zero, as shape, row, column and value."""
    if not is_large:
        return np.asarray(matrix, dtype=float).tolist()
    entries = sp.coo_array(matrix)
    kept = entries.data != 0.0
    row, column = (index[kept].tolist() for index in entries.coords)
    return {"shape": list(matrix.shape), "row": row, "column": column, "value": entries.data[kept].tolist()}


def _notes(dae: LinearDAE, form: StandardForm | SparseForm) -> list[str]:
    if form.n_dynamic <= HIGHEST_ORDER:
        return list(dae.notes)
    reason = f"No transfer functions: polynomials of {form.n_dynamic} modes say nothing in double precision."
    return [*dae.notes, reason]
