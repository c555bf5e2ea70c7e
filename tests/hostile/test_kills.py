"""Commands that are killed at random moments, that run side by side in one folder, and that run a thousand
times: nothing that was finished is lost, no file is half, and nothing is left over.

DAEST_KILLS sets how many kills there are, DAEST_SOAK how many commands the soak has.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from cart_data import CART, recording, write_recording
from lag_data import LAG, PROJECT, write_csv
from lag_data import recording as lag_recording

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")

N_KILLS = int(os.environ.get("DAEST_KILLS", "10"))
N_COMMANDS = int(os.environ.get("DAEST_SOAK", "1000"))
SECONDS = 2.0  # after which nothing may be left over
IDENTIFY = ("rub.csv", "--model", "Cart.mo", "--hold", "zoh")
SEARCH = (*IDENTIFY, "--effect", "CoulombFriction", "--jobs", "2")
COMMANDS = (("identify", *IDENTIFY), ("diagnose", *SEARCH), ("improve", *SEARCH), ("report",))
KILLED = (*COMMANDS, ("app", "--no-browser"))  # the last one does not end by itself


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A project with a fit, whose commands have a cache and a folder for temporary files of their own."""
    folder = tmp_path_factory.mktemp("kills")
    (folder / "passing").mkdir()
    (folder / "Cart.mo").write_text(CART)
    (folder / "daest.toml").write_text('[model]\nsource = "Cart.mo"\n[data]\nestimate = ["rub.csv"]\n')
    write_recording(folder / "rub.csv", recording(600, 1, friction=0.5))
    for command in COMMANDS:
        assert call(folder, *command).wait() == 0
    return folder


def call(folder: Path, *command: str) -> subprocess.Popen:
    environment = {**os.environ, "TMPDIR": str(folder / "passing"), "DAEST_CACHE": str(folder / "cache")}
    environment["DAEST_COMPILER_EFFORT"] = "O0"  # the cache is empty: all is compiled, and runs for a moment
    return subprocess.Popen(
        [sys.executable, "-m", "daest", *command], cwd=folder, env=environment,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def left_over(folder: Path) -> list[str]:
    """Processes that have the folder in their environment, temporary files, and files that are cut off."""
    mark = f"TMPDIR={folder / 'passing'}".encode()
    found = []
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            if mark in Path(f"/proc/{name}/environ").read_bytes():
                found.append(Path(f"/proc/{name}/cmdline").read_text().replace("\0", " "))
        except OSError:
            continue
    # loky keeps a folder of its own, which its tracker removes; it is empty but for that.
    found += [str(p) for p in (folder / "passing").rglob("*") if p.is_file() or p.name.startswith("daest")]
    found += [str(p) for p in folder.rglob(".daest-*")]
    found += [str(p) for p in (folder / "cache").rglob("build-*")]
    return found


def assert_whole(folder: Path) -> None:
    results = folder / "results"
    for file in results.rglob("*.json"):
        json.loads(file.read_text())
    for file in results.rglob("*.npz"):
        with np.load(file) as arrays:
            assert all(arrays[name].size >= 0 for name in arrays.files)
    assert {"fit.json", "diagnosis.json"} <= {file.name for file in results.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("number", range(N_KILLS))
def test_kill_at_a_random_moment(place, number):
    rng = random.Random(number)
    command = KILLED[number % len(KILLED)]
    if (
        command[0] not in ("report", "app") and rng.random() < 0.5
    ):  # no proof and no step is known from before
        for kept in [
            *(place / "results" / "diagnosis").glob("*"),
            *(place / "cache" / "diagnosis").glob("*"),
        ]:
            kept.unlink()
    process = call(place, *command)
    time.sleep(rng.uniform(0.0, 6.0))
    process.send_signal(rng.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT]))
    process.wait()
    ended = time.monotonic()
    while left_over(place):
        assert time.monotonic() - ended < SECONDS, (command, left_over(place))
        time.sleep(0.05)
    assert_whole(place)


@pytest.mark.slow
def test_after_all_kills_each_command_goes_on(place):
    for command in COMMANDS:
        assert call(place, *command).wait() == 0
    assert left_over(place) == []


@pytest.mark.slow
def test_two_commands_at_once_in_one_folder(tmp_path):
    """The same command twice, with an empty cache and results that both write: both end well."""
    (tmp_path / "passing").mkdir()
    lag_project(tmp_path)
    processes = [call(tmp_path, "identify") for _ in range(2)]
    assert [process.wait() for process in processes] == [0, 0]
    assert json.loads((tmp_path / "results" / "fit.json").read_text())["status"]
    assert left_over(tmp_path) == []


def lag_project(folder: Path) -> None:
    (folder / "Lag.mo").write_text(LAG)
    (folder / "daest.toml").write_text(PROJECT)
    write_csv(folder / "run1.csv", *lag_recording(200, 1))
    write_csv(folder / "run2.csv", *lag_recording(200, 2))


@pytest.mark.slow
def test_soak(tmp_path, monkeypatch, capsys):
    """Commands in one process and one folder, FMU included: memory and descriptors stay as they are."""
    from daest.cli.main import run

    monkeypatch.chdir(tmp_path)
    lag_project(tmp_path)
    assert run(["export", "Lag.mo", "-o", "lag.fmu"]) == 0
    lines = (
        "check run1.csv",
        "identify",
        "linearize Lag.mo",
        "linearize lag.fmu",
        "filter run2.csv",
        "report",
    )
    seen = []
    for number in range(N_COMMANDS):
        assert run(lines[number % len(lines)].split()) in (0, 1)
        capsys.readouterr()
        if number % 50 == 49:
            seen.append((resident(), len(os.listdir("/proc/self/fd")), len(list(tmp_path.rglob("*")))))
    settled = seen[len(seen) // 4 :]
    (first, _, _), (last, _, _) = settled[0], settled[-1]
    assert last < 1.15 * first, seen
    assert len({descriptors for _, descriptors, _ in settled}) == 1, seen
    assert len({files for _, _, files in settled}) == 1, seen


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1])
