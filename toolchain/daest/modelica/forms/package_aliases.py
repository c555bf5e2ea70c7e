"""Other names of packages, `package R = Modelica.Mechanics.Rotational;` among the declarations of a class, as
import clauses: the compiler does not look through such a name for the type of a component."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence

from daest.modelica.language.outline import Edit, Token, class_heads, edited, laid_over, name_end, tokens

_ALIAS = re.compile(rb"\bpackage\s+[A-Za-z_]\w*\s*=")
_BOUND = ("replaceable", "redeclare", "partial", "encapsulated", "final", "each", "inner", "outer")


def with_imported_packages(text: bytes) -> bytes:
    """The text with an import clause for each alias of a package that a class other than a package declares,
    that nothing may put another one in the place of, and that is not modified. All else keeps its place."""
    if not _ALIAS.search(text):
        return text
    heads = class_heads(text)
    packages = {head.name for head in heads if head.kind == "package" and not head.is_short}
    aliases = [head for head in heads if head.kind == "package" and head.is_short and head.depth]
    inside = {head.start for head in aliases if head.name.rpartition(".")[0] not in packages}
    # An import clause finds classes by their full names alone.
    nested = {head.name.rpartition(".")[2] for head in heads if head.depth}
    return edited(text, _imports(text, list(tokens(text)), inside, nested))


def _imports(
    text: bytes, words: Sequence[Token], inside: Collection[int], nested: Collection[str]
) -> Iterator[Edit]:
    """The words `package` that become `import`: of the aliases that begin at `inside`, but of packages that
    are themselves `nested` in this text."""
    for i, word in enumerate(words[:-3]):
        if word.text != "package" or words[i + 1].start not in inside or (i and words[i - 1].text in _BOUND):
            continue
        end = name_end(words, i + 3)
        if end < len(words) and words[end].text not in ("(", "[") and words[i + 3].text not in nested:
            yield Edit(word.start, word.end, laid_over(text[word.start : word.end], b"import").decode())
