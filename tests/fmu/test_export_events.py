"""Exported models with events: equal to our own simulation in fmpy, and the validator says nothing."""

from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

from daest.fmu.binary_model import binary_model
from daest.fmu.export import export_fmu
from daest.modelica.compile import compile_text
from daest.systems.simulation.simulate import simulate

MACHINE = """model Machine "State events with reinit, samples, time events, whole parts, a hysteresis"
  parameter Real e = 0.8;
  Real h(start = 1, fixed = true);
  Real v(start = 0, fixed = true);
  Integer bounces(start = 0, fixed = true);
  Real x(start = 0, fixed = true);
  discrete Real u(start = 0, fixed = true);
  Integer steps(start = 0, fixed = true);
  Real next(start = 0.25, fixed = true);
  Boolean on(start = true, fixed = true);
  Real T(start = 0, fixed = true);
  output Real y = h + x;
  output Real stairs = integer(3*time);
equation
  der(h) = v;
  der(v) = -9.81;
  when h < 0 then
    reinit(v, -e*pre(v));
    bounces = pre(bounces) + 1;
  end when;
  der(x) = -x + u + (if time >= 0.3 and time < 0.6 then 1 else 0);
  when sample(0.05, 0.1) then
    u = 2*(1 - x) + 0.5*pre(u);
  end when;
  when time >= pre(next) then
    steps = pre(steps) + 1;
    next = pre(next) + 0.25;
  end when;
  on = T < -0.2 or (pre(on) and T < 0.2);
  der(T) = (if on then 1.5 else 0.0) - 0.5;
initial equation
  pre(on) = true;
end Machine;
"""


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    flat = compile_text(MACHINE.encode(), Path("Machine.mo"))
    made = export_fmu(flat, tmp_path_factory.mktemp("events") / "machine.fmu")
    return flat, made


def test_the_validator_is_silent(machine):
    _, made = machine
    assert made.validation == ()
    assert made.parameters == ("e",)


@pytest.mark.parametrize("e", [0.8, 0.6])
def test_fmpy_simulates_what_we_simulate(machine, e):
    flat, made = machine
    time = np.linspace(0, 1.7, 171)
    theta = flat.theta_values
    theta[[p.name for p in flat.parameters].index("e")] = e
    own = simulate(flat, (time, np.zeros((time.size, 0))), theta=theta)
    names = ["h", "v", "x", "u", "T", "y", "stairs", "next", "bounces", "steps"]
    found = simulate_fmu(
        str(made.path),
        stop_time=1.7,
        output_interval=0.01,
        relative_tolerance=1e-10,
        start_values={"e": e},
        output=names,
        record_events=False,
    )
    # Just at an event the importer may write either side of it.
    clear = np.abs((time * 60) % 1.0 - 0.5) < 0.45
    for name in names[:-3]:
        expected = own.outputs[:, ["y", "stairs"].index(name)] if name in ("y", "stairs") else own[name]
        assert found[name][clear] == pytest.approx(expected[clear], abs=1e-6), name
    for name in names[-3:]:
        assert np.array_equal(found[name][clear], own[name][clear]), name
    assert found["bounces"][-1] >= 2


def test_our_own_reader_follows_the_events(machine):
    flat, made = machine
    time = np.linspace(0, 1.2, 61)
    own = simulate(flat, (time, np.zeros((time.size, 0))))
    again = simulate(binary_model(made.path), (time, np.zeros((time.size, 0))))
    assert again.outputs[:, 0] == pytest.approx(own.outputs[:, 0], abs=1e-5)
