"""Effects between a body of bare equations and what an input moves it on, against the motion by scipy."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.sites import sites
from daest.systems.simulation.simulate import simulate

SLOPE = 0.3  # m/s, of the road
HEAD = """model Seat
  parameter Real m(unit = "kg") = 2;
  parameter Real k(unit = "N/m") = 40;
  parameter Real c(unit = "N.s/m") = 1.5;
  output Real y(unit = "m/s") = v;
  Real v(unit = "m/s", start = 0, fixed = true);
"""
BY_POSITION = HEAD + '  input Real zr(unit = "m");\n  Real z(unit = "m", start = 0, fixed = true);\n'
BY_SPEED = HEAD + '  input Real vr(unit = "m/s");\n  Real e(unit = "m", start = 0, fixed = true);\n'
FORCE = '  Real F(unit = "N");\n'
DEFLECTION = '  Real e(unit = "m");\n'


def _form(head, declared, *equations):
    lines = "".join(f"  {equation};\n" for equation in equations)
    return f"{head}{declared}equation\n{lines}end Seat;\n"


BALANCE = _form(BY_POSITION, "", "der(z) = v", "m*der(v) = -k*(z - zr) - c*v")
FORMS = {  # with the relative motion as Modelica writes it
    "balance": (BALANCE, "z - zr"),
    "force": (_form(BY_POSITION, FORCE, "der(z) = v", "F = k*(zr - z) - c*v", "m*der(v) = F"), "zr - z"),
    "deflection": (_form(BY_POSITION, DEFLECTION, "der(z) = v", "e = z - zr", "m*der(v) = -k*e - c*v"), "e"),
    "both": (
        _form(BY_POSITION, FORCE + DEFLECTION, "der(z) = v", "e = z - zr", "F = k*e + c*v", "m*der(v) = -F"),
        "e",
    ),
    "speed": (_form(BY_SPEED, "", "der(e) = v - vr", "m*der(v) = -k*e - c*(v - vr)"), "e"),
    "rate": (_form(BY_SPEED, "", "der(e) = v - vr", "m*der(v) = -k*e - c*der(e)"), "e"),
    "other unit": (
        _form(
            BY_POSITION.replace('zr(unit = "m")', 'zr(unit = "mm")'),
            "",
            "der(z) = v",
            "m*der(v) = -k*(z - zr/1000) - c*v",
        ),
        "z - 0.001*zr",
    ),
    "carriage": (
        _form(
            HEAD + '  input Real vr(unit = "m/s");\n  Real z(unit = "m", start = 0, fixed = true);\n',
            FORCE + '  Real x(unit = "m", start = 0, fixed = true);\n',
            "der(x) = vr",
            "der(z) = v",
            "F = k*(x - z) - c*v",
            "m*der(v) = F",
        ),
        "x - z",
    ),
}
LAWS = {
    "Translational.HardeningSpring": ({"c3": 4e3}, lambda x, v: 4e3 * x**3),
    "Translational.ViscousFriction": ({"d": 6.0}, lambda x, v: 6.0 * v),
    "Translational.CoulombFriction": ({"f_c": 0.4, "v_s": 0.01}, lambda x, v: 0.4 * np.tanh(v / 0.01)),
}
PAIRS = [  # every form and every law; all pairs among the slow tests
    pytest.param(form, law, marks=pytest.mark.slow if i % len(LAWS) != j else ())
    for i, form in enumerate(FORMS)
    for j, law in enumerate(LAWS)
]


def simulated(flat):
    """The speed after 2 s on the road that rises from 0 at SLOPE."""
    time = np.linspace(0.0, 2.0, 41)
    road = SLOPE * {"m": time, "mm": 1e3 * time, "m/s": np.ones(time.size)}[flat.inputs[0].unit]
    return simulate(flat, (time, road[:, None]), hold="foh").outputs[-1]


@cache
def by_scipy(of_road, law):
    """The same with the force law(x, v) between the body and the road; the damper is `of_road` or fixed."""

    def rate(t, state):
        z, v = state
        x, relative = z - SLOPE * t, v - SLOPE
        return [v, -(40 * x + 1.5 * (relative if of_road else v) + law(x, relative)) / 2]

    return solve_ivp(rate, (0.0, 2.0), [0.0, 0.0], method="LSODA", rtol=1e-9, atol=1e-12).y[1:, -1]


def no_force(x, v):
    return 0.0


@pytest.mark.parametrize(("form", "class_name"), PAIRS)
def test_effect_is_driven_by_the_motion_relative_to_the_road(tmp_path, form, class_name):
    (text, motion), (values, law) = FORMS[form], LAWS[class_name]
    path = tmp_path / "Seat.mo"
    path.write_text(text)
    flat, effect = compile_model(path), find_effect(class_name)
    (site,) = [s for s in sites(flat) if s.kind == "force" and not s.is_grounded]
    of_road = form in ("speed", "rate")
    expected = by_scipy(of_road, law)
    assert not np.allclose(expected, by_scipy(of_road, no_force), rtol=1e-3)
    attached = simulated(attach(flat, effect, site, values=values))
    np.testing.assert_allclose(attached, expected, rtol=2e-5)
    written = extend_model(path, None, effect, site, values=values)
    assert f"(s = {motion})" in written.text
    np.testing.assert_allclose(simulated(written.flat), expected, rtol=2e-5)


def test_input_that_is_no_ground_is_none():
    """A force of its own, and a spring whose end moves twice as far as the input."""
    for law in ("-k*z + c*zr", "-k*(z - 2*zr)"):
        text = _form(BY_POSITION, "", "der(z) = v", f"m*der(v) = {law}")
        assert not [
            s
            for s in sites(compile_text(text.encode(), Path("Seat.mo")))
            if s.kind == "force" and not s.is_grounded
        ]
