"""Meshes among the bare equations of a model: rows such as `u = R*i + Ke*w` or `L*der(i) = u - R*i - Ke*w`,
the sums of voltages along a path with one current, where an effect can be put in series; and those of
pressures along a pipe with one flow, `L*der(q) = p - R*q`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from daest.model.effects import Domain
from daest.model.flat import FlatModel
from daest.modelica.flat.factors import (
    ONE,
    are_same,
    given_value,
    is_of_parameters,
    sum_around,
    variables_text,
)
from daest.modelica.language.text import times_text
from daest.modelica.places.balances import own_laws, slopes_near_start
from daest.modelica.places.place_units import (
    has_drop,
    has_unit,
    is_of_heads,
    parts_divided_by,
    scale_of_drops,
)
from daest.modelica.places.terminals import CURRENT, VOLTAGE
from daest.modelica.places.written_out import FLUX, in_potentials, potential, potential_symbol, written_out
from daest.quantities import conversion, in_base_units, is_of

_RESISTANCE = "Ohm"
UNITS: dict[Domain, tuple[str, str]] = {  # of what drops along the path, and of what flows
    "electrical": (VOLTAGE, CURRENT),
    "hydraulic": ("Pa", "m3/s"),
}


class WrittenOut(NamedTuple):
    """A current without a variable: the sum of the voltages along its path over a `resistance`, a parameter;
    its only `source` in the row, by name and symbol, drives it."""

    current: ca.SX
    resistance: str
    source: tuple[str, ca.SX]


@dataclass(frozen=True)
class Mesh:
    """Row `row` with the current that is the unknown `flow`, or one that the row holds without a variable, as
    in `J*der(w) = k*(u - k*w)/R`, called `R`. `sign` is the factor with which a voltage against the current
    enters the residual where the terms are voltages. Where they are currents or rates, the voltage is taken
    off the `source`, a voltage of the row: its name and its symbol; where several stand there, the `factor`
    is what the voltage is multiplied by. In the hydraulic domain read pressure, or head, and flow for voltage
    and current. One V is `per_drop` of the unit of the source, and one of the unit of the current `per_flow`
    A: effects are in V and A whatever the equation is in, as the `factor` of its terms is told, too. Where
    the unknown is a flux, as in `der(psi) = u - R*psi/L`, `per` is the number of the inductance, -1 else."""

    domain: Domain
    row: int
    flow: int | WrittenOut
    sign: float
    source: tuple[str, ca.SX] | None = None
    factor: ca.SX = ONE
    per_drop: float = 1.0
    per_flow: float = 1.0
    per: int = -1

    def name(self, flat: FlatModel) -> str:
        return f"{self.row}:{self.flow_name(flat)}"

    def aliases(self, flat: FlatModel) -> tuple[str, ...]:
        return flat.equations[self.row].text, self.flow_name(flat)

    def flow_name(self, flat: FlatModel) -> str:
        if not isinstance(self.flow, int):
            return self.flow.resistance
        return potential(flat, self.flow, self.per).name

    def term_name(self, flat: FlatModel) -> str:
        """The variable that a component in the mesh is called after."""
        return flat.unknowns[self.flow].name if isinstance(self.flow, int) else self.flow.source[0]

    def current(self, flat: FlatModel, drop: ca.SX) -> ca.SX:
        """The current [A] while the voltage `drop` [V] is taken off the source."""
        if isinstance(self.flow, int):
            return self.per_flow * potential_symbol(flat, self.flow, self.per)
        _, symbol = self.flow.source
        return self.per_flow * ca.substitute(self.flow.current, symbol, symbol - self.per_drop * drop)

    def current_text(self, flat: FlatModel, drop: str) -> str | None:
        """The same as Modelica writes it; None where it has no text."""
        if isinstance(self.flow, int):
            return times_text(self.per_flow, self.flow_name(flat))
        name, _ = self.flow.source
        written = variables_text(self.flow.current, flat, {name: self.lowered(name, drop)})
        return None if written is None else times_text(self.per_flow, written)

    def lowered(self, source: str, drop: str) -> str:
        """The text of a source from which a voltage is taken."""
        return f"({source} - {times_text(self.per_drop, drop)})"


def meshes(flat: FlatModel) -> list[Mesh]:
    """Rows of the model itself, not of its components, that are sums of voltages or pressures, or follow from
    one."""
    rows = own_laws(flat)
    if not rows:  # reading units takes longer than anything else here
        return []
    resistances = [k for k, p in enumerate(flat.parameters) if is_of(p.unit, _RESISTANCE)]
    over = [_written_out(flat, row, k) for row in rows for k in resistances]
    return [*_in_currents(flat, rows), *(_in_units(flat, mesh) for mesh in over if mesh is not None)]


def _fluxes(flat: FlatModel) -> dict[int, int]:
    """Unknowns that are fluxes -> the inductances over which they are written out as currents."""
    if not any(is_of(v.unit, FLUX) for v in flat.unknowns):
        return {}
    found = written_out(flat, slopes_near_start(flat), ())
    return {i: k for i, k in found.items() if is_of(flat.unknowns[i].unit, FLUX)}


def _in_currents(flat: FlatModel, rows: Sequence[int]) -> list[Mesh]:
    """The rows with an unknown, or one over a parameter, that is their current."""
    fluxes = _fluxes(flat)
    shown = in_potentials(flat, fluxes)
    currents = [
        (domain, k)
        for domain, (_, unit) in UNITS.items()
        for k, v in enumerate(shown.unknowns)
        if is_of(v.unit, unit)
    ]
    if not currents:
        return []
    slopes = slopes_near_start(shown)
    found = [(k, _mesh(shown, slopes, row, domain, k)) for row in rows for domain, k in currents]
    return [replace(_in_units(shown, mesh), per=fluxes.get(k, -1)) for k, mesh in found if mesh is not None]


def _in_units(flat: FlatModel, mesh: Mesh) -> Mesh:
    """The mesh with what its units are in those of effects: of mA and kOhm, or l/min and bar."""
    per_drop = 1.0 if mesh.source is None else _per_drop(flat, mesh.source[0])
    if not isinstance(mesh.flow, int):
        resistance = flat.parameters[flat.parameter_names.index(mesh.flow.resistance)].unit
        per_flow = _rounded(1.0 / (per_drop * in_base_units(resistance)))
        return replace(mesh, per_drop=per_drop, per_flow=per_flow)
    unit = UNITS[mesh.domain][1]
    per_flow = _rounded(conversion(flat.unknowns[mesh.flow].unit, unit).scale)
    if mesh.source is not None:
        return replace(mesh, per_drop=per_drop, per_flow=per_flow)
    scale = scale_of_drops(flat, mesh.row, mesh.flow, 1.0 / mesh.factor)
    return replace(mesh, factor=ca.simplify(mesh.factor / scale), per_flow=per_flow)


def _per_drop(flat: FlatModel, name: str) -> float:
    """How many of the unit of a voltage one V is."""
    unit = next(v.unit for v in (*flat.inputs, *flat.unknowns) if v.name == name)
    return _rounded(1.0 / in_base_units(unit))


def _rounded(value: float) -> float:
    """Without what rounding has left of a power of ten."""
    return float(f"{value:.12g}")


def _mesh(flat: FlatModel, slopes: np.ndarray, row: int, domain: Domain, current: int) -> Mesh | None:
    """The row as a mesh of the current; None where it is none, or where no voltage tells which way the
    current flows."""
    at = next((k for k in (flat.n + current, current) if slopes[row, k]), None)
    if at is None:
        return None
    sign = float(np.sign(slopes[row, at]))
    voltage, unit = UNITS[domain]
    if _is_sum(flat, row, current, domain):
        return Mesh(domain, row, current, sign)
    others = np.delete(slopes[row], at)
    rates, source = others[flat.n - (at < flat.n) :], _source(flat, row, voltage)
    # `C*der(v) = i - v/R` and `i = i1 + v/R` are sums of currents.
    if np.any(rates) or _holds_current(flat, row, current, unit):
        return None
    if source is None:
        over = [one for one in parts_divided_by(flat, row)[0] if _is_sum(flat, row, current, domain, one)]
        return Mesh(domain, row, current, sign, factor=1.0 / over[0]) if over else None
    slope = ca.jacobian(flat.residual[row], source[1])
    if not is_of_parameters(flat, slope):
        return None
    return Mesh(domain, row, current, sign, source) if np.sign(given_value(flat, slope)) == -sign else None


def _is_sum(flat: FlatModel, row: int, current: int, domain: Domain, times: ca.SX = ONE) -> bool:
    """Whether the row, `times` what it is divided by, is a sum of voltages, pressures or heads."""
    voltage, unit = UNITS[domain]
    is_of_levels = domain == "hydraulic" and is_of_heads(flat, row, current, times)
    return is_of_levels or has_drop(flat, row, current, voltage, unit, times)


def _written_out(flat: FlatModel, row: int, resistance: int) -> Mesh | None:
    """The row as one that holds the current through a resistance without a variable; None where it does not,
    or where no voltage tells which way the current flows."""
    residual, R = flat.residual[row], flat.theta[resistance]
    source = _source(flat, row, VOLTAGE) if ca.depends_on(residual, R) else None
    if source is None or _holds_current(flat, row, None, CURRENT):
        return None
    slope = ca.jacobian(residual, source[1])
    if not is_of_parameters(flat, slope):
        return None
    total = sum_around(residual, source[1])
    if (
        total is None
        or not are_same(flat, R * ca.jacobian(slope, R), -slope)
        or not has_unit(flat, total, VOLTAGE)
    ):
        return None
    direction = ca.jacobian(total, source[1])
    current = WrittenOut(direction * total / R, flat.parameter_names[resistance], source)
    return Mesh("electrical", row, current, 1.0, source)


def _holds_current(flat: FlatModel, row: int, current: int | None, unit: str) -> bool:
    """Whether a variable of that unit other than the unknown `current` stands in the row."""
    known = [(v.unit, flat.xi[k]) for k, v in enumerate(flat.unknowns) if k != current]
    known += [(v.unit, flat.u[k]) for k, v in enumerate(flat.inputs)]
    found = [x for other, x in known if is_of(other, unit)]
    return bool(found) and bool(ca.depends_on(flat.residual[row], ca.vertcat(*found)))


def _source(flat: FlatModel, row: int, unit: str) -> tuple[str, ca.SX] | None:
    """The only variable of that unit in the row that is an input, or else the only one that is an unknown."""
    for variables, symbols in ((flat.inputs, flat.u), (flat.unknowns, flat.xi)):
        found = [
            (variable.name, symbols[k])
            for k, variable in enumerate(variables)
            if is_of(variable.unit, unit) and ca.depends_on(flat.residual[row], symbols[k])
        ]
        if found:
            return found[0] if len(found) == 1 else None
    return None
