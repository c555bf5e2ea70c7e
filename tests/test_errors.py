"""Errors: their form, and the catalogue behind `daest explain`."""

import ast
import pickle
import re
from functools import cache
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


def walked(tree):
    """All nodes of a tree: what `ast.walk` gives, in a third of its time."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for part in vars(node).values():
            if isinstance(part, list):
                waiting += [entry for entry in part if isinstance(entry, ast.AST)]
            elif isinstance(part, ast.AST):
                waiting.append(part)


@cache
def nodes():
    """(file, node) of every string constant and call of the package outside errors.py, read once."""
    paths = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "errors.py")
    return [
        (path, node)
        for path in paths
        for node in walked(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
    ]


def texts_of_source():
    """(file, line, text) of every string constant of the package outside errors.py that has the form of a
    code."""
    for path, node in nodes():
        if isinstance(node, ast.Constant) and SLUG.fullmatch(node.value):
            yield path, node.lineno, node.value


def codes_of_calls():
    """(place, pattern) of every code that is written out, or put together, in a call of an error class."""
    for path, node in nodes():
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CLASSES:
            given = [*node.args[:1], *(k.value for k in node.keywords if k.arg == "code")]
            for pattern in patterns_of(given[0]) if given else ():
                yield f"{path.relative_to(PACKAGE)}:{node.lineno}", pattern


def patterns_of(argument):
    """Regular expressions of the codes that an expression may be; none for a variable."""
    if isinstance(argument, ast.Constant):
        return [re.escape(str(argument.value))]
    if isinstance(argument, ast.IfExp):
        return [*patterns_of(argument.body), *patterns_of(argument.orelse)]
    if isinstance(argument, ast.JoinedStr):
        parts = (re.escape(p.value) if isinstance(p, ast.Constant) else "[a-z0-9-]+" for p in argument.values)
        return ["".join(parts)]
    return []


def test_every_code_that_is_raised_is_explained():
    written = {re.escape(code) for code in EXPLANATIONS}  # most codes are no pattern
    unexplained = [
        f"{place}: {pattern}"
        for place, pattern in codes_of_calls()
        if pattern not in written and not any(re.fullmatch(pattern, code) for code in EXPLANATIONS)
    ]
    assert not unexplained


def test_every_explained_code_is_used():
    written = {text for _, _, text in texts_of_source()}
    put_together = {pattern for _, pattern in codes_of_calls() if "[a-z0-9-]+" in pattern}
    unused = [
        code
        for code in EXPLANATIONS
        if code not in written and not any(re.fullmatch(pattern, code) for pattern in put_together)
    ]
    assert not unused


def test_catalogue_is_sorted_and_says_something():
    assert list(EXPLANATIONS) == sorted(EXPLANATIONS)
    for code, text in EXPLANATIONS.items():
        assert SLUG.fullmatch(code), code
        assert len(text) > 30 and text.endswith("."), code


def test_message_names_place_and_remedy():
    error = DataError("data-text", "a text", where=Place("run.csv", 3, 2), remedy="write a number")
    assert str(error) == "error[data-text]: a text\n  --> run.csv:3:2\n  help: write a number"
    assert str(DataError("data-text", "a text")) == "error[data-text]: a text"


@pytest.mark.parametrize("where", [None, "run", Place("run.csv", 3)])
def test_errors_travel_between_processes(where):
    error = DataError("data-text", "a text", where=where, remedy="write a number")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is DataError and str(copy) == str(error)
