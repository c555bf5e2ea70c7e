"""A model whose equations jump, with the jumps as events.

Relations in equations (`if s < 0 then …`) are what they are at each instant as long as that is smooth enough
for the integration, which keeps the model a smooth one for estimation. Where it is not, as in circuits of
ideal diodes, each relation becomes one that keeps its truth between events.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from daest.model.events import Events, Relation, WholePart
from daest.model.flat import FlatModel
from daest.model.parts import Parameter

LONGEST = 80  # letters of a relation that are shown


@dataclass
class _Switches:
    """Relations found so far: symbols and values; `n_before` parameters stand before them."""

    n_before: int
    symbols: list[Any] = field(default_factory=list)
    relations: list[Relation] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)
    wholes: list[Any] = field(default_factory=list)
    parts: list[WholePart] = field(default_factory=list)
    known: dict[tuple[int, ...], Any] = field(default_factory=dict)

    def relation(self, greater: Any, less: Any, *, is_strict: bool) -> Any:
        key = (greater.element_hash(), less.element_hash(), int(is_strict))
        if key not in self.known:
            shown = f"{less} {'<' if is_strict else '<='} {greater}"[:LONGEST]
            self.known[key] = self._symbol("switch")
            slot = self.n_before + len(self.symbols) - 1
            self.relations.append(Relation(shown, slot, is_strict))
            self.values.append(greater - less)
        return self.known[key]

    def whole(self, value: Any) -> Any:
        key = (value.element_hash(),)
        if key not in self.known:
            self.known[key] = self._symbol("whole part")
            self.parts.append(WholePart(f"floor({value})"[:LONGEST], self.n_before + len(self.symbols) - 1))
            self.wholes.append(value)
        return self.known[key]

    def _symbol(self, what: str) -> Any:
        self.symbols.append(ca.SX.sym(f"{what} {len(self.symbols) + 1}"))
        return self.symbols[-1]


def with_switches(flat: FlatModel) -> FlatModel | None:
    """The model with its relations, signs and whole parts as events; None where it has none, or has events
    already."""
    if flat.events is not None:
        return None
    symbols = [flat.derivatives, flat.xi, flat.u, flat.w, flat.time, flat.theta]
    parts = [flat.residual, flat.output_expressions, flat.initial_residual]
    found = _Switches(len(flat.parameters))
    replaced = _replaced(ca.Function("equations", symbols, parts), symbols, found)
    if not found.symbols:
        return None
    kept = tuple(
        Parameter(symbol.name(), 0.0, description="between events", is_memory=True)
        for symbol in found.symbols
    )
    return replace(
        flat,
        parameters=(*flat.parameters, *kept),
        theta=ca.vertcat(flat.theta, *found.symbols),
        residual=replaced[0],
        output_expressions=replaced[1],
        initial_residual=replaced[2],
        events=_events(found),
    )


def _events(found: _Switches) -> Events:
    empty, pairs = ca.SX(0, 1), ca.SX(0, 2)
    return Events(
        relations=tuple(found.relations),
        whole_parts=tuple(found.parts),
        activations=(),
        assignments=(),
        memories=(),
        restarts=(),
        initial_slot=-1,
        start_slots=(),
        active=empty,
        ticks=empty,
        values=ca.vertcat(empty, *found.values),
        wholes=ca.vertcat(empty, *found.wholes),
        conditions=empty,
        assigned=empty,
        sources=empty,
        restarted=pairs,
        samples=pairs,
        starts=empty,
    )


def _replaced(function: ca.Function, symbols: list[Any], found: _Switches) -> list[Any]:
    """The results of an SX function, written out once more with what jumps replaced. The last of its
    arguments, θ, does not move."""
    work: dict[int, tuple[Any, bool]] = {}  # value, and whether it moves
    results = [ca.SX(function.sparsity_out(i)) for i in range(function.n_out())]
    nonzeros: list[list[Any]] = [[0] * part.nnz() for part in results]
    for k in range(function.n_instructions()):
        operation, into = function.instruction_id(k), function.instruction_output(k)
        sources = function.instruction_input(k)
        if operation == ca.OP_INPUT:
            argument, entry = sources
            work[into[0]] = symbols[argument].nonzeros()[entry], argument < len(symbols) - 1
        elif operation == ca.OP_OUTPUT:
            nonzeros[into[0]][into[1]] = work[sources[0]][0]
        elif operation == ca.OP_CONST:
            work[into[0]] = ca.SX(function.instruction_constant(k)), False
        else:
            at = [work[one] for one in sources]
            moves = any(moving for _, moving in at)
            work[into[0]] = _made(operation, [ca.SX(value) for value, _ in at], moves, found), moves
    for part, entries in zip(results, nonzeros, strict=True):
        for i, entry in enumerate(entries):
            part.nz[i] = entry
    return results


def _made(operation: int, at: list[Any], moves: bool, found: _Switches) -> Any:
    if moves and operation in (ca.OP_LT, ca.OP_LE):
        return found.relation(at[1], at[0], is_strict=operation == ca.OP_LT)
    if moves and operation == ca.OP_SIGN:
        above, below = (
            found.relation(at[0], ca.SX(0), is_strict=True),
            found.relation(ca.SX(0), at[0], is_strict=True),
        )
        return above - below
    if moves and operation == ca.OP_FLOOR:
        return found.whole(at[0])
    if len(at) == 1:
        return ca.SX.unary(operation, at[0])
    return ca.SX.binary(operation, at[0], at[1])


def extended(theta: np.ndarray | None, flat: FlatModel) -> np.ndarray | None:
    """Parameter values of the model before `with_switches`, as those of `flat`. Shapes: theta (n_theta,)."""
    if theta is None:
        return None
    return np.concatenate([theta, np.zeros(len(flat.parameters) - len(theta))])
