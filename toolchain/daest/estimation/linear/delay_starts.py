"""What a dead time may begin with: the past of a signal that no sample of the recording shows.

`delay(e, T)` is a chain of states, the first the level of e over the last T seconds, the others its shape
(`modelica.delays`). All of them free, they draw any curve into the first T seconds of a recording. Behind
inputs that keep one value the shape stays zero: they had a level before, too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from daest.model.experiment import Experiment
from daest.model.flat import Dynamics
from daest.modelica.flat.delays import N_POLYNOMIALS, is_memory_of_delay

_NUMBER = re.compile(r"\[(\d+)\]$")


def shapes_of_past(names: Sequence[str]) -> np.ndarray:
    """Which states (n,) are the shape of what a delay keeps; its level is none of them."""
    return np.array([is_memory_of_delay(name) and _number(name) > 1 for name in names], dtype=bool)


def steady_past(
    names: Sequence[str], by_state: np.ndarray, by_input: np.ndarray, inputs: np.ndarray
) -> np.ndarray:
    """The shapes (n,) of delays behind inputs (n_samples, n_u) alone that keep their values.

    `by_state` (n, n) and `by_input` (n, m), m >= n_u, are the structure of the rates of the states."""
    held = shapes_of_past(names)
    if not np.any(held):
        return held
    varies = np.zeros(by_input.shape[1], dtype=bool)
    varies[: inputs.shape[1]] = np.ptp(inputs, axis=0) > 0.0
    chains = np.array([name.rpartition("[")[0] if is_memory_of_delay(name) else "" for name in names])
    for chain in set(chains[held]):
        own = chains == chain
        follows = np.any(by_state[np.ix_(own, ~own)]) or np.any(by_input[own][:, varies])
        held[own] &= not follows
    return held


def long_past(names: Sequence[str], rates: Callable[[np.ndarray], np.ndarray], period: float) -> np.ndarray:
    """The shapes (n,) of delays that last more samples of `period` [s] than they have states; `rates` (n,) at
    a state (n,) are linear in those of delays. Fewer samples are as free as the numbers that were measured
    in them."""
    long = shapes_of_past(names)
    if not np.any(long):
        return long
    rest = rates(np.zeros(len(names)))
    for i, name in enumerate(names):
        if is_memory_of_delay(name) and _number(name) == 1:
            there = rates(np.eye(len(names))[i])
            lasts = -1.0 / (there[i] - rest[i])
            chain = name.rpartition("[")[0]
            own = np.array([other.rpartition("[")[0] == chain for other in names], dtype=bool)
            long[own] &= lasts > N_POLYNOMIALS * period
    return long


def long_past_of(explicit: Dynamics, theta: np.ndarray, experiment: Experiment) -> np.ndarray:
    """`long_past` (n,) of a model at parameters `theta` (n_theta,) on a recording."""
    rhs, t = explicit.rhs, float(experiment.time[0])
    still = [np.zeros(rhs.numel_in(i)) for i in (2, 3)]

    def rates(x: np.ndarray) -> np.ndarray:
        return rhs(x, experiment.inputs[0], *still, theta, t).full().ravel()

    return long_past(explicit.state_names, rates, experiment.median_step)


def _number(name: str) -> int:
    found = _NUMBER.search(name)
    return 0 if found is None else int(found.group(1))
