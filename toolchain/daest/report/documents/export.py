"""The document of `daest export`."""

from __future__ import annotations

from typing import Annotated, NotRequired, TypedDict

from daest.model.fmu import EstimatorExport, ExportResult


class ExportDocument(TypedDict):
    """An exported FMU, or estimator."""

    path: str
    model: str
    fmi_version: str | None
    platforms: list[str]
    n_states: NotRequired[int]
    n_equations: NotRequired[int]
    index: NotRequired[int]
    n_differentiations: NotRequired[int]
    states: NotRequired[list[str]]
    inputs: list[str]
    input_derivatives: NotRequired[list[str]]
    noises: NotRequired[list[str]]
    outputs: list[str]
    parameters: NotRequired[list[str]]
    validation: Annotated[list[str], "messages of the validator; none is good"]
    seconds: float
    estimates: NotRequired[Annotated[list[str], "variables that an exported estimator tells"]]


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


def estimator_document(result: EstimatorExport) -> ExportDocument:
    """JSON-ready summary of an exported estimator."""
    return {
        "path": str(result.path),
        "model": result.model_name,
        "fmi_version": result.fmi_version,
        "platforms": list(result.platforms),
        "inputs": list(result.inputs),
        "outputs": list(result.outputs),
        "estimates": list(result.values),
        "validation": list(result.validation),
        "seconds": result.seconds,
    }
