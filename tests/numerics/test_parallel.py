"""Workers: order, errors, losses and what cannot be sent; in this process, in others, on a Dask cluster."""

import logging
import math
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import CancelledError
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from daest.errors import ConfigError, DaestError
from daest.numerics import parallel
from daest.numerics.deadline import OutOfTimeError
from daest.numerics.parallel import called, done_by, packed, unpacked, workers

POSIX = pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")


@pytest.fixture(scope="module")
def cluster():
    """A Dask cluster of two processes on this machine."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=logging.CRITICAL
    ) as found:
        yield found


def places(cluster):
    return [(1, None), (2, None), (1, cluster.scheduler_address)]


@pytest.mark.parametrize("place", [0, 1, 2])
def test_outcomes_come_in_order_and_an_error_leaves_the_others_alone(cluster, place):
    heard = []
    with workers(*places(cluster)[place]) as pool:
        tasks = [4.0, -1.0, 9.0, 16.0]
        found = list(pool.map(math.sqrt, tasks, arrived=lambda n, outcome: heard.append((n, outcome.value))))
    assert [o.value for o in found] == [2.0, None, 3.0, 4.0]
    assert sorted(heard) == [(0, 2.0), (1, None), (2, 3.0), (3, 4.0)]
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        found[1].get()


def late_at_two(value):
    if value == 2.0:
        raise OutOfTimeError
    return math.sqrt(value)


@pytest.mark.parametrize(("ends", "done"), [(math.inf, {0: 1.0, 2: 2.0}), (0.0, {})])
def test_what_was_done_in_time_is_known_by_its_number(ends, done):
    heard = []
    with workers(1) as pool:
        tasks = [1.0, 2.0, 4.0]
        found = done_by(pool, late_at_two, tasks, ends, arrived=lambda n, outcome: heard.append(n))
    assert {number: outcome.get() for number, outcome in found.items()} == done
    assert heard == list(done)


@pytest.mark.parametrize("place", [1, 2])
def test_a_slow_first_task_does_not_hold_back_what_is_heard_of_the_others(cluster, place):
    heard = []
    with workers(*places(cluster)[place]) as pool:
        found = pool.map(time.sleep, [1.0, 0.0, 0.0], arrived=lambda n, _: heard.append(n))
        assert len(list(found)) == 3
    assert heard[0] != 0 and sorted(heard) == [0, 1, 2]


@pytest.mark.parametrize("place", [0, 1, 2])
def test_what_is_no_longer_wanted_is_given_up(cluster, place):
    began = time.monotonic()
    with workers(*places(cluster)[place]) as pool:
        found = pool.map(time.sleep, [0.01] + 40 * [0.5])
        next(found)
        found.close()
    assert time.monotonic() - began < 8.0


def test_expressions_travel_with_the_symbols_they_share():
    x = ca.SX.sym("x", 2)
    y, again = unpacked(packed((x, ca.sin(x[0]) * x[1])))
    value = ca.Function("f", [y], [again])([0.3, 2.0])
    assert float(value) == 2.0 * np.sin(0.3)


def test_few_short_tasks_stay_here():
    with workers(2) as pool:
        assert {o.get() for o in pool.map(_process, [0, 0], seconds=0.1)} == {os.getpid()}


def _process(_):
    return os.getpid()


def test_task_that_cannot_be_sent():
    with workers(2) as pool, pytest.raises(DaestError) as caught:
        list(pool.map(lambda x: x, [1, 2]))
    assert caught.value.code == "task-not-sendable" and "--jobs 1" in caught.value.remedy


def test_result_that_cannot_be_sent():
    with workers(2) as pool:
        (first, second) = pool.map(iter, [[1], range(2)])  # an iterator can be sent ...
        (frozen, _) = pool.map(memoryview, [b"1", b"2"])  # ... a view of memory cannot
    assert list(first.get()) == [1] and list(second.get()) == [0, 1]
    assert frozen.error.code == "task-not-sendable"


@POSIX
def test_a_process_that_is_killed_costs_nothing_but_time():
    killed = []

    def kill_one(*_):
        if not killed:
            killed.append(parallel._Processes.running()[0])
            os.kill(killed[0], signal.SIGKILL)

    with workers(2) as pool:
        found = list(pool.map(math.sqrt, [1.0, 4.0, 9.0, 16.0, 25.0, 36.0], arrived=kill_one))
    assert killed and [o.get() for o in found] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


@POSIX
def test_a_task_that_kills_every_process_is_told():
    with workers(2) as pool, pytest.raises(DaestError) as caught:
        list(pool.map(os._exit, [1, 1]))
    assert caught.value.code == "worker-lost"


def test_no_cluster_there(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(parallel, "CONNECT_SECONDS", 1.0)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        with pytest.raises(ConfigError) as caught, workers(1, address):
            pass
        assert caught.value.code == "cluster-unreachable" and caught.value.where == address


def test_no_dask(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "dask", None)
    with pytest.raises(ConfigError) as caught, workers(1, "tcp://127.0.0.1:9"):
        pass
    assert caught.value.code == "cluster-without-dask" and "daest[cluster]" in caught.value.remedy


def test_versions_that_differ(cluster, monkeypatch):
    monkeypatch.setattr(parallel, "program", lambda: "another")
    parallel.versions.cache_clear()
    with pytest.raises(ConfigError) as caught, workers(1, cluster.scheduler_address):
        pass
    parallel.versions.cache_clear()
    assert caught.value.code == "cluster-differs" and "(another)" in caught.value.what
    assert caught.value.where.startswith("tcp://")


@pytest.mark.slow  # a process: above
@POSIX
def test_a_worker_of_the_cluster_that_is_killed_costs_nothing_but_time(cluster):
    killed = []

    def kill_one(*_):
        if not killed:
            killed.append(next(iter(cluster.workers.values())).process.pid)
            os.kill(killed[0], signal.SIGKILL)

    with workers(1, cluster.scheduler_address) as pool:
        found = list(pool.map(math.sqrt, [float(n * n) for n in range(20)], arrived=kill_one))
    assert killed and [o.get() for o in found] == list(range(20))


class Fickle:
    """A future whose worker goes when its result is fetched: it is done, lost, and done again."""

    statuses = ("finished", "lost", "pending", "finished")

    def __init__(self, blob, fails):
        self.blob, self.fails, self.seen = blob, fails, iter(self.statuses)
        self.fetched = 0

    @property
    def status(self):
        return next(self.seen, "finished")

    def result(self, timeout):
        self.fetched += 1
        if self.fetched == 1:
            raise self.fails
        return self.blob


class FickleClient:
    """Runs tasks at once; what it gives back is taken away once."""

    def __init__(self, fails):
        self.fails, self.cancelled = fails, None

    def submit(self, work, *arguments, pure):
        return Fickle(work(*arguments), self.fails)

    def ncores(self):
        return {"here": 1}

    def cancel(self, futures):
        self.cancelled = futures


@pytest.mark.parametrize("fails", [TimeoutError(), CancelledError()])
def test_a_result_that_goes_with_its_worker_is_waited_for_again(monkeypatch, fails):
    """The status of a future changes whenever a worker goes, even between two looks at it."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "wait", lambda fs, **_: SimpleNamespace(done=set(fs)))
    client = FickleClient(fails)
    pool = parallel.Workers(parallel._Cluster(client, "tcp://nowhere:1"))
    assert [o.get() for o in pool.map(math.sqrt, [float(n * n) for n in range(5)])] == list(range(5))
    assert client.cancelled == []


def test_cluster_without_workers(monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(parallel, "CONNECT_SECONDS", 1.0)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as empty,
        pytest.raises(ConfigError) as caught,
        workers(1, empty.scheduler_address),
    ):
        pass
    assert caught.value.code == "cluster-unreachable" and "no worker" in caught.value.what


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize(
    ("name", "by_copies"),
    [("SIGKILL", False), pytest.param("SIGTERM", False, marks=pytest.mark.slow), ("SIGTERM", True)],
)
def test_processes_end_with_the_one_that_started_them(tmp_path, name, by_copies):
    """A run that is ended leaves no worker behind, and no compiler with its files."""
    (tmp_path / "slow").write_text("#!/bin/sh\nmktemp; echo $$ > pid; sleep 60\n")
    (tmp_path / "slow").chmod(0o755)
    script = (
        "import os, threading, time\nfrom pathlib import Path\n"
        "from daest.files import passing_folder, run_program\nfrom daest.numerics.parallel import workers\n"
        "def compile():\n"
        "    with passing_folder('build-') as work:\n"
        f"        run_program([r'{tmp_path / 'slow'}'], work, 60.0)\n"
        "thread = threading.Thread(target=compile)\n"
        "def heard(number, outcome):\n"
        "    if thread.ident is None: thread.start()\n"
        "    print('now', flush=True)\n"
        f"if not {by_copies}: thread.start()\n"  # of a process with threads, no copies are made
        "with workers(2) as pool:\n"
        "    list(pool.map(time.sleep, [0, 0, 60, 60], arrived=heard))\n"
    )
    passing = tmp_path / "passing"
    passing.mkdir()
    environment = {**os.environ, "TMPDIR": str(passing)}
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None and process.stdout.readline() == "now\n"
    while not list(passing.glob("build-*/pid")):
        time.sleep(0.05)
    started = [p for p in descendants(process.pid) if p != process.pid]
    assert len(started) >= 4  # two workers, the compiler, what it waits for
    process.send_signal(getattr(signal, name))
    process.wait(10)
    began = time.monotonic()
    while any(is_alive(p) for p in started) or list(passing.glob("build-*")):
        assert time.monotonic() - began < 5.0, [p for p in started if is_alive(p)]
        time.sleep(0.05)


def descendants(pid: int) -> list[int]:
    found = [pid]
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += descendants(int(child))
    return found


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def made(folders):
    """Tasks that make a folder each: a second time they fail."""
    return [partial(os.mkdir, str(folder)) for folder in folders]


def test_what_was_begun_is_not_done_again(tmp_path):
    tasks, another = made([tmp_path / name for name in "abc"]), made([tmp_path / "d"])
    with workers(2) as pool:
        pool.begin(called, tasks)
        assert all(outcome.error is None for outcome in pool.map(called, [*another, *tasks]))
    assert all((tmp_path / name).is_dir() for name in "abcd")


def test_tasks_begin_beside_this_process_one_after_the_other(tmp_path):
    if not parallel._may_copy():
        pytest.skip("this process has other threads")
    folders, last = [tmp_path / name for name in "ab"], time.monotonic() + 20.0
    with workers(2) as pool:
        pool.begin(called, made(folders))
        while not all(folder.is_dir() for folder in folders) and time.monotonic() < last:
            time.sleep(0.01)
    assert all(folder.is_dir() for folder in folders)


def test_what_is_begun_and_not_wanted_is_given_up():
    began = time.monotonic()
    with workers(2) as pool:
        pool.begin(time.sleep, [60.0, 60.0])
    assert time.monotonic() - began < 30.0


def test_without_processes_tasks_begin_when_they_are_asked_for(tmp_path):
    tasks = made([tmp_path / "a"])
    with workers(1) as pool:
        pool.begin(called, tasks)
        assert not (tmp_path / "a").exists()
        assert [outcome.error for outcome in pool.map(called, tasks)] == [None]


class _TwoPartsError(Exception):
    """As exceptions are that carry more than a text: pickle cannot make it again."""

    def __init__(self, one, other):
        super().__init__(one)
        self.other = other


def _fails():
    raise DaestError("worker-lost", "in the middle of something else")


def test_what_is_handled_meanwhile_does_not_travel_with_an_error():
    """A search is repeated while the exception is handled that asked for it; copies of the process begin
    there."""
    pytest.importorskip("tblib.pickling_support").install()
    try:
        raise _TwoPartsError(1, 2)
    except _TwoPartsError:
        outcome = unpacked(parallel.run_packed(packed(called), packed(_fails)))
    assert outcome.error.code == "worker-lost" and outcome.error.__context__ is None
