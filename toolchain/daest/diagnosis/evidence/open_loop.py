"""Evidence in open loop, the horizon at which a model is used.

An observer with unknown loads follows the data so closely that what a slow law does is hardly seen one sample
ahead, while the simulation is far off. So candidates are screened by the errors of the simulation, too, and
a law may show itself by a simulation that is better by more than chance. Errors of a simulation last: their
correlation tells how few of the samples count as independent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri, stdtr

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.beside_starts import Started, beside_starts, started
from daest.diagnosis.evidence.free_starts import free_runs
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, simulation_options
from daest.diagnosis.null_model.null_observer import RTOL, run_null
from daest.diagnosis.screening.candidates import courses, ranges
from daest.diagnosis.screening.screen import screen
from daest.estimation.fitting.signals import is_constant
from daest.estimation.identify import identify
from daest.model.diagnosis import Candidate, InUse, Screen
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FitResult, error_ratios, ratios_by_output
from daest.model.flat import ExplicitModel, FlatModel
from daest.numerics.statistics import autoregression
from daest.systems.events.integration import IntegrationError
from daest.systems.simulation.integrate import integrate, integrator

ITERATIONS = 40  # of a search by simulation
MOST_BLOCKS = 50  # of the records, in which two simulations are compared
PARTS = ("estimation", "validation")
START_SHARES = (1.0, 0.1)  # of the sizes by the screen, from which it starts


@dataclass(frozen=True)
class Simulated:
    """Errors (n_samples, n_y) of the simulation of every record that was fitted, and of every unseen one.
    `starts` are the same simulations with what their starts can do, where these count for nothing: there the
    records are many, and short."""

    fitted: tuple[np.ndarray, ...]
    unseen: tuple[np.ndarray, ...]
    starts: tuple[tuple[Started, ...], tuple[Started, ...]] | None = None


def speaks_for(used: InUse, n_own: int) -> bool:
    """Whether a law of `n_own` parameters is better in use by more than chance, also where it was fitted."""
    return (
        min(used.n_independent, used.n_unseen) >= GATES.min_independent
        and used.fitted > 0.0
        and used.bic(n_own) > GATES.min_bic_gain
        and used.ratio < GATES.max_clear_ratio
        and used.certainty > GATES.unseen_significance
    )


def leaves_an_output(explained: float, beside: FitResult, before: FitResult, after: FitResult) -> bool:
    """Whether a law takes hardly any of the load, and leaves an output of the simulation of unseen data
    nearly as wrong as `before`, with most of its squared error no noise, which is that of the fit `beside`
    the loads: an offset of one sensor does a little of what any load does to it. Or whether it takes a part,
    and makes such an output worse: hysteresis of one spring does some of what bushes before both
    dampers do, and cannot do it at the other axle."""
    if explained >= GATES.min_partly_explained or "validation" not in after.simulated:
        return False
    takes_a_part = explained >= GATES.min_curve_explained
    most = 1.0 if takes_a_part else GATES.max_simulated_ratio
    noise = {n.name: n.value for n in beside.noises if n.kind == "measurement"}
    left = after.simulated["validation"].rms
    ratios = ratios_by_output(before.simulated, after.simulated)
    return any(
        ratio > most and noise[name] ** 2 < GATES.max_noise_share * (left[name] or np.inf) ** 2
        for name, ratio in ratios.items()
        if name in noise
    )


def says_more_in_use(used: InUse, other: InUse) -> bool:
    """Whether a law is better in use than another one, on the data that it was fitted to and on unseen ones,
    and better than none on those by more than not."""
    return (
        used.n_independent >= GATES.min_independent
        and other.n_independent >= GATES.min_independent
        and used.fitted > other.fitted
        and used.unseen > other.unseen
        and used.ratio < GATES.max_clear_ratio
        and used.certainty > 0.0
    )


def rivals_in_use(used: InUse, n_own: int, other: InUse, n_other: int) -> bool:
    """Whether a law of `n_own` parameters may be what another one of `n_other` is taken for by its
    simulation: it says more there, or as much for as many independent samples."""
    if says_more_in_use(used, other):
        return True
    n = min(used.n_independent, other.n_independent)
    n_unseen = min(used.n_unseen, other.n_unseen)
    if n < GATES.min_independent:
        return False
    pairs = ((used, n_own), (other, n_other))
    own, others = (replace(u, n_independent=n, n_unseen=n_unseen).bic(m) for u, m in pairs)
    is_better = used.ratio < GATES.max_clear_ratio and used.certainty > 0.0
    return is_better and own > max(GATES.min_bic_gain, others - GATES.same_bic)


def is_far_behind(one: Mapping[str, Agreement], leader: Mapping[str, Agreement]) -> bool:
    """Whether the simulation of a law is far worse than that of the `leader`, of unseen data and of what it
    was fitted to."""
    if not all(part in fit for fit in (one, leader) for part in PARTS):
        return False
    ratios = [error_ratios({"validation": leader[part]}, {"validation": one[part]}) for part in PARTS]
    return all(part and float(np.mean(np.square(part))) > GATES.far_behind_in_use**2 for part in ratios)


def open_screen(null: Null, fit: FitResult, candidates: Sequence[Candidate], seed: int) -> Screen | None:
    """The screen of candidates by the errors of the simulation with the parameters of `fit`; None where it
    cannot be made, or the model has no simulation of its own."""
    if fit.method != "oe":
        return None
    quiet = replace(
        fit, noises=tuple(replace(n, value=0.0) if n.kind == "process" else n for n in fit.noises)
    )
    times = null.shortest_times
    flat = null.flat.with_theta({**fit.theta, **times})
    alone = replace(null, flat=flat, fit=quiet)
    try:
        return screen(alone, run_null(alone), candidates, seed)
    except FAILURES:
        return None


def fitted_in_use(
    null: Null,
    flat: FlatModel,
    names: Sequence[str],
    sizes: Sequence[str],
    reference: FitResult,
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    begun: Mapping[str, float] | None = None,
    iterations: int = ITERATIONS,
) -> FitResult | None:
    """The best simulation of `flat`, a model with a law of the `sizes`, from that of the model without it,
    or from the values where it has `begun`; None where there is none. A search of few `iterations` has one
    start."""
    values = {p.name: p.value for p in flat.parameters}
    options = simulation_options(null, names, iterations)
    near = {name: reference.theta.get(name, values[name]) for name in names}
    starts = [near | {name: share * values[name] for name in sizes} for share in START_SHARES]
    if iterations < ITERATIONS:
        starts = starts[:1]
    if begun:
        starts = [near | dict(begun)]
    best: FitResult | None = None
    for start in starts:
        with suppress(*FAILURES):
            least = -np.inf if best is None else best.log_likelihood
            end = identify(flat, experiments, replace(options, start=start, least=least), validation)
            best = end if end.log_likelihood > least else best
    return best


def simulated_errors(model: Null, validation: Sequence[Experiment]) -> Simulated | None:
    """Errors of a model on its experiments and on unseen ones, from the initial states that fit best; None
    where it cannot be simulated."""
    fitted, unseen = _errors(model, model.experiments), _errors(model, validation)
    return None if fitted is None or unseen is None else Simulated(fitted, unseen)


def _errors(model: Null, experiments: Sequence[Experiment]) -> tuple[np.ndarray, ...] | None:
    runs = free_runs(model, experiments)
    if runs is None:
        return None
    return tuple(e.outputs - run.outputs for e, run in zip(experiments, runs, strict=True))


def errors_in_pieces(
    model: Null, validation: Sequence[Experiment], before: Simulated | None = None
) -> Simulated | None:
    """`simulated_errors` over pieces of records, with what their starts can do; `before` is the simulation
    that it will be compared with."""
    known = ((), ()) if before is None or before.starts is None else before.starts
    fitted, unseen = started(model, model.experiments, known[0]), started(model, validation, known[1])
    if fitted is None or unseen is None:
        return None
    seen, foreseen = (tuple(one.errors for one in part) for part in (fitted, unseen))
    return Simulated(seen, foreseen, starts=(fitted, unseen))


def largest_values(model: Null) -> dict[str, float]:
    """Largest magnitude of every variable in the simulation of the experiments of a model; empty where it
    cannot be simulated."""
    found: dict[str, float] = {}
    for experiment, states in _run_freely(model):
        here = ranges(_at_its_values(model), experiment.time, states, experiment.inputs)
        found = {name: max(value, found.get(name, 0.0)) for name, value in here.items()}
    return found


def values_along(model: Null, names: Sequence[str]) -> np.ndarray | None:
    """Values (n_names, n) of variables in the simulation of the experiments of a model, one experiment after
    the other; None where it cannot be simulated or lacks one of them."""
    parts = []
    for experiment, states in _run_freely(model):
        every = np.arange(experiment.n_samples)
        found = courses(_at_its_values(model), experiment.time, states, experiment.inputs, every)
        if not all(name in found for name in names):
            return None
        parts.append(np.array([found[name] for name in names]))
    return np.concatenate(parts, axis=1) if parts else None


def _run_freely(model: Null) -> list[tuple[Experiment, dict[str, np.ndarray]]]:
    """The experiments of a model, each with its states (n_samples,) by name in a simulation; none where it
    cannot be simulated."""
    runs = free_runs(model, model.experiments)
    if runs is None:
        return []
    names = model.explicit.state_names
    return [
        (experiment, dict(zip(names, run.states.T, strict=True)))
        for experiment, run in zip(model.experiments, runs, strict=True)
    ]


def _at_its_values(model: Null) -> ExplicitModel:
    """The dynamics of a model with the values that it has now: they were made before it was fitted."""
    return replace(model.explicit, flat=model.flat)


def driven_share(model: Null) -> float | None:
    """How far the inputs of its experiments move the outputs of a model, relative to what these do: the
    largest over the outputs, None where no input moves or the model cannot be simulated.

    They move from their mean over all experiments: an input that was switched before the recordings began
    hardly changes in any of them, and tells as much by its levels. So does the state that a recording begins
    with: a tank that empties through an open valve tells the valve as if that were not recorded."""
    runs = free_runs(model, model.experiments)
    if runs is None:
        return None
    simulate, shares = integrator(model.explicit), []
    mean = np.mean(np.concatenate([e.inputs for e in model.experiments]), axis=0)
    for experiment, run in zip(model.experiments, runs, strict=True):
        level = np.broadcast_to(mean, experiment.inputs.shape)
        if all(is_constant(u) for u in experiment.inputs.T):
            continue
        try:
            still = integrate(
                simulate, experiment.time, level, model.theta, run.states[0], hold=model.hold, rtol=RTOL
            )
        except IntegrationError:
            return None
        moved = np.sqrt(np.mean((run.outputs - still.outputs) ** 2, axis=0))
        spread = np.nanstd(experiment.outputs, axis=0)
        moves = spread > 0.0
        by_inputs = moved[moves] / spread[moves]
        by_start = _foreseen(experiment.outputs[:, moves], still.outputs[:, moves])
        shares.append(float(np.max([*by_inputs, *by_start], initial=0.0)))
    return max(shares, default=None)


def _foreseen(measured: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    """The share (n_y,) of the spread of measured outputs (n_samples, n_y) that a simulation foresees, zero
    where that is too little to say that it moves as they do: a free start fits a part of any course."""
    left = np.sqrt(np.nanmean((measured - simulated) ** 2, axis=0)) / np.nanstd(measured, axis=0)
    return np.where(100.0 * (1.0 - left) > GATES.min_driven_fit, 1.0 - left, 0.0)


def in_use(before: Simulated | None, after: Simulated | None) -> InUse:
    """The second model against the first one, of which neither may be known."""
    if before is None or after is None or not after.unseen:
        return InUse()
    before, after = _beside_starts(before, after)
    if not after.fitted or not after.unseen:
        return InUse()
    size = _mean_squares(before.fitted)
    old, new = (_squares(one.fitted, size) for one in (before, after))
    independent, of_unseen = (
        sum(_independent(course) for course in _scaled(part, size)) for part in (after.fitted, after.unseen)
    )
    seen, foreseen = (_squares(one.unseen, size) for one in (before, after))
    if not seen.size or seen.size != foreseen.size or old.size != new.size:
        return InUse()  # one of them ran away
    unseen = float(np.log(np.mean(seen) / np.mean(foreseen)))
    known = sum(_independent(c) for c in _scaled(before.unseen, size)), of_unseen
    blocks = int(min(*known, _independent_in_mean(seen - foreseen), MOST_BLOCKS))
    return InUse(
        fitted=float(np.log(np.mean(old) / np.mean(new))),
        unseen=unseen,
        n_independent=independent,
        n_unseen=of_unseen,
        certainty=max(
            _certainty(seen - foreseen),
            _certainty_of_blocks(seen, foreseen, blocks),
            _certainty_of_noise(unseen, *known),
        ),
        apart=(_apart(before.fitted, after.fitted), _apart(before.unseen, after.unseen)),
        leaves_noise=_has_faded(*known),
    )


def _apart(before: Sequence[np.ndarray], after: Sequence[np.ndarray]) -> float:
    """Mean over the outputs of the logarithms of the ratios of their mean squares, before to after."""
    old, new = (_mean_squares(errors) for errors in (before, after))
    return float(np.mean(np.log(old / new)))


def _certainty(gap: np.ndarray) -> float:
    """How many standard errors the mean of a course (n,) is off zero."""
    error = _error_of_mean(gap)
    return float(np.mean(gap)) / error if error > 0.0 else 0.0


def _certainty_of_blocks(seen: np.ndarray, foreseen: np.ndarray, n_blocks: int) -> float:
    """How many standard errors the mean squares (n,) of one simulation are below those of another in a block
    of the records, as a ratio: where few of them hold most of the error, their sum is as uncertain as those
    few are, though the law does away with it in all. Of few blocks the standard error is uncertain itself
    (Student). 0 with too few to tell."""
    if n_blocks < GATES.min_independent:
        return 0.0
    parts = (np.array([part.mean() for part in np.array_split(c, n_blocks)]) for c in (seen, foreseen))
    one, other = (np.log(np.maximum(part, np.finfo(float).tiny)) for part in parts)
    return -float(ndtri(stdtr(n_blocks - 1, -_certainty(one - other))))


def _has_faded(before: float, after: float) -> bool:
    """Whether errors that count for `before` independent samples have no memory `after`, beside that."""
    return before >= GATES.min_independent and after >= GATES.min_faded * before


def _certainty_of_noise(unseen: float, before: float, after: float) -> float:
    """How many standard errors the logarithm `unseen` of the ratio of two mean squares is off zero, of errors
    that count for `before` and `after` independent samples, where what is left has no memory beside what was:
    chance may take a part of a few long excursions, but it does not leave noise of all. -inf where it has."""
    if not _has_faded(before, after):
        return -math.inf
    return unseen / math.sqrt(2.0 / before + 2.0 / after)


def _beside_starts(before: Simulated, after: Simulated) -> tuple[Simulated, Simulated]:
    """Both without what the starts of either can do, where these count for nothing."""
    if before.starts is None or after.starts is None:
        return before, after
    size = np.sqrt(_mean_squares(before.fitted))
    parts = zip(before.starts, after.starts, strict=True)
    (old, new), (seen, foreseen) = (beside_starts(*pair, size) for pair in parts)
    return Simulated(old, seen), Simulated(new, foreseen)


def _mean_squares(errors: Sequence[np.ndarray]) -> np.ndarray:
    """Of every output (n_y,), 1 where there is none."""
    found = np.nanmean(np.concatenate(errors) ** 2, axis=0)
    return np.where(np.isfinite(found) & (found > 0.0), found, 1.0)


def _squares(errors: Sequence[np.ndarray], size: np.ndarray) -> np.ndarray:
    """Mean over the outputs of the squared errors of every sample with a value (n,)."""
    table = np.concatenate(errors) ** 2 / size
    known = np.isfinite(table)
    count = known.sum(axis=1)
    return np.where(known, table, 0.0).sum(axis=1)[count > 0] / count[count > 0]


def _scaled(errors: Sequence[np.ndarray], size: np.ndarray) -> list[np.ndarray]:
    """Errors of every record and output (n_samples,), with zero where nothing was measured."""
    return [np.nan_to_num(part[:, j]) / np.sqrt(size[j]) for part in errors for j in range(part.shape[1])]


def _independent(course: np.ndarray) -> float:
    """How many independent samples tell the mean square of a course as well: n / (1 + 2 Σ ρ_k²)."""
    rho = _correlation(course)
    return course.size / (1.0 + 2.0 * float(np.sum(rho**2)))


def _independent_in_mean(course: np.ndarray) -> float:
    """How many independent samples tell the mean of a course as well: what a constant load does to a slow
    error goes with that error, and not with its square, and lasts twice as long."""
    error = _error_of_mean(course)
    return float(np.var(course)) / error**2 if error > 0.0 else 0.0


def _error_of_mean(course: np.ndarray) -> float:
    """Standard error of the mean of a correlated course (n,), by its spectrum at frequency zero: that of an
    autoregression, or of Bartlett's window over its correlation, whichever is more."""
    rho = _correlation(course - course.mean())
    weights = 1.0 - np.arange(1, rho.size + 1) / (rho.size + 1.0)
    by_window = float(np.var(course)) * max(1.0 + 2.0 * float(weights @ rho), 1.0)
    coefficients, cov = autoregression((course - course.mean())[:, None])
    stays = max(1.0 - float(np.sum(coefficients)), 1.0 / max(course.size, 1))
    return float(np.sqrt(max(by_window, float(cov[0, 0]) / stays**2) / max(course.size, 1)))


def _correlation(course: np.ndarray) -> np.ndarray:
    """Of a course with itself, at lags from 1 to a fifth of it."""
    n, lags = course.size, course.size // 5
    whole = np.fft.rfft(course, 2 * n)
    found = np.fft.irfft(np.abs(whole) ** 2)[: lags + 1]
    return found[1:] / found[0] if found.size and found[0] > 0.0 else np.zeros(lags)
