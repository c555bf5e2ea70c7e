"""The tables of results: what notebooks show of a value, and what its DataFrame holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np

from daest.model.comparison import Comparison
from daest.model.diagnosis import Diagnosis, Improvement
from daest.model.estimates import FilterResult
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FitResult
from daest.model.linear import LinearDAE, StateSpace
from daest.model.noise import NoisePlace, NoiseReport
from daest.model.quality import DataCheck
from daest.model.simulation import Simulation


@dataclass(frozen=True)
class Listing:
    """A table: a sentence above it, names of the columns, rows of numbers, texts, truth values or None."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]


@dataclass(frozen=True)
class Trajectories:
    """Arrays (n_samples,) by name over `time` (s), with units by name."""

    title: str
    time: np.ndarray
    values: Mapping[str, np.ndarray]
    units: Mapping[str, str]


@singledispatch
def listings_of(value: object) -> tuple[Listing, ...]:
    """The tables of a result, the chief one first."""
    raise TypeError(f"{type(value).__name__} has no table")


@singledispatch
def trajectories_of(value: object) -> Trajectories:
    """The trajectories of a result."""
    raise TypeError(f"{type(value).__name__} has no trajectories")


@listings_of.register
def _(fit: FitResult) -> tuple[Listing, ...]:
    columns = ("parameter", "value", "std_error", "unit", "start", "min", "max", "at_bound")
    rows = tuple(
        (p.name, p.value, p.std_error, p.unit, p.initial, p.min, p.max, p.at_bound) for p in fit.parameters
    )
    parameters = Listing(f"{fit.status}: {fit.message}", columns, rows)
    return parameters, _agreements(fit.simulated, fit.one_step)


def _agreements(simulated: Mapping[str, Agreement], one_step: Mapping[str, Agreement]) -> Listing:
    rows = tuple(
        (part, output, fit, agreement.rms[output], one_step[part].fit_percent.get(output))
        for part, agreement in simulated.items()
        for output, fit in agreement.fit_percent.items()
    )
    columns = ("data", "output", "fit %", "rms", "one-step fit %")
    return Listing("Model against data, simulated", columns, rows)


@listings_of.register
def _(comparison: Comparison) -> tuple[Listing, ...]:
    rows = tuple(
        (m.name, output, m.simulation.fit_percent.get(output), m.simulation.rms.get(output), m.bic, m.verdict)
        for m in comparison.models
        for output in comparison.output_names
    )
    names = ", ".join(e.name for e in comparison.experiments)
    return (Listing(f"On {names}", ("model", "output", "fit %", "rms", "bic", "verdict"), rows),)


@listings_of.register
def _(report: NoiseReport) -> tuple[Listing, ...]:
    title = f"{report.n_forbidden} of {len(report.equations)} equations may not carry white noise"
    columns = ("equation", "text", "admissible", "projection norm", "differentiated")
    rows = tuple(
        (i, equation.text, place.admissible, place.projection_norm, _differentiated(place))
        for i, (equation, place) in enumerate(zip(report.equations, report.places, strict=True))
    )
    # What is forbidden is what a reader looks for.
    ordered = tuple(sorted(rows, key=lambda row: row[2]))
    return (Listing(title, columns, ordered),)


def _differentiated(place: NoisePlace) -> str:
    names, rest = ", ".join(place.differentiated), place.n_differentiated - len(place.differentiated)
    return f"{names} and {rest} more" if rest > 0 else names


@listings_of.register
def _(diagnosis: Diagnosis) -> tuple[Listing, ...]:
    columns = ("effect", "at", "verdict", "delta_bic", "p_value")
    rows = tuple(
        (p.candidate.effect.name, p.candidate.site.name, p.verdict, p.delta_bic, p.p_value)
        for p in diagnosis.proofs
    )
    return (Listing(f"{diagnosis.verdict}: {diagnosis.message}", columns, rows),)


@listings_of.register
def _(improvement: Improvement) -> tuple[Listing, ...]:
    rows = tuple(
        (i, "" if step.proof is None else step.proof.candidate.name, step.remark, step.fit.log_likelihood)
        for i, step in enumerate(improvement.steps)
    )
    return (Listing(improvement.reason, ("step", "added", "remark", "log-likelihood"), rows),)


@listings_of.register
def _(check: DataCheck) -> tuple[Listing, ...]:
    title = f"{check.name}: {check.n_samples} samples, {check.start:.6g} s to {check.stop:.6g} s"
    rows = tuple((f.code, f.level, f.column, f.sentence, f.at, f.count) for f in check.findings)
    return (Listing(title, ("code", "level", "column", "text", "time", "count"), rows),)


@listings_of.register
def _(dae: LinearDAE) -> tuple[Listing, ...]:
    title = f"E ξ' = J ξ + K u + B w of {len(dae.equations)} equations ({dae.source})"
    rows = tuple((p.name, p.value, p.unit, p.estimate) for p in dae.parameters)
    return (Listing(title, ("parameter", "value", "unit", "estimate"), rows),)


@listings_of.register
def _(model: StateSpace) -> tuple[Listing, ...]:
    poles = np.linalg.eigvals(model.A)
    rows = tuple((float(p.real), float(p.imag)) for p in poles)
    title = (
        f"States {', '.join(model.state_names)}; inputs {', '.join(model.input_names)}; "
        f"outputs {', '.join(model.output_names)}"
    )
    return (Listing(title, ("pole, real part", "imaginary part"), rows),)


@listings_of.register(Experiment)
@listings_of.register(Simulation)
@listings_of.register(FilterResult)
def _trajectories(value: Experiment | Simulation | FilterResult) -> tuple[Listing, ...]:
    found = trajectories_of(value)
    rows = tuple((name, found.units.get(name, ""), *_range(v)) for name, v in found.values.items())
    span = f"{found.time[0]:.6g} s to {found.time[-1]:.6g} s" if found.time.size else "no time"
    title = f"{found.title}: {found.time.size} samples, {span}"
    return (Listing(title, ("name", "unit", "min", "mean", "max"), rows),)


def _range(values: np.ndarray) -> tuple[float | None, float | None, float | None]:
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.mean()), float(known.max())) if known.size else (None, None, None)


@trajectories_of.register
def _(experiment: Experiment) -> Trajectories:
    values = {
        **dict(zip(experiment.input_names, experiment.inputs.T, strict=True)),
        **dict(zip(experiment.output_names, experiment.outputs.T, strict=True)),
        **experiment.extra,
    }
    return Trajectories(experiment.name, experiment.time, values, {})


@trajectories_of.register
def _(simulation: Simulation) -> Trajectories:
    values = {
        **dict(zip(simulation.variable_names, simulation.variables.T, strict=True)),
        **dict(zip(simulation.input_names, simulation.inputs.T, strict=True)),
        **dict(zip(simulation.output_names, simulation.outputs.T, strict=True)),
    }
    return Trajectories(simulation.model_name, simulation.time, values, simulation.units)


@trajectories_of.register
def _(result: FilterResult) -> Trajectories:
    columns = {
        **dict(zip(result.names, result.values.T, strict=True)),
        **{f"{name}.std": std for name, std in zip(result.names, result.std.T, strict=True)},
    }
    units = dict(zip(result.names, result.units, strict=True))
    units.update({f"{name}.std": unit for name, unit in list(units.items())})
    kind = f"{result.kind} {'smoother' if result.smoothed else 'filter'}"
    return Trajectories(kind, result.time, columns, units)
