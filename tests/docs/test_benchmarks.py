"""Benchmarks import and name what there is, so that a change of the house does not leave them behind."""

import ast
import importlib
import sys

import pytest
from test_rates import ROOT

SCRIPTS = sorted((ROOT / "benchmarks").rglob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_what_a_benchmark_imports_of_daest_is_there(script):
    tree = ast.parse(script.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "daest":
            module = importlib.import_module(node.module)
            missing = [a.name for a in node.names if not _is_there(module, a.name)]
            assert not missing, f"{script.name}: {node.module} has no {', '.join(missing)}"


def _is_there(module, name):
    return hasattr(module, name) or importlib.util.find_spec(f"{module.__name__}.{name}") is not None


@pytest.fixture
def speed(monkeypatch):
    """The modules of the speed table, without leaving theirs behind."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if (
            getattr(sys.modules[name], "__file__", None)
            and str(ROOT / "benchmarks") in sys.modules[name].__file__
        ):
            del sys.modules[name]


def test_stages_of_a_diagnosis_are_functions_that_it_calls(speed):
    for place, function in speed("diagnosis_speed").STAGES:
        assert callable(getattr(importlib.import_module(f"daest.diagnosis.{place}"), function))


def test_exponent_of_a_power_is_that_of_the_larger_sizes(speed):
    growth = speed("growth_speed").Growth
    sizes = (1.0, 2.0, 10.0, 100.0, 1000.0)
    seconds = (5.0, 5.0, 10.0**1.5, 100.0**1.5, 1000.0**1.5)
    assert growth("a step", "things", sizes, seconds).exponent == pytest.approx(1.5)


def test_table_and_picture_of_speed(speed, tmp_path):
    rows = [speed("timed").Row("a step", "ms", 0.5, "a peer", 2.0), speed("timed").Row("alone", "s", 1.5)]
    growth = [speed("growth_speed").Growth("a step", "things", (1.0, 10.0, 100.0), (0.1, 1.0, 10.0))]
    page = speed("speed").markdown(rows, growth)
    assert "| a step | 0.5 ms | a peer | 2 | 4 |" in page and "| alone | 1.5 s |  |  |  |" in page
    assert "| a step | things | 1 | 100 | 10 s | 1.00 |" in page
    speed("growth_speed").drawn(growth, tmp_path / "growth.svg")
    assert (tmp_path / "growth.svg").read_text(encoding="utf-8").count("a step") >= 1
