"""Laws that are the same equation on a recording count alike, whichever way they were accepted."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library

N_SAMPLES, PERIOD = 400, 0.05
PUMP = b"""
model Pump "a pump in a loop with a controller that is not here"
  parameter Real J(unit = "kg.m2", min = 0) = 0.02 annotation(__Daest(estimate = true));
  parameter Real a(unit = "bar.s2/rad2", min = 0) = 4e-5 annotation(__Daest(estimate = true));
  parameter Real b(unit = "bar.min2/l2", min = 0) = 1e-4 annotation(__Daest(estimate = true));
  parameter Real I(unit = "bar.min.s/l", min = 0) = 0.02 annotation(__Daest(estimate = true));
  parameter Real k(unit = "N.m.s.min/(rad.l)", min = 0) = 4e-4 annotation(__Daest(estimate = true));
  input Real u(unit = "N.m");
  output Real n(unit = "rpm") annotation(__Daest(std = 3));
  output Real q(unit = "l/min", start = 90, fixed = true) annotation(__Daest(std = 0.5));
  Real w(unit = "rad/s", start = 150, fixed = true);
equation
  J*der(w) = u - k*q*w;
  I*der(q) = a*w^2 - b*q^2;
  n = 30/3.141592653589793*w;
end Pump;
"""
LAWS = {"DeadZone", "Offset", "QuadraticGain", "CoulombFriction", "ConstantLoad", "StribeckFriction"}


def controlled(seed: int, friction: float) -> tuple[np.ndarray, np.ndarray]:
    """Torque (n_samples, 1) and readings (n_samples, 2) of a pump whose flow is controlled."""
    rng = np.random.default_rng(seed)
    wanted = np.repeat(rng.uniform(60.0, 130.0, 17), 25)
    state, integral, inputs, outputs = np.array([150.0, 90.0]), 4.0, [], []
    for k in range(N_SAMPLES):
        outputs.append(state * [30.0 / np.pi, 1.0] + rng.standard_normal(2) * [3.0, 0.5])
        error = wanted[k] - outputs[-1][1]
        integral += 0.08 * error * PERIOD
        u = integral + 0.06 * error
        inputs.append([u])

        def rate(_, x, u=u):
            w, q = x
            pressure = 4.5e-5 * w**2 - 1.15e-4 * q * abs(q)
            return [(u - 3.6e-4 * q * w - friction * np.tanh(w)) / 0.0235, pressure / 0.017]

        state = solve_ivp(rate, (0.0, PERIOD), state, method="LSODA", rtol=1e-9, atol=1e-10).y[:, -1]
    n, q = np.array(outputs).T  # as they stand in a file, by which the one or the other fit was taken
    return np.round(np.array(inputs), 6), np.column_stack([np.round(n, 3), np.round(q, 5)])


@pytest.mark.slow
def test_friction_of_what_turns_one_way_is_told_from_no_offset_of_its_torque() -> None:
    """A dead zone had come by its simulation, and left the others behind, which had come beside loads."""
    inputs, outputs = controlled(62, 0.8)
    time, half = PERIOD * np.arange(N_SAMPLES), N_SAMPLES // 2
    parts = [
        Experiment(f"{k}", time[s], inputs[s], outputs[s], ("u",), ("n", "q"))
        for k, s in enumerate((slice(0, half), slice(half, None)))
    ]
    laws = [one for one in effect_library() if one.class_name.rpartition(".")[2] in LAWS]
    found = diagnose(compile_text(PUMP, Path("Pump.mo")), laws, parts[:1], parts[1:])
    accepted = [p for p in found.proofs if p.verdict != "rejected"]
    told = {p.candidate.label for p in accepted} | {label for p in accepted for label in p.same_as}
    alike = {"CoulombFriction at 0:w", "ConstantLoad at 0:w", "Offset at u", "DeadZone at u"}
    assert told <= alike and len(told) > 1, found.message
