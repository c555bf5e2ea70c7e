"""Effects of the Modelica library as an FMU without equations can have them: a law that is added to one of
its inputs, or what a sensor does to one of its outputs. Both are read from the equations of the effect's
class.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.fmu.drive import CONSTANT, MOST_STEPS, SIZE, STEPS, VARIABLE, Step
from daest.model.effects import Effect, EffectParameter
from daest.modelica.effects.catalogue import EffectModel, effect_model
from daest.modelica.flat.connectors import connectors_of

ANGLE = "rad"
_OPERATIONS = dict(
    zip(
        STEPS,
        (
            ca.OP_ASSIGN, ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE,
            ca.OP_INV, ca.OP_POW, ca.OP_SQRT, ca.OP_EXP, ca.OP_LOG, ca.OP_SIN, ca.OP_COS, ca.OP_TAN,
            ca.OP_ATAN, ca.OP_TANH, ca.OP_FABS, ca.OP_SIGN, ca.OP_FMIN, ca.OP_FMAX, ca.OP_LT, ca.OP_LE,
            ca.OP_NOT, ca.OP_IF_ELSE_ZERO,
        ),
        strict=True,
    )
)  # fmt: skip
_NUMBERS = {operation: number for number, operation in enumerate(_OPERATIONS.values())} | {
    ca.OP_CONSTPOW: list(STEPS).index("power")
}
_BINARY = {ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_POW, ca.OP_CONSTPOW, ca.OP_FMIN, ca.OP_FMAX,
           ca.OP_LT, ca.OP_LE, ca.OP_IF_ELSE_ZERO}  # fmt: skip


@dataclass(frozen=True)
class InputLaw:
    """What `effect` adds to an input where it reads a variable v and has a size s.

    `reads`: "nothing", a "state" of the FMU, the "signal" of the input itself, or a "recorded" one. `cuts`:
    the size is what is cut off the largest magnitude of the signal, for an effect whose own size is a share.
    """

    effect: Effect
    reads: str
    value: ca.Function  # (v, theta) -> added
    cuts: bool = False

    @property
    def needs_angle(self) -> bool:
        """Whether v is an angle: a law with an angle among its parameters turns round with it."""
        return any(p.unit == ANGLE for p in self.effect.parameters)

    def function(self, largest: float) -> ca.Function:
        """(v, s) -> added, where `largest` is the largest magnitude of v."""
        size = ca.SX.sym("size")
        numbers = [self._number(p, size, largest) for p in self.effect.parameters]
        v = ca.SX.sym("v")
        return ca.Function("law", [v, size], [self.value(v, ca.vertcat(*numbers))])

    def _number(self, parameter: EffectParameter, size: ca.SX, largest: float) -> ca.SX:
        cut = parameter.role == "shape" and parameter.scale_of != ""
        if self.cuts and parameter.role in ("size", "shape"):
            return ca.fmax(largest - size, 0.0) if cut else ca.SX(parameter.max or 1.0)
        if parameter.role == "size":
            return size
        if parameter.role == "sharpness" and parameter.grid:
            return ca.SX(parameter.grid[0] * (largest if parameter.scale_of else 1.0))
        return ca.SX(parameter.start)


@dataclass(frozen=True)
class SensorFault:
    """What a unit of the size of `effect` adds to an output."""

    effect: Effect
    slope: ca.Function  # (y, der(y), t) -> added

    def along(self, y: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Of an output y (n,) at `time` (n,), both from the first sample on."""
        arguments = (y, np.gradient(y, time), time - time[0])
        return np.array(self.slope.map(y.size)(*(a[None] for a in arguments))).ravel()


def program_of(function: ca.Function) -> tuple[Step, ...]:
    """The steps of a function (v, s) -> value for `fmu.laws`. Raises ModelError `effect-law-outside` where it
    has others than those, or too many."""
    program: list[Step] = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        target, source = function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_INPUT:
            program.append((VARIABLE if source[0] == 0 else SIZE, target[0], 0, 0, 0.0))
        elif operation == ca.OP_CONST:
            program.append((CONSTANT, target[0], 0, 0, function.instruction_constant(k)))
        elif operation == ca.OP_OUTPUT:
            program.append((_NUMBERS[ca.OP_ASSIGN], 0, source[0], 0, 0.0))
        elif operation in _NUMBERS:
            other = source[1] if operation in _BINARY else 0
            program.append((_NUMBERS[operation], target[0], source[0], other, 0.0))
        else:
            raise _unfit("its law has a function that FMUs are not given")
    if len(program) > MOST_STEPS or function.sz_w() > MOST_STEPS:
        raise _unfit(f"its law takes more than {MOST_STEPS} steps")
    return tuple(program)


def _unfit(what: str) -> ModelError:
    return ModelError(
        "effect-law-outside",
        f"an effect marked `outside` cannot be added to an input of an FMU: {what}",
        remedy="write it as one formula of one variable, or leave out `outside`",
    )


def input_law(effect: Effect) -> InputLaw:
    """The law of an effect with outside = "input". Raises ModelError `effect-law-outside`."""
    model = effect_model(effect)
    theta = ca.SX.sym("theta", len(model.parameters))
    known = _Elimination(model, theta)
    if effect.connectors == ("u", "y"):
        u, z = ca.SX.sym("u"), ca.SX.sym("z")
        known.set("u", u)
        for name in effect.inputs:
            known.set(name, z)
        added = known.solved("y") - u
        reads, v = ("recorded", z) if effect.inputs else ("signal", u)
        return InputLaw(effect, reads, _function(v, theta, added), _is_share(effect))
    position, rate = ca.SX.sym("position"), ca.SX.sym("rate")
    connectors = connectors_of(model.unknowns)
    for number, name in enumerate(effect.connectors):
        potential = model.unknowns[connectors[name].potential].name
        known.set(potential, ca.SX(0.0) if number else position, ca.SX(0.0) if number else rate)
    added = -known.solved(model.unknowns[connectors[effect.connectors[0]].flow].name)
    used = [v for v in (position, rate) if ca.depends_on(added, v)]
    if len(used) > 1:
        raise _unfit("its law depends on a position and on its rate")
    return InputLaw(
        effect, "state" if used else "nothing", _function(used[0] if used else rate, theta, added)
    )


def sensor_fault(effect: Effect) -> SensorFault:
    """What the sizes of an effect with outside = "output" do to a signal, to first order at their null, where
    the signal is what it would be without. Raises ModelError `effect-law-outside`."""
    model = effect_model(effect)
    names = [x.name for x in model.unknowns]
    if sorted(names) != ["u", "y"] or len(effect.sizes) != 1:
        raise _unfit("a fault of a sensor has one equation between u and y, and one size")
    xi, derivatives, t = (ca.SX.sym(name, n) for name, n in (("xi", 2), ("derivatives", 2), ("t", 1)))
    theta = ca.SX.sym("theta", len(model.parameters))
    residual = model.function(derivatives, xi, ca.SX(0, 1), theta, t)[0]
    size = [p.name for p in effect.parameters].index(effect.sizes[0].name)
    slope: ca.SX = -ca.jacobian(residual, theta)[0, size] / ca.jacobian(residual, xi)[0, names.index("y")]
    y, rate = ca.SX.sym("y"), ca.SX.sym("rate")
    null = [effect.null_values.get(p.name, p.start) for p in effect.parameters]
    there = ca.vertcat(ca.repmat(y, 2, 1), ca.repmat(rate, 2, 1), *null)
    value: ca.SX = ca.substitute(slope, ca.vertcat(xi, derivatives, theta), there)
    return SensorFault(effect, ca.Function("slope", [y, rate, t], [value]))


def tried_as(effect: Effect, unit: str) -> Effect:
    """The effect as a diagnosis of an FMU tells it: one size, in the `unit` of the input or output, of either
    sign, as an input may turn the state that the law reads either way."""
    size = replace(effect.sizes[0], name="size", unit=unit, signal_unit="", null=0.0, min=None, max=None)
    return replace(effect, parameters=(size,), outside=effect.outside)


def _function(v: ca.SX, theta: ca.SX, added: ca.SX) -> ca.Function:
    function = ca.Function("law", [v, theta], [added], {"allow_free": True})
    if function.has_free():
        raise _unfit("its law depends on more than one variable")
    return function


def _is_share(effect: Effect) -> bool:
    """Whether the size is the share of what lies beyond a limit."""
    sizes, shapes = effect.sizes, [p for p in effect.parameters if p.role == "shape" and p.scale_of]
    return sizes[0].max == 1.0 and bool(shapes)


class _Elimination:
    """The unknowns of an effect as formulas of those that are set, row by row."""

    def __init__(self, model: EffectModel, theta: ca.SX) -> None:
        n = len(model.unknowns)
        self._names = [x.name for x in model.unknowns]
        self._xi, self._rates = ca.SX.sym("xi", n), ca.SX.sym("rates", n)
        w = ca.SX(len(model.noises), 1)
        rows = model.function(self._rates, self._xi, w, theta, ca.SX.sym("t"))[0]
        self._rows = ca.vertsplit(rows)
        self._set: list[tuple[ca.SX, ca.SX]] = []  # symbols that later values may hold, with their rates
        self._open = set(range(n))

    def set(self, name: str, value: ca.SX, rate: ca.SX | None = None) -> None:
        number = self._names.index(name)
        if not value.is_constant():
            self._set.append((value, ca.SX(0.0) if rate is None else rate))
        self._replace(number, value, ca.SX(0.0) if rate is None else rate)

    def solved(self, name: str) -> ca.SX:
        """The formula of this unknown. Raises ModelError `effect-law-outside`."""
        wanted = self._names.index(name)
        while True:
            found = self._next()
            if found is None:
                raise _unfit("its equations are no formula for what it adds")
            number, value = found
            if number == wanted:
                return value
            parts = [ca.jtimes(value, symbol, rate) for symbol, rate in self._set]
            self._replace(number, value, sum(parts, ca.SX(0.0)))

    def _next(self) -> tuple[int, ca.SX] | None:
        for row in self._rows:
            left = [i for i in self._open if ca.depends_on(row, self._xi[i])]
            waits = any(ca.depends_on(row, self._rates[i]) for i in self._open)
            if len(left) == 1 and not waits and ca.is_linear(row, self._xi[left[0]]):
                slope = ca.jacobian(row, self._xi[left[0]])
                rest = ca.substitute(row, self._xi[left[0]], ca.SX(0.0))
                return left[0], ca.simplify(-rest / slope)
        return None

    def _replace(self, number: int, value: ca.SX, rate: ca.SX) -> None:
        self._open.discard(number)
        before = ca.vertcat(self._xi[number], self._rates[number])
        self._rows = [ca.substitute(row, before, ca.vertcat(value, rate)) for row in self._rows]
