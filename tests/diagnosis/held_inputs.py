"""Machines whose inputs are held for a while each: simulated exactly, and asked for what they lack."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.model.diagnosis import Diagnosis
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library

PERIOD = 0.1  # of the samples, in the unit in which the model counts time


def held(rng: np.random.Generator, low: float, high: float, n_held: int, n_samples: int) -> np.ndarray:
    """Levels (n_samples,) between two limits, each for `n_held` samples."""
    return np.repeat(rng.uniform(low, high, n_samples), n_held)[:n_samples]


def followed(rate: Callable, start: Sequence[float], inputs: np.ndarray) -> np.ndarray:
    """States (n_samples, n) of `rate(x, u)` from `start`, with `inputs` (n_samples, n_u) held."""
    states = [np.array(start, float)]
    for u in inputs[:-1]:
        run = solve_ivp(lambda _, x, u=u: rate(x, u), (0.0, PERIOD), states[-1], rtol=1e-9, atol=1e-9)
        states.append(run.y[:, -1])
    return np.array(states)


def diagnosed(text: bytes, inputs: np.ndarray, outputs: np.ndarray, names: Sequence) -> Diagnosis:
    """The diagnosis from the first half of a record; the second one validates. The `names` are those of the
    inputs and of the outputs."""
    time, half = PERIOD * np.arange(len(inputs)), len(inputs) // 2
    parts = [
        Experiment(f"{k}", time[s], inputs[s], outputs[s], *names)
        for k, s in enumerate((slice(0, half), slice(half, None)))
    ]
    model = compile_text(text, Path("Machine.mo"))
    return diagnose(model, effect_library(), parts[:1], parts[1:], DiagnoseOptions(hold="zoh"))
