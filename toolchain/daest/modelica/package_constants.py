"""Integer constants of packages, `Real x[Sizes.n]`, by their numbers: the compiler knows no such size."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from daest.modelica.components import Classes, declared, statements
from daest.modelica.nested_modifications import class_around, overwritten
from daest.modelica.outline import ClassHead, Edit, Token, class_heads, class_tokens, edited, name_end, tokens


def with_integer_constants(text: bytes, classes: Classes) -> bytes:
    """The text with the numbers of the Integer constants that its packages declare where other classes name
    them. Lines keep their numbers, and all else its column."""
    if b"package" not in text or b"Integer" not in text:
        return text
    heads = class_heads(text)
    numbers = dict(_numbers(text, heads))
    return edited(text, _edits(text, heads, numbers, classes)) if numbers else text


def _numbers(text: bytes, heads: Sequence[ClassHead]) -> Iterator[tuple[str, str]]:
    """Full names of the constants, with what they are. Those of a replaceable package may be others."""
    for head in heads:
        before = text[: head.start].split()
        if head.kind != "package" or head.is_short or b"replaceable" in before[-3:]:
            continue
        for line in statements(class_tokens(text, head)):
            if any(word.text == "constant" for word in line):
                for one in declared(line, head.name):
                    if one.type_name == "Integer" and [word.kind for word in one.binding] == ["number"]:
                        yield f"{head.name}.{one.name.text}", one.binding[0].text


def _edits(
    text: bytes, heads: Sequence[ClassHead], numbers: dict[str, str], classes: Classes
) -> Iterator[Edit]:
    last = {name.rpartition(".")[2] for name in numbers}
    words = list(tokens(text))
    at = 0
    while at < len(words):
        end = max(name_end(words, at), at + 1)
        if words[at].kind == "name" and words[end - 1].text in last:
            scope = class_around(heads, words[at].start)
            full = _full_name(words[at:end], scope, classes)
            is_named = end == at + 1 and end < len(words) and words[end].text == "="  # `f(n = 3)`
            if full in numbers and not is_named and not _is_import(words, at):
                yield overwritten(text, words[at].start, words[end - 1].end, numbers[full])
        at = end


def _is_import(words: Sequence[Token], at: int) -> bool:
    """Whether the name stands in an import clause."""
    return words[at - 1].text == "import" or (words[at - 1].text == "=" and words[at - 3].text == "import")


def _full_name(words: Sequence[Token], scope: str, classes: Classes) -> str:
    """What a name in a class means as that of a constant in a package; empty where it is another one."""
    *package, last = [word.text for word in words if word.text != "."]
    if classes.component((package or [last])[0], scope) is not None:
        return ""
    if package:
        found = classes.resolved(".".join(package), scope)
        return "" if found is None else f"{found}.{last}"
    around = classes.get(scope)
    return "" if around is None else around.imports.get(last, "")
