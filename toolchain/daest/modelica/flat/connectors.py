"""Connectors of physical domains, known by the names of their two variables or by their units; and members of
expandable connectors that nothing uses: they are no variables of the model (Language Specification 9.1.3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

from daest.model.effects import Domain
from daest.model.parts import Variable
from daest.modelica.flat.parameters import is_parameter, referenced_names
from daest.modelica.language import syntax as s
from daest.quantities import conversion, converts, is_of

# (potential, flow) -> domain, as in the Modelica Standard Library; hydraulic connectors carry a volume flow.
DOMAINS: dict[tuple[str, str], Domain] = {
    ("phi", "tau"): "rotational",
    ("s", "f"): "translational",
    ("v", "i"): "electrical",
    ("T", "Q_flow"): "thermal",
    ("p", "q"): "hydraulic",
    ("amount", "inflow"): "amount",
}

NAMES: dict[Domain, tuple[str, str]] = {domain: names for names, domain in DOMAINS.items()}
MASS_FLOW = "kg/s"  # of a gas, say: the laws are those of volume flows, with kg for m3 in their units
LEVEL = "m"  # of a liquid, beside flows or areas: the laws are those of pressures, with m for Pa
# Unit of the flows of a domain in the laws of the library.
FLOWS: dict[Domain, str] = {
    "translational": "N",
    "rotational": "N.m",
    "thermal": "W",
    "hydraulic": "m3/s",
    "electrical": "A",
    "amount": "1/s",  # of what there is one: every store counts in its own unit
}
# The same by units, for a connector that calls them otherwise.
_UNITS: dict[tuple[str, str], Domain] = {
    ("rad", "N.m"): "rotational",
    ("m", "N"): "translational",
    ("V", "A"): "electrical",
    ("K", "W"): "thermal",
    ("degC", "W"): "thermal",
    ("Pa", "m3/s"): "hydraulic",
    ("Pa", MASS_FLOW): "hydraulic",
    (LEVEL, "m3/s"): "hydraulic",
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

    def variables(self, unknowns: Sequence[Variable]) -> tuple[str, str]:
        """The full names of its potential and of its flow."""
        return unknowns[self.potential].name, unknowns[self.flow].name


def flow_scale(unit: str, domain: Domain) -> float:
    """How many of the domain's unit a flow of 1 in `unit` is: 1000 for kW; 1 for a unit of another kind.

    >>> flow_scale("kW", "thermal"), flow_scale("kg/s", "hydraulic")
    (1000.0, 1.0)
    """
    wanted = FLOWS[domain]
    return conversion(unit, wanted).scale if is_of(unit, wanted) and converts(unit, wanted) else 1.0


@cache
def _by_units(potential: str, flow: str) -> Domain | None:
    """The domain of a connector by its units, which may be others of the same quantities."""
    if (potential, flow) in _UNITS:
        return _UNITS[potential, flow]
    for (wanted, wanted_flow), domain in _UNITS.items():
        pairs = ((potential, wanted), (flow, wanted_flow))
        if wanted != "rad" and all(is_of(unit, of) and converts(unit, of) for unit, of in pairs):
            return domain
    return None


def connectors_of(unknowns: Sequence[Variable]) -> dict[str, Connector]:
    """All connectors among the unknowns whose variables have the names of a domain, or are one potential and
    one flow in its units, by name, in their order."""
    position = {unknown.name: i for i, unknown in enumerate(unknowns)}
    members: dict[str, list[int]] = {}
    for i, unknown in enumerate(unknowns):
        members.setdefault(unknown.name.rpartition(".")[0], []).append(i)
    found: dict[str, Connector] = {}
    for i, unknown in enumerate(unknowns):
        if not unknown.is_flow:
            continue
        name, _, flow = unknown.name.rpartition(".")
        for (potential, wanted), domain in DOMAINS.items():
            if flow == wanted and f"{name}.{potential}" in position:
                found[name] = Connector(name, domain, position[f"{name}.{potential}"], i)
        if name and name not in found and len(members[name]) == 2:
            other = next(one for one in members[name] if one != i)
            by_unit = _by_units(unknowns[other].unit, unknown.unit)
            if by_unit is not None:
                found[name] = Connector(name, by_unit, other, i)
    return found


def outside_of_term(end: str) -> str:
    """The connector of a class that stands for that of one of its terms.

    >>> outside_of_term("ram.v_term.flange")
    'ram.v_term_flange'
    """
    term, _, connector = end.rpartition(".")
    return f"{term}_{connector}"


def without_empty_members(source: s.FlatSource) -> s.FlatSource:
    """The source without members of expandable connectors that are connected to each other alone."""
    members = {x.name for x in source.variables if x.is_bus_member and x.binding is None}
    if not members:
        return source
    pairs = [pair for e in source.equations if (pair := _ends(e)) is not None]
    used = set(_used(source)) & members
    used |= {one for pair in pairs if not set(pair) <= members for one in pair}
    waiting = pairs
    while waiting:
        reached = [pair for pair in waiting if used & set(pair)]
        used |= {one for pair in reached for one in pair}
        waiting = [pair for pair in waiting if pair not in reached] if reached else []
    empty = members - used
    if not empty:
        return source
    return replace(
        source,
        variables=tuple(x for x in source.variables if x.name not in empty),
        equations=tuple(e for e in source.equations if not set(_ends(e) or ()) & empty),
    )


def _ends(equation: s.FlatEquation) -> tuple[str, str] | None:
    """The variables that a connection equates."""
    left, right = equation.left, equation.right
    if equation.kind == "connection" and isinstance(left, s.Name) and isinstance(right, s.Name):
        return left.name, right.name
    return None


def _used(source: s.FlatSource) -> Iterable[str]:
    """Names in all that is no connection."""
    for equation in source.equations:
        if _ends(equation) is None:
            yield from referenced_names((equation.left, equation.right))
    yield from referenced_names(tuple(x.binding for x in source.variables if not is_parameter(x)))
    others = (source.initial_equations, source.algorithms, source.initial_algorithms, source.whens)
    yield from referenced_names(others)
