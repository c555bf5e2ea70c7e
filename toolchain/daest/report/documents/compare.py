"""The document of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from daest.model.comparison import Comparison, Finding, Horizon, ModelTrial, ResidualTest


def document(comparison: Comparison) -> dict[str, Any]:
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


def _model(trial: ModelTrial) -> dict[str, Any]:
    return {
        "name": trial.name,
        "n_parameters": trial.n_parameters,
        "fit_percent": trial.simulation.fit_percent,
        "rms": trial.simulation.rms,
        "one_step": {"fit_percent": trial.one_step.fit_percent, "rms": trial.one_step.rms},
        "growth": [_horizon(horizon) for horizon in trial.growth],
        "log_likelihood": trial.log_likelihood,
        "bic": trial.bic,
        "tests": {kind: _tests(by_output) for kind, by_output in trial.tests.items()},
        "feedback": _tests(trial.feedback),
        "verdict": trial.verdict,
        "where": [_finding(finding) for finding in trial.where],
        "notes": list(trial.notes),
    }


def _tests(by_output: Mapping[str, ResidualTest]) -> dict[str, Any]:
    return {output: _test(test) for output, test in by_output.items()}


def _test(test: ResidualTest) -> dict[str, Any]:
    entry = {
        "statistic": test.statistic,
        "limit": test.limit,
        "p_value": test.p_value,
        "pass": test.passed,
    }
    return entry if test.band is None else {**entry, "band": list(test.band)}


def _horizon(horizon: Horizon) -> dict[str, Any]:
    return {"steps": horizon.steps, "seconds": horizon.seconds, "rms": horizon.rms}


def _finding(finding: Finding) -> dict[str, Any]:
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
