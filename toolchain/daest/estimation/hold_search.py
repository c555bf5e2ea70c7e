"""Which inputs keep their value between samples, by the likelihood of short fits.

All inputs alike come first. Then one after the other is taken the other way, since a heating that is switched
may stand beside a temperature that runs straight; that some differ from others must gain more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from daest.estimation.gates import FIT
from daest.model.experiment import Experiment
from daest.model.holds import HOLDS, Hold, held_inputs, mixed_hold

MOST_TURNED = 6  # inputs that are taken the other way one after the other: each costs a short fit


def ranked_holds(
    names: Sequence[str], likelihood: Callable[[Hold], float | None], first: Sequence[Hold] = HOLDS
) -> list[Hold]:
    """The holds that were tried, likeliest first; those without a `likelihood` (None) are left out. `names`
    are inputs that may differ from the others."""
    values: dict[Hold, float] = {}

    def ask(hold: Hold) -> None:
        found = None if hold in values else likelihood(hold)
        if found is not None:
            values[hold] = found - (0.0 if hold in HOLDS else FIT.min_mixed_hold_gain)

    for hold in first:
        ask(hold)
    for name in names if values and len(names) > 1 else ():
        ask(_turned(max(values, key=values.__getitem__), name, names))
    return sorted(values, key=lambda hold: -values[hold])


def _turned(hold: Hold, name: str, names: Sequence[str]) -> Hold:
    """The hold with which the input `name` alone does the other thing."""
    held = {one for one, is_held in zip(names, held_inputs(hold, names), strict=True) if is_held}
    return mixed_hold(held ^ {name}, names)


def moving_inputs(experiments: Sequence[Experiment], names: Sequence[str]) -> tuple[str, ...]:
    """The inputs whose course depends on the hold: those that change, and of many the `MOST_TURNED` that
    change most from sample to sample."""
    rough = {name: max(_roughness(experiment.input(name)) for experiment in experiments) for name in names}
    moving = [name for name in names if rough[name] > 0.0]
    chosen = sorted(moving, key=lambda name: -rough[name])[:MOST_TURNED]
    return tuple(name for name in names if name in chosen)


def _roughness(course: np.ndarray) -> float:
    """Mean change between samples over the range of a course (n_samples,); 0 where it stands still."""
    width = float(np.ptp(course))
    return float(np.mean(np.abs(np.diff(course)))) / width if width > 0.0 else 0.0
