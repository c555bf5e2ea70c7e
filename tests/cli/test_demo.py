"""`daest demo`: examples are listed, copied and run."""

import json

import pytest

from daest.data.examples import examples


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


def test_example_without_recording_is_copied_alone(tmp_path, monkeypatch, daest):
    monkeypatch.chdir(tmp_path)
    silent = next(example.name for example in examples() if not example.has_recording)
    code, _, err = daest("demo", silent)
    assert code == 0 and "no recording" in err
    assert (tmp_path / silent / "daest.toml").is_file() and not (tmp_path / silent / "results").exists()


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
