"""The folder that keeps what can be made again: compiled libraries, the catalogue of effects.

What it holds is never trusted: each file has its hash, and one that was cut off or changed is made anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from pathlib import Path

from daest.files import whole_file

_DIGEST = 32  # bytes of SHA-256


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
