"""The folder that keeps what can be made again: compiled libraries, the catalogue of effects.

What it holds is never trusted: each file has its hash, and one that was cut off or changed is made anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import sys
import time
from pathlib import Path

from daest.files import whole_file

_DIGEST = 32  # bytes of SHA-256

MOST_BYTES = 400_000_000
"""A folder of the cache holds at most this much, if nothing else is said."""

RECENT_SECONDS = 600.0
"""What was used within this time stays, although there is too much: another process may be reading it."""

_FEW, _OFTEN = 100, 50  # the size of so few entries is asked whenever one is added, of more only so often


def cache_folder() -> Path:
    """Where it is: $DAEST_CACHE, or the user's cache folder for daest."""
    if chosen := os.environ.get("DAEST_CACHE"):
        return Path(chosen)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or str(Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = str(Path.home() / "Library" / "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "daest"


def kept_content(file: Path) -> bytes | None:
    """What `keep_content` wrote; None where the file is missing or damaged."""
    with contextlib.suppress(OSError):
        content = file.read_bytes()
        if hashlib.sha256(content[_DIGEST:]).digest() == content[:_DIGEST]:
            return content[_DIGEST:]
    return None


def keep_content(file: Path, content: bytes) -> None:
    """Write a file that `kept_content` reads; a cache that cannot be written is no error."""
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(file) as temporary:
            temporary.write_bytes(hashlib.sha256(content).digest() + content)


def was_used(path: Path) -> None:
    """Let a file or folder of the cache stay longer."""
    with contextlib.suppress(OSError):
        os.utime(path)


def forget_unused(folder: Path, most_entries: int, most_bytes: int = MOST_BYTES) -> None:
    """Take away what was not used for longest where a folder of the cache has more files and folders, or more
    bytes in them, than these; to be called when something was added.

    It goes down to three quarters, so that it is not called for nothing every time. A folder that is not
    inside the cache is left alone: what lies there belongs to others.
    """
    if Path(os.path.realpath(cache_folder())) not in Path(os.path.realpath(folder)).parents:
        return
    try:
        paths = [Path(entry.path) for entry in os.scandir(folder)]
    except OSError:
        return
    if _FEW < len(paths) <= most_entries and len(paths) % _OFTEN:
        return
    now = time.time()
    found = sorted((_last_use(path, now), _size(path), path) for path in paths)
    entries, size = len(found), sum(each for _, each, _ in found)
    if entries <= most_entries and size <= most_bytes:
        return
    for used, its_size, path in found:
        if (entries <= 0.75 * most_entries and size <= 0.75 * most_bytes) or now - used < RECENT_SECONDS:
            return
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        entries, size = entries - 1, size - its_size


def _last_use(path: Path, otherwise: float) -> float:
    try:
        return path.stat().st_mtime
    except OSError:  # it has gone in the meantime
        return otherwise


def _size(path: Path) -> int:
    with contextlib.suppress(OSError):
        if not path.is_dir():
            return path.stat().st_size
        return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    return 0


def put_whole(made: Path, file: Path) -> None:
    """Move a file that another program made to its place, with its hash beside it. Raises OSError."""
    _hash_file(file).write_text(hash_of(made), encoding="ascii")
    os.replace(made, file)


def is_whole(file: Path) -> bool:
    """Whether the file is as `put_whole` left it."""
    try:
        return _hash_file(file).read_bytes().decode("ascii") == hash_of(file)
    except (OSError, UnicodeDecodeError):
        return False


def hash_of(file: Path) -> str:
    """SHA-256 of the content of a file. Raises OSError."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _hash_file(file: Path) -> Path:
    return file.with_name(f"{file.name}.sha256")
