"""Parametric bootstrap of a fit: how estimates scatter over recordings that the fitted model could have made.

Each recording is simulated with the inputs, initial states, noises and gaps of the measured ones, and
identified like them, from the estimate. Where residuals of a simulation are coloured, the noise of an output
is coloured like them (a sieve: Bühlmann, Bernoulli 3, 1997). Percentile intervals (Efron and Tibshirani 1993,
section 13.3) need no assumption of linearity or of the shape of the likelihood; like standard errors they
take the model for true.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

import numpy as np

from daest.errors import DaestError, EstimationError
from daest.estimation.fitting.fitted import fitted_model
from daest.estimation.fitting.identifiability import are_coloured
from daest.estimation.fitting.profile import Tell, silent
from daest.estimation.fitting.records import in_model_order
from daest.estimation.gates import FIT
from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import Bootstrap, FitResult, IdentifyOptions
from daest.model.flat import Dynamics, Model
from daest.numerics.parallel import workers
from daest.numerics.statistics import autoregression
from daest.systems.reduction.reduce import dynamics
from daest.systems.reduction.redundant import good_everywhere
from daest.systems.simulation.simulate import simulate

LEVEL = 0.95


@dataclass(frozen=True)
class Coloured:
    """A simulation without noise (n_samples, n_y), and the vector autoregression of what it leaves:
    coefficients (order, n_y, n_y) and covariance (n_y, n_y) of what drives it."""

    outputs: np.ndarray
    coefficients: np.ndarray
    cov: np.ndarray

    def drawn(self, rng: np.random.Generator) -> np.ndarray:
        """Outputs with noise of that colour, (n_samples, n_y)."""
        n, n_y = self.outputs.shape
        errors = rng.multivariate_normal(np.zeros(n_y), self.cov, 2 * n, method="eigh")
        order = len(self.coefficients)
        stacked = self.coefficients.transpose(0, 2, 1).reshape(-1, n_y)
        for k in range(order, 2 * n):
            errors[k] += errors[k - order : k][::-1].ravel() @ stacked
        return self.outputs + errors[n:]  # the first half forgets that it began at rest


@dataclass(frozen=True)
class _Model:
    """What every replicate needs: the model to identify, and the one that makes recordings, with the
    simulations of the `experiments` where what these leave is `coloured`."""

    flat: Model
    explicit: Dynamics
    experiments: tuple[Experiment, ...]
    fit: FitResult
    options: IdentifyOptions
    coloured: tuple[Coloured, ...] = ()


def with_bootstrap(
    fit: FitResult,
    flat: Model,
    experiments: Sequence[Experiment],
    options: IdentifyOptions,
    n: int,
    tell: Tell = silent,
) -> FitResult:
    """`fit` (of `flat` to `experiments` with `options`) with `n` refits of simulated recordings.

    Seeded by `options.seed`; refits run where the options say. Raises EstimationError `bootstrap-failed`
    where most refits come to no end, and what `simulate` raises.
    """
    ordered = tuple(in_model_order(e, flat) for e in experiments)
    model = _Model(flat, _simulated_model(flat, fit), ordered, fit, _like(fit, options))
    model = replace(model, coloured=_coloured(model))
    seeds = [int(s.generate_state(1)[0]) for s in np.random.SeedSequence(options.seed).spawn(n)]
    resampled(model, seeds[0])  # what cannot be simulated at all is said before the work begins
    done = count(1)
    with workers(options.jobs, options.cluster) as pool:
        outcomes = pool.map(
            partial(_replicate, model),
            seeds,
            seconds=fit.seconds,
            arrived=lambda *_: tell(f"refits of simulated recordings ({next(done)} of {n})"),
        )
        found = [outcome.get() for outcome in outcomes]
    rows = [row for row in found if row is not None]
    if len(rows) < FIT.least_refitted * n:
        raise EstimationError(
            "bootstrap-failed",
            f"{n - len(rows)} of {n} refits of simulated recordings came to no end",
            remedy="the fit itself is doubtful: look at the directions that the data cannot tell, fix a "
            "parameter or give a prior",
        )
    estimates = np.array(rows)
    tails = 50.0 * (1.0 - LEVEL)
    lower, upper = np.percentile(estimates, [tails, 100.0 - tails], axis=0)
    names = tuple(p.name for p in fit.parameters)
    return replace(fit, bootstrap=Bootstrap(names, estimates, n - len(rows), LEVEL, lower, upper))


def resampled(model: _Model, seed: int) -> list[Experiment]:
    """The recordings with outputs of the fitted model, noise included, where outputs were measured."""
    rng = np.random.default_rng(seed)
    if model.coloured:
        drawn = [one.drawn(rng) for one in model.coloured]
    else:
        drawn = [_simulated(model, i, int(rng.integers(2**31))) for i in range(len(model.experiments))]
    return [
        replace(experiment, outputs=np.where(np.isfinite(experiment.outputs), outputs, np.nan))
        for experiment, outputs in zip(model.experiments, drawn, strict=True)
    ]


def _simulated(model: _Model, index: int, seed: int | None) -> np.ndarray:
    """Outputs (n_samples, n_y) of the fitted model in one experiment, with noise where there is a seed."""
    experiment, state = model.experiments[index], model.fit.initial_states[index]
    has_noise, hold = seed is not None, model.fit.hold
    return simulate(
        model.explicit, experiment, hold=hold, x0=state.values, noise=has_noise, seed=seed
    ).outputs


def _coloured(model: _Model) -> tuple[Coloured, ...]:
    """Of every experiment; empty where what the simulations leave is white, or the fit was one of
    predictions, whose model has the noise of the machine."""
    if model.fit.method != "oe":
        return ()
    clean = [_simulated(model, i, None) for i in range(len(model.experiments))]
    observed = [np.isfinite(e.outputs) for e in model.experiments]
    pairs = zip(model.experiments, observed, clean, strict=True)
    left = [np.where(seen, e.outputs - outputs, 0.0) for e, seen, outputs in pairs]
    if not are_coloured(left, observed):
        return ()
    return tuple(Coloured(one, *autoregression(errors)) for one, errors in zip(clean, left, strict=True))


def _replicate(model: _Model, seed: int) -> np.ndarray | None:
    """Estimates (p,) from one simulated recording; None where the refit comes to no end."""
    try:
        again = identify(model.flat, resampled(model, seed), model.options)
    except DaestError:
        return None
    if again.status == "iteration limit":
        return None
    return np.array([again.theta[p.name] for p in model.fit.parameters])


def _like(fit: FitResult, options: IdentifyOptions) -> IdentifyOptions:
    """Options of the refits: as those of the fit, from the estimate."""
    start = {p.name: p.value for p in fit.parameters}
    return replace(
        options,
        method=fit.method,
        hold=fit.hold,
        start={**options.start, **start},
        estimate=tuple(start),
        starts=1,
        second_look=False,
        profile=(),
        split=None,
        jobs=1,
        cluster=None,
    )


def _simulated_model(flat: Model, fit: FitResult) -> Dynamics:
    """The fitted model with the states that the fit has initial values of."""
    explicit = dynamics(fitted_model(flat, fit))
    has_own = all(state.names == explicit.state_names for state in fit.initial_states)
    return explicit if has_own else good_everywhere(explicit)
