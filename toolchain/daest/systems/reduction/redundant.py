"""The explicit form on all differentiated variables, for models whose choice of states is not good
everywhere.

Dummy derivatives leave as many states as the model has degrees of freedom; where the constraints are
nonlinear, that choice becomes singular on the way (a pendulum in Cartesian coordinates passing the
horizontal). Here every variable that occurs differentiated stays a state. Only the highest derivatives are
solved for, which is regular wherever the model is; the constraints and their derivatives are invariants of
the flow, 0 = g(x), to which computed states are pulled back (Hairer & Wanner, Solving ODEs II, section VII.2,
projection).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from daest.model.flat import Dynamics, ExplicitModel, FlatModel
from daest.systems.reduction.expand import (
    ExpandedSystem,
    SamplePoint,
    check_structure,
    differentiations,
    flat_signature,
    nudged,
    sample_point,
)
from daest.systems.reduction.loops import Definitions, equations_at, regular_system, solve_blocks
from daest.systems.reduction.reduce import ARGUMENTS, assemble, expressions_of, refuse_differentiated_noise
from daest.systems.reduction.state_choice import (
    DependentEquations,
    StateChoice,
    choose_states,
    depends_on_place,
    singular_after_reduction,
)


def needs_redundant_states(flat: FlatModel) -> bool:
    """Whether states have to be chosen among variables whose constraint depends on where the model is."""
    system = regular_system(flat)
    return depends_on_place(system, choose_states(system, sample_point(system)))


def good_everywhere(explicit: Dynamics) -> Dynamics:
    """The model itself, or on all differentiated variables where its choice of states could become singular
    on the way. States that no equations of ours have chosen stay."""
    if not isinstance(explicit, ExplicitModel) or explicit.invariants is not None:
        return explicit
    return redundant_model(explicit.flat) if needs_redundant_states(explicit.flat) else explicit


def redundant_model(flat: FlatModel) -> ExplicitModel:
    """The model on all its differentiated variables with the `invariants` that tie them, independently
    wherever the model is regular; variables that a constraint gives directly as a derivative of another state
    (x' = v) are left out. Errors as `reduce_index`."""
    sigma = flat_signature(flat)
    check_structure(sigma, flat.equations, flat.unknowns, flat.name)
    system = regular_system(flat)
    choice = StateChoice(np.zeros_like(system.counts.unknowns), system.counts.unknowns)
    top = [row for row, (i, k) in enumerate(system.rows) if k == system.counts.equations[i]]
    lower = [row for row, (i, k) in enumerate(system.rows) if k < system.counts.equations[i]]
    definitions = _solve(system, choice, top, sample_point(system))
    parts = expressions_of(system, choice, definitions)
    refuse_differentiated_noise(system, parts, definitions)
    explicit = assemble(system, choice, definitions, parts, differentiations(sigma))
    v = ca.vertcat(ca.SX(0, 1), *(system.u[d.order][d.index] for d in explicit.input_derivatives))
    symbols = [system.pick(choice.states), flat.u, v, flat.w, flat.theta, flat.time]
    invariants = ca.Function(
        "invariants", symbols, [ca.densify(system.residual[lower])], ARGUMENTS, ["value"]
    )
    return _without_copies(explicit, invariants, [k for _, k in choice.states])


def _solve(system: ExpandedSystem, choice: StateChoice, rows: list[int], point: SamplePoint) -> Definitions:
    """Definitions of the highest derivatives from the equations differentiated most often."""
    z = system.pick(choice.solved)
    known = ca.vertcat(system.pick(choice.states), *system.u, *system.w, system.flat.time)
    n_theta = len(system.flat.parameters)

    def values(at: SamplePoint) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        plain, theta, time = np.split(at.others, [at.others.size - n_theta - 1, at.others.size - 1])
        solved = np.array([at.z[k, j] for j, k in choice.solved])
        return solved, np.concatenate([[at.z[k, j] for j, k in choice.states], plain, time]), theta

    equations = equations_at(system.residual[rows], z, known, system.flat.theta, values(point))
    elsewhere = equations_at(system.residual[rows], z, known, system.flat.theta, values(nudged(point)))
    try:
        return solve_blocks(equations, elsewhere.values)
    except DependentEquations as error:
        raise singular_after_reduction(system, [system.rows[rows[r]] for r in error.rows]) from error


def _without_copies(explicit: ExplicitModel, invariants: ca.Function, orders: list[int]) -> ExplicitModel:
    """Leave out states that are derivatives and that an invariant with constant coefficients gives from
    others."""
    arguments = invariants.sx_in()
    x, g = arguments[0], invariants(*arguments)
    whole, rows = ca.SX(x), list(range(g.numel()))
    kept = list(range(x.numel()))
    for j in [j for j, order in enumerate(orders) if order > 0]:
        for r in rows:
            slope = ca.jacobian(g[r], x[j])
            if slope.is_constant() and abs(float(slope)) > 0.0:
                value = -ca.substitute(g[r], x[j], 0) / slope
                whole, g = (ca.substitute(part, x[j], value) for part in (whole, g))
                rows.remove(r)
                kept.remove(j)
                break
    of_kept = ca.Function("whole", [x[kept], *arguments[1:]], [whole])
    held = ca.Function("invariants", [x[kept], *arguments[1:]], [ca.densify(g[rows])], ARGUMENTS, ["value"])

    def reduced(function: ca.Function, chosen: list[int] | None = None) -> ca.Function:
        inner: Any = of_kept.sx_in() if explicit.is_symbolic else of_kept.mx_in()
        value = function(of_kept(*inner), *inner[1:])
        result = value if chosen is None else value[chosen]
        return ca.Function(function.name(), inner, [result], ARGUMENTS, ["value"])

    return replace(
        explicit,
        state_names=tuple(explicit.state_names[j] for j in kept),
        state_units=tuple(explicit.state_units[j] for j in kept),
        rhs=reduced(explicit.rhs, kept),
        variables=reduced(explicit.variables),
        variable_derivatives=reduced(explicit.variable_derivatives),
        outputs=reduced(explicit.outputs),
        invariants=held,
        near=None,
        of_tears=None,
    )


def matching_states(
    chosen: Dynamics, redundant: Dynamics, x: np.ndarray, xi: np.ndarray, arguments: tuple
) -> np.ndarray:
    """The states of the redundant model where the other one has states x and internal variables xi.
    Shapes: x (n_x,), xi (n_xi,)."""
    names = chosen.flat.unknown_names
    known = dict(zip(names, xi, strict=True))
    rates = np.array(chosen.variable_derivatives(x, *arguments)).ravel()
    known.update({f"der({name})": rate for name, rate in zip(names, rates, strict=True)})
    return np.array([known[name] for name in redundant.state_names])
