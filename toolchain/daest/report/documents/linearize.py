"""The document of `daest linearize`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, NotRequired, TypedDict

import numpy as np
import scipy.sparse as sp

from daest.model.linear import LinearDAE, Matrix, SparseForm, StandardForm
from daest.report.documents.parts import (
    Decision,
    EquationEntry,
    Of,
    decision_entry,
    entry,
    equation_entry,
)
from daest.systems.linear.linearize import ThetaEntry
from daest.systems.linear.transfer import HIGHEST_ORDER, TransferFunction, poles

Rows = list[list[float | None]]


class Triplets(TypedDict):
    shape: list[int]
    row: list[int]
    column: list[int]
    value: list[float]


MatrixEntry = Annotated[Rows | Triplets, "Rows of numbers, or of large models the entries that are not zero."]


class ParameterValue(TypedDict):
    name: str
    value: float
    unit: str
    min: float | None
    max: float | None
    estimate: bool


class Quotient(TypedDict):
    input: str
    output: str
    num: Annotated[list[float], "highest power first"]
    den: list[float]


class Dependence(TypedDict):
    matrix: str
    row: int
    column: int
    expression: str
    parameters: list[str]


class LinearizeDocument(TypedDict):
    """The linear DAE E ξ' = J ξ + K u + B w, y = C ξ + D u."""

    equations: list[EquationEntry]
    unknowns: list[str]
    inputs: list[str]
    outputs: list[str]
    noises: list[str]
    units: dict[str, str]
    parameters: list[ParameterValue]
    matrix_format: NotRequired[Literal["rows", "triplets"]]
    E: MatrixEntry
    J: MatrixEntry
    K: MatrixEntry
    B: MatrixEntry
    C: MatrixEntry
    D: MatrixEntry
    H: NotRequired[MatrixEntry]
    offset: NotRequired[list[float | None]]
    output_offset: NotRequired[list[float | None]]
    n_equations: Annotated[int, Of("n")]
    n_dynamic: int
    index: int
    poles: list[list[float]]
    transfer_functions: list[Quotient]
    theta: list[Dependence]
    source: Literal["symbolic", "fmi-ls-dae", "directional derivatives", "finite differences"]
    is_affine: NotRequired[bool]
    cross_check: float | None
    cross_checks: NotRequired[dict[str, float]]
    decisions: list[Decision]
    notes: NotRequired[list[str]]


def document(
    dae: LinearDAE,
    form: StandardForm | SparseForm,
    functions: Sequence[TransferFunction] = (),
    theta: Sequence[ThetaEntry] = (),
    cross_check: Mapping[str, float] | None = None,
) -> LinearizeDocument:
    """JSON-ready linear DAE E ξ' = J ξ + K u + B w + offset, y = C ξ + D u + H w + output_offset.

    Rows are `equations`, columns of E and J `unknowns`. Polynomials have the highest power first.
    `cross_check` maps pairs of sources, and `largest`, to relative differences; it becomes a number and the
    mapping `cross_checks`.
    """
    differences = dict(cross_check or {})
    is_large = sp.issparse(dae.E)
    matrices = {name: _matrix(getattr(dae, name), is_large) for name in "EJKBCDH"}
    return entry(
        LinearizeDocument,
        dae,
        equations=[equation_entry(i, equation) for i, equation in enumerate(dae.equations)],
        **{
            part: [v.name for v in getattr(dae, part)] for part in ("unknowns", "inputs", "outputs", "noises")
        },
        units={
            one.name: one.unit for part in (dae.unknowns, dae.inputs, dae.outputs, dae.noises) for one in part
        },
        parameters=[p for p in dae.parameters if not p.is_memory],
        matrix_format="triplets" if is_large else "rows",
        **matrices,
        n_dynamic=form.n_dynamic,
        index=form.index,
        poles=[[p.real, p.imag] for p in poles(form)],
        transfer_functions=functions,
        theta=theta,
        cross_check=differences.pop("largest", None),
        cross_checks=differences,
        decisions=[decision_entry(decision) for decision in form.decisions],
        notes=_notes(dae, form),
    )


def _matrix(matrix: Matrix, is_large: bool) -> np.ndarray | Triplets:
    """Rows of numbers; of large models the entries that are not zero, as shape, row, column and value."""
    if not is_large:
        return np.asarray(matrix, dtype=float)
    entries = sp.coo_array(matrix)
    kept = entries.data != 0.0
    row, column = (index[kept].tolist() for index in entries.coords)
    return {"shape": list(matrix.shape), "row": row, "column": column, "value": entries.data[kept].tolist()}


def _notes(dae: LinearDAE, form: StandardForm | SparseForm) -> list[str]:
    if form.n_dynamic <= HIGHEST_ORDER:
        return list(dae.notes)
    reason = f"No transfer functions: polynomials of {form.n_dynamic} modes say nothing in double precision."
    return [*dae.notes, reason]
