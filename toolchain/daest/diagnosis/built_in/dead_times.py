"""Dead times by shifts of the recordings, beside a model that bends.

A dead time has ten states, and beside a model that is not affine each run of them takes as long as a hundred
without. But a model whose input is late is the model driven by the shifted input, and one whose output is
late has its measurements shifted back: both are fits of the model as it is. They tell how long the dead time
may be, and whether it can come near to a lag at the same signal at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.null_model.null import Null
from daest.estimation.fitting.records import n_observed
from daest.estimation.identify import identify
from daest.model.effects import Site
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions

DELAY = "Daest.Effects.Signals.Delay"
SHIFTS = (0.4, 0.55, 0.7, 0.85, 1.0, 1.2)  # of the time constant of a lag that fits best


@dataclass(frozen=True)
class Shift:
    """A dead time [s], with the log-likelihood and all parameters of the simulation beside it."""

    log_likelihood: float
    delay: float
    theta: Mapping[str, float]


def best_shift(null: Null, site: Site, delays: Sequence[float], options: IdentifyOptions) -> Shift | None:
    """Of dead times [s] at the `site` of a signal, from short to long, the one beside which the null's model
    simulates best; the fit at each begins where the one before ended. None where none succeeds."""
    found: list[Shift] = []
    for delay in delays:
        shifted = tuple(shifted_back(one, site, delay) for one in null.experiments)
        with suppress(*FAILURES):
            fit = identify(null.flat, shifted, options)
            options = replace(options, start={name: fit.theta[name] for name in null.estimated})
            # As if nothing were missing behind the end.
            whole = n_observed(null.experiments) / n_observed(shifted)
            found.append(Shift(whole * fit.log_likelihood, delay, fit.theta))
    return max(found, key=lambda one: one.log_likelihood, default=None)


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
