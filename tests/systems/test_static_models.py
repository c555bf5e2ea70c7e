"""Models whose outputs follow from inputs and parameters alone: no equation is left to solve."""

from pathlib import Path

from daest.modelica.compile import compile_text
from daest.systems.linearize import linearize
from daest.systems.split import split

STATIC = b"model S\n  parameter Real a = 2;\n  input Real u;\n  output Real y = 3*a*u;\nend S;\n"


def test_model_without_equations_of_its_own_has_a_linear_form():
    flat = compile_text(STATIC, Path("S.mo"))
    dae = linearize(flat)
    assert flat.n == dae.n == 0
    assert split(dae).n_dynamic == 0
