"""What drives a simulation of an FMU, said by `fmu.runner` and heard by `fmu.worker`, and laws that are added
to its inputs from outside, as programs of a few arithmetic steps.

A program is data: the process that runs the FMU needs neither CasADi nor a compiler to follow it. `foreign.c`
and `Law.value` run the same steps. `fmu.outside` writes programs from the classes of the Modelica library.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daest.systems.tolerances import SOLVER

MOST_STEPS = 64
"""Steps and registers of a program that `foreign.c` has room for."""

# A step computes registers[target] from two registers. In the order of foreign.c.
STEPS: dict[str, Callable[[float, float], float]] = {
    "copy": lambda a, _: a,
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b if b else math.copysign(math.inf, a),
    "negate": lambda a, _: -a,
    "square": lambda a, _: a * a,
    "twice": lambda a, _: 2.0 * a,
    "invert": lambda a, _: 1.0 / a if a else math.inf,
    "power": lambda a, b: float(np.power(a, b)),
    "root": lambda a, _: math.sqrt(a) if a >= 0.0 else math.nan,
    "exponential": lambda a, _: float(np.exp(a)),
    "logarithm": lambda a, _: math.log(a) if a > 0.0 else math.nan,
    "sine": lambda a, _: math.sin(a),
    "cosine": lambda a, _: math.cos(a),
    "tangent": lambda a, _: math.tan(a),
    "arctangent": lambda a, _: math.atan(a),
    "tanh": lambda a, _: math.tanh(a),
    "magnitude": lambda a, _: abs(a),
    "sign": lambda a, _: float(np.sign(a)),
    "smaller": lambda a, b: min(a, b),
    "larger": lambda a, b: max(a, b),
    "below": lambda a, b: float(a < b),
    "at most": lambda a, b: float(a <= b),
    "not": lambda a, _: float(not a),
    "where": lambda a, b: b if a else 0.0,
}
CONSTANT, VARIABLE, SIZE = len(STEPS), len(STEPS) + 1, len(STEPS) + 2
"""Steps that fill a register: with a number, with what the law reads, with its size."""

Step = tuple[int, int, int, int, float]
"""Number of the step, target register, two source registers, and the number of a constant."""


@dataclass(frozen=True)
class Law:
    """What is added to input number `input`: the last register of `program`, which reads one variable of the
    FMU (`reads`, a value reference) or one column of what drives the simulation (`column`), or nothing, and
    its `size`."""

    program: tuple[Step, ...]
    input: int
    reads: int | None = None
    column: int | None = None
    size: float = 1.0

    def value(self, variable: float) -> float:
        """The law where what it reads is `variable`."""
        registers = [0.0] * MOST_STEPS
        target = 0
        for step, target, a, b, number in self.program:
            if step == CONSTANT:
                registers[target] = number
            elif step == VARIABLE:
                registers[target] = variable
            elif step == SIZE:
                registers[target] = self.size
            else:
                registers[target] = _STEPS[step](registers[a], registers[b])
        return registers[target]

    def read(self, get: Callable[[tuple[int, ...]], np.ndarray], columns: np.ndarray) -> float:
        """What the law reads: by `get` from the FMU, or from the columns (n_columns,)."""
        if self.column is not None:
            return float(columns[self.column])
        return 0.0 if self.reads is None else float(get((self.reads,))[0])


_STEPS = tuple(STEPS.values())


def law_table(laws: tuple[Law, ...]) -> np.ndarray:
    """The laws as foreign.c reads them, (n_laws, 4 + 5 MOST_STEPS): input, column or -1, value reference or
    -1, number of steps, and the steps, filled up with zeros."""
    table = np.zeros((len(laws), 4 + 5 * MOST_STEPS))
    for row, law in zip(table, laws, strict=True):
        column, reads = (-1 if n is None else n for n in (law.column, law.reads))
        row[:4] = law.input, column, reads, len(law.program)
        row[4 : 4 + 5 * len(law.program)] = np.array(law.program, dtype=float).ravel()
    return table


@dataclass(frozen=True)
class Drive:
    """What drives a simulation.

    time (n,); `inputs` are value references; u0 and u1 (n - 1, n_u) hold their values at both ends of every
    interval, u_last (n_u,) at the last sample; columns behind those of the inputs are read by laws alone.
    `bent` (n - 1, 2, n_u) are a and b of r (1 - r) (a + b r), by which they leave the straight line at the
    part r of an interval (None: they do not).
    `read` are the value references to record. `laws` add to the inputs what depends on variables of the FMU
    or on the columns. measurements (n, n_y) of the first n_y of `read` and gain
    (n_states, n_y) correct the states at every sample (None: no correction).
    """

    time: np.ndarray
    inputs: tuple[int, ...]
    u0: np.ndarray
    u1: np.ndarray
    u_last: np.ndarray
    read: tuple[int, ...]
    laws: tuple[Law, ...] = ()
    bent: np.ndarray | None = None
    measurements: np.ndarray | None = None
    gain: np.ndarray | None = None
    rtol: float = SOLVER.simulation_rtol

    def first_inputs(self) -> np.ndarray:
        """Values of the inputs at the first sample."""
        return (self.u0[0] if len(self.u0) else self.u_last)[: len(self.inputs)]

    @property
    def is_held(self) -> bool:
        """Inputs are constant between samples."""
        return self.bent is None and bool(np.array_equal(self.u0, self.u1))
