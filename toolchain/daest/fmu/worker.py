"""The process that runs an FMU: `python -m daest.fmu.worker LOG`, spoken to by `fmu.runner`.

Whatever the FMU does (crash, hang, exit, print without end) happens here. What it prints goes to the file
LOG, whose size is limited; requests and answers go over the original standard input and output.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from daest.fmu.drive import Drive, Law
from daest.fmu.engine import Followed, Plan, follow
from daest.fmu.instance import CALLS, Binary, Instance, Log, Refusal
from daest.fmu.sandbox import Walls, confine
from daest.fmu.trajectory import Recorded, Stopped, run
from daest.fmu.wire import read_message, write_message

# Exit status of a worker whose FMU logged too much.
LOG_STATUS = 97
# And of one whose FMU closed the pipes to the caller.
CUT_STATUS = 98
# The caller hears at most this often that the work goes on.
ALIVE_SECONDS = 0.2
# Points at which an instance that has heard of steps is compared with a new one, and the difference, relative
# to the largest value among them, beyond which it remembers: above the error of a solver inside the FMU.
HISTORY_POINTS = 4
SAME_ANSWER = 1e-6


def main() -> None:
    requests, replies = _private_streams(sys.argv[1])
    opening, _ = read_message(requests)
    _limit(opening["memory"], opening["written"])
    write_message(replies, {"kind": "walls", **asdict(_walls(opening["sandbox"]))})
    session = Session(
        Binary(**{**opening["binary"], "states": tuple(opening["binary"]["states"])}),
        opening["written"],
        replies,
    )
    try:
        while True:
            header, arrays = read_message(requests)
            session.answer(header, arrays)
    except EOFError:
        os._exit(0)  # without the FMU's own code that runs at exit
    except OSError:  # the pipes are gone
        os._exit(CUT_STATUS)


def _walls(mode: str) -> Walls:
    """Confine this process to its folder, once all is there that starts programs or makes threads."""
    import fmpy.fmi2
    import fmpy.fmi3  # noqa: F401 - what takes time here is none of the FMU's

    return Walls() if mode == "off" else confine(Path.cwd())


def _private_streams(log: str) -> tuple[BinaryIO, BinaryIO]:
    """The pipes to the caller, out of reach of an FMU that prints or reads."""
    requests, replies = os.dup(0), os.dup(1)
    nothing = os.open(os.devnull, os.O_RDONLY)
    written = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(nothing, 0)
    os.dup2(written, 1)
    os.dup2(written, 2)
    return os.fdopen(requests, "rb"), os.fdopen(replies, "wb")


def _limit(memory: int, written: int) -> None:
    """Bounds that the system keeps, where it can: address space, size of files, no core dumps."""
    if hasattr(signal, "SIGXFSZ"):  # which Python ignores: writing would fail, and the FMU go on
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
    with contextlib.suppress(ImportError):
        import resource

        for name, value in (("RLIMIT_CORE", 0), ("RLIMIT_FSIZE", written), ("RLIMIT_AS", memory)):
            with contextlib.suppress(ValueError, OSError, AttributeError):
                resource.setrlimit(getattr(resource, name), (value, value))
    if sys.platform.startswith("linux"):
        import ctypes

        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: no orphan in an endless loop


class Session:
    """One FMU, with the instance that answered last."""

    def __init__(self, binary: Binary, log_limit: int, replies: BinaryIO) -> None:
        self._binary, self._replies = binary, replies
        self._log = Log(log_limit, lambda: os._exit(LOG_STATUS))
        self._instance: Instance | None = None
        self._moved: list[Instance] = []  # instances with moved parameters
        self._remembers: bool | None = None  # not known yet
        self._kept: Any = None  # what the instance was started with, while nothing has changed it
        self._told = 0.0
        self._writing = threading.Lock()
        threading.Thread(target=self._beat, daemon=True).start()

    def answer(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """One request, one reply: results, or why there are none. Shapes of the arrays are those of the
        request's function."""
        work = {
            "evaluate": self._evaluate,
            "hear steps": self._hear_steps,
            "differentiate": self._differentiate,
            "simulate": self._simulate,
            "follow": self._follow,
        }
        try:
            reply, tables = work[header["request"]](header, arrays)
            self._send({"kind": "done", **reply}, tables)
        except Refusal as problem:
            self._kept = None
            self._send({"kind": "refused", "what": str(problem)})
        except MemoryError:
            self._kept = None
            self._send({"kind": "memory"})

    def _send(self, header: Mapping[str, Any], tables: Mapping[str, np.ndarray] | None = None) -> None:
        with self._writing:
            write_message(self._replies, header, tables)

    def _beat(self) -> None:
        """Tell the caller that calls into the FMU come back, however many a step of the simulation needs."""
        last = CALLS.all
        while True:
            time.sleep(ALIVE_SECONDS)
            now = CALLS.all
            if now != last:
                with contextlib.suppress(OSError):  # found where the next answer is sent
                    self._send({"kind": "beat"})
            last = now

    def _alive(self, stage: str, at: float | None = None) -> None:
        now = time.monotonic()
        if now - self._told > ALIVE_SECONDS:
            self._told = now
            self._send({"kind": "alive", "stage": stage, "time": at})

    def _stage(self, stage: str) -> None:
        self._send({"kind": "alive", "stage": stage, "time": None})

    def _loaded(self) -> Instance:
        if self._instance is None:
            self._stage("was loaded")
            self._instance = Instance(self._binary, self._log)
        return self._instance

    def _started(
        self,
        header: Mapping[str, Any],
        values: np.ndarray,
        time: float,
        dae_mode: bool = False,
        inputs: tuple[Sequence[int], np.ndarray] = ((), np.zeros(0)),
    ) -> Instance:
        """The instance with parameter `values`, as it is after its initialisation."""
        key = (header["request"] in ("simulate", "follow"), tuple(values), time, dae_mode, tuple(inputs[1]))
        instance = self._loaded()
        if self._kept != key:
            self._kept = None
            self._stage("was initialised")
            instance.start((header["parameters"], values), time, dae_mode, inputs)
            self._kept = key
        return instance

    # ------------------------------------------------------------------------------------- requests

    def _evaluate(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> tuple[dict, dict]:
        """Values at points: parameters (s, n_p), points (m, n_set), states (m, n_x), times (m,) -> values
        (s, m, n_read + n_x), NaN where the FMU refuses a point; the first refusal in words, and whether time
        events are announced."""
        sets, points, states, times = (arrays[k] for k in ("parameters", "points", "states", "times"))
        n_rates = len(self._binary.states) if header["rates"] else 0
        values = np.full((len(sets), len(times), len(header["read"]) + n_rates), np.nan)
        problem, timed = None, False
        for s, parameters in enumerate(sets):
            instance, first = self._started(header, parameters, 0.0, header["dae_mode"]), 0
            for m in range(len(times)):
                self._alive("was evaluated")
                try:
                    settle = header["settle"] and (m == first or header["settle"] == "each")
                    values[s, m] = _values_at(instance, header, points[m], states[m], times[m], settle)
                except Refusal as refusal:
                    if refusal.is_fatal:
                        raise
                    problem = problem or str(refusal)
                    if refusal.stays and m + 1 < len(times):
                        self._kept = None
                        instance = self._started(header, parameters, 0.0, header["dae_mode"])
                        first = m + 1
            timed = timed or instance.next_event is not None
        if header["settle"]:
            self._kept = None  # its discrete variables belong to the first point
        return {"problem": problem, "has_time_events": timed}, {"values": values}

    def _hear_steps(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> tuple[dict, dict]:
        """Whether completed steps at points (m, n_set), states (m, n_x), times (m,) lead to an event, or
        change what is answered at the last of them."""
        points, states, times = (arrays[k] for k in ("points", "states", "times"))
        instance = self._started(header, np.zeros(0), 0.0)
        changes = False
        for point, x, time_ in zip(points, states, times, strict=True):
            last = _values_at(instance, header, point, x, time_, False)
            changes = changes or instance.completed_step()
        self._kept = None
        instance = self._started(header, np.zeros(0), 0.0)
        fresh = _values_at(instance, header, points[-1], states[-1], times[-1], False)
        sizes = np.maximum(np.abs(last), np.abs(fresh))
        changes = changes or bool(np.any(np.abs(last - fresh) > SAME_ANSWER * sizes))
        return {"changes": changes}, {}

    def _differentiate(
        self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> tuple[dict, dict]:
        """Directional derivatives at points, arguments as `_evaluate`: (s, m, n_unknown, n_known)."""
        sets, points, states, times = (arrays[k] for k in ("parameters", "points", "states", "times"))
        found = np.full((len(sets), len(times), len(header["unknowns"]), len(header["knowns"])), np.nan)
        for s, parameters in enumerate(sets):
            instance = self._started(header, parameters, 0.0, header["dae_mode"])
            for m in range(len(times)):
                settle = header["settle"] and m == 0
                _values_at(
                    instance, {**header, "read": [], "rates": False}, points[m], states[m], times[m], settle
                )
                for column, known in enumerate(header["knowns"]):
                    self._alive("was differentiated")
                    found[s, m, :, column] = instance.directional(header["unknowns"], known)
        if header["settle"]:
            self._kept = None
        return {}, {"derivatives": found}

    def _simulate(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> tuple[dict, dict]:
        """Simulations: parameters (s, n_p), x0 (s, n_x) or none, sizes of laws (s, n_laws) -> values (s, n,
        n_read), states (s, n, n_x), NaN where one stopped; the first stop in words with its time."""
        sets, starts, sizes = arrays["parameters"], arrays.get("x0"), arrays["sizes"]
        n, n_x = arrays["time"].size, len(self._binary.states)
        values, states = (
            np.full((len(sets), n, len(header["read"])), np.nan),
            np.full((len(sets), n, n_x), np.nan),
        )
        events, stopped = 0, None
        for s, parameters in enumerate(sets):
            drive = _drive(header, arrays, sizes[s])
            inputs = (header["inputs"], drive.first_inputs())
            if header["fresh"]:
                self._kept = None
            try:
                instance = self._started(header, parameters, float(drive.time[0]), False, inputs)
                clean = self._kept
                self._kept = None
                x0 = None if starts is None else starts[s]
                found = run(instance, drive, x0, lambda now: self._alive("was simulated", now))
                values[s], states[s] = found.values, found.states
                events += found.n_events
                self._kept = clean if self._is_memoryless(found, starts) else None
            except Stopped as stop:
                stopped = stopped or {"what": str(stop), "time": stop.time, "set": s}
                self._kept = None
        return {"stopped": stopped, "n_events": events}, {"values": values, "states": states}

    def _follow(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> tuple[dict, dict]:
        """One trajectory by the compiled integrator: parameters (1 + 2 n_moved, n_p), those of the solution
        and the moved ones, x0 (n_x,) -> values (n, n_y), states (n, n_x), slopes (n, n_y, n_moved + n_x).
        Nothing where the FMU has events after all or remembers more than its states, where its instances
        disturb each other, or where it or the integrator gives up."""
        nothing: tuple[dict, dict] = {"followed": False, "gave_up": False}, {}
        steps, sizes, atol = (arrays[name] for name in ("steps", "sizes", "atol"))
        plan = Plan(
            header["library"], steps, sizes, atol, int(header["most"]), header["has_slopes"],
            arrays["laws"], arrays["law_sizes"],
        )  # fmt: skip
        drive, sets, x0 = _drive(header, arrays, np.zeros(0)), arrays["parameters"], arrays["x0"]
        inputs = (header["inputs"], drive.first_inputs())
        first = self._started(header, sets[0], float(drive.time[0]), False, inputs)
        clean, self._kept = self._kept, None
        if first.n_event_indicators or first.next_event is not None or (plan.has_slopes and self._remembers):
            return nothing
        try:
            others = self._all_moved(header, sets[1:], drive, x0, inputs) if plan.has_slopes else []
            found = None if others is None else follow(
                (first, *others), drive, x0, plan, lambda now: self._alive("was simulated", now)
            )  # fmt: skip
            if found is None:
                return {"followed": False, "gave_up": others is not None}, {}
            if plan.has_slopes and self._is_history(header, sets[0], drive, found, inputs):
                return nothing
        except Refusal as problem:
            if problem.is_fatal:
                raise
            return nothing
        self._kept = None if self._binary.reports_steps else clean
        return {"followed": True}, {"values": found.values, "states": found.states, "slopes": found.slopes}

    def _is_history(
        self, header: Mapping[str, Any], parameters: np.ndarray, drive: Drive, found: Followed, inputs: Any
    ) -> bool:
        """Whether the answers of an FMU that hears of steps depend on those it has heard of, as the answers
        of a delay do: a new instance then answers otherwise at points of the solution. Asked once."""
        if self._remembers is None and self._binary.reports_steps:
            assert self._instance is not None
            new = Instance(self._binary, self._log)
            new.start((header["parameters"], parameters), float(drive.time[0]), False, inputs)
            chosen = np.unique(np.linspace(0, drive.time.size - 1, HISTORY_POINTS + 1).astype(int)[1:])
            old, fresh = (
                np.array([_answers(one, drive, k, found.states[k]) for k in chosen])
                for one in (self._instance, new)
            )
            new.free()
            sizes = np.max(np.abs(old), axis=0, initial=0.0)
            self._remembers = not bool(np.all(np.abs(old - fresh) <= SAME_ANSWER * sizes))
        return bool(self._remembers)

    def _all_moved(
        self, header: Mapping[str, Any], sets: np.ndarray, drive: Drive, x0: np.ndarray, inputs: Any
    ) -> list[Instance] | None:
        """Instances with the moved parameters `sets`; None where they change what the first one answers, as
        those of a binary do that keeps its values in one place for all. Raises Refusal."""
        assert self._instance is not None
        while len(self._moved) < len(sets):
            self._moved.append(Instance(self._binary, self._log))
        chosen = self._moved[: len(sets)]
        before = _answers(self._instance, drive, 0, x0)
        for instance, parameters in zip(chosen, sets, strict=True):
            self._alive("was initialised")
            instance.start((header["parameters"], parameters), float(drive.time[0]), False, inputs)
            _answers(instance, drive, 0, x0)
        if np.array_equal(before, _answers(self._instance, drive, 0, x0)):
            return chosen
        for instance in self._moved:
            instance.free()
        return None

    def _is_memoryless(self, found: Recorded, starts: np.ndarray | None) -> bool:
        """The instance can be used again: its state is all that it remembers, and will be given."""
        binary = self._binary
        indicators = self._instance.n_event_indicators if self._instance else 1
        return (
            starts is not None
            and binary.kind == "exchange"
            and not (indicators or found.n_events or binary.reports_steps)
        )


def _values_at(
    instance: Instance,
    header: Mapping[str, Any],
    point: np.ndarray,
    states: np.ndarray,
    time: float,
    settle: bool,
) -> np.ndarray:
    """Variables, then rates. Time is set last, and variables are read first: in some tools outputs that alias
    states are stale after the derivatives have been read."""

    def go() -> None:
        instance.set_time(float(time))
        instance.set(header["set"], point)
        if states.size:
            instance.set_states(states)
        instance.set_time(float(time))

    go()
    if settle:
        instance.settle()
        go()
    values = instance.get(header["read"])
    return np.concatenate([values, instance.rates()]) if header["rates"] else values


def _answers(instance: Instance, drive: Drive, k: int, x: np.ndarray) -> np.ndarray:
    """What is read, and the rates, at sample k in the state x."""
    header = {"set": drive.inputs, "read": drive.read, "rates": True}
    u = drive.u0[k] if k < len(drive.u0) else drive.u_last
    return _values_at(instance, header, u[: len(drive.inputs)], x, float(drive.time[k]), False)


def _drive(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], sizes: np.ndarray) -> Drive:
    laws = tuple(
        Law(tuple(map(tuple, law["program"])), law["input"], law["reads"], law["column"], float(size))
        for law, size in zip(header["laws"], sizes, strict=True)
    )
    return Drive(
        time=arrays["time"],
        inputs=tuple(header["inputs"]),
        u0=arrays["u0"],
        u1=arrays["u1"],
        u_last=arrays["u_last"],
        read=tuple(header["read"]),
        laws=laws,
        bent=arrays.get("bent"),
        measurements=arrays.get("measurements"),
        gain=arrays.get("gain"),
        rtol=header["rtol"],
    )


if __name__ == "__main__":
    main()
