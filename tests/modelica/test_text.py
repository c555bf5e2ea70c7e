"""Expressions as Modelica text: fewest parentheses, same meaning."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daest.modelica.language import syntax as s
from daest.modelica.language.outline import tokens
from daest.modelica.language.parse import Parser
from daest.modelica.language.text import number_text, text


def parsed(source: str) -> s.Node:
    parser = Parser(list(tokens(source.encode())))
    made = parser.expression()
    assert parser.next is None
    return made


@pytest.mark.parametrize(
    "source",
    [
        "a + b*c",
        "(a + b)*c",
        "a - (b - c)",
        "a - b - c",
        "a/b/c",
        "a/(b*c)",
        "a/b*c",
        "-a + b",
        "a - (-b)",
        "a*(-b)",
        "(-a)^2",
        "-a^2",
        "(a^b)^c",
        "a^(-1)",
        "not a and b or c",
        "not (a and b)",
        "(a or b) and c",
        "a + b > c*d",
        "sin(a + b)*f(x, {1, 2})",
        "x[1] + m[1,2]",
        "1e-20*a",
        "0.1 + 2",
    ],
)
def test_text_has_no_more_parentheses_than_needed(source: str) -> None:
    assert text(parsed(source)) == source


_leaves = st.one_of(
    st.sampled_from(["a", "b", "c.d"]).map(s.Name),
    st.floats(min_value=0, max_value=1e12).map(s.Constant),
)


def _grown(inner: st.SearchStrategy[s.Node]) -> st.SearchStrategy[s.Node]:
    operators = st.sampled_from(["+", "-", "*", "/", "^", ".*"])
    return st.one_of(
        st.builds(s.Binary, operators, inner, inner),
        st.builds(s.Unary, st.just("-"), inner),
        st.builds(lambda x: s.Call("sin", (x,), True), inner),
    )


@given(st.recursive(_leaves, _grown, max_leaves=12))
def test_text_read_again_is_the_same_tree(node: s.Node) -> None:
    assert text(parsed(text(node))) == text(node)
    assert parsed(text(node)) == parsed(f"({text(node)})")
    assert _same(parsed(text(node)), node)


def _same(a: s.Node, b: s.Node) -> bool:
    """Equal trees up to whole numbers written without a point."""
    match a, b:
        case s.Constant(x), s.Constant(y):
            return math.isclose(float(x), float(y), rel_tol=1e-15)
        case s.Binary(p, l1, r1), s.Binary(q, l2, r2):
            return p == q and _same(l1, l2) and _same(r1, r2)
        case s.Unary(p, x), s.Unary(q, y):
            return p == q and _same(x, y)
        case s.Call(f, (x,)), s.Call(g, (y,)):
            return f == g and _same(x, y)
    return a == b


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_are_written_exactly(value: float) -> None:
    assert float(number_text(value)) == value
