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
    """`size` times the law `name` of the variables `reads`, added to input number `input`.

    `shape` holds what the law needs besides: the width of a sign, a dead band, a limit.
    """

    name: str
    input: int
    reads: tuple[int, ...]
    shape: tuple[float, ...] = ()
    size: float = 1.0

    def value(self, variables: np.ndarray, time: float) -> float:
        return self.size * float(LAWS[self.name](variables, np.array(self.shape)))


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
