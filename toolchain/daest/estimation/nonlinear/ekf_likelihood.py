"""Maximum likelihood of nonlinear models with process noise, by the prediction errors of the extended filter.

Search vector: parameters, logarithms of intensities and of measurement standard deviations, and the initial
state of every record, which is a fixed unknown: its covariance is zero. The gradient is exact; the Fisher
information is Σ ∂ε ∂εᵀ + ½ ∂log s ∂log sᵀ over whitened innovations ε and their variances s.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines.ekf import EkfLikelihood, ekf_likelihood, run_ekf
from daest.estimation.filter_engines.filter_task import Directions, Noise, Record, Start, record
from daest.estimation.fitting.coordinates import Coordinate, Unknowns, log_likelihood, objective
from daest.estimation.fitting.identifiability import covariance, std_errors, without_influence
from daest.estimation.fitting.optimum import Search, best_point, coloured
from daest.estimation.fitting.profile import Searched, Tell, silent
from daest.estimation.fitting.result import End, Told, agreement_of, bound_of, fit_result
from daest.estimation.fitting.search import Found, Objective, minimise
from daest.estimation.fitting.setup import Setup
from daest.estimation.fitting.ties import Beginning, with_ties
from daest.estimation.gates import FIT
from daest.estimation.nonlinear.ekf_start import best_start, felt_intensity, with_lost_ones
from daest.estimation.nonlinear.identify_nonlinear import nonlinear_ends
from daest.estimation.nonlinear.nonlinear_result import NonlinearEnds
from daest.estimation.nonlinear.nonlinear_start import fit_initial_states
from daest.estimation.nonlinear.trajectories import TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FitResult, FittedInitialState, FittedNoise, IdentifyOptions
from daest.model.flat import Dynamics
from daest.systems.events.integration import IntegrationError
from daest.systems.reduction.initialize import initial_point
from daest.systems.simulation.integrate import integrator
from daest.systems.simulation.local_linear import LocalModel, local_model

MOST_HALVINGS = 4  # a model that needs finer steps is not smooth on the scale of its samples
START_SAMPLES, START_SUBSTEPS = 2000, 4  # of the record, and per sample, when starts are compared
AGREEMENT_ITERATIONS = 20  # of the search for the initial states that a simulation is judged from
ROUNDS = 2  # of searching with a step of the linearisation that is checked afterwards


@dataclass(frozen=True)
class EkfProblem:
    """What is fitted to what: `model` built with tangents along the parameters of `unknowns`; its coordinates
    are parameters, process and measurement noises in this order. Substeps are no longer than `longest`
    seconds."""

    model: LocalModel
    records: tuple[Record, ...]
    unknowns: Unknowns
    state_scale: np.ndarray
    longest: float = np.inf

    @property
    def n_unknowns(self) -> int:
        return len(self.unknowns.coordinates)

    def initial_states(self, z: np.ndarray) -> np.ndarray:
        """(n_records, n_states)."""
        return z[self.n_unknowns :].reshape(len(self.records), -1) * self.state_scale

    def predict(self, z: np.ndarray, with_slopes: bool = False) -> EkfPredicted | None:
        """Every record at z, with derivatives along the unknowns, then its own initial state; None where
        the filter cannot run. Shapes: z (n_z,)."""
        theta, intensity, std = self.unknowns.values(z[: self.n_unknowns])
        noise = Noise(intensity, std**2)
        directions = _directions(self, z, std) if with_slopes else None
        n = self.state_scale.size
        result = []
        for data, x0 in zip(self.records, self.initial_states(z), strict=True):
            start = Start(x0, np.zeros((n, n)))
            try:
                result.append(ekf_likelihood(self.model, data, theta, noise, start, self.longest, directions))
            except (IntegrationError, EstimationError):
                return None
        return EkfPredicted(tuple(result))

    def derivatives(self, found: EkfPredicted, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and Fisher information along z. Shapes: z (n_z,); gradient (n_z,), information (n_z,
        n_z)."""
        p, n = self.n_unknowns, self.state_scale.size
        gradient, information = np.zeros(z.size), np.zeros((z.size, z.size))
        for number, part in enumerate(found.parts):
            rows = np.concatenate([np.arange(p), p + number * n + np.arange(n)])
            gradient[rows] -= part.gradient
            information[np.ix_(rows, rows)] += part.information
        return gradient, information

    def tied(self, likelihood: Objective) -> Objective:
        explicit = self.model.explicit
        n_u = len(explicit.flat.inputs)
        beginnings = [Beginning(r.u0[0, :n_u], r.u0[0, n_u:], float(r.time[0])) for r in self.records]
        return with_ties(likelihood, explicit, self.unknowns, self.state_scale, beginnings)


@dataclass(frozen=True)
class EkfPredicted:
    """One-step predictions of every record."""

    parts: tuple[EkfLikelihood, ...]

    @property
    def negative_log_likelihood(self) -> float:
        return -sum(part.log_likelihood for part in self.parts)


def _directions(problem: EkfProblem, z: np.ndarray, std: np.ndarray) -> Directions:
    """∂(parameters, intensities, variances, x0)/∂(z of the unknowns, z of one initial state)."""
    unknowns, n = problem.unknowns, problem.state_scale.size
    p = problem.n_unknowns
    slopes = unknowns.slopes(z[:p])
    sizes = (len(problem.model.names), unknowns.intensity.size, std.size)
    parameters, intensity, variance = (np.zeros((p + n, size)) for size in sizes)
    names = problem.model.names
    for i, (coordinate, slope) in enumerate(zip(unknowns.coordinates, slopes, strict=True)):
        if coordinate.kind == "parameter":
            parameters[i, names.index(coordinate.name)] = slope
        elif coordinate.kind == "process":
            intensity[i, coordinate.index] = slope
        else:
            variance[i, coordinate.index] = 2.0 * std[coordinate.index] * slope
    mean = np.vstack([np.zeros((p, n)), np.diag(problem.state_scale)])
    return Directions(parameters, intensity, variance, mean)


def identify_by_ekf(explicit: Dynamics, setup: Setup, tell: Tell = silent) -> FitResult:
    """As `identify_nonlinear`, whose prediction-error estimate it starts from, by maximum likelihood.

    Standard errors of parameters and noises are those of the Fisher information. Method "oe" is left to
    `identify_nonlinear`. A model with invariants is simulated first: its states, which constraints tie, have
    no observer with a constant gain. Where the model is not smooth over a few substeps of a sample, or the
    filter predicts worse than the observer, the result of `identify_nonlinear` is returned with a note.
    """
    began = time.perf_counter()
    first = nonlinear_ends(explicit, setup, tell)
    setup = first.setup
    if setup.method == "oe":
        return fit_result(setup, first, tell, began)
    problem, z = _problem(explicit, setup, setup.estimate_intensity, first)
    given = _given_start(problem, z, setup)
    starts = [with_lost_ones(problem.unknowns, z, given), given]
    if explicit.invariants is not None and not np.all(setup.estimate_intensity):
        starts += _wide_ends(explicit, setup, first)
    ends = _search(problem, starts, given, setup.options)
    reached = log_likelihood(setup.unknowns, first.best.found)
    if ends is None or log_likelihood(ends[0].unknowns, ends[1]) < reached - FIT.worse_filter:
        result = fit_result(setup, first, tell, began)
        note = "not smooth enough for the extended filter: predictions of an observer"
        return replace(result, notes=(*result.notes, note))
    return fit_result(setup, EkfEnds(setup, first, *ends), tell, began)


def _limits(problem: EkfProblem) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the search vector."""
    n_initial = len(problem.records) * problem.state_scale.size
    lower = np.concatenate([problem.unknowns.lower, np.full(n_initial, -FIT.state_range)])
    upper = np.concatenate([problem.unknowns.upper, np.full(n_initial, FIT.state_range)])
    return lower, upper


def _problem(
    explicit: Dynamics, setup: Setup, estimate_intensity: np.ndarray, first: NonlinearEnds
) -> tuple[EkfProblem, np.ndarray]:
    best, flat, unknowns, given_std = first.best, explicit.flat, setup.unknowns, setup.given_std
    values = unknowns.natural(best.found.z[: len(unknowns.coordinates)])
    theta, levels = best.problem.theta(best.found.z), first.levels
    intensity, std = np.nan_to_num(levels.intensity), levels.measurement_std
    model = local_model(explicit, unknowns.parameter_names(), tangents=True)
    records = tuple(record(model, e.time, e.inputs, e.outputs, best.problem.hold) for e in setup.experiments)
    x0 = best.problem.initial_states(best.found.z)
    least = FIT.least_felt_noise * felt_intensity(model, records[0], theta, x0[0], std)
    intensity = np.where(estimate_intensity, np.maximum(intensity, least), intensity)
    coordinates = [replace(c, initial=v) for c, v in zip(unknowns.coordinates, values, strict=True)]
    coordinates += [
        _noise(w.name, "process", i, intensity[i])
        for i, w in enumerate(flat.noises)
        if estimate_intensity[i] and intensity[i] > 0.0
    ]
    coordinates += [
        _noise(y.name, "measurement", j, std[j]) for j, y in enumerate(flat.outputs) if np.isnan(given_std[j])
    ]
    searched = Unknowns(tuple(coordinates), theta, intensity, std)
    # A state is as large as it becomes, which the filter tells; its first value is a start for that.
    size = _sizes(model, records, theta, Noise(intensity, std**2), x0)
    return EkfProblem(model, records, searched, size), np.concatenate([searched.start, (x0 / size).ravel()])


def _wide_ends(explicit: Dynamics, setup: Setup, first: NonlinearEnds) -> list[np.ndarray]:
    """Where a search ends whose noise may be as wide as a bad start needs it; without its intensities."""
    every = np.ones(len(explicit.flat.noises), dtype=bool)
    problem, z = _problem(explicit, setup, every, first)
    given = _given_start(problem, z, setup)
    ends = _search(problem, [given], given, setup.options)
    return [] if ends is None else [np.delete(ends[1].z, problem.unknowns.of_kind("process"))]


def _rough_objective(problem: EkfProblem) -> Objective:
    """Over the first samples alone, with a few substeps: enough to compare noise levels that differ by
    factors."""
    count = max(2, START_SAMPLES // len(problem.records))
    heads = tuple(
        Record(*(part[:count] for part in (r.time, r.u0, r.u1, r.outputs))) for r in problem.records
    )
    longest = float(np.median(np.concatenate([r.steps for r in heads]))) / START_SUBSTEPS
    return objective(replace(problem, records=heads, longest=longest))


def _given_start(problem: EkfProblem, z: np.ndarray, setup: Setup) -> np.ndarray:
    """The parameters that the user started from, and the initial states that the model asks for there."""
    start = z.copy()
    start[problem.unknowns.of_kind("parameter")] = setup.unknowns.start
    theta = problem.unknowns.values(start[: problem.n_unknowns])[0]
    x0 = [initial_point(problem.model.explicit, theta, e.inputs[0])[0] for e in setup.experiments]
    start[problem.n_unknowns :] = (np.array(x0) / problem.state_scale).ravel()
    return start


def _noise(name: str, kind: str, index: int, value: float) -> Coordinate:
    bounds = (value / FIT.noise_range, value * FIT.noise_range)
    return Coordinate(name, kind, index, value, True, 1.0, *bounds)  # type: ignore[arg-type]


def _sizes(
    model: LocalModel, records: tuple[Record, ...], theta: np.ndarray, noise: Noise, x0: np.ndarray
) -> np.ndarray:
    size = np.max(np.abs(x0), axis=0)
    for data, start in zip(records, x0, strict=True):
        try:
            run = run_ekf(model, data, theta, noise, Start(start, np.zeros((start.size, start.size))))
        except (IntegrationError, EstimationError):
            continue
        size = np.maximum(size, np.max(np.abs(run.filtered), axis=0))
    return np.where(size > 0.0, size, 1.0)


def _search(
    problem: EkfProblem, starts: list[np.ndarray], given: np.ndarray, options: IdentifyOptions
) -> tuple[EkfProblem, Found] | None:
    """The optimum, with substeps so short that halving them hardly changes the likelihood there; None where
    the shortest allowed ones are far too long.

    The most likely start goes first, the others follow where its end is doubtful. `given` is the search
    vector that the user started from.
    """
    rough = _rough_objective(problem)
    z = best_start(rough, problem.unknowns, starts)
    others: Iterable[np.ndarray] = ()
    if options.second_look and options.max_iterations and len(starts) > 1:
        others = (best_start(rough, problem.unknowns, [start]) for start in starts)
    found: Found | None = None
    for _ in range(ROUNDS):
        # A start may be far from smooth where the optimum is not: the shortest substeps then have to do.
        finer = with_substeps(problem, z) or replace(problem, longest=_period(problem) / 2**MOST_HALVINGS)
        if found is not None and finer.longest >= problem.longest:
            break
        problem = finer
        search = Search(
            objective(problem), problem.unknowns, *_limits(problem), given, options.max_iterations
        )
        again = best_point(search, [z], partial(_is_coloured, problem), others)
        if again is None:
            break
        found, z, others = again, again.z, ()
    if found is None or _change_by_halving(problem, found.z) > FIT.rough_substeps * _allowed_change(problem):
        return None
    return problem, found


def _is_coloured(problem: EkfProblem, found: Found) -> bool:
    """Whether the innovations at the end of a search are not white."""
    predicted = problem.predict(found.z)
    if predicted is None:
        return True
    pairs = [
        (part.whitened, data.outputs) for part, data in zip(predicted.parts, problem.records, strict=True)
    ]
    return coloured([white for white, _ in pairs], [np.isfinite(y) for _, y in pairs])


def with_substeps(problem: EkfProblem, z: np.ndarray) -> EkfProblem | None:
    """Halve the longest substep until the log-likelihood changes by no more than FIT.substep_change
    allows; None where MOST_HALVINGS are not enough. Shapes: z (n_z,)."""
    period, allowed = _period(problem), _allowed_change(problem)
    longest = np.inf
    coarse = objective(replace(problem, longest=longest))(z, False)
    for halvings in range(1, MOST_HALVINGS + 2):
        finer = period / 2**halvings
        fine = objective(replace(problem, longest=finer))(z, False)
        if coarse is not None and fine is not None and abs(coarse.value - fine.value) <= allowed:
            return replace(problem, longest=min(longest, problem.longest))
        coarse, longest = fine, finer
    return None


def _period(problem: EkfProblem) -> float:
    return float(np.median(np.concatenate([data.steps for data in problem.records])))


def _allowed_change(problem: EkfProblem) -> float:
    return FIT.substep_change * (1.0 + sum(data.time.size for data in problem.records) / 1000.0)


def _change_by_halving(problem: EkfProblem, z: np.ndarray) -> float:
    """Of the log-likelihood; infinite where the filter cannot run."""
    half = min(problem.longest, _period(problem)) / 2
    values = [objective(replace(problem, longest=step))(z, False) for step in (problem.longest, half)]
    coarse, fine = values
    return np.inf if coarse is None or fine is None else abs(coarse.value - fine.value)


@dataclass(frozen=True)
class EkfEnds:
    """Where the search ended that went on from the `first` ones."""

    setup: Setup
    first: NonlinearEnds
    problem: EkfProblem
    best: Found

    @property
    def found(self) -> list[Found]:
        return [self.best]

    @property
    def searched(self) -> Searched:
        return Searched(objective(self.problem), self.problem.unknowns, *_limits(self.problem), self.best)

    def judged(self) -> tuple[End, Told]:
        """By the Fisher information; the `End` has the parameters alone."""
        problem, found = self.problem, self.best
        searched, p, explicit = problem.unknowns, problem.n_unknowns, problem.model.explicit
        theta, intensity, std = searched.values(found.z[:p])
        bounds = [bound_of(c, z) for c, z in zip(searched.coordinates, found.z[:p], strict=True)]
        information = found.evaluation.information
        free = ~without_influence(information, self.setup.n_observed)
        free[:p] &= np.array([b is None for b in bounds], dtype=bool)
        states = problem.initial_states(found.z)
        units = np.concatenate([searched.slopes(found.z[:p]), np.tile(problem.state_scale, len(states))])
        cov = covariance(information, free) * np.outer(units, units)
        values = searched.natural(found.z[:p])
        errors = std_errors(cov, np.concatenate([values, states.ravel()]))
        own = searched.of_kind("parameter")
        rows = np.ix_(own, own)
        end = End(
            self.setup.unknowns,
            values[own],
            cov[rows],
            [errors[i] for i in own],
            [bounds[i] for i in own],
            information[rows],
        )
        table = np.array([np.nan if e is None else e for e in errors[p:]], dtype=float).reshape(states.shape)
        started = zip(self.setup.experiments, states, table, strict=True)
        substeps = f"linearised every {problem.longest:.3g} s between samples"
        first = self.first.judged()[1]
        told = replace(
            first,
            theta=theta,
            noises=_noises(problem, intensity, std, errors, bounds),
            initial_states=tuple(
                FittedInitialState(e.name, explicit.state_names, x0, error) for e, x0, error in started
            ),
            notes=(
                *first.notes,
                "maximum likelihood by the extended Kalman filter",
                *(() if np.isinf(problem.longest) else (substeps,)),
            ),
        )
        return end, told

    def agreements(self, experiments: tuple[Experiment, ...] | None = None) -> tuple[Agreement, Agreement]:
        """From the initial state that fits each simulation best."""
        problem, setup, hold = self.problem, self.setup, self.first.best.problem.hold
        experiments = setup.experiments if experiments is None else experiments
        theta, intensity, std = problem.unknowns.values(self.best.z[: problem.n_unknowns])
        explicit, size = problem.model.explicit, problem.state_scale
        held = TrajectoryProblem(
            integrator(explicit),
            experiments,
            hold,
            replace(setup.unknowns, coordinates=(), theta=theta),
            size,
            std,
        )
        asked = [initial_point(explicit, theta, e.inputs[0])[0] / size for e in experiments]
        limit = np.full(len(asked) * size.size, FIT.state_range)
        x0 = fit_initial_states(held, np.concatenate(asked), -limit, limit)
        fit = minimise(objective(held), x0, -limit, limit, AGREEMENT_ITERATIONS)
        names = explicit.flat.output_names
        simulation = None if fit is None else prediction_errors(held, fit.z)
        measured = [e.outputs for e in experiments]
        simulated = None if simulation is None else list(simulation.errors)
        predicted, noise = [], Noise(intensity, std**2)
        starts = (x0 if fit is None else fit.z).reshape(len(asked), -1) * size
        wide = np.diag(size**2)
        for e, start in zip(experiments, starts, strict=True):
            data = record(problem.model, e.time, e.inputs, e.outputs, hold)
            run = run_ekf(problem.model, data, theta, noise, Start(start, 1e-2 * wide), problem.longest)
            predicted.append(run.innovations)
        return agreement_of(names, measured, simulated), agreement_of(names, measured, predicted)


def _noises(
    problem: EkfProblem, intensity: np.ndarray, std: np.ndarray, errors: list, bounds: list
) -> tuple[FittedNoise, ...]:
    flat = problem.model.explicit.flat
    place: dict[tuple[str, int], int] = {
        (c.kind, c.index): i for i, c in enumerate(problem.unknowns.coordinates)
    }

    def fitted(kind: str, index: int, name: str, value: float, unit: str) -> FittedNoise:
        i = place.get((kind, index))
        error, bound = (None, None) if i is None else (errors[i], bounds[i])
        return FittedNoise(name, kind, float(value), error, unit, i is not None, bound)  # type: ignore[arg-type]

    process = [fitted("process", i, w.name, intensity[i], w.unit) for i, w in enumerate(flat.noises)]
    measured = [fitted("measurement", j, y.name, std[j], y.unit) for j, y in enumerate(flat.outputs)]
    return (*process, *measured)
