"""Completion by the shell: scripts that the shells accept, and what they ask for."""

import os
import shutil
import subprocess
import sys

import pytest

from daest.cli.main import COMMANDS
from daest.diagnosis.residual_tests import LEVEL
from daest.model.defaults import LEAST_NULL_RECORDS


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_script(daest, shell):
    code, out, _ = daest("completion", shell)
    assert code == 0 and "_DAEST_COMPLETE" in out and "daest" in out
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not here")
    checked = subprocess.run([program, "-n"], input=out, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr


def completed(*words):
    """What bash is offered for the last word."""
    environment = {
        **os.environ,
        "_DAEST_COMPLETE": "bash_complete",
        "COMP_WORDS": "daest " + " ".join(words),
        "COMP_CWORD": str(len(words)),
    }
    program = [sys.executable, "-m", "daest"]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    return [line.partition(",")[2] for line in done.stdout.splitlines()]


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("ident",), "identify"),
        (("check", "--for"), "--format"),
        (("check", "--format", "j"), "json"),
        (("explain", "data-no-t"), "data-no-time"),
        (("demo", "quarter"), "quarter_car"),
        (("schema", "noi"), "noise"),
    ],
)
def test_words(words, offered):
    assert completed(*words) == [offered]


@pytest.mark.parametrize("name", list(COMMANDS))
def test_nothing_numerical_is_loaded_for_a_completion(name):
    """The options of a command are known before numpy is: a Tab takes no longer than the interpreter."""
    program = (
        f"import sys, importlib; importlib.import_module('daest.cli.{name}');"
        "print(sorted({'numpy', 'scipy', 'casadi', 'matplotlib', 'rich', 'fmpy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_least_records_fit_the_level_of_the_tests():
    assert int(1 / LEVEL) - 1 == LEAST_NULL_RECORDS
