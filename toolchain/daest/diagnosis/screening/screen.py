"""Screen: the score of every candidate effect on the whitened innovations of the null, in one pass.

All candidates are attached to the null model at once with size zero (`responses`), and all scores are judged
together (`scores`).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.candidates import attachable, in_shapes, with_possible_values, without_shape
from daest.diagnosis.screening.clipping import CLIPPED
from daest.diagnosis.screening.responses import (
    grown_along,
    loads_rescaled,
    nuisance,
    responses_to,
    size_names,
)
from daest.diagnosis.screening.scores import scored
from daest.diagnosis.screening.size_slopes import Sizes, sizes_of
from daest.errors import EstimationError
from daest.model.diagnosis import Candidate, Screen
from daest.model.flat import ExplicitModel
from daest.modelica.effects.attach import components_with
from daest.numerics.parallel import Workers, called
from daest.systems.linear.linearize import has_affine_dynamics

ALONE = "has states that do not follow the model alone"  # why an effect is skipped
NO_SOLUTION = "its equations have no solution along the recordings"
MOST_SENT = 1 << 24  # numbers (128 MiB) of the responses that another process makes


def screen(
    null: Null,
    run: NullObserver,
    candidates: Sequence[Candidate],
    seed: int = 0,
    pool: Workers | None = None,
) -> Screen:
    """Scores of all candidates at their best shapes, best first. Candidates that change the order of the
    model, or that cannot be attached, are listed as skipped with the reason. The `pool` may take a part.

    Raises EstimationError `diagnose-no-candidate`.
    """
    present = already_there(null, candidates)
    regular = [c for c, there in zip(candidates, present, strict=True) if not there and not c.is_dynamic]
    fitted = "fitted by simulation, not screened"
    if not has_affine_dynamics(null.explicit):
        fitted = "fitted by simulation where nothing else is accepted"
    skipped = [
        (c.label, there or f"changes the order of the model: {fitted}")
        for c, there in zip(candidates, present, strict=True)
        if c not in regular
    ]
    contained = {c.label for c, there in zip(candidates, present, strict=True) if there}
    with_states = [c for c in regular if c.effect.n_states and not c.keeps_order]
    following = _following(null, run, with_states)

    def without(left: Sequence[Candidate]) -> Screen:
        others = [(c.label, ALONE) for c in left]
        wanted = [c for c in regular if c not in left]
        among = (seed, len(candidates), pool or Workers())
        found = _screened(null, run, wanted, [*skipped, *others], *among)
        return _without_sums(found, contained)

    if following:
        with suppress(EstimationError):
            return without([c for c in with_states if c not in following])
    return without(with_states)


def _without_sums(found: Screen, contained: set[str]) -> Screen:
    """The screen without effects that are another one here: sums of effects, all but one of which the model
    contains or its parameters do, or which the recordings do not tell from the first of them. Friction in
    one direction is dry friction beside a constant load that is estimated, and on a wheel that turns in this
    direction alone, as damping in one direction is viscous friction. At a place that the sensors do not tell
    from such a one it is the same."""
    done = contained | {entry.candidate.label for entry in found.entries if entry.absorbed}
    at = {entry.candidate.label: i for i, entry in enumerate(found.entries)}
    alike = np.abs(found.correlation) > GATES.same_place_correlation
    others: dict[str, str] = {}
    for i, entry in enumerate(found.entries):
        effect, place = entry.candidate.effect, entry.candidate.site.name
        parts = [f"{name} at {place}" for name in effect.sum_of]
        left = [part for part in parts if part not in done]
        plain = f"{effect.one_way} at {place}"
        if parts and len(left) == 1 and left[0] in at:
            reason = f"the model as it is makes it the same as {left[0]}"
            others |= {
                other.candidate.label: reason
                for other, is_alike in zip(found.entries, alike[i], strict=True)
                if is_alike and other.candidate.effect is effect
            }
        elif parts and parts[0] in left and parts[0] in at and alike[i, at[parts[0]]]:
            others[entry.candidate.label] = f"these recordings do not tell it from {parts[0]}"
        elif plain in at and alike[i, at[plain]]:
            others[entry.candidate.label] = f"these recordings do not tell it from {plain}"
    keep = [i for i, entry in enumerate(found.entries) if entry.candidate.label not in others]
    return replace(found.only(keep), skipped=(*found.skipped, *others.items()))


def _following(null: Null, run: NullObserver, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those of the candidates with states whose states follow those of the model: all, or all of an effect
    where those of another one do not."""
    if not candidates or _follow_the_model(null, run, candidates):
        return list(candidates)
    names = dict.fromkeys(c.effect.class_name for c in candidates)
    if len(names) == 1:
        return []
    kinds = [[c for c in candidates if c.effect.class_name == name] for name in names]
    return [c for kind in kinds if _follow_the_model(null, run, kind) for c in kind]


def _follow_the_model(null: Null, run: NullObserver, candidates: Sequence[Candidate]) -> bool:
    """Whether the states of effects follow those of the model, as far as these effects alone tell: they are
    few, and what all candidates together would tell takes as long as the screen."""
    explicit = attachable(null.flat, candidates)[2]
    try:
        grown_along(null, run, explicit)
    except EstimationError:
        return False
    return True


def _screened(
    null: Null,
    run: NullObserver,
    static: Sequence[Candidate],
    skipped: Sequence[tuple[str, str]],
    seed: int,
    n_all: int,
    pool: Workers,
) -> Screen:
    # States that effects bring beside those that the model has already leave others no place for theirs.
    groups = [[c for c in static if c.keeps_order is kept] for kept in (False, True)]
    parts = [part for group in groups if group for part in _in_models(null, run, group, pool)]
    usable = tuple(chain.from_iterable(part.candidates for part in parts))
    refused = tuple(chain.from_iterable(part.refused for part in parts))
    if not usable and len(static) == n_all:
        raise EstimationError(
            "diagnose-no-candidate",
            "no effect of the library fits any place of this model",
            remedy="name effects and places (--effect, --at), or see `daest effects`",
        )
    if not usable:
        return Screen((), np.zeros((0, 0)), 1.0, 0, (*skipped, *refused))
    responses = np.concatenate([part.responses for part in parts if part.candidates])
    ends = np.cumsum([0, *(len(c.effect.sizes) for c in usable)]).tolist()
    columns = [slice(begin, end) for begin, end in pairwise(ends)]
    directions = nuisance(run, len(null.estimated))
    rescaling = np.vstack([directions, loads_rescaled(null, run)])
    return scored(
        usable,
        columns,
        run.whitened,
        directions,
        rescaling,
        responses,
        (*skipped, *refused),
        seed,
    )


@dataclass(frozen=True)
class _Responding:
    """Candidates at their shapes, the `responses` (k, m) of the whitened innovations to their sizes, and what
    cannot be attached with the reason; `left` are those that cannot be beside the others."""

    candidates: tuple[Candidate, ...]
    responses: np.ndarray
    refused: tuple[tuple[str, str], ...]
    left: tuple[Candidate, ...] = ()


def _in_models(
    null: Null, run: NullObserver, static: Sequence[Candidate], pool: Workers
) -> list[_Responding]:
    """What candidates do to the innovations. Those that cannot be attached beside the others, such as a
    capacity at a node where every branch has got an inductance, are in further models."""
    part = _responding(null, run, static, pool)
    if not part.left or len(part.left) == len(static):
        return [part]
    names = {c.label for c in part.left}
    others = tuple(pair for pair in part.refused if pair[0] not in names)
    return [replace(part, refused=others), *_in_models(null, run, part.left, pool)]


def _responding(null: Null, run: NullObserver, static: Sequence[Candidate], pool: Workers) -> _Responding:
    """The candidates with a shape for each that is worth trying, and what each does to the innovations.

    All shapes of an effect without states are values of its parameters in one model. One with states has a
    component for every shape: along the motion its states differ. These are one task, which takes about as
    long as what came before it."""
    began = time.monotonic()
    first, filtered = null.experiments[0], run.observed[0].filtered
    states = dict(zip(run.state_names, filtered.T, strict=True))
    usable, refused, explicit = attachable(null.flat, static)
    left = tuple(c for c in static if c not in usable)
    along_first = (explicit, first.time, states, first.inputs, run.observed[0].whitened)
    shaped = in_shapes(null.flat, usable, *along_first)
    pairs = [(c, one) for c, several in zip(usable, shaped, strict=True) for one in several]
    own = [one for c, one in pairs if c.effect.n_states]
    beside = [partial(_in_own_components, null, run, own)]
    seconds = time.monotonic() - began if own and _may_be_sent(run, own) else 0.0
    pool.begin(called, beside, seconds=seconds)
    in_one = _in_one_model(null, run, explicit, [pair for pair in pairs if not pair[0].effect.n_states])
    in_own = next(pool.map(called, beside, seconds=seconds)).get()
    refused = (*refused, *without_shape(usable, shaped))
    return replace(_in_order([one.name for _, one in pairs], (in_one, in_own), refused), left=left)


def _may_be_sent(run: NullObserver, shaped: Sequence[Candidate]) -> bool:
    """Whether the responses to candidates are few enough to come from another process."""
    return sum(len(c.effect.sizes) for c in shaped) * run.whitened.size <= MOST_SENT


def _in_one_model(
    null: Null,
    run: NullObserver,
    explicit: ExplicitModel,
    pairs: Sequence[tuple[Candidate, Candidate]],
) -> _Responding:
    """Pairs of a candidate that `explicit` contains, without states of its own, and one of its shapes."""
    kept, refused = with_possible_values([shaped for _, shaped in pairs])
    if not kept:
        return _Responding((), np.zeros((0, run.whitened.size)), refused)
    base = {shaped.name: candidate for candidate, shaped in pairs}
    sizes = _sizes_in(explicit, [(base[one.name], one) for one in kept])
    return _Responding(kept, responses_to(null, run, explicit, sizes), refused)


def _sizes_in(explicit: ExplicitModel, pairs: Sequence[tuple[Candidate, Candidate]]) -> Sizes:
    """The sizes of shaped candidates in a model that contains each once: at the parameters of their shapes,
    of which a value holds one of every effect."""
    column = {p.name: i for i, p in enumerate(explicit.flat.parameters)}
    names: list[str] = []
    at: list[int] = []
    values = [explicit.flat.theta_values.copy()]
    numbers: dict[str, int] = {}
    for candidate, shaped in pairs:
        number = numbers[candidate.name] = numbers.get(candidate.name, -1) + 1
        if number == len(values):
            values.append(explicit.flat.theta_values.copy())
        for name, value in shaped.shape.items():
            values[number][column[f"{candidate.name}.{name}"]] = value
        names += size_names(candidate)
        at += [number] * len(candidate.effect.sizes)
    return Sizes(tuple(names), np.array(at, dtype=int), np.array(values))


def _in_own_components(null: Null, run: NullObserver, shaped: Sequence[Candidate]) -> _Responding:
    usable, refused, explicit = attachable(null.flat, shaped) if shaped else ((), (), null.explicit)
    if not usable:
        return _Responding((), np.zeros((0, run.whitened.size)), refused)
    names = [name for c in usable for name in size_names(c)]
    try:
        responses = responses_to(null, run, explicit, sizes_of(explicit, names))
    except RuntimeError:  # a loop of equations that has no solution along the recordings
        if len(usable) == 1:
            refused = (*refused, (usable[0].label, NO_SOLUTION))
            return _Responding((), np.zeros((0, run.whitened.size)), refused)
        middle = len(usable) // 2
        parts = [_in_own_components(null, run, half) for half in (usable[:middle], usable[middle:])]
        return _in_order([c.name for c in usable], parts, refused)
    return _Responding(usable, responses, refused)


def _in_order(
    names: Sequence[str], parts: Sequence[_Responding], refused: Sequence[tuple[str, str]]
) -> _Responding:
    """The parts as one, their candidates in the order of `names`."""
    candidates = [c for part in parts for c in part.candidates]
    ends = np.cumsum([0, *(len(c.effect.sizes) for c in candidates)]).tolist()
    place = {name: i for i, name in enumerate(names)}
    order = sorted(range(len(candidates)), key=lambda i: place[candidates[i].name])
    rows = [row for i in order for row in range(ends[i], ends[i + 1])]
    responses = np.concatenate([part.responses for part in parts])[rows]
    whole = tuple(chain(refused, *(part.refused for part in parts)))
    return _Responding(tuple(candidates[i] for i in order), responses, whole)


def already_there(null: Null, candidates: Sequence[Candidate]) -> list[str]:
    """Of every candidate, which component of the model says what a second one at the same place would say:
    one with the same equations whose parameters are estimated, or the limit of a sensor that is seen to clip.
    Empty where there is none."""
    fitted = {name.partition(".")[0] for name in null.estimated}
    found = components_with(null.flat, [(c.effect, c.site) for c in candidates])
    peers = [
        next((name for name in names if name in fitted or name.startswith(CLIPPED)), "") for names in found
    ]
    return [f"the model contains it already: `{peer}`" if peer else "" for peer in peers]
