"""The document and the table of a simulation."""

from __future__ import annotations

from typing import Annotated, NotRequired, TypedDict

import numpy as np

from daest.model.experiment import Simulation
from daest.model.holds import Hold
from daest.report.documents.parts import Of, entry


class SimulateDocument(TypedDict):
    """Trajectories of a model."""

    model: Annotated[str, Of("model_name")]
    method: str
    hold: Hold
    noise: Annotated[bool, Of("with_noise")]
    seed: int | None
    n_samples: int
    inputs: Annotated[list[str], Of("input_names")]
    outputs: Annotated[list[str], Of("output_names")]
    states: NotRequired[Annotated[list[str], Of("state_names")]]
    units: dict[str, str]
    time: list[float]
    trajectories: dict[str, list[float | None]]
    notes: NotRequired[list[str]]


def document(simulation: Simulation) -> SimulateDocument:
    """What `daest simulate --format json` prints: names, units, method, outputs and states by name.

    Trajectories are lists of numbers, null where a value is not finite."""
    names = (*simulation.input_names, *simulation.output_names, *simulation.state_names)
    return entry(SimulateDocument, simulation, trajectories={name: simulation[name] for name in names})


def table(
    simulation: Simulation, all_variables: bool = False, clock: str = "s"
) -> tuple[list[str], np.ndarray]:
    """Header `name [unit]` and rows (n_samples, n_columns): time in `clock`, inputs, outputs; on
    request every internal variable, and the noises of a noisy run. A name is listed once."""
    names = [*simulation.input_names, *simulation.output_names]
    if all_variables:
        names += [*simulation.variable_names, *simulation.state_names]
        names += simulation.noise_names if simulation.with_noise else ()
    names = list(dict.fromkeys(names))
    header = [f"time [{clock}]", *(_titled(name, simulation.units.get(name, "")) for name in names)]
    return header, np.column_stack([simulation.time, *(simulation[name] for name in names)])


def _titled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
