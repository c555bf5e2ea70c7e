"""The document of `daest export`."""

from __future__ import annotations

from typing import Annotated, NotRequired, TypedDict

from daest.model.fmu import ExportResult


class ExportDocument(TypedDict):
    """An exported FMU."""

    path: str
    model: str
    fmi_version: str
    platforms: list[str]
    n_states: int
    n_equations: int
    index: int
    n_differentiations: NotRequired[int]
    states: list[str]
    inputs: list[str]
    input_derivatives: NotRequired[list[str]]
    noises: list[str]
    outputs: list[str]
    parameters: list[str]
    validation: Annotated[list[str], "messages of the validator; none is good"]
    seconds: float


def document(result: ExportResult) -> ExportDocument:
    """JSON-ready summary of a written FMU. `index` is the structural index of the DAE that travels inside;
    `validation` lists the validator's messages, none for a conforming file."""
    return {
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
