"""C compilers: find one, compile a source to a shared library, keep the result.

The order is the environment variable CC, then cc, gcc, clang on the path, then the `ziglang` wheel, which
also compiles for other platforms. Libraries are kept in a cache directory under the hash of all that decides
them.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from daest.cache import cache_folder, forget_unused, is_whole, put_whole, was_used
from daest.errors import FmuError
from daest.files import passing_folder, removed_at_the_end, run_program

if TYPE_CHECKING:
    import numpy as np

T = TypeVar("T")

# Nobody waits longer for a compiler than this; zig builds its C library on the first cross-compilation.
COMPILE_SECONDS = 600.0
# Of a compiler's complaint, this many lines are shown.
SHOWN_LINES = 20
# Lines of C up to which code is compiled as asked, and up to which it is optimised at all: gcc 12 takes a
# second for 3000 lines of one generated function at -O1, for 1500 at -O3 and for 30 000 at -O0, the longer
# the function the more.
ASKED_LINES, OPTIMISED_LINES = 12_000, 40_000
EFFORT_VARIABLE, EFFORTS = "DAEST_COMPILER_EFFORT", ("-O0", "-Og", "-O1", "-O2", "-O3")
# Beside -O2, for loops over states and samples that are written out in C: 10 to 20 % faster than -O3 for the
# integrators of five laws of a servo, and compiled in four fifths of its time; two to three times as fast for
# recursions of eight states, of which -O3 takes the loops apart, and compiled in two fifths.
FAST = ("-ftree-vectorize", "-fpeel-loops", "-fno-math-errno", "-fno-semantic-interposition")
# Over the conditions of long generated code, gcc 12 threads jumps for 8 of the 10 s that 12 600 lines take at
# -O1, to no use. Other compilers know no such option, and pass over what is asked of gcc so.
UNTHREADED = '#pragma GCC optimize ("no-thread-jumps")\n'
# Longer code is not compiled: it would take minutes and gigabytes.
MOST_LINES = 400_000
# Compiled libraries that are kept; those that were not used for longest leave.
MOST_KEPT = 3000
# A compilation of more lines than this takes seconds and is told.
TOLD_LINES = 6_000


@dataclass(frozen=True)
class Platform:
    """A target: its FMI 3 name, the name that users know, the file ending, and what zig calls it."""

    tuple_name: str
    short_name: str
    suffix: str
    zig_target: str


PLATFORMS = (
    Platform("x86_64-linux", "linux64", ".so", "x86_64-linux-gnu.2.17"),
    Platform("aarch64-linux", "linux-arm64", ".so", "aarch64-linux-gnu.2.17"),
    Platform("x86_64-windows", "win64", ".dll", "x86_64-windows-gnu"),
    Platform("aarch64-windows", "win-arm64", ".dll", "aarch64-windows-gnu"),
    Platform("x86_64-darwin", "darwin64", ".dylib", "x86_64-macos"),
    Platform("aarch64-darwin", "darwin-arm64", ".dylib", "aarch64-macos"),
)


@dataclass(frozen=True)
class Compiler:
    """A command that compiles C; `identity` changes when the compiler does; `is_zig` tells that it can
    cross-compile.
    """

    command: tuple[str, ...]
    identity: str
    is_zig: bool


def native_platform() -> Platform:
    """The platform that this process runs on; FmuError `fmu-platform-unknown` for an exotic one."""
    machine = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
    processor = machine.get(platform.machine().lower(), platform.machine().lower())
    return platform_named(f"{processor}-{platform.system().lower()}")


def platform_named(name: str) -> Platform:
    """The platform of a short name (`linux64`) or FMI 3 name (`x86_64-linux`). Raises FmuError
    `fmu-platform-unknown`."""
    for candidate in PLATFORMS:
        if name in (candidate.short_name, candidate.tuple_name):
            return candidate
    known = ", ".join(p.short_name for p in PLATFORMS)
    raise FmuError("fmu-platform-unknown", f"There is no platform `{name}`.", remedy=f"Choose among {known}.")


def find_compiler(target: Platform | None = None) -> Compiler:
    """A compiler for `target` (default: this platform).

    Errors: FmuError `no-c-compiler` when there is none, or none that compiles for another platform.
    """
    if target is None or target == native_platform():
        compiler = _native_compiler() or _zig()
        remedy = (
            "Install one: `pip install daest[compiler]`, or gcc or clang by your system's package manager."
        )
        what = "No C compiler was found (looked for $CC, cc, gcc, clang and the ziglang package)."
    else:
        compiler = _zig()
        remedy = "Install it: `pip install daest[compiler]`."
        what = (
            f"Compiling for {target.short_name} on this machine needs the ziglang package, which is missing."
        )
    if compiler is None:
        raise FmuError("no-c-compiler", what, remedy=remedy)
    return compiler


def _native_compiler() -> Compiler | None:
    wanted = os.environ.get("CC", "").strip()
    commands = ([shlex.split(wanted)] if wanted else []) + [["cc"], ["gcc"], ["clang"]]
    for command in commands:
        program = shutil.which(command[0])
        if program:
            return Compiler((program, *command[1:]), _identity(program, command[1:]), is_zig=False)
    return None


def _identity(program: str, options: list[str]) -> str:
    """Path, size and time of the program: cheaper than asking for its version, and as telling."""
    status = os.stat(program)
    return " ".join([os.path.realpath(program), str(status.st_size), str(status.st_mtime_ns), *options])


def _zig() -> Compiler | None:
    found = importlib.util.find_spec("ziglang")
    if found is None or found.origin is None:
        return None
    return Compiler((sys.executable, "-m", "ziglang", "cc"), _identity(found.origin, []), is_zig=True)


def headers() -> Path:
    """The folder with the FMI headers (they are shipped with fmpy, which need not be imported for that).
    Raises FmuError `fmu-headers-missing`."""
    found = importlib.util.find_spec("fmpy")
    if found is None or found.origin is None:
        raise FmuError(
            "fmu-headers-missing",
            "The FMI headers that come with fmpy are missing.",
            remedy="Reinstall fmpy.",
        )
    return Path(found.origin).parent / "c-code"


@functools.lru_cache(maxsize=1)
def _spare_folder() -> Path:
    """For machines where the cache folder cannot be written: a folder of this process."""
    folder = Path(tempfile.mkdtemp(prefix="daest-cache-"))
    removed_at_the_end(folder)
    return folder


def _writable(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return _spare_folder()


@functools.lru_cache(maxsize=1)
def processor_flags(*, widest: bool = False) -> tuple[str, ...]:
    """Wide instructions where this processor tells that it has them; libraries are kept by their flags.

    `widest`: with vectors of 512 bits, which code in explicit vectors alone gains by.
    """
    try:
        told = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ()
    words = set(told.split())
    if platform.machine() != "x86_64" or not {"avx2", "fma"} <= words:
        return ()
    return ("-mavx2", "-mfma", *(("-mavx512f",) if widest and "avx512f" in words else ()))


def build_shared(
    source: str,
    name: str,
    flags: tuple[str, ...] = ("-O2",),
    *,
    files: Mapping[str, str] | None = None,
    target: Platform | None = None,
    objects: Sequence[Path] = (),
) -> Path:
    """The shared library made from the C text `source`, compiled now or before.

    `name` is the stem of the file. `files` are texts that the source includes (file name -> text), and
    `objects` those of `build_object` that it is linked with. The result stands in the cache under a hash of
    source, files, flags, objects, target and compiler; it appears there whole or not at all, also when
    several processes build it at once.
    Errors: FmuError `no-c-compiler`; `compilation-failed` with the compiler's words.
    """
    where = target or native_platform()
    texts = {f"{name}.c": source, **(files or {})}
    return _built(texts, name, where.suffix, flags, where, tuple(objects))


def build_object(source: str, name: str, flags: tuple[str, ...]) -> Path:
    """The object file of the C text `source` for this platform, compiled now or before: what several
    libraries of `build_shared` have in common. Errors as there."""
    return _built({f"{name}.c": source}, name, ".o", flags, native_platform(), ())


def _built(
    texts: Mapping[str, str],
    name: str,
    suffix: str,
    flags: tuple[str, ...],
    target: Platform,
    objects: tuple[Path, ...],
) -> Path:
    compiler = find_compiler(target)
    key = _key(compiler, target, (*flags, *(one.parent.name for one in objects)), texts)
    folder = cache_folder() / "compiled" / key
    file_name = f"{name}{suffix}"
    if is_whole(folder / file_name):
        was_used(folder)
        return folder / file_name
    n_lines = sum(text.count("\n") for text in texts.values())
    if n_lines > TOLD_LINES:
        _telling.get()(f"compiling {n_lines} lines of C, which is kept for the next time")
    folder = _writable(folder)
    with passing_folder("build-", folder) as work:
        head = UNTHREADED if n_lines > ASKED_LINES else ""
        for source, text in texts.items():
            (work / source).write_text(head + text, encoding="utf-8")
        _compile(compiler, target, flags, work, name, file_name, objects)
        put_whole(work / file_name, folder / file_name)
    forget_unused(cache_folder() / "compiled", MOST_KEPT)
    return folder / file_name


def loaded(source: str, name: str, flags: tuple[str, ...] = ("-O2",)) -> ctypes.CDLL | None:
    """The library of `build_shared`, loaded; None without a C compiler."""
    return if_compiler(lambda: ctypes.CDLL(str(build_shared(source, name, flags))))


def if_compiler(make: Callable[[], T]) -> T | None:
    """What `make` returns; None where it finds no C compiler."""
    try:
        return make()
    except FmuError as error:
        if error.code != "no-c-compiler":
            raise
        return None


def text_of(name: str, package: str = "daest.numerics") -> str:
    """A C file of a room."""
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")


def pointer(array: np.ndarray | None) -> ctypes.c_void_p | None:
    """Address of a C-contiguous array for compiled code, null for None; the array lives as long as it. Any
    shape."""
    if array is None:
        return None
    address = ctypes.c_void_p(array.ctypes.data)
    address.array = array  # type: ignore[attr-defined]  # as `data_as` does, in twice the time
    return address


def effort(source: str, wanted: str) -> str:
    """The optimisation for a source: `wanted`, that of the environment variable DAEST_COMPILER_EFFORT ("O0",
    "Og", "O1", "O2" or "O3": short runs of many models want less), or less where it would take a compiler
    minutes."""
    chosen = f"-{os.environ.get(EFFORT_VARIABLE, '')}"
    wanted = chosen if chosen in EFFORTS else wanted
    lines = source.count("\n")
    if lines <= ASKED_LINES:
        return wanted
    most = "-O1" if lines <= OPTIMISED_LINES else "-O0"
    return min(wanted, most, key=EFFORTS.index)


_telling: ContextVar[Callable[[str], object]] = ContextVar("telling", default=lambda _: None)


def tell_of_compilations(tell: Callable[[str], object]) -> None:
    """From now on `tell` hears, in this context, of every compilation that takes long, when it begins."""
    _telling.set(tell)


def _key(compiler: Compiler, target: Platform, flags: tuple[str, ...], texts: Mapping[str, str]) -> str:
    digest = hashlib.sha256()
    for part in (compiler.identity, target.tuple_name, str(headers()), *flags):
        digest.update(part.encode() + b"\0")
    for file_name in sorted(texts):
        digest.update(file_name.encode() + b"\0" + texts[file_name].encode() + b"\0")
    return digest.hexdigest()[:32]


def _compile(
    compiler: Compiler,
    target: Platform,
    flags: tuple[str, ...],
    work: Path,
    name: str,
    made: str,
    objects: tuple[Path, ...],
) -> None:
    """Make the file `made`, an object or a shared library, of `name`.c in the folder `work`."""
    is_object = made.endswith(".o")
    command = [*compiler.command, *flags, "-c" if is_object else "-shared", "-w"]
    if target.suffix != ".dll":
        command.append("-fPIC")
    if compiler.is_zig:
        command += ["-target", target.zig_target, *([] if is_object else ["-s"])]
    command += [f"-I{headers()}", f"{name}.c", *map(str, objects), "-o", made]
    if target.suffix == ".so" and not is_object:
        command.append("-lm")
    try:
        done = run_program(command, work, COMPILE_SECONDS)
    except (OSError, subprocess.TimeoutExpired) as problem:
        raise FmuError(
            "compilation-failed", f"The C compiler did not run: {problem}", where=command[0]
        ) from problem
    if done.returncode != 0 or not (work / made).is_file():
        words = "\n".join((done.stderr or done.stdout).splitlines()[:SHOWN_LINES])
        raise FmuError(
            "compilation-failed",
            f"The C compiler refused the code of `{name}`:\n{words}",
            where=" ".join(compiler.command),
            remedy="Set the environment variable CC to another compiler, or `pip install daest[compiler]`.",
        )
