"""What must not outlive this process: files, folders and processes that are removed when it dies, however it
dies.

A small process beside this one knows them and waits for its end, which the system tells by closing a pipe.
Where processes cannot be started so (Windows), litter stays after a process that is ended by force.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux
POLL_SECONDS = 0.5  # between two looks at whether the parent lives, where the system does not tell
_SWEEPER = """
import json, os, shutil, signal, sys
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
os.chdir("/")
known = {}
for line in sys.stdin:
    is_there, kind, what = json.loads(line)
    if is_there:
        known[kind, what] = None
    else:
        known.pop((kind, what), None)
def end_marked(mark):
    for name in os.listdir("/proc") if os.path.isdir("/proc") else ():
        try:
            with open(f"/proc/{name}/environ", "rb") as found:
                if name.isdigit() and int(name) != os.getpid() and mark.encode() in found.read():
                    os.kill(int(name), signal.SIGKILL)
        except OSError:
            pass
for kind, what in reversed(list(known)):
    try:
        if kind == "marked":
            end_marked(what)
            end_marked(what)
        elif kind == "group":
            os.killpg(what, signal.SIGKILL)
        elif os.path.isdir(what) and not os.path.islink(what):
            shutil.rmtree(what, ignore_errors=True)
        else:
            os.unlink(what)
    except OSError:
        pass
"""


@contextmanager
def removed_at_death(path: Path) -> Iterator[None]:
    """The file or folder `path`, which may not exist yet, does not stay where this process dies inside the
    block."""
    name = os.path.abspath(path)
    _tell(True, "path", name)
    try:
        yield
    finally:
        _tell(False, "path", name)


@contextmanager
def ended_at_death(group: int) -> Iterator[None]:
    """The process group does not go on where this process dies inside the block."""
    _tell(True, "group", group)
    try:
        yield
    finally:
        _tell(False, "group", group)


def follow_folder(folder: Path, is_there: bool) -> None:
    """From now on (or no longer) the folder is removed when this process dies, and the processes are ended
    whose environment names it."""
    _tell(is_there, "path", os.path.abspath(folder))
    _tell(is_there, "marked", os.path.abspath(folder))


def removed_at_the_end(path: Path) -> None:
    """The file or folder `path` does not stay when this process ends."""
    _tell(True, "path", os.path.abspath(path))


@contextmanager
def passing_folder(prefix: str, parent: Path | None = None) -> Iterator[Path]:
    """A temporary folder, in `parent` or where the system has them, for the time of a block."""
    folder = Path(tempfile.gettempdir() if parent is None else parent) / f"{prefix}{secrets.token_hex(8)}"
    with removed_at_death(folder):
        try:
            folder.mkdir(mode=0o700)
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def run_program(command: Sequence[str], work: Path, seconds: float) -> subprocess.CompletedProcess[str]:
    """Run a program in the folder `work`, where its temporary files go, too. It ends with this process, and
    with it those that it started. Raises OSError and subprocess.TimeoutExpired."""
    with subprocess.Popen(
        command, cwd=work, env={**os.environ, "TMPDIR": str(work)}, text=True, errors="replace",
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process, ended_at_death(process.pid):  # fmt: skip
        try:
            out, err = process.communicate(timeout=seconds)
        except BaseException:
            _end(process)
            raise
    return subprocess.CompletedProcess(command, process.returncode, out, err)


def _end(process: subprocess.Popen) -> None:
    if os.name == "posix":
        with contextlib.suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()


def die_with_parent(parent: int) -> None:
    """Let this process be killed when `parent`, the process that made it, ends; at once if it has ended.

    On Linux the system does it, and counts the thread that made this process as the parent. Elsewhere a
    thread looks for the parent from time to time.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PARENT_DEATH_SIGNAL, signal.SIGKILL)
    elif os.name == "posix":
        threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    if os.name == "posix" and os.getppid() != parent:
        os._exit(1)


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(POLL_SECONDS)
    os._exit(1)


# The process that sweeps ------------------------------------------------------------------------------------

_lock = threading.Lock()
_pipe: tuple[int, int] | None = None  # this process, and the end of the pipe that it writes to


def _tell(is_there: bool, kind: Literal["path", "group", "marked"], what: str | int) -> None:
    if not hasattr(os, "posix_spawn"):
        return
    line = json.dumps([is_there, kind, what]).encode() + b"\n"
    with _lock, contextlib.suppress(OSError):  # without it litter may stay, which is no reason to fail
        os.write(_sweeper(), line)


def _sweeper() -> int:
    """The pipe to the process that sweeps for this one; a fork starts its own."""
    global _pipe
    if _pipe is None or _pipe[0] != os.getpid():
        if _pipe is not None:
            os.close(_pipe[1])
        _pipe = os.getpid(), _started()
    return _pipe[1]


def _started() -> int:
    read, write = os.pipe()
    try:
        nothing = [(os.POSIX_SPAWN_OPEN, n, os.devnull, os.O_WRONLY, 0) for n in (1, 2)]
        os.posix_spawn(
            sys.executable,
            [sys.executable, "-I", "-S", "-c", _SWEEPER],
            {},
            file_actions=[(os.POSIX_SPAWN_DUP2, read, 0), *nothing],
            setsid=True,
        )
    except (OSError, NotImplementedError):
        os.close(write)
        raise OSError("no process can be started") from None
    finally:
        os.close(read)
    return write
