"""Meaning of expressions and functions, against values computed with NumPy."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from daest.errors import ModelError
from daest.model.flat import FlatModel

Compile = Callable[..., FlatModel]

X, Y = 0.7, -1.3


def value_of(compiled: Compile, expression: str, declarations: str = "") -> np.ndarray:
    """The value of an expression in x = 0.7, y = -1.3, v = {1, 2, 3}·x, time = 0.4 of a compiled model."""
    text = f"""model M {declarations} input Real x, y; parameter Real p = 2; output Real r; Real v[3]; Real
    w[3];
    equation v = {{x, 2*x, 3*x}}; w = {{y, x, 1}}; r = {expression}; end M;"""
    flat = compiled(text)
    v, w = X * np.array([1, 2, 3]), np.array([Y, X, 1])
    arguments = [flat.xi, flat.u, flat.theta, flat.time]
    function = ca.Function("r", arguments, [flat.output_expressions])
    return float(function(np.concatenate([v, w]), [X, Y], flat.theta_values, 0.4))


V, W = X * np.array([1.0, 2.0, 3.0]), np.array([Y, X, 1.0])
A = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("x^2 - y/x + time*p", X**2 - Y / X + 0.4 * 2),
        ("-x^2", -(X**2)),
        ("2^(-x)", 2**-X),
        ("sin(x) + cos(y) + tan(x)", math.sin(X) + math.cos(Y) + math.tan(X)),
        ("asin(x) + acos(x) + atan(y)", math.asin(X) + math.acos(X) + math.atan(Y)),
        ("atan2(y, x)", math.atan2(Y, X)),
        ("sinh(x) + cosh(y) + tanh(x)", math.sinh(X) + math.cosh(Y) + math.tanh(X)),
        ("exp(y) + log(x) + log10(x)", math.exp(Y) + math.log(X) + math.log10(X)),
        ("sqrt(x) + abs(y) + sign(y)", math.sqrt(X) + abs(Y) - 1),
        ("min(x, y) + max(x, y)", X + Y),
        ("min(v) + max(w) + min({x, y, 3})", X + 1 + Y),
        ("semiLinear(y, 3, 5)", 5 * Y),
        ("smooth(1, noEvent(if x > 0 then x else 0))", X),
        ("homotopy(actual = x, simplified = y)", X),
        ("if y > 0 then 1 elseif x > 0.5 and not y > 1 then 2 else 3", 2),
        ("if x < 0 or y < 0 then x else y", X),
        (
            "div(7, 2) + mod(-7, 3) + rem(-7, 3) + floor(-1.5) + ceil(1.5) + integer(2.7)",
            3 + 2 - 1 - 2 + 2 + 2,
        ),
        ("5/2", 2.5),
        ("sum(v) + product(w)", V.sum() + W.prod()),
        ("v*w", V @ W),
        ("sum({{1,2,3},{4,5,6}}*v)", (A @ V).sum()),
        ("sum(v*transpose({{1,2,3},{4,5,6}}))", (V @ A.T).sum()),
        ("sum(transpose({{1,2,3},{4,5,6}})*{{1,2,3},{4,5,6}})", (A.T @ A).sum()),
        ("cross(v, w)*{1, 10, 100}", np.cross(V, W) @ [1, 10, 100]),
        ("sum(i^2*v[i] for i in 1:3)", (np.array([1, 4, 9]) * V).sum()),
        ("sum({i*j for i in 1:2, j in 1:3})", 18),
        ("v[2:3]*w[1:2]", V[1] * W[0] + V[2] * W[1]),
        ("v[end] + w[end - 1]", V[2] + W[1]),
        ("size(v, 1) + size({{1,2},{3,4},{5,6}}, 2)", 5),
        ("sum(linspace(0, x, 5))", 2.5 * X),
        ("sum(zeros(2, 3)) + sum(ones(2)) + sum(fill(x, 4))", 2 + 4 * X),
        ("sum(identity(3)*v) + sum(diagonal(v)*w)", V.sum() + V @ W),
        ("sum([x, y; 1, 2]*{1, 10})", X + 10 * Y + 1 + 20),
        ("sum(v .* w ./ {1, 2, 4} .^ 2)", (V * W / np.array([1, 2, 4]) ** 2).sum()),
        ("sum(cat(1, v, {1, 2})) + sum(-v + 2*w)", V.sum() + 3 + (-V + 2 * W).sum()),
        ("sum(skew(v)*w)", np.cross(V, W).sum()),
        ("sum(sin(v))", np.sin(V).sum()),
    ],
)
def test_expression(compiled: Compile, expression: str, expected: float) -> None:
    assert value_of(compiled, expression) == pytest.approx(expected, rel=1e-13, abs=1e-13)


FUNCTIONS = {
    "square": (
        "function f input Real a; output Real b; algorithm b := a*a; end f;",
        "f(x) + f(y)",
        X**2 + Y**2,
    ),
    "loop over an array of any size": (
        "function f input Real a[:]; output Real b; algorithm b := 0;"
        " for i in 1:size(a, 1) loop b := b + i*a[i]; end for; end f;",
        "f(v)",
        V @ [1, 2, 3],
    ),
    "Horner's rule": (
        "function f input Real a; output Real b; algorithm b := 0; for i in 1:4 loop b := b*a + i; end "
        "for; end f;",
        "f(x)",
        ((X + 2) * X + 3) * X + 4,
    ),
    "symbolic if": (
        "function f input Real a; output Real b; algorithm if a > 0 then b := sqrt(a); elseif a > -1 then "
        "b := 1;"
        " else b := a^2; end if; end f;",
        "f(x) + 10*f(y)",
        math.sqrt(X) + 10 * Y**2,
    ),
    "locals, defaults and several results": (
        "function f input Real a; input Real k = 3; output Real b; output Real c; protected Real t = a*k;"
        " algorithm b := t + 1; c := 2*t; end f;"
        "function g input Real a; output Real b; protected Real c; Real d; algorithm (c, d) := f(a, 2); b "
        ":= c + d;"
        " end g;",
        "f(x) + g(y)",
        3 * X + 1 + (2 * Y + 1) + 4 * Y,
    ),
    "while, break and return on constants": (
        "function f input Real a; output Real b; protected Integer n = 0; algorithm b := a; while true loop"
        " n := n + 1; b := b*a; if n >= 3 then break; end if; end while; if n == 3 then return; end if; b "
        ":= 0;"
        " end f;",
        "f(x)",
        X**4,
    ),
    "several iterators, array elements, a call of another function": (
        "function g input Real a; output Real b; output Real c; algorithm b := a^2; c := 1; end g;"
        "function f input Real a; output Real s; output Real[2] t; protected Real h; Real k; algorithm s "
        ":= 0;"
        " t := zeros(2); for i in 1:2, j in {1, 3} loop (h, k) := g(a); t[i] := t[i] + j*h + (if i > 1 "
        "then k else"
        " 0); end for; s := sum(t[i]*i for i in 1:2) + t[1:2]*{1, 10}; end f;",
        "f(x)",
        (4 * X**2 + 2 * (4 * X**2 + 2)) + (4 * X**2 + 10 * (4 * X**2 + 2)),
    ),
    "record argument of a function with while": (
        "record R Real a; Real b; end R; function f input R q; output Real y; protected Integer i = 1;"
        " algorithm y := q.a; while i < 3 loop y := y*q.b; i := i + 1; end while; end f;",
        "f(R(x, y))",
        X * Y**2,
    ),
    "recursion on a constant": (
        "function f input Integer n; output Real b; algorithm if n <= 1 then b := 1; else b := n*f(n - 1); "
        "end if;"
        " end f;",
        "f(5)*x",
        120 * X,
    ),
    "array result": (
        "function f input Real a; output Real b[2]; algorithm b[1] := a; b[2] := 2*a; end f;",
        "f(x)*{1, 10}",
        21 * X,
    ),
    "record argument": (
        "record R Real a; Real b; end R; function f input R q; output Real c; algorithm c := q.a - q.b; "
        "end f;",
        "f(R(x, y))",
        X - Y,
    ),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function(compiled: Compile, name: str) -> None:
    declarations, expression, expected = FUNCTIONS[name]
    assert value_of(compiled, expression, declarations) == pytest.approx(expected, rel=1e-13)


def test_several_results_in_an_equation(compiled: Compile) -> None:
    flat = compiled(
        "model M function f input Real a; output Real b; output Real c[2]; algorithm b := a; c := {2*a, "
        "3*a}; end f;"
        " Real s, t[2]; equation (s, t) = f(time); end M;"
    )
    residual = ca.Function("r", [flat.xi, flat.time], [flat.residual])
    np.testing.assert_allclose(residual([1, 2, 3], 1).full().ravel(), 0)
    np.testing.assert_allclose(residual([1, 2, 3], 2).full().ravel(), [-1, -2, -3])


def test_records(compiled: Compile) -> None:
    flat = compiled(
        "model M record R Real a; Real b; end R; R q, p; equation q = R(1, b = 2*time); p = q; end M;"
    )
    assert [x.name for x in flat.unknowns] == ["q.a", "q.b", "p.a", "p.b"]
    residual = ca.Function("r", [flat.xi, flat.time], [flat.residual])
    np.testing.assert_allclose(residual([1, 6, 1, 6], 3).full().ravel(), 0)


def test_component_arrays(compiled: Compile) -> None:
    flat = compiled(
        """model M model C Real x; parameter Real k = 1; equation x = k*time; end C; C c[3](k = {1, 2, 3});
        Real s, t[3], g[3]; equation s = sum(c.x) + c[2].x; t = c.x; for i in 1:3 loop g[i] = c[i].x + i;
        end for;
        end M;"""
    )
    residual = ca.Function("r", [flat.xi, flat.theta, flat.time], [flat.residual])
    solution = {"c[1].x": 1, "c[2].x": 2, "c[3].x": 3, "s": 8, "t[1]": 1, "t[2]": 2, "t[3]": 3}
    solution |= {"g[1]": 2, "g[2]": 4, "g[3]": 6}
    xi = [solution[x.name] for x in flat.unknowns]
    np.testing.assert_allclose(residual(xi, flat.theta_values, 1).full().ravel(), 0, atol=1e-15)


def test_booleans_integers_and_enumerations_are_put_in(compiled: Compile) -> None:
    flat = compiled(
        """model M type E = enumeration(one, two); parameter E e = E.two; input Real x; output Real y;
        Boolean high = x > 3; Boolean b; Integer i; Real z(start = 1);
        equation b = high or z < 0; i = if b then 2 else 5; der(z) = if e == E.one then 1 else -z;
        y = if high then i else -i; end M;"""
    )
    assert [v.name for v in flat.unknowns] == ["z"]
    h = ca.Function("h", [flat.xi, flat.u], [flat.output_expressions])
    assert [float(h(z, x)) for z, x in ((1, 4), (1, 2), (-1, 2))] == [2, -5, -2]
    assert flat.equations[0].text == "der(z) = -z"


def test_if_equations(compiled: Compile) -> None:
    flat = compiled(
        "model M parameter Boolean linear = false; Real x(start = 1), w; equation if linear then w = x; else"
        " w = x^2; end if; if w > 1 then der(x) = -x; else der(x) = -2*x; end if; end M;"
    )
    assert [e.text for e in flat.equations] == ["w = x^2", "der(x) = if w > 1 then -x else -2*x"]
    residual = ca.Function("r", [flat.derivatives, flat.xi], [flat.residual])
    np.testing.assert_allclose(residual([-2, 0], [2, 4]).full().ravel(), 0)
    np.testing.assert_allclose(residual([-1, 0], [0.5, 0.25]).full().ravel(), 0)


def test_derivatives_stay_finite_in_a_branch_that_is_not_taken(compiled: Compile) -> None:
    flat = compiled("model M Real h(start = 1); equation der(h) = if h > 0 then -sqrt(h) else 0; end M;")
    slope = ca.Function("j", [flat.xi], [ca.jacobian(flat.residual, flat.xi)])
    assert float(slope(-1)) == 0 and float(slope(0)) == 0
    assert float(slope(4)) == pytest.approx(0.25)


@pytest.mark.parametrize("inside", ["2*max(h, 0)", "max(0, h)*p", "max(h, 0)/p", "2*9.81*(p*max(h, 0))"])
@pytest.mark.parametrize("level", [0.0, -0.1])
def test_a_root_of_a_clipped_factor_has_no_infinite_slope(compiled, inside, level):
    flat = compiled(
        f"model M parameter Real p = 3; Real h(start = 1); equation der(h) = -sqrt({inside}); end M;"
    )
    slope = ca.Function("s", [flat.xi, flat.derivatives, flat.theta], [ca.jacobian(flat.residual, flat.xi)])
    assert float(slope(level, 0.0, flat.theta_values)) == 0.0
    assert abs(float(slope(0.25, 0.0, flat.theta_values))) > 0.5


def test_a_root_is_clipped_by_its_numerator_alone(compiled):
    flat = compiled("model M Real h(start = 1); equation der(h) = -sqrt(1/max(h, 0)); end M;")
    value = ca.Function("s", [flat.xi, flat.derivatives, flat.theta], [flat.residual])
    assert abs(float(value(0.25, 0.0, flat.theta_values))) == pytest.approx(2.0)
    assert not np.isfinite(float(value(0.0, 0.0, flat.theta_values)))


def test_algorithm_section_of_assignments_and_conditionals(compiled: Compile) -> None:
    flat = compiled(
        "model M input Real x; output Real y; Real t; algorithm t := 2*x; algorithm if x > 3 then y := t;"
        " else y := t + 1; end if; end M;"
    )
    residual = ca.Function("r", [flat.xi, flat.u], [flat.residual])
    outputs = ca.Function("h", [flat.xi, flat.u], [flat.output_expressions])
    names = [x.name for x in flat.unknowns]
    for x, y in ((1.0, 3.0), (4.0, 8.0)):
        xi = [{"t": 2 * x, "y": y}[name] for name in names]
        np.testing.assert_allclose(residual(xi, x).full().ravel(), 0)
        assert float(outputs(xi, x)) == y


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("model M parameter Real p = 1/0; Real x; equation x = p; end M;", "model-arithmetic"),
        ("model M parameter Real p = sqrt(-1); Real x; equation x = p; end M;", "model-arithmetic"),
        ("model M parameter Real p = q, q = p; Real x; equation x = p; end M;", "model-circular"),
    ],
)
def test_constants_that_cannot_be_computed(compiled: Compile, text: str, code: str) -> None:
    with pytest.raises(ModelError) as caught:
        compiled(text)
    assert caught.value.code in (code, "model-compile")
