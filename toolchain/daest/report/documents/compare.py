"""The document of a comparison."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

import numpy as np

from daest.model.comparison import Comparison, Verdict
from daest.report.documents.parts import ByOutput, Of, entry

_Passed = TypedDict("_Passed", {"pass": Annotated[bool | None, Of("passed")]})


class TestEntry(_Passed):
    statistic: float | None
    limit: float | None
    p_value: float | None
    band: NotRequired[list[float]]


class Tests(TypedDict):
    """Tests by output; none where nothing can be tested."""

    whiteness: NotRequired[dict[str, TestEntry]]
    input_independence: NotRequired[dict[str, TestEntry]]
    variable_independence: NotRequired[dict[str, TestEntry]]
    nis: NotRequired[dict[str, TestEntry]]


class Where(TypedDict):
    output: str
    kind: Literal["time", "frequency", "region"]
    variable: str | None
    unit: NotRequired[str]
    low: float | None
    high: float | None
    share_of_error: Annotated[float, Of("share")]
    expected_share: NotRequired[Annotated[float, Of("expected")]]
    error: NotRequired[Literal["one-step", "simulation"]]
    data: NotRequired[Annotated[str | None, Of("experiment")]]
    p_value: NotRequired[float]
    text: str


class HorizonEntry(TypedDict):
    steps: int
    seconds: float
    rms: ByOutput


class OneStep(TypedDict):
    fit_percent: ByOutput
    rms: ByOutput


class ModelEntry(TypedDict):
    name: str
    n_parameters: int
    fit_percent: Annotated[ByOutput, Of("simulation.fit_percent")]
    rms: Annotated[ByOutput, Of("simulation.rms")]
    one_step: NotRequired[OneStep]
    growth: NotRequired[list[HorizonEntry]]
    log_likelihood: NotRequired[float | None]
    bic: float | None
    tests: Tests
    feedback: NotRequired[dict[str, TestEntry]]
    verdict: Verdict | None
    where: list[Where]
    notes: NotRequired[list[str]]


class Row(TypedDict):
    model: Annotated[str, Of("name")]
    rms: Annotated[ByOutput, Of("simulation.rms")]
    fit_percent: Annotated[ByOutput, Of("simulation.fit_percent")]
    one_step_rms: NotRequired[Annotated[ByOutput, Of("one_step.rms")]]
    bic: NotRequired[float | None]
    verdict: Verdict | None


class CompareDocument(TypedDict):
    """Models side by side on unseen data."""

    data: list[str]
    outputs: dict[str, str]
    models: list[ModelEntry]
    table: Annotated[list[Row], Of("models")]


def document(comparison: Comparison) -> CompareDocument:
    """JSON content of `daest compare`: one entry per model, and `table`, the simulation error of each."""
    return entry(
        CompareDocument,
        comparison,
        data=[experiment.name for experiment in comparison.experiments],
        outputs=dict(zip(comparison.output_names, comparison.output_units, strict=True)),
    )


def series(comparison: Comparison) -> dict[str, np.ndarray]:
    """Arrays by `R.time` and `R.measured` of recording R, and `R.M.simulated`, `R.M.predicted` and, where the
    model was tested, `R.M.residuals` of model M on it; columns are the outputs. Shapes: time (n_samples,)
    [s]; the others (n_samples, n_y)."""
    arrays: dict[str, np.ndarray] = {}
    for r, experiment in enumerate(comparison.experiments):
        arrays[f"{r}.time"], arrays[f"{r}.measured"] = experiment.time, experiment.outputs
        for m, trial in enumerate(comparison.models):
            arrays[f"{r}.{m}.simulated"] = trial.simulated[r]
            arrays[f"{r}.{m}.predicted"] = trial.predicted[r]
            if trial.residuals:
                arrays[f"{r}.{m}.residuals"] = trial.residuals[r]
    return arrays
