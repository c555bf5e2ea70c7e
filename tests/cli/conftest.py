"""A small project in the current folder, and a way to call commands."""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from lag_data import write_lag

from daest.cli.main import run
from daest.cli.output import Result
from daest.cli.schema import schema_of


@cache
def validator(command: str) -> Draft202012Validator:
    return Draft202012Validator(closed(schema_of(command)))


def closed(schema: Any) -> Any:
    """The schema that accepts no other keys than those it names."""
    if isinstance(schema, list):
        return [closed(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    inner = {key: closed(value) for key, value in schema.items()}
    return {**inner, "additionalProperties": False} if isinstance(schema.get("required"), list) else inner


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The current folder, with Lag.mo, run1.csv and run2.csv."""
    monkeypatch.chdir(tmp_path)
    write_lag(tmp_path)
    return tmp_path


WIDTHS = (60, 80, 140)
WIDEST = 400  # where nothing has to be divided
LONGEST_WORD = 32  # of a longer one, parts may stand on lines of their own


@dataclass(frozen=True)
class WatchedResult(Result):
    """A result whose text is looked at in terminals of all widths, however it was asked for: no line is too
    long, and no word and no number is cut or left out."""

    def __post_init__(self):
        if self.command == "completion":
            return  # a script for a shell
        words = {word for word in self.text(WIDEST, False).split() if len(word) <= LONGEST_WORD}
        for width in WIDTHS:
            text = self.text(width, False)
            too_long = [line for line in text.splitlines() if len(line) > width]
            assert not [line for line in too_long if len(longest(line)) + 24 < width], (width, too_long)
            lost = words - set(text.split())
            assert not lost, (self.command, width, lost)


def longest(line):
    return max(line.split(), key=len)


@pytest.fixture
def daest(capsys, monkeypatch):
    """Run a command line; returns exit code, stdout and stderr. Every JSON document is held against the
    schema of its command, which knows every key, and every text is looked at in three widths."""
    monkeypatch.setattr("daest.cli.output.Result", WatchedResult)

    def call(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        if captured.out.startswith('{\n  "schema": "daest/'):
            document = json.loads(captured.out)
            assert document["schema"] == f"daest/{arguments[0]}/1"
            validator(str(arguments[0])).validate(document)
        return code, captured.out, captured.err

    return call
