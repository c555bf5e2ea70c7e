"""Which exact number a double stands for, and its residue in a prime field.

Coincidences of coefficients (0.1 + 0.2 = 0.3, n times 1/n = 1) decide on the index of a model, and rounding
breaks them. A double is therefore read as the number that somebody would have written: its decimal text
where that has at most 15 digits, else a simple fraction within its rounding, else its own binary value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache, lru_cache

from flint import fmpz

WORD = 2**63
"""Primes are below this bound: residues fit into a machine word. A polynomial of degree d that is not zero
vanishes at a random point of a field of p elements with a probability of d/p at most (Schwartz, 1980; Zippel,
1979)."""

WRITTEN_DIGITS = 15
"""Every decimal number of so many digits survives its way through a double, and is taken literally."""

SHORT_DIGITS = 9
"""A decimal text of so many digits is taken literally before a simple fraction is looked for."""

SIMPLE = 1e8
"""Largest product of numerator and denominator of a fraction that is taken for meant. Some 1e8 of these
lie within a factor of ten: one falls within an ulp or two of a random double with a chance of 1e-7."""

ULPS = 4.0
"""Roundings [eps/2] that a number may have suffered before it came here: a power and two products."""


@dataclass(frozen=True)
class ReadNumber:
    """The exact `value` of a double; `is_simple` tells that it was read as text or as a simple fraction."""

    value: Fraction
    is_simple: bool


@lru_cache(maxsize=4096)
def read_number(number: float) -> ReadNumber:
    """The exact number that a finite double stands for."""
    if number == 0.0:
        return ReadNumber(Fraction(0), True)
    text = Decimal(repr(float(number)))
    digits = len(text.normalize().as_tuple().digits)
    if digits > SHORT_DIGITS:  # 0.333333333333333 is a third, whatever its digits
        simple = simple_value(number)
        if simple is not None:
            return ReadNumber(simple, True)
    if digits <= WRITTEN_DIGITS:
        return ReadNumber(Fraction(text), True)
    return ReadNumber(Fraction(number), False)


def simple_value(number: float, ulps: float = ULPS) -> Fraction | None:
    """The simple fraction, perhaps times a power of ten or of two, that `number`, not zero and wrong by
    `ulps` roundings at most, is next to; None where there is none."""
    size = abs(Fraction(number))
    decimal, binary = math.floor(math.log10(abs(number))), math.frexp(number)[1] - 1
    for unit in (Fraction(1), _power(10, decimal), _power(2, binary)):
        simple = _simple_fraction(size / unit, ulps)
        if simple is not None:
            return (simple if number > 0 else -simple) * unit
    return None


def _power(base: int, exponent: int) -> Fraction:
    return Fraction(base**exponent) if exponent >= 0 else Fraction(1, base**-exponent)


def _simple_fraction(value: Fraction, ulps: float) -> Fraction | None:
    """The first convergent of the continued fraction of `value` > 0 that is near enough, if it is simple.

    A fraction p/q as simple as that, within 1 / (2 p q) of the value, is a convergent (Legendre).
    """
    numerator, denominator = value.numerator, value.denominator
    a, b = numerator, denominator
    p, q, p_before, q_before = 1, 0, 0, 1
    while b:
        whole, rest = divmod(a, b)
        p, q, p_before, q_before = whole * p + p_before, whole * q + q_before, p, q
        if p * q > SIMPLE:
            return None
        if p and abs(p * denominator - numerator * q) << 53 <= ulps * (numerator * q):
            return Fraction(p, q)
        a, b = b, rest
    return None


@cache
def prime(k: int) -> int:
    """The k-th prime below `WORD` (k = 0, 1, …) that is 3 modulo 4, so that roots are powers."""
    number = (prime(k - 1) if k else WORD + 3) - 4
    while not fmpz(number).is_prime():
        number -= 4
    return number


def residue(value: Fraction, modulus: int) -> int:
    """`value` in the field of `modulus` elements. Raises ZeroDivisionError where its denominator is
    zero there."""
    denominator = value.denominator % modulus
    if denominator == 0:
        raise ZeroDivisionError("the denominator vanishes in this field")
    return value.numerator * pow(denominator, -1, modulus) % modulus
