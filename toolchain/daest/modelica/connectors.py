"""Connectors of physical domains, known by the names of their two variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from daest.model.effects import Domain
from daest.model.parts import Variable

# (potential, flow) -> domain, as in the Modelica Standard Library; hydraulic connectors carry a volume flow.
DOMAINS: dict[tuple[str, str], Domain] = {
    ("phi", "tau"): "rotational",
    ("s", "f"): "translational",
    ("v", "i"): "electrical",
    ("T", "Q_flow"): "thermal",
    ("p", "q"): "hydraulic",
}


@dataclass(frozen=True)
class Connector:
    """A connector with one potential and one flow; the two are positions among the unknowns."""

    name: str
    domain: Domain
    potential: int
    flow: int

    @property
    def component(self) -> str:
        """The component that it belongs to; empty for a connector of the model itself."""
        return self.name.rpartition(".")[0]


def connectors_of(unknowns: Sequence[Variable]) -> dict[str, Connector]:
    """All connectors among the unknowns whose variables have the names of a domain, by name, in their
    order."""
    position = {unknown.name: i for i, unknown in enumerate(unknowns)}
    found: dict[str, Connector] = {}
    for i, unknown in enumerate(unknowns):
        if not unknown.is_flow:
            continue
        name, _, flow = unknown.name.rpartition(".")
        for (potential, wanted), domain in DOMAINS.items():
            if flow == wanted and f"{name}.{potential}" in position:
                found[name] = Connector(name, domain, position[f"{name}.{potential}"], i)
    return found
