"""Scores of responses on the whitened innovations, and what a search over all of them finds by chance.

What refitted parameters and initial states would do is projected out. Scores are jointly normal with known
correlation when nothing is missing, which prices the search exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri_exp

from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.responses import loads_rescaled, nuisance, responses_to
from daest.diagnosis.screening.size_slopes import sizes_of
from daest.model.diagnosis import Candidate, Screen, Screened
from daest.numerics.statistics import autoregression, chi2, norm

TAIL = 100  # draws, the highest, beyond which the normal law extends the share above a score
DRAWS = 20_000  # of the largest score under the null


def scored(
    candidates: Sequence[Candidate],
    rows: Sequence[slice],
    white: np.ndarray,
    directions: np.ndarray,
    rescaling: np.ndarray,
    responses: np.ndarray,
    skipped: tuple[tuple[str, str], ...],
    seed: int,
    absorbed_share: float = GATES.absorbed_share,
) -> Screen:
    """The screen of candidates with `rows` of responses (k, m) to their sizes, tried on white residuals
    (m,) beyond `directions` (d, m) of the parameters, which absorb a response that keeps no more than that
    share beyond them, or beyond what `rescaling` (e, m) changes besides."""
    rest, share = projected(responses, directions)
    norms = np.linalg.norm(rest, axis=1)
    only_rescales = projected(responses, rescaling)[1] < absorbed_share
    seen = (share >= absorbed_share) & ~only_rescales & (norms > 0.0)
    unit = np.where(seen[:, None], rest / np.where(norms > 0.0, norms, 1.0)[:, None], 0.0)
    spread = spread_under(white)(unit)
    z = np.where(seen, unit @ white / spread, 0.0)
    correlation = unit @ unit.T
    tests = [_Test(c, r, correlation, seen) for c, r in zip(candidates, rows, strict=True)]
    scores = np.array([float(test.score(z[None])[0]) for test in tests])
    largest = _largest(tests, correlation, seed)
    level = float(np.quantile(largest, 0.95))
    entries = []
    for test, score in zip(tests, scores, strict=True):
        own = norms[test.rows]
        size = test.estimate(z) * spread[test.rows] / np.where(own > 0.0, own, 1.0)
        null_values = np.array(list(test.candidate.effect.null_values.values()))
        detectable = (level + norm.ppf(GATES.stated_power)) * np.min(
            spread[test.rows] / np.where(own > 0.0, own, np.inf)
        )
        entries.append(
            Screened(
                candidate=test.candidate,
                score=float(score),
                sizes=tuple((null_values + size).tolist()),
                # Bonferroni's bound for what was compared before the screen.
                p_value=min(1.0, test.candidate.searched * _p_value(float(score), largest))
                if test.is_seen
                else 1.0,
                absorbed=not test.is_seen,
                detectable=float(detectable) if detectable > 0.0 else np.inf,
                size_error=float(spread[test.rows][0] / own[0]) if seen[test.rows][0] else 0.0,
            )
        )
    order = np.argsort([-e.score for e in entries])
    leading = [r.start for r in rows]
    between = correlation[np.ix_(leading, leading)][np.ix_(order, order)]
    found = tuple(entries[i] for i in order)
    p_value = min((e.p_value for e in found), default=1.0)
    return Screen(found, between, p_value, len(candidates), skipped)


@dataclass(frozen=True)
class ScoredValue:
    """A parameter of the model that is not estimated: the magnitude of the score of another value, its
    p-value corrected for their number, and others of them whose values do the same to the innovations."""

    name: str
    score: float
    p_value: float
    alike: tuple[str, ...] = ()


def value_scores(null: Null, run: NullObserver, names: Sequence[str]) -> list[ScoredValue]:
    """How much another value of each of the parameters would show, most first. Nothing where estimated
    parameters and other loads do the same."""
    responses = responses_to(null, run, null.explicit, sizes_of(null.explicit, names))
    directions = nuisance(run, len(null.estimated))
    rest, share = projected(responses, directions)
    only_rescales = projected(responses, np.vstack([directions, loads_rescaled(null, run)]))[1]
    norms = np.linalg.norm(rest, axis=1)
    seen = (np.minimum(share, only_rescales) >= GATES.absorbed_value) & (norms > 0.0)
    unit = np.where(seen[:, None], rest / np.where(norms > 0.0, norms, 1.0)[:, None], 0.0)
    z = np.where(seen, np.abs(unit @ run.whitened) / spread_under(run.whitened)(unit), 0.0)
    same = np.abs(unit @ unit.T) > GATES.same_place_correlation
    found = [
        ScoredValue(
            name,
            float(z[i]),
            float(min(1.0, 2.0 * len(names) * norm.sf(z[i]))),
            tuple(other for j, other in enumerate(names) if j != i and same[i, j]),
        )
        for i, name in enumerate(names)
    ]
    return sorted(found, key=lambda one: -one.score)


def promising_pairs(found: Screen) -> list[tuple[Screened, Screened]]:
    """Pairs of candidates of one size each whose joint score says much more than any of all candidates alone,
    and more than a search over all pairs finds by chance; the best first, with their sizes beside each other:
    of two that hide each other, one may seem to have the wrong sign alone. One effect with two shapes at one
    place is no pair: a model holds it once.

    The scores z of two responses with the correlation ρ have the joint statistic
    (z₁² + z₂² - 2ρ z₁z₂)/(1 - ρ²), chi-squared with two degrees of freedom where nothing is missing."""
    chosen = [i for i, e in enumerate(found.entries) if not e.absorbed and len(e.candidate.effect.sizes) == 1]
    entries = [found.entries[i] for i in chosen]
    if len(entries) < 2:
        return []
    sizes = [e.candidate.effect.sizes[0] for e in entries]
    nulls = np.array([p.null or 0.0 for p in sizes])
    errors = np.array([e.size_error for e in entries])
    z = np.array([e.deviation for e in entries])
    rho = found.correlation[np.ix_(chosen, chosen)]
    away = np.maximum(1.0 - rho**2, float(np.finfo(float).eps))
    joint = (z[:, None] ** 2 + z[None] ** 2 - 2.0 * rho * z[:, None] * z[None]) / away
    beside = (z[:, None] - rho * z[None]) / away  # the size of the first beside the second, in its errors
    one_sided = np.array([p.min is not None and p.min >= null for p, null in zip(sizes, nulls, strict=True)])
    possible = ~one_sided[:, None] | (beside > 0.0)
    labels = np.array([e.candidate.label for e in entries])
    possible &= possible.T & (np.abs(rho) < GATES.same_place_correlation) & (labels[:, None] != labels[None])
    n_pairs = len(entries) * (len(entries) - 1) // 2
    alone = max(e.score for e in found.entries) ** 2
    possible &= 0.5 * (joint - alone) > GATES.min_bic_gain
    possible &= n_pairs * chi2.sf(joint, 2) < GATES.missing_level
    pairs = [(i, j) for i, j in zip(*np.nonzero(np.triu(possible, 1)), strict=True)]
    pairs.sort(key=lambda pair: -joint[pair])
    sizes_beside = nulls[:, None] + beside * errors[:, None]

    def at(i: int, j: int) -> Screened:
        return replace(entries[i], sizes=(float(sizes_beside[i, j]),))

    return [(at(i, j), at(j, i)) for i, j in pairs]


class _Test:
    """The score test of one candidate: its rows, and the sign that physics allows its size."""

    def __init__(self, candidate: Candidate, rows: slice, correlation: np.ndarray, seen: np.ndarray) -> None:
        self.candidate = candidate
        self.rows = rows
        self.is_seen = bool(np.any(seen[rows]))
        sizes = candidate.effect.sizes
        self.is_one_sided = (
            len(sizes) == 1 and sizes[0].min is not None and sizes[0].min >= (sizes[0].null or 0.0)
        )
        block = correlation[rows, rows]
        self._inverse = np.linalg.pinv(block, hermitian=True) if self.is_seen else np.zeros_like(block)
        self._degrees = max(int(np.sum(seen[rows])), 1)

    def score(self, z: np.ndarray) -> np.ndarray:
        """Standard-normal equivalent (≥ 0) of draws z (n_draws, k)."""
        own = z[:, self.rows]
        if self._degrees == 1:
            value = own[:, 0] if own.shape[1] == 1 else np.max(np.abs(own), axis=1)
            return np.maximum(value, 0.0) if self.is_one_sided else np.abs(value)
        statistic = np.einsum("di,ij,dj->d", own, self._inverse, own)
        log_tail = chi2.logsf(statistic, self._degrees)
        return np.where(
            np.isfinite(log_tail),
            np.maximum(-ndtri_exp(np.minimum(log_tail - np.log(2.0), -0.7)), 0.0),
            np.sqrt(statistic),
        )

    def estimate(self, z: np.ndarray) -> np.ndarray:
        """One-step estimate of the sizes in standard errors of each alone."""
        return self._inverse @ z[self.rows]


def projected(responses: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Responses with what the nuisance directions explain removed, and the share that is left of each.
    Shapes: responses (k, m), directions (d, m); shares (k,)."""
    return projection(directions)(responses)


def projection(directions: np.ndarray) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """`projected` for the same directions (d, m) time and again."""
    scale = np.linalg.norm(directions, axis=1)
    used = directions[scale > 0.0] / scale[scale > 0.0, None]
    values, vectors = np.linalg.eigh(used @ used.T)
    kept = values > GATES.nuisance_rank**2 * values.max(initial=0.0)
    basis = (vectors[:, kept] / np.sqrt(values[kept])).T @ used

    def apart(responses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rest = responses - (responses @ basis.T) @ basis
        size = np.linalg.norm(responses, axis=1)
        return rest, np.linalg.norm(rest, axis=1) / np.where(size > 0.0, size, 1.0)

    return apart


def spread_under(white: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Standard deviation (k,) of the scores of unit responses (k, m) under the spectrum of the innovations
    (m,) themselves: 1 where they are white."""
    coefficients, cov = autoregression(white[:, None])
    if coefficients.shape[0] == 0:
        return lambda unit: np.full(unit.shape[0], np.sqrt(cov[0, 0]))
    length = 2 * int(2 ** np.ceil(np.log2(white.size)))
    frequencies = np.arange(length // 2 + 1) / length
    delays = np.exp(-2j * np.pi * np.outer(frequencies, np.arange(1, coefficients.shape[0] + 1)))
    density = cov[0, 0] / np.abs(1.0 - delays @ coefficients[:, 0, 0]) ** 2
    weights = np.full(frequencies.size, 2.0)
    weights[0] = weights[-1] = 1.0
    weights *= density

    def spread(unit: np.ndarray) -> np.ndarray:
        variance = [np.abs(np.fft.rfft(row, length)) ** 2 @ weights / length for row in unit]
        return np.sqrt(np.maximum(variance, 1e-12))

    return spread


def _largest(tests: Sequence[_Test], correlation: np.ndarray, seed: int) -> np.ndarray:
    """Draws of the largest score under the null, sorted."""
    values, vectors = np.linalg.eigh(correlation)
    kept = values > 1e-10 * values.max(initial=0.0)
    root = vectors[:, kept] * np.sqrt(values[kept])
    # Draw by draw beside each other for every test, which reads its own rows one after the other.
    draws = (root @ np.random.default_rng(seed).standard_normal((DRAWS, root.shape[1])).T).T
    most = np.zeros(DRAWS)
    for test in tests:
        if test.is_seen:
            np.maximum(most, test.score(draws), out=most)
    return np.sort(most)


def _p_value(score: float, largest: np.ndarray) -> float:
    """Corrected p-value; beyond the highest draws, Bonferroni's bound with the number of candidates at which
    it meets the share of draws above the first of them."""
    above = largest.size - int(np.searchsorted(largest, score))
    if above >= TAIL:
        return above / largest.size
    meeting = float(largest[-TAIL])
    share = TAIL / largest.size
    return float(min(share, share * norm.sf(score) / norm.sf(meeting)))
