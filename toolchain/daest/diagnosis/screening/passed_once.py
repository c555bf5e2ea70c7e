"""Springs on a way that no recording goes back on.

A drum coasts down. Its model has a speed and no position; a spring counts one from where each recording
begins, and with a place of its own it gives nearly any course over that way, so over time, and over the speed
that falls with it. What it says is said by friction, which needs no such place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from daest.modelica.places.balances import balances, needs_position

if TYPE_CHECKING:
    from collections.abc import Sequence

    from daest.diagnosis.null_model.null_observer import NullObserver
    from daest.model.diagnosis import Candidate
    from daest.model.effects import Effect

PASSED_ONCE = (
    "the model has no position there, and no recording comes back to one: any course in time is as good"
)


def back_on_their_way(
    run: NullObserver, candidates: Sequence[Candidate]
) -> tuple[tuple[Candidate, ...], tuple[tuple[str, str], ...]]:
    """The candidates without those over positions that the model has not and no recording comes back to, and
    the labels of these with the reason; all of them where nothing else is left."""
    places = _one_way_places(run)
    over = [c for c in candidates if c.site.name in places and _is_over_places(c.effect)]
    if len(over) == len(candidates):
        return tuple(candidates), ()
    left = tuple(c for c in candidates if c not in over)
    return left, tuple((c.label, PASSED_ONCE) for c in over)


def _one_way_places(run: NullObserver) -> set[str]:
    """Balances of a speed whose position the model does not have, in which no recording turns back."""
    flat, names = run.null.flat, run.state_names
    found: set[str] = set()
    for balance in balances(flat):
        speed, domain = flat.unknowns[balance.variable].name, balance.domain(flat)
        if domain is None or not needs_position(domain) or balance.position >= 0 or speed not in names:
            continue
        courses = [observed.filtered[:, names.index(speed)] for observed in run.observed]
        if all((course >= 0.0).all() or (course <= 0.0).all() for course in courses):
            found.add(balance.name(flat))
    return found


def _is_over_places(effect: Effect) -> bool:
    """Whether a law has a place of its own along the way, as a spring has where it is relaxed: not a period,
    which comes back, and not the length of a state that follows the motion."""
    return not effect.n_states and any(
        p.role == "shape" and p.estimate and p.scale_of in ("phi", "s") and not p.periods_over
        for p in effect.parameters
    )
