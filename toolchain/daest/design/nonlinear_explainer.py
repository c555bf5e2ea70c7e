"""Nonlinear models: simulated with exact sensitivities, or predicted by an observer with the stationary gain
of their average linearisation where the process has noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daest.design.explainer import Driven, ErrorModel, Explained, Point
from daest.errors import DaestError
from daest.estimation.nonlinear.observer import (
    AverageModel,
    Observer,
    average_model,
    observer,
    sampled_average,
)
from daest.systems.events.integration import Correction, IntegrationError, Trajectory
from daest.systems.simulation.integrate import Integrator, integrate, interval_inputs
from daest.systems.simulation.simulate import values_along

RTOL = 1e-5  # of the integration: far below the noise of a measurement


@dataclass(frozen=True, kw_only=True)
class NonlinearExplainer(Driven):
    """`unknowns` holds the parameters alone; `model` integrates."""

    model: Integrator

    def outputs(self, inputs: np.ndarray, at: Point) -> np.ndarray:
        found = self._run(inputs, at)
        if found is None:
            return np.full((inputs.shape[0], len(self.chosen)), np.nan)
        return found.outputs[:, self.chosen]

    def variables(self, inputs: np.ndarray, at: Point) -> np.ndarray:
        n_v = len(self.explicit.flat.unknowns)
        found = self._run(inputs, at)
        if found is None:
            return np.full((inputs.shape[0], n_v), np.nan)
        theta, _, _ = self.unknowns.values(at.z)
        time = self._time(inputs)
        return values_along(self.explicit, time, self._ubar(time, inputs), theta, found.states, self.hold)[1]

    @np.errstate(all="ignore")  # where numbers overflow, nothing is explained
    def explain(self, inputs: np.ndarray, outputs: np.ndarray, at: Point) -> Explained | None:
        rows = self.chosen
        every = np.full((inputs.shape[0], len(self.explicit.flat.outputs)), np.nan)
        every[:, rows] = outputs
        found = self._observer(inputs, at)
        run = self._run(inputs, at, every, found, slopes=True)
        if run is None or not np.all(np.isfinite(run.sensitivities)):
            return None
        _, _, std = self.unknowns.values(at.z)
        cov = np.diag(std[rows] ** 2) if found is None else found.innovation_cov
        white = np.linalg.inv(np.linalg.cholesky(cov)).T
        p = len(self.coordinates)
        errors = (outputs - run.outputs[:, rows]) @ white
        moves = -run.sensitivities[:, rows].transpose(2, 0, 1)
        moves[:p] *= self.unknowns.slopes(at.z)[:, None, None]
        moves = (moves @ white).reshape(moves.shape[0], -1)
        return Explained(errors.ravel(), moves[:p], moves[p:])

    def error_model(self, inputs: np.ndarray) -> ErrorModel | None:
        at = self.start(inputs)
        average, found = self._average(inputs, at), self._observer(inputs, at)
        if average is None or not np.all(np.isfinite(average.A)):
            return None
        _, intensity, std = self.unknowns.values(at.z)
        if found is None and np.any(intensity > 0.0):
            return None
        stds = std[self.chosen]
        root = np.diag(stds) if found is None else np.linalg.cholesky(found.innovation_cov)
        gain = np.zeros(average.C.T.shape)
        if found is not None:  # it corrects the state at the sample itself
            gain = sampled_average(average, intensity, stds).transition @ found.gain @ root
        noises = self.explicit.flat.noise_names
        return ErrorModel(average.A, average.G, np.linalg.solve(root, average.C), gain, noises, self.period)

    def by_noise(self, n_samples: int) -> np.ndarray:
        """The gain is held, and nothing is said of the motion that noise causes."""
        return np.zeros((len(self.coordinates),) * 2)

    def pulled_back(self, weights: np.ndarray, n_samples: int) -> None:
        """Not known: what a pulse does depends on the motion."""

    def _time(self, inputs: np.ndarray) -> np.ndarray:
        return self.period * np.arange(inputs.shape[0])

    def _ubar(self, time: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        ubar, _ = interval_inputs(self.explicit, time, inputs, self.hold)
        return np.vstack([ubar, np.hstack([inputs[-1:], ubar[-1:, inputs.shape[1] :]])])

    def _run(
        self,
        inputs: np.ndarray,
        at: Point,
        measured: np.ndarray | None = None,
        gained: Observer | None = None,
        *,
        slopes: bool = False,
    ) -> Trajectory | None:
        theta, _, _ = self.unknowns.values(at.z)
        correction = None
        if gained is not None and measured is not None:
            gain = np.zeros((at.x0.size, measured.shape[1]))
            gain[:, self.chosen] = gained.gain
            correction = Correction(measured, gain)
        try:
            return integrate(
                self.model,
                self._time(inputs),
                inputs,
                theta,
                at.x0,
                hold=self.hold,
                sensitivities=slopes,
                correction=correction,
                rtol=RTOL,
            )
        except (IntegrationError, DaestError):
            return None

    def _observer(self, inputs: np.ndarray, at: Point) -> Observer | None:
        """The observer along the first motion that was asked for; None for a process without noise."""
        _, intensity, std = self.unknowns.values(at.z)
        if not np.any(intensity > 0.0):
            return None
        if "observer" not in self._kept:
            average = self._average(inputs, at)
            if average is None:
                return None
            self._kept["observer"] = observer(average, intensity, std[self.chosen])
        return self._kept["observer"]

    def _average(self, inputs: np.ndarray, at: Point) -> AverageModel | None:
        """The linearisation along the first motion that was asked for."""
        if "average" not in self._kept:
            run = self._run(inputs, at)
            if run is None:
                return None
            theta, _, _ = self.unknowns.values(at.z)
            time = self._time(inputs)
            average = average_model(self.explicit, theta, time, run.states, self._ubar(time, inputs))
            self._kept["average"] = replace(average, C=average.C[self.chosen])
        return self._kept["average"]
