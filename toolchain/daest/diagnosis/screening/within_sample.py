"""What inputs do to outputs within one sample: how late an input acts there is no law of a sensor.

Loads take over what an input does slowly, so that of a share of it in a reading the innovations see the
changes alone; as they do of an input that acts a part of a sample later, as the current of a drive.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.model.diagnosis import Candidate
from daest.model.fit import FitResult, error_ratios
from daest.numerics.exponential import transition_integrals


def acts_later(
    run: NullObserver, candidate: Candidate, told: FitResult, before: FitResult, *, adds_up: bool
) -> str:
    """Why a share of an input in a reading is none: it is less than what the input does to the output by
    itself within a sample, and no simulation of unseen data is clearly better with it; empty where it may be
    one. Where errors of the simulation add up (`adds_up`), as of the angle that a motor turns to, none is:
    what acts within a sample does not add up, and other values make such a simulation better."""
    effect = candidate.effect
    if not (effect.is_of_driving and candidate.site.kind == "output"):
        return ""
    ratios = error_ratios(before.simulated, told.simulated)
    if ratios and not adds_up and min(ratios) < GATES.max_clear_ratio:
        return ""
    experiment = run.null.experiments[0]
    column = experiment.input_names.index(candidate.inputs[effect.inputs[0]])
    row = experiment.output_names.index(candidate.site.name)
    size = next(p.value for p in told.parameters if p.name == f"{candidate.name}.{effect.sizes[0].name}")
    if abs(size) >= abs(responses_within(run)[row, column]):
        return ""
    return f"it does what {experiment.input_names[column]} would do that acts a part of a sample later"


def responses_within(run: NullObserver) -> np.ndarray:
    """What an input of one does to every output by the end of a sample (n_y, n_u), in the mean over the
    longest recording."""
    null, average = run.null, run.average
    longest = int(np.argmax([e.n_samples for e in null.experiments]))
    states, one = run.observed[longest].filtered, null.experiments[longest]
    B = _by_inputs(null.explicit.rhs, np.mean(states, axis=0), np.mean(one.inputs, axis=0), null.theta)
    held = transition_integrals(average.A, average.period).first
    return average.C @ held @ B


def _by_inputs(rhs: ca.Function, x: np.ndarray, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """∂f/∂u (n, n_u) at a point without noise, at time 0."""
    symbols = [ca.MX.sym(f"a{i}", rhs.size_in(i)) for i in range(rhs.n_in())]
    slope = ca.Function("slope", symbols, [ca.densify(ca.jacobian(rhs(*symbols), symbols[1]))])
    rest = [np.zeros(rhs.size_in(i)) for i in (2, 3)]
    return np.array(slope(x, u, *rest, theta, 0.0))
