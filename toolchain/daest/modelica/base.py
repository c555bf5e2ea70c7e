"""Base Modelica, as OpenModelica writes it: a flat model whose names stand in quotes, `'motor.flange_a.phi'`.

The compiler takes quoted names for operators, and nobody wants to type them. It is given a text with plain
names of the same length; what it answers gets the names without quotes. Base Modelica knows no `protected`,
which Modelica demands of the variables of a function.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from daest.modelica.tokens import Token, tokens

HEADING = b"//! base"
"""The comment that a Base Modelica text begins with."""

_ENDING = ("algorithm", "external", "equation", "end", "annotation", "protected", "public")
_DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"
_PLAIN = re.compile(r"\b_[0-9a-z]+\b")


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
            return _PLAIN.sub(lambda found: self.shown.get(found[0], found[0]), value)
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
            name = "_" + _base36(counts[length]).zfill(length - 1)
            counts[length] += 1
            if name not in taken:
                return name

    return free


def _base36(number: int) -> str:
    digits = ""
    while number:
        number, digit = divmod(number, 36)
        digits = _DIGITS[digit] + digits
    return digits
