"""Comparison: how models predict the same recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daest.model.experiment import Experiment
from daest.model.fit import Agreement


@dataclass(frozen=True)
class ModelTrial:
    """One model on the recordings of a comparison, in their order.

    `simulated` and `predicted` (one-step) hold one array (n_samples, n_y) per recording, columns as in
    `Comparison.output_names`; `simulation` and `one_step` say how well they agree, over all recordings
    together. `n_parameters` counts the estimated ones. `bic` is on the log-likelihood of these recordings.
    """

    name: str
    n_parameters: int
    simulation: Agreement
    one_step: Agreement
    log_likelihood: float
    bic: float
    simulated: tuple[np.ndarray, ...]
    predicted: tuple[np.ndarray, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Models side by side, in the order in which they were given."""

    experiments: tuple[Experiment, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    models: tuple[ModelTrial, ...]
