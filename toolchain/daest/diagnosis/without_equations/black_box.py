"""Which effect an FMU without equations lacks, as far as that shows from outside.

Nothing can be put between the parts of a black box. What can be tried: a force, torque, voltage or flow at
one of its inputs that follows a law of one of its states or a recorded column, and what a sensor may do to an
output. The effects are those of the Modelica library that are marked `outside`, with their laws. The null
hypothesis is the refitted model with a residual of any colour (an autoregression); every candidate is scored
on the whitened residual after the responses of parameters and initial states are projected out, and p-values
are corrected for the number of candidates. A slow effect looks like colour: what would explain much of the
residual as it is counts, too. The best are refitted and tried on validation data. A law that leaves more than
a tenth of what could be foreseen of the residual is refused: from outside, what acts between the parts looks
a little like many laws.
"""

from __future__ import annotations

import time as clock
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from daest.diagnosis.answers.decided import Evidence
from daest.diagnosis.comparison.compare import compare_models
from daest.diagnosis.comparison.trial import fitted_candidate
from daest.diagnosis.evidence.reasons import unmoved
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import DiagnoseOptions, Progress
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
from daest.errors import ConfigError, ModelError, NumericalError
from daest.estimation.fitting.coordinates import Coordinate, Unknowns, objective, parameter_coordinate
from daest.estimation.fitting.result import agreement_of
from daest.estimation.fitting.search import minimise
from daest.estimation.identify import identify
from daest.estimation.nonlinear.nonlinear_start import fit_initial_states, limits
from daest.estimation.nonlinear.trajectories import TrajectoryProblem, integrated
from daest.fmu.binary_model import BinaryDynamics, BinaryIntegrator, BinaryModel
from daest.fmu.drive import Law
from daest.fmu.drive import Step as LawStep
from daest.fmu.outside import InputLaw, SensorFault, input_law, program_of, sensor_fault, tried_as
from daest.model.diagnosis import Candidate, Diagnosis, Proof, Screen
from daest.model.effects import Effect, Site
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FitResult, FittedParameter, IdentifyOptions
from daest.model.flat import Model
from daest.model.holds import Hold
from daest.model.parts import Parameter, Variable
from daest.systems.events.integration import IntegrationError, Run, Trajectory
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.reduce import dynamics

REFITTED = 3  # candidates by their score, and as many by the share of the residual that they would explain
MOST_STATES = 12  # whose laws are tried
MOST_ITERATIONS = 15  # of a refit
START_ITERATIONS = 30  # of a search for initial states
TRANSLATIONAL = ("N", "m", "m/s", "m/s2")  # units by which the one of two effects of a name is told
NO_TEXT = "an FMU cannot be extended from outside; the law is told above"


@dataclass(frozen=True)
class Trial:
    """One effect at input or output `number`, in the words of `candidate`. A law at an input is the `program`
    of the state `variable`, of the recorded `column`, or of the input itself; `unit_value` is what it adds at
    size 1 where what it reads is as large as it gets. What a size `cuts` is at most that largest value (0.0:
    it cuts nothing). A `fault` is that of the sensor of an output."""

    candidate: Candidate
    number: int
    program: tuple[LawStep, ...] = ()
    reads: str = ""
    variable: str = ""
    column: str = ""
    unit_value: float = 1.0
    cuts: float = 0.0
    fault: SensorFault | None = None

    @property
    def label(self) -> str:
        return self.candidate.label


@dataclass(frozen=True)
class Case:
    """The FMU at fitted values with its recordings, behind whose inputs stand the recorded signals `columns`.
    `names` are the parameters that are refitted, `sizes` (n_x,) the largest values of the states."""

    flat: BinaryModel
    hold: Hold
    experiments: tuple[Experiment, ...]
    names: tuple[str, ...]
    theta: np.ndarray
    starts: tuple[np.ndarray, ...]
    columns: tuple[str, ...]
    sizes: np.ndarray


def diagnose_black_box(
    flat: BinaryModel,
    library: Sequence[Effect],
    estimation: Sequence[Experiment],
    validation: Sequence[Experiment],
    options: DiagnoseOptions | None = None,
    progress: Progress = lambda _: None,
) -> Diagnosis:
    """Diagnose an FMU without equations, as `diagnose` does a model with equations. `places` of the options
    are names of inputs and outputs.

    Raises EstimationError `diagnose-gaps` for missing samples, ConfigError `diagnose-fmu-search` for effects
    that cannot be tried from outside, ModelError `effect-place` for unknown places, and what identification
    raises.
    """
    options = options or DiagnoseOptions()
    began = clock.perf_counter()
    refuse_gaps([*estimation, *validation], "a black box")
    _require_places(flat, options.places)
    effects = chosen(library, flat, options)
    quiet = replace(flat, noises=())
    progress("fitting the FMU as it is")
    baseline = fitted_null(flat, quiet, estimation, validation, options, "fmu null")
    case = _case(quiet, baseline, tuple(estimation))
    residuals = _residuals(case)
    trials = candidates(case, effects, options.places)
    progress(f"screening {len(trials)} effects at inputs and outputs")
    labels = [trial.label for trial in trials]
    screen = options.step(
        "fmu screen", labels, flat, lambda: _screened(case, trials, residuals, options.seed)
    )
    leaders = [Leader(entry) for entry in worth_a_refit(screen.entries, REFITTED)]
    tried = _case(quiet, baseline, tuple(validation))
    alone = _simulated_alone(baseline, tried) if leaders else baseline
    worth = {trial.label: trial for trial in trials if any(trial.label == one.label for one in leaders)}
    refit = _Refit(case, tried, alone, tuple(residuals), worth, screen.n_screened)
    proofs, unproved = refitted(
        partial(_proof, refit), leaders, flat, baseline, options, progress, "fmu proof"
    )
    rest = Residual(lambda: is_white(residuals) or _is_noise_of(flat, baseline, estimation), "FMU")
    still = unmoved(estimation, validation)
    evidence = Evidence(alone, screen, proofs, options.fitted, rest, None, unproved, True, still)
    return diagnosis_of(evidence, baseline, _limits_of_the_box(case), began)


def _require_places(flat: Model, places: Sequence[str]) -> None:
    known = [*flat.input_names, *flat.output_names]
    for place in places:
        if place not in known:
            raise ModelError(
                "effect-place",
                f"the FMU has no input or output `{place}`",
                remedy=f"places are {', '.join(known)}",
            )


def chosen(library: Sequence[Effect], flat: Model, options: DiagnoseOptions) -> list[Effect]:
    """The effects that are marked `outside`, one of each name, in the domain that the units of the FMU tell;
    those that `options` name. Raises ConfigError `diagnose-fmu-search`."""
    units = {v.unit for v in (*flat.inputs, *flat.unknowns)}
    wanted = "translational" if units & set(TRANSLATIONAL) else "rotational"
    outside = [e for e in library if e.outside]
    of_name: dict[str, Effect] = {}
    for effect in sorted(outside, key=lambda e: e.domain != wanted):
        of_name.setdefault(effect.name, effect)
    known = list(dict.fromkeys(e.name for e in outside))
    if not options.effects:
        return [of_name[name] for name in known]
    named = {e.name for e in library if {e.name, e.class_name} & set(options.effects)}
    if missing := sorted(named - set(known)):
        raise ConfigError(
            "diagnose-fmu-search",
            f"{', '.join(missing)} cannot be searched for in an FMU without equations",
            where=flat.source,
            remedy=f"from outside these are tried: {', '.join(known)}",
        )
    return [of_name[name] for name in known if name in named]


def _is_noise_of(flat: Model, baseline: FitResult, estimation: Sequence[Experiment]) -> bool:
    """Whether white noise where the model declares it, fitted by maximum likelihood, leaves nothing that the
    tests of a comparison find in the same data. Asked of linear models, where it is exact."""
    if not flat.noises or not has_affine_dynamics(dynamics(flat)):
        return False
    try:
        fit = identify(flat, estimation, IdentifyOptions(method="pem", hold=baseline.hold))
        return compare_models([fitted_candidate(flat, fit)], estimation).models[0].verdict == "not falsified"
    except NumericalError:
        return False


def _case(flat: BinaryModel, baseline: FitResult, experiments: Sequence[Experiment]) -> Case:
    theta = np.array([baseline.theta[p.name] for p in flat.parameters])
    fitted = {s.experiment: s.values for s in baseline.initial_states}
    starts = [
        initial_point(dynamics(flat), theta, e.inputs[0], t0=float(e.time[0]))[0]
        if e.name not in fitted
        else fitted[e.name]
        for e in experiments
    ]
    columns = tuple(
        c
        for c in experiments[0].extra
        if all(np.all(np.isfinite(e.extra.get(c, np.nan))) for e in experiments)
    )
    driven = tuple(e.driven_by(columns) for e in experiments)
    names, n_x = tuple(p.name for p in baseline.parameters), len(flat.form.form.states)
    case = Case(flat, baseline.hold, driven, names, theta, tuple(starts), columns, np.ones(n_x))
    runs = integrated(*_problem(case))
    case = replace(case, sizes=np.max([np.max(np.abs(run.states), axis=0) for run in runs], axis=0))
    return case if all(e.name in fitted for e in experiments) else _with_fitted_starts(case)


def candidates(case: Case, effects: Sequence[Effect], places: Sequence[str] = ()) -> list[Trial]:
    """Every law at every input, and every fault of a sensor at every output; at `places` alone if there are
    any."""
    laws = [input_law(e) for e in effects if e.outside == "input"]
    laws.sort(key=lambda law: READ_FIRST.index(law.reads))
    trials = []
    for number, u in enumerate(case.flat.inputs):
        if not places or u.name in places:
            trials += [trial for law in laws for trial in _at_input(case, law, number)]
    faults = [sensor_fault(e) for e in effects if e.outside == "output"]
    for number, y in enumerate(case.flat.outputs):
        if not places or y.name in places:
            trials += [Trial(_told(f.effect, y.name, y.unit), number, fault=f) for f in faults]
    return trials


READ_FIRST = ("nothing", "state", "signal", "recorded")


def _at_input(case: Case, law: InputLaw, number: int) -> Iterable[Trial]:
    """The law at one input, of everything that it may read."""
    u, effect = case.flat.inputs[number], law.effect
    if law.reads == "state":
        states = case.flat.unknowns[: len(case.flat.form.form.states)][:MOST_STATES]
        for state, size in zip(states, case.sizes, strict=False):
            if size > 0.0 and np.isfinite(size) and (state.unit == "rad" or not law.needs_angle):
                told = _told(effect, f"{u.name} ({state.name})", "")
                yield _trial(law, told, number, float(size), variable=state.name)
    elif law.reads == "recorded":
        for column in case.columns:
            largest = max(float(np.max(np.abs(e.extra[column]))) for e in case.experiments)
            yield _trial(law, _told(effect, f"{u.name} ({column})", ""), number, largest, column=column)
    else:
        largest = max(float(np.max(np.abs(e.inputs[:, number]))) for e in case.experiments)
        yield _trial(law, _told(effect, u.name, u.unit), number, largest)


def _told(effect: Effect, at: str, unit: str) -> Candidate:
    return Candidate(tried_as(effect, unit), Site(at, "input", "signal"), effect.name)


def _trial(
    law: InputLaw, told: Candidate, number: int, largest: float, variable: str = "", column: str = ""
) -> Trial:
    function = law.function(largest)
    value = 1.0 if law.reads in ("nothing", "signal") else abs(float(function(largest, 1.0)))
    cuts = largest if law.cuts else 0.0
    return Trial(told, number, program_of(function), law.reads, variable, column, value, cuts)


# ------------------------------------------------------------------------------------------ simulation


SIZE = "size of the effect"  # that is tried: the parameter behind those of the FMU


@dataclass(frozen=True)
class _Tried(BinaryIntegrator):
    """An FMU with one effect of a size at an input or output, or without: the recorded columns stand behind
    the inputs of `explicit`, and the size behind its parameters."""

    case: Case
    trial: Trial | None

    def trajectory(self, run: Run) -> Trajectory:
        flat, trial = self.case.flat, self.trial
        n, n_u, behind = len(flat.parameters), len(flat.inputs), len(self.explicit.flat.inputs)

        def with_columns_last(u: np.ndarray) -> np.ndarray:
            return np.concatenate([u[..., :n_u], u[..., behind:], u[..., n_u:behind]], axis=-1)

        size = float(run.theta[n]) if trial is not None else 0.0
        laws = () if trial is None or trial.fault is not None else (_law(self.case, trial, size),)
        steps = np.array([_size_step(self.case, trial)]) if laws and trial is not None else None
        own = [name for name in self.names if name != SIZE] if run.by_parameter else []
        u0, u1, u_last = map(with_columns_last, (run.u0, run.u1, np.ravel(run.u_last)))
        bends = None if run.bent is None else with_columns_last(run.bent)
        alone = replace(run, u0=u0, u1=u1, u_last=u_last, bent=bends, theta=run.theta[:n])
        states, outputs, slopes = flat.form.integrate(flat, own, alone, laws=laws, size_steps=steps)
        if trial is None or trial.fault is None:
            return Trajectory(states, outputs, slopes, n_steps=0)
        added = _fault(outputs, run.time, trial)
        if run.directions:
            constant = _fault(np.zeros_like(outputs), run.time, trial)
            bent = [_fault(slopes[:, :, d], run.time, trial) - constant for d in range(slopes.shape[2])]
            slopes = slopes + size * np.stack(bent, axis=2)
            slopes = np.insert(slopes, slopes.shape[2] - run.x0.size, added, axis=2)
        return Trajectory(states, outputs + size * added, slopes, n_steps=0)


def _problem(
    case: Case, trial: Trial | None = None, size: float = 0.0, names: Sequence[str] | None = None
) -> tuple[TrajectoryProblem, np.ndarray]:
    """The output error of the FMU with `size` of the trial, over the parameters `names` (default: those of
    the case) and the size, and the point where it stands."""
    flat, names = case.flat, tuple(case.names if names is None else names)
    values = dict(zip(flat.parameter_names, case.theta, strict=True))
    bounds = {p.name: (p.min, p.max) for p in flat.parameters}
    unknown = [parameter_coordinate(flat, name, values[name], bounds[name]) for name in names]
    theta, parameters = case.theta, flat.parameters
    if trial is not None:
        scale = abs(size) or _size_step(case, trial)
        n = len(parameters)
        unknown.append(Coordinate(SIZE, "parameter", n, size, False, scale, -np.inf, np.inf))
        theta, parameters = np.append(theta, size), (*parameters, Parameter(SIZE, size))
        names = (*names, SIZE)
    inputs = (*flat.inputs, *(Variable(name) for name in case.columns))
    explicit = replace(dynamics(flat), flat=replace(flat, inputs=inputs, parameters=parameters))
    free = np.full(len(flat.outputs), np.nan)
    unknowns = Unknowns(tuple(unknown), theta, np.zeros(0), free)
    scales = np.where(case.sizes > 0.0, case.sizes, 1.0)
    model = _Tried(cast(BinaryDynamics, explicit), names, case, trial)
    problem = TrajectoryProblem(model, case.experiments, case.hold, unknowns, scales, free)
    return problem, np.concatenate([unknowns.start, *(x0 / scales for x0 in case.starts)])


def _fault(y: np.ndarray, time: np.ndarray, trial: Trial) -> np.ndarray:
    """What a unit of the fault of a sensor adds to the outputs (n, n_y)."""
    added = np.zeros_like(y)
    if trial.fault is not None:
        added[:, trial.number] = trial.fault.along(y[:, trial.number], time)
    return added


def _law(case: Case, trial: Trial, size: float) -> Law:
    reads = column = None
    if trial.column:
        column = len(case.flat.form.form.inputs) + case.columns.index(trial.column)
    elif trial.reads == "signal":
        column = trial.number
    elif trial.variable:
        reads = case.flat.form.form.states[case.flat.unknown_names.index(trial.variable)]
    return Law(trial.program, trial.number, reads, column, size)


def _residuals(case: Case, trial: Trial | None = None, size: float = 0.0) -> list[np.ndarray]:
    """y - ŷ of every recording, (n, n_y). Raises IntegrationError."""
    runs = integrated(*_problem(case, trial, size))
    return [e.outputs - run.outputs for e, run in zip(case.experiments, runs, strict=True)]


def _parameter_slopes(case: Case) -> list[np.ndarray]:
    """∂ŷ/∂(parameters, initial states of all recordings), (d, n, n_y) per recording."""
    runs = integrated(*_problem(case), with_slopes=True)
    return [beside_starts(run.sensitivities, len(case.names), i, len(runs)) for i, run in enumerate(runs)]


def _response(case: Case, trial: Trial) -> list[np.ndarray]:
    """∂ŷ/∂size per recording at size 0, (n, n_y); of a saturation, which has none there, a difference."""
    cut = GATES.fmu_cut * trial.cuts
    try:
        if cut:
            pairs = zip(_residuals(case), _residuals(case, trial, cut), strict=True)
            return [(without - with_it) / cut for without, with_it in pairs]
        runs = integrated(*_problem(case, trial, names=()), with_slopes=True)
        return [run.sensitivities[:, :, 0] for run in runs]
    except IntegrationError:
        return [np.zeros(e.outputs.shape) for e in case.experiments]


def _size_step(case: Case, trial: Trial) -> float:
    """A size at which the effect is small against its input or output."""
    if trial.fault is not None:
        return GATES.fmu_size_step
    spread = max(float(np.std(e.inputs[:, trial.number])) for e in case.experiments)
    spread = spread or max(float(np.max(np.abs(e.inputs[:, trial.number]))) for e in case.experiments) or 1.0
    return GATES.fmu_size_step * spread / (trial.unit_value or 1.0)


# ---------------------------------------------------------------------------------------------- screen


def _screened(case: Case, trials: Sequence[Trial], residuals: Sequence[np.ndarray], seed: int) -> Screen:
    """All trials on the whitened residual, as the screen of a model with equations, best first."""
    responses = [[_response(case, trial)] for trial in trials]
    return screened([t.candidate for t in trials], _parameter_slopes(case), responses, residuals, seed)


# ----------------------------------------------------------------------------------------------- proof


@dataclass(frozen=True)
class _Refit:
    """What every refit needs: the FMU at its fit, with the recordings and with the validation data, the
    residuals of that fit, and the trials that are worth a refit by their labels, of `n_trials`."""

    case: Case
    validation: Case
    baseline: FitResult
    residuals: tuple[np.ndarray, ...]
    trials: Mapping[str, Trial]
    n_trials: int


def _simulated_alone(baseline: FitResult, validation: Case) -> FitResult:
    """The fit with the errors of the validation data from the initial states that fit them best, as they are
    told of every effect; unchanged where the FMU cannot be simulated so."""
    try:
        alone = _with_fitted_starts(validation)
        told = _agreement(alone, _residuals(alone))
    except IntegrationError:
        return baseline
    return replace(baseline, simulated={**baseline.simulated, "validation": told})


def _proof(task: _Refit, leader: Leader) -> Proof:
    """The effect put at its place and refitted with all parameters, and tried on validation data. Raises
    IntegrationError."""
    case, baseline, entry = task.case, task.baseline, leader.entry
    trial = task.trials[leader.label]
    fitted, size, std_error, errors = _refitted(case, trial, entry.sizes[0])
    tried = _with_fitted_starts(replace(task.validation, theta=fitted.theta), trial, size)
    unseen = _agreement(tried, _residuals(tried, trial, size))
    theta = dict(zip(case.flat.parameter_names, fitted.theta.tolist(), strict=True))
    own, unit = f"{trial.candidate.name}.size", trial.candidate.size_unit
    known = [replace(p, value=theta[p.name], std_error=None) for p in baseline.parameters]
    fitted_size = FittedParameter(own, size, std_error, entry.sizes[0], unit, None, None, None)
    gain = log_likelihood(errors) - log_likelihood(task.residuals)
    fit = replace(
        baseline,
        parameters=(*known, fitted_size),
        theta={**theta, own: size},
        log_likelihood=baseline.log_likelihood + gain,
        simulated={"estimation": _agreement(case, errors), "validation": unseen},
        one_step={},
    )
    flat = case.flat.with_theta(theta)
    return judged(leader, flat, fit, baseline, errors, task.residuals, task.n_trials)


def _refitted(case: Case, trial: Trial, size: float) -> tuple[Case, float, float | None, list[np.ndarray]]:
    """Parameters, initial states and size together, with the standard error of the size."""
    # One step from the null may be far off, and even unstable: a part of it, or none, is the better start.
    sizes = [share * size for share in SHARES]
    if trial.cuts:
        sizes = [share * trial.cuts for share in (0.5 * GATES.fmu_cut, GATES.fmu_cut, 2.0 * GATES.fmu_cut)]
    problem, z = _problem(case, trial, size)
    n = len(problem.unknowns.coordinates)
    at_size = [
        np.concatenate([z[: n - 1], [problem.unknowns.coordinates[-1].searched(s)], z[n:]]) for s in sizes
    ]
    judge = objective(problem)

    def value(at: np.ndarray) -> float:
        there = judge(at, False)
        return np.inf if there is None else there.value

    found = minimise(judge, min(at_size, key=value), *limits(problem), MOST_ITERATIONS, GATES.fmu_refit_gain)
    if found is None:
        raise IntegrationError("the model cannot be simulated with the effect", 0.0)
    own = problem.unknowns.coordinates[-1]
    variance = float(np.linalg.pinv(found.evaluation.information)[n - 1, n - 1])
    fitted = replace(case, theta=problem.theta(found.z)[:-1], starts=tuple(problem.initial_states(found.z)))
    size = own.natural(found.z[n - 1])
    return fitted, size, float(np.sqrt(max(variance, 0.0))) * own.scale, _residuals(fitted, trial, size)


def _with_fitted_starts(case: Case, trial: Trial | None = None, size: float = 0.0) -> Case:
    """The initial states that fit every recording best, parameters held."""
    if not case.starts or not case.starts[0].size:
        return case
    problem, z = _problem(case, trial, size)
    n = len(problem.unknowns.coordinates)
    lower, upper = limits(problem)
    z = fit_initial_states(problem, z, lower, upper)
    held = problem.held_at(z)
    found = minimise(objective(held), z[n:], lower[n:], upper[n:], START_ITERATIONS, GATES.fmu_refit_gain)
    return case if found is None else replace(case, starts=tuple(held.initial_states(found.z)))


def _agreement(case: Case, errors: Sequence[np.ndarray]) -> Agreement:
    return agreement_of(case.flat.output_names, [e.outputs for e in case.experiments], errors)


# --------------------------------------------------------------------------------------------- verdict


def _limits_of_the_box(case: Case) -> str:
    inputs = ", ".join(case.flat.input_names) or "none"
    outputs = ", ".join(case.flat.output_names)
    return (
        f"(A black box: what acts together with the inputs {inputs}, as a law of a state or a recorded "
        f"column, and faults of the sensors of {outputs} could be tried; nothing between its parts.)"
    )
