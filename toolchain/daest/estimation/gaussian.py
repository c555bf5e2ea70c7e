"""Maximum likelihood of predictions with Gaussian errors: one objective, whatever the predictor is."""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np

from daest.estimation.coordinates import Unknowns, with_priors
from daest.estimation.search import Evaluation, Objective


class Prediction(Protocol):
    """Predictions of all recordings at one point of a search."""

    @property
    def negative_log_likelihood(self) -> float: ...


Found = TypeVar("Found", bound=Prediction)


class Predictor(Protocol[Found]):
    """A model and recordings, and how the one predicts the other. A search vector z begins with the
    coordinates of `unknowns`; initial states that are not eliminated follow."""

    @property
    def unknowns(self) -> Unknowns: ...

    def predict(self, z: np.ndarray, with_slopes: bool = False) -> Found | None:
        """Predictions at z; None where there are none, as where numbers overflow."""

    def derivatives(self, found: Found, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (p,) and Fisher information (p, p) of the negative log-likelihood along z, of predictions
        with slopes."""

    def tied(self, likelihood: Objective) -> Objective:
        """The objective with what ties initial states (`estimation.ties`); itself where they are free."""


def objective(predictor: Predictor[Found]) -> Objective:
    """Negative log-likelihood, priors and ties over the search vector, with gradient and information; None
    where there is no finite value."""

    @np.errstate(all="ignore")  # where numbers overflow, there is no value
    def evaluate(z: np.ndarray, with_slopes: bool) -> Evaluation | None:
        found = predictor.predict(z, with_slopes)
        if found is None or not np.isfinite(found.negative_log_likelihood):
            return None
        if not with_slopes:
            return Evaluation(found.negative_log_likelihood)
        gradient, information = predictor.derivatives(found, z)
        if not (np.all(np.isfinite(gradient)) and np.all(np.isfinite(information))):
            return None
        return Evaluation(found.negative_log_likelihood, gradient, information)

    return with_priors(predictor.tied(evaluate), predictor.unknowns)
