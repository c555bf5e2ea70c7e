"""Joints between the connectors of a model that call their variables otherwise, such as a temperature `T`
and a heat flow `Q`, and those of the library: components with one connector of either kind."""

from __future__ import annotations

from dataclasses import dataclass

from daest.model.effects import Domain
from daest.model.flat import FlatModel
from daest.modelica.flat.connectors import NAMES, Connector, flow_scale
from daest.modelica.language.components import Classes
from daest.modelica.language.outline import class_heads
from daest.modelica.places.balances import converted_text, in_connectors
from daest.quantities import Conversion

PORTS: dict[Domain, str] = {
    "rotational": "Daest.Mechanics.Rotational.Interfaces.Flange_b",
    "translational": "Daest.Mechanics.Translational.Interfaces.Flange_b",
    "electrical": "Daest.Electrical.Analog.Interfaces.NegativePin",
    "thermal": "Daest.Thermal.HeatTransfer.Interfaces.HeatPort_b",
    "hydraulic": "Daest.Hydraulic.Interfaces.Port_b",
    "amount": "Daest.Effects.Amounts.Interfaces.Port",
}


@dataclass(frozen=True)
class Joint:
    """The text of the component, and of its class where that is new, with the connectors `own` and `port`."""

    text: str
    own: str
    port: str


def needs_joint(flat: FlatModel, connector: Connector) -> bool:
    """Whether the variables of a connector have other names or units than those of the library."""
    potential, flow = flat.unknowns[connector.potential].unit, flat.unknowns[connector.flow].unit
    return (
        _variables(flat, connector) != NAMES[connector.domain]
        or in_connectors(potential) != Conversion()
        or flow_scale(flow, connector.domain) != 1.0
    )


def joint(
    source: bytes,
    class_name: str,
    flat: FlatModel,
    connector: Connector,
    name: str,
    known: dict[tuple[str, ...], str],
) -> Joint | None:
    """The joint `name` for a connector of class `class_name` of the text; None where the text does not hold
    the class of the connector. Classes of joints are `known` by what they hold: a new one is put there."""
    heads = {head.name for head in class_heads(source)}
    classes = Classes(lambda full: source if full in heads else None)
    scope: str | None = class_name
    for part in connector.name.split("."):
        name_of_array = part.partition("[")[0]
        found = None if scope is None else classes.component(name_of_array, scope)
        scope = None if found is None else classes.type_of(found)
    if scope is None:
        return None
    potential, flow = _variables(flat, connector)
    wanted, wanted_flow = NAMES[connector.domain]
    own = converted_text(f"own.{potential}", in_connectors(flat.unknowns[connector.potential].unit))
    scale = flow_scale(flat.unknowns[connector.flow].unit, connector.domain)
    entering = f"own.{flow}" if scale == 1.0 else f"{scale!r}*own.{flow}"
    lines = (
        f"  {scope} own;",
        f"  {PORTS[connector.domain]} port;",
        "equation",
        f"  port.{wanted} = {own};",
        f"  {entering} + port.{wanted_flow} = 0;",
    )
    is_new = lines not in known
    kind = known.setdefault(lines, name[:1].upper() + name[1:])
    opening = f'model {kind} "Joins connectors whose variables have other names"'
    of_class = (opening, *lines, f"end {kind};") if is_new else ()
    return Joint("\n".join((*of_class, f"{kind} {name};")), f"{name}.own", f"{name}.port")


def _variables(flat: FlatModel, connector: Connector) -> tuple[str, str]:
    """The names of its potential and of its flow, within it."""
    potential, flow = connector.variables(flat.unknowns)
    return potential.rpartition(".")[2], flow.rpartition(".")[2]
