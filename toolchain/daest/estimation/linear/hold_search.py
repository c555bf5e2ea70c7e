"""Which inputs keep their value between samples, by the likelihood of short fits.

All inputs alike come first. Then one after the other is taken the other way, since a heating that is switched
may stand beside a temperature that runs straight; that some differ from others must gain more. Smooth curves
are tried where the recorded values themselves lie on such: where splines through every other sample foretell
the samples between them better than straight lines do, and where straight lines are likelier than held
values, which are half a sample away from both. Recorded steps are held unless straight lines fit better: a
parameter may stand for half a sample, as the resistance before a capacitor, and no likelihood tells the two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from daest.data.prepare import is_resampled
from daest.estimation.gates import FIT
from daest.model.experiment import Experiment
from daest.model.holds import ALIKE, FOH, HOLDS, SMOOTH, ZOH, Hold, held_inputs, mixed_hold, resampled

FEWEST_SMOOTH = 16  # samples of an input of which it is asked whether they lie on a smooth curve
MOST_TURNED = 6  # inputs that are taken the other way one after the other: each costs a short fit


def ranked_holds(
    names: Sequence[str],
    likelihood: Callable[[Hold], float | None],
    first: Sequence[Hold] = HOLDS,
    in_steps: bool = False,
) -> list[Hold]:
    """The holds that were tried, likeliest first; those without a `likelihood` (None) are left out. `names`
    are inputs that may differ from the others. Smooth curves are asked for where straight lines lead. Inputs
    that were recorded `in_steps` are held unless another hold fits clearly better."""
    values: dict[Hold, float] = {}

    def ask(hold: Hold) -> None:
        found = None if hold in values else likelihood(hold)
        if found is not None:
            values[hold] = found - (0.0 if hold in ALIKE else FIT.min_mixed_hold_gain)
            values[hold] += FIT.min_ramp_gain if in_steps and hold == ZOH else 0.0

    def best() -> Hold | None:
        return max(values, key=values.__getitem__, default=None)

    for hold in first:
        if not values or hold != SMOOTH or best() == FOH:
            ask(hold)
    for name in names if ZOH in values and len(names) > 1 else ():
        turned = best()
        if turned is not None and turned != SMOOTH:
            ask(with_turned(turned, name, names))
    return sorted(values, key=lambda hold: -values[hold])


def with_turned(hold: Hold, name: str, names: Sequence[str]) -> Hold:
    """The hold with which the input `name` alone does the other thing: kept, or on straight lines.

    >>> with_turned("zoh", "P", ("P", "T_outside"))
    'zoh(T_outside)'
    """
    held = {one for one, is_held in zip(names, held_inputs(hold, names), strict=True) if is_held}
    return mixed_hold(held ^ {name}, names)


def moving_inputs(experiments: Sequence[Experiment], names: Sequence[str]) -> tuple[str, ...]:
    """The inputs whose course depends on the hold: those that change, and of many the `MOST_TURNED` that
    change most from sample to sample."""
    rough = {name: max(_roughness(experiment.input(name)) for experiment in experiments) for name in names}
    moving = [name for name in names if rough[name] > 0.0]
    chosen = sorted(moving, key=lambda name: -rough[name])[:MOST_TURNED]
    return tuple(name for name in names if name in chosen)


def possible_holds(
    experiments: Sequence[Experiment], names: Sequence[str], needs_slopes: bool
) -> tuple[Hold, ...]:
    """The holds of all inputs alike that a recording may have, where its inputs `names` move: a model that
    `needs_slopes` is not driven by held ones."""
    smooth = (SMOOTH,) if are_smooth(experiments, names) else ()
    return ((FOH,) if needs_slopes else HOLDS) + smooth


def are_smooth(experiments: Sequence[Experiment], names: Sequence[str]) -> bool:
    """Whether the inputs `names`, all of which move, lie on smooth curves through their samples. Those that
    were made for straight lines when the recordings were resampled do not."""
    if not names or any(is_resampled(experiment) for experiment in experiments):
        return False
    return all(
        is_smooth(experiment.time, course)
        for experiment in experiments
        for course in (experiment.input(name) for name in names)
        if np.ptp(course) > 0.0
    )


def is_smooth(time: np.ndarray, course: np.ndarray) -> bool:
    """Whether splines through every other sample of a course (n_samples,) foretell those between them better
    by far than straight lines do."""
    known, asked = slice(0, None, 2), slice(1, -1, 2)
    if course.size < FEWEST_SMOOTH or not np.ptp(course[known]):
        return False
    by_curve, by_line = (
        resampled(course[known, None], time[known], time[asked], hold)[:, 0] for hold in (SMOOTH, FOH)
    )
    curve, line = (np.sum((course[asked] - foretold) ** 2) for foretold in (by_curve, by_line))
    return bool(curve <= FIT.max_smooth_error**2 * line)


def are_steps(experiments: Sequence[Experiment], names: Sequence[str]) -> bool:
    """Whether the inputs `names`, all of which move, stand still from most samples to the next: somebody set
    them. Those that were made for straight lines when the recordings were resampled are none."""
    if not names or any(is_resampled(experiment) for experiment in experiments):
        return False
    courses = (experiment.input(name) for experiment in experiments for name in names)
    return all(float(np.median(np.abs(np.diff(course)))) == 0.0 for course in courses)


def _roughness(course: np.ndarray) -> float:
    """Mean change between samples over the range of a course (n_samples,); 0 where it stands still."""
    width = float(np.ptp(course))
    return float(np.mean(np.abs(np.diff(course)))) / width if width > 0.0 else 0.0
