"""Laws with a root of a difference, as of the flow between two levels, that start where the root is zero."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_text

TANKS = """model Tanks
  parameter Real A(unit = "m2", min = 0) = 0.01;
  parameter Real k = 1e-3;
  parameter Real c = 1e-3;
  input Real q(unit = "m3/s");
  output Real h1(unit = "m", start = 0.1, fixed = false);
  output Real h2(unit = "m", start = 0.1, fixed = false);
  Real d(unit = "m") = h1 - h2;
equation
  A*der(h1) = q - k*(LAW);
  A*der(h2) = k*(LAW) - c*sqrt(h2);
end Tanks;
"""
A, K, C = 0.012, 1.2e-3, 0.9e-3
LAWS = [
    "sign(d)*sqrt(abs(d))",
    "if d > 0 then sqrt(d) else -sqrt(-d)",
    "sign(d)*abs(d)^0.5",
    "if noEvent(h1 >= h2) then sqrt(h1 - h2) else -sqrt(h2 - h1)",
]


def recorded() -> Experiment:
    """400 s of steps of the inflow, from two levels that are equal."""
    time, rng = np.arange(400.0), np.random.default_rng(0)
    q = np.repeat(rng.uniform(0.0, 8e-4, 10), 40)

    def rates(t: float, h: np.ndarray) -> list[float]:
        flow = K * np.sign(h[0] - h[1]) * np.sqrt(abs(h[0] - h[1]))
        return [(np.interp(t, time, q) - flow) / A, (flow - C * np.sqrt(max(h[1], 0.0))) / A]

    h = solve_ivp(rates, (0.0, 399.0), [0.1, 0.1], "LSODA", time, rtol=1e-8, atol=1e-10, max_step=1.0).y.T
    return Experiment("tanks", time, q[:, None], h + rng.normal(0.0, 5e-4, h.shape), ("q",), ("h1", "h2"))


@pytest.mark.parametrize("law", LAWS)
def test_levels_that_start_equal_are_identified(law):
    flat = compile_text(TANKS.replace("LAW", law).encode(), Path("Tanks.mo"))
    fit = identify(flat, [recorded()], IdentifyOptions(method="oe", estimate=("A", "k", "c"), hold="foh"))
    named = {p.name: p for p in fit.parameters}
    for name, truth in (("A", A), ("k", K), ("c", C)):
        found = named[name]
        assert abs(found.value - truth) < 3.5 * found.std_error
        assert found.std_error < 0.002 * truth
