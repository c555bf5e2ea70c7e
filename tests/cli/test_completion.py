"""Completion by the shell: scripts that the shells accept, and what they ask for."""

import os
import shutil
import subprocess
import sys

import pytest
from click.shell_completion import BashComplete

from daest.cli.main import COMMANDS, cli
from daest.diagnosis.gates import GATES
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


def asked(*words):
    """What bash tells the program in its environment about the words so far."""
    return {
        "_DAEST_COMPLETE": "bash_complete",
        "COMP_WORDS": "daest " + " ".join(words),
        "COMP_CWORD": str(len(words)),
    }


def test_the_program_answers_the_shell():
    environment = {**os.environ, **asked("ident")}
    program = [sys.executable, "-m", "daest"]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout == "plain,identify\n"


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
def test_words(words, offered, monkeypatch):
    for name, value in asked(*words).items():
        monkeypatch.setenv(name, value)
    completion = BashComplete(cli, {}, "daest", "_DAEST_COMPLETE")
    assert completion.complete() == f"plain,{offered}"


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("identify", "--fix", "spring."), ["spring.c="]),
        (("diagnose", "--estimate", ""), ["spring.c", "R"]),
        (("filter", "--measure", "o"), ["omega"]),
        (("watch", "--measure", "o"), ["omega"]),
        (("diagnose", "--effect", "Coulomb"), ["CoulombFriction"]),
        (("extend", "--at", "ro"), ["rotor.flange_a"]),
    ],
    ids=lambda words: " ".join(words),
)
def test_values(words, offered, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "daest.toml").write_text(
        '[data.outputs]\nomega = "w"\n[parameters]\n"spring.c" = { value = 1 }\nR = { value = 2 }\n'
    )
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "diagnosis.json").write_text('{"candidates": [{"at": "rotor.flange_a"}, 3]}')
    for name, value in asked(*words).items():
        monkeypatch.setenv(name, value)
    completion = BashComplete(cli, {}, "daest", "_DAEST_COMPLETE")
    assert completion.complete().splitlines() == [f"plain,{value}" for value in offered]


def test_damaged_files_offer_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "daest.toml").write_text("[parameters")
    for name, value in asked("identify", "--fix", "").items():
        monkeypatch.setenv(name, value)
    assert BashComplete(cli, {}, "daest", "_DAEST_COMPLETE").complete() == ""


def test_nothing_numerical_is_loaded_for_a_completion():
    """The options of a command are known before numpy is: a Tab takes no longer than the interpreter."""
    program = (
        "import sys\nfrom click.shell_completion import BashComplete\nfrom daest.cli.main import cli\n"
        f"for name in {list(COMMANDS)}:\n"
        "    BashComplete(cli, {}, 'daest', '').get_completions([name], '--')\n"
        "    loaded = {'numpy', 'scipy', 'casadi', 'matplotlib', 'rich', 'fmpy'} & set(sys.modules)\n"
        "    assert not loaded, (name, loaded)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_least_records_fit_the_level_of_the_tests():
    assert int(1 / GATES.residual_level) - 1 == LEAST_NULL_RECORDS
