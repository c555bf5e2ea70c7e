"""Units of an effect's parameters at a place: those of the signal there, and none in an equation whose terms
have no known unit."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence

import casadi as ca
import numpy as np

from daest.model.effects import Domain, Effect, EffectParameter, Site
from daest.model.flat import FlatModel
from daest.modelica.flat.clock import clock_unit, in_clock, put_in
from daest.modelica.flat.connectors import FLOWS, LEVEL, MASS_FLOW, connectors_of
from daest.modelica.flat.factors import ONE, Entry, are_same, divisors, factors, given_value, is_of_parameters
from daest.modelica.flat.other_units import SCALES, in_other_units, power_of
from daest.modelica.places.balances import DOMAINS, Balance, balances, base_unit, is_length
from daest.quantities import conversion, dimensions, in_base_units, is_known_unit, is_of, over_power

_PRESSURE = re.compile(r"\bPa")  # in the unit of a parameter: the unit of a level, where that is the variable
_SIGNAL = "u"  # in the unit of a parameter: the unit of the signal
_INVERSE = "1/u"
_INVERSE_RATE = "1/(u.s)"
_NOT_BY_SECONDS = (_SIGNAL, _INVERSE, _INVERSE_RATE)  # nothing to convert, or converted as it is made
_VOLUME_AT_PRESSURE = "Pa.m3/s"
_GAS_FLOWS = (MASS_FLOW, _VOLUME_AT_PRESSURE)
_TOLERANCE = 1e-9  # relative, of numbers that rounding alone makes differ


def units_at(
    flat: FlatModel,
    effect: Effect,
    site: Site,
    clock: str | None = None,
    inputs: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Unit of every parameter of `effect` at `site` of the model, by its name; empty where it is not known.
    The `clock` is that of the model (`clock_unit`), for who asks for many effects. `inputs` names the
    variables that a parameter changes with."""
    if effect.is_of_variable:
        known = {y.name: y.unit for y in flat.outputs}
        known |= {x.name: x.unit for x in (*flat.unknowns, *flat.inputs)}
        unit = known.get((inputs or {}).get(effect.inputs[0], ""), "")
        return {p.name: _of_variable(p, unit) for p in effect.parameters}
    clock = clock_unit(flat) if clock is None else clock
    units = _units_in_seconds(flat, effect, site, clock)
    if clock == "s":
        return units
    of_signal = site.kind in ("input", "output", "signal")
    stores = {size.name for size in effect.sizes if effect.is_dynamic and size.unit != "s" and not of_signal}
    # A discharge in m3/s is in that whatever the model counts: seconds of the law stand behind "u/s" alone.
    by_unit = of_signal or effect.domain == "amount"
    kept = {p.name for p in effect.parameters if by_unit and p.signal_unit in _NOT_BY_SECONDS}
    told = {name: unit if name in kept else in_clock(unit, clock) for name, unit in units.items()}
    return {name: "" if name in stores else unit for name, unit in told.items()}


def _units_in_seconds(flat: FlatModel, effect: Effect, site: Site, clock: str) -> dict[str, str]:
    """The units of `units_at` where the model counts time in seconds, but for those over a signal and the
    time of the `clock`."""
    if site.parts:
        return _units_in_seconds(flat, effect, site.parts[0], clock)
    given = {p.name: p.unit for p in effect.parameters}
    if site.kind in ("input", "output", "signal"):
        known = {x.name: x.unit for x in flat.unknowns} if site.kind == "signal" else {}
        known |= {x.name: x.unit for x in flat.inputs} | {y.name: y.unit for y in flat.outputs}
        unit = known.get(site.name, "")
        return {p.name: _of_signal(p, unit, clock) for p in effect.parameters}
    if site.kind == "equation" and effect.domain == "amount":
        return _of_amount(flat, effect, _balance_of(flat, site.name), clock)
    if site.kind in ("equation", "exchange"):
        balance = _balance_of(flat, site.name.split(", ")[0])
        if balance is not None and not balances_flows(flat, balance):
            unit = balance.potential(flat).unit
            own = (base_unit(unit) or unit, "s")
            if balance.is_level(flat):  # m3/s is made of m and s, too, but the terms may be anything
                given = {name: "" if "m3" in unit else unit for name, unit in _as_levels(given).items()}
            return {name: unit if _is_made_of(unit, own) else "" for name, unit in given.items()}
        if balance is not None and balance.is_level(flat):
            return _as_levels(given)
        of_row = flow_of(flat, balance)[0] if balance is not None else ""
        if of_row in _GAS_FLOWS:
            return {p.name: _of_other_flow(p.unit, of_row) for p in effect.parameters}
    if site.connectors and site.domain == "hydraulic":
        of_potential, of_flow = _units_of_connector(flat, site)
        if of_flow == MASS_FLOW:
            return {p.name: _of_mass(p.unit) for p in effect.parameters}
        if is_length(of_potential):
            return _as_levels(given)
        if of_flow and not is_of(of_flow, FLOWS["hydraulic"]):
            return {p.name: _of_other_flow(p.unit, of_flow) for p in effect.parameters}
    if site.kind == "mesh" and site.domain == "hydraulic":
        number, name = site.name.split(":", 1)
        row, flow = int(number), flat.unknown_names.index(name)
        if any(is_of_heads(flat, row, flow, one) for one in (ONE, *parts_divided_by(flat, row)[0])):
            return _as_levels(given)
    return given


def _as_levels(units: Mapping[str, str]) -> dict[str, str]:
    """The units with levels in m in place of pressures.

    >>> _as_levels({"p_max": "Pa", "G": "m3/(s.Pa)"})
    {'p_max': 'm', 'G': 'm3/(s.m)'}
    """
    return {name: _PRESSURE.sub(LEVEL, unit) for name, unit in units.items()}


def _of_amount(flat: FlatModel, effect: Effect, balance: Balance | None, clock: str) -> dict[str, str]:
    """The units of an effect on an amount: what is a rate of it has no known unit where the rate stands
    behind a factor that moves, since the term is then no rate alone."""
    if balance is None:
        return dict.fromkeys((p.name for p in effect.parameters), "")
    unit, is_rate = balance.potential(flat).unit, rate_factor(flat, balance) is not None
    is_known = {p.name: is_rate or p.role != "size" for p in effect.parameters}
    return {p.name: _of_signal(p, unit, clock) if is_known[p.name] else "" for p in effect.parameters}


def _units_of_connector(flat: FlatModel, site: Site) -> tuple[str, str]:
    """The units of the potential and of the flow of the connectors of a site."""
    connector = connectors_of(flat.unknowns).get(site.connectors[0])
    if connector is None:
        return "", ""
    return flat.unknowns[connector.potential].unit, flat.unknowns[connector.flow].unit


def _of_mass(unit: str) -> str:
    """The unit of a law of volume flows where masses flow.

    >>> _of_mass("m3/(s.Pa)"), _of_mass("Pa.s2/m6")
    ('kg/(s.Pa)', 'Pa.s2/kg2')
    """
    return unit.replace("m3", "kg").replace("m6", "kg2")


def _of_other_flow(unit: str, flow: str) -> str:
    """The unit of a law of volume flows where something else flows, in `flow`; empty where that is not a
    flow, or one over a power of a pressure.

    >>> _of_other_flow("m3/(s.Pa2)", "mbar.l/s"), _of_other_flow("Pa.s2/m6", "mbar.l/s")
    ('mbar.l/(s.Pa2)', '')
    """
    if "m3" not in unit and "m6" not in unit:
        return unit
    if not is_known_unit(flow):
        return ""
    power = {"m3/s": 0, "m3/(s.Pa)": 1, "m3/(s.Pa2)": 2}.get(unit)
    return "" if power is None else over_power(flow, "Pa", power)


def carries_gas(flat: FlatModel, site: Site) -> bool:
    """Whether what flows between the connectors of a site may be a gas: mass, or pressure times volume.
    Where volumes balance, or the pressure is a level, it is a liquid."""
    if site.domain != "hydraulic":
        return False
    of_potential, of_flow = _units_of_connector(flat, site)
    is_volume = not is_known_unit(of_flow) or is_of(of_flow, FLOWS["hydraulic"])
    return not is_volume and not is_length(of_potential)


def flow_unit(flat: FlatModel, site: Site) -> str:
    """Unit of the terms of the bare equation at `site` where they are flows of its domain, or pressures or
    heads along a line, else empty (those of a mesh may be voltages, currents or rates)."""
    if site.kind == "mesh" and site.domain == "hydraulic":
        residual = flat.residual[int(site.name.partition(":")[0])]
        return next((unit for unit in ("Pa", LEVEL) if has_unit(flat, residual, unit)), "")
    balance = _balance_of(flat, site.name) if site.kind == "equation" else None
    return "" if balance is None else flow_of(flat, balance)[0]


def flows_in_rows(flat: FlatModel, rows: Sequence[int]) -> list[ca.SX]:
    """By what a flow in the unit of `flow_unit` is multiplied in each of the equations `rows`; 1 where that
    is no balance, or does not tell."""
    known = {b.row: balance_entry(flat, b).factor for b in balances(flat) if b.row in rows}
    return [known.get(row, ONE) for row in rows]


def _balance_of(flat: FlatModel, name: str) -> Balance | None:
    return next((b for b in balances(flat) if b.name(flat) == name), None)


def _of_signal(parameter: EffectParameter, unit: str, clock: str) -> str:
    """`u` stands for the unit of the signal, `u/s` for that per second, `1/u` for one over it, `1/(u.s)` for
    one over it and over the unit of the `clock`; without one, none is known."""
    written = parameter.signal_unit
    if not written:
        return parameter.unit
    if not unit or written == _SIGNAL:
        return unit
    if written == _INVERSE:
        return _one_over(unit)
    if written == _INVERSE_RATE:
        over, _, under = unit.partition("/")
        return f"1/{clock}" if unit == "1" else f"{under.strip('()') or 1}/({over}.{clock})"
    return (f"({unit})" if "/" in unit else unit) + written.removeprefix(_SIGNAL)


def _of_variable(parameter: EffectParameter, unit: str) -> str:
    """`z` stands for the unit of a variable that a parameter changes with, `1/z` for one over it."""
    if not parameter.signal_unit:
        return parameter.unit
    return unit if parameter.signal_unit == "z" or not unit else _one_over(unit)


def _one_over(unit: str) -> str:
    return "1" if unit == "1" else f"1/({unit})" if set(unit) & set("./") else f"1/{unit}"


def balances_flows(flat: FlatModel, balance: Balance) -> bool:
    """Whether the terms of the equation have the unit of its domain's flow, as they stand or over a storage
    (`flow_factor`)."""
    return flow_factor(flat, balance) is not None


def flow_factor(flat: FlatModel, balance: Balance) -> ca.SX | None:
    """By what a flow of the domain is multiplied in the equation: 1 in `m*der(v) = F - d*v`, 1/m in
    `der(v) = (F - d*v)/m`, as the units of the variables and parameters in the factor of the rate, or in what
    is divided by, tell, or else known flows; None where nothing does, or the variable has no unit.

    In other base units every quantity has another value. The factor must change as flow over rate does.
    """
    return flow_of(flat, balance)[1]


def flow_of(flat: FlatModel, balance: Balance) -> tuple[str, ca.SX | None]:
    """The unit of the flows that an equation balances, and their factor (`flow_factor`): that of its domain,
    or else of a gas, of which masses balance, or pressure times volume. Without a factor the unit is empty.
    """
    domain = balance.domain(flat)
    if domain is None:
        return "", None
    may_be_gas = domain == "hydraulic" and balance.store < 0 and balance.potential(flat).unit in DOMAINS
    for unit in (FLOWS[domain], *(_GAS_FLOWS if may_be_gas else ())):
        factor = _factor_of(flat, balance, unit)
        if factor is not None:
            return unit, factor
    return "", None


def _factor_of(flat: FlatModel, balance: Balance, unit: str) -> ca.SX | None:
    """By what a flow in the `unit` is multiplied in the equation (`flow_factor`)."""
    variable = balance.potential(flat)
    if balance.store >= 0:
        return _into_store(flat, balance, unit)
    wanted, rate = dimensions(unit), dimensions(variable.unit)
    if wanted is None or rate is None:
        return None
    if variable.unit not in (*DOMAINS, LEVEL) or _has_flow_of_other_scale(flat, balance, unit):
        return _slope_of_flow(flat, balance, unit)
    need = {d: wanted.get(d, 0.0) - rate.get(d, 0.0) for d in {*wanted, *rate}}
    need["[time]"] = need.get("[time]", 0.0) + 1.0
    if _slope_has(flat, balance.row, balance.rate, need):
        return ONE / _scale_of_terms(flat, balance, unit)
    over = _beside_storage(flat, balance, need)
    if over is not None:
        return over
    for found in parts_divided_by(flat, balance.row):
        storages = [one for one in found if _slope_has(flat, balance.row, balance.rate, need, one)]
        if storages:
            is_one = all(are_same(flat, one, storages[0]) for one in storages)
            return 1.0 / storages[0] if is_one else None
    # Heat and power have the unit of pressure times volume over time, and are not what flows.
    return None if unit == _VOLUME_AT_PRESSURE else _slope_of_flow(flat, balance, unit)


def _into_store(flat: FlatModel, balance: Balance, unit: str) -> ca.SX | None:
    """As `flow_factor`, in the equation of what is stored, `der(V) = q`: where the unit of that makes its
    rate a flow in `unit` but for a scale, as kJ does beside W, what stands before the rate; else as a known
    flow that stands there is multiplied."""
    stored = flat.unknowns[balance.store].unit
    before = ca.simplify(balance.sign * _slope(flat, balance.row, balance.rate))
    own, wanted = dimensions(f"({stored})/s") if stored else None, dimensions(unit)
    if own is not None and own == wanted and is_of_parameters(flat, before) and _changes_as(flat, before, {}):
        scale = in_base_units(unit) * in_base_units(clock_unit(flat)) / in_base_units(stored)
        return ca.simplify(before * scale)
    return _slope_of_flow(flat, balance, unit)


def _beside_storage(flat: FlatModel, balance: Balance, need: Mapping[str, float]) -> ca.SX | None:
    """What a storage is multiplied by in the factor of the rate: R in `R*C*der(v) = u - v`, where all terms
    are voltages and a current stands times R. None where no factor, or several, have the dimensions that a
    storage `need`s."""
    rate = ca.simplify(balance.sign * _slope(flat, balance.row, balance.rate))
    parts = list(factors(rate))
    storages = [k for k, one in enumerate(parts) if not one.is_constant() and _changes_as(flat, one, need)]
    if len(storages) != 1 or not is_of_parameters(flat, rate):
        return None
    return ca.simplify(rate / parts[storages[0]])


def _scale_of_terms(flat: FlatModel, balance: Balance, unit: str) -> float:
    """How many of a flow's `unit` one of the terms of the equation is, as the factor of the rate tells: 1000
    W in `C*der(T) = G*(T_a - T)` with C in kJ/K. 1 where that factor moves, or a flow stands there, or a
    number that may be a conversion."""
    factor, row = _slope(flat, balance.row, balance.rate), flat.residual[balance.row]
    if not is_of_parameters(flat, factor):
        return 1.0
    value = ca.Function("value", [flat.theta], [factor])
    has_number = abs(float(value(np.ones(flat.theta.numel())))) != 1.0
    if has_number or any(ca.depends_on(row, symbol) for symbol, _ in _flows(flat, unit)):
        return 1.0
    size = abs(float(value([in_base_units(p.unit) for p in flat.parameters])))
    return size * in_base_units(flat.unknowns[balance.variable].unit) / in_base_units(clock_unit(flat))


def _slope_of_flow(flat: FlatModel, balance: Balance, unit: str) -> ca.SX | None:
    """By what a flow in `unit` is multiplied in the equation of a variable that is in a unit of its own,
    whose scale may be anywhere in it, or beside parameters without units: as the known flows are that stand
    there, inputs and unknowns, be it with the sign of what drives or of what brakes. None where there is
    none, where its factor changes as the model moves, or where they do not agree: of a motor behind a gear of
    any ratio those count that nothing but a number stands before."""
    found = []
    for symbol, scale in _flows(flat, unit):
        slope = ca.jacobian(flat.residual[balance.row], symbol)
        if slope.nnz() and is_of_parameters(flat, slope):
            found.append(ca.simplify(slope / scale * np.sign(given_value(flat, slope))))
    for agreeing in (found, [one for one in found if one.is_constant()]):
        if agreeing and all(are_same(flat, one, agreeing[0]) for one in agreeing):
            return agreeing[0]
    return None


def _has_flow_of_other_scale(flat: FlatModel, balance: Balance, unit: str) -> bool:
    """Whether a flow in the equation is in kW, say, where that of the domain is in W: then all its terms
    are."""
    row = flat.residual[balance.row]
    return any(scale != 1.0 and ca.depends_on(row, symbol) for symbol, scale in _flows(flat, unit))


def _flows(flat: FlatModel, unit: str) -> Iterator[tuple[ca.SX, float]]:
    """The unknowns and inputs that convert to `unit`, each with the scale of its own unit; not those of
    loads and effects that were put in, which were told their factor themselves."""
    others = put_in(flat)
    known = [*zip(flat.unknowns, ca.vertsplit(flat.xi), strict=True)]
    known += zip(flat.inputs, ca.vertsplit(flat.u) if flat.u.numel() else [], strict=True)
    for variable, symbol in known:
        is_own = variable.name.partition(".")[0] not in others
        if is_own and is_of(variable.unit, unit):
            yield symbol, conversion(variable.unit, unit).scale


def balance_entry(flat: FlatModel, balance: Balance, domain: Domain | None = None) -> Entry:
    """Where a flow of an effect of a `domain` enters the model at a balance; one whose units do not tell
    takes it as it is. What enters an amount is a rate of it, and stands beside the rate that is there."""
    factor = rate_factor(flat, balance) if domain == "amount" else flow_factor(flat, balance)
    return Entry(balance.row, balance.sign, ONE if factor is None else factor)


def rate_factor(flat: FlatModel, balance: Balance) -> ca.SX | None:
    """By what the rate is multiplied in the equation of a balance, without the sign: V in `V*der(c) = q`.
    None where that moves with the model, as the volume of a vessel that fills does."""
    factor = ca.simplify(balance.sign * _slope(flat, balance.row, balance.rate))
    return factor if is_of_parameters(flat, factor) else None


def has_drop(flat: FlatModel, row: int, flow: int, drop: str, unit: str, times: ca.SX = ONE) -> bool:
    """Whether an equation, `times` an expression, is a sum of terms of the unit `drop` along a path of the
    unknown `flow` of that `unit`, as the units of the variables and parameters before the flow, or before its
    rate, tell: of one of them, since a number that stands for a density hides the unit of the other."""
    for at, over in ((flat.n + flow, f"({drop}).s/({unit})"), (flow, f"({drop})/({unit})")):
        need = dimensions(over)
        assert need is not None
        if _in_units(flat, _slope(flat, row, at))({}) and _slope_has(flat, row, at, need, times):
            return True
    return False


def scale_of_drops(flat: FlatModel, row: int, flow: int, times: ca.SX = ONE) -> float:
    """How many V one of the terms of an equation along a path of the unknown `flow` is, `times` what they are
    divided by, as the factor of the flow or of its rate tells: 1000 in `u = R*i` with R in kOhm and i in A.
    1 where both move or hold a number that may be a conversion."""
    per_time = in_base_units(clock_unit(flat))
    for at, time in ((flat.n + flow, per_time), (flow, 1.0)):
        factor = ca.simplify(times * _slope(flat, row, at))
        if not is_of_parameters(flat, factor):
            continue
        value = ca.Function("value", [flat.theta], [factor])
        if abs(float(value(np.ones(flat.theta.numel())))) == 1.0:
            size = abs(float(value([in_base_units(p.unit) for p in flat.parameters])))
            return float(f"{size * in_base_units(flat.unknowns[flow].unit) / time:.12g}")
    return 1.0


def is_of_heads(flat: FlatModel, row: int, flow: int, times: ca.SX = ONE) -> bool:
    """Whether the equation, `times` an expression, is a sum of heads, in meters of the liquid, along a path
    of the unknown `flow`."""
    return has_drop(flat, row, flow, LEVEL, FLOWS["hydraulic"], times)


def parts_divided_by(flat: FlatModel, row: int) -> tuple[list[ca.SX], list[ca.SX]]:
    """What an equation is divided by anywhere that only parameters change, and the factors of these: a time
    constant R*C, too, has the storage in it."""
    over = [one for one in divisors(flat.residual[row]) if is_of_parameters(flat, one)]
    return over, [factor for one in over for factor in factors(one)]


def has_unit(flat: FlatModel, expression: ca.SX, unit: str) -> bool:
    """Whether the terms of a scalar expression have the unit, as those of its variables and parameters
    tell."""
    need = dimensions(unit)
    assert need is not None
    return _changes_as(flat, expression, need)


def _slope_has(flat: FlatModel, row: int, at: int, need: Mapping[str, float], times: ca.SX = ONE) -> bool:
    """Whether the slope of an equation, `times` an expression, has these dimensions."""
    return _changes_as(flat, times * _slope(flat, row, at), need)


def _slope(flat: FlatModel, row: int, at: int) -> ca.SX:
    return ca.jacobian(flat.residual[row], ca.vertcat(flat.xi, flat.derivatives)[at])


def _changes_as(flat: FlatModel, expression: ca.SX, need: Mapping[str, float]) -> bool:
    """Whether a scalar expression has other values in other base units as what has these dimensions."""
    value = _in_units(flat, expression)
    return bool(np.isclose(value(SCALES), value({}) * power_of(SCALES, need), rtol=_TOLERANCE, atol=0.0))


def _in_units(flat: FlatModel, expression: ca.SX) -> Callable[[Mapping[str, float]], float]:
    """The expression with every quantity in base units changed by scales."""
    symbols = [ca.vertcat(flat.xi, flat.derivatives), flat.u, flat.theta, flat.w, flat.time]
    evaluate = ca.Function("value", symbols, [expression])
    units = [v.unit for v in flat.unknowns]

    def value(scales: Mapping[str, float]) -> float:
        values = [
            in_other_units([*units, *(f"({unit})/s" if unit else "" for unit in units)], scales),
            in_other_units([v.unit for v in flat.inputs], scales),
            flat.theta_values * in_other_units([p.unit for p in flat.parameters], scales),
            np.zeros(flat.w.numel()),
            scales.get("[time]", 1.0),
        ]
        return float(evaluate(*values))

    return value


def _is_made_of(unit: str, known: Sequence[str]) -> bool:
    """Whether the unit is a product of powers of the known ones."""
    parts = [dimensions(one) or {} for one in (*known, unit)]
    names = sorted({d for part in parts for d in part})
    table = np.array([[part.get(d, 0.0) for d in names] for part in parts])
    rest = table[-1] - np.linalg.lstsq(table[:-1].T, table[-1], rcond=None)[0] @ table[:-1]
    return bool(np.linalg.norm(rest) < _TOLERANCE)
