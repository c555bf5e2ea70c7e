"""The value of an expression: its syntax tree read over a scope of symbols and numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import product as cartesian
from typing import Protocol, TypeGuard

import casadi as ca
import numpy as np

from daest.errors import ModelError, Place
from daest.modelica.language import syntax as s
from daest.modelica.language import values as v
from daest.modelica.language.operators import BUILTINS, EVENTFUL, REFUSED, integer, matrix_of_rows
from daest.modelica.language.text import text
from daest.modelica.language.values import Record, Scalar, Value

_ELEMENTWISE: dict[str, v.Operation] = {
    "+": v.add,
    "-": v.subtract,
    ".+": v.add,
    ".-": v.subtract,
    ".*": v.multiply,
    "/": v.divide,
    "./": v.divide,
    ".^": v.power,
}
RELATIONS: dict[str, Callable[[Scalar, Scalar], Scalar]] = {
    "<": lambda a, b: a < b,  # type: ignore[operator]
    "<=": lambda a, b: a <= b,  # type: ignore[operator]
    ">": lambda a, b: a > b,  # type: ignore[operator]
    ">=": lambda a, b: a >= b,  # type: ignore[operator]
    "==": lambda a, b: a == b,
    "<>": lambda a, b: a != b,
}
_REFUSAL_REMEDY = (
    "Write when-clauses with sample(start, interval) for clocks; let a source be an input, and its values a "
    "column of the recording; or export the model by your own tool as an FMU, which all commands take."
)


# Functions that are undefined, or have infinite slopes, for some arguments; a number at which none is.
_GUARDED = ("sqrt", "log", "log10", "exp", "asin", "acos", "sinh", "cosh")
_SAFE = 0.5
_STEPPED = ("floor", "ceil", "integer", "div", "mod", "rem")

PathPart = tuple[str, tuple[Value | None, ...]]  # identifier and evaluated subscripts (None: `:`)
Path = list[PathPart]


class Scope(Protocol):
    """Where names get their values."""

    def lookup(self, name: str) -> Value | None:
        """The value of a variable, parameter or literal; None if there is none of that name."""

    def element(self, name: str, subscripts: Sequence[Value | None]) -> Value | None:
        """Elements of a variable of which others may have no value yet; None if there is none of that
        name."""

    def path(self, parts: Sequence[PathPart]) -> Value | None:
        """The value of a component path with evaluated subscripts (None stands for `:`)."""

    def derivative(self, name: str) -> Value | None:
        """der() of a variable; None if there is no variable of that name."""

    def rate(self, symbol: str) -> Scalar | None:
        """der() of a scalar by the name of its symbol; None where it has none."""

    def declared_shape(self, name: str) -> tuple[int, ...] | None:
        """The declared size of a variable, () for a scalar; None if there is no variable of that name."""


class EventSink(Protocol):
    """What a model does with operators that need an event or a memory."""

    def relation(self, operator: str, left: Scalar, right: Scalar, key: tuple, shown: str) -> Scalar:
        """A relation that keeps its value between events."""

    def whole(self, value: Scalar, key: tuple, shown: str) -> Scalar:
        """The largest whole number below `value`, which keeps its value between events."""

    def pre(self, name: str) -> Value | None:
        """The value of a variable before the event; None if there is no variable of that name."""

    def pre_scope(self, scope: Scope) -> Scope:
        """Names stand for their values before the event."""

    def is_discrete(self, name: str) -> bool:
        """Whether a variable changes at events only."""

    def sample(self, start: Scalar, interval: Scalar, at: Place | None) -> Scalar:
        """True at the instants start, start + interval, …"""

    def initial(self) -> Scalar:
        """True while the start is computed."""

    def activation(self, conditions: Sequence[Scalar], before: Sequence[Scalar], at: Place | None) -> ca.SX:
        """True at events at which one of `conditions` becomes true, and none of `before` does."""


class FunctionCaller(Protocol):
    def __call__(
        self, name: str, arguments: Sequence[Value], constructor: bool, evaluator: Evaluator
    ) -> tuple[Value, ...]:
        """The results of calling a function."""


@dataclass
class Evaluator:
    """Evaluates trees over `scope`. `iterators` are the loop variables in force; `at` is the place
    that errors name when a node carries none."""

    scope: Scope
    call: FunctionCaller
    locate: Callable[[s.Span | None], Place | None]
    iterators: dict[str, Value] = field(default_factory=dict)
    at: s.Span | None = None
    events: EventSink | None = None  # None: relations are what they are at each instant
    is_live: bool = False  # relations are what they are at each instant, in spite of `events`
    guard: ca.SX | None = None  # the condition under which what is evaluated is wanted at all

    # Entry points -------------------------------------------------------------------------------------------

    def value(self, node: s.Node) -> Value:
        """The value of `node`. Raises ModelError with the node's place."""
        try:
            return _HANDLERS[type(node)](self, node)
        except (ArithmeticError, ValueError) as problem:
            raise ModelError(
                "model-arithmetic",
                f"`{text(node)}` cannot be computed: {problem}",
                where=self.locate(getattr(node, "span", None) or self.at),
                remedy="Check the values, sizes and indices that it is computed from.",
            ) from None

    def results(self, node: s.Node) -> tuple[Value, ...]:
        """All results of a function call; one value for any other node."""
        if isinstance(node, s.Call) and not node.builtin:
            return self._function(node)
        made = self.value(node)
        return made if isinstance(made, tuple) else (made,)

    def scalar(self, node: s.Node) -> Scalar:
        made = self.value(node)
        if isinstance(made, np.ndarray | Record | tuple):
            raise self.error(
                "model-arithmetic", f"`{text(node)}` must be a scalar", node, "Select one element."
            )
        return made

    def size(self, node: s.Node) -> tuple[int, ...]:
        """The size of a node's value, () for a scalar."""
        made = self.value(node)
        return made.shape if isinstance(made, np.ndarray) else ()

    def decided(self, condition: s.Node) -> bool | None:
        """Whether a condition holds for the constants that it depends on; None when it depends on more.
        Asking makes no event: the condition may stand in noEvent()."""
        try:
            with self.at_events():
                made = self.value(condition)
        except ModelError:
            return None
        made = v.constant(made) if isinstance(made, ca.SX) else made
        return bool(made) if isinstance(made, bool | int | float) else None

    def sequence(self, node: s.Node) -> list[Value]:
        """The values that a for-iterator takes."""
        made = self.value(node)
        if isinstance(made, np.ndarray):
            return list(made)
        return [i + 1 for i in range(integer(made))]

    @contextmanager
    def bound(self, names: Sequence[str], values: Sequence[Value]) -> Iterator[None]:
        """Loop variables in force inside the block."""
        before = self.iterators
        self.iterators = {**before, **dict(zip(names, values, strict=True))}
        try:
            yield
        finally:
            self.iterators = before

    @contextmanager
    def at_events(self) -> Iterator[None]:
        """Relations are what they are at each instant inside the block: they generate no events."""
        before, self.is_live = self.is_live, True
        try:
            yield
        finally:
            self.is_live = before

    @contextmanager
    def guarded(self, condition: ca.SX) -> Iterator[None]:
        """What is evaluated inside the block is wanted only where `condition` holds."""
        before = self.guard
        self.guard = condition if before is None else ca.logic_and(before, condition)
        try:
            yield
        finally:
            self.guard = before

    def error(self, code: str, what: str, node: s.Node | s.Statement | None, remedy: str) -> ModelError:
        span = getattr(node, "span", None) or self.at
        return ModelError(code, what, where=self.locate(span), remedy=remedy)

    # Names --------------------------------------------------------------------------------------------------

    def _name(self, node: s.Name) -> Value:
        if node.subscripts and node.name not in self.iterators:
            found = self.scope.element(node.name, self._subscripts(node.subscripts))
            if found is not None:
                return found
        base = self.iterators.get(node.name) if node.name in self.iterators else self.scope.lookup(node.name)
        if base is None:
            base = self._path(node)
            if base is not None:
                return base
            raise self.error(
                "model-unknown-name",
                f"`{node.name}` is not known here",
                node,
                "Declare it, or check its spelling.",
            )
        return self._indexed(base, node.subscripts) if node.subscripts else base

    def _path(self, node: s.Node) -> Value | None:
        parts = self._parts(node)
        return None if parts is None else self.scope.path(parts)

    def _parts(self, node: s.Node) -> Path | None:
        """The component path behind nested names, indices and fields; None when the base is no name."""
        match node:
            case s.Name(name, subscripts):
                parts: Path = [(ident, tuple(indices)) for ident, indices in split_path(name)]
                return _with_subscripts(parts, self._subscripts(subscripts))
            case s.Field(base, name):
                parts_or_none = self._parts(base)
                return None if parts_or_none is None else [*parts_or_none, (name, ())]
            case s.Index(base, subscripts):
                parts_or_none = self._parts(base)
                if parts_or_none is None:
                    return None
                return _with_subscripts(parts_or_none, self._subscripts(subscripts))
        return None

    def _subscripts(self, nodes: Sequence[s.Node]) -> tuple[Value | None, ...]:
        scope = self.scope
        plain = replace(self, scope=scope.scope) if isinstance(scope, Redirected) else self
        return tuple(None if isinstance(node, s.Colon) else plain.value(node) for node in nodes)

    def _indexed(self, base: Value, subscripts: Sequence[s.Node]) -> Value:
        return indexed(base, self._subscripts(subscripts))

    def _index(self, node: s.Index) -> Value:
        if not isinstance(node.base, s.Index | s.Field | s.Name):
            return self._indexed(self.value(node.base), node.subscripts)
        base = self._path(node)
        if base is not None:
            return base
        return self._indexed(self.value(node.base), node.subscripts)

    def _field(self, node: s.Field) -> Value:
        found = self._path(node)
        if found is None:
            found = field_of(self.value(node.base), node.name)
        if found is None:
            raise self.error(
                "model-unknown-name",
                f"`{text(node)}` is not known here",
                node,
                "Declare it, or check its spelling.",
            )
        return found

    # Operators ----------------------------------------------------------------------------------------------

    def _constant(self, node: s.Constant) -> Value:
        return node.value

    def _unary(self, node: s.Unary) -> Value:
        made = self.value(node.operand)
        if node.operator == "not":
            return v.mapped(_not, made)
        return made if node.operator == "+" else v.mapped(v.negate, made)

    def _binary(self, node: s.Binary) -> Value:
        operator = node.operator
        left = self.value(node.left)
        if isinstance(left, bool) and operator in ("and", "or") and left is (operator == "or"):
            return left  # decided: what is on the right may have no value
        right = self.value(node.right)
        if operator == "*":
            return v.product(left, right)
        if operator in ("^", ".^"):
            return self._power(left, right, operator)
        if operator in ("and", "or"):
            return v.combined(_and if operator == "and" else _or, left, right)
        if operator in RELATIONS:
            return v.combined(self._relation(operator, node), left, right)
        if operator in ("/", "./"):
            right = self._inside(right, 1.0)
        return v.combined(_ELEMENTWISE[operator], left, right)

    def _relation(self, operator: str, node: s.Binary) -> Callable[[Scalar, Scalar], Scalar]:
        if self.events is None or self.is_live or operator in ("==", "<>"):
            return RELATIONS[operator]
        events, shown = self.events, text(node)
        key = (shown, tuple((name, str(value)) for name, value in self.iterators.items()))
        return lambda a, b: events.relation(operator, a, b, key, shown)

    def _inside(self, value: Value, safe: float) -> Value:
        """`value` where it is wanted, else a number at which functions and their slopes are finite: the slope
        of a branch that is not taken is multiplied by zero, which does not undo an infinite one."""
        if self.guard is None:
            return value
        guard = self.guard

        def one(x: Scalar) -> Scalar:
            return ca.if_else(guard, x, safe) if isinstance(x, ca.SX) and not x.is_constant() else x

        return v.mapped(one, value)

    def _power(self, base: Value, exponent: Value, operator: str) -> Value:
        if isinstance(base, np.ndarray) and operator == "^":
            return v.matrix_power(base, integer(exponent))
        if not (isinstance(exponent, int | float) and float(exponent).is_integer() and exponent >= 1):
            base = self._inside(base, _SAFE)
        return v.combined(v.power, base, exponent)

    def _conditional(self, node: s.Conditional) -> Value:
        return self._branches(node.branches, node.otherwise)

    def _branches(self, branches: tuple[tuple[s.Node, s.Node], ...], otherwise: s.Node) -> Value:
        if not branches:
            return self.value(otherwise)
        condition = v.constant(self.scalar(branches[0][0]))
        if not isinstance(condition, ca.SX):
            return self.value(branches[0][1]) if condition else self._branches(branches[1:], otherwise)
        with self.guarded(condition):
            taken = self.value(branches[0][1])
        with self.guarded(ca.logic_not(condition)):
            return v.choose(condition, taken, self._branches(branches[1:], otherwise))

    # Calls --------------------------------------------------------------------------------------------------

    def _call(self, node: s.Call) -> Value:
        if not node.builtin:
            return self._function(node)[0]
        if node.function == "der":
            return self._derivative(node)
        if node.function in EVENTFUL and self.events is not None:
            return self._eventful(node, self.events)
        if node.function in REFUSED:
            raise refusal(node.function, self.locate(node.span or self.at))
        if node.function == "homotopy":
            return self.value(node.arguments[0])
        if node.function in ("noEvent", "smooth"):
            with self.at_events():
                return self.value(node.arguments[-1])
        if node.function == "size" and (declared := self._declared_size(node.arguments)) is not None:
            return declared
        if node.function == "sqrt" and (inner := _clipped(node.arguments[0])) is not None:
            return v.mapped(v.root_of_positive_part, self.value(inner))
        if node.function == "sqrt" and _has_clipped_factor(node.arguments[0]):
            return v.mapped(v.root_of_positive_part, self.value(node.arguments[0]))
        arguments = [self.value(argument) for argument in node.arguments]
        if node.function in _GUARDED:
            arguments = [self._inside(argument, _SAFE) for argument in arguments]
        if node.function in _STEPPED and self.events is not None and not self.is_live:
            return self._stepped(node, arguments, self.events)
        return BUILTINS[node.function](arguments)

    def _declared_size(self, arguments: Sequence[s.Node]) -> Value | None:
        """`size(x)` or `size(x, i)` of a variable by its declaration: a parameter may ask for the size of a
        variable that has no value yet."""
        shape = self.scope.declared_shape(arguments[0].name) if _is_plain(arguments[0]) else None
        if shape is None:
            return None
        at = None if len(arguments) == 1 else integer(self.value(arguments[1]))
        if at is None:
            return v.array(list(shape))
        return shape[at - 1] if 1 <= at <= len(shape) else None

    def _eventful(self, node: s.Call, events: EventSink) -> Value:
        """Operators that need an event or a memory."""
        match node.function:
            case "pre":
                return self._before(node.arguments[0], events)
            case "edge":
                now, before = self.value(node.arguments[0]), self._before(node.arguments[0], events)
                return v.combined(lambda a, b: _and(a, _not(b)), now, before)
            case "change":
                now, before = self.value(node.arguments[0]), self._before(node.arguments[0], events)
                return v.combined(lambda a, b: a != b, now, before)
            case "sample" if len(node.arguments) == 2 and not _is_clock(node.arguments[1]):
                start, interval = (self.scalar(argument) for argument in node.arguments)
                return events.sample(start, interval, self.locate(node.span or self.at))
            case "initial":
                return events.initial()
            case "terminal":
                return False
        raise refusal(node.function, self.locate(node.span or self.at))

    def _before(self, node: s.Node, events: EventSink) -> Value:
        if not self.is_live and isinstance(node, s.Name) and not events.is_discrete(node.name):
            raise self.error(
                "model-unsupported",
                f"`pre` of the continuous variable `{text(node)}` outside of a when-clause",
                node,
                "pre() is for discrete variables, and for what a when-clause restarts.",
            )
        scope = events.pre_scope(self.scope)
        return Evaluator(scope, self.call, self.locate, self.iterators, self.at).value(node)

    def _stepped(self, node: s.Call, arguments: Sequence[Value], events: EventSink) -> Value:
        """Functions whose values jump: between events they keep what they are."""

        def floor(x: Scalar, part: str) -> Scalar:
            if not isinstance(x, ca.SX):
                return BUILTINS["floor"]([x])  # type: ignore[return-value]
            key = (text(node), part, tuple((name, str(value)) for name, value in self.iterators.items()))
            return events.whole(x, key, text(node))

        def one(x: Scalar, y: Scalar) -> Scalar:
            match node.function:
                case "ceil":
                    return v.negate(floor(v.negate(x), ""))
                case "mod":
                    return v.subtract(x, v.multiply(floor(v.divide(x, y), ""), y))
                case "div" | "rem":
                    quotient = v.divide(x, y)
                    if not isinstance(quotient, ca.SX):
                        return BUILTINS[node.function]([x, y])  # type: ignore[return-value]
                    down, up = floor(quotient, "down"), v.negate(floor(v.negate(quotient), "up"))
                    cut = ca.if_else(quotient >= 0, v.symbolic(down), v.symbolic(up))
                    return cut if node.function == "div" else v.subtract(x, v.multiply(cut, y))
            return floor(x, "")

        if len(arguments) == 2:
            return v.combined(one, arguments[0], arguments[1])
        return v.mapped(lambda x: one(x, 1.0), arguments[0])

    def _function(self, node: s.Call) -> tuple[Value, ...]:
        last = node.function.rpartition(".")[2]
        if last in REFUSED:
            raise refusal(last, self.locate(node.span or self.at))
        arguments = [self.value(argument) for argument in node.arguments]
        before, self.at = self.at, node.span or self.at
        try:
            return self.call(node.function, arguments, node.constructor, self)
        finally:
            self.at = before

    def _derivative(self, node: s.Call) -> Value:
        argument = node.arguments[0]
        if not isinstance(argument, s.Name | s.Index | s.Field):
            return v.mapped(lambda x: self._rate(x, node), self.value(argument))
        scope = Redirected(self.scope, self.scope.derivative)
        return Evaluator(scope, self.call, self.locate, self.iterators, node.span or self.at).value(argument)

    def _rate(self, value: Scalar, node: s.Call) -> Scalar:
        """The time derivative of an expression, by the chain rule."""
        if not isinstance(value, ca.SX):
            return 0.0
        made: Scalar = 0.0
        for symbol in ca.symvar(value):
            rate = self.scope.rate(symbol.name())
            if rate is None:
                what = f"der({text(node.arguments[0])}) differentiates an input or a discrete variable"
                remedy = "Introduce a variable for it (`Real x = u;`) and differentiate x in its place."
                raise self.error("model-der-input", what, node, remedy)
            if not (isinstance(rate, float) and rate == 0.0):
                made = v.add(made, v.multiply(ca.jacobian(value, symbol), rate))
        return made

    # Arrays -------------------------------------------------------------------------------------------------

    def _array(self, node: s.Array) -> Value:
        if node.is_matrix:
            rows = [row.elements if isinstance(row, s.Array) else (row,) for row in node.elements]
            return matrix_of_rows([[self.value(e) for e in row] for row in rows])
        return v.array([self.value(e) for e in node.elements])

    def _tuple(self, node: s.Tuple) -> Value:
        return tuple(0.0 if e is None else self.value(e) for e in node.elements)

    def _range(self, node: s.Range) -> Value:
        start, stop = v.constant(self.scalar(node.start)), v.constant(self.scalar(node.stop))
        step = 1 if node.step is None else v.constant(self.scalar(node.step))
        if any(isinstance(x, ca.SX) for x in (start, step, stop)):
            raise ValueError("a range needs constant bounds")
        return v.from_flat(*_range_values(start, step, stop))  # type: ignore[arg-type]

    def _comprehension(self, node: s.Comprehension) -> Value:
        return self._nested(node.element, node.iterators)

    def _nested(self, element: s.Node, iterators: tuple[tuple[str, s.Node], ...]) -> Value:
        if not iterators:
            return self.value(element)
        # The last iterator of {… for i in I, j in J} gives the first dimension (Specification 10.4.1.1).
        name, over = iterators[-1]
        made = []
        for value in self.sequence(over):
            with self.bound([name], [value]):
                made.append(self._nested(element, iterators[:-1]))
        return v.array(made)

    def _colon(self, node: s.Colon) -> Value:
        raise ValueError("`:` stands outside of a subscript")


_HANDLERS: dict[type, Callable[[Evaluator, s.Node], Value]] = {
    s.Constant: Evaluator._constant,  # type: ignore[dict-item]
    s.Name: Evaluator._name,  # type: ignore[dict-item]
    s.Unary: Evaluator._unary,  # type: ignore[dict-item]
    s.Binary: Evaluator._binary,  # type: ignore[dict-item]
    s.Conditional: Evaluator._conditional,  # type: ignore[dict-item]
    s.Call: Evaluator._call,  # type: ignore[dict-item]
    s.Array: Evaluator._array,  # type: ignore[dict-item]
    s.Tuple: Evaluator._tuple,  # type: ignore[dict-item]
    s.Range: Evaluator._range,  # type: ignore[dict-item]
    s.Comprehension: Evaluator._comprehension,  # type: ignore[dict-item]
    s.Index: Evaluator._index,  # type: ignore[dict-item]
    s.Field: Evaluator._field,  # type: ignore[dict-item]
    s.Colon: Evaluator._colon,  # type: ignore[dict-item]
}


@dataclass(frozen=True)
class Redirected:
    """A scope in which names stand for something else, as for their derivatives or for their values before
    an event; subscripts are read by the evaluator as usual."""

    scope: Scope
    meant: Callable[[str], Value | None]

    def lookup(self, name: str) -> Value | None:
        return self.meant(name)

    def element(self, name: str, subscripts: Sequence[Value | None]) -> Value | None:
        return None

    def path(self, parts: Sequence[PathPart]) -> Value | None:
        head = join_path(parts[:-1], parts[-1][0])
        found = None if head is None else self.meant(head)
        return None if found is None else indexed(found, parts[-1][1])

    def derivative(self, name: str) -> Value | None:
        return None

    def rate(self, symbol: str) -> Scalar | None:
        return None

    def declared_shape(self, name: str) -> tuple[int, ...] | None:
        return self.scope.declared_shape(name)


def _clipped(node: s.Node) -> s.Node | None:
    """x of `max(0, x)` and `max(x, 0)`."""
    if not isinstance(node, s.Call) or node.function != "max" or len(node.arguments) != 2:
        return None
    is_zero = [isinstance(one, s.Constant) and one.value == 0 for one in node.arguments]
    return node.arguments[1 - is_zero.index(True)] if any(is_zero) else None


def _has_clipped_factor(node: s.Node) -> bool:
    """Whether a product or quotient is zero where a clipped factor of it is, as `2*g*max(h, 0)`."""
    if not isinstance(node, s.Binary) or node.operator not in ("*", ".*", "/", "./"):
        return _clipped(node) is not None
    factors = (node.left,) if node.operator.endswith("/") else (node.left, node.right)
    return any(_has_clipped_factor(factor) for factor in factors)


def _is_plain(node: s.Node) -> TypeGuard[s.Name]:
    return isinstance(node, s.Name) and not node.subscripts


def _is_clock(node: s.Node) -> bool:
    return isinstance(node, s.Call) and node.function.rpartition(".")[2] == "Clock"


def refusal(what: str, where: Place | None) -> ModelError:
    """The error for an operator or construct that needs events, clocks or a memory."""
    return ModelError("model-unsupported", f"`{what}` is not supported", where=where, remedy=_REFUSAL_REMEDY)


def _range_values(start: float, step: float, stop: float) -> tuple[list[float], tuple[int]]:
    if step == 0:
        raise ValueError("a range needs a step other than zero")
    # A Real range includes its end up to rounding: the tolerance is relative to the number of steps.
    count = max(0, int(np.floor((stop - start) / step + 1e-9)) + 1)
    made = [start + i * step for i in range(count)]
    return made, (count,)


def _not(x: Scalar) -> Scalar:
    return ca.logic_not(x) if isinstance(x, ca.SX) else not x


def _and(a: Scalar, b: Scalar) -> Scalar:
    if isinstance(a, ca.SX) and isinstance(b, ca.SX):
        return ca.logic_and(a, b)
    if isinstance(a, ca.SX):
        return a if b else False
    return b if a else False


def _or(a: Scalar, b: Scalar) -> Scalar:
    if isinstance(a, ca.SX) and isinstance(b, ca.SX):
        return ca.logic_or(a, b)
    if isinstance(a, ca.SX):
        return True if b else a
    return True if a else b


def indexed(base: Value, subscripts: Sequence[Value | None]) -> Value:
    """`base[subscripts]` with Modelica's indices from 1; None is `:`. Raises ValueError outside of the
    array."""
    if not subscripts:
        return base
    if not isinstance(base, np.ndarray):
        raise v.ShapeError("a scalar has no elements")
    if len(subscripts) > base.ndim:
        raise v.ShapeError(f"{len(subscripts)} subscripts for an array of size {v.size_text(base.shape)}")
    for axis, subscript in enumerate(subscripts):
        if isinstance(v.constant(subscript), ca.SX):  # type: ignore[arg-type]
            return _selected(base, subscripts, axis)
    chosen = [_positions(subscript, size) for subscript, size in zip(subscripts, base.shape, strict=False)]
    if all(isinstance(c, int) for c in chosen):
        return base[tuple(chosen)]
    made = base
    axis = 0
    for positions in chosen:
        made = made.take(positions, axis=axis)
        axis += 0 if isinstance(positions, int) else 1
    return made


def _selected(base: np.ndarray, subscripts: Sequence[Value | None], axis: int) -> Value:
    """The element whose number a variable tells, as the gear of a gear box: a choice among all. A number
    outside of the array means its first or last element."""
    at = subscripts[axis]
    assert isinstance(at, ca.SX)

    def one(number: int) -> Value:
        return indexed(base, [*subscripts[:axis], number, *subscripts[axis + 1 :]])

    made = one(base.shape[axis])
    for number in range(base.shape[axis] - 1, 0, -1):
        made = v.choose(at <= number, one(number), made)
    return made


def _positions(subscript: Value | None, size: int) -> int | list[int]:
    if subscript is None:
        return list(range(size))
    if isinstance(subscript, np.ndarray):
        return [_position(one, size) for one in subscript]
    return _position(subscript, size)


def _position(subscript: Value, size: int) -> int:
    at = integer(v.constant(subscript) if isinstance(subscript, ca.SX) else subscript)
    if not 1 <= at <= size:
        raise ValueError(f"index {at} is outside of 1 to {size}")
    return at - 1


def field_of(value: Value, name: str) -> Value | None:
    """Field `name` of a record, or of each record of an array."""
    if isinstance(value, Record):
        return value.fields.get(name)
    if isinstance(value, np.ndarray) and value.size and isinstance(value.flat[0], Record):
        fields = [record.fields.get(name) for record in value.flat]
        if any(f is None for f in fields):
            return None
        made = v.array(fields)
        return made.reshape(value.shape + made.shape[1:])
    return None


_PART = re.compile(r"('(?:[^'\\]|\\.)*'|[^.\[\]']+)(?:\[([^\]]*)\])?\.?")


def split_path(name: str) -> list[tuple[str, list[int]]]:
    """`a[1].b[2,3]` -> [("a", [1]), ("b", [2, 3])]."""
    return [
        (ident, [int(i) for i in indices.split(",")] if indices else [])
        for ident, indices in _PART.findall(name)
    ]


def join_path(parts: Sequence[PathPart], last: str) -> str | None:
    """The flat name of a path whose subscripts are plain integers, else None."""
    made = []
    for ident, subscripts in parts:
        if any(subscript is None or not isinstance(subscript, int) for subscript in subscripts):
            return None
        made.append(ident + (f"[{','.join(map(str, subscripts))}]" if subscripts else ""))
    return ".".join([*made, last])


def _with_subscripts(parts: Path, subscripts: tuple[Value | None, ...]) -> Path:
    ident, before = parts[-1]
    return [*parts[:-1], (ident, (*before, *subscripts))]


def index_tuples(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """All index tuples of an array, row by row, from 1."""
    return list(cartesian(*(range(1, n + 1) for n in shape)))
