"""What is known of parameters beforehand: Gaussian densities over their search coordinates.

A prior of a linear coordinate is a normal density; that of a logarithmic one is lognormal, with the median
`mean` and the relative standard deviation `std / mean`. Estimates then maximise the posterior density, and
their covariance is that of its curvature.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from daest.errors import EstimationError
from daest.estimation.coordinates import Coordinate, Unknowns
from daest.estimation.search import Evaluation, Found
from daest.model.prior import Prior

Evaluate = Callable[[np.ndarray, bool], Evaluation | None]


def with_priors(likelihood: Evaluate, unknowns: Unknowns) -> Evaluate:
    """The objective plus the negative logarithm of the prior densities, up to a constant.

    The search vector begins with the coordinates of `unknowns`; others have no prior.
    """
    if not any(c.prior for c in unknowns.coordinates):
        return likelihood
    mean, precision = prior_means(unknowns), prior_precisions(unknowns)

    def evaluate(z: np.ndarray, with_slopes: bool) -> Evaluation | None:
        here = likelihood(z, with_slopes)
        if here is None:
            return None
        value = here.value + prior_penalty(unknowns, z)
        if not with_slopes:
            return Evaluation(value)
        p = mean.size
        gradient, information = here.gradient.copy(), here.information.copy()
        gradient[:p] += precision * (z[:p] - mean)
        information[range(p), range(p)] += precision
        return Evaluation(value, gradient, information)

    return evaluate


def prior_penalty(unknowns: Unknowns, z: np.ndarray) -> float:
    """Σ (z - mean)² / (2 std²) over the coordinates with a prior."""
    p = len(unknowns.coordinates)
    return float(prior_precisions(unknowns) @ (z[:p] - prior_means(unknowns)) ** 2 / 2)


def log_likelihood(unknowns: Unknowns, found: Found) -> float:
    """Of the data alone, at the end of a search for the posterior mode."""
    return prior_penalty(unknowns, found.z) - found.evaluation.value


def prior_precisions(unknowns: Unknowns) -> np.ndarray:
    """1 / std² in z (p,), zero without a prior."""
    return np.array([0.0 if c.prior is None else _spread(c, c.prior) ** -2 for c in unknowns.coordinates])


def prior_means(unknowns: Unknowns) -> np.ndarray:
    """Means in z (p,), zero without a prior."""
    return np.array([0.0 if c.prior is None else c.searched(c.prior.mean) for c in unknowns.coordinates])


def _spread(coordinate: Coordinate, prior: Prior) -> float:
    return prior.std / (prior.mean if coordinate.is_log else coordinate.scale)


def coordinate_with_prior(coordinate: Coordinate, prior: Prior | None) -> Coordinate:
    """The coordinate with a prior. Errors `prior-std`, `prior-mean`."""
    if prior is None:
        return coordinate
    if not (np.isfinite(prior.std) and prior.std > 0.0):
        raise EstimationError(
            "prior-std",
            f"the prior of {coordinate.name} has the standard deviation {prior.std:g}",
            where=coordinate.name,
            remedy="give a number above zero; to hold the parameter use --fix NAME=VALUE",
        )
    is_inside = coordinate.lower <= prior.mean <= coordinate.upper and np.isfinite(prior.mean)
    if not is_inside or (coordinate.is_log and prior.mean <= 0.0):
        limits = f"[{coordinate.lower:.6g}, {coordinate.upper:.6g}]"
        raise EstimationError(
            "prior-mean",
            f"the prior mean {prior.mean:.6g} of {coordinate.name} lies outside its bounds {limits}"
            + (", where its logarithm is searched" if coordinate.is_log else ""),
            where=coordinate.name,
            remedy="give another mean, or other bounds (min, max)",
        )
    return replace(coordinate, prior=prior)
