"""From Modelica source to the FMU and back: the servo with index 3, and a nonlinear tank."""

import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
import scipy.integrate
from fmu_archives import changed

from daest.fmu import serialization
from daest.fmu.export import export_fmu
from daest.fmu.linearize import cross_check_fmu, linearize_fmu, matrices_apart
from daest.fmu.load import symbolic_model
from daest.fmu.serialization import portable
from daest.modelica.compile import compile_model
from daest.systems.linear.linearize import linearize

ROOT = Path(__file__).resolve().parents[2]
SOURCES = (
    pytest.param("tests/library/models/ServoIndex3.mo", marks=pytest.mark.slow),
    pytest.param("examples/servo/Servo.mo", marks=pytest.mark.slow),
    "examples/tank/Tank.mo",
)


@pytest.mark.parametrize("source", SOURCES)
def test_model_and_binary_agree(source, tmp_path):
    flat = compile_model(ROOT / source)
    result = export_fmu(flat, tmp_path / "m.fmu")
    assert result.validation == ()
    assert result.n_equations == flat.n
    assert cross_check_fmu(tmp_path / "m.fmu")["largest"] < 1e-8
    stripped = changed(tmp_path / "m.fmu", tmp_path / "s.fmu", drop=[serialization.FOLDER])
    found = linearize_fmu(stripped)
    assert found.source == "fmi-ls-dae"
    assert matrices_apart(found, linearize(flat)) < 1e-12
    assert found.equations == portable(flat).equations
    assert found.unknowns == portable(flat).unknowns


def test_fmu_names_no_folder_of_this_machine(tmp_path):
    flat = compile_model(ROOT / "examples/servo/Servo.mo")
    export_fmu(flat, tmp_path / "servo.fmu")
    back = symbolic_model(tmp_path / "servo.fmu")
    files = {item.place.file for item in (*back.equations, *back.unknowns) if item.place}
    assert "Servo.mo" in files
    assert "Daest/Mechanics/Rotational/Components/Inertia.mo" in files
    with zipfile.ZipFile(tmp_path / "servo.fmu") as archive:
        assert not [n for n in archive.namelist() if str(ROOT).encode() in archive.read(n)]


def servo_rate(t, x, p, u):
    """The four-state servo, written from the physics: motor and gear, spring with damper, disc."""
    phi1, w1, phi2, w2 = x
    n = p["gear.ratio"]
    spring = p["c"] * (phi2 - phi1 / n) + p["d"] * (w2 - w1 / n)
    current = (u - p["k"] * w1) / p["R"]
    return [w1, (p["k"] * current + spring / n) / p["J1"], w2, -spring / p["J2"]]


@pytest.mark.slow  # the binary: the test above
def test_servo_simulates_like_the_hand_written_equations(tmp_path):
    flat = compile_model(ROOT / "examples/servo/Servo.mo")
    export_fmu(flat, tmp_path / "servo.fmu")
    tuned = {"J2": 0.035}
    result = fmpy.simulate_fmu(
        str(tmp_path / "servo.fmu"),
        stop_time=3.0,
        output_interval=0.02,
        relative_tolerance=1e-10,
        start_values={"u": 2.0, **tuned},
        output=["omega", "phi"],
    )
    values = {p.name: p.value for p in flat.parameters} | tuned
    exact = scipy.integrate.solve_ivp(
        servo_rate, (0, 3), np.zeros(4), "LSODA", result["time"], args=(values, 2.0), rtol=1e-10, atol=1e-12
    ).y
    assert np.abs(result["phi"] - exact[2]).max() < 1e-6
    assert np.abs(result["omega"] - exact[1] / values["gear.ratio"]).max() < 1e-6
    assert np.ptp(result["phi"]) > 1.0
