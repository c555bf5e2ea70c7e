"""Commands on an FMU without equations: what they do, and what they refuse."""

import json
import re
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "fmu"))
from ball_fmu import DESCRIPTION, ball, fall
from fmu_archives import changed

from daest.cli.main import run
from daest.diagnosis.without_equations.black_box import diagnose_black_box
from daest.errors import EstimationError
from daest.fmu.binary_model import binary_model
from daest.model.experiment import Experiment
from daest.systems.reduction.reduce import dynamics
from daest.systems.simulation.local_linear import local_model

TIME = np.linspace(0.0, 2.0, 41)
FORCE = 9.81 + 3.0 * np.sin(3.0 * TIME)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    ball(tmp_path)
    h = fall(TIME, FORCE, d=0.25)[0] + 0.005 * np.random.default_rng(1).standard_normal(TIME.size)
    rows = [f"{t:.4f},{u:.6f},{y:.6f}" for t, u, y in zip(TIME, FORCE, h, strict=True)]
    (tmp_path / "run.csv").write_text("time,u,y\n" + "\n".join(rows) + "\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def told(capsys, code):
    text = capsys.readouterr().err
    assert f"error[{code}]" in text
    assert "Traceback" not in text


@pytest.mark.slow
def test_identify_compare_and_noise(folder, capsys):
    arguments = ["identify", "run.csv", "--model", "ball.fmu", "--estimate", "d", "--hold", "foh"]
    assert run([*arguments, "--format", "json"]) == 0
    fit = json.loads(capsys.readouterr().out)
    d = fit["parameters"]["d"]
    assert abs(d["value"] - 0.25) < 4 * d["std_error"]
    assert run(["compare", "ball.fmu", "--data", "run.csv", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out)["models"][0]["rms"]["y"] < 0.01
    assert run(["noise", "ball.fmu"]) == 0


def test_values_that_are_no_numbers_and_outputs_that_are_none_are_told(folder, capsys):
    ball(folder, "CoSimulation", TRAP="NOT_A_NUMBER")
    assert run(["simulate", "ball.fmu", "--inputs", "run.csv", "-o", "out.csv"]) == 0
    assert re.search(r"no finite values from t = 0\.5\d* s on: y", capsys.readouterr().err)
    changed(folder / "ball.fmu", folder / "mute.fmu", replace={
        "modelDescription.xml": description(folder / "ball.fmu").replace(' causality="output"', "")
        .replace("<Outputs><Unknown index=\"6\"/></Outputs>", "").encode()
    })  # fmt: skip
    assert run(["simulate", "mute.fmu", "--inputs", "run.csv", "--to", "0.4", "-o", "out.csv"]) == 0
    assert "no outputs that are numbers: --all writes its 4 variables" in capsys.readouterr().err


def test_inner_variable_that_is_measured_has_its_noise(folder, capsys):
    """[data] outputs makes it an output, [noise.measurement] may speak of it."""
    (folder / "daest.toml").write_text(
        '[model]\nsource = "ball.fmu"\n[data]\nestimate = ["run.csv"]\noutputs = { h = "y" }\n'
        "[parameters]\nd = { estimate = true }\n[noise.measurement]\nh = { std = 0.005, estimate = true }\n"
    )
    assert run(["identify", "--method", "oe", "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert abs(found["parameters"]["d"]["value"] - 0.25) < 4 * found["parameters"]["d"]["std_error"]
    assert found["noise"]["measurement"]["h"]["std"] == pytest.approx(0.005, rel=0.4)


def description(path):
    with zipfile.ZipFile(path) as archive:
        return archive.read("modelDescription.xml").decode()


def test_effects_and_places_can_be_named(folder, capsys):
    """With the pictures and options of models with equations; what an earlier run has found is not made
    again."""
    (folder / "daest.toml").write_text("[parameters]\nd = { estimate = true }\n")
    command = ["diagnose", "run.csv", "--model", "ball.fmu", "--effect", "CoulombFriction", "--at", "u"]
    more = ["--split", "0.5", "--jobs", "2", "--plot", "found.png", "--format", "json"]
    assert run([*command, *more]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["searched"] == {"effects": ["CoulombFriction"], "places": ["u"]}
    assert found["screen"]["n_screened"] == 2  # of h and v
    assert {e["effect"] for e in found["screen"]["best"]} == {"CoulombFriction"}
    assert Path("found.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads(Path("results/diagnosis.json").read_text())["verdict"] == found["verdict"]


def test_effects_that_cannot_be_tried_from_outside(folder, capsys):
    for words, code in (
        (["--effect", "LuGreFriction"], "diagnose-fmu-search"),
        (["--effect", "CoulombFrictoin"], "effect-unknown"),
        (["--at", "brake"], "effect-place"),
    ):
        assert run(["diagnose", "run.csv", "--model", "ball.fmu", *words]) == 2
        told(capsys, code)
    assert run(["improve", "run.csv", "--model", "ball.fmu"]) == 2
    told(capsys, "fmu-no-equations")


def test_gaps_are_refused(tmp_path):
    flat = binary_model(ball(tmp_path))
    whole = Experiment("run", TIME, FORCE[:, None], np.ones((41, 1)), ("u",), ("y",))
    gaps = replace(whole, outputs=np.where(TIME[:, None] > 1, np.nan, 1.0))
    with pytest.raises(EstimationError) as caught:
        diagnose_black_box(flat, (), [gaps], [whole])
    assert caught.value.code == "diagnose-gaps"


def test_derivatives_that_a_binary_does_not_have(tmp_path):
    flat = binary_model(ball(tmp_path))
    with pytest.raises(EstimationError) as caught:
        local_model(dynamics(flat), tangents=True)
    assert caught.value.code == "given-form-without-tangents"


def test_purely_discrete_fmu(tmp_path, capsys):
    text = DESCRIPTION.replace("KIND", "ModelExchange").replace("INDICATORS", "0")
    text = re.sub(r'<ScalarVariable name="(?:[hvyw]|der.*)".*\n', "", text)
    text = re.sub(r"<ModelStructure>.*</ModelStructure>", "<ModelStructure/>", text, flags=re.DOTALL)
    with zipfile.ZipFile(tmp_path / "d.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("binaries/linux64/ball.so", b"")
    assert run(["linearize", str(tmp_path / "d.fmu")]) == 2
    told(capsys, "fmu-nothing-continuous")
