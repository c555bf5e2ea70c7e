"""The most likely noise levels of a nonlinear model, by the one-step predictions of an observer.

The gain is the stationary Kalman gain of the average linearisation for the levels tried. It depends on the
ratios of the levels alone; their common size follows from the innovations wherever no level is given.

An average slope takes friction for damping, and damping hides noise: with Coulomb friction that sticks now
and then the intensity comes out up to twice too large, while the gain, the predictions and the parameters
are right. The extended filter (`ekf_likelihood`) has no such bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from daest.estimation.fitting.search import Evaluation, Found
from daest.estimation.fitting.setup import Setup
from daest.estimation.fitting.signals import white_variance
from daest.estimation.gates import FIT
from daest.estimation.nonlinear.gain_family import GainFamily, Levels, gain_family
from daest.estimation.nonlinear.observer import AverageModel, Observer, average_model, observer
from daest.estimation.nonlinear.shooting import Cut
from daest.estimation.nonlinear.trajectories import Errors, TrajectoryProblem, prediction_errors
from daest.systems.simulation.integrate import interval_inputs

NOISE_EVALUATIONS = 40  # of the simplex search over noise levels in each round
NOISE_SPREAD = np.log(10.0)  # first step of that search
NO_GAIN = 1e300  # stands for the value of levels without a gain; two infinities have no difference
# Of the way back for the size of a noise that the gain leaves open.
OPEN_SHARES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
SCAN = (0.0, -2.3, -4.6, -9.2, -13.8)  # logs of common factors that a search over noise levels tries first


@dataclass(frozen=True)
class Ending:
    """Where one search ended: the problem with its gain, and the noise levels behind the gain (None without
    one). `cut` is the end of multiple shooting where no simulation over a whole record comes that far."""

    problem: TrajectoryProblem
    found: Found
    levels: Levels | None
    cut: Cut | None = None
    notes: tuple[str, ...] = ()


def with_gain(
    setup: Setup,
    problem: TrajectoryProblem,
    z: np.ndarray,
    known: Levels | None,
    around: Levels | None = None,
    evaluations: int = NOISE_EVALUATIONS,
) -> tuple[TrajectoryProblem, Levels | None]:
    """The problem with the gain of the most likely noise levels at the parameters z, and these levels.

    Searched from `around`, by default from `known` levels and a first guess where there are none. Where no
    level makes a gain, the problem as it is with `known`. Shapes: z (n_z,).
    """
    average = average_along(problem, z)
    assert average is not None
    family = free_gains(setup, average, around or _first_levels(setup, problem, average, z, known))
    if family is None:
        return problem, known
    tried: dict[bytes, _Tried | None] = {}

    def at(logs: np.ndarray) -> _Tried | None:
        # The scan, the first corner of the simplex and the end of the search ask for the same.
        if logs.tobytes() not in tried:
            tried[logs.tobytes()] = _try_levels(setup, problem, family, z, logs)
        return tried[logs.tobytes()]

    def value(logs: np.ndarray) -> float:
        one = at(logs)
        return NO_GAIN if one is None else one.value

    best = at(_searched_logs(value, family.intensity_free.size, family.std_free.size, evaluations))
    if best is None:
        return problem, known
    return gained(problem, best.observer), best.levels


@dataclass(frozen=True)
class _Tried:
    """A predictor: its negative log-likelihood, and the levels behind its gain at the size of its
    innovations."""

    value: float
    observer: Observer
    levels: Levels


def _try_levels(
    setup: Setup, problem: TrajectoryProblem, family: GainFamily, z: np.ndarray, logs: np.ndarray
) -> _Tried | None:
    found = family.at(logs)
    errors = None if found is None else prediction_errors(gained(problem, found), z)
    if found is None or errors is None:
        return None
    value = errors.negative_log_likelihood + (0.0 if setup.has_free_size else _misfit(errors, found))
    return _Tried(value, found, at_size_of_innovations(setup, errors, family.levels_at(logs), found))


def free_gains(setup: Setup, average: AverageModel, levels: Levels) -> GainFamily | None:
    """The gains of an average linearisation over the noise levels that are searched, around `levels`."""
    std_free = np.flatnonzero(np.isnan(setup.given_std))[1 if setup.has_free_size else 0 :]
    return gain_family(average, levels, np.flatnonzero(setup.estimate_intensity), std_free)


def with_family(problem: TrajectoryProblem, family: GainFamily) -> TrajectoryProblem:
    """The predictors whose gains are searched, too. Their errors are innovations, of which no covariance is
    given."""
    return replace(problem, family=family, gain=None, given_std=np.full(problem.given_std.size, np.nan))


def without_family(setup: Setup, problem: TrajectoryProblem, found: Found) -> Ending:
    """The predictor with the gain at the end of a search over a family, and the levels behind it."""
    family = problem.family
    assert family is not None
    n = found.z.size - family.n_logs
    logs = _at_own_sizes(replace(problem, family=None), found.z[:n], family, problem.logs(found.z))
    gain, errors = family.at(logs), prediction_errors(problem, np.concatenate([found.z[:n], logs]))
    assert gain is not None and errors is not None
    evaluation = Evaluation(
        found.evaluation.value, found.evaluation.gradient[:n], found.evaluation.information[:n, :n]
    )
    return Ending(
        replace(problem, family=None, gain=gain.gain),
        replace(found, z=found.z[:n], evaluation=evaluation),
        at_size_of_innovations(setup, errors, family.levels_at(logs), gain),
    )


def _at_own_sizes(
    problem: TrajectoryProblem, z: np.ndarray, family: GainFamily, logs: np.ndarray
) -> np.ndarray:
    """The logs of levels, with those of every output near the size of its innovations where that is far from
    what the gain foretells. Where the best gain takes nothing from one output for the states behind
    another, the ratio of their noises is open, and a search ends anywhere: at a noise beyond all that the
    sensor shows. The noise of the process that belongs to the output changes along with it. Shapes: z (n_z,),
    logs (n_logs,)."""
    known = _sizes(problem, z, family, logs)
    if known is None:
        return logs
    value, ratios = known
    held = np.setdiff1d(np.arange(ratios.size), family.std_free)
    least = value + FIT.refit_round_gain
    for row, output in enumerate(family.std_free):
        change = float(np.log(ratios[output] / (ratios[held[0]] if held.size else 1.0)))
        if abs(change) < 2.0 * np.log(FIT.open_size):
            continue
        # Nearer to the size of the innovations the gain may tell the ratio after all.
        moved = (_moved(problem, z, family, logs, row, share * change) for share in OPEN_SHARES)
        logs = next((found[1] for found in moved if found[0] <= least), logs)
    return logs


def _moved(
    problem: TrajectoryProblem, z: np.ndarray, family: GainFamily, logs: np.ndarray, row: int, change: float
) -> tuple[float, np.ndarray]:
    """The logs with the variance of the free output `row` moved by the log `change`, and with those noises of
    the process that belong to it, and the negative log-likelihood there."""
    best, moved = np.inf, logs.copy()
    moved[family.intensity_free.size + row] += 0.5 * change
    for noise in (None, *range(family.intensity_free.size)):
        tried = moved.copy()
        if noise is not None:
            tried[noise] += change
        found = _sizes(problem, z, family, tried)
        if found is not None and found[0] < best:
            best, moved = found[0], tried
    return best, moved


def _sizes(
    problem: TrajectoryProblem, z: np.ndarray, family: GainFamily, logs: np.ndarray
) -> tuple[float, np.ndarray] | None:
    """The negative log-likelihood with the gain at `logs` (n_logs,), and the variances (n_y,) of the
    innovations relative to what that foretells; None without a gain. Shapes: z (n_z,)."""
    gain = family.at(logs)
    errors = None if gain is None else prediction_errors(gained(problem, gain), z)
    if gain is None or errors is None:
        return None
    ratios = np.diagonal(errors.covariance) / np.diagonal(gain.innovation_cov)
    return errors.negative_log_likelihood, ratios


def assumed(
    problem: TrajectoryProblem,
    z: np.ndarray,
    levels: Levels | None,
    factors: Sequence[float],
    run: TrajectoryProblem | None = None,
) -> tuple[TrajectoryProblem, Levels] | None:
    """The predictor for an assumed noise on every state, and its levels: the most likely of `levels`, by
    default as large as the measurement noise, with the intensity times each of `factors`. The model is
    linearised where the `run` is, by default that of the problem. None where that cannot be run at z or no
    level makes a gain. Shapes: z (n_z,)."""
    run = problem if run is None else run
    average = average_along(run, z)
    if average is None:
        return None
    average = replace(average, G=np.diag(problem.state_scale))
    if levels is None:
        std = _rough_std(run, z)
        levels = Levels(_unit_intensity(average, std), std)
    best: tuple[float, Observer, Levels] | None = None
    for factor in factors:
        tried = Levels(factor * levels.intensity, levels.measurement_std)
        found = observer(average, tried.intensity, tried.measurement_std)
        errors = None if found is None else prediction_errors(gained(problem, found), z)
        if found is None or errors is None:
            continue
        if best is None or errors.negative_log_likelihood < best[0]:
            best = errors.negative_log_likelihood, found, tried
    return None if best is None else (gained(problem, best[1]), best[2])


def gained(problem: TrajectoryProblem, found: Observer) -> TrajectoryProblem:
    """The predictor with this gain. Its errors are innovations, of which no covariance is given."""
    return replace(problem, gain=found.gain, given_std=np.full(problem.given_std.size, np.nan))


def at_size_of_innovations(setup: Setup, errors: Errors, levels: Levels, found: Observer) -> Levels:
    """The levels, with the common size that the innovations tell where it is free. An output whose innovation
    is its measurement noise, since the process noise does nothing to it, has a size of its own: the gain does
    not tell the ratio of its noise to another one's."""
    if not setup.has_free_size:
        return levels
    expected = np.diagonal(found.innovation_cov)
    ratios = np.diagonal(errors.covariance) / expected
    own = levels.measurement_std**2 >= FIT.own_noise * expected
    size = float(np.mean(ratios[~own] if not np.all(own) else ratios))
    sized = levels.times(size)
    std = np.where(own, sized.measurement_std * np.sqrt(ratios / size), sized.measurement_std)
    return replace(sized, measurement_std=std)


def _misfit(errors: Errors, found: Observer) -> float:
    """Negative log-likelihood that the innovations lose when their covariance is that of the levels, instead
    of the one that suits them best."""
    S, n_samples = found.innovation_cov, sum(e.shape[0] for e in errors.errors)
    ratio = np.linalg.solve(S, errors.covariance)
    return float(n_samples * (np.trace(ratio) - S.shape[0] - np.linalg.slogdet(ratio)[1]) / 2)


def average_along(problem: TrajectoryProblem, z: np.ndarray) -> AverageModel | None:
    """Average linearisation along the longest experiment; None where the integration fails. Shapes: z
    (n_z,)."""
    longest = int(np.argmax([e.n_samples for e in problem.experiments]))
    experiment = problem.experiments[longest]
    errors = prediction_errors(problem, z)
    if errors is None:
        return None
    u0, _ = interval_inputs(problem.model.explicit, experiment.time, experiment.inputs, problem.hold)
    ubar = np.vstack([u0, u0[-1:]])
    states = errors.trajectories[longest].states
    return average_model(problem.model.explicit, problem.theta(z), experiment.time, states, ubar)


def _first_levels(
    setup: Setup, problem: TrajectoryProblem, average: AverageModel, z: np.ndarray, known: Levels | None
) -> Levels:
    rough = _rough_std(problem, z)
    intensity = setup.intensity if known is None else known.intensity
    intensity = np.where(np.isnan(intensity), _unit_intensity(average, rough), intensity)
    return Levels(intensity, np.where(np.isnan(setup.given_std), rough, setup.given_std))


def _searched_logs(value: object, n_intensity: int, n_std: int, evaluations: int) -> np.ndarray:
    """Logs of the factors: the best common factor of a scan, then a simplex search."""
    assert callable(value)
    if not n_intensity + n_std:
        return np.zeros(0)
    scanned = [np.concatenate([np.full(n_intensity, s), np.zeros(n_std)]) for s in SCAN]
    best = min(scanned, key=value)
    if not evaluations or value(best) >= NO_GAIN:
        return best
    steps = NOISE_SPREAD * np.diag([1.0] * n_intensity + [FIT.std_step] * n_std)
    options = {
        "maxfev": evaluations,
        "initial_simplex": np.vstack([best, best - steps]),
        "xatol": 0.05,
        "fatol": 0.1,
    }
    return minimize(value, best, method="Nelder-Mead", options=options).x


def _rough_std(problem: TrajectoryProblem, z: np.ndarray) -> np.ndarray:
    """The white part of the simulation errors, from second differences of the samples that are there."""
    errors = prediction_errors(problem, z)
    assert errors is not None
    fine = np.sqrt([white_variance(column) for column in _columns(errors)])
    whole = np.sqrt(np.diagonal(errors.covariance))
    return np.where(np.isfinite(fine) & (fine > 0.0), np.minimum(fine, whole), whole)


def _columns(errors: Errors) -> list[list[np.ndarray]]:
    """The errors (n_samples,) of every record, by output."""
    n_y = errors.covariance.shape[0]
    return [[e[:, j] for e in errors.errors] for j in range(n_y)]


def _unit_intensity(average: AverageModel, std: np.ndarray) -> np.ndarray:
    """Intensity of each noise that moves the outputs in one period by about their measurement noise."""
    step = np.abs(average.C @ average.G) * np.sqrt(average.period)
    two_steps = np.abs(average.C @ average.A @ average.G) * average.period**1.5
    reach = np.maximum(step, two_steps) / std[:, None]
    largest = reach.max(axis=0, initial=0.0)
    return 1.0 / np.where(largest > 0.0, largest, 1.0) ** 2
