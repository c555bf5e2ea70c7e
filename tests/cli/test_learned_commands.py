"""An effect that no library holds, from the command line: friction of a cart that depends on its place."""

from __future__ import annotations

import json

import numpy as np
import pytest
from cart_data import CART, TRUE, WAVES, recording, write_recording

from daest.modelica.compile import compile_model

FRICTION, BUMPS, CUBIC = 0.6, 0.9, 20.0
FEW = ("--effect", "ConstantLoad", "--effect", "HardeningSpring", "--hold", "zoh")


def cart(tmp_path, monkeypatch, cubic=0.0):
    """Be in a folder with Cart.mo and bumpy.csv."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Cart.mo").write_text(CART)
    table = recording(1600, 1, friction=FRICTION, bumps=BUMPS, cubic=cubic)
    write_recording(tmp_path / "bumpy.csv", table)
    return tmp_path


def true_friction(s):
    return -FRICTION * (1.0 + BUMPS * np.sin(WAVES * s))


@pytest.mark.slow
def test_curve_is_written_into_the_model(tmp_path, daest, monkeypatch):
    folder = cart(tmp_path, monkeypatch)
    code, out, err = daest("diagnose", "bumpy.csv", "--model", "Cart.mo", *FEW, "--format", "json")
    assert code == 0, err
    found = json.loads(out)
    assert found["verdict"] == "unknown effect"
    load = found["disturbance"]
    learned = load["learned"]
    assert (load["variable"], load["sign_of"]) == ("cart.s", "cart.v")
    assert learned["refitted"] and learned["period"] is None
    before, after = learned["rms_before"]["s"], learned["rms"]["s"]
    assert before == found["baseline"]["rms"]["validation"]["s"] and after < before / 10
    assert f"validation error (rms) s {before:.3g} -> {after:.3g}." in found["message"]
    x, y, std = np.array(learned["curve"]).T
    inside = np.abs(x) < 0.7  # beyond, the cart was seldom, and the straight lines are long
    assert inside.sum() > 6 and np.corrcoef(y[inside], true_friction(x[inside]))[0, 1] > 0.9
    assert np.all(std > 0.0)
    for name, true in TRUE.items():
        assert learned["model_parameters"][name]["value"] == pytest.approx(true, rel=0.02)

    (folder / "daest.toml").write_text('[model]\nsource = "Cart.mo"\n')
    assert daest("report")[0] == 0
    page = (folder / "report.html").read_text()
    assert "Cart_Learned" in page and "refitted in the model" in page

    (folder / "New.mo").write_text(load["model"])
    flat = compile_model(folder / "New.mo")
    values = {p.name: p.value for p in flat.parameters}
    assert [values[f"learned.y[{i + 1}]"] for i in range(y.size)] == pytest.approx(y, rel=1e-6)
    code, out, err = daest("compare", "New.mo", "--data", "bumpy.csv", "--hold", "zoh", "--format", "json")
    assert code == 0, err
    assert json.loads(out)["models"][0]["rms"]["s"] < 2 * after


@pytest.mark.slow
def test_text_shows_the_refitted_curve(tmp_path, daest, monkeypatch):
    cart(tmp_path, monkeypatch)
    code, out, _ = daest("diagnose", "bumpy.csv", "--model", "Cart.mo", *FEW)
    assert code == 0 and out.startswith("Unknown effect.")
    assert "load [N] where cart.v > 0" in out
    assert "The curve was refitted in the model, with m = 1.00" in out
    assert "`disturbance.model` of the json result" in out


@pytest.mark.slow
def test_improve_offers_the_curve_on_top_of_the_last_step(tmp_path, daest, monkeypatch):
    folder = cart(tmp_path, monkeypatch, CUBIC) / "results" / "improve"
    arguments = ("improve", "bumpy.csv", "--model", "Cart.mo", *FEW, "--format", "json")
    code, out, err = daest(*arguments)
    assert code == 0, err
    found = json.loads(out)
    assert [step["added"] for step in found["steps"]] == [None, "HardeningSpring", "LearnedForce"]
    curve = found["steps"].pop()
    assert curve["at"] == "cart.flange_a" and curve["verdict"] == "unknown effect"
    assert curve["model"] == found["unknown_effect"] and curve["disturbance"]["variable"] == "cart.s"
    assert curve["model_rms"]["s"] == pytest.approx(curve["rms"]["validation"]["s"], rel=0.05)
    assert found["unknown_effect"] == "unknown_effect.mo"
    assert found["reason"].startswith("An effect that the library does not hold acts at cart.flange_a")
    assert found["reason"].endswith("The model with the curve is offered as unknown_effect.mo.")
    learned = found["final"]["disturbance"]["learned"]
    assert learned["rms"]["s"] == pytest.approx(curve["rms"]["validation"]["s"])
    assert learned["rms"]["s"] < found["steps"][-1]["rms"]["validation"]["s"] / 5
    flat = compile_model(folder / "unknown_effect.mo")
    assert flat.name == "Cart_HardeningSpring_Learned"
    values = {p.name: p.value for p in flat.parameters}
    assert values["hardeningSpring.c3"] == pytest.approx(CUBIC, rel=0.03)
    assert {name: values[name] for name in TRUE} == pytest.approx(TRUE, rel=0.03)

    (tmp_path / "daest.toml").write_text('[model]\nsource = "Cart.mo"\n')
    assert daest("report")[0] == 0
    page = (tmp_path / "report.html").read_text()
    assert "unknown_effect.mo" in page and "Cart_HardeningSpring_Learned" in page

    # Where nothing is unknown in a later run, the file goes.
    write_recording(tmp_path / "bumpy.csv", recording(1000, 2))
    code, out, err = daest(*arguments)
    assert code == 0, err
    assert json.loads(out)["unknown_effect"] is None
    assert not (folder / "unknown_effect.mo").exists()
