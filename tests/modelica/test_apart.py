"""The compiler in a process that may crash, with a cache that may be damaged."""

import contextlib
import os
import random
import signal
import threading
import time
from pathlib import Path

import pytest

from daest.cache import is_whole, keep_content, kept_content, put_whole
from daest.errors import ModelError
from daest.modelica import apart, compiler
from daest.modelica.compile import compile_text

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
    assert names()


@POSIX
@pytest.mark.parametrize("may_copy", [True, False])
def test_a_crash_is_one_message(cache, monkeypatch, may_copy):
    monkeypatch.setattr(apart, "_may_copy", lambda: may_copy)
    monkeypatch.setattr(compiler, "_apart", lambda *_: apart.run_apart(os.abort))
    with pytest.raises(ModelError) as caught:
        compile_text(SMALL.encode(), Path("Small.mo"))
    assert caught.value.code == "model-compiler" and "SIGABRT" in caught.value.what


def _number(value: int) -> int:
    return value + 1


def _problem() -> int:
    raise ValueError("no number")


@pytest.mark.parametrize("may_copy", [True, False])
def test_values_and_exceptions_come_back(monkeypatch, may_copy):
    if may_copy and os.name != "posix":
        pytest.skip("processes of POSIX")
    monkeypatch.setattr(apart, "_may_copy", lambda: may_copy)
    work = _number if may_copy else abs
    assert apart.run_apart(work, 41) == (42 if may_copy else 41)
    with pytest.raises(ValueError, match="no number" if may_copy else "invalid literal"):
        apart.run_apart(*((_problem,) if may_copy else (int, "x")))


@POSIX
def test_ctrl_c_ends_the_compiler(monkeypatch):
    """The thread that waits for it would keep the program alive."""
    monkeypatch.setattr(apart, "_may_copy", lambda: True)
    threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        compiler.with_room(lambda: apart.run_apart(time.sleep, 60))
    while apart._running:
        assert time.monotonic() - began < 10.0
        time.sleep(0.05)


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
