"""Expressions in annotation text, by precedence climbing (Modelica Language Specification 2.6 and appendix
A)."""

from __future__ import annotations

from dataclasses import dataclass

from daest.modelica import syntax as s
from daest.modelica.tokens import Token

_BINARY = {"or": 1, "and": 2, "<": 4, "<=": 4, ">": 4, ">=": 4, "==": 4, "<>": 4}
_BINARY |= {"+": 5, "-": 5, ".+": 5, ".-": 5, "*": 6, "/": 6, ".*": 6, "./": 6, "^": 7, ".^": 7}


class ParseError(ValueError):
    """Text that is no expression; `token` is where it stops being one (None: at the end)."""

    def __init__(self, message: str, token: Token | None) -> None:
        super().__init__(message)
        self.token = token


@dataclass
class Parser:
    """Reads expressions from a list of tokens, from position `at` on."""

    tokens: list[Token]
    at: int = 0

    @property
    def next(self) -> Token | None:
        return self.tokens[self.at] if self.at < len(self.tokens) else None

    def take(self, text: str | None = None) -> Token:
        """The next token, which must be `text` if given."""
        token = self.next
        if token is None or (text is not None and token.text != text):
            wanted = "an expression" if text is None else f"`{text}`"
            found = "the end" if token is None else f"`{token.text}`"
            raise ParseError(f"expected {wanted}, found {found}", token)
        self.at += 1
        return token

    def expression(self, loosest: int = 1) -> s.Node:
        left = self._operand()
        while (token := self.next) is not None and _BINARY.get(token.text, 0) >= loosest:
            self.take()
            left = s.Binary(token.text, left, self.expression(_BINARY[token.text] + 1))
        return left

    def _operand(self) -> s.Node:
        token = self.take()
        if token.text in ("-", "+"):
            return s.Unary(token.text, self.expression(6))
        if token.text == "not":
            return s.Unary("not", self.expression(4))
        if token.text == "(":
            inner = self.expression()
            self.take(")")
            return inner
        if token.text == "{":
            return s.Array(self._list("}"))
        if token.kind == "number":
            is_whole = token.text.isdigit()
            return s.Constant(int(token.text) if is_whole else float(token.text))
        if token.kind == "text":
            return s.Constant(token.text[1:-1].replace('\\"', '"').replace("\\\\", "\\"))
        if token.text in ("true", "false"):
            return s.Constant(token.text == "true")
        if token.kind == "name":
            return self._reference(token)
        raise ParseError(f"`{token.text}` cannot begin an expression", token)

    def _reference(self, first: Token) -> s.Node:
        parts = [first.text]
        while self.next is not None and self.next.text == ".":
            self.take()
            parts.append(self.take().text)
        name = ".".join(parts)
        if self.next is not None and self.next.text == "(":
            self.take()
            return s.Call(name, self._list(")"), builtin=True)
        if self.next is not None and self.next.text == "[":
            self.take()
            return s.Name(name, self._list("]"))
        return s.Name(name)

    def _list(self, closing: str) -> tuple[s.Node, ...]:
        found: list[s.Node] = []
        while self.next is not None and self.next.text != closing:
            found.append(self.expression())
            if self.next is not None and self.next.text == ",":
                self.take()
        self.take(closing)
        return tuple(found)
