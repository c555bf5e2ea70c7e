"""The document of `daest export`."""

from __future__ import annotations

from typing import Any

from daest.model.fmu import ExportResult

SCHEMA = "daest/export/1"


def document(result: ExportResult) -> dict[str, Any]:
    """JSON-ready summary of a written FMU. `index` is the structural index of the DAE that travels inside;
    `validation` lists the validator's messages, none for a conforming file."""
    return {
        "schema": SCHEMA,
        "path": str(result.path),
        "model": result.model_name,
        "fmi_version": "3.0",
        "platforms": list(result.platforms),
        "n_states": len(result.states),
        "n_equations": result.n_equations,
        "index": result.structural_index,
        "n_differentiations": result.n_differentiations,
        "states": list(result.states),
        "inputs": list(result.inputs),
        "input_derivatives": list(result.input_derivatives),
        "noises": list(result.noises),
        "outputs": list(result.outputs),
        "parameters": list(result.parameters),
        "validation": list(result.validation),
        "seconds": result.seconds,
    }
