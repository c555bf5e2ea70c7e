"""The words of README.md: its commands run, print what it says, and nothing that exists is left out."""

import re
import shutil
from pathlib import Path

import pytest
from console_blocks import checked_commands, fenced, missing

import daest
from daest.cli.main import COMMANDS, run
from daest.errors import EXPLANATIONS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
TOUR = ("export", "linearize", "noise", "identify", "filter", "compare")


def indented_line(start: str) -> str:
    """The only indented command line of README.md that begins with `start`."""
    (line,) = re.findall(rf"^    ({re.escape(start)}.*)$", README, re.MULTILINE)
    return line


@pytest.fixture(scope="module")
def servo(tmp_path_factory) -> Path:
    """A copy of the example of the tour, in which results gather."""
    folder = tmp_path_factory.mktemp("tour") / "servo"
    return shutil.copytree(ROOT / "examples" / "servo", folder, ignore=shutil.ignore_patterns("results"))


def test_tour(servo, monkeypatch, capsys):
    """One test, because later commands use the results of earlier ones."""
    monkeypatch.chdir(servo)
    commands = checked_commands(README, run, lambda: capsys.readouterr().out)
    assert tuple(commands) == TOUR
    assert (servo / "speed.png").stat().st_size > 10_000


def test_python(servo, monkeypatch, capsys):
    monkeypatch.chdir(servo)
    (block,) = fenced(README, "python")
    exec(compile(block, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "'k': (0.0675" in printed


def test_matching_notices_a_wrong_word_and_a_wrong_number():
    printed = ["a = 1.00 m", "b = 2", "c"]
    assert missing(["a = 1.01 m", "..."], printed) is None
    assert missing(["...", "c"], printed) is None
    assert missing(["a = 1.1 m"], printed) == "a = 1.1 m"
    assert missing(["a = 1.00 kg"], printed) == "a = 1.00 kg"
    assert missing(["b = 2"], printed) == "b = 2"
    assert missing(["...", "c", "b = 2"], printed) == "b = 2"


def test_ci_runs_the_test_command():
    script = (ROOT / ".ci" / "run").read_text()
    assert f"\n{indented_line('pip install -e')}\n" in script
    assert indented_line("python3 -m venv").endswith("&& pip install . && daest demo servo")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_in_the_table_and_shows_an_example(command, capsys):
    assert f"| `daest {command}" in README
    assert run([command, "-h"]) == 0
    assert re.search(rf"Example:\s+daest\s+{command}", capsys.readouterr().out)


def test_every_code_is_explained_by_the_command(capsys):
    assert run(["explain"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line for line in listed if line and not line.startswith(" ")] == sorted(EXPLANATIONS)


def test_names_and_paths_exist():
    for path in re.findall(r"`((?:tests|examples|modelica|benchmarks)(?:/[\w.]+)*)(?:::\w+)?`", README):
        assert (ROOT / path).exists(), path
    for path, function in re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", README):
        assert f"def {function}(" in (ROOT / path).read_text(), function
    for path in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README):
        assert (ROOT / path).is_file(), path
    for name in re.findall(r"daest\.(\w+)\(", "".join(fenced(README, "python"))):
        assert name in daest.__all__
