"""The words of the documentation: its commands run and print what it says, its workflow sees a drift."""

import json
import re
import shlex
import shutil
from pathlib import Path

import click
import pytest
import yaml
from console_blocks import checked_commands, fenced

from daest.cli.main import cli, run
from daest.data.examples import copy_example

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))


def page(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def prepare_report_servo(folder: Path) -> None:
    copy_example("report_servo", folder)


def prepare_model(folder: Path) -> None:
    folder.mkdir()
    shutil.copy(DOCS / "how-to" / "Servo.mo", folder)
    shutil.copy(ROOT / "examples" / "servo" / "servo.csv", folder)


def prepare_effect(folder: Path) -> None:
    copy_example("servo", folder)
    (folder / "effects").mkdir()
    shutil.copy(DOCS / "how-to" / "WindLoad.mo", folder / "effects")
    shortened(folder / "servo.csv", 4)


def shortened(recording: Path, parts: int) -> None:
    """The first of so many parts of a recording says the same."""
    whole = recording.read_text(encoding="utf-8").splitlines(keepends=True)
    recording.write_text("".join(whole[: len(whole) // parts]), encoding="utf-8")


def prepare_motor(folder: Path) -> None:
    folder.mkdir()
    for name in ("Motor.mo", "motor.csv"):
        shutil.copy(DOCS / "motor" / name, folder)


CONSOLE = {
    "motor.md": (prepare_motor, ["init", "check", "identify", "compare", "diagnose"]),
    "tutorial.md": (prepare_report_servo, ["linearize", "noise", "identify", "filter", "compare"]),
    "how-to/model.md": (prepare_model, ["init", "check", "noise", "identify", "compare"]),
    "how-to/effect.md": (prepare_effect, ["effects", "diagnose", "extend"]),
}


SLOW = {"motor.md", "how-to/effect.md", "tutorial.md"}  # searches, and a tour that README.md makes too


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in CONSOLE]
)
def test_commands_print_what_the_page_says(name, tmp_path, monkeypatch, capsys):
    prepare, commands = CONSOLE[name]
    prepare(tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    assert checked_commands(page(name), run, lambda: capsys.readouterr().out) == commands


def test_the_motor_cannot_be_identified_from_its_speed_alone(tmp_path, monkeypatch, capsys):
    """The error that the tutorial shows, to the letter, and the fit that follows."""
    prepare_motor(tmp_path / "motor")
    monkeypatch.chdir(tmp_path / "motor")
    assert run(["init", "Motor.mo", "motor.csv"]) == 0
    capsys.readouterr()
    assert run(["identify"]) == 2
    (shown,) = fenced(page("motor.md"), "text")
    assert shown in capsys.readouterr().err
    assert run(["identify", "--fix", "J=1.15e-4"]) == 0
    assert "0.04613" in capsys.readouterr().out


def test_every_page_with_commands_is_run():
    shown = [str(p.relative_to(DOCS)) for p in PAGES if fenced(p.read_text("utf-8"), "console")]
    assert sorted(shown) == sorted(CONSOLE)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_commands_that_are_only_shown_are_understood(path):
    lines = "\n".join(fenced(path.read_text("utf-8"), "sh")).splitlines()
    context = click.Context(cli, info_name="daest")
    for line in filter(None, lines):
        program, *arguments = shlex.split(line)
        assert program in ("daest", "export")
        if program == "daest":
            command = cli.get_command(context, arguments[0])
            command.make_context(arguments[0], arguments[1:], parent=context)


def test_the_truth_that_the_tutorial_tells():
    """The recording's k is that of a motor the other way round."""
    truth = json.loads((ROOT / "examples" / "report_servo" / "truth.json").read_text("utf-8"))["parameters"]
    sentence = re.search(r"the truth is known: (.*?)\. All", page("tutorial.md"), re.DOTALL)[1]
    told = dict(re.findall(r"(\w+) = (-?[\d.]+(?:e-\d+)?)", sentence))
    assert list(told) == ["d", "c", "J1", "J2", "k"]
    for name, value in told.items():
        assert float(value) == pytest.approx(-truth[name] if name == "k" else truth[name], rel=1e-3)


# A workflow that fails when the model drifts ----------------------------------------------------------------


def workflow_commands() -> list[list[str]]:
    workflow = yaml.safe_load(page("how-to/daest.yml"))
    steps = workflow["jobs"]["drift"]["steps"]
    runs = [shlex.split(step["run"]) for step in steps if "run" in step]
    return [words[1:] for words in runs if words[0] == "daest"]


@pytest.fixture
def whole_repository(tmp_path, monkeypatch) -> Path:
    """The servo as the page says: values in daest.toml, no results."""
    copy_example("servo", tmp_path / "servo")
    file = tmp_path / "servo" / "daest.toml"
    (values,) = fenced(page("how-to/ci.md"), "toml")
    text, n = re.subn(r"(?<=\[parameters\]\n).*?(?=\n\[)", values, file.read_text("utf-8"), flags=re.DOTALL)
    assert n == 1
    file.write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path / "servo")
    return tmp_path / "servo"


@pytest.fixture
def repository(whole_repository) -> Path:
    shortened(whole_repository / "servo.csv", 8)
    return whole_repository


def change(file: Path, old: str, new: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert text.count(old) == 1
    file.write_text(text.replace(old, new), encoding="utf-8")


def test_workflow_has_the_three_commands():
    assert [words[0] for words in workflow_commands()] == ["check", "noise", "compare"]


def test_workflow_passes_the_good_model(repository):
    assert [run(words) for words in workflow_commands()] == [0, 0, 0]
    assert (repository / "drift.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("Servo.mo", "gear(ratio = 30)", "gear(ratio = 29)"),
        ("daest.toml", "c = { value = 1.43695 }", "c = { value = 1.4513 }"),
    ],
    ids=["gear", "stiffness"],
)
def test_workflow_fails_where_the_model_drifts(whole_repository, file, old, new):
    """What the page says of a percent of stiffness takes the whole recording to see."""
    change(whole_repository / file, old, new)
    assert [run(words) for words in workflow_commands()] == [0, 0, 1]


def test_workflow_fails_where_noise_moves_to_an_angle(repository):
    change(
        repository / "daest.toml",
        "[noise.measurement]",
        '[noise.process]\n"34" = { intensity = 1e-6 }\n\n[noise.measurement]',
    )
    assert run(workflow_commands()[1]) == 1
