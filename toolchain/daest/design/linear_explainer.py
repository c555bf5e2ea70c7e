"""Models with affine dynamics: predicted by the Kalman filter of their noise, exactly.

The slopes of the innovations are those of the likelihood (estimation.linear_predictors): with process noise
they include the change of the gain, and the noise itself excites the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daest.design.explainer import Driven, ErrorModel, Explained, Point
from daest.estimation.fitting.records import Record
from daest.estimation.linear.linear_predictors import (
    Problem,
    Recursion,
    innovation_slopes,
    innovations,
    kalman_gains,
    matrix_slopes,
    noise_levels,
    recursion,
)
from daest.model.linear import StateSpace, StateSpaceFamily
from daest.numerics.riccati import Gains
from daest.systems.linear.state_space import stacked_inputs, state_space

LARGEST = 150  # states of the model and of its slopes up to which the information by noise is computed
PULSE = 2  # sample at which inputs are pulsed: a slope of the input reaches one sample to either side
OUTPUT_FIELDS = ("C", "D", "H", "d")


@dataclass(frozen=True, kw_only=True)
class LinearExplainer(Driven):
    """`unknowns` holds the parameters, then the noises that were estimated."""

    family: StateSpaceFamily

    @property
    def has_noise(self) -> bool:
        return bool(np.any(self.unknowns.intensity > 0.0))

    @cached_property
    def problem(self) -> Problem:
        weigh = np.zeros(len(self.family.outputs), dtype=bool)
        direct = np.any(state_space(self.family, self.unknowns.theta).H != 0.0)
        return Problem(self.family, (), self.hold, self.unknowns, weigh, "held" if direct else "white")

    def outputs(self, inputs: np.ndarray, at: Point) -> np.ndarray:
        ss = self._space(at.z)
        return self._states(inputs, at) @ ss.C.T + self._stacked(inputs) @ ss.D.T + ss.d

    def variables(self, inputs: np.ndarray, at: Point) -> np.ndarray:
        ss = self._space(at.z)
        return self._states(inputs, at) @ ss.X.T + self._stacked(inputs) @ ss.U.T + ss.x0

    @np.errstate(all="ignore")  # where numbers overflow, nothing is explained
    def explain(self, inputs: np.ndarray, outputs: np.ndarray, at: Point) -> Explained | None:
        dyn, gains = self._sampled(at.z)
        if gains is None and self.has_noise:
            return None
        record = self._record(inputs, outputs)
        found = innovations(dyn, record, gains)
        errors = found.at_zero - np.tensordot(at.x0, found.response, 1)
        slopes = innovation_slopes(dyn, record, found, at.x0) * self._steps(at.z)[:, None, None]
        rows = np.concatenate([errors[None], slopes, -found.response])
        if not np.all(np.isfinite(rows)):
            return None
        white = rows @ np.linalg.inv(np.linalg.cholesky(_covariance(dyn, gains))).T
        flat = white.reshape(white.shape[0], -1)
        p = slopes.shape[0]
        return Explained(flat[0], flat[1 : p + 1], flat[p + 1 :])

    def error_model(self, inputs: np.ndarray) -> ErrorModel | None:
        z = self.unknowns.start
        dyn, gains = self._sampled(z)
        if gains is None and self.has_noise:
            return None
        ss, root = self._space(z), np.linalg.cholesky(_covariance(dyn, gains))
        gain = np.zeros(ss.C.T.shape) if gains is None else gains[0].K @ root
        white = np.linalg.solve(root, ss.C)
        return ErrorModel(ss.A, ss.G, white, gain, tuple(ss.noise_names), self.period)

    def by_noise(self, n_samples: int) -> np.ndarray:
        """Expected products of slopes that noise drives, and what the size of the innovations tells."""
        z = self.unknowns.start
        p = z.size
        sampled = self._sampled(z)
        if not p or (sampled[1] is None and self.has_noise):
            return np.zeros((p, p))
        key = ("noise", n_samples)
        if key not in self._kept:
            steps = self._steps(z)
            self._kept[key] = _noise_information(*sampled, n_samples) * np.outer(steps, steps)
        return np.array(self._kept[key])

    def pulled_back(self, weights: np.ndarray, n_samples: int) -> np.ndarray:
        """∂/∂inputs (n_samples, n_u) of the sum of weights (p, n_samples, n_y) times slopes: the weights
        correlated with what a pulse of each input does to the slopes."""
        n_u = len(self.family.inputs)
        found = np.zeros((n_samples, n_u))
        for i, pulse in enumerate(self._pulses(n_samples)):
            found[:, i] = _correlated(weights, pulse)
        return found

    def _pulses(self, n_samples: int) -> np.ndarray:
        """Slopes (n_u, p, n_samples, n_y) after a pulse of each input at sample PULSE, less those without."""
        key = ("pulses", n_samples)
        if key not in self._kept:
            z = self.unknowns.start
            rest = np.zeros((n_samples, len(self.family.inputs)))
            at = Point(z, np.zeros(self.explicit.n_states))
            without = self._own_slopes(rest, at)
            parts = []
            for i in range(rest.shape[1]):
                pulse = rest.copy()
                pulse[PULSE, i] = 1.0
                parts.append(self._own_slopes(pulse, at) - without)
            self._kept[key] = np.array(parts)
        return np.array(self._kept[key])

    def _own_slopes(self, inputs: np.ndarray, at: Point) -> np.ndarray:
        explained = self.explain(inputs, self.outputs(inputs, at), at)
        assert explained is not None
        return explained.slopes.reshape(explained.slopes.shape[0], inputs.shape[0], -1)

    def _steps(self, z: np.ndarray) -> np.ndarray:
        return self.unknowns.slopes(z)

    def _space(self, z: np.ndarray) -> StateSpace:
        theta, _, _ = self.unknowns.values(z)
        ss, rows = state_space(self.family, theta), self.chosen
        return replace(
            ss,
            output_names=tuple(ss.output_names[i] for i in rows),
            **{name: getattr(ss, name)[rows] for name in OUTPUT_FIELDS},
        )

    def _sampled(self, z: np.ndarray) -> tuple[Recursion, tuple[Gains, Gains | None] | None]:
        """The recursion at z, and the Kalman gains where the process has noise and a filter settles."""
        key = z.tobytes()
        if key not in self._kept:
            if len(self._kept) > 8:
                self._kept.clear()
            self._kept[key] = self._made(z)
        return self._kept[key]

    def _made(self, z: np.ndarray) -> tuple[Recursion, tuple[Gains, Gains | None] | None]:
        theta, intensity, std = self.unknowns.values(z)
        rows, every = self.chosen, matrix_slopes(self.problem, theta)
        chosen = {name: m[:, rows] if name in OUTPUT_FIELDS else m for name, m in every.items()}
        levels = noise_levels(self.problem, intensity, std)
        levels = replace(
            levels,
            measurement_cov=levels.measurement_cov[np.ix_(rows, rows)],
            measurement_slope=levels.measurement_slope[:, rows][:, :, rows],
        )
        record = self._record(np.zeros((3, len(self.family.inputs))), np.zeros((3, len(rows))))
        dyn = recursion(self._space(z), record, self.hold, levels, chosen)
        return dyn, kalman_gains(dyn, record) if self.has_noise else None

    def _stacked(self, inputs: np.ndarray) -> np.ndarray:
        time = self.period * np.arange(inputs.shape[0])
        return stacked_inputs(inputs, time, self.family.input_derivatives)

    def _record(self, inputs: np.ndarray, outputs: np.ndarray) -> Record:
        n = inputs.shape[0]
        seen = np.ones(outputs.shape, dtype=bool)
        time = self.period * np.arange(n)
        return Record("", time, self._stacked(inputs), outputs, seen, self.period, np.arange(n))

    @np.errstate(all="ignore")
    def _states(self, inputs: np.ndarray, at: Point) -> np.ndarray:
        dyn, _ = self._sampled(at.z)
        record = self._record(inputs, np.zeros((inputs.shape[0], len(self.chosen))))
        found = innovations(dyn, record, None)
        return found.states_at_zero + np.tensordot(at.x0, found.states_response, 1)


def _correlated(weights: np.ndarray, pulse: np.ndarray) -> np.ndarray:
    """Sum over (i, y) of Σ_t weights[i, t, y] pulse[i, t - k + PULSE, y], for every sample k."""
    from scipy.signal import fftconvolve  # half a second that no other command waits for

    n = weights.shape[1]
    turned = fftconvolve(weights, pulse[:, ::-1], axes=1).sum(axis=(0, 2))
    return turned[n - 1 - PULSE : 2 * n - 1 - PULSE]


def _covariance(dyn: Recursion, gains: tuple[Gains, Gains | None] | None) -> np.ndarray:
    return dyn.R if gains is None else gains[0].S


def _noise_information(
    dyn: Recursion, gains: tuple[Gains, Gains | None] | None, n_samples: int
) -> np.ndarray:
    """Information (p, p) of n samples without input, over the values of the unknowns.

    The innovations e drive the predicted state, x̂[k+1] = Φ x̂ + K e, and its slopes,
    s_i[k+1] = (Φ - K C) s_i + (∂Φ_i - K ∂C_i) x̂ + ∂K_i e; the expected products of C s_i + ∂C_i x̂ follow from
    the covariance of (x̂, s_1, ..., s_p).
    """
    slope = dyn.slope
    assert slope is not None
    p, n = slope.transition.shape[0], dyn.Phi.shape[0]
    S = _covariance(dyn, gains)
    inverse = np.linalg.inv(S)
    if gains is None:
        change = slope.measurement_cov
        return _of_size(change, inverse, n_samples)
    found = _of_size(gains[1].S, inverse, n_samples) if gains[1] is not None else np.zeros((p, p))
    if gains[1] is None or n * (1 + p) > LARGEST:
        return found
    K = gains[0].K
    F, G = np.zeros((n * (1 + p), n * (1 + p))), np.zeros((n * (1 + p), K.shape[1]))
    F[:n, :n], G[:n] = dyn.Phi, K
    looks = np.zeros((p, dyn.C.shape[0], n * (1 + p)))
    for i in range(p):
        own = slice(n * (1 + i), n * (2 + i))
        F[own, own] = dyn.Phi - K @ dyn.C
        F[own, :n] = slope.transition[i] - K @ slope.output[i]
        G[own] = gains[1].K[i]
        looks[i][:, own], looks[i][:, :n] = dyn.C, slope.output[i]
    drive = G @ S @ G.T
    covariance, total = np.zeros_like(F), np.zeros_like(F)
    for _ in range(n_samples):
        total += covariance
        covariance = F @ covariance @ F.T + drive
    return found + np.einsum("iab,bc,jdc,ad->ij", looks, total, looks, inverse)


def _of_size(change: np.ndarray, inverse: np.ndarray, n_samples: int) -> np.ndarray:
    """What n innovations tell by their size: n/2 tr(S⁻¹ ∂S_i S⁻¹ ∂S_j)."""
    turned = inverse @ change
    return 0.5 * n_samples * np.einsum("iab,jba->ij", turned, turned)
