"""Filter a recording with a model: every internal variable with its standard deviation. Report section 3.4.

The model is sampled with the steps of the recording, exactly for white noise; only when white noise reaches a
used output directly is it held over a sample, (43)-(45), and the correlation with the output kept, (47).
Internal variables are ξ = X x + U ū + W w + x0; the covariance of x with w is part of the standard deviation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_cost import LARGE, check_memory, filter_cost
from daest.estimation.kalman import kalman_filter, steady_sample, unobservable_states
from daest.estimation.large_filter import LargeResult, can_stream, large_filter
from daest.estimation.modes import has_equal_steps, models_by_interval
from daest.estimation.smoother import smooth as smooth_record
from daest.estimation.stationary import combination_text, stationary_filter
from daest.model.estimates import (
    FilterKind,
    FilterResult,
    InitialState,
    KalmanResult,
    NisSummary,
    OutputComparison,
    ProcessNoiseEstimate,
)
from daest.model.experiment import Experiment
from daest.model.linear import DiscreteModel, StateSpace, StateSpaceFamily
from daest.numerics.distributions import chi2
from daest.numerics.gaussian import marginals
from daest.systems.sample import sample, stacked_inputs
from daest.systems.state_space import state_space

COVERAGE = 0.95  # of the band for the normalised innovations
STEP_RESOLUTION = 1e-8  # steps that differ by less than this part of the median step share one sampled model
NAMED_AT_MOST = 8  # variables in a message
# Time constants of a stationary filter that the record must hold for its start not to matter.
FORGETTING_TIMES = 3.0

Hold = Literal["foh", "zoh"]
Noise = Literal["white", "held"]


@dataclass(frozen=True)
class _Units:
    unknowns: tuple[str, ...]
    outputs: tuple[str, ...]
    noises: tuple[str, ...]


@dataclass(frozen=True)
class _Rows:
    """variable = state_and_noise (x, w) + inputs ū + offset, one row per variable."""

    state_and_noise: np.ndarray
    inputs: np.ndarray
    offset: np.ndarray


def run_filter(
    model: StateSpace | StateSpaceFamily,
    theta: np.ndarray | None,
    experiment: Experiment,
    process_intensity: np.ndarray,
    measurement_cov: np.ndarray,
    kind: FilterKind = "time-varying",
    measure: Sequence[str] | None = None,
    smooth: bool = False,
    initial: InitialState | None = None,
    hold: Hold = "foh",
    tell: Callable[[str], None] = lambda text: None,
) -> FilterResult:
    """Estimate all internal variables of `model` at `theta` (None for a StateSpace) from a recording.

    `process_intensity` (n_w,) or (n_w, n_w): two-sided intensities of the white noises; `measurement_cov`
    (n_y,) or (n_y, n_y): covariance of one sample of the measurement noises, both in the order of the model.
    `measure` names the outputs to use (None: all that were recorded); the other recorded outputs are compared
    with their estimates. `initial` None is an unknown initial state for the time-varying filter, zero for the
    stationary one. `smooth` gives the estimates from the whole record instead of the past. `tell` hears of
    the progress of a large filter.

    Errors (EstimationError): `filter-unknown-output`, `filter-too-large`, and those of `kalman_filter`. What
    cannot be estimated has NaN and inf in the result and is named in its messages.
    """
    ss, all_units = _at(model, theta)
    measure = used_outputs(ss.output_names, experiment, measure)
    rows = [ss.output_names.index(name) for name in measure]
    intensity = _square(process_intensity, len(ss.noise_names))
    noise = noise_rule(ss, intensity, rows)
    used = _with_outputs(ss, rows)
    cov = _square(measurement_cov, len(ss.output_names))[np.ix_(rows, rows)]
    models = sampled_models(used, experiment.time, hold, intensity, cov, noise)
    record = _record(ss, experiment, measure)
    names, units, rows_of = _variables(ss, all_units)
    result: KalmanResult | LargeResult
    if kind == "time-varying" and initial is None and not smooth and can_stream(models, record):
        result = large_filter(models, record, _with_noise(rows_of.state_and_noise, len(ss.noise_names)), tell)
        values, std = result.values, result.std
    else:
        if kind == "time-varying" and len(ss.state_names) >= LARGE:
            check_memory(filter_cost(len(ss.state_names), len(names), len(experiment.time), "stored"))
        result = kalman_filter(models, record, initial, kind, ss.state_names)
        estimates = smooth_record(result).smoothed if smooth else result.filtered
        values, std = marginals(estimates, _with_noise(rows_of.state_and_noise, len(ss.noise_names)))
    values, noise_values = np.split(values, [len(names)], axis=1)
    std, noise_std = np.split(std, [len(names)], axis=1)
    values = values + record.inputs @ rows_of.inputs.T + rows_of.offset
    compared = [n for n in experiment.output_names if n in ss.output_names and n not in measure]
    steady = result.steady_sample if isinstance(result, LargeResult) else steady_sample(result)
    return FilterResult(
        kind=kind,
        smoothed=smooth,
        names=names,
        units=units,
        time=experiment.time,
        values=values,
        std=std,
        output_names=measure,
        innovations=result.innovations,
        nis=nis_summary(result),
        log_likelihood=result.log_likelihood,
        measure=measure,
        compared={
            n: comparison(_measured(experiment, n), values[:, names.index(n)], std[:, names.index(n)])
            for n in compared
        },
        process_noise=ProcessNoiseEstimate(ss.noise_names, all_units.noises, noise_values, noise_std),
        steady_after=None if steady is None else float(experiment.time[steady] - experiment.time[0]),
        noise=noise,
        hold=hold,
        messages=(
            *_messages(ss, result, names, std, intensity, noise, initial, measure),
            *_long_memory(kind, models, experiment.time),
        ),
    )


def noise_rule(ss: StateSpace, intensity: np.ndarray, outputs: Sequence[int]) -> Noise:
    """ "held" when white noise with an intensity above zero reaches one of the outputs (rows) directly."""
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
    """One sampled model for a uniform record, else one per interval; equal steps share their model."""
    steps = np.diff(time)
    if steps.size == 0:
        raise EstimationError("data-too-few-rows", "a filter needs at least two samples")
    if has_equal_steps(time):
        return sample(ss, float((time[-1] - time[0]) / steps.size), hold, intensity, measurement_cov, noise)
    grid = STEP_RESOLUTION * float(np.median(steps))
    lengths, which = np.unique(np.round(steps / grid), return_inverse=True)
    models = [sample(ss, float(length * grid), hold, intensity, measurement_cov, noise) for length in lengths]
    return [models[i] for i in which]


def nis_summary(result: KalmanResult | LargeResult) -> NisSummary:
    """Mean normalised innovation square per scalar innovation with its 95 % chi-square band."""
    n = int(np.sum(result.nis_dof))
    if n == 0:
        return NisSummary(np.nan, np.nan, np.nan, 0)
    tail = (1.0 - COVERAGE) / 2.0
    low, high = chi2.ppf([tail, 1.0 - tail], n) / n
    return NisSummary(float(np.nansum(result.nis)) / n, float(low), float(high), n)


def _at(model: StateSpace | StateSpaceFamily, theta: np.ndarray | None) -> tuple[StateSpace, _Units]:
    if isinstance(model, StateSpace):
        names = (model.unknown_names, model.output_names, model.noise_names)
        return model, _Units(*(("",) * len(part) for part in names))
    values = np.array([p.value for p in model.parameters]) if theta is None else theta
    parts = (model.unknowns, model.outputs, model.noises)
    return state_space(model, values), _Units(*(tuple(v.unit for v in part) for part in parts))


def used_outputs(
    output_names: Sequence[str], experiment: Experiment, measure: Sequence[str] | None
) -> tuple[str, ...]:
    """The outputs of a model to use: those named, or all recorded ones. Raises `filter-unknown-output`."""
    recorded = [name for name in experiment.output_names if name in output_names]
    chosen = recorded if measure is None else list(dict.fromkeys(measure))
    for name in chosen:
        if name not in recorded:
            missing = "was not recorded" if name in output_names else "is no output of the model"
            raise EstimationError(
                "filter-unknown-output",
                f"{name} {missing}",
                where=name,
                remedy=f"recorded outputs of the model: {', '.join(recorded) or 'none'}",
            )
    if not chosen:
        raise EstimationError(
            "filter-unknown-output",
            "no recorded column is an output of the model",
            remedy=f"outputs of the model: {', '.join(output_names) or 'none'}",
        )
    return tuple(chosen)


def _with_outputs(ss: StateSpace, rows: list[int]) -> StateSpace:
    return replace(
        ss,
        output_names=tuple(ss.output_names[i] for i in rows),
        C=ss.C[rows],
        D=ss.D[rows],
        H=ss.H[rows],
        d=ss.d[rows],
    )


def _record(ss: StateSpace, experiment: Experiment, measure: tuple[str, ...]) -> Experiment:
    """The used columns, with the inputs ū of the model in its order."""
    columns = [experiment.input_names.index(name) for name in ss.input_names]
    inputs = stacked_inputs(experiment.inputs[:, columns], experiment.time, ss.input_derivatives)
    outputs = experiment.outputs[:, [experiment.output_names.index(name) for name in measure]]
    slopes = tuple(f"der({ss.input_names[i]})" for i, _ in ss.input_derivatives)
    return Experiment(
        experiment.name, experiment.time, inputs, outputs, tuple(ss.input_names) + slopes, measure
    )


def _variables(ss: StateSpace, units: _Units) -> tuple[tuple[str, ...], tuple[str, ...], _Rows]:
    """Names, units and rows of all internal variables, followed by the outputs that are none of them."""
    extra = [i for i, name in enumerate(ss.output_names) if name not in ss.unknown_names]
    rows = _Rows(
        state_and_noise=np.vstack([np.hstack([ss.X, ss.W]), np.hstack([ss.C, ss.H])[extra]]),
        inputs=np.vstack([ss.U, ss.D[extra]]),
        offset=np.concatenate([ss.x0, ss.d[extra]]),
    )
    names = ss.unknown_names + tuple(ss.output_names[i] for i in extra)
    return names, units.unknowns + tuple(units.outputs[i] for i in extra), rows


def _with_noise(rows: np.ndarray, n_noises: int) -> np.ndarray:
    """The rows, and those of the noises themselves."""
    return np.vstack([rows, np.eye(rows.shape[1])[rows.shape[1] - n_noises :]])


def _measured(experiment: Experiment, name: str) -> np.ndarray:
    return experiment.outputs[:, experiment.output_names.index(name)]


def comparison(measured: np.ndarray, estimate: np.ndarray, std: np.ndarray) -> OutputComparison:
    """Samples whose estimate is less certain than the spread of the signal say nothing and are left out."""
    recorded = measured[np.isfinite(measured)]
    spread = float(np.std(recorded)) if recorded.size else 0.0
    use = np.isfinite(measured) & np.isfinite(estimate) & (std <= spread)
    if not np.any(use):
        return OutputComparison(np.nan, np.nan, 0)
    error, signal = measured[use] - estimate[use], measured[use] - np.mean(measured[use])
    size = np.linalg.norm(signal)
    fit = 100.0 * (1.0 - np.linalg.norm(error) / size) if size > 0 else np.nan
    return OutputComparison(float(fit), float(np.sqrt(np.mean(error**2))), int(np.sum(use)))


def _square(value: np.ndarray, size: int) -> np.ndarray:
    value = np.asarray(value, dtype=float)
    return np.diag(value) if value.ndim == 1 else value.reshape(size, size)


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
            f"{used} never determine {_listed([names[i] for i in open_])}: no value is given for "
            "them. Measure another output or give the initial state."
        )
    elif (unseen := _unobservable(result)).shape[1]:
        hidden = "; ".join(combination_text(v, ss.state_names) for v in unseen.T)
        messages.append(f"{used} never show {hidden}: its uncertainty is that of the given initial state.")
    if noise == "held":
        messages.append("White noise reaches an output directly; it is held over each sample.")
    direct = np.flatnonzero(np.sum(ss.W @ intensity * ss.W, axis=1) > 0.0)
    if direct.size:
        noisy = _listed([ss.unknown_names[i] for i in direct])
        messages.append(f"{noisy} contain white noise: their values are means over one sample.")
    if result.kind == "stationary" and initial is None:
        messages.append("The stationary filter starts with all states at zero.")
    return tuple(messages)


def _unobservable(result: KalmanResult | LargeResult) -> np.ndarray:
    return result.unobservable if isinstance(result, LargeResult) else unobservable_states(result)


def _long_memory(
    kind: FilterKind, models: DiscreteModel | list[DiscreteModel], time: np.ndarray
) -> tuple[str, ...]:
    """A warning where the stationary filter keeps the error of its start over a large part of the record."""
    if kind != "stationary":
        return ()
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


def _listed(names: list[str]) -> str:
    if len(names) > NAMED_AT_MOST:
        return ", ".join(names[:NAMED_AT_MOST]) + f" and {len(names) - NAMED_AT_MOST} more"
    return ", ".join(names)
