"""`daest effects` and `daest extend`."""

from __future__ import annotations

import json

import pytest
from effect_rig import RIG

from daest.cli.main import run
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library


@pytest.fixture
def daest(capsys, tmp_path, monkeypatch):
    """Run a command line in an empty folder; returns exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


def test_list_of_effects(daest) -> None:
    code, out, err = daest("effects")
    assert code == 0 and not err
    assert all(effect.name in out for effect in effect_library())
    code, out, _ = daest("effects", "--format", "json")
    document = json.loads(out)
    assert document["schema"] == "daest/effects/1" and len(document["effects"]) == len(effect_library())
    first = document["effects"][0]
    assert {"name", "class", "domain", "law", "parameters", "sits", "places"} <= set(first)
    assert first["places"] is None


def test_one_effect_and_its_places(daest) -> None:
    code, out, _ = daest("effects", "Rotational.CoulombFriction", "--model", RIG)
    assert code == 0
    for text in ("tau = -tau_c*tanh(w/w_s)", "N.m", "rotor.flange_a", "sharpness", "Bearings"):
        assert text in out
    code, out, _ = daest("effects", "MeasuredVentilation", "--model", RIG, "--format", "json")
    (effect,) = json.loads(out)["effects"]
    assert effect["inputs"] == ["u"] and effect["places"]
    assert {p["kind"] for p in effect["places"]} <= {"component", "pair"}


def test_unknown_effect(daest) -> None:
    code, out, err = daest("effects", "Couloumb")
    assert code == 2 and not out and "effect-unknown" in err and "CoulombFriction" in err
    assert "error[model-missing]" in daest("effects", "Rig.mo")[2]


def test_extend_writes_a_model_that_compiles(daest, tmp_path) -> None:
    at = ("--effect", "CoulombFriction", "--at", "rotor")
    code, out, _ = daest("extend", RIG, *at, "--set", "tau_c=0.02", "--set", "J=0.6", "-o", "new.mo")
    assert code == 0 and "Rig_CoulombFriction" in out and "coulombFriction.tau_c" in out
    flat = compile_model(tmp_path / "new.mo")
    values = {p.name: p.value for p in flat.parameters}
    assert (values["coulombFriction.tau_c"], values["J"]) == (0.02, 0.6)
    code, out, _ = daest("extend", RIG, *at)
    assert code == 0 and out.endswith("end Rig_CoulombFriction;\n")
    code, out, _ = daest("extend", RIG, *at, "--format", "json", "--name", "rub", "--new-class", "Rubbing")
    document = json.loads(out)
    assert document["schema"] == "daest/extend/1"
    assert (document["class"], document["component"], document["path"]) == ("Rubbing", "rub", None)
    assert "model Rubbing" in document["model"]


def test_measured_signal(daest) -> None:
    arguments = ("extend", RIG, "--effect", "MeasuredHeatGain", "--at", "room")
    code, out, _ = daest(*arguments, "--input", "u=G_solar")
    assert code == 0 and "connect(G_solar, measuredHeatGain.u);" in out
    code, _, err = daest(*arguments, "--input", "z=G_solar")
    assert code == 2 and "option-assignment" in err


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("--effect", "Coulomb", "--at", "rotor"), "effect-unknown"),
        (("--effect", "CoulombFriction", "--at", "rotr"), "effect-place"),
        (("--effect", "CoulombFriction", "--at", "room"), "effect-fit"),
        (("--effect", "Unbalance", "--at", "load", "--set", "mg=1"), "effect-parameter"),
        (("--effect", "Unbalance", "--at", "load", "--name", "shaft"), "effect-name"),
        (("--effect", "Unbalance", "--at", "load", "--new-class", "Rig"), "effect-name"),
    ],
)
def test_refusals_write_nothing(daest, tmp_path, arguments, code) -> None:
    status, out, err = daest("extend", RIG, *arguments, "-o", "new.mo")
    assert status == 2 and not out and f"error[{code}]" in err
    assert not (tmp_path / "new.mo").exists()


def test_effect_that_the_model_contains(daest) -> None:
    at = ("--effect", "CoulombFriction", "--at", "rotor")
    daest("extend", RIG, *at, "-o", "new.mo")
    code, _, err = daest("extend", "new.mo", *at, "-o", "newer.mo")
    assert code == 2 and "effect-present" in err


def test_model_is_not_overwritten_and_fmus_are_refused(daest, tmp_path) -> None:
    (tmp_path / "Rig.mo").write_bytes(RIG.read_bytes())
    at = ("--effect", "CoulombFriction", "--at", "rotor")
    code, _, err = daest("extend", "Rig.mo", *at, "-o", "Rig.mo")
    assert code == 2 and "output-is-input" in err
    (tmp_path / "rig.fmu").write_bytes(b"PK")
    code, _, err = daest("extend", "rig.fmu", *at)
    assert code == 2 and "effect-no-source" in err
