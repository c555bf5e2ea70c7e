"""Locks that the system releases when the process that holds them dies, however it dies."""

from __future__ import annotations

import os
import sys
from pathlib import Path

FAR = 1 << 20  # the byte that is locked on Windows, where a locked byte cannot be read


def locked(path: Path) -> int | None:
    """The descriptor of `path`, locked for this process until it is closed; None where another process holds
    the lock. The file is made, readable by its owner alone. Raises OSError."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    if _take(descriptor):
        return descriptor
    os.close(descriptor)
    return None


def is_held(path: Path) -> bool:
    """Whether a process holds the lock of a file, which may be missing."""
    if not path.is_file():
        return False
    try:
        descriptor = locked(path)
    except OSError:
        return False
    if descriptor is None:
        return True
    os.close(descriptor)
    return False


if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int) -> bool:
        os.lseek(descriptor, FAR, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _take(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True
