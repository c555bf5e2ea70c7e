"""Redeclarations in the forms that the compiler takes.

- `redeclare Dry friction(c = 2);` among the declarations of a class: written in its extends clause, since the
  compiler takes no other variable of the base class then that is bound to one of the component.
- Replaceable classes that a component leaves as they are. Where one component redeclares its package, the
  compiler gives that one to the other components of the class, too; and a class that is redeclared in an
  extends clause it gives to the components inside of the heir. So they redeclare the default, by another
  name: the same name changes nothing for the compiler.
- Redeclarations inside of the modification of a part, `Car car(motor(redeclare model Friction = Dry))`, which
  the compiler passes over without a word. It takes the redeclaration of a component by a class that says the
  same, `Car car(redeclare Part__0 motor)`, where `motor` is replaceable; so that is what it is given, with
  `model Part__0 extends Motor(redeclare model Friction = Dry)` behind the end of the text.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from daest.errors import ModelError
from daest.modelica.forms.constraining import names_variable, values_of
from daest.modelica.forms.modification_trees import Change, change, changes, written
from daest.modelica.forms.modifications import check_class_modification, names_of, redeclared_name
from daest.modelica.forms.nested_modifications import (
    Modification,
    bases_of,
    class_around,
    modifications,
    overwritten,
)
from daest.modelica.language.components import MOST_BASES, Classes, ClassText, Declared, statements
from daest.modelica.language.outline import (
    KINDS,
    Edit,
    Token,
    arguments,
    class_heads,
    depths,
    edited,
    inserted,
    laid_over,
    name_end,
    place_of,
    tokens,
)

_NAME = "Part__{}"
_PREFIXES = r"(?:(?:each|final|replaceable|parameter|constant|input|output|inner|outer) )*"
_KIND = rf"(?:{'|'.join(KINDS)})"
_CLASS = re.compile(rf"(redeclare {_PREFIXES}{_KIND} \w+ = )(\w+(?: \. \w+)*)()$")
_COMPONENT = re.compile(rf"(redeclare {_PREFIXES})(?!{_KIND} )(\w+(?: \. \w+)*)( \w+.*)$")
_IN_FRONT = ("final", "inner", "outer")  # of `replaceable`
_PACKAGE = re.compile(rb"\bredeclare\s+(?:(?:final|each|replaceable)\s+)*package\s+([A-Za-z_]\w*)\s*=")
_ALIAS = "Default__{}"


def with_redeclared_components(text: bytes, classes: Classes) -> bytes:
    """The text with the redeclared components of its classes in their extends clauses. Lines keep their
    numbers, and all else its column."""
    if b"redeclare" not in text:
        return text
    found = (classes.get(head.name) for head in class_heads(text) if not head.is_short)
    return edited(text, [edit for one in found if one is not None for edit in _moved(one, classes, text)])


def _moved(around: ClassText, classes: Classes, text: bytes) -> Iterator[Edit]:
    moved: dict[int, list[str]] = {}
    words = around.words
    for line in statements(words):
        if not line or line[0].text != "redeclare" or set(_texts(line[1:4])) & set(KINDS):
            continue
        end = next(
            (i for i, word in enumerate(line) if word.kind == "text" or word.text == "annotation"), len(line)
        )
        at = _base(line[:end], around, classes)
        if at is not None:
            moved.setdefault(at, []).append(" ".join(_texts(line[:end])))
            start, behind = line[0].start, words[words.index(line[-1]) + 1].end
            yield Edit(start, behind, laid_over(text[start:behind]).decode())
    for at, said in moved.items():
        name = name_end(words, at + 1)
        if words[name].text == "(":
            yield Edit(words[name].end, words[name].end, inserted(", ".join(said) + ", "))
        else:
            yield Edit(words[name - 1].end, words[name - 1].end, inserted(f"({', '.join(said)})"))


def _texts(words: Sequence[Token]) -> list[str]:
    return [word.text for word in words]


def _base(line: Sequence[Token], around: ClassText, classes: Classes) -> int | None:
    """Where among the words of a class the extends clause stands whose base has the component that a line
    redeclares."""
    outside = line[: next((i for i, word in enumerate(line) if word.text in ("(", "[", "=")), len(line))]
    for i, word in enumerate(around.words):
        if word.text == "extends":
            base = "".join(_texts(around.words[i + 1 : name_end(around.words, i + 1)]))
            scope = around.name.rpartition(".")[0]
            full = classes.resolved(base, scope) or classes.resolved(base, around.name)
            if full is not None and classes.component(outside[-1].text, full) is not None:
                return i
    return None


def with_default_packages(text: bytes, classes: Classes) -> bytes:
    """The text with a redeclaration of each default that something else redeclares. Lines keep their numbers,
    and all else its column."""
    if b"redeclare" not in text:
        return text
    found = [classes.get(head.name) for head in class_heads(text)]
    every = [one for one in found if one is not None]
    wanted = {f"package {name.decode()}" for name in _PACKAGE.findall(text)}
    wanted |= {name for one in every for name in _redeclared_by(one)}
    aliases: dict[str, str] = {}  # kinds and full names -> what is redeclared
    components = [one for around in every for one in around.components.values() if wanted]
    edits = [edit for one in components for edit in _with_defaults(one, wanted, classes, aliases)]
    appended = " ".join(f"{kind.split()[0]} {alias} = {kind.split()[1]};" for kind, alias in aliases.items())
    return edited(text, edits) + (f"\n{appended}\n".encode() if appended else b"")


def _redeclared_by(around: ClassText) -> set[str]:
    """Kinds and names of the classes that a class redeclares of those that it inherits."""
    every = [one for _, words in bases_of(around) if words for one in arguments(words, 0)]
    every += [] if around.alias else statements(around.words)
    return {_redeclared_class(one) for one in every if one and one[0].text == "redeclare"} - {""}


def _with_defaults(
    one: Declared, wanted: set[str], classes: Classes, aliases: dict[str, str]
) -> Iterator[Edit]:
    """What is added to the modification of a component."""
    full = classes.resolved(one.type_name, one.scope)
    around = None if full is None else classes.get(full)
    defaults = {} if around is None else _defaults(around, classes)
    own = set(map(_redeclared_class, arguments(one.modification, 0))) if one.modification else set()
    missing = [
        f"redeclare {name} = {aliases.setdefault(f'{name.split()[0]} {of}', _ALIAS.format(len(aliases)))}"
        for name, of in defaults.items()
        if of and name in wanted - own
    ]
    if missing and one.modification:
        comma = ", " if len(one.modification) > 2 else ""
        at = one.modification[0].end
        yield Edit(at, at, inserted(", ".join(missing) + comma))
    elif missing:
        yield Edit(one.behind, one.behind, inserted(f"({', '.join(missing)})"))


def _redeclared_class(words: Sequence[Token]) -> str:
    """Kind and name of the class that an argument of a modification redeclares; empty for any other."""
    at = next((i for i, word in enumerate(words) if word.text in KINDS), len(words))
    return f"{words[at].text} {words[at + 1].text}" if at + 1 < len(words) else ""


def _defaults(around: ClassText, classes: Classes, steps: int = 0) -> dict[str, str]:
    """The replaceable classes of a class, with their kinds, and the full names of what they are; empty where
    that is modified."""
    found: dict[str, str] = {}
    for base, words in bases_of(around) if steps < MOST_BASES else ():
        full = classes.base(base, around.name)
        below = None if full is None or full == around.name else classes.get(full)
        found |= {} if below is None else _defaults(below, classes, steps + 1)
        for one in arguments(words, 0) if words else ():
            found |= _named_class(one, "redeclare", around, classes)
    for line in statements(around.words):
        found |= _named_class(line, "replaceable", around, classes) | _named_class(
            line, "redeclare", around, classes
        )
    return found


def _named_class(words: Sequence[Token], first: str, around: ClassText, classes: Classes) -> dict[str, str]:
    """What `redeclare model F = A` or the like says: the kind and the name, and the full name."""
    at = next((i for i, word in enumerate(words) if word.text in KINDS), len(words))
    if not words or words[0].text != first or at + 3 >= len(words) or words[at + 2].text != "=":
        return {}
    end = name_end(words, at + 3)
    full = classes.resolved("".join(word.text for word in words[at + 3 : end]), around.name)
    is_modified = end < len(words) and words[end].text == "("
    return {f"{words[at].text} {words[at + 1].text}": "" if full is None or is_modified else full}


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
