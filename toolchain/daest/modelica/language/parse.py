"""Expressions in source text, by precedence climbing (Modelica Language Specification 2.6 and appendix
A).

Vendor annotations `__Daest(...)` behind declarations, read from the source text.

    parameter Real c annotation (__Daest(estimate = true, scale = "log", min = 0.01, max = 1));
    input Real w annotation (__Daest(noise = true, intensity = 1e-3, estimate = true));
    output Real y annotation (__Daest(std = 0.01, estimate = false));

The compiler drops annotations, but tells where each declaration stands.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from daest.errors import ModelError, Place
from daest.modelica.language import syntax as s
from daest.modelica.language.operators import BUILTINS, REFUSED
from daest.modelica.language.outline import CLOSE, OPEN, Token, arguments, find_outside, place_of, tokens
from daest.modelica.language.text import text
from daest.near import did_you_mean

_BINARY = {"or": 1, "and": 2, "<": 4, "<=": 4, ">": 4, ">=": 4, "==": 4, "<>": 4}
_BINARY |= {"+": 5, "-": 5, ".+": 5, ".-": 5, "*": 6, "/": 6, ".*": 6, "./": 6, "^": 7, ".^": 7}
_RANGE = 5  # parts of a range bind as tightly as a sum


class ParseError(ValueError):
    """Text that is no expression; `token` is where it stops being one (None: at the end)."""

    def __init__(self, message: str, token: Token | None) -> None:
        super().__init__(message)
        self.token = token


@dataclass
class Parser:
    """Reads expressions from a list of tokens, from position `at` on. Spans carry the number `source`."""

    tokens: list[Token]
    at: int = 0
    source: int | None = None
    _indexed: list[tuple[str, int]] = field(default_factory=list)  # arrays around `end`, with the dimension

    @property
    def next(self) -> Token | None:
        return self.tokens[self.at] if self.at < len(self.tokens) else None

    def sees(self, *texts: str) -> bool:
        """Whether the next token is one of `texts`."""
        return self.next is not None and self.next.text in texts

    def take(self, text: str | None = None) -> Token:
        """The next token, which must be `text` if given."""
        token = self.next
        if token is None or (text is not None and token.text != text):
            wanted = "an expression" if text is None else f"`{text}`"
            found = "the end" if token is None else f"`{token.text}`"
            raise ParseError(f"expected {wanted}, found {found}", token)
        self.at += 1
        return token

    def skip_brackets(self) -> None:
        """Pass over a bracket and what is in it."""
        depth = 0
        while True:
            token = self.take()
            depth += (token.text == "(") - (token.text == ")")
            if depth == 0:
                return

    def span(self, first: Token) -> s.Span | None:
        """From `first` to the token before the next one."""
        if self.source is None:
            return None
        return s.Span(self.source, first.start, self.tokens[self.at - 1].end)

    def expression(self) -> s.Node:
        """An expression, a range among them."""
        if self.sees("if"):
            return self._conditional()
        start = self.binary(1)
        if not self.sees(":"):
            return start
        self.take()
        second = self.binary(_RANGE)
        if not self.sees(":"):
            return s.Range(start, None, second)
        self.take()
        return s.Range(start, second, self.binary(_RANGE))

    def _conditional(self) -> s.Node:
        branches = []
        first = self.take("if")
        while True:
            condition = self.expression()
            self.take("then")
            branches.append((condition, self.expression()))
            if not self.sees("elseif"):
                break
            self.take()
        self.take("else")
        otherwise = self.expression()
        return s.Conditional(tuple(branches), otherwise, self.span(first))

    def binary(self, loosest: int) -> s.Node:
        """Operands joined by operators of at least the precedence `loosest`."""
        first = self.next
        left = self._operand()
        while (token := self.next) is not None and _BINARY.get(token.text, 0) >= loosest:
            self.take()
            right = self.binary(_BINARY[token.text] + 1)
            left = s.Binary(token.text, left, right, self.span(first or token))
        return left

    def _operand(self) -> s.Node:
        token = self.take()
        if token.text in ("-", "+"):
            return s.Unary(token.text, self.binary(6), self.span(token))
        if token.text == "not":
            return s.Unary("not", self.binary(4), self.span(token))
        if token.text == "(":
            inner = self.expression()
            self.take(")")
            return inner
        if token.text == "{":
            return self._braces()
        if token.text == "[":
            return self._matrix()
        if token.kind == "number":
            return s.Constant(int(token.text) if token.text.isdigit() else float(token.text))
        if token.kind == "text":
            return s.Constant(token.text[1:-1].replace('\\"', '"').replace("\\\\", "\\"))
        if token.text in ("true", "false"):
            return s.Constant(token.text == "true")
        if token.text == "end" and self._indexed:
            name, dimension = self._indexed[-1]
            return s.Call("size", (s.Name(name), s.Constant(dimension)), builtin=True)
        if token.kind == "name":
            return self._reference(token)
        raise ParseError(f"`{token.text}` cannot begin an expression", token)

    def _braces(self) -> s.Node:
        if self.sees("}"):
            self.take()
            return s.Array(())
        element = self.expression()
        if self.sees("for"):
            made = s.Comprehension(element, self._iterators())
            self.take("}")
            return made
        return s.Array((element, *self._rest("}")))

    def _matrix(self) -> s.Node:
        rows = []
        while True:
            row = [self.expression()]
            while self.sees(","):
                self.take()
                row.append(self.expression())
            rows.append(s.Array(tuple(row)))
            if not self.sees(";"):
                break
            self.take()
        self.take("]")
        return s.Array(tuple(rows), is_matrix=True)

    def _iterators(self) -> tuple[tuple[str, s.Node], ...]:
        """`for i in range, j in range`."""
        self.take("for")
        return self.iterators()

    def iterators(self) -> tuple[tuple[str, s.Node], ...]:
        """`i in range, j in range`."""
        found = []
        while True:
            name = self.take().text
            self.take("in")
            found.append((name, self.expression()))
            if not self.sees(","):
                return tuple(found)
            self.take()

    def _reference(self, first: Token) -> s.Node:
        parts = [first.text]
        while self.sees("."):
            self.take()
            parts.append(self.take().text)
        name = ".".join(parts)
        if self.sees("("):
            self.take()
            arguments = self._arguments()
            return s.Call(name, arguments, name in BUILTINS or name in REFUSED, span=self.span(first))
        subscripts = self._subscripts(name) if self.sees("[") else ()
        return self._members(s.Name(name, subscripts, self.span(first)), first)

    def _members(self, node: s.Node, first: Token) -> s.Node:
        """`.x[2].y` behind a component with subscripts."""
        while self.sees("."):
            self.take()
            member = self.take().text
            node = s.Field(node, member, self.span(first))
            if self.sees("["):
                node = s.Index(node, self._subscripts(member), self.span(first))
        return node

    def _arguments(self) -> tuple[s.Node, ...]:
        if self.sees(")"):
            self.take()
            return ()
        element = self.expression()
        if self.sees("for"):
            made = s.Comprehension(element, self._iterators())
            self.take(")")
            return (made,)
        return (element, *self._rest(")"))

    def _subscripts(self, name: str) -> tuple[s.Node, ...]:
        self.take("[")
        found: list[s.Node] = []
        while True:
            if self.sees(":"):
                self.take()
                found.append(s.Colon())
            else:
                self._indexed.append((name, len(found) + 1))
                found.append(self.expression())
                self._indexed.pop()
            if not self.sees(","):
                break
            self.take()
        self.take("]")
        return tuple(found)

    def _rest(self, closing: str) -> tuple[s.Node, ...]:
        """The other elements of a list whose first one is read."""
        found: list[s.Node] = []
        while self.sees(","):
            self.take()
            found.append(self.expression())
        self.take(closing)
        return tuple(found)


Role = Literal["parameter", "input", "output", "variable"]

KEYS: dict[Role, tuple[str, ...]] = {
    # The second row is read by the catalogue of effects.
    "parameter": (
        *("estimate", "scale", "min", "max"),
        *("role", "null", "grid", "of", "from", "required", "periods", "unit", "proof"),
    ),
    "input": ("noise", "intensity", "estimate"),
    "output": ("std", "estimate"),
    "variable": (),
}
SCALES = ("auto", "linear", "log")


@dataclass(frozen=True)
class Annotation:
    """The entries of one `__Daest(...)`, each with its place. `is_of_formula`: the declaration beside it
    computes its value from others."""

    entries: Mapping[str, s.Node] = field(default_factory=dict)
    places: Mapping[str, Place] = field(default_factory=dict)
    place: Place | None = None
    is_of_formula: bool = False

    def __bool__(self) -> bool:
        return self.place is not None

    def flag(self, key: str, default: bool) -> bool:
        """A Boolean entry. Raises ModelError for any other value."""
        node = self.entries.get(key)
        if node is None:
            return default
        if not isinstance(node, s.Constant) or not isinstance(node.value, bool):
            raise self.error(key, f"`{key} = {text(node)}` must be true or false", f"Write `{key} = true`.")
        return node.value

    def scale(self) -> Literal["auto", "linear", "log"]:
        node = self.entries.get("scale")
        if node is None:
            return "auto"
        value = node.value if isinstance(node, s.Constant) else None
        for scale in SCALES:
            if value == scale:
                return scale  # type: ignore[return-value]
        choices = ", ".join(f'"{scale}"' for scale in SCALES)
        raise self.error("scale", f"`scale = {text(node)}` is no scale", f"Choose {choices}.")

    def error(self, key: str, what: str, remedy: str) -> ModelError:
        return ModelError(
            "model-annotation", f"__Daest: {what}", where=self.places.get(key, self.place), remedy=remedy
        )


NONE = Annotation()
_AT_CLASS = re.compile(rb";\s*(annotation\s*\()")


def refuse_marks_of_classes(file: str, source: bytes) -> None:
    """Raise ModelError `model-annotation` for a `__Daest(...)` that stands at a class, behind no declaration:
    nothing would read it. Those of classes of effects are read elsewhere."""
    for match in _AT_CLASS.finditer(source) if b"__Daest" in source else ():
        mark = _mark(_tail(source, match.start(1)), 1, file, source)
        if mark and "effect" not in mark.entries:
            what = "it stands at the class, where it has no meaning"
            remedy = "Write it behind the parameter, input or output that it is about, before its `;`."
            raise mark.error("", what, remedy)


def annotation_of(file: str, source: bytes, declaration_end: int) -> Annotation:
    """The `__Daest(...)` of the declaration whose identifier ends at byte `declaration_end`; falsy if it has
    none.

    A list `Real a, b annotation(...)` gives the annotation to b alone, as Modelica does."""
    tail = _tail(source, declaration_end)
    at = find_outside(tail, 0, "annotation")
    mark = _mark(tail, at + 1, file, source)
    value = tail[find_outside(tail, 0, "=") : at] if mark else []
    return replace(mark, is_of_formula=any(token.kind == "name" for token in value))


def _mark(tail: list[Token], at: int, file: str, source: bytes) -> Annotation:
    """The `__Daest(...)` among the arguments of the annotation whose bracket opens at token `at`."""
    for one in arguments(tail, at) if at < len(tail) and tail[at].text == "(" else ():
        if one[0].text == "__Daest" and len(one) > 1 and one[1].text == "(":
            return _entries(one, file, source)
    return NONE


def _tail(source: bytes, start: int) -> list[Token]:
    """The tokens of a declaration after its identifier, up to the `,` or `;` that ends it."""
    found: list[Token] = []
    depth = 0
    for token in tokens(source, start):
        if depth == 0 and token.text in (",", ";"):
            break
        depth += (token.text in OPEN) - (token.text in CLOSE)
        if depth < 0:
            break
        found.append(token)
    return found


def _entries(words: list[Token], file: str, source: bytes) -> Annotation:
    """The entries of `__Daest(…)`."""
    place = place_of(file, source, words[0].start)
    parser = Parser(words, 2)
    entries: dict[str, s.Node] = {}
    places: dict[str, Place] = {}
    try:
        while parser.next is not None and parser.next.text != ")":
            key = parser.take()
            parser.take("=")
            entries[key.text] = parser.expression()
            places[key.text] = place_of(file, source, key.start)
            if parser.next is not None and parser.next.text == ",":
                parser.take()
        parser.take(")")
    except ParseError as problem:
        where = place if problem.token is None else place_of(file, source, problem.token.start)
        raise ModelError(
            "model-annotation",
            f"__Daest: {problem}",
            where=where,
            remedy="Write __Daest(key = value, …), for example __Daest(estimate = true).",
        ) from None
    return Annotation(entries, places, place)


def check_keys(annotation: Annotation, role: Role, name: str) -> None:
    """Raise ModelError for a key that has no meaning for a declaration of this role."""
    known = KEYS[role]
    for key in annotation.entries:
        if key in known:
            continue
        if not known:
            what = f"`{name}` is neither a parameter, an input nor an output"
            raise annotation.error(key, what, "Move the annotation to a parameter, an input or an output.")
        hint = did_you_mean(key, known, 1)
        raise annotation.error(
            key, f"`{key}` has no meaning for {role} `{name}`", f"{hint}Known there: {', '.join(known)}."
        )
