"""Diagnoses, with the shares of their stages, and the screen alone: rows of `speed.py`."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path

from timed import Row, as_installed, children_of, in_turn

import daest
from daest.diagnosis.evidence.stand import without_noises
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import Null, fit_null
from daest.diagnosis.null_model.null_observer import NullObserver, run_null
from daest.diagnosis.screening.candidates import pairs
from daest.diagnosis.screening.screen import screen
from daest.model.diagnosis import Candidate
from daest.modelica.places.sites import sites
from daest.numerics.threads import one_thread

HIDDEN = Path(__file__).parents[1] / "examples" / "servo_hidden"
# Functions that take the time of a diagnosis, by the module of `daest.diagnosis` that calls them, and what
# the table calls them.
STAGES = {
    ("diagnose", "begin"): "the model as it is",
    ("examine", "screen"): "screen",
    ("refits.stages", "_dynamic"): "effects with states of their own",
    ("refits.stages", "proof_by_attempts"): "refit with",
    ("examine", "other_value"): "values that the model holds",
}
LEAST_TOLD = 0.02  # share of a stage that has a row


def staged(told: Path) -> None:
    """Diagnose in the current folder, one fit at a time, and write the processor time of the stages there."""
    from daest.cli.main import run

    found: dict[str, float] = defaultdict(float)

    def timed(name: str, function: Callable) -> Callable:
        def run_timed(*arguments: object, **options: object) -> object:
            start = time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                which = f" {arguments[1].trial.candidate.label}" if name == "refit with" else ""  # type: ignore[attr-defined]
                found[name + which] += time.process_time() - start

        return run_timed

    for (place, function), name in STAGES.items():
        module = import_module(f"daest.diagnosis.{place}")
        setattr(module, function, timed(name, getattr(module, function)))
    try:
        run(["diagnose", "--jobs", "1"])
    finally:
        told.write_text(json.dumps({"whole": time.process_time(), **found}), encoding="utf-8")


def diagnosis_rows(folder: Path, projects: Sequence[Path]) -> Iterator[Row]:
    """The embedded example by stages, by the clock, and by `improve`; and `projects` of one's own."""
    work, told = folder / "servo_hidden", folder / "stages.json"
    shutil.copytree(HIDDEN, work, ignore=shutil.ignore_patterns("results"))
    variables = {**as_installed(), "DAEST_CACHE": str(folder / "cache")}
    there = os.pathsep.join([str(Path(__file__).parent.resolve()), variables.get("PYTHONPATH", "")])
    code = "import pathlib, sys, diagnosis_speed; diagnosis_speed.staged(pathlib.Path(sys.argv[1]))"
    here = [sys.executable, "-c", code, str(told)]
    for name in ("first", "again"):
        seconds, _ = _afresh(here, work, {**variables, "PYTHONPATH": there})
        yield Row(f"`daest diagnose` of examples/servo_hidden, {name}", "s", seconds)
    stages = json.loads(told.read_text(encoding="utf-8"))
    whole = stages.pop("whole")
    for stage, seconds in sorted(stages.items(), key=lambda item: -item[1]):
        if seconds > LEAST_TOLD * whole:
            yield Row(f"of it: {stage} ({100 * seconds / whole:.0f} %)", "s", seconds)
    emptied = {**variables, "DAEST_CACHE": str(folder / "emptied_by_the_clock")}
    for command in ("diagnose", "improve"):
        for name, environment in (("first", emptied), ("again", variables)):
            _, clock = _afresh([sys.executable, "-m", "daest", command], work, environment)
            what = f"`daest {command}` of examples/servo_hidden, two processes, by the clock, {name}"
            yield Row(what, "s", clock)
    for project in projects:
        mine = folder / f"project_{project.name}"
        shutil.copytree(project, mine, ignore=shutil.ignore_patterns("results"))
        seconds, clock = _afresh([sys.executable, "-m", "daest", "diagnose"], mine, variables)
        yield Row(f"`daest diagnose` of {project.name}, processor time, first", "s", seconds)
        yield Row("the same by the clock", "s", clock)


def _afresh(command: list[str], work: Path, variables: dict[str, str]) -> tuple[float, float]:
    """Seconds of processor time, and by the clock, of a command in a project without results."""
    shutil.rmtree(work / "results", ignore_errors=True)
    began = time.perf_counter()

    def run() -> None:
        done = subprocess.run(command, cwd=work, env=variables, capture_output=True, check=False, text=True)
        if not (work / "results").exists():
            raise SystemExit(f"{' '.join(command)} failed: {done.stderr[-500:]}")

    return children_of(run), time.perf_counter() - began


def screened() -> tuple[Null, NullObserver, list[Candidate]]:
    """What the screen of the embedded example needs: 8000 samples of the servo."""
    flat = daest.with_values(daest.compile_model(HIDDEN / "Servo.mo"), {"R": 5.24093})
    outputs = [daest.Signal("omega", "rad/s"), daest.Signal("phi", "rad")]
    recordings = daest.read_experiments([HIDDEN / "servo.csv"], [daest.Signal("u", "V")], outputs)
    with one_thread():
        null = fit_null(without_noises(flat), load_sites(flat), recordings, "zoh")
        return null, run_null(null), pairs(daest.effect_library(), sites(flat))


def screen_rows() -> Iterator[Row]:
    null, run, candidates = screened()
    with one_thread():
        (seconds,) = in_turn([lambda: screen(null, run, candidates)], 3)
    n_samples = null.experiments[0].n_samples
    yield Row(f"screen of {len(candidates)} effects at places, {n_samples} samples", "s", seconds)
