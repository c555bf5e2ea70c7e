"""Values beside attributes inside of modifications: `extends Base(k(max = 5) = 4)`.

Where both stand together, the compiler takes neither, without a word: in extends clauses, short classes,
redeclarations and modifications of modifications; not where a component is declared. It takes both where k is
named twice, `k(max = 5), k = 4`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from daest.modelica.outline import CLOSE, OPEN, Edit, Token, edited, tokens

_SUSPECT = re.compile(rb"[(,]\s*(?:(?:each|final)\s+)*[A-Za-z_][\w.]*\s*\([^;]*?\)\s*=[^=]")
_SHORT = ("extends", "=")  # in front of the bracket: that of a base class, or of a short class


def with_values_apart(text: bytes) -> bytes:
    """The text in which what is modified by both is named twice. Where code stands behind the statement in
    its line, whose columns are known to others, the value stays alone. Lines keep their numbers."""
    if not _SUSPECT.search(text):
        return text
    edits = list(_edits(text, list(tokens(text))))
    blanked = [edit for edit in edits if edit.end > edit.start]
    return edited(text, (e for e in edits if not any(b.start < e.start < b.end for b in blanked)))


def _edits(text: bytes, words: Sequence[Token]) -> Iterator[Edit]:
    begun = 0  # where the statement begins
    brackets: list[tuple[int, int]] = []  # of the open ones, where each opens and where its argument begins
    for i, word in enumerate(words):
        if word.text in OPEN:
            brackets.append((i, i + 1))
        elif word.text in CLOSE and brackets:
            opened, _ = brackets.pop()
            is_valued = i + 1 < len(words) and words[i + 1].text == "="
            if not is_valued or not brackets:
                continue
            (first, _), name = brackets[0], words[brackets[-1][1] : opened]
            is_nested = len(brackets) > 1 or any(one.text in _SHORT for one in words[begun:first])
            if is_nested and _is_modified(name):
                yield _apart(text, words, i, name, words[opened].start)
        elif word.text == "," and brackets:
            brackets[-1] = (brackets[-1][0], i + 1)
        elif word.text == ";" and not brackets:
            begun = i + 1


def _is_modified(words: Sequence[Token]) -> bool:
    """Whether the words are the name of an element, `each` or `final` in front of it allowed."""
    return bool(words) and all(one.kind == "name" or one.text in (".", "each", "final") for one in words)


def _apart(text: bytes, words: Sequence[Token], closed: int, name: Sequence[Token], opened: int) -> Edit:
    behind = words[closed].end
    line_end = (text.find(b"\n", behind) + 1 or len(text) + 1) - 1
    semicolon = next((one.end for one in words[closed:] if one.text == ";"), line_end)
    rest = text[semicolon:line_end].strip()
    if rest and not rest.startswith(b"//"):
        return Edit(opened, behind, " " * (behind - opened))
    again = text[name[0].start : name[-1].end].decode()
    return Edit(behind, behind, f", {again}")
