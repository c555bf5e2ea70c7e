"""Algebraic loops with several solutions: a trigger with hysteresis keeps the one that it is at, and jumps
where it ends.

The amplifier with gain V0 and limits ±V has positive feedback, v₊ = (R2 u + R1 y)/(R1 + R2). Its upper
solution y = V ends where V0 v₊ < V, at u = -V R1/R2 + V (1 + R1/R2)/V0; the lower one at the opposite."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from daest.modelica.compile import compile_text
from daest.systems.reduction.reduce import _beyond, reduce_index
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.simulate import simulate

V, V0, RATIO = 15.0, 15000.0, 1.0 / 15.0
THRESHOLD = RATIO * V - V * (1 + RATIO) / V0

TRIGGER = """model Trigger
  parameter Real V = 15;
  parameter Real V0 = 15000;
  parameter Real R1 = 1000;
  parameter Real R2 = 15000;
  {source}
  Real vp;
  output Real y(start = 15);
  {more}
equation
  (u - vp)/R1 + (y - vp)/R2 = 0;
  y = noEvent(if V0*vp > V then V else if V0*vp < -V then -V else V0*vp);
  {equations}
end Trigger;
"""
LAG = {"more": "output Real x(start = 0, fixed = true);", "equations": "der(x) = y - x;"}
LATE = {
    "more": " discrete Real late(start = 0, fixed = true);",
    "equations": " when time > 0.33 then late = 1; end when;",
}
CHANGES = {
    "nothing": {"more": "", "equations": ""},
    "events": LATE,
    "states": LAG,
    "states and events": {
        "more": LAG["more"] + LATE["more"],
        "equations": LAG["equations"] + LATE["equations"],
    },
}


def trigger(kind: str, source: str = "input Real u(start = 5);"):
    return compile_text(TRIGGER.format(source=source, **CHANGES[kind]).encode(), Path("Trigger.mo"))


def triangle(n: int = 801) -> tuple[np.ndarray, np.ndarray]:
    """A period and a half of a triangle of ±5 V, from its top down."""
    time = np.linspace(0.0, 1.5, n)
    return time, 5.0 - 10.0 * np.abs((2 * time + 1) % 2 - 1)


def expected(u: np.ndarray) -> np.ndarray:
    """The exact output of the trigger at samples of slow ramps."""
    y, at = np.empty_like(u), V
    for k, value in enumerate(u):
        at = -V if value < -THRESHOLD else V if value > THRESHOLD else at
        y[k] = at
    return y


# States with events as either alone.
@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=pytest.mark.slow if kind == "states and events" else ()) for kind in CHANGES],
)
def test_a_trigger_keeps_its_branch_on_either_ramp(kind):
    time, u = triangle()
    found = simulate(trigger(kind), (time, u[:, None]))
    y = found.outputs[:, found.output_names.index("y")]
    assert np.max(np.abs(y - expected(u))) < 1e-9
    inside = np.abs(u) < 0.9 * THRESHOLD
    assert set(np.sign(y[inside])) == {-1.0, 1.0}
    assert np.array_equal(y, found.variables[:, found.variable_names.index("y")])


def test_a_loop_without_states_has_the_slopes_of_its_implicit_function():
    flat = compile_text(
        b"""model Static
          parameter Real k = 2;
          input Real u(start = 0);
          output Real y(start = 0.1);
        equation
          u = y + k*y^3 + 0.1*exp(y);
        end Static;""",
        Path("Static.mo"),
    )
    time = np.linspace(0, 1, 11)
    u = np.sin(5 * time)[:, None]
    run = integrate(
        integrator(reduce_index(flat), ("k",)),
        time,
        u,
        flat.theta_values,
        np.zeros(0),
        sensitivities=True,
    )
    y = run.outputs[:, 0]
    assert np.allclose(y + 2 * y**3 + 0.1 * np.exp(y), u[:, 0], atol=1e-10)
    assert np.allclose(run.sensitivities[:, 0, 0], -(y**3) / (1 + 6 * y**2 + 0.1 * np.exp(y)), atol=1e-10)


@pytest.mark.parametrize(
    ("law", "jump"),
    [
        (lambda z: (z**2 + 0.01) * (z - 3), 3.0),
        (lambda z: (z**2 + 0.01) * (z + 3), -3.0),
        (lambda z: (z**2 + 0.01) * (z**2 - 9), np.nan),  # on either side another one
        (lambda z: z**2 + 0.01, np.nan),  # none at all
    ],
)
def test_where_a_solution_ends_the_only_other_one_is_taken(law, jump):
    z, p = ca.SX.sym("z"), ca.SX.sym("p", 0)
    options = {"abstol": 1e-11, "abstolStep": 1e-11, "max_iter": 50, "error_on_fail": False}
    attempt = ca.rootfinder("attempt", "fast_newton", {"x": z, "p": p, "g": law(z)}, options)
    elsewhere = _beyond("law", ca.Function("law", [z, p], [law(z)]), attempt)
    assert float(elsewhere(0.0, [])) == pytest.approx(jump, nan_ok=True)
