"""Where results go: files, links, pipes, devices, and streams that are closed or full."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from daest.cli.streams import fitted
from daest.files import whole_file

POSIX = pytest.mark.skipif(os.name != "posix", reason="pipes and devices of POSIX")
FULL = Path("/dev/full")
NEEDS_FULL = pytest.mark.skipif(not FULL.exists(), reason="the system has no /dev/full")
# The schema of the command whose documents need no numerics: these tests start it dozens of times.
COMMAND = (sys.executable, "-m", "daest", "schema", "watch")


def shell(words: str, folder: Path) -> subprocess.CompletedProcess:
    """A line of bash in which `daest` stands for the short command of these tests."""
    line = words.replace("daest", " ".join(COMMAND))
    return subprocess.run(
        ["bash", "-c", line], cwd=folder, capture_output=True, text=True, timeout=60, check=False
    )


def write(path: Path, text: str = "new") -> None:
    with whole_file(path) as temporary:
        temporary.write_text(text)


@POSIX
def test_a_link_stays_and_its_target_is_replaced(tmp_path):
    (tmp_path / "deep").mkdir()
    target, link = tmp_path / "deep" / "target.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to("deep/target.txt")
    write(link)
    assert link.is_symlink() and target.read_text() == "new"
    target.unlink()
    write(link, "again")  # a link to nothing makes what it leads to
    assert link.is_symlink() and target.read_text() == "again"
    assert sorted(tmp_path.rglob(".daest-*")) == []


@POSIX
def test_a_pipe_is_written_to_and_stays(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    heard = []
    reader = threading.Thread(target=lambda: heard.append(pipe.read_text()))
    reader.start()
    write(pipe, "x" * 200_000)
    reader.join(10)
    assert heard == ["x" * 200_000] and pipe.is_fifo() and os.listdir(tmp_path) == ["pipe"]


@POSIX
@pytest.mark.parametrize("device", ["/dev/null", "own"])
def test_a_device_stays_a_device(tmp_path, device):
    """Through a link of our own: the devices of the system are never in danger here."""
    link = tmp_path / "out"
    if device == "own":
        device = str(tmp_path / "node")
        try:
            os.mknod(device, 0o600 | 0o020000, os.makedev(1, 3))
            os.close(os.open(device, os.O_WRONLY))
        except OSError:
            pytest.skip("devices cannot be made here")
    link.symlink_to(device)
    write(link)
    assert link.is_symlink() and Path(device).is_char_device()


@POSIX
def test_a_folder_or_a_circle_of_links_is_refused_before_anything_is_computed(tmp_path):
    (tmp_path / "circle").symlink_to("circle")
    for name in ("circle", "."):
        with pytest.raises(OSError), whole_file(tmp_path / name):
            raise AssertionError("the block must not be entered")
    assert os.listdir(tmp_path) == ["circle"]


@POSIX
@pytest.mark.parametrize(
    "line",
    [
        "daest -o >(cat > copy); sleep 0.5; cat copy",
        "daest -o /proc/self/fd/1",
        "daest -o /dev/stdout",
        "daest -o /proc/self/fd/1 > copy; cat copy",
        "printf '' > copy; daest -o /dev/stdout >> copy; cat copy",
        "mkfifo pipe; cat pipe & daest -o pipe; wait",
        "ln -s /dev/stdout link; daest -o link",
        "daest | cat",
    ],
)
def test_results_by_a_shell(tmp_path, line):
    if "/proc" in line and not Path("/proc/self/fd").exists():
        pytest.skip("no /proc")
    done = shell(line, tmp_path)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert json.loads(done.stdout)["title"]


@POSIX
def test_a_reader_that_goes_is_no_error(tmp_path):
    done = shell("daest -o >(true); echo $?", tmp_path)
    assert (done.stdout, done.stderr) == ("0\n", "")
    done = shell("set -o pipefail; daest | true; echo $?", tmp_path)
    assert (done.stdout, done.stderr) == ("0\n", "")


@POSIX
def test_closed_stdout_loses_nothing_and_says_so(tmp_path):
    done = shell("daest >&-; echo $? > code", tmp_path)
    assert (tmp_path / "code").read_text() == "0\n"
    assert done.stderr.startswith("note: stdout is closed") and "Traceback" not in done.stderr
    done = shell("daest -o result.json >&- <&- 2>&-", tmp_path)
    assert done.returncode == 0 and json.loads((tmp_path / "result.json").read_text())


@POSIX
@NEEDS_FULL
@pytest.mark.parametrize("line", ["daest > /dev/full", "daest -o /dev/full", "daest -h > /dev/full"])
def test_full_disk(tmp_path, line):
    done = shell(line, tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("error[output-unwritable]: the result cannot be written: No space left")
    assert "\n  help: " in done.stderr and "Traceback" not in done.stderr and "Exception" not in done.stderr


@POSIX
@NEEDS_FULL
@pytest.mark.parametrize("end", ["2> /dev/full", "2>&-"])
def test_stderr_that_takes_nothing_decides_nothing(tmp_path, end):
    assert shell(f"daest {end}", tmp_path).returncode == 0
    assert shell(f"daest nonsense {end}", tmp_path).returncode == 2


@POSIX
@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT", "SIGHUP"])
def test_signals_that_ask_for_the_end(tmp_path, name):
    """A command that waits for the reader of a pipe is ended by each, and leaves nothing."""
    os.mkfifo(tmp_path / "pipe")
    process = subprocess.Popen(
        [*COMMAND, "-o", "pipe"], cwd=tmp_path, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )  # fmt: skip
    for _ in range(200):  # the result is written in a temporary file before it goes into the pipe
        if list(tmp_path.glob(".daest-*")):
            break
        threading.Event().wait(0.05)
    process.send_signal(getattr(signal, name))
    _, said = process.communicate(timeout=10)
    assert (process.returncode, said.strip()) == (130, "interrupted")
    assert os.listdir(tmp_path) == ["pipe"]


@POSIX
def test_nothing_stays_of_a_file_that_is_written_when_its_process_is_killed(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    script = (
        "import os, sys, time\nfrom pathlib import Path\nfrom daest.files import whole_file\n"
        "with whole_file(Path('result')) as temporary:\n"
        "    temporary.write_text('half')\n    print('now', flush=True)\n    time.sleep(60)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "now\n"
    assert len(list(tmp_path.glob(".daest-*"))) == 1
    process.kill()
    process.wait()
    for _ in range(40):
        if os.listdir(tmp_path) == ["pipe"]:
            return
        threading.Event().wait(0.05)
    raise AssertionError(os.listdir(tmp_path))


@pytest.mark.parametrize("width", [60, 80, 140])
def test_messages_end_their_lines_between_words(width):
    text = "error[data-unit]: " + "the column 'n [1/min]' of 7.9e-12 does not fit " * 5 + "\n  --> run.csv:1"
    text += "\n  help: " + "write rpm for turns, or rad/min for angles, in the header " * 3
    shown = fitted(text, width)
    assert shown.split() == text.split()
    lines = shown.splitlines()
    assert max(map(len, lines)) <= width and "  --> run.csv:1" in lines
    assert fitted("a/path/" * 40, width) == "a/path/" * 40


@POSIX
def test_a_terminal_gets_short_lines_and_a_pipe_whole_ones(tmp_path):
    import pty

    command = [sys.executable, "-m", "daest", "check", "no model here " * 8 + ".mo"]
    surroundings = {**os.environ, "COLUMNS": "60"}
    piped = subprocess.run(command, cwd=tmp_path, env=surroundings, stderr=subprocess.PIPE, text=True).stderr
    near, far = pty.openpty()
    subprocess.run(command, cwd=tmp_path, env=surroundings, stdin=far, stdout=far, stderr=far)
    os.close(far)
    shown = os.read(near, 10_000).decode()
    os.close(near)
    assert max(map(len, shown.splitlines())) <= 60 < max(map(len, piped.splitlines()))
    assert shown.split() == piped.split()
