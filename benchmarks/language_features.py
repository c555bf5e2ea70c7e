"""Features of the Modelica language: a small model for each, really run, as a page of the documentation.

    python benchmarks/language_features.py [--write docs/language.md]

Each model is compiled and simulated for two seconds; where a value is known in closed form it is compared to
1e-6. Without --write the page goes to stdout.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daest.errors import DaestError
from daest.machine import described
from daest.modelica.compile import compile_text
from daest.systems.simulation.simulate import simulate

TOLERANCE = 1e-6  # of a value with a closed form, relative to it (floor 1)
END, SAMPLES = 2.0, 201  # s, and how many

HEADING = """# The Modelica language

Which features of the language a model may use. Each row is a small model that was compiled and simulated when
this page was made, by `python benchmarks/language_features.py --write docs/language.md`; where its result is
known in closed form it agrees to 1e-6. What is refused is refused with a message that names the place, and
what to write in its stead.

"""


@dataclass(frozen=True)
class Feature:
    """One feature: the declarations and equations of model `M`, or a whole package with one; `values` are
    (variable, time [s], value) in closed form."""

    area: str
    name: str
    text: str
    values: tuple[tuple[str, float, float], ...] = ()
    is_refused: bool = False

    @property
    def source(self) -> str:
        if self.text.startswith("package"):
            return self.text
        return f"model M\n{self.text}\nend M;\n"


def features() -> Iterator[Feature]:
    """All features, in the order of the page."""
    area = "Variables and parameters"
    yield Feature(
        area,
        "arrays, slices, `end`, array constructors with `for`",
        "parameter Integer n = 3; parameter Real a[n] = {i^2 for i in 1:n}; "
        "parameter Real B[2,3] = {a, 2*a};\n"
        "Real s = sum(a[2:end]) + B[2,end]; Real x(start = 0, fixed = true); equation der(x) = s;",
        (("x", 1.0, 31.0),),
    )
    yield Feature(
        area,
        "records, also with functions",
        "package P record D Real J = 2; Real d = 1; end D;\nfunction t input D v; input Real w; "
        "output Real y;"
        "\nalgorithm y := v.d*w; end t;\nmodel M parameter D v(d = 4); Real w(start = 1, fixed = true);\n"
        "equation v.J*der(w) = -t(v, w); end M; end P;",
        (("w", 1.0, math.exp(-2)),),
    )
    yield Feature(
        area,
        "enumerations",
        "type E = enumeration(off, on); parameter E e = E.on; Real x(start = 0, fixed = true);\n"
        "equation der(x) = if e == E.on then 1 else 0;",
        (("x", 1.0, 1.0),),
    )
    yield Feature(
        area,
        "an Integer variable that selects an element",
        "parameter Real r[3] = {1, 2, 4}; Integer g(start = 1, fixed = true); Real x(start = 0, "
        "fixed = true);"
        "\nequation der(x) = r[g]; when time > 1 then g = 3; end when;",
        (("x", 2.0, 5.0),),
    )
    yield Feature(
        area,
        "parameters that the start computes (`fixed = false`), `initial algorithm`",
        "parameter Real p(fixed = false, start = 1); parameter Real t[2](each fixed = false);\n"
        "Real x(start = 0, fixed = true);\n"
        "initial equation p^2 = 4;\n"
        "initial algorithm for i in 1:2 loop t[i] := 3*i; end for;\nequation der(x) = t[2] + p;",
        (("x", 1.0, 8.0),),
    )
    yield Feature(
        area,
        "`initial algorithm` with branches, Boolean parameters with `fixed = false`",
        "parameter Real k = 3; parameter Real p(fixed = false); parameter Boolean b(fixed = false);\n"
        "Real x(start = 0, fixed = true);\n"
        "initial algorithm p := 2*k; b := false; if p > 5 then b := true; p := p + 1; end if;\n"
        "equation der(x) = if b then p else 0;",
        (("x", 1.0, 7.0),),
    )
    yield Feature(
        area,
        "Strings in parameters and messages",
        'parameter String s = "ab"; Real x(start = 1, fixed = true);\nequation '
        'assert(x > -1, "x = " + String(x)); der(x) = if s == "ab" then -x else x;',
        (("x", 1.0, math.exp(-1)),),
    )
    yield Feature(
        area,
        "operator records, as Complex numbers",
        "package P operator record V Real x; Real y;\nencapsulated operator function '+' import P.V;\n"
        "input V a; input V b; output V c; algorithm c := V(a.x + b.x, a.y + b.y); end '+'; end V;\n"
        "model M V a = V(1, time); V b = V(2, 3); V c = a + b; end M; end P;",
        (),
        True,
    )
    area = "Classes"
    yield Feature(
        area,
        "`extends` with modifications, `each`, `final`",
        "package P model A parameter Real k = 1; Real x(start = 0, fixed = true); equation der(x) = "
        "k; end A;\n"
        "model B A a[2](each k = 2); end B;\nmodel M extends B(a(each k = 3)); end M; end P;",
        (("a[2].x", 1.0, 3.0),),
    )
    yield Feature(
        area,
        "`replaceable`, `redeclare` with a modification, `constrainedby`",
        "package P partial model L input Real w; output Real t; end L;\n"
        "model L1 extends L; equation t = w; end L1;\n"
        "model L2 extends L; parameter Real c = 9; equation t = c*w; end L2;\n"
        "model D replaceable model F = L1 constrainedby L; F f(w = w); Real w(start = 1, fixed = true);\n"
        "equation der(w) = -f.t; end D;\nmodel M extends D(redeclare model F = L2(c = 2)); end M; end P;",
        (("w", 1.0, math.exp(-2)),),
    )
    yield Feature(
        area,
        "modifications of parts of parts, by dotted names too, with values beside attributes",
        "package P model A parameter Real k(max = 9) = 1; Real x(start = 0, fixed = true); equation der(x) = "
        "k; end A;\nmodel B A a(x(start = 1)); end B; model C B b; end C;\n"
        "model M extends B(a(k(min = 0) = 3)); C c(b.a.k = 4, b.a.x.start = 2); end M; end P;",
        (("a.x", 1.0, 4.0), ("c.b.a.x", 1.0, 6.0)),
    )
    yield Feature(
        area,
        "redeclarations inside of modifications",
        "package P model A parameter Real k = 1; Real x(start = 0, fixed = true); equation der(x) = k; "
        "end A;\nmodel A2 = A(k = 5); model B replaceable model F = A; F f; end B; model C B b; end C;\n"
        "model M C c(b(redeclare model F = A2)); C d; end M; end P;",
        (("c.b.f.x", 1.0, 5.0), ("d.b.f.x", 1.0, 1.0)),
    )
    yield Feature(
        area,
        "`inner` and `outer` variables and parameters",
        "package P model B outer Real T; outer parameter Real k; Real x(start = 0, fixed = true);\n"
        "equation der(x) = k*T; end B; model C B b; end C;\n"
        "model M inner Real T = 2; inner parameter Real k = 3; C c; end M; end P;",
        (("c.b.x", 1.0, 6.0),),
    )
    yield Feature(
        area,
        "`inner` and `outer`",
        "package P model E parameter Real g = 1; end E;\n"
        "model B outer E e; Real x(start = 0, fixed = true); equation der(x) = e.g; end B;\n"
        "model M inner E e(g = 3); B b; end M; end P;",
        (("b.x", 1.0, 3.0),),
    )
    yield Feature(
        area,
        "`if` equations, start equations and conditional components by a parameter of an `outer` component",
        "package P model E parameter Boolean b = false; end E; model A Real y = 2; end A;\n"
        "model B outer E e; Real x; A a if e.b; initial equation if e.b then x = 3; end if;\n"
        "equation der(x) = if e.b then 1 else 2; end B;\n"
        "model M inner E e(b = true); B b; end M; end P;",
        (("b.x", 1.0, 4.0), ("b.a.y", 1.0, 2.0)),
    )
    yield Feature(
        area,
        "conditional components",
        "package P model A Real y = 2; end A;\nmodel M parameter Boolean with = false; A a if with; A b;\n"
        "Real x(start = 0, fixed = true); equation der(x) = b.y; end M; end P;",
        (("x", 1.0, 2.0),),
    )
    yield Feature(
        area,
        "imports of constants, functions and literals",
        "package P package L constant Real g = 2; type E = enumeration(a, b);\n"
        "function f input Real x; output Real y; algorithm y := 2*x; end f; end L;\n"
        "model M import P.L.g; import P.L.f; import P.L.E.b; parameter L.E e = b;\n"
        "Real x(start = 0, fixed = true); equation der(x) = if e == b then f(g) else 0; end M; end P;",
        (("x", 1.0, 4.0),),
    )
    yield Feature(
        area,
        "expandable connectors, also with members that connections add",
        "package P connector I = input Real; connector O = output Real;\nexpandable connector B "
        "end B;\n"
        "block S B b; O y; equation y = time; connect(y, b.s); end S;\n"
        "block T B b; I u; Real x(start = 0, fixed = true); equation connect(b.s, u); der(x) = u; end T;\n"
        "model M S s; T t; B b; equation connect(s.b, b); connect(b, t.b); end M; end P;",
        (("t.x", 2.0, 2.0),),
    )
    yield Feature(
        area,
        "stream connectors",
        "package P connector F Real p; flow Real m; stream Real h; end F;\n"
        "model A F f; parameter Real p = 2, h = 10; equation f.p = p; f.h = h; end A;\n"
        "model V F a, b; Real U(start = 5, fixed = true); equation a.m = a.p - b.p; a.m + b.m = 0;\n"
        "a.h = U; b.h = U; der(U) = a.m*actualStream(a.h) + b.m*actualStream(b.h); end V;\n"
        "model M A s; A t(p = 1, h = 3); V v; equation connect(s.f, v.a); connect(v.b, t.f); end M; end P;",
        (("v.U", 1.0, 10 - 5 * math.exp(-1)),),
    )
    yield Feature(
        area,
        "arrays of Boolean connectors, connected one by one or as a whole",
        "package P connector I = input Boolean; connector O = output Boolean;\n"
        "block N I u; O y; equation y = not u; end N;\n"
        "block S O y[2]; equation for i in 1:2 loop y[i] = time > 0.5*i; end for; end S;\n"
        "model M S s; N n[2]; Real x(start = 0, fixed = true); equation connect(s.y, n.u);\n"
        "der(x) = (if n[1].y then 1 else 0) + (if n[2].y then 10 else 0); end M; end P;",
        (("x", 2.0, 0.5 + 10),),
    )
    area = "Equations"
    yield Feature(
        area,
        "constraints of higher index",
        "parameter Real L = 2; Real x(start = 2, fixed = true), y(start = 0), u, v(start = 0, fixed "
        "= true), F;"
        "\nequation der(x) = u; der(y) = v; der(u) = -F*x; der(v) = -F*y - 9.81; x^2 + y^2 = L^2;",
    )
    yield Feature(
        area,
        "`for` and `if` equations, `der` of an element that a parameter selects",
        "parameter Integer n = 2; parameter Boolean b = true; Real T[n](each start = 1, each fixed = true);\n"
        "equation for i in 1:n - 1 loop der(T[i]) = -T[i]; end for;\n"
        "if b then der(T[n]) = -2*T[n]; else der(T[n]) = 0; end if;",
        (("T[2]", 1.0, math.exp(-2)),),
    )
    yield Feature(
        area,
        "`initial equation`",
        "Real x; initial equation der(x) = -3; equation der(x) = -x;",
        (("x", 1.0, 3 * math.exp(-1)),),
    )
    yield Feature(
        area,
        "`der` of an expression",
        "Real x(start = 1, fixed = true); equation der(2*x) = -2*x;",
        (("x", 1.0, math.exp(-1)),),
    )
    yield Feature(
        area,
        "algorithm sections with loops, `while`, values read and assigned again",
        "Real s; Real x(start = 0, fixed = true); equation der(x) = s;\n"
        "algorithm s := 0; for i in 1:3 loop s := s + i; end for;",
        (("x", 1.0, 6.0),),
    )
    yield Feature(
        area,
        "`delay(e, T)`, T estimated as well; `delay(e, T, Tmax)`",
        "parameter Real T = 0.4; Real x = sin(3*time), y, z;\n"
        "equation y = delay(x, T); z = delay(x, 0.2 + 0.1*sin(time), 0.4);",
        (("y", 2.0, math.sin(3 * (2 - 0.4))), ("z", 2.0, math.sin(3 * (2 - 0.2 - 0.1 * math.sin(2))))),
    )
    area = "Functions"
    yield Feature(
        area,
        "loops, `while`, `break`, `return`, several results, arrays of any size",
        "package P function f input Real x[:]; output Real s; output Real m;\n"
        "protected Integer n; algorithm s := 0; n := 0; m := x[1];\n"
        "while n < size(x, 1) loop n := n + 1; if n > 3 then break; end if; s := s + x[n]; end "
        "while; end f;\n"
        "model M Real s, n; Real x(start = 0, fixed = true);\n"
        "equation (s, n) = f({1.0, time, 2.0, 3.0, 4.0}); der(x) = s; end M; end P;",
        (("x", 2.0, 8.0),),
    )
    yield Feature(
        area,
        "recursion",
        "package P function f input Integer n; output Integer y; algorithm\n"
        "y := if n <= 1 then 1 else n*f(n - 1); end f;\n"
        "model M Real x(start = 0, fixed = true); equation der(x) = f(4); end M; end P;",
        (("x", 1.0, 24.0),),
    )
    yield Feature(
        area,
        "`while` that depends on a parameter",
        "package P function f input Real a; output Real y; algorithm y := a;\n"
        "while y > 1 loop y := y/2; end while; end f;\n"
        "model M parameter Real a = 5; Real x(start = 0, fixed = true); equation der(x) = f(a); end "
        "M; end P;",
        (),
        True,
    )
    yield Feature(
        area,
        "external functions (C, Fortran)",
        'package P function f input Real x; output Real y; external "C" y = cbrt(x); end f;\n'
        "model M Real y = f(time); Real x(start = 0, fixed = true); equation der(x) = y; end M; end P;",
        (),
        True,
    )
    area = "Events"
    yield Feature(
        area,
        "`when` with `reinit` and `pre`",
        "Real x(start = 0, fixed = true); equation der(x) = 1; when x >= 0.75 then reinit(x, pre(x) - 0.75); "
        "end when;",
        (("x", 1.0, 0.25),),
    )
    yield Feature(
        area,
        "`sample`: a controller beside its plant",
        "Real x(start = 0, fixed = true); discrete Real u(start = 0, fixed = true);\n"
        "equation der(x) = -x + u; when sample(0, 0.5) then u = 2*(1 - x); end when;",
        (("x", 0.25, 2 * (1 - math.exp(-0.25))),),
    )
    yield Feature(
        area,
        "Boolean states with hysteresis",
        "Real x(start = 0, fixed = true); Boolean on(start = true);\n"
        "initial equation pre(on) = true; equation on = if pre(on) then x < 1 else x < 0.5;\n"
        "der(x) = if on then 1 else -1;",
        (("x", 1.75, 0.75),),
    )
    yield Feature(
        area,
        "state machines by enumerations, `elsewhen`, `edge`, `change`",
        "type S = enumeration(a, b, c); S s(start = S.a, fixed = true); Integer n(start = 0, fixed = true);\n"
        "Real x(start = 0, fixed = true); equation der(x) = if s == S.b then 1 else 0;\n"
        "when time > 0.5 and time < 1 then s = S.b; elsewhen time > 1.5 then s = S.c; end when;\n"
        "when change(s) then n = pre(n) + 1; end when;",
        (("x", 2.0, 1.0), ("n", 1.9, 2.0)),
    )
    yield Feature(
        area,
        "`integer`, `floor`, `mod` and the like of a moving value",
        "Real x(start = 0, fixed = true); equation der(x) = integer(2*time) + mod(time, 0.5);",
        (("x", 1.0, 0.75),),
    )
    yield Feature(
        area,
        "`initial()`, `terminate`, several conditions",
        "discrete Real a; Real x(start = 0, fixed = true); equation der(x) = a;\n"
        'when {initial(), time >= 1} then a = 2 + time; end when; when x > 9 then terminate("end"); '
        "end when;",
        (("x", 2.0, 5.0),),
    )
    yield Feature(
        area,
        "clocks (`Clock`, `sample(u)`, `hold`, `previous`, `subSample` …) of known periods",
        "Clock c = Clock(0.1); Real x(start = 0, fixed = true); Real a; Real n(start = 0);\n"
        "equation der(x) = 1; when c then a = sample(x); n = previous(n) + a; end when;\n",
        (("n", 0.25, 0.3),),
    )
    yield Feature(
        area,
        "`Clock(…)` in place of a clock's name, `sample(u, c)` inside of an expression, `when Clock() then`",
        "Real x(start = 0, fixed = true); Real a; Real n(start = 0);\n"
        "equation der(x) = 1; a = 2*sample(x, Clock(0.1));\n"
        "when Clock() then n = previous(n) + a/2; end when;\n",
        (("n", 0.25, 0.3),),
    )
    yield Feature(
        area,
        "clocks that tick at events",
        "Real x(start = 0, fixed = true); Real y; Real u; Boolean b = x > 0.5; Clock c = Clock(b);\n"
        "equation der(x) = u; y = sample(x, c); u = hold(y) + 1;",
        (),
        True,
    )


def outcome(feature: Feature) -> str:
    """What became of a feature: "works", or the code of the refusal. Raises AssertionError for a "
    "value that is
    off."""
    times = sorted({t for _, t, _ in feature.values} | set(np.linspace(0, END, SAMPLES)))
    try:
        flat = compile_text(
            feature.source.encode(), Path("M.mo"), "P.M" if feature.source[0] == "p" else None
        )
        found = simulate(flat, (np.array(times), np.zeros((len(times), 0))))
    except DaestError as error:
        return error.code
    for name, t, value in feature.values:
        got = found[name][times.index(t)]
        assert abs(got - value) <= TOLERANCE * max(1.0, abs(value)), (feature.name, name, got, value)
    return "works"


def page() -> str:
    """The page, from runs."""
    lines, area = [HEADING.rstrip("\n")], ""
    for feature in features():
        if feature.area != area:
            area = feature.area
            lines += ["", f"## {area}", "", "| feature | |", "|---|---|"]
        found = outcome(feature)
        compared = ", closed form" if feature.values else ""
        shown = f"works{compared}" if found == "works" else f"refused: `{found}`"
        lines.append(f"| {feature.name} | {shown} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path)
    chosen = parser.parse_args()
    print(described(), file=sys.stderr)
    made = page()
    if chosen.write:
        chosen.write.write_text(made)
    else:
        print(made, end="")


if __name__ == "__main__":
    main()
