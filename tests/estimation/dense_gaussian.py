"""Oracle: the joint Gaussian of a whole record, written out as one dense covariance and conditioned on the
outputs.

Every quantity is an affine function of the base vector (x[0], g[0], …, g[N-1]) with g[k] = (w̃[k], ẽ[k],
w̄[k]); nothing recursive is estimated here. An unknown x[0] is a regression coefficient with a flat prior
(generalised least squares).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daest.model.experiment import Experiment
from daest.model.linear import DiscreteModel


@dataclass(frozen=True)
class Posterior:
    mean: np.ndarray
    cov: np.ndarray


class DenseRecord:
    """All states, noises and outputs of a record as affine maps of one Gaussian base vector."""

    def __init__(self, models: list[DiscreteModel], experiment: Experiment, mean0, cov0=None) -> None:
        n, n_y = models[0].cross_cov.shape
        n_w = models[0].noise_cov.shape[0]
        N = experiment.n_samples
        width = n + n_y + n_w
        total = n + N * width
        self.n, self.flat = n, cov0 is None
        self.cov = np.zeros((total, total))
        if cov0 is not None:
            self.cov[:n, :n] = cov0
        state, offset = np.hstack([np.eye(n), np.zeros((n, total - n))]), np.array(mean0, dtype=float)
        self.states, self.state_offsets, self.noises = [], [], []
        rows, values = [], []
        for k in range(N):
            m = models[min(k, len(models) - 1)]
            at = n + k * width
            self.cov[at : at + width, at : at + width] = np.block([
                [m.process_cov, m.cross_cov, m.noise_process_cov.T],
                [m.cross_cov.T, m.measurement_cov, m.noise_measurement_cov.T],
                [m.noise_process_cov, m.noise_measurement_cov, m.noise_cov],
            ])  # fmt: skip
            pick = np.eye(total)[at : at + width]
            u = experiment.inputs
            self.states.append(state)
            self.state_offsets.append(offset)
            self.noises.append(pick[n + n_y :])
            output = m.output @ state + pick[n : n + n_y]
            known = m.output @ offset + m.feedthrough @ u[k] + m.output_offset
            for i in np.flatnonzero(~np.isnan(experiment.outputs[k])):
                rows.append((k, output[i]))
                values.append(experiment.outputs[k, i] - known[i])
            following = u[min(k + 1, N - 1)]
            state = m.transition @ state + pick[:n]
            offset = m.transition @ offset + m.input_now @ u[k] + m.input_next @ following + m.drift
        self.output_rows, self.residual = rows, np.array(values)

    def condition(self, target: np.ndarray, last: int) -> Posterior:
        """Posterior of target @ base given all outputs up to and including sample `last`."""
        keep = [i for i, (k, _) in enumerate(self.output_rows) if k <= last]
        if not keep:
            return Posterior(np.zeros(target.shape[0]), target @ self.cov @ target.T)
        Y = np.array([self.output_rows[i][1] for i in keep])
        y = self.residual[keep]
        gain = np.linalg.solve(Y @ self.cov @ Y.T, Y @ self.cov @ target.T).T
        mean, cov = gain @ y, target @ self.cov @ target.T - gain @ Y @ self.cov @ target.T
        if not self.flat:
            return Posterior(mean, cov)
        start, start_cov = self._start(Y, y)
        load = target[:, : self.n] - gain @ Y[:, : self.n]
        return Posterior(mean + load @ start, cov + load @ start_cov @ load.T)

    def log_likelihood(self) -> float:
        Y = np.array([row for _, row in self.output_rows])
        S = Y @ self.cov @ Y.T
        y = self.residual
        value = -0.5 * (y @ np.linalg.solve(S, y) + np.linalg.slogdet(2 * np.pi * S)[1])
        if not self.flat:
            return float(value)
        start, start_cov = self._start(Y, y)
        gained = 0.5 * start @ np.linalg.solve(start_cov, start)
        return float(value + gained + 0.5 * np.linalg.slogdet(2 * np.pi * start_cov)[1])

    def _start(self, Y: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Generalised least squares for x[0] - mean0."""
        O = Y[:, : self.n]
        weighted = np.linalg.solve(Y @ self.cov @ Y.T, np.column_stack([O, y]))
        cov = np.linalg.inv(O.T @ weighted[:, : self.n])
        return cov @ (O.T @ weighted[:, -1]), cov


def random_model(
    rng: np.random.Generator, n: int, n_y: int, n_w: int, n_u: int, period: float = 0.1
) -> DiscreteModel:
    """Correlated noises from a common factor; fewer noises than states makes the process covariance
    singular."""
    Phi = rng.normal(size=(n, n))
    Phi *= rng.uniform(0.6, 1.02) / np.max(np.abs(np.linalg.eigvals(Phi)))
    W = rng.normal(size=(n_w, n_w))
    noise_cov = W @ W.T + 0.1 * np.eye(n_w)
    G, H = rng.normal(size=(n, n_w)), rng.normal(size=(n_y, n_w))
    return DiscreteModel(
        transition=Phi,
        input_now=rng.normal(size=(n, n_u)),
        input_next=rng.normal(size=(n, n_u)),
        drift=rng.normal(size=n),
        output=rng.normal(size=(n_y, n)),
        feedthrough=rng.normal(size=(n_y, n_u)),
        output_offset=rng.normal(size=n_y),
        process_cov=G @ noise_cov @ G.T,
        measurement_cov=H @ noise_cov @ H.T + np.diag(rng.uniform(0.1, 2.0, n_y)),
        cross_cov=G @ noise_cov @ H.T,
        noise_cov=noise_cov,
        noise_process_cov=noise_cov @ G.T,
        noise_measurement_cov=noise_cov @ H.T,
        period=period,
        hold="foh",
    )


def simulate_record(
    rng: np.random.Generator,
    models: list[DiscreteModel],
    n_samples: int,
    x0: np.ndarray,
    missing: float = 0.0,
    time: np.ndarray | None = None,
) -> tuple[Experiment, np.ndarray]:
    """A record drawn from the models and its true states; a share `missing` of the outputs is NaN."""
    n, n_y = models[0].cross_cov.shape
    n_u = models[0].input_now.shape[1]
    u = rng.normal(size=(n_samples, n_u))
    outputs, states, x = np.empty((n_samples, n_y)), np.empty((n_samples, n)), x0
    for k in range(n_samples):
        m = models[min(k, len(models) - 1)]
        joint = np.block([[m.process_cov, m.cross_cov], [m.cross_cov.T, m.measurement_cov]])
        values, vectors = np.linalg.eigh(joint)
        g = vectors @ (np.sqrt(np.maximum(values, 0)) * rng.normal(size=n + n_y))
        states[k] = x
        outputs[k] = m.output @ x + m.feedthrough @ u[k] + m.output_offset + g[n:]
        following = u[min(k + 1, n_samples - 1)]
        x = m.transition @ x + m.input_now @ u[k] + m.input_next @ following + m.drift + g[:n]
    outputs[rng.uniform(size=outputs.shape) < missing] = np.nan
    if time is None:
        time = np.arange(n_samples) * models[0].period
    names = tuple(f"u{i}" for i in range(n_u)), tuple(f"y{i}" for i in range(n_y))
    return Experiment("random", time, u, outputs, *names), states
