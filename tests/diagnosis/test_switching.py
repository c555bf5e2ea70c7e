"""Diagnosis of a model with events: a shaft under a sampled speed controller, whose bearing rubs."""

from pathlib import Path

import numpy as np
import pytest

from daest import with_values
from daest.diagnosis.comparison.compare import Candidate, compare_models
from daest.diagnosis.comparison.event_trial import FILTERED
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.improve import improve
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.without_equations import switching
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library
from daest.systems.simulation.simulate import simulate

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
LOADED = """model Loaded "A speed under a sampled controller and a white load"
  parameter Real d = 0.5;
  input Real r;
  input Real load annotation(__Daest(noise = true, intensity = 0.02));
  output Real w annotation(__Daest(std = 0.02, estimate = false));
  discrete Real u(start = 0, fixed = true);
initial equation
  w = 0;
equation
  der(w) = u + load - d*w;
  when sample(0, 0.1) then
    u = 2*(r - w);
  end when;
end Loaded;
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


@pytest.mark.slow
def test_models_are_compared_through_their_events(drive):
    """By the simulation without process noise, by the extended filter with it."""
    right, wrong = (Candidate(name, with_values(drive, {"d": d}), 0, "zoh") for name, d in
                    (("right", 0.01), ("wrong", 0.04)))  # fmt: skip
    found = compare_models([right, wrong], [recording(drive, 9, 200)])
    assert [one.verdict for one in found.models] == ["not falsified", "falsified"]
    assert found.models[0].simulation.rms["w"] == pytest.approx(0.05, rel=0.15)
    assert found.models[0].bic < found.models[1].bic


@pytest.mark.slow
def test_one_step_errors_of_a_loop_with_process_noise_are_those_of_the_filter():
    flat = compile_text(LOADED.encode(), Path("Loaded.mo"))
    rng, n, dt = np.random.default_rng(1), 160, 0.05
    t, r = np.arange(n) * dt, np.repeat(rng.uniform(-1, 1, n // 20), 20)
    w, u, y = 0.0, 0.0, np.empty(n)
    for k in range(n):
        u = 2 * (r[k] - w) if k % 2 == 0 else u
        y[k] = w + 0.02 * rng.standard_normal()
        a = np.exp(-0.5 * dt)
        w = a * w + (1 - a) / 0.5 * u + np.sqrt(0.02 * (1 - a * a)) * rng.standard_normal()
    record = Experiment("noisy", t, r[:, None], y[:, None], ("r",), ("w",))
    right, wrong = (
        Candidate("right", flat, 0, "zoh"),
        Candidate("wrong", with_values(flat, {"d": 3}), 0, "zoh"),
    )
    (one, two) = compare_models([right, wrong], [record]).models
    assert (one.verdict, two.verdict) == ("not falsified", "falsified")
    assert FILTERED in one.notes
    assert one.one_step.rms["w"] < 0.8 * one.simulation.rms["w"]
    assert one.tests["nis"]["w"].p_value > 0.01


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


@pytest.mark.slow
def test_improving_a_model_with_events_ends_where_nothing_is_missing():
    model = compile_text(DRIVE.encode(), Path("Drive.mo"))
    true = compile_text(RUBS.encode(), Path("Drive.mo"))
    options = DiagnoseOptions(hold="zoh", jobs=1, effects=("CoulombFriction", "ConstantLoad"))
    found = improve(model, effect_library(), [recording(true, 1)], [recording(true, 9)], options)
    assert [step.proof and step.proof.candidate.effect.name for step in found.steps] == [
        None,
        "CoulombFriction",
    ]
    before, after = (step.fit.simulated["validation"].rms["w"] for step in found.steps)
    assert before > 1.5 * after and after == pytest.approx(0.05, rel=0.15)
    assert found.last.verdict == "nothing missing"
