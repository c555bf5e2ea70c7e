"""Models with effects as subjects of a design: rivals of a diagnosis, and an effect that is to be seen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.design.detect import DetectAim
from daest.design.drawn import Required
from daest.design.explainer import Explainer, likely
from daest.design.loads import Loads
from daest.design.prepared import Subject, estimated_names, explainer
from daest.design.rivals import RivalAim
from daest.design.sensors import COMPONENT
from daest.design.signals import first_half
from daest.errors import EstimationError
from daest.model.design import Limits
from daest.model.effects import Effect, Placement, Site
from daest.model.flat import FlatModel, Model
from daest.modelica.effects.attach import attach_all

Loop = Callable[[Model], Model]  # puts a model into the loop of its controller
DRAWS = 4  # likely parameters of each rival beside the fitted ones, for the expectation


@dataclass(frozen=True)
class Rival:
    """A model that the data do not refuse: `flat` with the values of its fit and the noise that it leaves."""

    label: str
    flat: Model
    names: tuple[str, ...]  # of the parameters that were estimated


def with_effect(
    flat: FlatModel,
    effect: Effect,
    site: Site,
    values: Mapping[str, float],
    inputs: Mapping[str, str],
    name: str = COMPONENT,
) -> FlatModel:
    """The model with the effect at a place as component `name`; parameters without a value have their start
    value."""
    return attach_all(flat, [Placement(effect, site, name, values, inputs)], allow_repeated=True)


def leaving(flat: Model, rms: Mapping[str, float | None]) -> Model:
    """The model without process noise, whose outputs have the noise that a simulation left: what counts where
    models are told apart by what they simulate."""
    outputs = tuple(replace(y, noise_std=rms.get(y.name) or y.noise_std) for y in flat.outputs)
    return replace(flat, outputs=outputs, noises=tuple(replace(w, intensity=0.0) for w in flat.noises))


def rival_aim(
    rivals: Sequence[Rival],
    limits: Limits,
    recorded: Sequence[np.ndarray],
    margin: float,
    seed: int,
    draws: int = DRAWS,
) -> tuple[RivalAim, tuple[Subject, ...]]:
    """The aim of telling the rivals apart. All are judged with the noise that the best of them leaves. Raises
    EstimationError `design-no-rivals` for fewer than two. Shapes: recorded inputs (n_samples, n_u) each."""
    if len(rivals) < 2:
        raise EstimationError(
            "design-no-rivals",
            "there are no two rivals to be told apart",
            remedy='run daest diagnose first; its verdict "cannot tell" leaves rivals. --parameters and '
            "--detect design for other aims",
        )
    flats = _alike([rival.flat for rival in rivals])
    subjects = tuple(Subject(one, rival.names) for one, rival in zip(flats, rivals, strict=True))
    driven = tuple(explainer(subject, limits.period, limits.hold) for subject in subjects)
    truths = tuple(_truths(one, recorded, seed, draws) for one in driven)
    return RivalAim(tuple(r.label for r in rivals), driven, truths, margin), subjects


def _alike(flats: Sequence[Model]) -> list[Model]:
    """The models with the smallest noise that one of them leaves, by output."""
    every = np.array([[y.noise_std or np.nan for y in flat.outputs] for flat in flats])
    least = np.nanmin(every, axis=0) if np.any(np.isfinite(every)) else every[0]
    return [_with_stds(flat, least) for flat in flats]


def _with_stds(flat: Model, stds: np.ndarray) -> Model:
    pairs = zip(flat.outputs, stds.tolist(), strict=True)
    return replace(flat, outputs=tuple(replace(y, noise_std=std) for y, std in pairs))


def _truths(
    driven: Explainer, recorded: Sequence[np.ndarray], seed: int, draws: int
) -> tuple[np.ndarray, ...]:
    """The fitted parameters, and `draws` that are as likely as the recordings let them be."""
    home = np.array([c.searched(c.initial) for c in driven.coordinates])
    return (home, *likely(driven, recorded, seed, draws))


def detect_aim(
    flat: FlatModel,
    effect: Effect,
    site: Site,
    limits: Limits,
    recorded: Sequence[np.ndarray],
    *,
    size: float | None,
    required: Required,
    loads: Loads,
    loop: Loop = lambda flat: flat,
) -> tuple[DetectAim, tuple[Subject, ...]]:
    """The aim of seeing `effect` at a place of `flat`, through whose noises the `loads` act. `size` is that
    of its first size parameter (default: the smallest that the recorded halves show, else its start value).
    `loop` closes that of a controller. Raises EstimationError `design-no-size` for an effect without a size.
    Shapes: recorded inputs (n_samples, n_u) each."""
    sizes = [p for p in effect.sizes if p.start]
    if not sizes:
        raise EstimationError(
            "design-no-size",
            f"{effect.name} has no size that could be seen",
            remedy="give an effect with a size parameter: daest effects NAME shows them",
        )
    starts = np.array([p.start for p in sizes])
    values = dict(zip((p.name for p in sizes), starts.tolist(), strict=True))
    whole = with_effect(flat, effect, site, values, {})
    names = tuple(f"{COMPONENT}.{p.name}" for p in sizes)
    subjects = (Subject(loop(flat), estimated_names(flat)), Subject(loop(whole), names))
    null, other = (explainer(subject, limits.period, limits.hold) for subject in subjects)
    first = float(starts[0]) if size is None else size
    aim = DetectAim(null, other, starts, first, required, loads)
    if size is None and recorded:
        smallest = aim.smallest([first_half(inputs) for inputs in recorded])
        aim = replace(aim, size=smallest if np.isfinite(smallest) else first)
    return aim, subjects
