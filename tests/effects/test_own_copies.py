"""Parameters of components of libraries, opened for effects in copies of their classes."""

from pathlib import Path

import numpy as np
import pytest

from daest.errors import ModelError
from daest.modelica.compile import compile_model
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.sites import find_site
from daest.systems.simulation.simulate import simulate

LIBRARY = """\
package Plant "A library with what names may hide behind"
  package Units
    type Rate = Real(unit = "1/s");
  end Units;
  package Parts
    constant Real unity = 1 "Found in the package around";
    function square
      input Real x; output Real y;
    algorithm
      y := x*x;
    end square;
    partial model Store
      input Real q; parameter Plant.Units.Rate k0 = 0.1; Real h(start = 1); Real loss;
    equation
      der(h) = q - loss - k0*h;
    end Store;
    model Tank "A tank"
      import Plant.Units;
      extends Store;
      parameter Units.Rate k(min = 0) = 0.2 "Outflow"
        annotation(Dialog(group = "k"));
    equation
      loss = unity*k*square(h);
      annotation(Icon(graphics = {Line(points = {{0, 0}, {1, 1}})}), Documentation(info = "k"));
    end Tank;
  end Parts;
end Plant;
"""

MODEL = """\
model Row "Tanks of a library"
  model Pair "Two tanks"
    input Real q; parameter Real k(unit = "1/s") = 0.3;
    Plant.Parts.Tank first(q = q, k = k), second(q = first.h, k = 0.25);
  end Pair;
  input Real u;
  parameter Real k(unit = "1/s") = 0.15;
  Plant.Parts.Tank tank(q = u, k = k), row[2](each q = u);
  Pair pair(q = u);
  output Real y[4] = {tank.h, row[1].h, row[2].h, pair.second.h};
end Row;
"""


@pytest.fixture(scope="module")
def row(tmp_path_factory):
    folder = tmp_path_factory.mktemp("row")
    libraries = folder / "libraries"
    libraries.mkdir()
    (libraries / "Plant.mo").write_text(LIBRARY)
    (folder / "Row.mo").write_text(MODEL)
    return folder / "Row.mo", libraries, compile_model(folder / "Row.mo", libraries=(libraries,))


def _extended(row, place: str):
    file, libraries, flat = row
    effect = find_effect("General.DependentParameter")
    site, values, inputs = find_site(flat, place, effect), {"r": 0.2}, {"z": "u"}
    made = extend_model(file, None, effect, site, values=values, inputs=inputs, libraries=(libraries,))
    return made, attach(flat, effect, site, values=values, inputs=inputs)


@pytest.mark.parametrize(
    ("place", "says"),
    [
        ("k", ["TankOpened tank(q = u, k = k)", "tank(k_used = dependentParameter.y)"]),
        ("row[2].k", ["row(k_used = {row[1].k, dependentParameter.y})"]),
        (
            "pair.k",
            ["    model TankOpened", "TankOpened first(", "pair(first(k_used = dependentParameter.y))"],
        ),
    ],
)
def test_the_class_of_a_library_is_copied_and_opened(row, place, says) -> None:
    made, merged = _extended(row, place)
    assert all(text in made.text for text in says)
    assert "loss = Plant.Parts.unity*k_used*Plant.Parts.square(h);" in made.text
    assert "extends Plant.Parts.Store;" in made.text and "Icon" not in made.text
    drive = (np.linspace(0.0, 2.0, 9), np.linspace(1.0, 3.0, 9)[:, None])
    expected = simulate(merged, drive).outputs
    assert simulate(made.flat, drive).outputs == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert np.abs(simulate(row[2], drive).outputs - expected).max() > 1e-3


def test_what_a_base_class_of_a_library_uses_stays(row) -> None:
    with pytest.raises(ModelError, match="cannot be written") as caught:
        _extended(row, "tank.k0")
    assert caught.value.code == "effect-not-writable"


def test_a_short_class_is_not_copied(row, tmp_path) -> None:
    """What it gives its parameters would be lost."""
    _, libraries, _ = row
    file = tmp_path / "Row.mo"
    file.write_text("""\
model Row
  model Wide = Plant.Parts.Tank(k = 0.7);
  input Real u; output Real y = tank.h; Wide tank(q = u);
end Row;
""")
    flat = compile_model(file, libraries=(libraries,))
    effect = find_effect("General.DependentParameter")
    with pytest.raises(ModelError, match="of a short class") as caught:
        extend_model(
            file, None, effect, find_site(flat, "tank.k", effect), inputs={"z": "u"}, libraries=(libraries,)
        )
    assert caught.value.code == "effect-not-writable"


def test_components_of_the_bundled_library(tmp_path: Path) -> None:
    parts = "Daest.Mechanics.Rotational"
    (tmp_path / "Motor.mo").write_text(f"""\
model Motor
  input Real u(unit = "N.m"); output Real w(unit = "rad/s") = rotor.w;
  {parts}.Components.Inertia rotor(J = 0.01);
  {parts}.Components.Damper damper(d = 0.02);
  {parts}.Components.Fixed ground;
  {parts}.Sources.Torque drive;
equation
  drive.tau = u;
  connect(drive.flange, rotor.flange_a);
  connect(rotor.flange_b, damper.flange_a);
  connect(damper.flange_b, ground.flange);
end Motor;
""")
    file = tmp_path / "Motor.mo"
    effect = find_effect("General.DependentParameter")
    site = find_site(compile_model(file), "damper.d", effect)
    made = extend_model(file, None, effect, site, inputs={"z": "rotor.w"})
    assert f"extends {parts}.Interfaces.PartialCompliantWithRelativeStates;" in made.text
    assert "tau = d_used*w_rel;" in made.text
