"""Simulation with sensitivities by `radau.c` on the binary of an FMU that has no events.

The integrator and what it asks of the FMU are compiled together (`foreign.c`), so that no evaluation passes
through Python. `engine_library` compiles; the rest is foreign code that only `fmu.worker` runs.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daest.fmu.drive import Drive
from daest.fmu.instance import CALLS, Instance
from daest.numerics.compiler import build_shared, effort, if_compiler, pointer, text_of

# The caller hears this often how far the solution has come.
TOLD_SECONDS = 0.2
_LONG = ctypes.c_long


@functools.lru_cache(maxsize=64)
def engine_library(
    fmi: int, n_x: int, n_u: int, n_p: int, n_y: int, n_columns: int | None = None, n_laws: int = 0
) -> Path | None:
    """The compiled integrator for FMUs of FMI 2 or 3 with n_x states, n_u inputs, n_y outputs, and n_p chosen
    parameters or sizes of the n_laws laws, which read n_columns columns (None: the inputs); None without a C
    compiler."""
    sizes = {"FMI": fmi, "NX": n_x, "NU": n_u if n_columns is None else n_columns, "N_SET": n_u, "NL": n_laws}
    sizes |= {"NP": n_p, "NY": n_y, "NG": 0}
    lines = [f"#define {name} {value}" for name, value in sizes.items()]
    texts = (*lines, text_of("foreign.c", "daest.fmu"), text_of("radau.c"))
    source = "\n".join(texts)
    return if_compiler(lambda: build_shared(source, "engine", (effort(source, "-O2"),)))


@dataclass(frozen=True)
class Plan:
    """How a trajectory is followed: the `library` of `engine_library`; `steps` (n_p,) by which the instances
    behind the first have their parameters moved; `sizes` (n_x,) of the states; `atol` (n_x,); the `most`
    steps in all; whether there are sensitivities (n, n_y, n_p + n_x) (`has_slopes`).
    `laws` is their `laws.law_table`, `law_sizes` (1 + 2 n_p, n_laws) those of every instance."""

    library: str
    steps: np.ndarray
    sizes: np.ndarray
    atol: np.ndarray
    most: int
    has_slopes: bool
    laws: np.ndarray
    law_sizes: np.ndarray


@dataclass(frozen=True)
class Followed:
    """values (n, n_y) and states (n, n_x) before corrections, sensitivities (n, n_y, n_p + n_x) of values."""

    values: np.ndarray
    states: np.ndarray
    slopes: np.ndarray


def follow(
    instances: Sequence[Instance], drive: Drive, x0: np.ndarray, plan: Plan, alive: Callable[[float], None]
) -> Followed | None:
    """Follow the first instance from x0 (n_x,); None where the FMU or the integrator gives up."""
    library = ctypes.CDLL(plan.library)
    _bind(library, instances, drive, plan)
    n, n_x, n_y = drive.time.size, x0.size, len(drive.read)
    directions = plan.steps.size + n_x if plan.has_slopes else 0
    found = Followed(np.empty((n, n_y)), np.empty((n, n_x)), np.empty((n, n_y, directions)))
    start = np.zeros((n_x, directions))
    if directions:
        start[:, plan.steps.size :] = np.eye(n_x)
    steps, reached = np.zeros(1, dtype=_LONG), np.array([drive.time[0], 0.0, 0.0])
    lengths, most = (np.array([count], dtype=_LONG) for count in (n, plan.most))
    given = (drive.time, drive.u0, drive.u1, drive.u_last, drive.bent, None, x0)
    correction = _correction(drive)
    with _told(lambda: float(reached[0]), alive), _counted(_LONG.in_dll(library, "daest_calls")):
        status = library.daest_simulate(
            _LONG(1), *map(pointer, (lengths, *given)),
            ctypes.c_int(directions), ctypes.c_int(plan.steps.size), pointer(start),
            *map(pointer, correction), _LONG(0), None, ctypes.c_int(0),
            ctypes.c_double(drive.rtol), pointer(plan.atol),
            *map(pointer, (most, found.states, found.values, found.slopes, steps, reached)), None, None,
        )  # fmt: skip
    return None if status or library.daest_refused() else found


def _correction(drive: Drive) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Measurements and gain for all that is read: what is not measured corrects nothing."""
    if drive.measurements is None or drive.gain is None:
        return None, None
    more = len(drive.read) - drive.measurements.shape[1]
    y = np.pad(drive.measurements, ((0, 0), (0, more)), constant_values=np.nan)
    return y, np.pad(drive.gain, ((0, 0), (0, more)))


def _bind(library: ctypes.CDLL, instances: Sequence[Instance], drive: Drive, plan: Plan) -> None:
    first = instances[0]
    is_fmi3 = first.binary.fmi_major == 3
    kind, rates = ("Float64", "GetContinuousStateDerivatives") if is_fmi3 else ("Real", "GetDerivatives")
    names = ["SetTime", "SetContinuousStates", rates, f"Set{kind}", f"Get{kind}"]
    addresses = [first.address(name) for name in names]
    addresses.append(first.address("CompletedIntegratorStep") if first.binary.reports_steps else None)
    functions = (ctypes.c_void_p * len(addresses))(*addresses)
    components = (ctypes.c_void_p * len(instances))(*(one.component for one in instances))
    inputs, outputs = (np.array(refs, dtype=np.uint32) for refs in (drive.inputs, drive.read))
    arrays = (inputs, outputs, plan.steps, plan.sizes)
    library.daest_bind(
        functions, components, *map(pointer, arrays), ctypes.c_int(plan.has_slopes),
        pointer(plan.laws), pointer(plan.law_sizes),
    )  # fmt: skip


@contextlib.contextmanager
def _counted(calls: ctypes.c_long) -> Iterator[None]:
    CALLS.more = lambda: calls.value
    try:
        yield
    finally:
        CALLS.more = lambda: 0


@contextlib.contextmanager
def _told(reached: Callable[[], float], alive: Callable[[float], None]) -> Iterator[None]:
    """Within the block `alive` is called with the time reached, as long as that grows."""
    is_done = threading.Event()

    def tell() -> None:
        last = None
        while not is_done.wait(TOLD_SECONDS):
            now = reached()
            if now != last:
                alive(now)
            last = now

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        is_done.set()
        teller.join()
