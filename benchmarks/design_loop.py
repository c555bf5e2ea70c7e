"""The loop of designed experiments: a recording that leaves something open, a designed one, and the diagnosis
of both.

    python benchmarks/design_loop.py open --runs 20     laws that a first recording cannot tell apart
    python benchmarks/design_loop.py small --runs 10    dry friction too small for a first recording
    python benchmarks/design_loop.py power --runs 40    predicted against obtained power to name an effect
    python benchmarks/design_loop.py hard --runs 20     effects that a multisine shows half of the time

Every case is diagnosed with the whole library. Then the designed input is played for as long as the first
one, and so are, instead of it, a multisine and a random binary input of the same power and range, each
recorded with the same noise. The machines are integrated by scipy, which shares nothing with daest.
`--json FILE` keeps a line for each case; a run that finds the file goes on after them, and `--minutes`
ends it early.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from design_study import of_power
from scipy.integrate import solve_ivp
from scipy.stats import binomtest

from daest.design.design import Task, design
from daest.design.effects import Rival, detect_aim, leaving, rival_aim, with_effect
from daest.design.signals import multisine, random_binary, within
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.foreseeable import beside_loads, required
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import DiagnoseOptions
from daest.errors import DaestError
from daest.machine import described
from daest.model.design import Limits, Range
from daest.model.diagnosis import Diagnosis
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library, find_effects
from daest.modelica.places.sites import find_site

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 8.0  # of the search for an input
HARD_CANDIDATES = 100  # of the whole library at the machines of `hard`
SLIDE = """\
model Slide "A mass on a spring and a damper, moved by a force"
  parameter Real m(unit = "kg", min = 0) = 1.2 annotation(__Daest(estimate = true));
  parameter Real c(unit = "N/m", min = 0) = 30 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.s/m", min = 0) = 2 annotation(__Daest(estimate = true));
  Daest.Blocks.Interfaces.RealInput F(unit = "N", start = 0);
  Daest.Blocks.Interfaces.RealOutput s(unit = "m") annotation(__Daest(std = 0.002));
  Daest.Mechanics.Translational.Sources.Force drive;
  Daest.Mechanics.Translational.Components.Mass mass(m = m);
  Daest.Mechanics.Translational.Components.SpringDamper spring(c = c, d = d);
  Daest.Mechanics.Translational.Components.Fixed wall;
  Daest.Mechanics.Translational.Sensors.PositionSensor ruler;
equation
  connect(F, drive.f);
  connect(drive.flange, mass.flange_a);
  connect(mass.flange_b, spring.flange_a);
  connect(spring.flange_b, wall.flange);
  connect(mass.flange_b, ruler.flange);
  connect(ruler.s, s);
end Slide;
"""
Law = Callable[[float, float], float]  # force against the motion at position and velocity


@dataclass(frozen=True)
class Plant:
    """A machine x'' m = u - d x' - c x - law(x, x'), of which position or speed is measured."""

    name: str
    values: tuple[float, float, float]  # m, d, c
    measures_speed: bool
    noise: float
    period: float
    input: Range
    output: str
    place: str

    def output_of(self, law: Law, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        m, d, c = self.values
        x, found = np.zeros(2), []
        for force in u:
            found.append(x[1] if self.measures_speed else x[0])

            def rate(_: float, s: np.ndarray, force: float = force) -> list[float]:
                return [s[1], (force - d * s[1] - c * s[0] - law(s[0], s[1])) / m]

            x = solve_ivp(rate, (0.0, self.period), x, method="LSODA", rtol=1e-8, atol=1e-10).y[:, -1]
        return np.array(found)[:, None] + self.noise * rng.standard_normal((len(u), 1))

    def recorded(self, name: str, law: Law, u: np.ndarray, seed: Sequence[int]) -> Experiment:
        y = self.output_of(law, u[:, 0], np.random.default_rng(list(seed)))
        time = self.period * np.arange(len(u))
        return Experiment(name, time, u, y, (self.input.name,), (self.output,))

    def limits(self, n: int) -> Limits:
        return Limits((self.input,), (n - 1) * self.period, self.period, hold="zoh")


ROTOR = Plant(
    "Rotor", (0.1, 0.12, 0.0), True, 0.05, 0.05, Range("tau", "N.m", -0.3, 0.3), "w", "rotor.flange_a"
)
SLIDER = Plant(
    "Slide", (1.0, 1.6, 36.0), False, 0.002, 0.02, Range("F", "N", -4.0, 4.0), "s", "mass.flange_a"
)


def dry(size: float) -> Law:
    return lambda _, v: size * np.tanh(v / 0.01)


def constant(size: float) -> Law:
    return lambda _, v: size


def drag(size: float) -> Law:
    return lambda _, v: size * v * abs(v)


def hardening(size: float) -> Law:
    return lambda x, _: size * x**3


@dataclass(frozen=True)
class Kind:
    """Cases of one law at one machine. `right` are names of the law in the library, an equal one included;
    sizes are log-uniform, the first input holds levels for `hold` samples."""

    plant: Plant
    law: Callable[[float], Law]
    right: tuple[str, ...]
    sizes: tuple[float, float]
    levels: tuple[float, float]
    hold: int
    n: int


OPEN = (
    Kind(ROTOR, dry, ("CoulombFriction",), (0.04, 0.12), (0.3, 0.6), 20, 481),
    Kind(ROTOR, constant, ("ConstantLoad", "Offset"), (0.04, 0.12), (0.3, 0.6), 20, 481),
    Kind(ROTOR, drag, ("QuadraticDrag",), (0.02, 0.05), (0.3, 0.6), 20, 481),
    Kind(SLIDER, hardening, ("HardeningSpring",), (300.0, 1200.0), (2.4, 3.2), 40, 801),
)
SMALL = (Kind(ROTOR, dry, ("CoulombFriction",), (0.02, 0.05), (0.48, 0.56), 20, 481),)


@cache
def model(name: str) -> Any:
    if name == "Rotor":
        return compile_model(ROOT / "tests" / "design" / "models" / "Rotor.mo")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "Slide.mo"
        path.write_text(SLIDE)
        return compile_model(path)


def diagnosed(plant: Plant, recordings: Sequence[Experiment]) -> Diagnosis:
    options = DiagnoseOptions(hold="zoh", jobs=1)
    return diagnose(model(plant.name), effect_library(()), recordings, (), options)


def answer(found: Diagnosis) -> str:
    """The law that stands out, else the verdict."""
    best = next((p for p in found.proofs if p.verdict == "supported"), None)
    return found.verdict if best is None else best.candidate.effect.name


def left_open(found: Diagnosis) -> list[Rival]:
    """The candidates that were not told apart, as `daest design --rivals` has them."""
    rivals = []
    for proof in found.proofs:
        if proof.verdict == "not separable" and not proof.candidate.inputs:
            told = proof.told
            flat = leaving(proof.flat.with_theta(told.theta), told.simulated["estimation"].rms)
            rivals.append(Rival(proof.candidate.label, flat, tuple(p.name for p in told.parameters)))
    return rivals


def first_of(kind: Kind, seed: Sequence[int]) -> tuple[float, np.ndarray, Experiment]:
    rng = np.random.default_rng(list(seed))
    size = float(np.exp(rng.uniform(*np.log(kind.sizes))))
    levels = rng.uniform(*kind.levels, kind.n // kind.hold + 1)
    u = levels.repeat(kind.hold)[: kind.n, None]
    return size, u, kind.plant.recorded("first", kind.law(size), u, (*seed, 1))


def played(kind: Kind, task: Task, first: Experiment, size: float, seed: Sequence[int]) -> dict[str, Any]:
    """The answers after the designed input and after its peers of the same power."""
    found = design(task)
    allowed, rms = task.limits, float(np.std(found.inputs))
    inputs = {
        "designed": found.inputs,
        "multisine": of_power(list(multisine(allowed, seed[-1]))[1], allowed, rms),
        "random binary": of_power(list(random_binary(allowed, seed[-1]))[1], allowed, rms),
    }
    row: dict[str, Any] = {"family": found.families[0].family, "rms": rms, "power": found.expected.power}
    for name, u in inputs.items():
        second = kind.plant.recorded("second", kind.law(size), u, (*seed, 2))
        row[name] = answer(diagnosed(kind.plant, [first, second]))
    return row


Second = Callable[[Kind, Diagnosis, Experiment, float, np.ndarray, Sequence[int]], dict[str, Any]]


def case(kind: Kind, second: Second, key: Sequence[int]) -> dict[str, Any]:
    """One case. `second` adds the answers after the second recording, none where the first one decides."""
    size, u, first = first_of(kind, key)
    before = diagnosed(kind.plant, [first])
    row: dict[str, Any] = {
        "plant": kind.plant.name,
        "right": kind.right,
        "size": size,
        "key": key,
        "first": answer(before),
    }
    return row | second(kind, before, first, size, u, key)


def cases(
    kinds: Sequence[Kind], runs: int, seed: int, second: Second, kept: Path | None, minutes: float
) -> list[dict[str, Any]]:
    """A row for every case, until `runs` of them have a second recording or the time is over; rows that were
    kept are not made again."""
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept and kept.exists() else []
    until = time.monotonic() + 60.0 * minutes
    while sum("designed" in row for row in rows) < runs and len(rows) < 3 * runs and time.monotonic() < until:
        number = len(rows)
        rows.append(case(kinds[number % len(kinds)], second, (seed, number)))
        print(json.dumps(rows[-1]), flush=True)
        if kept:
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    return rows


def told_apart(
    kind: Kind, before: Diagnosis, first: Experiment, size: float, u: np.ndarray, key: Sequence[int]
) -> dict[str, Any]:
    """Where the first recording ends in "cannot tell": an input for the rivals."""
    left = left_open(before)
    if before.verdict != "cannot tell" or len(left) < 2:
        return {}
    row: dict[str, Any] = {"left": [r.label for r in left]}
    allowed = kind.plant.limits(kind.n)
    try:
        aim, subjects = rival_aim(left, allowed, [u], 0.5 * GATES.same_bic, 0)
        task = Task(aim, subjects, allowed, (u,), seconds=SECONDS)
        return row | played(kind, task, first, size, key)
    except DaestError as problem:
        return row | {"designed": problem.code, "multisine": None, "random binary": None}


def detected(
    kind: Kind, before: Diagnosis, first: Experiment, size: float, u: np.ndarray, key: Sequence[int]
) -> dict[str, Any]:
    """Where the first recording does not show the effect: an input that does."""
    if before.verdict != "nothing missing":
        return {}
    flat, allowed = model(kind.plant.name), kind.plant.limits(kind.n)
    effect = next(e for e in find_effects(kind.right[0]) if e.domain == "rotational")
    loaded, loads = beside_loads(flat.with_theta(before.baseline.theta))
    aim, subjects = detect_aim(
        loaded, effect, find_site(flat, kind.plant.place, effect), allowed, [u],
        size=size, required=required(50), loads=loads,
    )  # fmt: skip
    return played(kind, Task(aim, subjects, allowed, (u,), seconds=SECONDS), first, size, key)


@dataclass(frozen=True)
class Shown:
    """An effect that is the only law to be tried, of several sizes, in recordings of an input of `n` samples
    that is played twice, since half of each is kept for validation."""

    plant: Plant
    law: Callable[[float], Law]
    effect: str
    place: str
    n: int
    family: Callable[..., Any]
    sizes: tuple[float, ...]
    rival: str = ""  # a second law that is tried; what tells them apart is a short reversal

    @property
    def found(self) -> Effect:
        return self.law_of(self.effect)

    @property
    def tried(self) -> tuple[Effect, ...]:
        return (self.found, self.law_of(self.rival)) if self.rival else (self.found,)

    def law_of(self, name: str) -> Effect:
        domain = "rotational" if self.plant is ROTOR else "translational"
        return next(e for e in find_effects(name) if e.domain == domain)

    @property
    def inputs(self) -> np.ndarray:
        if self.rival:
            levels = np.random.default_rng(5).uniform(0.3, 0.6, self.n // 20 + 1).repeat(20)[: self.n, None]
            levels[100:120] = -0.1
            return levels
        allowed = self.plant.limits(self.n + 1)
        return within(allowed, list(self.family(allowed, 0))[1].signal, keeps_form=True)[:-1]


POWER = (
    Shown(
        ROTOR, dry, "CoulombFriction", ROTOR.place, 240, multisine, (0.0107, 0.0141, 0.0197, 0.0268)
    ),
    Shown(SLIDER, hardening, "HardeningSpring", "spring", 400, random_binary, (7.0, 9.5, 12.5, 20.0)),
    Shown(
        ROTOR, dry, "CoulombFriction", ROTOR.place, 240, multisine, (0.042, 0.0445, 0.0475, 0.0525),
        rival="ConstantLoad",
    ),
)  # fmt: skip


def powers(runs: int, seed: int, kept: Path | None, minutes: float) -> list[dict[str, Any]]:
    """A row for every recording of every effect and size."""
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept and kept.exists() else []
    done = {tuple(row["key"]) for row in rows}
    until = time.monotonic() + 60.0 * minutes
    keys = ((run, i, j) for run in range(runs) for i, one in enumerate(POWER) for j in range(len(one.sizes)))
    for run, i, j in keys:
        if (run, i, j) in done or time.monotonic() > until:
            continue
        one = POWER[i]
        inputs, size = np.vstack([one.inputs, one.inputs]), one.sizes[j]
        recording = one.plant.recorded("r", one.law(size), inputs, (seed, i, j, run))
        options = DiagnoseOptions(hold="zoh", jobs=1)
        found = diagnose(model(one.plant.name), one.tried, [recording], (), options)
        best = max(found.proofs, key=lambda p: p.delta_log_likelihood, default=None)
        rows.append(
            {
                "key": (run, i, j),
                "plant": one.plant.name,
                "size": size,
                "named": answer(found) == one.effect,
                "verdict": found.verdict,
                "ratio": None if best is None else 2.0 * best.delta_log_likelihood,
                "reason": "not refitted" if best is None else best.reason,
            }
        )
        print(json.dumps(rows[-1]), flush=True)
        if kept:
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    return rows


HARD = (
    Shown(ROTOR, dry, "CoulombFriction", ROTOR.place, 240, multisine, (0.019,)),
    Shown(SLIDER, hardening, "HardeningSpring", "spring", 400, multisine, (12.0,)),
)
PEERS = ("designed", "multisine", "random binary")


def aim_of(one: Shown, size: float, n_candidates: int) -> tuple[Any, Any]:
    """The aim of showing that size, at the true parameters of the plant."""
    loaded, loads = beside_loads(at_truth(one.plant))
    return detect_aim(
        loaded, one.found, find_site(loaded, one.place, one.found), one.plant.limits(2 * one.n), (),
        size=size, required=required(n_candidates), loads=loads,
    )  # fmt: skip


def hard_inputs(one: Shown, kept: Path | None) -> dict[str, np.ndarray]:
    """The designed input, and peers of the same power that are played twice, too; those of an earlier run
    where there are any."""
    path = None if kept is None else kept.with_suffix(f".{one.plant.name}.npz")
    if path is not None and path.exists():
        return dict(np.load(path))
    aim, subjects = aim_of(one, one.sizes[0], HARD_CANDIDATES)
    whole, half = one.plant.limits(2 * one.n), one.plant.limits(one.n)
    found = design(Task(aim, subjects, whole, seconds=SECONDS))
    rms = float(np.std(found.inputs))
    inputs = {"designed": found.inputs}
    for name, family in (("multisine", multisine), ("random binary", random_binary)):
        once = of_power(list(family(half, 0))[1], half, rms)
        inputs[name] = np.vstack([once, once])
    if path is not None:
        np.savez(path, **inputs)
    return inputs


def hard(runs: int, seed: int, kept: Path | None, minutes: float) -> list[dict[str, Any]]:
    """A row for every recording, diagnosed with the whole library."""
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept and kept.exists() else []
    done = {(*row["key"], row["input"]) for row in rows}
    until = time.monotonic() + 60.0 * minutes
    inputs = [hard_inputs(one, kept) for one in HARD]
    for run, i, name in ((run, i, name) for run in range(runs) for i in range(len(HARD)) for name in PEERS):
        if (run, i, name) in done or time.monotonic() > until:
            continue
        one = HARD[i]
        recording = one.plant.recorded("r", one.law(one.sizes[0]), inputs[i][name], (seed, i, run))
        said = answer(diagnosed(one.plant, [recording]))
        rows.append({"key": (run, i), "plant": one.plant.name, "input": name, "answer": said})
        print(json.dumps(rows[-1]), flush=True)
        if kept:
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    return rows


def compared(rows: Sequence[dict[str, Any]], kept: Path | None) -> list[dict[str, Any]]:
    """Of every plant and input its rms, the predicted power and the answers."""
    found = []
    for one in HARD:
        aim, _ = aim_of(one, one.sizes[0], HARD_CANDIDATES)
        for name, u in hard_inputs(one, kept).items():
            half = u[: one.n]
            said = [row["answer"] for row in rows if (row["plant"], row["input"]) == (one.plant.name, name)]
            counts = {key: said.count(key) for key in sorted(set(said))}
            part = {"plant": one.plant.name, "input": name, "rms": float(np.std(u))}
            found.append({**part, "predicted": aim.power([half], one.sizes[0]), "answers": counts})
    return found


def predicted(one: Shown) -> list[tuple[float, float]]:
    """Of every size the expected evidence and the power, at the true parameters of the plant."""
    if one.rival:
        return [told_by(one, size) for size in one.sizes]
    # One effect at one place is searched: the shapes of the library that it is tried with are few.
    aim, _ = aim_of(one, one.sizes[0], 4)
    found = []
    for size in one.sizes:
        evidence = aim.evidence([one.inputs], size)
        found.append((evidence.evidence if evidence else np.nan, aim.power([one.inputs], size)))
    return found


def at_truth(plant: Plant) -> Any:
    m, d, c = plant.values
    return model(plant.name).with_theta({"J": m, "d": d} if plant is ROTOR else {"m": m, "d": d, "c": c})


def told_by(one: Shown, size: float) -> tuple[float, float]:
    """The expected ratio to the rival, and the power to tell the effect from it."""
    rivals = []
    for effect, value in zip(one.tried, (size, size), strict=True):
        name = effect.sizes[0].name
        flat = with_effect(
            at_truth(one.plant), effect, find_site(at_truth(one.plant), one.place, effect), {name: value}, {}
        )
        rivals.append(Rival(effect.name, flat, ("J", "d", f"effect.{name}")))
    aim, _ = rival_aim(rivals, one.plant.limits(one.n), [], 0.5 * GATES.same_bic, 0, draws=0)
    expected = replace(aim, orders=((0, 1),)).expected([one.inputs])  # the effect is the truth
    return (np.nan, np.nan) if expected is None else (expected.value, expected.power or 0.0)


def calibrated(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of every plant and size the predicted power, how often the effect was named, and the probability that a
    binomial number is that far off or farther."""
    found = []
    for i, one in enumerate(POWER):
        for j, (evidence, power) in enumerate(predicted(one)):
            own = [row for row in rows if row["key"][1:] == [i, j] or row["key"][1:] == (i, j)]
            named = sum(row["named"] for row in own)
            part = {"plant": one.plant.name, "size": one.sizes[j], "evidence": evidence, "predicted": power}
            tail = float(binomtest(named, len(own), power).pvalue) if own else np.nan
            ratio = float(np.mean([row["ratio"] for row in own if row["ratio"] is not None] or [np.nan]))
            found.append({**part, "ratio": ratio, "named": named, "recordings": len(own), "p": tail})
    return found


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    cases = [row for row in rows if "designed" in row]
    names = ("designed", "multisine", "random binary")
    right = {name: sum(row[name] in row["right"] for row in cases) for name in names}
    return {"recorded first": len(rows), "cases": len(cases), "decided rightly": right}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=["open", "small", "power", "hard"])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    given = parser.parse_args()
    if given.part == "power":
        rows = powers(given.runs, given.seed, given.json, given.minutes)
        print(json.dumps({"power": calibrated(rows), "machine": described()}, indent=2))
        return
    if given.part == "hard":
        rows = hard(given.runs, given.seed, given.json, given.minutes)
        print(json.dumps({"hard": compared(rows, given.json), "machine": described()}, indent=2))
        return
    kinds, second = {"open": (OPEN, told_apart), "small": (SMALL, detected)}[given.part]
    rows = cases(kinds, given.runs, given.seed, second, given.json, given.minutes)
    print(json.dumps({**summary(rows), "machine": described()}, indent=2))


if __name__ == "__main__":
    main()
