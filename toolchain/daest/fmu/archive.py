"""The archive of an FMU: read and unpacked as a file that somebody else made."""

from __future__ import annotations

import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from daest.errors import FmuError, printable
from daest.files import why_no_file

# Limits against archives that are made to fill memory or disk. The largest FMUs in use (with maps or
# neural networks as resources) stay well below.
MOST_FILES = 50_000
LARGEST_TOTAL = 2 * 1024**3
LARGEST_XML = 128 * 1024**2
LARGEST_DIRECTORY = 16 * 1024**2  # bytes of the list of all members: 50 000 with names of 250 characters
BLOCK = 1 << 20  # bytes that are inflated at a time
# Beyond this, and at this ratio, compressed content is taken for a bomb: XML compresses up to 50 : 1.
SUSPICIOUS_RATIO = 500
SUSPICIOUS_SIZE = 64 * 1024**2

# The records at the end of an archive, and how far from the end they can begin.
_END, _LARGE_END, _END_AT_MOST = b"PK\5\6", b"PK\6\6", 65_536 + 200

_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError, ValueError)


class Archive:
    """An open FMU: its members by clean path. Made by `open_archive`."""

    def __init__(self, path: Path, opened: zipfile.ZipFile) -> None:
        self.path = path
        self._zip = opened
        self._members = {_clean_name(path, info): info for info in opened.infolist() if not info.is_dir()}

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._members)

    def read(self, name: str, limit: int = LARGEST_XML) -> bytes:
        """The content of a member of at most `limit` bytes."""
        return b"".join(self._blocks(name, limit))

    def _blocks(self, name: str, limit: int) -> Iterator[bytes]:
        """The content in pieces, counted while it is inflated: sizes that the archive states may be wrong."""
        info, found = self._members[name], 0
        if info.file_size > limit:
            raise self._too_large(name, info.file_size)
        try:
            with self._zip.open(info) as stream:
                while block := stream.read(BLOCK):
                    found += len(block)
                    if found > limit:
                        raise self._too_large(name, found)
                    yield block
        except _DAMAGED as problem:
            raise _damaged(self.path, f"`{printable(name)}` cannot be read ({problem})") from problem

    def _too_large(self, name: str, size: int) -> FmuError:
        return FmuError(
            "fmu-too-large",
            f"`{printable(name)}` in the FMU has {size} bytes or more.",
            where=str(self.path),
            remedy="Export it again; such a file is not expected there.",
        )

    def text(self, name: str, limit: int = LARGEST_XML) -> str:
        try:
            return self.read(name, limit).decode("utf-8")
        except UnicodeDecodeError as problem:
            raise _damaged(self.path, f"`{printable(name)}` is not UTF-8 text") from problem

    def unpack(self, folder: Path, prefixes: tuple[str, ...]) -> None:
        """Write the members below `prefixes` into `folder`, of LARGEST_TOTAL bytes together at most."""
        left = LARGEST_TOTAL
        for name in self._members:
            if name.startswith(prefixes):
                left -= self._write(name, folder / name, left)

    def _write(self, name: str, target: Path, limit: int) -> int:
        written = 0
        for block in self._blocks(name, limit):
            written += self._append(name, target, block, is_first=not written)
        return written or self._append(name, target, b"", is_first=True)

    def _append(self, name: str, target: Path, block: bytes, is_first: bool) -> int:
        try:
            if is_first:
                target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb" if is_first else "ab") as stream:
                return stream.write(block)
        except (OSError, ValueError) as problem:  # a file in the place of a folder, a name too long
            raise _damaged(self.path, f"`{printable(name)}` cannot be unpacked ({problem})") from problem


@contextmanager
def open_archive(path: str | Path) -> Iterator[Archive]:
    """The FMU at `path`, checked before anything is unpacked.

    Errors (FmuError): `fmu-missing-file`, `fmu-empty-file`, `fmu-not-an-archive`, `fmu-unsafe-path` (a member
    would be written outside its folder), `fmu-too-large` (a decompression bomb), `fmu-damaged`.
    """
    path = Path(path)
    if (why := why_no_file(path)) is not None:
        raise FmuError("fmu-missing-file", f"The FMU `{path}` {why}.", remedy="Check the path of the FMU.")
    if path.stat().st_size == 0:
        raise FmuError(
            "fmu-empty-file", "The FMU is an empty file.", where=str(path), remedy="Export it again."
        )
    if not zipfile.is_zipfile(path):
        raise FmuError(
            "fmu-not-an-archive",
            "The file is no FMU: an FMU is a zip archive.",
            where=str(path),
            remedy="Export it again; a download may have been cut off.",
        )
    _check_directory(path)
    try:
        opened = zipfile.ZipFile(path)
    except _DAMAGED as problem:
        raise _damaged(path, str(problem)) from problem
    with opened:
        _check_size(path, opened)
        yield Archive(path, opened)


def _check_directory(path: Path) -> None:
    """Refuse a list of members that alone would take long to read. Its size stands near the end of the file,
    in a record of its own where it is large (ZIP64)."""
    with path.open("rb") as stream:
        stream.seek(max(path.stat().st_size - _END_AT_MOST, 0))
        end = stream.read()
    at = end.rfind(_END)
    sizes = [int.from_bytes(end[at + 12 : at + 16], "little")] if at >= 0 else []
    large = end.rfind(_LARGE_END)
    sizes += [int.from_bytes(end[large + 40 : large + 48], "little")] if large >= 0 else []
    if min(sizes, default=0) > LARGEST_DIRECTORY:
        raise FmuError(
            "fmu-too-large",
            f"The list of the files in the FMU has {min(sizes)} bytes.",
            where=str(path),
            remedy="If it is trusted, remove what the model does not need from its resources.",
        )


def _check_size(path: Path, opened: zipfile.ZipFile) -> None:
    infos = opened.infolist()
    total = sum(info.file_size for info in infos)
    packed = sum(info.compress_size for info in infos)
    is_bomb = total > SUSPICIOUS_SIZE and total > SUSPICIOUS_RATIO * max(packed, 1)
    if len(infos) > MOST_FILES or total > LARGEST_TOTAL or is_bomb:
        raise FmuError(
            "fmu-too-large",
            f"The FMU would unpack to {len(infos)} files with {total} bytes.",
            where=str(path),
            remedy="If it is trusted, remove what the model does not need from its resources.",
        )


def _clean_name(path: Path, info: zipfile.ZipInfo) -> str:
    name = PurePosixPath(info.filename.replace("\\", "/"))
    is_link = stat.S_ISLNK(info.external_attr >> 16)
    if name.is_absolute() or ".." in name.parts or ":" in str(name) or is_link:
        raise FmuError(
            "fmu-unsafe-path",
            f"The FMU holds `{printable(info.filename)}`, which would be written outside its folder.",
            where=str(path),
            remedy="Do not use this file unless you know where it comes from.",
        )
    return str(name)


def _damaged(path: Path, why: str) -> FmuError:
    return FmuError("fmu-damaged", f"The FMU is damaged: {why}.", where=str(path), remedy="Export it again.")
