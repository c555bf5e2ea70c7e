"""Where Modelica libraries are looked for, and their folders as the compiler can read them: one version of
each library, no byte order marks.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from daest.cache import cache_folder, forget_unused, was_used
from daest.errors import ModelError

_PACKAGE = Path(__file__).resolve().parents[2]


def library_root() -> Path:
    """The folder that contains `Daest/package.mo`: inside the installed package, or `modelica/` of a
    checkout.

    Raises ModelError when the installation holds neither."""
    candidates = (_PACKAGE / "library", _PACKAGE.parent.parent / "modelica")
    for candidate in candidates:
        if (candidate / "Daest" / "package.mo").is_file():
            return candidate
    raise ModelError(
        "model-library",
        "the bundled library Daest is missing from this installation",
        where=str(candidates[0]),
        remedy="Install daest again.",
    )


def library_roots(libraries: Sequence[str | Path] = ()) -> tuple[Path, ...]:
    """Folders to search: `libraries`, then MODELICAPATH, then the bundled library. Raises ModelError for a
    folder of `libraries` that does not exist."""
    found = [Path(folder).expanduser() for folder in libraries]
    for folder in found:
        if not folder.is_dir():
            raise ModelError(
                "model-library",
                f"there is no library folder {folder}",
                where=str(folder),
                remedy="Give -L the folder that contains the library's own folder.",
            )
    path = os.environ.get("MODELICAPATH", "").split(os.pathsep)
    found += [Path(folder) for folder in path if folder and Path(folder).is_dir()]
    if all(not (folder / "Daest" / "package.mo").is_file() for folder in found):
        found += [root for root in (bundled_root(),) if root is not None]
    return tuple(dict.fromkeys(folder.resolve() for folder in found))


def bundled_root() -> Path | None:
    """`library_root`, as `library_roots` has it; None where the installation holds none."""
    try:
        return library_root().resolve()
    except ModelError:
        return None


_COPIES = 3  # version of the copies of libraries in the cache: older ones hold folders without package.mo

_MOST_KEPT = 200  # copies, excerpts and indices of libraries in the cache

BYTE_ORDER_MARK = b"\xef\xbb\xbf"

_USES = re.compile(rb'\b([A-Za-z_]\w*)\s*\(\s*version\s*=\s*"([^"]*)"')


@dataclass(frozen=True)
class Roots:
    """Folders for the compiler, and for those that were made from others where their files come from."""

    folders: tuple[Path, ...]
    origins: Mapping[str, Path]
    objects: tuple[str, ...] = ()  # external objects, whose constructors are functions beside them

    def original(self, file: str) -> str:
        """The user's own file that a file of `folders` was made from."""
        for made, source in self.origins.items():
            if file.startswith(made + os.sep):
                return str(source / file[len(made) + 1 :])
        return file

    def in_words_of(self, message: str) -> str:
        """The message with the user's files in the place of those that were made from them."""
        for made, source in self.origins.items():
            message = message.replace(made, str(source))
        return message

    def readable(self, file: Path) -> Path:
        """The file of `folders` that was made from the user's `file`, or the file itself."""
        for made, source in self.origins.items():
            if file == source or file.is_relative_to(source):
                return Path(made) / file.relative_to(source) if file != source else Path(made)
        return file


def readable_roots(folders: Sequence[Path], text: bytes, path: Path) -> Roots:
    """`folders` with each library once, for a model of the text `text` in file `path`.

    A library is taken from the first folder that has it, in the version that holds `path`, else the one that
    `text` declares in `uses`, else the highest. A folder with several versions, or with files that begin with
    a byte order mark, is replaced by a copy in the cache, without a file of the name of `path`.
    """
    made: list[Path] = []
    origins: dict[str, Path] = {}
    for folder, chosen, is_whole in chosen_libraries(folders, text, path):
        if is_whole and _is_readable(folder, stamp([folder])):
            made.append(folder)
        elif chosen := [entry for entry in chosen if entry.name != path.name]:
            made.append(_copied(chosen, origins))
    return Roots(tuple(made), origins)


def chosen_libraries(folders: Sequence[Path], text: bytes, path: Path) -> list[tuple[Path, list[Path], bool]]:
    """Of each folder the libraries that are used, and whether those are all that it holds. See
    `readable_roots`."""
    uses = _all_uses(folders, text, path.resolve())
    seen: set[str] = set()
    found: list[tuple[Path, list[Path], bool]] = []
    for folder in folders:
        if (folder / "package.mo").is_file():
            is_new = _library(folder)[0] not in seen
            seen.add(_library(folder)[0])
            found.append((folder, [folder] if is_new else [], is_new))
        else:
            found.append((folder, *_chosen(folder, uses, seen, path.resolve())))
    return found


def _all_uses(folders: Sequence[Path], text: bytes, path: Path) -> dict[str, str]:
    """Versions by library: those that the text declares, then those that the chosen versions of the libraries
    that it names declare."""
    uses = {name.decode(): version.decode() for name, version in _USES.findall(text)}
    words = {word.decode() for word in re.findall(rb"[A-Za-z_]\w*", text)}
    by_name: dict[str, list[Path]] = {}
    for entry in (entry for folder in folders for entry in library_entries(folder)):
        by_name.setdefault(_library(entry)[0], []).append(entry)
    waiting = [name for name in by_name if name in words]
    seen = set(waiting)
    while waiting:
        name = waiting.pop(0)
        entry = _version(by_name[name], uses.get(name), path)
        with contextlib.suppress(OSError):
            content = (entry / "package.mo" if entry.is_dir() else entry).read_bytes()
            for used, version in _USES.findall(content):
                uses.setdefault(used.decode(), version.decode())
                if used.decode() in by_name and used.decode() not in seen:
                    seen.add(used.decode())
                    waiting.append(used.decode())
    return uses


def library_entries(folder: Path) -> list[Path]:
    """The libraries that a folder holds, or is: folders with a package.mo, and files."""
    if (folder / "package.mo").is_file():
        return [folder]
    packages = [entry for entry in sorted(folder.iterdir()) if (entry / "package.mo").is_file()]
    return packages + sorted(folder.glob("*.mo"))


def library_name(entry: Path) -> str:
    """The name of the library of a folder or file, without its version."""
    return _library(entry)[0]


def _library(folder: Path) -> tuple[str, tuple[int, ...]]:
    """Name and version of a library's folder or file: `Modelica 4.0.0`, or `Modelica` without a version."""
    name, _, version = (folder.stem if folder.suffix == ".mo" else folder.name).partition(" ")
    return name, tuple(int(part) for part in re.findall(r"\d+", version))


def _chosen(folder: Path, uses: Mapping[str, str], seen: set[str], path: Path) -> tuple[list[Path], bool]:
    """The entries of a folder that are used, and whether those are all that there are."""
    entries = library_entries(folder)
    by_name: dict[str, list[Path]] = {}
    for entry in entries:
        by_name.setdefault(_library(entry)[0], []).append(entry)
    chosen = [_version(same, uses.get(name), path) for name, same in by_name.items() if name not in seen]
    seen.update(by_name)
    return chosen, len(chosen) == len(entries)


def _version(entries: Sequence[Path], wanted: str | None, path: Path) -> Path:
    """The version that holds `path`, or that is wanted, or one that differs from it in the last number only,
    else the highest; none counts as the highest."""
    numbers = tuple(int(part) for part in re.findall(r"\d+", wanted or ""))
    own = [entry for entry in entries if path.is_relative_to(entry.resolve())]
    exact = [entry for entry in entries if numbers and _library(entry)[1] == numbers]
    near = [entry for entry in entries if numbers and _library(entry)[1][:2] == numbers[:2]]
    near.sort(key=lambda entry: _library(entry)[1])
    return (own or exact or near or sorted(entries, key=lambda e: (not _library(e)[1], _library(e)[1])))[-1]


def _modelica_files(folder: Path) -> list[os.DirEntry[str]]:
    """All .mo files below a folder, in the order of their paths."""
    files: list[os.DirEntry[str]] = []
    waiting = [str(folder)]
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
                elif entry.name.endswith(".mo"):
                    files.append(entry)
    return sorted(files, key=lambda entry: entry.path)


@functools.lru_cache(maxsize=64)
def _is_readable(folder: Path, fingerprint: str) -> bool:
    """Whether the compiler reads a folder of libraries as it is; `fingerprint` tells that it has changed."""
    libraries = [entry for entry in library_entries(folder) if entry.is_dir()]
    marked = (entry.path for entry in _modelica_files(folder) if _has_mark(entry.path))
    return not any(map(_stray_folders, libraries)) and not any(marked)


def _stray_folders(library: Path) -> list[Path]:
    """Folders inside of a library that hold .mo files, or folders with some, but no package.mo: they are no
    packages."""
    found: set[Path] = set()
    for folder in {Path(entry.path).parent for entry in _modelica_files(library)}:
        while folder not in found and folder != library.parent:
            found.add(folder)
            folder = folder.parent
    return [folder for folder in found if not (folder / "package.mo").is_file()]


def _has_mark(file: str) -> bool:
    try:
        with open(file, "rb") as opened:
            return opened.read(3) == BYTE_ORDER_MARK
    except OSError:
        return False


def stamp(entries: Iterable[Path]) -> str:
    """A fingerprint of the names, sizes and times of files, and of all .mo files of folders."""
    digest = hashlib.sha256()
    for path in entries:
        with contextlib.suppress(OSError):
            for file in [path] if path.is_file() else _modelica_files(path):
                with contextlib.suppress(OSError):
                    status = file.stat()
                    digest.update(f"{os.fspath(file)}\0{status.st_size}\0{status.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def _copied(entries: Sequence[Path], origins: dict[str, Path]) -> Path:
    """A folder of the cache with copies of the libraries, without byte order marks."""
    root = cache_folder() / "libraries" / f"{stamp(entries)[:32]}-{_COPIES}"
    for entry in entries:
        target = root / (_library(entry)[0] + entry.suffix if entry.is_file() else _library(entry)[0])
        origins[str(target)] = entry

    def fill(draft: Path) -> None:
        for entry in entries:
            _copy_library(entry, draft / _library(entry)[0])

    return kept_folder(root, fill)


def _copy_library(source: Path, target: Path) -> None:
    if source.is_file():
        write_file(target.with_suffix(".mo"), source.read_bytes().removeprefix(BYTE_ORDER_MARK))
        return
    strays = _stray_folders(source)
    files = [Path(entry.path) for entry in _modelica_files(source)]
    for file in [*files, *source.rglob("package.order")]:
        if any(file.is_relative_to(stray) for stray in strays):
            continue
        place = target / file.relative_to(source)
        write_file(place, file.read_bytes().removeprefix(BYTE_ORDER_MARK))


def write_file(file: Path, content: bytes) -> None:
    """Write a file in a folder that may have to be made."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)


def kept_folder(root: Path, fill: Callable[[Path], None]) -> Path:
    """The folder `root` of the cache; where it is not there, `fill` writes its content into a draft first.
    Raises OSError."""
    if not root.is_dir():
        draft = root.with_name(f"{root.name}.{os.getpid()}")
        fill(draft)
        try:
            draft.rename(root)
        except OSError:  # another process may have been faster
            shutil.rmtree(draft, ignore_errors=True)
            if not root.is_dir():
                raise
        forget_unused(root.parent, _MOST_KEPT)
    was_used(root)
    return root
