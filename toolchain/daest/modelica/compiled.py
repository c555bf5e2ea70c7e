"""Flat sources of the compiler, kept so that the next command does not wait again."""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path

from daest.cache import cache_folder, keep_content, kept_content
from daest.modelica import syntax as s
from daest.modelica.roots import stamp

KEPT_BYTES = 200_000_000
"""Size of all flat sources that are kept; those that were not used for longest leave."""


def kept_or_compiled(
    text: bytes,
    what: str,
    path: Path,
    roots: Iterable[Path],
    compiled: Callable[[], s.FlatSource],
) -> s.FlatSource:
    """`compiled()`, or what it returned last time for the same text, class (`what`), files and versions.

    `roots` are library folders and files; .mo files beside `path` count too. A cache that cannot be read or
    written makes no difference.
    """
    file = cache_folder() / "flat" / f"{_key(text, what, path, roots)}.pickle"
    kept = _read(file)
    if kept is not None:
        return kept
    source = compiled()
    _write(file, source)
    return source


def _key(text: bytes, what: str, path: Path, roots: Iterable[Path]) -> str:
    room = Path(__file__).resolve().parent
    code = [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in sorted(room.glob("*.py"))]
    beside = stamp(sorted(path.resolve().parent.glob("*.mo")))
    parts = [what, str(path), version("rumoca"), repr(code), beside, stamp(roots)]
    return hashlib.sha256("\0".join(parts).encode() + text).hexdigest()


def _read(file: Path) -> s.FlatSource | None:
    content = kept_content(file)
    if content is None:
        return None
    try:
        kept = pickle.loads(content)
        os.utime(file)
    except Exception:  # an unreadable entry of the cache, whatever is wrong with it, is no entry
        return None
    return kept if isinstance(kept, s.FlatSource) else None


def _write(file: Path, source: s.FlatSource) -> None:
    with contextlib.suppress(OSError, RecursionError):
        keep_content(file, pickle.dumps(source, protocol=pickle.HIGHEST_PROTOCOL))
        _make_room(file.parent)


def _make_room(folder: Path) -> None:
    with os.scandir(folder) as entries:
        found = [(e.stat(), e.path) for e in entries if e.name.endswith(".pickle")]
    size = sum(status.st_size for status, _ in found)
    for status, path in sorted(found, key=lambda f: f[0].st_mtime):
        if size <= KEPT_BYTES:
            return
        os.unlink(path)
        size -= status.st_size
