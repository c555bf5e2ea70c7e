"""Writing files: whole or not at all; pipes and devices are written to."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from daest.errors import printable
from daest.litter import removed_at_death

MODEL_SUFFIXES = (".mo", ".bmo", ".fmu")  # of files that hold a model
FOLDER = "is a folder, not a file"  # what `why_no_file` says of one
MOST_LINKS = 40  # that are followed to an open file, as many as Linux follows


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary file that becomes `path` when the block ends well, and vanishes otherwise.

    A regular file is replaced as a whole; where `path` is a link, the file that it leads to. Pipes, terminals
    and other devices are written to. A reader of a pipe that has gone is no error. Raises OSError.
    """
    descriptor, target = _own_descriptor(path), Path(os.path.realpath(path))
    is_stream = descriptor is not None or _is_stream(path)
    with _temporary(path.suffix, None if is_stream else target.parent) as temporary:
        yield temporary
        if is_stream:
            _send(temporary, path, descriptor)
        else:
            temporary.chmod(_usual_mode(target))
            os.replace(temporary, target)


@contextmanager
def _temporary(suffix: str, folder: Path | None) -> Iterator[Path]:
    """An empty file that goes at the end, also where the program is ended before that."""
    place = Path(tempfile.gettempdir()) if folder is None else folder
    temporary = place / f".daest-{secrets.token_hex(8)}{suffix}"
    with removed_at_death(temporary):
        try:
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
            yield temporary
        finally:
            temporary.unlink(missing_ok=True)


def _is_stream(path: Path) -> bool:
    """Whether what stands at `path` is neither absent nor a regular file. Raises OSError for a folder, and
    where links lead in a circle."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return False
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    return not stat.S_ISREG(mode)


def why_no_file(path: Path) -> str | None:
    """What a path is that does not name a regular file, as the end of a sentence; None where it does."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        if path.is_symlink():
            return f"is a link to {printable(os.readlink(path))}, which does not exist"
        return "does not exist"
    except OSError as error:
        if error.errno == errno.ELOOP:
            return "is a link that leads in a circle"
        return f"cannot be reached: {error.strerror or error}"
    except ValueError:  # a zero byte in the name
        return "does not exist"
    kinds = ((stat.S_ISDIR, "folder"), (stat.S_ISFIFO, "pipe"), (stat.S_ISSOCK, "socket"))
    found = next((name for asks, name in kinds if asks(mode)), "device")
    return None if stat.S_ISREG(mode) else f"is a {found}, not a file"


def _own_descriptor(path: Path) -> int | None:
    """The number of an open file of this process that `path` names, as /dev/stdout and /dev/fd/63 do. Its
    content is continued, not replaced."""
    found = path
    for _ in range(MOST_LINKS):
        if found.name.isdigit() and os.path.realpath(found.parent) in _descriptor_folders():
            return int(found.name)
        if not found.is_symlink():
            return None
        found = found.parent / os.readlink(found)
    return None


def _descriptor_folders() -> set[str]:
    return {os.path.realpath(folder) for folder in ("/proc/self/fd", "/proc/thread-self/fd", "/dev/fd")}


def _send(content: Path, path: Path, descriptor: int | None) -> None:
    opened = os.open(path, os.O_WRONLY) if descriptor is None else os.dup(descriptor)
    with content.open("rb") as source:
        try:
            with os.fdopen(opened, "wb") as stream:
                shutil.copyfileobj(source, stream)
        except BrokenPipeError:
            return


def _usual_mode(path: Path) -> int:
    if path.exists():
        return path.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
