"""Initial states of recordings that a fit has not seen."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from daest.estimation.nonlinear import nonlinear_start as starting

RUN = np.concatenate([np.full((10, 1), -150.0), np.full((90, 1), 14.0)])  # states of a run that comes back


@dataclass(frozen=True)
class Problem:
    experiments: tuple[str, ...]
    state_scale: np.ndarray
    model: SimpleNamespace


def problem():
    explicit = SimpleNamespace(state_names=("ce",))
    return Problem(("run",), np.ones(1), SimpleNamespace(explicit=explicit))


def begun(monkeypatch, first, *, is_near=False):
    """Where the searches begin, and the best end, of a problem whose first end leaves errors of size `first`
    in the first tenth, and 1 later."""
    starts = []
    errors = np.concatenate([np.full((10, 1), first), np.ones((90, 1))])
    found = SimpleNamespace(errors=(errors,), trajectories=(SimpleNamespace(states=RUN),))

    def minimise(likelihood, z, lower, upper, iterations, gain):
        starts.append(float(z[0]))
        end = 14.5 if z[0] > 5.0 else -150.0
        value = SimpleNamespace(value=-593.0 if end > 0.0 else 1758.0)
        return SimpleNamespace(z=np.array([end]), reason="converged", evaluation=value)

    monkeypatch.setattr(starting, "_scale_by_outputs", lambda problem, z: np.ones(1))
    monkeypatch.setattr(starting, "objective", lambda problem: None)
    monkeypatch.setattr(starting, "prediction_errors", lambda problem, z: found)
    monkeypatch.setattr(starting, "fit_initial_states", lambda problem, z, low, high, gain: z)
    monkeypatch.setattr(starting, "minimise", minimise)
    bounds = np.full(1, -1e3), np.full(1, 1e3)
    _, end = starting.begun_best(problem(), np.zeros(1), *bounds, 10, is_near=is_near)
    return starts, float(end.z[0])


def test_a_start_that_the_first_samples_show_is_looked_for_amid_the_run(monkeypatch):
    """Behind a sensor that saturates: -150 mg/l in place of 14.5, with 7 times the noise."""
    assert begun(monkeypatch, 50.0) == ([0.0, 14.0], 14.5)


def test_a_start_that_leaves_what_the_rest_leaves_is_kept(monkeypatch):
    assert begun(monkeypatch, 2.0) == ([0.0], -150.0)
    assert begun(monkeypatch, 50.0, is_near=True) == ([0.0], -150.0), "it was fitted"
