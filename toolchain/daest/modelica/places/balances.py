"""Balances among the bare equations of a model: rows such as `m*der(v) = F - d*v`, where an effect can add a
term."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.model.effects import Domain
from daest.model.flat import FlatModel
from daest.model.parts import Variable
from daest.modelica.flat.connectors import FLOWS, LEVEL, connectors_of, outside_of_term
from daest.modelica.places.written_out import FLUX, effects_in, potential, potential_symbol, written_out
from daest.numerics.matching import maximum_matching
from daest.quantities import Conversion, conversion, converts, dimensions, is_of, parse_unit

# Unit of the variable whose rate a balance gives -> domain: momentum, heat, volume and charge. A variable in
# another unit of the same quantity is of that domain, too (`base_unit`).
DOMAINS: dict[str, Domain] = {
    "m/s": "translational",
    "rad/s": "rotational",
    "K": "thermal",
    "degC": "thermal",
    "Pa": "hydraulic",
    "V": "electrical",
}
_ANGLES = ("rad", "mrad", "deg", "turn", "rpm")  # one of them makes a rate of turning of what is once a time
_VOLUME_FLOW = {"[length]": 3.0, "[time]": -1.0}
_AREA = {"[length]": 2.0}
_MECHANICAL: tuple[Domain, ...] = ("translational", "rotational")
# What has a place of its own in a domain, or follows from one: positions, rates, flows, and what drives them.
_NO_AMOUNTS = ("m", "m/s2", "N", "N.m", "W", "m3/s", "kg/s", "A", "Wb", "1/s")
_DIFFERENCE = 200.0  # K: beyond what any sensor is off, so that a temperature is one above a reference
_SEED = 20040101


@dataclass(frozen=True)
class Balance:
    """Row `row` balances what drives the rate of unknown `variable`; `sign` is +1 where the rate stands on
    the left with a positive factor. `position` is the unknown whose derivative the variable is, -1 if there
    is none; `rate` is where the rate stands among the unknowns and, behind them, their derivatives.

    Where the rate is that of what is stored, as in `der(Q) = i` with `Q = C*v`, the variable is the potential
    that row `law` gives, and `store` the unknown that is stored; both are -1 else. Where that potential is
    written out, as p/m in `der(p) = F - d*p/m`, the variable is what is stored itself, and `per` the number
    of the parameter that it is divided by, -1 else."""

    row: int
    variable: int
    sign: float
    position: int
    rate: int
    store: int = -1
    law: int = -1
    per: int = -1

    def name(self, flat: FlatModel) -> str:
        return f"{self.row}:{self.potential(flat).name}"

    def potential(self, flat: FlatModel) -> Variable:
        """The variable, or what it is divided by `per`, under the name of an expression."""
        return potential(flat, self.variable, self.per)

    def symbol(self, flat: FlatModel) -> ca.SX:
        """The expression of `potential`."""
        return potential_symbol(flat, self.variable, self.per)

    def domain(self, flat: FlatModel) -> Domain | None:
        """The domain by the unit of the variable; None for a unit that does not tell."""
        if self.is_level(flat):
            return "hydraulic"
        return domain_of(self.potential(flat).unit)

    def is_amount(self, flat: FlatModel) -> bool:
        """Whether the variable is an amount or a concentration of something that belongs to no domain, as its
        unit tells: mg, mol/l, ppm. What has none may be one as well as a position of a valve, which follows
        what it is told (`_follows`)."""
        unit = self.potential(flat).unit
        if not unit or self.domain(flat) is not None or any(is_of(unit, one) for one in _NO_AMOUNTS):
            return False
        return bool(dimensions(unit) != {}) or (unit not in _ANGLES and not self._follows(flat))

    def _follows(self, flat: FlatModel) -> bool:
        """Whether the equation is `T*der(x) = u - x`, with a time of its own: nothing is stored there."""
        row = flat.residual[self.row]
        others = ca.vertcat(flat.xi, flat.u)
        own, rate = ca.jacobian(row, flat.xi[self.variable]), ca.vertcat(flat.xi, flat.derivatives)[self.rate]
        slopes = ca.jacobian(row, others)
        told = [ca.simplify(slopes[k] + own) for k in range(others.numel()) if k != self.variable]
        is_timed = any(not ca.symvar(one) for one in (own, ca.jacobian(row, rate)))
        return is_timed and bool(own.nnz()) and any(one.is_zero() for one in told)

    def is_level(self, flat: FlatModel) -> bool:
        """Whether the variable is the level of a liquid: a length beside a volume flow or an area."""
        if not is_length(self.potential(flat).unit):
            return False
        if self.per >= 0:
            return True
        units = [x.unit for part in (flat.unknowns, flat.inputs, flat.parameters) for x in part]
        symbols = ca.vertcat(flat.xi, flat.u, flat.theta)
        rows = flat.residual[[row for row in (self.row, self.law) if row >= 0]]
        used = ca.which_depends(rows, symbols, 1, False)
        known = [dimensions(unit) for unit, is_used in zip(units, used, strict=True) if is_used]
        return _VOLUME_FLOW in known or _AREA in known


@cache
def base_unit(unit: str) -> str:
    """The unit of DOMAINS that a quantity in `unit` converts to, empty for none: rad/s of rpm, Pa of bar;
    none of 1/s, which may be anything."""
    if unit in DOMAINS:
        return unit
    known = [base for base in DOMAINS if is_of(unit, base) and converts(unit, base)]
    turns = bool(known) and any(symbol in _ANGLES for symbol in parse_unit(unit))
    return next((base for base in known if base != "rad/s" or turns), "")


def is_length(unit: str) -> bool:
    """Whether a quantity in the unit converts to meters.

    >>> is_length("cm"), is_length("1/m")
    (True, False)
    """
    return is_of(unit, LEVEL) and converts(unit, LEVEL)


def domain_of(unit: str) -> Domain | None:
    """The domain of a variable in `unit` whose rate a balance gives; None where the unit does not tell."""
    return DOMAINS.get(base_unit(unit))


def in_connectors(unit: str) -> Conversion:
    """From a variable of a balance to what the connectors of its domain have: temperatures are absolute
    there, all else is in the unit of DOMAINS, lengths are in meters. A unit that tells no domain stays."""
    base = LEVEL if is_length(unit) else base_unit(unit)
    return conversion(unit, "K" if DOMAINS.get(base) == "thermal" else base) if base else Conversion()


def temperatures(flat: FlatModel) -> dict[int, Conversion]:
    """Unknown -> absolute temperature, of those that are differences from a reference: an output, or a
    variable of the model, is `T = e + 293.15`, where `e` in K is no absolute temperature."""
    found: dict[int, Conversion] = {}
    for unit, law, i in (*_outputs_of_one(flat), *_pairs(flat)):
        own = flat.unknowns[i].unit
        reference = _reference(law, flat.xi[i]) if _is_to_scale(unit) and _is_to_scale(own) else None
        offset = None if reference is None else reference + in_connectors(unit).offset
        if offset is not None and abs(offset - in_connectors(own).offset) > _DIFFERENCE:
            found[i] = Conversion(offset=offset)
    return found


def _is_to_scale(unit: str) -> bool:
    return domain_of(unit) == "thermal" and in_connectors(unit).scale == 1.0


def _outputs_of_one(flat: FlatModel) -> list[tuple[str, ca.SX, int]]:
    """Of every output that is a function of one unknown alone, its unit, that function, and the unknown."""
    used = _columns_by_row(ca.jacobian_sparsity(flat.output_expressions, flat.xi))
    return [(flat.outputs[k].unit, flat.output_expressions[k], ones[0]) for k, ones in used if len(ones) == 1]


def _pairs(flat: FlatModel) -> list[tuple[str, ca.SX, int]]:
    """Of every equation of two unknowns and no rate, by each of the two that it is linear in, its unit, that
    unknown as a function of the other, and the other one."""
    symbols = ca.vertcat(flat.xi, flat.derivatives)
    found = []
    for row, ones in _columns_by_row(ca.jacobian_sparsity(flat.residual, symbols)):
        if len(ones) != 2 or max(ones) >= flat.n:
            continue
        for i, other in (ones, reversed(ones)):
            unit = flat.unknowns[i].unit
            slope = ca.jacobian(flat.residual[row], flat.xi[i]) if _is_to_scale(unit) else None
            if slope is not None and slope.is_constant():
                found.append((unit, flat.xi[i] - flat.residual[row] / slope, other))
    return found


def _columns_by_row(sparsity: ca.Sparsity) -> list[tuple[int, list[int]]]:
    """The rows of a sparse matrix that are not empty, in their order, and the columns in each."""
    used: dict[int, list[int]] = {}
    for row, column in zip(*sparsity.get_triplet(), strict=True):
        used.setdefault(row, []).append(column)
    return sorted(used.items())


def _reference(law: ca.SX, symbol: ca.SX) -> float | None:
    """The number c of an expression `symbol + c`; None for another one."""
    slope, rest = ca.simplify(ca.jacobian(law, symbol)), ca.simplify(ca.substitute(law, symbol, 0.0))
    if not slope.is_constant() or not rest.is_constant():
        return None
    return float(rest) if float(slope) == 1.0 else None


def potential_change(flat: FlatModel, balance: Balance, above: Mapping[int, Conversion]) -> Conversion:
    """From what is balanced to the potential of a connector, as `in_connectors`; of a temperature above a
    reference (`temperatures`) with that."""
    return above.get(balance.variable, in_connectors(balance.potential(flat).unit))


def converted_text(name: str, change: Conversion) -> str:
    """A variable in another unit, as text of an expression.

    >>> converted_text("n", Conversion(scale=0.5)), converted_text("T", Conversion(offset=273.15))
    ('0.5*n', 'T + 273.15')
    """
    scaled = name if change.scale == 1.0 else f"{change.scale!r}*{name}"
    return scaled if change.offset == 0.0 else f"{scaled} + {change.offset!r}"


def needs_position(domain: Domain) -> bool:
    """Whether the potential of the domain's connectors is the integral of the balanced variable."""
    return domain in _MECHANICAL


def balances(flat: FlatModel, everywhere: bool = False) -> list[Balance]:
    """Rows of the model itself, of components without a connector of a domain (`_open_components`) and of
    another domain than the connectors of their component (`_is_within`), and `everywhere` of all components
    and sums of flows, as beside a store `der(w.S) = w.q` whose flow is the rate itself, that hold the rate of
    an unknown and more than that. What events assign has no balance: it stands still between them. Nor has a
    row that gives a reading alone of a rate that another row balances, as `acc = der(v)/9.81` does. Of
    several rates in one row those are left out that another row needs (`_of_own_rows`)."""
    kinds = ("component", "flow") if everywhere else ("component",)
    laws = [i for i, e in enumerate(flat.equations) if e.kind in kinds]
    is_open, joined = _open_components(flat), _joined_domains(flat)
    places = is_open | joined.keys()
    rows = [i for i in laws if everywhere or (flat.equations[i].origin or "") in places]
    if not rows:
        return []
    slopes = slopes_near_start(flat)
    # `der(e) = v - road` is no position of what moves with v.
    by_inputs = ca.which_depends(flat.residual, flat.u, 1, True) if flat.u.numel() else []
    unmoved = [row for row in rows if not (by_inputs and by_inputs[row])]
    stores = {} if everywhere else _stores(flat, slopes, unmoved)
    ratios = {} if everywhere else _ratios(flat, slopes, stores)
    scaled = _in_potentials(flat, slopes, ratios)
    rates, definitions = _rates(scaled, unmoved, _own_unknowns(flat), {*stores, *ratios})
    positions = {rate: variable for variable, rate in rates.items()}
    assigned = set() if flat.events is None else {one.unknown for one in flat.events.assignments}
    moving = set(np.flatnonzero(np.any(slopes[:, slopes.shape[1] // 2 :], axis=0)).tolist())
    moving |= {potential for _, potential in stores.values()}
    found: list[Balance] = []
    for row in rows:
        if row in definitions:
            continue
        for variable, rate in _balanced(slopes[row], rates, moving):
            if variable not in assigned:
                sign, per = float(np.sign(slopes[row, rate])), ratios.get(variable, -1)
                store = -1 if per < 0 else variable
                found.append(Balance(row, variable, sign, positions.get(variable, -1), rate, store, per=per))
    if not everywhere:
        found = [one for one in found if _is_within(flat, one, joined)]
        found = _by_potentials(found, stores, positions)
    readings = _readings(slopes)
    moved = {one.variable for one in found if one.row not in readings}
    return _of_own_rows([one for one in found if one.row not in readings or one.variable not in moved])


def _ratios(flat: FlatModel, slopes: np.ndarray, stores: Container[int]) -> dict[int, int]:
    """What is stored and the parameter over which its potential is written out, but for fluxes, whose
    equations are meshes."""
    found = written_out(flat, slopes, stores)
    return {i: k for i, k in found.items() if not is_of(flat.unknowns[i].unit, FLUX)}


def _in_potentials(flat: FlatModel, slopes: np.ndarray, ratios: Mapping[int, int]) -> np.ndarray:
    """The slopes (n, 2n) with those along what is stored along its potential in its place: 1 in
    `der(s) = p/m`."""
    if not ratios:  # of a large model they are many
        return slopes
    scaled = slopes.copy()
    for stored, parameter in ratios.items():
        column = slopes[:, stored] * flat.theta_values[parameter]
        scaled[:, stored] = np.where(np.isclose(np.abs(column), 1.0, rtol=1e-12), np.sign(column), column)
    return scaled


def _open_components(flat: FlatModel) -> set[str]:
    """The model itself, "", and the components that no connector of a domain stands for, as those with
    connectors of the user's own whose potential is a speed, or in bar: nothing can be connected to them, and
    their equations are places as those of the model are. Not what was attached to the model."""
    return (_own_components(flat) - _joined_domains(flat).keys()) | {""}


def _own_components(flat: FlatModel) -> set[str]:
    """The components that have equations, without what was attached to the model."""
    origins = {e.origin or "" for e in flat.equations if e.kind == "component"}
    return {name for name in origins if name.partition(".")[0] not in flat.attached}


def _joined_domains(flat: FlatModel) -> dict[str, set[Domain]]:
    """The components with connectors of a domain, each with the domains of these; those that a class has
    outside of its terms do not count: its balance is the place that they belong to."""
    joined: dict[str, set[Domain]] = {}
    own = _own_components(flat)
    known = connectors_of(flat.unknowns)
    of_terms = {outside_of_term(name) for name in known}
    for name, connector in known.items():
        if connector.component in own - {""} and name not in of_terms:
            joined.setdefault(connector.component, set()).add(connector.domain)
    return joined


def _is_within(flat: FlatModel, balance: Balance, joined: Mapping[str, set[Domain]]) -> bool:
    """Whether nothing reaches the balance but its own equation: that of a component, `joined` by connectors,
    in a domain that these do not have, as the moving mass of a ram behind its port of oil."""
    connected = joined.get(flat.equations[balance.row].origin or "")
    domain = balance.domain(flat)
    return connected is None or (domain is not None and domain not in connected)


def _stores(flat: FlatModel, slopes: np.ndarray, rows: Sequence[int]) -> dict[int, tuple[int, int]]:
    """Unknown that is stored, as charge, momentum, volume or heat are -> the row of the law that holds it and
    its potential alone, as `Q = C*v` does, and that potential, whose own rate stands in no row: one of the
    model's own, none of a term that was opened for an effect. `slopes` (n, 2n) are of all equations, `rows`
    those that have no input."""
    n, effects = slopes.shape[1] // 2, effects_in(flat)
    rows = [row for row in rows if flat.equations[row].origin.partition(".")[0] not in effects]
    found: dict[int, tuple[int, int]] = {}
    moving = np.flatnonzero(np.any(slopes[:, n:], axis=0)).tolist()
    for stored in moving:
        laws = [
            (row, other)
            for row in rows
            if slopes[row, stored] and (other := _other_unknown(slopes[row], stored)) not in (-1, *moving)
        ]
        if len(laws) == 1 and _is_stored(flat, slopes, stored, *laws[0]):
            found[stored] = laws[0]
    return found


def _other_unknown(slopes: np.ndarray, one: int) -> int:
    """The only unknown beside `one` in a row without rates, (2n,); -1 where there is none, or several."""
    others = [i for i in np.flatnonzero(slopes).tolist() if i != one]
    return others[0] if len(others) == 1 and others[0] < slopes.size // 2 else -1


def _is_stored(flat: FlatModel, slopes: np.ndarray, stored: int, law: int, other: int) -> bool:
    """Whether the rate of the unknown `stored` is a flow of the domain of the `other`, as its own unit tells,
    or a flow beside it; not of what belongs to a domain itself. A voltage that gives the position of a lever
    is nothing by which that is stored."""
    n = slopes.shape[1] // 2
    rows = np.flatnonzero(slopes[:, n + stored]).tolist()
    if len(rows) != 1 or Balance(rows[0], stored, 1.0, -1, n + stored).domain(flat) is not None:
        return False
    domain = Balance(rows[0], other, 1.0, -1, n + stored, stored, law).domain(flat)
    if domain is None:
        return False
    unit = flat.unknowns[stored].unit
    if unit and is_of(f"({unit})/s", FLOWS[domain]):
        return True
    units = [x.unit for part in (flat.unknowns, flat.inputs) for x in part]
    used = ca.which_depends(flat.residual[rows[0]], ca.vertcat(flat.xi, flat.u), 1, False)
    return any(is_of(one, FLOWS[domain]) for one, is_used in zip(units, used, strict=True) if is_used)


def _by_potentials(
    found: Sequence[Balance], stores: Mapping[int, tuple[int, int]], positions: Mapping[int, int]
) -> list[Balance]:
    """The balances, those of what is stored as balances of its potential; the law that gives it is none."""
    laws = {law for law, _ in stores.values()}
    told = []
    for one in found:
        if one.variable in stores:
            law, other = stores[one.variable]
            position = positions.get(other, -1)
            one = replace(one, variable=other, position=position, store=one.variable, law=law)
        if one.row not in laws:
            told.append(one)
    return told


def _of_own_rows(found: Sequence[Balance]) -> list[Balance]:
    """The balances beside which as many rows as can be have a rate of their own: an arm whose own equation
    gives its acceleration leaves the one of its pendulum, which holds both, to the pendulum."""
    rows = sorted({one.row for one in found})
    variables = sorted({one.variable for one in found})
    if len(rows) == len(found):
        return list(found)
    graph = np.zeros((len(rows), len(variables)), dtype=bool)
    places = [(rows.index(one.row), variables.index(one.variable)) for one in found]
    for place in places:
        graph[place] = True
    most = _matched(graph)
    return [
        one
        for one, (i, j) in zip(found, places, strict=True)
        if _matched(np.delete(np.delete(graph, i, axis=0), j, axis=1)) == most - 1
    ]


def _matched(graph: np.ndarray) -> int:
    """How many rows of a graph of rows and columns, (n, m) of bool, can have a column of their own."""
    return int(np.sum(maximum_matching(sp.csr_array(graph)) >= 0)) if graph.size else 0


def _balanced(slopes: np.ndarray, rates: Mapping[int, int], moving: Container[int]) -> list[tuple[int, int]]:
    """The variables whose rates a row with these `slopes` (2n,) gives, and where each rate stands. `moving`
    are the unknowns whose derivatives stand in any row.

    `A*v` in `m*der(v) = A*p - d*v` and in `C*der(p) = q - A*v` is no rate of a position, although v is: a
    derivative goes before the unknowns that equal one, and of these the highest before the lower ones. An
    acceleration that has a name of its own, and no rate, stands for its derivative: it is as high as one."""
    n = slopes.size // 2
    explicit = [(i - n, i) for i in (np.flatnonzero(slopes[n:]) + n).tolist()]
    named = [(variable, rate) for variable, rate in rates.items() if slopes[rate]]
    lower = {variable for variable, rate in named if any(higher == rate for higher, _ in named)}
    if explicit:
        named = [one for one in named if one[1] not in moving]
    highest = [one for one in named if one[0] not in lower]
    return sorted([*explicit, *highest])


def _readings(slopes: np.ndarray) -> set[int]:
    """Rows that give a variable which stands in no other row, and whose rate stands in none: nothing moves by
    what is added there. `slopes` (n, 2n) are of all equations."""
    n = slopes.shape[1] // 2
    uses = np.count_nonzero(slopes, axis=0)
    read = np.flatnonzero((uses[:n] == 1) & (uses[n:] == 0))
    return set(np.flatnonzero(np.any(slopes[:, read], axis=1)).tolist())


def own_laws(flat: FlatModel) -> list[int]:
    """Rows of the model itself, not of its components, be they equations or bindings."""
    return [i for i, e in enumerate(flat.equations) if e.kind in ("component", "binding") and not e.origin]


def _own_unknowns(flat: FlatModel) -> np.ndarray:
    """Which unknowns (n,) stand for nothing that was attached to the model: `der(v) = g*beam + load` balances
    v, it does not define the load."""
    attached = {e.origin for e in flat.equations if e.kind == "component"}
    return np.array([x.name not in attached for x in flat.unknowns])


def _rates(
    slopes: np.ndarray, rows: list[int], is_own: np.ndarray, stores: Container[int]
) -> tuple[dict[int, int], set[int]]:
    """Variable -> the unknown that is its derivative, by rows such as `v = der(s)`; and these rows. `is_own`
    (n,) says which unknowns may be a derivative; what is in `stores` is none of a position: `der(Q) = i`
    balances currents."""
    n = len(is_own)
    rates: dict[int, int] = {}
    definitions: set[int] = set()
    for row in rows:
        used = np.flatnonzero(slopes[row])
        if len(used) != 2 or not used[0] < n <= used[1] or used[0] == used[1] - n or not is_own[used[0]]:
            continue
        if sorted(slopes[row, used]) == [-1, 1] and int(used[1]) - n not in stores:
            rates[int(used[1]) - n] = int(used[0])
            definitions.add(row)
    return rates, definitions


def slopes_near_start(flat: FlatModel) -> np.ndarray:
    """[∂F/∂ξ, ∂F/∂ξ'] (n, 2n) at one random point near the start values, zero where it is not finite."""
    everything = ca.vertcat(flat.xi, flat.derivatives)
    others = [flat.u, flat.w, flat.theta, flat.time]
    evaluate = ca.Function("slopes", [everything, *others], [ca.jacobian(flat.residual, everything)])
    rng = np.random.default_rng(_SEED)
    point = [rng.uniform(0.5, 1.5, x.numel()) for x in (everything, flat.u, flat.w)]
    matrix = np.array(evaluate(*point, flat.theta_values, 0.7).full())
    return np.where(np.isfinite(matrix), matrix, 0.0)
