"""The part of the state that no output sees, such as the absolute angle of a machine that measures speeds.

A hidden mode that does not die out has no stationary covariance, yet it reaches no prediction. With the
projection Π on the unobservable subspace, Φ (I - Π) forgets that part at every step: the innovations and
their covariances stay what they are, gains change along hidden directions only, and every covariance settles.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg

from daest.numerics.balancing import balanced
from daest.numerics.innovations import NoiseModel
from daest.numerics.riccati import undamped_modes, unobservable_subspace

UNDAMPED_MARGIN = 1e-9  # a mode with |λ| > 1 - this does not die out within a record


def hidden_basis(Phi: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Unobservable subspace (n, r) of (C, Φ), empty (n, 0) unless it holds a mode that does not die out, and
    where no output sees anything at all."""
    if not np.all(np.isfinite(Phi)) or not np.any(C):
        return np.zeros((Phi.shape[0], 0))
    if np.max(np.abs(np.linalg.eigvals(Phi)), initial=0.0) <= 1.0 - UNDAMPED_MARGIN:
        return np.zeros((Phi.shape[0], 0))
    _, hidden = unobservable_subspace(Phi, C)
    return hidden if undamped_modes(Phi, hidden, UNDAMPED_MARGIN)[0].size else hidden[:, :0]


def forgetting(Phi: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Φ (I - Π) for a transition Φ (n, n): the same predictions without the undamped hidden modes."""
    basis = hidden_basis(Phi, C)
    return Phi - Phi @ _Projection(Phi, basis).whole if basis.shape[1] else Phi


def forgetting_model(noise: NoiseModel, change: NoiseModel | None) -> tuple[NoiseModel, NoiseModel | None]:
    """`noise` with Φ (I - Π) in place of Φ, and its derivatives in p directions.

    Φ (…, n, n) may have an axis of steps: all are functions of one matrix of rates and hide the same
    directions. Where these turn with a parameter, so does Π.
    """
    first = noise.Phi.reshape(-1, *noise.Phi.shape[-2:])[0]
    basis = hidden_basis(first, noise.C)
    if not basis.shape[1]:
        return noise, change
    onto = _Projection(first, basis)
    still = replace(noise, Phi=noise.Phi - noise.Phi @ onto.whole)
    if change is None:
        return still, None
    directions = change.Phi.reshape(change.Phi.shape[0], -1, *change.Phi.shape[-2:])[:, 0]
    turned = onto.turning(first, noise.C, directions, change.C)
    turned = turned.reshape(turned.shape[0], *(1,) * (noise.Phi.ndim - 2), *turned.shape[1:])
    return still, replace(change, Phi=change.Phi - change.Phi @ onto.whole - noise.Phi @ turned)


class _Projection:
    """Π = N L on the columns of N (n, r), L N = I; orthogonal in the units that balance Φ."""

    def __init__(self, Phi: np.ndarray, basis: np.ndarray) -> None:
        self._size = balanced(Phi - np.eye(Phi.shape[0]))[1]
        self._columns = np.linalg.qr(basis / self._size[:, None])[0]
        self._back = self._columns.T / self._size
        self.whole = self._size[:, None] * self._columns @ self._back

    def turning(self, Phi: np.ndarray, C: np.ndarray, dPhi: np.ndarray, dC: np.ndarray) -> np.ndarray:
        """dΠ (p, n, n) = dN L. C N = 0 and Φ N = N Λ hold for every θ, so that C dN = -dC N and, outside of
        N, Φ dN - dN Λ = -dΦ N."""
        size, inside = self._size, self._columns
        outside = scipy.linalg.null_space(inside.T)
        (m, r), rate = (outside.shape[1], inside.shape[1]), Phi * size / size[:, None]
        sylvester = np.kron(np.eye(r), outside.T @ rate @ outside)
        sylvester -= np.kron((inside.T @ rate @ inside).T, np.eye(m))
        system = np.vstack([sylvester, np.kron(np.eye(r), C * size @ outside)])
        drift = outside.T @ (dPhi * size / size[:, None]) @ inside
        wanted = np.concatenate([_stacked(drift), _stacked(dC * size @ inside)], axis=1)
        found = np.linalg.lstsq(system, -wanted.T, rcond=None)[0].T.reshape(-1, r, m)
        return size[:, None] * (outside @ found.transpose(0, 2, 1)) @ self._back


def _stacked(matrices: np.ndarray) -> np.ndarray:
    """The columns of each of p matrices one below the other, (p, m r)."""
    return matrices.transpose(0, 2, 1).reshape(matrices.shape[0], -1)
