"""Stationary Kalman filter: the constant gain of (47), or the mode of the model that forbids one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daest.errors import EstimationError
from daest.estimation.fitting.identifiability import combination_text
from daest.model.linear import DiscreteModel
from daest.numerics.exponential import balanced
from daest.numerics.gaussian import FREE_TOLERANCE
from daest.numerics.riccati import (
    UNDAMPED_MARGIN,
    NoiseModel,
    filter_riccati,
    forgetting,
    hidden_basis,
    predictor_gain,
    stationary_gains,
    undamped_modes,
    unobservable_subspace,
)


@dataclass(frozen=True)
class StationaryFilter:
    """x̂[k+1] = Φ x̂[k] + … + gain ν[k]: predictor gain (n, n_y), covariance of the one-step prediction (n,
    n), covariance S of the innovations (n_y, n_y) and closed loop Φ - gain C."""

    gain: np.ndarray
    predicted_cov: np.ndarray
    innovation_cov: np.ndarray
    closed_loop: np.ndarray


def stationary_filter(model: DiscreteModel, state_names: tuple[str, ...] | None = None) -> StationaryFilter:
    """The stabilising solution of the Riccati equation of (47), with the cross covariance.

    Errors (EstimationError) name the states: `filter-unobservable` when a mode that does not die out never
    shows in the outputs; `filter-undriven-mode` when a mode on or outside the unit circle has no noise, so
    that a constant gain would ignore the outputs about it; `filter-no-stationary-gain` when the equation has
    no reliable solution for another reason.
    """
    names = state_names or tuple(f"state {i + 1}" for i in range(model.transition.shape[0]))
    found = try_stationary_filter(model)
    hidden = unobservable_message(model, names)
    if hidden:
        raise EstimationError(
            "filter-unobservable",
            f"the outputs do not show {hidden}",
            remedy="measure more outputs, or use the time-varying filter with a known initial state",
        )
    if found is None:
        raise _no_solution(model, names)
    return found


def try_stationary_filter(model: DiscreteModel) -> StationaryFilter | None:
    """As `stationary_filter`, None where that raises."""
    arrays = (model.transition, model.output, model.measurement_cov, model.cross_cov)
    _, hidden = unobservable_subspace(model.transition, model.output)
    if undamped_modes(model.transition, hidden, UNDAMPED_MARGIN)[0].size:
        return None
    P = filter_riccati(
        model.transition, model.output, model.process_cov, model.measurement_cov, model.cross_cov
    )
    if P is None:
        return None
    gain, S = predictor_gain(P, *arrays)
    return StationaryFilter(gain, P, S, model.transition - gain @ model.output)


def known_filter(model: DiscreteModel) -> StationaryFilter | None:
    """As `try_stationary_filter`, and where modes that no noise drives neither die out nor grow, such as the
    charge of a cell, the filter that knows them: their start, which is estimated, settles them for all time.
    """
    found = try_stationary_filter(model)
    if found is not None or not _undriven_modes(model).shape[1]:
        return found
    _, hidden = unobservable_subspace(model.transition, model.output)
    if undamped_modes(model.transition, hidden, UNDAMPED_MARGIN)[0].size:
        return None
    noise = NoiseModel(
        model.transition, model.output, model.process_cov, model.measurement_cov, model.cross_cov
    )
    gains = stationary_gains(noise)
    if gains is None:
        return None
    closed = model.transition - gains.K @ model.output
    grows = np.max(np.abs(np.linalg.eigvals(closed))) > 1.0 + UNDAMPED_MARGIN
    return None if grows else StationaryFilter(gains.K, gains.P, gains.S, closed)


def unobservable_message(model: DiscreteModel, names: tuple[str, ...]) -> str:
    """The combinations of states that the outputs do not show and that do not die out; empty when all are
    seen."""
    _, hidden = unobservable_subspace(model.transition, model.output)
    _, vectors = undamped_modes(model.transition, hidden, UNDAMPED_MARGIN)
    return "; ".join(dict.fromkeys(combination_text(vector, names) for vector in vectors.T))


def without_unseen(model: DiscreteModel, present: np.ndarray) -> tuple[DiscreteModel, np.ndarray]:
    """The model with the same predictions of the outputs that are `present` (n_y,) bool and without undamped
    modes that none of them sees, and the directions (n, r) of the state that it leaves out."""
    output = model.output[present]
    basis = hidden_basis(model.transition, output)
    scaled = basis / balanced(model.transition - np.eye(basis.shape[0]))[1][:, None]
    rounding = np.abs(scaled) < FREE_TOLERANCE * np.max(np.abs(scaled), axis=0, initial=0.0)
    still = replace(model, transition=forgetting(model.transition, output))
    return still, np.where(rounding, 0.0, basis)


def _no_solution(model: DiscreteModel, names: tuple[str, ...]) -> EstimationError:
    undriven = _undriven_modes(model)
    if undriven.shape[1]:
        text = "; ".join(dict.fromkeys(combination_text(vector, names) for vector in undriven.T))
        return EstimationError(
            "filter-undriven-mode",
            f"no noise drives {text}, which never settles: a stationary filter would stop correcting it",
            remedy="give it process noise (an intensity above zero), or use the time-varying filter",
        )
    return EstimationError(
        "filter-no-stationary-gain",
        "the Riccati equation of the stationary filter has no reliable solution",
        remedy="check the noise covariances (all measurement noise zero?), or use the time-varying filter",
    )


def _undriven_modes(model: DiscreteModel) -> np.ndarray:
    """Eigenvectors (n, m) of modes with |λ| > 1 - UNDAMPED_MARGIN that the process noise cannot reach.

    The noise-free part of the dual: left eigenvectors with Qᵀ w = 0; the mode itself is the right
    eigenvector.
    """
    _, unreached = unobservable_subspace(model.transition.T, model.process_cov)
    values, _ = undamped_modes(model.transition.T, unreached, UNDAMPED_MARGIN)
    if not values.size:
        return np.zeros((model.transition.shape[0], 0))
    all_values, vectors = np.linalg.eig(model.transition)
    nearest = [int(np.argmin(np.abs(all_values - value))) for value in values]
    return vectors[:, sorted(set(nearest))]
