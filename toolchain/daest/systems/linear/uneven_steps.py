"""Steps of an affine model over intervals of many lengths: exact, with exact slopes, however fast it is.

The recursion is that of `affine_steps`, with Φ, I and R of every interval. They are short series in what its
length differs by from a middle one (`numerics.exponential.Beside`). Intervals that differ by more are cut
into equal parts whose lengths are near each other; inputs run on straight lines over them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daest.model.linear import StateSpaceFamily
from daest.numerics.exponential import Beside, beside
from daest.numerics.recursions import varying_recursion
from daest.numerics.tables import turned
from daest.systems.linear.affine_steps import DrivenBy, Gain, Steps
from daest.systems.linear.state_space import state_space, state_space_derivatives

MOST_PARTS = 40  # of an interval on the average: with more, adaptive steps are as few
MOST_NUMBERS = 2**25  # of the matrices of all parts (256 MiB)
AT_ONCE = 2**22  # numbers (32 MiB) of their derivatives that are there at a time
HALVINGS = 8  # of the length of the parts
FAST = 1.0  # |λ| times an interval, below which adaptive steps take few per sample and cost less


@dataclass(frozen=True)
class UnevenSteps(Steps):
    """Steps over the parts of intervals, of which each is cut into `counts` (n_samples - 1,)."""

    counts: np.ndarray
    near: Beside  # the lengths of the parts of every interval

    def at_samples(self, states: np.ndarray) -> np.ndarray:
        return states[..., self._samples, :]

    @cached_property
    def _samples(self) -> np.ndarray:
        """The positions (n_samples,) of the samples among the starts of the parts."""
        return np.concatenate([[0], np.cumsum(self.counts)])

    @property
    def _begins(self) -> np.ndarray:
        return self._samples[:-1]

    @cached_property
    def _tops(self) -> np.ndarray:
        """Φ and its two integrals beside each other for the parts of every interval, (n_samples - 1, n,
        3 n)."""
        return self.near.summed(self.near.rows)

    @property
    def _transitions(self) -> np.ndarray:
        """Φ for the parts of every interval, (n_samples - 1, n, n)."""
        return self._tops[:, :, : self.matrices.A.shape[0]]

    @cached_property
    def _courses(self) -> tuple[np.ndarray, np.ndarray]:
        """The inputs at the start of every part and their rise over it, both (n_parts, n_ū)."""
        inputs, counts = self.inputs, self.counts
        rise = np.repeat((inputs.end - inputs.start) / counts[:, None], counts, axis=0)
        number = np.arange(len(rise)) - np.repeat(self._begins, counts)
        return np.repeat(inputs.start, counts, axis=0) + number[:, None] * rise, rise

    def _weighted(self, B: np.ndarray, b: np.ndarray) -> np.ndarray:
        """What the integrals are multiplied by at every part, (..., n_parts, 2 n), linear in B (..., n, n_ū)
        and b (..., n)."""
        weights = np.repeat(self.near.weights, self.counts, axis=0)
        start, rise = self._courses
        held, risen = start @ turned(B) + b[..., None, :], rise @ turned(B)
        return np.concatenate([weights[:, :1] * held, weights[:, 1:2] * risen], axis=-1)

    @cached_property
    def _signals(self) -> np.ndarray:
        """Those of the model at theta, (n_parts, 2 n)."""
        return self._weighted(self.matrices.B, self.matrices.b)

    def _driven(self) -> np.ndarray:
        return self._integrated(self._signals)

    def _integrated(self, signals: np.ndarray) -> np.ndarray:
        """The integrals of every part times signals (..., n_parts, 2 n)."""
        tops, n = self._tops, self.matrices.A.shape[0]
        found = np.empty((*signals.shape[:-1], n))
        for intervals, parts in self._alike(0, len(tops)):
            found[..., parts, :] = signals[..., parts, :] @ turned(tops[intervals, :, n:])
        return found

    def _fed_back(self, errors: np.ndarray, gain: np.ndarray) -> np.ndarray:
        return np.asarray((self._transitions @ (errors @ turned(gain))[..., None])[..., 0])

    def _move(self, drive: np.ndarray, begun: np.ndarray) -> None:
        signals = np.hstack([begun, self._signals])
        changes, powers = self.near.row_derivatives(self.by_theta["A"]), self.near.powers
        _, p, n, width = changes.shape
        n_at_once = max(AT_ONCE // max(p * n * width, 1), 1)
        for first in range(0, len(powers), n_at_once):
            last = min(first + n_at_once, len(powers))
            moved = self.near.summed(changes, powers[first:last]).reshape(last - first, p * n, width)
            for intervals, parts in self._alike(first, last):
                found = signals[parts] @ turned(moved[intervals - first])
                drive[:, parts] = np.moveaxis(found.reshape(*parts.shape, p, n), 2, 0)
        drive += self._integrated(self._weighted(self.by_theta["B"], self.by_theta["b"]))

    def _alike(self, first: int, last: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Of the intervals from `first` to `last` those that have as many parts, (k,), and these, (k, n)."""
        counts = self.counts[first:last]
        for count in np.unique(counts):
            intervals = first + np.flatnonzero(counts == count)
            yield intervals, self._begins[intervals][:, None] + np.arange(count)

    def _followed(self, drive: np.ndarray, start: np.ndarray) -> np.ndarray:
        states = varying_recursion(self._closed, drive.reshape(-1, *drive.shape[-2:]), start)
        return states.reshape(*drive.shape[:-2], *states.shape[1:])

    @cached_property
    def _closed(self) -> np.ndarray:
        """Φ (n_parts, n, n), at samples Φ (1 - K C)."""
        Phi = np.repeat(self._transitions, self.counts, axis=0)
        if self.gain is not None:
            Phi[self._begins] -= Phi[self._begins] @ self.gain.gain @ self.matrices.C
        return Phi


def uneven_steps(
    family: StateSpaceFamily,
    theta: np.ndarray,
    names: Sequence[str],
    intervals: np.ndarray,
    inputs: DrivenBy,
    gain: Gain | None,
) -> UnevenSteps | None:
    """The steps over `intervals` (n_samples - 1,) [s] at theta (n_theta,) with derivatives by the parameters
    `names`; None where the model moves so slowly that adaptive steps cost less, or so fast, or has so many
    states, that these would be too many. The inputs have no bends."""
    ss = state_space(family, theta)
    n, most, length = ss.A.shape[0], MOST_PARTS * intervals.size, float(np.median(intervals))
    if not np.all(np.isfinite(ss.A)) or np.max(np.abs(np.linalg.eigvals(ss.A))) * length < FAST:
        return None
    for _ in range(HALVINGS):
        counts = np.maximum(np.rint(intervals / length), 1.0).astype(int)
        if counts.sum() > most or counts.sum() * 3 * n * n > MOST_NUMBERS:
            return None
        near = beside(ss.A, intervals / counts)
        if near is not None:
            by_theta = state_space_derivatives(family, theta, names)
            return UnevenSteps(ss, by_theta, inputs, gain, counts, near)
        length /= 2.0
    return None
