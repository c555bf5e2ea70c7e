"""Index reduction: FlatModel -> ExplicitModel ẋ = f(x, u, v, w, θ, t) with all internal variables."""

from __future__ import annotations

from functools import singledispatch

import casadi as ca
import numpy as np

from daest.model.flat import Dynamics, ExplicitModel, FlatModel, Model
from daest.systems.dummy_derivatives import DependentEquations
from daest.systems.expand import ExpandedSystem
from daest.systems.explicit_functions import assemble, expressions_of, refuse_differentiated_noise
from daest.systems.loops import Definitions, equations_at, solve_blocks
from daest.systems.pantelides import check_structure, differentiations, flat_signature
from daest.systems.regular import regular_system
from daest.systems.sample_point import SamplePoint, nudged, sample_point
from daest.systems.state_choice import StateChoice, choose_states, singular_after_reduction


@singledispatch
def dynamics(model: Model) -> Dynamics:
    """The form ẋ = f of a model, by which it is driven and filtered."""
    raise NotImplementedError(type(model).__name__)


def reduce_index(flat: FlatModel) -> ExplicitModel:
    """The explicit form of the model, states chosen among its own variables.

    Steps: alias elimination; Pantelides' differentiation counts; combinations of equations whose highest
    derivatives depend on each other (`systems.regular`); dummy derivatives with pivots chosen by
    value at the start point, such that `stateSelect`, then differentiated variables with (fixed) start values
    stay states; block lower triangular order; tearing. Linear loops are written out, nonlinear ones become
    Newton iterations.

    Raises ModelError: `structurally-singular`, `singular-after-reduction`, `noise-differentiated`."""
    sigma = flat_signature(flat)
    check_structure(sigma, flat.equations, flat.unknowns, flat.name)
    in_source = differentiations(sigma)
    system = regular_system(flat)
    point = sample_point(system)
    choice = choose_states(system, point)
    definitions = _solve(system, choice, point)
    parts = expressions_of(system, choice, definitions)
    refuse_differentiated_noise(system, parts, definitions)
    return assemble(system, choice, definitions, parts, in_source)


dynamics.register(FlatModel, reduce_index)


def _solve(system: ExpandedSystem, choice: StateChoice, point: SamplePoint) -> Definitions:
    solved, states = choice.solved, choice.states
    z = system.pick(solved)
    # What changes at events counts as known, not as a parameter: a coefficient that vanishes in some mode is
    # no pivot.
    memory = [i for i, p in enumerate(system.flat.parameters) if p.is_memory]
    steady = [i for i, p in enumerate(system.flat.parameters) if not p.is_memory]
    kept, tunable = (
        ca.vertcat(ca.SX(0, 1), *(system.flat.theta[i] for i in part)) for part in (memory, steady)
    )
    known = ca.vertcat(system.pick(states), *system.u, *system.w, system.flat.time, kept)
    n_theta = len(system.flat.parameters)

    def values(at: SamplePoint) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        plain, theta, time = np.split(at.others, [at.others.size - n_theta - 1, at.others.size - 1])
        return (
            np.array([at.z[k, j] for j, k in solved]),
            np.concatenate([[at.z[k, j] for j, k in states], plain, time, theta[memory]]),
            theta[steady],
        )

    equations = equations_at(system.residual, z, known, tunable, values(point))
    try:
        return solve_blocks(equations, equations.values)
    except DependentEquations as error:
        if not np.any(equations.varying):
            raise singular_after_reduction(system, [system.rows[r] for r in error.rows]) from error
        elsewhere = equations_at(system.residual, z, known, tunable, values(nudged(point)))
        try:
            return solve_blocks(equations, elsewhere.values)
        except DependentEquations as generic:
            raise singular_after_reduction(system, [system.rows[r] for r in generic.rows]) from generic
