"""Running the Modelica compiler: one session per compilation, its failures as `ModelError`s."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import rumoca

from daest.modelica import adapter, failures
from daest.modelica import syntax as s
from daest.modelica.outline import within
from daest.modelica.tokens import check_depth

T = TypeVar("T")

# The compiler's parser recurses in native code and the conversion of its trees in Python: both get room.
_STACK_BYTES = 512 * 1024 * 1024
_RECURSION_LIMIT = 40_000

# A folder that does not exist: the compiler reads every .mo file beside the file that it is given.
_ALONE = Path("/daest-single-file")


@dataclass(frozen=True)
class Job:
    """What to compile: the text of a file (UTF-8, no byte order mark), the class in it, and library folders."""

    path: Path
    text: bytes
    class_name: str
    roots: tuple[Path, ...]


def with_room(work: Callable[[], T]) -> T:
    """`work()` with a deep stack. Exceptions come through."""
    result: list[T] = []
    problem: list[BaseException] = []

    def run() -> None:
        try:
            result.append(work())
        except BaseException as caught:
            problem.append(caught)

    size, limit = threading.stack_size(_STACK_BYTES), sys.getrecursionlimit()
    sys.setrecursionlimit(max(limit, _RECURSION_LIMIT))
    try:
        thread = threading.Thread(target=run, name="daest-modelica")
        thread.start()
        thread.join()
    finally:
        threading.stack_size(size)
        sys.setrecursionlimit(limit)
    if problem:
        raise problem[0]
    return result[0]


def compile_source(job: Job, appended: bytes = b"") -> s.FlatSource:
    """The flat form of a job; `appended` Modelica text goes behind the file's own (its class is compiled then if
    it is named `Daest__…`). Raises ModelError."""
    check_depth(str(job.path), job.text)
    text = job.text + appended
    name = _compiled_name(job, appended)
    try:
        model = _load(job, text.decode("utf-8"), name)
        flat = model.to_dict("flat")
        files = model.to_dict("dae")["source_map"]["files"]
    except rumoca.RumocaError as problem:
        raise failures.translated(str(problem), job.path, job.text, job.class_name) from None
    except Exception as problem:
        raise failures.internal(problem, job.path) from None
    except BaseException as problem:  # a panic of the compiler is no Exception
        if isinstance(problem, KeyboardInterrupt | SystemExit):
            raise
        raise failures.internal(problem, job.path) from None
    return adapter.flat_source(job.class_name, flat, _texts(files, job))


def _compiled_name(job: Job, appended: bytes) -> str:
    if not appended:
        return job.class_name
    inside = within(job.text)
    return f"{inside}.{WRAPPER}" if inside else WRAPPER


WRAPPER = "Daest__Wrapper"


def wrapper(
    class_name: str, modification: str = "", equations: Sequence[str] = (), declarations: str = ""
) -> bytes:
    """A class that extends `class_name`, to be appended to its file."""
    body = "".join(f" {equation};" for equation in equations)
    section = f" equation{body}" if equations else ""
    text = f"\nmodel {WRAPPER} extends {class_name}{modification};{declarations}{section} end {WRAPPER};\n"
    return text.encode()


def _load(job: Job, text: str, name: str) -> Any:
    session = rumoca.Session(roots=[str(root) for root in job.roots])
    try:
        return session.loads(text, model=name, filename=str(_file_name(job)))
    except rumoca.RumocaError as problem:
        if "unresolved type" not in str(problem) or _in_package(job):
            raise
    # The class that is missing may stand in a file beside this one.
    session = rumoca.Session(roots=[str(root) for root in job.roots])
    return session.loads(text, model=name, filename=str(job.path.resolve()))


def _file_name(job: Job) -> Path:
    return job.path.resolve() if _in_package(job) else _ALONE / job.path.name


def _in_package(job: Job) -> bool:
    """Whether the file is one of a package that is stored as a folder."""
    return bool(within(job.text)) and (job.path.resolve().parent / "package.mo").is_file()


def _texts(files: list[Any], job: Job) -> dict[int, tuple[str, bytes]]:
    found = {}
    own = str(_ALONE / job.path.name)
    for number, name, text in files:
        is_own = name in (own, str(job.path.resolve()))
        found[number] = (str(job.path), job.text) if is_own else (name, text.encode())
    return found
