"""Trials: what the screen leaves to be refitted, and candidates built into the model for that."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from daest.diagnosis.built_in.settled import FAR, LOST
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.screening.clipping import SATURATION, Clip
from daest.model.diagnosis import Candidate, Proof, Screen
from daest.model.fit import FitResult
from daest.model.flat import ExplicitModel, FlatModel, with_equations
from daest.modelica.effects.attach import attach
from daest.modelica.places.place_units import units_at
from daest.systems.reduction.reduce import reduce_index

CUT = 0.99  # share of what is beyond the limit that a clipping sensor is taken to cut, at first
NEARLY = 0.9  # share of its full size, at first, of a law whose kinks are rounded widely
CLIPPED_WITHIN = 0.01  # of the limit, over which its edge is rounded in the screen
GENTLE = 0.1  # of the size by the screen, from which a search is tried again
SHARPEST = 0.01  # of the range over which the screen rounds kinks, below which no proof rounds them
SHARPER = 0.3  # the proof rounds kinks over this part of what the screen rounds them over


@dataclass(frozen=True)
class Trial:
    """A candidate, its sizes by the screen, and the places where these sensors would see it alike. One that
    leads the screen in open loop (`is_seen_in_use`) may show itself there alone. `promised` is the gain in
    log-likelihood that the screen foresees at its size."""

    candidate: Candidate
    sizes: tuple[float, ...]
    alike: tuple[Candidate, ...]
    is_seen_in_use: bool = False
    promised: float = 0.0


def trials(screen: Screen, level: float, most: int) -> tuple[Trial, ...]:
    """The best candidates that are significant at `level`, at most `most`, each at its best shape; the same
    effect at a place that the sensors see alike is the same trial. A law with states of its own waits where
    one without them has its response: where that leaves something, richer laws are tried. Shares of an input
    in a sensor stand beside those (`n_seats`), and only the first: there is one at every output for every
    input."""
    chosen: list[Trial] = []
    taken: set[int] = set()
    entries = screen.entries
    for i, entry in enumerate(entries):
        if _n_seated(chosen) == most:
            break
        if i in taken or entry.absorbed or entry.p_value > level:
            continue
        if entry.candidate.effect.is_of_driving and _n_seated(chosen) < len(chosen):
            continue
        effect = entry.candidate.effect.class_name
        same = [j for j in range(len(entries)) if entries[j].candidate.effect.class_name == effect]
        near = [j for j in same if abs(screen.correlation[i, j]) > GATES.same_place_correlation]
        own_site = [j for j in same if entries[j].candidate.site == entry.candidate.site]
        places = {entries[j].candidate.site.name: entries[j].candidate for j in near if j not in own_site}
        # Other shapes at a place that is taken are found by the refit.
        taken.update(near, own_site)
        taken.update(j for j in same if entries[j].candidate.site.name in places)
        if entry.candidate.effect.n_states and _has_bare_twin(screen, i):
            continue
        # Among places that the sensors see alike, the first of the model speaks for all.
        group = [entries[j] for j in (i, *near) if entries[j].score >= GATES.same_score * entry.score]
        first = min(group, key=lambda e: _position(e.candidate))
        places.setdefault(entry.candidate.site.name, entry.candidate)
        places.pop(first.candidate.site.name, None)
        promised = 0.5 * entry.score**2
        chosen.append(Trial(first.candidate, first.sizes, tuple(places.values()), promised=promised))
    return tuple(chosen)


def _n_seated(chosen: Sequence[Trial]) -> int:
    """How many trials take a seat from others."""
    return sum(not trial.candidate.effect.is_of_driving for trial in chosen)


def n_seats(wanted: Sequence[Trial], most: int) -> int:
    """How many of the first trials are refitted where `most` take a seat."""
    return next((n for n in range(len(wanted)) if _n_seated(wanted[: n + 1]) > most), len(wanted))


def _has_bare_twin(screen: Screen, number: int) -> bool:
    """Whether a candidate without states of its own, at the same place, has the response of an entry."""
    entries = screen.entries
    return any(
        other.candidate.site == entries[number].candidate.site
        and not other.candidate.effect.n_states
        and abs(screen.correlation[number, j]) > GATES.same_place_correlation
        for j, other in enumerate(entries)
    )


def moved(trial: Trial, number: int) -> Trial:
    """The trial at one of the places where the sensors would see it alike."""
    other = trial.alike[number]
    rest = (*trial.alike[:number], *trial.alike[number + 1 :])
    return replace(trial, candidate=other, alike=(trial.candidate, *rest))


def clipping_trials(
    null: Null, candidates: Sequence[Candidate], clipped: Mapping[str, Clip]
) -> tuple[Trial, ...]:
    """Sensors that may cut at the limits where the recordings are known to stay: `clipped`, by output."""
    found = []
    for candidate in candidates:
        clip = clipped.get(candidate.site.name)
        if candidate.effect.class_name != SATURATION or candidate.site.kind != "output":
            continue
        if clip is None or clip.is_certain or not clip.limit:
            continue
        reach = max(abs(clip.limit), 1e-12)
        shape = {
            p.name: reach * (CLIPPED_WITHIN if p.role == "sharpness" else 1.0)
            for p in candidate.effect.parameters
            if p.role in ("shape", "sharpness")
        }
        units = units_at(null.flat, candidate.effect, candidate.site)
        placed = replace(candidate, name=f"{candidate.name}_0", shape=shape, units=units)
        found.append(Trial(placed, (CUT,) * len(candidate.effect.sizes), ()))
    return tuple(found)


def _position(candidate: Candidate) -> tuple[int, ...]:
    """Place in the order of the search, which is that of the library and of the model."""
    return tuple(int(part) for part in candidate.name.split("_")[1:] if part.isdigit())


@dataclass(frozen=True)
class Prepared:
    """A candidate model ready for its search, which starts from the noise and the initial states of
    `similar`, if there is a fit of a simpler law, or of `simulation`, if it comes from one, or of `refit`, if
    it starts where the refit of the null has ended, else from the null's. One that `has_loop` is solved by
    iterations at every point, and takes longest. A refit below the log-likelihood `useless` says less than
    one of the same law that is known: it is not judged further. One that says less than the accepted
    `simpler` law, which it contains and was started from, is judged in brief. One that is `by_shooting`
    starts from a simulation by multiple shooting. `simulated` is the log-likelihood of the simulation that
    its values are from, if they are; `explicit` is the
    form of `flat`, if that was reduced before."""

    trial: Trial
    flat: FlatModel
    names: tuple[str, ...]
    similar: FitResult | None = None
    simulation: FitResult | None = None
    refit: FitResult | None = None
    has_loop: bool = False
    useless: float = -np.inf
    simpler: Proof | None = None
    by_shooting: bool = False
    simulated: float = -np.inf
    explicit: ExplicitModel | None = None

    def n_unknowns(self, estimated: Sequence[str]) -> int:
        """How much its fit is free in beside that of the model as it is, whose `estimated` ones are those."""
        return len(self.names) - len(estimated) + self.trial.candidate.n_memory

    def reduced(self) -> ExplicitModel:
        """The explicit form of the model. Raises what `reduce_index` raises."""
        return reduce_index(self.flat) if self.explicit is None else self.explicit


def prepare(
    flat: FlatModel, estimated: Sequence[str], trial: Trial, share: float = 1.0, sharper: float = SHARPER
) -> Prepared:
    """`flat` with the effect attached, sizes started from a `share` of the screen's estimate, kinks `sharper`
    than in the screen."""
    candidate = trial.candidate
    effect = candidate.effect
    sharp = {name: sharper * candidate.shape[name] for name in _kinks(candidate)}
    sizes = {
        p.name: (p.null or 0.0) + share * (size - (p.null or 0.0))
        for p, size in zip(effect.sizes, trial.sizes, strict=True)
    }
    inside = {p.name: _inside(sizes[p.name], p.min, p.max) for p in effect.sizes}
    values = {**candidate.shape, **sharp, **candidate.proved, **inside}
    grown = attach(
        flat, effect, candidate.site, candidate.name, values, candidate.inputs, candidate.input_units
    )
    return Prepared(trial, grown, (*estimated, *candidate.estimated))


def has_kinks(candidate: Candidate) -> bool:
    """Whether the law has a kink that the screen has rounded."""
    return bool(_kinks(candidate))


def _kinks(candidate: Candidate) -> list[str]:
    """The parameters of the law over which the screen has rounded its kinks."""
    return [
        p.name for p in candidate.effect.parameters if p.role == "sharpness" and p.name in candidate.shape
    ]


def with_kinks_bounded(flat: FlatModel, candidates: Sequence[Candidate]) -> FlatModel:
    """The model with bounds below the kinks of effects that are to be fitted: far within what lies between
    two samples recordings tell no kink from a sharper one, and integrators come to a stop at it."""
    least = {f"{c.name}.{name}": SHARPEST * c.shape[name] for c in candidates for name in _kinks(c)}
    parameters = tuple(
        replace(p, min=max(least[p.name], p.min or 0.0)) if p.name in least else p for p in flat.parameters
    )
    return replace(flat, parameters=parameters)


def _inside(value: float, low: float | None, high: float | None) -> float:
    """A start value off its bounds, since a search in logarithms cannot leave zero."""
    if low is not None and high is not None and not low < value < high:
        return low + (0.1 if value <= low else 0.9) * (high - low)
    if low is not None and value <= low:
        return low + 0.1 * max(abs(value), abs(low), 1e-3)
    if high is not None and value >= high:
        return high - 0.1 * max(abs(value), abs(high), 1e-3)
    return value


def at_full_size(null: Null, prepared: Prepared) -> tuple[Callable[[], Prepared], ...]:
    """Makers of the candidate near its full size, with the parameters that the null's search began with,
    rounded as in the screen and sharper; none for one that is not a share in what a sensor shows.

    Half a sensor of magnitude is worse than none, so that a search from a small share ends there; and beside
    loads that imitate a sensor, the null's parameters may have gone anywhere. A sharp kink makes a likelihood
    of many valleys."""
    trial, effect = prepared.trial, prepared.trial.candidate.effect
    is_share = all(p.is_share for p in effect.sizes)
    if trial.candidate.site.kind != "output" or not is_share or prepared.similar is not None:
        return ()
    begun = {p.name: p.initial for p in null.fit.parameters if p.name in null.estimated}
    flat, made = null.flat.with_theta(begun), []
    for sharper, share in ((1.0, NEARLY), (SHARPER, CUT)):
        nulls = [p.null or 0.0 for p in effect.sizes]
        sizes = tuple(low + share * (p.start - low) for p, low in zip(effect.sizes, nulls, strict=True))
        full = replace(trial, sizes=sizes)
        made.append(partial(prepare, flat, null.estimated, full, sharper=sharper))
    return tuple(made)


def from_simulation(prepared: Prepared, proof: Proof) -> Prepared | None:
    """The candidate of `proof` at its estimates without loads, where the refit beside them has lost a
    parameter that those keep: a load that is free enough does without an input, say, and nothing can be told
    of a model that has none. And with hardly any loads, where the refit has ended below those estimates,
    which it contains. None where nothing is lost."""
    if proof.final is None:
        return None
    is_below = proof.final.log_likelihood > proof.fit.log_likelihood + LOST
    names = _names_at(prepared, proof.candidate)
    kept = {name: proof.final.theta[name] for name in names if name in proof.final.theta}
    apart = [proof.fit.theta[name] / value for name, value in kept.items() if value]
    if not is_below and not any(0.0 < ratio < 1.0 / FAR for ratio in apart):
        return None
    trial = replace(prepared.trial, candidate=proof.candidate)
    started = replace(prepared, trial=trial, names=names, flat=with_equations(proof.flat, "a refit"))
    return replace(started_at(started, kept), simulation=proof.final if is_below else None)


def started_at(prepared: Prepared, values: Mapping[str, float]) -> Prepared:
    """The candidate with other values of parameters, within their bounds, to start its search from."""
    known = {p.name: p for p in prepared.flat.parameters}
    inside = {name: _inside(value, known[name].min, known[name].max) for name, value in values.items()}
    return replace(prepared, flat=prepared.flat.with_theta(inside), explicit=None)


def _names_at(prepared: Prepared, candidate: Candidate) -> tuple[str, ...]:
    """The parameters that are estimated where the law is the `candidate`, which may stand at another place
    that the sensors see alike."""
    own, there = f"{prepared.trial.candidate.name}.", f"{candidate.name}."
    return tuple(there + name.removeprefix(own) if name.startswith(own) else name for name in prepared.names)
