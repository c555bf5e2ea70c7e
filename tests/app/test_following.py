"""The process behind the sliders: its curves and errors are those of a comparison, and it answers quickly."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from lag_data import LAG, PROJECT, recording, write_csv

from daest.cli.main import run

SPEED = 0.05  # s for a frame: 20 in a second


@pytest.fixture(scope="module")
def project(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("lag")
    (folder / "Lag.mo").write_text(LAG)
    (folder / "daest.toml").write_text(PROJECT)
    write_csv(folder / "run1.csv", *recording(400, 1))
    write_csv(folder / "run2.csv", *recording(3000, 2))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run(["identify"]) == 0 and run(["compare"]) == 0
    return folder


@pytest.fixture(scope="module")
def answers(project) -> list[dict]:
    """What the process tells first, and its answers to four questions and to those of a moved slider."""
    asked = [
        {"id": 1, "measured": True},
        {"id": 2, "values": {"T": 2.0}, "window": [1.0, 2.0], "recording": 0},
        {"id": 3, "band": True},
        {"id": 4, "values": {"T": "much"}, "window": "wide", "recording": 99},
    ]
    return told(project, *asked, *({"id": i, "values": {"T": 1.0 + 0.001 * i}} for i in range(5, 45)))


def told(project, *questions) -> list[dict]:
    """Answers of the process to the questions."""
    lines = "".join(json.dumps(question) + "\n" for question in questions)
    command = [sys.executable, "-m", "daest", "app", "--follow", "Lag.mo"]
    done = subprocess.run(command, input=lines, cwd=project, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_it_tells_what_a_comparison_tells(project, answers):
    first, fit, other, band, odd = answers[:5]
    comparison = json.loads((project / "results" / "comparison.json").read_text())
    with np.load(project / "results" / "comparison.npz") as series:
        time = series["0.time"]
        simulated, measured = (series[key][:, 0] for key in ("0.0.simulated", "0.measured"))
    name = first["outputs"][0]["name"]
    assert fit["rms"][name] == pytest.approx(comparison["models"][0]["rms"][name], rel=1e-9)
    assert odd["rms"] == fit["rms"]
    curve = fit["curves"][0]
    at = np.searchsorted(time, np.array(curve["x"]) - 1e-6)
    np.testing.assert_allclose(curve["y"], simulated[at], rtol=1e-6, atol=1e-7)
    assert max(curve["y"]) == pytest.approx(simulated.max(), rel=1e-6) and len(curve["x"]) <= 1200
    assert max(fit["measured"][0]["y"]) == pytest.approx(measured.max(), rel=1e-6)
    assert other["rms"][name] > 2.0 * fit["rms"][name]
    assert min(other["curves"][0]["x"]) >= 0.9 and max(other["curves"][0]["x"]) <= 2.1
    low, high = (np.array(band["bands"][0][side]["y"]) for side in ("low", "high"))
    assert np.all(low <= high) and 0.0 < np.max(high - low) < 0.2 * np.ptp(simulated)


def test_sliders_reach_from_bounds_to_bounds_and_as_far_as_the_fit_is_unsure(project, answers):
    sliders = {one["name"]: one for one in answers[0]["parameters"]}
    fit = json.loads((project / "results" / "fit.json").read_text())["parameters"]
    assert set(fit) <= set(sliders)
    for name, entry in fit.items():
        one = sliders[name]
        assert one["value"] == pytest.approx(entry["value"]) and one["std_error"] == pytest.approx(
            entry["std_error"]
        )
        assert one["low"] < one["value"] < one["high"] and one["estimated"]
        reach = min(one["high"] - one["value"], one["value"] - one["low"])
        assert reach > 2.0 * one["std_error"]


def test_a_frame_takes_a_fraction_of_its_time(answers):
    """In the process itself, so that other work on the machine does not decide: the median of many."""
    assert len(answers[5:]) == 40
    assert np.median([answer["seconds"] for answer in answers[5:]]) < SPEED


@pytest.mark.slow
def test_a_candidate_beside_the_model(project):
    """Errors of both are those of a comparison; the plot tells them apart."""
    later = LAG.replace("Lag", "Later").replace("k = 2", "k = 2.5")
    assert later != LAG
    (project / "Later.mo").write_text(later)
    command = [sys.executable, "-m", "daest", "app", "--follow", "Lag.mo", "--beside", "Later.mo"]
    done = subprocess.run(command, cwd=project, capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    comparison = json.loads((project / "results" / "comparison.json").read_text())["models"][0]
    assert told["rms"][0] == pytest.approx(comparison["rms"], rel=1e-9)
    assert told["rms"][1]["y"] > 1.2 * told["rms"][0]["y"]
    item = json.dumps(json.loads(told["plot"]["item"]))
    assert '"as it is"' in item and '"with it"' in item
