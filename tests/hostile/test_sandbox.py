"""What a hostile FMU can do to the machine: nothing where the kernel has walls; what it leaves is ended."""

import os
import platform
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hostile_fmu import Y, hostile

from daest.cli.main import run
from daest.errors import FmuError
from daest.fmu import sandbox
from daest.fmu.load import load_fmu
from daest.fmu.runner import Limits, Points, Runner
from daest.fmu.sandbox import Walls, tried_walls

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() not in ("x86_64", "aarch64"), reason="walls of Linux"
)
NOWHERE = Points((), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1))
WRITE, SECRET, TCP, UDP, DAEMONS, SIGNAL, CHMOD, UNLINK, RENAME, SHELL, LINK, CUT, CLOSE, LOG = range(1, 15)
GOOD = 20


@pytest.fixture(scope="module")
def walls() -> Walls:
    return tried_walls()


def outcome(path: Path) -> float:
    with Runner(load_fmu(path), Limits(seconds=20.0)) as runner:
        return float(runner.evaluate(NOWHERE, (Y,)).values[0, 0, 0])


FURTHER = [pytest.param(deed, marks=pytest.mark.slow) for deed in (RENAME, LINK, CUT)]


@pytest.mark.parametrize("deed", [WRITE, CHMOD, UNLINK, *FURTHER])
def test_it_writes_nowhere_else(tmp_path, monkeypatch, walls, deed):
    if not walls.write:
        pytest.skip("the kernel has no Landlock")
    place = tmp_path / "precious"
    place.write_text("precious")
    place.chmod(0o600)
    path = hostile(tmp_path, deed, place)
    assert outcome(path) == 0.0
    assert place.read_text() == "precious" and place.stat().st_mode & 0o777 == 0o600
    assert sorted(p.name for p in tmp_path.iterdir()) == ["hostile.fmu", "precious"]
    monkeypatch.setenv("DAEST_FMU_SANDBOX", "off")  # the deed is one
    assert outcome(path) == 1.0


@pytest.mark.parametrize("deed", [TCP, UDP])
def test_it_reaches_no_network(tmp_path, monkeypatch, walls, deed):
    if not walls.socket:
        pytest.skip("the kernel filters no system calls")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM if deed == TCP else socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        if deed == TCP:
            server.listen(5)
        path = hostile(tmp_path, deed, port=server.getsockname()[1])
        assert outcome(path) == 0.0
        monkeypatch.setenv("DAEST_FMU_SANDBOX", "off")
        assert outcome(path) == 1.0


@pytest.mark.parametrize("deed", [DAEMONS, pytest.param(SHELL, marks=pytest.mark.slow), SIGNAL])
def test_it_starts_and_signals_no_process(tmp_path, monkeypatch, walls, deed):
    if not walls.processes:
        pytest.skip("the kernel filters no system calls")
    path = hostile(tmp_path, deed)
    assert outcome(path) == 0.0
    monkeypatch.setenv("DAEST_FMU_SANDBOX", "off")
    assert outcome(path) == 1.0


def test_its_environment_is_scrubbed(tmp_path, monkeypatch):
    """With and without walls; what DAEST_FMU_PASS names comes through."""
    monkeypatch.setenv("SECRET", "a token")
    path = hostile(tmp_path, SECRET)
    assert outcome(path) == 0.0
    monkeypatch.setenv("DAEST_FMU_SANDBOX", "off")
    assert outcome(path) == 0.0
    monkeypatch.setenv("DAEST_FMU_PASS", "OTHER, SECRET")
    assert outcome(path) == 1.0


def test_a_good_one_has_a_folder_and_threads(tmp_path):
    assert outcome(hostile(tmp_path, GOOD)) == 1.0


def daemons(folder: Path) -> list[int]:
    mark = str(folder).encode()
    found = []
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            environment = Path(f"/proc/{name}/environ").read_bytes()
            command = Path(f"/proc/{name}/cmdline").read_bytes()
        except OSError:
            continue
        if b"TMPDIR=" + mark in environment and b"daest.fmu.worker" in command:
            found.append(int(name))
    return found


@pytest.mark.parametrize("is_killed", [False, True])
def test_its_processes_end_with_it_where_it_could_start_some(tmp_path, monkeypatch, is_killed):
    """Daemons in sessions of their own, after a good end and where daest itself is killed."""
    monkeypatch.setenv("DAEST_FMU_SANDBOX", "off")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    path = hostile(tmp_path, DAEMONS)
    script = (
        "import sys, time\nimport numpy as np\nfrom daest.fmu.load import load_fmu\n"
        "from daest.fmu.runner import Points, Runner\n"
        "with Runner(load_fmu(sys.argv[1])) as runner:\n"
        "    nowhere = Points((), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1))\n"
        "    print(runner.evaluate(nowhere, (3,)).values[0, 0, 0], flush=True)\n"
        "    sys.stdin.readline()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None and process.stdout.readline() == "1.0\n"
    assert len(daemons(tmp_path)) == 21
    if is_killed:
        process.send_signal(signal.SIGKILL)
    process.communicate()
    began = time.monotonic()
    while daemons(tmp_path) or list(tmp_path.glob("daest-fmu-*")):
        assert time.monotonic() - began < 5.0
        time.sleep(0.05)


@pytest.mark.parametrize(("deed", "code"), [(CLOSE, "fmu-exited"), (LOG, "fmu-crashed")])
def test_pipes_that_it_closes_and_a_log_that_it_replaces(tmp_path, deed, code):
    with pytest.raises(FmuError) as caught:
        outcome(hostile(tmp_path, deed))
    assert caught.value.code == code and "Traceback" not in str(caught.value)
    if deed == CLOSE:
        assert "cut its process off" in caught.value.what


def test_modes(tmp_path, monkeypatch, walls):
    path = hostile(tmp_path, GOOD)
    monkeypatch.setenv("DAEST_FMU_SANDBOX", "maybe")
    with pytest.raises(FmuError) as caught:
        outcome(path)
    assert caught.value.code == "fmu-sandbox"
    monkeypatch.setenv("DAEST_FMU_SANDBOX", "require")
    if walls.are_whole:
        assert outcome(path) == 1.0
    else:
        with pytest.raises(FmuError, match="asks for all walls"):
            outcome(path)


def test_sentences(monkeypatch):
    assert "cannot write outside its own folder, open a socket" in Walls(*[True] * 5).sentence()
    assert "does not keep it from these: write outside" in Walls(False, False, True, True, True).sentence()
    assert "not confined" in Walls().sentence()
    monkeypatch.setattr(sandbox.sys, "platform", "darwin")
    assert sandbox.confine(Path(".")) == Walls()


def test_daest_check_tells_what_holds(tmp_path, monkeypatch, capsys, walls):
    path = hostile(tmp_path, GOOD)
    rows = "".join(f"{0.1 * i:.1f},{i % 3},{(i * i) % 7}\n" for i in range(60))
    (tmp_path / "run.csv").write_text(f"time,u,y\n{rows}")
    for mode, sentence in (("on", walls.sentence()), ("off", "DAEST_FMU_SANDBOX is off")):
        monkeypatch.setenv("DAEST_FMU_SANDBOX", mode)
        assert run(["check", str(tmp_path / "run.csv"), "--model", str(path)]) in (0, 1)
        assert sentence in capsys.readouterr().err
