"""Signals inside of a model that may be bent, cut or late on their way: what a block hands to others through
connections, such as the output of a controller, and variables that bare equations give, such as the force of
a tyre over its slip angle, `F = c*(delta - beta - l*r/v)`.

Not those where an effect would be none of its own: what follows from one input alone is that input, what goes
to an output alone is that output, and what one law takes into another signal is that one. Nor flows and
potentials of a physical domain that has places, whose own effects tell what is missing there; but what is
made of an input and the motion together is the work of a controller, whatever its unit.

Three kinds are places of limits alone: a current that an equation gives, as in `i = (u - k*w)/R`, where
voltages in its path say all but what an amplifier does that lets no more through; and the rate at which
what an input asks for is reached, `rate = (command - angle)/T` of a rudder whose pump gives no more. A third
is what an actuator comes to with its time constant, `T*der(gate) = command - gate`, where no place of a
domain is: a gate opens no further than it can."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.model.effects import Domain
from daest.model.flat import FlatModel
from daest.modelica.flat.delays import is_memory_of_delay
from daest.modelica.flat.factors import are_same, is_of_parameters
from daest.modelica.places.balances import balances, domain_of, own_laws, slopes_near_start
from daest.modelica.places.place_units import has_unit
from daest.quantities import is_of

_UNITS: dict[str, Domain] = {
    **dict.fromkeys(("N", "m", "m/s", "m/s2"), "translational"),
    **dict.fromkeys(("N.m", "rad", "rad/s", "rad/s2"), "rotational"),
    **dict.fromkeys(("W", "K"), "thermal"),
    **dict.fromkeys(("m3/s", "Pa"), "hydraulic"),
    **dict.fromkeys(("A", "V"), "electrical"),
}  # of flows and potentials


@dataclass(frozen=True)
class InnerSignal:
    """Unknown `variable`; the rows `uses` use it, connections alone where it is the output of a block. It is
    a place of effects that limit, or of all."""

    variable: int
    uses: tuple[int, ...]
    limits_only: bool = False

    def name(self, flat: FlatModel) -> str:
        return flat.unknowns[self.variable].name


def inner_signals(
    flat: FlatModel, domains: Collection[Domain], taken: Collection[str], flows: Collection[str] = ()
) -> tuple[InnerSignal, ...]:
    """The signals inside of the model, whose places of other kinds are in these `domains`; variables called
    as in `taken` are places already, but for what may be a command as well as a force, for forces of a slip,
    and for `flows` through meshes, which may have a limit."""
    laws = _Laws(flat)
    taken = {*taken} - laws.commands() - laws.slips() - {*flows} | {*flat.output_names}
    blocks, own = _outputs_of_blocks(flat), {*own_laws(flat)}
    found: list[InnerSignal] = []
    for variable, row in (*laws.given.items(), *laws.integrated.items()):
        name = flat.unknowns[variable].name
        is_block = name in blocks
        is_law = row in own and laws.given.get(variable) == row and "." not in name
        if name in taken or not (is_block or is_law):
            continue
        rated = laws.rates.get(variable)
        if rated is not None and flat.unknowns[rated].name in taken:
            continue
        limits_only = not is_block and (name in flows or rated is not None)
        signal = InnerSignal(variable, laws.uses(variable, row, is_block), limits_only)
        if laws.is_taken_further(signal) and _is_own(flat, signal, is_block, laws, domains):
            found.append(signal)
    found += [one for one in laws.actuators(own) if _has_no_place(flat, one, taken, domains)]
    kept = {one.variable for one in found}
    return tuple(one for one in found if laws.alone_in(one) not in kept)


def is_lag(flat: FlatModel, row: int, variable: int) -> bool:
    """Whether a row is `T*der(x) = … - x` with a time T of parameters, or a plain number."""
    equation = flat.residual[row]
    own, rate = (ca.jacobian(equation, of[variable]) for of in (flat.xi, flat.derivatives))
    if not own.nnz() or not is_of_parameters(flat, ca.vertcat(own, rate)):
        return False
    is_plain = not ca.symvar(own) and not _units_in(flat, rate)
    return is_plain or has_unit(flat, rate / own, "s")


def _units_in(flat: FlatModel, expression: ca.SX) -> list[str]:
    """Units of the parameters in an expression, those that have one."""
    return [
        p.unit
        for p, symbol in zip(flat.parameters, ca.vertsplit(flat.theta), strict=True)
        if p.unit and ca.depends_on(expression, symbol)
    ]


def _outputs_of_blocks(flat: FlatModel) -> set[str]:
    """Variables of components that connections take elsewhere, and that belong to no connector with a
    flow."""
    physical = {x.name.rpartition(".")[0] for x in flat.unknowns if x.is_flow}
    connected = (e.text.split(" = ") for e in flat.equations if e.kind == "connection")
    return {end for ends in connected for end in ends if end.rpartition(".")[0] not in {"", *physical}}


def _is_own(
    flat: FlatModel, signal: InnerSignal, is_block: bool, laws: _Laws, domains: Collection[Domain]
) -> bool:
    """Whether an effect at the signal would do what none does at another place."""
    inputs, states = laws.sources(signal.variable)
    if not states and len(inputs) < 2:
        return False
    if signal.limits_only:
        return bool(inputs and states)
    unit = flat.unknowns[signal.variable].unit
    is_physical = any(domain in domains and is_of(unit, one) for one, domain in _UNITS.items())
    return is_block or not is_physical or bool(inputs and states)


def _has_no_place(
    flat: FlatModel, signal: InnerSignal, taken: Collection[str], domains: Collection[Domain]
) -> bool:
    """Whether no balance of a domain is a place where the signal is."""
    return signal.name(flat) not in taken and domain_of(flat.unknowns[signal.variable].unit) not in domains


class _Laws:
    """Which equation gives which unknown, and what it is made of."""

    def __init__(self, flat: FlatModel) -> None:
        self._flat, self._n = flat, flat.xi.numel()
        self._slopes = slopes_near_start(flat)
        self._unknowns = _used(flat.residual, ca.vertcat(flat.xi, flat.derivatives))
        self._inputs = _used(flat.residual, flat.u)
        self._rows = _turned(self._unknowns)
        self._shown = set().union(*_used(flat.output_expressions, flat.xi))
        self.rates = dict(filter(None, map(_rate, self._slopes)))
        self.given = self._given()
        self.integrated = self._integrated()
        self._memory = {i for i, x in enumerate(flat.unknowns) if is_memory_of_delay(x.name)}
        self._made = {row: variable for variable, row in self.given.items()}

    def _given(self) -> dict[int, int]:
        """Unknown -> the row without derivatives that is written `unknown = …`."""
        flat, slopes = self._flat, self._slopes
        number = {v.name: i for i, v in enumerate(flat.unknowns)}
        found: dict[int, int] = {}
        for row, equation in enumerate(flat.equations):
            variable = number.get(equation.text.partition(" = ")[0])
            if variable is None or equation.kind not in ("component", "binding"):
                continue
            if abs(slopes[row, variable]) == 1.0 and not np.any(slopes[row, self._n :]):
                found.setdefault(variable, row)
        return found

    def _integrated(self) -> dict[int, int]:
        """Unknown -> the row that is written `der(unknown) = …`."""
        number = {f"der({v.name})": i for i, v in enumerate(self._flat.unknowns)}
        lefts = (equation.text.partition(" = ")[0] for equation in self._flat.equations)
        return {number[left]: row for row, left in enumerate(lefts) if left in number}

    def actuators(self, own: Collection[int]) -> list[InnerSignal]:
        """The unknowns that equations of their own bring to what they are told, with a time constant, and
        that other laws use; not where one uses the rate, too."""
        signals: list[InnerSignal] = []
        for row in sorted({*own} - self._of_delays()):
            rates = [i for i in self._unknowns[row] if i >= self._n]
            if len(rates) != 1 or len(self._rows[rates[0]]) > 1:
                continue
            is_told = len(self._unknowns[row]) + len(self._inputs[row]) > 2
            if not is_told or not is_lag(self._flat, row, rates[0] - self._n):
                continue
            signal = InnerSignal(rates[0] - self._n, self.uses(rates[0] - self._n, row, False), True)
            if self.is_taken_further(signal):
                signals.append(signal)
        return signals

    def _of_delays(self) -> set[int]:
        """The rows of the polynomials that a dead time is computed by."""
        return {row for one in self._memory for row in self._rows[self._n + one]}

    def commands(self) -> set[str]:
        """Names of the variables that a law gives which is made of an input and of the position and the speed
        of a body, but not of the speed of that input, as a spring and damper between the two would be; or of
        its speed, an input and a sum over time of both, as a controller of the speed says it (and a coupling
        to a shaft that is driven, which slips where it has a limit): they may be what a controller says."""
        bodies = [(body.variable, body.position) for body in balances(self._flat)]
        found: set[str] = set()
        for row in own_laws(self._flat):
            used, inputs = self._made_of(row)
            if not inputs or max(used, default=0) >= self._n:
                continue
            summed = self._summed(used, inputs)
            if any({*body} <= used or body[0] in summed for body in bodies):
                given = [i for i in self._unknowns[row] if abs(self._slopes[row, i]) == 1.0]
                found |= {self._flat.unknowns[i].name for i in given}
        return found

    def slips(self) -> set[str]:
        """Names of the variables that a law gives which goes with ratios of speeds alone, of bodies and of
        inputs, as the force of a tyre with its slip does in `F = c*(delta - (vy + l*r)/v)`: what such a force
        lacks goes with its slip, which no relative motion of bodies is."""
        flat = self._flat
        symbols = [*ca.vertsplit(flat.xi), *ca.vertsplit(flat.u)]
        units = [x.unit for x in (*flat.unknowns, *flat.inputs)]
        speeds = {i for i, unit in enumerate(units) if is_of(unit, "m/s") or is_of(unit, "rad/s")}
        bodies = {body.variable for body in balances(flat)}
        found: set[str] = set()
        for variable, row in self.given.items():
            used = self._unknowns[row] | {self._n + i for i in self._inputs[row]}
            if max(self._unknowns[row]) >= self._n or not bodies & speeds & used:
                continue
            own = ca.vertcat(*(symbols[i] for i in sorted(speeds & used)))
            faster = ca.substitute(flat.residual[row], own, 2.0 * own)
            if are_same(flat, flat.residual[row], faster, flat.theta_values):
                found.add(flat.unknowns[variable].name)
        return found

    def _made_of(self, row: int) -> tuple[set[int], set[int]]:
        """The unknowns and the inputs in a row, and in those without derivatives that give these unknowns."""
        used, inputs = set(self._unknowns[row]), set(self._inputs[row])
        left = [x for x in used if self.given.get(x, row) != row]
        while left:
            one = self.given[left.pop()]
            new = self._unknowns[one] - used
            used |= new
            inputs |= self._inputs[one]
            left += [x for x in new if x in self.given]
        return used, inputs

    def _summed(self, used: set[int], inputs: set[int]) -> set[int]:
        """Of the unknowns `used` in a law those of which another one is the sum over time, together with one
        of the same `inputs`."""
        rates = (self._made_of(self.integrated[x]) for x in used if x in self.integrated)
        return used & set().union(*(of for of, given in rates if given & inputs))

    def uses(self, variable: int, row: int, is_block: bool) -> tuple[int, ...]:
        """The rows that use an unknown which `row` gives: of a block those of connections."""
        rows = [i for i in self._rows[variable] if i != row]
        return tuple(i for i in rows if not is_block or self._is_connection(i))

    def _is_connection(self, row: int) -> bool:
        return self._flat.equations[row].kind == "connection"

    def is_taken_further(self, signal: InnerSignal) -> bool:
        """Whether more than an output of the model uses the signal."""
        return any(self._ends(signal, row) for row in signal.uses)

    def _ends(self, signal: InnerSignal, row: int) -> list[int]:
        """The rows of laws to which a row takes the signal: itself, or those behind a connection."""
        if not self._is_connection(row):
            return [row]
        others = self._unknowns[row] - {signal.variable}
        return [i for other in others for i in self._rows[other] if i != row]

    def alone_in(self, signal: InnerSignal) -> int | None:
        """The unknown that is made of the signal alone, in proportion, where nothing else uses it."""
        rows = [end for row in signal.uses for end in self._ends(signal, row)]
        if len(rows) != 1 or self._inputs[rows[0]] or signal.variable in self._shown:
            return None
        result = self._made.get(rows[0])
        used = self._unknowns[rows[0]] - {result}
        is_line = len(used) == 1 and ca.is_linear(self._flat.residual[rows[0]], self._flat.xi[min(used)])
        return result if is_line else None

    def sources(self, variable: int) -> tuple[set[int], set[int]]:
        """The inputs, and the unknowns that no row without derivatives gives, of which an unknown is made."""
        inputs: set[int] = set()
        states: set[int] = set()
        left, seen, passed = [variable], {variable}, set[int]()
        while left:
            one = left.pop()
            links = {row for row in self._rows.get(one, ()) if self._is_connection(row)} - passed
            rows = {self.given[one]} if one in self.given else links
            if not rows:
                states.add(one)
            for row in rows:
                passed.add(row)
                inputs |= self._inputs[row]
                states |= {used - self._n for used in self._unknowns[row] if used >= self._n}
                new = {used for used in self._unknowns[row] if used < self._n} - seen
                seen |= new
                left += sorted(new)
        return inputs, states


def _rate(slopes: np.ndarray) -> tuple[int, int] | None:
    """The unknown that a row with these `slopes` (2n,) says to be the rate of another one, and that one."""
    used, n = np.flatnonzero(slopes), slopes.size // 2
    is_rate = len(used) == 2 and used[0] < n <= used[1] and sorted(slopes[used]) == [-1, 1]
    return (int(used[0]), int(used[1]) - n) if is_rate else None


def _turned(used: Sequence[set[int]]) -> dict[int, list[int]]:
    """Symbol -> the expressions that it is in."""
    found: dict[int, list[int]] = {}
    for row, symbols in enumerate(used):
        for symbol in symbols:
            found.setdefault(symbol, []).append(row)
    return found


def _used(expressions: ca.SX, symbols: ca.SX) -> list[set[int]]:
    """Of each expression (n,), the symbols (m,) in it."""
    found: list[set[int]] = [set() for _ in range(expressions.numel())]
    for row, at in zip(*ca.jacobian_sparsity(expressions, symbols).get_triplet(), strict=True):
        found[row].add(at)
    return found
