"""A fleet: one model, and a recording of each of many machines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Machine:
    """What became of one machine.

    `status`: "converged" and the other ends of a fit, or "failed"; `message` says more. `parameters` name:
    (value, standard error). `fit_percent` by output, on the later half of the recording. `verdict`: "not
    falsified", else that of the diagnosis. `effect`, `at`, `size` in `size_unit`: what is missing, where that
    could be told; `places` are those that the sensors cannot tell from `at`.
    """

    name: str
    status: str
    message: str = ""
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fit_percent: Mapping[str, float] = field(default_factory=dict)
    verdict: str | None = None
    effect: str | None = None
    at: str | None = None
    size: float | None = None
    size_unit: str = ""
    places: tuple[str, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True)
class Group:
    """Machines that lack the same effect at the same place."""

    effect: str
    at: str
    machines: tuple[str, ...]


@dataclass(frozen=True)
class Spread:
    """A parameter over the machines that nothing is missing from: `mean`, standard deviation `std`, and the
    root mean square `mean_std_error` of its own standard errors; `n` machines."""

    mean: float
    std: float
    mean_std_error: float
    n: int


@dataclass(frozen=True)
class Odd:
    """A machine whose parameter lies `distance` standard deviations from the middle of the fleet, those of
    the fleet and of the estimate together."""

    machine: str
    parameter: str
    value: float
    distance: float


@dataclass(frozen=True)
class Fleet:
    machines: tuple[Machine, ...]
    groups: tuple[Group, ...]
    spread: Mapping[str, Spread]
    odd: tuple[Odd, ...]
