"""Loads that begin at a value which their own noise makes next to impossible.

The start of a load is free in the fit. A load whose noise vanishes while its start does not is a decay that
begins with the recording. A lag makes the same of a step at the start, so that the recording does not tell
what a machine lacks from what it was left with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daest.diagnosis.evidence.ranking import best_accepted
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, at_fit
from daest.estimation.fitting.records import n_observed
from daest.model.diagnosis import Load, Proof
from daest.model.experiment import Experiment
from daest.model.fit import FitResult
from daest.systems.events.integration import IntegrationError
from daest.systems.simulation.integrate import Integrator, integrate, integrator

QUICK = "loads begin with the recording: once more with loads without memory"


@dataclass(frozen=True)
class LoadStart:
    """A load that starts at `value` (in its unit) when the recording number `experiment` begins."""

    load: Load
    experiment: int
    value: float


def starts_from_nowhere(null: Null, bought: float, by_noises: float) -> tuple[LoadStart, ...]:
    """As `from_nowhere`, where the loads make the recordings likelier by as much as such a start would:
    `bought`, of which `by_noises` what their noises do. At a kink, as of friction that sticks, the standard
    error of a start means nothing."""
    if bought < GATES.max_load_start**2 / 2.0:
        return ()
    return from_nowhere(null, bought - by_noises)


def from_nowhere(null: Null, bought: float = 0.0) -> tuple[LoadStart, ...]:
    """The starts of loads that are farther from zero than the size of the load makes likely, in a way that
    the outputs show; of each load the farthest. `bought` is the log-likelihood that the loads buy beyond what
    their noises do: where it is much, the starts are certain together, if none of them is alone."""
    far = [start for load in null.loads if (start := _farthest(null, load, bought)) is not None]
    if not far:
        return ()
    model = integrator(null.explicit)
    return tuple(start for start in far if _is_seen(null, start, model))


def rests_on_starts(null: Null, fit: FitResult, without: FitResult) -> bool:
    """Whether a simulation of the model with loads, in its `fit`, that is as good as its prediction is so by
    how they begin. The noises of loads do nothing in it, so that all that makes the recordings likelier than
    in the fit `without` loads is their starts: by as much as one would that is certain, and in a way that the
    outputs show. What starts where no machine could have left it is none that the model foresees."""
    if fit.log_likelihood - without.log_likelihood < GATES.max_load_start**2 / 2.0:
        return False
    begun = at_fit(null, fit)
    model = integrator(begun.explicit)
    starts = (
        LoadStart(load, number, _told_start(fit, load.name, number)[0])
        for load in begun.loads
        for number in range(len(begun.experiments))
    )
    return any(_is_seen(begun, start, model) for start in starts)


def takes_over(start: LoadStart, proof: Proof) -> bool:
    """Whether the candidate, which keeps a state of its own, does what the start of the load did."""
    value, _ = _told_start(proof.fit, start.load.name, start.experiment)
    return proof.candidate.is_dynamic and abs(value) < GATES.max_kept_start * abs(start.value)


def says_as_much_as_starts(null: Null, proofs: Sequence[Proof]) -> bool:
    """Whether an accepted candidate, beside loads without memory, makes the recordings as likely as the loads
    of `null` do, whose starts are free in every recording."""
    best = best_accepted(proofs)
    if best is None:
        return False
    n_starts = len(null.loads) * len(null.experiments)
    worth = 0.5 * n_starts * float(np.log(n_observed(null.experiments)))
    return best.fit.log_likelihood > null.fit.log_likelihood - worth


def _farthest(null: Null, load: Load, bought: float) -> LoadStart | None:
    """The most certain of the starts of a load; None where chance explains it."""
    told = [_told_start(null.fit, load.name, number) for number in range(len(null.experiments))]
    if bought > GATES.max_load_start**2 / 2.0:  # as a single start of so many standard errors buys
        told = [(value, 0.0 if np.isfinite(error) else error) for value, error in told]
    sure = [abs(value) / max(load.size, error, np.finfo(float).tiny) for value, error in told]
    number = int(np.argmax(sure))
    return LoadStart(load, number, told[number][0]) if sure[number] > GATES.max_load_start else None


def _told_start(fit: FitResult, name: str, experiment: int) -> tuple[float, float]:
    """The initial value of a state and its standard error, which is infinite where the data know none."""
    found = fit.initial_states[experiment]
    if name not in found.names:
        return 0.0, np.inf
    row = found.names.index(name)
    error = float(found.std_errors[row])
    return float(found.values[row]), error if np.isfinite(error) else np.inf


def _is_seen(null: Null, start: LoadStart, model: Integrator) -> bool:
    """Whether an output moves by more than its noise where the load starts at zero."""
    experiment, state = null.experiments[start.experiment], null.initial_states[start.experiment]
    try:
        own, without = (
            _simulated(null, model, experiment, one) for one in (state, {**state, start.load.name: 0.0})
        )
    except IntegrationError:
        return False
    moved = np.max(np.abs(own - without), axis=0, initial=0.0)
    return bool(np.any(moved > GATES.min_seen_start * null.measurement_std))


def _simulated(
    null: Null, model: Integrator, experiment: Experiment, state: Mapping[str, float]
) -> np.ndarray:
    """Outputs (n_samples, n_y) of the model from that state."""
    x0 = np.array([state.get(name, 0.0) for name in null.explicit.state_names])
    return integrate(model, experiment.time, experiment.inputs, null.theta, x0, hold=null.hold).outputs
