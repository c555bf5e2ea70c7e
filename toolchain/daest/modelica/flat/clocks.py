"""Clocked equations as equations with events (Modelica Language Specification 3.6, chapter 16).

Between two ticks of its clock every clocked variable keeps its value. So its equations hold at all times,
if what they take from outside changes at ticks alone: `sample(u)` becomes a variable that takes the left
limit of u at a tick, `previous(v)` one that takes that of v, `subSample(v)` one that takes v itself. These
are assigned in one when-clause, whose ticks are the common raster of all clocks of the model; a counter of
these ticks tells which clock is active. `hold(v)` is v, which has its start value before the first tick.

Which variables share a clock follows from the equations: what stands in one equation, unless one of the
operators above lies between, has one clock (16.7), and sub-, super- and shifted clocks bind those of their
arguments to their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from fractions import Fraction
from math import gcd, lcm
from typing import Any

from daest.errors import DaestError, ModelError, Place
from daest.modelica.flat.functions import assigned
from daest.modelica.flat.parameters import is_parameter
from daest.modelica.flat.reading import Reading
from daest.modelica.language import syntax as s
from daest.modelica.language.failures import CLOCKED_REMEDY
from daest.modelica.language.specialise import specialised, with_numbers
from daest.modelica.language.text import text

_BETWEEN_CLOCKS = ("hold", "subSample", "superSample", "shiftSample", "backSample", "noClock")
_OPERATORS = (*_BETWEEN_CLOCKS, "previous", "interval", "firstTick")
_MOST_TICKS = 1000  # of the raster in the shortest period
_FINEST = 10**9  # largest denominator of a period that is written as a decimal number [1/s]

Rate = tuple[Fraction, Fraction]  # period and first tick [s]


def without_clocks(source: s.FlatSource) -> s.FlatSource:
    """The source with its clocked equations as equations and one when-clause.

    Raises ModelError `model-unsupported` where a clock ticks at events, has a solver for continuous
    equations, or follows from nothing.
    """
    clocks = frozenset(x.name for x in source.variables if x.type_name == "Clock")
    return _Partitions(Reading(source), clocks).read().translated() if clocks else source


def _changed(node: Any, change: Callable[[Any], Any]) -> Any:
    """The tree in which `change` has replaced nodes; it gives None where it leaves a node to its parts."""
    made = change(node)
    return s.rebuilt(node, lambda part: _changed(part, change)) if made is None else made


@dataclass(frozen=True)
class _Relation:
    """Of the clocks of two partitions: `outer` ticks with `factor` times the period of `inner`, or is shifted
    by `shift` of its periods; factor None: as both clocks are."""

    outer: object
    inner: object
    factor: Fraction | None
    shift: Fraction


@dataclass
class _Partitions:
    """Which variables and equations have one clock, and which."""

    reading: Reading
    clocks: frozenset[str]
    parent: dict[object, object] = field(default_factory=dict)
    relations: list[_Relation] = field(default_factory=list)
    rates: dict[object, Rate] = field(default_factory=dict)
    clocked: list[object] = field(default_factory=list)  # nodes whose partitions have a clock
    whens: list[s.When] = field(default_factory=list)  # those that are not on a clock
    equations: list[s.FlatEquation] = field(default_factory=list)
    inner: dict[int, object] = field(default_factory=dict)  # id of a call -> partition of its argument

    def __post_init__(self) -> None:
        source = self.reading.source
        self.variables = {x.name: x for x in source.variables if not is_parameter(x)}

    # Reading ------------------------------------------------------------------------------------------------

    def read(self) -> _Partitions:
        source = self.reading.source
        self.equations = [with_numbers(one) for one in source.equations]
        for when in source.whens:
            if len(when.branches) == 1 and self._is_clock(when.branches[0][0]):
                self._take_when(when)
            else:
                self.whens.append(when)
        self.equations = [
            replace(one, right=self._chosen(one.right)) if self._is_of_clocks(one) else one
            for one in self.equations
        ]
        for equation in self.equations:
            self._visit((equation.left, equation.right), id(equation))
        for algorithm in source.algorithms:
            self._visit(algorithm.body, id(algorithm))
        for when in self.whens:
            self._visit(when.branches, id(when))
        for name, variable in self.variables.items():
            if variable.binding is not None:
                self._visit((s.Name(name), variable.binding), ("binding", name))
        self._solve()
        return self

    def _is_clock(self, node: s.Node) -> bool:
        if isinstance(node, s.Name):
            return node.name in self.clocks
        return isinstance(node, s.Call) and node.builtin and node.function == "clock"

    def _is_of_clocks(self, equation: s.FlatEquation) -> bool:
        return isinstance(equation.left, s.Name) and equation.left.name in self.clocks

    def _chosen(self, node: s.Node | None) -> s.Node | None:
        """A clock's expression without branches that parameters decide."""
        return node and specialised(node, {}, lambda condition: bool(self._number(condition)))

    def _take_when(self, when: s.When) -> None:
        condition, body = when.branches[0]
        self._visit(condition, id(when))
        made = [self._equation(one, when) for one in _simple(body, self._place(when.span))]
        for one in made:
            self._join(id(when), id(one))
        self.equations += made

    def _equation(self, statement: s.Statement, when: s.When) -> s.FlatEquation:
        span = statement.span or when.span
        match statement:
            case s.Assign(target, value):
                return s.FlatEquation(target, value, "component", target.name.rpartition(".")[0], span)
            case s.AssignCall(targets, call):
                return s.FlatEquation(s.Tuple(targets, span), call, "component", "", span)
        raise self._refused("a statement of this kind in a when-clause on a clock", span)

    def _visit(self, node: object, owner: object) -> None:
        """What stands in `node` shares the clock of `owner`."""
        match node:
            case s.Name(name, subscripts):
                if name in self.variables:
                    self._join(owner, name)
                self._visit(subscripts, owner)
            case s.Call(function, arguments, True):
                self._visit_call(node, function, arguments, owner)
            case tuple():
                for part in node:
                    self._visit(part, owner)
            case _ if is_dataclass(node) and not isinstance(node, s.Span):
                for one in fields(node):
                    self._visit(getattr(node, one.name), owner)

    def _visit_call(self, call: s.Call, function: str, arguments: tuple[s.Node, ...], owner: object) -> None:
        if function == "clock":
            self.clocked.append(owner)
            self._constructed(call, arguments, owner)
            return
        if function not in _BETWEEN_CLOCKS and not self._is_sampling(call):
            if function in _OPERATORS:
                self.clocked.append(owner)
            self._visit(arguments, owner)
            return
        argument = ("argument", len(self.inner))
        self.inner[id(call)] = argument
        self._visit(arguments[0], argument)
        if function != "sample":
            self.clocked.append(argument)
        if function != "hold":
            self.clocked.append(owner)
        if function == "sample":
            self._visit(arguments[1:], owner)
        elif function in ("subSample", "superSample"):
            n = Fraction(round(self._number(arguments[1]))) if len(arguments) > 1 else Fraction(0)
            factor = None if not n else n if function == "subSample" else 1 / n
            self.relations.append(_Relation(owner, argument, factor, Fraction(0)))
        elif function in ("shiftSample", "backSample"):
            counts = [Fraction(round(self._number(one))) for one in arguments[1:]]
            shift = counts[0] / (counts[1] if len(counts) > 1 else 1)
            sign = 1 if function == "shiftSample" else -1
            self.relations.append(_Relation(owner, argument, Fraction(1), sign * shift))

    def _is_sampling(self, call: s.Call) -> bool:
        """Whether it is sample(u) or sample(u, clock), and not sample(start, interval)."""
        return call.function == "sample" and all(map(self._is_clock, call.arguments[1:]))

    def _constructed(self, call: s.Call, arguments: tuple[s.Node, ...], owner: object) -> None:
        if not arguments:
            return
        if self._is_clock(arguments[0]):
            self._visit(arguments[0], owner)
            return
        try:
            numbers = [self._number(one) for one in arguments]
        except DaestError:
            numbers = []
        if not numbers or any(isinstance(one, bool) for one in numbers):
            raise self._refused(
                f"`{text(call).replace('clock', 'Clock', 1)}`, a clock that ticks at events,", call.span
            )
        exact = [Fraction(float(one)).limit_denominator(_FINEST) for one in numbers]
        period = exact[0] / (exact[1] if len(exact) > 1 else 1)
        if period <= 0:
            raise self._refused(f"a clock with the period {float(period):g} s", call.span)
        self._tell(owner, (period, Fraction(0)))

    # Clocks -------------------------------------------------------------------------------------------------

    def _root(self, node: object) -> object:
        while (above := self.parent.get(node, node)) != node:
            self.parent[node] = self.parent.get(above, above)
            node = above
        return node

    def _join(self, one: object, other: object) -> None:
        one, other = self._root(one), self._root(other)
        if one == other:
            return
        self.parent[other] = one
        if other in self.rates:
            self._tell(one, self.rates.pop(other))

    def _tell(self, node: object, rate: Rate) -> None:
        """Gives a partition its clock; raises ModelError where it has another one already."""
        known = self.rates.setdefault(self._root(node), rate)
        if known != rate:
            raise ModelError(
                "model-unsupported",
                "variables of one equation are on two clocks: "
                f"every {_seconds(known)} and every {_seconds(rate)}",
                remedy="Put superSample, subSample or hold and sample between them.",
            )

    def rate(self, node: object) -> Rate | None:
        return self.rates.get(self._root(node))

    def _solve(self) -> None:
        is_changed = True
        while is_changed:
            is_changed = False
            for one in self.relations:
                outer, inner = self.rate(one.outer), self.rate(one.inner)
                if one.factor is None or (outer is None) == (inner is None):
                    continue
                if inner is not None:
                    period, phase = inner
                    self._tell(one.outer, (period * one.factor, phase + one.shift * period))
                elif outer is not None:
                    period = outer[0] / one.factor
                    self._tell(one.inner, (period, outer[1] - one.shift * period))
                is_changed = True
        roots = {self._root(node) for node in self.clocked}
        open_ = {root for root in roots if root not in self.rates}
        for equation in self.equations:
            if self._root(id(equation)) in open_ and not self._is_of_clocks(equation):
                raise self._refused("an equation whose clock follows from nothing", equation.span)

    # Translation --------------------------------------------------------------------------------------------

    def translated(self) -> s.FlatSource:
        source = self.reading.source
        raster = _Raster.of(list(self.rates.values()), self._place(None))
        made = _Translation(self, raster)
        equations = [_changed(one, made.of(id(one))) for one in self.equations if not self._is_of_clocks(one)]
        algorithms = tuple(_changed(one, made.of(id(one))) for one in source.algorithms)
        whens = [replace(one, branches=_changed(one.branches, made.of(id(one)))) for one in self.whens]
        variables = [self._bound(x, made) for x in source.variables if x.name not in self.clocks]
        whens += made.when()
        return replace(
            source,
            variables=(*variables, *made.variables),
            equations=tuple(equations),
            algorithms=algorithms,
            whens=tuple(whens),
        )

    def _bound(self, variable: s.FlatVariable, made: _Translation) -> s.FlatVariable:
        if variable.binding is None or is_parameter(variable):
            return variable
        return replace(variable, binding=_changed(variable.binding, made.of(("binding", variable.name))))

    def _number(self, node: s.Node) -> Any:
        value = self.reading.evaluator(self.reading.numeric, getattr(node, "span", None)).scalar(node)
        return value if isinstance(value, bool | str) else float(value)

    def _place(self, span: s.Span | None) -> Place | None:
        return self.reading.sources.place(span)

    def _refused(self, what: str, span: s.Span | None) -> ModelError:
        return ModelError(
            "model-unsupported",
            f"{what} is not supported",
            where=self._place(span),
            remedy=CLOCKED_REMEDY.format(period="period"),
        )


@dataclass(frozen=True)
class _Raster:
    """The common ticks start + k period of all clocks [s]."""

    start: Fraction
    period: Fraction

    @classmethod
    def of(cls, rates: Sequence[Rate], where: Place | None) -> _Raster:
        """Raises ModelError where the clocks have no raster that is coarse enough."""
        if not rates:
            return cls(Fraction(0), Fraction(1))
        start = min(phase for _, phase in rates)
        spans = [period for period, _ in rates] + [phase - start for _, phase in rates if phase > start]
        below = lcm(*(span.denominator for span in spans))
        period = Fraction(gcd(*(int(span * below) for span in spans)), below)
        if start < 0 or min(period for period, _ in rates) > _MOST_TICKS * period:
            what = "a clock ticks before the start" if start < 0 else "the clocks have no common raster"
            raise ModelError(
                "model-unsupported",
                f"{what}: " + ", ".join(f"every {_seconds(rate)}" for rate in sorted(set(rates))),
                where=where,
                remedy="Let the periods of the clocks be multiples of one period.",
            )
        return cls(start, period)

    def counts(self, rate: Rate) -> tuple[int, int]:
        """Ticks of the raster between two ticks of a clock, and before its first one."""
        return int(rate[0] / self.period), int((rate[1] - self.start) / self.period)


class _Translation:
    """The operators of clocked equations by variables that one when-clause assigns."""

    def __init__(self, partitions: _Partitions, raster: _Raster) -> None:
        self.partitions, self.raster = partitions, raster
        self.variables: list[s.FlatVariable] = []
        self.body: list[s.Statement] = []
        self._names = {x.name for x in partitions.reading.source.variables}
        self._made: dict[tuple, s.Name] = {}
        self.tick = s.Name(self._free("clock_tick"))

    def of(self, owner: object) -> Callable[[Any], Any]:
        """What `_changed` does to the nodes of an equation."""

        def change(node: Any) -> Any:
            if not isinstance(node, s.Call) or not node.builtin:
                return None
            if node.function == "der" and (rate := self.partitions.rate(owner)) is not None:
                raise self.partitions._refused(
                    f"`{text(node)}` on a clock of {float(rate[0]):g} s (a clock with a solver)", node.span
                )
            is_clocked = id(node) in self.partitions.inner or node.function in _OPERATORS
            return self._call(node, owner) if is_clocked else None

        return change

    def _call(self, call: s.Call, owner: object) -> s.Node:
        original = call.arguments[0]
        inside = self.partitions.inner.get(id(call), owner)
        argument = _changed(original, self.of(inside))
        rate, inner = self.partitions.rate(owner), self.partitions.rate(inside)
        if call.function in ("noClock", "superSample"):
            return argument
        if call.function == "hold":
            assert inner is not None
            return self._from(self.raster.counts(inner)[1], argument, original) if inner[1] else argument
        assert rate is not None
        count, first = self.raster.counts(rate)
        match call.function:
            case "interval":
                return s.Constant(float(rate[0]))
            case "firstTick":
                return _less(self.tick, first + count)
            case "previous":
                return self._left_limit("previous", argument, original, rate, first)
            case "sample":
                before: s.Node = s.Call("pre", (argument,), builtin=True)
                if rate[1] == 0:  # nothing has been before the start
                    before = s.Conditional(((_less(self.tick, 1), argument),), before)
                return self._kept("sampled", original, before, rate, None)
            case "subSample":
                return self._kept("sampled", original, argument, rate, None)
        assert inner is not None
        return self._shifted(argument, original, rate, inner)

    def _shifted(self, argument: s.Node, original: s.Node, rate: Rate, inner: Rate) -> s.Node:
        """The latest value of `argument`, whose clock is `inner`; its start value before its first tick."""
        _, first = self.raster.counts(inner)
        if ((rate[1] - inner[1]) / inner[0]).denominator != 1:
            return self._left_limit("shifted", argument, original, rate, first)
        return argument if rate[1] >= inner[1] else self._from(first, argument, original)

    def _left_limit(self, what: str, argument: s.Node, original: s.Node, rate: Rate, first: int) -> s.Name:
        """What `argument`, whose first tick is that, has been before a tick."""
        before = self._from(first + 1, s.Call("pre", (argument,), builtin=True), original)
        return self._kept(what, original, before, rate, self._start(original))

    def _from(self, first: int, value: s.Node, original: s.Node) -> s.Node:
        """`value` from a tick of the raster on, the start value of `original` before."""
        return s.Conditional(((_less(self.tick, first), self._start(original)),), value)

    def _start(self, node: s.Node) -> s.Node:
        variable = self._variable(node)
        if variable is None:
            return s.Constant(0)
        return variable.start or s.Constant(False if variable.type_name == "Boolean" else 0)

    def _variable(self, node: s.Node) -> s.FlatVariable | None:
        return self.partitions.variables.get(node.name) if isinstance(node, s.Name) else None

    def _kept(self, what: str, original: s.Node, taken: s.Node, rate: Rate, start: s.Node | None) -> s.Name:
        """The variable that takes `taken` at the ticks of a clock; one for all places that ask for it."""
        key = (what, text(original), rate)
        if key in self._made:
            return self._made[key]
        like = self._variable(original)
        count, first = self.raster.counts(rate)
        span = getattr(original, "span", None)
        label = text(original) if isinstance(original, s.Name) else f"signal_{len(self._made)}"
        path, _, end = label.rpartition(".")
        name = self._free(f"{path}.{what}_{_plain(end)}" if path else f"{what}_{_plain(end)}")
        is_scalar = like is None or bool(isinstance(original, s.Name) and original.subscripts)
        made = s.Name(name, (), span)
        if count > 1 or first > 0:
            behind = s.Binary("-", self.tick, s.Constant(first))
            phase = s.Call("mod", (behind, s.Constant(count)), builtin=True)
            is_active: s.Node = _less(phase, 1)
            if first:
                is_active = s.Binary("and", s.Unary("not", _less(self.tick, first)), is_active)
            taken = s.Conditional(((is_active, taken),), s.Call("pre", (made,), builtin=True))
        self.variables.append(_variable(name, like, is_scalar, start, span))
        self.body.append(s.Assign(made, taken, span))
        self._made[key] = made
        return made

    def when(self) -> tuple[s.When, ...]:
        """The clause that counts the ticks and assigns what is taken at them."""
        if not self.partitions.rates:
            return ()
        now = s.Binary("+", s.Call("pre", (self.tick,), builtin=True), s.Constant(1.0))
        self.variables.append(_variable(self.tick.name, None, True, s.Constant(-1.0), None))
        ticks = (s.Constant(float(self.raster.start)), s.Constant(float(self.raster.period)))
        condition = s.Call("sample", ticks, builtin=True)
        return (s.When(((condition, (s.Assign(self.tick, now), *self.body)),)),)

    def _free(self, name: str) -> str:
        while name in self._names:
            name += "_"
        self._names.add(name)
        return name


def _plain(name: str) -> str:
    """A name that may end another one: x[2] as x_2."""
    return "".join(c if c.isalnum() else "_" for c in name).strip("_")


def _less(node: s.Node, count: int) -> s.Node:
    """Whether a whole number is less than `count`."""
    return s.Binary("<", node, s.Constant(count - 0.5))


def _variable(
    name: str, like: s.FlatVariable | None, is_scalar: bool, start: s.Node | None, span: s.Span | None
) -> s.FlatVariable:
    base = like or s.real_variable(name, span)
    return replace(
        base,
        name=name,
        variability="discrete",
        causality="local",
        is_flow=False,
        is_top_level=False,
        dimensions=() if is_scalar else base.dimensions,
        start=start,
        fixed=(True,),
        binding=None,
        is_bus_member=False,
    )


def _simple(body: Sequence[s.Statement], where: Place | None) -> Iterator[s.Statement]:
    """The statements of a when-clause without `if`: each target once, with a conditional value."""
    for statement in body:
        if not isinstance(statement, s.If):
            if not isinstance(statement, s.Assert):
                yield statement
            continue
        bodies = [tuple(_simple(inner, where)) for _, inner in statement.branches]
        last = tuple(_simple(statement.otherwise, where))
        for name in dict.fromkeys(assigned(last)):
            values = [_value_of(name, inner) for inner in (*bodies, last)]
            if any(value is None for value in values):
                raise ModelError(
                    "model-unsupported",
                    f"`{name}` is not assigned in every branch of an if-clause on a clock",
                    where=where,
                    remedy="Assign it in all branches, with previous() where it stays.",
                )
            conditions = [condition for condition, _ in statement.branches]
            *chosen, otherwise = (value for value in values if value is not None)
            value = s.Conditional(tuple(zip(conditions, chosen, strict=True)), otherwise)
            yield s.Assign(s.Name(name, (), statement.span), value, statement.span)


def _value_of(name: str, body: Sequence[s.Statement]) -> s.Node | None:
    return next((one.value for one in body if isinstance(one, s.Assign) and text(one.target) == name), None)


def _seconds(rate: Rate) -> str:
    period, phase = (f"{float(part):g} s" for part in rate)
    return period if not rate[1] else f"{period} from {phase} on"
