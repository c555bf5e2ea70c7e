"""The part of its libraries that a model needs: the compiler reads a library as a whole, and takes many
seconds for a large one.

Which files are needed follows from the names in the texts: each is looked up where it stands, in the packages
around it, and through imports, short class definitions and base classes. That may miss a name: where the
compiler says so, it reads the whole library instead.
"""

from __future__ import annotations

import hashlib
import pickle
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

from daest.cache import cache_folder, keep_content, kept_content
from daest.modelica.forms.bus_members import bus_members, with_members
from daest.modelica.forms.complex_text import COMPLEX, with_parts
from daest.modelica.forms.constraining import fits, with_bases, with_constraining_modifications
from daest.modelica.forms.dialect import OPERATOR_FILES, adapted, external_objects, with_constructors
from daest.modelica.forms.nested_modifications import (
    with_record_arrays,
    with_record_values,
    with_taken_modifications,
)
from daest.modelica.forms.sizes import with_last_elements
from daest.modelica.language.components import Classes
from daest.modelica.language.library import (
    BYTE_ORDER_MARK,
    Roots,
    kept_folder,
    library_name,
    stamp,
    write_file,
)
from daest.modelica.language.outline import NO_CODE, class_heads

_VERSION = "35"  # of what is kept; another one throws away what is there
_NAME = re.compile(rb"(?<![\w.])\.?[A-Za-z_]\w*(?:\s*\.\s*[A-Za-z_]\w*)*")
_ALIAS = re.compile(
    rb"\b(?:import|package|model|function|type|block|connector|record|class|operator)\s+([A-Za-z_]\w*)"
    rb"(?:\s*\([^()]*\))?\s*=\s*([A-Za-z_][\w.]*)"
)
_IMPORT = re.compile(rb"\bimport\s+([A-Za-z_][\w.]*?)(?:\.(\*)|\.\{([^}]*)\})?\s*;")
_EXTENDS = re.compile(rb"\bextends\s+\.?([A-Za-z_][\w.]*)")


@dataclass(frozen=True)
class _File:
    """What a file of a library names: all names, aliases, opened packages and base classes."""

    names: frozenset[str]
    aliases: dict[str, str]
    opened: tuple[str, ...]
    bases: tuple[str, ...]
    objects: tuple[str, ...]


@dataclass(frozen=True)
class _Library:
    """A library: where each class with a file of its own stands, by its full name."""

    entry: Path
    places: dict[str, str]  # full name -> path below the entry
    files: dict[str, _File]  # by full name
    left_out: tuple[str, ...]  # folders without package.mo


def excerpt(
    entries: Sequence[Path],
    others: Sequence[Path],
    text: bytes,
    path: Path,
    bases: Mapping[str, str] = MappingProxyType({}),
) -> Roots | None:
    """A root with what the text in file `path` needs of the libraries `entries`; `others` are roots as they
    are, `bases` further base classes of classes. None where a library cannot be read."""
    try:
        libraries = {library_name(entry): _indexed(entry) for entry in entries}
        scope = _scope_of(path, libraries)
        needed = _needed(text, scope, libraries)
        if scope:
            _include(scope[1], libraries, needed)
        folder, origins, objects = _written(needed, libraries, bases)
    except (OSError, UnicodeDecodeError):
        return None
    return Roots((folder, *others), origins, objects)


# The index --------------------------------------------------------------------------------------------------


def _indexed(entry: Path) -> _Library:
    """The library, from the cache where its files have not changed."""
    file = cache_folder() / "libraries" / f"{stamp([entry])[:32]}-{_VERSION}.index"
    content = kept_content(file)
    if content is not None:
        try:
            found = pickle.loads(content)
            if isinstance(found, _Library):
                return found
        except Exception:  # an unreadable entry of the cache, whatever is wrong with it, is no entry
            pass
    made = _index(entry)
    keep_content(file, pickle.dumps(made, protocol=pickle.HIGHEST_PROTOCOL))
    return made


def _index(entry: Path) -> _Library:
    name = library_name(entry)
    if entry.is_file():
        return _Library(entry, {name: ""}, {name: _read(entry.read_bytes(), (name,))}, ())
    places: dict[str, str] = {}
    files: dict[str, _File] = {}
    left_out: list[str] = []

    def visit(folder: Path, full: str) -> None:
        for child in sorted(folder.iterdir()):
            if child.is_dir() and child.name != "Resources":
                if (child / "package.mo").is_file():
                    visit(child, f"{full}.{child.name}")
                elif any(child.rglob("*.mo")):
                    left_out.append(str(child.relative_to(entry)))
            elif child.suffix == ".mo":
                inner = full if child.name == "package.mo" else f"{full}.{child.stem}"
                places[inner] = str(child.relative_to(entry))
                files[inner] = _read(child.read_bytes(), tuple(inner.split(".")))

    visit(entry, name)
    return _Library(entry, places, files, tuple(left_out))


def _read(text: bytes, scope: tuple[str, ...]) -> _File:
    objects = tuple(".".join((*scope, one)) for one in external_objects(text))
    bare = NO_CODE.sub(b" ", text)
    names = frozenset(re.sub(rb"\s", b"", name).decode() for name in _NAME.findall(bare))
    aliases = {a.decode(): b.decode() for a, b in _ALIAS.findall(bare)}
    opened: list[str] = []
    for package, star, chosen in _IMPORT.findall(bare):
        full = package.decode()
        if star:
            opened.append(full)
        elif chosen:
            aliases.update((part.strip(), f"{full}.{part.strip()}") for part in chosen.decode().split(","))
        else:
            aliases[full.rpartition(".")[2]] = full
    bases = tuple(sorted({base.decode() for base in _EXTENDS.findall(bare)}))
    return _File(names, aliases, tuple(opened), bases, objects)


# What is needed ---------------------------------------------------------------------------------------------


def _scope_of(path: Path, libraries: dict[str, _Library]) -> tuple[tuple[str, ...], str] | None:
    """Package and full name of a file that lies in one of the libraries."""
    for library in libraries.values():
        base = library.entry.resolve()
        if path.resolve().is_relative_to(base):
            inside = "" if path.resolve() == base else str(path.resolve().relative_to(base))
            for full, place in library.places.items():
                if place == inside:
                    return tuple(full.split(".")), full
    return None


def _needed(
    text: bytes, scope: tuple[tuple[str, ...], str] | None, libraries: dict[str, _Library]
) -> set[str]:
    """Full names of all classes with files of their own that the text needs."""
    found: set[str] = set()
    waiting = [(_read(text, scope[0] if scope else ()), scope[0] if scope else ())]
    while waiting:
        file, at = waiting.pop()
        for name in file.names:
            for full in _resolved(name, file, at, libraries):
                if full not in found:
                    found.add(full)
                    waiting.append((_file(full, libraries), tuple(full.split("."))))
    return found


def _file(full: str, libraries: dict[str, _Library]) -> _File:
    return libraries[full.partition(".")[0]].files[full]


def _resolved(
    name: str, file: _File, at: tuple[str, ...], libraries: dict[str, _Library], depth: int = 0
) -> list[str]:
    """The files that a name in a file leads to: those of the class and of the packages around it."""
    parts = name.lstrip(".").split(".")
    if depth > 8:
        return []
    around = [file]
    for k in range(len(at), 0, -1):
        full = ".".join(at[:k])
        if full in libraries[at[0]].files:
            around.append(_file(full, libraries))
    for one in around:
        if parts[0] in one.aliases and one.aliases[parts[0]] != name:
            target = ".".join([one.aliases[parts[0]], *parts[1:]])
            if target.partition(".")[0] != parts[0] or target != name:
                made = _walk(target.split("."), at, libraries)
                if made:
                    return made
                nested = _resolved(target, file, at, libraries, depth + 1) if target != name else []
                if nested:
                    return nested
    made = _walk(parts, at, libraries)
    if made:
        return made
    for one in around:
        for package in (*one.opened, *one.bases):
            if package.split(".")[0] == parts[0]:
                continue
            made = _walk([*package.split("."), *parts], at, libraries, whole=len(package.split(".")) + 1)
            if made:
                return made
    return []


def _walk(
    parts: Sequence[str], at: tuple[str, ...], libraries: dict[str, _Library], whole: int = 1
) -> list[str]:
    """The files along a dotted name, looked up in the packages from the innermost one outwards; at least
    `whole` of its parts must be found."""
    for k in range(len(at), -1, -1):
        prefix = at[:k]
        library = libraries.get(prefix[0] if prefix else parts[0])
        if library is None:
            continue
        full = ".".join((*prefix, parts[0]))
        if full not in library.files:
            continue
        chain = [".".join(prefix[: i + 1]) for i in range(len(prefix))]
        reached = 0
        for i in range(len(parts)):
            full = ".".join((*prefix, *parts[: i + 1]))
            if full not in library.files:
                break
            chain.append(full)
            reached = i + 1
        if reached >= whole:
            return [one for one in chain if one in library.files]
    return []


def _include(full: str, libraries: dict[str, _Library], needed: set[str]) -> None:
    """The class and the packages around it."""
    parts = full.split(".")
    library = libraries[parts[0]]
    needed |= {one for i in range(len(parts)) if (one := ".".join(parts[: i + 1])) in library.files}


# Writing it -------------------------------------------------------------------------------------------------


def _written(
    needed: set[str], libraries: dict[str, _Library], bases: Mapping[str, str]
) -> tuple[Path, dict[str, Path], tuple[str, ...]]:
    """A folder of the cache with the files, and where they come from."""
    used = sorted({full.partition(".")[0] for full in needed})
    objects = sorted({one for name in used for f in libraries[name].files.values() for one in f.objects})
    key = hashlib.sha256(
        "\0".join(
            [
                _VERSION,
                *sorted(needed),
                *(stamp([libraries[name].entry]) for name in used),
                str(sorted(bases.items())),
            ]
        ).encode()
    ).hexdigest()[:32]
    root = cache_folder() / "libraries" / f"excerpt-{key}"
    origins: dict[str, Path] = {}
    for name in used:
        entry = libraries[name].entry
        origins[str(root / (name + entry.suffix if entry.is_file() else name))] = entry

    def fill(draft: Path) -> None:
        texts = {
            full: with_bases(_file_of(full, libraries).read_bytes().removeprefix(BYTE_ORDER_MARK), bases)
            for full in needed
        }
        classes = Classes(texts.get)
        members = bus_members(classes, texts.values())
        if members:
            texts = {full: with_members(text, members) for full, text in texts.items()}
            classes = Classes(texts.get)
        with_complex = _with_complex(texts, libraries)
        for full in sorted(needed):
            library = libraries[full.partition(".")[0]]
            place = library.places[full]
            inside = f"{library_name(library.entry)}/{place}" if place else f"{full}.mo"
            text = with_parts(texts[full], classes) if full in with_complex else texts[full]
            text = with_last_elements(text, classes)
            text = with_taken_modifications(with_constraining_modifications(text), classes)
            write_file(draft / inside, with_constructors(adapted(text), objects))
        for name, content in OPERATOR_FILES.items():
            write_file(draft / f"{name}.mo", content.encode())

    return kept_folder(root, fill), origins, tuple(objects)


def _with_complex(texts: Mapping[str, bytes], libraries: dict[str, _Library]) -> set[str]:
    """The files that may hold equations of Complex numbers: those that name them, and, by the names of base
    classes, those that inherit from one."""
    found = {full for full, text in texts.items() if COMPLEX.encode() in text and full != COMPLEX}
    waiting = list(found)
    heirs: dict[str, list[str]] = {}
    for full in texts:
        for base in _file(full, libraries).bases:
            heirs.setdefault(base.rpartition(".")[2], []).append(full)
    while waiting:
        for heir in heirs.get(waiting.pop().rpartition(".")[2], ()):
            if heir not in found:
                found.add(heir)
                waiting.append(heir)
    return found


def _file_of(full: str, libraries: dict[str, _Library]) -> Path:
    library = libraries[full.partition(".")[0]]
    place = library.places[full]
    return library.entry / place if place else library.entry


def adapted_text(text: bytes, roots: Roots) -> bytes:
    """The user's text for the compiler, with a comment that makes it load all libraries of the excerpt."""
    names = sorted({Path(made).stem for made in roots.origins} | set(OPERATOR_FILES))
    objects = roots.objects
    members = bus_members(Classes(lambda full: _read_of(full, text, roots)), [text])
    text = with_members(text, members) if members else text
    if any(Path(made).stem == COMPLEX for made in roots.origins):
        text = with_parts(text, Classes(lambda full: _read_of(full, text, roots)))
    text = with_modifications(text, lambda own: Classes(partial(_read_of, text=own, roots=roots)))
    return with_constructors(adapted(text), objects) + f"\n// {' '.join(names)}\n".encode()


def with_modifications(text: bytes, classes_of: Callable[[bytes], Classes]) -> bytes:
    """The text with its modifications as the compiler takes them; `classes_of` tells the classes that a text
    names."""
    for written in (with_record_values, with_record_arrays, with_last_elements, with_taken_modifications):
        text = written(text, classes_of(text))
    return text


def may_extend(text: bytes, roots: Roots, name: str, wanted: str) -> bool:
    """Whether class `name`, of the text or of the excerpt, has what class `wanted` has, so that it may extend
    it."""
    return fits(Classes(lambda full: _read_of(full, text, roots)), name, wanted)


def _read_of(full: str, text: bytes, roots: Roots) -> bytes | None:
    """The text of the file of a class: in the folder of the excerpt, or else the user's."""
    parts = full.split(".")
    for made in map(Path, roots.origins):
        if made.stem == parts[0]:
            place = made.joinpath(*parts[1:])
            for file in (place / "package.mo", place.with_suffix(".mo")):
                if file.is_file():
                    return file.read_bytes()
            return None
    if any(head.name == full for head in class_heads(text)):
        return text
    places = (folder.joinpath(*parts) for folder in roots.folders)
    files = (file for place in places for file in (place / "package.mo", place.with_suffix(".mo")))
    return next((file.read_bytes() for file in files if file.is_file()), None)
