"""What an experiment is designed for: parameters that are to be known better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from daest.design.explainer import Explainer, information, information_gradient, total_information
from daest.estimation.fitting.identifiability import covariance, std_errors, weak_directions
from daest.model.design import AimName, Criterion, Expected
from daest.model.fit import WeakDirection

FLAT = 1e-11  # eigenvalue of the information, scaled to a unit diagonal, that counts as none
VALUE_OF: dict[Criterion, str] = {
    "D": "geometric mean of the standard errors, relative to the values (joint ellipsoid)",
    "A": "root mean square of the standard errors, relative to the values",
    "worst": "largest standard error of any combination, relative to the values",
}


class Aim(Protocol):
    """An aim turns an input into a number: `merit` is searched for its largest value, and is on a logarithmic
    scale; `value` is what is told of it."""

    @property
    def name(self) -> AimName: ...

    @property
    def value_of(self) -> str: ...

    @property
    def higher_is_better(self) -> bool: ...

    @property
    def driven(self) -> tuple[Explainer, ...]:
        """The models that the input drives."""

    def merit(self, inputs: np.ndarray) -> float:
        """-inf where a model cannot be simulated. Shapes: inputs (n_samples, n_u)."""

    def gradient(self, inputs: np.ndarray) -> np.ndarray | None:
        """∂merit/∂inputs (n_samples, n_u); None where it is not known."""

    def value(self, merit: float) -> float: ...

    def expected(self, recordings: Sequence[np.ndarray]) -> Expected | None:
        """What is expected of recordings with these inputs; None where a model cannot be simulated. Shapes:
        recordings (n_samples, n_u) each."""

    def focused(self, inputs: np.ndarray) -> Aim:
        """What decides the merit near an input, where that is less work than the whole. Shapes: inputs
        (n_samples, n_u)."""

    def watching(self, driven: Sequence[Explainer]) -> Aim:
        """The same aim with other measurements of the same models."""


@dataclass(frozen=True)
class ParameterAim:
    """The parameters at `interest` among the coordinates of `explainer` are to be known better. `known` (p,
    p) is the information that there is already."""

    explainer: Explainer
    interest: tuple[int, ...]
    criterion: Criterion
    known: np.ndarray

    name: AimName = "parameters"
    higher_is_better: bool = False

    @property
    def value_of(self) -> str:
        return VALUE_OF[self.criterion]

    @property
    def driven(self) -> tuple[Explainer, ...]:
        return (self.explainer,)

    def merit(self, inputs: np.ndarray) -> float:
        found = information(self.explainer, inputs)
        return -np.inf if found is None else self._merit(found + self.known)

    def gradient(self, inputs: np.ndarray) -> np.ndarray | None:
        found = information(self.explainer, inputs)
        return None if found is None else information_gradient(self.explainer, inputs, self.weights(found))

    def weights(self, found: np.ndarray) -> np.ndarray:
        """∂merit/∂information (p, p), symmetric, at the information of one recording."""
        whole = _inverse(found + self.known)
        chosen = list(self.interest)
        rows = whole[:, chosen]
        return rows @ self._outer(whole[np.ix_(chosen, chosen)]) @ rows.T

    def value(self, merit: float) -> float:
        return float(np.exp(-merit))

    def expected(self, recordings: Sequence[np.ndarray]) -> Expected | None:
        found = total_information(self.explainer, recordings)
        if found is None:
            return None
        cov, values = self.natural(found)
        names = [c.name for c in self.explainer.coordinates]
        errors = dict(zip(names, std_errors(cov, values), strict=True))
        kept = {c.name: errors[c.name] for c in self.explainer.coordinates if c.kind == "parameter"}
        return Expected(self.value(self._merit(found)), kept)

    def natural(self, found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Covariance (p, p) in the units of the parameters, NaN where they are not determined, and their
        values."""
        values = np.array([c.initial for c in self.explainer.coordinates])
        slopes = np.array([c.slope(c.initial) for c in self.explainer.coordinates])
        free = np.diagonal(found) > 0.0
        return covariance(found, free) * np.outer(slopes, slopes), values

    def open_directions(self, recordings: Sequence[np.ndarray]) -> tuple[WeakDirection, ...]:
        """Combinations of parameters that these recordings leave open. Shapes: recordings (n_samples, n_u)
        each."""
        found = total_information(self.explainer, recordings)
        if found is None:
            return ()
        chosen = [i for i, c in enumerate(self.explainer.coordinates) if c.kind == "parameter"]
        cov, values = self.natural(found)
        part = np.ix_(chosen, chosen)
        slopes = np.array([c.slope(c.initial) for c in self.explainer.coordinates])
        scaled = found / np.outer(slopes, slopes)
        coordinates = tuple(self.explainer.coordinates[i] for i in chosen)
        return weak_directions(coordinates, values[chosen], scaled[part], cov[part])

    def focused(self, inputs: np.ndarray) -> ParameterAim:
        return self

    def watching(self, driven: Sequence[Explainer]) -> ParameterAim:
        p = len(driven[0].coordinates)  # noises come last, and may be taken as given
        return replace(self, explainer=driven[0], known=self.known[:p, :p])

    def _merit(self, found: np.ndarray) -> float:
        cov = _inverse(found)[np.ix_(self.interest, self.interest)]
        if self.criterion == "D":
            return -0.5 * float(np.linalg.slogdet(cov)[1]) / len(self.interest)
        if self.criterion == "A":
            return -0.5 * float(np.log(np.mean(np.diagonal(cov))))
        return -0.5 * float(np.log(np.linalg.eigvalsh(cov)[-1]))

    def _outer(self, cov: np.ndarray) -> np.ndarray:
        """-∂merit/∂cov (k, k)."""
        if self.criterion == "D":
            return 0.5 * np.linalg.inv(cov) / len(self.interest)
        if self.criterion == "A":
            return 0.5 * np.eye(cov.shape[0]) / float(np.trace(cov))
        values, vectors = np.linalg.eigh(cov)
        return 0.5 * np.outer(vectors[:, -1], vectors[:, -1]) / float(values[-1])


def _inverse(found: np.ndarray) -> np.ndarray:
    """The inverse; directions without information count as known FLAT times as well as single parameters, so
    that an input that tells nothing of them can be compared with others."""
    scale = np.sqrt(np.maximum(np.diagonal(found), 1e-300))
    values, vectors = np.linalg.eigh(found / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, FLAT)) @ vectors.T
    return inverse / np.outer(scale, scale)
