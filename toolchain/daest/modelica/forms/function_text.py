"""Functions read from source text, for those whose algorithm the compiler itself does not take.

The compiler refuses `while`, `break`, `return`, loops over several iterators and most loops that assign more
than a sum. Such a function is shown to it as an external one, and its algorithm is read here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from daest.modelica.language import syntax as s
from daest.modelica.language.outline import Token, class_heads, class_tokens, laid_over, tokens
from daest.modelica.language.parse import ParseError, Parser

_KEYWORD = b"algorithm"


@dataclass(frozen=True)
class FunctionText:
    """Where a function stands in a file: bytes `start` (its identifier) to `end`, `algorithm` at its keyword;
    and the names of its outputs."""

    name: str
    outputs: tuple[str, ...]
    start: int
    algorithm: int
    end: int


def find_function(text: bytes, name: str) -> FunctionText | None:
    """The function with the last part of `name`, if the file has exactly one that has an algorithm and
    declarations that can be read."""
    short = name.rpartition(".")[2]
    heads = [h for h in class_heads(text) if h.kind == "function" and h.name.rpartition(".")[2] == short]
    if len(heads) != 1:
        return None
    words = class_tokens(text, heads[0])
    algorithm = next((i for i, word in enumerate(words) if word.text == "algorithm"), None)
    if algorithm is None:
        return None
    try:
        declared = _Declarations(words[:algorithm], 1).read()
    except ParseError:
        return None
    outputs = tuple(variable.name for role, variable in declared if role == "output")
    return FunctionText(short, outputs, heads[0].start, words[algorithm].start, heads[0].end)


def hidden(text: bytes, function: FunctionText) -> bytes:
    """The file with the function's algorithm replaced by an external declaration; no line or byte moves."""
    body = text[function.algorithm : function.end]
    instead = f"external {function.name}({','.join(function.outputs)});".encode()
    return text[: function.algorithm] + laid_over(body, instead) + text[function.end :]


def with_products(text: bytes, names: Iterable[str]) -> bytes:
    """The file with `= f(…)` as `= 1*f(…)` and with `pure function f` for functions f: the compiler mistakes
    the size of what a function of arrays gives where it is used alone, and takes hidden functions for impure
    ones. Lines keep their numbers."""
    for name in names:
        call = re.compile(rb"(=\s*)((?:[A-Za-z_]\w*\s*\.\s*)*" + name.encode() + rb"\s*\()")
        text = _outside_of_tuples(call, text)
        head = re.compile(
            rb"(?<!\bend )(?<!pure )(?<!operator )\bfunction(\s+" + name.encode() + rb"\b(?!\s*=))"
        )
        text = head.sub(rb"pure function\g<1>", text)
    return text


def _outside_of_tuples(call: re.Pattern[bytes], text: bytes) -> bytes:
    """`= f(` as `= 1*f(`, but not behind `(a, b)`, which takes several results."""

    def product(match: re.Match[bytes]) -> bytes:
        before = text[: match.start()].rstrip()
        return match[0] if before.endswith(b")") else match[1] + b"1*" + match[2]

    return call.sub(product, text)


def with_body(function: s.Function, found: FunctionText, text: bytes, source: int) -> s.Function:
    """The compiler's function with the algorithm of the text. Raises ParseError."""
    words = [t for t in tokens(text, found.algorithm + len(_KEYWORD)) if t.start < found.end]
    body = StatementParser(words, source=source).statements()
    return replace(function, body=body, is_external=False)


def read_function(found: FunctionText, text: bytes, source: int) -> s.Function:
    """A function of the text that the compiler does not hand over. Raises ParseError."""
    words = [token for token in tokens(text, found.start) if token.start < found.algorithm]
    declared = _Declarations(words, 1, source).read()
    empty = s.Function(
        name=found.name,
        inputs=tuple(variable for role, variable in declared if role == "input"),
        outputs=tuple(variable for role, variable in declared if role == "output"),
        locals=tuple(variable for role, variable in declared if role == "local"),
        body=(),
        is_external=True,
    )
    return with_body(empty, found, text, source)


def called_functions(tree: object) -> Iterator[str]:
    """Names of the functions that statements or expressions call."""
    return (one.function for one in s.nodes(tree) if isinstance(one, s.Call) and not one.builtin)


class _Declarations(Parser):
    """Reads the declarations at the head of a function."""

    def read(self) -> list[tuple[str, s.FunctionVariable]]:
        """Role ("input", "output", "local") and variable, in order."""
        found: list[tuple[str, s.FunctionVariable]] = []
        while self.next is not None:
            if self.next.kind == "text" or self.sees("protected", "public"):
                self.take()
            elif self.sees("import", "annotation"):
                self._skip()
            else:
                found += self._declaration()
        return found

    def _declaration(self) -> list[tuple[str, s.FunctionVariable]]:
        role = "local"
        while self.sees("input", "output", "parameter", "constant", "final", "replaceable"):
            word = self.take().text
            role = word if word in ("input", "output") else role
        type_name = self.take().text
        while self.sees("."):
            type_name += self.take().text + self.take().text
        common = self._subscripts(type_name) if self.sees("[") else ()
        found = []
        while True:
            found.append((role, self._variable(type_name, common)))
            if not self.sees(","):
                break
            self.take()
        self._skip()
        return found

    def _variable(self, type_name: str, common: tuple[s.Node, ...]) -> s.FunctionVariable:
        name = self.take().text
        own = self._subscripts(name) if self.sees("[") else ()
        if self.sees("("):
            self.skip_brackets()
        default = None
        if self.sees("=", ":="):
            self.take()
            default = self.expression()
        while self.next is not None and (self.next.kind == "text" or self.sees("annotation")):
            if self.take().text == "annotation":
                self.skip_brackets()
        return s.FunctionVariable(name, type_name, (*own, *common), default)

    def _skip(self) -> None:
        """To behind the next `;`."""
        while self.take().text != ";":
            pass


@dataclass
class StatementParser(Parser):
    """Reads statements (Modelica Language Specification 11.2); `when` where `takes_when` (models)."""

    takes_when: bool = False

    def statements(self, *until: str) -> tuple[s.Statement, ...]:
        """Statements up to one of the words `until`, or to the end of the tokens."""
        found: list[s.Statement] = []
        while self.next is not None and not self.sees(*until):
            found.append(self._statement())
            self.take(";")
        return tuple(found)

    def _statement(self) -> s.Statement:
        first = self.take()
        match first.text:
            case "if":
                return self._if(first)
            case "for":
                iterators = self.iterators()
                return s.For(iterators, self._loop("for"), self.span(first))
            case "while":
                condition = self.expression()
                return s.While(condition, self._loop("while"), self.span(first))
            case "return" | "break":
                return s.Jump("return" if first.text == "return" else "break", self.span(first))
            case "when":
                return self._when(first)
            case "assert" | "terminate":
                self.skip_brackets()
                return s.Assert(s.Constant(True), s.Constant(""), self.span(first))
            case "(":
                return self._several(first)
        self.at -= 1
        return self._assignment()

    def _loop(self, word: str) -> tuple[s.Statement, ...]:
        self.take("loop")
        body = self.statements("end")
        self.take("end")
        self.take(word)
        return body

    def _if(self, first: Token) -> s.Statement:
        branches = []
        while True:
            condition = self.expression()
            self.take("then")
            branches.append((condition, self.statements("elseif", "else", "end")))
            if not self.sees("elseif"):
                break
            self.take()
        otherwise: tuple[s.Statement, ...] = ()
        if self.sees("else"):
            self.take()
            otherwise = self.statements("end")
        self.take("end")
        self.take("if")
        return s.If(tuple(branches), otherwise, self.span(first))

    def _when(self, first: Token) -> s.Statement:
        if not self.takes_when:
            raise ParseError("`when` in a function", first)
        branches = []
        while True:
            condition = self.expression()
            self.take("then")
            branches.append((condition, self.statements("elsewhen", "end")))
            if not self.sees("elsewhen"):
                break
            self.take()
        self.take("end")
        self.take("when")
        return s.When(tuple(branches), self.span(first))

    def _several(self, first: Token) -> s.Statement:
        """`(a, , b) := f(x)`."""
        targets: list[s.Name | None] = []
        while not self.sees(")"):
            targets.append(None if self.sees(",") else self._target())
            if self.sees(","):
                self.take()
        self.take(")")
        self.take(":=")
        call = self.expression()
        if not isinstance(call, s.Call):
            raise ParseError("only a function has several results", first)
        return s.AssignCall(tuple(targets), call, self.span(first))

    def _target(self) -> s.Name:
        token = self.next
        node = self.binary(8)
        if not isinstance(node, s.Name):
            raise ParseError("only a variable can be assigned", token)
        return node

    def _assignment(self) -> s.Statement:
        first = self.next
        target = self.binary(8)
        assert first is not None
        if isinstance(target, s.Call):
            return s.AssignCall((), target, self.span(first))
        if not isinstance(target, s.Name):
            raise ParseError("only a variable can be assigned", first)
        self.take(":=")
        return s.Assign(target, self.expression(), self.span(first))
