"""Modelica text in the words that the compiler takes, line by line the same.

Two constructs are written otherwise, everywhere in a library and in the user's file:

- der(expression) becomes a call of a function of the same length, which the equations then differentiate;
- an external object (a table that C code reads) becomes an Integer, and its constructor a function beside it
  whose result is multiplied by one: the compiler mistakes the size of what a function of a matrix gives where
  it is used alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

DER = "deR"
"""The function that stands for der() of an expression."""

DER_FILE = f"""within ;
function {DER}
  input Real x;
  output Real y;
external "C" y = {DER}(x);
end {DER};
"""

CONSTRUCTOR = "_constructor"
"""What follows the name of an external object in that of its constructor."""

_C_TABLES = b"ModelicaStandardTables_"

_SKIPPED = re.compile(rb'"(?:[^"\\]|\\.)*"|//[^\n]*|/\*.*?\*/', re.DOTALL)
_DER = re.compile(rb"\bder(\s*\()")
_WORD = rb"[A-Za-z_]\w*(?:\s*\[[^\]()]*\])?"
_PLAIN = re.compile(rb"\s*\.?\s*" + _WORD + rb"(?:\s*\.\s*" + _WORD + rb")*\s*\)")
_OBJECT = re.compile(
    rb"\bclass(\s+)([A-Za-z_]\w*)((?:\s+\"(?:[^\"\\]|\\.)*\")?\s*)extends\s+ExternalObject\s*;"
)
_HEAD = re.compile(rb"(?:\bencapsulated\s+)?(?:\bpartial\s+)?\b(model|block|class|package)\s+([A-Za-z_]\w*)")
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
    text = _without_inner_bases(text.replace(_C_TABLES, _C_TABLES.upper()))
    return _with_marked_rates(text) if b"der" in text else text


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


def _with_marked_rates(text: bytes) -> bytes:
    """`der(a*b)` as `deR(a*b)`; comments and strings stay."""
    made = bytearray(text)
    skipped = [match.span() for match in _SKIPPED.finditer(text)]
    at = 0
    for match in _DER.finditer(text):
        while at < len(skipped) and skipped[at][1] <= match.start():
            at += 1
        if at < len(skipped) and skipped[at][0] <= match.start():
            continue
        if not _PLAIN.match(text, match.end()):
            made[match.start() : match.start() + 3] = DER.encode()
    return bytes(made)


def _without_inner_bases(text: bytes) -> bytes:
    """The text with each base class that its heir contains behind the heir."""
    if not _BASE.search(text):
        return text
    bare = _SKIPPED.sub(lambda skipped: b" " * len(skipped[0]), text)
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
