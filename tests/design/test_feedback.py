"""A machine in the loop of its controller, against scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.design.aims import ParameterAim
from daest.design.design import Task, design
from daest.design.prepared import Subject, explainer
from daest.errors import DaestError
from daest.model.design import Limits, Range
from daest.modelica.closed_loop import closed_loop
from daest.modelica.compile import compile_model

FALL = """\
model Fall "Runs away when left alone"
  parameter Real a(unit = "1/s") = 4 annotation(__Daest(estimate = true));
  input Real u(unit = "V", start = 0);
  output Real y(unit = "m") annotation(__Daest(std = 0.1));
  Real x(unit = "m", start = 0, fixed = true);
equation
  der(x) = a*x + u;
  y = x;
end Fall;
"""
HOLD = """\
model Hold "Proportional and integral"
  parameter Real K = 8;
  input Real y;
  input Real r(unit = "m");
  output Real u;
  Real e;
equation
  der(e) = r - y;
  u = K*(r - y) + 2*e;
end Hold;
"""
PERIOD, STD = 0.05, 0.1


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loop")
    found = []
    for name, text in (("Fall", FALL), ("Hold", HOLD)):
        (folder / f"{name}.mo").write_text(text)
        found.append(compile_model(folder / f"{name}.mo"))
    return found


def outputs(reference, a=4.0, start=(0.0, 0.0)):
    """y of the loop by scipy, the reference held."""
    s, y = np.array(start), []
    for r in reference:
        y.append(s[0])

        def rate(_, z, r=r):
            return [a * z[0] + 8 * (r - z[0]) + 2 * z[1], r - z[0]]

        s = solve_ivp(rate, (0.0, PERIOD), s, method="LSODA", rtol=1e-10, atol=1e-12).y[:, -1]
    return np.array(y)


def test_a_design_for_the_reference(parts):
    """The machine alone is refused; in the loop its command keeps the limits of the machine, and the error
    that is promised is that of scipy's slopes, both initial states unknown."""
    plant, controller = parts
    loop = closed_loop(plant, controller)
    assert [v.name for v in loop.inputs] == ["r"] and {"u", "x", "controller.e"} <= {
        v.name for v in loop.unknowns
    }
    safe = (Range("u", "V", -6.0, 6.0),)
    for flat, name, ranges in ((plant, "u", ()), (loop, "r", safe)):
        allowed = Limits((Range(name, "", -1.0, 1.0),), 8.0, PERIOD, ranges, hold="zoh")
        subject = Subject(flat, ("a",))
        aim = ParameterAim(explainer(subject, PERIOD, "zoh"), (0,), "D", np.zeros((1, 1)))
        task = Task(aim, (subject,), allowed, seconds=0.4, commanded=("u",) if ranges else ())
        if not ranges:
            with pytest.raises(DaestError, match="unstable"):
                design(task)
    found = design(task)
    assert found.sensors == () and -6.0 <= found.safety[0].lowest < found.safety[0].highest <= 6.0
    r = found.inputs[:, 0]
    steps = [{"a": 4.0 + 1e-5}, {"start": (1e-5, 0.0)}, {"start": (0.0, 1e-5)}]
    slopes = np.array([(outputs(r, **step) - outputs(r)) / 1e-5 for step in steps]).T
    error = STD * np.sqrt(np.linalg.inv(slopes.T @ slopes)[0, 0])
    assert found.expected.std_errors["a"] == pytest.approx(error, rel=1e-3)


def test_controllers_that_do_not_fit(parts):
    plant, controller = parts
    for other in (plant, closed_loop(plant, controller)):
        with pytest.raises(DaestError) as problem:
            closed_loop(plant, other)
        assert problem.value.code == "controller-fit"
