"""Values that an `inner` component gives decide branches, conditional components and start equations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daest.errors import ModelError
from daest.modelica.compile import compile_text
from daest.systems.simulation.simulate import simulate

_SYSTEM = """within ;
model Sys
  parameter Dyn d = Dyn.Fixed "how the start is";
  parameter Dyn m = d;
  parameter Boolean b = false;
end Sys;
"""
_REST = """
  type Dyn = enumeration(Free, Fixed, Steady);
  model Load
    input Real u;
    output Real y = 2*u;
  end Load;
  model Tank
    outer Sys sys;
    parameter Dyn e = sys.m;
    parameter Boolean b = sys.b;
    Real x;
    Load load(u = x) if b;
  initial equation
    if e == Dyn.Fixed then
      x = 3;
    elseif e == Dyn.Steady then
      der(x) = 0;
    end if;
  equation
    der(x) = 1 - x;
  end Tank;
  model M
    inner Sys sys(d = Dyn.Steady, b = true);
    Tank t;
    Tank own(e = Dyn.Fixed, b = false);
  end M;
  model Other
    inner Sys sys;
    Tank t;
  end Other;
  model Group
    parameter Dyn d;
    inner Sys sys(d = d);
    Tank t;
  end Group;
  model Two
    Group a(d = Dyn.Fixed);
    Group b(d = Dyn.Steady);
  end Two;
end P;
"""
_ALL = "package P" + _SYSTEM.replace("within ;", "") + _REST


def _start(text: str, name: str, libraries: list[Path], overrides: dict[str, float]) -> dict[str, float]:
    flat = compile_text(text.encode(), Path("P.mo"), name, libraries, overrides)
    run = simulate(flat, (np.linspace(0, 1, 3), np.zeros((3, 0))))
    return dict(zip(run.variable_names, run.variables[0].tolist(), strict=True))


def test_the_modification_of_an_inner_component_decides() -> None:
    """Solutions by hand: the steady x is 1, the fixed one 3; the load is there once."""
    assert _start(_ALL, "P.M", [], {}) == pytest.approx({"t.x": 1, "t.load.y": 2, "own.x": 3})


def test_the_default_decides_where_nothing_is_modified() -> None:
    assert _start(_ALL, "P.Other", [], {}) == pytest.approx({"t.x": 3})


def test_a_value_from_outside_decides() -> None:
    made = _start(_ALL, "P.M", [], {"sys.b": 0.0})
    assert made == pytest.approx({"t.x": 1, "own.x": 3})


def test_the_class_may_stand_in_a_library(tmp_path: Path) -> None:
    """The file of the library stays as it is."""
    folder = tmp_path / "Lib"
    folder.mkdir()
    kinds = "within ;\npackage Lib\n  type Dyn = enumeration(Free, Fixed, Steady);\nend Lib;\n"
    (folder / "package.mo").write_text(kinds)
    (folder / "package.order").write_text("Dyn\nSys\n")
    system = _SYSTEM.replace("within ;", "within Lib;")
    (folder / "Sys.mo").write_text(system)
    rest = _REST.replace("  type Dyn = enumeration(Free, Fixed, Steady);\n", "")
    text = "package P import Lib.Sys; import Lib.Dyn;" + rest.replace("outer Sys", "outer Lib.Sys").replace(
        "inner Sys", "inner Lib.Sys"
    ).replace("Dyn", "Lib.Dyn").replace("import Lib.Lib.Dyn", "import Lib.Dyn")
    made = _start(text.replace("import Lib.Sys; import Lib.Dyn;", ""), "P.M", [tmp_path], {})
    assert made == pytest.approx({"t.x": 1, "t.load.y": 2, "own.x": 3})
    assert (folder / "Sys.mo").read_text() == system


def test_two_values_of_one_class_are_refused() -> None:
    with pytest.raises(ModelError, match=r"sys\.d` is another") as caught:
        _start(_ALL, "P.Two", [], {})
    assert caught.value.code == "model-inner"
    assert str(caught.value.where).startswith("P.mo:3")
