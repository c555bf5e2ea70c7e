"""The compiler in a process that may crash, with a cache that may be damaged."""

import contextlib
import os
import random
import signal
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from daest.cache import is_whole, keep_content, kept_content, put_whole
from daest.errors import ModelError
from daest.modelica.compile import compile_text
from daest.modelica.compiling import apart, compiler

POSIX = pytest.mark.skipif(os.name != "posix", reason="processes of POSIX")
MODEL = """\
model Drive
  Daest.Mechanics.Rotational.Components.Inertia disc(J = 0.1);
  output Real w = disc.w;
end Drive;
"""
SMALL = "model Small\n  Real x(start = 1, fixed = true);\nequation\n  der(x) = -x;\nend Small;\n"


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("DAEST_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def names() -> list[str]:
    return [x.name for x in compile_text(MODEL.encode(), Path("Drive.mo")).unknowns]


def kept_files(cache: Path) -> list[Path]:
    return sorted(file for file in cache.rglob("*") if file.is_file())


def garbage(content: bytes) -> bytes:
    return random.Random(1).randbytes(len(content))


def zeroed(content: bytes) -> bytes:
    return content[: len(content) // 2] + bytes(len(content) - len(content) // 2)


@pytest.mark.slow
@pytest.mark.parametrize("damage", [garbage, zeroed])
def test_a_damaged_cache_is_made_anew(cache, damage):
    whole = names()
    assert any("compiler" in str(file) for file in kept_files(cache))
    for file in kept_files(cache):
        file.write_bytes(damage(file.read_bytes()))
    assert names() == whole
    before = [file for file in kept_files(cache) if file.suffix == ".bin"]
    stamps = [file.stat().st_mtime_ns for file in before]
    assert names() == whole and [file.stat().st_mtime_ns for file in before] == stamps  # it is used again


def test_a_cache_that_cannot_be_written_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "cache").write_text("in the way")
    monkeypatch.setenv("DAEST_CACHE", str(tmp_path / "cache"))
    (tmp_path / "Tiny.mo").write_text("package Tiny\n  constant Real rate = 2;\nend Tiny;\n")
    text = SMALL.replace("-x", "-Tiny.rate*x").encode()
    assert compile_text(text, Path("Small.mo"), libraries=[tmp_path]).n == 1


@pytest.fixture(params=[True, False])
def is_copy(request, monkeypatch) -> Iterator[bool]:
    """The compiler in a copy of this process, and in a new one."""
    if request.param and os.name != "posix":
        pytest.skip("processes of POSIX")
    monkeypatch.setattr(apart, "_may_copy", lambda: request.param)
    apart.stop()
    yield request.param
    apart.stop()


@POSIX
def test_a_crash_is_one_message(cache, monkeypatch, is_copy):
    monkeypatch.setattr(compiler, "_apart", lambda *_: apart.run_apart(os.abort))
    with pytest.raises(ModelError) as caught:
        compile_text(SMALL.encode(), Path("Small.mo"))
    assert caught.value.code == "model-compiler" and "SIGABRT" in caught.value.what


def test_values_and_exceptions_come_back(is_copy):
    assert apart.run_apart(abs, -41) == 41
    with pytest.raises(ValueError, match="invalid literal"):
        apart.run_apart(int, "x")
    assert apart.run_apart(os.getpid) == apart.run_apart(os.getpid) != os.getpid()  # it stays


@POSIX
def test_it_works_where_the_program_is_now(is_copy, tmp_path, monkeypatch):
    apart.run_apart(os.getpid)
    monkeypatch.chdir(tmp_path)
    assert apart.run_apart(os.getcwd) == str(tmp_path)
    monkeypatch.setenv(apart.FOLDER_VARIABLE, str(tmp_path))
    assert apart.run_apart(os.getenv, apart.FOLDER_VARIABLE) == str(tmp_path)


@POSIX
def test_it_is_replaced_after_it_was_killed(is_copy):
    """At once, too, before the system says that it has ended."""
    first = apart.run_apart(os.getpid)
    os.kill(first, signal.SIGKILL)
    assert apart.run_apart(os.getpid) != first


@POSIX
def test_what_kills_it_is_not_asked_again(is_copy, tmp_path):
    file = tmp_path / "asked"
    file.touch()
    with pytest.raises(apart.Crash, match="SIGKILL"):
        apart.run_apart(_marked_and_killed, str(file))
    assert file.read_text() == "x"


def _marked_and_killed(file: str) -> None:
    with Path(file).open("a") as stream:
        stream.write("x")
    os.kill(os.getpid(), signal.SIGKILL)


@POSIX
def test_a_copy_of_the_program_has_its_own(is_copy):
    own = apart.run_apart(os.getpid)
    read, write = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        pid = os.fork()
    if pid == 0:
        os.write(write, str(apart.run_apart(os.getpid)).encode())
        os._exit(0)
    os.waitpid(pid, 0)
    assert int(os.read(read, 100)) != own == apart.run_apart(os.getpid)


@POSIX
def test_ctrl_c_ends_the_compiler(is_copy):
    """The thread that waits for it would keep the program alive."""
    running = apart.run_apart(os.getpid)
    threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        compiler.with_room(lambda: apart.run_apart(time.sleep, 60))
    assert time.monotonic() - began < 10.0
    assert apart.run_apart(os.getpid) != running


def test_content_is_checked(tmp_path):
    file = tmp_path / "kept"
    assert kept_content(file) is None
    keep_content(file, b"content")
    assert kept_content(file) == b"content"
    file.write_bytes(file.read_bytes()[:-1])
    assert kept_content(file) is None
    made = tmp_path / "made"
    made.write_bytes(b"library")
    put_whole(made, tmp_path / "library")
    assert is_whole(tmp_path / "library") and not made.exists()
    with contextlib.suppress(FileNotFoundError):
        (tmp_path / "library").write_bytes(b"librarx")
    assert not is_whole(tmp_path / "library")
