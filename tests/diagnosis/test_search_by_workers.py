"""The same diagnosis wherever its refits run: here, in processes, on a Dask cluster with a worker killed."""

import dataclasses
import logging
import os
import signal

import numpy as np
import pytest
from hidden_plants import library, model, rotor_record

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.numerics import parallel

EFFECTS = ("CoulombFriction", "AsymmetricFriction", "LuGreFriction", "DeadZone")


def options(**more):
    return DiagnoseOptions(effects=EFFECTS, hold="zoh", **more)


def diagnosed(given):
    record, _ = rotor_record(500, seed=5, coulomb=lambda phi: 0.15)
    return diagnose(model(), library(), [record], options=given)


def content(value):
    """Everything of a result that is not an expression or a time, in a form that can be compared."""
    if dataclasses.is_dataclass(value):
        left_out = ("flat", "seconds")
        return [content(getattr(value, f.name)) for f in dataclasses.fields(value) if f.name not in left_out]
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, dict):
        return [(key, content(entry)) for key, entry in value.items()]
    if isinstance(value, list | tuple):
        return [content(entry) for entry in value]
    return repr(value)


@pytest.fixture(scope="module")
def alone():
    return diagnosed(options(jobs=1))


@pytest.fixture
def no_waiting(monkeypatch):
    """Processes work, however short the tasks are."""
    monkeypatch.setattr(parallel, "START_SECONDS", -np.inf)


@pytest.mark.slow
def test_processes_find_the_same_to_the_last_bit(alone, no_waiting):
    assert alone.verdict == "supported" and len(alone.proofs) >= 2
    keeper = LooksOn()
    found = diagnosed(options(jobs=2, keeper=keeper))
    assert len(keeper.running) == 2 and not parallel._copies
    assert content(found) == content(alone)


class LooksOn:
    """A keeper that sees which processes work when a proof has come."""

    def __init__(self):
        self.running = []

    def found(self, prepared):
        return None

    def step(self, name, parts, flat, make):
        return make()

    def keep(self, prepared, proof):
        self.running = parallel._Processes.running()


class KillsAWorker:
    """A keeper that kills a worker of the cluster when the first proof has come."""

    def __init__(self, cluster):
        self.cluster, self.killed = cluster, None

    def found(self, prepared):
        return None

    def step(self, name, parts, flat, make):
        return make()

    def keep(self, prepared, proof):
        if self.killed is None:
            self.killed = next(iter(self.cluster.workers.values())).process.pid
            os.kill(self.killed, signal.SIGKILL)


@pytest.mark.slow  # a worker that is killed: tests/numerics/test_parallel.py; equal bits: the test above
@pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
def test_a_cluster_that_loses_a_worker_finds_the_same_to_the_last_bit(alone):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=logging.CRITICAL
    ) as cluster:
        keeper = KillsAWorker(cluster)
        found = diagnosed(options(cluster=cluster.scheduler_address, keeper=keeper))
    assert keeper.killed is not None
    assert content(found) == content(alone)
