"""`daest diagnose`: what it finds in a cart with hidden friction, what it writes, where it goes on, and what
it refuses. The recordings come from an integration in the test."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from cart_data import CART, recording, write_recording

from daest.cache import cache_folder
from daest.diagnosis import examine
from daest.diagnosis.evidence import stand
from daest.diagnosis.refits import search
from daest.modelica.compile import compile_model

FRICTION = 0.5  # N
COULOMB = ("--effect", "CoulombFriction")


@pytest.fixture
def cart(tmp_path, monkeypatch):
    """A folder with Cart.mo and rub.csv, where the cart rubs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Cart.mo").write_text(CART)
    write_recording(tmp_path / "rub.csv", recording(600, 1, friction=FRICTION))
    return tmp_path


def diagnosis(daest, *arguments):
    """Document and stderr of a diagnosis of Cart.mo."""
    code, out, err = daest("diagnose", *arguments, "--model", "Cart.mo", "--hold", "zoh", "--format", "json")
    assert code == 0, err
    return json.loads(out), err


def refusal(daest, *arguments, model="Cart.mo"):
    code, out, err = daest("diagnose", *arguments, "--model", model, "--hold", "zoh")
    assert code == 2 and not out
    assert "Traceback" not in err
    return err


def test_hidden_friction_is_found_and_written(cart, daest):
    found, err = diagnosis(daest, "rub.csv", *COULOMB, "--plot", "picture.png")
    assert found["schema"] == "daest/diagnose/1" and found["verdict"] == "supported"
    best = found["candidates"][0]
    size = best["parameters"]["f_c"]
    assert (best["effect"], best["at"], best["verdict"]) == ("CoulombFriction", "cart.flange_a", "supported")
    assert abs(size["value"] - FRICTION) < 0.02 * FRICTION and size["unit"] == "N"
    assert best["equivalent_places"] == ["spring"]
    before, after = found["baseline"]["rms"]["validation"]["s"], best["rms"]["validation"]["s"]
    assert after < before / 5 and best["delta_bic"] > 100
    assert {"p_value", "not_separable_from", "fit_percent", "model"} <= set(best)
    assert found["places"][0]["group"][0] == "cart.flange_a"
    assert "half of every recording" in err and "refitting with CoulombFriction" in err
    assert "no parameter is estimated" not in err
    kept = json.loads((cart / "results" / "diagnosis.json").read_text())
    assert kept.pop("made_from")["files"][0]["path"] == "Cart.mo"
    assert kept == found
    assert (cart / "picture.png").stat().st_size > 5000

    (cart / "New.mo").write_text(best["model"])
    values = {p.name: p.value for p in compile_model(cart / "New.mo").parameters}
    assert values["coulombFriction.f_c"] == pytest.approx(size["value"], rel=1e-7)
    for name, parameter in best["model_parameters"].items():
        assert values[name] == pytest.approx(parameter["value"], rel=1e-7)

    # daest extend knows size and form, also at a place that the sensors see alike; what is set goes before.
    for arguments, expected in ((), size["value"]), (("--set", "f_c=3"), 3.0):
        at = ("--effect", "CoulombFriction", "--at", "spring", *arguments, "-o", "Own.mo")
        code, _, err = daest("extend", "Cart.mo", *at)
        assert code == 0 and "sizes as in" in err
        values = {p.name: p.value for p in compile_model(cart / "Own.mo").parameters}
        assert values["coulombFriction.f_c"] == pytest.approx(expected, rel=1e-7)
        assert values["coulombFriction.v_s"] == pytest.approx(best["settings"]["v_s"], rel=1e-4)

    # The same as text, from the fits that are kept.
    code, out, _ = daest("diagnose", "rub.csv", "--model", "Cart.mo", "--hold", "zoh", *COULOMB)
    lines = out.splitlines()
    assert code == 0 and lines[0] == "Supported."
    assert lines[1].startswith("  CoulombFriction at cart.flange_a: f_c = 0.5")
    assert "Only CoulombFriction was searched for." in out
    assert re.search(r"the model as it is +0\.\d+\n", out)
    assert re.search(r"CoulombFriction +cart\.flange_a +0\.00\d+ .* supported", out)
    assert "The model as it is: its parameters refitted together with unknown loads" in out


@pytest.mark.slow
def test_coarser_period_is_told_in_the_result(cart, daest, monkeypatch):
    """The cart's recordings are noisy: that they are taken coarser is only pretended."""
    write_recording(cart / "clean.csv", recording(1200, 2))
    monkeypatch.setattr("daest.data.prepare.sufficient_period", lambda *_: 0.04)
    code, out, err = daest("diagnose", "clean.csv", "--model", "Cart.mo", *COULOMB, "--format", "json")
    assert code == 0
    (remark,) = json.loads(out)["notes"]
    assert "diagnosed at 0.04 s" in remark and "(--resample 0.02 keeps them as they are)" in remark
    assert remark in err
    assert diagnosis(daest, "clean.csv", *COULOMB, "--resample", "0.02")[0]["notes"] == []


@pytest.mark.slow
def test_fit_of_other_data_is_contradicted(cart, daest):
    write_recording(cart / "light.csv", recording(1000, 2))
    write_recording(cart / "heavy.csv", recording(1000, 3, mass=1.3))
    assert daest("identify", "light.csv", "--model", "Cart.mo", "--hold", "zoh")[0] == 0
    found, err = diagnosis(daest, "heavy.csv", *COULOMB)
    assert "fit.json are held against the data" in err
    assert found["verdict"] == "parameters off" and re.search(r"\bm\b", found["message"])
    found, err = diagnosis(daest, "light.csv", *COULOMB)
    assert "held against" not in err and found["verdict"] == "nothing missing"


@pytest.mark.slow
def test_interrupted_run_goes_on(cart, daest, monkeypatch):
    write_recording(cart / "rub.csv", recording(600, 1, friction=FRICTION, cubic=40.0))
    arguments = ("rub.csv", *COULOMB, "--effect", "HardeningSpring", "--jobs", "1")
    proof_of, calls = search.proof_of, []

    def interrupted(*given, **named):
        calls.append(given)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return proof_of(*given, **named)

    monkeypatch.setattr(search, "proof_of", interrupted)
    code, out, err = daest("diagnose", *arguments, "--model", "Cart.mo", "--hold", "zoh")
    assert (code, out) == (130, "") and "interrupted" in err
    assert not (cart / "results" / "diagnosis.json").exists()
    kept = list((cart / "results" / "diagnosis").iterdir())
    assert len(kept) == 1 and kept[0].suffix == ".json"

    monkeypatch.setattr(search, "proof_of", proof_of)
    first, err = diagnosis(daest, *arguments)
    refitted = err.count("refitting with")
    assert 1 <= refitted < 1 + refitted == len(list((cart / "results" / "diagnosis").iterdir()))
    again, err = diagnosis(daest, *arguments)
    assert "refitting with" not in err
    assert [again[key] for key in ("verdict", "message", "candidates")] == [
        first[key] for key in ("verdict", "message", "candidates")
    ]


def test_without_time_the_leaders_are_named_and_the_same_command_goes_on(cart, daest):
    late, _ = diagnosis(daest, "rub.csv", *COULOMB, "--time-limit", "0.001")
    assert late["verdict"] == "cannot tell" and "the time was up" in late["message"]
    assert "The time was up before all of them were refitted" in late["message"]
    (leader,) = late["candidates"]
    assert leader["effect"] == "CoulombFriction" and "the time was up" in leader["reason"]
    assert "same command again" in late["next_experiment"]
    assert diagnosis(daest, "rub.csv", *COULOMB)[0]["verdict"] == "supported"


@pytest.mark.slow
def test_the_null_and_the_screen_are_kept_too(cart, daest, monkeypatch, tmp_path):
    """An interrupted run fits the model as it is, and screens, once; what was kept changes no number."""
    (tmp_path / "cache").mkdir()
    for part in cache_folder().iterdir():  # what is compiled may be used, as far as it exists
        if part.name != "diagnosis":
            (tmp_path / "cache" / part.name).symlink_to(part)
    monkeypatch.setenv("DAEST_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("daest.diagnosis.kept.WORTH_KEEPING", 0.0)
    fit_null, screen, calls = stand.fit_null, examine.screen, []
    monkeypatch.setattr(stand, "fit_null", lambda *given: calls.append("null") or fit_null(*given))
    monkeypatch.setattr(examine, "screen", lambda *given: calls.append("screen") or screen(*given))
    write_recording(cart / "clean.csv", recording(420, 2))  # nothing to refit
    arguments = ("clean.csv", *COULOMB, "--at", "cart.flange_a", "--jobs", "1")
    first, _ = diagnosis(daest, *arguments)
    assert first["verdict"] == "nothing missing" and first["candidates"] == []
    assert "It would have shown" in first["message"]
    assert calls == ["null", "screen"]
    shutil.rmtree(cart / "results")
    again, _ = diagnosis(daest, *arguments)
    assert calls == ["null", "screen"]
    leave = ("seconds", "made_from")
    assert {k: v for k, v in again.items() if k not in leave} == {
        k: v for k, v in first.items() if k not in leave
    }


@pytest.mark.slow  # test_streams.py (signals that ask for the end)
@pytest.mark.skipif(sys.platform == "win32", reason="sends a POSIX signal")
def test_ctrl_c_ends_at_once(cart):
    some = [*COULOMB, "--effect", "StribeckFriction,QuadraticDrag"]
    given = ["rub.csv", "--model", "Cart.mo", "--hold", "zoh", *some]
    command = [sys.executable, "-m", "daest", "diagnose", *given]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stderr:
            if line.startswith("refitting"):
                break
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=10)
    assert (process.returncode, out) == (130, "") and "interrupted" in err and "Traceback" not in err
    assert not (cart / "results" / "diagnosis.json").exists()


@pytest.mark.slow
def test_kept_refits_belong_to_their_data_and_damage_is_mended(cart, daest):
    diagnosis(daest, "rub.csv", *COULOMB)
    (kept,) = (cart / "results" / "diagnosis").iterdir()
    whole = kept.read_text()
    kept.write_text(whole[: len(whole) // 2])
    _, err = diagnosis(daest, "rub.csv", *COULOMB)
    assert "refitting with" in err
    assert json.loads(kept.read_text())["delta_bic"] == json.loads(whole)["delta_bic"]
    write_recording(cart / "rub.csv", recording(1000, 4, friction=FRICTION))
    _, err = diagnosis(daest, "rub.csv", *COULOMB)
    assert "refitting with" in err


@pytest.mark.slow  # the name that is free: tests/effects/test_extend.py
def test_a_model_without_unknowns_is_told(cart, daest):
    (cart / "Cart.mo").write_text(CART.replace("estimate = true", "estimate = false"))
    _, err = diagnosis(daest, "rub.csv", *COULOMB)
    assert "no parameter is estimated" in err


@pytest.mark.slow  # the name that is free: tests/effects/test_extend.py
def test_component_of_the_same_name(cart, daest):
    text = CART.replace("Fixed wall", "Fixed coulombFriction").replace(
        "wall.flange", "coulombFriction.flange"
    )
    (cart / "Cart.mo").write_text(text + "\nmodel Cart_CoulombFriction\nend Cart_CoulombFriction;\n")
    found, _ = diagnosis(daest, "rub.csv", *COULOMB, "--class", "Cart")
    model = found["candidates"][0]["model"]
    assert "model Cart_CoulombFriction2 " in model and "CoulombFriction coulombFriction2(" in model
    (cart / "New.mo").write_text(model)
    assert compile_model(cart / "New.mo", "Cart_CoulombFriction2").name == "Cart_CoulombFriction2"


@pytest.mark.slow
def test_law_at_an_input_that_an_equation_uses_is_written(cart, daest):
    text = CART.replace("connect(F, motor.f);", "motor.f = F;")
    (cart / "Cart.mo").write_text(text)
    table = recording(1000, 5)
    wanted = np.array(table[:, 1])
    lost = recording(1000, 5, force=np.sign(wanted) * np.maximum(np.abs(wanted) - 2.0, 0.0))
    lost[:, 1] = wanted
    write_recording(cart / "dead.csv", lost)
    found, err = diagnosis(daest, "dead.csv", "--effect", "DeadZone", "--at", "F")
    assert "screening 1 effect at places" in err
    best = found["candidates"][0]
    assert best["verdict"] == "supported" and best["parameters"]["width"]["value"] == pytest.approx(
        4.0, rel=0.05
    )
    assert best["parameters"]["width"]["unit"] == found["screen"]["best"][0]["unit"] == "N"
    assert "deadZone.u = F;" in best["model"]
    (cart / "New.mo").write_text(best["model"])
    written = {p.name: p.value for p in compile_model(cart / "New.mo").parameters}
    assert written["deadZone.width"] == pytest.approx(best["parameters"]["width"]["value"], rel=1e-7)


def test_fmu_is_diagnosed_without_text(cart, daest):
    assert daest("export", "Cart.mo", "-o", "Cart.fmu")[0] == 0
    arguments = ("diagnose", "rub.csv", "--model", "Cart.fmu", "--hold", "zoh", *COULOMB, "--format", "json")
    code, out, _ = daest(*arguments)
    best = json.loads(out)["candidates"][0]
    assert code == 0 and best["verdict"] == "supported"
    assert best["model"] is None and "FMU" in best["model_reason"]


def test_refused_names(cart, daest):
    assert "error[effect-unknown]" in refusal(daest, "rub.csv", "--effect", "CoulombFricton")
    assert "error[effect-fit]" in refusal(daest, "rub.csv", "--effect", "Radiation")
    err = refusal(daest, "rub.csv", "--effect", "HardeningSpring", "--at", "cart.flange_a")
    assert "error[effect-fit]" in err and "It fits at: `spring`" in err
    err = refusal(daest, "rub.csv", "--at", "cart.flange_c")
    assert "error[effect-place]" in err and "cart.flange_a" in err
    assert not (cart / "results").exists()


def test_refused_data(cart, daest):
    err = refusal(daest, "rub.csv", "--to", "1")
    assert "error[diagnose-too-short]" in err and "100 samples" in err and "both directions" in err
    constant = recording(1000, 6)
    constant[:, 1] = 1.0
    write_recording(cart / "constant.csv", constant)
    err = refusal(daest, "constant.csv")
    assert "error[identify-constant-input]" in err and "varying input" in err
    assert not (cart / "results" / "diagnosis.json").exists()


def test_long_recordings_are_told_how_to_come_to_an_answer_sooner(cart, daest, monkeypatch):
    hint = "--resample 0.08 or a part (--to) first"
    assert hint not in refusal(daest, "rub.csv", "--to", "1")
    monkeypatch.setattr("daest.cli.diagnose.MANY_SAMPLES", 20)
    assert hint in refusal(daest, "rub.csv", "--to", "1")
    uneven = np.loadtxt(cart / "rub.csv", delimiter=",", skiprows=1)
    uneven[1::3, 0] += 0.004
    write_recording(cart / "uneven.csv", uneven)
    assert hint in refusal(daest, "uneven.csv", "--to", "1"), "an uneven clock has a median step"


def test_refused_cluster(cart, daest, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("daest.numerics.parallel.CONNECT_SECONDS", 0.5)
    err = refusal(daest, "rub.csv", "--cluster", "tcp://127.0.0.1:9")
    assert err.startswith("error[cluster-unreachable]") and "fitting" not in err


def test_refused_models(cart, daest):
    code, out, err = daest("diagnose", "rub.csv")
    assert code == 2 and not out and "error[model-not-given]" in err
    assert "error[model-missing]" in refusal(daest, "rub.csv", model="Card.mo")


@pytest.mark.slow
def test_place_that_no_output_sees(cart, daest):
    """A second cart that nothing ties to the first one, and whose motion is not measured."""
    second = """\
  Daest.Mechanics.Translational.Sources.Force motor2 "Motor";
  Daest.Mechanics.Translational.Components.Mass cart2(m = 2) "Cart";
  Daest.Mechanics.Translational.Components.SpringDamper spring2(c = 5, d = 1) "Spring";
equation
  connect(F, motor2.f);
  connect(motor2.flange, cart2.flange_a);
  connect(wall.flange, spring2.flange_a);
  connect(spring2.flange_b, cart2.flange_b);
"""
    (cart / "Cart.mo").write_text(CART.replace("equation\n", second))
    err = refusal(daest, "rub.csv", *COULOMB, "--at", "cart2.flange_a")
    assert "error[diagnose-unseen]" in err and "cart2.flange_a" in err and "nearer to the place" in err
    assert not (cart / "results" / "diagnosis.json").exists()
