"""Loops of equations written out, so that one of their equations can be opened.

`for i in 2:n loop C*der(T[i]) = q[i-1] - q[i]; end for;` becomes `C*der(T[2]) = q[1] - q[2];` and so on: the
same equations in the same order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from daest.modelica.outline import Edit, Token, edited

_LOOP, _END = "loop", "end"
_BLOCKS = ("for", "if", "when")


def without_loop(source: bytes, words: Sequence[Token], at: int, n_equations: int) -> bytes | None:
    """The text with a loop of a class written out, whose index is the token `at` and which stands for
    `n_equations`; None for one that is not of the form `for i in FIRST:LAST loop`, with a number as its
    first, around equations of one line each."""
    if at == 0 or words[at - 1].text != "for" or [w.text for w in words[at + 1 : at + 2]] != ["in"]:
        return None
    first, colon = words[at + 2], words[at + 3]
    body = next(i for i in range(at, len(words)) if words[i].text == _LOOP) + 1
    is_stepped = any(w.text == ":" for w in words[at + 4 : body])
    end = next(i for i in range(body, len(words)) if words[i].text == _END)
    inside = words[body:end]
    n_statements = sum(w.text == ";" for w in inside)
    is_nested = any(w.text in _BLOCKS for w in inside)
    if not first.text.isdecimal() or colon.text != ":" or is_stepped or is_nested:
        return None
    if n_equations % max(n_statements, 1):  # some of them are of arrays
        return None
    indent = _indent(source, words[at - 1].start)
    begin = int(first.text)
    lines = [
        line
        for number in range(begin, begin + n_equations // n_statements)
        for line in _statements(source, inside, words[at].text, number)
    ]
    semicolon = next(w for w in words[end:] if w.text == ";")
    return edited(source, [Edit(words[at - 1].start, semicolon.end, f"\n{indent}".join(lines))])


def _indent(source: bytes, at: int) -> str:
    before = source[source.rfind(b"\n", 0, at) + 1 : at].decode()
    return before if not before.strip() else ""


def _statements(source: bytes, inside: Sequence[Token], index: str, number: int) -> Iterator[str]:
    """The statements of a loop with a number for its index."""
    begin = 0
    for i, word in enumerate(inside):
        if word.text == ";":
            yield _with_number(source, inside[begin : i + 1], index, number)
            begin = i + 1


def _with_number(source: bytes, statement: Sequence[Token], index: str, number: int) -> str:
    start = statement[0].start
    edits = []
    for i, word in enumerate(statement):
        if word.text != index or word.kind != "name" or (i and statement[i - 1].text == "."):
            continue
        sign, value = (w.text for w in [*statement[i + 1 : i + 3], word, word][:2])
        around = statement[i - 1].text, statement[i + 3].text if i + 3 < len(statement) else ""
        is_sum = around[0] in ("[", ",") and around[1] in ("]", ",")
        if is_sum and sign in ("+", "-") and value.isdecimal():
            further = number + int(value) * (1 if sign == "+" else -1)
            edits.append(Edit(word.start - start, statement[i + 2].end - start, str(further)))
        else:
            edits.append(Edit(word.start - start, word.end - start, str(number)))
    return edited(source[start : statement[-1].end], edits).decode()
