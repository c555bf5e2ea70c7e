"""A first-order lag, and recordings of it from its closed form."""

from pathlib import Path

import numpy as np

LAG = """\
model Lag "First-order lag"
  parameter Real T(unit = "s", min = 0) = 0.4 "Time constant" annotation(__Daest(estimate = true));
  parameter Real k(unit = "1") = 1.0 "Gain" annotation(__Daest(estimate = true));
  input Real u(unit = "V", start = 0) "Drive";
  output Real y(unit = "V") "Response" annotation(__Daest(std = 0.02));
  Real x(unit = "V", start = 0, fixed = true) "State";
equation
  T*der(x) = k*u - x;
  y = x;
end Lag;
"""
PROJECT = """\
[model]
source = "Lag.mo"
[data]
estimate = ["run1.csv"]
validate = ["run2.csv"]
"""
TRUE = {"T": 0.5, "k": 2.0}
PERIOD = 0.05
NOISE = 0.02


def recording(n_samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, a held input and the measured response of the lag with its true parameters, solved exactly."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(n_samples)
    u = np.repeat(rng.normal(size=n_samples // 8 + 1), 8)[:n_samples]
    x, keep = np.zeros(n_samples), np.exp(-PERIOD / TRUE["T"])
    for i in range(1, n_samples):
        x[i] = keep * x[i - 1] + (1 - keep) * TRUE["k"] * u[i - 1]
    return time, u, x + NOISE * rng.standard_normal(n_samples)


def write_lag(folder: Path) -> None:
    """Lag.mo, run1.csv and run2.csv."""
    (folder / "Lag.mo").write_text(LAG)
    write_csv(folder / "run1.csv", *recording(400, 1))
    write_csv(folder / "run2.csv", *recording(300, 2))


def write_csv(path: Path, time: np.ndarray, u: np.ndarray, y: np.ndarray, header: str = "time,u,y") -> Path:
    lines = [header, *(f"{a:.6g},{b:.9g},{c:.9g}" for a, b, c in zip(time, u, y, strict=True))]
    path.write_text("\n".join(lines) + "\n")
    return path
