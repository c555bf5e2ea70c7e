"""Modifications in the forms that the compiler takes.

Of legal modifications the compiler loses these without a word:

- dotted names, `motor(inertia.J = 2)`: written `motor(inertia(J = 2))`;
- values beside attributes, `k(max = 5) = 4`, in extends clauses, short classes, redeclarations and
  modifications of modifications, though not where a component is declared: written `k(max = 5), k = 4`;
- the same of a part's element in an extends clause, `extends Base(part(k(max = 5) = 4))`, where it takes only
  one of two that name the same element: both are packed into one value;
- what the base class says of that element already, `Part part(k = 3)`, of which it keeps nothing where
  `extends Base(part(k(max = 5)))` says something else: it is said again in the extends clause;
- another value of a whole record, `motor(data = Data(R = 6))`, where the record is declared with a
  modification, `parameter Data data(R = 5)`: this is written with a constructor, `Data data = Data(R = 5)`.

It breaks off where a loop reads an array of records that is declared as a parameter and given values,
`parameter Data data[2](each R = 5)`: the prefix goes where the fields of the record are parameters anyway.

What is written otherwise stands in marked comments, which places do not count, and what it stands for is
blank: everything else keeps its line and column.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from daest.modelica.forms.modification_trees import Change, Style, change, changes, merged, over, written
from daest.modelica.language.components import MOST_BASES, Classes, ClassText, Declared, declared, statements
from daest.modelica.language.outline import (
    KINDS,
    OPEN,
    ClassHead,
    Edit,
    Token,
    arguments,
    class_heads,
    class_tokens,
    closing,
    edited,
    inserted,
    laid_over,
    name_end,
    tokens,
)

_NAMED = rb"[(,]\s*(?:(?:each|final)\s+)*[A-Za-z_]\w*"
_SUSPECT = re.compile(
    _NAMED + rb"\s*\([^;]*?\)\s*=[^=]"  # a value beside attributes
    rb"|" + _NAMED + rb"(?:\s*\.\s*[A-Za-z_]\w*)+\s*(?:=[^=]|\([\w.\s]*(?:=[^=]|\())"  # a dotted name
    rb"|\b(?:extends|(?:model|block|class|record)\s+\w+\s*=)\s*[\w.]+\s*\([^;]*\("  # of a part
    rb"|=\s*(?:\{[^;]*\bfor\b|linspace\b|[^;(){},=\"]*:[^;=])"  # an array
)
_NO_DECLARATION = (
    *("if", "elseif", "else", "then", "when", "elsewhen", "for", "while", "loop", "connect", "assert", "not"),
    *("equation", "algorithm", "and", "or", "end", "import", "annotation", "return", "initial", "in"),
)
_COMPONENT: tuple[Style, ...] = ("together", "apart")
_EXTENDS: tuple[Style, ...] = ("apart", "packed", "apart")


def with_taken_modifications(text: bytes, classes: Classes) -> bytes:
    """The text with its modifications as the compiler takes them; `classes` are those that it may extend.
    Lines keep their numbers, and what is not changed its column."""
    if not _SUSPECT.search(text):
        return text
    rewriter = _Rewriter(class_heads(text), classes)
    edits = [edit for one in modifications(list(tokens(text))) for edit in rewriter.edits(one, text)]
    return edited(text, edits) if edits else text


@dataclass(frozen=True)
class Modification:
    """A modification `(…)` that stands in no other one, and the words of its statement in front of it."""

    head: Sequence[Token]
    words: Sequence[Token]  # with both brackets

    @property
    def base(self) -> str:
        """The class that is extended, by an extends clause or a short class; empty for any other."""
        at = next((i + 1 for i, word in enumerate(self.head) if word.text == "extends"), None)
        short = _short(self.head)
        if at is None and short is None:
            return ""
        at = at or (short or 0) + 3
        return "".join(word.text for word in self.head[at : name_end(self.head, at)])


def class_around(heads: Sequence[ClassHead], at: int) -> str:
    """The full name of the class whose text byte `at` stands in; empty outside of all."""
    around = [head.name for head in heads if head.start < at < head.end and not head.is_short]
    return around[-1] if around else ""


def _short(head: Sequence[Token]) -> int | None:
    """Where among the words a short class begins, `model M = N`."""
    starts = range(len(head) - 2)
    return next((i for i in starts if head[i].text in KINDS and head[i + 2].text == "="), None)


def modifications(words: Sequence[Token]) -> Iterator[Modification]:
    """The outermost modifications of a text."""
    begun, at = 0, 0
    while at < len(words):
        if words[at].text not in OPEN:
            begun = at + 1 if words[at].text in (";", ",") else begun
            at += 1
            continue
        end = closing(words, at)
        is_listed = begun > 0 and words[begun - 1].text == ","
        if words[at].text == "(" and _is_modified(words[begun:at], is_listed):
            yield Modification(words[begun:at], words[at:end])
        at = end


def _is_modified(head: Sequence[Token], is_listed: bool) -> bool:
    """Whether a bracket behind these words of a statement holds modifications: it is that of a component, of
    an extends clause, of a constraining class or of a short class."""
    names = [word.text for word in head]
    if not head or not (head[-1].kind == "name" or names[-1] == "]") or set(names) & set(_NO_DECLARATION):
        return False
    if "extends" in names or "constrainedby" in names or _short(head) is not None:
        return True
    is_declared = is_listed or (name_end(head, 0) < len(head) and head[name_end(head, 0)].kind == "name")
    return is_declared and not {"=", ":="} & set(names)


@dataclass(frozen=True)
class _Rewriter:
    heads: Sequence[ClassHead]
    classes: Classes

    def edits(self, one: Modification, text: bytes) -> Iterator[Edit]:
        """What is written otherwise in a modification that stands in no other one."""
        styles, base = (_EXTENDS, self._base(one)) if one.base else (_COMPONENT, None)
        every = arguments(one.words, 0)
        done: set[str] = set()
        for i, words in enumerate(every):
            name = change(words).name
            same = [other for other in every if name and change(other).name == name]
            if name in done:  # it stands with the first one
                comma = every[i - 1][-1].end
                yield overwritten(text, comma, words[-1].end, "")
                continue
            done |= {name} if len(same) > 1 else set()
            made = merged(map(change, same or [words]))[0]
            again = ", ".join(self._written(made, styles, base))
            if len(same) > 1 or [w.text for w in tokens(again.encode())] != [w.text for w in words]:
                yield overwritten(text, words[0].start, words[-1].end, again)

    def _written(self, one: Change, styles: Sequence[Style], base: ClassText | None) -> Iterator[str]:
        """The change of an element of the class `base`, or of any other."""
        if base is None or not one.name or not one.inner:
            yield written(one, styles)
            return
        said = self._said(one.name, base)
        inner = tuple(_completed(part, said) for part in one.inner)
        real = {part.name for part in inner if part.both and self._is_real(base, one.name, part.name)}
        yield written(replace(one, inner=inner), styles, real)

    def _base(self, one: Modification) -> ClassText | None:
        """The class that is extended."""
        return self._class(one.base, class_around(self.heads, one.words[0].start))

    def _class(self, name: str, scope: str) -> ClassText | None:
        """The class that `name` means where class `scope` extends it."""
        full = self.classes.base(name, scope)
        return None if full is None or full == scope else self.classes.get(full)

    def _said(self, name: str, around: ClassText, steps: int = 0) -> tuple[Change, ...]:
        """What a class and those that it extends say of the elements of their component `name`."""
        if name in around.components:
            return tuple(
                self._placed(one, around.name) for one in changes(around.components[name].modification)
            )
        found: tuple[Change, ...] = ()
        for base, words in bases_of(around):
            below = self._class(base, around.name)
            if below is not None and steps < MOST_BASES:
                own = next((one.inner for one in changes(words) if one.name == name), ())
                found = merged((*found, *self._said(name, below, steps + 1), *own))
        return found

    def _placed(self, one: Change, scope: str) -> Change:
        """A change that stands in class `scope`, with full names of what is declared around that."""
        inner = tuple(self._placed(part, scope) for part in one.inner)
        words = list(tokens(one.value.encode())) if one.name else []
        value = " ".join(self._full(words, i, scope) for i in range(len(words))) if words else one.value
        return replace(one, inner=inner, value=value)

    def _full(self, words: Sequence[Token], at: int, scope: str) -> str:
        """The word, by its full name where it is that of a class or of a constant of a package."""
        word = words[at].text
        is_first = words[at].kind == "name" and (at == 0 or words[at - 1].text != ".")
        is_argument = at + 1 < len(words) and words[at + 1].text == "="
        if not is_first or is_argument or self.classes.component(word, scope) is not None:
            return word
        if (found := self.classes.resolved(word, scope)) is not None:
            return found
        parts = scope.split(".")
        around = (".".join(parts[:end]) for end in range(len(parts) - 1, 0, -1))
        package = next((one for one in around if self.classes.component(word, one) is not None), None)
        return word if package is None else f"{package}.{word}"

    def _is_real(self, around: ClassText, part: str, name: str) -> bool:
        """Whether the element of a component is a Real number, or an array of such."""
        component = self.classes.component(part, around.name)
        inside = None if component is None else self.classes.type_of(component)
        element = None if inside is None else self.classes.component(name, inside)
        return element is not None and self.classes.type_of(element) == "Real"


def _completed(one: Change, said: Sequence[Change]) -> Change:
    """The change of an element with what is `said` of it already, unless both are but values."""
    below = next((other for other in said if other.name == one.name and one.name), None)
    return one if below is None or not (below.inner or one.inner) else over(below, one)


def bases_of(around: ClassText) -> Iterator[tuple[str, Sequence[Token]]]:
    """The classes that a class extends, with the words of the modification."""
    words = around.words
    starts = [2] if around.alias else [i + 1 for i, word in enumerate(words) if word.text == "extends"]
    for at in starts:
        while at < len(words) and words[at].text in ("each", "final", "replaceable", "input", "output"):
            at += 1
        end = name_end(words, at)
        is_modified = end < len(words) and words[end].text == "("
        yield "".join(w.text for w in words[at:end]), words[end : closing(words, end)] if is_modified else ()


def overwritten(text: bytes, start: int, end: int, again: str) -> Edit:
    """Bytes that become blank, with something else in front of them."""
    blank = laid_over(text[start:end]).decode()
    return Edit(start, end, (inserted(again) if again else "") + blank)


def with_record_values(text: bytes, classes: Classes) -> bytes:
    """The text with constructors in place of modifications where the records that are declared are given
    values from outside."""
    if b"record" not in text:
        return text
    words = list(tokens(text))
    given = _given(words)
    edits = [
        edit
        for head in class_heads(text)
        if not head.is_short and (around := classes.get(head.name)) is not None
        for one in around.components.values()
        if one.name.text in given or head.kind == "record"
        for edit in _rewritten(one, classes, text)
    ]
    return edited(text, edits)


def with_record_arrays(text: bytes, classes: Classes) -> bytes:
    """The text without `parameter` before arrays of records that are given values and whose fields are
    parameters all the same. Lines keep their numbers, and all else its column."""
    if b"record" not in text or b"for" not in text:
        return text
    edits = [
        overwritten(text, prefix.start, prefix.end, "")
        for head in class_heads(text)
        if not head.is_short
        for line in statements(class_tokens(text, head))
        for prefix in line[:2]  # `final parameter`
        if prefix.text == "parameter" and _are_record_arrays(declared(line, head.name), classes)
    ]
    return edited(text, edits) if edits else text


def _are_record_arrays(found: Iterable[Declared], classes: Classes) -> bool:
    """Whether all that a statement declares are such arrays."""
    of = [(classes.type_of(one), one) for one in found]
    records = [None if full is None else classes.get(full) for full, _ in of]
    return bool(of) and all(
        one.sizes
        and (one.modification or one.binding)
        and record is not None
        and record.kind == "record"
        and all(field.is_parameter for field in _fields(record, classes).values())
        for record, (_, one) in zip(records, of, strict=True)
    )


def _given(words: Sequence[Token]) -> frozenset[str]:
    """The names that modifications, or arguments, give a value to."""
    places = range(1, len(words) - 1)
    return frozenset(
        words[i].text for i in places if words[i - 1].text in ("(", ",") and words[i + 1].text == "="
    )


def _rewritten(one: Declared, classes: Classes, text: bytes) -> Iterator[Edit]:
    """A record's declaration with a constructor."""
    if not one.modification or one.binding or one.sizes:
        return
    full = classes.type_of(one)
    made = None if full is None else _constructor(one.type_name, full, changes(one.modification), classes)
    if made is not None:
        first, last = one.modification[0], one.modification[-1]
        yield overwritten(text, first.start, last.end, f" = {made}")


def _constructor(name: str, full: str, modified: Sequence[Change], classes: Classes) -> str | None:
    """The call of the constructor of a record; None where it does not say the same as the changes."""
    record = classes.get(full)
    if record is None or record.kind != "record" or not modified:
        return None
    values: dict[str, str] = {}
    for one in modified:
        field = classes.component(one.name, full) if one.name else None
        if field is None or one.prefixes or one.inner or (field.sizes and not one.value):
            return None
        values[one.name] = one.value
    if any(not field.binding and name not in values for name, field in _fields(record, classes).items()):
        return None
    return f"{name}({', '.join(f'{name} = {value}' for name, value in values.items())})"


def _fields(record: ClassText, classes: Classes, steps: int = 0) -> dict[str, Declared]:
    """The fields of a record, those of its base classes included."""
    found = dict(record.components)
    for base in record.bases if steps < MOST_BASES else ():
        full = classes.base(base, record.name)
        below = None if full is None else classes.get(full)
        found |= {} if below is None else _fields(below, classes, steps + 1)
    return found
