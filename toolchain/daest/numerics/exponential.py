"""Matrix exponential, its integrals and their exact derivatives: what sampling a linear model needs.

Integrals come from exponentials of block matrices (Van Loan 1978). The covariance integral is formed over
a short step and doubled, because e^(-A t), which Van Loan's block holds, overflows for stiff models over
long periods. Derivatives use L(M, dM), the upper right block of exp([[M, dM], [0, M]]), which is exact.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import chebyshev
from scipy.linalg import expm, lapack
from scipy.linalg.lapack import dpstrf

SHORT_STEP_NORM = 0.5  # ‖A h‖₁ up to which Van Loan's block is evaluated directly, before doubling
LARGE = 100  # states from which on series and doublings of the parts replace exponentials of block matrices
MANY = 20  # the same for derivatives, of which each takes a matrix of twice that size
TERMS = 16  # of the series at ‖A h‖₁ = SHORT_STEP_NORM: the next is 1e-19
LONGEST_REACH = 2.0  # |A| times what a period differs by, up to which a series takes it from one to the other
MOST_PARTS = 8  # in which near periods are taken so: with more, exponentials of each cost as little
MOST_TERMS = 32  # of that series
MOST_ALONE = 4  # periods near each other that are taken by themselves
N_NODES = 20  # of periods, between which the values at more are interpolated
NODES_REACH = 4.0  # |λ| times half of what the periods between such nodes differ by
LAST_TERM = -39.0  # logarithm of the first term that is left out
NODES = 10  # of the Gauss quadrature of the covariance over a short step, exact to degree 19
FEW = 4  # a covariance of a rank below this part of its size is integrated by its factor
NEGLIGIBLE = 1e-17  # part of the largest singular value of a factor up to which others are left out

# Rates that are far too fast give results that are not finite, which is for the caller to see.
OVERFLOWING = np.errstate(over="ignore", invalid="ignore")


@dataclass(frozen=True)
class TransitionIntegrals:
    """Φ = e^(A T), first = ∫₀ᵀ e^(A s) ds and second = ∫₀ᵀ e^(A (T-s)) s ds / T; each (..., n, n). `more`
    are those of (s/T)² and (s/T)³ instead of s/T, where they were asked for."""

    transition: np.ndarray
    first: np.ndarray
    second: np.ndarray
    more: tuple[np.ndarray, ...] = ()


STRAIGHT = 2  # integrals that inputs on straight lines take
CUBIC = 4  # those that inputs on cubic curves take


@OVERFLOWING
def transition_integrals(
    A: np.ndarray, period: float, count: int = STRAIGHT, *, by_doubling: bool = False
) -> TransitionIntegrals:
    """Φ and its first `count` integrals over `period` [s] for A (n, n) [1/s]; NaN where A is not finite.
    `by_doubling` takes a fifth of the time for tens of states, and loses digits where many doublings are
    needed: 1e-13 at |A| T = 1e3, 1e-10 at 1e5."""
    if not np.all(np.isfinite(A)):
        return _packed([np.full(A.shape, np.nan) for _ in range(count + 1)])
    scaled, size = balanced(A)
    if by_doubling or A.shape[0] >= LARGE:
        found = _doubled_integrals(scaled, period, count)
    else:
        found = _unpack(expm(_augmented(scaled * period, count)), A.shape[0], period, count)
    return _in_units(found, size)


@OVERFLOWING
def transition_integral_derivatives(
    A: np.ndarray, dA: np.ndarray, period: float, count: int = STRAIGHT
) -> TransitionIntegrals:
    """Derivatives of `transition_integrals` in the directions dA (p, n, n); every field is (p, n, n),
    and NaN where A is not finite."""
    if not np.all(np.isfinite(A)):
        return _packed([np.full(dA.shape, np.nan) for _ in range(count + 1)])
    n, (scaled, size) = A.shape[0], balanced(A)
    if n >= MANY:
        return _in_units(_doubled_derivatives(scaled, dA * size / size[:, None], period, count), size)
    direction = np.zeros((dA.shape[0], (count + 1) * n, (count + 1) * n))
    direction[:, :n, :n] = dA * size / size[:, None] * period
    change = _frechet(_augmented(scaled * period, count), direction)
    return _in_units(_unpack(change, n, period, count), size)


@dataclass(frozen=True)
class Beside:
    """e^(A T) for many periods T near one: e^(M (1 + δ)) = Σ δ^j e^M M^j / j! with the block M of
    `_augmented`, a short series."""

    A: np.ndarray  # (n, n), balanced, times the middle period
    size: np.ndarray  # (n,) of the states
    period: float  # the middle one [s]
    relative: np.ndarray  # (k,) periods by the middle one
    count: int  # of integrals

    def integrals(self) -> TransitionIntegrals:
        """As `transition_integrals`, every field (k, n, n)."""
        return self._unpacked(self.summed(self._rows))

    def derivatives(self, dA: np.ndarray) -> TransitionIntegrals:
        """As `transition_integral_derivatives` for dA (p, n, n), every field (k, p, n, n)."""
        return self._unpacked(self.summed(self._row_derivatives(dA)))

    @property
    def weights(self) -> np.ndarray:
        """By what the integrals of the `rows` are multiplied at every period, (k, count)."""
        p = np.arange(self.count)
        factorials = np.array([math.factorial(one) for one in p], dtype=float)
        return np.asarray(self.period * factorials / self.relative[:, None] ** p)

    @property
    def rows(self) -> np.ndarray:
        """The terms of Φ and its integrals beside each other, in the units of A: shape (terms, n, (1 + count)
        n)."""
        return self._rows * self._units

    def row_derivatives(self, dA: np.ndarray) -> np.ndarray:
        """Those of `rows` in the directions dA (p, n, n), (terms, p, n, (1 + count) n)."""
        return self._row_derivatives(dA) * self._units

    @property
    def _units(self) -> np.ndarray:
        return self.size[:, None] / np.tile(self.size, self.count + 1)

    @cached_property
    def _rows(self) -> np.ndarray:
        return np.asarray(self._whole @ self._terms)

    def _row_derivatives(self, dA: np.ndarray) -> np.ndarray:
        moved = dA * self.size / self.size[:, None] * self.period
        parts = _doubled_derivatives(self.A, moved, 1.0, self.count)
        row = [part / math.factorial(max(p - 1, 0)) for p, part in enumerate(parts)]
        changes, n = [np.concatenate(row, axis=2)], self.A.shape[0]
        # Of the rows e^M M^j / j!, each from the one before.
        for j, term in enumerate(self._whole @ self._terms[:-1], start=1):
            change = changes[-1] @ self._block
            change[..., :n] += term[:, :n] @ moved
            changes.append(change / j)
        return np.array(changes)

    def covariances(self, Q: np.ndarray) -> np.ndarray:
        """`covariance_integral` of Q (n, n) over every period, (k, n, n): what the middle one has, and what
        the series adds, Σ δ^(j+1)/(j+1)! Lʲ(Q) with L(X) = A X + X Aᵀ, carried on by Φ of the middle one."""
        inner = Q / np.outer(self.size, self.size)
        middle = _covariance_by_doubling(self._rates, inner, self.period)
        carried = self._transition @ np.array(self._series(inner)) @ self._transition.T
        return self._covariance_in_units(middle + self._of_series(carried))

    def covariance_derivatives(self, Q: np.ndarray, dA: np.ndarray, dQ: np.ndarray) -> np.ndarray:
        """`covariance_integral_derivatives` in the directions (dA, dQ), both (p, n, n), over every period,
        (k, p, n, n)."""
        units = np.outer(self.size, self.size)
        inner, dinner = Q / units, dQ / units
        turned = dA * self.size / self.size[:, None]
        middle = _covariance_derivatives(self._rates, inner, turned, dinner, self.period)
        series = self._series(inner)
        changes, moved = [dinner * self.period], turned * self.period
        for j, term in enumerate(series[:-1], start=1):
            half = (moved @ term + self.A @ changes[-1]) / (j + 1)
            changes.append(half + _transposed(half))
        dtransition = _frechet(self.A, moved)
        half = dtransition @ np.array(series)[:, None] @ self._transition.T
        carried = half + _transposed(half) + self._transition @ np.array(changes) @ self._transition.T
        return self._covariance_in_units(middle + self._of_series(carried))

    def _series(self, Q: np.ndarray) -> list[np.ndarray]:
        """Lʲ(Q) / (j + 1)! in units of the middle period, as many as `_terms` has."""
        found = [Q * self.period]
        for j in range(1, len(self._terms)):
            half = self.A @ found[-1] / (j + 1)
            found.append(half + half.T)
        return found

    def _of_series(self, terms: np.ndarray) -> np.ndarray:
        """Their sums (k, ...) over the relative differences of the periods."""
        return self.summed(terms, self.powers * (self.relative - 1.0)[:, None])

    def summed(self, terms: np.ndarray, powers: np.ndarray | None = None) -> np.ndarray:
        """Sums (k, ...) of the `terms` (j, ...) times δ^j, or other `powers` (k, j)."""
        powers = self.powers if powers is None else powers
        flat = terms.reshape(len(terms), math.prod(terms.shape[1:]))
        return np.asarray(powers @ flat).reshape(len(powers), *terms.shape[1:])

    def _covariance_in_units(self, covariance: np.ndarray) -> np.ndarray:
        return np.outer(self.size, self.size) * (covariance + _transposed(covariance)) / 2

    @cached_property
    def _rates(self) -> np.ndarray:
        return self.A / self.period

    @cached_property
    def _transition(self) -> np.ndarray:
        """Φ of the middle period."""
        return self._whole[:, : self.A.shape[0]]

    @cached_property
    def _block(self) -> np.ndarray:
        return _augmented(self.A, self.count)

    @cached_property
    def _whole(self) -> np.ndarray:
        """The rows of e^M that hold Φ and the integrals."""
        return np.asarray(expm(self._block)[: self.A.shape[0]])

    @cached_property
    def _terms(self) -> np.ndarray:
        """M^j / j! of the series, as many as it takes."""
        reach = max(_reach(self.A, self.relative), 1e-12)
        last = (j for j in range(2, MOST_TERMS) if j * math.log(reach) - math.lgamma(j + 1) < LAST_TERM)
        terms = [np.eye(self._block.shape[0])]
        for j in range(1, next(last, MOST_TERMS)):
            terms.append(terms[-1] @ self._block / j)
        return np.array(terms)

    @cached_property
    def powers(self) -> np.ndarray:
        """δ^j (k, terms) by which the `rows` of every period are summed up."""
        return np.vander(self.relative - 1.0, len(self._terms), increasing=True)

    def _unpacked(self, top: np.ndarray) -> TransitionIntegrals:
        """Of rows of blocks (k, ..., n, m) in units of the middle period."""
        n = self.A.shape[0]
        s = self.relative.reshape(-1, *(1,) * (top.ndim - 1))
        parts = [top[..., p * n : (p + 1) * n] for p in range(self.count + 1)]
        scaled = (self.period * math.factorial(p) * part / s**p for p, part in enumerate(parts[1:]))
        return _in_units([parts[0], *scaled], self.size)


def beside(A: np.ndarray, periods: np.ndarray, count: int = STRAIGHT) -> Beside | None:
    """For A (n, n) [1/s] and `periods` (k,) [s] within an octave; None where A moves too fast for a short
    series, is empty, large or not finite."""
    if not A.size or not np.all(np.isfinite(A)) or A.shape[0] >= LARGE:
        return None
    scaled, size = balanced(A)
    period = float(np.min(periods) + np.max(periods)) / 2.0
    found = Beside(scaled * period, size, period, periods / period, count)
    return found if _reach(found.A, found.relative) <= LONGEST_REACH else None


def near_periods(A: np.ndarray, periods: np.ndarray) -> list[np.ndarray]:
    """Ascending `periods` (k,) [s] in as many parts as `beside` needs for A (n, n) [1/s]: one, where that is
    so many that none would be saved."""
    scaled, _ = balanced(A)
    middle = float(periods[0] + periods[-1]) / 2.0
    reach = _reach(scaled * middle, periods / middle)
    if not LONGEST_REACH < reach <= LONGEST_REACH * min(MOST_PARTS, periods.size / 2):
        return [periods]
    edges = np.linspace(periods[0], periods[-1], math.ceil(1.01 * reach / LONGEST_REACH) + 1)[1:-1]
    return [part for part in np.split(periods, np.searchsorted(periods, edges)) if part.size]


@dataclass(frozen=True)
class Nodes:
    """Periods near each other, those at the positions `at` (k,), and the `nodes` (n,) [s] from whose values
    the `weights` (k, n) sum up the value of any function that is made of e^(A T) at each of the periods."""

    at: np.ndarray
    nodes: np.ndarray
    weights: np.ndarray


def nodes_of_periods(A: np.ndarray, periods: np.ndarray, same: float) -> list[Nodes]:
    """All `periods` (k,) [s] in groups, for A (n, n) [1/s]. Those that differ by the part `same` are one,
    which is its own node. Where more than MOST_ALONE are in one part of an octave, their nodes are those of
    Chebyshev in that part, which leave 1e-11 where the largest eigenvalue times half of it is NODES_REACH:
    other periods there have the same nodes."""
    octave = np.floor(np.log2(periods))
    low = np.exp2(octave)
    rate = float(np.max(np.abs(np.linalg.eigvals(A)))) if np.all(np.isfinite(A)) else 0.0
    parts = np.ceil(np.maximum(low * rate / (2.0 * NODES_REACH), 1.0))
    part = np.floor((periods / low - 1.0) * parts)
    alone = np.rint(periods / (same * low)) * same * low  # of the octave: equal ones are equal everywhere
    groups = []
    for one in np.unique(octave + (part / parts)):
        at = np.flatnonzero(octave + part / parts == one)
        distinct, which = np.unique(alone[at], return_inverse=True)
        if distinct.size > MOST_ALONE:
            width = low[at[0]] / parts[at[0]]
            groups.append(_interpolated(at, periods[at], low[at[0]] + width * part[at[0]], width))
            continue
        for i, length in enumerate(distinct):
            own = at[which == i]
            groups.append(Nodes(own, np.array([length]), np.ones((own.size, 1))))
    return groups


def _interpolated(at: np.ndarray, periods: np.ndarray, low: float, width: float) -> Nodes:
    places = chebyshev.chebpts1(N_NODES)
    # The polynomials are orthogonal on their nodes: the inverse of their values is their transpose, scaled.
    values = chebyshev.chebvander(places, N_NODES - 1)
    inverse = values.T / np.sum(values**2, axis=0)[:, None]
    at_periods = chebyshev.chebvander(2.0 * (periods - low) / width - 1.0, N_NODES - 1)
    return Nodes(at, low + width * (1.0 + places) / 2.0, at_periods @ inverse)


def _reach(A: np.ndarray, relative: np.ndarray) -> float:
    rate = max(float(np.linalg.norm(A, 1)) if A.size else 0.0, 1.0)
    return rate * float(np.max(np.abs(relative - 1.0), initial=0.0))


def _packed(parts: Sequence[np.ndarray]) -> TransitionIntegrals:
    transition, first, second, *more = parts
    return TransitionIntegrals(transition, first, second, tuple(more))


def _in_units(parts: Sequence[np.ndarray], size: np.ndarray) -> TransitionIntegrals:
    """For x = size · z, from those of z."""
    return _packed([size[:, None] * part / size for part in parts])


@OVERFLOWING
def covariance_integral(A: np.ndarray, Q: np.ndarray, period: float) -> np.ndarray:
    """∫₀ᵀ e^(A s) Q e^(Aᵀ s) ds for A (n, n) and positive semidefinite Q (n, n); NaN where they are not
    finite."""
    if not np.all(np.isfinite(A)) or not np.all(np.isfinite(Q)):
        return np.full(A.shape, np.nan)
    if not Q.any():  # a simulation samples without noise
        return np.zeros(A.shape)
    scaled, size = balanced(A)
    units = np.outer(size, size)
    if A.shape[0] >= LARGE:
        factor = _factor(Q)
        if FEW * factor.shape[1] <= A.shape[0]:
            return units * _covariance_of_factor(scaled, factor / size[:, None], period)
    return units * _covariance_by_doubling(scaled, Q / units, period)


def _covariance_by_doubling(A: np.ndarray, Q: np.ndarray, period: float) -> np.ndarray:
    n = A.shape[0]
    doublings, step = _doublings(A, period)
    block = expm(_van_loan(A, Q, step))
    transition = block[n:, n:].T
    covariance = transition @ block[:n, n:]
    for _ in range(doublings):
        covariance = covariance + transition @ covariance @ transition.T
        transition = transition @ transition
    return (covariance + covariance.T) / 2


@OVERFLOWING
def covariance_integral_derivatives(
    A: np.ndarray, Q: np.ndarray, dA: np.ndarray, dQ: np.ndarray, period: float
) -> np.ndarray:
    """Derivatives (p, n, n) of `covariance_integral` in the directions (dA, dQ), both (p, n, n)."""
    if not np.all(np.isfinite(A)) or not np.all(np.isfinite(Q)):
        return np.full(dA.shape, np.nan)
    if not Q.any() and not dQ.any():
        return np.zeros(dA.shape)
    scaled, size = balanced(A)
    units = np.outer(size, size)
    return units * _covariance_derivatives(scaled, Q / units, dA * size / size[:, None], dQ / units, period)


def _covariance_derivatives(
    A: np.ndarray, Q: np.ndarray, dA: np.ndarray, dQ: np.ndarray, period: float
) -> np.ndarray:
    n = A.shape[0]
    doublings, step = _doublings(A, period)
    base = _van_loan(A, Q, step)
    block, dblock = expm(base), _frechet(base, _van_loan(dA, dQ, step))
    transition, dtransition = block[n:, n:].T, _transposed(dblock[:, n:, n:])
    covariance = transition @ block[:n, n:]
    dcovariance = dtransition @ block[:n, n:] + transition @ dblock[:, :n, n:]
    for _ in range(doublings):
        half = dtransition @ covariance @ transition.T
        dcovariance = dcovariance + half + _transposed(half) + transition @ dcovariance @ transition.T
        covariance = covariance + transition @ covariance @ transition.T
        dtransition = dtransition @ transition + transition @ dtransition
        transition = transition @ transition
    return (dcovariance + _transposed(dcovariance)) / 2


def _doubled_integrals(A: np.ndarray, period: float, count: int) -> list[np.ndarray]:
    """Φ and R_p / T^p for R_p = ∫ e^(A (h-s)) s^p ds: series over a short step h, where A may be sparse, then
    Φ(2h) = Φ² and R_p(2h) = Φ R_p + Σ_k binom(p, k) h^(p-k) R_k."""
    doublings, step = _doublings(A, period)
    phis = _phi(sp.csr_array(A * step), A.shape[0], count)
    found = [math.factorial(p) * step ** (p + 1) * phi for p, phi in enumerate(phis)]
    transition = np.eye(A.shape[0]) + A @ found[0]
    for _ in range(doublings):
        found = [
            transition @ whole + sum(math.comb(p, k) * step ** (p - k) * found[k] for k in range(p + 1))
            for p, whole in enumerate(found)
        ]
        transition = transition @ transition
        step *= 2.0
    return [transition, *(whole / period**p for p, whole in enumerate(found))]


def _doubled_derivatives(A: np.ndarray, dA: np.ndarray, period: float, count: int) -> list[np.ndarray]:
    """Derivatives (p, n, n) of `_doubled_integrals` in the directions dA (p, n, n)."""
    doublings, step = _doublings(A, period)
    phis, dphis = _phi_derivatives(A * step, dA * step, count)
    found = [math.factorial(p) * step ** (p + 1) * phi for p, phi in enumerate(phis)]
    changes = [math.factorial(p) * step ** (p + 1) * dphi for p, dphi in enumerate(dphis)]
    transition = np.eye(A.shape[0]) + A @ found[0]
    dtransition = dA @ found[0] + A @ changes[0]
    for _ in range(doublings):
        shares = [[math.comb(p, k) * step ** (p - k) for k in range(p + 1)] for p in range(count)]
        changes = [
            dtransition @ found[p] + transition @ changes[p] + sum(s * changes[k] for k, s in enumerate(own))
            for p, own in enumerate(shares)
        ]
        found = [
            transition @ found[p] + sum(s * found[k] for k, s in enumerate(own))
            for p, own in enumerate(shares)
        ]
        dtransition = dtransition @ transition + transition @ dtransition
        transition = transition @ transition
        step *= 2.0
    return [dtransition, *(change / period**p for p, change in enumerate(changes))]


def _phi_derivatives(
    At: np.ndarray, dAt: np.ndarray, count: int
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """φ_p of a small M (n, n) for p = 1 … count, and their derivatives (p, n, n) in the directions dM."""
    n = At.shape[0]
    last, change = np.zeros((n, n)), np.zeros(dAt.shape)
    for k in range(TERMS, count - 1, -1):  # Horner, as `_phi`
        change = (dAt @ last + At @ change) / k
        last = (np.eye(n) + At @ last) / k
    found, changes = [last / math.factorial(count - 1)], [change / math.factorial(count - 1)]
    for p in range(count - 1, 0, -1):
        changes.insert(0, dAt @ found[0] + At @ changes[0])
        found.insert(0, np.eye(n) / math.factorial(p) + At @ found[0])
    return found, changes


def _phi(At: sp.csr_array, n: int, count: int = STRAIGHT) -> list[np.ndarray]:
    """φ_p = Σ M^k / (k+p)! of a small M (n, n) for p = 1 … count."""
    last = np.zeros((n, n))
    for k in range(TERMS, count - 1, -1):  # Horner: φ2 = (I + M/3 (I + M/4 (…))) / 2
        last = (np.eye(n) + At @ last) / k
    found = [last / math.factorial(count - 1)]
    for p in range(count - 1, 0, -1):
        found.insert(0, np.eye(n) / math.factorial(p) + At @ found[0])
    return found


def _factor(Q: np.ndarray) -> np.ndarray:
    """L with L Lᵀ = Q, as many columns as the rank of a positive semidefinite Q, in any units."""
    size = np.sqrt(np.maximum(np.diagonal(Q), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    lower, order, rank, _ = dpstrf(Q / np.outer(unit, unit), lower=1)
    factor = np.empty((Q.shape[0], rank))
    factor[order - 1] = np.tril(lower)[:, :rank]
    return size[:, None] * factor


def _covariance_of_factor(A: np.ndarray, factor: np.ndarray, period: float) -> np.ndarray:
    """∫₀ᵀ e^(A s) L Lᵀ e^(Aᵀ s) ds by a factor of few columns: quadrature over a short step h, then the
    factor of 2h is [X, Φ X], its columns brought together by a singular value decomposition."""
    doublings, step = _doublings(A, period)
    sparse = sp.csr_array(A)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    moved = [_moved(sparse * (step * (node + 1.0) / 2.0), factor) for node in nodes]
    columns = _shortened(np.hstack(np.sqrt(step * weights / 2.0)[:, None, None] * np.stack(moved)))
    transition = _phi(sparse * step, A.shape[0])[0]
    transition = np.eye(A.shape[0]) + sparse @ (step * transition)
    for i in range(doublings):
        columns = _shortened(np.hstack([columns, transition @ columns]))
        if i + 1 < doublings:
            transition = transition @ transition
    covariance = columns @ columns.T
    return (covariance + covariance.T) / 2


def _moved(At: sp.csr_array, columns: np.ndarray) -> np.ndarray:
    """e^(A t) times columns, for a small A t."""
    result = columns
    for k in range(TERMS + 2, 0, -1):
        result = columns + At @ result / k
    return result


def _shortened(columns: np.ndarray) -> np.ndarray:
    """Columns with the same product X Xᵀ, none where a direction is negligible, in any units."""
    size = np.linalg.norm(columns, axis=1, keepdims=True)
    left, values, _ = np.linalg.svd(columns / np.where(size > 0.0, size, 1.0), full_matrices=False)
    kept = values > NEGLIGIBLE * values.max(initial=0.0)
    return size * left[:, kept] * values[kept]


def _augmented(At: np.ndarray, count: int) -> np.ndarray:
    """[[A T, I, 0], [0, 0, I], [0, 0, 0]] for a count of 2: its exponential holds Φ and φ_p(A T)."""
    n = At.shape[0]
    block = np.zeros(((count + 1) * n, (count + 1) * n))
    block[: count * n, n:] = np.eye(count * n)
    block[:n, :n] = At
    return block


def _unpack(block: np.ndarray, n: int, period: float, count: int) -> list[np.ndarray]:
    """Φ and the integrals T p! φ_(p+1)."""
    top = [block[..., :n, p * n : (p + 1) * n] for p in range(count + 1)]
    return [top[0], *(period * math.factorial(p) * phi for p, phi in enumerate(top[1:]))]


def _van_loan(A: np.ndarray, Q: np.ndarray, step: float) -> np.ndarray:
    """[[-A, Q], [0, Aᵀ]] h, for one or many (A, Q)."""
    n = A.shape[-1]
    block = np.zeros((*A.shape[:-2], 2 * n, 2 * n))
    block[..., :n, :n] = -A * step
    block[..., :n, n:] = Q * step
    block[..., n:, n:] = _transposed(A) * step
    return block


def _doublings(A: np.ndarray, period: float) -> tuple[int, float]:
    """Number of doublings, and the short step [s] that they start from."""
    size = float(np.linalg.norm(A, 1)) if A.size else 0.0
    if size == 0.0:
        return 0, period
    # Logarithms: the product of an absurd rate and a long period is beyond the largest double.
    power = math.log2(min(size, sys.float_info.max)) + math.log2(period / SHORT_STEP_NORM)
    doublings = max(0, math.ceil(power))
    return doublings, math.ldexp(period, -doublings)


def _frechet(M: np.ndarray, dM: np.ndarray) -> np.ndarray:
    """L(M, dM) for every direction dM (p, m, m). Zero directions cost nothing."""
    p, m = dM.shape[0], M.shape[0]
    result = np.zeros((p, m, m))
    active = np.flatnonzero(np.any(dM != 0.0, axis=(1, 2)))
    if active.size:
        # L is linear in dM: directions are brought to the size of M, so that scaling does not depend on
        # units.
        size = np.linalg.norm(dM[active], axis=(1, 2)) / (np.linalg.norm(M) or 1.0)
        block = np.zeros((active.size, 2 * m, 2 * m))
        block[:, :m, :m] = M
        block[:, m:, m:] = M
        block[:, :m, m:] = dM[active] / size[:, None, None]
        result[active] = expm(block)[:, :m, m:] * size[:, None, None]
    return result


def _transposed(matrix: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrix, -1, -2)


def balanced(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T⁻¹ A T and the diagonal (n,) of T, powers of 2; x = T · balanced x.

    Nothing is permuted: LAPACK would set the rows of single eigenvalues aside, and then scale them by what
    suits the others, which may blow them up. `scipy.linalg.matrix_balance` reads the scales as permutations
    too, and warns of an invalid cast where units differ by more than 2^63. What is not finite stays as
    it is.
    """
    if not A.size or not np.all(np.isfinite(A)):
        return A, np.ones(A.shape[0])
    scaled, _, _, size, _ = lapack.dgebal(A, scale=1, permute=0)
    return scaled, size
