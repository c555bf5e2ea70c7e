"""What drives a simulation of an FMU: said by `fmu.runner`, heard by `fmu.worker`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daest.fmu.laws import Law
from daest.systems.tolerances import SOLVER


@dataclass(frozen=True)
class Drive:
    """What drives a simulation.

    time (n,); `inputs` are value references; u0 and u1 (n - 1, n_u) hold their values at both ends of every
    interval, u_last (n_u,) at the last sample; columns behind those of the inputs are read by laws alone.
    `read` are the value references to record. `laws` add to the inputs what depends on variables of the FMU
    or on the columns. measurements (n, n_y) of the first n_y of `read` and gain
    (n_states, n_y) correct the states at every sample (None: no correction).
    """

    time: np.ndarray
    inputs: tuple[int, ...]
    u0: np.ndarray
    u1: np.ndarray
    u_last: np.ndarray
    read: tuple[int, ...]
    laws: tuple[Law, ...] = ()
    measurements: np.ndarray | None = None
    gain: np.ndarray | None = None
    rtol: float = SOLVER.simulation_rtol

    def first_inputs(self) -> np.ndarray:
        """Values of the inputs at the first sample."""
        return (self.u0[0] if len(self.u0) else self.u_last)[: len(self.inputs)]

    @property
    def is_held(self) -> bool:
        """Inputs are constant between samples."""
        return bool(np.array_equal(self.u0, self.u1))
