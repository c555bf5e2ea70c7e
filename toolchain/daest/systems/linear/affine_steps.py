"""Steps of an affine model over sample intervals of one length: exact, with exact slopes, however fast it is.

x[k+1] = Φ x[k] + I (B u0[k] + b) + R B (u1[k] - u0[k]) and y = C x + D u + d, where u0 and u1 are the inputs
at the two ends of an interval: Φ = e^(A T), I = ∫₀ᵀ e^(A s) ds and R = ∫₀ᵀ e^(A (T-s)) s ds / T. Inputs that
leave the straight line by r (1 - r) (a + b r) at r = s/T add the integrals with that factor. Where a gain
corrects every state first, x + K e with e = y measured - y, the matrix of the recursion is Φ (1 - K C).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daest.model.linear import StateSpace, StateSpaceFamily
from daest.numerics.exponential import (
    CUBIC,
    STRAIGHT,
    TransitionIntegrals,
    transition_integral_derivatives,
    transition_integrals,
)
from daest.numerics.recursions import linear_recursion
from daest.numerics.tables import turned
from daest.systems.linear.state_space import state_space, state_space_derivatives


@dataclass(frozen=True)
class DrivenBy:
    """At the start and the end of every interval, `start` and `end` (n_samples - 1, n_ū), and at the samples
    (n_samples, n_ū); `bent` (n_samples - 1, 2, n_ū) are a and b."""

    start: np.ndarray
    end: np.ndarray
    sampled: np.ndarray
    bent: np.ndarray | None = None

    @property
    def courses(self) -> list[np.ndarray]:
        """What the inputs are made of in every interval, each (n_samples - 1, n_ū): the start, the rise, and
        the two bends."""
        bends = [] if self.bent is None else [self.bent[:, 0], self.bent[:, 1]]
        return [self.start, self.end - self.start, *bends]

    def weights(self, integrals: TransitionIntegrals) -> list[np.ndarray]:
        """The integral (..., n, n) by which each of the courses adds to the state."""
        if self.bent is None:
            return [integrals.first, integrals.second]
        square, cube = integrals.more
        return [integrals.first, integrals.second, integrals.second - square, square - cube]


@dataclass(frozen=True)
class Gain:
    """What corrects the states: measurements (n_samples, n_y) without gaps, the gain (n, n_y) and its slopes
    (n_gain, n, n_y) along further directions."""

    measurements: np.ndarray
    gain: np.ndarray
    slopes: np.ndarray


@dataclass(frozen=True)
class Steps(ABC):
    """The steps of a model over a record at one theta, driven by `inputs` and corrected by the `gain`, if
    any; `by_theta` are the derivatives of the matrices by p parameters, with a leading axis of p."""

    matrices: StateSpace
    by_theta: Mapping[str, np.ndarray]
    inputs: DrivenBy
    gain: Gain | None

    def states(self, x0: np.ndarray) -> np.ndarray:
        """Before the correction at the start of every step, and at the end: (n_steps + 1, n), from x0
        (n,)."""
        drive = self._driven()
        if self.gain is not None:
            ss = self.matrices
            known = self.gain.measurements - self.inputs.sampled @ turned(ss.D) - ss.d
            drive[self._begins] += self._fed_back(known[:-1], self.gain.gain)
        return self._followed(drive, x0)

    @abstractmethod
    def at_samples(self, states: np.ndarray) -> np.ndarray:
        """Those (..., n_samples, n) of `states` (..., n_steps + 1, n)."""

    def outputs(self, states: np.ndarray) -> np.ndarray:
        """(n_samples, n_y) of states (n_samples, n)."""
        ss = self.matrices
        return states @ turned(ss.C) + self.inputs.sampled @ turned(ss.D) + ss.d

    def slopes(self, states: np.ndarray, outputs: np.ndarray) -> np.ndarray:
        """∂y/∂(the p parameters, x0, the directions of the gain), (directions, n_samples, n_y), along states
        (n_steps + 1, n) with outputs (n_samples, n_y)."""
        by, gain, n = self.by_theta, self.gain, states.shape[1]
        p, n_gain = by["A"].shape[0], 0 if gain is None else gain.slopes.shape[0]
        ones = np.ones((outputs.shape[0], 1))
        direct = np.concatenate([by["C"], by["D"], by["d"][:, :, None]], axis=2)
        straight = np.hstack([self.at_samples(states), self.inputs.sampled, ones]) @ turned(direct)
        drive = np.zeros((p + n + n_gain, len(states) - 1, n))
        begun = states[:-1]
        if gain is None:
            self._move(drive[:p], begun)
        else:
            error = gain.measurements - outputs
            begun = begun.copy()
            begun[self._begins] += (error @ turned(gain.gain))[:-1]
            self._move(drive[:p], begun)
            drive[:p, self._begins] -= self._fed_back(straight[:, :-1], gain.gain)
            drive[p + n :, self._begins] = self._fed_back(error[:-1], gain.slopes)
        start = np.zeros((drive.shape[0], n))
        start[p : p + n] = np.eye(n)
        found = self.at_samples(self._followed(drive, start)) @ turned(self.matrices.C)
        found[:p] += straight
        return found

    @property
    @abstractmethod
    def _begins(self) -> slice | np.ndarray:
        """The steps that a sample begins."""

    @abstractmethod
    def _driven(self) -> np.ndarray:
        """What the inputs and the offset add to the state over every step, (n_steps, n)."""

    @abstractmethod
    def _fed_back(self, errors: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """What errors (..., n_samples - 1, n_y) add to the state over the steps that samples begin, by a gain
        (..., n, n_y)."""

    @abstractmethod
    def _move(self, drive: np.ndarray, begun: np.ndarray) -> None:
        """Put what the parameters change over every step into `drive` (p, n_steps, n), along the corrected
        states that the steps are `begun` with (n_steps, n)."""

    @abstractmethod
    def _followed(self, drive: np.ndarray, start: np.ndarray) -> np.ndarray:
        """The states (..., n_steps + 1, n) of the corrected recursion under a drive (..., n_steps, n)."""


@dataclass(frozen=True)
class AffineSteps(Steps):
    """Steps that are all of one length; `change` are the derivatives of the `integrals` by p parameters, with
    a leading axis of p."""

    integrals: TransitionIntegrals
    change: TransitionIntegrals

    def at_samples(self, states: np.ndarray) -> np.ndarray:
        """The same states: every step leads from a sample to the next."""
        return states

    @property
    def _begins(self) -> slice:
        return slice(None)

    def _driven(self) -> np.ndarray:
        """I (B u0 + b) + R B (u1 - u0) and what bends add."""
        ss, now = self.matrices, self.integrals
        offset = (now.first @ ss.b[:, None])[:, 0]
        pairs = zip(self.inputs.courses, self.inputs.weights(now), strict=True)
        return np.asarray(sum((u @ turned(held @ ss.B) for u, held in pairs), offset))

    def _fed_back(self, errors: np.ndarray, gain: np.ndarray) -> np.ndarray:
        return errors @ turned(self.integrals.transition @ gain)

    def _move(self, drive: np.ndarray, begun: np.ndarray) -> None:
        # One product with all signals of an interval beside each other.
        signals = np.hstack([begun, *self.inputs.courses, np.ones((len(begun), 1))])
        moves = [self.change.transition, *self._moved_by()]
        np.matmul(signals, turned(np.concatenate(moves, axis=2)), out=drive)

    def _moved_by(self) -> list[np.ndarray]:
        """Derivatives, with a leading axis of p, of what each of the courses of the inputs, and then the
        offset, adds to the state."""
        ss, by, now, change = self.matrices, self.by_theta, self.integrals, self.change
        pairs = zip(self.inputs.weights(change), self.inputs.weights(now), strict=True)
        offset = change.first @ ss.b[:, None] + now.first @ by["b"][:, :, None]
        return [*(moved @ ss.B + held @ by["B"] for moved, held in pairs), offset]

    def _followed(self, drive: np.ndarray, start: np.ndarray) -> np.ndarray:
        return linear_recursion(self._closed, drive, start)

    @cached_property
    def _closed(self) -> np.ndarray:
        """Φ (1 - K C)."""
        Phi = self.integrals.transition
        return Phi if self.gain is None else Phi - Phi @ self.gain.gain @ self.matrices.C


def affine_steps(
    family: StateSpaceFamily,
    theta: np.ndarray,
    names: Sequence[str],
    period: float,
    inputs: DrivenBy,
    gain: Gain | None,
) -> AffineSteps:
    """The steps of one `period` [s] at theta (n_theta,) with derivatives by the parameters `names`; not
    finite where the rates are beyond all numbers."""
    ss, count = state_space(family, theta), STRAIGHT if inputs.bent is None else CUBIC
    by_theta = state_space_derivatives(family, theta, names)
    integrals = transition_integrals(ss.A, period, count)
    change = transition_integral_derivatives(ss.A, by_theta["A"], period, count)
    return AffineSteps(ss, by_theta, inputs, gain, integrals, change)
