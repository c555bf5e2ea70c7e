"""Whether errors that last follow what drives the model."""

from __future__ import annotations

import numpy as np

from daest.diagnosis.evidence.driven_errors import are_driven
from daest.model.experiment import Experiment

N = 2000


def _recording(inputs: np.ndarray, simulated: np.ndarray, errors: np.ndarray) -> Experiment:
    time = 0.1 * np.arange(N)
    return Experiment("one", time, inputs[:, None], (simulated + errors)[:, None], ("u",), ("y",))


def _first_order(driving: np.ndarray, memory: float) -> np.ndarray:
    """x[k+1] = memory x[k] + (1 - memory) driving[k]."""
    x = np.zeros(N)
    for k in range(N - 1):
        x[k + 1] = memory * x[k] + (1.0 - memory) * driving[k]
    return x


def _judged(inputs: np.ndarray, simulated: np.ndarray, errors: np.ndarray) -> bool | None:
    return are_driven([_recording(inputs, simulated, errors)], [errors[:, None]])


def test_slow_noise_follows_nothing() -> None:
    judged = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        u = rng.normal(size=N)
        slow = _first_order(rng.normal(size=N), 0.98) + 0.01 * rng.normal(size=N)
        judged.append(_judged(u, _first_order(u, 0.9), slow))
    assert judged == [False] * 10


def test_a_missing_lag_is_driven() -> None:
    rng = np.random.default_rng(1)
    u = rng.normal(size=N)
    simulated = _first_order(u, 0.9)
    lagged = _first_order(simulated, 0.7)
    assert _judged(u, simulated, lagged - simulated + 0.02 * rng.normal(size=N)) is True


def test_what_goes_with_the_square_of_an_output_is_driven() -> None:
    rng = np.random.default_rng(2)
    u = rng.normal(size=N)
    simulated = _first_order(u, 0.95)
    slow = _first_order(simulated**2 - np.mean(simulated**2), 0.9)
    assert _judged(u, simulated, slow + 0.001 * rng.normal(size=N)) is True


def test_without_a_moving_input_nothing_is_told() -> None:
    rng = np.random.default_rng(3)
    still = np.full(N, 2.0)
    assert _judged(still, np.exp(-0.01 * np.arange(N)), 0.1 * rng.normal(size=N)) is None


def test_an_error_that_is_not_known_tells_nothing() -> None:
    rng = np.random.default_rng(4)
    u, errors = rng.normal(size=N), rng.normal(size=N)
    recording = _recording(u, _first_order(u, 0.9), errors)
    unknown = np.where(np.arange(N) == 7, np.nan, errors)
    assert are_driven([recording], [unknown[:, None]]) is None
