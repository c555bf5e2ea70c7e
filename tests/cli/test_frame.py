"""The frame of the command line: exit codes, where texts go, files whole or not at all."""

import json
import os
import subprocess
import sys

import click
import numpy as np
import pytest

from daest.cli import main as frame
from daest.cli.main import COMMANDS, run
from daest.cli.options import assignments
from daest.cli.output import keep_inputs, to_json, whole_file, with_schema
from daest.errors import EXPLANATIONS, ConfigError


def test_help_loads_nothing_numerical():
    program = (
        "import sys\nfrom daest.cli.main import run\nassert run(['--help']) == 0\n"
        "heavy = {'numpy', 'scipy', 'casadi', 'pandas', 'matplotlib', 'pint', 'rich', 'fmpy', 'control'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
    for name, text in COMMANDS.items():
        assert name in done.stdout and text.split()[0] in done.stdout


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_explains_itself_with_an_example(name, capsys):
    assert run([name, "-h"]) == 0
    shown = capsys.readouterr().out
    assert "Example" in shown and f"daest {name}" in shown


def test_short_help_works_after_another_use_of_a_command():
    """click keeps the help option that it first made for a command, and here another context is first."""
    program = (
        "import click\nfrom daest.cli.main import cli, run\n"
        "context = click.Context(cli)\n"
        "cli.get_command(context, 'explain').make_context('explain', [], parent=context).get_help()\n"
        "raise SystemExit(run(['explain', '-h']))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0 and "-h, --help" in done.stdout, done.stderr


@pytest.mark.parametrize(
    ("arguments", "mentions"),
    [
        (["explan"], "Did you mean 'explain'?"),
        (["explain", "--wrong"], "--wrong"),
        (["--nothing"], "--nothing"),
    ],
)
def test_wrong_usage_is_2_and_speaks_on_stderr(arguments, mentions, capsys):
    assert run(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and mentions in captured.err


def test_explain(capsys):
    assert run(["explain", "data-text"]) == 0
    assert EXPLANATIONS["data-text"].split()[0] in capsys.readouterr().out
    assert run(["explain", "--format", "json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == {"schema": "daest/explain/1", "codes": dict(sorted(EXPLANATIONS.items()))}
    assert run(["explain", "data-texd", "--format", "json"]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and "did you mean data-text" in captured.err


def failing(error):
    @click.command()
    def command():
        raise error

    return command


def test_a_fault_of_daest_is_one_message(monkeypatch, capsys):
    monkeypatch.setattr(frame.LazyGroup, "get_command", lambda *_: failing(ZeroDivisionError("oh")))
    assert run(["explain"]) == 2
    message = capsys.readouterr().err
    assert "internal-error" in message and "ZeroDivisionError: oh" in message
    assert "Traceback" not in message and "DAEST_TRACEBACK=1" in message
    monkeypatch.setenv("DAEST_TRACEBACK", "1")
    run(["explain"])
    assert "Traceback" in capsys.readouterr().err


def test_interrupt(monkeypatch, capsys):
    monkeypatch.setattr(frame.LazyGroup, "get_command", lambda *_: failing(KeyboardInterrupt()))
    assert run(["explain"]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_reader_that_goes_away_is_no_error():
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "daest", "explain"], stdout=writing, stderr=subprocess.PIPE, text=True
    )
    os.close(writing)
    assert done.returncode == 0 and done.stderr == ""


def test_json_has_numbers_and_null():
    text = to_json(
        {
            "matrix": np.array([[1.0, np.nan], [np.inf, 2.0]]),
            "count": np.int64(3),
            "flag": np.bool_(True),
            "value": np.float32(0.5),
            "names": ("a", "b"),
            "none": None,
            "empty": {},
        }
    )
    assert json.loads(text) == {
        "matrix": [[1.0, None], [None, 2.0]],
        "count": 3,
        "flag": True,
        "value": 0.5,
        "names": ["a", "b"],
        "none": None,
        "empty": {},
    }
    assert "[1.0, null]" in text
    with pytest.raises(TypeError):
        to_json({"thing": object()})


def test_schema_stands_first():
    assert list(with_schema({"a": 1, "schema": "x"}, "noise").items()) == [
        ("schema", "daest/noise/1"),
        ("a", 1),
    ]


def test_files_are_written_whole_or_not_at_all(tmp_path):
    target = tmp_path / "out" / "result.csv"
    with whole_file(target) as temporary:
        temporary.write_text("new")
    assert target.read_text() == "new"
    with pytest.raises(ZeroDivisionError), whole_file(target) as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError
    assert target.read_text() == "new"
    assert [p.name for p in target.parent.iterdir()] == ["result.csv"]


def test_unwritable_output(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(ConfigError) as caught, whole_file(tmp_path / "file" / "result.csv"):
        pass
    assert caught.value.code == "output-unwritable"


def test_inputs_are_not_overwritten(tmp_path):
    data = tmp_path / "run.csv"
    data.write_text("x")
    with pytest.raises(ConfigError) as caught:
        keep_inputs(tmp_path / "." / "run.csv", [data])
    assert caught.value.code == "output-is-input"
    keep_inputs(tmp_path / "other.csv", [data])


def test_assignments():
    assert assignments(("a.b=1e-3", "c = 2"), "--set") == {"a.b": 1e-3, "c": 2.0}
    for text in ("a", "a=", "=3", "a=x", "a=nan"):
        with pytest.raises(ConfigError) as caught:
            assignments((text,), "--set")
        assert caught.value.code == "option-assignment" and "--set" in str(caught.value)
