"""What is searched: unknowns with the scale of each, priors over them, and the objective that is minimised.

What is known of parameters beforehand: Gaussian densities over their search coordinates.

A prior of a linear coordinate is a normal density; that of a logarithmic one is lognormal, with the median
`mean` and the relative standard deviation `std / mean`. Estimates then maximise the posterior density, and
their covariance is that of its curvature.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, Protocol, TypeVar

import numpy as np

from daest.errors import EstimationError
from daest.estimation.fitting.search import Evaluation, Found, Objective
from daest.estimation.gates import FIT
from daest.model.flat import Model
from daest.model.linear import StateSpaceFamily
from daest.model.parts import Prior

NEXT_TO_NOTHING = 0.01  # of what moves the outputs by what is left of them: a start value that tells no size


@dataclass(frozen=True)
class Coordinate:
    """One unknown. `index` counts in the model's parameters, noises or outputs. The search variable z is
    log(value) when `is_log`, else value / scale. Bounds are in the unit of the unknown, ±inf when absent."""

    name: str
    kind: Literal["parameter", "process", "measurement"]
    index: int
    initial: float
    is_log: bool
    scale: float
    lower: float
    upper: float
    prior: Prior | None = None
    is_nominal: bool = False  # whether the user gave the `scale`

    def searched(self, value: float) -> float:
        """z of a value."""
        if not self.is_log:
            return value / self.scale
        with np.errstate(divide="ignore"):
            return float(np.log(value))

    def natural(self, z: float) -> float:
        """Value of z, kept inside the bounds against rounding."""
        value = float(np.exp(z)) if self.is_log else z * self.scale
        return min(max(value, self.lower), self.upper)

    def slope(self, value: float) -> float:
        """∂value/∂z."""
        return value if self.is_log else self.scale


@dataclass(frozen=True)
class Unknowns:
    """All unknowns of an identification, in the order parameters, process noises, measurement noises; and the
    values of everything that is not searched."""

    coordinates: tuple[Coordinate, ...]
    theta: np.ndarray  # all parameters of the model
    intensity: np.ndarray  # (n_w,)
    measurement_std: np.ndarray  # (n_y,)

    @property
    def start(self) -> np.ndarray:
        """Start values of the search (p,)."""
        return np.array([c.searched(c.initial) for c in self.coordinates])

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the search variables (p,)."""
        return np.array([c.searched(c.lower) for c in self.coordinates])

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the search variables (p,)."""
        return np.array([c.searched(c.upper) for c in self.coordinates])

    @property
    def spread(self) -> np.ndarray:
        """How far a further start point may be from the given one: a factor of 10, or 3 linear scales.
        Shapes: (p,)."""
        return np.array([np.log(10.0) if c.is_log else 3.0 for c in self.coordinates])

    def with_initial_of(self, other: Unknowns) -> Unknowns:
        """These unknowns with the start values of the same ones in `other`."""
        pairs = zip(self.coordinates, other.coordinates, strict=True)
        return replace(self, coordinates=tuple(replace(c, initial=given.initial) for c, given in pairs))

    def started_at(self, values: Mapping[str, float]) -> Unknowns:
        """These unknowns with the start values of some parameters."""
        moved = tuple(replace(c, initial=values.get(c.name, c.initial)) for c in self.coordinates)
        theta = self.theta.copy()
        for c in moved:
            if c.name in values:
                theta[c.index] = c.initial
        return replace(self, coordinates=moved, theta=theta)

    def range_around(self, home: np.ndarray, within: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest further start points: between the bounds of the unknowns `within`, of the others
        as far from `home` as a further start may be, and not beyond a bound. Shapes: all (p,)."""
        low = np.where(within, self.lower, np.maximum(home - self.spread, self.lower))
        high = np.where(within, self.upper, np.minimum(home + self.spread, self.upper))
        return low, high

    def of_kind(self, kind: str) -> list[int]:
        return [i for i, c in enumerate(self.coordinates) if c.kind == kind]

    def natural(self, z: np.ndarray) -> np.ndarray:
        """Values (p,) of the search variables z (p,), each in its unit."""
        return np.array([c.natural(value) for c, value in zip(self.coordinates, z, strict=True)])

    def slopes(self, z: np.ndarray) -> np.ndarray:
        """∂value/∂z of every unknown. Shapes: z and slopes (p,)."""
        return np.array([c.slope(c.natural(value)) for c, value in zip(self.coordinates, z, strict=True)])

    def values(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(theta, intensity, measurement_std) at z."""
        found = {"parameter": self.theta.copy(), "process": self.intensity.copy()}
        found["measurement"] = self.measurement_std.copy()
        for coordinate, value in zip(self.coordinates, self.natural(z), strict=True):
            found[coordinate.kind][coordinate.index] = value
        return found["parameter"], found["process"], found["measurement"]

    def parameter_names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.coordinates if c.kind == "parameter")


def parameter_scale(value: float, nominal: float | None) -> float:
    """Size of one unit of a linear coordinate: the nominal value, else the start value, else 1."""
    return abs(nominal) if nominal else (abs(value) or 1.0)


def parameter_coordinate(
    family: StateSpaceFamily | Model,
    name: str,
    value: float,
    bounds: tuple[float | None, float | None],
) -> Coordinate:
    """Coordinate of a model parameter; scale "auto" is logarithmic where min >= 0 and the start is
    positive.
    """
    index = family.parameter_names.index(name)
    parameter = family.parameters[index]
    lower = -np.inf if bounds[0] is None else bounds[0]
    upper = np.inf if bounds[1] is None else bounds[1]
    is_log = parameter.scale == "log" or (parameter.scale == "auto" and lower >= 0.0)
    return Coordinate(
        name=name,
        kind="parameter",
        index=index,
        initial=value,
        is_log=is_log and value > 0.0,
        scale=parameter_scale(value, parameter.nominal),
        lower=float(max(lower, 0.0) if is_log and value > 0.0 else lower),
        upper=float(upper),
        prior=parameter.prior,
        is_nominal=bool(parameter.nominal),
    )


def rescaled(unknowns: Unknowns, start: Callable[[], Evaluation | None], n_observed: int) -> Unknowns:
    """The unknowns with units for those linear parameters whose start value tells none: it is zero, or next
    to nothing beside the change that moves the outputs by as much as is left of them at the `start`. What
    does nothing there, as a wall between two equal parts, keeps the unit of its value.

    A search moves no coordinate by more than a few units in one step: from an offset of 0 N in units of 1 N
    it would creep towards one of 800 N. The `start` is evaluated only if there are such parameters.
    """
    coordinates = list(unknowns.coordinates)
    linear = [i for i, c in enumerate(coordinates) if not (c.is_log or c.is_nominal)]
    here = start() if linear else None
    if here is None:
        return unknowns
    for i in linear:
        one, information = coordinates[i], float(here.information[i, i])
        does_something = information > FIT.rounded_influence * n_observed
        unit = one.scale * np.sqrt(n_observed / information) if does_something else 0.0
        if abs(one.initial) < NEXT_TO_NOTHING * unit:
            coordinates[i] = replace(one, scale=float(unit))
    return replace(unknowns, coordinates=tuple(coordinates))


def lost_ones(unknowns: Unknowns, z: np.ndarray, start: np.ndarray) -> list[int]:
    """The logarithmic parameters that have run off by orders of magnitude on the way from `start` to z.
    Shapes: z and start (n_z,)."""
    return [
        i
        for i, coordinate in enumerate(unknowns.coordinates)
        if coordinate.kind == "parameter" and coordinate.is_log and abs(z[i] - start[i]) > FIT.lost_log
    ]


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
    """Σ (z - mean)² / (2 std²) over the coordinates with a prior. Shapes: z (n_z,), whose first p entries are
    the coordinates."""
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


class Prediction(Protocol):
    """Predictions of all recordings at one point of a search."""

    @property
    def negative_log_likelihood(self) -> float: ...


Predicted = TypeVar("Predicted", bound=Prediction)


class Predictor(Protocol[Predicted]):
    """A model and recordings, and how the one predicts the other. A search vector z begins with the
    coordinates of `unknowns`; initial states that are not eliminated follow."""

    @property
    def unknowns(self) -> Unknowns: ...

    def predict(self, z: np.ndarray, with_slopes: bool = False) -> Predicted | None:
        """Predictions at z; None where there are none, as where numbers overflow. Shapes: z (n_z,)."""

    def derivatives(self, found: Predicted, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (p,) and Fisher information (p, p) of the negative log-likelihood along z, of predictions
        with slopes."""

    def tied(self, likelihood: Objective) -> Objective:
        """The objective with what ties initial states (`estimation.ties`); itself where they are free."""


_last: deque[tuple[object, np.ndarray, Evaluation]] = deque(maxlen=1)
"""The last evaluation with slopes, of a predictor at z: the check of a start asks for it before a search."""


def _known_at(predictor: object, z: np.ndarray) -> Evaluation | None:
    for of, at, evaluation in tuple(_last):
        if of is predictor and np.array_equal(at, z):
            return evaluation
    return None


def objective(predictor: Predictor[Predicted]) -> Objective:
    """Negative log-likelihood, priors and ties over the search vector, with gradient and information; None
    where there is no finite value."""

    @np.errstate(all="ignore")  # where numbers overflow, there is no value
    def evaluate(z: np.ndarray, with_slopes: bool) -> Evaluation | None:
        known = _known_at(predictor, z)
        if known is not None:
            return known if with_slopes else Evaluation(known.value)
        found = predictor.predict(z, with_slopes)
        if found is None or not np.isfinite(found.negative_log_likelihood):
            return None
        if not with_slopes:
            return Evaluation(found.negative_log_likelihood)
        gradient, information = predictor.derivatives(found, z)
        if not (np.all(np.isfinite(gradient)) and np.all(np.isfinite(information))):
            return None
        made = Evaluation(found.negative_log_likelihood, gradient, information)
        _last.append((predictor, z.copy(), made))
        return made

    return with_priors(predictor.tied(evaluate), predictor.unknowns)
