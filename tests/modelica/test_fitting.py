"""Redeclared classes that fit the constraining class without extending it."""

import numpy as np
import pytest

from daest.errors import ModelError
from daest.systems.simulation.simulate import simulate

PLANT = """package Plant
  connector Input = input Real;
  connector Output = output Real;
  partial model Interface "What a controller has"
    Input a;
    Output b;
  end Interface;
  model Gain "Fits, and says so"
    extends Interface;
  equation
    b = a;
  end Gain;
  model Other "Fits as well"
    Input a;
    Output b;
    parameter Real k = 3;
  equation
    b = k*a;
  end Other;
  model Lacking
    Input a;
    Real c = a;
  end Lacking;
  model Loop
    replaceable Gain c constrainedby Interface;
    Real x(start = 1, fixed = true);
  equation
    der(x) = -c.b;
    c.a = x;
  end Loop;
  model Fits
    extends Loop(redeclare Other c(k = 4));
  end Fits;
  model Lacks
    extends Loop(redeclare Lacking c);
  end Lacks;
end Plant;
"""


def test_a_class_that_fits_is_taken(compiled):
    flat = compiled(PLANT, "Plant.Fits")
    time = np.linspace(0, 1, 11)
    found = simulate(flat, (time, np.zeros((11, 0))))
    assert found.states[:, 0] == pytest.approx(np.exp(-4 * time), rel=1e-6)


def test_a_class_that_lacks_something_is_refused(compiled):
    with pytest.raises(ModelError) as caught:
        compiled(PLANT, "Plant.Lacks")
    assert "constraining class" in caught.value.what and "extend the constraining one" in caught.value.remedy
