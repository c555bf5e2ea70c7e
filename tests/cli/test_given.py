"""Files in any order, and what a command line says of parameters."""

import json
import math
from pathlib import Path

import pytest

from daest.cli.diagnose import Search, opened
from daest.cli.given import Files, ParameterOptions, kind_of
from daest.cli.options import DataOptions, listed_names
from daest.data.project import load_project
from daest.errors import ConfigError, EstimationError, ModelError
from daest.model.parts import Prior
from daest.modelica.compile import compile_model


def test_kinds_of_files_by_their_endings():
    assert kind_of(Path("A.MO"), "data") == "model" and kind_of(Path("a.CSV"), "model") == "data"
    assert kind_of(Path("folder"), "model") == "model"


def test_one_of_each_is_one():
    assert Files((Path("A.mo"), Path("A.mo"))).model == Path("A.mo")
    assert Files().recording is None
    with pytest.raises(ConfigError, match=r"one recording, and a\.csv, b\.csv are given"):
        _ = Files((), (Path("a.csv"), Path("b.csv"))).recording


@pytest.mark.parametrize(
    "words",
    [
        ("Lag.mo", "run1.csv"),
        ("run1.csv", "Lag.mo"),
        ("run1.csv", "--model", "Lag.mo"),
        ("--data", "run1.csv", "--model", "Lag.mo"),
    ],
    ids=" ".join,
)
def test_files_stand_in_any_order(folder, daest, words):
    code, out, _ = daest("check", *words)
    assert code == 0 and "input" in out and "output" in out


def test_a_second_model_is_refused(folder, daest):
    (folder / "Other.mo").write_text((folder / "Lag.mo").read_text())
    code, _, err = daest("identify", "Lag.mo", "Other.mo", "run1.csv")
    assert code == 2 and "error[files-too-many]" in err and "Other.mo" in err


def test_check_looks_at_a_part(folder, daest):
    whole = json.loads(daest("check", "run1.csv", "--format", "json")[1])["recordings"][0]
    _, out, _ = daest("check", "run1.csv", "--from", "1", "--to", "2", "--format", "json")
    part = json.loads(out)["recordings"][0]
    assert whole["start"] < 1 <= part["start"] and part["stop"] <= 2 < whole["stop"]
    assert part["n_samples"] < whole["n_samples"]
    assert DataOptions(start=1.0).has_window


def test_a_parameter_is_held_or_estimated(folder, daest):
    code, _, err = daest("diagnose", "Lag.mo", "run1.csv", "--fix", "k=2", "--estimate", "k")
    assert code == 2 and "error[option-contradiction]" in err and "--fix and by --estimate" in err
    code, _, err = daest("compare", "Lag.mo", "run1.csv", "--estimate", "k")
    assert code == 2 and "error[option-contradiction]" in err and "--refit" in err


def test_set_gives_the_start_of_the_search(folder, daest):
    _, out, _ = daest("identify", "Lag.mo", "run1.csv", "--set", "T=0.7", "--format", "json")
    assert json.loads(out)["parameters"]["T"]["initial"] == 0.7


def test_what_estimate_alone_leaves_out_is_told_before_a_diagnosis(folder, capsys):
    """The advice to estimate a given value, followed by --estimate alone, had held the rates of a fermenter,
    for which a bent growth stood."""
    for choice, is_told in (
        (ParameterOptions({}, {}, ("k",)), True),
        (ParameterOptions({}, {}), False),
        (ParameterOptions({}, {"T": 0.45}, ("k",)), False),
    ):
        opened(
            load_project(None), Path("Lag.mo"), [Path("run1.csv")], DataOptions(), Search(), parameters=choice
        )
        assert ("--estimate holds T, estimated without it" in capsys.readouterr().err) == is_told


def test_diagnosis_takes_the_choice(folder):
    choice = ParameterOptions({"k": 1.5}, {"T": 0.45}, ("k",), {"k": Prior(2.0, 0.1)})
    data = [Path("run1.csv")]
    case = opened(load_project(None), Path("Lag.mo"), data, DataOptions(), Search(), parameters=choice)
    known = {p.name: p for p in case.flat.parameters}
    assert (known["T"].value, known["T"].estimate, known["T"].prior) == (0.45, False, None)
    assert (known["k"].value, known["k"].estimate, known["k"].prior) == (1.5, True, Prior(2.0, 0.1))


def test_a_prior_without_an_estimate_is_refused(folder):
    flat = compile_model(Path("Lag.mo"))
    with pytest.raises(EstimationError, match="k has a prior but is not estimated"):
        ParameterOptions({}, {"k": 2.0}, (), {"k": Prior(2.0, 0.1)}).applied(flat)
    with pytest.raises(ModelError, match="no tunable parameter `kk`"):
        ParameterOptions({}, {}, ("kk",)).applied(flat)


def test_later_commands_take_their_files_alike(folder, daest):
    code, out, err = daest("fleet", "run1.csv", "Lag.mo", "--fix", "k=2", "--no-diagnose", "--format", "json")
    machines = json.loads(out)["machines"]
    assert code == 0 and [machine["name"] for machine in machines] == ["run1"], err
    assert set(machines[0]["parameters"]) == {"T"}
    words = ("run1.csv", "Lag.mo", "--set", "k=2", "--parameters", "T", "--seconds", "0.2", "-o", "next.csv")
    code, _, err = daest("design", *words)
    assert code == 0 and (folder / "next.csv").is_file(), err
    code, out, err = daest("watch", "run1.csv", "Lag.mo", "--idle", "0", "--set", "T=0.5", "--set", "k=2")
    assert code == 0 and json.loads(out.splitlines()[-1])["event"] == "ended", err
    assert (
        daest("effects", "Lag.mo", "ConstantLoad")[1:]
        == daest("effects", "ConstantLoad", "--model", "Lag.mo")[1:]
    )
    code, _, err = daest("effects", "ConstantLoad", "Offset")
    assert code == 2 and "one effect, and ConstantLoad, Offset are given" in err
    code, _, err = daest("fleet", "Lag.mo")
    assert code == 2 and "error[data-not-given]" in err


def test_names_with_commas_are_several():
    assert listed_names(("k, T", "gear.ratio", "a[1,2],b")) == ("k", "T", "gear.ratio", "a[1,2]", "b")


HOURS = """
model Store
  parameter Real C(unit = "kW.h/K") = 2;
  parameter Real G(unit = "kW/K") = 1;
  input Real P(unit = "kW");
  output Real T(unit = "K");
equation
  C*der(T) = P - G*T;
end Store;
"""


@pytest.mark.parametrize(
    ("time", "step"), [("time", 0.1), ("time [h]", 0.1), ("time [min]", 6), ("time_s", 360)]
)
def test_a_time_of_any_unit_is_read_in_that_of_a_model_that_counts_hours(
    tmp_path, monkeypatch, daest, time, step
):
    monkeypatch.chdir(tmp_path)
    Path("Store.mo").write_text(HOURS)
    levels, T = [], 0.0
    for k in range(60):
        P = float(k % 7 > 3)
        levels.append(f"{k * step:.6g},{P},{T:.9g}")
        T = P + (T - P) * math.exp(-0.1 / 3.0)
    Path("run.csv").write_text("\n".join((f"{time},P [kW],T [K]", *levels)) + "\n")
    code, out, err = daest("identify", "--estimate", "C", "--hold", "zoh", "Store.mo", "run.csv")
    assert code == 0, err
    value = next(line.split()[1] for line in out.splitlines() if line.startswith("C "))
    assert float(value) == pytest.approx(3.0, rel=1e-3) and "60 samples at 0.1 h," in out
    assert ("is read in h, in which" in err) == (time != "time"), err
    code, out, err = daest("simulate", "Store.mo", "run.csv", "-o", "out.csv")
    assert code == 0 and Path("out.csv").read_text().startswith("time [h],"), err
