"""Where in a model an effect can sit: found from names, flow flags and equations of the FlatModel alone."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.lists import first_few
from daest.model.effects import Domain, Effect, Site
from daest.model.flat import FlatModel, Model
from daest.model.parts import Parameter
from daest.modelica.flat.connectors import FLOWS, Connector, connectors_of, flow_scale
from daest.modelica.places.balances import Balance, balances, domain_of, in_connectors, slopes_near_start
from daest.modelica.places.equal_places import equal_places
from daest.modelica.places.inner_signals import inner_signals, is_lag
from daest.modelica.places.internal_forces import internal_forces
from daest.modelica.places.meshes import meshes
from daest.modelica.places.place_units import balances_flows, carries_gas, flow_of
from daest.modelica.places.terminals import terminals
from daest.near import did_you_mean
from daest.quantities import converts, in_base_units, is_of

# Rows of a component are linearised at a random point; a combination of rows is found with this relative
# residual.
_TOLERANCE = 1e-9
# Exchange between bodies that no component joins is plausible in these domains (air, radiation, leaks).
_PAIRED: tuple[Domain, ...] = ("thermal", "hydraulic")
BEHIND_OUTPUT = "_actual"  # ends the name of the variable that equations hold behind an output
_MOST_LISTED = 12  # places in a message
_OF_NATURE = {  # in base units: gravity, and the constants of gases, radiation and charge
    "m/s2": 9.81,
    "J/(mol.K)": 8.314,
    "W/(m2.K4)": 5.670e-8,
    "C/mol": 96485.0,
}
_SIGNALS: dict[str, tuple[str, ...]] = {  # what is attached to a signal of each kind
    "input": ("signal", "input"),
    "output": ("signal", "output"),
    "signal": ("signal", "input"),
    "parameter": ("parameter",),
}
# The places of the models that were asked for last: every effect of a search asks for those of one model.
_found: deque[tuple[FlatModel, tuple[Site, ...]]] = deque(maxlen=8)


@dataclass(frozen=True)
class ConnectionSet:
    """Connectors that one flow sum joins: `row` is its equation, `members` the connectors in its order."""

    row: int
    members: tuple[str, ...]

    def is_outside(self, connector: str) -> bool:
        """Whether `connector` is that of a composite whose parts the set joins."""
        outer = connector.rpartition(".")[0]
        others = (m.rpartition(".")[0] for m in self.members if m != connector)
        return any(other != outer and (not outer or other.startswith(f"{outer}.")) for other in others)


def sites(flat: Model) -> tuple[Site, ...]:
    """All places of the model: nodes, two-terminal components, pairs of thermal and hydraulic nodes,
    connectors where something can be put in series, balances of bare equations, forces, meshes and terminals
    in them, inputs, outputs, signals inside and tunable parameters. A model without equations has inputs and
    outputs alone."""
    signals = (
        *(Site(x.name, "input", "signal") for x in flat.inputs),
        *(Site(y.name, "output", "signal") for y in flat.outputs),
    )
    if not isinstance(flat, FlatModel):
        return signals
    for model, places in _found:
        if model is flat:
            return places
    physical = _physical(flat)
    amounts = _amounts(flat)
    places = (
        *physical,
        *amounts,
        *equal_places(flat, [*physical, *amounts]),
        *signals,
        *_inside(flat, physical),
        *(Site(name, "parameter", "signal") for name in used_parameters(flat)),
    )
    _found.append((flat, places))
    return places


def unused_inputs(flat: Model) -> tuple[str, ...]:
    """The inputs that no equation and no output of a model depends on: they may be recorded and wait for the
    law that needs them. None of a model without equations."""
    if not isinstance(flat, FlatModel) or not flat.u.numel():
        return ()
    events = (
        () if flat.events is None else tuple(p for p in vars(flat.events).values() if isinstance(p, ca.SX))
    )
    used = ca.which_depends(ca.veccat(flat.residual, flat.output_expressions, *events), flat.u, 1, False)
    return tuple(x.name for x, is_used in zip(flat.inputs, used, strict=True) if not is_used)


def sites_left(declared: Model, grown: Model) -> tuple[Site, ...]:
    """The places of the model as it was `declared` that are there in the one to which effects were added:
    what bends a signal stands between that and the bodies on which it would be a force."""
    if grown is declared or not isinstance(grown, FlatModel):
        return sites(declared)
    left = {site.name for site in _forces(grown)}
    return tuple(site for site in sites(declared) if site.kind != "force" or site.name in left)


def _physical(flat: FlatModel) -> tuple[Site, ...]:
    """The places of effects in a physical domain."""
    net = Network(flat)
    return (
        *net.nodes(),
        *_with_gases(flat, [*net.components(), *_pairs(net)]),
        *net.cuts(),
        *_equations(flat),
        *_exchanges(flat),
        *_forces(flat),
        *(Site(one.name(flat), "mesh", one.domain, aliases=one.aliases(flat)) for one in meshes(flat)),
        *(Site(one.name(flat), "terminal", "electrical") for one in terminals(flat)),
    )


def _inside(flat: FlatModel, physical: Sequence[Site]) -> list[Site]:
    """Signals inside of a model, besides its `physical` places; not where events may switch them. What a
    filter between potentials makes, as `T*der(v) = u - v` does, where no flow is known, is a signal like any
    other."""
    if flat.events is not None:
        return []
    of_filters = {
        balance.name(flat)
        for balance in balances(flat)
        if is_lag(flat, balance.row, balance.variable) and not balances_flows(flat, balance)
    }
    places = [site for site in physical if site.kind != "equation" or site.name not in of_filters]
    taken = {name for site in places for name in (site.name, *site.aliases)}
    flows = {site.aliases[-1] for site in places if site.kind == "mesh"}
    found = inner_signals(flat, {site.domain for site in places}, taken, flows)
    return [Site(one.name(flat), "signal", "signal", limits_only=one.limits_only) for one in found]


def _equations(flat: FlatModel, domain: Domain | None = None) -> list[Site]:
    """Balances among the model's own equations whose domain the unit of their variable tells, or is `domain`
    where it has no unit."""
    found: list[Site] = []
    for balance in _of_fitting_units(flat):
        unit = balance.potential(flat).unit
        own = balance.domain(flat) if unit else domain
        if own is not None:
            found.append(_at_balance(flat, balance, own))
    return found


def _for_effect(flat: FlatModel, effect: Effect) -> list[Site]:
    """The balances where an effect is put in by name: its domain tells that of a variable without a unit."""
    told = _amounts(flat) if effect.domain == "amount" else []
    return [*_equations(flat, effect.domain), *told]


def _amounts(flat: FlatModel) -> list[Site]:
    """Balances among the model's own equations of what belongs to no physical domain (`is_amount`)."""
    return [_at_balance(flat, one, "amount") for one in balances(flat) if one.is_amount(flat)]


def _at_balance(flat: FlatModel, balance: Balance, domain: Domain) -> Site:
    names = dict.fromkeys((flat.unknowns[balance.variable].name, balance.potential(flat).name))
    aliases = (flat.equations[balance.row].text, *names)
    return Site(balance.name(flat), "equation", domain, aliases=aliases)


def _of_fitting_units(flat: FlatModel) -> list[Balance]:
    """The balances; of a row with several rates those whose terms are flows of their domain, if there are
    any: `m*l*der(v) + m*l^2*der(w) = …` is a sum of torques, where a force on v has no place."""
    known = balances(flat)
    rows = [balance.row for balance in known]
    shared = [balance for balance in known if rows.count(balance.row) > 1]
    fitting = [balance for balance in shared if balances_flows(flat, balance)]
    told = {balance.row for balance in fitting}
    return [balance for balance in known if balance.row not in told or balance in fitting]


def untold_balances(flat: FlatModel) -> list[Site]:
    """Balances whose domain no unit tells, among the model's own equations, or else among those of its
    components: a load may act there, and no effect of the library but those of signals fits."""
    own = [one for one in balances(flat) if one.domain(flat) is None]
    return [
        Site(one.name(flat), "equation", "signal", aliases=(flat.equations[one.row].text,))
        for one in own or balances(flat, everywhere=True)
    ]


def _exchanges(flat: FlatModel) -> list[Site]:
    """Pairs of balances of heat, of volume or of a gas among the model's own equations, and of a balance of
    heat and a temperature that is an input in one of them."""
    kinds = [(b, b.domain(flat), (flow_of(flat, b)[0], b.is_level(flat))) for b in balances(flat)]
    known = [(b, domain, kind) for b, domain, kind in kinds if domain in _PAIRED and kind[0]]
    found: list[Site] = []
    for (a, domain, kind), (b, other, of_b) in combinations(known, 2):
        if domain == other and kind == of_b:
            variables = ", ".join(one.potential(flat).name for one in (a, b))
            found.append(_exchange(f"{a.name(flat)}, {b.name(flat)}", domain, variables))
    return [*found, *_exchanges_with_surroundings(flat, [b for b, domain, _ in known if domain == "thermal"])]


def _exchange(name: str, domain: Domain, variables: str) -> Site:
    return Site(name, "exchange", domain, aliases=(variables,))


def _exchanges_with_surroundings(flat: FlatModel, heats: Sequence[Balance]) -> list[Site]:
    """What a wall hides from the air today, a draught may reach: surroundings that any of the balances of
    heat feels are a place beside every one of them."""
    if not heats:
        return []
    used = ca.which_depends(flat.residual[[b.row for b in heats]], flat.u, 1, False)
    surroundings = [
        one.name
        for one, is_used in zip(flat.inputs, used, strict=True)
        if is_used and domain_of(one.unit) == "thermal"
    ]
    return [
        _exchange(f"{balance.name(flat)}, {name}", "thermal", f"{balance.potential(flat).name}, {name}")
        for balance in heats
        for name in surroundings
    ]


def _forces(flat: FlatModel) -> list[Site]:
    """Forces between the bodies of the model's own equations."""
    return [
        Site(
            force.name(flat),
            "force",
            force.domain,
            aliases=force.aliases(flat),
            parameters=force.coefficients(flat),
            is_grounded=force.is_grounded,
        )
        for force in internal_forces(flat)
    ]


def used_parameters(flat: FlatModel) -> list[str]:
    """Tunable parameters that the equations depend on (intensities of noises do not count)."""
    pattern = ca.jacobian_sparsity(ca.vertcat(flat.residual, flat.output_expressions), flat.theta)
    return [flat.parameters[i].name for i in sorted(set(pattern.get_col()))]


def changeable(flat: Model) -> list[Site]:
    """The parameters that may change while a machine runs: not the constants of nature."""
    given = {p.name: p for p in flat.parameters}
    return [s for s in sites(flat) if s.kind == "parameter" and not _is_of_nature(given[s.name])]


def _is_of_nature(parameter: Parameter) -> bool:
    """Whether a given parameter has the unit and, to half a percent, the value of a constant of nature."""
    if parameter.estimate:
        return False
    value = parameter.value * in_base_units(parameter.unit)
    return any(
        is_of(parameter.unit, unit) and abs(value - constant) < 5e-3 * constant
        for unit, constant in _OF_NATURE.items()
    )


def fits(effect: Effect, site: Site) -> bool:
    """Whether the effect can be attached at the site; at equal places those alone that bring no state."""
    if site.parts:
        is_stateless = not effect.n_states and (effect.is_of_store or not effect.is_dynamic)
        return is_stateless and all(fits(effect, part) for part in site.parts)
    if site.kind in _SIGNALS:
        return effect.attach in _SIGNALS[site.kind] and (effect.is_limit or not site.limits_only)
    if effect.domain != site.domain or (effect.is_of_gas and not site.carries_gas):
        return False
    if site.kind in ("node", "equation"):
        return effect.attach == "connector" and (site.kind == "equation" or not effect.is_of_equation)
    if site.kind in ("connector", "mesh", "terminal"):
        return effect.attach == "series"
    if effect.attach == "connector":  # beside a spring to what does not move it would be one at the body
        is_apart = site.kind == "component" or (site.kind == "force" and not site.is_grounded)
        return effect.has_support and is_apart
    return effect.attach == "parallel" and all(
        not p.required or p.given_from in site.given for p in effect.parameters
    )


def find_site(flat: Model, name: str, effect: Effect | None = None, number: int = 0) -> Site:
    """The place called `name` (a site, one of its aliases, or two connectors `a, b`), where `effect` fits if
    it is given: a component means its first connector to an effect in series. Of a bare equation that has
    another row than its name tells, `number` counts among those for the same variable (`number_of`). What
    has been put before an output has left the equations the variable behind it.

    Raises ModelError `effect-place` for an unknown place with the nearest names, `effect-fit` for one where
    the effect does not fit, with the places where it does.
    """
    known = sites(flat)
    wanted = ", ".join(part.strip() for part in name.split(","))
    found = [site for site in known if wanted in (site.name, *site.aliases)]
    if isinstance(flat, FlatModel):
        found += _pair_named(flat, wanted)
    if effect is not None and isinstance(flat, FlatModel):
        # Without a unit the effect tells the domain; what was put in elsewhere changes the number of a row.
        own, variable = _for_effect(flat, effect), wanted.rpartition(":")[2]
        bodies = ", ".join(part.rpartition(":")[2] for part in wanted.split(", "))
        between = [s for s in known if s.kind in ("exchange", "force", "mesh") and s not in found]
        found += [s for s in between if bodies == s.aliases[-1]]
        alike = [s for s in own if variable in s.aliases[1:] and fits(effect, s)]
        found += [s for s in own if wanted == s.name] or alike[number : number + 1] or alike
    if effect is not None and effect.attach == "series":
        found += _first_connector(found, known)
    fitting = found if effect is None else [site for site in found if fits(effect, site)]
    if fitting:
        return fitting[0]
    behind = _behind_outputs(flat, wanted)
    if behind != wanted:
        return find_site(flat, behind, effect, number)
    if found and effect is not None:
        raise _unfit(effect, found[0], known)
    raise _unknown(name, known, effect)


def _behind_outputs(flat: Model, name: str) -> str:
    """The name of a place with the variables that equations hold since something stands before an output."""
    inner = {y.name: f"{y.name}{BEHIND_OUTPUT}" for y in flat.outputs}
    known = {x.name for x in flat.unknowns} if isinstance(flat, FlatModel) else set()
    parts = re.split(r"([^\w.]+)", name)
    return "".join(inner[part] if inner.get(part) in known else part for part in parts)


def number_of(flat: Model, site: Site, effect: Effect) -> int:
    """Which of the bare equations for its variable a site of the model is, from 0: coupled masses give the
    rate of a speed in several. What is put in elsewhere changes their rows, and not their order."""
    if not isinstance(flat, FlatModel) or site.kind != "equation":
        return 0
    own = [s for s in _for_effect(flat, effect) if s.aliases[1] == site.aliases[1]]
    alike = [s.name for s in own if fits(effect, s)]
    return alike.index(site.name) if site.name in alike else 0


def find_effect_site(flat: Model, effects: Sequence[Effect], place: str) -> tuple[Effect, Site]:
    """The first of `effects`, which have one name, that fits at the place called `place`, and that place.

    Raises what `find_site` raises. Of effects that several domains have, the one of this model tells best why
    it does not fit.
    """
    known = sites(flat)
    problems: list[ModelError] = []
    for effect in sorted(effects, key=lambda effect: not any(fits(effect, site) for site in known)):
        try:
            return effect, find_site(flat, place, effect)
        except ModelError as problem:
            problems.append(problem)
    raise problems[0]


def _first_connector(found: Sequence[Site], known: Sequence[Site]) -> list[Site]:
    ends = {site.connectors[0] for site in found if site.kind == "component"}
    return [s for s in known if s.kind == "connector" and ends & {s.name, *s.aliases}]


def _pair_named(flat: FlatModel, name: str) -> list[Site]:
    """The pair of nodes that `a, b` names, whether or not it is listed among the sites."""
    ends = name.split(", ")
    connectors = connectors_of(flat.unknowns)
    if len(ends) != 2 or any(end not in connectors for end in ends):
        return []
    a, b = (connectors[end] for end in ends)
    found = [Site(name, "pair", a.domain, (a.name, b.name))] if a.domain == b.domain else []
    return _with_gases(flat, found)


def _with_gases(flat: FlatModel, lines: Sequence[Site]) -> list[Site]:
    """The `lines` between connectors, with what is known of those that may carry a gas."""
    return [replace(line, carries_gas=carries_gas(flat, line)) for line in lines]


def _unknown(name: str, known: Sequence[Site], effect: Effect | None) -> ModelError:
    usable = [site for site in known if effect is None or fits(effect, site)]
    names = [n for site in usable for n in (site.name, *site.aliases)]
    hint = did_you_mean(name, names)
    where = f"{effect.name} fits at" if effect is not None else "Places are"
    return ModelError(
        "effect-place",
        f"the model has no place `{name}`",
        remedy=f"{hint}{where}: {_listed(usable)}.",
    )


def _unfit(effect: Effect, site: Site, known: Sequence[Site]) -> ModelError:
    usable = [one for one in known if fits(effect, one)]
    what = site.told if site.kind not in _SIGNALS else f"the {site.kind}"
    why = ""
    if effect.attach == "parallel" and site.domain == effect.domain and site.kind == "component":
        missing = [p.given_from for p in effect.parameters if p.required and p.given_from not in site.given]
        why = f" which has no parameter {' or '.join(missing)}" if missing else ""
    remedy = f"It fits at: {_listed(usable)}." if usable else "It fits nowhere in this model."
    return ModelError(
        "effect-fit",
        f"{effect.name} ({effect.domain}, {_wanted(effect)}) does not fit at `{site.name}`, {what}{why}",
        remedy=remedy,
    )


def _wanted(effect: Effect) -> str:
    return {
        "connector": "at a connector",
        "parallel": "in parallel to a component",
        "series": "in series with a connector",
        "signal": "at an input, an output or a signal inside",
        "input": "at an input or a signal inside",
        "output": "at an output",
        "parameter": "at a parameter",
    }[effect.attach]


def _listed(usable: Sequence[Site]) -> str:
    # A node and a cut through it go by the same name.
    return first_few(list(dict.fromkeys(f"`{site.name}`" for site in usable)), _MOST_LISTED)


class Network:
    """The connection sets of a model and what its components do between their connectors."""

    def __init__(self, flat: FlatModel) -> None:
        self.flat = flat
        self.connectors = connectors_of(flat.unknowns)
        self.sets = connection_sets(flat, self.connectors)
        self._owner: dict[str, list[int]] = {}
        for i, one in enumerate(self.sets):
            for member in one.members:
                self._owner.setdefault(member, []).append(i)
        self._components: dict[str, list[Connector]] = {}
        for connector in self.connectors.values():
            self._components.setdefault(connector.component, []).append(connector)
        self._rows = _rows_by_component(flat)
        self._slopes = slopes_near_start(flat)
        self._groups = self._joined()

    def node_of(self, connector: str) -> int:
        """A number that the connectors of one node share; -1 for a connector in no connection set."""
        return self._groups.get(connector, -1)

    def nodes(self) -> list[Site]:
        """One site per node: connection sets, those on both sides of a composite's connector or of a rigid
        body being one. Nodes that a component holds at a constant potential (ground) are left out: no flow
        moves them."""
        return [self._node(names) for names in self._members().values() if not self.is_held(names)]

    def all_nodes(self) -> list[Site]:
        """The nodes with those at a constant potential."""
        return [self._node(names) for names in self._members().values()]

    def _members(self) -> dict[int, list[str]]:
        members: dict[int, list[str]] = {}
        for name, group in self._groups.items():
            members.setdefault(group, []).append(name)
        return members

    def _node(self, names: Sequence[str]) -> Site:
        """Named after a connector of a component that stores something, as a body does, else after its
        first."""
        stores = sorted(filter(self._stores, names), key=lambda name: self._is_alone(name))
        first = stores[0] if stores else names[0]
        others = tuple(name for name in names if name != first)
        components = dict.fromkeys(self.connectors[n].component for n in stores)
        aliases = (*others, *(c for c in components if c))
        return Site(first, "node", self.connectors[first].domain, tuple(names), aliases)

    def components(self) -> list[Site]:
        """Components (and parts of them) where what flows in at one connector flows out at the other."""
        found: list[Site] = []
        for component, members in self._components.items():
            pairs = [
                (a, b)
                for a, b in combinations(members, 2)
                if a.domain == b.domain and self._carries(component, a, b)
            ]
            for a, b in pairs:
                name = component if len(pairs) == 1 else f"{a.name}, {b.name}"
                aliases = (f"{a.name}, {b.name}",) if len(pairs) == 1 else ()
                own = self._parameters(component)
                ends = (a.name, b.name)
                found.append(Site(name, "component", a.domain, ends, aliases, own, self.is_grounded(*ends)))
        return found

    def _parameters(self, component: str) -> tuple[tuple[str, str], ...]:
        names = (*self.flat.parameter_names, *(p.name for p in self.flat.derived_parameters))
        return tuple((n.rpartition(".")[2], n) for n in names if n.rpartition(".")[0] == component)

    def cuts(self) -> list[Site]:
        """Connectors that carry a flow; the only two of a connection set are one place. None whose units do
        not convert to the library's, such as mass flows in g/s."""
        found: list[Site] = []
        for one in self.sets:
            if not all(self._is_to_scale(m) for m in one.members):
                continue
            inside = [m for m in one.members if not one.is_outside(m)]
            carrying = [m for m in inside if not self._is_idle(m)]
            if len(carrying) == 2:
                found.append(self._cut(carrying[0], (carrying[1],)))
            elif len(carrying) > 2:
                found += [self._cut(member, ()) for member in carrying]
        return found

    def _is_to_scale(self, name: str) -> bool:
        one = self.connectors[name]
        potential, flow = (self.flat.unknowns[i].unit for i in (one.potential, one.flow))
        is_flow = is_of(flow, FLOWS[one.domain]) and converts(flow, FLOWS[one.domain])
        return is_flow or (in_connectors(potential).scale == 1.0 and flow_scale(flow, one.domain) == 1.0)

    def _cut(self, name: str, aliases: tuple[str, ...]) -> Site:
        return Site(name, "connector", self.connectors[name].domain, (name,), aliases)

    # --- structure of the connections ----------------------------------------------------------------------

    def _joined(self) -> dict[str, int]:
        groups = list(range(len(self.sets)))

        def root(i: int) -> int:
            while groups[i] != i:
                i = groups[i]
            return i

        for owners in self._owner.values():
            for other in owners[1:]:
                groups[root(other)] = root(owners[0])
        for component in self._components:
            ends = [self._owner[end][0] for end in self._rigid_ends(component) if end in self._owner]
            for end in ends[1:]:
                groups[root(end)] = root(ends[0])
        return {name: root(owners[0]) for name, owners in self._owner.items()}

    # --- what a component does -----------------------------------------------------------------------------

    def _rigid_ends(self, component: str) -> list[str]:
        """Connectors of a component that move as one body: equal potentials up to a constant, and flows that
        act on it alike."""
        members = self._components[component]
        for a, b in combinations(members, 2):
            if a.domain == b.domain and self._is_rigid(component, a, b):
                return [a.name, b.name]
        return []

    def _is_rigid(self, component: str, a: Connector, b: Connector) -> bool:
        matrix = self._matrix(component)
        alike = np.array_equal(matrix[:, a.flow], matrix[:, b.flow])
        return alike and _in_row_space(matrix, {a.potential: 1.0, b.potential: -1.0})

    def _carries(self, component: str, a: Connector, b: Connector) -> bool:
        """Whether a.flow + b.flow = 0, and nothing holds the potentials together."""
        matrix = self._matrix(component)
        if self._is_idle(a.name):
            return False
        return _in_row_space(matrix, {a.flow: 1.0, b.flow: 1.0}) and not _in_row_space(
            matrix, {a.potential: 1.0, b.potential: -1.0}
        )

    def _is_idle(self, connector: str) -> bool:
        """Whether the component lets nothing flow there, as a sensor, or drives a flow that nothing
        changes."""
        one = self.connectors[connector]
        return _in_row_space(self._matrix(one.component), {one.flow: 1.0})

    def is_grounded(self, a: str, b: str) -> bool:
        """Whether the node of `a` is held at a constant potential, or that of `b` by a component of one
        connector, as by ground. A tank that is filled from above holds the pressure at its inlet, too, but
        keeps what flows in."""
        return a in self.held or b in self._grounds

    @cached_property
    def held(self) -> frozenset[str]:
        """The connectors of the nodes whose potential a component holds constant."""
        nodes = self._members().values()
        return frozenset(name for node in nodes if self.is_held(node) for name in node)

    @cached_property
    def _grounds(self) -> frozenset[str]:
        alone = {name for name, one in self.connectors.items() if len(self._components[one.component]) == 1}
        nodes = self._members().values()
        return frozenset(name for node in nodes if self.is_held(alone.intersection(node)) for name in node)

    def is_held(self, node: Iterable[str]) -> bool:
        """Whether a component of the node holds its potential constant."""
        return any(
            _in_row_space(self._matrix(one.component), {one.potential: 1.0})
            for one in (self.connectors[name] for name in node)
        )

    def _stores(self, connector: str) -> bool:
        """Whether the component is a body: it has derivatives, takes a flow, and moves as one."""
        component = self.connectors[connector].component
        if not self._matrix(component)[:, self.flat.n :].any() or self._is_idle(connector):
            return False
        return self._is_alone(connector) or connector in self._rigid_ends(component)

    def _is_alone(self, connector: str) -> bool:
        return len(self._components[self.connectors[connector].component]) == 1

    def _matrix(self, component: str) -> np.ndarray:
        """The component's rows of [∂F/∂ξ, ∂F/∂ξ'] at a random point."""
        return self._slopes[list(self._rows.get(component, ())), :]


def connection_sets(flat: FlatModel, connectors: dict[str, Connector]) -> list[ConnectionSet]:
    """The flow sums of the model, also those of one unconnected connector."""
    rows = [i for i, e in enumerate(flat.equations) if e.kind in ("flow", "unconnected")]
    if not rows:
        return []
    by_flow = {c.flow: name for name, c in connectors.items()}
    pattern = ca.jacobian_sparsity(flat.residual[rows], flat.xi)
    members: dict[int, list[str]] = {}
    for row, column in zip(pattern.row(), pattern.get_col(), strict=True):
        if column in by_flow:
            members.setdefault(row, []).append(by_flow[column])
    return [ConnectionSet(rows[i], _in_order(flat, rows[i], members[i])) for i in sorted(members)]


def _in_order(flat: FlatModel, row: int, members: Sequence[str]) -> tuple[str, ...]:
    origin = flat.equations[row].origin.split(", ")
    return tuple(sorted(members, key=lambda m: (origin.index(m) if m in origin else len(origin), m)))


def _rows_by_component(flat: FlatModel) -> dict[str, list[int]]:
    """Rows of each component, with those of the components inside of it."""
    found: dict[str, list[int]] = {}
    for i, equation in enumerate(flat.equations):
        if equation.kind not in ("component", "binding"):
            continue
        path = equation.origin.split(".") if equation.origin else []
        for end in range(1, len(path) + 1):
            found.setdefault(".".join(path[:end]), []).append(i)
    return found


def _in_row_space(matrix: np.ndarray, target: dict[int, float]) -> bool:
    """Whether a combination of the rows is `target` (column -> value) and zero elsewhere."""
    used = np.flatnonzero(np.any(matrix != 0, axis=0))
    if any(column not in used for column in target):
        return False
    wanted = np.zeros(matrix.shape[1])
    for column, value in target.items():
        wanted[column] = value
    rows = matrix[:, used]
    scale = np.abs(rows).max(axis=1, keepdims=True)
    rows = rows / np.where(scale > 0, scale, 1.0)
    solution, *_ = np.linalg.lstsq(rows.T, wanted[used], rcond=None)
    return bool(np.linalg.norm(rows.T @ solution - wanted[used]) < _TOLERANCE * np.linalg.norm(wanted[used]))


def _pairs(net: Network) -> list[Site]:
    """Pairs of nodes of a domain where bodies exchange something without being in touch, that no component
    joins."""
    joined = {frozenset(net.node_of(c) for c in site.connectors) for site in net.components()}
    nodes = [node for node in net.all_nodes() if node.domain in _PAIRED]
    found: list[Site] = []
    for a, b in combinations(nodes, 2):
        ends = frozenset((net.node_of(a.name), net.node_of(b.name)))
        if a.domain == b.domain and ends not in joined and not {a.name, b.name} <= net.held:
            pair = (a.name, b.name)
            grounded = net.is_grounded(*pair)
            found.append(Site(", ".join(pair), "pair", a.domain, pair, is_grounded=grounded))
    return found
