"""Commands on a live Dask cluster, as a user starts it: a scheduler and two workers, each a process."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cart_data import CART, recording, write_recording

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal"),
    pytest.mark.slow,
]
CART_FROM = ("rub.csv", "--model", "Cart.mo", "--hold", "zoh", "--format", "json")
EFFECTS = ("--effect", "CoulombFriction", "--effect", "StribeckFriction")
SECONDS = 60.0  # for anything that is waited for


@pytest.fixture(scope="module")
def cart(tmp_path_factory) -> Path:
    """A folder with Cart.mo and rub.csv, where the cart rubs."""
    folder = tmp_path_factory.mktemp("cart")
    (folder / "Cart.mo").write_text(CART)
    write_recording(folder / "rub.csv", recording(1000, 1, friction=0.5))
    return folder


class Cluster:
    """A scheduler and two workers that nothing starts anew; `processes`: the scheduler first."""

    def __init__(self, folder: Path) -> None:
        file = folder / "scheduler.json"
        alike = ("--scheduler-file", str(file), "--no-dashboard")
        self.processes = [dask("scheduler", "--host", "127.0.0.1", "--port", "0", *alike)]
        wait_for(lambda: file.is_file() and file.read_text().endswith("\n}"))  # it is there before its text
        self.address = json.loads(file.read_text())["address"]
        for _ in range(2):
            self.processes.append(dask("worker", "--nthreads", "1", "--no-nanny", *alike))

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


def dask(*arguments: str) -> subprocess.Popen:
    quiet = subprocess.DEVNULL
    return subprocess.Popen([sys.executable, "-m", "dask", *arguments], stdout=quiet, stderr=quiet)


def wait_for(condition) -> None:
    deadline = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture
def cluster(tmp_path):
    distributed = pytest.importorskip("distributed")
    found = Cluster(tmp_path)
    with distributed.Client(found.address) as client:
        client.wait_for_workers(2, timeout=SECONDS)
    yield found
    found.close()


def daest(cart: Path, *arguments: str, kill: tuple[str, subprocess.Popen] | None = None):
    """Exit code, stdout and stderr of a command; where `kill` is given, its process is killed when stderr
    begins to speak of its first word."""
    command = [sys.executable, "-m", "daest", *arguments]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=cart)
    lines = []
    for line in process.stderr:
        lines.append(line)
        if kill is not None and line.startswith(kill[0]) and kill[1].poll() is None:
            assert process.poll() is None
            kill[1].send_signal(signal.SIGKILL)
            kill[1].wait()
    out = process.stdout.read()
    assert kill is None or kill[1].returncode == -signal.SIGKILL
    return process.wait(), out, "".join(lines)


def without_seconds(out: str) -> dict:
    document = json.loads(out)
    del document["seconds"]
    return document


@pytest.mark.parametrize(
    ("command", "during"),
    [
        (("diagnose", *CART_FROM, *EFFECTS), "refitting"),
        (("identify", *CART_FROM, "--starts", "3", "--bootstrap", "60"), "refits of simulated"),
    ],
    ids=["diagnose", "identify"],
)
def test_a_cluster_that_loses_a_worker_says_what_one_process_says(command, during, cart, cluster):
    shutil.rmtree(cart / "results", ignore_errors=True)
    code, there, err = daest(
        cart, *command, "--cluster", cluster.address, kill=(during, cluster.processes[-1])
    )
    assert code == 0, err
    shutil.rmtree(cart / "results")
    code, here, err = daest(cart, *command, "--jobs", "1")
    assert code == 0, err
    assert without_seconds(there) == without_seconds(here)


def test_a_scheduler_that_goes_is_one_message(cart, cluster):
    kill = "refits of simulated", cluster.processes[0]
    command = ("identify", *CART_FROM, "--bootstrap", "2000", "--cluster", cluster.address)
    code, out, err = daest(cart, *command, kill=kill)
    assert code == 2 and out == ""
    assert "error[cluster-lost]" in err and "Traceback" not in err
