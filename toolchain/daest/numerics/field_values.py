"""Values of CasADi functions in a prime field, where a rational identity either holds or does not.

Sums, products, quotients and whole powers are those of the field. A square root is a root of the field where
there is one. Sine and cosine of one argument come from one random element t, as (2 t, 1 - t²) / (1 + t²), an
exponential from one that exp(-x) inverts; every other function of one argument (logarithm, arc sine, a power
that is not whole) is an independent random element. So n · (1/n) = 1, sin² + cos² = 1 and sqrt(x)² = x hold,
while relations that no polynomial tells, such as log(x y) = log x + log y, are lost. What depends on a
comparison (abs, min, if) follows the branch of the double that is carried along.
"""

from __future__ import annotations

import math
import operator
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import casadi as ca

from daest.numerics.exact_numbers import read_number, residue


@dataclass(frozen=True)
class FieldValue:
    """A residue with the double that it stands for."""

    residue: int
    double: float


@dataclass
class Field:
    """Arithmetic modulo `prime`; `seed` chooses the random elements.

    `missing_roots` counts square roots that the field does not have, for which independent elements stand;
    `all_simple` tells that every constant was read as a text or a simple fraction."""

    prime: int
    seed: int = 0
    missing_roots: int = 0
    all_simple: bool = True
    _known: dict[tuple[object, ...], int] = field(default_factory=dict)

    def constant(self, number: float) -> FieldValue:
        """The value that the double stands for (`read_number`)."""
        read = read_number(number)
        self.all_simple &= read.is_simple
        return FieldValue(residue(read.value, self.prime), number)

    def independent(self, *key: object) -> int:
        """A random element for `key`, the same one whenever it is asked for."""
        if key not in self._known:
            self._known[key] = random.Random(f"{self.seed} {self.prime} {key}").randrange(2, self.prime - 1)
        return self._known[key]

    def inverse(self, value: int) -> int:
        """Raises ZeroDivisionError."""
        if value % self.prime == 0:
            raise ZeroDivisionError("division by zero in the field")
        return pow(value, -1, self.prime)

    def root(self, value: int) -> int:
        """A square root; the prime is 3 modulo 4."""
        found = pow(value, (self.prime + 1) // 4, self.prime)
        if found * found % self.prime == value:
            return found
        self.missing_roots += 1
        return self.independent("root", value)

    def exponential(self, value: int) -> int:
        """exp(-x) = 1 / exp(x), exp(0) = 1."""
        if value == 0:
            return 1
        if 2 * value < self.prime:
            return self.independent("exp", value)
        return self.inverse(self.independent("exp", self.prime - value))

    def circle(self, value: int) -> tuple[int, int]:
        """(sin, cos) of an argument; odd and even in it."""
        if value == 0:
            return 0, 1
        is_turned = 2 * value > self.prime
        t = self.independent("circle", self.prime - value if is_turned else value)
        scale = self.inverse(1 + t * t)
        sine = 2 * t * scale % self.prime
        return (-sine if is_turned else sine) % self.prime, (1 - t * t) * scale % self.prime

    def power(self, base: FieldValue, exponent: FieldValue) -> int:
        """Whole powers, and those of square roots; others are independent."""
        doubled = 2.0 * exponent.double
        if abs(doubled) > 2e6 or not float(doubled).is_integer():
            return self.independent("power", base.residue, exponent.residue)
        whole, is_half = divmod(int(doubled), 2)
        start = base.residue if whole >= 0 else self.inverse(base.residue)
        result = pow(start, abs(whole), self.prime)
        return result * self.root(base.residue) % self.prime if is_half else result


Operation = Callable[..., int]


def _rational(f: Field) -> dict[int, Operation]:
    p = f.prime
    return {
        ca.OP_ASSIGN: lambda a: a.residue,
        ca.OP_ADD: lambda a, b: (a.residue + b.residue) % p,
        ca.OP_SUB: lambda a, b: (a.residue - b.residue) % p,
        ca.OP_MUL: lambda a, b: a.residue * b.residue % p,
        ca.OP_DIV: lambda a, b: a.residue * f.inverse(b.residue) % p,
        ca.OP_NEG: lambda a: -a.residue % p,
        ca.OP_INV: lambda a: f.inverse(a.residue),
        ca.OP_SQ: lambda a: a.residue * a.residue % p,
        ca.OP_TWICE: lambda a: 2 * a.residue % p,
    }


def _transcendental(f: Field) -> dict[int, Operation]:
    p = f.prime

    def half_sum(a: FieldValue, sign: int) -> int:
        e = f.exponential(a.residue)
        return (e + sign * f.inverse(e)) * f.inverse(2) % p

    return {
        ca.OP_SQRT: lambda a: f.root(a.residue),
        ca.OP_POW: f.power,
        ca.OP_CONSTPOW: f.power,
        ca.OP_EXP: lambda a: f.exponential(a.residue),
        ca.OP_SIN: lambda a: f.circle(a.residue)[0],
        ca.OP_COS: lambda a: f.circle(a.residue)[1],
        ca.OP_TAN: lambda a: f.circle(a.residue)[0] * f.inverse(f.circle(a.residue)[1]) % p,
        ca.OP_SINH: lambda a: half_sum(a, -1),
        ca.OP_COSH: lambda a: half_sum(a, 1),
        ca.OP_TANH: lambda a: half_sum(a, -1) * f.inverse(half_sum(a, 1)) % p,
        ca.OP_HYPOT: lambda a, b: f.root((a.residue**2 + b.residue**2) % p),
    }


def _branching(f: Field) -> dict[int, Operation]:
    p = f.prime

    def compared(holds: Callable[[float, float], bool]) -> Operation:
        return lambda a, b: int(holds(a.double, b.double))

    def signed(a: FieldValue, sign_of: float) -> int:
        """|a| with the sign of `sign_of`."""
        return a.residue if (a.double < 0) == (math.copysign(1.0, sign_of) < 0) else -a.residue % p

    return {
        ca.OP_FABS: lambda a: signed(a, 1.0),
        ca.OP_COPYSIGN: lambda a, b: signed(a, b.double),
        ca.OP_SIGN: lambda a: ((a.double > 0) - (a.double < 0)) % p,
        ca.OP_FMIN: lambda a, b: a.residue if a.double <= b.double else b.residue,
        ca.OP_FMAX: lambda a, b: a.residue if a.double >= b.double else b.residue,
        ca.OP_LT: compared(operator.lt),
        ca.OP_LE: compared(operator.le),
        ca.OP_EQ: compared(operator.eq),
        ca.OP_NE: compared(operator.ne),
        ca.OP_NOT: lambda a: int(not a.double),
        ca.OP_AND: lambda a, b: int(bool(a.double) and bool(b.double)),
        ca.OP_OR: lambda a, b: int(bool(a.double) or bool(b.double)),
        ca.OP_IF_ELSE_ZERO: lambda a, b: b.residue if a.double else 0,
        ca.OP_FLOOR: lambda a: math.floor(a.double) % p,
        ca.OP_CEIL: lambda a: math.ceil(a.double) % p,
    }


@dataclass(frozen=True)
class Tape:
    """The instructions of a function θ -> several matrices, read once."""

    instructions: tuple[tuple[int, tuple[int, ...], tuple[int, ...], float], ...]
    work: int
    n_outputs: tuple[int, ...]  # entries of every output


def tape(function: ca.Function) -> Tape:
    """Of a CasADi function of scalar instructions (SX)."""
    kept = []
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        value = function.instruction_constant(k) if code == ca.OP_CONST else 0.0
        kept.append(
            (code, tuple(function.instruction_input(k)), tuple(function.instruction_output(k)), value)
        )
    sizes = tuple(function.nnz_out(i) for i in range(function.n_out()))
    return Tape(tuple(kept), function.sz_w(), sizes)


def evaluate(program: Tape, arguments: Sequence[FieldValue], f: Field) -> list[list[FieldValue]]:
    """The entries of every output at `arguments` of the only input.

    Raises ZeroDivisionError where a quotient has no value.
    """
    operations = {**_rational(f), **_transcendental(f), **_branching(f)}
    doubles = _Doubles()
    work: list[FieldValue] = [FieldValue(0, 0.0)] * program.work
    outputs = [[FieldValue(0, 0.0)] * size for size in program.n_outputs]
    constants: dict[float, FieldValue] = {}
    for code, source, target, value in program.instructions:
        if code == ca.OP_CONST:
            if value not in constants:
                constants[value] = f.constant(value)
            work[target[0]] = constants[value]
        elif code == ca.OP_INPUT:
            work[target[0]] = arguments[source[1]]
        elif code == ca.OP_OUTPUT:
            outputs[target[0]][target[1]] = work[source[0]]
        else:
            operands = [work[i] for i in source]
            double = doubles.of(code, [operand.double for operand in operands])
            operation = operations.get(code)
            result = (
                operation(*operands) if operation else f.independent(code, *[o.residue for o in operands])
            )
            work[target[0]] = FieldValue(result, double)
    return outputs


class _Doubles:
    """The operations of CasADi on doubles, each as a function that is made once."""

    def __init__(self) -> None:
        self._functions: dict[tuple[int, int], Callable[..., float]] = {
            (ca.OP_ADD, 2): operator.add,
            (ca.OP_SUB, 2): operator.sub,
            (ca.OP_MUL, 2): operator.mul,
            (ca.OP_NEG, 1): operator.neg,
            (ca.OP_SQ, 1): lambda a: a * a,
            (ca.OP_TWICE, 1): lambda a: 2.0 * a,
        }

    def of(self, code: int, values: Sequence[float]) -> float:
        key = (code, len(values))
        if key not in self._functions:
            self._functions[key] = _compiled(code, len(values))
        return self._functions[key](*values)


def _compiled(code: int, n: int) -> Callable[..., float]:
    symbols = [ca.SX.sym(f"a{i}") for i in range(n)]
    expression = ca.SX.unary(code, *symbols) if n == 1 else ca.SX.binary(code, *symbols)
    function = ca.Function("operation", symbols, [expression])
    return lambda *values: float(function(*values))
