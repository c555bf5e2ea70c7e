"""See from its values that an output was measured at fewer times than it has samples.

Where loggers of different rates are put together, the slower one is interpolated to the rows of the faster
one. Its values between two readings are no measurements: they have no noise of their own, and what a filter
takes for the machine is the straight line.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daest.data.faults import Samples, last_digit
from daest.data.limits import DATA
from daest.model.experiment import Finding


def interpolated(samples: Samples, others: Sequence[np.ndarray]) -> list[Finding]:
    """An output that runs on straight lines between every so many samples, while `others`, the columns (n,),
    change within them. A machine that an input drives straight on has its kinks where that input changes, one
    that runs to and fro has few different slopes, and readings in steps have no kinks beyond these."""
    values = samples.values
    if samples.role != "output" or values.size < DATA.told_values:
        return []
    bends = np.abs(np.diff(values, 2))
    rounding = max(2.0 * last_digit(values), DATA.straight * float(np.ptp(values)))
    kinks = np.flatnonzero(bends > rounding) + 1
    if kinks.size < DATA.told_values or np.median(bends[kinks - 1]) < DATA.kink * rounding:
        return []
    lengths = np.diff(kinks)
    every = int(np.median(lengths))
    usual = float(np.mean(np.abs(lengths - every) <= 1))
    slopes = np.diff(values[kinks]) / lengths
    n_slopes = np.unique(np.round(slopes / rounding)).size
    if every < 2 or usual < DATA.usual_line or n_slopes <= DATA.switch_levels or _explained(kinks, others):
        return []
    period = float(np.median(np.diff(samples.time[kinks])))
    share = 1.0 - (kinks.size + 2) / values.size
    text = (
        f"runs on straight lines between every {every} samples ({period:.4g} {samples.clock}): {share:.0%} "
        "of them are interpolated, and no readings"
    )
    first = float(samples.time[kinks[0]])
    return [Finding("check-interpolated", "warning", samples.name, text, first, values.size - kinks.size - 2)]


def _explained(kinks: np.ndarray, others: Sequence[np.ndarray]) -> bool:
    """Whether one of the `others`, columns (n,), moves at the `kinks`, indices (n_kinks,), and hardly
    between."""
    for other in others:
        moves = np.flatnonzero(np.diff(other) != 0)
        if moves.size <= DATA.usual_line * kinks.size:
            continue
        if any(np.mean(np.isin(moves, kinks + late)) > DATA.usual_line for late in (-1, 0, 1)):
            return True
    return False
