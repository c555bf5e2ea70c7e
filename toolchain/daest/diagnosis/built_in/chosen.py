"""The candidates that a diagnosis looks at: effects at places, and columns of the recordings as causes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from daest.diagnosis.built_in.certainty import bends
from daest.diagnosis.built_in.dead_times import DELAY
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.candidates import pairs
from daest.estimation.fitting.signals import is_constant
from daest.model.diagnosis import Candidate
from daest.model.effects import Effect, Site
from daest.model.experiment import Experiment
from daest.model.flat import Model
from daest.quantities import is_temperature

MEASURED_INPUT = "Daest.Effects.General.MeasuredInput"
NYQUIST = 2.0  # samples in the shortest period that they tell


def chosen_candidates(
    library: Sequence[Effect],
    places: Sequence[Site],
    experiments: Sequence[Experiment],
    options: DiagnoseOptions,
    taken: Collection[str] = (),
    unused: Sequence[str] = (),
    temperatures: Collection[str] = (),
    input_units: Mapping[str, str] | None = None,
) -> tuple[Candidate, ...]:
    """The effects of the library at the places where they fit, those that `options` name, under names that
    are not `taken`. What is recorded and does nothing in the model may be what a law needs: columns, and
    `unused` inputs, which have `input_units`. No dead time of the one output of a model whose inputs keep
    their levels: what runs by itself is as late where it began elsewhere. Nothing with states of its own at
    an input that is zero, and no bend at one that takes no more than two values: between them any law is a
    gain with an offset. No law of a sensor that is hardly ever read, unless it is asked for: through a few
    samples many laws go. No recorded temperature is added to one of the signals `temperatures`: such a sum
    has no meaning, since it is another one in K as in degC."""
    library = [_within_samples(effect, experiments) for effect in library]
    recorded = [*unused, *experiments[0].extra]
    columns = [name for name in recorded if _is_new_signal(name, experiments, unused)]
    units = {**(input_units or {}), **_agreed_units(experiments)}
    whole = pairs(library, places, columns, taken, _driving(experiments, unused), units)
    none = {
        name for name in experiments[0].input_names if not any(np.any(e.input(name)) for e in experiments)
    }
    two = {name for name in experiments[0].input_names if _n_values(experiments, name) <= 2}
    moves = not all(is_constant(u) for e in experiments for u in e.inputs.T)
    runs_by_itself = not moves and len(experiments[0].output_names) == 1
    rare = set() if options.places else _rarely_read(experiments)
    return tuple(
        c
        for c in whole
        if not (c.site.kind == "input" and c.site.name in unused)
        and not (c.site.kind == "output" and c.site.name in rare)
        and not (runs_by_itself and c.effect.class_name == DELAY and c.site.kind == "output")
        and not (c.site.kind == "input" and c.is_dynamic and c.site.name in none)
        and not (c.site.kind == "input" and c.site.name in two and bends(c))
        and not (c.site.name in temperatures and _adds_temperature(c, experiments))
        and (
            {c.effect.name, c.effect.class_name} & set(options.effects)
            or not (options.effects or c.effect.is_rival)
        )
        and (not options.places or {c.site.name, *c.site.aliases} & set(options.places))
    )


def _agreed_units(experiments: Sequence[Experiment]) -> dict[str, str]:
    """The units of columns that all recordings tell alike."""
    first = experiments[0].extra_units
    return {n: u for n, u in first.items() if all(e.extra_units.get(n) == u for e in experiments)}


def temperatures_of(flat: Model) -> set[str]:
    """The inputs and outputs of a model that are temperatures, where any input is one: else those of the
    model may be differences, to which a recorded one is added."""
    inputs = {x.name for x in flat.inputs if is_temperature(x.unit)}
    return inputs | {y.name for y in flat.outputs if is_temperature(y.unit)} if inputs else set()


def _adds_temperature(candidate: Candidate, experiments: Sequence[Experiment]) -> bool:
    columns = candidate.inputs.values() if candidate.effect.class_name == MEASURED_INPUT else ()
    return any(is_temperature(experiments[0].extra_units.get(name, "")) for name in columns)


def _rarely_read(experiments: Sequence[Experiment]) -> set[str]:
    """The outputs with too few samples to tell a law of their sensors by."""
    counts = sum(np.isfinite(e.outputs).sum(axis=0) for e in experiments)
    names = experiments[0].output_names
    return {name for name, count in zip(names, counts, strict=True) if count < GATES.min_of_sensor}


def _driving(experiments: Sequence[Experiment], unused: Sequence[str]) -> list[str]:
    """The inputs that do something in the model and move in every recording."""
    names = [name for name in experiments[0].input_names if name not in unused]
    return [name for name in names if not any(is_constant(e.input(name)) for e in experiments)]


def _n_values(experiments: Sequence[Experiment], name: str) -> int:
    """How many values an input takes in all recordings."""
    return len(np.unique(np.concatenate([e.input(name) for e in experiments])))


def _within_samples(effect: Effect, experiments: Sequence[Experiment]) -> Effect:
    """The effect, with periods of time that pass in two samples or more: a search that loses its way makes
    them ever shorter, each integration takes longer, and no sample tells them."""
    if not any(p.is_period_of_time for p in effect.parameters):
        return effect
    least = NYQUIST * min(e.median_step for e in experiments)
    told = [
        replace(p, min=max(p.min or 0.0, least), start=max(p.start, least)) if p.is_period_of_time else p
        for p in effect.parameters
    ]
    return replace(effect, parameters=tuple(told))


def _is_new_signal(name: str, experiments: Sequence[Experiment], unused: Sequence[str]) -> bool:
    """Whether an unused signal could be a cause: it moves in every experiment, and it is not just another
    form of an input or of a measured output (a command in other units, the reference of a control loop, a
    speed beside a measured angle)."""
    for experiment in experiments:
        if name not in (*experiment.extra, *experiment.input_names) or np.ptp(experiment.signal(name)) == 0.0:
            return False
    column = np.concatenate([e.signal(name) for e in experiments])
    known = np.concatenate([_known_signals(e, unused) for e in experiments])
    table = np.column_stack([np.ones(column.size), known])
    rest = column - table @ np.linalg.lstsq(table, column, rcond=None)[0]
    return bool(np.sum(rest**2) > GATES.max_known_variance * np.sum((column - column.mean()) ** 2))


def _known_signals(experiment: Experiment, unused: Sequence[str]) -> np.ndarray:
    """Inputs that do something, outputs and rates of outputs (n_samples, n)."""
    outputs = np.nan_to_num(experiment.outputs)
    driving = [experiment.input(name) for name in experiment.input_names if name not in unused]
    return np.column_stack([*driving, outputs, np.gradient(outputs, experiment.time, axis=0)])
