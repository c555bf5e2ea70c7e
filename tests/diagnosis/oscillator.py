"""A damped oscillator with process noise, in Modelica, and records of it."""

import numpy as np

from daest.model.experiment import Experiment
from daest.systems.simulation.simulate import simulate

OSCILLATOR = """\
model Oscillator "Mass on a spring"
  parameter Real a(unit = "1/s", min = 0) = 0.5 "Damping" annotation(__Daest(estimate = true));
  parameter Real b(unit = "1/s2", min = 0) = 4 "Stiffness" annotation(__Daest(estimate = true));
  input Real u(unit = "m/s2") "Drive";
  input Real w annotation(__Daest(noise = true, intensity = 1e-3, estimate = true));
  output Real y(unit = "m") annotation(__Daest(std = 0.05));
  output Real v(unit = "m/s") annotation(__Daest(std = 0.1));
  Real x(unit = "m", start = 0, fixed = true);
  Real s(unit = "m/s", start = 0, fixed = true);
equation
  der(x) = s;
  der(s) = -a*s - b*x{extra} + u + w;
  y = x;
  v = s;
end Oscillator;
"""
PERIOD = 0.05


def drive(n_samples, seed, kind=0):
    """A held random level, a multisine, or a random telegraph signal."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(n_samples)
    if kind == 1:
        return sum(np.sin(2 * np.pi * f * time + rng.uniform(0, 2 * np.pi)) for f in (0.1, 0.23, 0.31, 0.8))
    levels, hold = (rng.normal(size=n_samples), 8) if kind == 0 else (np.sign(rng.normal(size=n_samples)), 20)
    return np.repeat(levels, hold)[:n_samples]


def record(flat, n_samples, seed, kind=0):
    """What the model itself does, noise included."""
    time, u = PERIOD * np.arange(n_samples), drive(n_samples, seed, kind)
    y = simulate(flat, (time, u[:, None]), noise=True, seed=seed, hold="zoh").outputs
    return Experiment("run", time, u[:, None], y, ("u",), ("y", "v"))
