"""What one model says about a recording that another one made: whitened one-step errors and their slopes.

A recording without noise of the model itself has no errors, and the slopes give its Fisher information; one
of a rival leaves the errors by which the two could be told apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from daest.estimation.fitting.coordinates import Coordinate, Unknowns
from daest.estimation.fitting.identifiability import covariance
from daest.model.flat import Dynamics
from daest.model.holds import Hold
from daest.systems.reduction.initialize import initial_point

RANK = 1e-10  # singular value of the scaled responses of initial states, relative, below which it is none
STEPS = 3  # Gauss-Newton steps of a refit that is not merely estimated
WIDEST = 0.5  # standard deviation of a logarithm that a parameter is drawn with where nothing tells it
DAMPED = 2.0  # largest change of a search coordinate (a factor e² of a logarithmic one) in a step


@dataclass(frozen=True)
class Explained:
    """Whitened errors (m,) of a recording, their slopes (p, m) along the search coordinates and (k, m) along
    the initial state."""

    errors: np.ndarray
    slopes: np.ndarray
    initial: np.ndarray

    def without_start(self) -> tuple[np.ndarray, np.ndarray]:
        """Errors (m,) and slopes (p, m) less what an initial state would explain."""
        scale = np.linalg.norm(self.initial, axis=1)
        used = self.initial[scale > 0.0] / scale[scale > 0.0, None]
        if not used.shape[0]:
            return self.errors, self.slopes
        _, values, rows = np.linalg.svd(used, full_matrices=False)
        rows = rows[values > RANK * values[0]]
        return self.errors - rows.T @ (rows @ self.errors), self.slopes - (self.slopes @ rows.T) @ rows


@dataclass(frozen=True)
class ErrorModel:
    """How noises w (n_w,), called `noises`, reach the whitened errors ε of an explainer: dx/dt = A x + G w
    between the samples, ε = C x + e with cov(e) = 1, and x loses gain ε at every sample of the `period`
    (s)."""

    A: np.ndarray
    G: np.ndarray
    C: np.ndarray
    gain: np.ndarray
    noises: tuple[str, ...]
    period: float


@dataclass(frozen=True)
class Point:
    """Search coordinates z (p,) and the initial state (n_states,)."""

    z: np.ndarray
    x0: np.ndarray


class Explainer(Protocol):
    """A model ready to be driven. `coordinates` are its unknown parameters, `output_names` what is
    measured."""

    @property
    def explicit(self) -> Dynamics: ...

    @property
    def coordinates(self) -> tuple[Coordinate, ...]: ...

    @property
    def output_names(self) -> tuple[str, ...]: ...

    @property
    def variable_names(self) -> tuple[str, ...]: ...

    def start(self, inputs: np.ndarray, z: np.ndarray | None = None) -> Point:
        """The parameters of the fit (or z), and the initial state that the model asks for. Shapes: inputs
        (n_samples, n_u), z (p,)."""

    def outputs(self, inputs: np.ndarray, at: Point) -> np.ndarray:
        """Outputs (n_samples, n_y) without noise; NaN where the model cannot be simulated."""

    def variables(self, inputs: np.ndarray, at: Point) -> np.ndarray:
        """All internal variables (n_samples, n_v) without noise."""

    def explain(self, inputs: np.ndarray, outputs: np.ndarray, at: Point) -> Explained | None:
        """What is left of `outputs` (n_samples, n_y) at a point; None where the model cannot be
        simulated."""

    def by_noise(self, n_samples: int) -> np.ndarray:
        """Information (p, p) that the noise of the process itself gives, whatever the input."""

    def error_model(self, inputs: np.ndarray) -> ErrorModel | None:
        """How noises of the process reach the errors; None where the model cannot be simulated. Shapes:
        inputs (n_samples, n_u)."""

    def pulled_back(self, weights: np.ndarray, n_samples: int) -> np.ndarray | None:
        """∂/∂inputs (n_samples, n_u) of the sum of weights (p, n_samples, n_y) times slopes; None where the
        slopes are no linear function of the inputs."""


@dataclass(frozen=True)
class Driven:
    """What explainers have in common: `unknowns` in coordinates of the search, inputs of a `period` (s) and
    `hold`; `rows` are the outputs that are measured (None: all)."""

    explicit: Dynamics
    unknowns: Unknowns
    period: float
    hold: Hold
    rows: tuple[int, ...] | None = None
    _kept: dict = field(default_factory=dict, repr=False, compare=False, kw_only=True)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return self.unknowns.coordinates

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(self.explicit.flat.outputs[i].name for i in self.chosen)

    @property
    def variable_names(self) -> tuple[str, ...]:
        return self.explicit.flat.unknown_names

    @property
    def chosen(self) -> list[int]:
        n_y = len(self.explicit.flat.outputs)
        return list(range(n_y)) if self.rows is None else list(self.rows)

    def start(self, inputs: np.ndarray, z: np.ndarray | None = None) -> Point:
        at = self.unknowns.start if z is None else z
        theta, _, _ = self.unknowns.values(at)
        return Point(at, initial_point(self.explicit, theta, inputs[0])[0])


def information(explainer: Explainer, inputs: np.ndarray) -> np.ndarray | None:
    """Fisher information (p, p) of a recording with these inputs, over the search coordinates; the initial
    state is unknown. None where the model cannot be simulated."""
    at = explainer.start(inputs)
    made = explainer.outputs(inputs, at)
    explained = explainer.explain(inputs, made, at) if np.all(np.isfinite(made)) else None
    if explained is None:
        return None
    _, slopes = explained.without_start()
    found = slopes @ slopes.T
    return found + explainer.by_noise(inputs.shape[0]) if np.all(np.isfinite(found)) else None


def total_information(explainer: Explainer, recordings: Sequence[np.ndarray]) -> np.ndarray | None:
    """Fisher information (p, p) of all recordings with these inputs; None without any, and where the model
    cannot be simulated."""
    total: np.ndarray | None = None
    for inputs in recordings:
        found = information(explainer, inputs)
        if found is None:
            return None
        total = found if total is None else total + found
    return total


def information_gradient(explainer: Explainer, inputs: np.ndarray, weights: np.ndarray) -> np.ndarray | None:
    """∂/∂inputs (n_samples, n_u) of the sum of weights (p, p) times information; None where it is not
    known."""
    at = explainer.start(inputs)
    explained = explainer.explain(inputs, explainer.outputs(inputs, at), at)
    if explained is None:
        return None
    _, slopes = explained.without_start()
    n = inputs.shape[0]
    return explainer.pulled_back((2.0 * weights @ slopes).reshape(slopes.shape[0], n, -1), n)


def likely(explainer: Explainer, recorded: Sequence[np.ndarray], seed: int, draws: int) -> list[np.ndarray]:
    """Search coordinates (p,) that are as likely as the recordings with these inputs let them be; sizes of
    noises stay as they are. Empty without recordings."""
    found = total_information(explainer, recorded)
    if found is None or not explainer.coordinates:
        return []
    cov = np.nan_to_num(covariance(found, np.diagonal(found) > 0.0))
    is_noise = [c.kind != "parameter" for c in explainer.coordinates]
    cov[is_noise] = cov[:, is_noise] = 0.0
    values, vectors = np.linalg.eigh(cov)
    root = vectors * np.sqrt(np.clip(values, 0.0, WIDEST**2))
    home, lower, upper = (
        np.array([c.searched(value) for c, value in zip(explainer.coordinates, every, strict=True)])
        for every in zip(*((c.initial, c.lower, c.upper) for c in explainer.coordinates), strict=True)
    )
    rng = np.random.default_rng(seed)
    return [np.clip(home + root @ rng.standard_normal(home.size), lower, upper) for _ in range(draws)]


def distance(
    explainer: Explainer, inputs: np.ndarray, outputs: np.ndarray, known: np.ndarray, steps: int = 0
) -> float:
    """Half the squared whitened errors that the best refit leaves of `outputs`: the log-likelihood that the
    model is expected to lose to the one that made them (T-optimality; Atkinson and Fedorov 1975).

    The refit is the Gauss-Newton projection; `steps` more of them run the model at the parameters found.
    `known` (p, p): what other recordings tell about the parameters, as information. -inf where the model
    cannot be simulated.
    """
    at = explainer.start(inputs)
    if not np.all(np.isfinite(outputs)):
        return -np.inf
    best = np.inf
    home = at.z
    for _ in range(steps + 1):
        explained = explainer.explain(inputs, outputs, at)
        if explained is None:
            break
        delta, left = _projected(explained, known, at.z - home)
        if not np.isfinite(left):
            break
        best = min(best, left)
        at = _moved(at, delta)
    return best if np.isfinite(best) else -np.inf


def _projected(explained: Explained, known: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, float]:
    """The Gauss-Newton step in (z, x0), and half the squares that are left after it. `moved` is how far z is
    from where `known` holds."""
    p = explained.slopes.shape[0]
    root = _root(known)
    rows = np.vstack([explained.slopes, explained.initial])
    jacobian = np.vstack([rows.T, np.hstack([root, np.zeros((root.shape[0], rows.shape[0] - p))])])
    errors = np.concatenate([explained.errors, root @ moved])
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    delta = -np.linalg.lstsq(jacobian / scale, errors, rcond=RANK)[0] / scale
    left = errors + jacobian @ delta
    return delta, 0.5 * float(left @ left)


def _root(known: np.ndarray) -> np.ndarray:
    """R with RᵀR = known."""
    values, vectors = np.linalg.eigh(known)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def _moved(at: Point, delta: np.ndarray) -> Point:
    p = at.z.size
    largest = float(np.max(np.abs(delta[:p]), initial=0.0))
    share = min(1.0, DAMPED / largest) if largest > 0.0 else 1.0
    return Point(at.z + share * delta[:p], at.x0 + share * delta[p:])
