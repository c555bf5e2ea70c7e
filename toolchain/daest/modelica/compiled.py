"""Flat sources that took the compiler long, kept so that the next command does not wait again."""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path

from daest.cache import cache_folder, keep_content, kept_content
from daest.modelica import syntax as s
from daest.modelica.roots import stamp

WORTH_KEEPING = 1.0
"""Seconds that a compilation must have taken."""

KEPT = 40
"""How many flat sources are kept; the oldest leave."""


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
    started = time.monotonic()
    source = compiled()
    if time.monotonic() - started > WORTH_KEEPING:
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
        for old in sorted(file.parent.glob("*.pickle"), key=lambda f: -f.stat().st_mtime)[KEPT:]:
            old.unlink(missing_ok=True)
