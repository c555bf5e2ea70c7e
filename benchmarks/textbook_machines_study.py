"""What `daest diagnose` and `improve` say of eleven machines of text books, asked as a user would.

    python benchmarks/textbook_machines_study.py [--machine NAME ...] [--pairs] [--seed N] [--every N]
                                                 [--jobs N] [--json FILE] [--keep DIR] [--list]

Every machine of `textbook_machines` is recorded once with each of its effects and once with none. A fault is
drawn for each recording: none, a parameter that drifts by 3 %, quantisation, coloured noise of sensors, or a
first input that is 1 % larger than recorded. `--every N` records in periods that are N times longer, so that
the same time has so many samples less: 10 leaves 240 or 300. `--pairs` hides two effects at once and asks
`improve`. Names are judged, not places. `--machine` takes a machine or a case, as `car` or `car stop`.
`--json FILE` keeps one line per recording; those that are in it are not done again. `--keep DIR` keeps the
folders of the commands.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnosis_study import chosen
from textbook_machines import FAULTS, MACHINES, Machine, recording, with_effects

from daest.machine import described
from daest.numerics.parallel import Outcome, workers

NOTHING = "nothing"
PAIRS = (
    ("car", "friction", "stop"),
    ("car", "damper", "hardening"),
    ("hoist", "friction", "drag"),
    ("cylinder", "dead zone", "friction"),
    ("dc", "brush", "friction"),
    ("dc", "fan", "brush"),
    ("zones", "sun", "wall"),
    ("zones", "gain", "saturation"),
    ("tanks3", "root", "overflow"),
    ("tanks3", "leak", "saturation"),
    ("pendulum", "friction", "spring"),
    ("pendulum", "drag", "stop"),
    ("heater", "loss", "lag"),
    ("train", "drag", "slope"),
    ("shaft", "friction", "play"),
    ("shaft", "drag", "hardening"),
)
COUNTS = ("right", "small faults", "missed", "wrong", "stops")


@dataclass(frozen=True)
class Case:
    """Effects that are hidden in a machine, which is its group."""

    group: str
    effects: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return f"{self.group} {'+'.join(self.effects) or NOTHING}"

    def rng(self, seed: int) -> np.random.Generator:
        """Random numbers of the recording: its fault first, then inputs, then noise."""
        letters = self.group + ("+".join(self.effects) or NOTHING)
        return np.random.default_rng([seed, sum(map(ord, letters))])


CASES = [
    Case(name, effects)
    for name, machine in MACHINES.items()
    for effects in (*((effect,) for effect in machine.effects), ())
]
TWO = [Case(name, tuple(effects)) for name, *effects in PAIRS]
NAMED = {case.name: case for case in (*CASES, *TWO)}


@dataclass(frozen=True)
class Run:
    """One recording: the labels `EFFECT at PLACE` that are told, and seconds of processor time of the
    commands."""

    case: str
    seed: int
    fault: str
    verdict: str
    claimed: tuple[str, ...]
    seconds: float


# One recording ----------------------------------------------------------------------------------------------


def one_run(place: Path | None, every: int, task: tuple[str, int]) -> Run:
    """Make the recording of a case and seed, in periods that are `every` times longer, and ask as a user
    would; `place` None: in a temporary folder."""
    name, seed = task
    if place is None:
        with tempfile.TemporaryDirectory() as temporary:
            return asked(Path(temporary), name, seed, every)
    folder = place / f"{name.replace(' ', '_')}-{seed}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return asked(folder, name, seed, every)


def asked(folder: Path, name: str, seed: int, every: int) -> Run:
    """What the commands say of a case in a folder that is empty before."""
    case = NAMED[name]
    rng = case.rng(seed)
    fault = FAULTS[int(rng.integers(len(FAULTS)))]
    machine = with_effects(case.group, case.effects)
    write(folder, machine, *recording(machine, fault, rng, every), every)
    before = os.times()
    question, answer, told = IMPROVE if len(case.effects) > 1 else DIAGNOSE
    stopped = command(folder, "init", "Machine.mo", "data.csv") or command(folder, question, "--jobs", "1")
    after = os.times()
    path = folder / "results" / answer
    verdict, claimed = (
        told(json.loads(path.read_text(encoding="utf-8")))
        if path.is_file()
        else (stopped or "stop: no result", ())
    )
    seconds = after.children_user + after.children_system - before.children_user - before.children_system
    return Run(name, seed, fault, verdict, claimed, round(seconds, 1))


def write(folder: Path, machine: Machine, u: np.ndarray, y: np.ndarray, every: int = 1) -> None:
    """The model and the recording, as `Machine.mo` and `data.csv`."""
    (folder / "Machine.mo").write_text(machine.model, encoding="utf-8")
    time = machine.period * every * np.arange(len(u))
    head = ",".join(("time", *machine.inputs, *machine.noise))
    table = np.column_stack([time, u, y])
    np.savetxt(folder / "data.csv", table, fmt="%.8g", delimiter=",", header=head, comments="")


def command(folder: Path, *arguments: str) -> str:
    """Run a command of daest; why it stopped, empty where it did not. What it prints is kept beside."""
    line = [sys.executable, "-m", "daest", *arguments]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
    (folder / f"{arguments[0]}.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
    code = re.search(r"error\[([\w-]+)\]", done.stderr)
    return f"stop: {code[1] if code else done.returncode}" if done.returncode else ""


def diagnosed(found: dict[str, Any]) -> tuple[str, tuple[str, ...]]:
    """Verdict and claimed labels of a document of `diagnose`."""
    told = [c for c in found["candidates"] if c["verdict"] in ("supported", "not separable")]
    labels = [f"{c['effect']} at {c['at']}" for c in told] + [label for c in told for label in c["same_as"]]
    return found["verdict"], tuple(dict.fromkeys(labels))


def improved(found: dict[str, Any]) -> tuple[str, tuple[str, ...]]:
    """The last verdict and the effects of a ledger of `improve`."""
    steps = [step for step in found["steps"] if step["added"]]
    return found["final"]["verdict"], tuple(f"{step['added']} at {step['at']}" for step in steps)


DIAGNOSE = ("diagnose", "diagnosis.json", diagnosed)
IMPROVE = ("improve", "improve/ledger.json", improved)


# Counts -----------------------------------------------------------------------------------------------------


def counts(run: Run) -> Counter[str]:
    """What is right and wrong of a recording. The names of a diagnosis are alternatives, of which one has to
    be right; those of `improve` stand beside each other and are counted one by one."""
    case = NAMED[run.case]
    if run.verdict.startswith("stop"):
        return Counter(["stops"])
    laws = [MACHINES[case.group].effects[effect].names for effect in case.effects]
    told = [(label, label.partition(" at ")[0]) for label in run.claimed]
    right = sum(any(name in law for _, name in told) for law in laws)
    others = [label for label, name in told if not any(name in law for law in laws)]
    small = sum(is_small_fault(case, run.fault, label) for label in others)
    if len(laws) > 1:
        lost = len(laws) - right
        return Counter({"right": right, "small faults": small, "missed": lost, "wrong": len(others) - small})
    if not told:
        return Counter(["missed"] * len(laws))
    return Counter(["right" if right else "small faults" if small else "wrong"])


def is_small_fault(case: Case, fault: str, label: str) -> bool:
    """Whether a label names the gain of the first input, or the parameter that drifts, which is there."""
    name, _, places = label.partition(" at ")
    machine = MACHINES[case.group]
    there = {
        "gain": ("Gain", next(iter(machine.inputs))),
        "drift": ("DriftingParameter", machine.drifting),
    }
    effect, place = there.get(fault, ("", ""))
    return name == effect and place in places.split(", ")


def table(runs: Sequence[Run]) -> str:
    """The counts by machine and in all, as text."""
    lines = [f"{'':9} recordings  hidden  {'  '.join(COUNTS)}  processor time"]
    for name in (*MACHINES, "all"):
        some = [run for run in runs if name in ("all", NAMED[run.case].group)]
        if not some:
            continue
        found = sum((counts(run) for run in some), Counter())
        hidden = sum(len(NAMED[run.case].effects) for run in some)
        row = "  ".join(f"{found[what]:{len(what)}}" for what in COUNTS)
        seconds = sum(run.seconds for run in some)
        lines.append(f"{name:9} {len(some):10}  {hidden:6}  {row}  {seconds:12.0f} s")
    return "\n".join(lines)


# Command ----------------------------------------------------------------------------------------------------


def kept(path: Path | None) -> list[Run]:
    if path is None or not path.exists():
        return []
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [Run(**{**one, "claimed": tuple(one["claimed"])}) for one in lines]


def keep(path: Path | None, _number: int, outcome: Outcome[Run]) -> None:
    run = outcome.get()
    said = ", ".join(f"{n} {what}" for what, n in counts(run).items() if n) or "nothing named"
    names = ", ".join(run.claimed)
    print(
        f"{run.case} {run.seed} {run.fault}: {said}; {run.verdict} {names} ({run.seconds:.0f} s)", flush=True
    )
    if path:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(run)) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--machine", action="append", default=[], help="machine or case; may be repeated")
    parser.add_argument("--pairs", action="store_true", help="two effects at once, asked of improve")
    parser.add_argument("--seed", type=int, default=1, help="of the recordings")
    parser.add_argument("--every", type=int, default=1, help="periods that are so many times longer")
    parser.add_argument("--jobs", type=int, default=1, help="recordings at a time")
    parser.add_argument("--json", type=Path, help="file that keeps the runs")
    parser.add_argument("--keep", type=Path, help="folder that keeps models, recordings and results")
    parser.add_argument("--list", action="store_true", help="name the cases and end")
    options = parser.parse_args()
    cases = chosen(options.machine, TWO if options.pairs else CASES)
    if options.list:
        print("\n".join(case.name for case in cases))
        return
    print(described(), flush=True)
    wanted = [(case.name, options.seed) for case in cases]
    runs = [run for run in kept(options.json) if (run.case, run.seed) in wanted]
    tasks = [task for task in wanted if task not in {(run.case, run.seed) for run in runs}]
    with workers(options.jobs, None) as pool:
        asks = partial(one_run, options.keep and options.keep.resolve(), options.every)
        runs += [outcome.get() for outcome in pool.map(asks, tasks, arrived=partial(keep, options.json))]
    print(table(runs))


if __name__ == "__main__":
    import textbook_machines_study  # what belongs to __main__ is unknown to other processes

    textbook_machines_study.main()
