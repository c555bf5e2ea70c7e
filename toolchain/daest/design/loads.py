"""What unknown loads can follow of a recording, and so take from the evidence of an effect.

`daest diagnose` compares a model with an effect with the model as it is beside unknown loads, each white
noise through a first-order lag, whose sizes and time constants are fitted as well. What such loads can follow
of an effect is no evidence for it. Here the errors that a model makes in a recording of another one are
filtered as if such loads acted, for the loads that leave the least evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm, solve_discrete_lyapunov

from daest.design.explainer import ErrorModel, Explained
from daest.numerics.recursions import linear_recursion
from daest.numerics.riccati import NoiseModel, forgetting, stationary_gains

TIMES = 4.0  # factor between the time constants that are tried
SIZES = 3.0  # factor between the variances of a load that are tried
LEAST = 1e-4  # variance that a load brings about in an output, in squares of the noise, the smallest one
N_SIZES = 20
FIRST_SIZE = 8  # of them, from which a search starts
BESIDE = ((1, 0), (-1, 0), (0, 1), (0, -1), (0, 2), (0, -2))
RANK = 1e-10  # eigenvalue of the products of scaled responses below which a direction is none

Level = tuple[int, int]  # time constant and size of a load, by their numbers; NO_LOAD without
NO_LOAD: Level = (-1, -1)
Levels = tuple[Level, ...]  # of every load


@dataclass(frozen=True)
class Loads:
    """Loads that enter a model by its noises `names`. Their time constants lie between `shortest` sampling
    periods and the share `longest` of the recordings."""

    names: tuple[str, ...]
    shortest: float
    longest: float


@dataclass(frozen=True)
class Whitening:
    """The Kalman filter of white errors beside loads: x̂[k+1] = F x̂ + K (ε - C x̂); `root` whitens its
    innovations. `log_det` is the logarithm of their covariance's determinant, and `power` their expected
    square where no load acts, both of one sample."""

    F: np.ndarray
    K: np.ndarray
    C: np.ndarray
    root: np.ndarray
    log_det: float
    power: float

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Whitened innovations of rows (k, n_samples, n_y)."""
        drive = rows[:, :-1] @ self.K.T
        states = linear_recursion(self.F - self.K @ self.C, drive, np.zeros((rows.shape[0], self.F.shape[0])))
        return (rows - states @ self.C.T) @ self.root.T


@dataclass(frozen=True)
class Shown:
    """What a model leaves of one recording: whitened `errors` (n_samples, n_y) that it cannot follow, for
    each of the sizes of the effect `own` (k, n_samples, n_y), and their slopes along its parameters (p,
    n_samples, n_y) and initial state (n, n_samples, n_y)."""

    errors: np.ndarray
    own: np.ndarray
    slopes: np.ndarray
    initial: np.ndarray


def shown(explained: Explained, own: Sequence[np.ndarray], n_y: int) -> Shown:
    """`own`: whitened errors (m,) of recordings with one of the sizes each."""
    n = explained.errors.size // n_y
    shape = (-1, n, n_y)
    return Shown(
        explained.errors.reshape(n, n_y),
        np.reshape(own, shape),
        explained.slopes.reshape(shape),
        explained.initial.reshape(shape),
    )


@dataclass(frozen=True)
class Absorbed:
    """Twice the expected log-likelihood ratio that loads leave, with the `levels` that leave the least."""

    evidence: float
    levels: Levels


@dataclass
class Bank:
    """The filters of a model whose errors follow `model`, beside `loads`, for recordings of together
    `n_samples`. Each is computed when it is asked for first."""

    model: ErrorModel
    loads: Loads
    n_samples: int
    _kept: dict[Levels, Whitening | None] = field(default_factory=dict)
    _units: dict[tuple[int, int], float] = field(default_factory=dict)

    @property
    def columns(self) -> list[int]:
        return [self.model.noises.index(name) for name in self.loads.names]

    @property
    def times(self) -> np.ndarray:
        """Time constants (s) that are tried. Shapes: (n_times,)."""
        period = self.model.period
        first = self.loads.shortest * period
        last = max(first, self.loads.longest * self.n_samples * period)
        return np.geomspace(first, last, 1 + int(np.ceil(np.log(last / first) / np.log(TIMES))))

    def none(self) -> Levels:
        return (NO_LOAD,) * len(self.loads.names)

    def whitening(self, levels: Levels) -> Whitening | None:
        """None where no filter settles."""
        if levels not in self._kept:
            self._kept[levels] = self._made(levels)
        return self._kept[levels]

    def neighbours(self, levels: Levels) -> list[Levels]:
        """The levels, those one step beside them in a time constant or a size, and none."""
        found = [levels]
        for i, (time, size) in enumerate(levels):
            if (time, size) == NO_LOAD:
                continue
            for step in BESIDE:
                beside = (time + step[0], size + step[1])
                if 0 <= beside[0] < self.times.size and 0 <= beside[1] < N_SIZES:
                    found.append((*levels[:i], beside, *levels[i + 1 :]))
        return list(dict.fromkeys([*found, self.none()]))

    def _made(self, levels: Levels) -> Whitening | None:
        acting = [i for i, level in enumerate(levels) if level != NO_LOAD]
        times = np.array([self.times[levels[i][0]] for i in acting])
        variances = np.array([self._variance(i, levels[i]) for i in acting])
        F, C, Q = self._sampled([self.columns[i] for i in acting], times, variances)
        n_y = C.shape[0]
        if not acting:
            zero = np.zeros((F.shape[0], n_y))
            return Whitening(F, zero, C, np.eye(n_y), 0.0, float(n_y))
        if not np.all(np.isfinite(F)) or not np.all(np.isfinite(Q)):
            return None
        F = forgetting(F, C)
        gains = stationary_gains(NoiseModel(F, C, Q, np.eye(n_y), np.zeros((F.shape[0], n_y))))
        if gains is None:
            return None
        try:
            lower = np.linalg.cholesky(gains.S)
            spread = solve_discrete_lyapunov(F - gains.K @ C, gains.K @ gains.K.T)
        except (np.linalg.LinAlgError, ValueError):
            return None
        root = np.linalg.inv(lower)
        squares = root @ (np.eye(n_y) + C @ spread @ C.T) @ root.T
        log_det = 2.0 * float(np.sum(np.log(np.diag(lower))))
        return Whitening(F, gains.K, C, root, log_det, float(np.trace(squares)))

    def _variance(self, load: int, level: Level) -> float:
        """Stationary, of a load in squares of its own unit."""
        key = (load, level[0])
        if key not in self._units:
            time = np.array([self.times[level[0]]])
            F, C, Q = self._sampled([self.columns[load]], time, np.ones(1))
            reached = np.zeros_like(Q)
            with np.errstate(over="ignore", invalid="ignore"):
                for _ in range(max(1, int(np.log2(self.n_samples)))):  # twice as many samples each time
                    reached, F = Q + F @ Q @ F.T, F @ F
                    Q = reached
            self._units[key] = float(np.max(np.diag(C @ reached @ C.T), initial=0.0))
        unit = self._units[key]
        return LEAST * SIZES ** level[1] / unit if np.isfinite(unit) and unit > 0.0 else np.nan

    def _sampled(
        self, columns: Sequence[int], times: np.ndarray, variances: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Transition (N, N), output (n_y, N) and noise (N, N) of the errors' states and the loads'."""
        model = self.model
        n, n_l = model.A.shape[0], len(columns)
        A = np.zeros((n + n_l, n + n_l))
        A[:n, :n], A[:n, n:] = model.A, model.G[:, columns]
        A[n:, n:] = -np.diag(1.0 / times)
        driven = np.zeros_like(A)
        driven[n:, n:] = np.diag(2.0 * variances / times)
        both = np.block([[-A, driven], [np.zeros_like(A), A.T]]) * model.period  # van Loan (1978)
        if not np.all(np.isfinite(both)):
            nothing = np.full_like(A, np.nan)
            return nothing, np.zeros((model.C.shape[0], n + n_l)), nothing
        grown = expm(both)
        F = grown[n + n_l :, n + n_l :].T
        Q = F @ grown[: n + n_l, n + n_l :]
        C = np.hstack([model.C, np.zeros((model.C.shape[0], n_l))])
        F[:n] -= model.gain @ C
        return F, C, 0.5 * (Q + Q.T)


def without_start(rows: np.ndarray, initial: np.ndarray) -> np.ndarray:
    """Rows (k, m) less what an initial state with responses (n, m) would explain."""
    basis = orthonormal(initial)
    return rows - (rows @ basis.T) @ basis


def orthonormal(rows: np.ndarray) -> np.ndarray:
    """An orthonormal basis (r, m) of the rows (k, m)."""
    products = rows @ rows.T
    scale = np.sqrt(np.diag(products))
    seen = scale > 0.0
    used, products = rows[seen], products[np.ix_(seen, seen)] / np.outer(scale[seen], scale[seen])
    values, vectors = np.linalg.eigh(products)
    large = values > RANK
    return (vectors[:, large] / np.sqrt(values[large])).T @ (used / scale[seen, None])


@dataclass(frozen=True)
class Filtered:
    """The errors (m,) of a recording, those of the sizes (k, m) and slopes (p, m) after a filter, less what
    an initial state with the responses `initial` (n, m) would explain."""

    errors: np.ndarray
    own: np.ndarray
    slopes: np.ndarray
    initial: np.ndarray


def filtered(whitening: Whitening, one: Shown) -> Filtered:
    rows = np.concatenate([one.errors[None], one.own, one.slopes, one.initial])
    white = whitening(rows).reshape(rows.shape[0], -1)
    k, p = one.own.shape[0], one.slopes.shape[0]
    initial = white[1 + k + p :]
    left = without_start(white[: 1 + k + p], initial)
    return Filtered(left[0], left[1 : 1 + k], left[1 + k :], initial)


@dataclass
class Evidence:
    """Twice the log-likelihood ratio that recordings are expected to have against the model, refitted beside
    loads. `parts` tell what the model leaves of each."""

    bank: Bank
    parts: Sequence[Shown]
    _squares: dict[Levels, float] = field(default_factory=dict)

    def beside(self, levels: Levels, share: float = 1.0) -> float:
        """With loads of these levels, for that share of the effect; the common size of the noise is refitted,
        too. inf where no filter settles."""
        whitening = self.bank.whitening(levels)
        if whitening is None:
            return np.inf
        if levels not in self._squares:
            self._squares[levels] = self._left(whitening)
        n, n_samples = (
            sum(size) for size in zip(*((p.errors.size, p.errors.shape[0]) for p in self.parts), strict=True)
        )
        squares = share**2 * self._squares[levels] + n_samples * whitening.power
        with np.errstate(invalid="ignore", divide="ignore"):
            expected = n * np.log(squares / n) + n_samples * whitening.log_det
        return float(expected) if np.isfinite(expected) else np.inf

    def _left(self, whitening: Whitening) -> float:
        """Squares of the filtered errors that the model, refitted, leaves."""
        found = [filtered(whitening, one) for one in self.parts]
        errors = np.concatenate([one.errors for one in found])
        basis = orthonormal(np.concatenate([one.slopes for one in found], axis=1))
        return float(errors @ errors - np.sum((basis @ errors) ** 2))

    def least(self, share: float = 1.0) -> Absorbed:
        """What the loads leave that follow the most; load by load, the one that follows most first."""
        none = self.bank.none()
        best = Absorbed(self.beside(none, share), none)
        if not np.isfinite(best.evidence):
            return best
        open_loads = list(range(len(none)))
        while open_loads:
            tried = {i: self._least_of_load(best, i, share) for i in open_loads}
            first = min(tried, key=lambda i: tried[i].evidence)
            if tried[first].evidence >= best.evidence:
                break
            best = tried[first]
            open_loads.remove(first)
        return best

    def _least_of_load(self, known: Absorbed, load: int, share: float) -> Absorbed:
        """The best level of one load beside the others, climbing over its sizes at every time constant."""
        size, best = FIRST_SIZE, known

        def at(time: int, size: int) -> Absorbed:
            levels = (*known.levels[:load], (time, size), *known.levels[load + 1 :])
            return Absorbed(self.beside(levels, share), levels)

        for time in range(self.bank.times.size):
            least = at(time, size)
            for step in (1, -1):
                while 0 <= size + step < N_SIZES:
                    beside = at(time, size + step)
                    if beside.evidence >= least.evidence:
                        break
                    least, size = beside, size + step
            best = min(best, least, key=lambda found: found.evidence)
        return best
