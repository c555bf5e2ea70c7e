"""Coordinates of the search: which unknowns there are, and the scale that each is searched in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from daest.model.flat import Model
from daest.model.linear import StateSpaceFamily
from daest.model.prior import Prior

LOST = np.log(1e3)  # times smaller or larger than its start: no slope is left for the way back


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
        return np.array([c.searched(c.initial) for c in self.coordinates])

    @property
    def lower(self) -> np.ndarray:
        return np.array([c.searched(c.lower) for c in self.coordinates])

    @property
    def upper(self) -> np.ndarray:
        return np.array([c.searched(c.upper) for c in self.coordinates])

    def of_kind(self, kind: str) -> list[int]:
        return [i for i, c in enumerate(self.coordinates) if c.kind == kind]

    def natural(self, z: np.ndarray) -> np.ndarray:
        return np.array([c.natural(value) for c, value in zip(self.coordinates, z, strict=True)])

    def slopes(self, z: np.ndarray) -> np.ndarray:
        """∂value/∂z of every unknown."""
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
    index = [p.name for p in family.parameters].index(name)
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
    )


def lost_ones(unknowns: Unknowns, z: np.ndarray, start: np.ndarray) -> list[int]:
    """The logarithmic parameters that have run off by orders of magnitude on the way from `start` to z."""
    return [
        i
        for i, coordinate in enumerate(unknowns.coordinates)
        if coordinate.kind == "parameter" and coordinate.is_log and abs(z[i] - start[i]) > LOST
    ]
