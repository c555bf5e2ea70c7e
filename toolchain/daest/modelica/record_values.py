"""Modified records that are given another value from outside.

Of `parameter Data data(R = 5)` the compiler keeps the 5 where the whole record gets another value,
`motor(data = Data(R = 6))`, and so it does with records inside of records. It takes the value where the
declaration is written with a constructor, `parameter Data data = Data(R = 5)`, which means the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from daest.modelica.components import MOST_BASES, Classes, ClassText, Declared
from daest.modelica.modification_trees import Change, changes
from daest.modelica.nested_modifications import overwritten
from daest.modelica.outline import Edit, Token, class_heads, edited, tokens


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
