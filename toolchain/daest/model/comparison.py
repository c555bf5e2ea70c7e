"""Comparison: how models predict the same recordings, whether the data contradict them, and where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from daest.model.experiment import Experiment
from daest.model.fit import Agreement
from daest.model.shown import Framed, Listing

Verdict = Literal["falsified", "not falsified"]


@dataclass(frozen=True)
class ResidualTest:
    """A test of the one-step errors of one output. It passes while `statistic` is within `limit`, which is
    set so that all tests of a model together raise a false alarm in at most the share of the verdict.

    `band` (low, high) where both sides count; `limit` is then the nearer side.
    """

    statistic: float
    limit: float
    p_value: float
    passed: bool
    band: tuple[float, float] | None = None


@dataclass(frozen=True)
class Finding:
    """A place where the error of an output is larger than if it were spread evenly.

    `share` of the sum of squares of `error` falls where `variable` is within `low` … `high` (None: no limit),
    where an evenly spread error would have `expected`. `variable` is `time` [s], `frequency` [Hz], the name
    of a model variable or abs(name). `p_value` is that of the search over all places.
    """

    output: str
    kind: Literal["time", "frequency", "region"]
    error: Literal["one-step", "simulation"]
    variable: str
    unit: str
    low: float | None
    high: float | None
    share: float
    expected: float
    p_value: float
    text: str
    experiment: str | None = None  # of a time window


@dataclass(frozen=True)
class Horizon:
    """rms error per output of predictions `steps` samples (`seconds`) ahead of the last sample used."""

    steps: int
    seconds: float
    rms: dict[str, float | None]


@dataclass(frozen=True)
class ModelTrial:
    """One model on the recordings of a comparison, in their order.

    `simulated` and `predicted` (one-step) hold one array (n_samples, n_y) per recording, columns as in
    `Comparison.output_names`; `simulation` and `one_step` say how well they agree, over all recordings
    together. `n_parameters` counts the estimated ones. `bic` is on the log-likelihood of these recordings.
    `tests` and `feedback` are by test and output; `verdict` is None where nothing can be tested. `residuals`
    are the one-step errors in units of their predicted standard deviation.
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
    tests: Mapping[str, Mapping[str, ResidualTest]] = field(default_factory=dict)
    feedback: Mapping[str, ResidualTest] = field(default_factory=dict)
    verdict: Verdict | None = None
    where: tuple[Finding, ...] = ()
    growth: tuple[Horizon, ...] = ()
    residuals: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True)
class Comparison(Framed):
    """Models side by side, in the order in which they were given."""

    experiments: tuple[Experiment, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    models: tuple[ModelTrial, ...]

    def tables(self) -> tuple[Listing, ...]:
        rows = tuple(
            (
                m.name,
                output,
                m.simulation.fit_percent.get(output),
                m.simulation.rms.get(output),
                m.bic,
                m.verdict,
            )
            for m in self.models
            for output in self.output_names
        )
        names = ", ".join(e.name for e in self.experiments)
        return (Listing(f"On {names}", ("model", "output", "fit %", "rms", "bic", "verdict"), rows),)
