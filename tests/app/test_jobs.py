"""Commands that the page starts: they outlive the server, end when asked, and are found by the next one."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from served import served

from daest.app.jobs import jobs, shown, start, stop
from daest.app.state import HOME
from daest.app.story import Story, read_story
from daest.errors import ConfigError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
PATIENCE = 60.0


def ended(home: Path, number: int):
    began = time.monotonic()
    while True:
        job = next(job for job in jobs(home) if job.number == number)
        if job.status != "running":
            return job
        assert time.monotonic() - began < PATIENCE
        time.sleep(0.05)


@pytest.fixture
def home(tmp_path) -> Path:
    found = tmp_path / HOME
    found.mkdir(parents=True)
    return found

    """A line that does not end by itself: it waits for somebody who writes into a pipe."""
    os.mkfifo(tmp_path / "never")
    return ("completion", "bash", str(tmp_path / "never"))


def test_lines_run_one_after_the_other_up_to_the_first_that_fails(tmp_path, home):
    lines = [["explain", "app-busy"], ["explain", "no such code"], ["explain", "app-port"]]
    job = ended(home, start(tmp_path, home, "explain", lines))
    assert job.status == "failed" and job.codes == (0, 2)
    assert "one command at a time" in job.result and "no such code" in job.said
    assert (home / "session.sh").read_text().splitlines()[2:] == [shown(line) for line in lines]
    assert shown(lines[1]) == "daest explain 'no such code'"


SLOW = """
import signal, sys, time
from pathlib import Path
def end(*_):
    Path("told").touch()
    sys.exit(130)
signal.signal(signal.SIGTERM, end)
Path("begun").touch()
time.sleep(120)
"""
MAIN = "from daest.cli.main import main; main()"


@pytest.fixture
def slow(tmp_path, monkeypatch):
    """Lines are run by a `daest` that takes its time."""
    package = tmp_path / "fake" / "daest"
    package.mkdir(parents=True)
    import daest

    own = Path(daest.__file__).parent
    for entry in own.iterdir():
        if entry.name not in ("__main__.py", "__pycache__"):
            (package / entry.name).symlink_to(entry)
    (package / "__main__.py").write_text(SLOW)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "fake"))


def begun(tmp_path: Path) -> None:
    began = time.monotonic()
    while not (tmp_path / "begun").exists():
        assert time.monotonic() - began < PATIENCE
        time.sleep(0.02)


def test_stop_ends_a_command_and_begins_no_other(tmp_path, home, slow):
    number = start(tmp_path, home, "improve", [["a"], ["b"]])
    begun(tmp_path)
    with pytest.raises(ConfigError) as caught:
        start(tmp_path, home, "check", [["check"]])
    assert caught.value.code == "app-busy"
    stop(home, number)
    job = ended(home, number)
    assert job.status == "stopped" and job.codes == (130,) and (tmp_path / "told").exists()
    stop(home, number)  # of one that has ended: nothing


def test_what_was_ended_by_force_is_told_and_leaves_no_process(tmp_path, home, slow):
    number = start(tmp_path, home, "improve", [["a"]])
    begun(tmp_path)
    pid = json.loads((home / "jobs" / "0001" / "job.json").read_text())["pid"]
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    assert ended(home, number).status == "lost"
    began = time.monotonic()
    while any(_lives(child) for child in children):
        assert time.monotonic() - began < 5.0
        time.sleep(0.05)


def _lives(pid: str) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_job_goes_on_without_its_server_and_the_next_one_finds_it(tmp_path, slow):
    """The server is killed; the job it has started is stopped from the page of another one."""
    command = [sys.executable, "-c", MAIN, "app", "--no-browser", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    address = process.stdout.readline().strip()
    try:
        from served import Served

        status, told = Served(tmp_path, address).click(action="check")
        assert status == 200 and told == {"lines": ["daest check -o results/app/check.json"], "job": 1}
        begun(tmp_path)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    with served(tmp_path) as other:
        assert [job["status"] for job in other.state()["jobs"]] == ["running"]
        assert other.click(action="check")[1]["code"] == "app-busy"
        assert other.click(action="stop", job=1)[0] == 200
        assert ended(tmp_path / HOME, 1).status == "stopped"


def test_a_vanished_folder_is_told(tmp_path):
    folder = tmp_path / "project"
    folder.mkdir()
    with served(folder) as server:
        folder.rename(tmp_path / "elsewhere")
        assert server.state() == {"gone": True, "folder": str(folder)}
        assert server.click(action="check")[1]["code"] == "app-folder-gone"
        assert server.ask("PUT", "api/drop?name=a.csv", b"1", Origin=f"http://{server.host}")[0] == 409
        assert not folder.exists()


@pytest.mark.slow
def test_a_second_server_and_a_refused_port(tmp_path, capfd):
    command = [sys.executable, "-m", "daest", "app", "--no-browser", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        address = process.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:")
        second = subprocess.run(command, capture_output=True, text=True)
        assert second.returncode == 2 and second.stdout == ""
        assert "error[app-running]" in second.stderr and f"open {address}" in second.stderr
        port = address.split(":")[2].split("/")[0]
        (tmp_path / "other").mkdir()
        there = [*command[:-1], "--port", port, str(tmp_path / "other")]
        other = subprocess.run(there, capture_output=True, text=True)
        assert other.returncode == 2 and "error[app-port]" in other.stderr
        assert (tmp_path / HOME / "server").stat().st_mode & 0o077 == 0  # the token is nobody else's
    finally:
        process.terminate()
        assert process.wait(20) == 0
        process.stdout.close()


def test_no_folder(tmp_path):
    from daest.app.server import serve

    with pytest.raises(ConfigError) as caught:
        serve(tmp_path / "none", 0, False, print)
    assert caught.value.code == "app-folder"


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"current": 3, "steps": []}', '{"current": 0, "steps": [{"number": 1}]}',
                '{"current": 0, "steps": [{"number": 0, "parent": 0, "model": "A.mo"}]}', "[" * 100_000]
)  # fmt: skip
def test_damaged_steps_are_one_message(home, content):
    (home / "story.json").write_text(content)
    with pytest.raises(ConfigError) as caught:
        read_story(home, "A.mo")
    assert caught.value.code == "results-unreadable"


def test_a_job_whose_lock_is_made_but_not_yet_held_is_starting(home):
    folder = home / "jobs" / "0001"
    folder.mkdir(parents=True)
    (folder / "lines.json").write_text("[[]]", encoding="utf-8")
    about = {"action": "", "began": time.time(), "pid": os.getpid()}
    (folder / "job.json").write_text(json.dumps(about), encoding="utf-8")
    (folder / "alive").touch()
    assert [job.status for job in jobs(home)] == ["running"]
    (folder / "alive").write_bytes(b"1")  # a process held it, and holds it no longer
    assert [job.status for job in jobs(home)] == ["lost"]


def test_steps_form_a_tree_of_which_no_branch_is_lost():
    story = Story((read_story(Path("nowhere"), "A.mo").step,))
    one = story.added(HOME, "CoulombFriction", "motor")
    two = one.standing_at(0).added(HOME, "../Odd name", "spring")
    assert [step.number for step in two.path()] == [0, 2] and len(two.steps) == 3
    assert two.step.model == f"{HOME}/models/2____Odd_name.mo"
