"""Whether errors that last follow what drives the model.

Dynamics that a model lacks respond to what moves the machine, so that the errors of its simulation go with
past inputs, or with what the model makes of them. The slow noise of a sensor, and loads from outside, follow
neither.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daest.diagnosis.comparison.residual_tests import joined, residual_tests
from daest.diagnosis.gates import GATES
from daest.estimation.fitting.signals import is_constant
from daest.model.experiment import Experiment

KINDS = ("input_independence", "variable_independence")


def are_driven(experiments: Sequence[Experiment], errors: Sequence[np.ndarray]) -> bool | None:
    """Whether the `errors` (n_samples, n_y) of the simulation of every experiment follow past inputs, or the
    simulated outputs, their squares and signs, at the level of a screen; None where no input moves, or an
    error is not known. Errors are whitened by their own autoregression, and what they may follow with them
    (`residual_tests`)."""
    if all(is_constant(u) for e in experiments for u in e.inputs.T):
        return None
    if any(
        np.any(~np.isfinite(r) & np.isfinite(e.outputs)) for e, r in zip(experiments, errors, strict=True)
    ):
        return None
    size = np.sqrt(np.nanmean(np.concatenate(errors) ** 2, axis=0))
    names = [str(column) for column in range(size.size)]
    sequences = joined(
        [r / np.where(size > 0.0, size, 1.0) for r in errors],
        [e.inputs for e in experiments],
        _simulated_outputs(experiments, errors),
        (),
        None,
        acts_at_once=True,
        n_estimation=None,
        known_noise=np.zeros(size.size, dtype=bool),
    )
    tests, _ = residual_tests(sequences, names)
    p_values = [test.p_value for kind in KINDS for test in tests[kind].values()]
    return min(p_values) * len(p_values) < GATES.missing_level if p_values else None


def _simulated_outputs(experiments: Sequence[Experiment], errors: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Those of every experiment less their mean over all, (n_samples, n_y); zero where nothing was seen."""
    outputs = [e.outputs - r for e, r in zip(experiments, errors, strict=True)]
    mean = np.nanmean(np.concatenate(outputs), axis=0)
    return [np.nan_to_num(y - mean) for y in outputs]
