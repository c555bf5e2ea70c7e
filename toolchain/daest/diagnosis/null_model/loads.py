"""Unknown external loads: where one may act, and the model with coloured loads attached.

A load enters a flow balance (torques, forces, currents, heat flows, volume flows at a node), which is where
the noise subspace of Theorem 3.1 admits white noise, and there it passes through a first-order filter
besides, so that a slow external load is as well described as a fast one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count

import casadi as ca
import numpy as np

from daest.diagnosis.gates import GATES
from daest.errors import DaestError
from daest.model.effects import Site
from daest.model.flat import FlatModel
from daest.model.linear import StateSpace
from daest.model.parts import Equation, NoiseInput, Parameter, Variable
from daest.modelica.places.balances import Balance, balances
from daest.modelica.places.place_names import resolve_place
from daest.modelica.places.place_units import flow_unit, flows_in_rows
from daest.modelica.places.sites import sites, untold_balances
from daest.quantities import dimensions, is_of
from daest.systems.linear.state_space import state_space, state_space_family

N_FREQUENCIES = 9
SELDOM_LOADED = ("electrical",)
CHARGE = "A.s"


@dataclass(frozen=True)
class LoadPlace:
    """Equation `row` of the model, where a load may act; `names`: nodes that act on the outputs alike;
    `load`: what the load is called in the model."""

    row: int
    names: tuple[str, ...]
    unit: str
    load: str

    @property
    def noise(self) -> str:
        """The white noise that drives the load."""
        return f"{self.load}.w"

    @property
    def time_constant(self) -> str:
        """The parameter."""
        return f"{self.load}.T"


def load_sites(flat: FlatModel) -> list[Site]:
    """Where unknown loads may act: at nodes and balances of a physical domain and at those of stuff, and
    where a pressure moves a liquid; in a model that has none of them, a circuit of one loop say, in its
    meshes, and where no unit tells a domain, in any balance."""
    known = sites(flat)
    stuff = {one.name(flat) for one in balances(flat) if one.is_amount(flat) and _is_of_stuff(flat, one)}
    flows = [
        site
        for site in known
        if site.kind in ("node", "equation") and (site.domain != "amount" or site.name in stuff)
    ]
    meshes = [site for site in known if site.kind == "mesh"]
    loops = [site for site in meshes if site.domain == "electrical"]
    heads = [site for site in meshes if site.domain == "hydraulic" and _moves(flat, site)]
    return [*flows, *heads] or loops or untold_balances(flat)


def _moves(flat: FlatModel, site: Site) -> bool:
    """Whether the equation of a place is one of motion: a liquid has inertia there."""
    return any(bool(ca.depends_on(flat.residual[row], flat.derivatives)) for row in _rows(flat, site))


def _is_of_stuff(flat: FlatModel, balance: Balance) -> bool:
    """Whether an amount is one of matter: a charge is what a current brings, and a number may be anything."""
    unit = flat.unknowns[balance.variable].unit
    return bool(dimensions(unit)) and not is_of(unit, CHARGE)


def load_places(flat: FlatModel, nodes: Sequence[Site]) -> tuple[LoadPlace, ...]:
    """The nodes where a load is admissible and reaches the outputs, grouped by what the outputs see of it."""
    rows: dict[int, Site] = {}
    # Where the outputs cannot tell, a load is named by its mechanical place: currents are known better.
    for node in sorted(nodes, key=lambda n: n.domain in SELDOM_LOADED):
        for row in _rows(flat, node):
            rows.setdefault(row, node)
    # What turns without inertia has no acceleration under white noise, and need not have one: components tell
    # it all the same. Under a load of finite rate it has.
    responses = _responses(flat, rows, _driven_by) or _responses(flat, rows, _loaded_at)
    if not responses:
        return ()
    table = np.array(list(responses.values()))
    # Every output counts alike at every frequency, whatever its unit.
    largest = np.max(np.abs(table), axis=0)
    table = table / np.where(largest > 0.0, largest, 1.0)
    seen = np.linalg.norm(table, axis=1) > GATES.unseen_load * np.max(
        np.linalg.norm(table, axis=1), initial=0.0
    )
    groups: list[tuple[np.ndarray, list[int]]] = []
    for row, response, is_seen in zip(responses, table, seen, strict=True):
        if not is_seen:
            continue
        for direction, members in groups:
            if _sine(direction, response) < GATES.same_place_sine:
                members.append(row)
                break
        else:
            groups.append((response, [row]))
    return tuple(
        LoadPlace(
            row=members[0],
            names=tuple(rows[m].name for m in members),
            unit=_unit(flat, members[0], rows[members[0]]),
            load=name,
        )
        for (_, members), name in zip(groups, _free_names(flat), strict=False)
    )


def _free_names(flat: FlatModel) -> Iterator[str]:
    """`load_1`, `load_2` and so on, without those that the model has for a variable, a parameter or a
    component of its own."""
    variables = {v.name for v in (*flat.unknowns, *flat.inputs)} | set(flat.output_names)
    others = set(flat.parameter_names) | set(flat.noise_names)
    own = {name.split(".")[0].split("[")[0] for name in variables | others}
    return (name for name in (f"load_{i}" for i in count(1)) if name not in own)


def _rows(flat: FlatModel, node: Site) -> list[int]:
    """Equations that a load at the node enters: its balance of flows, or the bare equation itself."""
    return resolve_place(flat, node.connectors[0] if node.kind == "node" else node.name.partition(":")[0])


def _responses(
    flat: FlatModel, rows: Iterable[int], driven_by: Callable[[FlatModel, int], StateSpace | None]
) -> dict[int, np.ndarray]:
    """`_response` to what drives each of the `rows` that reaches the outputs."""
    driven = {row: space for row in rows if (space := driven_by(flat, row)) is not None}
    responses = {row: made for row, space in driven.items() if np.any(made := _response(space))}
    smooth = {row: made for row, made in responses.items() if not np.any(driven[row].H)}
    # White noise may not enter an output at once, a load of finite rate may. It does so where accelerations
    # alone are measured, or where nothing has a state.
    return smooth or responses


def _driven_by(flat: FlatModel, row: int) -> StateSpace | None:
    """State space with white noise in equation `row` alone; None where that would be differentiated."""
    w = ca.SX.sym("load")
    silent = _silent(flat)
    residual = ca.SX(silent.residual)
    residual[row] -= w
    return _as_space(replace(silent, noises=(NoiseInput("load", intensity=1.0),), w=w, residual=residual))


def _loaded_at(flat: FlatModel, row: int) -> StateSpace | None:
    """State space with a load of finite rate in equation `row` alone; None where it would be differentiated
    twice. Its time constant [s] does not count: places are compared at each frequency."""
    place = LoadPlace(row, (), "", next(_free_names(flat)))
    return _as_space(with_loads(_silent(flat), [place], [1.0]))


def _silent(flat: FlatModel) -> FlatModel:
    """The model without noises."""
    residual = ca.substitute(flat.residual, flat.w, ca.SX.zeros(flat.w.numel()))
    return replace(flat, noises=(), w=ca.SX(0, 1), residual=residual)


def _as_space(loaded: FlatModel) -> StateSpace | None:
    """None where a noise is differentiated. Where a slope is infinite at the start values, as that of the
    root between two levels that start alike, it is taken beside them."""
    try:
        made = state_space(family := state_space_family(loaded), loaded.theta_values)
        if _is_finite(made):
            return made
        made = state_space(
            state_space_family(loaded, _apart(loaded, family.state_names)), loaded.theta_values
        )
    except DaestError:
        return None
    return made if _is_finite(made) else None


def _is_finite(space: StateSpace) -> bool:
    return all(np.isfinite(matrix).all() for matrix in (space.A, space.C, space.G, space.H))


def _apart(flat: FlatModel, states: Sequence[str]) -> dict[str, float]:
    """Start values of the states that differ from each other, those above that are given."""
    starts = {v.name: v.start_or_zero for v in flat.unknowns if v.name in states}
    return {
        name: start + i * GATES.start_apart * (abs(start) or 1.0)
        for i, (name, start) in enumerate(starts.items(), start=1)
    }


def _response(space: StateSpace) -> np.ndarray:
    """C (iω - A)⁻¹ G + H at frequencies around the model's own, real and imaginary parts of all outputs."""
    rates = np.abs(np.linalg.eigvals(space.A)) if space.A.size else np.zeros(0)
    rates = rates[rates > GATES.integrator_rate * np.max(rates, initial=0.0)]
    low, high = (rates.min(), rates.max()) if rates.size else (1.0, 1.0)
    eye = np.eye(space.A.shape[0])
    parts = [
        space.C @ np.linalg.solve(1j * omega * eye - space.A, space.G[:, 0]) + space.H[:, 0]
        for omega in np.geomspace(low / GATES.compared_beyond, high * GATES.compared_beyond, N_FREQUENCIES)
    ]
    whole = np.concatenate(parts)
    return np.concatenate([whole.real, whole.imag])


def _sine(a: np.ndarray, b: np.ndarray) -> float:
    size = np.linalg.norm(a) * np.linalg.norm(b)
    cosine = abs(a @ b) / size if size > 0.0 else 1.0
    return float(np.sqrt(max(0.0, 1.0 - cosine**2)))


def _unit(flat: FlatModel, row: int, node: Site) -> str:
    """Of the flows in equation `row`, at the node; empty where it is not known."""
    if node.kind != "node":
        return flow_unit(flat, node)
    text = flat.equations[row].text
    for variable in flat.unknowns:
        if variable.is_flow and variable.name in text:
            return variable.unit
    return ""


def _unknown_of(place: LoadPlace) -> Variable:
    """The load at a place: a state whatever else the model is given. Between a spring that was put in and a
    damper it would follow from their motion, and nothing could tell its course by its name."""
    return Variable(place.load, place.unit, "unexplained load", start=0.0, fixed=False, state_select="kept")


def with_loads(flat: FlatModel, places: Sequence[LoadPlace], time_constants: Sequence[float]) -> FlatModel:
    """`flat` with d, der(d) + d/T = w, subtracted in the equation of each place and named as the place says.
    Noises of the model stay."""
    n = len(places)
    d, rate = ca.SX.sym("load", n), ca.SX.sym("load_rate", n)
    w, T = ca.SX.sym("load_w", n), ca.SX.sym("load_T", n)
    residual = ca.SX(flat.residual)
    rows = [place.row for place in places]
    for i, (row, factor) in enumerate(zip(rows, flows_in_rows(flat, rows), strict=True)):
        residual[row] -= factor * d[i]
    return replace(
        flat,
        unknowns=(
            *flat.unknowns,
            *(_unknown_of(place) for place in places),
        ),
        noises=(
            *flat.noises,
            *(NoiseInput(place.noise, None, estimate=True) for place in places),
        ),
        parameters=(
            *flat.parameters,
            *(
                Parameter(place.time_constant, float(value), "s", "time constant of the load", min=0.0)
                for place, value in zip(places, time_constants, strict=True)
            ),
        ),
        equations=(
            *flat.equations,
            *(
                Equation(f"der({p.load}) + {p.load}/{p.time_constant} = {p.noise}", "component", p.load)
                for p in places
            ),
        ),
        derivatives=ca.vertcat(flat.derivatives, rate),
        xi=ca.vertcat(flat.xi, d),
        w=ca.vertcat(flat.w, w),
        theta=ca.vertcat(flat.theta, T),
        residual=ca.vertcat(residual, rate + d / T - w),
    )
