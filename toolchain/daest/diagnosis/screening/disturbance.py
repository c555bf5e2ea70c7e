"""The unexplained loads: what each buys, and its course, smoothed from the innovations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import RTOL, NullObserver, error_covariance, measured_together
from daest.estimation.filter_engines.stationary import known_filter
from daest.estimation.nonlinear.observer import observer, sampled_average
from daest.model.diagnosis import PlaceGain
from daest.numerics.recursions import linear_recursion
from daest.systems.events.integration import Correction, IntegrationError
from daest.systems.simulation.integrate import Integrator, integrate, integrator


@dataclass(frozen=True)
class SmoothedLoad:
    """The load with the largest size, given all data: values (n_samples,) and its standard deviation."""

    index: int
    values: np.ndarray
    std: float


def place_gains(null: Null, run: NullObserver) -> tuple[PlaceGain, ...]:
    """What each load buys in log-likelihood while the others stay (parameters held), in the order of the
    loads; nothing, where no load at all is likelier."""
    if null.is_likelier_alone:
        return tuple(PlaceGain(load.places, 0.0, load.size, load.unit) for load in null.loads)
    model = integrator(null.explicit)
    whole = _log_likelihood(null, model, run.gain)
    # Where the loads explain all noise of a sensor, even hardly any load would follow the data as well.
    std = np.maximum(null.measurement_std, np.sqrt(np.diag(np.linalg.inv(run.root.T @ run.root))))
    gains = []
    for load in null.loads:
        without = np.array(
            [
                q * GATES.hardly_any_load if w.name == f"{load.name}.w" else q
                for w, q in zip(null.flat.noises, null.intensity, strict=True)
            ]
        )
        found = observer(run.average, without, std)
        gain = np.zeros_like(run.gain) if found is None else found.gain
        values = (_log_likelihood(null, model, g) for g in (gain, np.zeros_like(gain)))
        # An observer that runs away predicts no worse than the simulation.
        other = next((value for value in values if np.isfinite(value)), whole)
        bought = max(whole - other, 0.0)
        gains.append(PlaceGain(load.places, bought, load.size, load.unit))
    return tuple(gains)


def _log_likelihood(null: Null, model: Integrator, gain: np.ndarray) -> float:
    """Of the innovations with their own covariance, up to a constant."""
    names = null.explicit.state_names
    errors = []
    for experiment, state in zip(null.experiments, null.initial_states, strict=True):
        x0 = np.array([state.get(name, 0.0) for name in names])
        try:
            outputs = integrate(
                model, experiment.time, experiment.inputs, null.theta, x0,
                hold=null.hold, correction=Correction(experiment.outputs, gain), rtol=RTOL,
            ).outputs  # fmt: skip
        except IntegrationError:
            return -np.inf
        errors.append(experiment.outputs - outputs)
    table = np.concatenate(errors)
    together, spread = measured_together(table), error_covariance(table)
    if together.size:
        value = -0.5 * together.shape[0] * np.linalg.slogdet(spread)[1]
    else:
        with np.errstate(divide="ignore", invalid="ignore"):
            value = -0.5 * np.isfinite(table).sum(axis=0) @ np.log(np.diagonal(spread))
    return float(value) if np.isfinite(value) else -np.inf


def smoothed_load(
    null: Null, run: NullObserver, gains: Sequence[PlaceGain], experiment: int = 0
) -> SmoothedLoad | None:
    """The load that buys most, by fixed-interval smoothing with the stationary gain of the average model
    (Bryson & Frazier); None where no load buys anything or there is no gain."""
    bought = np.array([g.log_likelihood_gain for g in gains])
    if not np.any(bought > GATES.min_looked_at_gain):
        return None
    return smoothed_at(null, run, int(np.argmax(bought)), experiment)


def smoothed_at(null: Null, run: NullObserver, index: int, experiment: int = 0) -> SmoothedLoad | None:
    """The load `index`, smoothed; None where there is no stationary gain that the observer follows."""
    if not run.is_optimal:
        return None
    model = sampled_average(run.average, null.intensity, null.measurement_std)
    found = known_filter(model)
    if found is None:
        return None
    observed = run.observed[experiment]
    S_inverse = run.root.T @ run.root
    errors = np.linalg.solve(run.root, observed.whitened.T).T
    # r[k-1] = C' S⁻¹ e[k] + closed' r[k], smoothed = predicted + P r[k-1]
    weighted = (observed.sensors * (errors @ S_inverse)) @ run.average.C
    backward = linear_recursion(found.closed_loop.T, weighted[::-1], np.zeros(weighted.shape[1]))[1:][::-1]
    smoothed = observed.predicted + backward @ found.predicted_cov
    row = run.state_names.index(null.loads[index].name)
    std = float(np.sqrt(found.predicted_cov[row, row]))
    return SmoothedLoad(index, smoothed[:, row], std)
