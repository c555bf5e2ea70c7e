"""Expressions as readable Modelica text, with no more parentheses than Modelica's precedence needs."""

from __future__ import annotations

import re

from daest.modelica.language import syntax as s

_VARIABLE = re.compile(r"[A-Za-z_][\w.\[\]]*")

_PRECEDENCE = {
    "or": 1,
    "and": 2,
    "not": 3,
    "<": 4,
    "<=": 4,
    ">": 4,
    ">=": 4,
    "==": 4,
    "<>": 4,
    "+": 5,
    "-": 5,
    ".+": 5,
    ".-": 5,
    "*": 6,
    "/": 6,
    ".*": 6,
    "./": 6,
    "^": 7,
    ".^": 7,
}
_ATOM = 9
_LOOSE = 0  # if-expressions and ranges stand alone or in parentheses
_SPACED = ("or", "and", "<", "<=", ">", ">=", "==", "<>", "+", "-", ".+", ".-", ".*", "./", ".^")


def text(node: s.Node) -> str:
    """Modelica text of `node`, e.g. `J*der(w)` or `(a + b)*c`."""
    return _print(node)[0]


def number_text(value: float | int | bool | str) -> str:
    """A number as Modelica writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    return f"{value:.15g}" if float(f"{value:.15g}") == value else repr(value)


def factor_number(value: float) -> str:
    """A factor between units as Modelica writes it, without the rounding of the products that made it.

    >>> factor_number(59999.999999999985), factor_number(0.1)
    ('60000', '0.1')
    """
    return number_text(float(f"{value:.14g}"))


def times_text(factor: float, text: str) -> str:
    """A text times a number, which is left out where it is 1.

    >>> times_text(1.0, "i"), times_text(0.001, "i"), times_text(0.001, "u/R")
    ('i', '0.001*i', '0.001*(u/R)')
    """
    if factor == 1.0:
        return text
    shown = text if _VARIABLE.fullmatch(text) else f"({text})"
    return f"{factor_number(factor)}*{shown}"


def _print(node: s.Node) -> tuple[str, int]:
    """The text and its precedence."""
    match node:
        case s.Constant(value):
            shown = number_text(value)
            return shown, _PRECEDENCE["-"] if shown.startswith("-") else _ATOM
        case s.Name(name, subscripts):
            return name + _brackets(subscripts), _ATOM
        case s.Unary(operator, operand):
            return _unary(operator, operand)
        case s.Binary(operator, left, right):
            return _binary(operator, left, right)
        case s.Conditional(branches, otherwise):
            return _conditional(branches, otherwise), _LOOSE
        case s.Range(start, step, stop):
            parts = [start, stop] if step is None else [start, step, stop]
            return ":".join(_wrapped(part, 5) for part in parts), _LOOSE
        case _:
            return _bracketed(node), _ATOM


def _bracketed(node: s.Node) -> str:
    match node:
        case s.Call(function, arguments):
            return f"{function}({_list(arguments)})"
        case s.Array(elements, is_matrix):
            return _matrix(elements) if is_matrix else "{" + _list(elements) + "}"
        case s.Tuple(elements):
            return "(" + ", ".join("" if e is None else text(e) for e in elements) + ")"
        case s.Comprehension(element, iterators):
            loops = ", ".join(f"{name} in {text(over)}" for name, over in iterators)
            return "{" + f"{text(element)} for {loops}" + "}"
        case s.Index(base, subscripts):
            return _wrapped(base, _ATOM) + _brackets(subscripts)
        case s.Field(base, name):
            return f"{_wrapped(base, _ATOM)}.{name}"
        case s.Colon():
            return ":"
    raise TypeError(f"no text for {type(node).__name__}")


def _list(nodes: tuple[s.Node, ...]) -> str:
    return ", ".join(text(node) for node in nodes)


def _brackets(subscripts: tuple[s.Node, ...]) -> str:
    return "[" + ",".join(text(node) for node in subscripts) + "]" if subscripts else ""


def _matrix(rows: tuple[s.Node, ...]) -> str:
    shown = (_list(row.elements) if isinstance(row, s.Array) else text(row) for row in rows)
    return "[" + "; ".join(shown) + "]"


def _wrapped(node: s.Node, at_least: int) -> str:
    shown, precedence = _print(node)
    return shown if precedence >= at_least else f"({shown})"


def _unary(operator: str, operand: s.Node) -> tuple[str, int]:
    if operator == "not":
        return f"not {_wrapped(operand, _PRECEDENCE['not'] + 1)}", _PRECEDENCE["not"]
    return operator + _wrapped(operand, _PRECEDENCE["*"]), _PRECEDENCE["-"]


def _binary(operator: str, left: s.Node, right: s.Node) -> tuple[str, int]:
    own = _PRECEDENCE[operator]
    # Modelica's operators associate to the left, except that relations and powers do not associate at all.
    loosest_left = own + 1 if own in (4, 7) else own
    shown_left = _wrapped(left, loosest_left)
    shown_right = _wrapped(right, own + 1)
    between = f" {operator} " if operator in _SPACED else operator
    return f"{shown_left}{between}{shown_right}", own


def _conditional(branches: tuple[tuple[s.Node, s.Node], ...], otherwise: s.Node) -> str:
    words = ["if", "elseif"]
    parts = [
        f"{words[min(i, 1)]} {text(condition)} then {text(value)}"
        for i, (condition, value) in enumerate(branches)
    ]
    return " ".join([*parts, f"else {text(otherwise)}"])
