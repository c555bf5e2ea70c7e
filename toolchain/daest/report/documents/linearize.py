"""The document of `daest linearize`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import scipy.sparse as sp

from daest.model.linear import LinearDAE, Matrix, StandardForm
from daest.report.documents.parts import decision_entry, equation_entry
from daest.systems.linearize import ThetaEntry
from daest.systems.transfer import TransferFunction, poles

SCHEMA = "daest/linearize/1"


def document(
    dae: LinearDAE,
    form: StandardForm,
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
        **{name: _rows(getattr(dae, name)) for name in ("E", "J", "K", "B", "C", "D", "H")},
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
        "notes": list(dae.notes),
    }


def _units(dae: LinearDAE) -> dict[str, str]:
    return {
        **{v.name: v.unit for v in (*dae.unknowns, *dae.inputs)},
        **{y.name: y.unit for y in dae.outputs},
        **{w.name: w.unit for w in dae.noises},
    }


def _rows(matrix: Matrix) -> list[list[float]]:
    dense = sp.csr_array(matrix).toarray() if sp.issparse(matrix) else np.asarray(matrix)
    return [[float(value) for value in row] for row in dense]
