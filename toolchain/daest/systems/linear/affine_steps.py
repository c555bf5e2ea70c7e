"""Steps of an affine model over sample intervals of one length: exact, with exact slopes, however fast it is.

x[k+1] = Φ x[k] + I (B u0[k] + b) + R B (u1[k] - u0[k]) and y = C x + D u + d, where u0 and u1 are the inputs
at the two ends of an interval: Φ = e^(A T), I = ∫₀ᵀ e^(A s) ds and R = ∫₀ᵀ e^(A (T-s)) s ds / T. Inputs that
leave the straight line by r (1 - r) (a + b r) at r = s/T add the integrals with that factor. Where a gain
corrects every state first, x + K e with e = y measured - y, the matrix of the recursion is Φ (1 - K C).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daest.model.linear import StateSpace, StateSpaceFamily
from daest.numerics.exponential import (
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
class AffineSteps:
    """The steps over `period` [s] at one theta; `by_theta` and `change` are the derivatives of the matrices
    and of their integrals by p parameters, with a leading axis of p."""

    matrices: StateSpace
    integrals: TransitionIntegrals
    by_theta: Mapping[str, np.ndarray]
    change: TransitionIntegrals

    def states(self, inputs: DrivenBy, x0: np.ndarray, gain: Gain | None) -> np.ndarray:
        """Before the correction of each sample, (n_samples, n), from x0 (n,)."""
        ss = self.matrices
        drive = self._driven(self.integrals, ss.B, ss.b, inputs)
        if gain is not None:
            known = gain.measurements - inputs.sampled @ turned(ss.D) - ss.d
            drive = drive + known[:-1] @ turned(self.integrals.transition @ gain.gain)
        return linear_recursion(self._closed(gain), drive, x0)

    @staticmethod
    def at_samples(states: np.ndarray) -> np.ndarray:
        """The same states: every step leads from a sample to the next."""
        return states

    def outputs(self, states: np.ndarray, inputs: DrivenBy) -> np.ndarray:
        """(n_samples, n_y) of states (n_samples, n)."""
        ss = self.matrices
        return states @ turned(ss.C) + inputs.sampled @ turned(ss.D) + ss.d

    def slopes(
        self, inputs: DrivenBy, states: np.ndarray, outputs: np.ndarray, gain: Gain | None
    ) -> np.ndarray:
        """∂y/∂(the p parameters, x0, the directions of the gain), (directions, n_samples, n_y), along states
        (n_samples, n) with outputs (n_samples, n_y)."""
        ss, by, (n_samples, n) = self.matrices, self.by_theta, states.shape
        p, n_gain = by["A"].shape[0], 0 if gain is None else gain.slopes.shape[0]
        error = None if gain is None else gain.measurements - outputs
        ones = np.ones((n_samples, 1))
        direct = np.concatenate([by["C"], by["D"], by["d"][:, :, None]], axis=2)
        straight = np.hstack([states, inputs.sampled, ones]) @ turned(direct)
        corrected = states if gain is None or error is None else states + error @ turned(gain.gain)
        # What drives the parameters is one product with all signals of an interval beside each other.
        signals = np.hstack([corrected[:-1], *inputs.courses, ones[1:]])
        moves = [self.change.transition, *self._moved_by(inputs, by)]
        drive = np.zeros((p + n + n_gain, n_samples - 1, n))
        np.matmul(signals, turned(np.concatenate(moves, axis=2)), out=drive[:p])
        if gain is not None and error is not None:
            drive[:p] -= straight[:, :-1] @ turned(self.integrals.transition @ gain.gain)
            drive[p + n :] = error[:-1] @ turned(self.integrals.transition @ gain.slopes)
        start = np.zeros((drive.shape[0], n))
        start[p : p + n] = np.eye(n)
        found = linear_recursion(self._closed(gain), drive, start) @ turned(ss.C)
        found[:p] += straight
        return found

    def _moved_by(self, inputs: DrivenBy, by: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        """Derivatives, with a leading axis of p, of what each of the courses of the inputs, and then the
        offset, adds to the state."""
        ss, now, change = self.matrices, self.integrals, self.change
        pairs = zip(inputs.weights(change), inputs.weights(now), strict=True)
        offset = change.first @ ss.b[:, None] + now.first @ by["b"][:, :, None]
        return [*(moved @ ss.B + held @ by["B"] for moved, held in pairs), offset]

    def _closed(self, gain: Gain | None) -> np.ndarray:
        """Φ (1 - K C)."""
        Phi = self.integrals.transition
        return Phi if gain is None else Phi - Phi @ gain.gain @ self.matrices.C

    @staticmethod
    def _driven(integrals: TransitionIntegrals, B: np.ndarray, b: np.ndarray, inputs: DrivenBy) -> np.ndarray:
        """I (B u0 + b) + R B (u1 - u0) and what bends add, (..., n_steps, n), linear in the integrals and in
        (B, b): either may have a leading axis of derivatives."""
        offset = (integrals.first @ b[..., None])[..., 0]
        pairs = zip(inputs.courses, inputs.weights(integrals), strict=True)
        return np.asarray(sum((u @ turned(held @ B) for u, held in pairs), offset[..., None, :]))


def affine_steps(
    family: StateSpaceFamily, theta: np.ndarray, names: Sequence[str], period: float, count: int = STRAIGHT
) -> AffineSteps:
    """The steps at theta (n_theta,) with derivatives by the parameters `names`; not finite where the rates
    are beyond all numbers. `count`: integrals that the inputs take, STRAIGHT or CUBIC."""
    ss = state_space(family, theta)
    by_theta = state_space_derivatives(family, theta, names)
    integrals = transition_integrals(ss.A, period, count)
    change = transition_integral_derivatives(ss.A, by_theta["A"], period, count)
    return AffineSteps(ss, integrals, by_theta, change)
