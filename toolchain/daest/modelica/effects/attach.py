"""Effects attached to a compiled model: equations are merged, nothing is compiled again.

The result is the FlatModel that the compiler would make of the extended Modelica model: the effect's
variables and parameters under the name of its component, its equations, and the equations of its connections.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from typing import TypeVar

import casadi as ca

from daest.errors import ModelError
from daest.model.effects import Effect, EffectParameter, Placement, Site
from daest.model.flat import FlatModel
from daest.model.parts import DerivedParameter, Equation, NoiseInput, Output, Parameter, Variable
from daest.modelica.effects.catalogue import OWN, EffectModel, effect_model
from daest.modelica.flat.clock import clock_unit
from daest.modelica.flat.connectors import NAMES, connectors_of, flow_scale
from daest.modelica.flat.factors import Entry
from daest.modelica.language.text import times_text
from daest.modelica.language.values import column
from daest.modelica.places.balances import (
    Balance,
    balances,
    converted_text,
    in_connectors,
    needs_position,
    potential_change,
    temperatures,
)
from daest.modelica.places.internal_forces import InternalForce, internal_forces
from daest.modelica.places.meshes import Mesh, meshes
from daest.modelica.places.place_units import balance_entry, units_at
from daest.modelica.places.sites import connection_sets, fits
from daest.modelica.places.terminals import terminals
from daest.near import did_you_mean
from daest.quantities import Conversion, conversion, is_of

__all__ = ["attach", "attach_all", "component_name"]


def attach(
    flat: FlatModel,
    effect: Effect,
    site: Site,
    name: str | None = None,
    values: Mapping[str, float] | None = None,
    inputs: Mapping[str, str] | None = None,
    input_units: Mapping[str, str] | None = None,
) -> FlatModel:
    """`flat` with `effect` at `site` as component `name` (default: its class name in lower case, numbered if
    taken).

    `values` are the values of the effect's parameters, in place of their start values; `inputs` maps its
    signal inputs to inputs of the model, which are made where they do not exist, with `input_units` as in
    `Placement`. Raises ModelError: `effect-fit`, `effect-present`, `effect-name`, `effect-parameter`.

        >>> from daest.modelica.places.sites import find_site
        >>> site = find_site(flat, "disc", effect)
        >>> daest.attach(flat, effect, site).parameters[-1].name
        'coulombFriction.w_s'
    """
    return attach_all(
        flat, [Placement(effect, site, name or "", values or {}, inputs or {}, input_units or {})]
    )


def attach_all(
    flat: FlatModel,
    placements: Iterable[Placement | tuple[Effect, Site, str]],
    *,
    allow_repeated: bool = False,
) -> FlatModel:
    """`flat` with several effects; the work grows linearly with their number. See `attach`.
    `allow_repeated`: an effect may sit several times at the same place (in different shapes, say)."""
    assembly = _Assembly(flat, allow_repeated)
    for one in placements:
        assembly.add(one if isinstance(one, Placement) else Placement(*one))
    return assembly.model()


def components_with(flat: FlatModel, places: Iterable[tuple[Effect, Site]]) -> list[tuple[str, ...]]:
    """Of every pair, the components of the model at that place that have the equations of that effect."""
    assembly = _Assembly(flat)
    return [assembly.with_equations_of(effect, site) for effect, site in places]


def component_name(effect: Effect, taken: Iterable[str]) -> str:
    """The name of the effect's component: `coulombFriction`, or `coulombFriction2` where that is taken."""
    return free_name(effect.name[0].lower() + effect.name[1:], taken)


def free_name(base: str, taken: Iterable[str]) -> str:
    """`base`, or the first of base2, base3, … that is not taken."""
    known = set(taken)
    return next(name for n in count(1) if (name := base if n == 1 else f"{base}{n}") not in known)


def one_by_one(placement: Placement, taken: Collection[str]) -> list[Placement]:
    """The placement, at equal places the one at each of them: under its name the first, the others under free
    names with the number of their part, with the same signals."""
    if not placement.site.parts:
        return [placement]
    made = {signal: f"{placement.name}_{signal}" for signal in placement.effect.inputs}
    placement = replace(placement, inputs={**made, **placement.inputs})
    first, *others = placement.site.parts
    found, known = [replace(placement, site=first)], {*taken, placement.name}
    for number, part in enumerate(others, 2):
        name = free_name(f"{placement.name}_{number}", known)
        known.add(name)
        found.append(replace(placement, site=part, name=name))
    return found


def names_of(flat: FlatModel) -> set[str]:
    """The names of components and variables that the model declares itself."""
    names = [*flat.unknown_names, *flat.input_names, *flat.noise_names, *flat.output_names]
    names += [*flat.parameter_names, *(p.name for p in flat.derived_parameters)]
    own = {name.partition(".")[0] for name in names}
    return own | {e.origin.partition(".")[0] for e in flat.equations if e.kind == "component"}


Found = TypeVar("Found")
_COMPONENT = re.compile(
    r"(?<![\w.])(\w+(?:\[[\d,]+\])?)\.(?=[A-Za-z_])"
)  # before the name of a variable of it


@dataclass
class _Member:
    """A component that is put in: its model, and the symbols of its variables by their local names."""

    name: str
    effect: Effect
    model: EffectModel
    symbols: dict[str, ca.SX] = field(default_factory=dict)

    def local(self, connector: str, kind: int) -> tuple[str, ca.SX]:
        """Full name and symbol of the potential (0) or flow (1) of one of its connectors."""
        variable = f"{connector}.{NAMES[self.effect.domain][kind]}"
        return f"{self.name}.{variable}", self.symbols[variable]


class _Assembly:
    """The rows and symbols of a model that grows."""

    def __init__(self, flat: FlatModel, allow_repeated: bool = False) -> None:
        self.flat = flat
        self.allow_repeated = allow_repeated
        self.unknowns: list[Variable] = list(flat.unknowns)
        self.xi: list[ca.SX] = ca.vertsplit(flat.xi)
        self.derivatives: list[ca.SX] = ca.vertsplit(flat.derivatives)
        self.inputs: list[Variable] = list(flat.inputs)
        self.u: list[ca.SX] = ca.vertsplit(flat.u)
        self.noises: list[NoiseInput] = list(flat.noises)
        self.w: list[ca.SX] = ca.vertsplit(flat.w)
        self.parameters: list[Parameter] = list(flat.parameters)
        self.theta: list[ca.SX] = ca.vertsplit(flat.theta)
        self.derived: list[DerivedParameter] = list(flat.derived_parameters)
        self.derived_values: list[ca.SX] = ca.vertsplit(flat.derived_values)
        self.outputs: list[Output] = list(flat.outputs)
        self.results: list[ca.SX] = ca.vertsplit(flat.output_expressions)
        self.equations: list[Equation] = list(flat.equations)
        self.residual: list[ca.SX] = ca.vertsplit(flat.residual)
        self.initial: list[Equation] = list(flat.initial_equations)
        self.initial_residual: list[ca.SX] = ca.vertsplit(flat.initial_residual)
        self._connectors = connectors_of(flat.unknowns)
        self._symbol = {v.name: x for v, x in zip(flat.unknowns, self.xi, strict=True)}
        self._values = {p.name: x for p, x in zip(flat.parameters, self.theta, strict=True)}
        self._values |= {p.name: x for p, x in zip(self.derived, self.derived_values, strict=True)}
        self._flow_rows: dict[str, int] = {}
        for one in connection_sets(flat, self._connectors):
            for member in one.members:  # a composite's connector belongs to two: that outside of it counts
                if member not in self._flow_rows or not one.is_outside(member):
                    self._flow_rows[member] = one.row
        self._potential_rows: dict[str, list[int]] | None = None
        self._names = names_of(flat)
        self._attached: set[str] = set()
        self._laws: dict[str, list[str]] = {}
        self._note_laws(self.equations)

    def model(self) -> FlatModel:
        return replace(
            self.flat,
            unknowns=tuple(self.unknowns),
            inputs=tuple(self.inputs),
            noises=tuple(self.noises),
            parameters=tuple(self.parameters),
            outputs=tuple(self.outputs),
            equations=tuple(self.equations),
            derivatives=column(self.derivatives),
            xi=column(self.xi),
            u=column(self.u),
            w=column(self.w),
            theta=column(self.theta),
            residual=column(self.residual),
            output_expressions=column(self.results),
            initial_equations=tuple(self.initial),
            initial_residual=column(self.initial_residual),
            derived_parameters=tuple(self.derived),
            derived_values=column(self.derived_values),
            attached=self.flat.attached | self._attached,
        )

    @cached_property
    def _clock(self) -> str:
        return clock_unit(self.flat)

    @cached_property
    def _balances(self) -> dict[str, Balance]:
        return {balance.name(self.flat): balance for balance in balances(self.flat)}

    @cached_property
    def _temperatures(self) -> dict[int, Conversion]:
        return temperatures(self.flat)

    @cached_property
    def _forces(self) -> dict[str, InternalForce]:
        return {force.name(self.flat): force for force in internal_forces(self.flat)}

    @cached_property
    def _meshes(self) -> dict[str, Mesh]:
        return {mesh.name(self.flat): mesh for mesh in meshes(self.flat)}

    def _found(self, places: Mapping[str, Found], name: str) -> Found:
        """The place of that name. Raises ModelError where an effect that was put in before has changed the
        equations so that it is none any more."""
        if name not in places:
            raise ModelError(
                "effect-place",
                f"`{name}` is no place of the model any more",
                where=self.flat.source or None,
                remedy="An effect in its equations has changed them: choose another place.",
            )
        return places[name]

    # --- putting in ----------------------------------------------------------------------------------------

    def add(self, placement: Placement) -> None:
        effect, site = placement.effect, placement.site
        if not fits(effect, site):
            raise ModelError(
                "effect-fit",
                f"{effect.name} does not fit at `{site.name}`, {site.told}",
                remedy="Choose one of the sites where it fits.",
            )
        if not self.allow_repeated:
            self._refuse_repetition(effect, site)
        name = placement.name or component_name(effect, self._names)
        for one in one_by_one(replace(placement, name=name), self._names):
            self._put(one, "" if one.name == name else name)

    def _put(self, placement: Placement, shared: str = "") -> None:
        """A component at one place; of the component `shared` it takes the parameters."""
        effect, site = placement.effect, placement.site
        member = self._member(placement, shared)
        if not effect.is_of_variable:
            self._supply(member, placement)
        if site.kind == "node":
            self._join(member, effect.connectors[0], site.connectors[0])
        elif site.kind in ("component", "pair"):
            self._across(member, site)
        elif site.kind == "connector":
            self._in_series(member, site.connectors[0])
        elif site.kind == "equation":
            self._as_term(member, effect.connectors[0], site.name)
        elif site.kind == "exchange":
            for own, name in zip(effect.connectors, site.name.split(", "), strict=True):
                if name in self._balances:
                    self._as_term(member, own, name)
                else:
                    self._at_input(member, own, name)
        elif site.kind == "force":
            self._beside_force(member, site.name)
        elif site.kind == "mesh":
            self._in_mesh(member, site.name)
        elif site.kind == "terminal":
            self._at_terminal(member, site.name)
        elif site.kind == "output":
            self._before_output(member, site.name)
        elif site.kind == "input":
            self._behind_input(member, site.name)
        elif site.kind == "signal":
            self._behind_signal(member, site.name)
        else:
            self._instead(member, site.name, placement.inputs)

    def _member(self, placement: Placement, shared: str = "") -> _Member:
        """The effect's variables, parameters and equations, with nothing connected yet."""
        effect, site = placement.effect, placement.site
        model = effect_model(effect, across=effect.attach == "connector" and site.kind == "component")
        member = _Member(self._name(placement), effect, model)
        xi = [ca.SX.sym(f"{member.name}.{x.name}") for x in model.unknowns]
        derivatives = [ca.SX.sym(f"der({member.name}.{x.name})") for x in model.unknowns]
        w = [ca.SX.sym(f"{member.name}.{x.name}") for x in model.noises]
        theta = self._parameters(member, placement, shared)
        member.symbols = {x.name: symbol for x, symbol in zip(model.unknowns, xi, strict=True)}
        residual, initial, derived = model.function(
            column(derivatives), column(xi), column(w), column(theta), self.flat.time
        )
        self.unknowns += [replace(x, name=f"{member.name}.{x.name}") for x in model.unknowns]
        self.xi += xi
        self.derivatives += derivatives
        self.noises += [_placed_noise(x, member.name) for x in model.noises]
        self.w += w
        equations = [_placed(e, member.name) for e in model.equations]
        self._note_laws(equations)
        self.equations += equations
        self.residual += ca.vertsplit(residual)
        self.initial += [_placed(e, member.name) for e in model.initial_equations]
        self.initial_residual += ca.vertsplit(initial)
        self.derived += [_placed_derived(p, member.name) for p in model.derived]
        self.derived_values += ca.vertsplit(derived)
        return member

    def _name(self, placement: Placement) -> str:
        name = placement.name
        if name in self._names:
            raise ModelError(
                "effect-name",
                f"the model has a `{name}` already",
                where=self.flat.source or None,
                remedy=f"Choose another name, such as {component_name(placement.effect, self._names)}.",
            )
        self._names.add(name)
        self._attached.add(name)
        return name

    def _parameters(self, member: _Member, placement: Placement, shared: str = "") -> list[ca.SX]:
        """The symbols of the effect's parameters; those that the place gives are expressions of the
        model's, and those of a `shared` component are this one's."""
        check_values(member.effect, placement.values)
        roles = {p.name: p for p in member.effect.parameters}
        units = units_at(self.flat, member.effect, placement.site, self._clock, placement.inputs)
        symbols: list[ca.SX] = []
        for parameter in member.model.parameters:
            full = f"{member.name}.{parameter.name}"
            source = self._given(roles[parameter.name], placement)
            if shared and not source:
                source = f"{shared}.{parameter.name}"
            if source:
                value = self._values[source]
                self.derived.append(DerivedParameter(full, source, parameter.unit, parameter.description))
                self.derived_values.append(value)
            else:
                value = ca.SX.sym(full)
                role = roles[parameter.name]
                start = float(placement.values.get(parameter.name, role.start))
                unit = units[parameter.name]
                own = replace(parameter, name=full, value=start, min=role.min, unit=unit, null=None)
                self.parameters.append(own)
                self.theta.append(value)
            self._values[full] = value
            symbols.append(value)
        return symbols

    def _given(self, parameter: EffectParameter, placement: Placement) -> str:
        """The model's parameter that supplies one of role "given"; empty for one that has its own value."""
        return given_source(parameter, placement.site) if parameter.name not in placement.values else ""

    def _supply(self, member: _Member, placement: Placement) -> None:
        """Connect the effect's signal inputs to inputs of the model, new ones where there are none."""
        for name in member.effect.inputs:
            wanted = placement.inputs.get(name, f"{member.name}_{name}")
            known = [x.name for x in self.inputs]
            own = next(x for x in member.model.unknowns if x.name == name)
            if wanted not in known:
                self._new_input(wanted, replace(own, unit=placement.unit_of(name, own.unit)))
            at = [x.name for x in self.inputs].index(wanted)
            text, symbol = _converted(wanted, self.u[at], supplied(self.inputs[at].unit, own.unit))
            self._connect(text, symbol, f"{member.name}.{name}", member.symbols[name])

    def _new_input(self, wanted: str, own: Variable) -> None:
        if wanted in self._names:
            raise ModelError(
                "effect-name",
                f"the input `{wanted}` cannot be added: the model has a `{wanted}` already",
                remedy="Choose another name for the input.",
            )
        self.inputs.append(replace(own, name=wanted, start=own.start_or_zero, place=None))
        self.u.append(ca.SX.sym(wanted))
        self._names.add(wanted)

    # --- connecting ----------------------------------------------------------------------------------------

    def _connect(self, left: str, left_symbol: ca.SX, right: str, right_symbol: ca.SX) -> None:
        """left = right, as a connection writes it."""
        origin = ", ".join(_owner(name) for name in (left, right))
        self.equations.append(Equation(f"{left} = {right}", "connection", origin))
        self.residual.append(left_symbol - right_symbol)

    def _join(self, member: _Member, own: str, connector: str) -> None:
        """The effect's connector `own` joins the connection set of `connector`."""
        target = self._connectors[connector]
        name, symbol = member.local(own, 0)
        self._connect(
            *_potential_of(self.unknowns[target.potential], self.xi[target.potential]), name, symbol
        )
        flow_name, flow = member.local(own, 1)
        row = self._flow_rows[connector]
        sign = self._orientation(row, target.flow)
        old = self.equations[row]
        left, _, right = old.text.partition(" = ")
        scale = flow_scale(self.unknowns[target.flow].unit, target.domain)
        if scale != 1.0:  # in the unit of the connector
            flow_term, flow = f"{1.0 / scale!r}*{flow_name}", flow / scale
        else:
            flow_term = flow_name
        text = f"{left} + {flow_term} = {right}" if right == "0" else f"{old.text} + {flow_term}"
        origin = f"{old.origin}, {_owner(flow_name)}" if old.origin else _owner(flow_name)
        self.equations[row] = replace(old, text=text, kind="flow", origin=origin)
        self.residual[row] = self.residual[row] + sign * flow

    def _orientation(self, row: int, flow: int) -> float:
        """The sign in a flow sum of the flows into components, which the innermost connector tells."""
        members = [name for name, at in self._flow_rows.items() if at == row and name in self._connectors]
        inner = max(members, key=lambda name: name.count("."), default="")
        symbol = self.xi[self._connectors[inner].flow] if inner else self.xi[flow]
        slope = ca.jacobian(self.residual[row], symbol)
        return -1.0 if slope.is_constant() and float(slope) < 0 else 1.0

    def _across(self, member: _Member, site: Site) -> None:
        a, b = site.connectors
        if member.effect.attach == "connector":
            self._join(member, "support", a)
            self._join(member, member.effect.connectors[0], b)
        else:
            self._join(member, member.effect.connectors[0], a)
            self._join(member, member.effect.connectors[1], b)

    def _in_series(self, member: _Member, connector: str) -> None:
        """The connections of `connector` go to the effect's first connector, its second one to
        `connector`."""
        first, second = member.effect.connectors
        row = self._flow_rows[connector]
        self._rename(row, connector, member, first)
        for at in self._rows_of_potential(connector, row):
            self._rename(at, connector, member, first)
        one = self._connectors[connector]
        _, flow = one.variables(self.unknowns)
        end, end_symbol = member.local(second, 0)
        inner = _potential_of(self.unknowns[one.potential], self.xi[one.potential])
        self._connect(end, end_symbol, *inner)
        end_flow, end_flow_symbol = member.local(second, 1)
        origin = f"{member.name}.{second}, {connector}"
        scale = flow_scale(self.unknowns[one.flow].unit, one.domain)
        entering = times_text(scale, flow)
        self.equations.append(Equation(f"{end_flow} + {entering} = 0", "flow", origin))
        self.residual.append(end_flow_symbol + scale * self._symbol[flow])
        self._flow_rows[connector] = len(self.equations) - 1
        self._potentials()[connector] = [len(self.equations) - 2]

    def _rename(self, row: int, connector: str, member: _Member, own: str) -> None:
        """The row with the variables of `connector` replaced by those of the effect's connector `own`, in the
        units of `connector`."""
        old, one = self.equations[row], self._connectors[connector]
        replaced, text = self.residual[row], old.text
        scale = flow_scale(self.unknowns[one.flow].unit, one.domain)
        changes = in_connectors(self.unknowns[one.potential].unit), Conversion(scale=scale)
        for kind, former in enumerate(one.variables(self.unknowns)):
            name, symbol = _converted(*member.local(own, kind), _inverse(changes[kind]))
            replaced = ca.substitute(replaced, self._symbol[former], symbol)
            text = _renamed(text, former, name)
        origin = ", ".join(
            f"{member.name}.{own}" if one == connector else one for one in old.origin.split(", ")
        )
        self.equations[row] = replace(old, text=text, origin=origin)
        self.residual[row] = replaced

    def _rows_of_potential(self, connector: str, flow_row: int) -> list[int]:
        """Rows of connections of `connector` with members of its connection set."""
        peers = set(self.equations[flow_row].origin.split(", "))
        rows = self._potentials().get(connector, [])
        return [at for at in rows if set(self.equations[at].origin.split(", ")) & (peers - {connector})]

    def _potentials(self) -> dict[str, list[int]]:
        if self._potential_rows is None:
            self._potential_rows = {}
            for i, equation in enumerate(self.equations):
                if equation.kind == "connection":
                    for name in equation.origin.split(", "):
                        self._potential_rows.setdefault(name, []).append(i)
        return self._potential_rows

    def _as_term(self, member: _Member, own: str, name: str) -> None:
        """The flow into the effect's connector `own` becomes a term of a balance, its potential follows the
        balanced variable."""
        balance = self._found(self._balances, name)
        self._add_term(balance_entry(self.flat, balance, member.effect.domain), *member.local(own, 1))
        potential, symbol = member.local(own, 0)
        variable, of_variable = balance.potential(self.flat), balance.symbol(self.flat)
        if not needs_position(member.effect.domain):
            change = potential_change(self.flat, balance, self._temperatures)
            self._tie(potential, symbol, *_converted(variable.name, of_variable, change))
        elif balance.position >= 0:
            # In the unit that makes the speed its rate.
            change = in_connectors(variable.unit)
            position = self.flat.unknowns[balance.position].name
            self._tie(potential, symbol, *_converted(position, self.xi[balance.position], change))
        else:
            self._tie_rate(potential, *_potential_of(variable, of_variable))

    def _at_input(self, member: _Member, own: str, name: str) -> None:
        """The potential of the effect's connector `own` follows the temperature that is the input `name`."""
        at = self._found({one.name: i for i, one in enumerate(self.flat.inputs)}, name)
        self._tie(*member.local(own, 0), *_potential_of(self.flat.inputs[at], self.u[at]))

    def _beside_force(self, member: _Member, name: str) -> None:
        """The effect's flow becomes a term beside a force between bodies, its potential follows their
        relative motion; the other end of an effect with two does not move."""
        force = self._found(self._forces, name)
        *fixed, own = member.effect.connectors
        for entry in force.entries:
            self._add_term(entry, *member.local(own, 1))
        potential, symbol = member.local(own, 0)
        shown = force.motion_text(self.flat) or f"motion at {name}"
        if force.has_positions:
            self._tie(potential, symbol, shown, force.motion(self.flat))
        else:
            self._tie_rate(potential, shown, force.motion(self.flat))
        for end in fixed:
            self._tie(*member.local(end, 0), "0", ca.SX(0.0))

    def _in_mesh(self, member: _Member, name: str) -> None:
        """The voltage over the effect becomes a term of a sum of voltages, its current follows the mesh."""
        place = self._found(self._meshes, name)
        first, second = member.effect.connectors
        voltage, symbol = member.local(first, 0)
        if place.source is None:
            self._add_term(Entry(place.row, place.sign, place.factor), voltage, symbol)
        else:
            source, source_symbol = place.source
            old = self.equations[place.row]
            text = _renamed(old.text, source, place.lowered(source, voltage))
            self.equations[place.row] = replace(old, text=text)
            lowered = source_symbol - place.per_drop * symbol
            self.residual[place.row] = ca.substitute(self.residual[place.row], source_symbol, lowered)
        current = place.current_text(self.flat, voltage) or place.flow_name(self.flat)
        self._tie(*member.local(first, 1), current, place.current(self.flat, symbol))
        self._tie(*member.local(second, 0), "0", ca.SX(0.0))

    def _at_terminal(self, member: _Member, name: str) -> None:
        """The voltage over the effect becomes a term of an output, its current is the input's."""
        place = self._found({one.name(self.flat): one for one in terminals(self.flat)}, name)
        first, second = member.effect.connectors
        self.results[place.output] += place.sign * place.per_drop * member.local(first, 0)[1]
        current = times_text(place.per_flow, place.current_name(self.flat))
        self._tie(*member.local(first, 1), current, place.per_flow * self.u[place.current])
        self._tie(*member.local(second, 0), "0", ca.SX(0.0))

    def _add_term(self, entry: Entry, name: str, symbol: ca.SX) -> None:
        """Add a term to an equation of the model."""
        old = self.equations[entry.row]
        left, _, right = old.text.partition(" = ")
        term = entry.term(name, self.flat) or f"({entry.factor})*{name}"
        text = f"{left} + {term} = {right}" if entry.sign > 0 else f"{left} = {right} + {term}"
        self.equations[entry.row] = replace(old, text=text)
        self.residual[entry.row] = self.residual[entry.row] + entry.in_residual * symbol

    def _tie_rate(self, left: str, right: str, right_symbol: ca.SX) -> None:
        """der(left) = right, of an unknown by its name."""
        at = [x.name for x in self.unknowns].index(left)
        self._tie(f"der({left})", self.derivatives[at], right, right_symbol)

    def _tie(self, left: str, left_symbol: ca.SX, right: str, right_symbol: ca.SX) -> None:
        self.equations.append(Equation(f"{left} = {right}", "connection", ""))
        self.residual.append(left_symbol - right_symbol)

    # --- signals -------------------------------------------------------------------------------------------

    def _behind_input(self, member: _Member, name: str) -> None:
        """The uses of an input take the effect's output."""
        source = self.u[[x.name for x in self.inputs].index(name)]
        self._substitute(source, member.symbols["y"], name, f"{member.name}.y", member)
        self._connect(name, source, f"{member.name}.u", member.symbols["u"])

    def _behind_signal(self, member: _Member, name: str) -> None:
        """The uses of a signal inside of the model take the effect's output: connections to other blocks, or
        all equations but that which gives it, or its rate."""
        owner = name.rpartition(".")[0]
        kept = [
            i
            for i, e in enumerate(self.equations)
            if e.kind in ("component", "binding")
            and (e.origin == owner if owner else e.text.partition(" = ")[0] == name)
        ]
        source = self._symbol[name]
        rate = self.derivatives[[x.name for x in self.unknowns].index(name)]
        kept = kept or ca.jacobian_sparsity(column(self.residual), rate).row()
        self._substitute(source, member.symbols["y"], name, f"{member.name}.y", member, kept)
        self._connect(name, source, f"{member.name}.u", member.symbols["u"])

    def _substitute(
        self,
        old: ca.SX,
        new: ca.SX,
        name: str,
        shown: str,
        member: _Member,
        kept: Collection[int] = (),
    ) -> None:
        """`new` for `old` everywhere but in the effect's own rows and those that are `kept`, `shown` for
        `name` in the texts."""
        rows = [
            i
            for i, e in enumerate(self.equations)
            if e.origin.partition(".")[0] != member.name and i not in kept
        ]
        before = column([*(self.residual[i] for i in rows), *self.results])
        depends = ca.jacobian_sparsity(before, old).row()
        after = ca.vertsplit(ca.substitute(before[depends], old, new)) if depends else []
        for at, expression in zip(depends, after, strict=True):
            if at >= len(rows):
                self.results[at - len(rows)] = expression
                continue
            equation = self.equations[rows[at]]
            origin = ", ".join(member.name if o == name else o for o in equation.origin.split(", "))
            text = _renamed(equation.text, name, shown)
            self.equations[rows[at]] = replace(equation, text=text, origin=origin)
            self.residual[rows[at]] = expression

    def _instead(self, member: _Member, name: str, inputs: Mapping[str, str]) -> None:
        """The uses of a parameter take the effect's formula, of one equation `y = …` in u, time and those
        variables of the model that `inputs` names."""
        row = next(i for i, e in enumerate(self.equations) if e.origin == member.name)
        formula = -ca.substitute(self.residual[row], member.symbols["y"], 0)
        formula = ca.substitute(formula, member.symbols["u"], self._values[name])
        shown = _renamed(self.equations[row].text.partition(" = ")[2], f"{member.name}.u", name)
        for own in member.effect.inputs:
            variable = inputs.get(own, "")
            formula = ca.substitute(formula, member.symbols[own], self._variable(variable, member, own))
            shown = _renamed(shown, f"{member.name}.{own}", variable)
        del self.equations[row], self.residual[row]
        for _ in member.model.unknowns:
            del self.unknowns[-1], self.xi[-1], self.derivatives[-1]
        self._substitute(self._values[name], formula, name, f"({shown})", member)

    def _variable(self, name: str, member: _Member, own: str) -> ca.SX:
        """A variable, an input or an output of the model. Raises ModelError where there is none."""
        known = {y.name: result for y, result in zip(self.outputs, self.results, strict=True)}
        known |= self._symbol | {x.name: u for x, u in zip(self.inputs, self.u, strict=True)}
        if name not in known:
            raise ModelError(
                "effect-parameter",
                f"{member.effect.name} needs a variable of the model for `{own}`"
                + (f", and `{name}` is none" if name else ""),
                remedy=f"{did_you_mean(name, known, 2) if name else ''}Name one: --input {own}=VARIABLE.",
            )
        return known[name]

    def _before_output(self, member: _Member, name: str) -> None:
        at = [y.name for y in self.outputs].index(name)
        expression = self.results[at]
        shown = expression.name() if expression.is_symbolic() else str(expression)
        self._connect(shown, expression, f"{member.name}.u", member.symbols["u"])
        self.results[at] = member.symbols["y"]

    # --- the same effect twice -----------------------------------------------------------------------------

    def _refuse_repetition(self, effect: Effect, site: Site) -> None:
        """Raise ModelError where a component at the place has the equations of the effect."""
        for peer in self.with_equations_of(effect, site):
            raise ModelError(
                "effect-present",
                f"the model contains {effect.name} at `{site.name}` already: `{peer}`",
                where=self.flat.source or None,
                remedy=f"Estimate the parameters of `{peer}`, or choose another place.",
            )

    def with_equations_of(self, effect: Effect, site: Site) -> tuple[str, ...]:
        """The components at the place that have the equations of the effect, in the order of their names; of
        equal places, at any of them."""
        if site.parts:
            return tuple(
                dict.fromkeys(c for part in site.parts for c in self.with_equations_of(effect, part))
            )
        peers = self._peers(site)
        if not peers:
            return ()
        variants = [effect_model(effect)] + ([effect_model(effect, True)] if effect.has_support else [])
        laws = [frozenset(e.text for e in v.equations if e.kind == "component") for v in variants]
        return tuple(peer for peer in sorted(peers) if frozenset(self._laws.get(peer, ())) in laws)

    def _peers(self, site: Site) -> set[str]:
        """Components that join the place at all of its ends."""
        if site.kind in ("input", "output", "signal", "parameter"):
            found = {_owner(e.text.partition(" = ")[2]) for e in self.equations if _reads(e, site.name)}
            return found | self._shown_by(site)
        if site.kind == "terminal":
            current = site.name.partition(":")[2]
            return {_owner(e.text.partition(" = ")[0]) for e in self.equations if _is_tied(e, current)}
        if site.kind in ("equation", "exchange", "force", "mesh"):
            names = [name.partition(":") for name in site.name.split(", ")]
            return self._terms_of({int(row) for row, colon, _ in names if colon})
        if site.kind == "connector":
            joined = self.equations[self._flow_rows[site.connectors[0]]].origin.split(", ")
            return {_owner(name) for name in joined} if len(joined) == 2 else set()
        if site.kind == "node":
            return self._joined_to(site.connectors)
        a, b = site.connectors
        return self._joined_to([a]) & self._joined_to([b])

    def _terms_of(self, rows: set[int]) -> set[str]:
        """Components of which something stands in these equations of the model, and in no other one."""
        own = {
            i: self._names.intersection(_COMPONENT.findall(e.text))
            for i, e in enumerate(self.equations)
            if i in rows or (not e.origin and e.kind != "connection")
        }
        shared = set.intersection(*(own[row] for row in rows)) if rows else set()
        return {name for name in shared if {i for i, names in own.items() if name in names} == rows}

    def _shown_by(self, site: Site) -> set[str]:
        """The effect whose result is the output, if one was put there."""
        shown = [r for y, r in zip(self.outputs, self.results, strict=True) if y.name == site.name]
        if site.kind != "output" or not shown or not shown[0].is_symbolic():
            return set()
        return {_owner(shown[0].name())}

    def _joined_to(self, connectors: Iterable[str]) -> set[str]:
        rows = {self._flow_rows[c] for c in connectors if c in self._flow_rows}
        return {_owner(name) for row in rows for name in self.equations[row].origin.split(", ")}

    def _note_laws(self, equations: Iterable[Equation]) -> None:
        """Keep the equations of components as their classes write them."""
        for equation in equations:
            if equation.kind == "component":
                text = equation.text.replace(f"{equation.origin}.", OWN)
                self._laws.setdefault(equation.origin, []).append(text)


def supplied(unit: str, wanted: str) -> Conversion:
    """What makes of an input in a `unit` a signal in the `wanted` one; nothing where either is not known."""
    return conversion(unit, wanted) if wanted and is_of(unit, wanted) else Conversion()


def check_values(effect: Effect, values: Mapping[str, float]) -> None:
    """Raise ModelError for a value of a parameter that the effect does not have, or outside of its bounds."""
    known = {p.name: p for p in effect.parameters}
    for name, value in values.items():
        if name not in known:
            hint = did_you_mean(name, known, 2)
            raise ModelError(
                "effect-parameter",
                f"{effect.name} has no parameter `{name}`",
                remedy=f"{hint}It has {', '.join(known)}.",
            )
        low, high = known[name].min, known[name].max
        if not (low is None or value >= low) or not (high is None or value <= high):
            raise ModelError(
                "parameter-outside-bounds",
                f"parameter `{name}` of {effect.name}: {value:g} is outside of "
                f"{'-inf' if low is None else f'{low:g}'} to {'inf' if high is None else f'{high:g}'}",
                remedy="Choose a value inside.",
            )


def given_source(parameter: EffectParameter, site: Site) -> str:
    """The parameter of the model that the site supplies for one of role "given"; empty if there is none."""
    return site.given.get(parameter.given_from, "") if parameter.role == "given" else ""


def _placed(equation: Equation, component: str) -> Equation:
    parts = [f"{component}.{o}" if o else component for o in equation.origin.split(", ")]
    return replace(equation, text=equation.text.replace(OWN, f"{component}."), origin=", ".join(parts))


def _placed_derived(derived: DerivedParameter, component: str) -> DerivedParameter:
    expression = derived.expression.replace(OWN, f"{component}.")
    return replace(derived, name=f"{component}.{derived.name}", expression=expression)


def _placed_noise(noise: NoiseInput, component: str) -> NoiseInput:
    source = noise.intensity_parameter
    return replace(
        noise,
        name=f"{component}.{noise.name}",
        intensity_parameter=f"{component}.{source}" if source else "",
    )


def _potential_of(variable: Variable, symbol: ca.SX) -> tuple[str, ca.SX]:
    """A variable as the potential of a connector, as text and as an expression: temperatures are absolute,
    and all is in the unit of its domain."""
    return _converted(variable.name, symbol, in_connectors(variable.unit))


def _converted(name: str, symbol: ca.SX, change: Conversion) -> tuple[str, ca.SX]:
    scaled = symbol if change.scale == 1.0 else change.scale * symbol
    return converted_text(name, change), scaled if change.offset == 0.0 else scaled + change.offset


def _owner(name: str) -> str:
    """The component of a variable or connector; the name itself at top level."""
    return name.rpartition(".")[0] or name


def _is_tied(equation: Equation, current: str) -> bool:
    """Whether the equation gives a connector the current of an input."""
    return equation.kind == "connection" and not equation.origin and equation.text.endswith(f" = {current}")


def _reads(equation: Equation, name: str) -> bool:
    return equation.kind == "connection" and equation.text.partition(" = ")[0] == name


def _inverse(change: Conversion) -> Conversion:
    """From the unit of a connector of the library back to that of a variable."""
    if change == Conversion():
        return change
    return Conversion(scale=1.0 / change.scale, offset=-change.offset / change.scale)


def _renamed(text: str, old: str, new: str) -> str:
    return re.sub(rf"(?<![\w.]){re.escape(old)}(?![\w.])", new, text)
