"""A drive that follows with a lag, before a machine that bends. Simulated by LSODA."""

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects import effect_library

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


def test_lag_of_a_drive_before_a_pendulum() -> None:
    rng, T = np.random.default_rng(3), 0.12
    time = 0.04 * np.arange(700)
    voltage = np.repeat(rng.uniform(-3.5, 3.5, 28), 25)

    def rates(t, z):
        u = voltage[min(int(t / 0.04 + 1e-9), 699)]
        return [z[1], (z[2] - 0.3 * z[1] - 4.0 * np.sin(z[0])) / 0.1, (u - z[2]) / T]

    run = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0, 0.0], "LSODA", time, max_step=0.04, rtol=1e-8)
    angle = run.y[0] + rng.normal(0.0, 2e-3, time.size)
    record = Experiment("run", time, voltage[:, None], angle[:, None], ("u",), ("y",))
    options = DiagnoseOptions(effects=("Lag", "CoulombFriction", "QuadraticGain"), hold="zoh")
    found = diagnose(compile_text(ARM, Path("Arm.mo")), effect_library(), [record], (), options)
    named = {p.candidate.effect.name for p in found.proofs if p.verdict != "rejected"}
    assert named == {"Lag"}, found.message
    best = found.proofs[0]
    own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.T")
    assert abs(own.value - T) < 4.0 * own.std_error < 0.2 * T
