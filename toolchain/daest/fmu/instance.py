"""A running FMU behind one small interface, FMI 2.0 and 3.0: set, get, differentiate."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from daest.errors import FmuError
from daest.fmu.archive import unpacked
from daest.fmu.compiler import native_platform
from daest.model.fmu import FmuModel

# Event iteration of a model that never settles is given up after this many rounds.
MOST_EVENT_ROUNDS = 100


class Instance:
    """An FMU in continuous-time mode at a point that can be moved. Made by `open_instance`.

    Value references are those of Float64 (FMI 2: Real) variables. All methods raise FmuError
    `fmu-call-failed` with the FMU's own words.
    """

    def __init__(self, model: FmuModel, unit: Any, messages: list[str]) -> None:
        self.model = model
        self._unit = unit
        self._messages = messages
        self._is_fmi3 = model.fmi_version.startswith("3")

    def get(self, references: Sequence[int]) -> np.ndarray:
        """Values, shape (len(references),)."""
        if not references:
            return np.zeros(0)
        read = self._unit.getFloat64 if self._is_fmi3 else self._unit.getReal
        return np.array(self._try(read, list(references)), dtype=float)

    def set(self, references: Sequence[int], values: Sequence[float] | np.ndarray) -> None:
        if references:
            write = self._unit.setFloat64 if self._is_fmi3 else self._unit.setReal
            self._try(write, list(references), [float(v) for v in values])

    def set_states(self, values: np.ndarray) -> None:
        """Continuous states in the order of `model.states`; time is set again so that nothing stays stale."""
        import ctypes

        count = len(values)
        if count:
            self._try(self._unit.setContinuousStates, (ctypes.c_double * count)(*values), count)
        self.set_time(0.0)

    def rates(self) -> np.ndarray:
        """The derivatives of the continuous states."""
        import ctypes

        count = len(self.model.states)
        buffer = (ctypes.c_double * count)()
        if count:
            read = self._unit.getContinuousStateDerivatives if self._is_fmi3 else self._unit.getDerivatives
            self._try(read, buffer, count)
        return np.array(buffer[:])

    def set_time(self, time: float) -> None:
        self._try(self._unit.setTime, time)

    def directional(self, unknowns: Sequence[int], known: int) -> np.ndarray:
        """∂unknowns/∂known, shape (len(unknowns),). Ask only if the model declares that it provides it."""
        if not unknowns:
            return np.zeros(0)
        return np.array(
            self._try(self._unit.getDirectionalDerivative, list(unknowns), [known], [1.0]), dtype=float
        )

    def _try(self, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except Exception as problem:  # fmpy raises bare exceptions
            raise self._failed(getattr(call, "__name__", "a function"), problem) from problem

    def _failed(self, name: str, problem: Exception) -> FmuError:
        words = "; ".join(self._messages[-3:]) or str(problem)
        return FmuError(
            "fmu-call-failed",
            f"The FMU refused {name}: {words.rstrip('.')}.",
            where=str(self.model.path),
            remedy="Choose parameter values and an operating point at which the model can be evaluated.",
        )


@contextmanager
def open_instance(
    model: FmuModel, parameters: tuple[Sequence[int], Sequence[float]] = ((), ()), dae_mode: bool = False
) -> Iterator[Instance]:
    """An instance with the given parameter values, past its initialization and event iteration, at time 0.

    `dae_mode` sets the structural parameter of fmi-ls-dae first.
    Errors (FmuError): `fmu-without-binary`, `fmu-binary-not-loaded`, `fmu-call-failed`.
    """
    folders = (_binary_folder(model), "resources/")
    with unpacked(model.path, folders) as folder:
        (folder / "resources").mkdir(exist_ok=True)
        unit, messages = _load(model, folder)
        instance = Instance(model, unit, messages)
        try:
            _start(instance, parameters, dae_mode)
            yield instance
        finally:
            if unit.component:
                unit.freeInstance()
            else:
                unit.freeLibrary()


def _binary_folder(model: FmuModel) -> str:
    """`binaries/<platform>/` of this machine."""
    here = native_platform()
    names = (here.tuple_name,) if model.fmi_version.startswith("3") else (_fmi2_platform(),)
    for name in names:
        if name in model.platforms:
            return f"binaries/{name}/"
    has = f"it has {', '.join(model.platforms)}" if model.platforms else "it has none at all"
    raise FmuError(
        "fmu-without-binary",
        f"The FMU has no binary for this platform ({names[0]}); {has}.",
        where=str(model.path),
        remedy=f"Export it again for this platform: `daest export MODEL.mo --platform {here.short_name}`.",
    )


def _fmi2_platform() -> str:
    system = {"Linux": "linux", "Windows": "win", "Darwin": "darwin"}.get(
        platform.system(), platform.system()
    )
    return f"{system}64"


def _load(model: FmuModel, folder: Path) -> tuple[Any, list[str]]:
    arguments = {
        "guid": model.token,
        "unzipDirectory": str(folder),
        "modelIdentifier": model.model_identifier,
        "instanceName": model.model_identifier,
    }
    messages: list[str] = []
    folder_now = os.getcwd()  # fmpy changes it, and stays there if the library cannot be loaded
    try:
        if model.fmi_version.startswith("3"):
            from fmpy.fmi3 import FMU3Model

            unit = FMU3Model(**arguments)
            unit.instantiate(logMessage=lambda *told: messages.append(_decoded(told[3])))
        else:
            from fmpy.fmi2 import FMU2Model

            unit = FMU2Model(**arguments)
            unit.instantiate(callbacks=_fmi2_callbacks(messages))
    except Exception as problem:
        raise FmuError(
            "fmu-binary-not-loaded",
            f"The binary of the FMU cannot be used: {'; '.join(messages) or problem}",
            where=str(model.path),
            remedy="It may need a library that is missing here; export the FMU for this platform again.",
        ) from problem
    finally:
        os.chdir(folder_now)
    return unit, messages


def _decoded(text: Any) -> str:
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)


def _fmi2_callbacks(messages: list[str]) -> Any:
    """fmpy's callbacks with a logger of ours: its own prints to standard output."""
    import ctypes

    from fmpy import fmi2
    from fmpy.logging import addLoggerProxy

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *told: messages.append(_decoded(told[4])))
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    addLoggerProxy(ctypes.byref(callbacks))  # writes the values into the message
    return callbacks


def _start(instance: Instance, parameters: tuple[Sequence[int], Sequence[float]], dae_mode: bool) -> None:
    model, unit, attempt = instance.model, instance._unit, instance._try
    if dae_mode and model.manifest is not None and model.manifest.enable is not None:
        attempt(unit.enterConfigurationMode)
        attempt(unit.setBoolean, [model.manifest.enable], [True])
        attempt(unit.exitConfigurationMode)
    instance.set(*parameters)
    if instance._is_fmi3:
        attempt(unit.enterInitializationMode, None, 0.0)
    else:
        attempt(unit.setupExperiment)
        attempt(unit.enterInitializationMode)
    attempt(unit.exitInitializationMode)
    iterate = unit.updateDiscreteStates if instance._is_fmi3 else unit.newDiscreteStates
    for _ in range(MOST_EVENT_ROUNDS):
        if not attempt(iterate)[0]:
            break
    attempt(unit.enterContinuousTimeMode)
