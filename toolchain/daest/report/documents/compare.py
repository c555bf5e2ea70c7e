"""The document of a comparison."""

from __future__ import annotations

from typing import Any

from daest.model.comparison import Comparison, ModelTrial


def document(comparison: Comparison) -> dict[str, Any]:
    """JSON content of `daest compare`: one entry per model, and `table`, the simulation error of each."""
    return {
        "data": [experiment.name for experiment in comparison.experiments],
        "outputs": dict(zip(comparison.output_names, comparison.output_units, strict=True)),
        "models": [_model(trial) for trial in comparison.models],
        "table": [
            {"model": trial.name, "rms": trial.simulation.rms, "fit_percent": trial.simulation.fit_percent}
            for trial in comparison.models
        ],
    }


def _model(trial: ModelTrial) -> dict[str, Any]:
    return {
        "name": trial.name,
        "n_parameters": trial.n_parameters,
        "fit_percent": trial.simulation.fit_percent,
        "rms": trial.simulation.rms,
        "one_step": {"fit_percent": trial.one_step.fit_percent, "rms": trial.one_step.rms},
        "log_likelihood": trial.log_likelihood,
        "bic": trial.bic,
        "tests": {},
        "verdict": None,
        "where": [],
        "notes": list(trial.notes),
    }
