"""Modelica units in the base units of FMI: kg m s A K mol cd rad, with factor and offset."""

from __future__ import annotations

from dataclasses import dataclass, field

from daest.errors import DataError
from daest.quantities import Factors, parse_unit

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class BaseUnit:
    """value in SI = factor * value + offset, in the product of the base units to their `exponents`."""

    exponents: dict[str, int] = field(default_factory=dict)
    factor: float = 1.0
    offset: float = 0.0


def _u(factor: float = 1.0, **exponents: int) -> BaseUnit:
    return BaseUnit(exponents, factor)


_DEGREE = 3.141592653589793 / 180
_UNITS: dict[str, BaseUnit] = {
    **{name: _u(**{name: 1}) for name in BASE},
    "g": _u(1e-3, kg=1),
    "t": _u(1e3, kg=1),
    "Hz": _u(s=-1),
    "N": _u(kg=1, m=1, s=-2),
    "Pa": _u(kg=1, m=-1, s=-2),
    "bar": _u(1e5, kg=1, m=-1, s=-2),
    "J": _u(kg=1, m=2, s=-2),
    "W": _u(kg=1, m=2, s=-3),
    "C": _u(A=1, s=1),
    "V": _u(kg=1, m=2, s=-3, A=-1),
    "ohm": _u(kg=1, m=2, s=-3, A=-2),
    "S": _u(kg=-1, m=-2, s=3, A=2),
    "F": _u(kg=-1, m=-2, s=4, A=2),
    "H": _u(kg=1, m=2, s=-2, A=-2),
    "Wb": _u(kg=1, m=2, s=-2, A=-1),
    "T": _u(kg=1, s=-2, A=-1),
    "lm": _u(cd=1),
    "lx": _u(cd=1, m=-2),
    "Bq": _u(s=-1),
    "Gy": _u(m=2, s=-2),
    "Sv": _u(m=2, s=-2),
    "kat": _u(mol=1, s=-1),
    "sr": _u(rad=2),
    "deg": _u(_DEGREE, rad=1),
    "turn": _u(360 * _DEGREE, rad=1),
    "rpm": _u(6 * _DEGREE, rad=1, s=-1),
    "min": _u(60.0, s=1),
    "h": _u(3600.0, s=1),
    "d": _u(86400.0, s=1),
    "l": _u(1e-3, m=3),
    "L": _u(1e-3, m=3),
    "eV": _u(1.602176634e-19, kg=1, m=2, s=-2),
    "percent": _u(1e-2),
}
_PREFIXES = {
    "da": 1e1, "h": 1e2, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12, "P": 1e15, "E": 1e18,
    "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9, "p": 1e-12, "f": 1e-15,
}  # fmt: skip
_ZERO_CELSIUS = 273.15
_WITHOUT_PREFIX = {"min", "d", "h", "rpm", "percent", "turn", "deg"}


def base_unit(text: str) -> BaseUnit | None:
    """The unit in base units, or None if a symbol is not known (the FMU then carries the name alone)."""
    try:
        factors = parse_unit(text)
    except DataError:
        return None
    if factors == {"degC": 1}:
        return BaseUnit({"K": 1}, offset=_ZERO_CELSIUS)
    exponents, scale = dict.fromkeys(BASE, 0), 1.0
    for symbol, power in factors.items():
        unit = _symbol(symbol)
        if unit is None:
            return None
        scale *= unit.factor**power
        for name, exponent in unit.exponents.items():
            exponents[name] += exponent * power
    return BaseUnit({name: e for name, e in exponents.items() if e}, scale)


def _symbol(symbol: str) -> BaseUnit | None:
    if symbol == "degC":
        return _u(K=1)
    if symbol in _UNITS:
        return _UNITS[symbol]
    for prefix, scale in _PREFIXES.items():
        rest = symbol.removeprefix(prefix)
        if rest != symbol and rest in _UNITS and rest not in _WITHOUT_PREFIX:
            return BaseUnit(_UNITS[rest].exponents, scale * _UNITS[rest].factor)
    return None


def derivative_unit(text: str, order: int = 1) -> str:
    """The unit of the time derivative, in Modelica's spelling; empty where the unit is not given or not
    read.
    """
    if not text:
        return ""
    try:
        factors = dict(parse_unit(text))
    except DataError:
        return ""
    factors["s"] = factors.get("s", 0) - order
    return _spelled(factors)


def _spelled(factors: Factors) -> str:
    above = [_power(s, e) for s, e in factors.items() if e > 0]
    below = [_power(s, -e) for s, e in factors.items() if e < 0]
    text = ".".join(above) or "1"
    if below:
        text += "/" + (below[0] if len(below) == 1 else f"({'.'.join(below)})")
    return text


def _power(symbol: str, exponent: int) -> str:
    return symbol.replace("ohm", "Ohm") + (str(exponent) if exponent != 1 else "")
