"""The modes of a model with events: the one in which it starts, and the smooth model of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import DaestError, ModelError
from daest.lists import first_few
from daest.model.experiment import Experiment
from daest.model.flat import ExplicitModel, FlatModel
from daest.systems.events.event_functions import EventFunctions
from daest.systems.events.event_update import settled_start
from daest.systems.reduction.reduce import reduce_index

BOTH_STICK = (
    "Look for two elements with friction (bearing, brake, clutch, gear with losses) on one rigid part: where "
    "both stick, nothing tells which of them holds. Put a spring between them, or take one of them out; look "
    "for two paths that impose the same constraint, too."
)
MOST_MODES = 8  # modes that are tried as a first guess where the declared one is singular
MOST_TURNS = 5  # reductions, each at the mode that the one before has found


def in_starting_mode(flat: FlatModel, recording: Any = None, theta: np.ndarray | None = None) -> FlatModel:
    """The model with what keeps its value between events (`Parameter.is_memory`) as it is at the start.

    The reduced form of a model takes its pivots at the values of its parameters, so that the mode comes
    before the reduction; where it turns out otherwise the reduction is done again. A model without events is
    returned as it is. `recording` gives the first time and inputs (default: 0 and their start values). Raises
    ModelError `model-unsupported` for a model in which nothing is continuous. Shapes: theta (n_theta,).
    """
    if flat.events is None:
        return flat
    if flat.n == 0:
        raise ModelError(
            "model-unsupported",
            f"{flat.name} has discrete variables only; nothing in it is continuous",
            where=flat.source or None,
            remedy="Add the plant: a Real variable that an equation determines.",
        )
    values = flat.theta_values if theta is None else np.asarray(theta, dtype=float)
    t, u = _beginning(flat, recording)
    for _ in range(MOST_TURNS):
        explicit, values = _reduced(flat, values)
        functions = EventFunctions(explicit)
        ubar = np.concatenate([u, np.zeros(explicit.rhs.numel_in(2))])
        start = values.copy()
        _, mode = settled_start(functions, _as_declared(flat, start), ubar, t, None)
        if np.array_equal(mode.theta, values, equal_nan=True):
            break
        values = mode.theta
    return _with_memory(flat, values) if theta is None else _with_memory(_with_theta(flat, values), values)


def frozen(flat: FlatModel, values: np.ndarray | None = None) -> FlatModel:
    """The smooth model of one mode, without its events: what keeps its value between events is a number, that
    of `values` (n_theta,), by default of the model."""
    if flat.events is None:
        return flat
    values = flat.theta_values if values is None else values
    memory = [i for i, p in enumerate(flat.parameters) if p.is_memory]
    steady = [i for i, p in enumerate(flat.parameters) if not p.is_memory]
    symbols = ca.vertcat(ca.SX(0, 1), *[flat.theta[i] for i in memory])
    return replace(
        flat,
        parameters=tuple(replace(flat.parameters[i], value=float(values[i])) for i in steady),
        theta=ca.vertcat(ca.SX(0, 1), *[flat.theta[i] for i in steady]),
        events=None,
        **_with(flat, symbols, ca.SX(ca.DM(values[memory]))),
    )


def _with(flat: FlatModel, symbols: ca.SX, values: ca.SX) -> dict[str, Any]:
    """The expressions of the model, by field, with values in place of symbols."""
    names = ("residual", "output_expressions", "initial_residual")
    made = ca.substitute([getattr(flat, name) for name in names], [symbols], [values])
    return dict(zip(names, made, strict=True))


def without_noise(flat: FlatModel) -> FlatModel:
    """The model with every white noise at zero."""
    if not flat.noises:
        return flat
    none = ca.SX.zeros(flat.w.numel())
    events = flat.events
    if events is not None:
        names = [f.name for f in fields(events) if isinstance(getattr(events, f.name), ca.SX)]
        quiet = ca.substitute([getattr(events, name) for name in names], [flat.w], [none])
        changed: dict[str, Any] = dict(zip(names, quiet, strict=True))
        events = replace(events, **changed)
    return replace(flat, noises=(), w=ca.SX(0, 1), events=events, **_with(flat, flat.w, none))


def mode_slots(flat: FlatModel) -> list[int]:
    """The parameters whose values are the mode: relations, whole parts and discrete variables that equations
    or outputs contain."""
    events = flat.events
    assert events is not None
    slots = [one.slot for one in events.relations] + [one.slot for one in events.whole_parts]
    slots += [one.slot for one in events.assignments if one.slot >= 0]
    read = ca.vertcat(flat.residual, flat.output_expressions)
    return [slot for slot in dict.fromkeys(slots) if ca.depends_on(read, flat.theta[slot])]


def _reduced(flat: FlatModel, values: np.ndarray) -> tuple[ExplicitModel, np.ndarray]:
    """The reduced form at the mode in `values`, or, where that is singular, at the first other one that is
    not: two brakes on one shaft that both hold leave their torques open, and may not be the start at all."""
    assert flat.events is not None
    slots = [one.slot for one in flat.events.relations]
    rng = np.random.default_rng(0)
    for turn in range(MOST_MODES):
        try:
            return reduce_index(_with_memory(flat, values)), values
        except DaestError as error:
            if error.code != "singular-after-reduction":
                raise
            if turn == MOST_MODES - 1:
                raise ModelError(error.code, error.what, where=error.where, remedy=BOTH_STICK) from None
            values = values.copy()
            values[slots] = rng.integers(0, 2, len(slots))
    raise AssertionError


def _with_theta(flat: FlatModel, values: np.ndarray) -> FlatModel:
    pairs = zip(flat.parameters, values, strict=True)
    return replace(flat, parameters=tuple(replace(p, value=float(value)) for p, value in pairs))


def mode_text(flat: FlatModel, values: np.ndarray | None = None, slots: Sequence[int] | None = None) -> str:
    """The values of the discrete variables and relations, as `heat = 0, gear = 2`: those of the parameters
    `slots` (None: all) in `values` (n_theta,), by default in those of the model."""
    events = flat.events
    if events is None:
        return ""
    values = flat.theta_values if values is None else values
    named = [(one.slot, f"{one.name} = {values[one.slot]:g}") for one in events.assignments if one.slot >= 0]
    named += [
        (one.slot, f"{one.text}: {'true' if values[one.slot] > 0.5 else 'false'}") for one in events.relations
    ]
    named += [(one.slot, f"{one.text} = {values[one.slot]:g}") for one in events.whole_parts]
    shown = [text for slot, text in named if slots is None or slot in slots]
    return first_few(shown, MOST_SHOWN)


MOST_SHOWN = 8  # discrete variables and relations of a mode that are named


def _as_declared(flat: FlatModel, values: np.ndarray) -> np.ndarray:
    """The values with those start values that the source declares."""
    return np.array(
        [p.value if p.is_memory else value for p, value in zip(flat.parameters, values, strict=True)]
    )


def _with_memory(flat: FlatModel, values: np.ndarray) -> FlatModel:
    pairs = zip(flat.parameters, values, strict=True)
    return replace(flat, parameters=tuple(replace(p, value=v) if p.is_memory else p for p, v in pairs))


def _beginning(flat: FlatModel, recording: Any) -> tuple[float, np.ndarray]:
    names = flat.input_names
    if isinstance(recording, Experiment) and all(name in recording.input_names for name in names):
        return float(recording.time[0]), recording.inputs_of(names)[0]
    if isinstance(recording, tuple):
        time, u = (np.asarray(part, dtype=float) for part in recording)
        return float(time[0]), u.reshape(time.size, -1)[0]
    return 0.0, np.array([v.start_or_zero for v in flat.inputs])
