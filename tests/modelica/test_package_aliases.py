"""Other names of packages among the declarations of a class."""

from pathlib import Path

import pytest

from daest.modelica.compile import compile_text
from daest.modelica.forms.package_aliases import with_imported_packages

WHEEL = b"""model Wheel
  package R = Daest.Mechanics.Rotational "short";
  input Real tau(unit = "N.m");
  output Real w(unit = "rad/s");
  R.Components.Inertia inertia(J = 2);
  R.Sources.Torque torque;
equation
  torque.tau = tau;
  connect(torque.flange, inertia.flange_a);
  w = inertia.w;
end Wheel;
"""


def test_components_are_found_by_another_name_of_their_package():
    flat = compile_text(WHEEL, Path("Wheel.mo"))
    assert "inertia.J" in {p.name for p in flat.parameters} and flat.output_names == ("w",)


def test_nothing_else_moves():
    made = with_imported_packages(WHEEL)
    assert len(made) == len(WHEEL) and made.count(b"import  R = Daest") == 1


@pytest.mark.parametrize(
    "text",
    [
        "model M package R = Inner; package Inner end Inner; end M;",  # known here alone
        "model M replaceable package R = Lib.A; end M;",
        "model M package R = Lib.A(n = 2); end M;",
        "package P package R = Lib.A; end P;",  # used as P.R elsewhere
        "package R = Lib.A;",
        'model M parameter String package_R = "package R = Lib.A;"; end M;',
    ],
)
def test_what_is_more_than_another_name_stays(text):
    assert with_imported_packages(text.encode()) == text.encode()
