"""Run an FMU in a process of its own, with limits on time, memory and what it writes.

An FMU is foreign code: whatever it does ends in one message here, and never in this process.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from daest.errors import FmuError
from daest.files import follow_folder
from daest.fmu.archive import open_archive
from daest.fmu.drive import Drive
from daest.fmu.engine import Followed, Plan
from daest.fmu.instance import Binary
from daest.fmu.sandbox import VARIABLE, Walls, chosen_mode, end_marked, scrubbed
from daest.fmu.wire import read_message, write_message
from daest.model.fmu import FmuModel
from daest.numerics.compiler import native_platform

# Environment variables that change the limits.
SECONDS_VARIABLE, TOTAL_VARIABLE = "DAEST_FMU_SECONDS", "DAEST_FMU_TOTAL_SECONDS"
MEMORY_VARIABLE = "DAEST_FMU_MEMORY"
LOG_STATUS = 97
CUT_STATUS = 98
START_SECONDS = 60.0  # until the process of an FMU works, on a busy machine
WORD_SECONDS = 20.0  # between two words on an FMU that takes long
# Two answers to one question, relative to the largest value: solvers inside FMUs that begin from what they
# remember come within 1e-6, what is drawn at random does not.
SAME_ANSWER = 1e-4
SETTERS = ("fmi2SetReal", "fmi3SetFloat64")
DISCRETE = "it may be given values only at events, for it has the discrete inputs"
SHOWN_NAMES = 5
SHOWN_LOG = 500  # characters of what the FMU printed last


@dataclass(frozen=True)
class Limits:
    """`seconds` that a single call into the FMU may take, and `total` seconds that all requests to it may;
    `memory` of its process and `written` by it in bytes."""

    seconds: float = 60.0
    memory: int = 8 * 1024**3
    written: int = 64 * 1024**2
    total: float = 12 * 3600.0

    @classmethod
    def from_environment(cls) -> Limits:
        """The defaults, or what DAEST_FMU_SECONDS, DAEST_FMU_TOTAL_SECONDS and DAEST_FMU_MEMORY (in MB) say.
        FmuError `fmu-limit`."""
        seconds, total = _positive(SECONDS_VARIABLE, cls.seconds), _positive(TOTAL_VARIABLE, cls.total)
        return cls(seconds, int(_positive(MEMORY_VARIABLE, cls.memory / 1e6) * 1e6), total=total)


def _positive(variable: str, default: float) -> float:
    text = os.environ.get(variable)
    with contextlib.suppress(ValueError):
        value = default if text is None else float(text)
        if 0.0 < value < float("inf"):
            return value
    raise FmuError(
        "fmu-limit",
        f"{variable} is `{text}`, which is no positive number.",
        remedy=f"Write for example {variable}={default:g}, or leave it out.",
    )


@dataclass(frozen=True)
class Points:
    """Where a model is evaluated: values (m, len(set)) of the variables `set`, states (m, n_x) or (m, 0) to
    leave them, times (m,)."""

    set: tuple[int, ...]
    values: np.ndarray
    states: np.ndarray
    times: np.ndarray


@dataclass(frozen=True)
class Stop:
    """Why and when the simulation number `number` stopped."""

    reason: str
    time: float
    number: int


@dataclass(frozen=True)
class Simulated:
    """values (s, n, n_read) and states (s, n, n_x); NaN where a simulation stopped."""

    values: np.ndarray
    states: np.ndarray
    n_events: int
    stopped: Stop | None


@dataclass(frozen=True)
class Evaluated:
    """values (s, m, n_read + n_x): variables, then rates; NaN where the FMU refused, `problem` says why.
    `has_time_events`: the FMU announces an event after its initialisation."""

    values: np.ndarray
    problem: str | None = None
    has_time_events: bool = False


class Runner:
    """An FMU ready to answer; its process starts with the first request and stays for the next ones.

    Errors of all requests (FmuError): `fmu-without-binary`, `fmu-binary-not-loaded`, `fmu-call-failed`,
    `fmu-crashed`, `fmu-exited`, `fmu-hangs`, `fmu-too-long`, `fmu-memory`, `fmu-writes-too-much`; of
    simulations `fmu-not-repeatable`. After one of them the next request starts a new process.
    """

    def __init__(self, model: FmuModel, limits: Limits | None = None) -> None:
        self.model = model
        self.limits = limits or Limits.from_environment()
        self._process: _Process | None = None
        self._busy = Busy(model.path.name)
        self._n_compared = 0

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process and remove its folder."""
        if self._process is not None:
            self._process.close()
            self._process = None

    def evaluate(
        self,
        points: Points,
        read: Sequence[int],
        parameters: tuple[Sequence[int], np.ndarray] = ((), np.zeros((1, 0))),
        *,
        rates: bool = False,
        dae_mode: bool = False,
        settle: bool | Literal["each"] = False,
    ) -> Evaluated:
        """Values at every point for every row of parameter values (s, n_p). `settle`: discrete variables fit
        the first point, and stay so at the others; or fit each point, as far as they follow from it."""
        header = {"request": "evaluate", "read": list(read), "rates": rates}
        reply, tables = self._ask(
            {**header, **_mode(points, parameters, dae_mode, settle)}, _tables(points, parameters)
        )
        problem = reply["problem"] and in_words(self.model, reply["problem"])
        return Evaluated(tables["values"], problem, reply["has_time_events"])

    def hears_steps(self, points: Points, read: Sequence[int]) -> bool:
        """Whether steps that are completed at the points lead to an event, or change what the FMU answers."""
        header = {"request": "hear steps", "read": list(read), "rates": True}
        none: tuple[Sequence[int], np.ndarray] = ((), np.zeros((1, 0)))
        reply, _ = self._ask({**header, **_mode(points, none, False, False)}, _tables(points, none))
        return bool(reply["changes"])

    def differentiate(
        self,
        points: Points,
        unknowns: Sequence[int],
        knowns: Sequence[int],
        parameters: tuple[Sequence[int], np.ndarray] = ((), np.zeros((1, 0))),
        *,
        dae_mode: bool = False,
        settle: bool = False,
    ) -> np.ndarray:
        """The FMU's directional derivatives (s, m, n_unknown, n_known). Ask only where they are declared."""
        header = {"request": "differentiate", "unknowns": list(unknowns), "knowns": list(knowns)}
        _, tables = self._ask(
            {**header, **_mode(points, parameters, dae_mode, settle)}, _tables(points, parameters)
        )
        return tables["derivatives"]

    def simulate(
        self,
        drive: Drive,
        parameters: tuple[Sequence[int], np.ndarray],
        x0: np.ndarray | None = None,
        sizes: np.ndarray | None = None,
    ) -> Simulated:
        """One simulation per row of parameter values (s, n_p), with initial states x0 (s, n_x) (None: those
        of the FMU) and sizes (s, n_laws) of the laws (None: their own)."""
        names, values = parameters
        if sizes is None:
            sizes = np.tile([law.size for law in drive.laws], (len(values), 1))
        header = {
            "request": "simulate", "parameters": list(names), "inputs": list(drive.inputs),
            "read": list(drive.read), "laws": [asdict(law) for law in drive.laws], "rtol": drive.rtol,
            "fresh": x0 is None or self.model.kind != "exchange",
        }  # fmt: skip
        tables = {"parameters": values, "sizes": sizes, "time": drive.time, "u0": drive.u0, "u1": drive.u1,
                  "u_last": drive.u_last}  # fmt: skip
        optional = {"x0": x0, "bent": drive.bent, "measurements": drive.measurements, "gain": drive.gain}
        tables |= {name: table for name, table in optional.items() if table is not None}
        reply, found = self._ask(header, tables)
        if self._is_due():
            one = {"parameters": 1, "sizes": 1, "x0": 1}
            self._compare(header, {k: t[:1] if k in one else t for k, t in tables.items()}, found)
        stop = reply["stopped"]
        stopped = stop and Stop(in_words(self.model, stop["what"]), stop["time"], stop["set"])
        return Simulated(found["values"], found["states"], reply["n_events"], stopped)

    def follow(
        self, drive: Drive, parameters: tuple[Sequence[int], np.ndarray], x0: np.ndarray, plan: Plan
    ) -> Followed | Literal["gave up"] | None:
        """The trajectory from x0 (n_x,) by the compiled integrator, with the first row of the parameter
        values (1 + 2 n_moved, n_p); in the others parameters are moved up and down by the steps of `plan`.
        None where the FMU is none for it; "gave up" where it or the integrator did."""
        names, values = parameters
        header = {
            "request": "follow", "parameters": list(names), "inputs": list(drive.inputs),
            "read": list(drive.read), "laws": [], "rtol": drive.rtol, "library": plan.library,
            "most": plan.most, "has_slopes": plan.has_slopes,
        }  # fmt: skip
        tables = {"parameters": values, "time": drive.time, "u0": drive.u0, "u1": drive.u1,
                  "u_last": drive.u_last, "x0": x0}  # fmt: skip
        tables |= {"steps": plan.steps, "sizes": plan.sizes, "atol": plan.atol}
        tables |= {"laws": plan.laws, "law_sizes": plan.law_sizes}
        optional = {"bent": drive.bent, "measurements": drive.measurements, "gain": drive.gain}
        tables |= {name: table for name, table in optional.items() if table is not None}
        reply, found = self._ask(header, tables)
        if reply["followed"]:
            if self._is_due():
                self._compare(header, tables, found)
            return Followed(**found)
        return "gave up" if reply["gave_up"] else None

    def _is_due(self) -> bool:
        """Whether a simulation is repeated: the second, fourth, eighth ... one, so that a search hears of an
        FMU that answers at random, and a single simulation costs nothing more."""
        self._n_compared += 1
        return self._n_compared > 1 and self._n_compared & (self._n_compared - 1) == 0

    def _compare(
        self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]
    ) -> None:
        """Ask again. Raises FmuError `fmu-not-repeatable` where the answers differ by more than a solver
        inside the FMU may make them."""
        _, again = self._ask(header, arrays)
        for name in ("values", "states"):
            if name not in again:
                raise self._not_repeatable("one time it can be followed, another time it cannot")
            first, second = found[name][: len(again[name])], again[name]
            scale = np.nanmax(np.abs(first), axis=tuple(range(first.ndim - 1)), initial=0.0)
            with np.errstate(invalid="ignore"):
                differs = ~(np.abs(first - second) <= SAME_ANSWER * scale) & ~(first == second)
            differs &= ~(np.isnan(first) & np.isnan(second))
            if np.any(differs):
                place = tuple(np.argwhere(differs)[0])
                raise self._not_repeatable(f"{first[place]:.6g} and {second[place]:.6g} for the same {name}")

    def _not_repeatable(self, what: str) -> FmuError:
        return FmuError(
            "fmu-not-repeatable",
            f"The FMU answers otherwise when it is asked the same again: {what}.",
            where=str(self.model.path),
            remedy="It may draw random numbers, or keep something between instances: fix the seed, or export "
            "it without noise.",
        )

    def _ask(
        self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        is_used = self._process is not None
        try:
            return self._answered(header, arrays)
        except FmuError as error:
            # Some FMUs wear out: what crashes after thousands of instances runs in a new process.
            if not is_used or error.code not in ("fmu-crashed", "fmu-exited", "fmu-memory"):
                raise
            return self._answered(header, arrays)

    def _answered(
        self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        if self._process is None:
            self._process = _Process(self.model, self.limits, self._busy)
        try:
            with self._busy:
                return self._process.ask(header, arrays)
        except BaseException:
            self.close()
            raise


@contextlib.contextmanager
def running(model: FmuModel, runner: Runner | None) -> Iterator[Runner]:
    """`runner`, or one of its own that ends with the block: a process starts slower than it answers."""
    if runner is not None:
        yield runner
        return
    with Runner(model) as own:
        yield own


def _mode(
    points: Points,
    parameters: tuple[Sequence[int], np.ndarray],
    dae_mode: bool,
    settle: bool | Literal["each"],
) -> dict:
    return {
        "set": list(points.set),
        "parameters": list(parameters[0]),
        "dae_mode": dae_mode,
        "settle": settle,
    }


def _tables(points: Points, parameters: tuple[Sequence[int], np.ndarray]) -> dict[str, np.ndarray]:
    return {
        "parameters": parameters[1],
        "points": points.values,
        "states": points.states,
        "times": points.times,
    }


class Busy:
    """The time that requests to an FMU take, all together. Who listens hears of it from time to time."""

    def __init__(self, name: str) -> None:
        self._name, self._before, self._began = name, 0.0, 0.0
        self._n_requests, self._told = 0, 0.0

    def __enter__(self) -> None:
        self._began = time.monotonic()
        self._n_requests += 1

    def __exit__(self, *_: object) -> None:
        self._before = self.seconds
        self.tell()
        self._began = 0.0

    @property
    def seconds(self) -> float:
        return self._before + (time.monotonic() - self._began if self._began else 0.0)

    def tell(self) -> None:
        """A word where there has been none for a while."""
        if self.seconds - self._told > WORD_SECONDS:
            self._told = self.seconds
            listeners.tell(f"{self._name} has worked {self.seconds:.0f} s, on {self._n_requests} requests")


class _Listeners:
    """Who hears of FMUs that take long; nobody, until a command listens."""

    def __init__(self) -> None:
        self.tell: Callable[[str], None] = lambda _: None


listeners = _Listeners()


@dataclass
class _Heard:
    """What the worker said last about what it is doing."""

    stage: str = "was loaded"
    time: float | None = None
    is_there: bool = False
    walls: Walls = field(default_factory=Walls)
    replies: queue.SimpleQueue = field(default_factory=queue.SimpleQueue)

    def doing(self) -> str:
        return self.stage if self.time is None else f"{self.stage} (t = {self.time:g} s)"


def in_words(model: FmuModel, problem: str) -> str:
    """What an FMU refused, with the reason where it is known better than the FMU tells it."""
    names = [model.variables[vr].name for vr in model.inputs if model.variables[vr].variability == "discrete"]
    if not names or not problem.startswith(SETTERS) or model.kind != "exchange":
        return problem
    return f"{problem}; {DISCRETE} {', '.join(f'`{name}`' for name in names[:SHOWN_NAMES])}"


def refused(model: FmuModel, problem: str) -> FmuError:
    """The error of a call that the FMU refused, in words of `in_words`."""
    remedy = "Choose parameter values, inputs and an operating point where the model can be evaluated."
    if DISCRETE in problem:
        remedy = (
            "Inputs of daest change at any time: export the FMU with continuous inputs, or for Co-Simulation."
        )
    return FmuError("fmu-call-failed", f"The FMU refused {problem}.", where=str(model.path), remedy=remedy)


class _Process:
    """A worker with the unpacked FMU in a temporary folder."""

    def __init__(self, model: FmuModel, limits: Limits, busy: Busy) -> None:
        self._model, self._limits, self._busy = model, limits, busy
        self._mode = chosen_mode()
        self._folder = tempfile.TemporaryDirectory(prefix="daest-fmu-", ignore_cleanup_errors=True)
        root = Path(self._folder.name)
        follow_folder(root, True)
        try:
            binary = unpacked_binary(model, root / "fmu")
            log = root / "printed.log"
            self._log = log.open("w+b")  # kept open: the FMU may put something else in its place
            more = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1",
                    "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}  # fmt: skip
            self._child = subprocess.Popen(
                [sys.executable, "-m", "daest.fmu.worker", str(log)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                cwd=root, env=scrubbed(root, more), start_new_session=True,
            )  # fmt: skip
        except BaseException:
            self._folder.cleanup()
            follow_folder(root, False)
            raise
        self._heard = _Heard()
        self._close = weakref.finalize(self, _end, self._child, self._folder, self._log, self._heard)
        threading.Thread(target=_listen, args=(self._child.stdout, self._heard.replies), daemon=True).start()
        opening = {"binary": asdict(binary), "memory": limits.memory, "written": limits.written}
        self._write({**opening, "sandbox": self._mode}, {})

    def close(self) -> None:
        self._close()

    def ask(
        self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        self._write(header, arrays)
        first = self._limits.seconds if self._heard.is_there else max(self._limits.seconds, START_SECONDS)
        deadline = time.monotonic() + first
        while True:
            self._busy.tell()
            left = self._limits.total - self._busy.seconds
            if left <= 0.0:
                raise self._too_long()
            try:
                reply = self._heard.replies.get(timeout=max(min(deadline - time.monotonic(), left), 0.001))
            except queue.Empty:
                if time.monotonic() < deadline:
                    continue
                raise self._hangs() from None
            if reply is None:
                raise self._died()
            told, tables = reply
            self._heard.is_there = True
            if told["kind"] == "walls":
                self._built(told)
            elif told["kind"] == "beat":
                deadline = time.monotonic() + self._limits.seconds
            elif told["kind"] == "alive":
                deadline = time.monotonic() + self._limits.seconds
                self._heard.stage, self._heard.time = told["stage"], told["time"]
            elif told["kind"] == "done":
                return told, tables
            else:
                raise self._memory() if told["kind"] == "memory" else self._refused(told["what"])

    def _write(self, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        assert self._child.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # its end is told where the reply is awaited
            write_message(self._child.stdin, header, arrays)  # type: ignore[arg-type]

    def _built(self, told: Mapping[str, Any]) -> None:
        """The walls stand before the FMU is loaded. Raises FmuError `fmu-sandbox` where some are missing and
        all are wanted."""
        self._heard.walls = Walls(**{f.name: told[f.name] is True for f in fields(Walls)})
        if self._mode == "require" and not self._heard.walls.are_whole:
            raise FmuError(
                "fmu-sandbox",
                f"{VARIABLE} asks for all walls around an FMU; here {self._heard.walls.sentence()}.",
                where=str(self._model.path),
                remedy=f"Use a newer Linux, or leave {VARIABLE} out if the FMU is trusted.",
            )

    # --------------------------------------------------------------------------------------- endings

    def _refused(self, what: str) -> FmuError:
        if self._heard.stage == "was loaded":
            return FmuError(
                "fmu-binary-not-loaded",
                f"The binary of the FMU cannot be used: {what}.",
                where=str(self._model.path),
                remedy="It may need a library that is missing here; export the FMU for this platform again.",
            )
        if what.startswith("instantiate"):
            remedy = (
                "It may need a licence, a network or files of the tool that wrote it: export it to run "
                f"without, or set {VARIABLE}=off if it is trusted."
            )
            return FmuError(
                "fmu-call-failed", f"The FMU refused {what}.", where=str(self._model.path), remedy=remedy
            )
        return refused(self._model, in_words(self._model, what))

    def _hangs(self) -> FmuError:
        seconds = self._limits.seconds
        return self._error(
            "fmu-hangs",
            f"The FMU did not come back within {seconds:g} s when it {self._heard.doing()}, and was stopped.",
            f"Set {SECONDS_VARIABLE} to more seconds if it only is slow; else report it to the tool that "
            "wrote the FMU.",
        )

    def _too_long(self) -> FmuError:
        total = self._limits.total
        return self._error(
            "fmu-too-long",
            f"The FMU has worked for {total:g} s in all, and was stopped when it {self._heard.doing()}.",
            f"Set {TOTAL_VARIABLE} to more seconds to let it go on; a shorter or coarser recording "
            "(--to, --resample) takes less time.",
        )

    def _memory(self) -> FmuError:
        return self._error(
            "fmu-memory",
            f"The FMU needs more than {self._limits.memory / 1e6:.0f} MB of memory when it "
            f"{self._heard.doing()}.",
            f"Set {MEMORY_VARIABLE} (in MB) to allow more.",
        )

    def _died(self) -> FmuError:
        status, peak = _status_and_peak(self._child)
        doing = self._heard.doing()
        if status == CUT_STATUS:
            return self._error(
                "fmu-exited",
                f"The FMU cut its process off when it {doing}: it closed files that it did not open.",
                "Report it to the tool that wrote the FMU.",
            )
        report = "Report it to the tool that wrote the FMU; try other parameter values or inputs."
        if status == LOG_STATUS or -status == getattr(signal, "SIGXFSZ", 0):
            return self._error(
                "fmu-writes-too-much",
                f"The FMU logged or wrote more than {self._limits.written / 1e6:.0f} MB when it {doing}, and "
                "was stopped.",
                report,
            )
        if status >= 0 and peak < 0.8 * self._limits.memory:
            return self._error(
                "fmu-exited", f"The FMU ended its process (exit status {status}) when it {doing}.", report
            )
        if peak >= 0.8 * self._limits.memory:
            return self._memory()
        try:
            name = signal.Signals(-status).name
        except ValueError:
            name = f"signal {-status}"
        return self._error("fmu-crashed", f"The FMU crashed ({name}) when it {doing}.", report)

    def _error(self, code: str, what: str, remedy: str) -> FmuError:
        printed = _tail(self._log)
        return FmuError(
            code, f"{what} It printed last: {printed}" if printed else what,
            where=str(self._model.path), remedy=remedy,
        )  # fmt: skip


def _listen(stream: Any, replies: queue.SimpleQueue) -> None:
    """Hand on the replies; None at the end, also when what comes is no message."""
    with contextlib.suppress(EOFError, ValueError, KeyError, TypeError, OSError):
        while True:
            replies.put(read_message(stream))
    replies.put(None)


def _status_and_peak(child: subprocess.Popen) -> tuple[int, int]:
    """Exit status (negative: signal) and the largest resident memory in bytes of a process that ended."""
    before = _children_peak()
    try:
        status = child.wait(timeout=5.0)
    except subprocess.TimeoutExpired:
        child.kill()
        status = child.wait()
    after = _children_peak()
    return status, after if after > before else 0


def _children_peak() -> int:
    with contextlib.suppress(ImportError):
        import resource

        unit = 1 if sys.platform == "darwin" else 1024
        return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * unit
    return 0


def _tail(stream: BinaryIO) -> str:
    try:
        stream.seek(max(0, os.fstat(stream.fileno()).st_size - SHOWN_LOG))
        text = stream.read(SHOWN_LOG).decode("utf-8", "replace")
    except (OSError, ValueError):
        return ""
    words = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return words[-SHOWN_LOG:]


def _end(child: subprocess.Popen, folder: tempfile.TemporaryDirectory, log: BinaryIO, heard: _Heard) -> None:
    """Kill the worker and what it may have started, and remove the folder."""
    with contextlib.suppress(OSError, AttributeError):
        os.killpg(child.pid, signal.SIGKILL)
    with contextlib.suppress(OSError):
        child.kill()
    child.wait()
    if not heard.walls.processes:
        end_marked(folder.name)
    for stream in (child.stdin, child.stdout, log):
        with contextlib.suppress(OSError, AttributeError):
            stream.close()  # type: ignore[union-attr]
    folder.cleanup()
    follow_folder(Path(folder.name), False)


# ------------------------------------------------------------------------------------------------- unpacking


def unpacked_binary(model: FmuModel, folder: Path) -> Binary:
    prefix = binary_folder(model)
    with open_archive(model.path) as archive:
        archive.unpack(folder, (prefix, "resources/"))
    (folder / "resources").mkdir(parents=True, exist_ok=True)
    manifest = model.manifest
    return Binary(
        folder=str(folder),
        identifier=model.model_identifier,
        token=model.token,
        fmi_major=int(model.fmi_version[0]),
        kind=model.kind,
        states=model.states,
        n_event_indicators=model.n_event_indicators,
        reports_steps=model.reports_steps,
        enable=None if manifest is None else manifest.enable,
        only_once=model.only_once,
    )


def binary_folder(model: FmuModel) -> str:
    """`binaries/<platform>/` of this machine. FmuError `fmu-without-binary`."""
    here = native_platform()
    fmi2_names = {"linux": "linux64", "windows": "win64", "darwin": "darwin64"}
    system = here.tuple_name.rpartition("-")[2]
    name = here.tuple_name if model.fmi_version.startswith("3") else fmi2_names[system]
    if name in model.platforms:
        return f"binaries/{name}/"
    has = f"it has {', '.join(model.platforms)}" if model.platforms else "it has none at all"
    raise FmuError(
        "fmu-without-binary",
        f"The FMU has no binary for this platform ({name}); {has}.",
        where=str(model.path),
        remedy=f"Export it again for this platform ({here.short_name}).",
    )
