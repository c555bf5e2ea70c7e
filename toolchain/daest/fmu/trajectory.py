"""Simulation of a loaded FMU: CVODE with state, time and step events, or the FMU's own steps.

Foreign code: only `fmu.worker` uses this.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from daest.fmu.drive import Drive
from daest.fmu.instance import Instance, Refusal

# Steps of the integrator between two samples, and events between two samples: beyond, it does not get on.
MOST_STEPS = 20_000
MOST_EVENTS = 1_000
# Absolute tolerance: this part of the relative one times the nominal value of a state.
ABSOLUTE_PART = 1e-2
# CV_ONE_STEP of cvode.h.
_ONE_STEP = 2
# Times that differ by less than this, relative to the later one, are one time.
SAME_TIME = 1e-12

# State events at one time that change nothing: so many are heard, then none over this part of the rest of the
# interval, and twice as long at every further one that follows at once.
HEARD_EVENTS = 10
DEAF_PART = 1e-6


class Stopped(Exception):
    """The simulation stopped at `time`, for a reason that other values may not have."""

    def __init__(self, reason: str, time: float) -> None:
        super().__init__(reason)
        self.time = time


@dataclass(frozen=True)
class Recorded:
    """values (n, n_read), states (n, n_states) before corrections; `n_events` counts all events."""

    values: np.ndarray
    states: np.ndarray
    n_events: int


def run(instance: Instance, drive: Drive, x0: np.ndarray | None, alive: Callable[[float], None]) -> Recorded:
    """Simulate from the instance's own start, or from x0 (n_states,). `alive` gets the time reached."""
    if instance.binary.kind == "exchange":
        return _exchange(instance, drive, x0, alive)
    return _co_simulation(instance, drive, alive)


def _co_simulation(instance: Instance, drive: Drive, alive: Callable[[float], None]) -> Recorded:
    """Inputs of a step are held at its mean: exact for held inputs, of second order for others."""
    n = drive.time.size
    values = np.empty((n, len(drive.read)))
    for k in range(n):
        now = float(drive.time[k])
        alive(now)
        # Outputs that follow an input directly belong to the input at the sample.
        u = drive.u0[k] if k + 1 < n else drive.u_last
        added = _added(instance, drive, u, now)
        _guarded(instance.set, now, drive.inputs, u[: added.size] + added)
        values[k] = _guarded(instance.get, now, drive.read)
        if k + 1 == n:
            break
        mean = 0.5 * (drive.u0[k] + drive.u1[k])
        if drive.bent is not None:
            mean += drive.bent[k, 0] / 6.0 + drive.bent[k, 1] / 12.0
        _guarded(instance.set, now, drive.inputs, mean[: added.size] + _added(instance, drive, mean, now))
        _guarded(instance.step, now, now, float(drive.time[k + 1] - now))
    return Recorded(values, np.empty((n, 0)), 0)


def _added(instance: Instance, drive: Drive, u: np.ndarray, time: float) -> np.ndarray:
    """What the laws add to the inputs, (n_inputs,), with the columns at u (n_columns,)."""
    added = np.zeros(len(drive.inputs))
    for law in drive.laws:
        added[law.input] += law.value(law.read(lambda refs: _guarded(instance.get, time, refs), u))
    return added


def _guarded(call: Callable[..., Any], time: float, *arguments: Any) -> Any:
    try:
        return call(*arguments)
    except Refusal as problem:
        if problem.is_fatal:
            raise
        raise Stopped(str(problem), time) from problem


class _Driver:
    """Puts time, states and inputs into the instance, in the order that leaves nothing stale."""

    def __init__(self, instance: Instance, drive: Drive) -> None:
        self.instance, self.drive = instance, drive
        self.problem: Refusal | None = None
        self._buffer, self._write = instance.writer(drive.inputs)
        self._columns = np.zeros(drive.u_last.size)
        self._rise = drive.u1 - drive.u0
        self._lengths = np.diff(drive.time).tolist()
        self._times = drive.time.tolist()
        self._held_interval = -1
        self.is_held = drive.is_held
        self.interval = 0

    def forget(self) -> None:
        """Inputs must be set again: an event or another interval may have changed what the FMU keeps."""
        self._held_interval = -1

    def move(self, time: float) -> None:
        """Time and inputs, without what the laws add."""
        self.instance.set_time(time)
        drive, k = self.drive, self.interval
        if not self._buffer.size:
            return
        if k >= len(self._lengths):
            self._columns[:] = drive.u_last
        elif self.is_held:
            if self._held_interval == k:
                return
            self._held_interval = k
            self._columns[:] = drive.u0[k]
        else:
            # The integrator looks beyond the end of an interval.
            while k + 1 < len(self._lengths) and time > self._times[k + 1]:
                k += 1
            share = min(max((time - self._times[k]) / self._lengths[k], 0.0), 1.0)
            self._columns[:] = drive.u0[k] + share * self._rise[k]
            if drive.bent is not None:
                self._columns += share * (1.0 - share) * (drive.bent[k, 0] + share * drive.bent[k, 1])
        self._buffer[:] = self._columns[: self._buffer.size]
        self._write()

    def add_laws(self, _time: float) -> None:
        """What the laws add at the states that are set."""
        if not self.drive.laws:
            return
        read = self.instance.get
        added = [(law.input, law.value(law.read(read, self._columns))) for law in self.drive.laws]
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
    instance: Instance, drive: Drive, x0: np.ndarray | None, alive: Callable[[float], None]
) -> Recorded:
    driver = _Driver(instance, drive)
    n = drive.time.size
    start = float(drive.time[0])
    if x0 is not None:
        driver.go(start, x0)
        if instance.n_event_indicators:
            _guarded(instance.settle, start)
            driver.forget()
    integrator = _Integrator(driver, start)
    values, states = np.empty((n, len(drive.read))), np.empty((n, instance.n_states))
    for k in range(n):
        now = float(drive.time[k])
        driver.interval = k
        driver.forget()
        alive(now)
        try:
            x = integrator.x
            driver.go(now, x)
            states[k], values[k] = x, instance.get(drive.read)
            if drive.gain is not None and drive.measurements is not None:
                integrator.correct(now, _correction(drive, k, values[k]))
            if k + 1 < n:
                integrator.advance(now, float(drive.time[k + 1]), k)
        except Refusal as problem:
            if problem.is_fatal:
                raise
            raise Stopped(str(problem), now) from problem
    return Recorded(values, states, integrator.n_events)


def _correction(drive: Drive, k: int, values: np.ndarray) -> np.ndarray:
    assert drive.measurements is not None and drive.gain is not None
    error = drive.measurements[k] - values[: drive.measurements.shape[1]]
    return drive.gain @ np.where(np.isfinite(error), error, 0.0)


class _Integrator:
    """CVODE (BDF) on the instance behind a `_Driver`."""

    def __init__(self, driver: _Driver, time: float) -> None:
        self._driver, self._instance = driver, driver.instance
        self.x = driver.instance.states()
        self.n_events = 0
        self._time = time
        self._solver: Any = None
        self._fresh = False
        self._repeats = 0
        self._deaf_length = 0.0
        self._last_root = -np.inf
        self._held = np.zeros(driver.instance.n_event_indicators)

    def correct(self, time: float, step: np.ndarray) -> None:
        if np.any(step != 0.0):
            self.x = self.x + step
            self._fresh = False

    def advance(self, time: float, end: float, interval: int) -> None:
        """Move `x` from `time` to `end`, through the events on the way."""
        instance, driver = self._instance, self._driver
        if (
            driver.is_held
            and interval
            and not np.array_equal(driver.drive.u0[interval], driver.drive.u0[interval - 1])
        ):
            self._fresh = False
        if driver.is_held and instance.n_event_indicators and not self._fresh:
            self._event(time, counted=False)
        events = steps = 0
        while end - time > SAME_TIME * max(abs(end), 1.0):
            target = end
            if instance.next_event is not None and instance.next_event < end:
                target = max(instance.next_event, time)
            reached, is_root = (time, False) if target <= time else self._integrate(time, target)
            time = reached
            driver.go(time, self.x)
            wants = instance.completed_step()
            steps += 1
            if steps > MOST_STEPS:
                raise Stopped(f"more than {MOST_STEPS} steps within one sample interval", time)
            is_time_event = instance.next_event is not None and instance.next_event <= time * (1 + SAME_TIME)
            if is_root or wants or is_time_event:
                events += 1
                if events > MOST_EVENTS:
                    raise Stopped(f"more than {MOST_EVENTS} events within one sample interval", time)
                if is_root:
                    self._state_event(time, end)
                else:
                    self._event(time)

    def _state_event(self, time: float, end: float) -> None:
        """Settle a state event; hear of none for a while where they change nothing and hold the time up:
        indicators of some FMUs (OpenModelica's of variables that no derivative needs), once changed, stay so
        until the next event, and seem to change as soon as they are asked."""
        is_same = time - self._last_root <= SAME_TIME * max(abs(time), 1.0) + 2 * self._deaf_length
        self._last_root = time
        before = self._motion(time) if is_same else None
        self._event(time)
        is_idle = before is not None and np.array_equal(before, self._motion(time))
        self._repeats = self._repeats + 1 if is_idle else 0
        doublings = self._repeats - HEARD_EVENTS
        self._deaf_length = min(DEAF_PART * 2.0**doublings, 1.0) * (end - time) if doublings >= 0 else 0.0
        if self._deaf_length:
            self._instance.take_indicators(ctypes.c_void_p(self._held.ctypes.data))

    def _motion(self, time: float) -> np.ndarray:
        """States and their derivatives."""
        self._driver.go(time, self.x)
        return np.concatenate([self.x, self._instance.rates()])

    def _event(self, time: float, counted: bool = True) -> None:
        instance, driver = self._instance, self._driver
        driver.go(time, self.x)
        instance.settle()
        driver.forget()
        self.x = instance.states()
        self._fresh = False
        self.n_events += int(counted)

    def _integrate(self, time: float, end: float) -> tuple[float, bool]:
        if not self._instance.n_states and not self._instance.n_event_indicators:
            return end, False
        if not self._fresh:
            self._restart(time)
        try:
            if self._instance.binary.reports_steps:
                is_root, reached = self._single_step(end)
            else:
                is_root, _, reached = self._solver.step(time, end)
        except Exception as error:
            problem, self._driver.problem = self._driver.problem, None
            self._fresh = False
            if problem is not None:
                raise problem from error
            raise Stopped(
                "the step size became too small: a singularity, an event that it does not tell, or a model "
                f"that is too stiff ({error})",
                time,
            ) from error
        if self._driver.problem is not None:  # the integrator has found a way round
            self._driver.problem = None
        if self._instance.n_states:
            self.x = np.ctypeslib.as_array(self._solver.px, (self._instance.n_states,)).copy()
        if not np.all(np.isfinite(self.x)):
            raise Stopped("a state is no finite number", time)
        return float(reached), bool(is_root)

    def _single_step(self, end: float) -> tuple[bool, float]:
        """One step of CVODE's own, not beyond `end`, for an FMU that wants to hear of every one; whether it
        ends with an event, and the time reached."""
        from fmpy.sundials.cvode import CV_ROOT_RETURN, CVode
        from fmpy.sundials.libraries import sundials_cvode

        solver, reached = self._solver, ctypes.c_double()
        sundials_cvode.CVodeSetStopTime(ctypes.c_void_p(solver.cvode_mem), ctypes.c_double(end))
        flag = CVode(solver.cvode_mem, end, solver.x, ctypes.byref(reached), _ONE_STEP)
        if flag < 0:
            raise RuntimeError(f"CVode error: {solver.error_info[3]}")
        return flag == CV_ROOT_RETURN, reached.value

    def _restart(self, time: float) -> None:
        if self._solver is not None:
            self._solver.reset(time)
        else:
            self._solver = self._made(time)
        self._fresh = True

    def _made(self, time: float) -> Any:
        from fmpy.sundials import CVodeSolver

        rtol = self._driver.drive.rtol
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
        self._keep(self._driver.move, time)

    def _get_states(self, pointer: Any, size: int) -> None:
        np.ctypeslib.as_array(pointer, (size,))[:] = self.x

    def _set_states(self, pointer: Any, size: int) -> None:
        self._keep(self._instance.put_states, pointer)

    def _get_nominals(self, pointer: Any, size: int) -> None:
        np.ctypeslib.as_array(pointer, (size,))[:] = ABSOLUTE_PART * self._instance.nominals()

    def _get_rates(self, pointer: Any, size: int) -> None:
        self._keep(self._driver.add_laws, self._time)
        if not self._keep(self._instance.take_rates, pointer):
            np.ctypeslib.as_array(pointer, (size,))[:] = np.nan

    def _get_indicators(self, pointer: Any, size: int) -> None:
        if self._time < self._last_root + self._deaf_length:
            np.ctypeslib.as_array(pointer, (size,))[:] = self._held
            return
        self._keep(self._driver.add_laws, self._time)
        # OpenModelica's indicators see what no derivative needs as it was when a variable was last read.
        self._keep(self._instance.get, self._instance.binary.states[:1])
        self._keep(self._instance.set_time, self._time)
        if not self._keep(self._instance.take_indicators, pointer):
            np.ctypeslib.as_array(pointer, (size,))[:] = np.nan

    def _keep(self, call: Callable[..., object], argument: Any) -> bool:
        if self._driver.problem is None:
            try:
                call(argument)
                return True
            except Refusal as problem:
                self._driver.problem = problem
        return False
