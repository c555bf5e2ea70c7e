"""The document of `daest export`."""

from __future__ import annotations

from typing import Annotated, NotRequired, TypedDict

from daest.model.fmu import EstimatorExport, ExportResult
from daest.report.documents.parts import Of, entry


class ExportDocument(TypedDict):
    """An exported FMU, or estimator."""

    path: str
    model: Annotated[str, Of("model_name")]
    fmi_version: str | None
    platforms: list[str]
    n_states: NotRequired[int]
    n_equations: NotRequired[int]
    index: NotRequired[Annotated[int, Of("structural_index")]]
    n_differentiations: NotRequired[int]
    states: NotRequired[list[str]]
    inputs: list[str]
    input_derivatives: NotRequired[list[str]]
    noises: NotRequired[list[str]]
    outputs: list[str]
    parameters: NotRequired[list[str]]
    validation: Annotated[list[str], "messages of the validator; none is good"]
    seconds: float
    estimates: NotRequired[Annotated[list[str], Of("values"), "variables that an exported estimator tells"]]


def document(result: ExportResult | EstimatorExport) -> ExportDocument:
    """JSON-ready summary of a written FMU or estimator. `index` is the structural index of the DAE that
    travels inside; `validation` lists the validator's messages, none for a conforming file."""
    return entry(ExportDocument, result, path=str(result.path))
