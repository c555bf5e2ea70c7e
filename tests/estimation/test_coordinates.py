"""Units of what is searched for."""

import numpy as np
import pytest

from daest.estimation.fitting.coordinates import Coordinate, Unknowns, rescaled
from daest.estimation.fitting.search import Evaluation


@pytest.mark.parametrize(("information", "scale"), [(1e-6, 1e4), (1e-31, 1.0), (0.0, 1.0)])
def test_unit_of_a_linear_unknown_is_not_made_of_rounding(information, scale):
    """A wall between two parts that are equally warm: the outputs move by rounding alone."""
    one = Coordinate("wall.G", "parameter", 0, 0.5, False, 1.0, -np.inf, np.inf)
    unknowns = Unknowns((one,), np.array([0.5]), np.zeros(0), np.ones(1))
    here = Evaluation(0.0, np.zeros(1), np.array([[information]]))
    (found,) = rescaled(unknowns, lambda: here, 100).coordinates
    assert found.scale == pytest.approx(scale)
