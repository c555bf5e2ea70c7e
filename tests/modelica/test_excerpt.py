"""The part of a library that a model needs, and what is written otherwise for the compiler."""

from pathlib import Path

import numpy as np
import pytest

import daest
from daest.errors import ModelError
from daest.modelica.forms.dialect import adapted, external_objects
from daest.modelica.forms.excerpt import excerpt
from daest.systems.linear.linearize import linearize
from daest.systems.simulation.simulate import simulate

FILES = {
    "package.mo": 'within ;\npackage Base\n  annotation(version = "2.1.0");\nend Base;\n',
    "Units.mo": 'within Base;\npackage Units\n  type Speed = Real(unit = "m/s");\nend Units;\n',
    "Lag.mo": (
        "within Base;\nmodel Lag\n  import U = Base.Units;\n  parameter Real T = 2;\n"
        "  U.Speed v(start = 1);\nequation\n  der(T*v) = -v;\nend Lag;\n"
    ),
    "Unused.mo": "within Base;\nmodel Unused\n  Nowhere.Part part;\nend Unused;\n",
    "Notes/Old.mo": "within Base.Notes;\nmodel Old\nend Old;\n",
}
BOOK = (
    "within ;\npackage Book\n  model Example\n    extends Base.Lag;\n  end Example;\n"
    '  annotation(uses(Base(version = "2.0.0")));\nend Book;\n'
)


@pytest.fixture
def libraries(tmp_path, monkeypatch):
    """Base in two versions, of which Book asks for one; Notes is a folder without package.mo."""
    monkeypatch.setenv("DAEST_CACHE", str(tmp_path / "cache"))
    root = tmp_path / "lib"
    for version in ("2.0.1", "3.0.0"):
        for name, text in FILES.items():
            file = root / f"Base {version}" / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text.replace("T = 2", f"T = {version[0]}"))
    (root / "Book.mo").write_text(BOOK)
    return root


def test_only_what_is_named_is_read(libraries):
    text = b"model M\n  extends Base.Lag;\nend M;\n"
    found = excerpt([libraries / "Base 2.0.1"], [], text, Path("M.mo"))
    assert found is not None
    names = {file.name for file in found.folders[0].rglob("*.mo")}
    assert {"package.mo", "Lag.mo", "Units.mo"} <= names
    assert "Unused.mo" not in names and "Old.mo" not in names


def test_a_library_names_the_version_of_another_one(libraries, tmp_path):
    (tmp_path / "M.mo").write_text("model M\n  extends Book.Example;\nend M;\n")
    flat = daest.compile_model(tmp_path / "M.mo", libraries=[libraries])
    assert [p.value for p in flat.parameters if p.name == "T"] == [2.0]
    # der(T*v) = -v with T = 2: a pole at -1/2.
    linear = linearize(flat)
    assert np.linalg.solve(linear.E, linear.J) == pytest.approx(-0.5)


def test_a_missing_class_is_told_with_the_place_in_the_own_file(libraries, tmp_path):
    (tmp_path / "M.mo").write_text("model M\n  Base.Leg lag;\nend M;\n")
    with pytest.raises(ModelError) as caught:
        daest.compile_model(tmp_path / "M.mo", libraries=[libraries])
    assert caught.value.code == "model-unknown-class" and "Base.Leg" in caught.value.what


TABLE = b"""package P
class Table "read in C"
  extends ExternalObject;
  function constructor
    input Real rows[:, :];
    output Table table;
    external "C" table = make(rows, size(rows, 1), size(rows, 2));
  end constructor;
  function destructor
    input Table table;
    external "C" destroy(table);
  end destructor;
end Table;
end P;
"""


def test_an_external_object_becomes_a_number_and_a_function():
    made = adapted(TABLE)
    assert external_objects(TABLE) == ("Table",)
    assert b"type Table = Integer;" in made and b"function Table_constructor" in made
    assert b"destructor" not in made
    assert made.count(b"\n") == TABLE.count(b"\n")


def test_der_of_expressions_alone_is_marked():
    text = b'der(x) + der(a.b[1].c) + der(x*y) // der(x*y)\n "der(x*y)" der( z )'
    assert adapted(text) == text.replace(b"der(x*y) //", b"deR(x*y) //")
    assert len(adapted(text)) == len(text)


def test_the_derivative_of_a_product(tmp_path):
    file = tmp_path / "M.mo"
    file.write_text(
        "model M\n  Real m(start = 1, fixed = true);\n  Real v(start = 2, fixed = true);\nequation\n"
        "  der(m) = 1;\n  der(m*v) = 0;\nend M;\n"
    )
    time = np.linspace(0, 2, 21)
    found = simulate(daest.compile_model(file), (time, np.zeros((21, 0))))
    assert found["v"] == pytest.approx(2 / (1 + time), rel=1e-7)


def test_parameters_that_the_start_decides(tmp_path):
    file = tmp_path / "M.mo"
    file.write_text(
        "model M\n  parameter Real a = 3;\n  parameter Real b(fixed = false);\n"
        "  parameter Real c(fixed = false);\n"
        "  parameter Real d[2] = {1, 2};\n  parameter Integer n = 4;\n  Real w[4];\n"
        "  Real x(start = 5, fixed = true);\ninitial algorithm\n  b := 2*a;\ninitial equation\n  c = x + 1;\n"
        "equation\n  der(x) = -b;\n  w = fill(c + n, 4);\nend M;\n"
    )
    flat = daest.compile_model(file)
    assert {p.name for p in flat.derived_parameters} == {"b"}
    found = simulate(flat, (np.array([0.0, 0.5]), np.zeros((2, 0))))
    assert found["x"] == pytest.approx([5, 2])
    assert found["w[4]"] == pytest.approx([10, 10])


def test_a_branch_that_is_not_taken_spoils_no_slope(tmp_path):
    file = tmp_path / "M.mo"
    file.write_text(
        "model M\n  Real x(start = 0);\n  Real y;\nequation\n  der(x) = -x;\n"
        "  y = noEvent(if abs(x) > 1e-3 then sin(x)/x else 1 + x);\nend M;\n"
    )
    linear = linearize(daest.compile_model(file))
    assert np.all(np.isfinite(linear.J)) and np.abs(linear.J).max() == pytest.approx(1.0)


def test_a_parameter_asks_for_the_size_of_an_input(tmp_path):
    file = tmp_path / "M.mo"
    file.write_text(
        "model M\n  model Part\n    input Real lines[:];\n    Real total = n*sum(lines);\n  protected\n"
        "    parameter Integer n = size(lines, 1);\n  end Part;\n  Real x(start = 1);\n"
        "  Part part(lines = {x, 2*x, 3*x});\nequation\n  der(x) = -part.total;\nend M;\n"
    )
    linear = linearize(daest.compile_model(file))
    column = [v.name for v in linear.unknowns].index("x")
    rows = np.flatnonzero(linear.E[:, column])
    assert rows.size == 1
    found = simulate(daest.compile_model(file), (np.array([0.0, 0.1]), np.zeros((2, 0))))
    assert found["x"][-1] == pytest.approx(np.exp(-1.8))
