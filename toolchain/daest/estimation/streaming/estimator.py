"""The parts of an exported estimator: the filter of a model with its start and its noise levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import casadi as ca
import numpy as np

from daest.errors import EstimationError
from daest.estimation.filter_engines.ukf import SigmaPoints
from daest.estimation.filters.case import FilterModel
from daest.estimation.streaming.online_gaussian import OnlineGaussian, inside_function, online_gaussian
from daest.estimation.streaming.online_kalman import online_kalman
from daest.fmu.estimator_code import EstimatorModel, chosen_values
from daest.fmu.estimator_linear import EstimatorStart, LinearForm
from daest.fmu.estimator_nonlinear import NonlinearForm
from daest.model.estimates import FilterKind, FilterOptions, InitialState
from daest.model.flat import FlatModel, Model, events_refused, with_equations
from daest.model.holds import Hold, causal_hold
from daest.systems.linear.linearize import is_affine_model
from daest.systems.linear.state_space import state_space_family
from daest.systems.simulation.integrate import interval_inputs
from daest.systems.simulation.local_linear import internal_names

EstimatorKind = Literal["stationary", "kalman", "ekf", "ukf"]
FILTER_OF: dict[str, FilterKind] = {"kalman": "time-varying", "stationary": "stationary"}


def estimator_model(
    model: Model,
    period: float,
    kind: EstimatorKind | None = None,
    hold: Hold = "foh",
    only: Sequence[str] = (),
    initial: InitialState | None = None,
    longest: float | None = None,
) -> EstimatorModel:
    """The estimator of `model` with its parameters and noises, for steps of about `period` [s].

    `kind` None: kalman for an affine model, ekf for another. `only` names the variables that it tells;
    `longest` [s]: of the substeps of a nonlinear filter. Raises FmuError `fmu-no-equations`, EstimationError
    `estimator-nonlinear`, `filter-unknown-variable`, `filter-noise-unknown` and those of `online_kalman` and
    `online_gaussian`.
    """
    flat = with_equations(model, "the export of an estimator")
    if flat.events is not None:
        raise events_refused("an exported estimator")
    is_affine = is_affine_model(flat)
    chosen = kind or ("kalman" if is_affine else "ekf")
    values, hold = chosen_values(flat, only), causal_hold(hold)
    if chosen == "ekf" or chosen == "ukf":
        return _nonlinear(flat, period, chosen, hold, values, initial, longest)
    if not is_affine:
        raise EstimationError(
            "estimator-nonlinear",
            f"there is no {chosen} estimator of a nonlinear model",
            where=flat.name,
            remedy="use --kind ekf or --kind ukf",
        )
    return _linear(flat, period, FILTER_OF[chosen], hold, values, initial)


def _linear(
    flat: FlatModel,
    period: float,
    kind: FilterKind,
    hold: Hold,
    values: tuple[str, ...],
    initial: InitialState | None,
) -> EstimatorModel:
    family = state_space_family(flat)
    ready = FilterModel.of(flat, FilterOptions(hold=hold))
    online = online_kalman(
        ready.linear, ready.intensity, ready.cov, period, kind=kind, hold=hold, initial=initial
    )
    first = online.first
    start = EstimatorStart(first.mean, first.cov, first.sensitivity, first.root.shape[0], first.log_density)
    intensity, variance = ready.independent_noise()
    slopes = tuple(source for source, _ in family.input_derivatives)
    return EstimatorModel(
        flat, family.state_names, family.state_units, slopes, ready.theta, intensity, np.sqrt(variance),
        online.scale, period, hold, values, LinearForm(family, online.noise == "held", start),
    )  # fmt: skip


def _nonlinear(
    flat: FlatModel,
    period: float,
    kind: Literal["ekf", "ukf"],
    hold: Hold,
    values: tuple[str, ...],
    initial: InitialState | None,
    longest: float | None,
) -> EstimatorModel:
    ready = FilterModel.of(flat, FilterOptions(hold=hold))
    intensity, variance = ready.independent_noise()
    online = online_gaussian(
        ready.explicit, ready.theta, intensity, np.sqrt(variance), period, kind=kind, hold=hold,
        initial=initial, longest=longest,
    )  # fmt: skip
    explicit = online.model.explicit
    interval_inputs(explicit, np.arange(2.0), np.zeros((2, len(flat.inputs))), hold)  # says what it lacks
    nominal = {v.name: abs(v.nominal or 1.0) for v in flat.unknowns}
    weights = tuple(SigmaPoints().weights(explicit.n_states)) if kind == "ukf" else None
    form = NonlinearForm(
        online.model, _chosen(online, values), online.first.mean, online.first.cov,
        np.array([nominal.get(name, 1.0) for name in explicit.state_names]), online.longest, weights,
    )  # fmt: skip
    slopes = tuple(derivative.index for derivative in explicit.input_derivatives)
    return EstimatorModel(
        flat, explicit.state_names, explicit.state_units, slopes, ready.theta, intensity, np.sqrt(variance),
        np.sqrt(np.diagonal(online.first.cov)), period, hold, values, form,
    )  # fmt: skip


def _chosen(online: OnlineGaussian, values: tuple[str, ...]) -> ca.Function:
    """(x, u, v, w, theta, t) -> the variables `values`, and their slopes row by row."""
    explicit = online.model.explicit
    inside = inside_function(explicit)
    rows = [internal_names(explicit).index(name) for name in values]
    symbols: list[ca.MX] = inside.sx_in() if explicit.is_symbolic else inside.mx_in()  # type: ignore[assignment]
    value, slopes = inside.call(symbols, True, False)
    chosen = [ca.densify(value[rows]), ca.vec(ca.densify(slopes[rows, :]).T)]
    return ca.Function("daest_inside", symbols, chosen)
