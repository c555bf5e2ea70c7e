"""Parameters that other ones decide."""

import numpy as np
import pytest

from daest.systems.simulation.simulate import simulate


def test_a_parameter_bound_to_one_that_the_start_settles(compiled):
    """`direction` follows from where the start is, and what is bound to it does as well."""
    flat = compiled(
        "model M\n  parameter Real direction[2](each fixed = false);\n"
        "  parameter Real twice[2] = 2*direction;\n  Real x(start = 3, fixed = true), y = twice[2];\n"
        "initial equation\n  direction = {x, x/3};\nequation\n  der(x) = -twice[1];\nend M;"
    )
    time = np.linspace(0, 1, 3)
    found = simulate(flat, (time, np.zeros((3, 0))))
    at = found.variable_names.index
    assert found.variables[:, at("x")] == pytest.approx(3 - 6 * time)
    assert found.variables[:, at("y")] == pytest.approx(np.full(3, 2.0))
