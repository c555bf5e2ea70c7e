"""Functions of the user that are called as an operator of Modelica is: the compiler takes the operator, so
that such a model would be refused for it, or compute something else."""

from __future__ import annotations

from pathlib import Path

from daest.errors import ModelError
from daest.modelica.language.operators import BUILTINS, REFUSED
from daest.modelica.language.outline import ClassHead, class_heads, place_of, tokens

_OPERATORS = {*BUILTINS, *REFUSED, "cardinality"} - {"sum", "product"}  # the compiler takes the user's


def check_operator_names(text: bytes, path: Path) -> None:
    """Raise ModelError for the first function that has the name of an operator and is called by it. What is
    called by a longer name, `P.abs(x)`, is taken for the function, but not for operators of events and
    clocks."""
    for head in class_heads(text):
        word = head.name.rpartition(".")[2]
        if head.kind == "function" and word in _OPERATORS and _is_called(text, head, word):
            raise ModelError(
                "model-function",
                f"the function `{word}` has the name of an operator of Modelica, which is taken for it",
                where=place_of(str(path), text, head.start),
                remedy=f"Rename the function, where it is declared and where it is called: `{word}_`.",
            )


def _is_called(text: bytes, head: ClassHead, word: str) -> bool:
    words = list(tokens(text))
    scope = head.name.rpartition(".")[0]
    around = next((one for one in class_heads(text) if one.name == scope), None)
    for before, name, behind in zip(words, words[1:], words[2:], strict=False):
        if name.text != word or behind.text != "(":
            continue
        is_within = around is None or around.start < name.start < around.end
        if (word in REFUSED) if before.text == "." else is_within:
            return True
    return False
