"""Detect wrong polarity with a model: an output moves against the simulated one for all parameter values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from daest.errors import DaestError
from daest.model.experiment import Experiment, Finding
from daest.model.flat import Model

# Every unknown parameter is moved by this factor, up and down, because beyond a resonance that stands
# elsewhere a healthy output moves against the model's, too.
FACTOR = 3.0
AGAINST = -0.5  # correlation of measured and simulated output, at all parameter values
MOST_PARAMETERS = 8
LONGEST = 20_000  # samples of the recording that are simulated


def polarity_findings(flat: Model, experiment: Experiment) -> list[Finding]:
    """One finding per output that moves against the model; on the only input if all outputs do.

    Nothing is said where the model cannot be simulated, or where the sign depends on the parameters.
    """
    part = _shortened(experiment)
    try:
        correlations = np.array([_correlations(flat, part, theta) for theta in _variants(flat)])
    except DaestError:
        return []
    against = [
        name
        for name, column in zip(part.output_names, correlations.T, strict=True)
        if np.all(np.isfinite(column)) and column.max() < AGAINST
    ]
    measured = int(np.isfinite(correlations).all(axis=0).sum())
    if len(against) == measured and len(against) > 1 and len(part.input_names) == 1:
        text = f"drives all {measured} outputs the other way than the model: probably its polarity"
        return [Finding("check-polarity", "warning", part.input_names[0], text)]
    text = f"moves against the model, with its parameters up to {FACTOR:g} times larger or smaller"
    return [Finding("check-polarity", "warning", name, text) for name in against]


def _shortened(experiment: Experiment) -> Experiment:
    n = min(experiment.n_samples, LONGEST)
    return replace(
        experiment,
        time=experiment.time[:n],
        inputs=experiment.inputs[:n],
        outputs=experiment.outputs[:n],
        extra={},
    )


def _variants(flat: Model) -> Iterator[np.ndarray]:
    """The parameter values of the model, then with each unknown one larger and smaller."""
    theta = flat.theta_values
    yield theta
    unknown = [i for i, p in enumerate(flat.parameters) if p.estimate][:MOST_PARAMETERS]
    for i in unknown:
        for factor in (FACTOR, 1.0 / FACTOR):
            changed = theta.copy()
            changed[i] *= factor
            yield changed


def _correlations(flat: Model, experiment: Experiment, theta: np.ndarray) -> list[float]:
    """Correlation of every measured output with the simulated one, NaN where one of them stands still."""
    from daest.systems.simulate import simulate

    simulated = simulate(flat, experiment, theta=theta).outputs
    return [
        _correlation(experiment.time, measured, own)
        for measured, own in zip(experiment.outputs.T, simulated.T, strict=True)
    ]


def _correlation(time: np.ndarray, measured: np.ndarray, simulated: np.ndarray) -> float:
    """Without a trend: where both drift, they do so for other reasons."""
    known = np.isfinite(measured) & np.isfinite(simulated)
    if known.sum() < 3:
        return np.nan
    basis = np.vander(time[known] - time[0], 2)
    rest = [v - basis @ np.linalg.lstsq(basis, v, rcond=None)[0] for v in (measured[known], simulated[known])]
    sizes = [float(np.linalg.norm(v)) for v in rest]
    return float(rest[0] @ rest[1] / (sizes[0] * sizes[1])) if min(sizes) > 0 else np.nan
