"""Workers: independent tasks one after the other, in processes of this machine, or on a Dask cluster.

A task is a function of a module and one argument; both are sent as bytes, CasADi expressions included. Every
task runs with one thread of linear algebra wherever it runs, so that the results are equal to the last bit on
equal machines; another processor may round otherwise.
"""

from __future__ import annotations

import hashlib
import logging
import math
import multiprocessing
import os
import pickle
import platform
import signal
import sys
import threading
import time
import traceback
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    ProcessPoolExecutor,
    wait,
)
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import Any, Generic, Protocol, TypeVar

import casadi as ca

import daest
from daest.errors import ConfigError, DaestError
from daest.files import die_with_parent
from daest.machine import version
from daest.numerics import deadline
from daest.numerics.compiler import find_compiler
from daest.numerics.threads import one_thread

START_SECONDS = 3.0  # until new processes work: tasks that would gain less run one after the other
COPY_SECONDS = 0.2  # until copies of this process work
MOST_LOSSES = 3  # workers lost one after the other, without a result in between, that end a run
CONNECT_SECONDS = 10.0
PATIENCE = 120.0  # seconds that a cluster may be without any worker
POLL = 5.0
SETTLED = ("finished", "error", "cancelled")  # what a task of a cluster is when it is done
RETRY = 0.05  # after which it is asked again what became of a lost task [s]
AHEAD = 2  # tasks that a cluster has at a time, for each thread of its workers
LARGE = "1 GiB"  # of tasks, before Dask warns: each holds the recordings
SOURCES = (".py", ".c", ".h")  # what decides numbers
PACKAGES = ("casadi", "numpy", "scipy")  # those that numbers depend on

Task = TypeVar("Task")
Result = TypeVar("Result")
Versions = dict[str, str]


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """The outcome of a task: its `value`, or the `error` that it raised."""

    value: Result | None = None
    error: Exception | None = None

    def get(self) -> Result:
        """The value; raises the error."""
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]


class Engine(Protocol):
    """Runs pickled work on pickled tasks and yields pickled outcomes with their numbers as they arrive."""

    def gain(self, n_tasks: int, seconds: float) -> float:
        """Seconds that this engine saves where each task takes `seconds`."""

    def begin(self, work: bytes, blobs: Sequence[bytes]) -> bool:
        """Begin tasks, of which `arrivals` takes those that are the same objects as here. Whether it does
        that."""

    def arrivals(self, work: bytes, blobs: Sequence[bytes]) -> Generator[tuple[int, bytes]]: ...


@dataclass(frozen=True)
class Workers:
    """A pool that runs tasks. `engine` None: the tasks run in this process. `begun` are tasks with their
    bytes, by their identity."""

    engine: Engine | None = None
    begun: dict[int, tuple[Any, bytes]] = field(default_factory=dict)

    def begin(
        self, work: Callable[[Task], Result], tasks: Sequence[Task], *, seconds: float = math.inf
    ) -> None:
        """Begin tasks beside what this process does next, where that saves time: `map` over the same objects
        then takes what has become of them. Raises DaestError `task-not-sendable`."""
        if self.engine is None or self.engine.gain(len(tasks) + 1, seconds) <= 0.0:
            return
        blobs = [packed(task) for task in tasks]
        if self.engine.begin(packed(work), blobs):
            self.begun.update({id(task): (task, blob) for task, blob in zip(tasks, blobs, strict=True)})

    def map(
        self,
        work: Callable[[Task], Result],
        tasks: Sequence[Task],
        *,
        seconds: float = math.inf,
        arrived: Callable[[int, Outcome[Result]], object] = lambda _number, _outcome: None,
    ) -> Iterator[Outcome[Result]]:
        """Yield the outcomes of `work` over the tasks in the order of the tasks, each as soon as it and all
        before it have arrived. `arrived` is called with the number and the outcome of every task at once. An
        error in one task does not affect the others. Closing the iterator cancels the remaining tasks.

        `seconds` is the expected duration of one task; where workers would save no time, the tasks run in
        this process. Raises OutOfTimeError at the deadline, which workers do not know of, and
        DaestError `worker-lost`, `task-not-sendable` and ConfigError `cluster-differs`, `cluster-lost`.
        """
        known = [self.begun.pop(id(task), None) for task in tasks]
        if self.engine is None or (not any(known) and self.engine.gain(len(tasks), seconds) <= 0.0):
            for number, task in enumerate(tasks):
                deadline.check()
                here = outcome_of(work, task)
                arrived(number, here)
                yield here
            return
        waiting: dict[int, Outcome[Result]] = {}
        following = 0
        blobs = [one[1] if one else packed(task) for one, task in zip(known, tasks, strict=True)]
        with closing(self.engine.arrivals(packed(work), blobs)) as arrivals:
            for number, blob in arrivals:
                waiting[number] = unpacked(blob)
                arrived(number, waiting[number])
                while following in waiting:
                    yield waiting.pop(following)
                    following += 1


def done_by(
    pool: Workers,
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    ends: float,
    *,
    seconds: float = math.inf,
    arrived: Callable[[int, Outcome[Result]], object] = lambda _number, _outcome: None,
) -> dict[int, Outcome[Result]]:
    """The outcomes of `Workers.map` by the numbers of their tasks, of those that were done when the time
    `ends` (as `deadline.until` counts it); only these have `arrived`."""
    outcomes: dict[int, Outcome[Result]] = {}

    def heard(number: int, outcome: Outcome[Result]) -> None:
        if not isinstance(outcome.error, deadline.OutOfTimeError):
            outcomes[number] = outcome
            arrived(number, outcome)

    with suppress(deadline.OutOfTimeError), deadline.until(ends):
        deque(pool.map(work, tasks, seconds=seconds, arrived=heard), maxlen=0)
    return outcomes


@contextmanager
def workers(jobs: int = 1, cluster: str | None = None) -> Iterator[Workers]:
    """Workers for the time of a block: `jobs` processes of this machine, or all workers of the Dask cluster
    at the address `cluster`.

    Raises ConfigError `cluster-without-dask`, `cluster-unreachable`, `cluster-differs`.
    """
    if cluster is not None:
        with _connected(cluster) as client:
            yield Workers(_Cluster(client, cluster))
    elif jobs > 1:
        engine = _Processes(jobs)
        try:
            yield Workers(engine)
        finally:
            engine.end_copies()
    else:
        yield Workers(None)


def stop() -> None:
    """End the processes of this machine at once, whatever they are doing."""
    _kill(_Processes.running())


# One task ---------------------------------------------------------------------------------------------------


def outcome_of(work: Callable[[Task], Result], task: Task) -> Outcome[Result]:
    try:
        with one_thread():
            return Outcome(value=work(task))
    except DaestError as error:
        return Outcome(error=error)
    except Exception as error:
        error.add_note(traceback.format_exc())  # a traceback does not travel
        return Outcome(error=error)


def _alone(outcome: Outcome[Result]) -> Outcome[Result]:
    """The outcome, its error without what was being handled when it was raised: where Dask is installed that
    would travel, too, and need not be an exception that can."""
    if outcome.error is not None:
        outcome.error.__cause__ = outcome.error.__context__ = outcome.error.__traceback__ = None
    return outcome


def called(task: Callable[[], Any]) -> Any:
    """The work of tasks that are functions without arguments."""
    return task()


def run_packed(work: bytes, blob: bytes, expected: Versions | None = None) -> bytes:
    """The packed outcome of a packed task, on a worker with the `expected` programs. Raises ConfigError
    `cluster-differs`."""
    if expected is not None:
        _require_equal(versions(), expected, platform.node())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # nobody would know where they come from
            return packed(_alone(outcome_of(_known_work(work), unpacked(blob))))
    except DaestError as error:
        return packed(Outcome(error=error))


@lru_cache(maxsize=2)
def _known_work(work: bytes) -> Callable[[Any], Any]:
    """What many tasks have in common is unpacked once."""
    return unpacked(work)


_packing = Lock()  # CasADi has one context for all threads


def packed(value: Any) -> bytes:
    """Anything as bytes. Expressions that share symbols keep them in common. DaestError
    `task-not-sendable`."""
    try:
        with _packing, ca.global_pickle_context():
            return pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        raise DaestError(
            "task-not-sendable",
            f"a task cannot be sent to another process: {_first_line(error)}",
            remedy="run it in this process (--jobs 1, without --cluster); functions must belong to a module",
        ) from error


def unpacked(blob: bytes) -> Any:
    with _packing, ca.global_unpickle_context():
        return pickle.loads(blob)


# Processes of this machine ----------------------------------------------------------------------------------


_IDLE = ("daest-compiler",)  # threads that wait for questions, and that a copy of the process does without
_copies: list[ProcessPoolExecutor] = []  # pools that work or wait for work


@dataclass(frozen=True)
class _Processes:
    """Copies of this process for the time of a block, where that is safe: they start at once and know all
    that it knows. Else joblib's processes, which stay for later tasks. While this process works itself,
    copies take the tasks `ahead` on other processors; `begun` are those that they have begun."""

    jobs: int
    copies: list[ProcessPoolExecutor] = field(default_factory=list)  # one at most
    ahead: deque[tuple[bytes, bytes]] = field(default_factory=deque)  # work and task
    begun: dict[bytes, Any] = field(default_factory=dict)
    beginning: Lock = field(default_factory=Lock)

    def gain(self, n_tasks: int, seconds: float) -> float:
        n_rounds = math.ceil(n_tasks / self.jobs)
        start = COPY_SECONDS if self.copies or _may_copy() else START_SECONDS
        return (n_tasks - n_rounds) * seconds - start if n_tasks > n_rounds else 0.0

    def begin(self, work: bytes, blobs: Sequence[bytes]) -> bool:
        if not self.copies and not _may_copy():
            return False
        with self.beginning:
            self.ahead.extend((work, blob) for blob in blobs)
            busy = sum(not future.done() for future in self.begun.values())
        for _ in range(max(self.jobs - 1, 1) - busy):
            self._follow(self._pool())
        return True

    def _follow(self, pool: Any) -> None:
        """Begin the first of the tasks `ahead`, and when that is done the next one."""
        with self.beginning:
            if not self.ahead:
                return
            work, blob = self.ahead.popleft()
            try:
                future = pool.submit(run_packed, work, blob)
            except RuntimeError:  # the pool has come to its end
                return
            self.begun[blob] = future
        future.add_done_callback(lambda _: self._follow(pool))

    def arrivals(self, work: bytes, blobs: Sequence[bytes]) -> Generator[tuple[int, bytes]]:
        """If one worker dies, the whole pool breaks: tasks without an outcome are started again."""
        missing, losses = dict(enumerate(blobs)), 0
        while missing:
            try:
                for number, blob in self._round(work, missing):
                    del missing[number]
                    losses = 0
                    yield number, blob
            except BrokenExecutor as error:
                losses += 1
                self.end_copies()
                if losses == MOST_LOSSES:
                    raise _lost() from error

    def _round(self, work: bytes, blobs: dict[int, bytes]) -> Iterator[tuple[int, bytes]]:
        pool = self._pool()
        with self.beginning:
            wanted = {id(blob) for blob in blobs.values()}
            others = [one for one in self.ahead if id(one[1]) not in wanted]
            self.ahead.clear()
            self.ahead.extend(others)
            running = {self.begun.pop(blob): number for number, blob in blobs.items() if blob in self.begun}
        following = iter([item for item in blobs.items() if item[0] not in running.values()])
        try:
            while True:
                # As many as there are processes: those that wait inside the pool cannot be given up cleanly.
                for number, blob in islice(following, max(self.jobs - len(running), 0)):
                    running[pool.submit(run_packed, work, blob)] = number
                if not running:
                    return
                done = wait(running, deadline.left(), FIRST_COMPLETED).done
                if not done:
                    deadline.check()
                for future in done:
                    yield running.pop(future), future.result()
        finally:
            if running and self.copies:
                self.end_copies(at_once=True)
            elif running:
                pool.shutdown(kill_workers=True)

    def _pool(self) -> Any:
        if not self.copies and _may_copy():
            context = multiprocessing.get_context("fork")
            self.copies.append(
                ProcessPoolExecutor(
                    self.jobs, mp_context=context, initializer=_begin_copy, initargs=(os.getpid(),)
                )
            )
            _copies.extend(self.copies)
        if self.copies:
            return self.copies[0]
        from joblib.externals.loky import get_reusable_executor

        with _unwarned():
            return get_reusable_executor(
                max_workers=self.jobs, initializer=die_with_parent, initargs=(os.getpid(),)
            )

    def end_copies(self, *, at_once: bool = False) -> None:
        """End the copies; `at_once` in the middle of their work."""
        with self.beginning:
            self.ahead.clear()
            at_once = at_once or any(not future.done() for future in self.begun.values())
            self.begun.clear()
        while self.copies:
            pool = self.copies.pop()
            _copies.remove(pool)
            if at_once:
                _kill(_numbers_of(pool))
            pool.shutdown(wait=True, cancel_futures=True)

    @staticmethod
    def running() -> list[int]:
        """Process numbers, without waiting for any lock."""
        loky = sys.modules.get("joblib.externals.loky.reusable_executor")
        pools = [*_copies, getattr(loky, "_executor", None)]
        return [number for pool in pools for number in _numbers_of(pool)]


def _numbers_of(pool: Any) -> list[int]:
    return list(getattr(pool, "_processes", None) or ())


def _kill(numbers: Sequence[int]) -> None:
    for pid in numbers:
        with suppress(OSError):
            os.kill(pid, getattr(signal, "SIGKILL", signal.SIGTERM))


def _may_copy() -> bool:
    """Whether a copy of this process lacks nothing that works: it has the one thread that makes it."""
    if sys.platform != "linux" or threading.current_thread() is not threading.main_thread():
        return False
    threads = threading.enumerate()
    others = [t for t in threads if t is not threading.current_thread() and t.name not in _IDLE]
    # Threads of native code are in no list of Python's.
    return not others and len(os.listdir("/proc/self/task")) <= len(threads)


def _begin_copy(parent: int) -> None:
    """Ctrl-C ends the process that was copied, and that ends its copies."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    die_with_parent(parent)


@contextmanager
def _unwarned() -> Iterator[None]:
    """Semaphores of processes that `stop` ended are tidied up by a process that starts here; it need not warn
    of them."""
    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [before, "ignore:resource_tracker"]))
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = before


def _lost() -> DaestError:
    return DaestError(
        "worker-lost",
        f"a worker process died during a task, {MOST_LOSSES} times in a row",
        remedy="it may have run out of memory: use fewer at a time (--jobs 1), or workers with more memory",
    )


# A Dask cluster ---------------------------------------------------------------------------------------------


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    try:
        import dask
        import distributed
    except ImportError as error:
        raise ConfigError(
            "cluster-without-dask",
            "work on a cluster needs Dask, which is not installed",
            remedy="pip install 'daest[cluster]'",
        ) from error
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": LARGE}), _without_logs():
        try:
            client = distributed.Client(address, timeout=CONNECT_SECONDS)
        except (OSError, ValueError, TimeoutError) as error:
            raise _unreachable(address, f"no Dask scheduler answers at {address}") from error
        with client:
            _check(client, address)
            yield client


@contextmanager
def _without_logs() -> Iterator[None]:
    """Dask logs the end of a connection with its traceback; here it is told as one error."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.CRITICAL)
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _unreachable(address: str, what: str) -> ConfigError:
    return ConfigError(
        "cluster-unreachable",
        what,
        where=address,
        remedy="start one (dask scheduler; dask worker ADDRESS --nthreads 1); it shows its address",
    )


def _check(client: Any, address: str) -> None:
    """Whether there are workers, each with the programs that are here."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except TimeoutError as error:
        raise _unreachable(address, f"the cluster at {address} has no worker") from error
    for worker, theirs in client.run(versions, on_error="return").items():
        if isinstance(theirs, Exception):
            raise _differs(worker, _first_line(theirs))
        _require_equal(theirs, versions(), worker)


@dataclass(frozen=True)
class _Cluster:
    """All workers of a cluster; Dask begins a task anew whose worker has gone."""

    client: Any
    address: str

    def gain(self, n_tasks: int, seconds: float) -> float:
        return math.inf

    def begin(self, work: bytes, blobs: Sequence[bytes]) -> bool:
        """It does not: a cluster has all tasks of a stage at once."""
        return False

    def arrivals(self, work: bytes, blobs: Sequence[bytes]) -> Generator[tuple[int, bytes]]:
        expected, following = versions(), iter(enumerate(blobs))
        running: dict[Any, int] = {}
        is_lost = False
        try:
            while True:
                # A few more than there are workers: each holds what all have in common.
                wanted = AHEAD * max(self._n_threads(), 1) - len(running)
                for number, blob in islice(following, max(wanted, 0)):
                    running[self.client.submit(run_packed, work, blob, expected, pure=False)] = number
                if not running:
                    break
                for future, status in self._done(list(running)).items():
                    if status == "finished":
                        # What a worker took with it on the way is made anew, and told as done once more.
                        if (fetched := self._fetched(future)) is not None:
                            yield running.pop(future), fetched
                        continue
                    del running[future]
                    self._require_killed(future, status)
                    is_lost = True  # said when the others have come
        finally:
            self.client.cancel(list(running))
        if is_lost:
            raise _lost()

    @staticmethod
    def _fetched(future: Any) -> bytes | None:
        """The result of a task that was done; None where its worker has gone since."""
        import distributed

        again = (TimeoutError, CancelledError, distributed.scheduler.KilledWorker)
        try:
            return bytes(future.result(POLL))
        except again:
            return None

    def _require_killed(self, future: Any, status: str) -> None:
        """Whether a task that has failed killed its workers; raises what else is wrong with it."""
        error = future.exception() if status == "error" else None
        if isinstance(error, DaestError):
            raise error
        if error is None:
            raise self._gone()
        if type(error).__name__ != "KilledWorker":
            raise _differs(self.address, _first_line(error)) from error

    def _done(self, running: list) -> dict[Any, str]:
        """Those that are done, one at least, as they were when they were looked at: the status is read once,
        since a worker that goes changes it at any time."""
        import distributed

        alone = 0.0
        while True:
            try:
                with suppress(CancelledError):  # told by the status, too
                    distributed.wait(running, timeout=POLL, return_when="FIRST_COMPLETED")
                looked_at = {future: future.status for future in running}
                # What a worker took with it is made anew, and only then done.
                if done := {f: status for f, status in looked_at.items() if status in SETTLED}:
                    return done
                deadline.check()
                time.sleep(RETRY)
                alone = 0.0 if self._n_threads() else alone + RETRY
            except TimeoutError:
                deadline.check()
                alone = 0.0 if self._n_threads() else alone + POLL
            if alone > PATIENCE:
                raise self._gone()

    def _n_threads(self) -> int:
        try:
            return sum(self.client.ncores().values())
        except (OSError, TimeoutError) as error:
            raise self._gone() from error

    def _gone(self) -> ConfigError:
        return ConfigError(
            "cluster-lost",
            f"the cluster at {self.address} has gone in the middle of the work",
            where=self.address,
            remedy="start it again; diagnose and improve go on where they were",
        )


def _first_line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _differs(where: str, what: str) -> ConfigError:
    return ConfigError(
        "cluster-differs",
        f"a worker cannot do the work of this machine: {what}",
        where=where,
        remedy="install the same versions of daest and its packages there, and restart the workers",
    )


# Versions ---------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def program() -> str:
    """Hash of the source code of daest; results may differ between versions."""
    found = hashlib.sha256()
    folder = Path(daest.__file__).parent
    for file in sorted(f for f in folder.rglob("*") if f.suffix in SOURCES):
        content = file.read_bytes()
        found.update(f"{len(content)} ".encode())
        found.update(content)
    return found.hexdigest()[:32]


@lru_cache(maxsize=1)
def versions() -> Versions:
    """What results depend on: programs, and whether models are compiled."""
    known = {name: version(name) for name in PACKAGES}
    python = ".".join(platform.python_version_tuple()[:2])
    return {"daest": f"{daest.__version__} ({program()[:8]})", "Python": python, **known, **_compiler()}


def _compiler() -> Versions:
    try:
        find_compiler()
    except DaestError:
        return {"C compiler": "none"}
    return {"C compiler": "found"}


def _require_equal(theirs: Versions, ours: Versions, where: str) -> None:
    other = [
        f"{name} {theirs.get(name, 'none')}, here {own}"
        for name, own in ours.items()
        if theirs.get(name) != own
    ]
    if other:
        raise _differs(where, "; ".join(other))
