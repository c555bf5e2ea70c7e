"""The document of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NotRequired, TypedDict, cast

import numpy as np

from daest.model.comparison import Comparison, Finding, ModelTrial, ResidualTest, Verdict
from daest.report.documents.parts import ByOutput, entry

_Passed = TypedDict("_Passed", {"pass": bool | None})


class TestEntry(_Passed):
    statistic: float | None
    limit: float | None
    p_value: float | None
    band: NotRequired[list[float]]


class Tests(TypedDict):
    whiteness: dict[str, TestEntry]
    input_independence: dict[str, TestEntry]
    variable_independence: NotRequired[dict[str, TestEntry]]
    nis: dict[str, TestEntry]


class Where(TypedDict):
    output: str
    kind: Literal["time", "frequency", "region"]
    variable: str | None
    unit: NotRequired[str]
    low: float | None
    high: float | None
    share_of_error: float
    expected_share: NotRequired[float]
    error: NotRequired[Literal["one-step", "simulation"]]
    data: NotRequired[str | None]
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
    fit_percent: ByOutput
    rms: ByOutput
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
    model: str
    rms: ByOutput
    fit_percent: ByOutput
    one_step_rms: NotRequired[ByOutput]
    bic: NotRequired[float | None]
    verdict: Verdict | None


class CompareDocument(TypedDict):
    """Models side by side on unseen data."""

    data: list[str]
    outputs: dict[str, str]
    models: list[ModelEntry]
    table: list[Row]


def document(comparison: Comparison) -> CompareDocument:
    """JSON content of `daest compare`: one entry per model, and `table`, the simulation error of each."""
    return {
        "data": [experiment.name for experiment in comparison.experiments],
        "outputs": dict(zip(comparison.output_names, comparison.output_units, strict=True)),
        "models": [_model(trial) for trial in comparison.models],
        "table": [
            {
                "model": trial.name,
                "rms": trial.simulation.rms,
                "fit_percent": trial.simulation.fit_percent,
                "one_step_rms": trial.one_step.rms,
                "bic": trial.bic,
                "verdict": trial.verdict,
            }
            for trial in comparison.models
        ],
    }


def series(comparison: Comparison) -> dict[str, np.ndarray]:
    """Arrays by `R.time` and `R.measured` of recording R, and `R.M.simulated`, `R.M.predicted` and, where
    the model was tested, `R.M.residuals` of model M on it; columns are the outputs."""
    arrays: dict[str, np.ndarray] = {}
    for r, experiment in enumerate(comparison.experiments):
        arrays[f"{r}.time"], arrays[f"{r}.measured"] = experiment.time, experiment.outputs
        for m, trial in enumerate(comparison.models):
            arrays[f"{r}.{m}.simulated"] = trial.simulated[r]
            arrays[f"{r}.{m}.predicted"] = trial.predicted[r]
            if trial.residuals:
                arrays[f"{r}.{m}.residuals"] = trial.residuals[r]
    return arrays


def _model(trial: ModelTrial) -> ModelEntry:
    return entry(
        ModelEntry,
        trial,
        fit_percent=trial.simulation.fit_percent,
        rms=trial.simulation.rms,
        tests=cast(Tests, {kind: _tests(by_output) for kind, by_output in trial.tests.items()}),
        feedback=_tests(trial.feedback),
        where=[_finding(finding) for finding in trial.where],
    )


def _tests(by_output: Mapping[str, ResidualTest]) -> dict[str, TestEntry]:
    return {output: _test(test) for output, test in by_output.items()}


def _test(test: ResidualTest) -> TestEntry:
    entry: TestEntry = {
        "statistic": test.statistic,
        "limit": test.limit,
        "p_value": test.p_value,
        "pass": test.passed,
    }
    if test.band is not None:
        entry["band"] = list(test.band)
    return entry


def _finding(finding: Finding) -> Where:
    return {
        "output": finding.output,
        "kind": finding.kind,
        "variable": finding.variable,
        "unit": finding.unit,
        "low": finding.low,
        "high": finding.high,
        "share_of_error": finding.share,
        "expected_share": finding.expected,
        "error": finding.error,
        "data": finding.experiment,
        "p_value": finding.p_value,
        "text": finding.text,
    }
