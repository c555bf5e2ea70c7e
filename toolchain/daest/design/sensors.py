"""Which additional measurement would serve an aim, among all variables of the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from daest.design.aims import Aim
from daest.design.explainer import Explainer
from daest.design.prepared import Subject, explainer, with_rows
from daest.errors import DaestError
from daest.model.design import Limits, SensorGain
from daest.modelica.change import declare

PROPORTIONAL = 1.0 - 1e-9  # correlation of variables that are the same up to a factor and an offset
STILL = 1e-9  # of its size: a variable that moves less does not move
MOST_SENSORS = 24
COMPONENT = "effect"  # of a rival: what is inside of it is no variable of the machine
USUAL_NOISE = 0.01  # of the motion, where the present sensors tell none


def sensor_gains(
    aim: Aim,
    subjects: Sequence[Subject],
    limits: Limits,
    inputs: np.ndarray,
    noise: Mapping[str, float],
) -> tuple[SensorGain, ...]:
    """The aim with one more sensor, best first, for every variable that moves with these inputs. Its noise is
    that of `noise` by name, else it has the share of the motion that the present sensors' noise has on
    average. Empty where the models have no such variables in common."""
    groups = _groups(aim.driven[0], limits, inputs, noise)
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
    before = _value(aim, wide, range(n_y), inputs)
    found = []
    for i, group in enumerate(groups):
        value = _value(aim, wide, [*range(n_y), n_y + i], inputs)
        if value is None or before is None:
            continue
        gain = value / before if aim.higher_is_better else before / value
        found.append(SensorGain(group, units[group[0]], stds[group[0]], value, gain))
    return tuple(sorted(found, key=lambda one: -one.gain))


def _value(aim: Aim, wide: Sequence[Explainer], rows: Sequence[int], inputs: np.ndarray) -> float | None:
    merit = aim.watching([with_rows(one, rows) for one in wide]).merit(inputs)
    return aim.value(merit) if np.isfinite(merit) else None


def _widened(subject: Subject, stds: Mapping[str, float], limits: Limits) -> Explainer:
    """The model with all these variables as outputs, after its own."""
    own = [y.name for y in subject.flat.outputs]
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
    driven: Explainer, limits: Limits, inputs: np.ndarray, noise: Mapping[str, float]
) -> list[tuple[str, ...]]:
    """Variables that move and are neither inputs nor outputs, those that are the same up to a factor
    together; those with a given noise first."""
    at = driven.start(inputs)
    values, taken = driven.variables(inputs, at), np.hstack([inputs, driven.outputs(inputs, at)])
    names = list(driven.variable_names)
    scaled, known = _scaled(values), _scaled(taken)
    free = (np.linalg.norm(scaled, axis=0) > 0.5) & ~np.any(np.abs(scaled.T @ known) > PROPORTIONAL, axis=1)
    free |= np.array([name in noise for name in names])
    free &= ~np.array([name.startswith(f"{COMPONENT}.") for name in names])
    groups: list[list[int]] = []
    for column in np.flatnonzero(free):
        home = (g for g in groups if abs(scaled[:, g[0]] @ scaled[:, column]) > PROPORTIONAL)
        group = next(home, None)
        if group is None:
            groups.append([int(column)])
        else:
            group.append(int(column))
    order = sorted(groups, key=lambda g: not any(names[i] in noise for i in g))
    return [_leading([names[i] for i in g], noise) for g in order[:MOST_SENSORS]]


def _leading(group: list[str], noise: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(sorted(group, key=lambda name: (name not in noise, name.count("."), len(name))))


def _scaled(values: np.ndarray) -> np.ndarray:
    """Columns around their means, of length one; zero where a variable does not move."""
    moves = values - values.mean(axis=0)
    length = np.linalg.norm(moves, axis=0)
    still = ~(length > STILL * np.maximum(np.linalg.norm(values, axis=0), 1e-300))
    return np.where(still, 0.0, moves / np.where(length > 0.0, length, 1.0))


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
