"""Legal forms of modifications (Language Specification, chapter 7), records, arrays, `outer` variables, and
what they mean, worked out by hand."""

from __future__ import annotations

import contextlib
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from daest.errors import ModelError
from daest.modelica.compile import compile_text, with_own_forms, with_own_modifications
from daest.systems.simulation.simulate import simulate

PART = """model Part
  parameter Real k(min = 0, unit = "N") = 2;
  parameter Real d = 1;
  Real x(start = 1, fixed = true);
equation
  der(x) = -d*x + 0*k;
end Part;
model Free
  Real x;
equation
  der(x) = -x;
end Free;
model Around
  Part b;
end Around;
"""
LAWS = """package Laws
  partial model Law
    parameter Real g = 1;
    parameter Real h = 1;
    input Real w;
    output Real t;
  end Law;
  model A
    extends Law;
  equation
    t = g*h*w;
  end A;
  model Q
    extends Law;
    parameter Real c = 2;
  equation
    t = c*g*h*w;
  end Q;
  model Drive
    replaceable model F = A(h = 3) constrainedby Law(g(max = 8) = 3, h = 2);
    F a(w = x);
    Real x(start = 1, fixed = true);
  equation
    der(x) = -a.t;
  end Drive;
  model Component
    replaceable A a "declared" constrainedby Law(g(max = 8) = 3, h = 2) "wanted";
    Real x(start = 1, fixed = true);
  equation
    a.w = x;
    der(x) = -a.t;
  end Component;
end Laws;
"""


def facts(text: str, name: str = "M") -> dict[str, dict[str, Any]]:
    """What the compiled model says of its parameters and unknowns."""
    flat = compile_text(text.encode(), Path("M.mo"), name)
    known = {p.name: {"value": p.value, "min": p.min, "max": p.max, "unit": p.unit} for p in flat.parameters}
    for x in flat.unknowns:
        known[x.name] = {
            "start": x.start, "fixed": x.fixed, "min": x.min, "max": x.max, "nominal": x.nominal
        }  # fmt: skip
    return known


def assert_facts(text: str, expected: dict[str, dict[str, Any]], name: str = "M") -> None:
    known = facts(text, name)
    for variable, wanted in expected.items():
        assert wanted == {key: known[variable][key] for key in wanted}, variable


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("Around c(b.k = 7);", {"c.b.k": {"value": 7.0, "min": 0.0, "unit": "N"}}),
        ("Around c(b.x.start = 4);", {"c.b.x": {"start": 4.0, "fixed": True}}),
        ("Part b(k.max = 9, d = 3);", {"b.k": {"value": 2.0, "min": 0.0, "max": 9.0}, "b.d": {"value": 3.0}}),
        (
            "Around c(b.k = 7, b.d.max = 8, b(x(nominal = 3)), b.x.start = 4);",
            {
                "c.b.k": {"value": 7.0, "min": 0.0},
                "c.b.d": {"value": 1.0, "max": 8.0},
                "c.b.x": {"start": 4.0, "nominal": 3.0},
            },
        ),
        ("extends Around(b.k = 7, b.x(start = 4));", {"b.k": {"value": 7.0}, "b.x": {"start": 4.0}}),
        (
            "Around c[2](each b.k = 7, b.x.start = {3, 4});",
            {"c[2].b.k": {"value": 7.0}, "c[1].b.x": {"start": 3.0}, "c[2].b.x": {"start": 4.0}},
        ),
        (
            'Around c(b.k = 3, // b.k = 5\n b.d = 2) "c(b.k = 6)", e(b.k = 4);',
            {"c.b.k": {"value": 3.0}, "c.b.d": {"value": 2.0}, "e.b.k": {"value": 4.0}},
        ),
    ],
)
def test_dotted_names_in_modifications_arrive(model: str, expected: dict[str, dict[str, Any]]) -> None:
    assert_facts(f"{PART}model M\n  {model}\nend M;\n", expected)


def test_a_short_class_with_dotted_names() -> None:
    short = "model Short = Around(b.k = 7, b.x.start = 3);"
    text = f"{PART}{short}\nmodel M\n  Short c(b.x(fixed = false));\nend M;\n"
    assert_facts(text, {"c.b.k": {"value": 7.0}, "c.b.x": {"start": 3.0, "fixed": False}})


def test_a_call_with_named_arguments_is_no_modification() -> None:
    text = """package P
  package F
    function f
      input Real x;
      input Real a = 1;
      output Real y;
    algorithm
      y := x*a;
    end f;
  end F;
  model Part
    parameter Real k = 1;
    Real x(start = k, fixed = true);
  equation
    der(x) = 0;
  end Part;
  model M
    Part b(k = F.f(F.f(x = 2, a = 3), a = 4));
  end M;
end P;
"""
    assert_facts(text, {"b.x": {"start": 24.0}}, "P.M")


@pytest.mark.parametrize(
    ("base", "clause", "expected"),
    [
        ("Free b(x(start = 1, fixed = true))", "b(x(start = 5))", {"b.x": {"start": 5.0, "fixed": True}}),
        ("Part b(k(max = 8) = 3)", "b(k(min = 1))", {"b.k": {"value": 3.0, "min": 1.0, "max": 8.0}}),
        ("Part b(k(max = 8) = 3)", "b(k = 4)", {"b.k": {"value": 4.0, "min": 0.0, "max": 8.0}}),
        ("Part b(k = 3, d = 5)", "b(k(max = 8))", {"b.k": {"value": 3.0, "max": 8.0}, "b.d": {"value": 5.0}}),
        ("Around b(b(d = 5))", "b(b(k = 4))", {"b.b.d": {"value": 5.0}, "b.b.k": {"value": 4.0}}),
        (
            "Part b[2](k = {3, 4}, each x(fixed = true, nominal = 7))",
            "b(x(start = {5, 6}))",
            {"b[2].k": {"value": 4.0}, "b[2].x": {"start": 6.0, "fixed": True, "nominal": 7.0}},
        ),
    ],
)
def test_what_a_base_class_says_of_a_part_stays(
    base: str, clause: str, expected: dict[str, dict[str, Any]]
) -> None:
    """An extends clause replaces what it names, and nothing else."""
    classes = f"{PART}model Base\n  {base};\nend Base;\n"
    assert_facts(f"{classes}model M\n  extends Base({clause});\nend M;\n", expected)
    assert_facts(f"{classes}model M = Base({clause});\n", expected)
    between = f"model Between\n  extends Base({clause});\nend Between;\nmodel M\n  extends Between;\nend M;\n"
    assert_facts(classes + between, expected)


@pytest.mark.parametrize(
    ("part", "clause", "expected"),
    [
        (
            "Part b",
            'b(k(unit = "kg.m2/rad", max = 9, displayUnit = "g") = 3)',
            {"b.k": {"value": 3.0, "min": 0.0, "max": 9.0, "unit": "kg.m2/rad"}},
        ),
        (
            "Row b",
            'b(w(each unit = "N", each max = 9) = {3, 4})',
            {"b.w[2]": {"value": 4.0, "max": 9.0, "unit": "N"}},
        ),
        ("Part b[2]", "b(each k(max = 9) = 3)", {"b[2].k": {"value": 3.0, "min": 0.0, "max": 9.0}}),
        ("Part b[2]", "b(k(each max = 9) = {3, 4})", {"b[2].k": {"value": 4.0, "max": 9.0}}),
        ("Part b[2]", "b(k(max = {8, 9}) = {3, 4})", {"b[1].k": {"value": 3.0, "max": 8.0}}),
        ("Row b", "b(w(max = {8, 9}) = {3, 4})", {"b.w[2]": {"value": 4.0, "min": 0.0, "max": 9.0}}),
        ("Row b(w(each max = 9))", "b(w = {3, 4})", {"b.w[2]": {"value": 4.0, "min": 0.0, "max": 9.0}}),
    ],
)
def test_arrays_keep_values_and_attributes(
    part: str, clause: str, expected: dict[str, dict[str, Any]]
) -> None:
    row = "model Row\n  parameter Real w[2](each min = 0) = {1, 2};\nend Row;\n"
    classes = f"{PART}{row}model Base\n  {part};\nend Base;\n"
    assert_facts(f"{classes}model M\n  extends Base({clause});\n  Part other;\nend M;\n", expected)


def test_inherited_values_mean_what_they_mean_in_their_class() -> None:
    text = """package P
  package Inner
    constant Real g = 3;
    model Part
      parameter Real k(max = 99) = 1;
      Real x(start = k, fixed = true);
    equation
      der(x) = 0;
    end Part;
    model Base
      parameter Real q = 2;
      Part b(k = q*g);
    end Base;
  end Inner;
  model M
    extends Inner.Base(b(k(min = -4)));
  end M;
end P;
"""
    assert_facts(text, {"b.x": {"start": 6.0}}, "P.M")


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("Drive d;", {"d.a.g": (3.0, 8.0), "d.a.h": (3.0, None)}),
        (
            "Drive d(redeclare model F = Q(c = 4));",
            {"d.a.g": (3.0, 8.0), "d.a.h": (2.0, None), "d.a.c": (4.0, None)},
        ),
        (
            "Drive d(redeclare model F = Q);",
            {"d.a.g": (3.0, 8.0), "d.a.h": (2.0, None), "d.a.c": (2.0, None)},
        ),
        ("extends Drive(redeclare replaceable model F = Q(g = 7));", {"a.g": (7.0, 8.0), "a.h": (2.0, None)}),
        ("Component d;", {"d.a.g": (3.0, 8.0), "d.a.h": (2.0, None)}),
        ("Component d(a(h = 7));", {"d.a.g": (3.0, 8.0), "d.a.h": (7.0, None)}),
        ("Component d(redeclare Q a(c = 4));", {"d.a.g": (3.0, 8.0), "d.a.c": (4.0, None)}),
    ],
)
def test_modifications_of_constraining_classes_count(model: str, expected: dict[str, tuple]) -> None:
    """Language Specification 7.3.2: they hold for the class that is declared and for any in its place."""
    text = LAWS.replace("end Laws;", f"  model M\n    {model}\n  end M;\nend Laws;")
    known = facts(text, "Laws.M")
    assert {name: (known[name]["value"], known[name]["max"]) for name in expected} == expected


def test_a_constraint_with_a_variable_is_told_where_it_cannot_be_kept() -> None:
    text = LAWS.replace("Law(g(max = 8) = 3, h = 2);", "Law(g = x);", 1)
    text = text.replace("end Laws;", "  model M\n    Drive d(redeclare model F = Q);\n  end M;\nend Laws;")
    with pytest.raises(ModelError, match="modified with `x`") as caught:
        compile_text(text.encode(), Path("M.mo"), "Laws.M")
    line = text[: text.index("redeclare model F = Q")].count("\n") + 1
    assert str(caught.value.where) == f"M.mo:{line}:13"


def test_places_do_not_move() -> None:
    line = "  Around c(b.k = 7, b.d = 3); Real y = c.b.x; Part e(zz.k = 4);"
    with pytest.raises(ModelError) as caught:
        compile_text(f"{PART}model M\n{line}\nend M;\n".encode(), Path("M.mo"), "M")
    assert str(caught.value.where) == f"M.mo:{PART.count(chr(10)) + 2}:{line.index('zz') + 1}"
    line = line.partition(" Part")[0]
    flat = compile_text(f"{PART}model M\n{line}\nend M;\n".encode(), Path("M.mo"), "M")
    (place,) = [x.place for x in flat.unknowns if x.name == "y"]
    assert place is not None and place.column == line.index("y =") + 1


RECORDS = """package P
  record A
    Real a = 1;
    Real c(max = 99, unit = "m") = 10;
  end A;
  record R
    A s(a = 5);
    Real b = 2;
  end R;
  constant A table(a = 6, c = 3);
  model Part
    parameter A r(a = 5);
    Real z(start = 0, fixed = true);
  equation
    der(z) = r.a*r.c;
  end Part;
  model Nested
    parameter R r;
    Real z(start = 0, fixed = true);
  equation
    der(z) = r.s.a*r.s.c*r.b;
  end Nested;
  model M
    MODEL
  end M;
end P;
"""
ARRAYS = """package P
  constant Integer three = 3;
  package Sizes
    constant Integer n = three;
    constant Integer two = 2;
  end Sizes;
  function scaled
    input Real x;
    input Real k = 1;
    output Real y;
  algorithm
    y := k*x;
  end scaled;
  function squared
    input Real x;
    output Real y;
  algorithm
    y := x^2;
  end squared;
  type Vector = Real[3];
  function dot
    input Vector a;
    input Vector b;
    output Real y;
  algorithm
    y := a*b;
  end dot;
  model Part
    parameter Real k = 1;
    Real z(start = 0, fixed = true);
  equation
    der(z) = k;
  end Part;
  model M
    parameter Integer n = 3;
    MODEL
  end M;
end P;
"""
OUTER = """package P
  type Temperature = Real(unit = "K");
  model Part
    outer Temperature T;
    outer parameter Real k;
    Real z(start = 0, fixed = true);
  equation
    der(z) = k*T;
  end Part;
  model Group
    Part b;
  end Group;
  model Shadow
    inner Temperature T = 10;
    Part b;
  end Shadow;
  model M
    inner Temperature T = 2;
    inner parameter Real k(max = 9) = 3;
    Group g;
    Shadow s;
    Part own;
    Real y = g.b.T + own.k;
  end M;
end P;
"""


def after_a_second(text: str) -> dict[str, float]:
    """The variables of P.M at 1 s."""
    run = simulate(
        compile_text(text.encode(), Path("P.mo"), "P.M"), (np.linspace(0.0, 1.0, 3), np.zeros((3, 0)))
    )
    return dict(zip(run.variable_names, run.variables[-1].tolist(), strict=True))


def assert_after_a_second(text: str, expected: dict[str, float]) -> None:
    found = after_a_second(text)
    assert {name: found[name] for name in expected} == pytest.approx(expected)


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("Part p;", {"p.z": 50.0}),
        ("Part p(r(c = 2));", {"p.z": 10.0}),
        ("Part p(r = A(a = 6));", {"p.z": 60.0}),
        ("Part p(r = A(6, 3));", {"p.z": 18.0}),
        ("Part p(r = table);", {"p.z": 18.0}),
        ("parameter A q(a = 7, c = 2); Part p(r = q);", {"p.z": 14.0}),
        ("extends Part(r = A(a = 6));", {"z": 60.0}),
        ("Nested p;", {"p.z": 100.0}),
        ("Nested p(r(s(a = 9)));", {"p.z": 180.0}),
        ("Nested p(r(s = A(a = 6)));", {"p.z": 120.0}),
        ("Nested p(r = R(b = 3));", {"p.z": 150.0}),
        ("Nested p(r = R(s = A(a = 6, c = 1), b = 1));", {"p.z": 6.0}),
    ],
)
def test_a_record_takes_the_value_that_it_is_given(model: str, expected: dict[str, float]) -> None:
    assert_after_a_second(RECORDS.replace("MODEL", model), expected)


@pytest.mark.parametrize("given", ["(each d = 3, J = {1, 2})", " = {Wheel(1, 3), Wheel(2, 3)}"])
def test_a_loop_reads_an_array_of_records_that_is_a_parameter(given: str) -> None:
    source = f"""
package P
  model M
  record Wheel
    parameter Real J = 9;
    parameter Real d = 9;
  end Wheel;
  parameter Wheel wheel[2]{given};
  Real y[2](start = {{0, 0}}, each fixed = true);
equation
  for i in 1:2 loop
    wheel[i].J*der(y[i]) = wheel[i].d;
  end for;
  end M;
end P;
"""
    assert_after_a_second(source, {"y[1]": 3.0, "y[2]": 1.5})


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("Part p[n](k = {i for i in 2:2:6});", {"p[1].z": 2.0, "p[2].z": 4.0, "p[3].z": 6.0}),
        ("Part p[n](k = {10*i for i in 3:-1:1});", {"p[1].z": 30.0, "p[3].z": 10.0}),
        ("Part p[n](k = {i^2 for i in {2, 4, 6}});", {"p[1].z": 4.0, "p[2].z": 16.0, "p[3].z": 36.0}),
        ("Part p[n](z(start = {i for i in 2:2:6}));", {"p[2].z": 5.0}),
        ("Part p[n](k = 1:n);", {"p[1].z": 1.0, "p[3].z": 3.0}),
        ("Part p[n](k = linspace(1, 5, n));", {"p[2].z": 3.0, "p[3].z": 5.0}),
        ("Real x[2, 3] = {i + 10*j for i in 1:3, j in 1:2};", {"x[1,3]": 13.0, "x[2,1]": 21.0}),
        ("Real y[2] = scaled({1, 2}, {3, 4});", {"y[1]": 3.0, "y[2]": 8.0}),
        ("Real y[2] = squared({3, 4}); Real s = sum(squared({1, 2}));", {"y[2]": 16.0, "s": 5.0}),
        ("Real y = dot({1, 2, 3}, {4, 5, 6});", {"y": 32.0}),
    ],
)
def test_arrays_have_the_elements_that_they_should(model: str, expected: dict[str, float]) -> None:
    assert_after_a_second(ARRAYS.replace("MODEL", model), expected)


@pytest.mark.parametrize("size", ["Sizes.two", "P.Sizes.two", "three - 1"])
def test_constants_of_packages_are_sizes(size: str) -> None:
    model = f"Real x[{size}](each start = 1, each fixed = true); equation der(x) = zeros({size});"
    found = after_a_second(ARRAYS.replace("MODEL", model))
    assert found == pytest.approx({"x[1]": 1.0, "x[2]": 1.0})


def test_an_outer_variable_is_the_inner_one() -> None:
    assert_after_a_second(OUTER, {"g.b.z": 6.0, "own.z": 6.0, "s.b.z": 30.0, "y": 5.0})
    known = facts(OUTER, "P.M")
    assert known["k"]["value"] == 3.0 and known["k"]["max"] == 9.0 and "own.k" not in known


CHAIN = """package P
  connector Pin
    Real v;
    flow Real i;
  end Pin;
  model Resistor
    Pin p;
    Pin n;
    parameter Real r = 1;
  equation
    p.v - n.v = r*p.i;
    p.i + n.i = 0;
  end Resistor;
  model Source
    Pin p;
    parameter Real v = 0;
  equation
    p.v = v;
  end Source;
  model Chain
    parameter Integer n = 2;
    parameter Real r0 = 1;
    Resistor r[n](each r = r0);
    Pin p;
    Pin q;
  equation
    connect(p, r[1].p);
    for i in 1:n - 1 loop
      connect(r[i].n, r[i + 1].p);
    end for;
    connect(r[end].n, q);
  end Chain;
  model M
    Chain c(n = 4, r0 = 0.5);
    Source s(v = 4);
    Source g;
    Real last = c.r[end].p.i;
  equation
    connect(s.p, c.p);
    connect(c.q, g.p);
  end M;
end P;
"""
PACKAGES = """package P
  package Water
    constant Real rho = 1000;
    constant Integer n = 1;
    function h
      input Real T;
      output Real y;
    algorithm
      y := 4*T;
    end h;
  end Water;
  package Oil
    extends Water(rho = 800, n = 2);
  end Oil;
  package Air = Water(rho = 1, n = 3);
  model Part
    replaceable package Medium = Water;
    Real x[Medium.n] = fill(Medium.rho, Medium.n);
    Real y = Medium.h(2);
  end Part;
  model Group
    Part inside;
  end Group;
  model M
    Part oil(redeclare package Medium = Oil);
    Part plain;
    Part air(redeclare package Medium = Air);
    Part heavy(redeclare package Medium = Water(rho = 2000));
    Group group;
  end M;
end P;
"""


def test_the_end_of_an_array_of_components_is_its_last_one() -> None:
    """Four times 0.5 at 4 between the ends."""
    assert_after_a_second(CHAIN, {"c.p.i": 2.0, "s.p.i": -2.0, "last": 2.0})


def test_a_redeclared_package_is_that_of_one_component() -> None:
    expected = {"oil.x[2]": 800.0, "plain.x[1]": 1000.0, "air.x[3]": 1.0, "heavy.x[1]": 2000.0}
    assert_after_a_second(PACKAGES, {**expected, "group.inside.x[1]": 1000.0, "plain.y": 8.0})


def test_a_modified_class_may_stand_for_one_with_the_same_base() -> None:
    text = LAWS.replace(" constrainedby Law(g(max = 8) = 3, h = 2);", ";", 1)
    model = "Drive a; Drive b(redeclare model F = Q(c = 5));"
    text = text.replace("end Laws;", f"  model M\n    {model}\n  end M;\nend Laws;")
    known = facts(text, "Laws.M")
    assert known["b.a.c"]["value"] == 5.0 and known["a.a.h"]["value"] == 3.0


REDECLARED = {
    "function": (
        "function f0 input Real x; output Real y; algorithm y := x/3; end f0;"
        " function f5 input Real x; output Real y; algorithm y := 5*x/3; end f5;"
        " model B replaceable function F = f0; Real t = F(3); end B;",
        "redeclare function F = f5",
    ),
    "package": (
        "package A constant Real g = 1; end A; package A5 extends A(g = 5); end A5;"
        " model B replaceable package F = A; Real t = F.g; end B;",
        "redeclare package F = A5",
    ),
    "model": (
        "partial model I Real t; end I; model A extends I; equation t = 1; end A;"
        " model A5 extends I; equation t = 5; end A5;"
        " model B replaceable model F = A constrainedby I; F f; Real t = f.t; end B;",
        "redeclare model F = A5",
    ),
    "component": (
        "partial model I Real t; end I; model A extends I; equation t = 1; end A;"
        " model A5 extends I; equation t = 5; end A5;"
        " model B replaceable A f constrainedby I; Real t = f.t; end B;",
        "redeclare A5 f",
    ),
    "record": (
        "record A Real a = 1; end A; record A5 extends A(a = 5); end A5;"
        " model B replaceable record F = A; parameter F f; Real t = f.a; end B;",
        "redeclare record F = A5",
    ),
}


@pytest.mark.parametrize("kind", REDECLARED)
@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("B p(CHANGE); B q; C r;", {"p.t": 5.0, "q.t": 1.0, "r.b.t": 1.0}),
        ("C p(b(CHANGE)); C q; B r;", {"p.b.t": 5.0, "q.b.t": 1.0, "r.t": 1.0}),
        ("D p(c(b(CHANGE))); D q;", {"p.c.b.t": 5.0, "q.c.b.t": 1.0}),
        ("extends C(b(CHANGE)); B r;", {"b.t": 5.0, "r.t": 1.0}),
        ("extends B(CHANGE); B q; C r;", {"t": 5.0, "q.t": 1.0, "r.b.t": 1.0}),
        ("extends B; CHANGE; B q; C r;", {"t": 5.0, "q.t": 1.0, "r.b.t": 1.0}),
        ("B p[2](EACH);", {"p[1].t": 5.0, "p[2].t": 5.0}),
    ],
)
def test_a_redeclaration_is_that_of_one_component(kind: str, model: str, expected: dict[str, float]) -> None:
    classes, change = REDECLARED[kind]
    parts = "model C B b; end C; model D C c; end D;"
    model = model.replace("CHANGE", change).replace("EACH", change.replace("redeclare", "redeclare each"))
    assert_after_a_second(f"package P {classes} {parts} model M {model} end M; end P;\n", expected)


@pytest.mark.parametrize(
    "model",
    [
        "parameter Real q = 2; C p(b(redeclare A5 f(k = q)));",
        "Several p(b(redeclare A5 f));",
        "E p(b(redeclare model F = A5));",
    ],
)
def test_a_redeclaration_that_would_be_lost_is_refused(model: str) -> None:
    classes = (
        "partial model I Real t; end I; model A extends I; equation t = 1; end A;"
        " model A5 extends I; parameter Real k = 5; equation t = k; end A5;"
        " model B replaceable A f constrainedby I; end B;"
        " model G replaceable model F = A constrainedby I; F f; end G;"
        " model C B b; end C; model E G b(redeclare model F = A); end E; model Several B b[2]; end Several;"
    )
    text = f"package P {classes} model M {model} end M; end P;\n"
    with pytest.raises(ModelError, match="redeclares something inside of it") as caught:
        compile_text(text.encode(), Path("P.mo"), "P.M")
    assert str(caught.value.where) == f"P.mo:1:{text.index(model) + model.index('(') + 2}"


def test_broken_text_is_passed_on_or_refused() -> None:
    """What is written otherwise is looked for in any text: it must not fail where that breaks off."""
    random = Random(1)
    texts = [one.encode() for one in (LAWS, RECORDS, ARRAYS, OUTER, CHAIN, PACKAGES)]
    pieces = (
        b"(",
        b")",
        b";",
        b",",
        b"=",
        b"{",
        b"}",
        b"[",
        b" end ",
        b" redeclare ",
        b" extends ",
        b":",
        b".",
    )
    for _ in range(500):
        text = random.choice(texts)
        at = random.randrange(len(text))
        broken = (text[:at], text[:at] + text[at + 9 :], text[:at] + random.choice(pieces) + text[at:])
        with contextlib.suppress(ModelError):
            with_own_modifications(with_own_forms(random.choice(broken), Path("P.mo"), "P.M"))


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ("C a(b(redeclare model F = Nope));", "class `Nope` is not known"),
        ("C a(b(redeclare model G = A5));", "`P.B` has no `G` that could be redeclared"),
        ("C a(bb(redeclare model F = A5));", "`P.C` has no `bb`"),
        ("B a(redeclare model G = A5);", "`P.B` has no `G`"),
        ("extends B(redeclare A5 g);", "`P.B` has no `g`"),
    ],
)
def test_what_is_not_there_cannot_be_redeclared(model: str, said: str) -> None:
    classes, _ = REDECLARED["model"]
    text = f"package P {classes} model C B b; end C; model M {model} end M; end P;\n"
    with pytest.raises(ModelError, match=said) as caught:
        compile_text(text.encode(), Path("P.mo"), "P.M")
    assert str(caught.value.where).startswith("P.mo:1:")
