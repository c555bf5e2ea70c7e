"""Modifications: of redeclared classes, of replaceable components, and of what a class does not have."""

from pathlib import Path

import casadi as ca
import pytest

from daest.errors import ModelError
from daest.modelica.compile import compile_text

DRIVES = """package Drives
  partial model Law
    input Real w;
    output Real t;
  end Law;
  model Linear
    extends Law;
    parameter Real d = 0.1;
  equation
    t = d*w;
  end Linear;
  model Quadratic
    extends Law;
    parameter Real c = 0.2;
    Real p = c if c > 5;
  equation
    t = c*w*abs(w);
  end Quadratic;
  model Seven = Quadratic(c = 0.7);
  model Drive
    replaceable model Friction = Linear(d = 0.3) constrainedby Law;
    Friction fr(w = w);
    Real w(start = 1, fixed = true);
  equation
    der(w) = -fr.t;
  end Drive;
  model Part
    replaceable Linear fr(d = 0.4) constrainedby Law;
    Real w(start = 1, fixed = true) = fr.w;
  equation
    der(w) = -fr.t;
  end Part;
  model Extended extends Drive(redeclare model Friction = Quadratic(c = 0.5)); end Extended;
  model Inside Drive d(redeclare model Friction = Quadratic(c = 0.5)); end Inside;
  model Short = Drive(redeclare model Friction = Quadratic(c = 0.5));
  model Alias extends Drive(redeclare model Friction = Seven); end Alias;
  model Plain extends Drive; end Plain;
  model Other Part d(redeclare Quadratic fr(c = 0.6)); end Other;
  model Kept extends Drive(redeclare model Friction = Quadratic, fr(c = 0.8, p(start = 1))); end Kept;
  model Variable
    parameter Real k = 2;
    extends Drive(redeclare model Friction = Quadratic(c = k));
  end Variable;
  model Misspelt extends Drive(Friktion = 3); end Misspelt;
  model Deep Drive d(fr(dd = 3)); end Deep;
  model Attribute extends Drive(w(strt = 2)); end Attribute;
  model OfClass extends Drive(redeclare model Friction = Quadratic(d = 1)); end OfClass;
  model Direct Drive d(nix = 3); end Direct;
end Drives;
"""


def compiled(name: str):
    return compile_text(DRIVES.encode(), Path("Drives.mo"), f"Drives.{name}")


@pytest.mark.parametrize(
    ("name", "parameter", "value"),
    [
        ("Extended", "fr.c", 0.5),
        ("Inside", "d.fr.c", 0.5),
        ("Short", "fr.c", 0.5),
        ("Alias", "fr.c", 0.7),
        ("Plain", "fr.d", 0.3),
        ("Other", "d.fr.c", 0.6),
        ("Kept", "fr.c", 0.8),
    ],
)
def test_a_redeclared_class_keeps_its_modification(name, parameter, value):
    assert {p.name: p.value for p in compiled(name).parameters} == {parameter: value}


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Misspelt", "has no `Friktion`"),
        ("Deep", "`d.fr` has no `dd`"),
        ("Attribute", "variable `w` has no `strt`"),
        ("OfClass", "`Drives.Quadratic` has no `d`"),
        ("Direct", "unknown modifier `nix`"),
        ("Variable", "modified with the variable `k`"),
    ],
)
def test_what_a_modification_cannot_reach_is_told(name, said):
    with pytest.raises(ModelError) as caught:
        compiled(name)
    assert said in caught.value.what
    first = DRIVES[: DRIVES.index(f"model {name}")].count("\n") + 1
    line = int(str(caught.value.where).split(":")[1])
    assert line == first + (2 if name == "Variable" else 0)


BASE = """model Base
  parameter Real d(min = 0) = 0.1;
  parameter Real k = 2;
  input Real u;
  Real v(start = 0);
equation
  der(v) = k*u - d*v;
end Base;
model Around
  replaceable model Kind = Base;
  input Real u;
  Kind b(u = u);
end Around;
"""


ROOM = {"d": (0.1, 0.0, None), "k": (4.0, None, 5.0)}
REDECLARED = "Around a(redeclare model Kind = Base(k(max = 5) = 4), u = u);"


@pytest.mark.parametrize(
    ("text", "prefix", "expected"),
    [
        ("model M\n  extends Base(k(max = 5) = 4);\nend M;", "", ROOM),
        (
            "model M\n  extends Base(d(min = -1)\n    = -0.5);\nend M;",
            "",
            {"d": (-0.5, -1.0, None), "k": (2.0, None, None)},
        ),
        # Code behind the clause keeps its columns.
        ("model M extends Base(k(max = 5) = 4); Real z; equation z = v; end M;", "", ROOM),
        ("model M = Base(k(max = 5) = 4);", "", ROOM),
        ("model M\n  input Real u;\n  Base b(k(max = 5) = 4, u = u);\nend M;", "b.", ROOM),
        ("model M\n  input Real u;\n  Around a(b(k(max = 5) = 4), u = u);\nend M;", "a.b.", ROOM),
        (f"model M\n  input Real u;\n  {REDECLARED}\nend M;", "a.b.", ROOM),
        ("model M\n  extends Around(b(k(max = 5) = 4));\nend M;", "b.", ROOM),
    ],
)
def test_value_beside_attributes_in_a_modification_is_not_lost(text, prefix, expected):
    """The compiler takes neither where both stand together, but where a component is declared."""
    flat = compile_text(f"{BASE}{text}\n".encode(), Path("M.mo"), "M")
    assert {p.name.removeprefix(prefix): (p.value, p.min, p.max) for p in flat.parameters} == expected
    if "z = v" in text:
        assert next(e.place.column for e in flat.equations if "z" in e.text) == text.index("z = v") + 1


def test_final_value_beside_attributes_is_not_lost():
    text = "model M\n  extends Base(final k(max = 5) = 4); // as measured\nend M;\n"
    flat = compile_text(f"{BASE}{text}".encode(), Path("M.mo"), "M")
    assert [p.name for p in flat.parameters] == ["d"]
    assert abs(float(ca.jacobian(flat.residual, flat.u))) == 4.0
