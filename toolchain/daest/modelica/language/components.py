"""What the classes of Modelica texts declare: components with their types and sizes, base classes, imports.

A look-up of names as the language makes it (Modelica Language Specification 5.3), as far as texts show it
without compiling them: nothing is redeclared. A name that it does not find is told as not found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from daest.modelica.language.outline import (
    CLOSE,
    KINDS,
    OPEN,
    ClassHead,
    Token,
    arguments,
    class_heads,
    class_tokens,
    closing,
    extends_clauses,
    find_outside,
    imports,
    name_end,
)

_PREFIXES = (
    *("final", "inner", "outer", "replaceable", "redeclare", "flow", "stream", "input", "output", "discrete"),
    *("parameter", "constant", "each", "public", "protected"),
)
_NO_COMPONENT = (
    *(*KINDS, "import", "extends", "annotation", "encapsulated", "partial", "expandable", "impure", "pure"),
    *("end", "equation", "algorithm", "initial"),
)
MOST_BASES = 30  # classes that extend each other, behind each other
_MOST_STEPS = 30  # of short classes, bases and imports behind each other


@dataclass(frozen=True)
class Declared:
    """A declared component: its type as written in class `scope`, its sizes, and the tokens of its
    modification `(…)` and of its binding behind `=`."""

    name: Token
    type_name: str
    sizes: tuple[tuple[Token, ...], ...]
    modification: tuple[Token, ...]
    binding: tuple[Token, ...]
    is_parameter: bool
    is_input: bool
    scope: str
    behind: int  # where the name and its own size end


@dataclass(frozen=True)
class ClassText:
    """A class: its full name, its tokens, what it declares, and the file that it stands in."""

    name: str
    file: str
    words: tuple[Token, ...]
    components: dict[str, Declared]
    bases: tuple[str, ...]
    imports: dict[str, str]
    alias: str  # the class that a short definition names
    kind: str  # "model", "record" …


@dataclass
class Classes:
    """The classes of files; `read` gives the text of the file of a full name, None where there is none."""

    read: Callable[[str], bytes | None]
    _heads: dict[str, dict[str, ClassHead]] = field(default_factory=dict)  # by file and full name
    _found: dict[str, ClassText | None] = field(default_factory=dict)

    def get(self, name: str) -> ClassText | None:
        """The class of a full name."""
        if name not in self._found:
            self._found[name] = self._made(name)
        return self._found[name]

    def _made(self, name: str) -> ClassText | None:
        parts = name.split(".")
        for end in range(len(parts), 0, -1):
            file = ".".join(parts[:end])
            text = self.read(file)
            if text is None:
                continue
            if file not in self._heads:
                self._heads[file] = {head.name: head for head in class_heads(text)}
            head = self._heads[file].get(name)
            return None if head is None else _class_text(text, head, file)
        return None

    def resolved(self, name: str, scope: str, steps: int = 0) -> str | None:
        """The full name of the class that `name` means in class `scope`; None if it is not found."""
        if steps > _MOST_STEPS:
            return None
        if name.startswith("."):
            return name[1:] if self.get(name[1:]) else None
        first, dot, rest = name.partition(".")
        around = scope.split(".") if scope else []
        for end in range(len(around), -1, -1):
            found = self._inside(first, ".".join(around[:end]), steps)
            if found is not None:
                return self._below(found, rest, steps) if dot else found
        return None

    def base(self, name: str, heir: str) -> str | None:
        """The full name of the class that class `heir` extends as `name`: one around it, else one inside."""
        return self.resolved(name, heir.rpartition(".")[0]) or self.resolved(name, heir)

    def _below(self, name: str, rest: str, steps: int) -> str | None:
        found: str | None = name
        for part in rest.split("."):
            found = None if found is None else self._inside(part, self.meant(found, steps + 1), steps)
        return found

    def _inside(self, first: str, scope: str, steps: int) -> str | None:
        """The class `first` that `scope` declares, inherits or imports; of no scope, a library."""
        if not scope:
            return first if self.get(first) else None
        if self.get(f"{scope}.{first}"):
            return f"{scope}.{first}"
        around = self.get(scope)
        if around is None or steps > _MOST_STEPS:
            return None
        if first in around.imports:
            full = around.imports[first]
            return self.resolved("." + full, "", steps + 1) or full
        for base in around.bases:
            full_base = self.resolved(base, scope.rpartition(".")[0], steps + 1)
            found = full_base and self._inside(first, full_base, steps + 1)
            if found:
                return found
        return None

    def meant(self, name: str, steps: int = 0) -> str:
        """The class that is left where short definitions are followed: `Complex` of `SI.ComplexVoltage`."""
        found = self.get(name)
        while found is not None and found.alias and steps < _MOST_STEPS:
            name = self.resolved(found.alias, found.name.rpartition(".")[0]) or found.alias
            found, steps = self.get(name), steps + 1
        return name

    def component(self, name: str, scope: str, steps: int = 0) -> Declared | None:
        """The component `name` that class `scope` declares or inherits."""
        around = self.get(scope)
        if around is None or steps > _MOST_STEPS:
            return None
        if name in around.components:
            return around.components[name]
        bases = [around.alias] if around.alias else around.bases
        for base in bases:
            full = self.base(base, scope)
            found = None if full is None else self.component(name, full, steps + 1)
            if found is not None:
                return found
        return None

    def type_of(self, one: Declared) -> str | None:
        """The full name of the class of a component, `Real` and the like as they are."""
        if one.type_name in ("Real", "Integer", "Boolean", "String"):
            return one.type_name
        found = self.resolved(one.type_name, one.scope)
        return None if found is None else self.meant(found)


def _class_text(text: bytes, head: ClassHead, file: str) -> ClassText:
    """The class of a head in the text of a file."""
    words = tuple(class_tokens(text, head))
    if head.is_short:
        at = 2
        while at < len(words) and words[at].text in _PREFIXES:
            at += 1
        alias = "".join(word.text for word in words[at : name_end(words, at)])
        is_array = name_end(words, at) < len(words) and words[name_end(words, at)].text == "["
        return ClassText(head.name, file, words, {}, (), {}, "" if is_array else alias, head.kind)
    components = {one.name.text: one for line in statements(words) for one in declared(line, head.name)}
    bases = tuple(clause.base for clause in extends_clauses(words))
    return ClassText(head.name, file, words, components, bases, imports(words), "", head.kind)


def statements(words: Sequence[Token]) -> Iterator[list[Token]]:
    """The declarations of a class, without what follows `equation` or `algorithm`."""
    line: list[Token] = []
    depth = 0
    for word in words[1:]:
        if not line and depth == 0:
            if word.text in ("equation", "algorithm", "initial", "external"):
                return
            if word.kind == "text" or word.text in ("public", "protected"):
                continue
        depth += (word.text in OPEN) - (word.text in CLOSE)
        if depth == 0 and word.text == ";":
            yield line
            line = []
        else:
            line.append(word)


def declared(line: Sequence[Token], scope: str) -> Iterator[Declared]:
    """The components that a declaration declares."""
    at = 0
    while at < len(line) and line[at].text in _PREFIXES:
        at += 1
    if (
        at >= len(line)
        or line[at].text in _NO_COMPONENT
        or (line[at].kind != "name" and line[at].text != ".")
    ):
        return
    is_parameter = any(word.text in ("parameter", "constant") for word in line[:at])
    is_input = any(word.text == "input" for word in line[:at])
    end = name_end(line, at)
    type_name = "".join(word.text for word in line[at:end])
    common, at = _sizes(line, end)
    while at < len(line) and line[at].kind == "name":
        name = line[at]
        own, at = _sizes(line, at + 1)
        behind = line[at - 1].end
        end = closing(line, at) if at < len(line) and line[at].text == "(" else at
        modification, at = tuple(line[at:end]), end
        binding: tuple[Token, ...] = ()
        if at < len(line) and line[at].text in ("=", ":="):
            end = expression_end(line, at + 1)
            binding, at = tuple(line[at + 1 : end]), end
        yield Declared(
            name, type_name, (*own, *common), modification, binding, is_parameter, is_input, scope, behind
        )
        at = find_outside(line, at, ",") + 1


def expression_end(line: Sequence[Token], at: int) -> int:
    """Index behind the expression at `at` that a component is bound to: that of a comma, a semicolon, a
    comment, an annotation or a condition of the component."""
    first = at
    while at < len(line):
        word = line[at]
        if word.kind == "text" or word.text in (",", ";", "annotation", "constrainedby"):
            return at
        if word.text == "if" and at > first and line[at - 1].text not in ("else", *_BEFORE_IF):
            return at
        at = closing(line, at) if word.text in OPEN else at + 1
    return at


_BEFORE_IF = ("+", "-", "*", "/", "^", "=", "then", "and", "or", "not", ":", "<", ">", "<=", ">=", "==", "<>")


def _sizes(line: Sequence[Token], at: int) -> tuple[tuple[tuple[Token, ...], ...], int]:
    """The sizes in the square bracket at `at`, and the index behind it."""
    if at >= len(line) or line[at].text != "[":
        return (), at
    return tuple(map(tuple, arguments(line, at))), closing(line, at)
