"""Learned loads of the library against numpy's interpolation, in every domain."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from daest.modelica.compile import compile_text

KNOTS, VALUES = [-0.5, 0.2, 0.4, 1.5], [1.0, -2.0, 0.5, 0.7]
CLASSES = {
    "Rotational.LearnedTorque": ("flange.tau", "N.m", "Mechanics.Rotational.Components.Fixed", "flange"),
    "Translational.LearnedForce": ("flange.f", "N", "Mechanics.Translational.Components.Fixed", "flange"),
    "Electrical.LearnedCurrent": ("pin.i", "A", "Electrical.Analog.Basic.Ground", "p"),
    "Thermal.LearnedHeatFlow": (
        "port.Q_flow",
        "W",
        "Thermal.HeatTransfer.Sources.FixedTemperature",
        "port",
    ),
    "Hydraulic.LearnedFlow": ("port.q", "m3/s", "Hydraulic.Sources.FixedPressure", "port"),
}


def compiled(name, more=""):
    """The load over `a`, where its connector is held."""
    flow, _, held, at = CLASSES[name]
    heat = "(T = 300)" if at == "port" and "Thermal" in held else ""
    text = (
        "model Rig\n  Real a(start = 0, fixed = true);\n  Real b(start = 0, fixed = true);\n"
        f"  Daest.Effects.{name} learned(x = a, x_knots = {{{str(KNOTS)[1:-1]}}},"
        f" y = {{{str(VALUES)[1:-1]}}}{more});\n  Daest.{held} held{heat};\n"
        "equation\n  der(a) = 1;\n  der(b) = 1;\n"
        f"  connect(learned.{flow.partition('.')[0]}, held.{at});\nend Rig;\n"
    )
    return compile_text(text.encode(), Path("Rig.mo"))


def load_of(flat):
    """(a, b) -> load, of the equation that gives it."""
    names = [v.name for v in flat.unknowns]
    at = [names.index(n) for n in ("learned.v", "learned.load")]
    rows = [next(i for i, e in enumerate(flat.equations) if e.text.startswith(f"{names[j]} = ")) for j in at]
    residual = ca.Function("residual", [flat.xi, flat.theta], [flat.residual[rows]])

    def load(a, b=1.0):
        xi = np.zeros(flat.n)
        xi[[names.index("a"), names.index("b")]] = a, b
        for k in range(2):  # v, then the load at it: each row is its variable minus the right side
            xi[at[k]] -= float(residual(xi, flat.theta_values)[k])
        return xi[at[1]]

    return load


@pytest.mark.parametrize("name", CLASSES)
def test_load_is_straight_lines_between_the_knots(name):
    flat = compiled(name)
    load = load_of(flat)
    for a in np.linspace(-2.0, 2.0, 41):
        assert load(a) == pytest.approx(np.interp(a, KNOTS, VALUES), abs=1e-12)
    flow, unit, *_ = CLASSES[name]
    assert any(e.text == f"learned.{flow} = -learned.load" for e in flat.equations)
    units = {p.name: p.unit for p in flat.parameters}
    assert {units[f"learned.y[{i}]"] for i in (1, 2, 3, 4)} == {unit}
    assert all(p.estimate for p in flat.parameters if p.name.startswith("learned.y"))


def test_curve_repeats_and_has_the_sign_of_another_variable():
    load = load_of(compiled("Rotational.LearnedTorque", ", s = b, s_s = 0.1, period = 2.5"))
    for a in np.linspace(-7.0, 7.0, 71):
        for b in (-0.3, 0.02, 1.0):
            true = np.interp(a, KNOTS, VALUES, period=2.5) * np.tanh(b / 0.1)
            assert load(a, b) == pytest.approx(true, abs=1e-12)
