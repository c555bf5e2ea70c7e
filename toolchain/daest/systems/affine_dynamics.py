"""Models whose states and outputs follow affine laws, whatever the other variables do."""

from __future__ import annotations

import casadi as ca

from daest.model.flat import ExplicitModel
from daest.systems.linearize import is_affine, is_affine_model


def has_affine_dynamics(explicit: ExplicitModel) -> bool:
    """True when ẋ = f and y are affine in (x, u, v, w) with coefficients that do not depend on time. Exact.

    Less than `is_affine_model` asks: an unknown that parameters settle is no signal, though others are
    multiplied by it (a resistance at a fixed temperature), and one that no state and no output reads may be
    any function (the power that is lost in a damper)."""
    flat = explicit.flat
    if flat.events is not None:
        return False
    if flat.given is not None:
        return flat.given.has_affine_dynamics(flat)
    if is_affine_model(flat):
        return True
    if not explicit.is_symbolic:
        return False
    arguments = explicit.rhs.sx_in()
    *signals, _, time = arguments
    laws = ca.vertcat(explicit.rhs(*arguments), explicit.outputs(*arguments))
    return is_affine(laws, ca.vertcat(*signals), time)
