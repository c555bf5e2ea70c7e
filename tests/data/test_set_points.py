"""Set points of controllers in the place of inputs, in simulated machines, and machines that follow their
inputs by themselves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from daest.data.contradictions import model_findings
from daest.data.read import Signal, read_experiments
from daest.data.set_points import set_points
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.improve import improve
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text

MOTOR = """model Motor
  parameter Real k(unit="N.m/A") = {k} annotation(__Daest(estimate = true));
  parameter Real J(unit="kg.m2") = 2e-3 annotation(__Daest(estimate = true));
  parameter Real R(unit="Ohm") = 1;
  input Real u(unit="{unit}");
  output Real w(unit="rad/s", start = 0, fixed = true);
equation
  J*der(w) = k*(u - k*w)/R;
end Motor;
"""
BODY = """model Body
  parameter Real C(unit="J/K") = 20 annotation(__Daest(estimate = true));
  parameter Real G(unit="W/K") = 0.4 annotation(__Daest(estimate = true));
  input Real P(unit="W");
  output Real T(unit="K", start = 293.15, fixed = true);
equation
  C*der(T) = P - G*(T - 293.15);
end Body;
"""
PERIOD = 0.01


def flat_of(text):
    return compile_text(text.encode(), Path("Model.mo"))


def motor(k=0.5, unit="V"):
    return flat_of(MOTOR.format(k=k, unit=unit))


def levels(rng, n=3000, every=150):
    return np.repeat(np.round(rng.uniform(-30, 30, n // every)), every)


def turned_by(command, controlled, *, k=0.8, friction=0.0, noise=0.1):
    """Speeds (n,) [rad/s] of a motor that a controller with an integral turns as told, or that is given the
    voltage; its dry friction is in volts."""
    w = z = 0.0
    speeds = []
    for wanted in command:
        speeds.append(w)
        for _ in range(10):
            h = PERIOD / 10
            z += h * 8.0 * (wanted - w)
            u = wanted - w + z if controlled else wanted
            w += h * k * (u - k * w - friction * np.tanh(10.0 * w)) / 3e-2
    return np.array(speeds) + noise * np.random.default_rng(3).normal(size=len(command))


def experiment(u, y, names=("u", "w"), period=PERIOD):
    return Experiment("run", period * np.arange(u.size), u[:, None], y[:, None], names[:1], names[1:])


@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_the_set_point_of_a_speed_is_no_voltage(friction):
    u = levels(np.random.default_rng(1))
    run = experiment(u, turned_by(u, controlled=True, friction=friction))
    (found,) = model_findings(motor(), run)
    assert found.code == "check-set-point" and found.column == "u"
    assert "set point of w" in found.text and "2 times" in found.text


def test_nothing_is_claimed_beside_a_set_point():
    u = levels(np.random.default_rng(1), 1500)
    run = experiment(u, turned_by(u, controlled=True))
    found = diagnose(motor(), (), [run])
    assert found.verdict == "cannot tell" and not found.proofs
    assert "u is probably the set point of w" in found.message and "Record what" in found.next_experiment
    assert improve(motor(), (), [run]).reason == found.message


def test_a_motor_that_turns_by_its_voltage_follows_no_set_point():
    u = levels(np.random.default_rng(1))
    assert not set_points(motor(), experiment(u, turned_by(u, controlled=False)))
    of_one = turned_by(u, controlled=False, k=1.0)
    assert set_points(motor(), experiment(u, of_one)), "by chance, and the model is another machine"
    assert not set_points(motor(k=1.1), experiment(u, of_one)), "the model has that gain, too"
    rubbing = turned_by(u, controlled=False, k=1.0, friction=1.0)
    assert not set_points(motor(), experiment(u, rubbing)), "friction takes a part of every level"


def test_a_model_with_its_controller_has_its_set_point():
    u = levels(np.random.default_rng(1))
    assert not set_points(motor(unit="rad/s"), experiment(u, turned_by(u, controlled=True)))


def test_a_switch_is_no_set_point():
    u = 10.0 * (levels(np.random.default_rng(1)) > 0)
    assert not set_points(motor(), experiment(u, turned_by(u, controlled=True)))


def test_a_recording_with_a_pause_of_months_is_not_laid_on_an_even_grid():
    u = levels(np.random.default_rng(1))
    run = experiment(u, turned_by(u, controlled=True))
    late = np.where(np.arange(u.size) < 1500, 0.0, 1e7)  # a thousand million steps
    assert set_points(motor(), run) and not set_points(motor(), replace(run, time=run.time + late))


def test_a_set_point_is_seen_in_the_units_of_the_recording():
    """An oven with a controller, a programme of ramps in degC that was taken for a power."""
    time = 10.0 * np.arange(2000)
    told = np.interp(time, [0, 3e3, 6e3, 8e3, 13e3, 2e4], [20, 60, 60, 90, 40, 50.0])
    heat, body, z, temperatures = 0.0, 20.0, 0.0, []
    for wanted in told:
        temperatures.append(body)
        z += 10.0 * 0.02 * (wanted - body)
        heat = 2.0 * (wanted - body) + z
        body += 10.0 * (heat - 0.5 * (body - 20.0)) / 100.0
    noise = 0.05 * np.random.default_rng(2).normal(size=time.size)
    table = pd.DataFrame({"time [s]": time, "P [W]": told, "T [degC]": np.array(temperatures) + noise})
    flat = flat_of(BODY)
    (as_read,) = read_experiments([table], [Signal("P", "W")], [Signal("T", "K")])
    (found,) = set_points(flat, as_read)
    assert (found.input, found.output) == ("P", "T") and found.gain == pytest.approx(1.0, abs=3e-3)
    assert not set_points(flat, replace(as_read, read_by={})), "in K something is added"
