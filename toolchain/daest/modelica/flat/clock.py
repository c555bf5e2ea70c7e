"""In what a model counts time: seconds, unless its balances have a longer unit, as `C*der(T) = Q` has hours
where C is in kW.h/K and Q in kW."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import casadi as ca
import numpy as np

from daest.model.flat import FlatModel, Model
from daest.modelica.flat.factors import is_of_parameters
from daest.modelica.flat.other_units import SCALES, power_of
from daest.quantities import dimensions, in_base_units, parse_unit

_LONGER = frozenset(("min", "h", "hour", "d", "day"))
_CLOCKS = {60: "min", 3600: "h", 86400: "d"}
_TOLERANCE = 1e-9  # relative, of what rounding alone makes differ


def clock_unit(flat: FlatModel) -> str:
    """The unit of the time of a model: `s`, `min`, `h` or `d`.

    In `C*der(T) = a*Q` the unit of C over that of a, times that of T over that of Q, is the unit of time.
    That is told where no number stands before either of them, which might be a conversion, and where all
    such pairs of terms agree. Where there is none, pairs with variables in their factors tell, as flows in
    kmol/h do in `M*der(x) = F*(z - x)` with M in kmol; they are less certain, for units of what is multiplied
    are often left out. Where these tell nothing either, as in `der(X) = mu*S/(K + S)*X`, the rates and times
    among the parameters do, if nothing of the model has any other unit of time in it.
    """
    if not _has_longer_unit(flat):
        return "s"
    units = _own_units(flat)
    told = list(_told(flat, units, is_of_parameters))
    if not told:
        moving = list(_told(flat, units, partial(_is_of_known_units, units)))
        told = moving if _agree(moving) else _of_parameters(flat)
    return _CLOCKS.get(round(told[0]), "s") if _agree(told) else "s"


def _agree(told: Sequence[float]) -> bool:
    return bool(told) and np.allclose(told, told[0], rtol=_TOLERANCE, atol=0.0)


def model_clock(flat: Model) -> str:
    """The `clock_unit` of a model; seconds where it has no equations."""
    return clock_unit(flat) if isinstance(flat, FlatModel) else "s"


def in_clock(unit: str, clock: str) -> str:
    """The unit of a time, or of a rate of a signal, of a law of seconds in a model that counts in `clock`.

    >>> in_clock("s", "h"), in_clock("degC/s", "h"), in_clock("W/K", "h")
    ('h', 'degC/h', 'W/K')
    """
    if unit == "s":
        return clock
    return f"{unit.removesuffix('/s')}/{clock}" if unit.endswith("/s") else unit


def _has_longer_unit(flat: FlatModel) -> bool:
    """Whether any quantity of the model is in a unit of minutes, hours or days."""
    units = {x.unit for part in (flat.unknowns, flat.inputs, flat.parameters) for x in part}
    return any(_LONGER & set(parse_unit(unit)) for unit in units if dimensions(unit))


def _of_parameters(flat: FlatModel) -> list[float]:
    """The seconds in the hour or day that the parameters which are a rate or a time count in; none where a
    unit of the model has time in it in another way, as W has. Minutes tell nothing: speeds are in 1/min."""
    named = put_in(flat)
    own = [
        x.unit
        for part in (flat.unknowns, flat.inputs, flat.parameters)
        for x in part
        if x.name.partition(".")[0] not in named
    ]
    timed = [unit for unit in own if "[time]" in (dimensions(unit) or {})]
    symbols = {symbol for unit in timed for symbol in _LONGER & set(parse_unit(unit))}
    rates = [p.name for p in flat.parameters if set(parse_unit(p.unit)) == symbols]
    is_alone = len(symbols) == 1 and all(symbols & set(parse_unit(unit)) for unit in timed)
    return [in_base_units(*symbols)] if rates and is_alone and "min" not in symbols else []


def _told(
    flat: FlatModel, units: Sequence[str], speaks: Callable[[FlatModel, ca.SX], bool]
) -> Iterator[float]:
    """The seconds in the unit of time, as every rate tells beside every other term of its row whose factor
    `speaks`; not those of loads and effects that were put in, of which `_own_units` tells none."""
    rates = ca.jacobian(flat.residual, flat.derivatives)
    terms = ca.jacobian(flat.residual, ca.vertcat(flat.xi, flat.u))
    for row, variable in zip(*rates.sparsity().get_triplet(), strict=True):
        for at in terms[row, :].sparsity().get_triplet()[1]:
            pair = [rates[row, variable], terms[row, at]]
            if units[variable] and units[at] and speaks(flat, ca.vertcat(*pair)):
                yield from _seconds(flat, units, pair, units[variable], units[at])


def _own_units(flat: FlatModel) -> list[str]:
    """The units of the unknowns and inputs; none of those that were put in."""
    named = put_in(flat)
    known = [*flat.unknowns, *flat.inputs]
    return ["" if x.name.partition(".")[0] in named else x.unit for x in known]


def _is_of_known_units(units: Sequence[str], flat: FlatModel, factors: ca.SX) -> bool:
    """Whether every variable in the factors tells its unit."""
    variables = ca.vertsplit(ca.vertcat(flat.xi, flat.u))
    untold = [x for x, unit in zip(variables, units, strict=True) if not unit]
    return not ca.depends_on(factors, ca.vertcat(flat.derivatives, flat.w, flat.time, *untold))


def put_in(flat: FlatModel) -> frozenset[str]:
    """The loads and effects that were put into a model, by the first part of their names."""
    names = frozenset(flat.unknown_names)
    return flat.attached.union(e.origin for e in flat.equations if e.origin in names)


def _seconds(
    flat: FlatModel, units: Sequence[str], pair: Sequence[ca.SX], unit: str, beside: str
) -> Iterator[float]:
    """The seconds in the unit of time by a `pair` of factors, of the rate of what is in `unit` and of what is
    in `beside`, with the `units` of the variables. Nothing where a number stands in them, or where they tell
    no time."""
    values = ca.Function("values", [flat.theta, ca.vertcat(flat.xi, flat.u)], pair)

    def ratio(size: Callable[[str], float]) -> float:
        sizes = [size(p.unit) for p in flat.parameters], [size(one) for one in units]
        over, under = (float(one) for one in values(*sizes))
        return abs(over * size(unit) / (under * size(beside))) if under else 0.0

    def changed(unit: str) -> float:
        return power_of(SCALES, dimensions(unit) or {})

    told = [ratio(lambda _: 1.0), ratio(changed)]
    if np.allclose(told, [1.0, SCALES["[time]"]], rtol=_TOLERANCE, atol=0.0):
        yield ratio(in_base_units)
