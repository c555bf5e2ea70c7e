"""Terminals among the outputs of a model: voltages such as `u = V0 - R*i` of a battery that an input current
flows through, where an effect can be put in series."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.model.flat import FlatModel
from daest.modelica.flat.factors import given_value, is_of_parameters
from daest.quantities import conversion, is_of

CURRENT, VOLTAGE = "A", "V"
_SEED, _POINTS, _DECADES = 20040101, 20, 6.0  # at which other variables change a resistance
_CONSTANT_PART = 0.01  # share of a resistance that is left whatever the size of what changes it; judgement


@dataclass(frozen=True)
class Terminal:
    """Output `output` is the voltage at which input `current` flows; `sign` is the factor with which the
    voltage over what is in series enters it. One V is `per_drop` of the unit of the output, and one of that
    of the input `per_flow` A."""

    output: int
    current: int
    sign: float
    per_drop: float = 1.0
    per_flow: float = 1.0

    def name(self, flat: FlatModel) -> str:
        return f"{flat.outputs[self.output].name}:{self.current_name(flat)}"

    def current_name(self, flat: FlatModel) -> str:
        return flat.inputs[self.current].name


def terminals(flat: FlatModel) -> list[Terminal]:
    """Outputs in volts that an input in amperes moves at once, by a resistance that is constant or has one
    sign wherever the machine is: that tells which way the current flows."""
    voltages = [j for j, y in enumerate(flat.outputs) if is_of(y.unit, VOLTAGE)]
    currents = [k for k, x in enumerate(flat.inputs) if voltages and is_of(x.unit, CURRENT)]
    found = [_terminal(flat, j, k) for j in voltages for k in currents]
    return [one for one in found if one is not None]


def _terminal(flat: FlatModel, output: int, current: int) -> Terminal | None:
    slope = ca.jacobian(_solved(flat, output), flat.u[current])
    constant = is_of_parameters(flat, slope)
    sign = np.sign(given_value(flat, slope)) if constant else _sign(flat, slope)
    if not sign:
        return None
    per_drop = conversion(VOLTAGE, flat.outputs[output].unit).scale
    per_flow = conversion(flat.inputs[current].unit, CURRENT).scale
    return Terminal(output, current, float(sign), per_drop, per_flow)


def _sign(flat: FlatModel, slope: ca.SX) -> float:
    """That of a resistance which other variables than the current change (the flow of an electrolyte, a state
    of charge), where it is the same for all their sizes, these being positive, and none makes it vanish: it
    has a constant part; 0 else."""
    if ca.depends_on(slope, ca.vertcat(flat.derivatives, flat.w, flat.time)):
        return 0.0
    evaluate = ca.Function("slope", [flat.xi, flat.u, flat.theta], [slope])
    rng = np.random.default_rng(_SEED)
    sizes = [[rng.uniform(-_DECADES, _DECADES, x.numel()) for x in (flat.xi, flat.u)] for _ in range(_POINTS)]
    points = [[np.zeros(x.numel()) for x in (flat.xi, flat.u)], *sizes]
    values = np.array([float(evaluate(10.0**xi, 10.0**u, flat.theta_values)) for xi, u in points])
    sign = float(np.sign(values[0]))
    return sign if np.all(sign * values > _CONSTANT_PART * abs(values[0])) else 0.0


def _solved(flat: FlatModel, output: int) -> ca.SX:
    """The output as an expression: where it is an unknown that a single row of the model gives and nothing
    else uses, by that row."""
    told = flat.output_expressions[output]
    named = [k for k in range(flat.n) if ca.is_equal(told, flat.xi[k])]
    if not named:
        return told
    own = flat.xi[named[0]]
    rows = [i for i in range(flat.n) if ca.depends_on(flat.residual[i], own)]
    if len(rows) != 1 or ca.depends_on(flat.residual, flat.derivatives[named[0]]):
        return told
    factor = ca.jacobian(flat.residual[rows[0]], own)
    return told - flat.residual[rows[0]] / factor if is_of_parameters(flat, factor) else told
