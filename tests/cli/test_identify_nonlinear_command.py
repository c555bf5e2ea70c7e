"""`daest identify` on a nonlinear model with process noise: a pendulum, simulated by Euler-Maruyama."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import daest
from daest.cli.main import run
from daest.model.fit import IdentifyOptions

MODEL = """
model Pendulum "Pendulum driven by a torque, with wind"
  parameter Real J(unit = "kg.m2", min = 0) = 0.02 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.01 annotation(__Daest(estimate = true));
  parameter Real mgl(unit = "N.m", min = 0) = 0.5 annotation(__Daest(estimate = true));
  input Real u(unit = "N.m", start = 0);
  input Real w(unit = "N.m", start = 0) annotation(__Daest(noise = true, intensity = 1e-4, estimate = true));
  output Real phi(unit = "rad", start = 0, fixed = true) annotation(__Daest(std = 0.01));
  Real v(unit = "rad/s", start = 0, fixed = true);
equation
  v = der(phi);
  J*der(v) = u - d*v - mgl*sin(phi) + w;
end Pendulum;
"""
TRUTH = {"J": 0.025, "d": 0.02, "mgl": 0.6}
INTENSITY = 2e-4
PERIOD = 0.02
SUBSTEPS = 20


@pytest.fixture
def pendulum(tmp_path: Path) -> Path:
    rng = np.random.default_rng(1)
    torque = np.repeat(rng.uniform(-0.6, 0.6, 50), 30)
    angle = speed = 0.0
    rows = []
    dt = PERIOD / SUBSTEPS
    for k, u in enumerate(torque):
        rows.append((k * PERIOD, u, angle + 0.01 * rng.standard_normal()))
        for _ in range(SUBSTEPS):
            kick = np.sqrt(INTENSITY * dt) * rng.standard_normal()
            force = u - TRUTH["d"] * speed - TRUTH["mgl"] * np.sin(angle)
            angle, speed = angle + dt * speed, speed + (dt * force + kick) / TRUTH["J"]
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header="time,u,phi", comments="", fmt="%.9g")
    (tmp_path / "Pendulum.mo").write_text(MODEL)
    return tmp_path


@pytest.mark.parametrize("likelihood", [pytest.param("observer", marks=pytest.mark.slow), "ekf"])
def test_parameters_and_noise_of_a_driven_pendulum(pendulum, monkeypatch, capsys, likelihood):
    monkeypatch.chdir(pendulum)
    arguments = ["identify", "run.csv", "--model", "Pendulum.mo", "--split", "0.6", "--hold", "zoh"]
    assert run([*arguments, "--likelihood", likelihood, "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "converged" and found["method"] == "pem"
    for name, value in TRUTH.items():
        estimate = found["parameters"][name]
        assert abs(estimate["value"] - value) < 3 * estimate["std_error"]
        assert estimate["std_error"] < 0.05 * value
    # A factor 2 is four standard errors of the intensity here.
    assert INTENSITY / 2 < found["noise"]["process"]["w"]["intensity"] < 2 * INTENSITY
    assert found["fit_percent"]["validation"]["phi"] < found["one_step"]["fit_percent"]["validation"]["phi"]


@pytest.mark.slow
def test_multiple_shooting_finds_what_a_simulation_over_the_record_does_not(pendulum, monkeypatch, capsys):
    """The pendulum turns over: from the start values a simulation leaves the record for good."""
    monkeypatch.chdir(pendulum)
    arguments = ["identify", "run.csv", "--model", "Pendulum.mo", "--hold", "zoh", "--method", "oe"]
    found = []
    for segments in (1, 20):
        assert run([*arguments, "--shooting", str(segments), "--format", "json"]) == 0
        found.append(json.loads(capsys.readouterr().out))
    assert found[1]["fit_percent"]["estimation"]["phi"] > 90.0
    assert found[1]["log_likelihood"] > found[0]["log_likelihood"] + 1000.0
    # The second look of the command goes on from either end. Without it:
    flat = daest.compile_model(pendulum / "Pendulum.mo")
    signals = [daest.Signal("u", "N.m", "u")], [daest.Signal("phi", "rad", "phi")]
    record = daest.read_experiments([pendulum / "run.csv"], *signals)
    options = IdentifyOptions(method="oe", hold="zoh", second_look=False)
    once, cut = (daest.identify(flat, record, replace(options, shooting=segments)) for segments in (1, 20))
    assert "found by multiple shooting (20 segments)" in cut.notes
    fits = [fit.simulated["estimation"].fit_percent["phi"] for fit in (once, cut)]
    assert fits[0] < 60.0 and fits[1] > 90.0


@pytest.mark.slow  # a prior by the command: test_fit_commands.py
def test_prior_of_a_nonlinear_model(pendulum, monkeypatch, capsys):
    monkeypatch.chdir(pendulum)
    arguments = ["identify", "run.csv", "--model", "Pendulum.mo", "--hold", "zoh", "--format", "json"]
    assert run([*arguments, "--prior", "J=0.03,0.00001"]) == 0
    J = json.loads(capsys.readouterr().out)["parameters"]["J"]
    assert J["prior"] == {"mean": 0.03, "std": 0.00001}
    assert J["value"] == pytest.approx(0.03, abs=1e-4) and J["std_error"] <= 1.01e-5


def test_step_in_the_model_is_refused(pendulum, monkeypatch, capsys):
    monkeypatch.chdir(pendulum)
    text = MODEL.replace("- mgl*sin(phi)", "- mgl*sin(phi) - 0.01*sign(v)")
    (pendulum / "Pendulum.mo").write_text(text)
    assert run(["identify", "run.csv", "--model", "Pendulum.mo"]) == 2
    shown = capsys.readouterr().err
    assert "error[identify-jump]" in shown and "Pendulum.mo:12" in shown
