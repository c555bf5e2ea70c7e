"""Modelica text in the words that the compiler takes, line by line the same.

Three constructs are written otherwise, everywhere in a library and in the user's file:

- der(expression) becomes a call of a function of the same length, which the equations then differentiate;
  delay(expression, time) becomes another one, because the compiler takes no Integer and no iterator of a
  loop as its time;
- an external object (a table that C code reads) becomes an Integer, and its constructor a function beside it
  whose result is multiplied by one: the compiler mistakes the size of what a function of a matrix gives where
  it is used alone.

`extends Base(break connect(a, b))`: the compiler reads it and keeps the connection all the same. So the
clause is blanked in the text of the base class before it is compiled; offsets stay as they are.

Base Modelica, as OpenModelica writes it, is a flat model whose names stand in quotes,
`'motor.flange_a.phi'`. The compiler takes quoted names for operators, and nobody wants to type them. It is
given a text with plain names of the same length; what it answers gets the names without quotes. Base
Modelica knows no `protected`, which Modelica demands of the variables of a function.

Redeclared classes with a modification, and modifications of what a class does not have. Of
`M m(redeclare model Law = Quadratic(c = 0.5))` the compiler takes the class and silently drops its
modification. So the class gets a name of its own behind the end of the text, `model D__0 =
P.Quadratic(c = 0.5);`, and the redeclaration names that; no line or byte moves.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from daest.errors import ModelError
from daest.modelica.forms.array_values import with_nested_constructors
from daest.modelica.forms.function_text import find_function, hidden
from daest.modelica.forms.modifications import check_class_modification
from daest.modelica.language.outline import (
    CLOSE,
    KINDS,
    NO_CODE,
    OPEN,
    ClassHead,
    Token,
    class_heads,
    class_tokens,
    closing,
    connect_clauses,
    extends_clauses,
    find_base,
    imported,
    laid_over,
    name_end,
    place_of,
    tokens,
)

DER, DELAY = "deR", "delaY"
"""The functions that stand for der() of an expression and for delay()."""

OPERATORS = {DER: "der", DELAY: "delay"}
"""What the functions stand for."""

OPERATOR_FILES = {
    DER: f"""within ;
function {DER}
  input Real x;
  output Real y;
external "C" y = {DER}(x);
end {DER};
""",
    DELAY: f"""within ;
function {DELAY}
  input Real x;
  input Real T;
  input Real longest = 0;
  output Real y;
external "C" y = {DELAY}(x, T, longest);
end {DELAY};
""",
}
"""The files that declare them, by name."""

MARK = "daest:"
"""How the message of an assertion begins that stands for a hidden algorithm section: its number and the names
that the summands behind it stand for."""

CONSTRUCTOR = "_constructor"
"""What follows the name of an external object in that of its constructor."""

_C_TABLES = b"ModelicaStandardTables_"

_WORD = rb"[A-Za-z_]\w*(?:\s*\[[^\]()]*\])?"
_PLAIN = rb"\s*\.?\s*" + _WORD + rb"(?:\s*\.\s*" + _WORD + rb")*\s*\)"
_DER = re.compile(rb"(?P<call>\bder)\s*\((?!" + _PLAIN + rb")")
# A call: behind an operator, not with modifiers as a component of that name. Of nested ones the inner: the
# compiler takes no other.
_DELAY = re.compile(
    rb"(?:[=(,*/+{<>^-]|\bthen\b|\belse\b)\s*(?P<call>\bdelay)\s*"
    rb"\((?!\s*(?:each\b|final\b|redeclare\b|[A-Za-z_]\w*\s*=(?!=)|\)))"
    rb"(?!(?:[^()]|\([^()]*\))*\bdelay\s*\()"
)
_OBJECT = re.compile(
    rb"\bclass(\s+)([A-Za-z_]\w*)((?:\s+\"(?:[^\"\\]|\\.)*\")?\s*)extends\s+ExternalObject\s*;"
)
# A class with an `end`; `model M = N` has none.
_HEAD = re.compile(
    rb"(?:\bencapsulated\s+)?(?:\bpartial\s+)?\b(model|block|class|package)\s+([A-Za-z_]\w*)\b(?!\s*=)"
)
# A base class; `redeclare model extends M` is none.
_BASE = re.compile(
    rb"(?<!\bmodel )(?<!\bblock )(?<!\bfunction )(?<!\brecord )(?<!\bpackage )"
    rb"\bextends\s+([A-Za-z_]\w*)\s*[;(]"
)
_PART = rb"\bfunction\s+%s\b.*?\bend\s+%s\s*;"


def adapted(text: bytes) -> bytes:
    """The text as the compiler takes it. Lines keep their numbers."""
    if b"ExternalObject" in text:
        text = _without_objects(text)
    if _SEVERAL.search(text):
        text = with_nested_constructors(text)
    text = _with_full_imports(_without_inner_bases(text.replace(_C_TABLES, _C_TABLES.upper())))
    if b"function find" in text:
        heads = {head.name for head in class_heads(text)}
        for name in _LOOPS_OVER_LETTERS:
            if name in heads and (function := find_function(text, name)):
                text = hidden(text, function)
    text = _EACH.sub(lambda match: match[1] + b"    ", text)
    text = _NAMED.sub(lambda match: match[1] + b" " * len(match[2]), text)
    if b"loadResource" in text:
        text = _LOADED.sub(lambda match: b" " * len(match[0]), text)
    if b"delay" in text:
        text = _with_marked(text, _DELAY, DELAY)
    return _with_marked(text, _DER, DER) if b"der" in text else text


# What may be an array that is made over several ranges.
_SEVERAL = re.compile(rb"\{[^;]*\bfor\s+\w+\s+in\b[^;]*,\s*\w+\s+in\b")

# Functions of Modelica.Utilities.Strings that tell what kind of file a table stands in.
_LOOPS_OVER_LETTERS = ("Modelica.Utilities.Strings.find", "Modelica.Utilities.Strings.findLast")

# How the tables of the Standard Library name their file. The compiler cannot have the second condition in an
# argument; a table with an empty name has no file here either way.
_NAMED = re.compile(
    rb'(\bfileName\s*<>\s*"NoName"\s+)(and\s+not\s+Modelica\.Utilities\.Strings\.isEmpty\(fileName\))'
    rb'(?=\s*then\s+fileName\s+else\s+"NoName")'
)

# `redeclare each`, which the compiler takes for each element either way, without the word.
_EACH = re.compile(rb"\b(redeclare\s+)each\b")

# The call that makes a path of an URI; files are found by the URI itself.
_LOADED = re.compile(
    rb"(?<=[=(,])\s*\.?(?:Modelica\.Utilities\.Files|ModelicaServices\.ExternalReferences)\.loadResource"
    rb"(?=\s*\()"
)

_IMPORTED = re.compile(rb"\bimport\s+((?:[A-Za-z_]\w*\.)+([A-Za-z_]\w*))\s*;")


_ENUMERATION = re.compile(rb"\benumeration\s*\([^()]*\)")


def _with_full_imports(text: bytes) -> bytes:
    """The text with imported constants and literals by their full names where they stand in expressions: the
    compiler does not find a literal of an enumeration by its import."""
    for full, name in _IMPORTED.findall(text):
        value = re.compile(rb"(?<=[=<>+*/-])(\s*)" + name + rb"(?=\s*(?:[),;+*/<>-]|==|then\b|and\b|or\b))")
        skipped = [match.span() for match in NO_CODE.finditer(text)]
        parts, last = [], 0
        for match in value.finditer(text):
            if not any(start <= match.start() < end for start, end in skipped):
                parts += [text[last : match.start()], match[1], full]
                last = match.end()
        if not parts:
            continue
        text = b"".join([*parts, text[last:]])
        clause = re.compile(rb"\bimport\s+" + re.escape(full) + rb"\s*;")
        bare = clause.sub(b"", NO_CODE.sub(b"", text)).replace(full, b"")
        if not re.search(rb"(?<![.\w])" + name + rb"\b(?!\s*=)", _ENUMERATION.sub(b"", bare)):
            text = clause.sub(lambda found: re.sub(rb"\S", b" ", found[0]), text)
    return text


def with_constructors(text: bytes, objects: Iterable[str]) -> bytes:
    """The text with calls `Object(…)` as calls of the constructors; `objects` are full names."""
    for name in objects:
        short = name.rpartition(".")[2].encode()
        if short not in text:
            continue
        call = re.compile(rb"(=\s*)(?:[A-Za-z_]\w*\.)*" + short + rb"(\s*\()")
        text = call.sub(rb"\g<1>1*" + name.encode() + CONSTRUCTOR.encode() + rb"\g<2>", text)
    return text


def external_objects(text: bytes) -> tuple[str, ...]:
    """Names of the external objects that a text declares."""
    if b"ExternalObject" not in text:
        return ()
    return tuple(match[2].decode() for match in _OBJECT.finditer(text))


def _with_marked(text: bytes, calls: re.Pattern[bytes], name: str) -> bytes:
    """`der(a*b)` as `deR(a*b)`; comments and strings stay. `name` is as long as the operator."""
    made = bytearray(text)
    skipped = [match.span() for match in NO_CODE.finditer(text)]
    at = 0
    for match in calls.finditer(text):
        start = match.start("call")
        while at < len(skipped) and skipped[at][1] <= start:
            at += 1
        if at == len(skipped) or skipped[at][0] > start:
            made[start : start + len(name)] = name.encode()
    return bytes(made)


def _without_inner_bases(text: bytes) -> bytes:
    """The text with each base class that its heir contains behind the heir."""
    if not _BASE.search(text):
        return text
    bare = NO_CODE.sub(lambda skipped: b" " * len(skipped[0]), text)
    bases = set(_BASE.findall(bare))
    heads = list(_HEAD.finditer(bare))
    for head in [head for head in heads if head[2] in bases]:
        end = _end_of(head[2], bare, head.end())
        before = [one for one in heads if one.start() < head.start()]
        around = [one for one in before if _end_of(one[2], bare, one.end()) > end]
        if end < 0 or not around or around[-1][1] == b"package":
            continue
        outer_end = _end_of(around[-1][2], bare, end)
        if head[2] in _BASE.findall(bare[around[-1].start() : head.start()] + bare[end:outer_end]):
            inner = text[head.start() : end]
            heir = text[: head.start()] + b"\n" * inner.count(b"\n") + text[end:outer_end]
            return _without_inner_bases(heir + b" " + inner + text[outer_end:])
    return text


def _end_of(name: bytes, text: bytes, start: int) -> int:
    """Where the class `name`, open at `start`, ends; -1 if nowhere."""
    found = re.compile(rb"\bend\s+" + name + rb"\s*;").search(text, start)
    return found.end() if found else -1


def _without_objects(text: bytes) -> bytes:
    for match in list(_OBJECT.finditer(text))[::-1]:
        name = match[2]
        end = re.compile(rb"\bend\s+" + name + rb"\s*;").search(text, match.end())
        if end is None:
            continue
        body = text[match.end() : end.start()]
        body = _part(body, b"destructor", lambda found: b"\n" * found.count(b"\n"))
        body = _part(body, b"constructor", lambda found, name=name: _renamed(found, name))
        head = b"type" + match[1] + name + b" = Integer;" + b"\n" * match[0].count(b"\n")
        text = text[: match.start()] + head + body + text[end.end() :]
    return text


def _part(body: bytes, name: bytes, change) -> bytes:  # type: ignore[no-untyped-def]
    return re.sub(_PART % (name, name), lambda match: change(match[0]), body, flags=re.DOTALL)


def _renamed(function: bytes, name: bytes) -> bytes:
    return re.sub(rb"\bconstructor\b", name + CONSTRUCTOR.encode(), function)


_BREAK = re.compile(rb"\bbreak\s+connect\b")


def without_broken(source: bytes, path: Path, class_name: str) -> bytes:
    """`source` with the connect clauses blanked that `class_name` and the classes it extends remove.

    Raises ModelError `model-break` for a connection that is not found, or a base class that stands elsewhere.
    """
    if _BREAK.search(source) is None:
        return source
    heads = class_heads(source)
    spans: list[tuple[int, int]] = []
    start = next((head for head in heads if head.name == class_name), None)
    if start is not None:
        _collect(source, path, heads, start, spans)
    text = bytearray(source)
    for begin, end in spans:
        text[begin:end] = laid_over(source[begin:end])
    return bytes(text)


def _collect(
    source: bytes, path: Path, heads: Sequence[ClassHead], head: ClassHead, spans: list[tuple[int, int]]
) -> None:
    """Add the spans of the clauses that `head` and its bases remove."""
    for clause in extends_clauses(class_tokens(source, head)):
        base = find_base(heads, head.name, clause.base)
        where = place_of(str(path), source, clause.start)
        if base is None:
            if clause.broken:
                raise ModelError(
                    "model-break",
                    f"`{head.name}` removes connections of `{clause.base}`, which stands in another file",
                    where=where,
                    remedy=f"Write `{clause.base}` into this file.",
                )
            continue
        if clause.broken:
            _refuse_other_use(source, path, base)
        for pair in clause.broken:
            found = _find(source, heads, base, pair)
            if not found:
                shown = ", ".join(sorted(pair))
                raise ModelError(
                    "model-break",
                    f"`{base.name}` has no connect({shown}) that could be removed",
                    where=where,
                    remedy="Write it as the base class does.",
                )
            spans += found
        _collect(source, path, heads, base, spans)


def _find(
    source: bytes, heads: Sequence[ClassHead], head: ClassHead, pair: frozenset[str]
) -> list[tuple[int, int]]:
    """Spans of the clauses that connect `pair`, in the class or in those of the file that it extends."""
    words = class_tokens(source, head)
    found = [(c.start, c.end) for c in connect_clauses(words) if c.pair == pair]
    for clause in extends_clauses(words):
        base = find_base(heads, head.name, clause.base)
        if base is not None:
            found += _find(source, heads, base, pair)
    return found


def _refuse_other_use(source: bytes, path: Path, base: ClassHead) -> None:
    """The base must not also be the class of a component: it would lose its connection there, too."""
    short = base.name.rpartition(".")[2]
    before: Token | None = None
    for token in tokens(source):
        known = before is None or before.text in ("end", "extends", ".") or token.start == base.start
        if token.text == short and not known:
            raise ModelError(
                "model-break",
                f"`{base.name}` loses a connection in one class and is a component in another",
                where=place_of(str(path), source, token.start),
                remedy="Copy the class under another name for one of the two uses.",
            )
        before = token


HEADING = b"//! base"
"""The comment that a Base Modelica text begins with."""

_ENDING = ("algorithm", "external", "equation", "end", "annotation", "protected", "public")
_GENERATED = re.compile(r"\b_[0-9a-z]+\b")


@dataclass(frozen=True)
class Names:
    """Plain names of the compiler's text -> names as the user writes them. Empty for ordinary Modelica."""

    shown: Mapping[str, str] = field(default_factory=dict)

    def model(self, class_name: str) -> str:
        """The user's name of the class, without the package that stands around it."""
        plain = class_name.rpartition(".")[2]
        return self.shown.get(plain, class_name)

    def restored(self, value: Any) -> Any:
        """`value` (text, or dicts and lists of such) with the names as the user writes them."""
        if not self.shown:
            return value
        if isinstance(value, str):
            return _GENERATED.sub(lambda found: self.shown.get(found[0], found[0]), value)
        if isinstance(value, dict):
            return {self.restored(key): self.restored(entry) for key, entry in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(self.restored(entry) for entry in value)
        return value


def without_quotes(text: bytes) -> tuple[bytes, Names]:
    """A Base Modelica text as Modelica, line by line, with plain names, each as long as what it stands for;
    and what they stand for. Any other text as it is."""
    if not text.lstrip().startswith(HEADING):
        return text, Names()
    text = _with_protected(text)
    words = list(tokens(text))
    free = _free_names({word.text for word in words})
    plain: dict[str, str] = {}
    parts, last = [], 0
    for word in words:
        if word.kind == "name" and word.text.startswith("'"):
            if word.text not in plain:
                plain[word.text] = free(word.end - word.start)
            parts += [text[last : word.start], plain[word.text].encode()]
            last = word.end
    return b"".join([*parts, text[last:]]), Names({made: quoted[1:-1] for quoted, made in plain.items()})


def _with_protected(text: bytes) -> bytes:
    """The text with `protected` before the variables of functions."""
    words = list(tokens(text))
    places = [
        place for i in range(len(words)) if _opens_function(words, i) for place in _sections(words, i + 2)
    ]
    parts, last = [], 0
    for start, keyword in places:
        parts += [text[last:start], keyword]
        last = start
    return b"".join([*parts, text[last:]])


def _opens_function(words: Sequence[Token], i: int) -> bool:
    """Whether the word at `i` opens a function with declarations: `function f = g` has none."""
    after = [word.text for word in words[i + 1 : i + 3]]
    return words[i].text == "function" and len(after) == 2 and after[1] not in ("=", ";", "extends")


def _sections(words: Sequence[Token], i: int) -> Iterator[tuple[int, bytes]]:
    """Where among the declarations of a function from word `i` on which keyword belongs."""
    is_public, depth, is_new = True, 0, True
    for word in words[i:]:
        if is_new and word.kind == "text":
            continue
        if is_new and word.text in _ENDING:
            return
        if is_new and is_public != (word.text in ("input", "output")):
            is_public = not is_public
            yield word.start, b"public " if is_public else b"protected "
        depth += (word.text in "([{") - (word.text in ")]}")
        is_new = depth == 0 and word.text == ";"


def _free_names(taken: set[str]) -> Callable[[int], str]:
    """A function that returns another name of the given length every time, none of `taken`."""
    counts: dict[int, int] = defaultdict(int)

    def free(length: int) -> str:
        while True:
            name = "_" + np.base_repr(counts[length], 36).lower().zfill(length - 1)
            counts[length] += 1
            if name not in taken:
                return name

    return free


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
        is_used = _around(heads, words[one.first]) in used
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
        made[start:end] = laid_over(text[start:end], name + component)
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
        if at + 3 >= len(words) or words[at].text not in KINDS or words[at + 2].text != "=":
            continue
        opening = name_end(words, at + 3)
        if opening < len(words) and words[opening].text == "(":
            yield _Modified(words[at].text, at + 3, opening, closing(words, opening))


def _constrained(words: Sequence[Token]) -> Iterator[_Modified]:
    """`replaceable Linear law(d = 0.4) constrainedby Law`: the modification belongs to this class alone, and
    not to one in its place (Language Specification 7.3.2), where the compiler keeps it."""
    for i, word in enumerate(words):
        if word.text != "replaceable" or i + 2 >= len(words) or words[i + 1].text in KINDS:
            continue
        named = name_end(words, i + 1)
        opening = named + 1
        if opening >= len(words) or words[named].kind != "name" or words[opening].text != "(":
            continue
        end = closing(words, opening)
        if end < len(words) and words[end].text == "constrainedby":
            yield _Modified("", i + 1, opening, end)


def _variable(words: Sequence[Token], one: _Modified) -> int | None:
    """The first word among the values of a modification that may be a variable: a name without dots that is
    neither called nor modified."""
    for i in range(one.opening + 1, one.end - 1):
        before, after = words[i - 1].text, words[i + 1].text
        is_name = words[i].kind == "name" and words[i].text not in _WORDS
        if is_name and "." not in (before, after) and after not in ("(", "=") and before not in KINDS:
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
    end = name_end(words, one.first)
    name = "".join(word.text for word in words[one.first : end])
    if name.startswith("."):
        return name
    first, dot, rest = name.partition(".")
    found = find_base(heads, f"{_around(heads, words[one.first])}.{_NAME}", first)
    return imported(words, name) if found is None else found.name + dot + rest


def _around(heads: Sequence[ClassHead], word: Token) -> str:
    """The full name of the class whose text a word stands in; empty outside of all."""
    around = [head.name for head in heads if head.start < word.start < head.end and not head.is_short]
    return around[-1] if around else ""
