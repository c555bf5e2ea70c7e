"""What is missing inside of a loop whose controller is part of the model."""

from pathlib import Path

import numpy as np
import pytest
from hidden_plants import library, some_effects
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text

SERVO = b"""model Servo
  parameter Real J(unit = "kg.m2", min = 0) = 0.01 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.02 annotation(__Daest(estimate = true, scale = "log"));
  input Real r(unit = "rad");
  output Real y(unit = "rad") = phi annotation(__Daest(std = 0.001));
  Real phi(unit = "rad", start = 0);
  Real w(unit = "rad/s", start = 0);
  Real u "Command [N.m]";
equation
  u = 20*(r - phi) - 2*w;
  der(phi) = w;
  J*der(w) = u - d*w;
end Servo;
"""
STEP, SAMPLES = 0.01, 1200


def held(rate, start, steps, times, method="RK45"):
    """The first state at `times` after the begin of each step of the reference, but for the last time, which
    is the begin of the next one."""
    x, found = start, []
    for r in steps:
        span = (times[0], times[-1])
        y = solve_ivp(rate, span, x, method, times, args=(r,), rtol=1e-9, atol=1e-12).y
        found.append(y[0, :-1])
        x = y[:, -1]
    return np.concatenate(found)


def recorded(limit, friction=0.0):
    """A reference in steps; the command is cut at the limit, and dry friction [N.m] holds the rotor."""
    rng = np.random.default_rng(4)
    steps = rng.uniform(-1, 1, SAMPLES // 60)

    def rate(_, x, r):
        torque = np.clip(20 * (r - x[0]) - 2 * x[1], -limit, limit) - friction * np.tanh(x[1] / 0.005)
        return [x[1], (torque - 0.03 * x[1]) / 0.012]

    angles = held(rate, (0.0, 0.0), steps, STEP * np.arange(61.0), "LSODA")
    outputs = angles[:, None] + 0.001 * rng.standard_normal((SAMPLES, 1))
    return Experiment(
        "run", STEP * np.arange(SAMPLES), np.repeat(steps, 60)[:, None], outputs, ("r",), ("y",)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "verdict", "others"),
    [
        (4.0, "supported", ()),
        (4.0, "supported", ("QuadraticDrag", "ConstantLoad")),
        (1e9, "nothing missing", ("QuadraticDrag", "ConstantLoad")),
    ],
)
def test_command_that_is_cut_is_told_from_all_else(limit, verdict, others):
    flat = compile_text(SERVO, Path("Servo.mo"))
    laws = some_effects("Saturation", "DeadZone", "CoulombFriction", *others)
    found = diagnose(flat, laws, [recorded(limit)], (), DiagnoseOptions(hold="zoh"))
    assert found.verdict == verdict
    if found.proofs and verdict == "supported":
        law = found.proofs[0].candidate
        assert law.label == "Saturation at u"
        assert found.proofs[0].told.theta[f"{law.name}.limit"] == pytest.approx(limit, rel=0.05)


@pytest.mark.slow  # tests/cli/test_diagnose_command.py
def test_friction_is_among_the_names_beside_a_dead_zone_of_the_controller():
    """Without overshoot they do the same."""
    flat = compile_text(SERVO, Path("Servo.mo"))
    laws = some_effects("DeadZone", "CoulombFriction")
    found = diagnose(flat, laws, [recorded(1e9, friction=0.4)], (), DiagnoseOptions(hold="zoh"))
    law = next(p for p in found.proofs if p.candidate.effect.name == "CoulombFriction")
    assert law.verdict != "rejected" and law.candidate.site.name.endswith(":w")
    assert law.told.theta[f"{law.candidate.name}.tau_c"] == pytest.approx(0.4, rel=0.03)


OVEN = b"""model Oven
  parameter Real C(unit = "J/K", min = 0) = 800 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real G(unit = "W/K", min = 0) = 5 annotation(__Daest(estimate = true, scale = "log"));
  input Real r(unit = "degC");
  output Real y(unit = "degC") = T annotation(__Daest(std = 0.1));
  Real T(unit = "degC", start = 60);
  Real I(unit = "W", start = 0);
  Real P(unit = "W");
equation
  P = 40*(r - T) + I;
  der(I) = 0.05*(r - T);
  C*der(T) = P - G*(T - 20);
end Oven;
"""


@pytest.mark.slow  # a command that is cut: the tests above
def test_heater_does_not_cool():
    rng = np.random.default_rng(11)
    steps = rng.uniform(40, 120, 10)

    def rate(_, x, r):
        return [(max(40 * (r - x[0]) + x[1], 0.0) - 4 * (x[0] - 20)) / 900, 0.05 * (r - x[0])]

    heat = held(rate, (60.0, 0.0), steps, 10.0 * np.arange(81.0))
    outputs = heat[:, None] + 0.1 * rng.standard_normal((heat.size, 1))
    run = Experiment(
        "run", 10.0 * np.arange(heat.size), np.repeat(steps, 80)[:, None], outputs, ("r",), ("y",)
    )
    names = ("OneSidedLimit", "DeadZone", "QuadraticGain", "HeatLoss")
    laws = [law for law in library() if law.name in names]
    found = diagnose(compile_text(OVEN, Path("Oven.mo")), laws, [run], (), DiagnoseOptions(hold="zoh"))
    law = found.proofs[0].candidate
    assert found.verdict == "supported" and law.label == "OneSidedLimit at P"
    fitted = {p.name: p for p in found.proofs[0].told.parameters}
    assert fitted[f"{law.name}.share"].value == pytest.approx(1.0, abs=0.01)
    limit = fitted[f"{law.name}.limit"]
    assert abs(limit.value) < max(4 * limit.std_error, 5.0)
