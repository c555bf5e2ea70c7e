"""A tank in bare equations: the rate of its level balances flows of liquid."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects import effect_library
from daest.modelica.place_units import units_at
from daest.modelica.sites import sites

TANK = b"""model Tank
  parameter Real k(unit = "m2/s", min = 0) = 1e-4 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real A(unit = "m2") = 0.0125;
  input Real inflow(unit = "m3/s");
  Real h(unit = "m", start = 0.2);
  output Real level(unit = "m");
equation
  A*der(h) = inflow - k*h;
  level = h;
end Tank;
"""
LAG = b"""model Slide
  input Real wanted(unit = "m");
  Real s(unit = "m", start = 0);
  output Real y(unit = "m");
equation
  0.2*der(s) = wanted - s;
  y = s;
end Slide;
"""


def tank():
    return compile_text(TANK, Path("Tank.mo"))


def test_level_is_a_place_for_flows_and_a_position_is_none() -> None:
    flat = tank()
    place = next(site for site in sites(flat) if site.kind == "equation")
    assert (place.domain, place.name) == ("hydraulic", "0:h")
    outlet = next(e for e in effect_library() if e.name == "FreeOutlet")
    assert {name: units_at(flat, outlet, place)[name] for name in ("k", "p_0")} == {"k": "m3/s", "p_0": "m"}
    assert not [site for site in sites(compile_text(LAG, Path("Slide.mo"))) if site.kind == "equation"]


@pytest.mark.slow
def test_hole_of_a_tank_is_named_with_its_height() -> None:
    """Torricelli's law where the model has an outflow in proportion to the level; simulated by LSODA."""
    rng, area, k, h_0 = np.random.default_rng(5), 0.0125, 6e-5, 0.02
    time = 4.0 * np.arange(600)
    inflow = np.repeat(rng.uniform(0.5e-5, 4.5e-5, 20), 30)

    def rate(t, h):
        return [(inflow[min(int(t / 4.0), 599)] - k * np.sqrt(max(h[0] - h_0, 0.0))) / area]

    run = solve_ivp(rate, (0.0, time[-1]), [0.2], "LSODA", time, max_step=4.0, rtol=1e-8, atol=1e-10)
    level = run.y[0] + rng.normal(0.0, 5e-4, time.size)
    record = Experiment("run", time, inflow[:, None], level[:, None], ("inflow",), ("level",))
    options = DiagnoseOptions(effects=("FreeOutlet", "Leak", "Overflow", "QuadraticGain"), hold="zoh")
    found = diagnose(tank(), effect_library(), [record], (), options)
    assert found.verdict == "supported", found.message
    best = found.proofs[0]
    assert best.candidate.effect.name == "FreeOutlet"
    own = {p.name.rpartition(".")[2]: p for p in best.told.parameters if "." in p.name}
    for name, true in (("k", k), ("p_0", h_0)):
        assert abs(own[name].value - true) < 4.0 * own[name].std_error < 0.5 * true
