"""Laws that can be added to the inputs of an FMU from outside: what a missing effect would do there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

LAWS: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {}


def _law(name: str) -> Callable[[Callable[[np.ndarray, np.ndarray], float]], Callable]:
    def keep(function: Callable[[np.ndarray, np.ndarray], float]) -> Callable:
        LAWS[name] = function
        return function

    return keep


@dataclass(frozen=True)
class Law:
    """The law `name` of the variables `reads` with its `size`, which is a factor of those in LAWS and a width
    or a limit in SIZED, added to input number `input`.

    `shape` holds what the law needs besides: the width of a sign, a dead band, a limit. `column`: it reads
    that column of what drives the simulation instead, an input or a recorded signal that is none.
    """

    name: str
    input: int
    reads: tuple[int, ...]
    shape: tuple[float, ...] = ()
    size: float = 1.0
    column: int | None = None

    def value(self, variables: np.ndarray, u: np.ndarray) -> float:
        """The law at the `variables` that it reads, or at the columns u (n_columns,)."""
        read = variables if self.column is None else u[self.column : self.column + 1]
        if self.name in SIZED:
            return float(SIZED[self.name](float(read[0]), self.shape, self.size))
        return self.size * float(LAWS[self.name](read, np.array(self.shape)))


@_law("constant")
def constant(_: np.ndarray, __: np.ndarray) -> float:
    """1."""
    return 1.0


@_law("linear")
def linear(v: np.ndarray, _: np.ndarray) -> float:
    """-v: viscous friction, a spring, a leak."""
    return -float(v[0])


@_law("sign")
def sign(v: np.ndarray, shape: np.ndarray) -> float:
    """-tanh(v / width): Coulomb friction, a voltage drop of brushes."""
    return -float(np.tanh(v[0] / shape[0]))


@_law("square")
def square(v: np.ndarray, _: np.ndarray) -> float:
    """-v |v|: drag."""
    return -float(v[0] * abs(v[0]))


@_law("cube")
def cube(v: np.ndarray, _: np.ndarray) -> float:
    """-v³: a hardening spring."""
    return -float(v[0] ** 3)


@_law("sine")
def sine(v: np.ndarray, shape: np.ndarray) -> float:
    """-sin(n v + phase): gravity on an unbalanced shaft, cogging."""
    return -float(np.sin(shape[0] * v[0] + shape[1]))


@_law("fourth power")
def fourth_power(v: np.ndarray, _: np.ndarray) -> float:
    """-(v / 100)⁴: radiation of a body at an absolute temperature."""
    return -float((v[0] / 100.0) ** 4)


@_law("recorded")
def recorded(v: np.ndarray, _: np.ndarray) -> float:
    """v: a signal that is added to the input."""
    return float(v[0])


def dead_zone(v: float, _: tuple[float, ...], size: float) -> float:
    """What a dead zone of the half width `size` takes away."""
    return -float(np.sign(size) * np.clip(v, -abs(size), abs(size)))


def saturation(v: float, shape: tuple[float, ...], size: float) -> float:
    """What a limit takes away that stands `size` below the largest value, shape[0]; nothing below 0."""
    limit = max(shape[0] - size, 0.0)
    return float(np.clip(v, -limit, limit)) - v if size > 0 else 0.0


SIZED: dict[str, Callable[[float, tuple[float, ...], float], float]] = {
    "dead zone": dead_zone,
    "saturation": saturation,
}
# The kinds of foreign.c, in its order.
KINDS = (*LAWS, *SIZED)


def law_table(laws: tuple[Law, ...]) -> np.ndarray:
    """The laws as foreign.c reads them, (n_laws, 6): kind, input, column or -1, value reference, shape."""
    rows = []
    for law in laws:
        reads = law.reads[0] if law.reads else 0
        shape = (*law.shape, 0.0, 0.0)[:2]
        rows.append([KINDS.index(law.name), law.input, _column(law), reads, *shape])
    return np.array(rows, dtype=float).reshape(len(laws), 6)


def _column(law: Law) -> int:
    """A constant reads nothing, and so no variable of the FMU."""
    return 0 if law.name == "constant" else -1 if law.column is None else law.column
