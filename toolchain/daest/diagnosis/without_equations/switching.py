"""Which effect a model with events lacks.

Between its events such a model is like any other, and effects attach at its connectors. What differs is the
prediction: a fit follows the whole simulation, with sensitivities that jump with the events. The null
hypothesis is the refitted model with a residual of any colour, as for an FMU without equations
(`diagnosis.coloured`). Candidates stand in one model at size zero, and one simulation tells the response to
each of them; the best are refitted and tried on validation data.
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from daest.diagnosis.answers.decided import Evidence
from daest.diagnosis.evidence.reasons import unmoved
from daest.diagnosis.options import DiagnoseOptions, Progress
from daest.diagnosis.screening.candidates import attached, fed, placement, with_shapes
from daest.diagnosis.without_equations.coloured import (
    SHARES,
    Leader,
    Residual,
    beside_starts,
    diagnosis_of,
    fitted_null,
    is_white,
    judged,
    log_likelihood,
    refitted,
    refuse_gaps,
    screened,
    worth_a_refit,
)
from daest.errors import DaestError, EstimationError
from daest.estimation.fitting.fitted import fitted_model
from daest.estimation.identify import identify
from daest.lists import first_few
from daest.model.diagnosis import Candidate, Diagnosis, Proof, Screen, Screened
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import ExplicitModel, FlatModel, with_equations
from daest.model.holds import Hold
from daest.modelica.effects.attach import attach_all
from daest.systems.events.event_functions import EventFunctions
from daest.systems.events.event_update import settled_start
from daest.systems.events.integration import IntegrationError
from daest.systems.events.modes import in_starting_mode
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.simulate import simulate

REFITTED = 4  # candidates by their score, and as many by the share of the residual that they would explain
MOST_SHAPES = 3  # of one effect at one place, which the screen tries
AT_ONCE = 24  # candidates that stand in one model of the screen
ITERATIONS = 30  # of a refit
SAME = 1.0 - 1e-6  # correlation of the responses of one effect at two places that the sensors see alike
MOST_NAMED = 6  # modes that were never seen


@dataclass(frozen=True)
class Case:
    """The model at fitted values with its recordings. `states` are the initial states of each, by name."""

    flat: FlatModel
    hold: Hold
    experiments: tuple[Experiment, ...]
    names: tuple[str, ...]
    states: tuple[dict[str, float], ...]


def diagnose_switching(
    flat: FlatModel,
    candidates: Sequence[Candidate],
    estimation: Sequence[Experiment],
    validation: Sequence[Experiment],
    options: DiagnoseOptions,
    progress: Progress = lambda _: None,
) -> Diagnosis:
    """Diagnose a model that changes at events, without its noises, with `candidates` whose shapes are not yet
    chosen. Raises EstimationError `diagnose-gaps`, `diagnose-no-candidate`, and what identification
    raises."""
    began = clock.perf_counter()
    refuse_gaps([*estimation, *validation], "a simulation")
    progress("fitting the model as it is, by its simulation through the events")
    baseline = fitted_null(flat, flat, estimation, validation, options, "events null")
    case = _case(flat, baseline, tuple(estimation))
    residuals = _residuals(case)
    shaped, skipped = _shaped(case, candidates)
    progress(f"screening {len(shaped)} effects at {len({c.site.name for c in shaped})} places")
    screen = options.step(
        "events screen",
        [c.label for c in shaped],
        flat,
        lambda: _screen(case, shaped, residuals, options.seed, skipped),
    )
    refit = _Refit(case, baseline, tuple(validation), tuple(residuals), screen.n_screened)
    leaders = _distinct(screen, worth_a_refit(screen.entries, REFITTED))
    proofs, unproved = refitted(
        partial(_proof, refit), leaders, flat, baseline, options, progress, "events proof"
    )
    rest = Residual(lambda: is_white(residuals))
    still = unmoved(case.experiments, validation)
    evidence = Evidence(baseline, screen, proofs, options.fitted, rest, unproved=unproved, still=still)
    return diagnosis_of(evidence, baseline, " ".join(_remarks(case)), began)


# The model as it is ---------------------------------------------------------------------------------------


def _case(flat: FlatModel, baseline: FitResult, experiments: tuple[Experiment, ...]) -> Case:
    fitted = with_equations(fitted_model(flat, baseline), "a diagnosis")
    known = {s.experiment: dict(zip(s.names, s.values, strict=True)) for s in baseline.initial_states}
    states = tuple({k: float(v) for k, v in known.get(e.name, {}).items()} for e in experiments)
    names = tuple(p.name for p in baseline.parameters)
    return Case(in_starting_mode(fitted, experiments[0]), baseline.hold, experiments, names, states)


def _start(case: Case, explicit: ExplicitModel, number: int) -> np.ndarray:
    """Initial states of recording `number`: the fitted ones, others at their start."""
    e, known = case.experiments[number], case.states[number]
    if not all(name in known for name in explicit.state_names):
        ubar = np.concatenate([e.inputs[0], np.zeros(explicit.rhs.numel_in(1) - e.inputs.shape[1])])
        ubar = np.concatenate([ubar, np.zeros(explicit.rhs.numel_in(2))])
        own, _ = settled_start(
            EventFunctions(explicit), explicit.flat.theta_values, ubar, float(e.time[0]), known
        )
        known = {**dict(zip(explicit.state_names, own.tolist(), strict=True)), **known}
    return np.array([known[name] for name in explicit.state_names])


def _inputs(explicit: ExplicitModel, e: Experiment) -> np.ndarray:
    """The inputs of the model (n_samples, n_u), recorded columns among them."""
    columns = dict(zip(e.input_names, e.inputs.T, strict=True)) | e.extra
    return np.column_stack([columns[v.name] for v in explicit.flat.inputs] or [np.zeros((e.time.size, 0))])


def _residuals(case: Case) -> list[np.ndarray]:
    explicit = reduce_index(case.flat)
    engine, found = integrator(explicit), []
    for i, e in enumerate(case.experiments):
        run = integrate(
            engine, e.time, e.inputs, explicit.flat.theta_values, _start(case, explicit, i), hold=case.hold
        )
        found.append(e.outputs - run.outputs)
    return found


def _slopes(case: Case, flat: FlatModel, names: Sequence[str]) -> list[np.ndarray]:
    """∂ŷ/∂(parameters `names`, initial states of all recordings) per recording, (d, n, n_y)."""
    explicit = reduce_index(flat)
    engine, tables = integrator(explicit, names), []
    for i, e in enumerate(case.experiments):
        u, x0 = _inputs(explicit, e), _start(case, explicit, i)
        run = integrate(engine, e.time, u, flat.theta_values, x0, hold=case.hold, sensitivities=True)
        tables.append(beside_starts(run.sensitivities, len(names), i, len(case.experiments)))
    return tables


# Screen ---------------------------------------------------------------------------------------------------


def _shaped(
    case: Case, candidates: Sequence[Candidate]
) -> tuple[tuple[Candidate, ...], tuple[tuple[str, str], ...]]:
    """The candidates with a few shapes each, relative to what their variables reach in the simulation."""
    if not candidates:
        raise EstimationError(
            "diagnose-no-candidate",
            "no effect of the library fits anywhere in the model",
            remedy="`daest effects MODEL` lists places and effects; leave out --effect or --at",
        )
    e, explicit = case.experiments[0], reduce_index(case.flat)
    run = integrate(
        integrator(explicit),
        e.time,
        e.inputs,
        case.flat.theta_values,
        _start(case, explicit, 0),
        hold=case.hold,
    )
    states = dict(zip(explicit.state_names, run.states.T, strict=True))
    shaped, skipped = with_shapes(case.flat, candidates, e.time, states, e.inputs)
    groups: dict[tuple, list[Candidate]] = {}
    for one in shaped:
        groups.setdefault((one.effect.class_name, one.site, tuple(one.inputs.items())), []).append(one)
    few = [
        group[k]
        for group in groups.values()
        for k in np.unique(np.linspace(0, len(group) - 1, MOST_SHAPES).round().astype(int))
    ]
    return tuple(few), skipped


def _sizes(candidate: Candidate) -> list[str]:
    return [f"{candidate.name}.{size.name}" for size in candidate.effect.sizes]


def _screen(
    case: Case,
    candidates: Sequence[Candidate],
    residuals: Sequence[np.ndarray],
    seed: int,
    skipped: tuple[tuple[str, str], ...],
) -> Screen:
    kept: list[Candidate] = []
    responses: list[list[list[np.ndarray]]] = []
    for first in range(0, len(candidates), AT_ONCE):
        part = candidates[first : first + AT_ONCE]
        for found, refused in _responses(case, part):
            skipped = (*skipped, *refused)
            kept += [one for one, _ in found]
            responses += [own for _, own in found]
    base = _slopes(case, case.flat, case.names)
    return screened(kept, base, responses, residuals, seed, skipped)


Response = tuple[Candidate, list[list[np.ndarray]]]


def _responses(
    case: Case, part: Sequence[Candidate]
) -> list[tuple[list[Response], tuple[tuple[str, str], ...]]]:
    """Responses to all sizes of the candidates; a group that cannot be simulated is divided."""
    names = [name for one in part for name in _sizes(one)]
    try:
        tables = _slopes(case, attached(case.flat, part), names)
    except (DaestError, IntegrationError) as error:
        if len(part) == 1:
            reason = error.what if isinstance(error, DaestError) else str(error)
            return [([], ((part[0].label, reason),))]
        middle = len(part) // 2
        return _responses(case, part[:middle]) + _responses(case, part[middle:])
    found, at = [], 0
    for one in part:
        rows = range(at, at + len(_sizes(one)))
        found.append((one, [[table[k] for table in tables] for k in rows]))
        at = rows.stop
    return [(found, ())]


# Proof ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Refit:
    case: Case
    baseline: FitResult
    validation: tuple[Experiment, ...]
    residuals: tuple[np.ndarray, ...]
    n_trials: int


def _distinct(screen: Screen, entries: Sequence[Screened]) -> list[Leader]:
    """One entry of an effect at a place, the one that comes first; with it the other places at which the
    effect does the same to the outputs."""
    rows = {id(entry): i for i, entry in enumerate(screen.entries)}
    found: list[tuple[Screened, list[str]]] = []
    for entry in entries:
        own = entry.candidate
        for other, places in found:
            alike = abs(screen.correlation[rows[id(entry)], rows[id(other)]]) > SAME
            if own.label == other.candidate.label:
                break
            if alike and own.effect.class_name == other.candidate.effect.class_name:
                if own.site.name not in places:
                    places.append(own.site.name)
                break
        else:
            found.append((entry, []))
    return [Leader(entry, tuple(places)) for entry, places in found]


def _proof(task: _Refit, leader: Leader) -> Proof:
    """The effect put at its place and refitted with all parameters, and tried on validation data."""
    case, candidate = task.case, leader.entry.candidate
    flat, start = _begun(task, leader.entry)
    names = (*case.names, *_sizes(candidate))
    options = IdentifyOptions(
        method="oe",
        estimate=names,
        start={name: start[name] for name in names},
        hold=case.hold,
        max_iterations=ITERATIONS,
        second_look=False,
    )
    fit = identify(flat, fed(case.experiments, candidate), options, fed(task.validation, candidate))
    after = _case(flat, fit, fed(case.experiments, candidate))
    return judged(leader, after.flat, fit, task.baseline, _residuals(after), task.residuals, task.n_trials)


def _begun(task: _Refit, entry: Screened) -> tuple[FlatModel, dict[str, float]]:
    """The model with the effect, and where its refit starts: one step from the null may be far off, so that a
    part of it, or none, is the better start."""
    case, candidate = task.case, entry.candidate
    null = {s: candidate.effect.null_values[s.name] for s in candidate.effect.sizes}
    best: tuple[float, FlatModel] | None = None
    for share in SHARES:
        sizes = {
            size.name: value + share * (step - value)
            for (size, value), step in zip(null.items(), entry.sizes, strict=True)
        }
        flat = attach_all(case.flat, [placement(candidate, sizes)])
        moved = replace(case, flat=flat, experiments=fed(case.experiments, candidate))
        try:
            error = -log_likelihood(_residuals(moved))
        except (IntegrationError, DaestError):
            continue
        if best is None or error < best[0]:
            best = (error, flat)
    flat = attach_all(case.flat, [placement(candidate)]) if best is None else best[1]
    return flat, {p.name: p.value for p in flat.parameters}


# What the recordings show of the events -------------------------------------------------------------------


def _remarks(case: Case) -> list[str]:
    """Modes that never occur in the recordings, and whether a sampled controller closes the loop."""
    events = case.flat.events
    assert events is not None
    said = []
    never = _never_seen(case)
    if never:
        said.append(
            f"Never in these recordings: {first_few(never, MOST_NAMED)}; they say nothing of an "
            "effect that acts only then."
        )
    held = [case.flat.unknowns[one.unknown].name for one in events.assignments if one.is_real]
    if held and events.samples.numel():
        said.append(
            f"A sampled controller in the model ({', '.join(held[:MOST_NAMED])}) closes the loop: it reads "
            "the simulated plant, and what the plant lacks goes through it as in the machine."
        )
    return said


def _never_seen(case: Case) -> list[str]:
    """Values of Boolean variables, and truths of relations between them, that the simulation never takes."""
    events = case.flat.events
    assert events is not None
    found: dict[str, set[float]] = {}
    for e in case.experiments:
        run = simulate(case.flat, e, hold=case.hold)
        for one in events.assignments:
            if one.slot >= 0 and one.name in run.variable_names:
                column = run.variables[:, run.variable_names.index(one.name)]
                found.setdefault(one.name, set()).update(np.unique(column).tolist())
    booleans = {p.name for p in case.flat.parameters if p.is_memory and p.max == 1.0}
    said = []
    for name, values in found.items():
        if len(values) == 1:
            value = next(iter(values))
            is_truth = name in booleans or value in (0.0, 1.0)
            other = ("true" if value == 0.0 else "false") if is_truth else f"other than {value:g}"
            said.append(f"{name} {other}")
    return said
