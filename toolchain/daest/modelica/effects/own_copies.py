"""Classes of libraries copied into the file of a model, so that they can be opened there for effects.

A parameter of a component of a library changes with nothing, and the library is not the user's to change. The
copy stands in the class that declares the component and says what the original says: names that the original
finds in the packages around it are written in full.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import dedent

from daest.modelica.effects.attach import free_name
from daest.modelica.effects.opened import NotOpened, declared_first
from daest.modelica.language.components import Classes, ClassText, Declared, statements
from daest.modelica.language.library import (
    BYTE_ORDER_MARK,
    chosen_libraries,
    library_name,
    library_roots,
)
from daest.modelica.language.outline import (
    Edit,
    Token,
    class_heads,
    class_tokens,
    depths,
    edited,
    find_outside,
    name_end,
)

_BEFORE_ANNOTATIONS = (";", "equation", "protected", "public")  # of a class, not of a declaration
_NOT_FOUND = "belongs to a component whose class cannot be found"


def with_own_class(
    source: bytes, path: Path, class_name: str, component: str, libraries: Sequence[str | Path]
) -> bytes:
    """The text of the file `path` in which the class of a component of `class_name`, `axle.damper`, stands
    itself; unchanged where it does already. Raises NotOpened where the class cannot be found."""
    chosen = chosen_libraries(library_roots(libraries), source, path)
    entries = {library_name(entry): entry for _, found, _ in chosen for entry in found}
    parts = component.split(".")
    for k in range(1, len(parts) + 1):
        source = _with_copy(source, class_name, parts[:k], entries)
    return source


def _with_copy(
    source: bytes, class_name: str, component: Sequence[str], entries: Mapping[str, Path]
) -> bytes:
    own = {head.name: head for head in class_heads(source)}
    classes = Classes(lambda full: source if full in own else _read(full, entries))
    declared, kind = _declaration(class_name, component, classes)
    if kind.name in own:
        return source
    if classes.resolved(declared.type_name, declared.scope) != kind.name:
        raise NotOpened("belongs to a component of a short class, whose values a copy would lose")
    text = _read(kind.file, entries)
    if declared.scope not in own or text is None:
        raise NotOpened(_NOT_FOUND)
    words = class_tokens(source, own[declared.scope])
    there = classes.get(declared.scope)
    taken = {*(there.components if there else ()), *(name.rpartition(".")[2] for name in own)}
    name = free_name(f"{kind.name.rpartition('.')[2]}Opened", taken)
    written = _type_words(words, declared)
    copied = declared_first(source, words, *_copy(text, kind, name, classes))
    return edited(source, [copied, Edit(written[0].start, written[-1].end, name)])


def _declaration(class_name: str, component: Sequence[str], classes: Classes) -> tuple[Declared, ClassText]:
    """Where a component of a component … of a class is declared, and its class."""
    scope: str | None = class_name
    declared: Declared | None = None
    for part in component:
        declared = None if scope is None else classes.component(part, scope)
        scope = None if declared is None else classes.type_of(declared)
    kind = None if scope is None else classes.get(scope)
    if declared is None or kind is None:
        raise NotOpened(_NOT_FOUND)
    return declared, kind


def _read(full: str, entries: Mapping[str, Path]) -> bytes | None:
    """The text of the file of a class of the libraries; None where it has no file of its own."""
    first, *rest = full.split(".")
    entry = entries.get(first)
    if entry is None:
        return None
    if entry.is_file():
        files = [entry] if not rest else []
    else:
        place = entry.joinpath(*rest)
        files = [place / "package.mo", *([place.with_name(f"{place.name}.mo")] if rest else [])]
    for file in files:
        if file.is_file():
            return file.read_bytes().removeprefix(BYTE_ORDER_MARK)
    return None


def _type_words(words: Sequence[Token], declared: Declared) -> list[Token]:
    """The tokens of the type in the declaration of a component."""
    for line in statements(words):
        if any(word.start == declared.name.start for word in line):
            for at in range(len(line)):
                end = name_end(line, at)
                if line[at].kind == "name" and "".join(w.text for w in line[at:end]) == declared.type_name:
                    return line[at:end]
    raise NotOpened(_NOT_FOUND)


def _copy(text: bytes, original: ClassText, name: str, classes: Classes) -> list[str]:
    """The lines of the class under another name, without its annotation, other classes named in full."""
    head = next(one for one in class_heads(text) if one.name == original.name)
    words = class_tokens(text, head)
    edits = [Edit(words[0].start, words[0].end, name), *_annotations(words)]
    gone = [(edit.start, edit.end) for edit in edits]
    for at in _first_names(words):
        word = words[at]
        full = _in_full(word.text, original, classes)
        if full != word.text and not any(start <= word.start < end for start, end in gone):
            edits.append(Edit(word.start, word.end, full))
    whole = edited(text, edits)
    body = whole[head.start : head.end + len(whole) - len(text)].decode()
    first, *lines = [line for line in f"{original.kind} {body}".splitlines() if line.strip()]
    return [first, *dedent("\n".join(lines)).splitlines(), f"end {name};"]


def _annotations(words: Sequence[Token]) -> Iterator[Edit]:
    """Annotations of the class itself, which draw and describe the original."""
    for at, depth in depths(words):
        is_own = depth == 0 and words[at - 1].text in _BEFORE_ANNOTATIONS
        if is_own and words[at].text == "annotation":
            yield Edit(words[at].start, words[find_outside(words, at, ";")].end, "")


def _first_names(words: Sequence[Token]) -> Iterator[int]:
    """Where names begin: not the parts behind a dot, and not those of arguments, `d(min = 0)`."""
    for at, word in enumerate(words):
        before = words[at - 1].text if at else ""
        after = words[at + 1].text if at + 1 < len(words) else ""
        is_argument = after in ("=", "(") and before in ("(", ",", "each", "final")
        if at and word.kind == "name" and before != "." and not is_argument:
            yield at


def _in_full(word: str, original: ClassText, classes: Classes) -> str:
    """The name of a class, or of a constant of a package around, as it is known everywhere; what the class or
    its base classes declare as it is."""
    if word in original.imports or classes.component(word, original.name) is not None:
        return word
    found = classes.resolved(word, original.name)
    if found is not None:
        return word if found.startswith(f"{original.name}.") else found
    around = original.name.split(".")
    packages = (".".join(around[:end]) for end in range(len(around) - 1, 0, -1))
    return next((f"{one}.{word}" for one in packages if classes.component(word, one) is not None), word)
