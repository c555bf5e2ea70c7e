"""Simulation of a loaded FMU: CVODE with state, time and step events, or the FMU's own steps.

Foreign code: only `fmu.worker` uses this.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from daest.fmu.instance import Instance, Refusal
from daest.fmu.laws import Law

# Steps of the integrator between two samples, and events between two samples: beyond, it does not get on.
MOST_STEPS = 20_000
MOST_EVENTS = 1_000
# Absolute tolerance: this part of the relative one times the nominal value of a state.
ABSOLUTE_PART = 1e-2
# Times that differ by less than this, relative to the later one, are one time.
SAME_TIME = 1e-12


class Stopped(Exception):
    """The simulation stopped at `time`, for a reason that other values may not have."""

    def __init__(self, reason: str, time: float) -> None:
        super().__init__(reason)
        self.time = time


@dataclass(frozen=True)
class Task:
    """What drives a simulation.

    time (n,); `inputs` are value references; u0 and u1 (n - 1, n_u) hold their values at both ends of every
    interval, u_last (n_u,) at the last sample. `read` are the value references to record. `laws` add to the
    inputs what depends on variables of the FMU. measurements (n, n_y) of the first n_y of `read` and gain
    (n_states, n_y) correct the states at every sample (None: no correction).
    """

    time: np.ndarray
    inputs: tuple[int, ...]
    u0: np.ndarray
    u1: np.ndarray
    u_last: np.ndarray
    read: tuple[int, ...]
    rtol: float
    laws: tuple[Law, ...] = ()
    measurements: np.ndarray | None = None
    gain: np.ndarray | None = None

    @property
    def is_held(self) -> bool:
        """Inputs are constant between samples."""
        return bool(np.array_equal(self.u0, self.u1))


@dataclass(frozen=True)
class Recorded:
    """values (n, n_read), states (n, n_states) before corrections; `n_events` counts all events."""

    values: np.ndarray
    states: np.ndarray
    n_events: int


def run(instance: Instance, task: Task, x0: np.ndarray | None, alive: Callable[[float], None]) -> Recorded:
    """Simulate from the instance's own start, or from x0 (n_states,). `alive` hears of the time reached."""
    if instance.binary.kind == "exchange":
        return _exchange(instance, task, x0, alive)
    return _co_simulation(instance, task, alive)


def _co_simulation(instance: Instance, task: Task, alive: Callable[[float], None]) -> Recorded:
    """Inputs of a step are held at its mean: exact for held inputs, of second order for straight ones."""
    n = task.time.size
    values = np.empty((n, len(task.read)))
    for k in range(n):
        now = float(task.time[k])
        alive(now)
        values[k] = _guarded(instance.get, now, task.read)
        if k + 1 == n:
            break
        u = 0.5 * (task.u0[k] + task.u1[k]) + _added(instance, task, now)
        _guarded(instance.set, now, task.inputs, u)
        _guarded(instance.step, now, now, float(task.time[k + 1] - now))
    return Recorded(values, np.empty((n, 0)), 0)


def _added(instance: Instance, task: Task, time: float) -> np.ndarray:
    u = np.zeros(len(task.inputs))
    for law in task.laws:
        u[law.input] += law.value(_guarded(instance.get, time, law.reads), time)
    return u


def _guarded(call: Callable[..., Any], time: float, *arguments: Any) -> Any:
    try:
        return call(*arguments)
    except Refusal as problem:
        if problem.is_fatal:
            raise
        raise Stopped(str(problem), time) from problem


class _Drive:
    """Puts time, states and inputs into the instance, in the order that leaves nothing stale."""

    def __init__(self, instance: Instance, task: Task) -> None:
        self.instance, self.task = instance, task
        self.problem: Refusal | None = None
        self._buffer, self._write = instance.writer(task.inputs)
        self._rise = task.u1 - task.u0
        self._lengths = np.diff(task.time).tolist()
        self._times = task.time.tolist()
        self._held_interval = -1
        self.is_held = task.is_held
        self.interval = 0

    def forget(self) -> None:
        """Inputs must be set again: an event or another interval may have changed what the FMU keeps."""
        self._held_interval = -1

    def move(self, time: float) -> None:
        """Time and inputs, without what the laws add."""
        self.instance.set_time(time)
        task, k = self.task, self.interval
        if not self._buffer.size:
            return
        if k >= len(self._lengths):
            self._buffer[:] = task.u_last
        elif self.is_held:
            if self._held_interval == k:
                return
            self._held_interval = k
            self._buffer[:] = task.u0[k]
        else:
            # The integrator looks beyond the end of an interval.
            while k + 1 < len(self._lengths) and time > self._times[k + 1]:
                k += 1
            share = (time - self._times[k]) / self._lengths[k]
            self._buffer[:] = task.u0[k] + min(max(share, 0.0), 1.0) * self._rise[k]
        self._write()

    def add_laws(self, time: float) -> None:
        """What the laws add at the states that are set."""
        if not self.task.laws:
            return
        added = [(law.input, law.value(self.instance.get(law.reads), time)) for law in self.task.laws]
        for number, value in added:
            self._buffer[number] += value
        self._write()
        self.forget()

    def go(self, time: float, x: np.ndarray | None = None) -> None:
        """Time, inputs and states, time again so that nothing is stale, then the laws that read them."""
        self.move(time)
        if x is not None:
            self.instance.set_states(x)
        self.instance.set_time(time)
        self.add_laws(time)


def _exchange(
    instance: Instance, task: Task, x0: np.ndarray | None, alive: Callable[[float], None]
) -> Recorded:
    drive = _Drive(instance, task)
    n = task.time.size
    start = float(task.time[0])
    if x0 is not None:
        drive.go(start, x0)
        if instance.n_event_indicators:
            _guarded(instance.settle, start)
            drive.forget()
    integrator = _Integrator(drive, start)
    values, states = np.empty((n, len(task.read))), np.empty((n, instance.n_states))
    for k in range(n):
        now = float(task.time[k])
        drive.interval = k
        drive.forget()
        alive(now)
        try:
            x = integrator.x
            drive.go(now, x)
            states[k], values[k] = x, instance.get(task.read)
            if task.gain is not None and task.measurements is not None:
                integrator.correct(now, _correction(task, k, values[k]))
            if k + 1 < n:
                integrator.advance(now, float(task.time[k + 1]), k)
        except Refusal as problem:
            if problem.is_fatal:
                raise
            raise Stopped(str(problem), now) from problem
    return Recorded(values, states, integrator.n_events)


def _correction(task: Task, k: int, values: np.ndarray) -> np.ndarray:
    assert task.measurements is not None and task.gain is not None
    error = task.measurements[k] - values[: task.measurements.shape[1]]
    return task.gain @ np.where(np.isfinite(error), error, 0.0)


class _Integrator:
    """CVODE (BDF) on the instance behind a `_Drive`."""

    def __init__(self, drive: _Drive, time: float) -> None:
        self._drive, self._instance = drive, drive.instance
        self.x = drive.instance.states()
        self.n_events = 0
        self._time = time
        self._solver: Any = None
        self._fresh = False

    def correct(self, time: float, step: np.ndarray) -> None:
        if np.any(step != 0.0):
            self.x = self.x + step
            self._fresh = False

    def advance(self, time: float, end: float, interval: int) -> None:
        """Move `x` from `time` to `end`, through the events on the way."""
        instance, drive = self._instance, self._drive
        if (
            drive.is_held
            and interval
            and not np.array_equal(drive.task.u0[interval], drive.task.u0[interval - 1])
        ):
            self._fresh = False
        if drive.is_held and instance.n_event_indicators and not self._fresh:
            self._event(time, counted=False)
        events = 0
        while end - time > SAME_TIME * max(abs(end), 1.0):
            target = end
            if instance.next_event is not None and instance.next_event < end:
                target = max(instance.next_event, time)
            reached, is_root = (time, False) if target <= time else self._integrate(time, target)
            time = reached
            drive.go(time, self.x)
            wants = instance.completed_step()
            is_time_event = instance.next_event is not None and instance.next_event <= time * (1 + SAME_TIME)
            if is_root or wants or is_time_event:
                events += 1
                if events > MOST_EVENTS:
                    raise Stopped(f"more than {MOST_EVENTS} events within one sample interval", time)
                self._event(time)

    def _event(self, time: float, counted: bool = True) -> None:
        instance, drive = self._instance, self._drive
        drive.go(time, self.x)
        instance.settle()
        drive.forget()
        self.x = instance.states()
        self._fresh = False
        self.n_events += int(counted)

    def _integrate(self, time: float, end: float) -> tuple[float, bool]:
        if not self._instance.n_states and not self._instance.n_event_indicators:
            return end, False
        if not self._fresh:
            self._restart(time)
        try:
            is_root, _, reached = self._solver.step(time, end)
        except Exception as error:
            problem, self._drive.problem = self._drive.problem, None
            self._fresh = False
            if problem is not None:
                raise problem from error
            raise Stopped(
                "the step size became too small: a singularity, an event that it does not tell, or a model "
                f"that is too stiff ({error})",
                time,
            ) from error
        if self._drive.problem is not None:  # the integrator has found a way round
            self._drive.problem = None
        if self._instance.n_states:
            self.x = np.ctypeslib.as_array(self._solver.px, (self._instance.n_states,)).copy()
        if not np.all(np.isfinite(self.x)):
            raise Stopped("a state is no finite number", time)
        return float(reached), bool(is_root)

    def _restart(self, time: float) -> None:
        if self._solver is not None:
            self._solver.reset(time)
        else:
            self._solver = self._made(time)
        self._fresh = True

    def _made(self, time: float) -> Any:
        from fmpy.sundials import CVodeSolver

        rtol = self._drive.task.rtol
        return CVodeSolver(
            nx=self._instance.n_states,
            nz=self._instance.n_event_indicators,
            get_x=self._get_states,
            set_x=self._set_states,
            get_dx=self._get_rates,
            get_z=self._get_indicators,
            get_nominals=self._get_nominals,
            set_time=self._set_time,
            input=self,
            startTime=time,
            relativeTolerance=rtol,
            maxNumSteps=MOST_STEPS,
        )

    # What CVODE calls; a refusal is kept and told after it has given up.

    def apply(self, time: float) -> None:
        """Inputs are set together with the time."""

    def _set_time(self, time: float) -> None:
        self._time = time
        self._keep(self._drive.move, time)

    def _get_states(self, pointer: Any, size: int) -> None:
        np.ctypeslib.as_array(pointer, (size,))[:] = self.x

    def _set_states(self, pointer: Any, size: int) -> None:
        self._keep(self._instance.put_states, pointer)

    def _get_nominals(self, pointer: Any, size: int) -> None:
        np.ctypeslib.as_array(pointer, (size,))[:] = ABSOLUTE_PART * self._instance.nominals()

    def _get_rates(self, pointer: Any, size: int) -> None:
        self._keep(self._drive.add_laws, self._time)
        if not self._keep(self._instance.take_rates, pointer):
            np.ctypeslib.as_array(pointer, (size,))[:] = np.nan

    def _get_indicators(self, pointer: Any, size: int) -> None:
        self._keep(self._drive.add_laws, self._time)
        if not self._keep(self._instance.take_indicators, pointer):
            np.ctypeslib.as_array(pointer, (size,))[:] = np.nan

    def _keep(self, call: Callable[..., None], argument: Any) -> bool:
        if self._drive.problem is None:
            try:
                call(argument)
                return True
            except Refusal as problem:
                self._drive.problem = problem
        return False
