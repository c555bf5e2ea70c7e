"""Names of a flat model and their values: the scope in which its equations are read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.modelica.language import values as v
from daest.modelica.language.expressions import PathPart, indexed, split_path
from daest.modelica.language.syntax import FlatVariable
from daest.modelica.language.values import Record, Scalar, Value


@dataclass(frozen=True)
class Element:
    """One scalar of a variable: its name, its position in the flattened array, its symbol."""

    name: str
    position: int
    variable: FlatVariable
    symbol: ca.SX


Path = Sequence[PathPart]

# A component tree: identifier -> indices of a component array ((): no array) -> subtree, or the full name of
# a leaf.
Tree = dict[str, dict[tuple[int, ...], Any]]


@dataclass
class ModelScope:
    """`values` holds what has a value; `pending` makes the value of a name on first use (a parameter's
    binding, a Boolean's defining equation); `derivatives` holds der() of the unknowns; `names` are all flat
    names."""

    names: tuple[str, ...]
    values: dict[str, Value] = field(default_factory=dict)
    derivatives: dict[str, Value] = field(default_factory=dict)
    pending: dict[str, Callable[[], Value]] = field(default_factory=dict)
    constant_names: frozenset[str] = frozenset()  # parameters and constants: their derivative is zero
    shapes: dict[str, tuple[int, ...]] = field(default_factory=dict)  # declared sizes of all variables
    _rates: dict[str, ca.SX | float] = field(default_factory=dict)  # der() by the name of the symbol
    _running: list[str] = field(default_factory=list)
    _tree: Tree | None = None

    def lookup(self, name: str) -> Value | None:
        if name in self.values:
            return self.values[name]
        if name in self.pending:
            return self._made(name)
        return None

    def _made(self, name: str) -> Value:
        """The value of a pending name. Raises ModelError when it is defined by itself."""
        if name in self._running:
            circle = " -> ".join([*self._running[self._running.index(name) :], name])
            raise ModelError(
                "model-circular",
                f"`{name}` is computed from itself: {circle}",
                remedy="Give one of them a value of its own.",
            )
        self._running.append(name)
        try:
            made = self.pending[name]()
        finally:
            self._running.pop()
        self.values[name] = made
        del self.pending[name]
        return made

    def element(self, name: str, subscripts: Sequence[Value | None]) -> Value | None:
        return None

    def path(self, parts: Path) -> Value | None:
        if self._tree is None:
            self._tree = component_tree(self.names)
        return self._resolve(self._tree, parts)

    def _resolve(self, tree: Tree, parts: Path) -> Value | None:
        (ident, subscripts), rest = parts[0], parts[1:]
        found = tree.get(ident)
        if found is None:
            return None
        if () in found:
            return self._below(found[()], subscripts, rest)
        rank = len(next(iter(found)))
        shape = tuple(max(index[i] for index in found) for i in range(rank))
        chosen = indexed(_index_array(shape), subscripts[:rank])
        if isinstance(chosen, tuple):
            return self._below(found[chosen], subscripts[rank:], rest)
        assert isinstance(chosen, np.ndarray)
        parts_below = [self._below(found[index], subscripts[rank:], rest) for index in chosen.flat]
        if any(part is None for part in parts_below):
            return None
        made = v.array(parts_below)  # type: ignore[arg-type]
        return made.reshape(chosen.shape + made.shape[1:])

    def _below(self, node: Any, subscripts: Sequence[Value | None], rest: Path) -> Value | None:
        if isinstance(node, str):
            value = self.lookup(node)
            return None if value is None or rest else indexed(value, subscripts)
        if subscripts:
            return None
        return self._resolve(node, rest) if rest else self._record(node)

    def _record(self, tree: Tree) -> Value | None:
        fields: dict[str, Value] = {}
        for ident in tree:
            value = self._resolve(tree, [(ident, ())])
            if value is None:
                return None
            fields[ident] = value
        return Record(fields)

    def derivative(self, name: str) -> Value | None:
        if name in self.derivatives:
            return self.derivatives[name]
        if name == "time":
            return 1.0
        value = self.lookup(name)
        if value is None:
            return None
        if name in self.constant_names:
            return v.mapped(lambda _: 0.0, value)
        raise ModelError(
            "model-der-input",
            f"der({name}) differentiates an input or a discrete variable",
            remedy=f"Introduce a variable x = {name} and write der(x).",
        )

    def rate(self, symbol: str) -> Scalar | None:
        if not self._rates:
            self._rates = self._all_rates()
        return self._rates.get(symbol)

    def _all_rates(self) -> dict[str, ca.SX | float]:
        found: dict[str, ca.SX | float] = {"time": 1.0}
        for name in self.constant_names:
            value = self.lookup(name)
            for element in v.elements(value) if value is not None else ():
                if isinstance(element, ca.SX):
                    found.update((symbol.name(), 0.0) for symbol in ca.symvar(element))
        for name, rates in self.derivatives.items():
            pairs = zip(v.elements(self.values[name]), v.elements(rates), strict=True)
            found.update((value.name(), rate) for value, rate in pairs)  # type: ignore[union-attr, misc]
        return found

    def declared_shape(self, name: str) -> tuple[int, ...] | None:
        return self.shapes.get(name)


def component_tree(names: Iterable[str]) -> Tree:
    """The tree of all flat names, e.g. `a[1].x` -> {"a": {(1,): {"x": {(): "a[1].x"}}}}."""
    tree: Tree = {}
    for name in names:
        node = tree
        parts = split_path(name)
        for ident, indices in parts[:-1]:
            node = node.setdefault(ident, {}).setdefault(tuple(indices), {})
        ident, indices = parts[-1]
        node.setdefault(ident, {})[tuple(indices)] = name
    return tree


def _index_array(shape: tuple[int, ...]) -> np.ndarray:
    """An array whose element at (i, j) is the tuple of its Modelica indices (i+1, j+1)."""
    made = np.empty(shape, dtype=object)
    for position in np.ndindex(*shape):
        made[position] = tuple(i + 1 for i in position)
    return made


def element_names(name: str, shape: Sequence[int]) -> list[str]:
    """`x` of size [2] -> x[1], x[2]; a scalar has its own name."""
    if not shape:
        return [name]
    return [f"{name}[{','.join(str(i + 1) for i in at)}]" for at in np.ndindex(*shape)]


def symbols(names: Sequence[str], shape: Sequence[int]) -> Value:
    """One SX symbol per name: a scalar for the shape (), else an array."""
    made = [ca.SX.sym(name) for name in names]
    return v.from_flat(made, tuple(shape)) if shape else made[0]
