"""Modelica functions by symbolic execution: an algorithm section run on numbers and SX expressions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from daest.errors import ModelError, Place
from daest.modelica.flat import tables
from daest.modelica.language import syntax as s
from daest.modelica.language import values as v
from daest.modelica.language.expressions import Evaluator, PathPart, field_of, indexed, refusal
from daest.modelica.language.operators import BUILTINS, integer
from daest.modelica.language.table_files import Folders, TableFileError
from daest.modelica.language.text import text
from daest.modelica.language.values import Record, Value

# A function that calls itself deeper, or loops longer, is taken not to end.
MAX_RECURSION = 60
MAX_ITERATIONS = 100_000

Frame = dict[str, Value | None]

# Types whose sizes are known: a type of another name may be one of arrays.
_SCALARS = ("Real", "Integer", "Boolean", "String")


class _Unassigned:
    """Stands in an array for an element without a value."""


_UNASSIGNED = _Unassigned()


@dataclass
class FunctionLibrary:
    """The functions of one model; calling it runs one. `constants` are names that functions may read, `paths`
    component paths, `folders` those of files with tables."""

    functions: Mapping[str, s.Function]
    locate: Callable[[s.Span | None], Place | None]
    constants: Callable[[str], Value | None]
    paths: Callable[[Sequence[PathPart]], Value | None]
    folders: Folders = field(default_factory=Folders)
    depth: int = field(default=0)

    def __call__(
        self, name: str, arguments: Sequence[Value], constructor: bool, evaluator: Evaluator
    ) -> tuple[Value, ...]:
        """The results of function `name`. Raises ModelError naming the call where it cannot be run."""
        last = name.rpartition(".")[2]
        if tables.is_table(name):
            return self._table(name, arguments, evaluator)
        if name.startswith(_STRINGS) and last in _OF_STRINGS:
            return (_OF_STRINGS[last](*arguments),)
        function = self.functions.get(name) or self._by_last_part(last)
        if function is None or function.is_external:
            if last in BUILTINS:
                return (BUILTINS[last](arguments),)
            raise _not_executable(name, function, evaluator)
        if constructor or not function.outputs:
            return (_record(function, arguments),)
        if self.depth >= MAX_RECURSION:
            raise evaluator.error(
                "model-function",
                f"function `{name}` calls itself more than {MAX_RECURSION} times",
                None,
                "Write it with a for-loop, or make the recursion end on a constant condition.",
            )
        shape = _elementwise(function, arguments)
        if shape is not None and all(one.type_name in _SCALARS for one in function.inputs):
            return self._for_each_element(function, arguments, shape, evaluator)
        self.depth += 1
        try:
            return _Run(self, function, evaluator).results(arguments)
        except ModelError:
            if shape is None:
                raise
        finally:
            self.depth -= 1
        return self._for_each_element(function, arguments, shape, evaluator)

    def _table(self, name: str, arguments: Sequence[Value], evaluator: Evaluator) -> tuple[Value, ...]:
        try:
            return tables.results(name, arguments, self.folders)
        except TableFileError as problem:
            raise evaluator.error("model-table-file", str(problem), None, problem.remedy) from None
        except ValueError as problem:
            raise evaluator.error("model-function", str(problem), None, _TABLE_REMEDY) from None

    def _for_each_element(
        self, function: s.Function, arguments: Sequence[Value], shape: tuple[int, ...], evaluator: Evaluator
    ) -> tuple[Value, ...]:
        """A function of scalars called with arrays of one size (Language Specification 12.4.6)."""
        calls = []
        for at in np.ndindex(*shape):
            scalars = [
                x[at] if isinstance(x, np.ndarray) and not one.shape else x
                for one, x in zip(function.inputs, arguments, strict=False)
            ]
            calls.append(self(function.name, scalars, False, evaluator))
        return tuple(v.from_flat(results, shape) for results in zip(*calls, strict=True))

    def _by_last_part(self, last: str) -> s.Function | None:
        """The only function whose name ends so: source text names a function relative to where it stands."""
        found = [function for name, function in self.functions.items() if name.rpartition(".")[2] == last]
        return found[0] if len(found) == 1 else None


def _elementwise(function: s.Function, arguments: Sequence[Value]) -> tuple[int, ...] | None:
    """The one size of all arrays that stand where the function takes a scalar; None if there are none, or
    several sizes."""
    arrays = [
        x.shape
        for one, x in zip(function.inputs, arguments, strict=False)
        if isinstance(x, np.ndarray) and not one.shape
    ]
    return arrays[0] if arrays and len(set(arrays)) == 1 else None


def run_algorithm(
    algorithm: s.FlatAlgorithm,
    shapes: Mapping[str, tuple[int, ...]],
    evaluator: Evaluator,
    library: FunctionLibrary,
    kept: frozenset[str] = frozenset(),
) -> dict[str, Value]:
    """The values that an algorithm section of a model gives to the variables that it assigns; `shapes` are
    their sizes; those of `kept` begin with their values before the event. Raises ModelError where one is not
    assigned on every way through."""
    name = algorithm.origin or "the model"
    run = _Run(library, s.Function(name, (), (), (), algorithm.body, False), evaluator)
    run.evaluator.events, run.evaluator.is_live = evaluator.events, evaluator.is_live
    targets = list(dict.fromkeys(whole_name(target) for target in assigned(algorithm.body)))
    for target in targets:
        if target in kept and evaluator.events is not None:
            run.frame[target] = evaluator.events.pre(target)
        else:
            run.declare(target, shapes.get(target, ()))
    run.block(algorithm.body)
    return {target: run.result(target) for target in targets}


def whole_name(name: str) -> str:
    """`a[1].x` of `a[1].x[2]`: the variable of which an element is assigned."""
    return name.rpartition("[")[0] if name.endswith("]") else name


def assigned(body: Sequence[s.Statement]) -> list[str]:
    """Names that statements assign, in order."""
    found: list[str] = []
    for statement in body:
        match statement:
            case s.Assign(target):
                found.append(target.name)
            case s.AssignCall(targets):
                found += [target.name for target in targets if target is not None]
            case s.For(_, inner) | s.While(_, inner):
                found += assigned(inner)
            case s.If(branches, otherwise):
                found += [name for _, inner in branches for name in assigned(inner)] + assigned(otherwise)
            case s.When(branches):
                found += [name for _, inner in branches for name in assigned(inner)]
    return list(dict.fromkeys(found))


# The Modelica Standard Library reads its tables in C; its friction elements are made of such tables.
_TABLE_REMEDY = (
    "It reads a table: describe the curve by a formula (friction by Daest.Effects.Rotational.CoulombFriction "
    "or StribeckFriction, also for Translational), let a table over time be an input that a recording gives, "
    "or, with OpenModelica installed, make an FMU by `daest export MODEL --compiler omc`."
)


def _not_executable(name: str, function: s.Function | None, evaluator: Evaluator) -> ModelError:
    if function is None:
        what = f"function `{name}` is not known"
    else:
        what = f"function `{name}` is external (written in C or Fortran)"
    remedy = "Write the function in Modelica, or replace the call by its formula."
    if "ExternalCombiT" in name:
        remedy = _TABLE_REMEDY
    return evaluator.error("model-function", what, None, remedy)


_STRINGS = "Modelica.Utilities.Strings."


def _find(
    text: Value, wanted: Value, start: Value, is_case_sensitive: Value = True, last: bool = False
) -> Value:
    """Where `wanted` begins in the text, from 1 on, 0 if nowhere; `start` is where the search begins, 0 the
    end of the text for the last one."""
    whole, part = str(text), str(wanted)
    if not is_case_sensitive:
        whole, part = whole.lower(), part.lower()
    at = int(start)  # type: ignore[arg-type]
    found = (
        whole.rfind(part, 0, at - 1 + len(part) if at else None) if last else whole.find(part, max(at - 1, 0))
    )
    return found + 1


# Functions of Modelica.Utilities.Strings, which the library writes in C or by loops over letters.
_OF_STRINGS: dict[str, Callable[..., Value]] = {
    "length": lambda text: len(str(text)),
    "isEmpty": lambda text: not str(text).strip(),
    "find": lambda text, wanted, start=1, exact=True: _find(text, wanted, start, exact),
    "findLast": lambda text, wanted, start=0, exact=True: _find(text, wanted, start, exact, True),
}


def _record(function: s.Function, arguments: Sequence[Value]) -> Record:
    names = [variable.name for variable in function.inputs]
    return Record(dict(zip(names, arguments, strict=False)))


class _Run:
    """One execution of a function: its frame, and an evaluator whose scope is that frame."""

    def __init__(self, library: FunctionLibrary, function: s.Function, caller: Evaluator) -> None:
        self.library = library
        self.function = function
        self.frame: Frame = {}
        self.evaluator = Evaluator(self, library, library.locate, {}, caller.at, guard=caller.guard)
        self.jump: str | None = None

    # Scope --------------------------------------------------------------------------------------------------

    def lookup(self, name: str) -> Value | None:
        if name not in self.frame:
            # The compiler splits a record argument `r` into one argument per field, `r_a` for `r.a`.
            split = name.replace(".", "_")
            if split not in self.frame:
                return self.library.constants(name)
            name = split
        return self._complete(name, self.frame[name])

    def element(self, name: str, subscripts: Sequence[Value | None]) -> Value | None:
        base = self.frame.get(name)
        return None if base is None else self._complete(name, indexed(base, subscripts))

    def _complete(self, name: str, value: Value | None) -> Value:
        if value is None or value is _UNASSIGNED or _has_gaps(value):
            raise self._error(f"`{name}` is used before it has a value", None)
        return value

    def path(self, parts: Sequence[tuple[str, tuple[Value | None, ...]]]) -> Value | None:
        """A field of a local record, or an element of it."""
        value = self.frame.get(parts[0][0])
        if value is None:
            return self.library.paths(parts)
        found: Value | None = indexed(value, parts[0][1])
        for name, subscripts in parts[1:]:
            found = None if found is None else field_of(found, name)
            found = None if found is None else indexed(found, subscripts)
        return found

    def derivative(self, name: str) -> Value | None:
        return None

    def rate(self, symbol: str) -> v.Scalar | None:
        return None

    def declared_shape(self, name: str) -> tuple[int, ...] | None:
        return None

    # Execution ----------------------------------------------------------------------------------------------

    def results(self, arguments: Sequence[Value]) -> tuple[Value, ...]:
        for i, variable in enumerate(self.function.inputs):
            if i < len(arguments):
                self.frame[variable.name] = arguments[i]
            else:
                self._declare(variable)
        for variable in (*self.function.outputs, *self.function.locals):
            self._declare(variable)
        self.block(self.function.body)
        return tuple(self.result(variable.name) for variable in self.function.outputs)

    def result(self, name: str) -> Value:
        value = self.lookup(name)
        assert value is not None
        return value

    def _declare(self, variable: s.FunctionVariable) -> None:
        if variable.default is not None:
            self.frame[variable.name] = self.evaluator.value(variable.default)
        elif variable.shape and not any(isinstance(size, s.Colon) for size in variable.shape):
            self.declare(variable.name, tuple(integer(self.evaluator.value(size)) for size in variable.shape))
        else:
            self.frame[variable.name] = None

    def declare(self, name: str, shape: tuple[int, ...]) -> None:
        """A variable without a value."""
        if not shape:
            self.frame[name] = None
            return
        made = np.empty(shape, dtype=object)
        made.fill(_UNASSIGNED)
        self.frame[name] = made

    def block(self, statements: Sequence[s.Statement]) -> None:
        for statement in statements:
            self.evaluator.at = statement.span or self.evaluator.at
            self._statement(statement)
            if self.jump is not None:
                return

    def _statement(self, statement: s.Statement) -> None:
        match statement:
            case s.Assign(target, value):
                self._assign(target, self.evaluator.value(value))
            case s.AssignCall(targets, call):
                for target_or_none, made in zip(targets, self.evaluator.results(call), strict=False):
                    if target_or_none is not None:
                        self._assign(target_or_none, made)
            case s.For(iterators, body):
                self._for(iterators, body)
            case s.While(condition, body):
                self._while(condition, body)
            case s.If(branches, otherwise):
                self._if(branches, otherwise)
            case s.Jump(kind):
                self.jump = kind
            case s.Assert():
                return
            case s.When(branches):
                self._when(branches, statement.span)
            case s.Reinit():
                raise refusal("reinit in an algorithm", self.library.locate(statement.span))
            case s.Refused(what):
                raise refusal(what, self.library.locate(statement.span))

    def _when(
        self, branches: tuple[tuple[s.Node, tuple[s.Statement, ...]], ...], span: s.Span | None
    ) -> None:
        """The branches as choices by whether they are active, a symbol each."""
        events, place = self.evaluator.events, self.library.locate(span)
        if events is None:
            raise refusal("when", place)
        active: list[ca.SX] = []
        for condition, _ in branches:
            conditions = v.elements(self.evaluator.value(condition))
            active.append(events.activation(conditions, active, place))
        before = dict(self.frame)
        after = before
        for symbol, (_, body) in zip(reversed(active), reversed(branches), strict=True):
            self.frame = dict(before)
            with self.evaluator.at_events():
                self.block(body)
            after = _merged(symbol, self.frame, after)
        self.frame = after

    def _assign(self, target: s.Name, value: Value) -> None:
        head, dot, field = target.name.rpartition(".")
        if dot and isinstance(self.frame.get(head, ""), Record | None):
            before = self.frame[head]
            fields = before.fields if isinstance(before, Record) else {}
            self.frame[head] = Record({**fields, field: self._with_element(fields.get(field), target, value)})
            return
        if target.name not in self.frame:
            raise self._error(f"`{text(target)}` cannot be assigned", target)
        self.frame[target.name] = self._with_element(self.frame[target.name], target, value)

    def _with_element(self, base: Value | None, target: s.Name, value: Value) -> Value:
        """`base` with what an assignment to the target makes of it."""
        if not target.subscripts:
            return value
        if not isinstance(base, np.ndarray):
            raise self._error(f"`{text(target)}` cannot be assigned", target)
        subscripts = [
            list(range(base.shape[i]))
            if isinstance(node, s.Colon)
            else _positions(self.evaluator.value(node))
            for i, node in enumerate(target.subscripts)
        ]
        made = base.copy()
        _store(made, subscripts, value)
        return made

    def _for(self, iterators: tuple[tuple[str, s.Node], ...], body: Sequence[s.Statement]) -> None:
        if not iterators:
            self.block(body)
            return
        name, over = iterators[0]
        for value in self.evaluator.sequence(over):
            with self.evaluator.bound([name], [value]):
                self._for(iterators[1:], body)
            if self.jump is not None:
                self.jump = None if self.jump == "break" else self.jump
                return

    def _while(self, condition: s.Node, body: Sequence[s.Statement]) -> None:
        for _ in range(MAX_ITERATIONS):
            going = v.constant(self.evaluator.scalar(condition))
            if isinstance(going, ca.SX):
                raise self._error(f"`while {text(condition)}` depends on variables or parameters", condition)
            if not going:
                return
            self.block(body)
            if self.jump is not None:
                self.jump = None if self.jump == "break" else self.jump
                return
        raise self._error(f"`while {text(condition)}` does not end in {MAX_ITERATIONS} rounds", condition)

    def _if(
        self, branches: tuple[tuple[s.Node, tuple[s.Statement, ...]], ...], otherwise: Sequence[s.Statement]
    ) -> None:
        if not branches:
            self.block(otherwise)
            return
        (condition_node, body), rest = branches[0], branches[1:]
        condition = v.constant(self.evaluator.scalar(condition_node))
        if not isinstance(condition, ca.SX):
            if condition:
                self.block(body)
            else:
                self._if(rest, otherwise)
            return
        before = dict(self.frame)
        with self.evaluator.guarded(condition):
            self.block(body)
        yes, self.frame = self.frame, before
        with self.evaluator.guarded(ca.logic_not(condition)):
            self._if(rest, otherwise)
        if self.jump is not None:
            raise self._error(f"`{self.jump}` depends on `{text(condition_node)}`", condition_node)
        self.frame = _merged(condition, yes, self.frame)

    def _error(self, what: str, node: s.Node | None) -> ModelError:
        return self.evaluator.error(
            "model-function",
            f"`{self.function.name}` cannot be executed: {what}",
            node,
            "Give every variable a value first; let loops, `return` and `break` depend on constants only.",
        )


def _has_gaps(value: Value) -> bool:
    return isinstance(value, np.ndarray) and any(e is _UNASSIGNED for e in value.flat)


def _positions(value: Value) -> list[int] | int:
    if isinstance(value, np.ndarray):
        return [integer(one) - 1 for one in value]
    return integer(value) - 1


def _store(target: np.ndarray, positions: Sequence[list[int] | int], value: Value) -> None:
    """target[positions] := value. Raises ShapeError outside of the array or when sizes differ."""
    for chosen, size in zip(positions, target.shape, strict=False):
        if any(not 0 <= at < size for at in (chosen if isinstance(chosen, list) else [chosen])):
            raise v.ShapeError(f"an index is outside of an array of size {v.size_text(target.shape)}")
    where = np.ix_(*[[p] if isinstance(p, int) else p for p in positions])
    if isinstance(value, np.ndarray):
        target[where] = value.reshape(target[where].shape)
    else:
        target[where] = v.filled(value, target[where].shape)  # type: ignore[arg-type]


def _merged(condition: ca.SX, yes: Frame, no: Frame) -> Frame:
    return {name: _merged_value(condition, yes[name], no[name]) for name in no}


def _merged_value(condition: ca.SX, yes: Value | None, no: Value | None) -> Value | None:
    """The value after an `if`; a variable that only one branch assigns has no meaning otherwise and keeps
    it."""
    if yes is no or no is None:
        return yes
    if yes is None:
        return no
    if isinstance(yes, np.ndarray) and isinstance(no, np.ndarray) and yes.shape == no.shape:
        pairs = zip(yes.flat, no.flat, strict=True)
        return v.from_flat((_merged_element(condition, a, b) for a, b in pairs), yes.shape)
    if isinstance(yes, Record) and isinstance(no, Record):
        names = dict.fromkeys((*no.fields, *yes.fields))
        merged = {name: _merged_value(condition, yes.fields.get(name), no.fields.get(name)) for name in names}
        return Record({name: value for name, value in merged.items() if value is not None})
    return v.choose(condition, yes, no)


def _merged_element(condition: ca.SX, yes: v.Scalar, no: v.Scalar) -> v.Scalar:
    if yes is no or no is _UNASSIGNED:
        return yes
    return no if yes is _UNASSIGNED else v.either(condition, yes, no)
