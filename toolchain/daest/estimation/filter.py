"""Filter recordings with a model: every internal variable with its standard deviation. Report section 3.4."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import overload

import numpy as np

from daest.errors import EstimationError
from daest.estimation.filters import FILTERS, usual_filter
from daest.estimation.filters.case import AnyModel, Case, Estimates, FilterModel, linear_refused
from daest.estimation.fitting.signals import fit_percent
from daest.model.estimates import (
    FilterOptions,
    FilterResult,
    NisSummary,
    OutputComparison,
    ProcessNoiseEstimate,
)
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel
from daest.numerics.statistics import chi2
from daest.systems.events.modes import in_starting_mode

COVERAGE = 0.95  # of the band for the normalised innovations


@overload
def run_filter(
    model: AnyModel,
    recordings: Experiment,
    kind: str | None = None,
    options: FilterOptions | None = None,
    tell: Callable[[str], None] = ...,
) -> FilterResult: ...
@overload
def run_filter(
    model: AnyModel,
    recordings: Sequence[Experiment],
    kind: str | None = None,
    options: FilterOptions | None = None,
    tell: Callable[[str], None] = ...,
) -> list[FilterResult]: ...
def run_filter(
    model: AnyModel,
    recordings: Experiment | Sequence[Experiment],
    kind: str | None = None,
    options: FilterOptions | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> FilterResult | list[FilterResult]:
    """Estimate all internal variables of `model` from a recording, or from each of several.

    `model` has equations, or is their explicit form, or a linear model in state space; an FMU without
    equations serves as well. `kind` is a name of `estimation.filters.FILTERS`; None is "time-varying" for an
    affine model and "ekf" for any other. `tell` is called with texts about the progress of a long run.

    What the data cannot tell has NaN and inf in the result and is named in its messages. Raises
    EstimationError `filter-kind-unknown`, `filter-unknown-output`, `filter-noise-unknown`,
    `filter-linear-model`, `filter-noise-correlated`, `filter-too-large`, `filter-initial-state`,
    `filter-singular-innovation`, `filter-events`, `output-white-noise`, `particle-collapse` and
    those of `kalman_filter`; FmuError `fmu-co-simulation-only`; IntegrationError where the model has no
    finite value on the way.

    Example: the angular velocity from the angle alone.

        result = daest.run_filter(fitted, data, options=daest.FilterOptions(measure=["phi"]))
        result.to_frame()[["omega", "omega.std"]]

        >>> daest.run_filter(flat, record, "stationary").kind
        'stationary'
    """
    options = options or FilterOptions()
    if isinstance(model, FlatModel):
        model = in_starting_mode(model, theta=options.theta)
    ready = FilterModel.of(model, options)
    if ready.flat is not None:
        ready.flat.refuse_hidden_states("filter")
    has_events = ready.flat is not None and ready.flat.events is not None
    name = kind or usual_filter(ready.is_affine, has_events)
    if name not in FILTERS:
        raise EstimationError(
            "filter-kind-unknown", f"there is no filter {name}", remedy=f"there are {', '.join(FILTERS)}"
        )
    if has_events and FILTERS[name].is_linear:
        raise linear_refused(name)
    estimate = import_module(f"daest.estimation.filters.{FILTERS[name].file}").estimate

    def one(experiment: Experiment) -> FilterResult:
        case = Case(ready, experiment, used_outputs(ready, experiment, options.measure), options, tell)
        return _result(case, name, estimate(case, name))

    return one(recordings) if isinstance(recordings, Experiment) else [one(each) for each in recordings]


def used_outputs(
    model: FilterModel, experiment: Experiment, measure: Sequence[str] | None
) -> tuple[str, ...]:
    """The outputs of a model to use: those named, or all recorded ones. Raises `filter-unknown-output`."""
    recorded = [name for name in experiment.output_names if name in model.output_names]
    chosen = recorded if measure is None else list(dict.fromkeys(measure))
    for name in chosen:
        if name not in recorded:
            missing = "was not recorded" if name in model.output_names else "is no output of the model"
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
            remedy=f"outputs of the model: {', '.join(model.output_names) or 'none'}",
        )
    return tuple(chosen)


def _result(case: Case, kind: str, found: Estimates) -> FilterResult:
    experiment, units, time = case.experiment, case.model.units, case.experiment.time
    unused = [n for n in experiment.output_names if n in case.model.output_names and n not in case.measure]
    compared = {
        name: comparison(
            experiment.output(name),
            found.values[:, found.names.index(name)],
            found.std[:, found.names.index(name)],
        )
        for name in unused
    }
    steady = found.steady_sample
    return FilterResult(
        kind=kind,
        smoothed=case.options.smooth,
        names=found.names,
        units=tuple(units.get(name, "") for name in found.names),
        time=time,
        values=found.values,
        std=found.std,
        output_names=case.measure,
        innovations=found.innovations,
        nis=nis_summary(found.nis, found.n_innovations),
        log_likelihood=found.log_likelihood,
        measure=case.measure,
        compared=compared,
        process_noise=ProcessNoiseEstimate(
            case.model.noise_names, case.model.noise_units, found.noise_values, found.noise_std
        ),
        steady_after=None if steady is None else float(time[steady] - time[0]),
        noise=found.noise,
        hold=case.options.hold,
        messages=found.messages,
        effective_sample_size=found.effective,
    )


def nis_summary(total: float, n_innovations: int) -> NisSummary:
    """Mean normalised innovation square per scalar innovation with its 95 % chi-square band."""
    if n_innovations == 0:
        return NisSummary(np.nan, np.nan, np.nan, 0)
    tail = (1.0 - COVERAGE) / 2.0
    low, high = chi2.ppf([tail, 1.0 - tail], n_innovations) / n_innovations
    return NisSummary(total / n_innovations, float(low), float(high), n_innovations)


def comparison(measured: np.ndarray, estimate: np.ndarray, std: np.ndarray) -> OutputComparison:
    """Samples whose estimate is less certain than the spread of the signal say nothing and are left out.
    All arrays have the shape (n_samples,)."""
    recorded = measured[np.isfinite(measured)]
    spread = float(np.std(recorded)) if recorded.size else 0.0
    use = np.isfinite(measured) & np.isfinite(estimate) & (std <= spread)
    if not np.any(use):
        return OutputComparison(np.nan, np.nan, 0)
    squares = (measured[use] - estimate[use]) ** 2
    fit = fit_percent([measured[use]], float(np.sum(squares)))
    return OutputComparison(
        np.nan if fit is None else fit, float(np.sqrt(np.mean(squares))), int(np.sum(use))
    )
