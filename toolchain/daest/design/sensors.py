"""Which additional measurement would serve an aim, among all variables of the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from daest.design.aims import Aim, ParameterAim
from daest.design.explainer import Explainer
from daest.design.prepared import Subject, explainer, with_rows
from daest.errors import DaestError
from daest.model.design import Limits, SensorGain
from daest.modelica.change import declare
from daest.modelica.closed_loop import CONTROLLER

ASIDE = 0.03  # change of the search coordinates at which variables are compared
EQUAL = 1e-9  # of its largest value: signals that differ by less are the same
STILL = 1e-9  # of its size: a variable that moves less does not move
MOST_SENSORS = 40
COMPONENT = "effect"  # of a rival: what is inside of it is no variable of the machine
KNOWN = (COMPONENT, CONTROLLER)  # components that no sensor is put into
USUAL_NOISE = 0.01  # of the motion, where the present sensors tell none


def sensor_gains(
    aim: Aim,
    subjects: Sequence[Subject],
    limits: Limits,
    inputs: np.ndarray,
    noise: Mapping[str, float],
    commanded: Sequence[str] = (),
) -> tuple[SensorGain, ...]:
    """The aim with one more sensor, best first, for every variable that moves with these inputs. Its noise is
    that of `noise` by name, else it has the share of the motion that the present sensors' noise has on
    average. Empty where the models have no such variables in common. `commanded`: variables that a controller
    sets, and which are known therefore. Shapes: inputs (n_samples, n_u)."""
    groups = _groups(aim.driven[0], inputs, noise, commanded)
    names = [group[0] for group in groups]
    moved = dict(zip(names, _motion(aim.driven[0], inputs, names), strict=True))
    share = _usual_share(aim.driven[0], subjects[0], inputs)
    stds = {n: noise.get(n, share * moved[n]) for n in names}
    try:
        wide = [_widened(subject, stds, limits) for subject in subjects]
    except DaestError:
        return ()
    n_y = len(subjects[0].flat.outputs)
    units = {v.name: v.unit for v in subjects[0].flat.unknowns}
    before, was_open = _value(aim, wide, range(n_y), inputs), _is_open(aim, wide, range(n_y), inputs)
    found = []
    for i, group in enumerate(groups):
        rows = [*range(n_y), n_y + i]
        value = _value(aim, wide, rows, inputs)
        if value is None or before is None:
            continue
        gain = value / before if aim.higher_is_better else before / value
        closes = was_open and not _is_open(aim, wide, rows, inputs)
        found.append(SensorGain(group, units[group[0]], float(stds[group[0]]), value, gain, closes))
    return tuple(sorted(found, key=lambda one: (not one.closes, -one.gain)))


def _value(aim: Aim, wide: Sequence[Explainer], rows: Sequence[int], inputs: np.ndarray) -> float | None:
    merit = aim.watching([with_rows(one, rows) for one in wide]).merit(inputs)
    return aim.value(merit) if np.isfinite(merit) else None


def _is_open(aim: Aim, wide: Sequence[Explainer], rows: Sequence[int], inputs: np.ndarray) -> bool:
    """Whether parameters stay undetermined with these outputs."""
    if not isinstance(aim, ParameterAim):
        return False
    left = aim.watching([with_rows(one, rows) for one in wide]).open_directions([inputs])
    return any(np.isinf(direction.relative_std) for direction in left)


def _widened(subject: Subject, stds: Mapping[str, float], limits: Limits) -> Explainer:
    """The model with all these variables as outputs, after its own."""
    own = subject.flat.output_names
    flat = declare(subject.flat, outputs=[*own, *stds])
    outputs = tuple(
        y if i < len(own) else replace(y, noise_std=stds[y.name]) for i, y in enumerate(flat.outputs)
    )
    return explainer(
        replace(subject, flat=replace(flat, outputs=outputs), unknown_noise=False),
        limits.period,
        limits.hold,
    )


def _groups(
    driven: Explainer, inputs: np.ndarray, noise: Mapping[str, float], commanded: Sequence[str]
) -> list[tuple[str, ...]]:
    """Variables that move and are neither inputs, commanded nor outputs, those that are the same but for
    their sign together; those with a given noise first.

    What is proportional is not the same: where the factor is unknown, a sensor tells it. They are compared
    at other parameters than those of the fit, where a factor may happen to be one.
    """
    home = driven.start(inputs).z
    at = driven.start(inputs, home + ASIDE * np.cos(np.arange(home.size)))
    values, taken = driven.variables(inputs, at), np.hstack([inputs, driven.outputs(inputs, at)])
    names = list(driven.variable_names)
    taken = np.hstack([taken, values[:, [names.index(name) for name in commanded]]])
    groups: list[list[int]] = []
    for column, name in enumerate(names):
        own = values[:, column]
        is_wanted = name in noise or not any(_are_same(own, other) for other in taken.T)
        if name.partition(".")[0] in KNOWN or not _moves(own) or not is_wanted:
            continue
        group = next((g for g in groups if _are_same(values[:, g[0]], own)), None)
        if group is None:
            groups.append([column])
        else:
            group.append(column)
    order = sorted(groups, key=lambda g: not any(names[i] in noise for i in g))
    return [_leading([names[i] for i in g], noise) for g in order[:MOST_SENSORS]]


def _are_same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two signals agree but for their sign."""
    least = min(float(np.max(np.abs(one - other))), float(np.max(np.abs(one + other))))
    return least <= EQUAL * float(np.max(np.abs(one)))


def _moves(values: np.ndarray) -> bool:
    return bool(np.std(values) > STILL * np.max(np.abs(values), initial=0.0))


def _leading(group: list[str], noise: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(sorted(group, key=lambda name: (name not in noise, name.count("."), len(name))))


def _motion(driven: Explainer, inputs: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Standard deviation of the variables, (n,)."""
    values = driven.variables(inputs, driven.start(inputs))
    every = list(driven.variable_names)
    return np.std(values[:, [every.index(name) for name in names]], axis=0)


def _usual_share(driven: Explainer, subject: Subject, inputs: np.ndarray) -> float:
    """Noise of the present sensors relative to the motion of what they measure, the geometric mean."""
    motion = np.std(driven.outputs(inputs, driven.start(inputs)), axis=0)
    std = np.array([y.noise_std for y in subject.flat.outputs], dtype=float)
    moves = motion > 0.0
    return float(np.exp(np.mean(np.log(std[moves] / motion[moves])))) if np.any(moves) else USUAL_NOISE
