"""A small project in the current folder, and a way to call commands."""

import json
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from lag_data import LAG, recording, write_csv

from daest.cli.main import run
from daest.cli.schema import schema_of


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The current folder, with Lag.mo, run1.csv and run2.csv."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Lag.mo").write_text(LAG)
    write_csv(tmp_path / "run1.csv", *recording(400, 1))
    write_csv(tmp_path / "run2.csv", *recording(300, 2))
    return tmp_path


@pytest.fixture
def daest(capsys):
    """Run a command line; returns exit code, stdout and stderr. Every JSON document is held against the
    schema of its command."""

    def call(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        if captured.out.startswith('{\n  "schema": "daest/'):
            document = json.loads(captured.out)
            assert document["schema"] == f"daest/{arguments[0]}/1"
            Draft202012Validator(schema_of(str(arguments[0]))).validate(document)
        return code, captured.out, captured.err

    return call
