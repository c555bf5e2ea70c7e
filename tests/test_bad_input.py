"""What users do wrong, by the command line: exit code 2, a message that names what and where and a remedy, no
traceback, and nothing written."""

import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from daest.cli.main import run
from daest.numerics import compiler

SERVO = Path(__file__).resolve().parents[1] / "examples" / "servo"
N_ROWS = 400
UNBALANCED = """\
model Loose
  input Real u(start = 0);
  output Real z;
  Real x, y;
equation
  der(x) = u;
  z = x + y;
end Loose;
"""
SINGULAR = """\
model Tied
  input Real u(start = 0);
  output Real z = x;
  Real x, y, q;
equation
  der(x) = u + y;
  x + y = 1;
  x + y = 2 + u;
end Tied;
"""
TUNING = """\
model Tuning
  input Real u(start = 0);
  output Real x(start = 0, fixed = true);
  parameter Real a = 1;
  parameter Real b = 2*a;
  final parameter Real m = 3;
equation
  der(x) = u - m*b*x;
end Tuning;
"""


def text_of(name: str) -> str:
    return Path(name).read_text(encoding="utf-8")


def write(name: str, text: str) -> None:
    Path(name).write_text(text, encoding="utf-8")


def change(source: str, target: str, old: str, new: str) -> None:
    text = text_of(source)
    assert text.count(old) >= 1
    write(target, text.replace(old, new, 1))


def backwards() -> None:
    rows = text_of("run.csv").splitlines(keepends=True)
    rows[20], rows[21] = rows[21], rows[20]
    write("bad.csv", "".join(rows))


def constant() -> None:
    head, *rows = text_of("run.csv").splitlines()
    cells = [row.split(",") for row in rows]
    write("bad.csv", "\n".join([head, *(",".join([c[0], "1", *c[2:]]) for c in cells)]) + "\n")


def few() -> None:
    write("bad.csv", "".join(text_of("run.csv").splitlines(keepends=True)[:5]))


def project(extra: str, outputs: str = 'omega = "omega", phi = "phi"') -> Callable[[], None]:
    text = f'[model]\nsource = "Servo.mo"\n[data]\nestimate = ["run.csv"]\noutputs = {{ {outputs} }}\n{extra}'
    return lambda: write("bad.toml", text)


def noise_on_an_angle() -> None:
    text = text_of("Servo.mo").replace(
        "equation\n",
        "  Real copy;\n  Real speed = der(copy);\n"
        "  input Real wn(start = 0) annotation(__Daest(noise = true, intensity = 1e-6));\n"
        "equation\n  copy = disc.phi + wn;\n",
        1,
    )
    write("Bad.mo", text)


def without_binary() -> None:
    assert run(["export", "Servo.mo", "-o", "whole.fmu"]) == 0
    with zipfile.ZipFile("whole.fmu") as whole, zipfile.ZipFile("bad.fmu", "w") as bad:
        for name in whole.namelist():
            if not name.startswith(("binaries/", "extra/org.daest")):
                bad.writestr(name, whole.read(name))


def nothing() -> None:
    """The folder is as it is."""


IDENTIFY = ("identify", "bad.csv", "--model", "Servo.mo")
ALL_FREE = [word for name in ("R", "k", "J1", "J2", "c", "d") for word in ("--estimate", name)]

# name: (what makes the folder bad, command line, code, words of the message)
CASES: dict[str, tuple[Callable[[], object], tuple[str, ...], str, tuple[str, ...]]] = {
    "missing file": (
        nothing,
        ("identify", "rum.csv", "--model", "Servo.mo"),
        "data-missing-file",
        ("rum.csv", "did you mean run.csv"),
    ),
    "missing model": (nothing, ("linearize", "Serwo.mo"), "model-missing", ("Serwo.mo",)),
    "empty file": (lambda: write("bad.csv", ""), IDENTIFY, "data-empty-file", ("bad.csv", "header")),
    "no time": (
        lambda: change("run.csv", "bad.csv", "time,", "zeit,"),
        IDENTIFY,
        "data-no-time",
        ("bad.csv:1", "zeit, u, omega, phi"),
    ),
    "time goes back": (backwards, IDENTIFY, "data-time-not-increasing", ("bad.csv:22:1", "sort the rows")),
    "duplicate column": (
        lambda: change("run.csv", "bad.csv", ",phi", ",omega"),
        IDENTIFY,
        "data-duplicate-column",
        ("bad.csv:1:4", "'omega' stands twice"),
    ),
    "unknown column": (
        project("", 'phi = "phy"'),
        ("identify", "-p", "bad.toml"),
        "data-unknown-column",
        ("'phy'", "did you mean phi"),
    ),
    "text in a number column": (
        lambda: change("run.csv", "bad.csv", "\n0.03,", "\n0.03,x"),
        IDENTIFY,
        "data-text",
        ("bad.csv:5:2", "column 'u'"),
    ),
    "unit that does not fit": (
        lambda: change("run.csv", "bad.csv", "omega", "omega [kg]"),
        IDENTIFY,
        "unit-incompatible",
        ("bad.csv:1:3", "'kg'", "rad/s"),
    ),
    "syntax error": (
        lambda: change("Servo.mo", "Bad.mo", "connect(u, source.v)", "connect(u source.v)"),
        ("linearize", "Bad.mo"),
        "model-syntax",
        ("Bad.mo:33:13", "unexpected `source`"),
    ),
    "unknown class": (
        lambda: change("Servo.mo", "Bad.mo", "Components.Inertia motor", "Components.Inertai motor"),
        ("linearize", "Bad.mo"),
        "model-unknown-class",
        ("Bad.mo:25:3", "Did you mean `Daest.Mechanics.Rotational.Components.Inertia`?"),
    ),
    "unbalanced model": (
        lambda: write("Bad.mo", UNBALANCED),
        ("linearize", "Bad.mo"),
        "model-unbalanced",
        ("Bad.mo", "2 equations for 3 unknowns", "`y`", "`z`"),
    ),
    "structurally singular model": (
        lambda: write("Bad.mo", SINGULAR),
        ("linearize", "Bad.mo"),
        "structurally-singular",
        ("x + y = 1  (Bad.mo:7:3)", "x + y = 2 + u  (Bad.mo:8:3)", "q"),
    ),
    "parameter that does not exist": (
        nothing,
        ("linearize", "Servo.mo", "--set", "spring.cc=1"),
        "parameter-unknown",
        ("spring.cc", "Did you mean `spring.c`"),
    ),
    "parameter that is fixed in the model": (
        lambda: write("Bad.mo", TUNING),
        ("linearize", "Bad.mo", "--set", "m=1"),
        "parameter-unknown",
        ("no tunable parameter `m`", "Tunable: a"),
    ),
    "parameter that follows from another": (
        lambda: write("Bad.mo", TUNING),
        ("linearize", "Bad.mo", "--set", "b=1"),
        "parameter-derived",
        ("Bad.mo:5:", "2*a"),
    ),
    "bounds that exclude the start": (
        project("[parameters]\nc = { estimate = true, start = 1.5, min = 2 }\n"),
        ("identify", "-p", "bad.toml"),
        "config-value",
        ("bad.toml:7", "1.5", "2 to inf"),
    ),
    "unidentifiable": (
        nothing,
        ("identify", "run.csv", "--model", "Servo.mo", *ALL_FREE),
        "identify-unidentifiable",
        ("R, J1, J2, c, d", "--fix"),
    ),
    "noise on a forbidden equation": (
        noise_on_an_angle,
        ("identify", "run.csv", "--model", "Bad.mo"),
        "noise-differentiated",
        ("copy = disc.phi + wn  (Bad.mo:", "daest noise"),
    ),
    "constant input": (constant, IDENTIFY, "identify-constant-input", ("input u is constant", "bad")),
    "fewer samples than parameters": (
        few,
        IDENTIFY,
        "identify-too-few-samples",
        ("8 measured values for 12 unknowns",),
    ),
    "FMU without binary": (
        without_binary,
        ("linearize", "bad.fmu"),
        "fmu-without-binary",
        ("bad.fmu", "has no binary"),
    ),
}


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    shutil.copy(SERVO / "Servo.mo", tmp_path)
    with (SERVO / "servo.csv").open() as recording:
        write("run.csv", "".join(next(recording) for _ in range(N_ROWS + 1)))
    return tmp_path


@pytest.mark.parametrize("name", CASES)
def test_message(folder, capsys, name):
    prepare, arguments, code, words = CASES[name]
    prepare()
    before = sorted(folder.rglob("*"))
    capsys.readouterr()
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    shown = err[err.index("error[") :]
    assert shown.startswith(f"error[{code}]: ")
    assert "\n  help: " in shown and "\n  --> " in shown
    assert "Traceback" not in err
    missing = [word for word in words if word not in shown]
    assert not missing, shown
    assert sorted(folder.rglob("*")) == before


def test_noise_that_is_asked_for_at_a_forbidden_equation_is_an_answer(folder, capsys):
    """No error but a verdict: exit code 1, with what to do instead."""
    assert run(["noise", "Servo.mo", "--at", "disc.phi = disc.flange_a.phi"]) == 1
    out = capsys.readouterr().out
    asked = out[out.index("Places that were asked for") :]
    assert re.search(r"disc\.phi = disc\.flange_a\.phi\s+34\s+NO", asked)
    assert "Put the noise on `disc.a = der(disc.w)`" in asked


def test_no_compiler(folder, capsys, monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiler, "cache_folder", lambda: folder / "cache")
    monkeypatch.setattr(compiler, "_zig", lambda: None)
    assert run(["export", "Servo.mo", "-o", "servo.fmu"]) == 2
    err = capsys.readouterr().err
    assert "error[no-c-compiler]" in err and "daest[compiler]" in err
    assert not (folder / "servo.fmu").exists()
