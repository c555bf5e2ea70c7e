"""Writing files, whole or not at all (pipes and devices are written to), and what must not outlive this
process: files, folders and processes that are removed when it dies, however it dies.

A small process beside this one knows what is to be removed and waits for its end, which the system tells by
closing a pipe. Where processes cannot be started so (Windows), litter stays after a process that is ended by
force.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import json
import os
import secrets
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from daest.errors import printable

MODEL_SUFFIXES = (".mo", ".bmo", ".fmu")  # of files that hold a model
FOLDER = "is a folder, not a file"  # what `why_no_file` says of one
MOST_LINKS = 40  # that are followed to an open file, as many as Linux follows


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary file that becomes `path` when the block ends well, and vanishes otherwise.

    A regular file is replaced as a whole; where `path` is a link, the file that it leads to. Pipes, terminals
    and other devices are written to. A reader of a pipe that has gone is no error. Raises OSError.
    """
    descriptor, target = _own_descriptor(path), Path(os.path.realpath(path))
    is_stream = descriptor is not None or _is_stream(path)
    with _temporary(path.suffix, None if is_stream else target.parent) as temporary:
        yield temporary
        if is_stream:
            _send(temporary, path, descriptor)
        else:
            temporary.chmod(_usual_mode(target))
            os.replace(temporary, target)


@contextmanager
def _temporary(suffix: str, folder: Path | None) -> Iterator[Path]:
    """An empty file that goes at the end, also where the program is ended before that."""
    place = Path(tempfile.gettempdir()) if folder is None else folder
    temporary = place / f".daest-{secrets.token_hex(8)}{suffix}"
    with removed_at_death(temporary):
        try:
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
            yield temporary
        finally:
            temporary.unlink(missing_ok=True)


def _is_stream(path: Path) -> bool:
    """Whether what stands at `path` is neither absent nor a regular file. Raises OSError for a folder, and
    where links lead in a circle."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return False
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    return not stat.S_ISREG(mode)


def why_no_file(path: Path) -> str | None:
    """What a path is that does not name a regular file, as the end of a sentence; None where it does."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        if path.is_symlink():
            return f"is a link to {printable(os.readlink(path))}, which does not exist"
        return "does not exist"
    except OSError as error:
        if error.errno == errno.ELOOP:
            return "is a link that leads in a circle"
        return f"cannot be reached: {error.strerror or error}"
    except ValueError:  # a zero byte in the name
        return "does not exist"
    kinds = ((stat.S_ISDIR, "folder"), (stat.S_ISFIFO, "pipe"), (stat.S_ISSOCK, "socket"))
    found = next((name for asks, name in kinds if asks(mode)), "device")
    return None if stat.S_ISREG(mode) else f"is a {found}, not a file"


def _own_descriptor(path: Path) -> int | None:
    """The number of an open file of this process that `path` names, as /dev/stdout and /dev/fd/63 do. Its
    content is continued, not replaced."""
    found = path
    for _ in range(MOST_LINKS):
        if found.name.isdigit() and os.path.realpath(found.parent) in _descriptor_folders():
            return int(found.name)
        if not found.is_symlink():
            return None
        found = found.parent / os.readlink(found)
    return None


def _descriptor_folders() -> set[str]:
    return {os.path.realpath(folder) for folder in ("/proc/self/fd", "/proc/thread-self/fd", "/dev/fd")}


def _send(content: Path, path: Path, descriptor: int | None) -> None:
    opened = os.open(path, os.O_WRONLY) if descriptor is None else os.dup(descriptor)
    with content.open("rb") as source:
        try:
            with os.fdopen(opened, "wb") as stream:
                shutil.copyfileobj(source, stream)
        except BrokenPipeError:
            return


def _usual_mode(path: Path) -> int:
    if path.exists():
        return path.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux
POLL_SECONDS = 0.5  # between two looks at whether the parent lives, where the system does not tell
_SWEEPER = """
import os, signal, sys
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
os.chdir("/")
known = {}
for line in sys.stdin:
    if line[0] == "+":
        known[line[1:]] = None
    else:
        known.pop(line[1:], None)
if known:  # these two take longer than all else
    import json, shutil
def end_marked(mark):
    for name in os.listdir("/proc") if os.path.isdir("/proc") else ():
        try:
            with open(f"/proc/{name}/environ", "rb") as found:
                if name.isdigit() and int(name) != os.getpid() and mark.encode() in found.read():
                    os.kill(int(name), signal.SIGKILL)
        except OSError:
            pass
for line in reversed(list(known)):
    kind, what = json.loads(line)
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
    line = f"{'+' if is_there else '-'}{json.dumps([kind, what])}\n".encode()
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
