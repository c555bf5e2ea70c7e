"""Dead times by shifts of the recordings, beside a model that bends.

A dead time has ten states, and beside a model that is not affine each run of them takes as long as a hundred
without. But a model whose input is late is the model driven by the shifted input, and one whose output is
late has its measurements shifted back: both are runs of the model as it is. They tell how long the dead time
may be, and whether it can come near to a lag at the same signal at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from daest.diagnosis.null import Null, period_of, pinned
from daest.diagnosis.unseen import free_runs
from daest.model.effects import Site
from daest.model.experiment import Experiment

DELAY = "Daest.Effects.Signals.Delay"
SHIFTS = np.geomspace(1.0, 100.0, 13)  # sampling periods, ...
FINER = 7  # ... and so many between the neighbours of the best


def best_shift(null: Null, site: Site, theta: Mapping[str, float]) -> tuple[float, float] | None:
    """The log-likelihood of the simulation of the null's model, with its parameters as in `theta` as far as
    they are there and a dead time at the `site` of a signal, and that dead time [s], of all SHIFTS the
    likeliest; None where the model cannot be simulated."""
    own = {p.name: theta[p.name] for p in null.flat.parameters if p.name in theta}
    model = replace(null, flat=pinned(null.flat.with_theta(own), null.explicit))

    def likeliest(delays: Sequence[float]) -> tuple[float, float] | None:
        tried = []
        for delay in delays:
            shifted = tuple(shifted_back(one, site, delay) for one in null.experiments)
            runs = free_runs(model, shifted)
            if runs is not None:
                errors = [e.outputs - run.outputs for e, run in zip(shifted, runs, strict=True)]
                tried.append((_log_likelihood(errors, null.experiments), delay))
        return max(tried, default=None)

    first = likeliest((SHIFTS * period_of(null.experiments)).tolist())
    if first is None:
        return None
    step = SHIFTS[1] / SHIFTS[0]
    again = likeliest(np.geomspace(first[1] / step, first[1] * step, FINER).tolist())
    return first if again is None else max(first, again)


def shifted_back(experiment: Experiment, site: Site, delay: float) -> Experiment:
    """The experiment as a model without a dead time [s] at the `site` would have it: an input later by that,
    an output earlier, with nothing measured behind the end."""
    table = experiment.inputs if site.kind == "input" else experiment.outputs
    names = experiment.input_names if site.kind == "input" else experiment.output_names
    column, time = names.index(site.name), experiment.time
    moved = table.copy()
    if site.kind == "input":
        moved[:, column] = np.interp(time - delay, time, table[:, column])
        return replace(experiment, inputs=moved)
    moved[:, column] = np.interp(time + delay, time, table[:, column], right=np.nan)
    return replace(experiment, outputs=moved)


def _log_likelihood(errors: Sequence[np.ndarray], experiments: Sequence[Experiment]) -> float:
    """Of errors with the variances that suit them best, as if there were one for every measurement."""
    table = np.concatenate(errors)
    count = np.isfinite(np.concatenate([e.outputs for e in experiments])).sum(axis=0)
    variance = np.nanmean(table**2, axis=0)
    return float(-0.5 * np.sum(count * (np.log(2.0 * np.pi * variance) + 1.0)))
