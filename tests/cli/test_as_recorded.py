"""Recordings that are much finer than their outputs move, diagnosed at a coarser period and at their own."""

import json

import numpy as np
import pytest

PERIOD, MASS, DAMPING = 0.002, 42.0, 85.0
AXIS = """model Axis "Linear axis under position control: force in, position out"
  parameter Real m(unit = "kg", min = 0) = 30 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.s/m", min = 0) = 60 annotation(__Daest(estimate = true));
  input Real F(unit = "N");
  output Real y(unit = "m") = s;
  Real s(unit = "m");
  Real v(unit = "m/s");
equation
  der(s) = v;
  m*der(v) = F - d*v;
end Axis;
"""


def record(n=9000):
    """Time, force and position of the axis behind an encoder of 2 um, in closed loop: exactly sampled."""
    rng = np.random.default_rng(41)
    levels = np.repeat(rng.uniform(-0.12, 0.12, n // 700 + 2), 700)[: n + 300]
    reference = np.convolve(levels, np.ones(301) / 301, "valid")[:n]
    decay = np.exp(-DAMPING / MASS * PERIOD)
    rest = (1.0 - decay) * MASS / DAMPING  # seconds that a speed goes on for
    s = v = before = 0.0
    table = np.empty((n, 3))
    for k in range(n):
        y = s + 2e-6 * rng.standard_normal()
        force = 4.2e4 * (reference[k] - y) - 1900.0 * (y - before) / PERIOD + 6.0 * rng.standard_normal()
        before = y
        table[k] = k * PERIOD, force, y
        s += rest * v + force / DAMPING * (PERIOD - rest)
        v = decay * v + force / DAMPING * (1.0 - decay)
    return table


@pytest.fixture
def axis(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Axis.mo").write_text(AXIS)
    np.savetxt(tmp_path / "run.csv", record(), delimiter=",", header="time,F,y", comments="", fmt="%.9g")


@pytest.mark.slow
@pytest.mark.parametrize("command", ["diagnose", "improve"])
def test_what_the_coarser_period_colours_is_no_missing_effect(axis, daest, command):
    """The force moves at 500 Hz: behind the filter for 8 ms, errors of an exact model are correlated."""
    arguments = ("Axis.mo", "run.csv", "--effect", "ConstantLoad", "--format", "json")
    code, out, told = daest(command, *arguments)
    assert code == 0, told
    assert "diagnosed at 0.008 s" in told and "diagnosed at the recordings' own" in told
    found = json.loads(out)
    if command == "diagnose":
        assert found["verdict"] == "nothing missing"
    else:
        assert "Nothing is missing" in found["reason"]
