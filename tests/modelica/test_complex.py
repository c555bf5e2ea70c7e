"""Complex numbers: equations by parts, against complex arithmetic of numpy."""

import numpy as np
import pytest

import daest
from daest.errors import ModelError
from daest.modelica.language.components import Classes
from daest.systems.simulation.simulate import simulate

OPERATORS = {
    "'-'": ("-c1", "negate", "Complex(-c1.re, -c1.im)"),
    "'+'": ("+", "add", "Complex(c1.re + c2.re, c1.im + c2.im)"),
    "'*'": ("*", "multiply", "Complex(c1.re*c2.re - c1.im*c2.im, c1.re*c2.im + c1.im*c2.re)"),
}
CONSTRUCTOR = """  encapsulated operator 'constructor'
    function fromReal
      import Complex;
      input Real re;
      input Real im = 0;
      output Complex result(re = re, im = im);
    algorithm
    end fromReal;
  end 'constructor';
"""
PRODUCT = """    function scalarProduct
      import Complex;
      input Complex c1[:];
      input Complex c2[size(c1, 1)];
      output Complex c3;
    algorithm
      c3 := Complex(0);
      for i in 1:size(c1, 1) loop
        c3 := Complex(c3.re + c1[i].re*c2[i].re + c1[i].im*c2[i].im,
                      c3.im + c1[i].re*c2[i].im - c1[i].im*c2[i].re);
      end for;
    end scalarProduct;
"""
BODY = {
    "real": ("Real r", "r := c.re"),
    "imag": ("Real r", "r := c.im"),
    "abs": ("Real r", "r := sqrt(c.re^2 + c.im^2)"),
    "arg": ("Real r", "r := atan2(c.im, c.re)"),
    "conj": ("Complex r", "r := Complex(c.re, -c.im)"),
    "exp": ("Complex r", "r := Complex(exp(c.re)*cos(c.im), exp(c.re)*sin(c.im))"),
}


def _operators() -> str:
    made = ""
    for name, (_, function, result) in OPERATORS.items():
        second = "" if function == "negate" else "      input Complex c2;\n"
        made += (
            f"  encapsulated operator {name}\n    function {function}\n      import Complex;\n"
            f"      input Complex c1;\n{second}      output Complex c3;\n"
            f"    algorithm\n      c3 := {result};\n"
            f"    end {function};\n{PRODUCT if function == 'multiply' else ''}  end {name};\n"
        )
    return made


def _math() -> str:
    functions = "".join(
        f"  function '{n}'\n    input Complex c;\n    output {r};\n  algorithm\n    {b};\n  end '{n}';\n"
        if n == "abs"
        else f"  function {n}\n    input Complex c;\n    output {r};\n  algorithm\n    {b};\n  end {n};\n"
        for n, (r, b) in BODY.items()
    )
    return "within Modelica;\npackage ComplexMath\n  final constant Complex j = Complex(0, 1);\n" + (
        f"{functions}end ComplexMath;\n"
    )


FILES = {
    "Complex.mo": (
        "within ;\noperator record Complex\n  Real re;\n  Real im;\n"
        f"{CONSTRUCTOR}{_operators()}end Complex;\n"
    ),
    "Modelica/package.mo": "within ;\npackage Modelica\nend Modelica;\n",
    "Modelica/ComplexMath.mo": _math(),
    "Modelica/Types.mo": (
        "within Modelica;\npackage Types\n  operator record ComplexVoltage = Complex;\n"
        "  connector Pin\n    ComplexVoltage v;\n    flow Complex i;\n  end Pin;\nend Types;\n"
    ),
    "Modelica/Port.mo": (
        "within Modelica;\npartial model Port\n  Types.Pin p, n;\n  Types.ComplexVoltage v;\n  Complex i;\n"
        "  Real P = Modelica.ComplexMath.real(v*Modelica.ComplexMath.conj(i));\n"
        "equation\n  v = p.v - n.v;\n  i = p.i;\n  p.i + n.i = Complex(0);\nend Port;\n"
    ),
    "Modelica/Impedance.mo": (
        "within Modelica;\nmodel Impedance\n  extends Port;\n  parameter Real R = 1, X = 0;\nequation\n"
        "  v = Complex(R, X)*i;\nend Impedance;\n"
    ),
    "Modelica/Source.mo": (
        "within Modelica;\nmodel Source\n  extends Port;\n  input Real re, im;\nequation\n"
        "  v = Complex(re, im);\nend Source;\n"
    ),
    "Modelica/Ground.mo": (
        "within Modelica;\nmodel Ground\n  Types.Pin p;\nequation\n  p.v = Complex(0);\nend Ground;\n"
    ),
    # No word of Complex stands in this one.
    "Modelica/Short.mo": (
        "within Modelica;\nmodel Short\n  extends Port;\nequation\n  v - v = v;\nend Short;\n"
    ),
}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """`run(text, inputs)`: what the model M of a text computes at one instant."""
    monkeypatch.setenv("DAEST_CACHE", str(tmp_path / "cache"))
    for name, text in FILES.items():
        file = tmp_path / "lib" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)

    def work(text: str, *inputs: float) -> dict[str, float]:
        (tmp_path / "M.mo").write_text(text)
        flat = daest.compile_model(tmp_path / "M.mo", libraries=[tmp_path / "lib"])
        found = simulate(flat, (np.array([0.0, 1.0]), np.tile(inputs, (2, 1))))
        return dict(zip(found.variable_names, found.variables[-1], strict=True)) | dict(
            zip(found.output_names, found.outputs[-1], strict=True)
        )

    return work


def _number(values: dict[str, float], name: str) -> complex:
    return complex(values[f"{name}.re"], values[f"{name}.im"])


A, B = 0.7 - 1.3j, -0.4 + 2.1j
GIVEN = "  input Real a_re, a_im, b_re, b_im;\n  Complex a = Complex(a_re, a_im), b = Complex(b_re, b_im);\n"


@pytest.mark.parametrize(
    "term, truth",
    [
        ("a + b*a - 2*b", A + B * A - 2 * B),
        pytest.param("-a*b/(a + b)", -A * B / (A + B), marks=pytest.mark.slow),
        ("a^3/2 - (a - b)^2", A**3 / 2 - (A - B) ** 2),
        ("Modelica.ComplexMath.exp(j*a_re)*b", np.exp(1j * A.real) * B),
        ("Modelica.ComplexMath.conj(a*b) + j", np.conj(A * B) + 1j),
        ("(if a_re > 0 then a else Complex(0))*b", A * B),
        pytest.param("a/Modelica.ComplexMath.abs(2*b)^2", A / abs(2 * B) ** 2, marks=pytest.mark.slow),
        (
            "Modelica.ComplexMath.arg(a*b)*a/(2*Modelica.ComplexMath.real(a*b))",
            np.angle(A * B) * A / (2 * (A * B).real),
        ),
        ("sum({k*a*b for k in 1:3})", 6 * A * B),
    ],
)
def test_operators_are_those_of_numpy(run, term, truth):
    text = (
        f"model M\n  import Modelica.ComplexMath.j;\n{GIVEN}  Complex c;\nequation\n  c = {term};\nend M;\n"
    )
    assert _number(run(text, A.real, A.imag, B.real, B.imag), "c") == pytest.approx(truth, rel=1e-12)


def test_equations_between_terms_and_in_modifications(run):
    text = (
        f'model M\n{GIVEN}  Complex c(re(unit = "1"), im(unit = "1")) = a*b;\n  Complex d;\n'
        "equation\n  d*a - b = c;\nend M;\n"
    )
    found = run(text, A.real, A.imag, B.real, B.imag)
    assert _number(found, "c") == pytest.approx(A * B, rel=1e-12)
    assert _number(found, "d") == pytest.approx((A * B + B) / A, rel=1e-12)


def test_arrays_are_taken_element_by_element(run):
    text = (
        f"model M\n{GIVEN}  parameter Integer m = 3;\n  Complex u[m], v[m] = 2*u, w[m];\n"
        "  Complex s;\nequation\n  for k in 1:m loop\n    u[k] = k*a + b;\n  end for;\n"
        "  w - v = fill(a, m);\n  s = u*v;\nend M;\n"
    )
    found = run(text, A.real, A.imag, B.real, B.imag)
    u = np.arange(1, 4) * A + B
    for k in range(3):
        assert _number(found, f"w[{k + 1}]") == pytest.approx(2 * u[k] + A, rel=1e-12)
    # The scalar product of the library conjugates its first vector.
    assert _number(found, "s") == pytest.approx(np.vdot(u, 2 * u), rel=1e-12)


CIRCUIT = (
    "model M\n  input Real U;\n  Modelica.Source source(re = U, im = 0);\n  Modelica.Ground ground;\n"
    "  Modelica.Impedance one(R = 3, X = 4);\n  {two};\nequation\n  connect(source.p, one.p);\n"
    "  connect(one.n, two.p);\n  connect(two.n, source.n);\n  connect(source.n, ground.p);\nend M;\n"
)


def test_circuit_of_phasors(run):
    """Two impedances in series behind a source: the phasors by hand."""
    found = run(CIRCUIT.format(two="Modelica.Impedance two(R = 1, X = -2)"), 10.0)
    current = 10 / (3 + 4j + 1 - 2j)
    assert _number(found, "one.i") == pytest.approx(current, rel=1e-12)
    assert _number(found, "two.v") == pytest.approx((1 - 2j) * current, rel=1e-12)
    assert found["one.P"] == pytest.approx(3 * abs(current) ** 2, rel=1e-12)


def test_a_class_that_inherits_its_complex_variables(run):
    found = run(CIRCUIT.format(two="Modelica.Short two"), 10.0)
    assert _number(found, "one.i") == pytest.approx(10 / (3 + 4j), rel=1e-12)


@pytest.mark.parametrize("kind", ["", "parameter "])
def test_a_binding_from_outside_is_never_dropped(run, kind):
    """It holds, or the model is refused: a class that binds its own variable to a term."""
    text = (
        f"model Part\n  {kind}Complex a = Complex(1, 2);\n  {kind}Complex c = a*a;\nend Part;\n"
        "model M\n  Part part(c = Complex(5, 7));\n  output Real y = part.c.im, x = 2*y;\nend M;\n"
    )
    try:
        found = run(text)
    except ModelError:
        return
    assert found["y"] == pytest.approx(7)


def test_what_is_not_understood_is_refused(run):
    """No operator is left out or taken for another one."""
    text = f"model M\n{GIVEN}  Complex c;\nequation\n  c = a^b;\nend M;\n"
    with pytest.raises(ModelError, match="Complex"):
        run(text, 1.0, 2.0, 3.0, 4.0)


def test_names_are_looked_up_as_the_language_does():
    texts = {
        "P": b"package P\n  import L = P.Inside;\n  constant Real g = 9.81;\nend P;\n",
        "P.Inside": (
            b"within P;\npackage Inside\n  type T = Real;\n  model A\n    T x[3](each min = 0) = y, z;\n"
            b"  end A;\nend Inside;\n"
        ),
        "P.B": b"within P;\nmodel B\n  extends L.A;\n  Nothing q;\nend B;\n",
    }
    classes = Classes(texts.get)
    found = classes.component("x", "P.B")
    assert found is not None and classes.type_of(found) == "Real"
    assert [[word.text for word in size] for size in found.sizes] == [["3"]]
    assert [word.text for word in found.binding] == ["y"]
    other = classes.component("q", "P.B")
    assert other is not None and classes.type_of(other) is None
    assert classes.component("w", "P.B") is None
