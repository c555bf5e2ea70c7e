"""Mutations of what daest reads, by number: each ends well or with one message, as a command would.

`python tests/hostile/mutations.py COUNT` tries COUNT of them and tells what became of them; with
`--processes N` it runs N of them as whole processes, too. A mutation takes one of two ways: damaged text,
which the parsers refuse, and valid files with strange values, which go past them into the computation.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

SECONDS = 20  # of processor time
WAIT = 1200.0  # seconds for a process on a machine that does other things
MODELS = {
    "Lag.mo": """model Lag
  parameter Real k = 2 annotation(__Daest(estimate = true));
  parameter Real T(min = 0) = 1 annotation(__Daest(estimate = true));
  input Real u(start = 0);
  output Real y = x annotation(__Daest(std = 0.01));
  Real x(start = 0, fixed = true);
equation
  T*der(x) = k*u - x;
end Lag;
""",
    "Pendulum.mo": """model Pendulum
  parameter Real m = 1;
  parameter Real l = 0.7;
  parameter Real d = 0.1;
  input Real tau(start = 0);
  output Real phi(start = 0.1, fixed = true);
  Real w(start = 0, fixed = true);
  Real root;
equation
  der(phi) = w;
  m*l^2*der(w) = tau - d*w*abs(w) - 9.81*m*l*sin(phi) + 1e-3*sqrt(root);
  root = l + phi^2 + log(m + root^2);
end Pendulum;
""",
}
TOML = """[model]
source = "Lag.mo"
[data]
estimate = ["run.csv"]
split = 0.5
inputs = { u = "u" }
outputs = { y = "y" }
[parameters]
k = { estimate = true, start = 2.0, min = 0.0, max = 10.0, scale = "log" }
T = { value = 1.0 }
[noise.measurement]
y = { std = 0.01, estimate = true }
"""
STRANGE = (
    *(0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 5e-324, 1e300, -1e300, 1.7e308, np.inf, -np.inf, np.nan),
    *(1e-16, 1e16, 3.0, 1e6, -1e6, 2.0**31, 2.0**53, 0.1),
)
WORDS = (
    *("", "0", "-1", "1e999", "nan", "inf", "'", '"', "[", "]", "{", "}", "=", "#", "\n", "\x00", "\x1b[31m"),
    *("\u202e", "true", "9" * 400, "../..", "a" * 300, "1e-400", ",", ";", "<", "&", "]]>", "--", "é"),
)

Mutation = Callable[[np.random.Generator, Path], str]


def damaged(rng: np.random.Generator, text: str) -> str:
    """A text with some pieces cut, doubled, or replaced by words that mean something."""
    for _ in range(rng.integers(1, 5)):
        start = int(rng.integers(len(text) + 1))
        stop = min(len(text), start + int(rng.integers(12)))
        piece = ("", text[start:stop] * 2, WORDS[rng.integers(len(WORDS))])[rng.integers(3)]
        text = text[:start] + piece + text[stop:]
    return text


def table(rng: np.random.Generator, n: int = 60) -> str:
    """A recording with some strange values."""
    columns = [0.1 * np.arange(n), rng.normal(size=n), rng.normal(size=n)]
    for _ in range(rng.integers(0, 4)):
        columns[rng.integers(1, 3)][rng.integers(n)] = STRANGE[rng.integers(len(STRANGE))]
    if rng.random() < 0.2:
        columns[rng.integers(1, 3)][:] = STRANGE[rng.integers(len(STRANGE))]
    if rng.random() < 0.1:
        columns[0] *= STRANGE[rng.integers(len(STRANGE))]
    rows = [",".join(repr(float(c[i])) if np.isfinite(c[i]) else "" for c in columns) for i in range(n)]
    return "time,u,y\n" + "\n".join(rows) + "\n"


def project(rng: np.random.Generator) -> str:
    """A valid daest.toml with strange values."""
    numbers = ("2.0", "0.0, max", "10.0", "1.0", "0.01", "0.5")
    old = numbers[rng.integers(len(numbers))].partition(",")[0]
    value = STRANGE[rng.integers(len(STRANGE))]
    return TOML.replace(old, repr(float(value)), 1)


# What is tried ----------------------------------------------------------------------------------------------


def read_table_of(rng: np.random.Generator, folder: Path, text: str) -> str:
    from daest.cli.main import run

    (folder / "daest.toml").unlink(missing_ok=True)
    (folder / "run.csv").write_text(text, encoding="utf-8", errors="replace")
    return f"exit {run(['check', 'run.csv'])}"


def damaged_table(rng: np.random.Generator, folder: Path) -> str:
    return read_table_of(rng, folder, damaged(rng, table(rng, 8)))


def strange_table(rng: np.random.Generator, folder: Path) -> str:
    return read_table_of(rng, folder, table(rng))


def damaged_project(rng: np.random.Generator, folder: Path) -> str:
    from daest.data.project import load_project

    (folder / "daest.toml").write_text(damaged(rng, TOML), encoding="utf-8", errors="replace")
    load_project(folder / "daest.toml")
    return "read"


def strange_project(rng: np.random.Generator, folder: Path) -> str:
    from daest.data.project import load_project

    (folder / "daest.toml").write_text(project(rng), encoding="utf-8")
    load_project(folder / "daest.toml")
    return "read"


def description(rng: np.random.Generator, folder: Path, is_damaged: bool) -> str:
    from hostile_fmu import DESCRIPTION

    from daest.fmu.load import load_fmu
    from daest.fmu.semi_explicit import semi_explicit_form

    text = DESCRIPTION
    if is_damaged:
        text = damaged(rng, text)
    else:
        for old in rng.choice(['start="1"', 'start="0"', 'valueReference="2"', 'name="k"'], size=2):
            key = old.partition("=")[0]
            text = text.replace(old, f'{key}="{STRANGE[rng.integers(len(STRANGE))]}"', 1)
    with zipfile.ZipFile(folder / "a.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", text.encode("utf-8", "replace"))
    semi_explicit_form(load_fmu(folder / "a.fmu"))
    return "read"


def damaged_description(rng: np.random.Generator, folder: Path) -> str:
    return description(rng, folder, True)


def strange_description(rng: np.random.Generator, folder: Path) -> str:
    return description(rng, folder, False)


def damaged_archive(rng: np.random.Generator, folder: Path) -> str:
    from hostile_fmu import DESCRIPTION

    from daest.fmu.load import load_fmu

    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION)
    content = bytearray(stream.getvalue())
    for _ in range(rng.integers(1, 6)):
        content[rng.integers(len(content))] = rng.integers(256)
    (folder / "a.fmu").write_bytes(bytes(content))
    load_fmu(folder / "a.fmu")
    return "read"


def strange_values(rng: np.random.Generator, folder: Path) -> str:
    """A model that compiles, at parameters that no machine has: linearized, or simulated."""
    from daest.data.read import Signal, read_experiments
    from daest.systems.linear.linearize import linearize
    from daest.systems.linear.split import split
    from daest.systems.simulation.simulate import simulate

    name = list(MODELS)[rng.integers(len(MODELS))]
    flat = compiled(name)
    theta = np.array([p.value for p in flat.parameters])
    theta[rng.integers(theta.size)] = STRANGE[rng.integers(len(STRANGE))]
    if rng.random() < 0.5:
        split(linearize(flat, theta))
        return "linearized"
    names = f"{flat.inputs[0].name},{flat.outputs[0].name}"
    (folder / "run.csv").write_text(table(rng, 20).replace("u,y", names, 1))
    inputs, outputs = ([Signal(v.name, v.unit, None) for v in part] for part in (flat.inputs, flat.outputs))
    (experiment,) = read_experiments([folder / "run.csv"], inputs, outputs)

    def told(_text: str) -> None:
        raise Long  # it is said how far it is, and an end is possible

    try:
        simulate(flat, experiment, theta=theta, tell=told)
    except Long:
        return "long"
    return "simulated"


_compiled: dict = {}


def compiled(name: str):
    from daest.modelica.compile import compile_text

    if name not in _compiled:
        _compiled[name] = compile_text(MODELS[name].encode(), Path(name))
    return _compiled[name]


DAMAGED = (damaged_table, damaged_project, damaged_description, damaged_archive)
PAST = (strange_table, strange_project, strange_description, strange_values)
COMMANDS = (
    ("check", "run.csv"),
    ("identify", "-p", "daest.toml"),
    ("linearize", "Lag.mo"),
    ("linearize", "a.fmu"),
    ("simulate", "Lag.mo", "--inputs", "run.csv", "-o", "out.csv"),
    ("report",),
)


class Long(Exception):
    """A simulation that says how far it is."""


class TooSlow(BaseException):
    """A mutation took longer than SECONDS."""


def _too_slow(*_: object) -> None:
    raise TooSlow


def tried(number: int, folder: Path) -> tuple[str, str]:
    """Mutation and outcome; raises what is a fault of daest."""
    from daest.errors import DaestError

    rng = np.random.default_rng(number)
    ways = PAST if number % 2 else DAMAGED
    mutation = ways[rng.integers(len(ways))]
    err, out = io.StringIO(), io.StringIO()
    signal.signal(signal.SIGPROF, _too_slow)  # processor time: other work on the machine does not count
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        with contextlib.redirect_stderr(err), contextlib.redirect_stdout(out), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            outcome = mutation(rng, folder)
    except DaestError as error:
        outcome = "message"
        assert error.what and "\x1b" not in str(error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    said = err.getvalue()
    assert "internal-error" not in said and "Traceback" not in said, said
    assert outcome in ("message", "read", "linearized", "simulated", "long", "exit 0", "exit 1", "exit 2"), (
        outcome
    )
    return mutation.__name__, outcome


def whole_process(number: int, folder: Path) -> str:
    """A mutation of one of the files of a command, run as a process; its exit code."""
    rng = np.random.default_rng(number)
    texts = {**MODELS, "daest.toml": TOML, "run.csv": table(rng)}
    chosen = rng.choice(list(texts))
    if chosen == "daest.toml" and number % 2:
        texts[chosen] = project(rng)
    elif chosen != "run.csv" or not number % 2:
        texts[chosen] = damaged(rng, texts[chosen])
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8", errors="replace")
    with contextlib.suppress(Exception):
        damaged_archive(rng, folder)
    command = COMMANDS[rng.integers(len(COMMANDS))]
    done = subprocess.run(
        [sys.executable, "-m", "daest", *command],
        cwd=folder,
        capture_output=True,
        timeout=3 * SECONDS,
        check=False,
    )
    said = done.stderr.decode("utf-8", "replace")
    assert done.returncode in (0, 1, 2), (number, command, done.returncode, said)
    assert "Traceback" not in said and "internal-error" not in said and "\x1b" not in said, (
        number,
        command,
        said,
    )
    return f"{command[0]} {done.returncode}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--processes", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()

    found: Counter = Counter()
    faults, began = 0, time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        for number in range(given.first, given.first + given.count):
            try:
                found[tried(number, Path(name))] += 1
            except (Exception, TooSlow) as fault:
                faults += 1
                print(f"mutation {number}: {type(fault).__name__}: {fault}", flush=True)
            if (number + 1) % 5000 == 0:
                print(
                    f"{number + 1 - given.first} tried, {faults} faults, {time.monotonic() - began:.0f} s",
                    flush=True,
                )
        for number in range(given.first, given.first + given.processes):
            try:
                found["process", whole_process(number, Path(name))] += 1
            except (AssertionError, subprocess.TimeoutExpired) as fault:
                faults += 1
                print(f"process {number}: {fault}", flush=True)
    for (mutation, outcome), n in sorted(found.items()):
        print(f"{n:7d}  {mutation}: {outcome}")
    print(f"{given.count} mutations and {given.processes} processes, {faults} faults")
    sys.exit(min(faults, 1))


if __name__ == "__main__":
    main()
