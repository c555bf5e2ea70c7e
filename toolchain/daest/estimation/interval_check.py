"""Whether estimate ± 1.96 standard errors is an interval that the likelihood agrees with.

A standard error stands for a parabola: at the ends of its 95 % interval the log-likelihood, maximised over
everything else, is 1.92 below the best. With few data it may be anything. One evaluation at every end, where
the others follow by the information, tells; an end that looks wrong is looked at again with the others
searched for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from daest.estimation.profile import Searched, colour_factor, held_minimum, tangent
from daest.model.fit import FitResult, FittedParameter

TWO_SIDED = float(ndtri(0.975))  # standard errors to the end of a 95 % interval
# Share by which the root of the drop at an end may differ from that of a parabola: with 15 % more or less,
# 1.2 to 4.9 % lie beyond it instead of 2.5 %.
PARABOLIC = 0.15


NOT_QUADRATIC = "the likelihood is not quadratic in"


def with_interval_check(result: FitResult, search: Searched) -> FitResult:
    """The result with a note that names the parameters whose standard error makes no interval."""
    doubtful = doubtful_intervals(result, search)
    if not doubtful:
        return result
    listed, profiles = ", ".join(doubtful), " ".join(f"--profile {name}" for name in doubtful)
    note = (
        f"{NOT_QUADRATIC} {listed}: do not trust an interval of standard errors, "
        f"use the profile likelihood ({profiles})"
    )
    return replace(result, notes=(*result.notes, note))


def doubtful_intervals(result: FitResult, search: Searched) -> tuple[str, ...]:
    """Names of the parameters with a standard error whose 95 % interval the likelihood does not agree
    with."""
    names = search.unknowns.parameter_names()
    return tuple(
        p.name
        for p in result.parameters
        if p.std_error is not None
        and not p.at_bound
        and not _is_parabolic(result, search, names.index(p.name), p)
    )


def _is_parabolic(result: FitResult, search: Searched, index: int, parameter: FittedParameter) -> bool:
    coordinate, centre = search.unknowns.coordinates[index], search.found.z[index]
    factor = np.sqrt(colour_factor(result, search, index))
    for sign in (-1.0, 1.0):
        end = parameter.value + sign * TWO_SIDED * (parameter.std_error or 0.0)
        if not coordinate.lower < end < coordinate.upper:
            return False
        z = coordinate.searched(end)
        move = tangent(search.found.evaluation.information, index) * (z - centre)
        there = search.objective(np.clip(search.found.z + move, search.lower, search.upper), False)
        if there is not None and _is_expected(there.value - search.found.evaluation.value, factor):
            continue
        # The others may follow along a curve.
        followed = held_minimum(search, search.found, index, z)
        if followed is None or not _is_expected(
            followed.evaluation.value - search.found.evaluation.value, factor
        ):
            return False
    return True


def _is_expected(drop: float, factor: float) -> bool:
    """Whether a drop of the log-likelihood is what a parabola has at the end of its interval."""
    return abs(np.sqrt(2.0 * max(drop, 0.0)) / (TWO_SIDED * factor) - 1.0) <= PARABOLIC
