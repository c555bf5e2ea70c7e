"""Where in the source a connection equation comes from: its connect clause."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from daest.errors import Place
from daest.modelica.tokens import place_of

_CLAUSE = re.compile(rb"\bconnect\s*\(\s*([^,;()]+?)\s*,\s*([^,;()]+?)\s*\)")
_SUBSCRIPT = re.compile(r"\[[^\]]*\]|\s+")


class ConnectClauses:
    """The connect clauses of some files, found by the connectors that they name."""

    def __init__(self, texts: Iterable[tuple[str, bytes]]) -> None:
        self._found: dict[frozenset[str], tuple[str, bytes, int]] = {}
        for file, text in texts:
            for match in _CLAUSE.finditer(text):
                pair = frozenset(_plain(group.decode()) for group in match.groups())
                self._found.setdefault(pair, (file, text, match.start()))

    def place(self, connectors: tuple[str, ...]) -> Place | None:
        """The clause that connects two of `connectors` (names seen from the model), None if there is none.

        A connection between components of a component is written with shorter names there."""
        names = [_plain(name).split(".") for name in connectors]
        for i, left in enumerate(names):
            for right in names[i + 1 :]:
                found = self._clause(left, right)
                if found is not None:
                    return place_of(*found)
        return None

    def _clause(self, left: list[str], right: list[str]) -> tuple[str, bytes, int] | None:
        shared = 0
        while True:
            pair = frozenset((".".join(left[shared:]), ".".join(right[shared:])))
            if pair in self._found:
                return self._found[pair]
            if shared + 1 >= min(len(left), len(right)) or left[shared] != right[shared]:
                return None
            shared += 1


def _plain(name: str) -> str:
    return _SUBSCRIPT.sub("", name)


def used_texts(texts: Mapping[int, tuple[str, bytes]], sources: Iterable[int]) -> list[tuple[str, bytes]]:
    """The files that declare something of the model, once each."""
    return [texts[number] for number in dict.fromkeys(sources) if number in texts]
