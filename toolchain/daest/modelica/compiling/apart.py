"""The compiler apart: in a process that may crash, with a cache of its own that is checked before it is read.

The compiler is native code. What it keeps of libraries lies in the folder of `daest.cache`; it trusts that
blindly, so that each file is held against its hash here, and one that is damaged is taken away.
"""

from __future__ import annotations

import _thread
import atexit
import contextlib
import faulthandler
import gc
import json
import os
import pickle
import queue
import shutil
import signal
import struct
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, TypeVar

from daest.cache import cache_folder, forget_unused, hash_of, keep_content, kept_content
from daest.files import die_with_parent

T = TypeVar("T")

# The compiler's parser recurses in native code and the conversion of its trees in Python: both get room.
STACK_BYTES = 128 * 1024 * 1024
FOLDER_VARIABLE = "XDG_CACHE_HOME"  # where the compiler looks for the place of its cache
_LENGTH = struct.Struct("<Q")  # of a message, in front of it
_BEGUN = b""  # what is sent when a question has been read
MOST_KEPT = 3000  # files in a folder of the compiler's cache: the Standard Library has some 500
_ANSWERS = 200  # after so many the process is replaced: native code may keep memory


class Crash(Exception):
    """The process of the compiler ended; the text says how."""


class Stopped(Exception):
    """The process of the compiler was ended by `stop`."""


def run_apart(work: Callable[..., T], *arguments: Any) -> T:
    """The value of a function of a module, or its exception, from another process. Raises Crash where that
    ended before, and Stopped after `stop`.

    The other process stays and answers the next question, too. It is a copy of this one where that is safe,
    which is quick; else a new one.
    """
    return _asker().ask(work, arguments)


def stop() -> None:
    """End the process that compiles."""
    if _only is not None:
        _only.end()


class _Other:
    """A process that answers questions; `environment` is what it was started with."""

    def __init__(self, environment: str | None) -> None:
        self.environment = environment
        self.n_answers = 0
        self.is_stopped = False
        self._process: subprocess.Popen | None = None
        if _may_copy():
            self.pid, self._questions, self._answers = _copy()
        else:
            self._process = process = _new_process()
            assert process.stdin is not None and process.stdout is not None
            self.pid, self._questions, self._answers = process.pid, process.stdin, process.stdout
        self._status: int | None = None

    def has_begun(self, question: bytes) -> bool:
        """Whether it has read the question, and works."""
        self.n_answers += 1
        try:
            _send(self._questions, question)
            return _received(self._answers) == _BEGUN
        except OSError:
            return False

    def answer(self) -> bytes | None:
        """Its answer; None where it ended before."""
        try:
            return _received(self._answers)
        except OSError:
            return None

    def is_lost(self) -> bool:
        if self.is_stopped:
            return True
        if self._status is None and self._process is not None:
            self._status = self._process.poll()
        elif self._status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._status = os.waitstatus_to_exitcode(status) if pid else None
        return self._status is not None

    def kill(self) -> None:
        if self._status is None:
            with contextlib.suppress(OSError):
                os.kill(self.pid, signal.SIGTERM if sys.platform == "win32" else signal.SIGKILL)

    def ending(self) -> int:
        """Its exit code, awaited."""
        if self._status is None and self._process is not None:
            self._status = self._process.wait()
        elif self._status is None:
            self._status = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        for stream in (self._questions, self._answers):
            with contextlib.suppress(OSError):
                stream.close()
        return self._status


class _Asker:
    """The thread that owns the other process. The system ends that with the thread which started it, so that
    this one lasts as long as the program."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Future, bytes]] = queue.SimpleQueue()
        self._other: _Other | None = None
        size = threading.stack_size(
            STACK_BYTES
        )  # a copy of the process has the stack of the thread that made it
        try:
            threading.Thread(target=self._run, name="daest-compiler", daemon=True).start()
        finally:
            threading.stack_size(size)

    def ask(self, work: Callable[..., T], arguments: tuple) -> T:
        answer: Future[T] = Future()
        self._waiting.put((answer, pickle.dumps((_folder(), sys.getrecursionlimit(), work, arguments))))
        return answer.result()

    def end(self) -> None:
        if (other := self._other) is not None:
            other.is_stopped = True
            other.kill()

    def _run(self) -> None:
        while True:
            answer, question = self._waiting.get()
            try:
                answer.set_result(self._answered(question))
            except BaseException as problem:
                answer.set_exception(problem)
            del answer, question

    def _answered(self, question: bytes) -> Any:
        other = self._ready()
        if not other.has_begun(question) and not other.is_stopped:
            # It was killed while nobody asked, and the system had not said so yet.
            self._give_up(other)
            other = self._ready()
            other.has_begun(question)
        content = other.answer()
        if content is None:
            status = self._give_up(other)
            raise Stopped if other.is_stopped else Crash(_ending(status))
        is_well, value = pickle.loads(content)
        if is_well:
            return value
        raise value

    def _give_up(self, other: _Other) -> int:
        self._other = None
        other.kill()
        return other.ending()

    def _ready(self) -> _Other:
        """The other process: as it is, or another one where it has ended, has worked for long, or was started
        with another cache."""
        environment = os.environ.get(FOLDER_VARIABLE)
        other = self._other
        if other is not None and (
            other.is_lost() or other.n_answers >= _ANSWERS or other.environment != environment
        ):
            self._give_up(other)
        self._other = self._other or _Other(environment)
        return self._other


def _folder() -> str:
    with contextlib.suppress(OSError):  # the folder is gone
        return os.getcwd()
    return os.sep


_only: _Asker | None = None
_lock = threading.Lock()


def _asker() -> _Asker:
    global _only
    with _lock:
        if _only is None:
            _only = _Asker()
        return _only


def _forget() -> None:
    """A copy of this process has neither the thread nor the process that answers it."""
    global _only, _lock
    _only, _lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
atexit.register(stop)


def _may_copy() -> bool:
    """Whether all threads of this process are Python's: a pool of threads that native code relies on (that of
    the compiler itself, used by somebody else here) would be missing in a copy."""
    if sys.platform != "linux":
        return False
    # Counted by the interpreter: `threading` does not know what was started below it.
    return len(os.listdir("/proc/self/task")) <= 1 + _thread._count()


def _copy() -> tuple[int, IO[bytes], IO[bytes]]:
    """A copy of this process that answers: its number, and where to write to and to read from."""
    parent, (question, ask), (told, tell) = os.getpid(), os.pipe(), os.pipe()
    with warnings.catch_warnings():
        # The copy has one thread, which runs the compiler and ends; no lock of another one is wanted there.
        warnings.simplefilter("ignore", DeprecationWarning)
        pid = os.fork()
    if pid == 0:
        try:
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                with contextlib.suppress(ValueError):  # not the main thread
                    signal.signal(number, signal.SIG_DFL)
            _close_all_but(question, tell)
            _answer_all(os.fdopen(question, "rb"), os.fdopen(tell, "wb"), parent)
        finally:
            os._exit(1)
    os.close(question)
    os.close(tell)
    return pid, os.fdopen(ask, "wb"), os.fdopen(told, "rb")


def _close_all_but(*kept: int) -> None:
    """Keep nothing open that others wait for the end of."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for standard in (0, 1, 2):
        os.dup2(nothing, standard)
    last = 2
    for descriptor in sorted(kept):
        os.closerange(last + 1, descriptor)
        last = descriptor
    os.closerange(last + 1, os.sysconf("SC_OPEN_MAX"))


def _new_process() -> subprocess.Popen:
    command = [sys.executable, "-c", f"from {__name__} import serve; serve({os.getpid()})"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )


def serve(parent: int) -> None:
    """In the new process: answer the questions of `run_apart`, with a deep stack for the parser."""
    question, tell = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    threading.stack_size(STACK_BYTES)
    thread = threading.Thread(target=_answer_all, args=(question, tell, parent))
    thread.start()
    thread.join()


def _answer_all(questions: IO[bytes], answers: IO[bytes], parent: int) -> None:
    """In the other process: send values or exceptions until nobody asks; end without what runs at exit."""
    status = 1
    try:
        die_with_parent(parent)
        _without_core()
        gc.disable()  # see `compiler.with_room`; the process is replaced after some answers
        while (question := _received(questions)) is not None:
            _send(answers, _BEGUN)
            folder, limit, work, arguments = pickle.loads(question)
            with contextlib.suppress(OSError):
                os.chdir(folder)
            sys.setrecursionlimit(limit)
            _send(answers, _outcome(work, arguments))
        status = 0
    finally:
        os._exit(status)


def _send(stream: IO[bytes], message: bytes) -> None:
    stream.write(_LENGTH.pack(len(message)))
    stream.write(message)
    stream.flush()


def _received(stream: IO[bytes]) -> bytes | None:
    """The next message; None where there is no other."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (length,) = _LENGTH.unpack(head)
    message = stream.read(length)
    return message if len(message) == length else None


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
def checked_cache(is_read: bool = True) -> Iterator[None]:
    """The compiler keeps what it has read of libraries in the folder of `daest.cache`, and finds there only
    what it left. A compilation that reads no library reads nothing there, either."""
    folder = compiler_cache()
    hashes, folders = _checked(folder) if is_read else ({}, [])
    changes = _last_changes(folders)
    before = os.environ.get(FOLDER_VARIABLE)
    os.environ[FOLDER_VARIABLE] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ[FOLDER_VARIABLE]
        else:
            os.environ[FOLDER_VARIABLE] = before
    if _last_changes(folders) != changes:
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


def _entries(folder: Path) -> tuple[dict[str, list[int]], list[str]]:
    """Paths of the compiler's files, with what changes when one of them is written to, and all folders."""
    files: dict[str, list[int]] = {}
    folders = [str(folder)]
    for each in folders:
        with contextlib.suppress(OSError), os.scandir(each) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
                elif entry.name.endswith(".bin"):
                    state = entry.stat(follow_symlinks=False)
                    files[entry.path] = [state.st_size, state.st_ino, state.st_mtime_ns, state.st_ctime_ns]
    return files, folders


def _last_changes(folders: Iterable[str]) -> list[int]:
    """When files were last added to folders or taken from them."""
    changes = []
    for folder in folders:
        with contextlib.suppress(OSError):
            changes.append(os.stat(folder).st_mtime_ns)
    return changes


def _index(folder: Path) -> Path:
    return folder / "hashes"


def _checked(folder: Path) -> tuple[_Known, list[str]]:
    """The files that are as they were left, the others being removed; and all folders."""
    content = kept_content(_index(folder))
    known: _Known = {} if content is None else json.loads(content)
    good: _Known = {}
    files, folders = _entries(folder)
    if len(files) > MOST_KEPT:
        _forget_old(files)
        files, folders = _entries(folder)
    for path, state in files.items():
        hashed, before = known.get(path, ("", []))
        with contextlib.suppress(OSError):
            if hashed and (state == before or hash_of(Path(path)) == hashed):
                good[path] = (hashed, state)
            else:
                os.unlink(path)
    return good, folders


def _remember(folder: Path, known: _Known) -> None:
    found = dict(known)
    files, _ = _entries(folder)
    for path, state in files.items():
        if path not in found:
            with contextlib.suppress(OSError):
                found[path] = (hash_of(Path(path)), state)
    if found != known:
        keep_content(_index(folder), json.dumps(found).encode())
        _forget_old(files)


def _forget_old(files: Iterable[str]) -> None:
    for folder in set(map(os.path.dirname, files)):
        forget_unused(Path(folder), MOST_KEPT)
