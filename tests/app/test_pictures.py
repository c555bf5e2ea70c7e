"""What Start and Doubt draw: recordings with their faults, rivals as models of their own."""

import json

import pytest
from cart_data import CART

from daest.app.actions import MOST_RIVALS, Standing, lines, rivals
from daest.app.pictures import recording_pictures
from daest.app.state import HOME, Desk, state
from daest.app.story import Step, Story
from daest.errors import ConfigError


def rival(effect, verdict="not separable", model="model"):
    size = {"f_c": {"value": 0.5, "std_error": None, "unit": "N"}}
    return {"effect": effect, "at": "cart.flange_a", "verdict": verdict, "model": model, "parameters": size}


def standing(candidates, number=0) -> Standing:
    steps = (Step(0, None, "Cart.mo"), Step(1, 0, "results/app/models/1_A.mo", "A", "b"))
    return Standing(None, HOME, Story(steps, number), (), {"candidates": candidates}, ())


def test_rivals_are_written_refitted_and_compared():
    found = lines("rivals", {}, standing([rival("Coulomb"), rival("Worse", "rejected"), rival("Stribeck")]))
    assert [line[0] for line in found] == ["extend", "extend", "compare"]
    files = [f"{HOME}/rivals/0_1_Coulomb.mo", f"{HOME}/rivals/0_2_Stribeck.mo"]
    assert [line[-1] for line in found[:2]] == files and "f_c=0.5" in found[0]
    assert found[2] == ["compare", "Cart.mo", *files, "--refit", "-o", f"{HOME}/rivals/0.json"]
    later = lines("rivals", {}, standing([rival("Coulomb"), rival("Stribeck")], 1))
    assert later[0][1] == later[2][1] == "results/app/models/1_A.mo"


def test_one_candidate_has_no_rival():
    assert rivals(None) == [] and rivals({"candidates": [rival("A"), rival("B", model=None)]}) == []
    assert len(rivals({"candidates": [rival(f"E{i}") for i in range(9)]})) == MOST_RIVALS
    with pytest.raises(ConfigError, match="no two candidates"):
        lines("rivals", {}, standing([rival("A")]))


def test_faults_are_drawn_where_they_begin(tmp_path):
    (tmp_path / "Cart.mo").write_text(CART)
    rows = [f"{0.02 * i:.2f},{i % 3},{0.1 * i if i != 50 else 99}" for i in range(100)]
    (tmp_path / "run.csv").write_text("\n".join(["time,F,s", *rows]) + "\n")
    desk = Desk(tmp_path)
    assert recording_pictures(desk) == []
    (tmp_path / "daest.toml").write_text('[model]\nsource = "Cart.mo"\n[data]\nestimate = ["run.csv"]\n')
    columns = [
        {"name": "F", "role": "input", "unit": "N"},
        {"name": "s", "role": "output", "unit": "m"},
        {"name": "time", "role": None, "unit": "s"},
    ]
    findings = [
        {"column": "s", "time": 1.0, "level": "warning", "text": "s has an outlier"},
        {"column": None, "time": 0.5, "level": "note", "text": "the clock jumps"},
        {"column": "s", "time": None, "level": "note", "text": "s is coarse"},
    ]
    check = {"recordings": [{"name": "run", "columns": columns, "findings": findings}]}
    (tmp_path / HOME).mkdir(parents=True)
    (tmp_path / HOME / "check.json").write_text(json.dumps(check))
    (picture,) = recording_pictures(desk)
    assert picture["id"] == "plot-recording-0" and "F, s of run" in picture["label"]
    assert state(desk)["rivals"] is None
    # The clock in both columns, the outlier in one.
    assert picture["item"].count('"location": 0.5') == 2 and picture["item"].count('"location": 1.0') == 1


def test_the_next_experiment_is_designed_for_the_current_model():
    assert lines("design", {}, standing([])) == [["design", "-o", "next_input.csv"]]
    (later,) = lines("design", {}, standing([], 1))
    assert later[1] == "--model" and later[-1] == "next_input.csv"


@pytest.mark.parametrize(("model", "is_seen"), [("Cart.mo", True), ("Other.mo", False)])
def test_a_diagnosis_of_the_command_line_is_that_of_the_page(tmp_path, model, is_seen):
    """It belongs to a step if it was made from its model; the newest one counts."""
    (tmp_path / "Cart.mo").write_text(CART)
    (tmp_path / "daest.toml").write_text('[model]\nsource = "Cart.mo"\n')
    document = {"candidates": [rival("New")], "made_from": {"files": [{"role": "model", "path": model}]}}
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "diagnosis.json").write_text(json.dumps(document))
    desk = Desk(tmp_path)
    assert (state(desk)["diagnosis"] is not None) is is_seen
    (desk.home / "diagnoses").mkdir(parents=True)
    (desk.home / "diagnoses" / "0.json").write_text(json.dumps({"candidates": [rival("Old")]}))
    found = state(desk)["diagnosis"]["candidates"]
    assert [one["effect"] for one in found] == ["New" if is_seen else "Old"]
    assert desk.standing().diagnosis["candidates"][0]["effect"] == found[0]["effect"]
