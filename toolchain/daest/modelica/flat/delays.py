"""`delay(e, T)` as linear equations: what e was over the last T seconds, as a sum of Legendre polynomials.

The window of T seconds that ends now is e(t - rT) = sum_i P_i(2r - 1) x_i, 0 <= r <= 1. Projected on the
first n polynomials, the transport of e through the window is

    T der(x_i) = (2i + 1) (sum_j a_ij x_j + (-1)^i e),    a_ij = -1 for i < j, else (-1)^(i - j + 1),

and e(t - T) = sum_i x_i is Pade's approximant of exp(-sT) with degrees n - 1 over n, in coordinates of the
size of e (Voelker, Kajic and Eliasmith, Legendre Memory Units, NeurIPS 2019). A delay is so a part of the
equations like any other, for matrices, filters and fits too, and T can be estimated.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from daest.errors import ModelError, Place
from daest.modelica.flat.parameters import is_parameter, number, referenced_names
from daest.modelica.flat.reading import Reading
from daest.modelica.language import syntax as s
from daest.modelica.language.specialise import with_numbers
from daest.modelica.language.text import text

N_POLYNOMIALS = 10  # a sine is delayed to 2e-7 of its size at omega*T = 7, to 1e-4 at 10, to 1e-2 at 13

UNGIVEN = s.Constant(0)  # the longest time where a call gives none

_MEMORY = re.compile(r"(^|\.)delay_\d+_memory\[\d+\]$")


def is_memory_of_delay(name: str) -> bool:
    """Whether a variable is a coefficient of a polynomial of `without_delays`: no quantity of the machine."""
    return _MEMORY.search(name) is not None


def without_delays(source: s.FlatSource) -> s.FlatSource:
    """The source with each `delay(e, T)` and `delay(e, T, Tmax)` as states and equations.

    Raises ModelError `model-delay` where T (with Tmax, that) is no positive number of seconds that follows
    from parameters.
    """
    parts = (source.equations, source.initial_equations, source.variables, source.algorithms, source.whens)
    return _Delays(source).translated() if _delays(parts) else source


def _delays(tree: object) -> bool:
    """Whether a delay occurs in a tree."""
    return any(isinstance(one, s.Call) and one.builtin and one.function == "delay" for one in s.nodes(tree))


class _Delays:
    """The delays of one source, with the variables and equations that stand for them."""

    def __init__(self, source: s.FlatSource) -> None:
        self.source, self.reading = source, Reading(source)
        self.variables: list[s.FlatVariable] = []
        self.equations: list[s.FlatEquation] = []
        self.initial: list[s.FlatEquation] = []
        self._made: dict[s.Call, s.Name] = {}
        self._names = {x.name for x in source.variables}
        self._sizes = {x.name: x.dimensions for x in source.variables}
        self._fixed = {x.name for x in source.variables if is_parameter(x)}

    def translated(self) -> s.FlatSource:
        source = self.source
        made = replace(
            source,
            variables=tuple(self._bound(one) for one in source.variables),
            equations=tuple(self._equation(one) for one in source.equations),
            initial_equations=tuple(self._equation(one) for one in source.initial_equations),
            algorithms=tuple(
                replace(one, body=self._undelayed(one.body, one.origin, one.span))
                for one in source.algorithms
            ),
            whens=tuple(self._undelayed(one, "", one.span) for one in source.whens),
        )
        return replace(
            made,
            variables=(*made.variables, *self.variables),
            equations=(*made.equations, *self.equations),
            initial_equations=(*made.initial_equations, *self.initial),
        )

    def _equation(self, equation: s.FlatEquation) -> s.FlatEquation:
        if not _delays(equation):
            return equation
        one = with_numbers(equation)
        left, right = (self._undelayed(side, one.origin, one.span) for side in (one.left, one.right))
        return replace(one, left=left, right=right)

    def _bound(self, variable: s.FlatVariable) -> s.FlatVariable:
        """The variable with the binding, which is an equation of its own, without delays."""
        origin = variable.name.rpartition(".")[0]
        return replace(variable, binding=self._undelayed(variable.binding, origin, variable.span))

    def _undelayed(self, node: Any, origin: str, span: s.Span | None) -> Any:
        """A tree with the delayed variable in place of each delay; those inside of another come first."""
        span = getattr(node, "span", None) or span
        made = s.rebuilt(node, lambda part: self._undelayed(part, origin, span))
        if isinstance(made, s.Call) and made.builtin and made.function == "delay":
            return self._delayed(made, origin, span)
        return made

    def _delayed(self, call: s.Call, origin: str, span: s.Span | None) -> s.Node:
        """The variable that is the delayed expression; of an array one for each element."""
        if call.arguments[2:] == (UNGIVEN,):
            call = replace(call, arguments=call.arguments[:2])
        signal, *times = call.arguments
        if elements := self._elements(signal):
            each = (replace(call, arguments=(one, *times)) for one in elements)
            return s.Array(tuple(self._delayed(one, origin, span) for one in each), span=span)
        if call not in self._made:
            self._made[call] = self._chain(call, origin, span)
        return self._made[call]

    def _elements(self, signal: s.Node) -> tuple[s.Node, ...]:
        """The elements of a vector that stands as a name or in braces; empty for anything else."""
        if isinstance(signal, s.Array):
            return signal.elements
        if (
            isinstance(signal, s.Name)
            and not signal.subscripts
            and len(size := self._sizes.get(signal.name, ())) == 1
        ):
            return tuple(s.Name(signal.name, (s.Constant(i + 1),), signal.span) for i in range(*size))
        return ()

    def _chain(self, call: s.Call, origin: str, span: s.Span | None) -> s.Name:
        """The states of a delay in the component `origin`, and the variable that is read from them."""
        signal, *times = call.arguments
        window = times[-1]
        self._check(call, window, span)
        name = self._free(f"{origin}.delay_" if origin else "delay_")
        memory, made = f"{name}_memory", s.Name(name)
        like = next(
            (x for x in self.source.variables if isinstance(signal, s.Name) and x.name == signal.name), None
        )
        said = f"`{text(signal)}` as it was `{text(times[0])}` seconds ago"
        self.variables += [
            _variable(name, like, (), said, span),
            _variable(
                memory, like, (N_POLYNOMIALS,), f"What `{text(signal)}` was, by Legendre polynomials", span
            ),
        ]
        states = [s.Name(memory, (s.Constant(i + 1),)) for i in range(N_POLYNOMIALS)]
        a, b = window_dynamics(N_POLYNOMIALS)
        for state, row, gain in zip(states, a, b, strict=True):
            rate = s.Binary("*", window, s.Call("der", (state,), builtin=True))
            self._add(self.equations, rate, _sum([*row, gain], [*states, signal]), origin, span)
        self._add(self.equations, made, self._read(states, times), origin, span)
        self._add(self.initial, states[0], signal, origin, span)
        for state in states[1:]:
            self._add(self.initial, state, s.Constant(0.0), origin, span)
        return made

    def _add(
        self, rows: list[s.FlatEquation], left: s.Node, right: s.Node, origin: str, span: s.Span | None
    ) -> None:
        rows.append(s.FlatEquation(left, right, "component", origin, span))

    def _read(self, states: list[s.Name], times: list[s.Node]) -> s.Node:
        """The delayed value: the sum of the states at the far end of the window, inside of it each times its
        polynomial at the share that the delay is of it, by Bonnet's recursion."""
        alike = [1.0] * len(states)
        if len(times) == 1 or times[0] == times[1]:
            return _sum(alike, states)
        share = s.Binary(
            "-", s.Binary("*", s.Constant(2.0), s.Binary("/", times[0], times[1])), s.Constant(1.0)
        )
        polynomials: list[s.Node] = [s.Constant(1.0), share]
        for i in range(1, len(states) - 1):
            rising = s.Binary("*", s.Binary("*", s.Constant((2 * i + 1) / (i + 1)), share), polynomials[i])
            falling = s.Binary("*", s.Constant(i / (i + 1)), polynomials[i - 1])
            polynomials.append(s.Binary("-", rising, falling))
        return _sum(alike, [s.Binary("*", p, x) for p, x in zip(polynomials, states, strict=True)])

    def _check(self, call: s.Call, window: s.Node, span: s.Span | None) -> None:
        """Raises ModelError where the window is no positive time that follows from parameters."""
        where: Place | None = self.reading.sources.place(call.span or span)
        if not set(referenced_names(window)) <= self._fixed:
            raise ModelError(
                "model-delay",
                f"the time `{text(window)}` of a delay changes with the states or inputs",
                where=where,
                remedy="Give the longest time as third argument, a parameter: delay(u, T, Tmax).",
            )
        seconds = number(window, 0, self.reading.numeric, self.reading.evaluator, span)
        assert seconds is not None  # of a node
        if not seconds > 0:
            raise ModelError(
                "model-delay",
                f"`{text(call)}` delays by {seconds:g} s",
                where=where,
                remedy="Give a positive time, or write the signal itself where nothing is delayed.",
            )

    def _free(self, stem: str) -> str:
        """A name that no variable has yet: the stem with the first number that is free."""
        count = 1
        while f"{stem}{count}" in self._names:
            count += 1
        self._names.add(f"{stem}{count}")
        return f"{stem}{count}"


def window_dynamics(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A (n, n) and b (n,) of T x' = A x + b e: the first n Legendre coefficients x of e over the last T
    seconds."""
    i, j = np.indices((n, n))
    a = (2 * i + 1) * np.where(i < j, -1.0, (-1.0) ** (i - j + 1))
    return a, (2 * np.arange(n) + 1) * (-1.0) ** np.arange(n)


def _sum(weights: Sequence[float], terms: Sequence[s.Node]) -> s.Node:
    made: s.Node | None = None
    for weight, term in zip(weights, terms, strict=True):
        one = term if weight == 1 else s.Binary("*", s.Constant(float(weight)), term)
        made = one if made is None else s.Binary("+", made, one)
    assert made is not None
    return made


def _variable(
    name: str, like: s.FlatVariable | None, dimensions: tuple[int, ...], description: str, span: s.Span | None
) -> s.FlatVariable:
    """A continuous variable with the unit of `like`."""
    unit = like.unit if like is not None else ""
    return replace(s.real_variable(name, span), dimensions=dimensions, unit=unit, description=description)
