"""Units: Modelica's unit strings, and the conversion of recorded values into the unit of the model.

Modelica writes units as `N.m`, `kg.m2`, `W/(m2.K)`, `rad/s2` (Modelica specification, chapter "Unit
Expressions"). The arithmetic of units is pint's; pint is imported only when two spellings really differ.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from daest.errors import DataError

Factors = dict[str, int]  # unit symbol -> exponent

_TOKEN = re.compile(
    r"\s*(?:(?P<symbol>(?:[cm]?m|in)H2O|[A-Za-zµμΩ°%_]+)|(?P<number>[+-]?\d+)|(?P<mark>\*\*|[./*()^·]))"
)
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_SPELLINGS = {  # Modelica and loggers -> pint
    "°": "deg",
    "°C": "degC",
    "°F": "degF",
    "°K": "K",
    "%": "percent",
    "rev": "turn",
    "r": "turn",
    "U": "turn",  # as German rigs write turns: U/min
    "RPM": "rpm",
    "Torr": "torr",
    "mTorr": "mtorr",
    "PSI": "psi",
    "Volt": "V",
    "Volts": "V",
    "Amp": "A",
    "Amps": "A",
    "Watt": "W",
    "Watts": "W",
    "Second": "s",
    "Seconds": "s",
    "Ampere": "A",
    "Amperes": "A",
    "Hertz": "Hz",
    "Celsius": "degC",
    "Fahrenheit": "degF",
    "Kelvin": "K",
}
_BASES = ("[length]", "[mass]", "[time]", "[current]", "[temperature]")
_KNOWN = {  # in base units, and exponents of the bases: units of the SI, and those that users write most
    "m": (1.0, (1, 0, 0, 0, 0)),
    "kg": (1.0, (0, 1, 0, 0, 0)),
    "s": (1.0, (0, 0, 1, 0, 0)),
    "A": (1.0, (0, 0, 0, 1, 0)),
    "K": (1.0, (0, 0, 0, 0, 1)),
    "rad": (1.0, (0, 0, 0, 0, 0)),
    "Hz": (1.0, (0, 0, -1, 0, 0)),
    "N": (1.0, (1, 1, -2, 0, 0)),
    "Pa": (1.0, (-1, 1, -2, 0, 0)),
    "J": (1.0, (2, 1, -2, 0, 0)),
    "W": (1.0, (2, 1, -3, 0, 0)),
    "C": (1.0, (0, 0, 1, 1, 0)),
    "V": (1.0, (2, 1, -3, -1, 0)),
    "ohm": (1.0, (2, 1, -3, -2, 0)),
    "F": (1.0, (-2, -1, 4, 2, 0)),
    "H": (1.0, (2, 1, -2, -2, 0)),
    "Wb": (1.0, (2, 1, -2, -1, 0)),
    "T": (1.0, (0, 1, -2, -1, 0)),
    "degC": (1.0, (0, 0, 0, 0, 1)),
    "mm": (1e-3, (1, 0, 0, 0, 0)),
    "cm": (1e-2, (1, 0, 0, 0, 0)),
    "km": (1e3, (1, 0, 0, 0, 0)),
    "l": (1e-3, (3, 0, 0, 0, 0)),
    "g": (1e-3, (0, 1, 0, 0, 0)),
    "ms": (1e-3, (0, 0, 1, 0, 0)),
    "min": (60.0, (0, 0, 1, 0, 0)),
    "h": (3600.0, (0, 0, 1, 0, 0)),
    "deg": (math.pi / 180.0, (0, 0, 0, 0, 0)),
    "rpm": (math.pi / 30.0, (0, 0, -1, 0, 0)),
    "mA": (1e-3, (0, 0, 0, 1, 0)),
    "mV": (1e-3, (2, 1, -3, -1, 0)),
    "kN": (1e3, (1, 1, -2, 0, 0)),
    "bar": (1e5, (-1, 1, -2, 0, 0)),
    "kPa": (1e3, (-1, 1, -2, 0, 0)),
    "kJ": (1e3, (2, 1, -2, 0, 0)),
    "kW": (1e3, (2, 1, -3, 0, 0)),
}
_TOGETHER = {  # products written without a mark between their units; pint takes `Nm` for a count of yarn
    "Nm": ("N", "m"),
    "kNm": ("kN", "m"),
    "MNm": ("MN", "m"),
    "mNm": ("mN", "m"),
    "Ncm": ("N", "cm"),
    "Nmm": ("N", "mm"),
    "Nms": ("N", "m", "s"),
    "mNms": ("mN", "m", "s"),
    "Ns": ("N", "s"),
    "kgm": ("kg", "m"),
    "gcm": ("g", "cm"),
    "Ws": ("W", "s"),
    "Vs": ("V", "s"),
    "As": ("A", "s"),
}
_OF_GRAVITY = {"g": "standard_gravity", "mg": "millistandard_gravity"}  # as sensors of acceleration have it
_TURNS: tuple[tuple[Factors, float], ...] = (  # units that count turns in a time, in turns a second
    ({"rpm": 1}, 1 / 60),
    ({"turn": 1, "min": -1}, 1 / 60),
    ({"min": -1}, 1 / 60),
    ({"turn": 1, "s": -1}, 1.0),
    ({"Hz": 1}, 1.0),
)
_MOST_UNITS = 1000  # whose dimensions are remembered: models ask for those of a few units thousands of times
_DEGREES: dict[str, Factors] = {"C": {"degC": 1}, "F": {"degF": 1}}  # as loggers write them
_TEMPERATURES = {"degC", "degF", "degRk", "K"}


@dataclass(frozen=True)
class Conversion:
    """`converted = scale * value + offset`; the offset is nonzero between temperature scales alone."""

    scale: float = 1.0
    offset: float = 0.0

    @property
    def is_identity(self) -> bool:
        return self.scale == 1.0 and self.offset == 0.0

    def __call__(self, values: np.ndarray) -> np.ndarray:
        return values if self.is_identity else self.scale * values + self.offset


def parse_unit(text: str) -> Factors:
    """Exponent of every unit symbol in a Modelica unit expression; `1` and the empty text have none.

    `^`, `**`, `*`, `·` and superscripts are read too, because column headers are written by hand. A product
    behind a slash needs brackets (`W/(m2.K)`), as in Modelica. Raises DataError `unit-unknown` otherwise.
    """
    tokens = _tokens(text)
    if not tokens:
        return {}
    factors, rest = _expression(tokens, text)
    if rest:
        raise _unreadable(text)
    return {symbol: exponent for symbol, exponent in factors.items() if exponent}


def is_unit_expression(text: str) -> bool:
    """Whether the text is written like a unit, known or not."""
    try:
        parse_unit(text)
    except DataError:
        return False
    return True


def is_known_unit(text: str) -> bool:
    """Whether the text is a unit expression of which every symbol is known."""
    return bool(text.strip()) and _dimensions(text) is not None


def over_power(unit: str, other: str, power: float) -> str:
    """The unit of a quantity in `unit` over a `power` of one in `other`; empty where whole exponents do not
    spell it. Raises DataError `unit-unknown` for what is no unit expression.

    >>> over_power("N.m", "V", 2)
    'N.m/V2'
    """
    factors = dict(parse_unit(unit))
    for symbol, exponent in parse_unit(other).items():
        change = power * exponent
        if not float(change).is_integer():
            return ""
        factors[symbol] = factors.get(symbol, 0) - int(change)
    above = [f"{s}{e if e > 1 else ''}" for s, e in factors.items() if e > 0]
    below = [f"{s}{-e if e < -1 else ''}" for s, e in factors.items() if e < 0]
    if not below:
        return ".".join(above) or "1"
    under = ".".join(below)
    return f"{'.'.join(above) or '1'}/{f'({under})' if len(below) > 1 else under}"


def dimensions(text: str) -> dict[str, float] | None:
    """Exponents of the base quantities ([mass], [length], [time], ...) in a unit; those of an angle, of `1`
    and of the empty text are none. None for a unit that is not known."""
    found = _dimensions(text)
    return None if found is None else dict(found)


@lru_cache(maxsize=_MOST_UNITS)
def _dimensions(text: str) -> dict[str, float] | None:
    try:
        factors = parse_unit(text)
        if all(symbol in _KNOWN for symbol in factors):
            return _known_dimensions(factors)
        return {str(d): float(e) for d, e in _in_base_units(factors, text).dimensionality.items()}
    except DataError:
        return None


def _known_dimensions(factors: Factors) -> dict[str, float]:
    """Those of a product of known units, for which pint need not be loaded."""
    total: dict[str, float] = {}
    for symbol, exponent in factors.items():
        for base, power in zip(_BASES, _KNOWN[symbol][1], strict=True):
            total[base] = total.get(base, 0.0) + exponent * power
    return {base: power for base, power in total.items() if power}


def is_of(unit: str, quantity: str) -> bool:
    """Whether a unit is given, and is one of what the unit `quantity` is of: mV and V of a voltage."""
    return bool(unit) and _dimensions(unit) == _dimensions(quantity)


@lru_cache(maxsize=_MOST_UNITS)
def in_base_units(unit: str) -> float:
    """How large one of a unit is in the base units of the SI, 1 of one that is not known; of temperatures as
    differences.

    >>> in_base_units("kW.h/K"), in_base_units("degC"), in_base_units("")
    (3600000.0, 1.0, 1.0)
    """
    try:
        factors = parse_unit(unit)
        if all(symbol in _KNOWN for symbol in factors):
            return math.prod(_KNOWN[symbol][0] ** exponent for symbol, exponent in factors.items())
        return float(_in_base_units(factors, unit).magnitude)
    except DataError:
        return 1.0


def conversion(given: str, wanted: str) -> Conversion:
    """The conversion from unit `given` to unit `wanted`.

    rad counts as 1, deg as π/180. A bare temperature converts with its offset (degC to K); in a product it
    is a difference. As an acceleration g is that of gravity, no gram, and C and F are degrees where a
    temperature is wanted, no coulomb and no farad. Neither Hz nor 1/min becomes rad/s:
    whether a turn or a radian is meant cannot be known; beside rpm and rev/s it is a turn.
    Raises DataError `unit-incompatible` or `unit-unknown`.
    """
    if given == wanted:
        return Conversion()
    source, target = parse_unit(given), parse_unit(wanted)
    if _is_temperature(target):
        source = _DEGREES.get(given, source)
    if source == target:
        return Conversion()
    turns = _turns_per_second(source), _turns_per_second(target)
    if turns[0] is not None and turns[1] is not None:
        return Conversion(turns[0] / turns[1])
    if ("Hz" in source and _has_angle(target)) or (_has_angle(source) and "Hz" in target):
        remedy = (
            "write rev/s for turns, or rad/s for angles, in the header or under [data.units] in daest.toml"
        )
        raise _incompatible(given, wanted, remedy)
    if source == {"min": -1} and _has_angle(target):
        remedy = (
            "write rpm for turns, or rad/min for angles, in the header or under [data.units] in daest.toml"
        )
        raise _incompatible(given, wanted, remedy)
    if given in _OF_GRAVITY and _is_acceleration(target, wanted):
        return _proportional({_OF_GRAVITY[given]: 1}, target, given, wanted)
    if _is_temperature(source) and _is_temperature(target):
        return _temperature_conversion(_only_symbol(source), _only_symbol(target))
    return _proportional(source, target, given, wanted)


def _turns_per_second(factors: Factors) -> float | None:
    """What one of the unit is in turns a second, where it counts turns in a time, or something beside turns
    (1/min, Hz). None of 1/s, as which rad/s is written, too."""
    return next((size for unit, size in _TURNS if unit == factors), None)


def _has_angle(factors: Factors) -> bool:
    return any(symbol in factors for symbol in ("rad", "mrad", "deg"))


def converts(given: str, wanted: str) -> bool:
    """Whether there is a conversion from unit `given` to unit `wanted`."""
    try:
        conversion(given, wanted)
    except DataError:
        return False
    return True


def is_temperature(unit: str) -> bool:
    """Whether the unit is that of a temperature, whose zero is another one in another unit.

    >>> is_temperature("degC"), is_temperature("W/K")
    (True, False)
    """
    return is_known_unit(unit) and _is_temperature(parse_unit(unit))


def may_count_turns(given: str, chosen: str) -> bool:
    """Whether `given` counts something in a time (1/min, 1/s, Hz) and `chosen` says what: turns or radians
    in that time (rpm, rev/s, rad/s)."""
    if not is_known_unit(given) or not is_known_unit(chosen):
        return False
    counts = {"rpm": 1} if parse_unit(given) == {"min": -1} else {"turn": 1, "s": -1}
    is_count = parse_unit(given) in ({"min": -1}, {"s": -1}, {"Hz": 1})
    per = "min" if parse_unit(given) == {"min": -1} else "s"
    return is_count and parse_unit(chosen) in (counts, {"turn": 1, per: -1}, {"rad": 1, per: -1})


def with_unit(number: str, unit: str) -> str:
    """A number with its unit behind it, as texts tell it; alone where it has none.

    >>> with_unit("2.5", "N.m"), with_unit("0.1", "1"), with_unit("3", "")
    ('2.5 N.m', '0.1', '3')
    """
    return f"{number} {unit}" if unit not in ("", "1") else number


def spoken_duration(seconds: float, clock: str = "s") -> str:
    """A duration for a text: in seconds below two minutes, else in minutes, hours or days; in `clock` where a
    model counts time in another unit."""
    if clock != "s":
        return f"{seconds:.3g} {clock}"
    for length, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.3g} s"


def _tokens(text: str) -> list[str]:
    text = text.strip().translate(_SUPERSCRIPTS)
    tokens, position = [], 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise _unreadable(text)
        tokens.append(match.group().strip())
        position = match.end()
    return tokens


def _expression(tokens: list[str], text: str) -> tuple[Factors, list[str]]:
    total, rest = _product(tokens, text)
    while rest and rest[0] == "/":
        divisor, after = _factor(rest[1:], text)
        if after and after[0] in (".", "*", "·"):
            raise _unreadable(text, "put the product behind the slash in brackets, as in W/(m2.K)")
        total, rest = _multiply(total, divisor, -1), after
    return total, rest


def _product(tokens: list[str], text: str) -> tuple[Factors, list[str]]:
    total, rest = _factor(tokens, text)
    while rest and rest[0] in (".", "*", "·"):
        factor, rest = _factor(rest[1:], text)
        total = _multiply(total, factor, 1)
    return total, rest


def _factor(tokens: list[str], text: str) -> tuple[Factors, list[str]]:
    if not tokens:
        raise _unreadable(text)
    head, rest = tokens[0], tokens[1:]
    if head == "(":
        inner, rest = _expression(rest, text)
        if not rest or rest[0] != ")":
            raise _unreadable(text)
        return inner, rest[1:]
    if head == "1":
        return {}, rest
    if not head[0].isalpha() and head[0] not in "°%_":
        raise _unreadable(text)
    before, last = _symbols(head)
    if rest and rest[0] in ("^", "**"):
        rest = rest[1:]
    if rest and _is_integer(rest[0]):
        return {**before, last: int(rest[0])}, rest[1:]
    return {**before, last: 1}, rest


def _symbols(word: str) -> tuple[Factors, str]:
    """The units in a word: those before the last one, and the last one, to which an exponent belongs."""
    if word in _TOGETHER:
        *before, last = _TOGETHER[word]
        return dict.fromkeys(before, 1), last
    return {}, _SPELLINGS.get(word, word.replace("Ohm", "ohm").replace("Ω", "ohm"))


def _is_integer(token: str) -> bool:
    return token.lstrip("+-").isdigit()


def _multiply(left: Factors, right: Factors, sign: int) -> Factors:
    result = dict(left)
    for symbol, exponent in right.items():
        result[symbol] = result.get(symbol, 0) + sign * exponent
    return result


def _only_symbol(factors: Factors) -> str:
    return next(iter(factors))


def _is_temperature(factors: Factors) -> bool:
    return len(factors) == 1 and all(s in _TEMPERATURES and e == 1 for s, e in factors.items())


def _is_acceleration(factors: Factors, text: str) -> bool:
    return bool(_in_base_units(factors, text).check("[acceleration]"))


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


def _temperature_conversion(given: str, wanted: str) -> Conversion:
    quantity = _registry().Quantity
    at_zero = float(quantity(0.0, given).to(wanted).magnitude)
    at_hundred = float(quantity(100.0, given).to(wanted).magnitude)
    scale = (at_hundred - at_zero) / 100.0
    # Celsius and Kelvin have the same step; the subtraction above leaves a rounding error of a few 1e-16.
    return Conversion(1.0 if abs(scale - 1.0) < 1e-12 else scale, at_zero)


def _proportional(source: Factors, target: Factors, given: str, wanted: str) -> Conversion:
    import pint

    ratio = _in_base_units(source, given) / _in_base_units(target, wanted)
    try:
        scale = float(ratio.to("dimensionless").magnitude)
    except pint.DimensionalityError as error:
        raise _incompatible(given, wanted) from error
    return Conversion(1.0 if abs(scale - 1.0) < 1e-14 else scale)


def _in_base_units(factors: Factors, text: str) -> Any:
    import pint

    registry = _registry()
    total = registry.Quantity(1.0)
    for symbol, exponent in factors.items():
        name = f"delta_{symbol}" if symbol in ("degC", "degF") else symbol
        try:
            total = total * registry.Quantity(1.0, name).to_base_units() ** exponent
        except (pint.UndefinedUnitError, pint.errors.DefinitionSyntaxError) as error:
            raise _unreadable(text) from error
    return total


def _unreadable(text: str, remedy: str = "") -> DataError:
    return DataError(
        "unit-unknown",
        f"the unit '{text}' is not understood",
        remedy=remedy or "write it as Modelica does: N.m, kg.m2, rad/s, W/(m2.K), degC, 1",
    )


def _incompatible(given: str, wanted: str, remedy: str = "") -> DataError:
    return DataError(
        "unit-incompatible",
        f"a value in '{given}' cannot be converted to '{wanted}'",
        remedy=remedy or "correct the unit in the column header, or the unit in the model",
    )
