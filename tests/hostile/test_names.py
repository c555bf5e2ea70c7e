"""Paths that name no file, and files that nest without end: one message each, with exit code 2."""

import json
import os
from pathlib import Path

import pytest

from daest.cli.main import run
from daest.files import why_no_file

LAG = """\
model Lag
  parameter Real k = 2;
  input Real u(start = 0);
  output Real y = x;
  Real x(start = 0, fixed = true);
equation
  der(x) = k*u - x;
end Lag;
"""
LONG = "n" * 300
PROJECT = '[model]\nsource = "Lag.mo"\n[data]\nestimate = ["run.csv"]\n'


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("Lag.mo").write_text(LAG)
    Path("run.csv").write_text("time,u,y\n" + "".join(f"{0.1 * i:.1f},{i % 7},{i % 5}\n" for i in range(60)))
    os.mkfifo("pipe.csv")
    os.mkfifo("pipe.mo")
    os.mkfifo("pipe.fmu")
    os.mkfifo("pipe.json")
    os.mkdir("dir.csv")
    for ending in ("csv", "mo", "fmu", "toml", "json"):
        Path(f"circle.{ending}").symlink_to(f"circle.{ending}")
        Path(f"nowhere.{ending}").symlink_to("nothing")
    return tmp_path


def message(capsys, *arguments: str) -> str:
    capsys.readouterr()
    assert run(arguments) == 2
    err = capsys.readouterr().err
    assert "internal-error" not in err and "Traceback" not in err and err.count("error[") == 1
    return err


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("pipe", "is a pipe, not a file"),
        ("dir", "is a folder, not a file"),
        ("circle", "is a link that leads in a circle"),
        ("nowhere", "is a link to nothing, which does not exist"),
        (LONG, "cannot be reached: File name too long"),
        ("pips", "does not exist"),
    ],
)
@pytest.mark.parametrize("kind", ["csv", "mo", "fmu"])
def test_what_a_path_is(folder, capsys, name, why, kind):
    if name == "dir" and kind != "csv":
        os.mkdir(f"dir.{kind}")
    path = f"{name}.{kind}"
    arguments = ("check", path) if kind == "csv" else ("linearize", path)
    err = message(capsys, *arguments)
    assert why in err and f"did you mean {path}" not in err
    if name == "pips":
        assert "did you mean pipe" in err


@pytest.mark.parametrize("name", ["circle.toml", f"{LONG}.toml", LONG, "nowhere.toml"])
def test_projects(folder, capsys, name):
    assert "error[config-missing]" in message(capsys, "identify", "-p", name)


def test_a_project_that_cannot_be_reached_is_not_ignored(folder, capsys):
    Path("daest.toml").symlink_to("daest.toml")
    assert "leads in a circle" in message(capsys, "identify", "run.csv", "--model", "Lag.mo")


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 3000, "a = " + "[" * 3000 + "]" * 3000, "a" + ".a" * 5000 + "=1"]
)
def test_nested_project(folder, capsys, text):
    Path("daest.toml").write_text(text)
    assert "error[config-" in message(capsys, "identify")


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000 + "1" + "}" * 100_000, "{", "null"])
def test_nested_fit(folder, capsys, text):
    Path("daest.toml").write_text(PROJECT)
    Path("results").mkdir()
    Path("results/fit.json").write_text(text)
    assert "error[results-unreadable]" in message(capsys, "report")
    assert "error[results-unreadable]" in message(capsys, "linearize", "--at", "results/fit.json")


@pytest.mark.parametrize("name", ["pipe.json", "circle.json", f"{LONG}.json", "dir.csv"])
def test_operating_points(folder, capsys, name):
    assert "error[results-unreadable]" in message(capsys, "linearize", "Lag.mo", "--at", name)


@pytest.mark.parametrize(
    "name", ["circle.json", f"{LONG}.json", f"{LONG}/x.json", "dir.csv", "run.csv/x.json"]
)
def test_outputs(folder, capsys, name):
    assert "error[output-unwritable]" in message(capsys, "linearize", "Lag.mo", "-o", name)


def test_why_no_file(folder):
    assert why_no_file(Path("run.csv")) is None
    assert why_no_file(Path("/dev/null")) == "is a device, not a file"
    assert why_no_file(Path("a\0b")) == "does not exist"
    assert why_no_file(Path("run.csv/x")) == "cannot be reached: Not a directory"


def test_one_absurd_value_among_300(folder, capsys):
    rows = [f"{0.1 * i:.1f},{i % 7},{(i * i) % 11}" for i in range(300)]
    for column in (1, 2):
        for value in ("1e300", "-1e300", "1e9"):
            cells = rows[140].split(",")
            cells[column] = value
            Path("odd.csv").write_text("time,u,y\n" + "\n".join([*rows[:140], ",".join(cells), *rows[141:]]))
            assert run(["check", "odd.csv", "--format", "json"]) == 1  # warnings
            out, err = capsys.readouterr()
            found = json.loads(out)
            codes = [f["code"] for f in _findings(found) if f.get("column") == "uy"[column - 1]]
            assert "check-outliers" in codes and err == "", (value, codes, err)


def test_a_time_beyond_all_numbers(folder, capsys):
    rows = [f"{1e-308 * i},1,{i % 3}" for i in range(60)] + ["1e308,2,2"]
    Path("odd.csv").write_text("time,u [V],y [m]\n" + "\n".join(rows))
    assert run(["check", "odd.csv"]) in (0, 1)
    assert capsys.readouterr().err == ""


def _findings(document):
    if isinstance(document, dict):
        if "code" in document:
            yield document
        for entry in document.values():
            yield from _findings(entry)
    elif isinstance(document, list):
        for entry in document:
            yield from _findings(entry)
