"""What is wrong with a model, by code, place and remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from daest.errors import EXPLANATIONS, ModelError, Place
from daest.model.flat import FlatModel
from daest.modelica.compile import compile_model
from daest.modelica.compiling import apart
from daest.modelica.language import failures

Compile = Callable[..., FlatModel]


def failure(run: Callable[[], object]) -> ModelError:
    with pytest.raises(ModelError) as caught:
        run()
    error = caught.value
    assert error.code in EXPLANATIONS
    assert error.remedy
    assert error.__cause__ is None
    return error


# text, class, code, line, column, words of the message, words of the remedy
CASES = {
    "syntax": (
        "model M\n Real x;\nequation\n x = = 3;\nend M;",
        "model-syntax",
        (4, 6),
        "unexpected `=`",
        "expected",
    ),
    "reserved word": (
        'model M\n input Real flow(unit = "1");\n Real x;\nequation\n x = 3;\nend M;',
        "model-syntax",
        (2, 13),
        "unexpected `flow`",
        "`flow` is a word of the language and cannot name anything: write `flow_`.",
    ),
    "reserved word that names a class": (
        "model M\n function flow\n  input Real r;\n  output Real y;\n algorithm\n  y := r;\n end flow;\n"
        " Real x;\nequation\n x = flow(1);\nend M;",
        "model-syntax",
        (2, 11),
        "unexpected `flow`",
        "`flow` is a word of the language and cannot name anything: write `flow_`.",
    ),
    "function with the name of an operator": (
        "model M\n function edge\n  input Real r;\n  output Real y;\n algorithm\n  y := r;\n end edge;\n"
        " Real x;\nequation\n x = edge(1);\nend M;",
        "model-function",
        (2, 11),
        "the function `edge` has the name of an operator of Modelica",
        "`edge_`",
    ),
    "function with the name of an operator that would be taken": (
        "package P\n function abs\n  input Real r;\n  output Real y;\n algorithm\n  y := r^2;\n end abs;\n"
        " model M\n  Real x;\n equation\n  x = abs(1);\n end M;\nend P;",
        "model-function",
        (2, 11),
        "`abs` has the name of an operator",
        "Rename the function",
    ),
    "semicolon before a reserved word": (
        "model M\n Real x\n flow Real u;\nequation\n x = 3;\nend M;",
        "model-syntax",
        (2, 7),
        "unexpected",
        ";",
    ),
    "semicolon": ("model M\n Real x\nequation\n x = 3;\nend M;", "model-syntax", (2, 7), "unexpected", ";"),
    "class": (
        "model Resistor Real x; equation x = 1; end Resistor;\nmodel M\n  Resistr r; Resistor q;\nend M;",
        "model-unknown-class",
        (3, 3),
        "`Resistr`",
        "`Resistor`",
    ),
    "class of the library": (
        "model M\n import Daest.Units.SI;\n"
        " Daest.Electrical.Analog.Basic.Resistr r(R = 1);\nequation\n r.p.v = 1;\n r.n.v = 0;\nend M;",
        "model-unknown-class",
        (3, 2),
        "`Daest.Electrical.Analog.Basic.Resistr`",
        "Did you mean `Daest.Electrical.Analog.Basic.Resistor`?",
    ),
    "class of the Modelica Standard Library": (
        "model M\n parameter Modelica.Units.SI.Resistance R = 1;\nend M;",
        "model-unknown-class",
        (2, 12),
        "`Modelica.Units.SI.Resistance`",
        "Write `Daest.Units.SI.Resistance`, which daest brings, or give the folder",
    ),
    "class that a package of the library lacks": (
        "model M\n Daest.Thermal.HeatTransfer.Components.Convection c;\nend M;",
        "model-unknown-class",
        (2, 2),
        "Convection",
        "Components holds HeatCapacitor, ThermalConductor, ThermalResistor.",
    ),
    "quantity by an import": (
        "model M\n import Daest.Units.SI;\n parameter SI.Powr P = 1;\nend M;",
        "model-unknown-class",
        (3, 12),
        "`SI.Powr`",
        "Did you mean `Daest.Units.SI.Power`?",
    ),
    "import of the base class": (
        "package P\n partial model A\n  import I = Daest.Electrical.Analog;\n  I.Basic.Ground g;\n end A;\n"
        " model M\n  extends A;\n  I.Basic.Resistor r;\n end M;\nend P;",
        "model-unknown-class",
        (8, 3),
        "`I.Basic.Resistor`",
        "Imports are not inherited: repeat that of the class which is extended, or write "
        "`Daest.Electrical.Analog.Basic.Resistor`.",
    ),
    "package of the library": (
        "model M\n Daest.Electrical.Analog.Basik.Ground g;\nend M;",
        "model-unknown-class",
        (2, 2),
        "Basik",
        "Did you mean `Daest.Electrical.Analog.Basic.Ground`?",
    ),
    "component": (
        "model M\n Daest.Electrical.Analog.Basic.Ground ground;\nequation\n"
        " connect(grund.p, ground.p);\nend M;",
        "model-unknown-name",
        (4, 10),
        "`grund.p`",
        "Did you mean `ground",
    ),
    "missing comma": (
        "model M\n Daest.Electrical.Analog.Basic.Ground a, b;\nequation\n connect(a.p b.p);\nend M;",
        "model-syntax",
        (4, 14),
        "unexpected `b`",
        "`,`",
    ),
    "base class": (
        "model M extends Modelica.Icons.Example; Real x = 1; end M;",
        "model-unknown-class",
        (1, 17),
        "Icons",
        "-L",
    ),
    "name": (
        "model M\n Real speed;\nequation\n speed = 3*sped;\nend M;",
        "model-unknown-name",
        (4, 12),
        "`sped`",
        "`speed`",
    ),
    "constant of the standard library": (
        "model M\n Real x;\nequation\n x = 2*Modelica.Constants.pi;\nend M;",
        "model-unknown-name",
        (4, 8),
        "`Modelica.Constants.pi`",
        "Write `Daest.Constants.pi`, which daest brings",
    ),
    "function that the language has": (
        "model M\n Real x;\nequation\n x = Modelica.Math.sin(time);\nend M;",
        "model-unknown-name",
        (4, 6),
        "`Modelica.Math.sin`",
        "Write `sin`, which the language has",
    ),
    "type": ('model M\n Real x;\nequation\n x = "a";\nend M;', "model-type", (4, 2), "String", "same type"),
    "delay": (
        "model M\n Real x, y;\nequation\n x = time;\n y = delay(x, x);\nend M;",
        "model-delay",
        (5, 6),
        "`x` of a delay",
        "Tmax",
    ),
    "pre": (
        "model M\n Real x, y;\nequation\n x = time;\n y = pre(x);\nend M;",
        "model-unsupported",
        (5, 6),
        "`pre`",
        "",
    ),
    "clock in a loop": (
        "model M\n Real x, s[2];\nequation\n x = time;\n for i in 1:2 loop\n"
        "  s[i] = sample(x, Clock(0.2));\n end for;\nend M;",
        "model-unsupported",
        (6, 20),
        "`Clock(…)`: equations on a clock are not supported",
        "`when sample(0, 0.2) then … end when;` around its equations, there pre(x) for previous(x)",
    ),
    "when a clock ticks": (
        "model M\n Real x(start = 0, fixed = true);\n discrete Real s(start = 0, fixed = true);\nequation\n"
        " der(x) = 1 - x;\n when Clock(0.1) then\n  s = x;\n end when;\nend M;",
        "model-unsupported",
        (6, 7),
        "`Clock(…)`",
        "`when sample(0, 0.1) then",
    ),
    "external": (
        'model M\n function f input Real x; output Real y; external "C" y = f(x); end f;\n'
        " Real x;\nequation\n"
        " x = f(time);\nend M;",
        "model-function",
        (5, 6),
        "external",
        "Write the function in Modelica",
    ),
    "table": (
        "model M\n function ExternalCombiTable1D input Real x; output Real y; external "
        '"C" y = f(x); end ExternalCombiTable1D;\n'
        " Real x;\nequation\n"
        " x = ExternalCombiTable1D(time);\nend M;",
        "model-function",
        (5, 6),
        "ExternalCombiTable1D",
        "CoulombFriction",
    ),
    "while": (
        "model M\n function f input Real x; output Real y; algorithm y := x;\n  while y > 1 loop y := y/2;"
        " end while; end f;\n Real x;\nequation\n x = f(time);\nend M;",
        "model-function",
        (3, 9),
        "`while y > 1` depends on variables",
        "constants only",
    ),
    "return": (
        "model M\n function f input Real x; output Real y; algorithm y := x;\n  if y > 1 then return; end if;"
        " y := 1; end f;\n Real x;\nequation\n x = f(time);\nend M;",
        "model-function",
        (3, 6),
        "`return` depends on `y > 1`",
        "constants only",
    ),
    "algorithm that cannot be read": (
        "model M\n function f input Real x; output Real y; algorithm y := x; while false loop y :=; end "
        "while;"
        " end f;\n Real x;\nequation\n x = f(time);\nend M;",
        "model-syntax",
        None,
        "",
        "",
    ),
    "recursion": (
        "model M\n function f input Real n; output Real y; algorithm if n <= 1 then y := 1; else y := "
        "n*f(n - 1);"
        " end if; end f;\n Real x;\nequation\n x = f(time);\nend M;",
        "model-function",
        (2, 87),
        "calls itself",
        "for-loop",
    ),
    "der of an input": (
        "model M\n input Real u; Real x;\nequation\n x = der(u);\nend M;",
        "model-der-input",
        (4, 6),
        "input",
        "der(x)",
    ),
    "parameter without value": (
        "model M\n parameter Real p;\n Real x = p;\nend M;",
        "model-parameter-value",
        (2, 17),
        "`p`",
        "p = ",
    ),
    "parameter outside": (
        "model M\n parameter Real p(min = 2) = 1;\n Real x = p;\nend M;",
        "parameter-outside-bounds",
        (2, 17),
        "below its min",
        "",
    ),
    "circular": ("model M\n parameter Real p = 2*q, q = p;\n Real x = p;\nend M;", None, None, "", ""),
    "too few": (
        "model M\n Real x, y, z;\nequation\n x = time;\n y = 2*z;\nend M;",
        "model-unbalanced",
        None,
        "2 equations for 3 unknowns: 1 too few. These unknowns are not all determined: `y`, `z`",
        "input",
    ),
    "too many": (
        "model M\n Real x, y, z;\nequation\n x = 3*y;\n x = 2*y;\n y = 3;\n z = x;\nend M;",
        "model-unbalanced",
        (6, 2),
        "compete for `x`, `y`",
        "Remove",
    ),
    "given at an open connector": (
        "package P\n connector C Real v; flow Real i; end C;\n"
        " model R C a; C b; equation a.v - b.v = a.i; a.i + b.i = 0; end R;\n"
        " model S C c; equation der(c.v) = c.i; end S;\n"
        " model M R r; S s;\n equation connect(s.c, r.a);\n"
        " r.b.v = 3;\n end M;\nend P;",
        "model-unbalanced",
        None,
        "r.b.i = 0    (nothing is connected to `r.b`)",
        "a source that is connected",
    ),
    "connection into a component": (
        "package P\n connector C Real v; flow Real i; end C;\n"
        " model R C a; C b; equation a.v - b.v = a.i; a.i + b.i = 0; end R;\n"
        " model S C c; equation c.v = 0; end S;\n"
        " model W R r; R q; C a; C b; equation connect(a, r.a); connect(r.b, q.a); connect(q.b, b); end W;\n"
        " model M W w; S s; S t; S u;\n equation connect(w.a, s.c); connect(w.b, t.c);\n"
        " connect(w.r.b, u.c);\n end M;\nend P;",
        "model-unbalanced",
        None,
        "reaches `w.r.b` inside of `w`",
        "connector of its own",
    ),
    "open input": (
        "model M\n model A input Real u; Real x; equation der(x) = u; end A;\n A a;\nend M;",
        "model-unbalanced",
        None,
        "nothing gives a value to `a.u`",
        "Connect",
    ),
    "division by zero": ("model M\n parameter Real p = 1/0;\n Real x = p;\nend M;", None, None, "", ""),
    "partial": ("partial model M\n Real x;\nend M;", "model-none", (1, 15), "partial model M", "model NAME"),
    "comment only": ("// nothing\n", "model-none", None, "no complete model", ""),
    "nothing": (" \n", "model-empty", None, "empty", ""),
    "nesting": (
        "model M Real x; equation x = " + "(" * 9000 + "1" + ")" * 9000 + "; end M;",
        "model-nesting",
        (1, 329),
        "nests",
        "Split",
    ),
    "chain": (
        "model M Real x; equation x = 1" + " + time" * 9000 + "; end M;",
        "model-nesting",
        None,
        "chains",
        "Split",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_message(compiled: Compile, name: str) -> None:
    text, code, position, words, remedy = CASES[name]
    error = failure(lambda: compiled(text))
    if code is not None:
        assert error.code == code
    assert words in error.what
    assert remedy in error.remedy
    if position is not None:
        assert isinstance(error.where, Place)
        assert (error.where.line, error.where.column) == position
        assert error.where.file.endswith("Model.mo")


def test_errors_name_the_line_in_a_file_with_windows_line_ends_and_mark(compiled: Compile) -> None:
    text = "model M\r\n Real x;\r\nequation\r\n x = delay(time, -1);\r\nend M;\r\n"
    error = failure(lambda: compiled(b"\xef\xbb\xbf" + text.encode()))
    assert isinstance(error.where, Place) and (error.where.line, error.where.column) == (4, 6)


@pytest.mark.parametrize(
    ("class_name", "code", "words"),
    [
        ("P.Servo", "model-unknown-class", "P.Servoo"),
        ("P", "model-kind", ""),
        ("f", "model-kind", ""),
        ("Base", "model-kind", ""),
    ],
)
def test_class_that_cannot_be_compiled(compiled: Compile, class_name: str, code: str, words: str) -> None:
    text = """package P partial model Base Real x; end Base; model Servoo extends Base; equation x = 1; end
    Servoo;
    function f input Real x; output Real y; algorithm y := x; end f; end P;"""
    error = failure(lambda: compiled(text, class_name))
    assert error.code == code
    assert words in error.remedy
    assert compiled(text, "Servoo").name == compiled(text).name == "P.Servoo"


def test_several_models_are_listed(compiled: Compile) -> None:
    text = "model A Real x = 1; end A; model B Real x = 1; end B;"
    error = failure(lambda: compiled(text))
    assert error.code == "model-ambiguous" and "A, B" in error.what and "--class B" in error.remedy
    # A model that the other one uses is a part of it.
    assert compiled("model A Real x = 1; end A; model B A a; end B;").name == "B"


def test_files_that_are_none(tmp_path: Path) -> None:
    assert failure(lambda: compile_model(tmp_path / "None.mo")).code == "model-missing"
    assert failure(lambda: compile_model(tmp_path)).code == "model-file"
    binary = tmp_path / "Latin.mo"
    binary.write_bytes(b"model M // Dr\xfcck\nend M;")
    error = failure(lambda: compile_model(binary))
    assert error.code == "model-encoding"
    assert isinstance(error.where, Place) and (error.where.line, error.where.column) == (1, 14)
    model = tmp_path / "M.mo"
    model.write_text("model M Real x = 1; end M;")
    assert failure(lambda: compile_model(model, libraries=[tmp_path / "no"])).code == "model-library"


def test_a_panic_of_the_compiler_is_one_message(
    compiled: Compile, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Panic(BaseException):
        """Like pyo3's PanicException, which is no Exception."""

    class Broken:
        def __init__(self, **_: object) -> None: ...

        def loads(self, *_: object, **__: object) -> object:
            raise Panic("index out of bounds\nstack backtrace: …")

    monkeypatch.setattr("rumoca.Session", Broken)
    apart.stop()  # the next one is a copy of this process with the broken session
    error = failure(lambda: compiled("model M Real x = 1.375; end M;"))
    assert error.code == "model-compiler"
    assert "index out of bounds" in error.what and "backtrace" not in str(error)
    monkeypatch.undo()
    apart.stop()
    failure(lambda: compiled("model M input Real u; Real x; equation x = der(u); end M;"))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("failed in ToDae: unsupported Flat semantic owner `record-array member slice`", "array of records"),
        (
            "failed in ToDae: unsupported Flat semantic owner `record constructor`: `P.R` is",
            "a record that a",
        ),
        ("failed in ToDae: canonical DAE: expected a numeric expression, found Record", "whole records"),
        ("missing exact function-selection identity for `P.loadResource`: exposed", "`P.loadResource`"),
        ("failed in Flatten: unresolved flat reference: v", "its condition leaves out"),
        ("failed in ToDae: unresolved Flat reference `z`", "(`z`)"),
        (
            "failed in ToDae: unsupported Flat semantic owner `array comprehension domain`: range bound",
            "whose end is computed",
        ),
    ],
)
def test_limits_of_the_compiler_in_words_of_the_language(said, words):
    made = failures.translated(said, Path("M.mo"), b"model M end M;", "M")
    assert made.code == "model-compile"
    assert words in made.what
    assert "canonical" not in str(made)
    assert "Flat" not in str(made)
    assert made.remedy


NESTED = """model Filter
  model Coil
    parameter Real L = 1e-3;
    Real i(start = 0);
    input Real u;
  equation
    L*der(i) = u - i;
  end Coil;
  parameter Real L[2] = {2e-3, 1e-3};
  input Real u;
  output Real y;
  Coil coil(u = u);
equation
  y = coil.i + L[1];
end Filter;
"""


def test_an_array_with_the_name_of_a_component_in_a_class_inside_is_told(compiled: Compile) -> None:
    """The compiler takes one for the other, and counts two equations of the coil."""
    error = failure(lambda: compiled(NESTED, "Filter"))
    assert error.code == "model-compile" and "`L` is an array in `Filter`" in error.what
    assert "`Coil`" in error.what and "otherwise" in error.remedy
    compiled(NESTED.replace("L[", "Ls["), "Filter")


def test_a_library_without_its_package_file_is_told_by_its_first_file_alone():
    faults = "; ".join(
        f"PKG-010 file '/lib/M/{name}.mo' has `within M.Blocks;` but expected `within Blocks;`"
        for name in "ABC"
    )
    said = f"Failed to load source root '/lib': invalid Modelica package layout under '/lib': {faults}"
    made = failures.translated(said, Path("N.mo"), b"model N end N;", "N")
    assert made.code == "model-compile" and "package.mo" in made.remedy
    assert made.what.count("within M.Blocks") == 1 and made.what.endswith("and so do 2 more files")


def test_a_function_with_a_loop_of_unknown_length_is_told_in_words_of_the_language():
    why = "contains a statement without a checked DAE owner"
    said = f"failed in ToDae: unsupported `function statement`: `P.f` {why}"
    made = failures.translated(said, Path("M.mo"), b"model M end M;", "M")
    assert made.code == "model-function" and "`P.f`" in made.what and "`while`" in made.what
    assert "owner" not in str(made)
