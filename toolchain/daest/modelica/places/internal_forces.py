"""Forces between the bodies of a model that is written as bare equations: those that a variable holds, as F
in `F = c*(s1 - s2)`, `m1*der(v1) = u - F` and `m2*der(v2) = F`, and those that stand in the balances.

What does work against such a force is the relative motion of the bodies. Of a force that acts with the
factors a on bodies with the speeds v, the power is the sum of a*v*F, so that an effect beside it sees the
speed which is the sum of -a*v: for the spring above v1 - v2, for a belt on two pulleys r1*w1 - r2*w2.

What a body stands on may be moved by an input, as a wheel by the road in `F = c*(z - road)`: the force then
goes with the motion relative to that, z - road, and one body is enough. The input may be in another unit, as
in `d*(w - rad*rate)`, or move an unknown, as the speed of a trolley does by `der(x) = v`. Where the speed of
the body comes in without that of the input, as in `u = kp*(r - phi) - kd*w`, or a sum over time of both
speeds as in `tau = kp*(r - w) + ki*e`, `der(e) = r - w`, it may be the command of a controller as well.

The speed of one body may be told relative to another that carries it, as vr in `m2*(der(v1) + der(vr)) = -F`
beside `m1*der(v1) = u + F`: it is the relative motion itself, and the carrier takes the same force the other
way.

A spring to what does not move has its place in the balance of the body: for what changes it, as a play does.
What acts on the body alone is a term of the balance itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import casadi as ca
import numpy as np

from daest.model.effects import Domain
from daest.model.flat import FlatModel
from daest.modelica.flat.factors import (
    Entry,
    are_same,
    at_points,
    given_value,
    is_of_parameters,
    multiplied,
    plain_factor,
    signed,
    signed_text,
)
from daest.modelica.places.balances import DOMAINS, Balance, balances, own_laws, slopes_near_start
from daest.modelica.places.place_units import flow_factor
from daest.modelica.places.written_out import in_potentials
from daest.quantities import conversion, converts, is_of

_FORCES: dict[Domain, str] = {"translational": "N", "rotational": "N.m"}
_POSITIONS: dict[Domain, str] = {"translational": "m", "rotational": "rad"}
_SPEEDS: dict[Domain, str] = {"translational": "m/s", "rotational": "rad/s"}
_DEPTH = 5  # of variables that are given by others
_TOLERANCE = 1e-9  # relative, of what rounding alone makes differ
_SAME_UNIT = 1e-3  # relative, of a factor between units as a model writes it: 57.3, 3.1416/180


@dataclass(frozen=True)
class InternalForce:
    """The force that an equation gives to unknown `variable`, or that stands in the balances of two `bodies`
    where this is None. `bodies` are the balances with the factors, expressions of the parameters, by which
    their speeds sum up to that of the relative motion; `entries` the equations that the flow of an effect
    enters: that which gives the force, or the two balances.
    `ground` are the inputs, or the unknowns that inputs alone move, as numbers among the unknowns and, behind
    them, the inputs, with their factors, that are what the bodies stand on: they are part of the relative
    motion. `deflection` is the unknown of the model that is the relative position, as phi in
    `der(phi) = w1 - w2` or e in `e = z - road`, with its sign; None where there is none. `beside` are other
    forces that the same motion drives, as that of a damper beside that of a spring. `carrier` is the balance
    of the body relative to which the speed of the only one of the `bodies` is told; None for none."""

    domain: Domain
    bodies: tuple[tuple[Balance, ca.SX], ...]
    entries: tuple[Entry, ...]
    variable: int | None = None
    ground: tuple[tuple[int, float], ...] = ()
    deflection: tuple[int, float] | None = None
    beside: tuple[InternalForce, ...] = ()
    carrier: Balance | None = None

    def name(self, flat: FlatModel) -> str:
        if self.variable is not None:
            return f"{self.entries[0].row}:{flat.unknowns[self.variable].name}"
        return ", ".join([*(body.name(flat) for body in self._acting), *self._ground_names(flat)])

    def aliases(self, flat: FlatModel) -> tuple[str, ...]:
        if self.variable is not None:
            return flat.equations[self.entries[0].row].text, flat.unknowns[self.variable].name
        bodies = [body.potential(flat).name for body in self._acting]
        return (", ".join([*bodies, *self._ground_names(flat)]),)

    @property
    def _acting(self) -> list[Balance]:
        """The balances that a force enters which stands in them."""
        return [*(body for body, _ in self.bodies), *([] if self.carrier is None else [self.carrier])]

    def _ground_names(self, flat: FlatModel) -> list[str]:
        return [_moved_names(flat)[i] for i, _ in self.ground]

    @property
    def is_grounded(self) -> bool:
        """Whether it acts between one body and what does not move."""
        return len(self.bodies) == 1 and not self.ground and self.carrier is None

    @property
    def has_positions(self) -> bool:
        """Whether every body has a position, or the deflection is known; else the speeds alone are."""
        return self.deflection is not None or all(body.position >= 0 for body, _ in self.bodies)

    def motion(self, flat: FlatModel) -> ca.SX:
        """The relative position, or the relative speed where a body has no position."""
        return _sum((factor, symbol) for symbol, _, factor in self._terms(flat))

    def motion_text(self, flat: FlatModel) -> str | None:
        """The same as Modelica writes it; None where a factor is neither a number nor a parameter."""
        text = ""
        terms = [(signed_text(factor, flat), name) for _, name, factor in self._terms(flat)]
        for (sign, factor), variable in sorted(terms, key=lambda term: term[0][0]):  # what is added first
            if factor is None:
                return None
            own = multiplied(variable, factor)
            text += f" {sign} {own}" if text else own if sign == "+" else f"-{own}"
        return text

    def coefficients(self, flat: FlatModel) -> tuple[tuple[str, str], ...]:
        """The parameters that the force, or one beside it, is proportional to: as `c` that by which it grows
        with the relative position, as `d` that with the relative speed."""
        known: dict[str, str] = {}
        of_speeds = _in_speeds(flat, balances(flat))
        for force in (self, *self.beside):
            known = {**force._with_bodies(balances(of_speeds))._own_coefficients(of_speeds), **known}
        return tuple(sorted(known.items()))

    def _with_bodies(self, known: Sequence[Balance]) -> InternalForce:
        """The force between the same bodies as the balances `known` of the model have them, in speeds or in
        momenta."""
        at = {(one.row, one.variable): one for one in known}
        bodies = tuple((at[body.row, body.variable], factor) for body, factor in self.bodies)
        beside = tuple(one._with_bodies(known) for one in self.beside)
        carrier = None if self.carrier is None else at[self.carrier.row, self.carrier.variable]
        return replace(self, bodies=bodies, beside=beside, carrier=carrier)

    def _own_coefficients(self, flat: FlatModel) -> dict[str, str]:
        if self.variable is None:
            return _factors_in_balances(self, flat)
        slopes = zip("cd", _slopes(self, flat), strict=True)
        printed = [(name, signed_text(slope, flat)) for name, slope in slopes]
        parameters = set(flat.parameter_names)
        return {name: text for name, (sign, text) in printed if sign == "+" and text in parameters}

    def _terms(self, flat: FlatModel) -> Iterator[tuple[ca.SX, str, ca.SX]]:
        """Symbol, name and factor of what the relative motion is the sum of."""
        if self.deflection is not None:
            i, sign = self.deflection
            yield flat.xi[i], flat.unknowns[i].name, ca.SX(sign)
            return
        for body, factor in self.bodies:
            if self.has_positions:
                yield flat.xi[body.position], flat.unknowns[body.position].name, factor
            else:
                yield body.symbol(flat), body.potential(flat).name, factor
        for i, sign in self.ground:
            yield _moved(flat)[i], _moved_names(flat)[i], ca.SX(sign)


def internal_forces(flat: FlatModel) -> list[InternalForce]:
    """Forces between bodies, or between one and what an input moves or what does not move, in the model's own
    equations: one of those that the same motion drives."""
    declared = balances(flat)
    of_speeds = _in_speeds(flat, declared)
    found = _forces_of_speeds(of_speeds)
    return found if of_speeds is flat else [force._with_bodies(declared) for force in found]


def _in_speeds(flat: FlatModel, known: Sequence[Balance]) -> FlatModel:
    """The model with the speeds of bodies in place of their momenta, where these are written out."""
    return in_potentials(flat, {body.variable: body.per for body in known if body.per >= 0})


def _forces_of_speeds(flat: FlatModel) -> list[InternalForce]:
    # A motion in other units is no text in terms of which a law can be written.
    known = balances(flat)
    bodies = [b for b in known if DOMAINS.get(flat.unknowns[b.variable].unit) in _FORCES]
    if not bodies:
        return []
    movers = _movers(flat, known)
    found: list[InternalForce] = []
    motions = np.zeros((0, flat.xi.numel() + flat.u.numel()))
    for force in (
        *_given_by_equations(flat, bodies, movers),
        *_in_balances(flat, bodies),
        *_on_carriers(flat, bodies),
        *_on_moved_ground(flat, bodies, movers),
        *_on_fixed_ground(flat, bodies),
    ):
        motion = _motion(force, flat)
        signed = (np.isclose(motions, sign * motion, rtol=_TOLERANCE, atol=0.0) for sign in (1.0, -1.0))
        same = np.flatnonzero(np.any([np.all(one, axis=1) for one in signed], axis=0))
        if len(same):
            first = int(same[0])
            found[first] = replace(found[first], beside=(*found[first].beside, force))
        else:
            found.append(force)
            motions = np.vstack([motions, motion])
    return found


def _given_by_equations(
    flat: FlatModel, bodies: Sequence[Balance], movers: Mapping[int, str]
) -> Iterator[InternalForce]:
    slopes = slopes_near_start(flat)
    rows = {body.row for body in bodies}
    kinetic = {i for body in bodies for i in (body.variable, body.position)}
    laws = [i for i in own_laws(flat) if i not in rows]
    for variable, unknown in enumerate(flat.unknowns):
        domain = next((d for d, unit in _FORCES.items() if is_of(unknown.unit, unit)), None)
        if domain is None or variable in kinetic:
            continue
        own = [row for row in laws if abs(slopes[row, variable]) == 1.0 and not _is_definition(slopes[row])]
        acting = _acting(flat, bodies, variable, domain)
        if len(own) != 1 or not acting:
            continue
        sign = -float(slopes[own[0], variable])
        law = _spelled_out(flat, sign * flat.residual[own[0]], slopes, {*laws} - {*own}, {*kinetic, variable})
        ground = _ground(flat, movers, law, acting, domain)
        deflection = _deflection(flat, acting, ground)
        force = InternalForce(domain, acting, (Entry(own[0], sign),), variable, ground, deflection)
        if not force.is_grounded or "c" in force._own_coefficients(flat):
            yield force


def _spelled_out(flat: FlatModel, law: ca.SX, slopes: np.ndarray, rows: set[int], kept: set[int]) -> ca.SX:
    """The law with the unknowns that one of the `rows` gives without a derivative put in, but for those that
    are `kept`, and with the derivatives that one of them gives."""
    n = flat.xi.numel()
    symbols = ca.vertcat(flat.xi, flat.derivatives)
    for _ in range(_DEPTH):
        used = np.flatnonzero(ca.which_depends(law, symbols, 1, False)).tolist()
        given = {}
        for k in used:
            rates = np.array([k - n]) if k >= n else np.array([], dtype=int)
            own = [
                i
                for i in rows
                if abs(slopes[i, k]) == 1.0 and np.array_equal(np.flatnonzero(slopes[i, n:]), rates)
            ]
            if k not in kept and len(own) == 1:
                given[k] = symbols[k] - float(slopes[own[0], k]) * flat.residual[own[0]]
        if not given:
            break
        law = ca.substitute(law, ca.vertcat(*(symbols[k] for k in given)), ca.vertcat(*given.values()))
    return law


def _moved(flat: FlatModel) -> ca.SX:
    """The symbols (n + n_u,) that `InternalForce.ground` counts."""
    return ca.vertcat(flat.xi, flat.u)


def _moved_names(flat: FlatModel) -> tuple[str, ...]:
    return (*flat.unknown_names, *flat.input_names)


def _ground(
    flat: FlatModel,
    movers: Mapping[int, str],
    law: ca.SX,
    bodies: Sequence[tuple[Balance, ca.SX]],
    domain: Domain,
) -> tuple[tuple[int, float], ...]:
    """Those of the `movers` that the bodies stand on, with the factors by which they enter the relative
    motion whose function the `law` is; none where it is no function of that."""
    has_positions = all(body.position >= 0 for body, _ in bodies)
    unit = (_POSITIONS if has_positions else _SPEEDS)[domain]
    candidates = [i for i, one in movers.items() if is_of(one, unit) and converts(one, unit)]
    if not candidates:
        return ()
    own = [flat.xi[body.position if has_positions else body.variable] for body, _ in bodies]
    moved = ca.vertcat(*own, _moved(flat)[candidates])
    column = ca.vertcat(ca.jacobian(law, moved).T, *(factor for _, factor in bodies))
    values = at_points(flat, column)[:, 0]
    n_bodies, n_all = len(own), moved.numel()
    with np.errstate(all="ignore"):
        per_motion = values[:n_bodies] / values[n_all:]
        factors = values[n_bodies:n_all] / per_motion[:1]
    is_motion = np.all(np.isfinite(factors)) and np.allclose(per_motion, per_motion[:1], rtol=_TOLERANCE)
    if not is_motion or not np.allclose(factors, factors[:, :1], rtol=_TOLERANCE, atol=_TOLERANCE):
        return ()
    found = []
    for i, value in zip(candidates, factors[:, 0], strict=True):
        scale = conversion(movers[i], unit).scale
        if abs(abs(value) - scale) < _SAME_UNIT * scale:
            found.append((i, float(np.sign(value)) * (scale if scale == 1.0 else abs(float(value)))))
    return tuple(found)


def _movers(flat: FlatModel, known: Sequence[Balance]) -> dict[int, str]:
    """The units of what may move a ground, by the numbers of `InternalForce.ground`: inputs, and the unknowns
    that a row of the model gives from inputs alone, or from others that are, with or without their rates, but
    for bodies: x in `der(x) = v_trolley`, z in `z = plate/1000`. `known` are the balances of the model."""
    n = flat.xi.numel()
    units = {n + i: one.unit for i, one in enumerate(flat.inputs)}
    everything = ca.vertcat(flat.xi, flat.derivatives, flat.u)
    rows = own_laws(flat)
    pattern = ca.jacobian_sparsity(flat.residual[rows], everything)
    used: dict[int, set[int]] = {}
    for row, column in zip(pattern.row(), pattern.get_col(), strict=True):
        used.setdefault(row, set()).add(column)
    bodies = {i for body in known for i in (body.variable, body.position) if body.domain(flat)}
    moved: set[int] = set()
    while True:
        new = set()
        for columns in used.values():
            unknown = {k % n for k in columns if k < 2 * n} - moved
            is_driven = any(k >= 2 * n or k % n in moved for k in columns)
            if len(unknown) == 1 and is_driven:
                new |= unknown - bodies
        if not new:
            return units | {k: flat.unknowns[k].unit for k in sorted(moved)}
        moved |= new


def _is_definition(slopes: np.ndarray) -> bool:
    """Whether the row says that two variables are equal but for their signs."""
    used = slopes[slopes != 0.0]
    return len(used) == 2 and bool(np.all(np.abs(used) == 1.0))


def _acting(
    flat: FlatModel, bodies: Sequence[Balance], variable: int, domain: Domain
) -> tuple[tuple[Balance, ca.SX], ...]:
    """The bodies in whose balances the unknown stands with a factor that only parameters change, and what
    their speeds are multiplied by; none where it stands in one of them otherwise."""
    symbol = flat.xi[variable]
    found: list[tuple[Balance, ca.SX]] = []
    for body in bodies:
        factor = ca.simplify(ca.jacobian(flat.residual[body.row], symbol))
        if factor.is_zero():
            continue
        if not is_of_parameters(flat, factor):
            return ()
        own = flow_factor(flat, body)
        if own is None:
            if body.domain(flat) != domain:
                return ()
            # The terms are accelerations: the factor has the mass in it, and tells the direction alone.
            factor, own = ca.SX(float(np.sign(given_value(flat, factor)))), ca.SX(1.0)
        factor = body.sign * factor / own
        plain = plain_factor(flat, factor)
        found.append((body, ca.simplify(factor) if plain is None else plain))
    return tuple(found)


def _deflection(
    flat: FlatModel, bodies: Sequence[tuple[Balance, ca.SX]], ground: Sequence[tuple[int, float]] = ()
) -> tuple[int, float] | None:
    """The unknown whose rate a row of the model says to be the relative speed of the bodies, or minus that,
    and its sign, or that a row says to be their position relative to the `ground`; None where there is
    none."""
    has_positions = all(body.position >= 0 for body, _ in bodies)
    moved = _sum((ca.SX(sign), _moved(flat)[i]) for i, sign in ground)
    motions: list[tuple[ca.SX, ca.SX]] = []
    if not ground or not has_positions:
        speed = _sum((factor, flat.xi[body.variable]) for body, factor in bodies)
        motions.append((flat.derivatives, speed + moved))
    if has_positions:
        position = _sum((factor, flat.xi[body.position]) for body, factor in bodies)
        motions.append((flat.xi, position + moved))
    own = {body.position for body, _ in bodies}
    kinds = ("component", "binding")
    rows = flat.residual[[i for i, e in enumerate(flat.equations) if e.kind in kinds and not e.origin]]
    for symbols, motion in motions:
        used = [pair for pair in _dependences(rows, symbols) if pair[1] not in own]
        found = _says_sum(flat, rows, used, symbols, motion)
        if found is not None:
            return found
    return None


def _dependences(rows: ca.SX, symbols: ca.SX) -> list[tuple[int, int]]:
    """The numbers of every row and of every symbol in it, by rows."""
    found = ca.jacobian_sparsity(rows, symbols).get_triplet()
    return sorted(zip(*found, strict=True))


def _says_sum(
    flat: FlatModel, rows: ca.SX, used: Sequence[tuple[int, int]], symbols: ca.SX, motion: ca.SX
) -> tuple[int, float] | None:
    """The number of the symbol of the first of the pairs `used` whose row says that it is the motion, or
    minus that, and the sign; None where no row does. All are compared at once: they are many in a chain."""
    if not used:
        return None
    values = at_points(flat, ca.vertcat(rows, symbols, motion), flat.theta_values)[:, 0]
    told, at, moved = np.split(values, [rows.numel(), rows.numel() + symbols.numel()])
    row, k = np.array(used).T
    signs = np.array([1.0, -1.0])
    deflected = at[k][:, None, :] - signs[:, None] * moved
    same = [np.isclose(told[row][:, None, :], t * deflected, rtol=_TOLERANCE, atol=0.0) for t in signs]
    found = np.argwhere(np.any(np.all(same, axis=-1), axis=0))
    return (int(k[found[0, 0]]), float(signs[found[0, 1]])) if len(found) else None


def _sum(terms: Iterable[tuple[ca.SX, ca.SX]]) -> ca.SX:
    return sum((factor * symbol for factor, symbol in terms), start=ca.SX(0.0))


def _slopes(force: InternalForce, flat: FlatModel) -> tuple[ca.SX, ca.SX]:
    """How the force that an equation gives grows with the relative position and with the relative speed."""
    (first, factor), *others = force.bodies
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    (entry,) = force.entries
    law = entry.sign * flat.residual[entry.row]
    speeds = _sum((f, flat.xi[body.variable]) for body, f in others)
    ground = _sum((ca.SX(sign), _moved(flat)[i]) for i, sign in force.ground)
    has_positions = all(body.position >= 0 for body, _ in force.bodies)
    if not has_positions:
        law = ca.substitute(law, flat.xi[first.variable], (v - speeds - ground) / factor)
    elif not force.ground:  # else the speeds are not those relative to the ground
        law = ca.substitute(law, flat.xi[first.variable], (v - speeds) / factor)
    if has_positions:
        positions = _sum((f, flat.xi[body.position]) for body, f in others) + ground
        law = ca.substitute(law, flat.xi[first.position], (x - positions) / factor)
    if force.deflection is not None:
        k, direction = force.deflection
        law = ca.substitute(law, ca.vertcat(flat.xi[k], flat.derivatives[k]), direction * ca.vertcat(x, v))
    return ca.simplify(ca.jacobian(law, x)), ca.simplify(ca.jacobian(law, v))


def _factors_in_balances(force: InternalForce, flat: FlatModel) -> dict[str, str]:
    """Of a force that stands in the balances: the only parameter that multiplies the relative position there,
    and the only one that multiplies the relative speed."""
    motions: dict[str, ca.SX] = {}
    if force.has_positions:
        motions["c"] = force.motion(flat)
    if not force.ground:
        motions["d"] = _sum((factor, flat.xi[body.variable]) for body, factor in force.bodies)
    entry = force.entries[0]
    law = flat.residual[entry.row] / entry.in_residual
    moving = [body for body, _ in force.bodies if body.position >= 0]
    if moving:  # der(s) is the speed
        rates = ca.vertcat(*(flat.derivatives[body.position] for body in moving))
        law = ca.substitute(law, rates, ca.vertcat(*(flat.xi[body.variable] for body in moving)))
    terms = ca.jacobian(law, flat.theta)
    found = {}
    for name, motion in motions.items():
        own = [
            k
            for k in range(terms.numel())
            if not terms[k].is_zero() and are_same(flat, terms[k], motion, flat.theta_values)
        ]
        if len(own) == 1:
            found[name] = flat.parameter_names[own[0]]
    return found


def _in_balances(flat: FlatModel, bodies: Sequence[Balance]) -> Iterator[InternalForce]:
    """Forces that a parameter tells: it acts on two bodies with opposite signs, and with what moves both, or
    it is the stiffness or the damping between two with a gear or a lever between them."""
    factors = [(body, flow_factor(flat, body)) for body in bodies]
    heavy = [(body, factor) for body, factor in factors if factor is not None]
    if len(heavy) < 2:
        return
    rows = ca.vertcat(*(body.sign * flat.residual[body.row] / factor for body, factor in heavy))
    slopes = ca.jacobian(rows, flat.theta)
    acts = np.nan_to_num(at_points(flat, slopes, flat.theta_values))
    for k in range(acts.shape[1]):
        pair = np.flatnonzero(np.any(acts[:, k], axis=1)).tolist()
        if len(pair) != 2:
            continue
        both = [heavy[i] for i in pair]
        is_opposite = np.allclose(acts[pair[0], k], -acts[pair[1], k], rtol=_TOLERANCE, atol=0.0)
        turned = _opposite if is_opposite else _geared
        ratios = turned(flat, slopes[pair, k], [body for body, _ in both])
        domain = _domain_of_motion(flat, [body for body, _ in both], ratios)
        if domain is None:
            continue
        shares = [signed(ratio) for ratio in ratios]
        entries = [
            Entry(body.row, body.sign * sign, factor * size)
            for (body, factor), (sign, size) in zip(both, shares, strict=True)
        ]
        joined = tuple((body, ratio) for (body, _), ratio in zip(both, ratios, strict=True))
        yield InternalForce(domain, joined, tuple(entries), deflection=_deflection(flat, joined))


def _on_carriers(flat: FlatModel, bodies: Sequence[Balance]) -> Iterator[InternalForce]:
    """Forces between a body and the one relative to which its speed is told: a parameter acts on both with
    opposite signs, and with what moves the one against the other."""
    for body, carrier in _carried(flat, bodies):
        domain, factor, of_carrier = body.domain(flat), flow_factor(flat, body), flow_factor(flat, carrier)
        if domain is None or factor is None or of_carrier is None:
            continue
        acts = ca.jacobian(body.sign * flat.residual[body.row] / factor, flat.theta)
        reacts = ca.jacobian(carrier.sign * flat.residual[carrier.row] / of_carrier, flat.theta)
        own = ca.vertcat(*(flat.xi[i] for i in (body.variable, body.position) if i >= 0))
        entries = (Entry(body.row, body.sign, factor), Entry(carrier.row, -carrier.sign, of_carrier))
        for k in range(flat.theta.numel()):
            if ca.depends_on(acts[k], own) and are_same(flat, acts[k], -reacts[k], flat.theta_values):
                yield InternalForce(domain, ((body, ca.SX(1.0)),), entries, carrier=carrier)


def _carried(flat: FlatModel, bodies: Sequence[Balance]) -> Iterator[tuple[Balance, Balance]]:
    """Pairs of a body and its carrier: the row of the body holds the rate of the carrier's speed with the
    same mass as that of its own, which the row of the carrier does not hold."""
    rates = ca.vertcat(flat.xi, flat.derivatives)
    held = set(_dependences(flat.residual, rates))  # once for all: the bodies of a chain are many
    for body, carrier in permutations(bodies, 2):
        if (body.row, carrier.rate) not in held or (carrier.row, body.rate) in held:
            continue
        masses = ca.jacobian(flat.residual[body.row], rates[[body.rate, carrier.rate]])
        if body.domain(flat) == carrier.domain(flat) and are_same(flat, masses[0], masses[1]):
            yield body, carrier


def _domain_of_motion(flat: FlatModel, bodies: Sequence[Balance], ratios: Sequence[ca.SX]) -> Domain | None:
    """The domain of two bodies, or of that one whose motion the relative motion is measured in: of a slide on
    a rack beside the shaft of its pinion. None where there is none, or there are no `ratios`."""
    domains = [body.domain(flat) for body in bodies]
    if not ratios or domains[0] == domains[1]:
        return domains[0] if ratios else None
    own = (d for d, ratio in zip(domains, ratios, strict=True) if signed_text(ratio, flat)[1] == "")
    return next(own, None)


def _opposite(flat: FlatModel, acting: ca.SX, bodies: Sequence[Balance]) -> tuple[ca.SX, ...]:
    """The factors of the speeds of two bodies on which a parameter acts with opposite signs, if what it
    multiplies in their balances, `acting` (2,), changes with the motion of both; else none."""
    if bodies[0].domain(flat) != bodies[1].domain(flat):
        return ()
    moved = [ca.vertcat(*(flat.xi[i] for i in (b.variable, b.position) if i >= 0)) for b in bodies]
    follows = all(ca.depends_on(acting[i], one) for i in (0, 1) for one in moved)
    return (ca.SX(1.0), ca.SX(-1.0)) if follows else ()


def _geared(flat: FlatModel, acting: ca.SX, bodies: Sequence[Balance]) -> tuple[ca.SX, ...]:
    """The factors a of the speeds of two bodies in the relative motion, where what a parameter multiplies in
    their balances, `acting` (2,), is a·(a·x) of their positions or speeds x; none where it is not."""
    for x in ([b.position for b in bodies], [b.variable for b in bodies]):
        if min(x) < 0:
            continue
        slopes = ca.jacobian(acting, ca.vertcat(*(flat.xi[i] for i in x)))
        (a, b), (c, d) = ((slopes[i, 0], slopes[i, 1]) for i in (0, 1))
        if not is_of_parameters(flat, slopes) or any(one.is_zero() for one in (a, b, c, d)):
            continue
        first, second = (plain_factor(flat, ca.sqrt(one)) for one in (a, d))
        if first is None or second is None or not are_same(flat, b, c):
            continue
        for ratio in (second, -second):
            if are_same(flat, b, first * ratio):
                return first, ratio
    return ()


def _on_moved_ground(
    flat: FlatModel, bodies: Sequence[Balance], movers: Mapping[int, str]
) -> Iterator[InternalForce]:
    """Forces between one body and what an input moves, in the balance of the body: a parameter multiplies a
    function of the motion relative to the input, as c in `m*der(v) = -c*(z - road)`."""
    slopes, laws = slopes_near_start(flat), own_laws(flat)
    rows = {*laws} - {body.row for body in bodies}
    kinetic = {i for body in bodies for i in (body.variable, body.position)}
    for body in bodies:
        domain = body.domain(flat)
        factor = flow_factor(flat, body)
        if domain is None or factor is None:
            continue
        law = _spelled_out(flat, flat.residual[body.row], slopes, rows, kinetic)
        terms = ca.jacobian(law / factor, flat.theta)
        for k in range(flat.theta.numel()):
            own = ((body, ca.SX(1.0)),)
            ground = _ground(flat, movers, terms[k], own, domain) if not terms[k].is_zero() else ()
            if ground:
                deflection = _deflection(flat, own, ground)
                entries = (Entry(body.row, body.sign, factor),)
                yield InternalForce(domain, own, entries, None, ground, deflection)


def _on_fixed_ground(flat: FlatModel, bodies: Sequence[Balance]) -> Iterator[InternalForce]:
    """Springs between a body and what does not move: a parameter multiplies the position of the body in its
    balance."""
    for body in bodies:
        factor, domain = flow_factor(flat, body), body.domain(flat)
        if factor is None or domain is None or body.position < 0:
            continue
        own = ((body, ca.SX(1.0)),)
        force = InternalForce(domain, own, (Entry(body.row, body.sign, factor),))
        if "c" in _factors_in_balances(force, flat):
            yield force


def _motion(force: InternalForce, flat: FlatModel) -> np.ndarray:
    """How the relative motion of a force depends on every unknown and input, (n + n_u,)."""
    moved = ca.jacobian(force.motion(flat), ca.vertcat(flat.xi, flat.u))
    return ca.Function("motion", [flat.theta], [moved])(flat.theta_values).full().ravel()
