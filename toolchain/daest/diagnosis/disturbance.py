"""The unexplained load as a signal: smoothed from the innovations, and its curve against model variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daest.diagnosis.null import Null
from daest.diagnosis.screen import RTOL, NullObserver
from daest.estimation.observer import observer, sampled_average
from daest.estimation.stationary import try_stationary_filter
from daest.model.diagnosis import DisturbanceCurve, PlaceGain
from daest.numerics.recursions import linear_recursion
from daest.systems.integrate import Correction, IntegrationError, Integrator, integrate, integrator

BINS = 16  # of a curve, with equally many samples each
FOLDS = 8  # consecutive pieces of the record, each predicted from the others
SHIFTS = 39  # circular shifts of the load that show what chance explains: the best of 40 has p = 1/40
LEAST_SHIFT = 0.05  # of the record: shorter shifts leave the load where it was
RELATED = 0.3  # share of the load's variance that a curve must predict to count as a relation
LEAST_GAIN = 5.0  # log-likelihood that a load must buy to be looked at
MOST_SAMPLES = 20_000
HARDLY_ANY = 1e-8  # of a load's intensity stands for none: a model with integrators has no gain without noise


@dataclass(frozen=True)
class SmoothedLoad:
    """The load with the largest size, given all data: values (n_samples,) and its standard deviation."""

    index: int
    values: np.ndarray
    std: float


def place_gains(null: Null, run: NullObserver) -> tuple[PlaceGain, ...]:
    """What each load buys in log-likelihood while the others stay (parameters held), in the order of the
    loads."""
    model = integrator(null.explicit)
    whole = _log_likelihood(null, model, run.gain)
    gains = []
    for load in null.loads:
        without = np.array(
            [
                q * HARDLY_ANY if w.name == f"{load.name}.w" else q
                for w, q in zip(null.flat.noises, null.intensity, strict=True)
            ]
        )
        found = observer(run.average, without, null.measurement_std)
        gain = np.zeros_like(run.gain) if found is None else found.gain
        bought = max(whole - _log_likelihood(null, model, gain), 0.0)
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
    table = table[np.all(np.isfinite(table), axis=1)]
    return float(-0.5 * table.shape[0] * np.linalg.slogdet(table.T @ table / table.shape[0])[1])


def smoothed_load(
    null: Null, run: NullObserver, gains: Sequence[PlaceGain], experiment: int = 0
) -> SmoothedLoad | None:
    """The load that buys most, by fixed-interval smoothing with the stationary gain of the average model
    (Bryson & Frazier); None where no load buys anything or there is no gain."""
    bought = np.array([g.log_likelihood_gain for g in gains])
    if not np.any(bought > LEAST_GAIN):
        return None
    return smoothed_at(null, run, int(np.argmax(bought)), experiment)


def smoothed_at(null: Null, run: NullObserver, index: int, experiment: int = 0) -> SmoothedLoad | None:
    """The load `index`, smoothed; None where there is no stationary gain."""
    model = sampled_average(run.average, null.intensity, null.measurement_std)
    found = try_stationary_filter(model)
    if found is None:
        return None
    observed = run.observed[experiment]
    S_inverse = run.root.T @ run.root
    errors = np.linalg.solve(run.root, observed.whitened.T).T
    # r[k-1] = C' S⁻¹ e[k] + closed' r[k], smoothed = predicted + P r[k-1]
    weighted = errors @ S_inverse @ run.average.C
    backward = linear_recursion(found.closed_loop.T, weighted[::-1], np.zeros(weighted.shape[1]))[1:][::-1]
    predicted = observed.filtered - errors @ run.gain.T
    smoothed = predicted + backward @ found.predicted_cov
    row = run.state_names.index(null.loads[index].name)
    std = float(np.sqrt(found.predicted_cov[row, row]))
    return SmoothedLoad(index, smoothed[:, row], std)


def internal_variables(null: Null, run: NullObserver, experiment: int = 0) -> dict[str, np.ndarray]:
    """Every distinct internal variable along the filtered trajectory, by name (n_samples,), as the model
    without the loads has it: a variable that contains the load would explain the load."""
    explicit = null.explicit
    one = null.experiments[experiment]
    n = one.n_samples
    u = one.inputs.T
    v, w = np.zeros((explicit.rhs.numel_in(2), n)), np.zeros((explicit.rhs.numel_in(3), n))
    theta = np.tile(null.theta[:, None], (1, n))
    loads = {load.name for load in null.loads}
    states = run.observed[experiment].filtered * [name not in loads for name in run.state_names]
    values = np.array(explicit.variables.map(n)(states.T, u, v, w, theta, one.time))
    found: dict[str, np.ndarray] = dict(zip(one.input_names, one.inputs.T, strict=True))
    seen = [_normalised(x) for x in found.values()]
    # Of proportional variables the motion is named, not the torque or flow that goes with it.
    in_order = sorted(zip(explicit.flat.unknowns, values, strict=True), key=lambda pair: pair[0].is_flow)
    for variable, row in in_order:
        if variable.name in loads or not np.all(np.isfinite(row)) or np.ptp(row) == 0.0:
            continue
        shape = _normalised(row)
        if all(abs(shape @ other) < 1.0 - 1e-6 for other in seen):
            found[variable.name] = row
            seen.append(shape)
    return found


def _normalised(x: np.ndarray) -> np.ndarray:
    centred = x - x.mean()
    size = np.linalg.norm(centred)
    return centred / size if size > 0.0 else centred


def best_curve(
    null: Null, run: NullObserver, load: SmoothedLoad, seed: int = 0
) -> tuple[DisturbanceCurve, bool]:
    """The variable that predicts the load best, with its curve; and whether that is more than chance.

    Prediction is by bin means from the other parts of the record; chance is what circularly shifted loads
    give, searched over the same variables.
    """
    variables = internal_variables(null, run)
    step = -(-load.values.size // MOST_SAMPLES)
    w = load.values[::step]
    table = {name: x[::step] for name, x in variables.items()}
    shares = {name: _predicted_share(x, w) for name, x in table.items()}
    best = max(shares, key=lambda name: shares[name])
    rng = np.random.default_rng(seed)
    least = int(LEAST_SHIFT * w.size)
    chance = [
        max(_predicted_share(x, np.roll(w, shift)) for x in table.values())
        for shift in rng.integers(least, w.size - least, SHIFTS)
    ]
    is_related = shares[best] > max(chance) and shares[best] > RELATED
    return _curve(null, load, best, table[best], w, shares[best]), is_related


def _bins(x: np.ndarray) -> np.ndarray:
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)[1:-1]))
    return np.searchsorted(edges, x)


def _predicted_share(x: np.ndarray, w: np.ndarray) -> float:
    """Share of the variance of w that bin means over x predict, fold by fold."""
    which = _bins(x)
    n_bins = int(which.max()) + 1
    fold = np.arange(w.size) * FOLDS // w.size
    sums = np.zeros((FOLDS, n_bins))
    counts = np.zeros((FOLDS, n_bins))
    np.add.at(sums, (fold, which), w)
    np.add.at(counts, (fold, which), 1.0)
    others, n_others = sums.sum(axis=0) - sums, counts.sum(axis=0) - counts
    means = np.where(n_others > 0.0, others / np.maximum(n_others, 1.0), 0.0)
    total = float(np.sum((w - w.mean()) ** 2))
    return 1.0 - float(np.sum((w - means[fold, which]) ** 2)) / total if total > 0.0 else 0.0


def _curve(
    null: Null, load: SmoothedLoad, name: str, x: np.ndarray, w: np.ndarray, share: float
) -> DisturbanceCurve:
    which = _bins(x)
    groups: Sequence[np.ndarray] = [which == b for b in range(int(which.max()) + 1)]
    place = null.loads[load.index]
    units = {v.name: v.unit for v in (*null.flat.unknowns, *null.flat.inputs)}
    # Samples of a coloured load are not independent: count one per correlation time.
    period = float(np.median(np.diff(null.experiments[0].time)))
    independent = np.array(
        [max(g.sum() * period / max(2.0 * place.time_constant, period), 1.0) for g in groups]
    )
    spread = np.array([np.std(w[g]) for g in groups])
    return DisturbanceCurve(
        place=place.place,
        variable=name,
        unit=place.unit,
        variable_unit=units.get(name, ""),
        x=np.array([x[g].mean() for g in groups]),
        w=np.array([w[g].mean() for g in groups]),
        std=np.sqrt(spread**2 / independent + load.std**2 / np.maximum(independent, 1.0)),
        explained=share,
    )
