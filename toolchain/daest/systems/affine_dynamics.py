"""Models whose states and outputs follow affine laws, whatever the other variables do."""

from __future__ import annotations

from functools import singledispatch

import casadi as ca

from daest.model.flat import Dynamics, ExplicitModel
from daest.systems.linearize import is_affine, is_affine_model


@singledispatch
def has_affine_dynamics(explicit: Dynamics) -> bool:
    """True when ẋ = f and y are affine in (x, u, v, w) with coefficients that do not depend on time. Exact.

    Less than `is_affine_model` asks: an unknown that parameters settle is no signal, though others are
    multiplied by it (a resistance at a fixed temperature), and one that no state and no output reads may be
    any function (the power that is lost in a damper)."""
    raise NotImplementedError(type(explicit).__name__)


@has_affine_dynamics.register
def _of_equations(explicit: ExplicitModel) -> bool:
    flat = explicit.flat
    if flat.events is not None:
        return False
    if is_affine_model(flat):
        return True
    if not explicit.is_symbolic:
        return False
    arguments = explicit.rhs.sx_in()
    *signals, _, time = arguments
    laws = ca.vertcat(explicit.rhs(*arguments), explicit.outputs(*arguments))
    return is_affine(laws, ca.vertcat(*signals), time)
