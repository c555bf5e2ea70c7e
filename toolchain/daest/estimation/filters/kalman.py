"""The Kalman filter of a linear model, time-varying or stationary, and its smoother. Report section 3.4.

The model is sampled with the steps of the recording, exactly for white noise; only when white noise reaches a
used output directly is it held over a sample, (43)-(45), and the correlation with the output kept, (47).
Internal variables are ξ = X x + U ū + W w + x0; the covariance of x with w is part of the standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines.filter_cost import LARGE, check_memory, filter_cost
from daest.estimation.filter_engines.kalman import kalman_filter, steady_sample, unobservable_states
from daest.estimation.filter_engines.large_filter import LargeResult, can_stream, large_filter
from daest.estimation.filter_engines.modes import has_equal_steps, models_by_interval
from daest.estimation.filter_engines.smoother import smooth as smooth_record
from daest.estimation.filter_engines.stationary import stationary_filter, without_unseen
from daest.estimation.filters.case import Case, Estimates
from daest.estimation.fitting.identifiability import combination_text
from daest.estimation.gates import FIT
from daest.lists import first_few
from daest.model.estimates import InitialState, KalmanResult
from daest.model.experiment import Experiment
from daest.model.holds import Hold
from daest.model.linear import DiscreteModel, StateSpace
from daest.numerics.gaussian import FREE_TOLERANCE, marginals
from daest.systems.linear.state_space import sample, space_for, stacked_inputs

NAMED_AT_MOST = 8  # variables in a message
# Time constants of a stationary filter that the record must hold for its start not to matter.
FORGETTING_TIMES = 3.0

Noise = Literal["white", "held"]


@dataclass(frozen=True)
class _Rows:
    """variable = state_and_noise (x, w) + inputs ū + offset, one row per variable."""

    state_and_noise: np.ndarray
    inputs: np.ndarray
    offset: np.ndarray


def estimate(case: Case, name: str) -> Estimates:
    """Raises EstimationError `filter-too-large` and those of `kalman_filter`."""
    kind: Literal["time-varying", "stationary"] = "stationary" if name == "stationary" else "time-varying"
    experiment, options = case.experiment, case.options
    ss = space_for(case.model.linear, options.hold)
    rows = [ss.output_names.index(name) for name in case.measure]
    intensity, cov = case.model.intensity, case.model.cov[np.ix_(rows, rows)]
    noise = noise_rule(ss, intensity, rows)
    models = sampled_models(_with_outputs(ss, rows), experiment.time, options.hold, intensity, cov, noise)
    record = _record(ss, experiment, case.measure, options.hold)
    unseen = np.zeros((len(ss.state_names), 0))
    if kind == "stationary" and isinstance(models, DiscreteModel):
        models, unseen = without_unseen(models, np.isfinite(record.outputs).any(axis=0))
    names, internal = _variables(ss)
    wanted = _with_noise(internal.state_and_noise, len(ss.noise_names))
    is_unknown = kind == "time-varying" and options.initial is None
    result: KalmanResult | LargeResult
    if is_unknown and not options.smooth and can_stream(models, record):
        result = large_filter(models, record, wanted, case.tell)
        values, std = result.values, result.std
    else:
        if kind == "time-varying" and len(ss.state_names) >= LARGE:
            check_memory(filter_cost(len(ss.state_names), len(names), len(experiment.time), "stored"))
        result = kalman_filter(models, record, options.initial, kind, ss.state_names)
        found = smooth_record(result).smoothed if options.smooth else result.filtered
        values, std = marginals(found, wanted)
    open_ = _reached_by(wanted, unseen)
    values[:, open_], std[:, open_] = np.nan, np.inf
    values, noise_values = np.split(values, [len(names)], axis=1)
    std, noise_std = np.split(std, [len(names)], axis=1)
    return Estimates(
        names=names,
        values=values + record.inputs @ internal.inputs.T + internal.offset,
        std=std,
        noise_values=noise_values,
        noise_std=noise_std,
        innovations=result.innovations,
        nis=float(np.nansum(result.nis)),
        n_innovations=int(np.sum(result.nis_dof)),
        log_likelihood=result.log_likelihood,
        noise=noise,
        steady_sample=result.steady_sample if isinstance(result, LargeResult) else steady_sample(result),
        messages=(
            *_messages(ss, result, names, std, intensity, noise, options.initial, case.measure),
            *(_long_memory(models, experiment.time) if kind == "stationary" else ()),
        ),
    )


def _reached_by(rows: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Which rows (m, n + …) over the state (n) and more a change of the state along `directions` (n, r)
    reaches, (m,) bool."""
    states = rows[:, : directions.shape[0]]
    largest = np.max(np.abs(states) @ np.abs(directions), axis=1, initial=0.0)
    return np.max(np.abs(states @ directions), axis=1, initial=0.0) > FREE_TOLERANCE * largest


def noise_rule(ss: StateSpace, intensity: np.ndarray, outputs: Sequence[int]) -> Noise:
    """ "held" when white noise with an intensity above zero reaches one of the outputs (rows) directly.
    Shapes: intensity (n_w, n_w)."""
    direct = ss.H[list(outputs)]
    return "held" if np.any(np.diagonal(direct @ intensity @ direct.T) > 0.0) else "white"


def sampled_models(
    ss: StateSpace,
    time: np.ndarray,
    hold: Hold,
    intensity: np.ndarray,
    measurement_cov: np.ndarray,
    noise: Noise,
) -> DiscreteModel | list[DiscreteModel]:
    """One sampled model for a uniform record, else one per interval; equal steps share their model. Raises
    EstimationError `data-too-few-rows` below two samples. Shapes: time (n_samples,), intensity (n_w,),
    measurement_cov (n_y, n_y)."""
    steps = np.diff(time)
    if steps.size == 0:
        raise EstimationError("data-too-few-rows", "a filter needs at least two samples")
    if has_equal_steps(time):
        return sample(ss, float((time[-1] - time[0]) / steps.size), hold, intensity, measurement_cov, noise)
    grid = FIT.same_step * float(np.median(steps))
    lengths, which = np.unique(np.round(steps / grid), return_inverse=True)
    models = [sample(ss, float(length * grid), hold, intensity, measurement_cov, noise) for length in lengths]
    return [models[i] for i in which]


def _with_outputs(ss: StateSpace, rows: list[int]) -> StateSpace:
    return replace(
        ss,
        output_names=tuple(ss.output_names[i] for i in rows),
        C=ss.C[rows],
        D=ss.D[rows],
        H=ss.H[rows],
        d=ss.d[rows],
    )


def _record(ss: StateSpace, experiment: Experiment, measure: tuple[str, ...], hold: Hold) -> Experiment:
    """The used columns, with the inputs ū of the model in its order."""
    driving = experiment.inputs_of(ss.input_names)
    inputs = stacked_inputs(driving, experiment.time, ss.input_derivatives, hold)
    outputs = experiment.outputs_of(measure)
    slopes = tuple(f"der({ss.input_names[i]})" for i, _ in ss.input_derivatives)
    return Experiment(
        experiment.name, experiment.time, inputs, outputs, tuple(ss.input_names) + slopes, measure
    )


def _variables(ss: StateSpace) -> tuple[tuple[str, ...], _Rows]:
    """Names and rows of all internal variables, followed by the outputs that are none of them."""
    extra = [i for i, name in enumerate(ss.output_names) if name not in ss.unknown_names]
    rows = _Rows(
        state_and_noise=np.vstack([np.hstack([ss.X, ss.W]), np.hstack([ss.C, ss.H])[extra]]),
        inputs=np.vstack([ss.U, ss.D[extra]]),
        offset=np.concatenate([ss.x0, ss.d[extra]]),
    )
    return ss.unknown_names + tuple(ss.output_names[i] for i in extra), rows


def _with_noise(rows: np.ndarray, n_noises: int) -> np.ndarray:
    """The rows, and those of the noises themselves."""
    return np.vstack([rows, np.eye(rows.shape[1])[rows.shape[1] - n_noises :]])


def _messages(
    ss: StateSpace,
    result: KalmanResult | LargeResult,
    names: tuple[str, ...],
    std: np.ndarray,
    intensity: np.ndarray,
    noise: Noise,
    initial: InitialState | None,
    measure: tuple[str, ...],
) -> tuple[str, ...]:
    messages = []
    used = ", ".join(measure)
    open_ = np.flatnonzero(np.isinf(std[-1]))
    if open_.size:
        messages.append(
            f"{used} never determine {first_few([names[i] for i in open_], NAMED_AT_MOST)}: no value is "
            "given for them. Measure another output or give the initial state."
        )
    elif (unseen := _unobservable(result)).shape[1]:
        hidden = "; ".join(combination_text(v, ss.state_names) for v in unseen.T)
        messages.append(f"{used} never show {hidden}: its uncertainty is that of the given initial state.")
    if noise == "held":
        messages.append("White noise reaches an output directly; it is held over each sample.")
    direct = np.flatnonzero(np.sum(ss.W @ intensity * ss.W, axis=1) > 0.0)
    if direct.size:
        noisy = first_few([ss.unknown_names[i] for i in direct], NAMED_AT_MOST)
        messages.append(f"{noisy} contain white noise: their values are means over one sample.")
    if result.kind == "stationary" and initial is None:
        messages.append("The stationary filter starts with all states at zero.")
    return tuple(messages)


def _unobservable(result: KalmanResult | LargeResult) -> np.ndarray:
    return result.unobservable if isinstance(result, LargeResult) else unobservable_states(result)


def _long_memory(models: DiscreteModel | list[DiscreteModel], time: np.ndarray) -> tuple[str, ...]:
    """A warning where the stationary filter keeps the error of its start over a large part of the record."""
    model, duration = models_by_interval(models, time)[0][0], float(time[-1] - time[0])
    slowest = float(np.max(np.abs(np.linalg.eigvals(stationary_filter(model).closed_loop)), initial=0.0))
    n_samples = np.inf if slowest >= 1.0 else -1.0 / np.log(slowest) if slowest > 0.0 else 0.0
    memory = float(n_samples * np.median(np.diff(time)))
    if FORGETTING_TIMES * memory <= duration:
        return ()
    return (
        f"With so little process noise the stationary filter forgets a wrong start with a time constant of "
        f"{memory:.3g} s, and the record has {duration:.3g} s: the time-varying filter does better.",
    )
