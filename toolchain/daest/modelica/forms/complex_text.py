"""Complex equations as equations between real and imaginary parts, in the text of a class.

The compiler reads operators between records, but does not make equations of them. So `v = Z*i` becomes
`v.re = Z.re*i.re - Z.im*i.im; v.im = …`, and where `v` is an array a loop over its elements; what is declared
with such an expression gets it likewise. Types are those that the texts declare. What is not understood in
full stays as it is, and is for the compiler to refuse: it takes no Complex number for a Real one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from daest.modelica.language import syntax as s
from daest.modelica.language.components import Classes, ClassText, Declared
from daest.modelica.language.outline import CLOSE, OPEN, Token, class_heads, depths, find_outside
from daest.modelica.language.parse import ParseError, Parser
from daest.modelica.language.text import text

COMPLEX, MATH = "Complex", "Modelica.ComplexMath"
_INDEX = "D__{}"
_ENDS = ("for", "if", "when")
_ELEMENTWISE = {".*": "*", "./": "/", ".+": "+", ".-": "-"}
_WITH_EQUATIONS = ("model", "block", "class")
_CONJUGATED = b"c3.re+c1[i].re*c2[i].re+c1[i].im*c2[i].im"  # in the scalar product of Complex
_MOST_FACTORS = 4  # of a power that is written as a product


class _Unclear(Exception):
    """An expression whose types or sizes the texts do not tell."""


Parts = tuple[str, str]


@dataclass(frozen=True)
class _Value:
    """An expression: `at` gives real and imaginary part (of a Real: itself and nothing) as text that can
    stand as an operand of a product; of an array (`size`) that of the element of an index."""

    is_complex: bool
    at: Callable[[str], Parts]
    size: str | None = None


def with_parts(source: bytes, classes: Classes) -> bytes:
    """The text, one of those that `classes` reads, with its Complex equations by parts. Lines keep their
    numbers."""
    changes: list[tuple[int, int, str]] = []
    for head in class_heads(source):
        if head.kind not in _WITH_EQUATIONS:
            continue
        found = classes.get(head.name)
        if found is not None and not found.alias:
            changes += _Class(found, classes).changes()
    made = source
    for start, end, new in sorted(changes, reverse=True):
        lines = made.count(b"\n", start, end)
        made = made[:start] + new.encode() + b"\n" * lines + made[end:]
    return made


@dataclass
class _Class:
    """The changes of one class."""

    one: ClassText
    classes: Classes
    _count: int = 0
    _loops: list[str] = field(default_factory=list)
    _moved: list[str] = field(default_factory=list)

    def changes(self) -> list[tuple[int, int, str]]:
        """Where to put which text."""
        return [*self._declarations(), *self._section(), *self._equations()]

    # Declarations -------------------------------------------------------------------------------------------

    def _declarations(self) -> Iterator[tuple[int, int, str]]:
        for one in self.one.components.values():
            for name, words in _modified(one.modification):
                made = self._tried(lambda name=name, words=words: self._modification(name, words))  # type: ignore[misc]
                if made is not None:
                    yield made
            if not one.binding:
                continue
            made = self._tried(lambda one=one: self._binding(one))  # type: ignore[misc]
            if made is not None:
                yield made

    def _modification(self, name: str, words: Sequence[Token]) -> tuple[int, int, str] | None:
        """A Real value in a modification that is made of Complex ones."""
        node = _parsed(words)
        if name in _ATTRIBUTES or not _holds_complex(self, node):
            return None
        value = _Expression(self, {}).value(node)
        if value.is_complex:
            return None
        return words[0].start, words[-1].end, self._whole(value, 0)

    def _binding(self, one: Declared) -> tuple[int, int, str] | None:
        node = _parsed(one.binding)
        value = _Expression(self, {}).value(node)
        is_complex = self.classes.type_of(one) == COMPLEX
        start, end = one.binding[0].start, one.binding[-1].end
        if not is_complex:
            if value.is_complex or not _holds_complex(self, node):
                return None
            return start, end, self._whole(value, 0)
        if one.is_parameter or (isinstance(node, s.Call | s.Name) and value.size is None):
            return None  # the compiler takes it as it is, or refuses it
        if not value.is_complex or len(one.sizes) > 1 or bool(one.sizes) != (value.size is not None):
            raise _Unclear
        return self._as_equation(one, value)

    def _as_equation(self, one: Declared, value: _Value) -> tuple[int, int, str]:
        """The binding becomes an equation. It does not become one of each part in the modification: the
        compiler would keep those where a binding from outside replaces them."""
        name = one.name.text

        def parts(index: str) -> Parts:
            element = f"{name}[{index}]" if index else name
            return f"{element}.re", f"{element}.im"

        own = _Value(True, parts, value.size)
        if value.size is None:
            self._moved.append(_equal(own, value, "", (0, 1)) + ";")
        elif isinstance(value.at, _Elements):
            made = [_equal(own, value, str(k + 1), (0, 1)) + ";" for k in range(len(value.at.elements))]
            self._moved += made
        else:
            index, declared = self.index(), _source(one.sizes[0])
            size = value.size if declared == ":" else declared
            loop = f"for {index} in 1:{size} loop {_equal(own, value, index, (0, 1))}; end for;"
            self._moved.append(loop)
        start = one.modification[-1].end if one.modification else one.behind
        return start, one.binding[-1].end, ""

    def _section(self) -> Iterator[tuple[int, int, str]]:
        """The equations that were bindings, at the head of the equations, or a section of their own."""
        if not self._moved:
            return
        words, depth, last = self.one.words, 0, self.one.words[-1].end
        for i, word in enumerate(words):
            depth += (word.text in OPEN) - (word.text in CLOSE)
            if depth == 0 and word.text == "equation" and words[i - 1].text != "initial":
                yield word.end, word.end, " " + " ".join(self._moved)
                return
            if depth == 0 and word.text in ("equation", "algorithm"):
                last = min(last, (words[i - 1] if words[i - 1].text == "initial" else word).start)
            if depth == 0 and word.text == "annotation" and words[i - 1].text == ";":
                last = min(last, word.start)
        yield last, last, f" equation {' '.join(self._moved)} "

    def _whole(self, value: _Value, part: int) -> str:
        """A part of a value, an array as a whole."""
        if value.size is None:
            return value.at("")[part]
        index = self.index()
        return f"{{{value.at(index)[part]} for {index} in 1:{value.size}}}"

    # Equations ----------------------------------------------------------------------------------------------

    def _equations(self) -> Iterator[tuple[int, int, str]]:
        for loops, line in _statements(self.one.words):
            self._loops = list(loops)
            equals = _equals(line)
            if equals is None:
                continue
            made = self._tried(lambda at=equals, line=line: self._equation(line, at))  # type: ignore[misc]
            if made is not None:
                yield made

    def _equation(self, line: Sequence[Token], equals: int) -> tuple[int, int, str] | None:
        end = next(
            (i for i in range(equals, len(line)) if line[i].kind == "text" or line[i].text == "annotation"),
            len(line),
        )
        sides = _parsed(line[:equals]), _parsed(line[equals + 1 : end])
        if not any(_holds_complex(self, side) for side in sides):
            return None
        expression = _Expression(self, {name: name for name in self._loops})
        left, right = (expression.value(side) for side in sides)
        start, stop = line[0].start, line[end - 1].end
        if left.is_complex != right.is_complex:
            raise _Unclear
        sizes = [value.size for value in (left, right) if value.size is not None]
        parts = (0, 1) if left.is_complex else (0,)
        if not sizes:
            return start, stop, _equal(left, right, "", parts)
        if len(sizes) < 2:
            raise _Unclear
        size = _chosen(sizes)
        if size.isdigit() or isinstance(left.at, _Elements) or isinstance(right.at, _Elements):
            size = next(one for one in sizes if one.isdigit()) if not size.isdigit() else size
            return start, stop, "; ".join(_equal(left, right, str(k + 1), parts) for k in range(int(size)))
        index = self.index()
        return start, stop, f"for {index} in 1:{size} loop {_equal(left, right, index, parts)}; end for"

    def _tried(self, work: Callable[[], tuple[int, int, str] | None]) -> tuple[int, int, str] | None:
        try:
            return work()
        except (_Unclear, ParseError):
            return None

    def index(self) -> str:
        """A name for another loop."""
        self._count += 1
        return _INDEX.format(self._count)

    # Names --------------------------------------------------------------------------------------------------

    def path(self, node: s.Node) -> list[tuple[str, tuple[s.Node, ...]]]:
        """A reference as its parts with their subscripts."""
        match node:
            case s.Name(name, subscripts):
                *heads, last = name.split(".")
                return [*((head, ()) for head in heads), (last, subscripts)]
            case s.Field(base, name):
                return [*self.path(base), (name, ())]
            case s.Index(base, subscripts):
                *before, (name, own) = self.path(base)
                if own:
                    raise _Unclear
                return [*before, (name, subscripts)]
        raise _Unclear

    def kind(self, path: Sequence[tuple[str, tuple[s.Node, ...]]]) -> tuple[str, list[tuple[int, str]]]:
        """The type of a reference, and which of its parts are arrays without a subscript, with a size.

        Raises _Unclear for a name that no text declares, and for slices."""
        first, at = self._first(path)
        found: list[tuple[int, str]] = []
        declared: Declared = first
        while True:
            subscripts = path[at][1]
            if any(isinstance(one, s.Colon | s.Range) for one in subscripts):
                raise _Unclear
            if len(subscripts) not in (0, len(declared.sizes)):
                raise _Unclear
            if declared.sizes and not subscripts:
                if len(declared.sizes) > 1:
                    raise _Unclear
                found.append((at, self._size(path, at, declared)))
            type_name = self.classes.type_of(declared)
            if type_name is None:
                raise _Unclear
            at += 1
            if at == len(path):
                return type_name, found
            inner = self.classes.component(path[at][0], type_name)
            if inner is None:
                raise _Unclear
            declared = inner

    def _first(self, path: Sequence[tuple[str, tuple[s.Node, ...]]]) -> tuple[Declared, int]:
        found = self.classes.component(path[0][0], self.one.name)
        if found is not None:
            return found, 0
        names = [name for name, _ in path]
        for end in range(len(names) - 1, 0, -1):
            package = self.classes.resolved(".".join(names[:end]), self.one.name)
            found = None if package is None else self.classes.component(names[end], package)
            if found is not None:
                return found, end
        # A constant that an import names, or one of a package around.
        for scope in self._around():
            if names[0] in scope.imports:
                package, _, name = scope.imports[names[0]].rpartition(".")
                found = self.classes.component(name, package)
                if found is not None:
                    return found, 0
            if names[0] in scope.components:
                return scope.components[names[0]], 0
        raise _Unclear

    def _around(self) -> Iterator[ClassText]:
        """This class and those that it stands in, from the inside."""
        names = self.one.name.split(".")
        for end in range(len(names), 0, -1):
            scope = self.classes.get(".".join(names[:end]))
            if scope is not None:
                yield scope

    def _size(self, path: Sequence[tuple[str, Any]], at: int, declared: Declared) -> str:
        size = _source(declared.sizes[0])
        if at == 0 and size != ":":
            return size
        return f"size({_path_text(path[: at + 1])}, 1)"

    def full_function(self, name: str) -> str:
        """The full name of a function as called in this class."""
        return self.classes.resolved(name, self.one.name) or self._imported(name)

    def _imported(self, name: str) -> str:
        return next((scope.imports[name] for scope in self._around() if name in scope.imports), name)


class _Elements:
    """`at` of an array whose elements are written one by one: its index must be a number."""

    def __init__(self, elements: Sequence[_Value]) -> None:
        self.elements = elements

    def __call__(self, index: str) -> Parts:
        if not index.isdigit():
            raise _Unclear
        return self.elements[int(index) - 1].at("")


@dataclass(frozen=True)
class _Expression:
    """The values of expressions in a class; `indices` are iterators and what stands for them."""

    around: _Class
    indices: Mapping[str, str]

    def value(self, node: s.Node) -> _Value:
        """The value of an expression. Raises _Unclear."""
        match node:
            case s.Constant(number):
                if isinstance(number, str):
                    raise _Unclear
                return _real(text(node))
            case s.Name() | s.Field() | s.Index():
                return self._reference(node)
            case s.Unary(operator, operand):
                return self._unary(operator, self.value(operand))
            case s.Binary(operator, left, right):
                return self._binary(operator, left, right)
            case s.Conditional(branches, otherwise):
                return self._conditional(branches, otherwise)
            case s.Call(function, arguments):
                return self._call(node, function, arguments)
            case s.Array(elements, False):
                values = [self.value(one) for one in elements]
                if any(one.size is not None or one.is_complex != values[0].is_complex for one in values):
                    raise _Unclear
                return _Value(values[0].is_complex, _Elements(values), str(len(values)))
            case s.Comprehension(element, ((name, s.Range(s.Constant(1), None, stop)),)):
                return self._comprehension(element, name, self._plain(stop))
        raise _Unclear

    def _comprehension(self, element: s.Node, name: str, size: str) -> _Value:
        def inside(index: str) -> _Value:
            return _Expression(self.around, {**self.indices, name: index}).value(element)

        first = inside(name)
        if first.size is not None:
            raise _Unclear
        return _Value(first.is_complex, lambda index: inside(index).at(""), size)

    def _plain(self, node: s.Node) -> str:
        """The text of a scalar Real expression, with the iterators that are meant."""
        return text(_renamed(node, self.indices))

    def _reference(self, node: s.Node) -> _Value:
        path = self.around.path(node)
        if len(path) == 1 and path[0][0] in self.indices:
            return _real(self.indices[path[0][0]])
        if len(path) == 1 and path[0][0] == "time":
            return _real("time")
        type_name, arrays = self.around.kind(path)
        if type_name not in ("Complex", "Real", "Integer", "Boolean") and not _is_real(
            type_name, self.around
        ):
            raise _Unclear
        if len(arrays) > 1:
            raise _Unclear
        path = [(name, tuple(_renamed(one, self.indices) for one in subs)) for name, subs in path]

        def at(index: str) -> Parts:
            chosen = list(path)
            if arrays:
                chosen[arrays[0][0]] = (path[arrays[0][0]][0], (s.Name(index),))
            shown = _path_text(chosen)
            return (f"{shown}.re", f"{shown}.im") if type_name == COMPLEX else (shown, "")

        if type_name == COMPLEX and _is_j(self.around, path):
            return _Value(True, lambda _index: ("0", "1"))
        return _Value(type_name == COMPLEX, at, arrays[0][1] if arrays else None)

    def _unary(self, operator: str, value: _Value) -> _Value:
        if operator == "+":
            return value
        if operator == "not":
            return replace(value, at=lambda index: (f"(not {value.at(index)[0]})", ""))
        return replace(value, at=lambda index: _both(_negated, value.at(index)))

    def _binary(self, operator: str, left_node: s.Node, right_node: s.Node) -> _Value:
        left, right = self.value(left_node), self.value(right_node)
        if not (left.is_complex or right.is_complex):
            return self._real_binary(operator, left, right)
        sizes = [one.size for one in (left, right) if one.size is not None]
        is_elementwise = operator in _ELEMENTWISE
        operator = _ELEMENTWISE.get(operator, operator)
        if len(sizes) == 2 and operator in "*/" and not is_elementwise:
            return self._scalar_product(operator, left, right)
        is_by_array = operator in "+-" or (operator == "/" and right.size is not None)
        if len(sizes) == 1 and is_by_array and not is_elementwise:
            raise _Unclear
        if operator == "^":
            return self._power(left, right_node)
        work = {"+": _sum2, "-": _difference2, "*": _product2, "/": _quotient2}.get(operator)
        if work is None:
            raise _Unclear
        found = work

        def at(index: str) -> Parts:
            return found(_complex(left, index), _complex(right, index))

        return _Value(True, at, _chosen(sizes) if sizes else None)

    def _scalar_product(self, operator: str, left: _Value, right: _Value) -> _Value:
        """The product of two Complex vectors, whose first one the library conjugates from version 4 on."""
        if operator != "*" or not left.is_complex or not right.is_complex:
            raise _Unclear
        if _CONJUGATED not in b"".join((self.around.classes.read(COMPLEX) or b"").split()):
            raise _Unclear
        first = replace(left, at=lambda index: (left.at(index)[0], _negated(left.at(index)[1])))
        size = _chosen([one for one in (left.size, right.size) if one is not None])
        return self._added(_Value(True, lambda index: _product2(first.at(index), right.at(index)), size))

    def _real_binary(self, operator: str, left: _Value, right: _Value) -> _Value:
        sizes = [one.size for one in (left, right) if one.size is not None]
        if sizes and operator not in ("+", "-", *_ELEMENTWISE) and not (len(sizes) == 1 and operator in "*/"):
            raise _Unclear
        if operator in "*/" and len(sizes) == 2:
            raise _Unclear
        scalar = _ELEMENTWISE.get(operator, operator) if sizes else operator

        def at(index: str) -> Parts:
            first, second = left.at(index)[0], right.at(index)[0]
            if scalar in "/^":  # what binds as tightly as these may stand inside
                first, second = f"({first})", f"({second})"
            return f"({first} {scalar} {second})", ""

        return _Value(False, at, _chosen(sizes) if sizes else None)

    def _power(self, base: _Value, exponent: s.Node) -> _Value:
        if not isinstance(exponent, s.Constant) or type(exponent.value) is not int:
            raise _Unclear
        count = exponent.value
        if base.size is not None or not 1 <= count <= _MOST_FACTORS:
            raise _Unclear

        def at(index: str) -> Parts:
            made = base.at(index)
            for _ in range(count - 1):
                made = _product2(made, base.at(index))
            return made

        return _Value(True, at)

    def _conditional(self, branches: tuple[tuple[s.Node, s.Node], ...], otherwise: s.Node) -> _Value:
        conditions = [self.value(condition) for condition, _ in branches]
        values = [*(self.value(branch) for _, branch in branches), self.value(otherwise)]
        if any(one.size is not None for one in (*conditions, *values)) or any(
            c.is_complex for c in conditions
        ):
            raise _Unclear
        is_complex = any(one.is_complex for one in values)

        def at(index: str) -> Parts:
            parts = []
            for k in (0, 1) if is_complex else (0,):
                made = ""
                for condition, value in zip(conditions, values, strict=False):
                    made += (
                        f"{'elseif' if made else 'if'} {condition.at('')[0]} then {_complex(value, '')[k]} "
                    )
                parts.append(f"({made}else {_complex(values[-1], '')[k]})")
            return parts[0], parts[1] if is_complex else ""

        return _Value(is_complex, at)

    def _call(self, node: s.Node, function: str, arguments: tuple[s.Node, ...]) -> _Value:
        if function == "sum" and len(arguments) == 1:
            return self._added(self.value(arguments[0]))
        full = self.around.full_function(function)
        if function == "fill" and len(arguments) == 2:
            filled = self.value(arguments[0])
            if filled.size is not None:
                raise _Unclear
            return replace(filled, at=lambda _index: filled.at(""), size=self._plain(arguments[1]))
        if full == COMPLEX or self.around.classes.meant(full) == COMPLEX:
            return self._constructed([self.value(one) for one in arguments])
        if full.startswith(MATH + "."):
            return self._math(full.rpartition(".")[2].strip("'"), node, arguments)
        if function == "size":
            return _real(self._plain(node))
        inlined = self._inlined(full, arguments)
        if inlined is not None:
            return self.value(inlined)
        values = [self.value(one) for one in arguments]
        if any(one.is_complex or one.size is not None for one in values) or not _is_scalar_function(function):
            raise _Unclear
        return _real(f"{function}({', '.join(one.at('')[0] for one in values)})")

    def _inlined(self, full: str, arguments: tuple[s.Node, ...]) -> s.Node | None:
        """What a function of one assignment gives; None of another function."""
        found = self.around.classes.get(full)
        if found is None or found.alias:
            return None
        assigned = _only_assignment(found.words)
        inputs = [one for one in found.components.values() if one.is_input]
        if assigned is None or len(inputs) != len(arguments):
            return None
        meant = {one.name.text: argument for one, argument in zip(inputs, arguments, strict=True)}
        for one in found.components.values():
            if one.binding and not one.is_input:
                meant[one.name.text] = _with_arguments(_parsed(one.binding), meant)
        return _with_arguments(_parsed(assigned), meant)

    def _added(self, value: _Value) -> _Value:
        if value.size is None:
            raise _Unclear
        if isinstance(value.at, _Elements):
            total = value.at.elements[0].at("")
            for one in value.at.elements[1:]:
                total = _sum2(total, one.at(""))
            return _Value(value.is_complex, lambda _index: total)
        index, size = self.around.index(), value.size
        parts = value.at(index)
        made = tuple(f"sum({{{part} for {index} in 1:{size}}})" if part else "" for part in parts)
        return _Value(value.is_complex, lambda _index: (made[0], made[1]))

    def _constructed(self, values: Sequence[_Value]) -> _Value:
        if not 1 <= len(values) <= 2 or any(one.size is not None or one.is_complex for one in values):
            raise _Unclear
        imaginary = values[1].at("")[0] if len(values) == 2 else "0"
        return _Value(True, lambda _index: (values[0].at("")[0], imaginary))

    def _math(self, name: str, node: s.Node, arguments: tuple[s.Node, ...]) -> _Value:
        """A function of Modelica.ComplexMath."""
        values = [self.value(one) for one in arguments]
        if name == "sum" and len(values) == 1:
            return self._added(values[0])
        if name == "fromPolar" and len(values) == 2 and not any(one.is_complex for one in values):
            length, angle = values
            sizes = [one.size for one in values if one.size is not None]

            def polar(index: str) -> Parts:
                by, phi = length.at(index)[0], angle.at(index)[0]
                return _product(by, f"cos({phi})"), _product(by, f"sin({phi})")

            return _Value(True, polar, _chosen(sizes) if sizes else None)
        work = _MATH.get(name)
        if work is None or len(values) != 1 or not values[0].is_complex:
            raise _Unclear
        value, found = values[0], work
        is_complex = name in ("conj", "exp")
        return _Value(is_complex, lambda index: found(*value.at(index)), value.size)


def _exponential(re: str, im: str) -> Parts:
    length = "1" if re == "0" else f"exp({re})"
    return _product(length, f"cos({im})"), _product(length, f"sin({im})")


_MATH: Mapping[str, Callable[[str, str], Parts]] = {
    "real": lambda re, _im: (re, ""),
    "imag": lambda _re, im: (im, ""),
    "conj": lambda re, im: (re, _negated(im)),
    "exp": _exponential,
    "abs": lambda re, im: (f"sqrt(({re})^2 + ({im})^2)", ""),
    "arg": lambda re, im: (f"atan2({im}, {re})", ""),
}


def _is_scalar_function(name: str) -> bool:
    return name in (
        "sin",
        "cos",
        "tan",
        "exp",
        "log",
        "sqrt",
        "abs",
        "sign",
        "atan2",
        "atan",
        "der",
        "max",
        "min",
        "noEvent",
    )


def _real(shown: str) -> _Value:
    return _Value(False, lambda _index: (shown, ""))


def _complex(value: _Value, index: str) -> Parts:
    re, im = value.at(index)
    return re, im if value.is_complex else "0"


def _both(work: Callable[[str], str], parts: Parts) -> Parts:
    return work(parts[0]), work(parts[1]) if parts[1] else ""


def _negated(one: str) -> str:
    return one if one == "0" else f"(-{one})"


def _sum(a: str, b: str) -> str:
    return b if a == "0" else a if b == "0" else f"({a} + {b})"


def _difference(a: str, b: str) -> str:
    return _negated(b) if a == "0" else a if b == "0" else f"({a} - {b})"


def _product(a: str, b: str) -> str:
    if "0" in (a, b):
        return "0"
    return b if a == "1" else a if b == "1" else f"{a}*{b}"


def _sum2(a: Parts, b: Parts) -> Parts:
    return _sum(a[0], b[0]), _sum(a[1], b[1])


def _difference2(a: Parts, b: Parts) -> Parts:
    return _difference(a[0], b[0]), _difference(a[1], b[1])


def _product2(a: Parts, b: Parts) -> Parts:
    return (
        _difference(_product(a[0], b[0]), _product(a[1], b[1])),
        _sum(_product(a[0], b[1]), _product(a[1], b[0])),
    )


def _quotient2(a: Parts, b: Parts) -> Parts:
    if b[1] == "0":
        return tuple(one if one == "0" else f"(({one})/({b[0]}))" for one in a)  # type: ignore[return-value]
    re, im = _product2(a, (b[0], _negated(b[1])))
    below = _sum(_product(b[0], b[0]), _product(b[1], b[1]))
    return tuple(one if one == "0" else f"(({one})/({below}))" for one in (re, im))  # type: ignore[return-value]


def _equal(left: _Value, right: _Value, index: str, parts: Sequence[int]) -> str:
    return "; ".join(f"{left.at(index)[k]} = {right.at(index)[k]}" for k in parts)


def _chosen(sizes: Sequence[str]) -> str:
    """The plainest of sizes that must be the same."""
    return min(sizes, key=lambda one: (not one.isdigit(), "size(" in one, len(one)))


def _is_j(around: _Class, path: Sequence[tuple[str, Any]]) -> bool:
    name = ".".join(one for one, _ in path)
    return name == f"{MATH}.j" or around._imported(name) == f"{MATH}.j"


def _is_real(type_name: str, around: _Class) -> bool:
    """Whether a type is one of Real numbers, as Modelica.Units.SI.Voltage."""
    return around.classes.meant(type_name) in ("Real", "Integer", "Boolean")


def _holds_complex(around: _Class, tree: Any) -> bool:
    """Whether a Complex reference or constructor stands somewhere in an expression."""
    return any(_is_complex(around, node) for node in s.nodes(tree))


def _is_complex(around: _Class, node: Any) -> bool:
    if isinstance(node, s.Name | s.Field | s.Index):
        try:
            return bool(around.kind(around.path(node))[0] == COMPLEX)
        except _Unclear:
            return False
    if not isinstance(node, s.Call):
        return False
    full = around.full_function(node.function)
    return full == COMPLEX or full.startswith(MATH + ".")


def _renamed(node: Any, indices: Mapping[str, str]) -> Any:
    """An expression with iterators by other names."""
    if isinstance(node, s.Name) and not node.subscripts and node.name in indices:
        return replace(node, name=indices[node.name])
    return s.rebuilt(node, lambda part: _renamed(part, indices))


def _with_arguments(node: Any, meant: Mapping[str, s.Node]) -> Any:
    """An expression in which names stand for others. Raises _Unclear where an element of what is no reference
    is meant."""
    if isinstance(node, s.Name):
        first, *members = node.name.split(".")
        subscripts = _with_arguments(node.subscripts, meant)
        if first not in meant:
            return replace(node, subscripts=subscripts)
        made = meant[first]
        if (members or subscripts) and not isinstance(made, s.Name | s.Field | s.Index):
            raise _Unclear
        for member in members:
            made = s.Field(made, member)
        if not subscripts:
            return made
        is_bare = isinstance(made, s.Name) and not made.subscripts
        return replace(made, subscripts=subscripts) if is_bare else s.Index(made, subscripts)
    return s.rebuilt(node, lambda part: _with_arguments(part, meant))


def _only_assignment(words: Sequence[Token]) -> Sequence[Token] | None:
    """The right-hand side of the only statement of a function."""
    at = next((i for i, word in enumerate(words) if word.text == "algorithm"), None)
    if at is None:
        return None
    rest = words[at + 1 :]
    end = next((i for i, word in enumerate(rest) if word.text == ";"), len(rest))
    is_last = end + 1 >= len(rest) or rest[end + 1].text == "annotation"
    return rest[2:end] if is_last and len(rest) > 2 and rest[1].text == ":=" else None


def _path_text(path: Sequence[tuple[str, tuple[s.Node, ...]]]) -> str:
    return ".".join(n + (f"[{','.join(map(text, subs))}]" if subs else "") for n, subs in path)


def _parsed(words: Sequence[Token]) -> s.Node:
    parser = Parser(list(words))
    made = parser.expression()
    if parser.next is not None:
        raise ParseError("more than an expression", parser.next)
    return made


def _source(words: Sequence[Token]) -> str:
    return " ".join(word.text for word in words)


def _equals(line: Sequence[Token]) -> int | None:
    """Index of the `=` of an equation."""
    for i, depth in depths(line):
        if line[i].kind == "text":
            return None
        if depth == 0 and line[i].text == "=":
            return i
    return None


_ATTRIBUTES = ("start", "unit", "displayUnit", "min", "max", "nominal", "fixed", "stateSelect", "quantity")


def _modified(words: Sequence[Token]) -> Iterator[tuple[str, Sequence[Token]]]:
    """Names and values, `name = value`, in a modification and those inside of it."""
    i = 0
    while i < len(words):
        if words[i].text != "=":
            i += 1
            continue
        end = find_outside(words, i + 1, ",")
        yield words[i - 1].text, words[i + 1 : end]
        i = end


def _statements(words: Sequence[Token]) -> Iterator[tuple[tuple[str, ...], list[Token]]]:
    """The equations of a class, each with the iterators of the loops around it; none in `when`."""
    line: list[Token] = []
    around: list[tuple[str, str]] = []
    depth, is_in = 0, False
    i = 0
    while i < len(words):
        word = words[i]
        depth += (word.text in OPEN) - (word.text in CLOSE)
        follows = words[i + 1].text if i + 1 < len(words) else ""
        if depth == 0 and not line:
            if word.text == "initial":
                i += 1
                continue
            if word.text in ("equation", "algorithm", "public", "protected"):
                is_in = word.text == "equation"
                i += 1
                continue
            if is_in and word.text == "else":
                i += 1
                continue
            if is_in and word.text == "end" and follows in _ENDS:
                around = around[:-1]
                i += 2
                continue
            if is_in and word.text in (*_ENDS, "elseif", "elsewhen"):
                last = "loop" if word.text == "for" else "then"
                end = next((k for k in range(i, len(words)) if words[k].text == last), len(words))
                if not word.text.startswith("else"):
                    around.append((word.text, follows if word.text == "for" else ""))
                i = end + 1
                continue
        if depth == 0 and word.text == ";":
            if is_in and line and not any(kind == "when" for kind, _ in around):
                yield tuple(name for kind, name in around if kind == "for"), line
            line = []
        else:
            line.append(word)
        i += 1
