"""Completion by the shell: scripts that the shells accept, and what they ask for."""

import os
import shutil
import subprocess
import sys

import pytest


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
