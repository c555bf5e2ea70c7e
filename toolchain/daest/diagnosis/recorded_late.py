"""Inputs that act before they are recorded.

A logger that writes the command of an interval at its end, beside what was measured there, shows effects
before their causes. No law does that; a lag too many in the model does something like it, and so do a
flexible part and a spring too stiff. What the recording cannot tell from inputs that are one sample late is
not told to be a law.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.null import Null, refitted
from daest.diagnosis.settled import FAILURES
from daest.estimation.hold_search import moving_inputs
from daest.model.experiment import Experiment
from daest.model.holds import ZOH


def gain_of_earlier_inputs(null: Null) -> float:
    """What the log-likelihood of the model as it is gains where its inputs act one sample before they are
    recorded; 0.0 where that is not likelier by as much as settles how inputs are held. Inputs that are held
    and a sample late are straight lines half a sample late, which are nearer: where held ones are, nothing is
    late."""
    is_coarse = null.other_experiments is not None
    if null.hold == ZOH or is_coarse or not moving_inputs(null.experiments, null.flat.input_names):
        return 0.0
    ahead = tuple(one_sample_ahead(e) for e in null.experiments)
    with suppress(*FAILURES):
        earlier = replace(null, experiments=ahead, hold=ZOH)
        least = null.fit.log_likelihood + GATES.min_hold_gain
        fit = refitted(null.flat, null.explicit, null.estimated, earlier, hopeless=least, least=least).fit
        # The search ends early where it gains too little, not where it gains nothing.
        return fit.log_likelihood - null.fit.log_likelihood if fit.log_likelihood >= least else 0.0
    return 0.0


def one_sample_ahead(experiment: Experiment) -> Experiment:
    """The experiment with inputs that act one sample earlier, the last ones to its end."""
    inputs = np.concatenate([experiment.inputs[1:], experiment.inputs[-1:]])
    return replace(experiment, inputs=inputs)
