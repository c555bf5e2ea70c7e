"""Inputs that act before they are recorded.

A logger that writes the command of an interval at its end, beside what was measured there, shows effects
before their causes; so do two loggers whose clocks differ, and an input whose sensor is late. No law does
that; a lag too many in the model does something like it, and so do a flexible part and a spring too stiff.
What the recording cannot tell from inputs that are some samples late is not told to be a law.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, period_of, refitted, simulation_options
from daest.estimation.identify import identify
from daest.estimation.linear.hold_search import moving_inputs
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, error_ratios
from daest.model.holds import ZOH, Hold

SAMPLES = (2, 4, 8, 16, 32, 64)  # by which inputs are taken to be late at first
SHARE = 20  # of a recording at most, one part of so many
ITERATIONS = 20  # of a fit by simulation
MOST_ALONE = 3  # inputs, of which each may be late alone


@dataclass(frozen=True)
class EarlierInputs:
    """What the log-likelihood gains where the inputs `names` act so many `samples`, `seconds` in the unit of
    the recording, before they are recorded; 0 where that is not clearly likelier."""

    gain: float = 0.0
    samples: int = 1
    seconds: float = 0.0
    names: tuple[str, ...] = ()
    fit: FitResult | None = field(default=None, repr=False, compare=False)


def earlier_inputs(null: Null) -> EarlierInputs:
    """The inputs, all of them or one alone, that act some samples before they are recorded, where that is
    likelier than that all act one sample before: searched for by doublings, then nearer."""
    names = moving_inputs(null.experiments, null.flat.input_names)
    one = EarlierInputs(gain_of_earlier_inputs(null))
    most = min(e.n_samples for e in null.experiments) // SHARE
    groups = [names, *([name] for name in names if 1 < len(names) <= MOST_ALONE)]
    shifts = [(group, k) for group in groups for k in SAMPLES if group and k <= most]
    found = [late for group, k in shifts if (late := _late_by(null, group, k, EarlierInputs()))]
    best = max(found, key=lambda late: late.gain, default=one)
    if best.gain < one.gain + GATES.min_late_gain:
        return one
    step = best.samples // 2
    while step:
        before = best.samples
        for k in (max(before - step, 1), min(before + step, most)):
            best = _late_by(null, best.names, k, best) or best
        step = step if best.samples != before else step // 2
    return best


def _late_by(null: Null, names: Sequence[str], k: int, known: EarlierInputs) -> EarlierInputs | None:
    """What the model gains where those inputs act k samples earlier, if that is clearly more than what is
    `known`, from whose fit it starts; else None."""
    start = null if known.fit is None else replace(null, fit=known.fit)
    least = null.fit.log_likelihood + max(known.gain, GATES.min_late_gain)
    fit = _fit_ahead(start, names, k, least)
    if fit is None or fit.log_likelihood <= least:
        return None
    gain = fit.log_likelihood - null.fit.log_likelihood
    return EarlierInputs(gain, k, k * period_of(null.experiments), tuple(names), fit)


def _fit_ahead(start: Null, names: Sequence[str], k: int, least: float) -> FitResult | None:
    """The model as it is refitted from its `start` with those inputs k samples earlier; None where that fails
    or does not come up to the log-likelihood `least`, where the search ends early."""
    shifted = tuple(ahead(e, k, names) for e in start.experiments)
    flat = start.flat.with_theta(start.fit.theta)
    explicit, earlier = replace(start.explicit, flat=flat), replace(start, experiments=shifted)
    with suppress(*FAILURES):
        fit = refitted(flat, explicit, start.estimated, earlier, hopeless=least, least=least).fit
        return fit if fit.log_likelihood >= least else None
    return None


def gain_of_earlier_inputs(null: Null) -> float:
    """What the log-likelihood of the model as it is gains where its inputs act one sample before they are
    recorded; 0.0 where that is not likelier by as much as settles how inputs are held. Inputs that are held
    and a sample late are straight lines half a sample late, which are nearer: where held ones are, nothing is
    late."""
    is_coarse = null.other_experiments is not None
    if null.hold == ZOH or is_coarse or not moving_inputs(null.experiments, null.flat.input_names):
        return 0.0
    least = null.fit.log_likelihood + GATES.min_hold_gain
    fit = _fit_ahead(replace(null, hold=ZOH), null.flat.input_names, 1, least)
    return 0.0 if fit is None else fit.log_likelihood - null.fit.log_likelihood


def simulates_better(null: Null, late: EarlierInputs) -> bool:
    """Whether the recordings are simulated better, over all outputs, where the inputs act as early as `late`
    says, each way fitted by simulation. A load takes what is left from sample to sample, and a controller or
    a pilot who answers it tells of it in the next input: predictions are better for that input, simulations
    not. True where there is no such fit."""
    names = late.names or null.flat.input_names
    shifted = [ahead(e, late.samples, names) for e in null.experiments]
    hold = null.hold if late.names else ZOH
    try:
        given = _simulated(null, null.experiments, null.hold)
        earlier = _simulated(null, shifted, hold)
    except FAILURES:
        return True
    ratios = error_ratios(given.simulated, earlier.simulated, "estimation")
    return not ratios or float(np.prod(ratios)) < 1.0


def _simulated(null: Null, experiments: Sequence[Experiment], hold: Hold | None) -> FitResult:
    options = replace(simulation_options(null, null.estimated, ITERATIONS), hold=hold)
    return identify(null.flat, experiments, options)


def ahead(experiment: Experiment, k: int, names: Sequence[str]) -> Experiment:
    """The experiment with the inputs `names` k samples earlier, their last ones to its end."""
    u = experiment.inputs
    shifted = np.concatenate([u[k:], np.repeat(u[-1:], k, axis=0)])
    is_late = [name in names for name in experiment.input_names]
    return replace(experiment, inputs=np.where(is_late, shifted, u))
