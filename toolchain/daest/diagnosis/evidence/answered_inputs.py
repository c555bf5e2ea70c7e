"""An input that answers an output: what a controller makes of that is no share of the input in a reading."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, refitted
from daest.model.diagnosis import Candidate
from daest.model.experiment import Experiment
from daest.model.fit import FitResult


def answers_output(null: Null, candidate: Candidate, told: FitResult) -> str:
    """Why a share of an input in a reading is none: a share of its next value makes the recordings likelier,
    with which no sensor can be mixed. A controller or a pilot answers what has moved the output, and its
    answer tells of that; empty where the share may be one.

    Both are taken off the recorded output, in the size `told`, and the model without it is fitted to the
    rest; the size is the best for the present value, so that the next one must do with it.
    """
    effect = candidate.effect
    if not (effect.is_of_driving and candidate.site.kind == "output"):
        return ""
    name = candidate.inputs[effect.inputs[0]]
    size = next(p.value for p in told.parameters if p.name == f"{candidate.name}.{effect.sizes[0].name}")
    present, following = (
        _likelihood_without(null, name, candidate.site.name, size, samples) for samples in (0, 1)
    )
    if not np.isfinite(present) or following <= present + GATES.min_hold_gain:
        return ""
    return f"the next value of {name} tells more than the present one: it answers {candidate.site.name}"


def _likelihood_without(null: Null, name: str, output: str, size: float, samples: int) -> float:
    """Log-likelihood of the model as it is where the share `size` of that input, so many samples later, is
    taken off the output; -inf where no fit comes out."""
    rest = tuple(_without_share(e, name, output, size, samples) for e in null.experiments)
    flat = null.flat.with_theta(null.fit.theta)
    left, explicit = replace(null, experiments=rest), replace(null.explicit, flat=flat)
    with suppress(*FAILURES):
        return refitted(flat, explicit, null.estimated, left).fit.log_likelihood
    return -np.inf


def _without_share(experiment: Experiment, name: str, output: str, size: float, samples: int) -> Experiment:
    """The recording whose `output` has lost `size` times the input `name` of so many samples later."""
    u = experiment.inputs[:, experiment.input_names.index(name)]
    u = np.concatenate([u[samples:], np.repeat(u[-1:], samples)])
    outputs = experiment.outputs.copy()
    outputs[:, experiment.output_names.index(output)] -= size * u
    return replace(experiment, outputs=outputs)
