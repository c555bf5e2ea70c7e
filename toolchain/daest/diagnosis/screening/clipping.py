"""Sensors that are seen to clip in the recording itself.

Where a noisy signal stays at one and the same extreme value again and again, its sensor cuts there: nothing
that the machine does keeps the noise away. That needs no test against a model, and every further law is
looked for beside it; without it, a law that is missing besides makes the limit look wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.data.faults import Samples, column_findings, suspected_limits
from daest.diagnosis.gates import GATES
from daest.model.diagnosis import Candidate
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel
from daest.modelica.effects.attach import attach, components_with
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import sites

SATURATION = "Daest.Effects.Signals.Saturation"
CLIPPED = "clipped_"  # before the number of such a saturation
WITHIN = 0.003  # of the limit, over which the edge of the sensor is rounded


@dataclass(frozen=True)
class Clip:
    """The magnitude at which an output stays. `is_certain`: its noise ends there, so that the sensor cuts."""

    limit: float
    is_certain: bool = False


def clips_of(experiments: Sequence[Experiment]) -> dict[str, Clip]:
    """The limits at which outputs stay in the recordings, by output: those of each, and of all one after the
    other, since a sensor may come to its limit once in each of them."""
    found: dict[str, Clip] = {}
    for name in experiments[0].output_names if experiments else ():
        each = [_samples_of(name, [one]) for one in experiments]
        together = [_samples_of(name, experiments)] if len(experiments) > 1 else []
        clips = [clip for samples in (*each, *together) for clip in _clips(samples)]
        if clips:
            found[name] = max(clips, key=lambda one: (one.is_certain, one.limit))
    return found


def _samples_of(name: str, experiments: Sequence[Experiment]) -> Samples:
    """What is known of an output, one recording after the other."""
    times, values, end = [], [], 0.0
    for one in experiments:
        column = one.output(name)
        known = np.isfinite(column)
        times.append(one.time[known] - one.time[0] + end)
        values.append(column[known])
        end += float(one.time[-1] - one.time[0]) + one.median_step
    return Samples(name, "output", np.concatenate(times), np.concatenate(values))


def _clips(samples: Samples) -> list[Clip]:
    """Where a signal is seen to stay; where that is nowhere, where it may: noise and coarse steps spread what
    a limit piles up over the levels below it."""
    if not samples.values.size:
        return []
    seen = [one for one in column_findings(samples, 0) if one.code == "check-saturation"]
    is_certain = bool(seen) and samples.noise is not None
    times = [one.at for one in seen or suspected_limits(samples, GATES.min_tried_pile) if one.at is not None]
    values = samples.values[[int(np.argmin(np.abs(samples.time - at))) for at in times]]
    return [Clip(abs(float(value)), is_certain) for value in values]


@dataclass(frozen=True)
class Clipped:
    """A model whose sensors clip where the recordings show it, with the laws that were put in."""

    flat: FlatModel
    laws: tuple[Candidate, ...] = ()


def with_clipped_sensors(flat: FlatModel, library: Sequence[Effect], clips: Mapping[str, Clip]) -> Clipped:
    """`flat` with a saturation at every output that is certain to clip and has none yet. Its limit is read
    off the recording and not estimated: a model that lacks something else simulates beyond it."""
    effect = next((e for e in library if e.class_name == SATURATION), None)
    found = Clipped(flat)
    if effect is None:
        return found
    for site in sites(flat):
        clip = clips.get(site.name) if site.kind == "output" else None
        if (
            clip is None
            or not clip.is_certain
            or not clip.limit
            or components_with(flat, [(effect, site)])[0]
        ):
            continue
        name = f"{CLIPPED}{len(found.laws) + 1}"
        values = {"share": 1.0, "limit": clip.limit, "u_s": WITHIN * clip.limit}
        candidate = Candidate(effect, site, name, {n: values[n] for n in ("limit", "u_s")})
        candidate = replace(candidate, units=units_at(flat, effect, site))
        grown = attach(found.flat, effect, site, name, values)
        parameters = tuple(
            replace(p, estimate=False) if p.name.startswith(f"{name}.") else p for p in grown.parameters
        )
        found = Clipped(replace(grown, parameters=parameters), (*found.laws, candidate))
    return found


def share_at_limit(experiments: Sequence[Experiment], output: str, limit: float) -> float:
    """The share of the samples of an output that stand at the limit of its sensor."""
    values = np.concatenate([e.output(output) for e in experiments])
    values = values[np.isfinite(values)]
    return float(np.mean(np.abs(np.abs(values) - limit) <= WITHIN * limit)) if values.size else 0.0
