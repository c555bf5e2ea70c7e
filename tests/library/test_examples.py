"""The examples: complete, consistent with their recordings, and with the numbers that their pages tell."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from daest.data.project import load_project
from daest.data.read import Signal, read_experiments
from daest.modelica.compile import compile_model
from daest.systems.linearize import linearize
from daest.systems.noise import noise_report
from daest.systems.simulate import simulate

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NAMES = sorted(folder.name for folder in EXAMPLES.iterdir() if (folder / "daest.toml").is_file())
WITH_RECORDING = ("servo", "zone")
MEASURED_ELSEWHERE = ("emps",)  # the recordings are not part of the project


def test_every_folder_is_an_example() -> None:
    assert {folder.name for folder in EXAMPLES.iterdir() if folder.is_dir()} == set(NAMES)
    assert {*WITH_RECORDING, *MEASURED_ELSEWHERE, "report_servo"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_project_file_fits_the_model(name: str) -> None:
    project = load_project(EXAMPLES / name)
    assert project.source is not None and (project.folder / "README.md").is_file()
    flat = compile_model(project.source, project.class_name)
    assert set(project.inputs) <= {v.name for v in flat.inputs}
    assert {*project.outputs, *project.measurement_noise} <= {o.name for o in flat.outputs}
    assert set(project.parameters) <= {p.name for p in flat.parameters}
    assert any(p.estimate for p in flat.parameters)
    places = {*(v.name for v in flat.unknowns), *(w.name for w in flat.noises)}
    assert set(project.process_noise) <= places


@pytest.mark.parametrize("name", NAMES)
def test_noise_is_admissible_and_leaves_the_outputs_alone(name: str) -> None:
    project = load_project(EXAMPLES / name)
    flat = compile_model(project.source, project.class_name)
    report = noise_report(linearize(flat), at=tuple(project.process_noise))
    noises = (*report.annotated, *report.asked)
    assert noises
    assert all(place.admissible and not place.white_outputs for place in noises)


@pytest.mark.parametrize("name", WITH_RECORDING)
def test_recording_fits_the_model(name: str) -> None:
    project = load_project(EXAMPLES / name)
    flat = compile_model(project.source, project.class_name)
    inputs = [Signal(v.name, v.unit, project.inputs[v.name]) for v in flat.inputs]
    outputs = [Signal(o.name, o.unit, project.outputs[o.name]) for o in flat.outputs]
    (experiment,) = read_experiments(project.estimate, inputs, outputs)
    assert experiment.period is not None
    assert np.isfinite(experiment.outputs).all()


def test_servo_with_its_true_parameters_leaves_the_noise() -> None:
    """The residual of a simulation with the true parameters has the variance of the measurement noise, inside
    the 99.9 % band of chi-square; and the fit that the page of the example tells."""
    folder = EXAMPLES / "servo"
    flat = compile_model(folder / "Servo.mo")
    truth = json.loads((folder / "truth.json").read_text())
    theta = np.array([truth["parameters"].get(p.name, p.value) for p in flat.parameters])
    signals = [Signal(o.name, o.unit) for o in flat.outputs]
    (experiment,) = read_experiments([folder / "servo.csv"], [Signal("u", "V")], signals)
    error = experiment.outputs - simulate(flat, experiment, theta=theta, hold="zoh").outputs
    n = experiment.n_samples
    squares = np.sum(error**2, axis=0) / np.array(truth["noise"]) ** 2
    assert (chi2.ppf(0.0005, n) < squares).all() and (squares < chi2.ppf(0.9995, n)).all()
    spread = experiment.outputs - experiment.outputs.mean(axis=0)
    fit = 100 * (1 - np.linalg.norm(error, axis=0) / np.linalg.norm(spread, axis=0))
    np.testing.assert_allclose(fit, [98.49, 98.45], atol=0.005)


SPRING_FIRST = "  connect(gear.flange_b, spring.flange_a);\n  connect(gear.flange_b, damper.flange_a);\n"
DAMPER_FIRST = "  connect(gear.flange_b, damper.flange_a);\n  connect(gear.flange_b, spring.flange_a);\n"


@pytest.mark.parametrize(
    ("connections", "n_forbidden", "n_large", "small_norm"),
    [(SPRING_FIRST, 10, 7, 1 / 67), (DAMPER_FIRST, 9, 6, 1 / 60)],
    ids=["spring first", "damper first"],
)
def test_report_servo(
    tmp_path: Path, connections: str, n_forbidden: int, n_large: int, small_norm: float
) -> None:
    text = (EXAMPLES / "report_servo" / "Servo.mo").read_text()
    assert text.count(SPRING_FIRST) == 1
    model = tmp_path / "Servo.mo"
    model.write_text(text.replace(SPRING_FIRST, connections))
    dae = linearize(compile_model(model))
    report = noise_report(dae)
    assert (dae.n, report.n_dynamic, report.index) == (54, 4, 2)
    sizes = np.array(report.N_singular_values)
    assert sizes.shape == (50,)
    np.testing.assert_allclose(sizes[:2], [1.414, 1.000], atol=5e-4)
    assert not sizes[2:].any()
    forbidden = [place for place in report.places if not place.admissible]
    assert len(forbidden) == n_forbidden
    assert all(".phi" in place.name and ".tau" not in place.name for place in forbidden)
    small = [place.projection_norm for place in forbidden if place.projection_norm < 0.02]
    assert small == pytest.approx([small_norm] * 3, rel=2e-3)
    coarse = noise_report(dae, tolerance=0.02)
    assert sum(not place.admissible for place in coarse.places) == n_large
