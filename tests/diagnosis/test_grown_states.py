"""The states that effects bring, beside those of the model."""

from pathlib import Path

import numpy as np

from daest.diagnosis.screening.grown_states import grown_states
from daest.modelica.compile import compile_text
from daest.systems.reduction.reduce import reduce_index

WELL = """model Well "With a pump that stands still its equations have no solution"
  input Real n(unit="1");
  output Real h(unit="m");
  Real q(unit="l/min", start=500);
  {own}
equation
  q/830 = -1.2 + 6.4*n^2 - 3.3e-6*q^2 - 3 - 0.1*h;
  28*60000*der(h) = q - 500;
  {law}
end Well;
"""


def test_states_are_told_at_inputs_where_the_model_has_a_solution():
    plain, grown = (
        reduce_index(compile_text(WELL.format(own=own, law=law).encode(), Path("Well.mo")))
        for own, law in (("", ""), ('Real late(unit="m", start=0);', "3600*der(late) = h - late;"))
    )
    theta = plain.flat.theta_values
    found = grown_states(plain, theta, np.array([2.0]), np.array([0.96]), grown)
    assert [grown.state_names[i] for i in found.common] == ["h"]
    assert [grown.state_names[i] for i in found.brought] == ["late"]
