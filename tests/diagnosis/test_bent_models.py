"""Effects that change the order of a model that is not linear. Simulated by LSODA."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library

ARM = b"""model Arm
  parameter Real k(unit = "N.m/V", min = 0) = 0.8 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.2 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real J(unit = "kg.m2") = 0.1;
  parameter Real mgl(unit = "N.m") = 4;
  input Real u(unit = "V");
  Real phi(unit = "rad", start = 0);
  Real w(unit = "rad/s", start = 0);
  output Real y(unit = "rad");
equation
  der(phi) = w;
  J*der(w) = k*u - d*w - mgl*sin(phi);
  y = phi;
end Arm;
"""


def diagnosed(text, effects, rates, period, voltage, rng):
    """Of a recording of the first of three states, from rest: `rates` at the states and a held voltage."""
    time = period * np.arange(voltage.size)

    def held(t, z):
        return rates(z, voltage[min(int(t / period + 1e-9), voltage.size - 1)])

    run = solve_ivp(held, (0.0, time[-1]), [0.0, 0.0, 0.0], "LSODA", time, max_step=period, rtol=1e-8)
    angle = run.y[0] + rng.normal(0.0, 2e-3, time.size)
    record = Experiment("run", time, voltage[:, None], angle[:, None], ("u",), ("y",))
    options = DiagnoseOptions(effects=effects, hold="zoh")
    return diagnose(compile_text(text, Path("Machine.mo")), effect_library(), [record], (), options)


@pytest.mark.slow
def test_lag_of_a_drive_before_a_pendulum() -> None:
    rng, T = np.random.default_rng(3), 0.12
    voltage = np.repeat(rng.uniform(-3.5, 3.5, 28), 25)

    def rates(z, u):
        return [z[1], (z[2] - 0.3 * z[1] - 4.0 * np.sin(z[0])) / 0.1, (u - z[2]) / T]

    found = diagnosed(ARM, ("Lag", "CoulombFriction"), rates, 0.04, voltage, rng)
    named = {p.candidate.effect.name for p in found.proofs if p.verdict != "rejected"}
    assert named == {"Lag"}, found.message
    best = found.proofs[0]
    own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.T")
    assert abs(own.value - T) < 4.0 * own.std_error < 0.2 * T


GEARED = b"""model Geared
  Daest.Electrical.Analog.Sources.SignalVoltage source;
  Daest.Electrical.Analog.Basic.Resistor resistor(R = 2);
  Daest.Electrical.Analog.Basic.RotationalEMF emf(k = 0.5);
  Daest.Electrical.Analog.Basic.Ground ground;
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.05 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real J(unit = "kg.m2", min = 0) = 0.05 annotation(__Daest(estimate = true, scale = "log"));
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = J);
  Daest.Mechanics.Rotational.Components.Damper damper(d = d);
  Daest.Mechanics.Rotational.Components.Fixed fixed;
  Daest.Mechanics.Rotational.Sources.Torque weight;
  Daest.Blocks.Interfaces.RealInput u(unit = "V");
  Daest.Blocks.Interfaces.RealOutput y(unit = "rad");
equation
  connect(u, source.v);
  connect(source.p, resistor.p);
  connect(resistor.n, emf.p);
  connect(emf.n, ground.p);
  connect(source.n, ground.p);
  connect(emf.flange, rotor.flange_a);
  connect(rotor.flange_b, damper.flange_a);
  connect(damper.flange_b, fixed.flange);
  connect(weight.flange, rotor.flange_b);
  weight.tau = -1.5*sin(rotor.phi);
  y = rotor.phi;
end Geared;
"""


@pytest.mark.slow
def test_inductance_of_a_motor_with_a_pendulum() -> None:
    rng, L = np.random.default_rng(1), 0.15
    voltage = np.repeat(rng.uniform(-7.0, 7.0, 100), 20)

    def rates(z, u):
        return [
            z[1],
            (0.5 * z[2] - 0.08 * z[1] - 1.5 * np.sin(z[0])) / 0.04,
            (u - 2.0 * z[2] - 0.5 * z[1]) / L,
        ]

    found = diagnosed(GEARED, ("Inductance", "CoulombFriction"), rates, 0.02, voltage, rng)
    best = found.proofs[0]
    assert best.verdict == "supported" and best.candidate.effect.name == "Inductance", found.message
    (own,) = (p for p in best.told.parameters if p.name == f"{best.candidate.name}.L")
    assert abs(own.value - L) < 4.0 * own.std_error < 0.05 * L
