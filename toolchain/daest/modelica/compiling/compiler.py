"""Running the Modelica compiler: one session per compilation, its failures as `ModelError`s.

Flat sources are kept, so that the next command does not wait again.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import hashlib
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import rumoca

from daest.cache import cache_folder, forget_unused, keep_content, kept_content, was_used
from daest.errors import ModelError
from daest.machine import version
from daest.modelica.compiling import adapter
from daest.modelica.compiling.apart import (
    STACK_BYTES,
    Crash,
    checked_cache,
    run_apart,
    stop,
    throw_cache_away,
)
from daest.modelica.forms.algorithm_text import UnknownNames, algorithm_texts, with_algorithms
from daest.modelica.forms.algorithm_text import hidden as hidden_algorithms
from daest.modelica.forms.clock_names import with_named_clocks
from daest.modelica.forms.dialect import Names
from daest.modelica.forms.function_text import (
    FunctionText,
    called_functions,
    find_function,
    hidden,
    read_function,
    with_body,
    with_products,
)
from daest.modelica.language import failures
from daest.modelica.language import syntax as s
from daest.modelica.language.library import Roots, stamp
from daest.modelica.language.outline import check_depth, class_heads, place_of, within
from daest.modelica.language.parse import ParseError
from daest.numerics.quiet import native_silence

T = TypeVar("T")

_RECURSION_LIMIT = 40_000

# A folder that does not exist: the compiler reads every .mo file beside the file that it is given.
_ALONE = Path("/daest-single-file")

# The class that is put behind a file's own to compile it with other parameter values, or to reach the flat
# form of a model whose equations and unknowns differ in number.
_WRAPPER = "Daest__Wrapper"


@dataclass(frozen=True)
class Job:
    """What to compile: the text of a file (UTF-8, no byte order mark), the class in it, library folders, the
    modification of the class (`n = 3, motor(J = 2)`), and the user's names where the text has others."""

    path: Path
    text: bytes
    class_name: str
    roots: Roots
    modification: str = ""
    names: Names = field(default_factory=Names)


def with_room(work: Callable[[], T]) -> T:
    """`work()` with a deep stack. Exceptions come through.

    The garbage collector rests: the trees of a large model are millions of objects without a cycle, and it
    would look through all of them again and again.
    """
    result: list[T] = []
    problem: list[BaseException] = []

    def run() -> None:
        try:
            result.append(work())
        except BaseException as caught:
            problem.append(caught)

    size, limit = threading.stack_size(STACK_BYTES), sys.getrecursionlimit()
    sys.setrecursionlimit(max(limit, _RECURSION_LIMIT))
    is_collecting = gc.isenabled()
    gc.disable()
    try:
        thread = threading.Thread(target=run, name="daest-modelica")
        thread.start()
        thread.join()
    except BaseException:  # Ctrl-C: the thread would wait for the compiler
        stop()
        raise
    finally:
        threading.stack_size(size)
        sys.setrecursionlimit(limit)
        if is_collecting:
            gc.enable()
    if problem:
        raise problem[0]
    return result[0]


def compile_source(job: Job) -> s.FlatSource:
    """The flat form of a job, also when its equations and unknowns differ in number. Raises ModelError."""
    check_depth(str(job.path), job.text)
    # A file that stands alone means the same in every folder; else its place and its neighbours count.
    meaning = _meaning(job)
    alone = _kept_file(meaning) if _file_name(job).parent == _ALONE else None
    kept = None if alone is None else _read(alone)
    if kept is None:
        beside = _kept_file(meaning, str(job.path), stamp(sorted(job.path.resolve().parent.glob("*.mo"))))
        kept = _read(beside)
    if kept is not None:
        return replace(kept, texts={**kept.texts, **{n: (str(job.path), kept.texts[n][1]) for n in kept.own}})
    source = _compiled_source(job)
    _write(beside if alone is None or not _needs_no_neighbour(source, job) else alone, source)
    return source


def _compiled_source(job: Job) -> s.FlatSource:
    try:
        return _with_functions(job)
    except failures.RefusedClock as problem:
        text = with_named_clocks(job.text)
        if text == job.text:
            raise
        try:
            # Its text stays: all is on the line where the user wrote it, but not at the same byte.
            return _with_functions(replace(job, text=text))
        except ModelError:
            raise problem from None


def _with_functions(job: Job) -> s.FlatSource:
    try:
        return _with_refused_functions(job)
    except failures.BeyondCompiler as problem_with_all:
        first = problem_with_all
        # What the compiler does not take may stand in a function: it is shown none of them.
        short = [h.name.rpartition(".")[2] for h in class_heads(job.text) if h.kind == "function"]
        if not short:
            raise
        for text in dict.fromkeys((job.text, with_products(job.text, short))):
            try:
                return _with_refused_functions(replace(job, text=text), tuple(short))
            except ModelError as problem:
                # That a hidden function is impure is said of the hiding, not of the model.
                if "is impure" in first.what and isinstance(problem, failures.BeyondCompiler):
                    first = problem
        raise first from None


def _with_refused_functions(job: Job, names: tuple[str, ...] = ()) -> s.FlatSource:
    """The flat form, with the functions that the compiler refuses, and `names`, hidden from it."""
    found: list[FunctionText] = []
    shown = job
    for name in names:
        function = find_function(shown.text, name)
        if function is not None:
            found.append(function)
            shown = replace(shown, text=hidden(shown.text, function))
    while True:
        try:
            return _with_bodies(_with_algorithms(shown), found, job)
        except failures.RefusedFunction as problem:
            function = find_function(shown.text, problem.name)
            if function is None:
                raise
            found.append(function)
            shown = replace(shown, text=hidden(shown.text, function))


def _with_algorithms(job: Job) -> s.FlatSource:
    """The flat form of a job; algorithm sections of its file that the compiler refuses are read here."""
    try:
        return _balanced(job)
    except failures.RefusedAlgorithm:
        sections = algorithm_texts(job.text, 0)
        if not sections:
            raise
        asked: tuple[tuple[str, ...], ...] = ((),) * len(sections)
        for _ in range(2):
            text = hidden_algorithms(job.text, sections, asked)
            if text is None:
                break
            source = _unchecked(replace(job, text=text))
            try:
                made = with_algorithms(source, algorithm_texts(job.text, source.own[0]))
            except UnknownNames as problem:
                asked = problem.names
                continue
            functions = dict(made.functions)
            _add_called(functions, job, made.own[0], [one.body for one in made.algorithms])
            texts = {**made.texts, **dict.fromkeys(made.own, (str(job.path), job.text))}
            return replace(made, functions=functions, texts=texts)
        raise


def _balanced(job: Job) -> s.FlatSource:
    try:
        return _compiled(job, _wrapper(job))
    except failures.Unbalanced:
        return _unchecked(job)


def _with_bodies(source: s.FlatSource, found: list[FunctionText], job: Job) -> s.FlatSource:
    """The flat source with the algorithms of functions that were hidden from the compiler, and the true
    text."""
    if not found:
        return source
    functions = dict(source.functions)
    for text in found:
        for name, function in source.functions.items():
            if name.rpartition(".")[2] == text.name and function.is_external:
                functions[name] = _parsed(text, job, source.own[0], function)
    bodies = [function.body for function in functions.values()]
    _add_called(functions, job, source.own[0], bodies)
    texts = {**source.texts, **{number: (str(job.path), job.text) for number in source.own}}
    return replace(source, functions=functions, texts=texts)


def _add_called(functions: dict[str, s.Function], job: Job, own: int, bodies: Iterable[object]) -> None:
    """Functions that only hidden algorithms, `bodies`, call, read from the text."""
    todo = [name for body in bodies for name in called_functions(body)]
    while todo:
        name = todo.pop()
        short = name.rpartition(".")[2]
        if name in functions or any(known.rpartition(".")[2] == short for known in functions):
            continue
        text = find_function(job.text, name)
        if text is not None:
            functions[text.name] = _parsed(text, job, own)
            todo += called_functions(functions[text.name].body)


def _parsed(text: FunctionText, job: Job, own: int, function: s.Function | None = None) -> s.Function:
    """A function with the algorithm of the text, and with the declarations of the compiler if it has them."""
    try:
        if function is None:
            return read_function(text, job.text, own)
        return with_body(function, text, job.text, own)
    except ParseError as problem:
        at = problem.token.start if problem.token else text.start
        raise ModelError(
            "model-function",
            f"function `{text.name}` cannot be read: {problem}",
            where=place_of(str(job.path), job.text, at),
            remedy="Use assignments, if, for, while, break and return, and arguments by position.",
        ) from None


def _unchecked(job: Job) -> s.FlatSource:
    """The flat form of a model whose equations and unknowns differ in number, or are counted wrongly: those
    of a partial model are not counted."""
    return _compiled(job, _wrapper(job, is_partial=True))


def _wrapper(job: Job, is_partial: bool = False) -> bytes:
    """The text to append, empty if the class itself can be compiled."""
    if not is_partial and not job.modification:
        return b""
    modification = f"({job.modification})" if job.modification else ""
    kind = "partial model" if is_partial else "model"
    return f"\n{kind} {_WRAPPER} extends {job.class_name}{modification}; end {_WRAPPER};\n".encode()


def modification(values: Mapping[str, str]) -> str:
    """`{"n": "3", "a.b.n": "2"}` -> `n = 3, a(b(n = 2))`."""
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *path, last = name.split(".")
        node = tree
        for part in path:
            node = node.setdefault(part, {})
        node[last] = value
    return _modification(tree)


def _modification(tree: Mapping[str, Any]) -> str:
    parts = (f"{k}({_modification(v)})" if isinstance(v, dict) else f"{k} = {v}" for k, v in tree.items())
    return ", ".join(parts)


def _compiled(job: Job, appended: bytes) -> s.FlatSource:
    text = (job.text + appended).decode("utf-8")
    try:
        flat, files = _load(job, text, _compiled_name(job, appended))
    except rumoca.RumocaError as problem:
        said, name = job.names.restored(job.roots.in_words_of(str(problem))), job.names.model(job.class_name)
        read = job.roots.origins.values() or job.roots.folders
        raise failures.translated(said, job.path, job.text, name, read) from None
    except BaseException as problem:  # a panic of the compiler is no Exception
        if isinstance(problem, KeyboardInterrupt | SystemExit):
            raise
        raise failures.internal(problem, job.path, job.text) from None
    name = job.names.model(job.class_name)
    own = tuple(number for number, file, _ in files if _is_own(file, job))
    return adapter.flat_source(name, _in_names_of(job, flat), _texts(files, job), own)


def _in_names_of(job: Job, flat: dict[str, Any]) -> dict[str, Any]:
    """The compiler's form with the user's names. In Base Modelica all of it is declared by the model itself,
    dots or not."""
    if not job.names.shown:
        return flat
    flat = job.names.restored(flat)
    outer = {v["name"].partition(".")[0].partition("[")[0] for v in flat["variables"].values()}
    return {**flat, "top_level_connectors": outer}


def _compiled_name(job: Job, appended: bytes) -> str:
    if not appended:
        return job.class_name
    inside = within(job.text)
    return f"{inside}.{_WRAPPER}" if inside else _WRAPPER


def _load(job: Job, text: str, name: str) -> tuple[dict[str, Any], list[Any]]:
    """The compiler's flat form and its source files. A class that is missing may stand in a file beside this
    one; where that does not help, the first failure stands."""
    try:
        return _session(job, text, name, _file_name(job))
    except rumoca.RumocaError as problem:
        if "unresolved type" not in str(problem) or _in_package(job):
            raise
        first = str(problem)
    try:
        return _session(job, text, name, job.path.resolve())
    except rumoca.RumocaError:
        raise rumoca.RumocaError(first) from None


@contextmanager
def _without_search_path() -> Iterator[None]:
    """The compiler does not see MODELICAPATH inside the block: its folders are among the roots already, each
    library once."""
    path = os.environ.pop("MODELICAPATH", None)
    try:
        yield
    finally:
        if path is not None:
            os.environ["MODELICAPATH"] = path


def _session(job: Job, text: str, name: str, file: Path) -> tuple[dict[str, Any], list[Any]]:
    """The compiler's flat form and its source files, from a process that may crash. Where it does, the cache
    of the compiler may be to blame: it is tried once more without."""
    try:
        return _apart(job, text, name, file)
    except Crash:
        throw_cache_away()
        return _apart(job, text, name, file)


def _apart(job: Job, text: str, name: str, file: Path) -> tuple[dict[str, Any], list[Any]]:
    with checked_cache(is_read=bool(job.roots.folders) or file.parent != _ALONE):
        return run_apart(_compiled_here, job, text, name, file)


def _compiled_here(job: Job, text: str, name: str, file: Path) -> tuple[dict[str, Any], list[Any]]:
    with _without_search_path():
        session: Any = rumoca.Session(roots=[str(root) for root in job.roots.folders])
    model: Any = None
    try:
        with native_silence(), _without_search_path():
            model = session.loads(text, model=name, filename=str(file))
            return model.to_dict("flat"), model.to_dict("dae")["source_map"]["files"]
    finally:
        # These objects must die in the thread that made them; a traceback would keep them alive.
        del model, session


def _file_name(job: Job) -> Path:
    file = job.roots.readable(job.path.resolve())
    return file if _in_package(job) or _in_root(file, job) else _ALONE / job.path.name


def _in_root(file: Path, job: Job) -> bool:
    """Whether the file lies in a library folder, where the compiler finds it anyway."""
    return any(file.is_relative_to(folder) for folder in job.roots.folders)


def _in_package(job: Job) -> bool:
    """Whether the file is one of a package that is stored as a folder."""
    return bool(within(job.text)) and (job.path.resolve().parent / "package.mo").is_file()


def _is_own(name: str, job: Job) -> bool:
    file = job.path.resolve()
    return name in (str(_ALONE / job.path.name), str(file), str(job.roots.readable(file)))


def _texts(files: list[Any], job: Job) -> dict[int, tuple[str, bytes]]:
    return {
        number: (str(job.path), job.text) if _is_own(name, job) else (job.roots.original(name), text.encode())
        for number, name, text in files
    }


KEPT_SOURCES, KEPT_BYTES = 2000, 200_000_000
"""Number and size of all flat sources that are kept; those that were not used for longest leave."""


def _meaning(job: Job) -> str:
    """A hash of all but the place of a job's file that decides its flat source."""
    what = f"{job.class_name}({job.modification})"
    parts = [what, job.path.name, version("rumoca"), _code(), stamp(job.roots.folders)]
    return hashlib.sha256("\0".join(parts).encode() + job.text).hexdigest()


@functools.cache
def _code() -> str:
    """What tells this room's code from another version of it: the content of its files. Their times would
    tell copies of the same code apart, and a new checkout or installation would compile everything anew."""
    found = hashlib.sha256()
    for file in sorted(Path(__file__).resolve().parents[1].rglob("*.py")):
        content = file.read_bytes()
        found.update(f"{file.name} {len(content)}\n".encode() + content)
    return found.hexdigest()


def _kept_file(*parts: str) -> Path:
    """Where the flat source that `parts` decide is kept. A cache that cannot be read or written makes no
    difference."""
    return cache_folder() / "flat" / f"{hashlib.sha256(chr(0).join(parts).encode()).hexdigest()}.pickle"


def _needs_no_neighbour(source: s.FlatSource, job: Job) -> bool:
    """Whether the compiler read no file of the folder of the job's own."""
    folder = job.path.resolve().parent
    others = [Path(name) for number, (name, _) in source.texts.items() if number not in source.own]
    return not any(other.resolve().parent == folder for other in others)


def _read(file: Path) -> s.FlatSource | None:
    content = kept_content(file)
    if content is None:
        return None
    try:
        kept = pickle.loads(content)
    except Exception:  # an unreadable entry of the cache, whatever is wrong with it, is no entry
        return None
    was_used(file)
    return kept if isinstance(kept, s.FlatSource) else None


def _write(file: Path, source: s.FlatSource) -> None:
    with contextlib.suppress(OSError, RecursionError):
        keep_content(file, pickle.dumps(source, protocol=pickle.HIGHEST_PROTOCOL))
        forget_unused(file.parent, KEPT_SOURCES, KEPT_BYTES)
