"""The examples in the documentation of the public functions say what they give."""

import doctest
import inspect
import shutil
from pathlib import Path

import numpy as np
import pytest

import daest

SERVO = Path(__file__).parents[1] / "examples" / "servo"
SLOW = ("diagnose", "improve")
FUNCTIONS = [name for name in daest.__all__ if not inspect.isclass(getattr(daest, name))]


def run_examples(names, folder):
    """The examples of functions, one after the other: what one names, the next may use."""
    for file in ("Servo.mo", "servo.csv"):
        shutil.copy(SERVO / file, folder)
    known, runner = {"daest": daest, "np": np}, doctest.DocTestRunner(verbose=False)
    for name in names:
        text = inspect.getdoc(getattr(daest, name))
        example = doctest.DocTestParser().get_doctest(text, known, f"daest.{name}", None, 0)
        assert example.examples, f"{name} has no example"
        runner.run(example, clear_globs=False)
        known = example.globs
    assert runner.failures == 0


def test_examples_of_public_functions(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_examples([name for name in FUNCTIONS if name not in SLOW], tmp_path)


@pytest.mark.slow
def test_examples_of_diagnoses(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_examples(SLOW, tmp_path)
