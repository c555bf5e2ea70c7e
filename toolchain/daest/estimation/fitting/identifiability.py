"""What the data tell about the unknowns: covariance, correlation, and the directions that stay open, of the
parameters and of the states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from daest.estimation.fitting.coordinates import Coordinate
from daest.estimation.gates import FIT
from daest.model.fit import WeakDirection
from daest.numerics.exponential import transition_integrals
from daest.numerics.riccati import hidden_basis
from daest.numerics.statistics import coloured_moment, whiteness_p_value

WEIGHT_STEP = 0.25  # weights are rounded to multiples of this
ROUNDING = 4.0 * np.finfo(float).eps  # of a value: no estimate is known better


@dataclass(frozen=True)
class Uncertainty:
    """Covariance (p, p) of the unknowns in their own units; NaN rows where the data do not determine one.

    `is_coloured` tells that the residuals were not white and that the covariance accounts for it.
    """

    covariance: np.ndarray
    is_coloured: bool


def without_influence(information: np.ndarray, n_observed: int) -> np.ndarray:
    """Mask (p,) of unknowns whose change by one unit of z moves no prediction by a measurable part of its
    noise.

    The information of a coordinate is the sum of squared changes of all whitened predictions per unit of
    z; it counts as zero up to FIT.no_influence per measured value.
    """
    return np.diagonal(information) <= FIT.no_influence * max(n_observed, 1)


def flat_directions(information: np.ndarray) -> np.ndarray:
    """Directions (p, m) in z with no information, by FIT.flat_direction; unknowns without any influence left
    out.
    """
    scale = np.sqrt(np.diagonal(information))
    active = scale > 0.0
    scaled = information[np.ix_(active, active)] / np.outer(scale[active], scale[active])
    values, vectors = np.linalg.eigh(scaled)
    flat = np.zeros((scale.size, int(np.sum(values < FIT.flat_direction))))
    flat[active] = vectors[:, values < FIT.flat_direction] / scale[active, None]
    return flat


def covariance(information: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Inverse information over the free unknowns; NaN for the others and for those inside flat directions.
    Shapes: information and covariance (n, n), free (n,)."""
    result = np.full(information.shape, np.nan)
    rows = np.flatnonzero(free)
    if not rows.size:
        return result
    part = information[np.ix_(rows, rows)]
    scale = np.sqrt(np.diagonal(part))
    values, vectors = np.linalg.eigh(part / np.outer(scale, scale))
    kept = values > FIT.flat_direction
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    lost = np.sum(vectors[:, ~kept] ** 2, axis=1) > FIT.flat_direction
    inverse = inverse / np.outer(scale, scale)
    inverse[lost] = inverse[:, lost] = np.nan
    result[np.ix_(rows, rows)] = inverse
    return result


def are_coloured(residuals: Sequence[np.ndarray], observed: Sequence[np.ndarray]) -> bool:
    """Whether the residuals (n_samples, n_y) of any record and output are not white; missing samples
    (observed False) are left out."""
    columns = [
        (one[:, j], seen[:, j])
        for one, seen in zip(residuals, observed, strict=True)
        for j in range(seen.shape[1])
    ]
    lowest = min((whiteness_p_value(*column) for column in columns), default=1.0)
    return lowest * max(1, len(columns)) < FIT.coloured_level


def output_error_covariance(
    parts: list[Scores],
    observed: list[np.ndarray],
    slopes: np.ndarray,
    free: np.ndarray,
    prior_precision: np.ndarray,
) -> Uncertainty:
    """Covariance of output-error estimates in z: the inverse information, or the sandwich for coloured
    residuals.

    Residuals of a simulation are white only if nothing but measurement noise separates model and data.
    Otherwise cov = I⁻¹ M I⁻¹ with M the covariance of the score under the residuals' own spectrum. The
    precision of the priors in z (p,) is part of I and of M.
    """
    information = sum(np.tensordot(s.slopes, s.slopes, ((1, 2), (1, 2))) for s in parts)
    information = information * np.outer(slopes, slopes) + np.diag(prior_precision)
    inverse = covariance(information, free)
    if not are_coloured([s.residuals for s in parts], observed):
        return Uncertainty(inverse, False)
    moment = sum(coloured_moment(s.slopes, s.residuals) for s in parts) * np.outer(slopes, slopes)
    moment = moment + np.diag(prior_precision)
    filled = np.nan_to_num(inverse)
    sandwich = filled @ moment @ filled
    sandwich[np.isnan(inverse)] = np.nan
    return Uncertainty(sandwich, True)


def std_errors(cov: np.ndarray, values: np.ndarray) -> list[float | None]:
    """Standard errors (p,) of `values`; None where the data do not determine one, and none below the rounding
    of its value, where data without noise or the slopes of an unstable simulation would put it."""
    with np.errstate(invalid="ignore"):
        errors = np.maximum(np.sqrt(np.diagonal(cov)), ROUNDING * np.abs(values))
    return [float(error) if np.isfinite(error) else None for error in errors]


def correlation(cov: np.ndarray) -> np.ndarray:
    """Correlation matrix; NaN where a variance is unknown. Both have the shape (n, n)."""
    with np.errstate(all="ignore"):
        std = np.sqrt(np.diagonal(cov))
        return cov / np.outer(std, std)


def weak_directions(
    coordinates: tuple[Coordinate, ...], values: np.ndarray, information: np.ndarray, cov: np.ndarray
) -> tuple[WeakDirection, ...]:
    """Directions in log θ that the data leave open, weakest first.

    Two kinds: parameters that are uncertain together, while their ratios are known (one direction explains
    FIT.named_share of the variance of each), by more than FIT.weak_direction; and any direction beyond
    FIT.open_direction, also that of one parameter. `information` and `cov` are in the units of the unknowns.
    Linear unknowns near zero are measured by their scale. Exponents are rounded to multiples of WEIGHT_STEP
    of the largest. Shapes: values (p,), information and cov (p, p).
    """
    size = np.array(
        [abs(v) if c.is_log else max(abs(v), c.scale) for c, v in zip(coordinates, values, strict=True)]
    )
    everything = np.ones(size.size, dtype=bool)
    flat = (flat_directions(information) / size[:, None]).T
    weak = [WeakDirection(_combination(coordinates, d, everything), float("inf")) for d in flat]
    known = np.flatnonzero(np.isfinite(np.diagonal(cov)))
    relative = cov[np.ix_(known, known)] / np.outer(size[known], size[known])
    variances, vectors = np.linalg.eigh((relative + relative.T) / 2)
    for variance, vector in zip(variances[::-1], vectors.T[::-1], strict=True):
        std = float(np.sqrt(max(variance, 0.0)) * np.max(np.abs(vector)))
        direction, named = np.zeros(size.size), np.zeros(size.size, dtype=bool)
        direction[known] = vector
        named[known] = variance * vector**2 > FIT.named_share * np.diagonal(relative)
        together = _combination(coordinates, direction, named)
        if len(together) > 1 and std > FIT.weak_direction:
            weak.append(WeakDirection(together, std))
        elif std > FIT.open_direction:
            weak.append(WeakDirection(_combination(coordinates, direction, everything), std))
    return tuple(weak)


def _combination(
    coordinates: tuple[Coordinate, ...], direction: np.ndarray, named: np.ndarray
) -> dict[str, float]:
    """Readable exponents of the named parameters: the largest is 1, small ones are dropped, the others
    rounded.
    """
    largest = direction[np.argmax(np.abs(direction))]
    weights = direction / largest
    rounded = np.rint(weights / WEIGHT_STEP) * WEIGHT_STEP
    return {
        c.name: float(r)
        for c, w, r, is_named in zip(coordinates, weights, rounded, named, strict=True)
        if is_named and abs(w) > FIT.named_weight and r != 0.0
    }


@dataclass(frozen=True)
class Scores:
    """Of one record: whitened residuals (n_samples, n_y), whitened slopes (p, n_samples, n_y) with the part
    that the initial state explains removed, and covariance factors of x0.

    x0 = x0 at the estimate + initial_slope · δ + noise with covariance initial_cov, δ in the directions (p,).
    """

    residuals: np.ndarray
    slopes: np.ndarray
    initial_cov: np.ndarray  # (n, n), NaN rows where x0 is not determined
    initial_slope: np.ndarray  # (n, p)


def initial_state(responses: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """x0 (n,) that minimises |residuals - x0 · responses|; responses (n, m), residuals (m,), both
    whitened.

    Combinations with a response below FIT.unseen_start of the largest (after scaling each state) are left at
    zero.
    """
    scale = _scales(responses)
    return np.linalg.lstsq((responses / scale[:, None]).T, residuals, rcond=FIT.unseen_start)[0] / scale


def scores(residuals: np.ndarray, response: np.ndarray, slopes: np.ndarray) -> Scores:
    """Project whitened `slopes` (p, n_samples, n_y) on what no initial state explains; `response` is
    whitened.
    """
    n, p = response.shape[0], slopes.shape[0]
    A, J = response.reshape(n, residuals.size).T, slopes.reshape(p, residuals.size).T
    scale = _scales(A.T)
    left, values, right = np.linalg.svd(A / scale, full_matrices=False)
    kept = values > FIT.unseen_start * np.max(values, initial=0.0)
    left, values, right = left[:, kept], values[kept], right[kept]
    inside = left.T @ J
    pseudo = (right.T / values) / scale[:, None]
    cov = pseudo @ pseudo.T
    lost = np.sum(right**2, axis=0) < 1.0 - FIT.unseen_start
    cov[lost] = cov[:, lost] = np.nan
    beyond = J - left @ inside
    # What is left where an initial state does all that a parameter does, at every sample, is rounding, and no
    # way to go. Not by their norms: of an unstable model the last samples are nearly all of these.
    beyond[:, np.all(np.abs(beyond) <= FIT.absorbed_by_start * np.abs(J), axis=0)] = 0.0
    return Scores(residuals, beyond.T.reshape(slopes.shape), cov, pseudo @ inside)


def _scales(responses: np.ndarray) -> np.ndarray:
    sizes = np.linalg.norm(responses, axis=1)
    return np.where(sizes > 0.0, sizes, 1.0)


def unseen_directions(A: np.ndarray, C: np.ndarray, period: float, names: tuple[str, ...]) -> tuple[str, ...]:
    """What outputs C x of ẋ = A x, sampled every `period` [s], do not show and what does not die out, in
    words. A (n, n), C (n_y, n)."""
    if not np.all(np.isfinite(A)):
        return ()
    basis = hidden_basis(transition_integrals(A, period).transition, C)
    if not basis.shape[1]:
        return ()
    # One state of its own for every direction keeps the others out of its text. Of a model whose rates are
    # far apart the directions may be alike to rounding.
    chosen = qr(basis.T, pivoting=True, mode="r")[1][: basis.shape[1]]
    own = basis @ np.linalg.pinv(basis[chosen])
    own = own[:, np.any(own, axis=0)]
    return tuple(dict.fromkeys(combination_text(column, names) for column in own.T))


def unseen_note(directions: tuple[str, ...]) -> tuple[str, ...]:
    """One sentence on them, if there are any."""
    if not directions:
        return ()
    return (
        f"no output sees {'; or '.join(directions)}: where it starts is left open, "
        "and nothing else depends on it",
    )


def combination_text(vector: np.ndarray, names: tuple[str, ...]) -> str:
    """A direction of the state space in words, for example `a common change of phi and psi (1 : 0.5)`.
    Shapes: vector (n_states,)."""
    size = np.abs(vector)
    kept = np.flatnonzero(size > FIT.named_state * np.max(size))
    if kept.size == 1:
        return names[kept[0]]
    largest = vector[np.argmax(size)]
    weights = " : ".join(f"{np.real(vector[i] / largest):.3g}" for i in kept)
    listed = ", ".join(names[i] for i in kept[:-1]) + " and " + names[kept[-1]]
    return f"a common change of {listed} (in the ratio {weights})"
