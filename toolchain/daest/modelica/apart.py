"""The compiler apart: in a process that may crash, with a cache of its own that is checked before it is read.

The compiler is native code. What it keeps of libraries lies in the folder of `daest.cache`; it trusts that
blindly, so that each file is held against its hash here, and one that is damaged is taken away.
"""

from __future__ import annotations

import _thread
import contextlib
import faulthandler
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from daest.cache import cache_folder, hash_of, keep_content, kept_content
from daest.litter import die_with_parent

T = TypeVar("T")

# The compiler's parser recurses in native code and the conversion of its trees in Python: both get room.
STACK_BYTES = 128 * 1024 * 1024
FOLDER_VARIABLE = "XDG_CACHE_HOME"  # where the compiler looks for the place of its cache
_running: set[int] = set()  # processes that compile


class Crash(Exception):
    """The process of the compiler ended; the text says how."""


def run_apart(work: Callable[..., T], *arguments: Any) -> T:
    """The value of a function of a module, or its exception, from another process. Raises Crash where that
    ended before.

    The other process is a copy of this one where that is safe, which is quick; else a new one.
    """
    status, answer = (_by_copy if _may_copy() else _by_new_process)(work, arguments)
    if status != 0:
        raise Crash(_ending(status))
    is_well, value = pickle.loads(answer)
    if is_well:
        return value
    raise value


def _may_copy() -> bool:
    """Whether all threads of this process are Python's: a pool of threads that native code relies on (that of
    the compiler itself, used by somebody else here) would be missing in a copy."""
    if sys.platform != "linux":
        return False
    # Counted by the interpreter: `threading` does not know what was started below it.
    return len(os.listdir("/proc/self/task")) <= 1 + _thread._count()


def _by_copy(work: Callable[..., Any], arguments: tuple) -> tuple[int, bytes]:
    parent, (read, write) = os.getpid(), os.pipe()
    pid = _forked()
    if pid == 0:
        _answer(work, arguments, write, parent)
    _running.add(pid)
    os.close(write)
    try:
        with os.fdopen(read, "rb") as stream:
            answer = stream.read()
    finally:
        _, status = os.waitpid(pid, 0)
        _running.discard(pid)
    return os.waitstatus_to_exitcode(status), answer


def _by_new_process(work: Callable[..., Any], arguments: tuple) -> tuple[int, bytes]:
    command = [sys.executable, "-c", f"from {__name__} import serve; serve()"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    question = pickle.dumps((os.getpid(), sys.getrecursionlimit(), work, arguments))
    with subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        _running.add(process.pid)
        try:
            answer, _ = process.communicate(question)
        finally:
            process.kill()
            _running.discard(process.pid)
    return process.returncode, answer


def serve() -> None:
    """In the new process: answer one question of `run_apart`, with a deep stack for the compiler's parser."""
    parent, limit, work, arguments = pickle.load(sys.stdin.buffer)
    sys.setrecursionlimit(limit)
    write = os.dup(1)
    os.dup2(2, 1)
    threading.stack_size(STACK_BYTES)
    thread = threading.Thread(target=_answer, args=(work, arguments, write, parent))
    thread.start()
    thread.join()


def stop() -> None:
    """End the processes that compile."""
    for pid in list(_running):
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGKILL)


def _forked() -> int:
    with warnings.catch_warnings():
        # The copy has one thread, which runs the compiler and ends; no lock of another one is wanted there.
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _answer(work: Callable[..., Any], arguments: tuple, write: int, parent: int) -> None:
    """In the other process: send the value or the exception, and end without what runs at exit."""
    status = 1
    try:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, signal.SIG_DFL)
        die_with_parent(parent)
        _without_core()
        with os.fdopen(write, "wb") as stream:
            stream.write(_outcome(work, arguments))
        status = 0
    finally:
        os._exit(status)


def _outcome(work: Callable[..., Any], arguments: tuple) -> bytes:
    try:
        return pickle.dumps((True, work(*arguments)), protocol=pickle.HIGHEST_PROTOCOL)
    except BaseException as problem:
        try:
            return pickle.dumps((False, problem.with_traceback(None)))
        except Exception:  # a panic of native code may be an exception that cannot be sent
            return pickle.dumps((False, RuntimeError(str(problem))))


def _without_core() -> None:
    """A crash leaves no file, and says nothing by itself."""
    faulthandler.disable()
    with contextlib.suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _ending(status: int) -> str:
    if status > 0:
        return f"it ended with status {status}"
    with contextlib.suppress(ValueError):
        return f"it was ended by {signal.Signals(-status).name}"
    return f"it was ended by signal {-status}"


# The cache --------------------------------------------------------------------------------------------------


@contextmanager
def checked_cache() -> Iterator[None]:
    """The compiler keeps what it has read of libraries in the folder of `daest.cache`, and finds there only
    what it left."""
    folder = compiler_cache()
    hashes = _checked(folder)
    before = os.environ.get(FOLDER_VARIABLE)
    os.environ[FOLDER_VARIABLE] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ[FOLDER_VARIABLE]
        else:
            os.environ[FOLDER_VARIABLE] = before
    _remember(folder, hashes)


def compiler_cache() -> Path:
    """The folder of the compiler's cache."""
    return cache_folder() / "compiler"


def throw_cache_away() -> None:
    """Let the compiler read all libraries anew."""
    shutil.rmtree(compiler_cache(), ignore_errors=True)


# What is known of a file: its hash, and what the file system says of it. Hashing thousands of files at every
# compilation would take longer than compiling; a file that nobody has touched since is not read again.
_Known = dict[str, tuple[str, list[int]]]


def _entries(folder: Path) -> Iterator[tuple[str, list[int]]]:
    """Paths of the compiler's files, and what changes when one of them is written to."""
    waiting = [str(folder)]
    while waiting:
        with contextlib.suppress(OSError), os.scandir(waiting.pop()) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
                elif entry.name.endswith(".bin"):
                    state = entry.stat(follow_symlinks=False)
                    yield entry.path, [state.st_size, state.st_ino, state.st_mtime_ns, state.st_ctime_ns]


def _index(folder: Path) -> Path:
    return folder / "hashes"


def _checked(folder: Path) -> _Known:
    """The files that are as they were left; others are removed."""
    content = kept_content(_index(folder))
    known: _Known = {} if content is None else json.loads(content)
    good: _Known = {}
    for path, state in _entries(folder):
        hashed, before = known.get(path, ("", []))
        with contextlib.suppress(OSError):
            if hashed and (state == before or hash_of(Path(path)) == hashed):
                good[path] = (hashed, state)
            else:
                os.unlink(path)
    return good


def _remember(folder: Path, known: _Known) -> None:
    found = dict(known)
    for path, state in _entries(folder):
        if path not in found:
            with contextlib.suppress(OSError):
                found[path] = (hash_of(Path(path)), state)
    if found != known:
        keep_content(_index(folder), json.dumps(found).encode())
