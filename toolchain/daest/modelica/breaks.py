"""`extends Base(break connect(a, b))`: the compiler reads it and keeps the connection all the same.

So the clause is blanked in the text of the base class before it is compiled; offsets stay as they are.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from daest.errors import ModelError
from daest.modelica.class_text import class_tokens, connect_clauses, extends_clauses, find_base
from daest.modelica.outline import ClassHead, class_heads
from daest.modelica.tokens import Token, place_of, tokens

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
        text[begin:end] = bytes(byte if byte in b"\r\n" else 32 for byte in text[begin:end])
    return bytes(text)


def _collect(
    source: bytes, path: Path, heads: Sequence[ClassHead], head: ClassHead, spans: list[tuple[int, int]]
) -> None:
    """Add the spans of the clauses that `head` and its bases remove."""
    for clause in extends_clauses(class_tokens(source, head)):
        base = find_base(heads, head, clause.base)
        where = place_of(str(path), source, clause.start)
        if base is None or base.name == head.name:
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
        base = find_base(heads, head, clause.base)
        if base is not None and base.name != head.name:
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
