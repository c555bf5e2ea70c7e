"""A mass on a spring and damper, driven by a force, and recordings of it made by a plain integration with
small steps. The machine has dry friction and a spring that hardens, which the model does not know."""

import math
from pathlib import Path

import numpy as np

CART = """\
model Cart "Mass on a spring and damper"
  parameter Real m(unit = "kg", min = 0) = 1.3 "Mass" annotation(__Daest(estimate = true, scale = "log"));
  parameter Real c(unit = "N/m", min = 0) = 8 "Stiffness" annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.s/m", min = 0) = 1 "Damping" annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput F(unit = "N", start = 0) "Force of the motor";
  Daest.Blocks.Interfaces.RealOutput s(unit = "m") "Position" annotation(__Daest(std = 0.002));
  Daest.Mechanics.Translational.Sources.Force motor "Motor";
  Daest.Mechanics.Translational.Components.Mass cart(m = m) "Cart";
  Daest.Mechanics.Translational.Components.SpringDamper spring(c = c, d = d) "Spring to the wall";
  Daest.Mechanics.Translational.Components.Fixed wall "Wall";
  Daest.Mechanics.Translational.Sensors.PositionSensor encoder "Encoder";
equation
  connect(F, motor.f);
  connect(motor.flange, cart.flange_a);
  connect(wall.flange, spring.flange_a);
  connect(spring.flange_b, cart.flange_b);
  connect(encoder.flange, cart.flange_b);
  connect(encoder.s, s);
end Cart;
"""
TRUE = {"m": 1.0, "c": 10.0, "d": 0.8}
PERIOD = 0.02
NOISE = 0.002
SUBSTEPS = 100
WAVES = 6.0  # rad/m, of friction along the way
SLIDING = 1e-3  # m/s at which friction has three quarters of its size


def recording(
    n_samples: int,
    seed: int,
    friction: float = 0.0,
    cubic: float = 0.0,
    mass: float = TRUE["m"],
    force: np.ndarray | None = None,
    bumps: float = 0.0,
) -> np.ndarray:
    """Columns time, force (held; a random one by default), position; `friction` in N, `cubic` in N/m3;
    `bumps` is the share of the friction that depends on the position."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(n_samples)
    steps = np.repeat(4.0 * rng.normal(size=n_samples // 20 + 1), 20)[:n_samples]
    force = steps if force is None else force
    step, s, v = PERIOD / SUBSTEPS, 0.0, 0.0
    position = np.zeros(n_samples)
    d, c = TRUE["d"], TRUE["c"]
    # Numbers of Python: those of numpy take many times as long here.
    for k, push in enumerate(force[:-1].tolist()):
        for _ in range(SUBSTEPS):
            load = d * v + c * s + cubic * s**3
            if friction:
                load += friction * (1.0 + bumps * math.sin(WAVES * s)) * math.tanh(v / SLIDING)
            v += step * (push - load) / mass
            s += step * v
        position[k + 1] = s
    return np.column_stack([time, force, position + NOISE * rng.standard_normal(n_samples)])


def write_recording(path: Path, table: np.ndarray, header: str = "time,F,s") -> Path:
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    return path
