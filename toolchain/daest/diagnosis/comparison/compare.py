"""Models side by side on recordings: how well each simulates and predicts, whether the data contradict it,
and where it fails."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from daest.diagnosis.comparison.affine_trial import AffineModel, affine_follower, affine_model, affine_trial
from daest.diagnosis.comparison.nonlinear_trial import (
    NonlinearModel,
    nonlinear_follower,
    nonlinear_model,
    nonlinear_trial,
)
from daest.diagnosis.comparison.residual_tests import (
    Raw,
    RawTest,
    joined,
    judged,
    residual_tests,
    with_limit,
)
from daest.diagnosis.comparison.trial import Candidate, Trial, agreement
from daest.diagnosis.comparison.where import ErrorSeries, Signal, distinct, where
from daest.diagnosis.gates import GATES
from daest.errors import EstimationError
from daest.estimation.fitting.records import in_model_order, n_observed
from daest.model.comparison import Comparison, ModelTrial
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel, Model
from daest.numerics.parallel import Workers, workers
from daest.systems.events.modes import in_starting_mode
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.reduction.reduce import dynamics
from daest.systems.simulation.simulate import simulate

__all__ = ["Candidate", "compare_models", "follower"]


@dataclass(frozen=True)
class _Ready:
    """A candidate with what every trial of it needs again."""

    candidate: Candidate
    prepared: AffineModel | NonlinearModel

    def trial(self, experiments: Sequence[Experiment]) -> Trial:
        if isinstance(self.prepared, AffineModel):
            return affine_trial(self.candidate, experiments, self.prepared)
        return nonlinear_trial(self.candidate, experiments, self.prepared)


def _ready(candidate: Candidate, experiments: Sequence[Experiment]) -> _Ready:
    flat = candidate.flat
    if isinstance(flat, FlatModel) and flat.events is not None:
        flat = in_starting_mode(flat, experiments[0])
    explicit = dynamics(flat)
    if flat.events is None and has_affine_dynamics(explicit):
        return _Ready(candidate, affine_model(explicit))
    return _Ready(candidate, nonlinear_model(explicit, candidate.parameter_names))


def follower(
    candidate: Candidate, experiments: Sequence[Experiment]
) -> Callable[[np.ndarray], tuple[np.ndarray, ...]]:
    """What a comparison simulates, as a function of theta: outputs (n_samples, n_y) of every recording. All
    that does not depend on theta is prepared here."""
    experiments = [in_model_order(e, candidate.flat) for e in experiments]
    ready = _ready(candidate, experiments)
    if isinstance(ready.prepared, AffineModel):
        return affine_follower(candidate, experiments, ready.prepared)
    return nonlinear_follower(candidate, experiments, ready.prepared)


def compare_models(
    candidates: Sequence[Candidate],
    experiments: Sequence[Experiment],
    *,
    bootstrap: int = 0,
    seed: int = 0,
    jobs: int = 1,
    cluster: str | None = None,
) -> Comparison:
    """Every candidate on all experiments; outputs are those of the first candidate, which all must have.

    A measurement noise that is not known is the one that the simulation leaves. Values are NaN and
    agreements None where a model overflows. `bootstrap` records without fault, simulated with the model
    itself, take the place of the tables of the tests; `LEAST_NULL_RECORDS` are needed to falsify
    anything. They are made in `jobs` processes where that is worth while, or on the Dask `cluster` at an
    address, with the same result. Raises EstimationError `compare-bootstrap-noise`.

        >>> found = daest.compare_models([daest.Candidate("as it is", flat, 0)], [record])
        >>> found.output_names
        ('omega', 'phi')
    """
    outputs = candidates[0].flat.outputs
    with workers(jobs if bootstrap else 1, cluster if bootstrap else None) as pool:
        models = tuple(_model_trial(c, experiments, bootstrap, seed, pool) for c in candidates)
    return Comparison(
        experiments=tuple(experiments),
        output_names=tuple(output.name for output in outputs),
        output_units=tuple(output.unit for output in outputs),
        models=models,
    )


def _model_trial(
    candidate: Candidate, experiments: Sequence[Experiment], bootstrap: int, seed: int, pool: Workers
) -> ModelTrial:
    flat = candidate.flat
    experiments = [in_model_order(e, flat) for e in experiments]
    ready = _ready(candidate, experiments)
    trial = ready.trial(experiments)
    raw, feedback = _tests(candidate, experiments, trial)
    level = None
    if bootstrap and any(raw.values()):
        raw, level = _bootstrapped(_Faultless(ready, tuple(experiments), trial), raw, bootstrap, seed, pool)
    tests = judged(raw, level)
    passed = [test.passed for by_output in tests.values() for test in by_output.values()]
    n_values = n_observed(experiments)
    return ModelTrial(
        name=candidate.name,
        n_parameters=candidate.n_parameters,
        simulation=agreement(flat, experiments, trial.simulated),
        one_step=agreement(flat, experiments, trial.predicted),
        log_likelihood=float(trial.log_likelihood),
        bic=float(candidate.n_parameters * np.log(n_values) - 2.0 * trial.log_likelihood),
        simulated=trial.simulated,
        predicted=trial.predicted,
        notes=(
            *candidate.notes,
            *trial.notes,
            *_not_asked(candidate, trial),
            *_notes(trial, feedback, is_doubtful=not all(passed)),
        ),
        tests=tests,
        feedback={name: with_limit(test, GATES.residual_level) for name, test in feedback.items()},
        verdict=None if not passed else ("not falsified" if all(passed) else "falsified"),
        where=where(_error_series(flat, experiments, trial), seed),
        growth=trial.growth,
        residuals=trial.residuals,
    )


def _notes(trial: Trial, feedback: Mapping[str, RawTest], *, is_doubtful: bool) -> list[str]:
    """Remarks on the trial. Where the model is wrong (`is_doubtful`), what it lacks may follow the inputs of
    long ago, and with them those to come, without any feedback."""
    notes = []
    if trial.residuals and trial.is_output_error:
        notes.append(
            "no process noise: one-step errors are those of the simulation, and whiteness is asked of them"
        )
    closed = [name for name, test in feedback.items() if test.p_value < GATES.residual_level / len(feedback)]
    if closed:
        cause = "a controller acts on them, or the model lacks something" if is_doubtful else "closed loop"
        notes.append(
            f"the inputs follow the errors of {', '.join(closed)}: {cause}. In closed loop the error of "
            "predictions is a fairer judge than that of the simulation"
        )
    return notes


def _tests(
    candidate: Candidate, experiments: Sequence[Experiment], trial: Trial
) -> tuple[Raw, dict[str, RawTest]]:
    if not trial.residuals:
        return {}, {}
    names = candidate.flat.output_names
    variables = _signals(candidate.flat, experiments, trial, trial.predicted_variables)
    counts = np.cumsum([e.n_samples for e in experiments])[:-1]
    columns = (
        np.column_stack([s.values for s in variables])
        if variables
        else np.zeros((sum(map(len, trial.residuals)), 0))
    )
    sequences = joined(
        trial.residuals,
        [e.inputs for e in experiments],
        np.split(columns, counts),
        trial.slopes,
        candidate.parameter_cov if trial.slopes else None,
        acts_at_once=trial.acts_at_once,
        n_estimation=candidate.n_estimation,
        known_noise=trial.known_noise & ~_to_estimate(candidate),
    )
    return residual_tests(sequences, names)


def _to_estimate(candidate: Candidate) -> np.ndarray:
    """Outputs (n_y,) whose noise is the start of an estimate that no fit has made: its size contradicts
    nothing."""
    no_fit = candidate.n_estimation is None
    return np.array([no_fit and output.estimate_noise for output in candidate.flat.outputs], dtype=bool)


def _not_asked(candidate: Candidate, trial: Trial) -> tuple[str, ...]:
    """Says whose errors were not held against the size of the noise."""
    names = np.array(candidate.flat.output_names)[trial.known_noise & _to_estimate(candidate)]
    if not trial.residuals or not names.size:
        return ()
    return (
        f"the noise of {', '.join(names)} is where an estimate would start, and no fit has made it: whether "
        "errors have the predicted size is not asked (estimate = false says that the size is known)",
    )


def _signals(
    flat: Model, experiments: Sequence[Experiment], trial: Trial, variables: Sequence[np.ndarray]
) -> tuple[Signal, ...]:
    """Distinct signals over all recordings: outputs of the model first, then its inputs, then short names.

    Outputs and variables are known without the sample that they belong to.
    """
    model = trial.predicted if variables is trial.predicted_variables else trial.simulated
    names = [(o.name, o.unit) for o in flat.outputs]
    signals = [Signal(n, u, np.concatenate([y[:, j] for y in model])) for j, (n, u) in enumerate(names)]
    inputs = np.concatenate([e.inputs for e in experiments])
    signals += [Signal(v.name, v.unit, inputs[:, j]) for j, v in enumerate(flat.inputs)]
    # Columns that the model does not use tell as much of where it fails.
    unused = [name for name in experiments[0].extra if all(name in e.extra for e in experiments)]
    columns = [(name, np.concatenate([e.extra[name] for e in experiments])) for name in unused]
    signals += [Signal(name, "", column) for name, column in columns if np.all(np.isfinite(column))]
    values = np.concatenate(list(variables))
    order = sorted(range(values.shape[1]), key=lambda j: (trial.variable_names[j].count("."), j))
    signals += [Signal(trial.variable_names[j], trial.variable_units[j], values[:, j]) for j in order]
    return distinct(signals)


def _error_series(flat: Model, experiments: Sequence[Experiment], trial: Trial) -> tuple[ErrorSeries, ...]:
    """One-step errors in units of their predicted spread, so that a filter that settles is no fault, and
    errors of the simulation."""
    simulated = [e.outputs - y for e, y in zip(experiments, trial.simulated, strict=True)]
    series = _series_of(flat, experiments, trial, "simulation", simulated)
    if trial.residuals and not trial.is_output_error:
        series = (*_series_of(flat, experiments, trial, "one-step", trial.residuals), *series)
    return series


def _series_of(
    flat: Model,
    experiments: Sequence[Experiment],
    trial: Trial,
    kind: Literal["one-step", "simulation"],
    errors: Sequence[np.ndarray],
) -> tuple[ErrorSeries, ...]:
    variables = trial.simulated_variables if kind == "simulation" else trial.predicted_variables
    signals = _signals(flat, experiments, trial, variables)
    if not signals:
        return ()
    record = np.repeat(np.arange(len(experiments)), [e.n_samples for e in experiments])
    time = np.concatenate([e.time for e in experiments])
    names = tuple(e.name for e in experiments)
    table = np.concatenate(list(errors))
    return tuple(
        ErrorSeries(output.name, kind, table[:, j], time, record, names, signals)
        for j, output in enumerate(flat.outputs)
    )


@dataclass(frozen=True)
class _Faultless:
    """What simulated records without fault are made from."""

    ready: _Ready
    experiments: tuple[Experiment, ...]
    trial: Trial


def _bootstrapped(faultless: _Faultless, raw: Raw, n: int, seed: int, pool: Workers) -> tuple[Raw, float]:
    """Tests with the p-values of `n` records that the model itself produced, and the level of a single test
    at which `residual_level` of these records fail any."""
    candidate = faultless.ready.candidate
    unknown = [o.name for o in candidate.flat.outputs if o.noise_std is None]
    if unknown:
        raise EstimationError(
            "compare-bootstrap-noise",
            f"the measurement noise of {', '.join(unknown)} is not known, so that no record can be simulated",
            where=candidate.name,
            remedy="identify the model first, or give the noise (std) in the model or in daest.toml",
        )
    first, *others = np.random.SeedSequence(seed).spawn(n)
    work = partial(_drawn, faultless)
    began = time.perf_counter()
    outcomes = list(Workers().map(work, [first]))
    outcomes += pool.map(work, others, seconds=time.perf_counter() - began)
    drawn = [outcome.get() for outcome in outcomes]
    calibrated = {
        kind: {
            name: _calibrated(test, [p_values[kind, name] for p_values in drawn if (kind, name) in p_values])
            for name, test in tests.items()
        }
        for kind, tests in raw.items()
    }
    smallest = [min(p_values.values(), default=1.0) for p_values in drawn]
    rank = int(GATES.residual_level * (n + 1))
    level = float(np.sort(smallest)[rank - 1]) if rank else 0.0
    return calibrated, level


def _drawn(faultless: _Faultless, seed: np.random.SeedSequence) -> dict[tuple[str, str], float]:
    """p-values of a simulated record, by kind of test and output."""
    candidate = faultless.ready.candidate
    again = _resampled(candidate, faultless.experiments, faultless.trial, np.random.default_rng(seed))
    found, _feedback = _tests(candidate, again, faultless.ready.trial(again))
    return {(kind, name): test.p_value for kind, tests in found.items() for name, test in tests.items()}


def _calibrated(test: RawTest, drawn: Sequence[float]) -> RawTest:
    as_extreme = sum(p_value <= test.p_value for p_value in drawn)
    return replace(test, p_value=(1 + as_extreme) / (1 + len(drawn)))


def _resampled(
    candidate: Candidate, experiments: Sequence[Experiment], trial: Trial, rng: np.random.Generator
) -> list[Experiment]:
    """The experiments with outputs of the model, noise included; parameters vary within their uncertainty."""
    flat = _varied(candidate, rng)
    result = []
    for experiment, x0 in zip(experiments, trial.initial_states, strict=True):
        outputs = simulate(
            flat, experiment, hold=candidate.hold, x0=x0, noise=True, seed=int(rng.integers(2**31))
        ).outputs
        result.append(replace(experiment, outputs=np.where(np.isfinite(experiment.outputs), outputs, np.nan)))
    return result


def _varied(candidate: Candidate, rng: np.random.Generator) -> Model:
    if candidate.parameter_cov is None:
        return candidate.flat
    shifts = rng.multivariate_normal(np.zeros(len(candidate.parameter_names)), candidate.parameter_cov)
    shift = dict(zip(candidate.parameter_names, shifts, strict=True))
    parameters = []
    for p in candidate.flat.parameters:
        low, high = (-np.inf if p.min is None else p.min), (np.inf if p.max is None else p.max)
        parameters.append(replace(p, value=float(np.clip(p.value + shift.get(p.name, 0.0), low, high))))
    return replace(candidate.flat, parameters=tuple(parameters))
