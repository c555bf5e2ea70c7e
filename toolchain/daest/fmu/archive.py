"""The archive of an FMU: read and unpacked as a file that somebody else made."""

from __future__ import annotations

import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from daest.errors import FmuError
from daest.litter import passing_folder

# Limits against archives that are made to fill memory or disk. The largest FMUs in use (with maps or
# neural networks as resources) stay well below.
MOST_FILES = 50_000
LARGEST_TOTAL = 4 * 1024**3
LARGEST_XML = 256 * 1024**2
# Beyond this, and at this ratio, compressed content is taken for a bomb: XML compresses up to 50 : 1.
SUSPICIOUS_RATIO = 500
SUSPICIOUS_SIZE = 64 * 1024**2

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
        info = self._members[name]
        if info.file_size > limit:
            raise FmuError(
                "fmu-too-large",
                f"`{name}` in the FMU has {info.file_size} bytes.",
                where=str(self.path),
                remedy="Export it again; such a file is not expected there.",
            )
        try:
            return self._zip.read(info)
        except _DAMAGED as problem:
            raise _damaged(self.path, f"`{name}` cannot be read ({problem})") from problem

    def text(self, name: str, limit: int = LARGEST_XML) -> str:
        try:
            return self.read(name, limit).decode("utf-8")
        except UnicodeDecodeError as problem:
            raise _damaged(self.path, f"`{name}` is not UTF-8 text") from problem

    def unpack(self, folder: Path, prefixes: tuple[str, ...]) -> None:
        """Write the members below `prefixes` into `folder`."""
        for name in self._members:
            if name.startswith(prefixes):
                content = self.read(name, LARGEST_TOTAL)
                try:
                    target = folder / name
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes(content)
                except (OSError, ValueError) as problem:  # a file in the place of a folder, a name too long
                    raise _damaged(self.path, f"`{name}` cannot be unpacked ({problem})") from problem


@contextmanager
def open_archive(path: str | Path) -> Iterator[Archive]:
    """The FMU at `path`, checked before anything is unpacked.

    Errors (FmuError): `fmu-missing-file`, `fmu-empty-file`, `fmu-not-an-archive`, `fmu-unsafe-path` (a member
    would be written outside its folder), `fmu-too-large` (a decompression bomb), `fmu-damaged`.
    """
    path = Path(path)
    if not path.is_file():
        raise FmuError("fmu-missing-file", f"There is no file `{path}`.", remedy="Check the path of the FMU.")
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
    try:
        opened = zipfile.ZipFile(path)
    except _DAMAGED as problem:
        raise _damaged(path, str(problem)) from problem
    with opened:
        _check_size(path, opened)
        yield Archive(path, opened)


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
            f"The FMU holds `{info.filename}`, which would be written outside its folder.",
            where=str(path),
            remedy="Do not use this file unless you know where it comes from.",
        )
    return str(name)


def _damaged(path: Path, why: str) -> FmuError:
    return FmuError("fmu-damaged", f"The FMU is damaged: {why}.", where=str(path), remedy="Export it again.")


@contextmanager
def unpacked(path: str | Path, prefixes: tuple[str, ...]) -> Iterator[Path]:
    """A temporary folder with the members below `prefixes`, removed at the end."""
    with passing_folder("daest-fmu-") as folder:
        with open_archive(path) as archive:
            archive.unpack(folder, prefixes)
        yield folder
