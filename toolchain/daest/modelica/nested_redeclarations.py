"""Redeclarations inside of the modification of a part: `Car car(motor(redeclare model Friction = Dry))`.

The compiler passes over them, without a word. It takes the redeclaration of a component by a class that says
the same, `Car car(redeclare Part__0 motor)`, where `motor` is replaceable; so that is what it is given, with
`model Part__0 extends Motor(redeclare model Friction = Dry)` behind the end of the text.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from daest.errors import ModelError
from daest.modelica.components import Classes, ClassText, Declared, statements
from daest.modelica.constraining import names_variable, values_of
from daest.modelica.modification_trees import Change, change, changes, written
from daest.modelica.modifications import check_class_modification, names_of, redeclared_name
from daest.modelica.nested_modifications import Modification, class_around, modifications, overwritten
from daest.modelica.outline import (
    KINDS,
    Edit,
    arguments,
    class_heads,
    depths,
    edited,
    inserted,
    place_of,
    tokens,
)

_NAME = "Part__{}"
_PREFIXES = r"(?:(?:each|final|replaceable|parameter|constant|input|output|inner|outer) )*"
_KIND = rf"(?:{'|'.join(KINDS)})"
_CLASS = re.compile(rf"(redeclare {_PREFIXES}{_KIND} \w+ = )(\w+(?: \. \w+)*)()$")
_COMPONENT = re.compile(rf"(redeclare {_PREFIXES})(?!{_KIND} )(\w+(?: \. \w+)*)( \w+.*)$")
_IN_FRONT = ("final", "inner", "outer")  # of `replaceable`


def with_redeclared_parts(text: bytes, path: Path, classes: Classes) -> bytes:
    """The text with redeclared components in place of what their modifications redeclare. Raises ModelError
    `model-unsupported` for parts of a class of another file and for arrays, and where variables stand."""
    if b"redeclare" not in text:
        return text
    heads = class_heads(text)
    by_name = {head.name: head for head in heads}
    parts = _Parts(text, path, classes)
    for one in modifications(list(tokens(text))):
        scope = class_around(heads, one.words[0].start)
        for words in arguments(one.words, 0):
            made = change(words)
            if made.name and _redeclares(made):
                parts.start, parts.scope = words[0].start, scope
                full = _class(one, scope, classes)
                if full in by_name:
                    check_class_modification(one.words, 0, by_name[full], heads, text, str(path))
                again = written(parts.redeclared(made, full), ("together", "apart"))
                parts.edits[words[0].start] = overwritten(text, words[0].start, words[-1].end, again)
    appended = f"\n{' '.join(parts.appended)}\n".encode() if parts.appended else b""
    return edited(text, parts.edits.values()) + appended


def _redeclares(one: Change) -> bool:
    """Whether something inside of a modification is a redeclaration."""
    return any(_is_redeclaration(part) or _redeclares(part) for part in one.inner)


def _is_redeclaration(one: Change) -> bool:
    return not one.name and one.prefixes[0].startswith("redeclare ")


def _class(one: Modification, scope: str, classes: Classes) -> str | None:
    """The full name of the class that is modified."""
    if one.base:
        return classes.base(one.base, scope)
    outside = [one.head[i] for i, depth in depths(one.head) if depth == 0]
    component = classes.component([word.text for word in outside if word.kind == "name"][-1], scope)
    return None if component is None else classes.type_of(component)


@dataclass
class _Parts:
    text: bytes
    path: Path
    classes: Classes
    start: int = 0  # of the modification that is at hand
    scope: str = ""  # the class that it stands in
    edits: dict[int, Edit] = field(default_factory=dict)
    appended: list[str] = field(default_factory=list)

    def redeclared(self, one: Change, around: str | None) -> Change:
        """The change of a component of class `around`, as a redeclaration of it."""
        component = None if around is None else self.classes.component(one.name, around)
        full = None if component is None else self.classes.type_of(component)
        made = None if full is None else self.classes.get(full)
        if component is None or made is None or component.sizes:
            raise self._beyond(one)
        self._check_names(one.inner, made)
        inner = [self.redeclared(x, full) if x.name and _redeclares(x) else x for x in one.inner]
        own = [self._full(part) for part in inner if _is_redeclaration(part)]
        if any(names_variable(value) for part in own for value in values_of(part.inner)):
            raise self._beyond(one)
        if any(self._is_lost(part, component, made) for part in own):
            raise self._beyond(one)
        name = _NAME.format(len(self.appended))
        said = ", ".join(written(part, ("apart",)) for part in own)
        self.appended.append(f"{made.kind} {name} extends {full}({said}); end {name};")
        self._make_replaceable(component)
        # Said of the component as well, it is not the default that the component may redeclare.
        again = tuple(part for part in own if _CLASS.match(part.prefixes[0]))
        rest = (*(part for part in inner if not _is_redeclaration(part)), *again)
        return replace(one, name="", prefixes=(f"redeclare {name} {one.name}",), inner=rest)

    def _check_names(self, inner: Sequence[Change], made: ClassText) -> None:
        """Raise ModelError for what is redeclared but not there."""
        heads = class_heads(self.text)
        head = next((head for head in heads if head.name == made.name), None)
        names = None if head is None else names_of(self.text, heads, head)
        for one in filter(_is_redeclaration, inner):
            name = redeclared_name(list(tokens(one.prefixes[0].encode())))
            if names is not None and name is not None and name.text not in names:
                raise ModelError(
                    "model-unknown-name",
                    f"`{made.name}` has no `{name.text}` that could be redeclared",
                    where=place_of(str(self.path), self.text, self.start),
                    remedy="Name something that it declares, or leave the redeclaration out.",
                )

    def _full(self, one: Change) -> Change:
        """A redeclaration with the full name of its class, which does not stand where it was written."""
        found = _CLASS.match(one.prefixes[0]) or _COMPONENT.match(one.prefixes[0])
        full = None if found is None else self.classes.resolved(found[2].replace(" ", ""), self.scope)
        is_made = found is not None and found[2].startswith(_NAME.format(""))
        if found is not None and full is None and "." not in found[2] and not is_made:
            raise ModelError(
                "model-unknown-class",
                f"class `{found[2]}` is not known",
                where=place_of(str(self.path), self.text, self.start),
                remedy="Check its spelling, or give its full name.",
            )
        return one if found is None or full is None else replace(one, prefixes=(found[1] + full + found[3],))

    def _is_lost(self, one: Change, component: Declared, made: ClassText) -> bool:
        """Whether the compiler would pass over a redeclaration all the same: of what the component redeclares
        where it is declared, and of packages whose functions are called."""
        words = one.prefixes[0].split()
        if "package" in words:
            name = words[words.index("package") + 1]
            texts = [word.text for word in made.words]
            return any(texts[i : i + 2] == [name, "."] and texts[i + 3] == "(" for i in range(len(texts) - 3))
        name = words[-3] if "=" in words else words[-1]
        there = (part.prefixes[0].split() for part in changes(component.modification) if not part.name)
        return any(name in said for said in there)

    def _make_replaceable(self, component: Declared) -> None:
        around = self.classes.get(component.scope)
        assert around is not None
        for line in statements(around.words):
            if any(word.start == component.name.start for word in line):
                first = next(word for word in line if word.text not in _IN_FRONT)
                if first.text != "replaceable":
                    self.edits[first.start] = Edit(first.start, first.start, inserted("replaceable "))

    def _beyond(self, one: Change) -> ModelError:
        return ModelError(
            "model-unsupported",
            f"the modification of `{one.name}` redeclares something inside of it, which is beyond the "
            "compiler that is built in",
            where=place_of(str(self.path), self.text, self.start),
            remedy=f"Write a class that extends the one of `{one.name}` with the redeclaration, with numbers "
            "as values, and make the component of that class.",
        )
