"""Potentials that are written out: a model whose state is what is stored, and that has no variable for the
potential, as `der(p) = F - d*p/m` has none for the speed p/m."""

from __future__ import annotations

import os
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np

from daest.model.flat import FlatModel
from daest.model.parts import Variable
from daest.modelica.flat.connectors import FLOWS, LEVEL
from daest.modelica.language.library import bundled_root
from daest.quantities import converts, dimensions, in_base_units, is_of

FLUX = "Wb"
# Unit of the rate of what is stored, and those that its potential may have; the current of a flux is as one.
_POTENTIALS = {
    FLOWS["translational"]: ("m/s",),
    FLOWS["rotational"]: ("rad/s",),
    FLOWS["thermal"]: ("K",),
    FLOWS["hydraulic"]: ("Pa", LEVEL),
    FLOWS["electrical"]: ("V",),
    f"{FLUX}/s": ("A",),
}
_TEMPERATURES = ("K", "degC")
_TOLERANCE = 1e-9  # relative, of numbers that rounding alone makes differ
_SEED = 20040102


def written_out(flat: FlatModel, slopes: np.ndarray, taken: Container[int]) -> dict[int, int]:
    """Unknown that is stored -> the parameter by which it is divided to be a potential, as their units and
    the equations tell: the momentum p -> the mass m where a row, or an output, has both as p/m alone. Not of
    those `taken`, whose potential is a variable. `slopes` (n, 2n) are of all equations."""
    n = slopes.shape[1] // 2
    stored = [i for i in np.flatnonzero(np.any(slopes[:, n:], axis=0)).tolist() if i not in taken]
    pairs = [(i, k) for i in stored for k in range(len(flat.parameters)) if potential_unit(flat, i, k)]
    told = [pair for pair, is_ratio in zip(pairs, _are_ratios(flat, pairs), strict=True) if is_ratio]
    several = {a for (a, _), (b, _) in pairwise(told) if a == b}
    return {i: k for i, k in told if i not in several}


def in_potentials(flat: FlatModel, ratios: Mapping[int, int]) -> FlatModel:
    """The model whose unknown is the potential itself, where `ratios` (of `written_out`) have what is stored
    and the parameter: `m*der(v) = F - d*v` of `der(p) = F - d*p/m`, v by the name `p/m`. It is no model to be
    simulated: start values and initial equations are those of what is stored."""
    if not ratios:
        return flat
    old, new, unknowns = [], [], list(flat.unknowns)
    for i, k in ratios.items():
        for symbol in (flat.xi[i], flat.derivatives[i]):
            old.append(symbol)
            new.append(symbol * flat.theta[k])
        unknowns[i] = potential(flat, i, k)
    laws = ca.vertcat(flat.residual, flat.output_expressions)
    changed = ca.substitute(laws, ca.vertcat(*old), ca.vertcat(*new))
    return replace(
        flat, unknowns=tuple(unknowns), residual=changed[: flat.n], output_expressions=changed[flat.n :]
    )


def potential(flat: FlatModel, stored: int, parameter: int) -> Variable:
    """What is stored over the parameter as a variable, which has the name of that expression; the unknown
    itself where the parameter is -1, for none."""
    variable = flat.unknowns[stored]
    if parameter < 0:
        return variable
    name = f"{variable.name}/{flat.parameters[parameter].name}"
    return replace(variable, name=name, unit=potential_unit(flat, stored, parameter))


def potential_symbol(flat: FlatModel, stored: int, parameter: int) -> ca.SX:
    """The expression of `potential`."""
    symbol = flat.xi[stored]
    return symbol if parameter < 0 else symbol / flat.theta[parameter]


def potential_unit(flat: FlatModel, stored: int, parameter: int) -> str:
    """The unit of the unknown `stored` over the `parameter` where that is a potential beside the flow in
    which the first is stored, or the current of a flux; empty where it is none."""
    unit, over = flat.unknowns[stored].unit, flat.parameters[parameter].unit
    flow = next((one for one in _POTENTIALS if unit and over and is_of(f"({unit})/s", one)), None)
    if flow is None:
        return ""
    ratio = dimensions(f"({unit})/({over})")
    found = next((one for one in _POTENTIALS[flow] if dimensions(one) == ratio), "")
    is_to_scale = bool(found) and np.isclose(in_base_units(unit), in_base_units(over), rtol=_TOLERANCE)
    if not is_to_scale:
        return ""
    return _temperature(flat) if found == "K" else found


def _temperature(flat: FlatModel) -> str:
    """The unit of all temperatures of the model, from whose zero heat over a capacity counts, too; empty
    where they have several. Those of effects in the model, which are absolute, tell nothing of its own."""
    effects = effects_in(flat)
    own = [x for x in flat.unknowns if x.name.partition(".")[0] not in effects]
    units = {x.unit for part in (own, flat.inputs, flat.outputs) for x in part}
    known = {unit for unit in units if is_of(unit, "K") and converts(unit, "K")}
    return known.pop() if len(known) == 1 and known <= {*_TEMPERATURES} else ""


def effects_in(flat: FlatModel) -> frozenset[str]:
    """The components of the model that are effects, or terms for them: those that were attached, and those
    that its text holds, as some of their variables are declared in these parts of the library."""
    root = bundled_root()
    if root is None:
        return flat.attached
    parts = tuple(str(root / "Daest" / name) + os.sep for name in ("Effects", "Terms"))
    declared = [x for x in flat.unknowns if x.place and str(x.place.file).startswith(parts)]
    return flat.attached.union(x.name.partition(".")[0] for x in declared)


def _are_ratios(flat: FlatModel, pairs: Sequence[tuple[int, int]]) -> list[bool]:
    """Whether some row or output has an unknown x and a parameter m as x/m alone: F(x/m) has
    x*∂F/∂x + m*∂F/∂m = 0, after Euler, with neither term zero."""
    if not pairs:
        return []
    everything = ca.vertcat(flat.xi, flat.derivatives)
    laws = ca.vertcat(flat.residual, flat.output_expressions)
    symbols = [everything, flat.u, flat.w, flat.theta, flat.time]
    slopes = ca.Function("slopes", symbols, [ca.jacobian(laws, flat.xi), ca.jacobian(laws, flat.theta)])
    rng = np.random.default_rng(_SEED)
    point = [rng.uniform(0.5, 1.5, x.numel()) for x in (everything, flat.u, flat.w)]
    by_unknowns, by_parameters = (np.array(one.full()) for one in slopes(*point, flat.theta_values, 0.7))
    found = []
    for i, k in pairs:
        by_x, by_m = by_unknowns[:, i] * point[0][i], by_parameters[:, k] * flat.theta_values[k]
        is_used = np.isfinite(by_x) & np.isfinite(by_m) & (by_x != 0.0)
        found.append(bool(np.any(is_used & (np.abs(by_x + by_m) < _TOLERANCE * np.abs(by_x)))))
    return found
