"""The document and the table of a simulation."""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict

import numpy as np

from daest.model.simulation import Simulation


class SimulateDocument(TypedDict):
    """Trajectories of a model."""

    model: str
    method: str
    hold: Literal["zoh", "foh"]
    noise: bool
    seed: int | None
    n_samples: int
    inputs: list[str]
    outputs: list[str]
    states: NotRequired[list[str]]
    units: dict[str, str]
    time: list[float]
    trajectories: dict[str, list[float | None]]
    notes: NotRequired[list[str]]


def document(simulation: Simulation) -> SimulateDocument:
    """What `daest simulate --format json` prints: names, units, method, outputs and states by name.

    Trajectories are lists of numbers, null where a value is not finite."""
    return {
        "model": simulation.model_name,
        "method": simulation.method,
        "hold": simulation.hold,
        "noise": simulation.with_noise,
        "seed": simulation.seed,
        "n_samples": simulation.n_samples,
        "inputs": list(simulation.input_names),
        "outputs": list(simulation.output_names),
        "states": list(simulation.state_names),
        "units": dict(simulation.units),
        "time": simulation.time.tolist(),
        "trajectories": _trajectories(simulation),
    }


def table(simulation: Simulation, all_variables: bool = False) -> tuple[list[str], np.ndarray]:
    """Header `name [unit]` and rows (n_samples, n_columns): time, inputs, outputs; on request every internal
    variable, and the noises of a noisy run. A name is listed once."""
    names = [*simulation.input_names, *simulation.output_names]
    if all_variables:
        names += [*simulation.variable_names, *simulation.state_names]
        names += simulation.noise_names if simulation.with_noise else ()
    names = list(dict.fromkeys(names))
    header = ["time [s]", *(_titled(name, simulation.units.get(name, "")) for name in names)]
    return header, np.column_stack([simulation.time, *(simulation[name] for name in names)])


def _titled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _trajectories(simulation: Simulation) -> dict[str, list[float | None]]:
    names = (*simulation.input_names, *simulation.output_names, *simulation.state_names)
    return {name: _numbers(simulation[name]) for name in dict.fromkeys(names)}


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]
