"""What a model does at events, collected while its equations are read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import casadi as ca

from daest.errors import ModelError, Place
from daest.model.events import (
    Activation,
    Assignment,
    Events,
    Memory,
    Relation,
    Restart,
    WholePart,
)
from daest.model.parts import Parameter
from daest.modelica.flat.functions import assigned, whole_name
from daest.modelica.flat.scope import ModelScope, element_names, symbols
from daest.modelica.language import syntax as s
from daest.modelica.language import values as v
from daest.modelica.language.expressions import Evaluator, Redirected, Scope, refusal
from daest.modelica.language.operators import EVENTFUL
from daest.modelica.language.text import text
from daest.modelica.language.values import Scalar, Value, column

_SWITCHED = {">": True, ">=": False, "<": True, "<=": False}


def has_events(source: s.FlatSource) -> bool:
    """Whether the model needs events or a memory: relations alone do not."""
    if source.whens:
        return True
    parts = (source.equations, source.initial_equations, source.algorithms)
    bindings = tuple(x.binding for x in source.variables)
    return _remembers((parts, bindings))


def _remembers(tree: object) -> bool:
    return any(
        isinstance(one, s.When) or (isinstance(one, s.Call) and one.builtin and one.function in EVENTFUL)
        for one in s.nodes(tree)
    )


def event_targets(source: s.FlatSource) -> frozenset[str]:
    """Names of the variables that events assign: in when-clauses, and Boolean and Integer variables of
    algorithms."""
    shapes = {x.name for x in source.variables}
    found = {name for when in source.whens for name in _targets([when])}
    discrete = {x.name for x in source.variables if x.is_discrete}
    for algorithm in source.algorithms:
        found |= set(_targets(s for s in algorithm.body))
        found |= set(assigned(algorithm.body)) & discrete
    return frozenset(name if name in shapes else whole_name(name) for name in found)


def _targets(statements: Iterable[s.Statement]) -> list[str]:
    """Names that when-clauses among statements assign."""
    found: list[str] = []
    for statement in statements:
        match statement:
            case s.When(branches):
                found += [name for _, body in branches for name in assigned(body)]
            case s.If(branches, otherwise):
                found += [name for _, body in branches for name in _targets(body)] + _targets(otherwise)
            case s.For(_, body) | s.While(_, body):
                found += _targets(body)
    return found


@dataclass
class _Relation:
    symbol: ca.SX
    value: ca.SX
    text: str
    is_strict: bool


@dataclass
class _Activation:
    symbol: ca.SX
    conditions: list[ca.SX]
    before: list[ca.SX]
    text: str
    place: Place | None


@dataclass
class Recorder:
    """The `EventSink` of one model. `targets` are the variables that events assign."""

    scope: ModelScope
    targets: frozenset[str]
    discrete: frozenset[str]  # Boolean and Integer variables
    relations: dict[tuple, _Relation] = field(default_factory=dict)
    wholes: dict[tuple, _Relation] = field(default_factory=dict)
    before: dict[str, Value] = field(default_factory=dict)
    activations: list[_Activation] = field(default_factory=list)
    ticks: list[tuple[ca.SX, ca.SX, ca.SX]] = field(default_factory=list)
    updates: dict[str, ca.SX] = field(default_factory=dict)
    restarts: list[tuple[s.Name, ca.SX, ca.SX]] = field(default_factory=list)
    memory: dict[str, tuple[ca.SX, s.FlatVariable]] = field(default_factory=dict)
    still: set[str] = field(default_factory=set)  # symbols that keep their values between events
    start: ca.SX | None = None
    parameters: frozenset[str] = frozenset()  # symbols of tunable parameters

    # EventSink ----------------------------------------------------------------------------------------------

    def relation(self, operator: str, left: Scalar, right: Scalar, key: tuple, shown: str) -> Scalar:
        flip = operator in ("<", "<=")
        value = v.subtract(right, left) if flip else v.subtract(left, right)
        is_strict = _SWITCHED[operator]
        if not isinstance(value, ca.SX) or self._keeps(value):
            return value > 0 if is_strict else value >= 0  # type: ignore[operator]
        if key not in self.relations:
            symbol = self._symbol("relation", len(self.relations))
            self.relations[key] = _Relation(symbol, value, shown, is_strict)
        return self.relations[key].symbol

    def whole(self, value: Scalar, key: tuple, shown: str) -> Scalar:
        made = v.symbolic(value)
        if self._keeps(made):
            return ca.floor(made)
        if key not in self.wholes:
            self.wholes[key] = _Relation(self._symbol("whole", len(self.wholes)), made, shown, False)
        return self.wholes[key].symbol

    def pre(self, name: str) -> Value | None:
        shape = self.scope.declared_shape(name)
        if shape is None:
            return self.scope.lookup(name)
        if name in self.scope.constant_names:
            return self.scope.lookup(name)
        if name not in self.before:
            names = element_names(name, shape)
            self.before[name] = symbols([f"pre({one})" for one in names], shape)
            self.still |= {f"pre({one})" for one in names}
        return self.before[name]

    def pre_scope(self, scope: Scope) -> Scope:
        return Redirected(scope, self.pre)

    def is_discrete(self, name: str) -> bool:
        return name in self.discrete or name in self.targets or name in self.scope.constant_names

    def sample(self, start: Scalar, interval: Scalar, at: Place | None) -> Scalar:
        symbol = self._symbol("sample", len(self.ticks))
        for value in (start, interval):
            if isinstance(value, ca.SX) and not self._keeps(value):
                raise ModelError(
                    "model-unsupported",
                    "sample(start, interval) depends on variables that change between events",
                    where=at,
                    remedy="Let start and interval depend on parameters only.",
                )
        self.ticks.append((symbol, v.symbolic(start), v.symbolic(interval)))
        return symbol

    def initial(self) -> Scalar:
        if self.start is None:
            self.start = self._symbol("initial", 0)
        return self.start

    def activation(self, conditions: Sequence[Scalar], before: Sequence[Scalar], at: Place | None) -> ca.SX:
        symbol = self._symbol("when", len(self.activations))
        self.activations.append(
            _Activation(
                symbol,
                [v.symbolic(condition) for condition in conditions],
                [v.symbolic(one) for one in before],
                "when",
                at,
            )
        )
        return symbol

    def _symbol(self, what: str, number: int) -> ca.SX:
        name = f"{what}#{number}"
        self.still.add(name)
        return ca.SX.sym(name)

    def _keeps(self, value: ca.SX) -> bool:
        return all(
            symbol.name() in self.still or self._is_parameter(symbol.name()) for symbol in ca.symvar(value)
        )

    def _is_parameter(self, name: str) -> bool:
        return name in self.parameters

    def complete(self) -> None:
        """Everything that pre() asks for has a value, and with it its relations."""
        done: set[str] = set()
        while new := set(self.before) - done:
            for name in sorted(new):
                self.scope.lookup(name)
            done |= new

    # Variables that events assign ---------------------------------------------------------------------------

    def remember(self, variable: s.FlatVariable) -> None:
        """A Boolean or Integer variable that keeps its value between events."""
        names = element_names(variable.name, variable.dimensions)
        value = symbols(names, variable.dimensions)
        self.scope.values[variable.name] = value
        for name, symbol in zip(names, v.elements(value), strict=True):
            self.memory[name] = (v.symbolic(symbol), variable)
            self.still.add(name)

    def hold(self, names: Iterable[str]) -> None:
        """Real variables that keep their values between events."""
        self.still |= set(names)

    def update(self, name: str, value: Value) -> None:
        """The value that events give to a variable, all its elements."""
        names = element_names(name, self.scope.declared_shape(name) or ())
        for one, element in zip(names, v.elements(value), strict=True):
            self.updates[one] = v.symbolic(element)

    # When-equations -----------------------------------------------------------------------------------------

    def read(self, whens: Iterable[s.When], evaluator: Evaluator) -> None:
        for when in whens:
            earlier: list[ca.SX] = []
            for condition, body in when.branches:
                evaluator.at = when.span
                conditions = v.elements(evaluator.value(condition))
                place = evaluator.locate(when.span)
                active = self.activation(conditions, earlier, place)
                self.activations[-1].text = f"when {text(condition)}"
                earlier.append(active)
                with evaluator.at_events():
                    self._body(body, active, evaluator)

    def _body(self, body: Iterable[s.Statement], active: ca.SX, evaluator: Evaluator) -> None:
        for statement in body:
            evaluator.at = statement.span or evaluator.at
            match statement:
                case s.Assign(target, value):
                    self._assign(target.name, evaluator.value(value), active)
                case s.AssignCall(targets, call):
                    for target_or_none, made in zip(targets, evaluator.results(call), strict=False):
                        if target_or_none is not None:
                            self._assign(target_or_none.name, made, active)
                case s.Reinit(target, value):
                    self.restarts.append((target, active, v.symbolic(evaluator.scalar(value))))
                case s.If(branches, otherwise):
                    self._choice(branches, otherwise, active, evaluator)
                case s.Assert():
                    continue
                case s.Refused(what):
                    raise refusal(what, evaluator.locate(statement.span))

    def _choice(
        self,
        branches: Sequence[tuple[s.Node, tuple[s.Statement, ...]]],
        otherwise: Sequence[s.Statement],
        active: ca.SX,
        evaluator: Evaluator,
    ) -> None:
        left = active
        for condition, body in branches:
            holds = v.symbolic(evaluator.scalar(condition))
            self._body(body, ca.logic_and(left, holds), evaluator)
            left = ca.logic_and(left, ca.logic_not(holds))
        self._body(otherwise, left, evaluator)

    def _assign(self, name: str, value: Value, active: ca.SX) -> None:
        shape = self.scope.declared_shape(name)
        base = name if shape is not None else whole_name(name)
        names = [name] if shape is None else element_names(name, shape)
        before = dict(
            zip(
                element_names(base, self.scope.declared_shape(base) or ()),
                v.elements(self.pre(base)),  # type: ignore[arg-type]
                strict=True,
            )
        )
        values = v.elements(value)
        for i, one in enumerate(names):
            otherwise = self.updates.get(one, before[one])
            new = v.symbolic(values[i if len(values) > 1 else 0])
            self.updates[one] = ca.if_else(active, new, v.symbolic(otherwise))


# The finished value -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Kept:
    """What keeps its value between events: parameters in the order of `symbols`."""

    parameters: tuple[Parameter, ...]
    symbols: ca.SX
    slots: dict[str, int]


def kept(recorder: Recorder, starts: dict[str, float], first: int) -> Kept:
    """The parameters of a model behind its own `first` ones; `starts` are start values by name."""
    entries: list[tuple[ca.SX, float, str]] = [
        (symbol, starts.get(name, 0.0), f"{variable.description or 'value'} between events")
        for name, (symbol, variable) in recorder.memory.items()
    ]
    for value in recorder.before.values():
        for symbol in v.elements(value):
            name = v.symbolic(symbol).name()
            inner = name.removeprefix("pre(").removesuffix(")")
            entries.append((v.symbolic(symbol), starts.get(inner, 0.0), "value before the event"))
    entries += [(one.symbol, 0.0, one.text) for one in recorder.relations.values()]
    entries += [(one.symbol, 0.0, one.text) for one in recorder.wholes.values()]
    if recorder.start is not None:
        entries.append((recorder.start, 0.0, "1 while the start is computed"))
    parameters = tuple(
        Parameter(symbol.name(), value, description=what, is_memory=True) for symbol, value, what in entries
    )
    columns = column([symbol for symbol, _, _ in entries])
    slots = {symbol.name(): first + i for i, (symbol, _, _) in enumerate(entries)}
    return Kept(parameters, columns, slots)


def finished(
    recorder: Recorder, slots: dict[str, int], unknowns: dict[str, int], starts: dict[str, ca.SX]
) -> Events:
    """The events of the model. `unknowns`: positions of the unknowns by name; `starts`: values that initial
    equations and algorithms give to what is remembered, by name."""
    relations, wholes = list(recorder.relations.values()), list(recorder.wholes.values())
    numbers = {one.symbol.name(): i for i, one in enumerate(recorder.activations)}
    conditions: list[ca.SX] = []
    activations = []
    for one in recorder.activations:
        first = len(conditions)
        conditions += one.conditions
        before = tuple(numbers[symbol.name()] for symbol in one.before)
        activations.append(Activation(first, len(conditions), before, one.text, one.place))
    memories = [
        (v.symbolic(symbol).name(), value)
        for name, before in recorder.before.items()
        for symbol, value in zip(v.elements(before), _present(recorder, name), strict=True)
    ]
    given = [name for name in starts if name in slots]
    return Events(
        relations=tuple(Relation(one.text, slots[one.symbol.name()], one.is_strict) for one in relations),
        whole_parts=tuple(WholePart(one.text, slots[one.symbol.name()]) for one in wholes),
        activations=tuple(activations),
        assignments=tuple(
            Assignment(name, slots.get(name, -1), unknowns.get(name, -1)) for name in recorder.updates
        ),
        memories=tuple(Memory(name, slots[name]) for name, _ in memories),
        restarts=tuple(_restart(target, unknowns) for target, _, _ in recorder.restarts),
        initial_slot=-1 if recorder.start is None else slots[recorder.start.name()],
        start_slots=tuple(slots[name] for name in given),
        active=column([one.symbol for one in recorder.activations]),
        ticks=column([symbol for symbol, _, _ in recorder.ticks]),
        values=column([one.value for one in relations]),
        wholes=column([one.value for one in wholes]),
        conditions=column(conditions),
        assigned=column(list(recorder.updates.values())),
        sources=column([value for _, value in memories]),
        restarted=_table([(active, value) for _, active, value in recorder.restarts]),
        samples=_table([(start, interval) for _, start, interval in recorder.ticks]),
        starts=column([starts[name] for name in given]),
    )


def _present(recorder: Recorder, name: str) -> list[ca.SX]:
    value = recorder.scope.lookup(name)
    assert value is not None
    return [v.symbolic(element) for element in v.elements(value)]


def _restart(target: s.Name, unknowns: dict[str, int]) -> Restart:
    name = text(target)
    if name not in unknowns:
        raise ModelError(
            "model-unsupported",
            f"reinit({name}, …) restarts what is no variable of the model",
            remedy="Name a variable that is differentiated.",
        )
    return Restart(name, unknowns[name])


def _table(rows: Sequence[tuple[ca.SX, ca.SX]]) -> ca.SX:
    return ca.vertcat(*[ca.horzcat(a, b) for a, b in rows]) if rows else ca.SX(0, 2)
