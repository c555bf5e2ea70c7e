"""Steps of an affine model over intervals of many lengths: exact, with exact slopes, however fast it is.

The recursion is that of `affine_steps`, with Φ, I and R of every interval. They are short series in what its
length differs by from a middle one (`numerics.exponential.Beside`). Intervals that differ by more are cut
into equal parts whose lengths are near each other; inputs run on straight lines over them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daest.model.linear import StateSpace, StateSpaceFamily
from daest.numerics.exponential import Beside, beside
from daest.numerics.recursions import varying_recursion
from daest.numerics.tables import turned
from daest.systems.linear.affine_steps import DrivenBy, Gain
from daest.systems.linear.state_space import state_space, state_space_derivatives

MOST_PARTS = 40  # of an interval on the average: with more, adaptive steps are as few
MOST_NUMBERS = 2**25  # of the matrices of all parts (256 MiB)
AT_ONCE = 2**22  # numbers (32 MiB) of their derivatives that are there at a time
HALVINGS = 8  # of the length of the parts
FAST = 1.0  # |λ| times an interval, below which adaptive steps take few per sample and cost less


@dataclass(frozen=True)
class UnevenSteps:
    """The steps over intervals that are cut into `counts` (n_samples - 1,) parts each, at one theta;
    `by_theta` are the derivatives of the matrices by p parameters, with a leading axis of p."""

    matrices: StateSpace
    by_theta: Mapping[str, np.ndarray]
    counts: np.ndarray
    near: Beside  # the lengths of the parts of every interval

    def states(self, inputs: DrivenBy, x0: np.ndarray, gain: Gain | None) -> np.ndarray:
        """Before the correction of each sample and at the start of all other parts, (n_parts + 1, n), from x0
        (n,)."""
        drive = self._integrated(self._signals(inputs))
        if gain is not None:
            ss = self.matrices
            known = gain.measurements - inputs.sampled @ turned(ss.D) - ss.d
            drive[self._begins] += self._through(known[:-1] @ turned(gain.gain))
        return varying_recursion(self._closed(gain), drive[None], x0)[0]

    def at_samples(self, states: np.ndarray) -> np.ndarray:
        """Those (..., n_samples, n) of the states at the starts of all parts (..., n_parts + 1, n)."""
        return states[..., self._samples, :]

    def outputs(self, states: np.ndarray, inputs: DrivenBy) -> np.ndarray:
        """(n_samples, n_y) of states (n_samples, n)."""
        ss = self.matrices
        return states @ turned(ss.C) + inputs.sampled @ turned(ss.D) + ss.d

    def slopes(
        self, inputs: DrivenBy, states: np.ndarray, outputs: np.ndarray, gain: Gain | None
    ) -> np.ndarray:
        """∂y/∂(the p parameters, x0, the directions of the gain), (directions, n_samples, n_y), along states
        (n_parts + 1, n) with outputs (n_samples, n_y)."""
        ss, by, n = self.matrices, self.by_theta, states.shape[1]
        p, n_gain = by["A"].shape[0], 0 if gain is None else gain.slopes.shape[0]
        ones = np.ones((outputs.shape[0], 1))
        direct = np.concatenate([by["C"], by["D"], by["d"][:, :, None]], axis=2)
        straight = np.hstack([self.at_samples(states), inputs.sampled, ones]) @ turned(direct)
        drive = np.zeros((p + n + n_gain, len(states) - 1, n))
        begun = states[:-1].copy()
        if gain is not None:
            error = gain.measurements - outputs
            begun[self._begins] += error[:-1] @ turned(gain.gain)
            drive[:p, self._begins] -= self._through(straight[:, :-1] @ turned(gain.gain))
            drive[p + n :, self._begins] = self._through(error[:-1] @ turned(gain.slopes))
        drive[:p] += self._moved(np.hstack([begun, self._signals(inputs)]))
        drive[:p] += self._integrated(self._changed_signals(inputs))
        start = np.zeros((drive.shape[0], n))
        start[p : p + n] = np.eye(n)
        found = varying_recursion(self._closed(gain), drive, start)
        result = self.at_samples(found) @ turned(ss.C)
        result[:p] += straight
        return result

    @cached_property
    def _samples(self) -> np.ndarray:
        """The positions (n_samples,) of the samples among the starts of the parts."""
        return np.concatenate([[0], np.cumsum(self.counts)])

    @property
    def _begins(self) -> np.ndarray:
        """Those of the parts that a sample begins."""
        return self._samples[:-1]

    @cached_property
    def _tops(self) -> np.ndarray:
        """Φ and its two integrals beside each other for the parts of every interval, (n_samples - 1, n,
        3 n)."""
        rows = self.near.rows
        return np.asarray(self.near.powers @ rows.reshape(len(rows), -1)).reshape(-1, *rows.shape[1:])

    def _closed(self, gain: Gain | None) -> np.ndarray:
        """Φ (n_parts, n, n), at samples Φ (1 - K C)."""
        n = self.matrices.A.shape[0]
        Phi = np.repeat(self._tops[:, :, :n], self.counts, axis=0)
        if gain is not None:
            Phi[self._begins] -= Phi[self._begins] @ gain.gain @ self.matrices.C
        return Phi

    def _through(self, states: np.ndarray) -> np.ndarray:
        """Φ of the parts that samples begin times states (..., n_samples - 1, n) there."""
        Phi = self._tops[:, :, : self.matrices.A.shape[0]]
        return np.asarray((Phi @ states[..., None])[..., 0])

    def _courses(self, inputs: DrivenBy) -> tuple[np.ndarray, np.ndarray]:
        """The inputs at the start of every part and their rise over it, both (n_parts, n_ū)."""
        rise = np.repeat((inputs.end - inputs.start) / self.counts[:, None], self.counts, axis=0)
        number = np.arange(len(rise)) - np.repeat(self._begins, self.counts)
        return np.repeat(inputs.start, self.counts, axis=0) + number[:, None] * rise, rise

    @property
    def _weights(self) -> np.ndarray:
        """Those of `Beside` at every part, (n_parts, 2)."""
        return np.repeat(self.near.weights, self.counts, axis=0)

    def _signals(self, inputs: DrivenBy) -> np.ndarray:
        """What the integrals are multiplied by at every part, (n_parts, 2 n)."""
        ss, weights = self.matrices, self._weights
        start, rise = self._courses(inputs)
        held, risen = start @ turned(ss.B) + ss.b, rise @ turned(ss.B)
        return np.hstack([weights[:, :1] * held, weights[:, 1:2] * risen])

    def _changed_signals(self, inputs: DrivenBy) -> np.ndarray:
        """The derivatives (p, n_parts, 2 n) of `_signals` by the parameters."""
        by, weights = self.by_theta, self._weights
        start, rise = self._courses(inputs)
        held, risen = start @ turned(by["B"]) + by["b"][:, None, :], rise @ turned(by["B"])
        return np.concatenate([weights[:, :1] * held, weights[:, 1:2] * risen], axis=2)

    def _integrated(self, signals: np.ndarray) -> np.ndarray:
        """The integrals of every part times signals (..., n_parts, 2 n)."""
        tops, n = self._tops, self.matrices.A.shape[0]
        found = np.empty((*signals.shape[:-1], n))
        for intervals, parts in self._alike(0, len(tops)):
            found[..., parts, :] = signals[..., parts, :] @ turned(tops[intervals, :, n:])
        return found

    def _moved(self, signals: np.ndarray) -> np.ndarray:
        """The derivatives of Φ and of the integrals by the parameters times signals (n_parts, 3 n), (p,
        n_parts, n)."""
        changes, powers = self.near.row_derivatives(self.by_theta["A"]), self.near.powers
        terms, p, n = changes.shape[:3]
        found = np.empty((len(signals), p * n))
        n_at_once = max(AT_ONCE // max(p * n * 3 * n, 1), 1)
        for first in range(0, len(powers), n_at_once):
            last = min(first + n_at_once, len(powers))
            moved = powers[first:last] @ changes.reshape(terms, p * n * 3 * n)
            moved = moved.reshape(last - first, p * n, 3 * n)
            for intervals, parts in self._alike(first, last):
                found[parts] = signals[parts] @ turned(moved[intervals - first])
        return found.reshape(len(signals), p, n).transpose(1, 0, 2)

    def _alike(self, first: int, last: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Of the intervals from `first` to `last` those that have as many parts, (k,), and these, (k, n)."""
        counts = self.counts[first:last]
        for count in np.unique(counts):
            intervals = first + np.flatnonzero(counts == count)
            yield intervals, self._begins[intervals][:, None] + np.arange(count)


def uneven_steps(
    family: StateSpaceFamily, theta: np.ndarray, names: Sequence[str], intervals: np.ndarray
) -> UnevenSteps | None:
    """The steps over `intervals` (n_samples - 1,) [s] at theta (n_theta,) with derivatives by the parameters
    `names`; None where the model moves so slowly that adaptive steps cost less, or so fast, or has so many
    states, that these would be too many."""
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
            return UnevenSteps(ss, state_space_derivatives(family, theta, names), counts, near)
        length /= 2.0
    return None
