"""Redeclared classes with a modification, in the form that the compiler takes; and modifications of what a
class does not have.

`M m(redeclare model Law = Quadratic(c = 0.5))`: the compiler takes the class and silently drops its
modification. So the class gets a name of its own behind the end of the text, `model D__0 =
P.Quadratic(c = 0.5);`, and the redeclaration names that; no line or byte moves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from daest.errors import ModelError
from daest.modelica.class_text import CLOSE, OPEN, class_tokens, closing, find_base
from daest.modelica.modifications import check_class_modification
from daest.modelica.outline import ClassHead, Token, class_heads, place_of, tokens

_KINDS = ("model", "block", "class", "package", "function", "record", "connector", "type")
_WORDS = ("true", "false", "each", "final", "if", "then", "else", "elseif", "and", "or", "not", "redeclare")
_NAME = "D__{}"


@dataclass(frozen=True)
class _Modified:
    """A class with a modification where a name is to stand: tokens `first` to before `end`."""

    kind: str
    first: int
    opening: int
    end: int


def with_named_classes(text: bytes, path: Path, class_name: str) -> bytes:
    """The text with a class of its own for each redeclared class that is modified. Raises ModelError where
    the modification, in what `class_name` is made of, names variables, which a class outside cannot see, or
    what the class does not have."""
    if b"redeclare" not in text and b"constrainedby" not in text:
        return text
    words = list(tokens(text))
    found = [*_redeclared(words), *_constrained(words)]
    if not found:
        return text
    heads = class_heads(text)
    used = _used(text, heads, class_name)
    made = bytearray(text)
    appended: list[str] = []
    for one in sorted(found, key=lambda one: one.first):
        name = _NAME.format(len(appended)).encode()
        start, end = words[one.first].start, words[one.end - 1].end
        if one.end == one.opening + 2:
            continue
        is_used = _around(heads, words, one.first) in used
        named = _variable(words, one)
        if named is not None:
            if one.kind and is_used:
                raise _names_variables(words, one, named, text, path)
            continue
        base = _full_name(words, one, heads)
        declared = next((head for head in heads if head.name == base), None)
        if declared is not None and is_used:
            check_class_modification(words, one.opening, declared, heads, text, str(path))
        modification = text[words[one.opening].start : end].decode("utf-8", "replace")
        appended.append(f"{one.kind or 'model'} {name.decode()} = {base}{' '.join(modification.split())};")
        component = b"" if one.kind else b" " + words[one.opening - 1].text.encode()
        _replace(made, start, end, name + component)
    return bytes(made) + ("\n" + " ".join(appended) + "\n").encode() if appended else text


def _used(text: bytes, heads: Sequence[ClassHead], class_name: str) -> set[str]:
    """The classes of the file whose names stand in the class, or in one that it uses."""
    by_name = {head.name: head for head in heads}
    found, todo = set[str](), [class_name]
    while todo:
        name = todo.pop()
        if name in found or name not in by_name:
            continue
        found.add(name)
        mentioned = {word.text for word in class_tokens(text, by_name[name])}
        todo += [h.name for h in heads if h.name.rpartition(".")[2] in mentioned or h.name == name]
        todo += [h.name for h in heads if h.name.startswith(name + ".")]
    return found


def _replace(made: bytearray, start: int, end: int, name: bytes) -> None:
    rest = iter(name)
    for at in range(start, end):
        if made[at] not in b"\r\n":
            made[at] = next(rest, 32)


def _redeclared(words: Sequence[Token]) -> Iterator[_Modified]:
    """`redeclare model Law = Quadratic(…)` inside of modifications."""
    depth = 0
    for i, word in enumerate(words):
        depth += (word.text in OPEN) - (word.text in CLOSE)
        if depth == 0 or word.text != "redeclare":
            continue
        at = i + 1
        while at < len(words) and words[at].text in ("each", "final", "replaceable"):
            at += 1
        if at + 3 >= len(words) or words[at].text not in _KINDS or words[at + 2].text != "=":
            continue
        opening = _name_end(words, at + 3)
        if opening < len(words) and words[opening].text == "(":
            yield _Modified(words[at].text, at + 3, opening, closing(words, opening))


def _constrained(words: Sequence[Token]) -> Iterator[_Modified]:
    """`replaceable Linear law(d = 0.4) constrainedby Law`: the modification belongs to this class alone, and
    not to one in its place (Language Specification 7.3.2), where the compiler keeps it."""
    for i, word in enumerate(words):
        if word.text != "replaceable" or i + 2 >= len(words) or words[i + 1].text in _KINDS:
            continue
        named = _name_end(words, i + 1)
        opening = named + 1
        if opening >= len(words) or words[named].kind != "name" or words[opening].text != "(":
            continue
        end = closing(words, opening)
        if end < len(words) and words[end].text == "constrainedby":
            yield _Modified("", i + 1, opening, end)


def _name_end(words: Sequence[Token], at: int) -> int:
    """Index behind the dotted name that begins at `at`."""
    at += words[at].text == "." if at < len(words) else 0
    while at < len(words) and words[at].kind == "name":
        at += 1
        if at >= len(words) or words[at].text != ".":
            break
        at += 1
    return at


def _variable(words: Sequence[Token], one: _Modified) -> int | None:
    """The first word among the values of a modification that may be a variable: a name without dots that is
    neither called nor modified."""
    for i in range(one.opening + 1, one.end - 1):
        before, after = words[i - 1].text, words[i + 1].text
        is_name = words[i].kind == "name" and words[i].text not in _WORDS
        if is_name and "." not in (before, after) and after not in ("(", "=") and before not in _KINDS:
            return i
    return None


def _names_variables(words: Sequence[Token], one: _Modified, at: int, text: bytes, path: Path) -> ModelError:
    base = "".join(word.text for word in words[one.first : one.opening])
    return ModelError(
        "model-unsupported",
        f"the redeclared class {base}(…) is modified with the variable `{words[at].text}`, which is beyond "
        "the compiler that is built in",
        where=place_of(str(path), text, words[at].start),
        remedy=f"Redeclare the class alone (`= {base}`) and modify the component that is of it "
        f"(`name({words[at].text} = …)`), or write the number.",
    )


def _full_name(words: Sequence[Token], one: _Modified, heads: Sequence[ClassHead]) -> str:
    """The name of the modified class as it is known at the end of the text."""
    end = _name_end(words, one.first)
    name = "".join(word.text for word in words[one.first : end])
    if name.startswith("."):
        return name
    inside = [head for head in heads if head.start <= words[one.first].start]
    if inside:
        local = ClassHead("model", f"{_around(inside, words, one.first)}.x", False, 0, 0)
        first, dot, rest = name.partition(".")
        found = find_base(heads, local, first)
        if found is not None:
            return found.name + dot + rest
    return _imported(words, name)


def _around(heads: Sequence[ClassHead], words: Sequence[Token], at: int) -> str:
    """The full name of the class whose text a word stands in."""
    position = words[at].start
    ended: set[str] = set()
    for i in range(at):
        if words[i].text == "end" and words[i + 1].kind == "name":
            open_heads = [h for h in heads if h.start < words[i].start and h.name not in ended]
            match = [h for h in open_heads if h.name.rpartition(".")[2] == words[i + 1].text]
            if match:
                ended.add(match[-1].name)
    still = [head for head in heads if head.start < position and head.name not in ended]
    long = [head for head in still if not _is_short(words, head)]
    return long[-1].name if long else ""


def _is_short(words: Sequence[Token], head: ClassHead) -> bool:
    """`model M = N(…)` has no end."""
    at = next(i for i, word in enumerate(words) if word.start == head.start)
    return at + 1 < len(words) and words[at + 1].text == "="


def _imported(words: Sequence[Token], name: str) -> str:
    """The name with what an import clause says of its first part."""
    first, dot, rest = name.partition(".")
    for i, word in enumerate(words):
        if word.text != "import":
            continue
        if words[i + 1].text == first and words[i + 2].text == "=":
            at = i + 3
            return "".join(w.text for w in words[at : _name_end(words, at)]) + dot + rest
        end = _name_end(words, i + 1)
        if words[end - 1].text == first:
            return "".join(w.text for w in words[i + 1 : end]) + dot + rest
    return name
