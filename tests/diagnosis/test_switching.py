"""Diagnosis of a model with events: a shaft under a sampled speed controller, whose bearing rubs."""

from pathlib import Path

import numpy as np
import pytest

from daest.diagnosis import switching
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.improve import improve
from daest.diagnosis.options import DiagnoseOptions
from daest.errors import ModelError
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects import effect_library
from daest.systems.simulate import simulate

DRIVE = """model Drive "A shaft under a sampled speed controller"
  parameter Real J(min = 0) = 0.02 annotation(__Daest(estimate = true));
  parameter Real d(min = 0) = 0.01 annotation(__Daest(estimate = true));
  input Real r;
  output Real w annotation(__Daest(std = 0.05));
  discrete Real command(start = 0, fixed = true);
  discrete Real sum(start = 0, fixed = true);
  Boolean limited(start = false, fixed = true);
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = J);
  Daest.Mechanics.Rotational.Components.Damper bearing(d = d);
  Daest.Mechanics.Rotational.Components.Fixed ground;
  Daest.Mechanics.Rotational.Sources.Torque drive;
  Daest.Mechanics.Rotational.Sensors.SpeedSensor tacho;
equation
  when sample(0, 0.04) then
    sum = pre(sum) + 0.004*(r - tacho.w);
    limited = abs(0.2*(r - tacho.w) + sum) > 5;
    command = if limited then 0 else 0.2*(r - tacho.w) + sum;
  end when;
  drive.tau = command;
  w = tacho.w;
  connect(drive.flange, rotor.flange_a);
  connect(rotor.flange_b, bearing.flange_a);
  connect(bearing.flange_b, ground.flange);
  connect(rotor.flange_b, tacho.flange);
end Drive;
"""
RUBS = DRIVE.replace(
    "equation\n  when", "  Daest.Effects.Rotational.CoulombFriction fric(tau_c = 0.08);\nequation\n  when"
).replace("end Drive;", "  connect(fric.flange, rotor.flange_b);\nend Drive;")


@pytest.fixture(scope="module")
def drive():
    return compile_text(DRIVE.encode(), Path("Drive.mo"))


def recording(flat, seed, n=300, dt=0.02):
    rng, t = np.random.default_rng(seed), np.arange(n) * dt
    r = 4 * np.repeat(rng.uniform(-1, 1, n // 50 + 1), 50)[:n]
    y = simulate(flat, (t, r[:, None]), hold="zoh").outputs[:, 0] + 0.05 * rng.standard_normal(n)
    return Experiment(f"run{seed}", t, r[:, None], y[:, None], ("r",), ("w",))


def test_a_mode_that_never_occurs_and_the_loop_are_told(drive):
    case = switching.Case(drive, "zoh", (recording(drive, 1, 60),), (), ({},))
    never, loop = switching._remarks(case)
    assert "limited true" in never
    assert "command" in loop and "closes the loop" in loop


def test_improving_in_rounds_refuses(drive):
    with pytest.raises(ModelError) as caught:
        improve(drive, (), [recording(drive, 1, 60)])
    assert "diagnose" in caught.value.remedy


@pytest.mark.slow
def test_friction_behind_a_sampled_controller_is_found():
    model = compile_text(DRIVE.encode(), Path("Drive.mo"))
    true = compile_text(RUBS.encode(), Path("Drive.mo"))
    options = DiagnoseOptions(
        hold="zoh", jobs=1, effects=("CoulombFriction", "ConstantLoad", "CoggingTorque")
    )
    found = diagnose(model, effect_library(), [recording(true, 1)], [recording(true, 9)], options)
    assert found.verdict == "supported"
    best = found.proofs[0]
    assert best.candidate.effect.name == "CoulombFriction"
    size = best.fit.parameters[-1]
    assert abs(size.value - 0.08) < 3 * size.std_error
    assert size.std_error < 0.005


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_missing(drive):
    options = DiagnoseOptions(
        hold="zoh", jobs=1, effects=("CoulombFriction", "ConstantLoad", "CoggingTorque")
    )
    found = diagnose(drive, effect_library(), [recording(drive, 1)], [recording(drive, 9)], options)
    assert found.verdict == "nothing missing"
