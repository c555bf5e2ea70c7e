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
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import cast

import numpy as np

from daest.diagnosis.compare import compare_models
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import DiagnoseOptions, Progress
from daest.diagnosis.screen import projected, scored
from daest.diagnosis.trial import fitted_candidate
from daest.errors import ConfigError, EstimationError, ModelError, NumericalError
from daest.estimation.coordinates import Coordinate, Unknowns, objective, parameter_coordinate
from daest.estimation.identify import identify
from daest.estimation.nonlinear_start import fit_initial_states, limits
from daest.estimation.result import agreement_of
from daest.estimation.search import minimise
from daest.estimation.trajectories import TrajectoryProblem, integrated
from daest.fmu.binary_model import BinaryDynamics, BinaryIntegrator, BinaryModel
from daest.fmu.drive import Law
from daest.fmu.drive import Step as LawStep
from daest.fmu.outside import InputLaw, SensorFault, input_law, program_of, sensor_fault, tried_as
from daest.model.diagnosis import Candidate, Diagnosis, Proof, Screen, Screened, VerdictName
from daest.model.effects import Effect, Site
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FitResult, FittedParameter, IdentifyOptions
from daest.model.flat import Model
from daest.model.parts import Parameter, Variable
from daest.numerics.parallel import workers
from daest.numerics.statistics import chi2, ljung_box
from daest.systems.initialize import initial_point
from daest.systems.integrate import Hold, Run, Trajectory
from daest.systems.integration import IntegrationError
from daest.systems.linearize import has_affine_dynamics
from daest.systems.reduce import dynamics

REFITTED = 3  # candidates by their score, and as many by the share of the residual that they would explain
MOST_ORDER = 8  # of the autoregression that whitens the residual
SHARES = (1.0, 0.3, 0.0)  # of the size that one step from the null gives, where a refit starts
MOST_STATES = 12  # whose laws are tried
WHITE_LAGS = 20
MOST_ITERATIONS = 15  # of a refit
START_ITERATIONS = 30  # of a search for initial states
REFIT_SECONDS = 3.0  # times that of the model as it is
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


@dataclass(frozen=True)
class Scored:
    """A trial with its entry in the screen."""

    trial: Trial
    entry: Screened


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
    _refuse_gaps([*estimation, *validation])
    _require_places(flat, options.places)
    effects = chosen(library, flat, options)
    quiet = replace(flat, noises=())
    progress("fitting the FMU as it is")
    fitting = IdentifyOptions(
        method="oe", hold=options.hold, seed=options.seed, jobs=options.jobs, cluster=options.cluster
    )
    baseline = options.step("fmu null", (), flat, lambda: identify(quiet, estimation, fitting, validation))
    case = _case(quiet, baseline, tuple(estimation))
    residuals = _residuals(case)
    trials = candidates(case, effects, options.places)
    progress(f"screening {len(trials)} effects at inputs and outputs")
    labels = [trial.label for trial in trials]
    scored, screen = options.step(
        "fmu screen", labels, flat, lambda: _screened(case, trials, residuals, options.seed)
    )
    tried = _case(quiet, baseline, tuple(validation))
    refit = _Refit(case, tried, baseline, tuple(residuals), screen.n_screened)
    found = _proofs(refit, _worth_a_refit(scored), options, progress)
    verdict, message, experiment, proofs = _verdict(
        found, lambda: _is_white(residuals) or _is_noise_of(flat, baseline, estimation)
    )
    return Diagnosis(
        verdict=verdict,
        message=f"{message} {_limits_of_the_box(case)}",
        baseline=baseline,
        proofs=proofs,
        screen=screen,
        places=(),
        disturbance=None,
        validation=baseline.simulated.get("validation"),
        next_experiment=experiment,
        seconds=clock.perf_counter() - began,
        has_loads=False,
    )


def _require_places(flat: Model, places: Sequence[str]) -> None:
    known = [*(v.name for v in flat.inputs), *(y.name for y in flat.outputs)]
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


def _worth_a_refit(scored: Sequence[Scored]) -> list[Scored]:
    """The best by score if any is significant, since one step from the null ranks like laws badly; and those
    that would explain most of the residual as it is, which a filter for its colour would take for colour."""
    found = [s for s in scored if not s.entry.absorbed]
    by_score = found[:REFITTED] if found and found[0].entry.p_value < GATES.fmu_level else []
    slow = [s for s in found if (s.entry.share or 0.0) >= GATES.fmu_min_share]
    by_share = sorted(slow, key=lambda s: -(s.entry.share or 0.0))[:REFITTED]
    return [*by_score, *(s for s in by_share if not any(s is other for other in by_score))]


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


def _refuse_gaps(experiments: Sequence[Experiment]) -> None:
    for experiment in experiments:
        if not np.all(np.isfinite(experiment.outputs)):
            raise EstimationError(
                "diagnose-gaps",
                f"{experiment.name} has missing samples, and the residual of a black box is whitened in time",
                remedy="choose a part without gaps (--from, --to), or resample it",
            )


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
    driven = tuple(
        replace(
            e,
            inputs=np.column_stack([e.inputs, *(e.extra[c] for c in columns)]),
            input_names=(*e.input_names, *columns),
        )
        for e in experiments
    )
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
            return np.hstack([u[..., :n_u], u[..., behind:], u[..., n_u:behind]])

        size = float(run.theta[n]) if trial is not None else 0.0
        laws = () if trial is None or trial.fault is not None else (_law(self.case, trial, size),)
        steps = np.array([_size_step(self.case, trial)]) if laws and trial is not None else None
        own = [name for name in self.names if name != SIZE] if run.by_parameter else []
        u0, u1, u_last = map(with_columns_last, (run.u0, run.u1, np.ravel(run.u_last)))
        alone = replace(run, u0=u0, u1=u1, u_last=u_last, theta=run.theta[:n])
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
    values = dict(zip((p.name for p in flat.parameters), case.theta, strict=True))
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
        reads = case.flat.form.form.states[[v.name for v in case.flat.unknowns].index(trial.variable)]
    return Law(trial.program, trial.number, reads, column, size)


def _residuals(case: Case, trial: Trial | None = None, size: float = 0.0) -> list[np.ndarray]:
    """y - ŷ of every recording, (n, n_y). Raises IntegrationError."""
    runs = integrated(*_problem(case, trial, size))
    return [e.outputs - run.outputs for e, run in zip(case.experiments, runs, strict=True)]


def _parameter_slopes(case: Case) -> list[np.ndarray]:
    """∂ŷ/∂(parameters, initial states of all recordings), (d, n, n_y) per recording."""
    p, n_x = len(case.names), case.starts[0].size
    tables = []
    for i, run in enumerate(integrated(*_problem(case), with_slopes=True)):
        own = run.sensitivities.transpose(2, 0, 1)
        table = np.zeros((p + n_x * len(case.experiments), *own.shape[1:]))
        table[:p] = own[:p]
        table[p + i * n_x : p + (i + 1) * n_x] = own[p:]
        tables.append(table)
    return tables


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


def _autoregression(residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Coefficients of the whitening filter of every output, order by BIC."""
    filters = []
    for j in range(residuals[0].shape[1]):
        best: tuple[float, np.ndarray] | None = None
        for order in range(MOST_ORDER + 1):
            rows = [_lagged(e[:, j], order) for e in residuals if e.shape[0] > 4 * MOST_ORDER]
            if not rows:
                break
            X, y = np.vstack([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
            a = np.linalg.lstsq(X, y, rcond=None)[0] if order else np.zeros(0)
            variance = float(np.mean((y - X @ a) ** 2)) + np.finfo(float).tiny
            bic = y.size * np.log(variance) + order * np.log(y.size)
            if best is None or bic < best[0]:
                best = (bic, np.concatenate([[1.0], -a]))
        filters.append(np.ones(1) if best is None else best[1])
    return filters


def _lagged(e: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the last `order` values before each sample from MOST_ORDER on, and these samples."""
    columns = [e[MOST_ORDER - k : e.size - k] for k in range(1, order + 1)]
    X = np.column_stack(columns) if columns else np.zeros((e.size - MOST_ORDER, 0))
    return X, e[MOST_ORDER:]


def _white(tables: Sequence[np.ndarray], filters: Sequence[np.ndarray]) -> np.ndarray:
    """All recordings and outputs whitened, one after the other, (m,)."""
    parts = []
    for table in tables:
        for j, taps in enumerate(filters):
            parts.append(np.convolve(table[:, j], taps)[: table.shape[0]][MOST_ORDER:])
    return np.concatenate(parts)


def _screened(
    case: Case, trials: Sequence[Trial], residuals: Sequence[np.ndarray], seed: int
) -> tuple[list[Scored], Screen]:
    """All trials on the whitened residual, as the screen of a model with equations, best first."""
    slopes, responses = _parameter_slopes(case), [_response(case, trial) for trial in trials]
    filters = _autoregression(residuals)
    spreads = _spreads(residuals, filters)
    weights = _weights(residuals, spreads)
    directions = [[table[k] for table in slopes] for k in range(slopes[0].shape[0])]

    def white(tables: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
        return _finite([_white(one, filters) * weights for one in tables])

    def plain(tables: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
        return _finite([np.concatenate([(part / spreads).ravel() for part in one]) for one in tables])

    told, rows = [trial.candidate for trial in trials], [slice(k, k + 1) for k in range(len(trials))]
    base, least = white(directions), float(np.sqrt(GATES.fmu_absorbed_share))
    screen = scored(told, rows, white([residuals])[0], base, base, white(responses), (), seed, least)
    shares = _shares(plain(responses), plain([residuals]), plain(directions))
    known = {id(c): (trial, share) for c, trial, share in zip(told, trials, shares, strict=True)}
    found = []
    for entry in screen.entries:
        trial, share = known[id(entry.candidate)]
        found.append(Scored(trial, replace(entry, share=float(share))))
    return found, replace(screen, entries=tuple(one.entry for one in found))


def _finite(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Rows (k, m); one that is not finite everywhere is zero."""
    table = np.array(rows).reshape(len(rows), -1)
    return np.where(np.all(np.isfinite(table), axis=1, keepdims=True), table, 0.0)


def _shares(responses: np.ndarray, residual: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Shares of the squared residual (1, m) that responses (k, m) explain beyond the parameters, (k,)."""
    own, left = projected(responses, directions)[0], projected(residual, directions)[0][0]
    sizes = np.sum(own**2, axis=1) * float(left @ left)
    return np.where(sizes > 0.0, (own @ left) ** 2 / np.where(sizes > 0.0, sizes, 1.0), 0.0)


def _spreads(residuals: Sequence[np.ndarray], filters: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviations of the whitened residual of every output, (n_y,)."""
    found = [
        np.std(np.concatenate([np.convolve(e[:, j], taps)[: e.shape[0]][MOST_ORDER:] for e in residuals]))
        for j, taps in enumerate(filters)
    ]
    return np.array([s or 1.0 for s in found])


def _weights(residuals: Sequence[np.ndarray], spreads: np.ndarray) -> np.ndarray:
    """1 / standard deviation of the whitened residual of every output, in the order of `_white`."""
    parts = [np.full(e.shape[0] - MOST_ORDER, 1.0 / s) for e in residuals for s in spreads]
    return np.concatenate(parts)


# ----------------------------------------------------------------------------------------------- proof


@dataclass(frozen=True)
class _Refit:
    """What every refit needs: the FMU at its fit with the recordings and the validation data, and the
    residuals of that fit. `without`: rms errors of the validation data as the FMU is, by output."""

    case: Case
    validation: Case
    baseline: FitResult
    residuals: tuple[np.ndarray, ...]
    n_trials: int
    without: Mapping[str, float | None] = field(default_factory=dict)


def _proofs(
    task: _Refit, scored: Sequence[Scored], options: DiagnoseOptions, progress: Progress
) -> list[Proof]:
    """Of all that were scored; an effect that the FMU cannot be simulated with is none."""
    if not scored:
        return []
    try:
        alone = _with_fitted_starts(task.validation)
        task = replace(task, without=_agreement(alone, _residuals(alone)).rms)
    except IntegrationError:
        return []
    for one in scored:
        progress(f"refitting with {one.trial.label}")
    with workers(options.jobs, options.cluster) as pool:
        seconds = REFIT_SECONDS * task.baseline.seconds
        outcomes = list(pool.map(partial(_kept_proof, task, options), scored, seconds=seconds))
    return [o.get() for o in outcomes if not isinstance(o.error, IntegrationError)]


def _kept_proof(task: _Refit, options: DiagnoseOptions, one: Scored) -> Proof:
    """The proof, now or of an earlier run. Raises IntegrationError."""
    return options.step("fmu proof", (one.trial.label,), task.case.flat, lambda: _proof(task, one))


def _proof(task: _Refit, one: Scored) -> Proof:
    """The effect put at its place and refitted with all parameters, and tried on validation data."""
    case, trial, baseline = task.case, one.trial, task.baseline
    fitted, size, std_error, errors = _refitted(case, trial, one.entry.sizes[0])
    gain = _log_likelihood(errors) - _log_likelihood(task.residuals)
    n = sum(e.size for e in errors)
    tried = _with_fitted_starts(replace(task.validation, theta=fitted.theta), trial, size)
    unseen = _agreement(tried, _residuals(tried, trial, size))
    shares = [(unseen.rms[name], error) for name, error in task.without.items()]
    better = float(np.mean([1 - (a or 0.0) / b for a, b in shares if b]))
    share = _foreseen(errors, task.residuals) / (_foreseen(task.residuals, errors) or 1.0)
    reason = ""
    if 2 * gain <= np.log(n) + 2 * np.log(task.n_trials):
        reason = "it gains no more likelihood than chance would in such a search"
    elif std_error is None or abs(size) < GATES.fmu_min_significance * std_error:
        reason = "its size cannot be told from zero"
    elif better <= GATES.fmu_min_validation_gain:
        reason = "it does not lower the error on validation data"
    elif share > (most := GATES.fmu_max_foreseen):
        reason = f"it leaves {share:.0%} of what can be foreseen of the residual, more than {most:.0%}"
    theta = dict(zip((p.name for p in case.flat.parameters), fitted.theta.tolist(), strict=True))
    own, unit = f"{trial.candidate.name}.size", trial.candidate.size_unit
    known = [replace(p, value=theta[p.name], std_error=None) for p in baseline.parameters]
    fitted_size = FittedParameter(own, size, std_error, one.entry.sizes[0], unit, None, None, None)
    fit = replace(
        baseline,
        parameters=(*known, fitted_size),
        theta={**theta, own: size},
        log_likelihood=baseline.log_likelihood + gain,
        simulated={"estimation": _agreement(case, errors), "validation": unseen},
        one_step={},
    )
    return Proof(
        candidate=trial.candidate,
        flat=case.flat.with_theta(theta),
        fit=fit,
        delta_log_likelihood=gain,
        delta_bic=2 * gain - float(np.log(n)),
        p_value=one.entry.p_value,
        explained=max(0.0, better),
        equivalent=(),
        not_separable_from=(),
        verdict="rejected" if reason else "supported",
        reason=reason,
    )


def _foreseen(errors: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> float:
    """How much of the residual could be foreseen from its own past: its mean square beyond that of the
    innovations, in units of the latter, over all outputs. As innovations counts the smaller of both."""
    floors = [_spreads(some, _autoregression(some)) ** 2 for some in (errors, others)]
    squares = np.mean(np.concatenate(errors) ** 2, axis=0)
    return float(np.sum(np.maximum(squares / np.minimum(*floors) - 1.0, 0.0)))


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
    return agreement_of([o.name for o in case.flat.outputs], [e.outputs for e in case.experiments], errors)


def _log_likelihood(errors: Sequence[np.ndarray]) -> float:
    """Gaussian, of the innovations of the autoregression of the errors, up to a constant."""
    total = 0.0
    for j, taps in enumerate(_autoregression(errors)):
        white = np.concatenate([np.convolve(e[:, j], taps)[: e.shape[0]][MOST_ORDER:] for e in errors])
        total -= 0.5 * white.size * np.log(np.mean(white**2) + np.finfo(float).tiny)
    return float(total)


# --------------------------------------------------------------------------------------------- verdict


def _verdict(
    proofs: Sequence[Proof], is_explained: Callable[[], bool]
) -> tuple[VerdictName, str, str, tuple[Proof, ...]]:
    """Verdict, message, what to record next, and the proofs with what was decided of each. `is_explained`,
    asked where no effect is supported: the residual is white, or that of declared noise."""
    ranked = sorted(proofs, key=lambda p: -p.delta_log_likelihood)
    supported = [p for p in ranked if p.verdict == "supported"]
    if supported:
        best = supported[0]
        close = [
            p
            for p in supported
            if best.delta_log_likelihood - p.delta_log_likelihood < GATES.fmu_same_log_likelihood
        ]
        decided = tuple(_decided(p, best, close) if p.verdict == "supported" else p for p in ranked)
        size = best.fit.parameters[-1]
        text = f"{best.candidate.label}, size {size.value:.4g} ± {size.std_error or 0.0:.2g}"
        if len(close) == 1:
            return "supported", f"{text}: the data ask for it, and it predicts better.", "", decided
        others = ", ".join(p.candidate.label for p in close[1:])
        return (
            "cannot tell",
            f"{text}, or {others}: the data cannot tell them apart.",
            "excite the inputs at other amplitudes and speeds, where these laws differ",
            decided,
        )
    if is_explained():
        return (
            "nothing missing",
            "The residual of the refitted FMU is white, or explained by its declared process noise; no "
            "effect improves the fit.",
            "",
            tuple(ranked),
        )
    return (
        "external disturbance",
        "The residual is coloured, and no law that can be tried from outside explains it: a load from "
        "outside, or something inside the FMU.",
        "measure what may act on the plant, and add the column to the recording",
        tuple(ranked),
    )


def _decided(proof: Proof, best: Proof, close: Sequence[Proof]) -> Proof:
    """A supported proof beside those that are as good as the best."""
    if not any(proof is one for one in close):
        behind = best.delta_log_likelihood - proof.delta_log_likelihood
        reason = f"{best.candidate.label} explains more: {behind:.1f} log-likelihood units"
        return replace(proof, verdict="rejected", reason=reason)
    if len(close) == 1:
        return proof
    others = tuple(p.candidate.label for p in close if p is not proof)
    return replace(proof, verdict="not separable", not_separable_from=others)


def _is_white(residuals: Sequence[np.ndarray]) -> bool:
    """Ljung-Box of every output, all together at GATES.fmu_level."""
    long = [e - e.mean(axis=0) for e in residuals if e.shape[0] > 2 * WHITE_LAGS]
    p_values = [1.0]
    for j in range(residuals[0].shape[1]):
        moving = [e[:, j] for e in long if np.any(e[:, j])]
        q = sum(ljung_box(x, np.ones(x.size, dtype=bool), WHITE_LAGS) for x in moving)
        p_values.append(float(chi2.sf(q, WHITE_LAGS * len(moving))) if moving else 1.0)
    return min(p_values) >= GATES.fmu_level / (len(p_values) - 1)


def _limits_of_the_box(case: Case) -> str:
    inputs = ", ".join(v.name for v in case.flat.inputs) or "none"
    outputs = ", ".join(o.name for o in case.flat.outputs)
    return (
        f"(A black box: what acts together with the inputs {inputs}, as a law of a state or a recorded "
        f"column, and faults of the sensors of {outputs} could be tried; nothing between its parts.)"
    )
