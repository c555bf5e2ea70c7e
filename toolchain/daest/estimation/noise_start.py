"""Start values of the noises: measurement noise from the roughness of the residuals, process noise by a
scan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from daest.estimation.coordinates import Coordinate, Unknowns
from daest.estimation.gates import FIT
from daest.estimation.linear_predictors import Problem, simulate
from daest.numerics.exponential import covariance_integral, transition_integrals
from daest.systems.state_space import state_space

SCAN_DECADES = (
    -8,
    -6,
    -5,
    -4,
    -3,
    -2,
    -1,
    0,
    1,
    2,
    3,
)  # of the intensity that would explain all of the residual
LOWEST_DECADE = -10  # bound of the search: less noise than that is none
LONGEST_GROWTH = 1000  # periods over which process noise is let grow to see what it does to the outputs


def with_noise(
    problem: Problem,
    process: dict[int, bool],
    measurement: dict[int, bool],
    given_intensity: np.ndarray,
    given_std: np.ndarray,
    z_parameters: np.ndarray,
) -> Problem:
    """`problem` with noise coordinates added and start values for all unknown noises.

    `process` and `measurement` map the indices of noises to whether they are estimated; NaN in the given
    values means unknown. Start values are those of the best of a scan at the parameters `z_parameters`.
    """
    theta = problem.unknowns.values(z_parameters)[0]
    residual_std, rough_std = _residual_sizes(problem, theta)
    unit = _reference_intensities(problem, theta, residual_std)
    std = np.where(np.isnan(given_std), rough_std, given_std)
    parameters = tuple(
        replace(c, initial=value)
        for c, value in zip(problem.unknowns.coordinates, problem.unknowns.natural(z_parameters), strict=True)
    )
    best: tuple[float, Problem] | None = None
    unknown = [i for i, estimated in process.items() if estimated and np.isnan(given_intensity[i])]
    for decade in SCAN_DECADES if unknown else (0,):
        intensity = np.where(np.isnan(given_intensity), unit * 10.0**decade, given_intensity)
        noises = [
            _noise("process", i, problem.family.noises[i].name, intensity[i], unit[i] * 10.0**LOWEST_DECADE)
            for i, estimated in process.items()
            if estimated
        ]
        floor = FIT.smallest_std * np.maximum(residual_std, rough_std)
        noises += [
            _noise("measurement", j, problem.family.outputs[j].name, std[j], floor[j])
            for j, estimated in measurement.items()
            if estimated
        ]
        unknowns = Unknowns((*parameters, *noises), problem.unknowns.theta, intensity, std)
        trial = replace(problem, unknowns=unknowns, is_filtered=True)
        found = trial.predict(unknowns.start)
        if found is not None and (best is None or found.negative_log_likelihood < best[0]):
            best = (found.negative_log_likelihood, trial)
    return best[1] if best else trial


def with_common_bounds(problems: Sequence[Problem]) -> Problem:
    """The first of some problems of `with_noise`, whose noises may become as small as in any of them."""
    lowest = np.min([p.unknowns.lower for p in problems], axis=0)
    unknowns = problems[0].unknowns
    coordinates = tuple(
        c if c.kind == "parameter" else replace(c, lower=float(np.exp(low)))
        for c, low in zip(unknowns.coordinates, lowest, strict=True)
    )
    return replace(problems[0], unknowns=replace(unknowns, coordinates=coordinates))


def _noise(
    kind: Literal["process", "measurement"], index: int, name: str, value: float, lower: float
) -> Coordinate:
    return Coordinate(name, kind, index, max(value, lower), True, 1.0, lower, np.inf)


def _residual_sizes(problem: Problem, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """rms of the simulation residuals, and of their white part (from second differences), both (n_y,)."""
    free = replace(problem, weigh=np.ones(len(problem.family.outputs), dtype=bool))
    simulated = simulate(free, theta, np.ones(len(problem.family.outputs)))
    n_y = len(problem.family.outputs)
    total, rough = np.zeros(n_y), np.zeros(n_y)
    counts, triples = np.zeros(n_y), np.zeros(n_y)
    for i, record in enumerate(problem.records):
        seen = record.observed
        if simulated is None:
            residuals = record.outputs - record.outputs.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        else:
            found = simulated.found[i]
            residuals = found.at_zero - np.tensordot(simulated.initial_states[i], found.response, 1)
        total += np.sum((residuals * seen) ** 2, axis=0)
        counts += seen.sum(axis=0)
        together = seen[2:] & seen[1:-1] & seen[:-2]
        rough += np.sum(np.diff(residuals, 2, axis=0) ** 2 * together, axis=0) / 6.0
        triples += together.sum(axis=0)
    whole = np.sqrt(total / np.maximum(counts, 1))
    whole = np.where(whole > 0.0, whole, 1.0)
    fine = np.sqrt(rough / np.maximum(triples, 1))
    return whole, np.where((triples > 0) & (fine > 0.0), np.minimum(fine, whole), whole)


def _reference_intensities(problem: Problem, theta: np.ndarray, residual_std: np.ndarray) -> np.ndarray:
    """Intensity (n_w,) of each noise that alone would make outputs as wrong as the simulation residuals
    are.
    """
    ss = state_space(problem.family, theta)
    record = max(problem.records, key=lambda r: r.n_samples)
    period = record.period or float(np.mean(np.diff(record.time)))
    length = period * min(record.n_samples, LONGEST_GROWTH)
    result = np.ones(ss.G.shape[1])
    with np.errstate(all="ignore"):
        held = transition_integrals(ss.A, period).first
        for i, column in enumerate(ss.G.T):
            one = np.outer(column, column)
            grown = covariance_integral(ss.A, one, length)
            if not np.all(np.isfinite(grown)):
                grown = held @ one @ held.T / period
            direct = ss.H[:, i] ** 2 / period
            variance = np.einsum("ya,ab,yb->y", ss.C, grown, ss.C) + direct
            with_effect = variance > 0.0
            if np.any(with_effect):
                result[i] = np.min(residual_std[with_effect] ** 2 / variance[with_effect])
    return result
