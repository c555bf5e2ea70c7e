"""A tank in bare equations: the rate of its level balances flows of liquid."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence.stand import begin
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.candidates import pairs
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import sites

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
DRAINED = b"""model Drained
  parameter Real a(unit = "m2", min = 0) = 9e-6 annotation(__Daest(estimate = true, scale = "log"));
  output Real h(unit = "m", start = 0.25);
  Real q(unit = "m3/s");
equation
  q = a*sqrt(2*9.81*(h - 0.02));
  0.0125*der(h) = -q;
end Drained;
"""
PAIR = b"""model Pair
  parameter Real A(unit = "m2") = 0.5;
  parameter Real a1(unit = "m2/s", min = 0) = 0.1 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real a2(unit = "m2/s", min = 0) = 0.1 annotation(__Daest(estimate = true, scale = "log"));
  input Real q(unit = "m3/s");
  Real h1(unit = "m", start = 0.2);
  Real h2(unit = "m", start = 0.1);
  output Real level(unit = "m");
equation
  A*der(h1) = q - a1*h1;
  A*der(h2) = a1*h1 - a2*h2;
  level = h2;
end Pair;
"""
CASCADE = b"""model Cascade
  parameter Real R(min = 0) = 1 annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput u;
  Daest.Blocks.Interfaces.RealOutput level;
  Daest.Hydraulic.Sources.PrescribedFlow pump;
  Daest.Hydraulic.Components.Tank upper(A = 1);
  Daest.Hydraulic.Components.LinearResistance drain(R = R);
  Daest.Hydraulic.Components.Tank lower(A = 1);
  Daest.Hydraulic.Components.LinearResistance outlet(R = R);
  Daest.Hydraulic.Sources.FixedPressure ambient;
  Daest.Hydraulic.Sensors.LevelSensor sensor;
equation
  connect(u, pump.q);
  connect(pump.port, upper.inlet);
  connect(upper.outlet, drain.port_a);
  connect(drain.port_b, lower.inlet);
  connect(lower.outlet, outlet.port_a);
  connect(outlet.port_b, ambient.port);
  connect(lower.outlet, sensor.port);
  connect(sensor.level, level);
end Cascade;
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


def test_what_flows_to_ground_leaves_the_model() -> None:
    """Between a tank and the surroundings a pipe that leads down is a free outlet of the tank."""
    places = sites(compile_text(CASCADE, Path("Cascade.mo")))
    outlet, pipe = (find_effect(f"Hydraulic.{name}") for name in ("FreeOutlet", "Downpipe"))
    tried = {c.label for c in pairs([outlet, pipe], places)}
    assert tried == {
        *("FreeOutlet at upper.outlet", "FreeOutlet at lower.outlet"),
        *("Downpipe at drain", "Downpipe at upper.outlet, lower.outlet"),
    }
    assert "Downpipe at outlet" in {c.label for c in pairs([pipe], places)}


@pytest.mark.slow
def test_outlets_of_a_cascade_are_named_one_after_the_other() -> None:
    """The outlet of each tank follows a square root; the level of the lower one is measured."""
    rng, area, k_1, k_2 = np.random.default_rng(6), 0.5, 0.125, 0.127
    time = 0.2 * np.arange(2400)
    drive = np.repeat(rng.uniform(0.02, 0.09, 16), 150)

    def rate(t, h):
        down, out = k_1 * np.sqrt(max(h[0], 0.0)), k_2 * np.sqrt(max(h[1], 0.0))
        return [(drive[min(int(t / 0.2), 2399)] - down) / area, (down - out) / area]

    run = solve_ivp(rate, (0.0, time[-1]), [0.2, 0.1], "LSODA", time, max_step=0.2, rtol=1e-8, atol=1e-10)
    level = run.y[1] + rng.normal(0.0, 5e-3, time.size)
    record = Experiment("run", time, drive[:, None], level[:, None], ("q",), ("level",))
    flat = compile_text(PAIR, Path("Pair.mo"))
    names = ("FreeOutlet", "Downpipe", "Weir", "Overflow", "QuadraticGain")
    first = diagnose(flat, effect_library(), [record], (), DiagnoseOptions(effects=names, hold="zoh"))
    assert first.verdict == "supported", first.message
    law = first.proofs[0].candidate
    assert law.label == "FreeOutlet at 1:h2"
    values = {p.name.rpartition(".")[2]: p.value for p in first.proofs[0].told.parameters if "." in p.name}
    wider = attach(flat, law.effect, law.site, values={**law.shape, **values})
    second = diagnose(wider, effect_library(), [record], (), DiagnoseOptions(effects=names, hold="zoh"))
    assert second.verdict == "supported", second.message
    assert second.proofs[0].candidate.effect.name == "Downpipe"


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


@pytest.mark.slow  # test_null.py
def test_a_start_from_which_the_model_cannot_be_simulated_is_no_stop() -> None:
    """With an outlet four times too large the level falls below the hole, where no root is; in closed form
    the root of the level over the hole falls in proportion to time."""
    rng, a = np.random.default_rng(8), 2.2e-6
    time = 1.5 * np.arange(460)
    root = np.sqrt(0.23) - a * np.sqrt(2 * 9.81) / (2 * 0.0125) * time
    level = 0.02 + np.maximum(root, 0.0) ** 2 + rng.normal(0.0, 5e-4, time.size)
    record = Experiment("run", time, np.zeros((time.size, 0)), level[:, None], (), ("h",))
    flat = compile_text(DRAINED, Path("Drained.mo"))
    stand = begin(flat, [record], (record,), DiagnoseOptions())
    assert stand.null.fit.theta["a"] == pytest.approx(a, rel=0.02)
