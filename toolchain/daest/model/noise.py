"""NoiseReport: which equations of a linear DAE may carry white noise, and why not. Report, section 3.2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from daest.lists import first_few
from daest.model.linear import RankDecision
from daest.model.parts import Equation
from daest.model.shown import Framed, Listing


@dataclass(frozen=True)
class NoisePlace:
    """The verdict on one white noise: on a single equation, or on a noise of the model (a column of B).

    `equations` are row indices, counted from 0. `projection_norm` is |(I - M M⁺) b| / |b| of (41), for the
    equations as they stand. Where the noise is not admissible, `differentiated` names the unknowns that would
    contain its derivatives, up to the derivative `order`; for the equations of a report only the first of the
    `n_differentiated`, for places that were asked for, and for noises of the model, all. `white_outputs` are
    outputs that would contain the noise itself, undifferentiated: it then belongs into their measurement
    noise too, (47).
    """

    name: str
    equations: tuple[int, ...]
    admissible: bool
    projection_norm: float
    order: int
    differentiated: tuple[str, ...]
    white_outputs: tuple[str, ...]
    advice: str
    n_differentiated: int = 0


@dataclass(frozen=True)
class GenericVerdict:
    """The verdict by exact arithmetic, without tolerances: `of` almost every value of the `parameters`, or,
    where the equations contain none, of the `numbers` in them. `forbidden` are equations, `noises` the names
    of those noises of the model that are not admissible."""

    of: Literal["parameters", "numbers"]
    index: int
    n_dynamic: int
    forbidden: tuple[int, ...]
    noises: tuple[str, ...]


@dataclass(frozen=True)
class Difference:
    """A difference between this report and the `GenericVerdict`: `what` is the index, the number of dynamic
    modes, the `equations` that are forbidden in one of them alone, or the `noises`; `reason` is a
    sentence."""

    what: Literal["index", "n_dynamic", "equations", "noises"]
    reason: str
    equations: tuple[int, ...] = ()
    noises: tuple[str, ...] = ()


@dataclass(frozen=True)
class NoiseReport(Framed):
    """Theorem 3.1 for every equation, for every noise of the model and for the places that were asked for.

    `places` has one entry per entry of `equations`. `N_singular_values` are those of N in (24), zeros for the
    dropped ones; `decisions` holds every rank decision, the one between admissible and forbidden equations
    last. `tolerance` is the projection norm up to which an equation was called admissible, None for the
    default decision, which does not depend on units. `generic` is the exact verdict (None where there is
    none: no equations, or numbers that are results of rounding), `differences` tell where the verdict at
    these numbers is another one, and `undecided` what rounding errors could turn.
    """

    equations: tuple[Equation, ...]
    places: tuple[NoisePlace, ...]
    annotated: tuple[NoisePlace, ...]
    asked: tuple[NoisePlace, ...]
    n_dynamic: int
    index: int
    N_singular_values: tuple[float, ...]
    decisions: tuple[RankDecision, ...]
    tolerance: float | None = None
    generic: GenericVerdict | None = None
    differences: tuple[Difference, ...] = ()
    undecided: tuple[str, ...] = ()

    @property
    def n_forbidden(self) -> int:
        """How many equations may not carry white noise."""
        return sum(not place.admissible for place in self.places)

    @property
    def all_admissible(self) -> bool:
        """True when every noise of the model and every place that was asked for is admissible."""
        return all(place.admissible for place in (*self.annotated, *self.asked))

    def tables(self) -> tuple[Listing, ...]:
        title = f"{self.n_forbidden} of {len(self.equations)} equations may not carry white noise"
        columns = ("equation", "text", "admissible", "projection norm", "differentiated")
        rows = tuple(
            (i, equation.text, place.admissible, place.projection_norm, _differentiated(place))
            for i, (equation, place) in enumerate(zip(self.equations, self.places, strict=True))
        )
        # What is forbidden is what a reader looks for.
        ordered = tuple(sorted(rows, key=lambda row: row[2]))
        return (Listing(title, columns, ordered),)


def _differentiated(place: NoisePlace) -> str:
    return first_few(place.differentiated, len(place.differentiated), place.n_differentiated)


@dataclass(frozen=True)
class NoisePlaceAlong:
    """The verdicts on one white noise at the points of a trajectory: the shares of points where it is not
    admissible, the first of these in time (s) with its verdict, and the largest projection norm. `at_start`
    is the verdict at the first point."""

    name: str
    equations: tuple[int, ...]
    at_start: bool
    forbidden_share: float
    first_time: float | None
    verdict: NoisePlace
    largest_norm: float

    @property
    def admissible(self) -> bool:
        """At every point."""
        return self.forbidden_share == 0.0

    @property
    def is_mixed(self) -> bool:
        """Admissible at some points and not at others."""
        return 0.0 < self.forbidden_share < 1.0


@dataclass(frozen=True)
class NoiseMode:
    """Theorem 3.1 in one mode of a model with events: `mode` in words, the `share` of the samples and the
    `first_time` [s] at which it occurs, the structure there, how many equations are forbidden at some point
    in it, and which of the noises of the model and of the places that were asked for. `structures` is empty
    where the linearised model is not regular at any point of the mode."""

    mode: str
    share: float
    first_time: float
    structures: tuple[tuple[int, int], ...]
    n_forbidden: int
    forbidden: tuple[str, ...]


@dataclass(frozen=True)
class NoiseAlong:
    """Theorem 3.1 at points along a trajectory. `places`, `annotated` and `asked` as in NoiseReport.

    `times` are those of the points judged; `unjudged` those where the linearised model is not regular, with
    the reason. `structures` are the pairs (n_dynamic, index) that occur; one pair with `same_everywhere` for
    an affine model, which needs no trajectory. `generic` is the exact verdict that holds at most points,
    `generic_points` their number; None where there is none at any point. `modes` are those of a model with
    events that occur, in the order in which they do."""

    times: tuple[float, ...]
    unjudged: tuple[tuple[float, str], ...]
    structures: tuple[tuple[int, int], ...]
    places: tuple[NoisePlaceAlong, ...]
    annotated: tuple[NoisePlaceAlong, ...]
    asked: tuple[NoisePlaceAlong, ...]
    same_everywhere: bool
    generic: GenericVerdict | None = None
    generic_points: int = 0
    modes: tuple[NoiseMode, ...] = ()

    @property
    def all_admissible(self) -> bool:
        """True when every noise of the model and every place that was asked for is so at every point."""
        return not self.unjudged and all(place.admissible for place in (*self.annotated, *self.asked))
