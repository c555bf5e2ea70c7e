"""A loaded FMU behind one small interface, FMI 2.0 and 3.0. Foreign code: only `fmu.worker` uses this."""

from __future__ import annotations

import ctypes
import os
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from daest.errors import printable

# Event iteration of a model that never settles is given up after this many rounds.
MOST_EVENT_ROUNDS = 100
# Of a log, this many messages are kept for the user, each cut to a length.
KEPT_MESSAGES = 5
LONGEST_MESSAGE = 500
# FMI states: ok and warning are answers; discard, error and fatal are refusals.
_WARNING, _DISCARD, _ERROR, _FATAL = 1, 2, 3, 4

_POINTER, _SIZE, _DOUBLE, _INT = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double, ctypes.c_int


@dataclass(frozen=True)
class Binary:
    """What is needed to load and run the library of an FMU; can be written as JSON.

    `kind` is "exchange" or "co-simulation". `states` and `enable` (the switch of fmi-ls-dae, None without)
    are value references. `reports_steps` tells that the FMU wants to know of completed steps, `only_once`
    that a process can hold one instance alone.
    """

    folder: str
    identifier: str
    token: str
    fmi_major: int
    kind: Literal["exchange", "co-simulation"]
    states: tuple[int, ...]
    n_event_indicators: int
    reports_steps: bool
    enable: int | None = None
    only_once: bool = False


class Calls:
    """How many calls into FMUs of this process have come back; compiled code counts its own, which `more`
    reads."""

    def __init__(self) -> None:
        self.done = 0
        self.more: Callable[[], int] = lambda: 0

    @property
    def all(self) -> int:
        return self.done + self.more()


CALLS = Calls()


class Refusal(Exception):
    """The FMU refused a call; the text holds its own words. `is_fatal`: it cannot be used any more; `stays`:
    the instance is in the error state of FMI and refuses everything from now on."""

    def __init__(self, text: str, is_fatal: bool = False, stays: bool = True) -> None:
        super().__init__(text)
        self.is_fatal, self.stays = is_fatal, stays


class Log:
    """The last messages of an FMU. `full` is called when there have been more than `limit` characters."""

    def __init__(self, limit: float = np.inf, full: Callable[[], None] = lambda: None) -> None:
        self._kept: deque[str] = deque(maxlen=KEPT_MESSAGES)
        self._left, self._full = limit, full

    def add(self, text: Any) -> None:
        words = text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
        self._left -= len(words)
        if self._left < 0:
            self._full()
        self._kept.append(printable(" ".join(words.split()))[:LONGEST_MESSAGE])

    def taken(self) -> str:
        """The messages since the last time, as one text."""
        words = "; ".join(w for w in self._kept if w)
        self._kept.clear()
        return words


class Instance:
    """One instance of an FMU, from instantiation to continuous-time (or step) mode.

    Value references are those of Float64 (FMI 2: Real) variables. Methods raise `Refusal`.
    """

    def __init__(self, binary: Binary, log: Log) -> None:
        self.binary = binary
        self._log = log
        self._unit = _loaded(binary)
        self._is_fmi3 = binary.fmi_major == 3
        self._get, self._set, self._get_rates = (
            ("GetFloat64", "SetFloat64", "GetContinuousStateDerivatives")
            if self._is_fmi3
            else ("GetReal", "SetReal", "GetDerivatives")
        )
        self.n_states = len(binary.states)
        self.n_event_indicators = binary.n_event_indicators
        self.next_event: float | None = None
        self._functions: dict[str, Callable[..., int]] = {}
        self._references: dict[tuple[int, ...], np.ndarray] = {}

    # ----------------------------------------------------------------------------------- life cycle

    def start(
        self,
        parameters: tuple[Sequence[int], Sequence[float] | np.ndarray] = ((), ()),
        time: float = 0.0,
        dae_mode: bool = False,
        inputs: tuple[Sequence[int], Sequence[float] | np.ndarray] = ((), ()),
    ) -> None:
        """A new instance with the given parameter and input values, initialised and settled at `time`. Both
        are references and values of the same shape (k,)."""
        unit = self._unit
        if self.binary.only_once and unit.component:
            self._call("Reset")  # some refuse another instance even after the first one was given back
        else:
            self.free()
            self._try(unit.instantiate, **self._callbacks())
        if dae_mode and self.binary.enable is not None:
            self._try(unit.enterConfigurationMode)
            self._try(unit.setBoolean, [self.binary.enable], [True])
            self._try(unit.exitConfigurationMode)
        self.set(*parameters)
        if self._is_fmi3:
            self._try(unit.enterInitializationMode, None, time)
        else:
            self._try(unit.setupExperiment, startTime=time)
            self._try(unit.enterInitializationMode)
        self.set(*inputs)
        self._try(unit.exitInitializationMode)
        if self.binary.kind == "exchange":
            if self._is_fmi3:
                self.n_event_indicators = int(self._try(unit.getNumberOfEventIndicators))
            self._iterate()
            self._try(unit.enterContinuousTimeMode)
        # A Co-Simulation FMU without event mode goes from initialisation straight to step mode.

    def free(self) -> None:
        """Give the instance back, if there is one."""
        if self._unit.component:
            if self._is_fmi3:
                self._unit.fmi3FreeInstance(self._unit.component)
            else:
                self._unit.fmi2FreeInstance(self._unit.component)
            self._unit.component = None

    def _callbacks(self) -> dict[str, Any]:
        if self._is_fmi3:
            return {"logMessage": lambda *told: self._log.add(told[3])}
        return {"callbacks": _fmi2_callbacks(self._log)}

    # --------------------------------------------------------------------------------------- events

    def settle(self) -> bool:
        """Event mode and back: discrete variables fit the states, which may have been changed (True)."""
        self._try(self._unit.enterEventMode)
        changed = self._iterate()
        self._try(self._unit.enterContinuousTimeMode)
        return changed

    def _iterate(self) -> bool:
        """Update discrete states until nothing changes; remembers the time of the next event."""
        update = self._unit.updateDiscreteStates if self._is_fmi3 else self._unit.newDiscreteStates
        changed = False
        for _ in range(MOST_EVENT_ROUNDS):
            again, terminate, _, states_changed, has_next, next_time = self._try(update)
            changed = changed or bool(states_changed)
            if terminate:
                raise Refusal(self._words("the FMU asked for the end of the simulation"))
            if not again:
                self.next_event = float(next_time) if has_next else None
                return changed
        raise Refusal(f"its event iteration does not end within {MOST_EVENT_ROUNDS} rounds")

    def completed_step(self) -> bool:
        """Tell the FMU of a completed step; True if it wants event mode."""
        if not self.binary.reports_steps:
            return False
        wants_event, terminate = self._try(self._unit.completedIntegratorStep)
        if terminate:
            raise Refusal(self._words("the FMU asked for the end of the simulation"))
        return bool(wants_event)

    # --------------------------------------------------------------------------------------- values

    def get(self, references: Sequence[int]) -> np.ndarray:
        """Values, shape (len(references),)."""
        values = np.zeros(len(references))
        if values.size:
            vr = self._array_of(references)
            self._call(self._get, *self._pairs(vr, values))
        return values

    def set(self, references: Sequence[int], values: Sequence[float] | np.ndarray) -> None:
        """Set the variables of references (k,) to values (k,)."""
        if len(references):
            vr, given = self._array_of(references), np.ascontiguousarray(values, dtype=float)
            self._call(self._set, *self._pairs(vr, given))

    def _pairs(self, vr: np.ndarray, values: np.ndarray) -> tuple[Any, ...]:
        pairs = (_POINTER(vr.ctypes.data), _SIZE(vr.size), _POINTER(values.ctypes.data))
        return (*pairs, _SIZE(values.size)) if self._is_fmi3 else pairs

    def set_time(self, time: float) -> None:
        self._call("SetTime", _DOUBLE(time))

    def set_states(self, values: np.ndarray) -> None:
        """Continuous states in the order of `binary.states`. Shapes: values (n_states,)."""
        if self.n_states:
            given = np.ascontiguousarray(values, dtype=float)
            self._call("SetContinuousStates", _POINTER(given.ctypes.data), _SIZE(self.n_states))

    def states(self) -> np.ndarray:
        """The continuous states (n_states,)."""
        return self._vector("GetContinuousStates", self.n_states)

    def rates(self) -> np.ndarray:
        """The derivatives of the continuous states. Shapes: (n_states,)."""
        return self._vector(self._get_rates, self.n_states)

    # The inner loop of an integrator: everything is prepared, and vectors go by their addresses.

    def writer(self, references: Sequence[int]) -> tuple[np.ndarray, Callable[[], None]]:
        """A buffer and a call that sets the variables to what stands in it. Shapes: buffer (k,)."""
        buffer, vr = np.zeros(len(references)), self._array_of(references)
        if not buffer.size:
            return buffer, lambda: None
        arguments = self._pairs(vr, buffer)
        return buffer, lambda: self._call(self._set, *arguments)

    def put_states(self, address: Any) -> None:
        self._call("SetContinuousStates", address, _SIZE(self.n_states))

    def take_rates(self, address: Any) -> None:
        self._call(self._get_rates, address, _SIZE(self.n_states))

    def take_indicators(self, address: Any) -> None:
        self._call("GetEventIndicators", address, _SIZE(self.n_event_indicators))

    def nominals(self) -> np.ndarray:
        """Sizes of the states; 1 where the FMU has no usable one (zero, negative, not finite)."""
        try:
            found = self._vector("GetNominalsOfContinuousStates", self.n_states)
        except Refusal:
            return np.ones(self.n_states)
        return np.where(np.isfinite(found) & (found > 0.0), found, 1.0)

    def _vector(self, name: str, size: int) -> np.ndarray:
        values = np.zeros(size)
        if size:
            self._call(name, _POINTER(values.ctypes.data), _SIZE(size))
        return values

    def directional(self, unknowns: Sequence[int], known: int) -> np.ndarray:
        """∂unknowns/∂known, shape (len(unknowns),). Ask only if the FMU declares that it provides it."""
        result, seed = np.zeros(len(unknowns)), np.ones(1)
        if result.size:
            asked, moved = self._array_of(unknowns), self._array_of((known,))
            arguments = [
                _POINTER(asked.ctypes.data),
                _SIZE(asked.size),
                _POINTER(moved.ctypes.data),
                _SIZE(1),
            ]
            if self._is_fmi3:
                arguments += [
                    _POINTER(seed.ctypes.data),
                    _SIZE(1),
                    _POINTER(result.ctypes.data),
                    _SIZE(result.size),
                ]
            else:
                arguments += [_POINTER(seed.ctypes.data), _POINTER(result.ctypes.data)]
            self._call("GetDirectionalDerivative", *arguments)
        return result

    def step(self, time: float, length: float) -> None:
        """One step of a Co-Simulation FMU."""
        if not self._is_fmi3:
            self._call("DoStep", _DOUBLE(time), _DOUBLE(length), _INT(1))
            return
        event, terminate, early, reached = (ctypes.c_bool(), ctypes.c_bool(), ctypes.c_bool(), _DOUBLE())
        ends = [ctypes.byref(end) for end in (event, terminate, early, reached)]
        self._call("DoStep", _DOUBLE(time), _DOUBLE(length), ctypes.c_bool(True), *ends)
        if terminate.value:
            raise Refusal(self._words("the FMU asked for the end of the simulation"))

    # For compiled code that calls the binary by itself.

    @property
    def component(self) -> Any:
        """The address of the instance in the binary."""
        found = self._unit.component
        return found.value if isinstance(found, _POINTER) else found

    def address(self, name: str) -> int | None:
        """The address of the function fmi2`name` or fmi3`name`; None where the binary has none."""
        full = f"fmi{self.binary.fmi_major}{name}"
        if not hasattr(self._unit.dll, full):
            return None
        return ctypes.cast(getattr(self._unit.dll, full), _POINTER).value

    # ---------------------------------------------------------------------------------------- calls

    def _array_of(self, references: Sequence[int]) -> np.ndarray:
        key = tuple(references)
        if key not in self._references:
            self._references[key] = np.array(key, dtype=np.uint32)
        return self._references[key]

    def _call(self, name: str, *arguments: Any) -> None:
        function = self._functions.get(name)
        if function is None:
            # A handle of its own: fmpy gives its handles argument types that suit its calls alone.
            full = f"fmi{self.binary.fmi_major}{name}"
            if not hasattr(self._unit.dll, full):
                raise Refusal(f"{full}: its binary has no such function", stays=False)
            function = ctypes.CFUNCTYPE(_INT)((full, self._unit.dll))
            self._functions[name] = function
        status = function(_POINTER(self._unit.component), *arguments)
        CALLS.done += 1
        if status > _WARNING:
            full = f"fmi{self.binary.fmi_major}{name}"
            reason = f"{full}: {self._words('it gave no reason')}"
            raise Refusal(reason, status == _FATAL, status != _DISCARD)

    def _try(self, call: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        try:
            return call(*arguments, **named)
        except Refusal:
            raise
        except Exception as problem:  # fmpy raises bare exceptions
            is_fatal = getattr(problem, "status", None) == _FATAL
            name = getattr(call, "__name__", "a function")
            raise Refusal(f"{name}: {self._words(str(problem))}", is_fatal) from problem
        finally:
            CALLS.done += 1

    def _words(self, otherwise: str) -> str:
        return (self._log.taken() or otherwise).rstrip(".")


def _loaded(binary: Binary) -> Any:
    arguments = {
        "guid": binary.token,
        "unzipDirectory": binary.folder,
        "modelIdentifier": binary.identifier,
        "instanceName": binary.identifier,
        "libraryPath": str(library_path(Path(binary.folder), binary.identifier)),
        "requireFunctions": False,
    }
    folder_now = os.getcwd()  # fmpy changes it, and stays there if the library cannot be loaded
    try:
        if binary.fmi_major == 3:
            from fmpy.fmi3 import FMU3Model, FMU3Slave

            return _forgiving(FMU3Model if binary.kind == "exchange" else FMU3Slave)(**arguments)
        from fmpy.fmi2 import FMU2Model, FMU2Slave

        return _forgiving(FMU2Model if binary.kind == "exchange" else FMU2Slave)(**arguments)
    except Exception as problem:
        raise Refusal(str(problem), is_fatal=True) from problem
    finally:
        os.chdir(folder_now)


def _forgiving(kind: type) -> type:
    """fmpy's class for binaries without some functions, as many tools leave out those that save a state:
    whoever calls one meets an error. fmpy itself wants them all."""

    def load(self: Any) -> None:
        library = self.dll
        self.dll = _Partial(library)
        try:
            kind._loadFunctions(self)  # type: ignore[attr-defined]
        finally:
            self.dll = library

    return type(kind.__name__, (kind,), {"_loadFunctions": load})


class _Partial:
    """A library whose missing functions give the status of an error; without instances there is nothing."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def __getattr__(self, name: str) -> Any:
        if hasattr(self._library, name) or "Instan" in name:
            return getattr(self._library, name)
        return ctypes.CFUNCTYPE(_INT)(lambda: _ERROR)


def library_path(folder: Path, identifier: str) -> Path:
    """The library below `folder`/binaries; there is one platform in an unpacked FMU. Raises Refusal where it
    is missing."""
    for suffix in (".so", ".dll", ".dylib"):
        for found in folder.glob(f"binaries/*/{identifier}{suffix}"):
            return found
    raise Refusal("there is no library", is_fatal=True)


def _fmi2_callbacks(log: Log) -> Any:
    """fmpy's callbacks with a logger of ours: its own prints to standard output."""
    from fmpy import fmi2
    from fmpy.logging import addLoggerProxy

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *told: log.add(told[4]))
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    addLoggerProxy(ctypes.byref(callbacks))  # writes the values into the message
    return callbacks
