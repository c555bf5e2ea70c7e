"""How often an effect is named: recordings are drawn, and judged as `daest diagnose` judges them.

One half of a recording is fitted, with the effect and without it, both beside unknown loads; the other half
must be foreseen better. Both models are linear about the motion, so that a drawn recording takes no
simulation: its errors are those of the effect and white noise, filtered for the loads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from daest.design.loads import (
    Bank,
    Evidence,
    Levels,
    Shown,
    Whitening,
    filtered,
    orthonormal,
    without_start,
)
from daest.numerics.statistics import chi2

DRAWS = 400  # recordings
MOST_NUMBERS = 300_000  # of all drawn recordings together
FEWEST_DRAWS = 60
SEED = 20


@dataclass(frozen=True)
class Required:
    """What `daest diagnose` asks of an effect among `n_candidates`: `evidence` in BIC; `chance` of the
    likelihood ratio; that unseen data be likelier by `foreseen` standard errors over stretches of `stretch`
    samples, at least `fewest` of them, and foreseen better by the share `noticed`, or be expected to gain
    less than `silent` in log-likelihood and not speak against it; or that their simulation has errors below
    `clear` times those without it. They may be simulated worse by the share `noticed`, by `tolerated` where
    they are likelier. They are foreseen over up to `horizon` samples and the share `longest` of a recording,
    and errors count where the share `acting` of the squared difference is."""

    evidence: float
    chance: float
    n_candidates: int
    foreseen: float
    silent: float
    stretch: int
    fewest: int
    noticed: float
    tolerated: float
    clear: float
    horizon: int
    longest: float
    acting: float

    def threshold(self, n_data: int, n_sizes: int) -> float:
        """Of twice the log-likelihood ratio."""
        price = self.evidence + n_sizes * np.log(n_data)
        return float(max(price, chi2.isf(self.chance / self.n_candidates, n_sizes)))


@dataclass(frozen=True)
class Fitted:
    """Half recordings filtered and fitted: -2 log-likelihood (draws,), estimates of the slopes (draws, p),
    and the size of the noise (draws,)."""

    value: np.ndarray
    estimate: np.ndarray
    noise: np.ndarray


@dataclass(frozen=True)
class Halves:
    """Drawn recordings after one filter, less what initial states would explain: of the effect `errors` (m,),
    their slopes along the parameters and the sizes `rows` (p + k, m), of the noise of either half `fitted`
    and `unseen` (draws, m). `without` and `beside` are orthonormal bases (r, m) of the slopes without and
    with the sizes."""

    whitening: Whitening
    errors: np.ndarray
    rows: np.ndarray
    n_sizes: int
    fitted: np.ndarray
    unseen: np.ndarray
    without: np.ndarray
    beside: np.ndarray
    n_samples: int

    def fit(self, share: float, *, with_effect: bool) -> Fitted:
        """With that share of the effect."""
        basis = self.beside if with_effect else self.without
        rows = self._rows(with_effect=with_effect)
        along = self.fitted @ basis.T + share * (basis @ self.errors)
        squares = self._squares[0] + 2.0 * share * self._squares[1] + share**2 * self._squares[2]
        squares = squares - np.sum(along**2, axis=1)
        n = self.errors.size
        value = n * np.log(squares / n) + self.n_samples * self.whitening.log_det
        return Fitted(value, along @ np.linalg.pinv(rows @ basis.T), np.sqrt(squares / n))

    @cached_property
    def _squares(self) -> tuple[np.ndarray, np.ndarray, float]:
        return np.sum(self.fitted**2, axis=1), self.fitted @ self.errors, float(self.errors @ self.errors)

    def left(self, share: float, fit: Fitted, draws: np.ndarray, *, with_effect: bool) -> np.ndarray:
        """Prediction errors (n, m) of the unseen halves of these draws."""
        moved = fit.estimate[draws] @ self._rows(with_effect=with_effect)
        return self.unseen[draws] + share * self.errors - moved

    def _rows(self, *, with_effect: bool) -> np.ndarray:
        return self.rows if with_effect else self.rows[: self.rows.shape[0] - self.n_sizes]


@dataclass(frozen=True)
class Unseen:
    """Prediction errors of unseen data, of every recording in standard deviations (draws, n_samples, n_y),
    and these deviations with the logarithm of the density's scale at one sample (draws,)."""

    white: Sequence[np.ndarray]
    noise: np.ndarray
    log_scale: np.ndarray


@dataclass
class Drawn:
    """Recordings with what the parts of `evidence` tell of them; drawn once, so that sizes are compared on
    the same noise."""

    evidence: Evidence
    required: Required
    _halves: dict[Levels, Halves] = field(default_factory=dict)

    @cached_property
    def noise(self) -> list[np.ndarray]:
        """Of every recording, white: (2, draws, n_samples, n_y)."""
        n = sum(one.errors.size for one in self.parts)
        draws = int(np.clip(MOST_NUMBERS // n, FEWEST_DRAWS, DRAWS))
        rng = np.random.default_rng(SEED)
        return [rng.standard_normal((2, draws, *one.errors.shape)) for one in self.parts]

    @property
    def bank(self) -> Bank:
        return self.evidence.bank

    @property
    def parts(self) -> Sequence[Shown]:
        return self.evidence.parts

    def power(self, share: float) -> float:
        """Probability that the effect is named where it has that share of its size."""
        found = self.evidence.least(share)
        if not np.isfinite(found.evidence) or self._n_free < 1:
            return 0.0
        near = dict.fromkeys([self.bank.none(), *self.bank.neighbours(found.levels)])
        filters = [one for levels in near if (one := self._filtered(levels)) is not None]
        without = [one.fit(share, with_effect=False) for one in filters]
        beside = [one.fit(share, with_effect=True) for one in filters]
        values = [np.array([fit.value for fit in fits]) for fits in (without, beside)]
        passed = values[0].min(axis=0) - values[1].min(axis=0) > self.threshold
        if not np.any(passed):
            return 0.0
        kept = np.flatnonzero(passed)
        likeliest = [value.argmin(axis=0) for value in values]
        alone = [np.zeros(passed.size, dtype=int)] * 2  # the filter of no load is the first one
        old, new = self._judged(share, filters, (without, beside), likeliest, kept)
        simulated = self._judged(share, filters, (without, beside), alone, kept)
        ratio = _ratio(*simulated)
        shows = np.minimum(ratio, self._ratio_ahead(*simulated)) < 1.0 - self.required.noticed
        return float(np.sum(self._confirmed(old, new, ratio, shows))) / passed.size

    def _judged(
        self,
        share: float,
        filters: Sequence[Halves],
        fits: Sequence[Sequence[Fitted]],
        chosen: Sequence[np.ndarray],
        kept: np.ndarray,
    ) -> tuple[Unseen, Unseen]:
        """The unseen halves without and with the effect in the model."""
        old = self._unseen(share, filters, fits[0], chosen[0][kept], kept, with_effect=False)
        return old, self._unseen(share, filters, fits[1], chosen[1][kept], kept, with_effect=True)

    @property
    def _n_free(self) -> int:
        """Data beyond the unknowns."""
        shared = self.parts[0].slopes.shape[0] + self.parts[0].own.shape[0]
        return sum(one.errors.size - one.initial.shape[0] for one in self.parts) - shared

    @property
    def threshold(self) -> float:
        n_data = sum(one.errors.size for one in self.parts)
        return self.required.threshold(n_data, self.parts[0].own.shape[0])

    def _filtered(self, levels: Levels) -> Halves | None:
        """None where no filter settles."""
        whitening = self.bank.whitening(levels)
        if whitening is None:
            return None
        if levels not in self._halves:
            self._halves[levels] = self._made(whitening)
        return self._halves[levels]

    def _made(self, whitening: Whitening) -> Halves:
        errors, rows = [], []
        fitted: list[np.ndarray] = []
        unseen: list[np.ndarray] = []
        for one, noise in zip(self.parts, self.noise, strict=True):
            part = filtered(whitening, one)
            errors.append(part.errors)
            rows.append(np.concatenate([part.slopes, part.own]))
            for halves, half in zip((fitted, unseen), noise, strict=True):
                halves.append(without_start(whitening(half).reshape(half.shape[0], -1), part.initial))
        n_sizes, whole = self.parts[0].own.shape[0], np.concatenate(rows, axis=1)
        return Halves(
            whitening,
            np.concatenate(errors),
            whole,
            n_sizes,
            np.concatenate(fitted, axis=1),
            np.concatenate(unseen, axis=1),
            orthonormal(whole[: whole.shape[0] - n_sizes]),
            orthonormal(whole),
            sum(noise.shape[2] for noise in self.noise),
        )

    def _unseen(
        self,
        share: float,
        filters: Sequence[Halves],
        fits: Sequence[Fitted],
        chosen: np.ndarray,
        kept: np.ndarray,
        *,
        with_effect: bool,
    ) -> Unseen:
        """The unseen halves of the draws `kept`, each by the filter and fit that was chosen for it."""
        n_y = self.parts[0].errors.shape[1]
        white = np.zeros((kept.size, filters[0].errors.size))
        noise, log_scale = np.zeros(kept.size), np.zeros(kept.size)
        for number in np.unique(chosen):
            own, one = chosen == number, filters[number]
            size = fits[number].noise[kept[own]]
            left = one.left(share, fits[number], kept[own], with_effect=with_effect)
            white[own], noise[own] = left / size[:, None], size
            log_scale[own] = -n_y * np.log(size) - 0.5 * one.whitening.log_det
        edges = np.cumsum([one.errors.size for one in self.parts])[:-1]
        parts = [part.reshape(kept.size, -1, n_y) for part in np.split(white, edges, axis=1)]
        return Unseen(parts, noise, log_scale)

    def _ratio_ahead(self, old: Unseen, new: Unseen) -> np.ndarray:
        """Of the rms errors of simulated unseen data over stretches, where the two models differ (draws,)."""
        shortest = min(white.shape[1] for white in old.white)
        length = max(1, min(self.required.horizon, int(self.required.longest * shortest)))
        parts = []
        for before, after in zip(old.white, new.white, strict=True):
            n = before.shape[1] // length
            errors = [one.noise[:, None, None] * white for one, white in ((old, before), (new, after))]
            squares = [errors[0] ** 2, errors[1] ** 2, (errors[1] - errors[0]) ** 2]
            parts.append([e[:, : n * length].reshape(e.shape[0], n, -1).sum(axis=2) for e in squares])
        without, beside, apart = (np.concatenate(one, axis=1) for one in zip(*parts, strict=True))
        order = np.argsort(-apart, axis=1)
        share = np.cumsum(np.take_along_axis(apart, order, axis=1), axis=1)
        least = np.arange(order.shape[1]) < self.required.fewest
        acts = least | (
            share - np.take_along_axis(apart, order, axis=1) < self.required.acting * share[:, -1:]
        )
        without, beside = (
            np.sum(np.take_along_axis(one, order, axis=1) * acts, axis=1) for one in (without, beside)
        )
        return np.sqrt(beside / without)

    def _confirmed(self, old: Unseen, new: Unseen, ratio: np.ndarray, shows: np.ndarray) -> np.ndarray:
        """Whether unseen data let each draw pass; `ratio` is that of the errors of simulations, and `shows`
        tells whether they become smaller."""
        required, length = self.required, self.required.stretch
        gains, expected = [], np.zeros(ratio.size)
        for before, after in zip(old.white, new.white, strict=True):
            n = before.shape[1]
            first = length if n > 4 * length else 0  # the observer settles
            n_stretches = (n - first) // length
            used = slice(first, first + n_stretches * length)
            squares = 0.5 * np.sum(before[:, used] ** 2 - after[:, used] ** 2, axis=2)
            gain = squares + (new.log_scale - old.log_scale)[:, None]
            gains.append(gain.reshape(gain.shape[0], n_stretches, length).sum(axis=2))
            expected += 0.5 * np.sum((after[:, used] - before[:, used]) ** 2, axis=(1, 2))
        gain = np.concatenate(gains, axis=1)
        speaks = np.zeros(ratio.size, dtype=bool)
        if gain.shape[1] >= required.fewest:
            error = np.std(gain, axis=1, ddof=1) * np.sqrt(gain.shape[1])
            certainty = np.sum(gain, axis=1) / np.where(error > 0.0, error, np.inf)
            is_silent = (expected < required.silent) & (certainty > -required.foreseen)
            speaks = is_silent | ((certainty > required.foreseen) & shows)
        most = np.where(speaks, 1.0 + required.tolerated, 1.0 + required.noticed)
        return (ratio <= most) & (speaks | (ratio < required.clear))


def _ratio(old: Unseen, new: Unseen) -> np.ndarray:
    """Of the rms errors of unseen data, with the effect to without it (draws,)."""
    before, after = (
        one.noise**2 * np.sum([np.sum(part**2, axis=(1, 2)) for part in one.white], axis=0)
        for one in (old, new)
    )
    return np.sqrt(after / before)
