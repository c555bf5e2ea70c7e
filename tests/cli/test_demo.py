"""`daest demo`: examples are listed, copied and run."""

import json
from pathlib import Path

import pytest

from daest.data.examples import demo_folder, examples


def test_list(daest):
    code, out, _ = daest("demo")
    assert code == 0
    names = [example.name for example in examples()]
    assert "servo" in names
    for name in names:
        assert name in out


def test_run(tmp_path, monkeypatch, daest):
    monkeypatch.chdir(tmp_path)
    code, out, err = daest("demo", "servo", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/demo/1" and "daest identify" in err
    truth = json.loads((tmp_path / "servo" / "truth.json").read_text())["parameters"]
    for name, found in document["identify"]["parameters"].items():
        assert abs(found["value"] - truth[name]) < 4 * found["std_error"]
    assert min(document["compare"]["models"][0]["fit_percent"].values()) > 98
    assert (tmp_path / "servo" / "results" / "fit.json").is_file()
    assert (tmp_path / "servo" / "results" / "comparison.json").is_file()


@pytest.mark.slow
def test_report_of_a_demo(tmp_path, monkeypatch, daest):
    monkeypatch.chdir(tmp_path)
    assert daest("demo", "servo")[0] == 0
    monkeypatch.chdir(tmp_path / "servo")
    code, out, _ = daest("report", "--format", "json")
    assert code == 0 and "daest diagnose" in out and "daest compare" not in out


WITHOUT = [example.name for example in examples() if not example.has_recording]


@pytest.mark.parametrize(
    "name", [WITHOUT[0], *(pytest.param(n, marks=pytest.mark.slow) for n in WITHOUT[1:])]
)
def test_example_without_recording_shows_its_noise(tmp_path, monkeypatch, daest, name):
    monkeypatch.chdir(tmp_path)
    code, out, err = daest("demo", name, "--format", "json")
    document = json.loads(out)
    assert code == 0 and "no recording" in err and document["identify"] is None
    assert document["noise"]["all_admissible"] and document["noise"]["equations"]
    assert (tmp_path / name / "daest.toml").is_file() and not (tmp_path / name / "results").exists()
    assert f"{document['noise']['n_equations']} equations" in daest("noise", "-p", f"{name}/daest.toml")[1]


def test_a_copy_is_made_beside_a_checkout(tmp_path):
    checkout = tmp_path / "daest"
    (checkout / "toolchain" / "daest").mkdir(parents=True)
    (checkout / "docs").mkdir()
    (checkout / "pyproject.toml").write_text("")
    assert demo_folder("servo", checkout / "docs") == Path("../../servo")
    assert demo_folder("servo", checkout) == Path("../servo")
    assert demo_folder("servo", tmp_path) == Path("servo")


def test_examples_tell_what_differs():
    told = [example.description for example in examples()]
    assert all(told) and len(set(told)) == len(told)


@pytest.mark.slow
@pytest.mark.parametrize("name", [e.name for e in examples() if e.has_recording and e.name != "servo"])
def test_every_example_runs(tmp_path, monkeypatch, daest, name):
    monkeypatch.chdir(tmp_path)
    code, out, err = daest("demo", name, "--format", "json")
    assert code == 0, err
    assert json.loads(out)["compare"]["models"]


@pytest.mark.parametrize(
    ("name", "code", "mentions"),
    [
        ("sarvo", "example-unknown", "did you mean servo"),
        ("servo", "example-folder-exists", "not overwritten"),
    ],
)
def test_refusals(tmp_path, monkeypatch, daest, name, code, mentions):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "servo").mkdir()
    status, _, err = daest("demo", name)
    assert status == 2 and code in err and mentions in err
    assert list((tmp_path / "servo").iterdir()) == []


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch, daest):
    def refuse(source, target, **_):
        target.mkdir()
        raise PermissionError(13, "Permission denied")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("shutil.copytree", refuse)
    code, _, err = daest("demo", "tank")
    assert code == 2 and "output-unwritable" in err and "Permission denied" in err and "--> tank" in err
    assert not (tmp_path / "tank").exists()
