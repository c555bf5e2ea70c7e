"""Values of arrays in the forms that the compiler takes.

It gives the elements of an array of components those of a constructor `{2*i for i in 1:n}` by their numbers
in the range: with `for i in 2:2:6` the second one gets what belongs to 3, over `{2, 4, 6}` what belongs to 2.
It takes neither `1:n` nor `linspace(a, b, n)` there. And an array that is made over several ranges,
`{i + 10*j for i in 1:2, j in 1:3}`, becomes a vector, where the language has the matrix
`{{i + 10*j for i in 1:2} for j in 1:3}` (Language Specification 10.4.1.2).
"""

from __future__ import annotations

from collections.abc import Sequence

from daest.modelica.language.outline import (
    Edit,
    Token,
    arguments,
    closing,
    depths,
    edited,
    find_outside,
    inserted,
    tokens,
)

_ITERATOR = "D__i"  # of ranges that are written as constructors


def taken_value(words: Sequence[Token]) -> str:
    """The value of a modification as text."""
    texts = [word.text.replace("\n", "\\n") for word in words]
    if texts[:2] == ["linspace", "("] and closing(words, 1) == len(words):
        given = [_joined(one) for one in arguments(words, 1)]
        return _linspace(*given) if len(given) == 3 else " ".join(texts)
    if len(_between(words, ":")) in (2, 3):
        return _over_range([_ITERATOR], _ITERATOR, _between(words, ":"))
    if texts[:1] == ["{"] and closing(words, 0) == len(words):
        return _constructor(words[1:-1]) or " ".join(texts)
    return " ".join(texts)


def _constructor(words: Sequence[Token]) -> str:
    """`{element for i in range}` without its brackets; empty where it may stay as it is."""
    at = find_outside(words, 0, "for")
    if at + 3 >= len(words) or words[at + 2].text != "in" or find_outside(words, at, ",") < len(words):
        return ""
    element, name, over = [word.text for word in words[:at]], words[at + 1].text, words[at + 3 :]
    if over[0].text == "{" and closing(over, 0) == len(over):
        every = [_joined(one) for one in arguments(over, 0)]
        return "{" + ", ".join(_put(element, name, one) for one in every) + "}"
    parts = _between(over, ":")
    return _over_range(element, name, parts) if len(parts) == 3 else ""


def _over_range(element: Sequence[str], name: str, parts: Sequence[str]) -> str:
    """The constructor over `first:last`, or `first:step:last` with an iterator that counts from 1 on."""
    if len(parts) == 2:
        return f"{{{' '.join(element)} for {name} in {parts[0]}:{parts[1]}}}"
    first, step, last = parts
    number = f"{first} + ({step})*({_ITERATOR} - 1)"
    return f"{{{_put(element, name, number)} for {_ITERATOR} in 1:div({last} - ({first}), {step}) + 1}}"


def _linspace(first: str, last: str, size: str) -> str:
    element = f"({first}) + ({last} - ({first}))*({_ITERATOR} - 1)/({size} - 1)"
    return f"{{{element} for {_ITERATOR} in 1:{size}}}"


def _put(element: Sequence[str], name: str, value: str) -> str:
    """The words of an expression with a value in place of a name."""
    return " ".join(
        f"({value})" if word == name and (i == 0 or element[i - 1] != ".") else word
        for i, word in enumerate(element)
    )


def _between(words: Sequence[Token], mark: str) -> list[str]:
    """The parts of an expression between the marks outside of brackets."""
    marks = [i for i, depth in depths(words) if depth == 0 and words[i].text == mark]
    ends = [*marks, len(words)]
    starts = [0, *(i + 1 for i in marks)]
    return [_joined(words[start:end]) for start, end in zip(starts, ends, strict=True)]


def _joined(words: Sequence[Token]) -> str:
    return " ".join(word.text for word in words)


def with_nested_constructors(text: bytes) -> bytes:
    """The text with one constructor of an array inside of another where one runs over several ranges."""
    words = list(tokens(text))
    edits: list[Edit] = []
    for i, word in enumerate(words):
        if word.text != "{":
            continue
        inside = words[i + 1 : closing(words, i) - 1]
        at = find_outside(inside, 0, "for")
        commas = [j for j, depth in depths(inside) if depth == 0 and j > at and inside[j].text == ","]
        if at < len(inside) and commas:
            edits.append(Edit(word.end, word.end, inserted("{" * len(commas))))
            edits += [Edit(inside[j].start, inside[j].end, inserted("} for") + " ") for j in commas]
    return edited(text, edits)
