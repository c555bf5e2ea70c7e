"""The document of `daest fleet`."""

from __future__ import annotations

import math
from typing import Annotated, NotRequired, TypedDict

from daest.model.fleet import Fleet, Machine
from daest.report.documents.parts import entry


class Estimated(TypedDict):
    value: float | None
    std_error: float | None


class MachineEntry(TypedDict):
    name: str
    status: Annotated[str, "of the fit, or failed"]
    message: str
    parameters: dict[str, Estimated]
    fit_percent: Annotated[dict[str, float | None], "of the later half of the recording, by output"]
    verdict: str | None
    effect: str | None
    at: str | None
    size: float | None
    size_unit: NotRequired[str]
    seconds: NotRequired[float]


class GroupEntry(TypedDict):
    effect: str
    at: str
    machines: list[str]


class SpreadEntry(TypedDict):
    mean: float | None
    std: Annotated[float | None, "over the machines that nothing is missing from"]
    mean_std_error: Annotated[float | None, "root mean square of their standard errors"]
    n: NotRequired[int]


class OddEntry(TypedDict):
    machine: str
    parameter: str
    value: float
    distance: Annotated[float, "standard deviations of fleet and estimate together"]


class FleetDocument(TypedDict):
    """A fleet of machines with one model."""

    machines: list[MachineEntry]
    groups: Annotated[list[GroupEntry], "machines that lack the same effect at the same place"]
    spread: dict[str, SpreadEntry]
    odd: NotRequired[list[OddEntry]]
    n_failed: NotRequired[int]
    model: NotRequired[str]
    seconds: NotRequired[float]


def document(fleet: Fleet, model: str, seconds: float) -> FleetDocument:
    """JSON-ready; numbers that do not exist are None."""
    return entry(
        FleetDocument,
        fleet,
        machines=[machine_entry(machine) for machine in fleet.machines],
        n_failed=sum(machine.status == "failed" for machine in fleet.machines),
        model=model,
        seconds=seconds,
    )


def machine_entry(machine: Machine) -> MachineEntry:
    """One machine."""
    parameters = machine.parameters.items()
    estimated = {name: {"value": value, "std_error": error} for name, (value, error) in parameters}
    return entry(MachineEntry, machine, parameters=estimated)


def columns(fleet: Fleet) -> dict[str, list[object]]:
    """The table of the machines as columns: name, status, verdict, effect, at, size, then value and standard
    error of each parameter and the fit of each output."""
    machines = fleet.machines
    found: dict[str, list[object]] = {
        name: [getattr(machine, name) for machine in machines]
        for name in ("name", "status", "message", "verdict", "effect", "at", "size", "size_unit", "seconds")
    }
    for name in dict.fromkeys(name for machine in machines for name in machine.parameters):
        pairs = [machine.parameters.get(name, (math.nan, math.nan)) for machine in machines]
        found[name] = [_number(value) for value, _ in pairs]
        found[f"{name}.std_error"] = [_number(error) for _, error in pairs]
    for name in dict.fromkeys(name for machine in machines for name in machine.fit_percent):
        values = [machine.fit_percent.get(name, math.nan) for machine in machines]
        found[f"fit_percent.{name}"] = [_number(value) for value in values]
    return found


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
