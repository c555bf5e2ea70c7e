"""Errors: their form, and the catalogue behind `daest explain`."""

import ast
import pickle
import re
from pathlib import Path

import pytest

import daest
from daest.errors import EXPLANATIONS, DataError, Place

PACKAGE = Path(daest.__file__).parent
CLASSES = {
    "DaestError",
    "ModelError",
    "FmuError",
    "DataError",
    "ConfigError",
    "EstimationError",
    "NumericalError",
}
SLUG = re.compile(r"[a-z0-9]+(-[a-z0-9]+)+")


def texts_of_source():
    """(file, line, text) of every string constant of the package outside errors.py that has the form of a
    code."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.name == "errors.py" and path.parent == PACKAGE:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and SLUG.fullmatch(node.value):
                yield path, node.lineno, node.value


def codes_of_calls():
    """(file, line, code) of every call of an error class whose code is written out."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CLASSES:
                given = [*node.args[:1], *(k.value for k in node.keywords if k.arg == "code")]
                for argument in given[:1]:
                    for part in ast.walk(argument):
                        if isinstance(part, ast.Constant) and isinstance(part.value, str):
                            yield f"{path.relative_to(PACKAGE)}:{node.lineno}", part.value


def test_every_code_that_is_raised_is_explained():
    unexplained = [f"{place}: {code}" for place, code in codes_of_calls() if code not in EXPLANATIONS]
    assert not unexplained


def test_every_explained_code_is_used():
    used = {text for _, _, text in texts_of_source()}
    assert sorted(set(EXPLANATIONS) - used) == []


def test_catalogue_is_sorted_and_says_something():
    assert list(EXPLANATIONS) == sorted(EXPLANATIONS)
    for code, text in EXPLANATIONS.items():
        assert SLUG.fullmatch(code), code
        assert len(text) > 40 and text.endswith("."), code


def test_message_names_place_and_remedy():
    error = DataError("data-text", "a text", where=Place("run.csv", 3, 2), remedy="write a number")
    assert str(error) == "error[data-text]: a text\n  --> run.csv:3:2\n  help: write a number"
    assert str(DataError("data-text", "a text")) == "error[data-text]: a text"


@pytest.mark.parametrize("where", [None, "run", Place("run.csv", 3)])
def test_errors_travel_between_processes(where):
    error = DataError("data-text", "a text", where=where, remedy="write a number")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is DataError and str(copy) == str(error)
