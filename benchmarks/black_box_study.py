"""Seeded calibration of `diagnose` on an FMU without equations: false alarms and hits on known truths.

    python benchmarks/black_box_study.py [--case NAME ...] [--runs N] [--seed N] [--samples N] [--jobs N]
                                         [--json FILE] [--table FILE] [--list]

The spring servo is exported, and its equations are taken out of the FMU: what is left is a binary with an
input, two outputs and four states. The records are those of `diagnosis_study.py`, from its own simulators,
with effects at the input and at the outputs, which can be named from outside, and with effects between the
parts, which cannot. `--json` keeps one line per run, and runs that are in it are not done again; `--table
docs/black_box_rates.json` writes the rates that the documentation shows.
"""

from __future__ import annotations

import json
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path

import diagnosis_study
import numpy as np
from diagnosis_study import EXCITATIONS, SIZES, Case, Rate, arguments, chosen, keep, limits, servo_truth

from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.without_equations.black_box import diagnose_black_box
from daest.errors import DaestError
from daest.estimation.fitting.records import part_of
from daest.fmu.binary_model import binary_model
from daest.fmu.export import export_fmu
from daest.machine import described
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel
from daest.modelica.effects.catalogue import effect_library
from daest.numerics.parallel import workers
from daest.report.documents.diagnose import document

# Faults of sensors at size 1: what is done to the outputs (omega, phi) of a record.
FAULTS: dict[str, Callable[[np.ndarray, np.ndarray, float], np.ndarray]] = {
    "offset-omega": lambda y, t, size: y + size * np.array([0.1, 0.0]),
    "drift-phi": lambda y, t, size: y + size * 0.1 * (t / t[-1])[:, None] * np.array([0.0, 1.0]),
    "gain-omega": lambda y, t, size: y * (1.0 + size * np.array([0.1, 0.0])),
}


def _named(name: str, values: dict[str, float], scaled: str, names: Sequence[str], site: str) -> Case:
    return Case(name, "named", "servo", values, (scaled,), tuple(names), (site,))


def _inside(name: str, values: dict[str, float], scaled: str, law: str = "", variable: str = "") -> Case:
    return Case(name, "inside", "servo", values, (scaled,), (law,), (f"u ({variable})",))


# Names and places that count as right: the law, and the state that it follows. Between the parts the place is
# wrong in any case.
CASES = (
    Case("nothing", "nothing", "servo"),
    Case("load", "load", "servo", {"load": 0.05, "load_T": 0.5}, ("load",)),
    _named("coulomb-motor", {"coulomb_1": 0.6}, "coulomb_1", ["CoulombFriction"], "u (motor.w)"),
    _named("drag-motor", {"drag_1": 0.15}, "drag_1", ["QuadraticDrag"], "u (motor.w)"),
    _named("voltage-offset", {"bias": 0.8}, "bias", ["ConstantLoad"], "u"),
    _named("supply", {"sag": 0.6}, "sag", ["MeasuredInput"], "u (sag)"),
    _named("deadzone", {"deadzone": 1.5}, "deadzone", ["DeadZone"], "u"),
    _named("saturation", {"cut": 2.0}, "cut", ["Saturation"], "u"),
    _named("offset-omega", {}, "", ["Offset"], "omega"),
    _named("drift-phi", {}, "", ["Drift"], "phi"),
    _named("gain-omega", {}, "", ["Gain"], "omega"),
    _inside("coulomb-disc", {"coulomb_2": 0.1}, "coulomb_2", "CoulombFriction", "disc.w"),
    _inside("drag-disc", {"drag": 0.02}, "drag", "QuadraticDrag", "disc.w"),
    _inside("unbalance-disc", {"unbalance": 0.2}, "unbalance", "Unbalance", "disc.phi"),
    _inside("hardening", {"c3": 10.0}, "c3"),
    _inside("backlash", {"gap": 0.1}, "gap"),
)


@dataclass(frozen=True)
class Run:
    """The outcome of one record. `right`: the true effect at the true place is among what is named."""

    case: str
    group: str
    excitation: str
    size: float
    seed: int
    samples: int
    verdict: str
    claimed: tuple[str, ...]
    is_right: bool
    p_value: float | None
    seconds: float

    @property
    def key(self) -> tuple:
        return self.case, self.seed, self.samples


@cache
def box() -> FlatModel:
    """The servo as an FMU without its equations."""
    folder = Path(tempfile.mkdtemp(prefix="daest-study-"))
    export_fmu(diagnosis_study.model("servo"), folder / "full.fmu")
    with zipfile.ZipFile(folder / "full.fmu") as full, zipfile.ZipFile(folder / "servo.fmu", "w") as bare:
        for entry in full.infolist():
            if not entry.filename.startswith("extra/"):
                bare.writestr(entry, full.read(entry))
    return binary_model(folder / "servo.fmu")


def record(case: Case, kind: str, size: float, samples: int, seed: int) -> Experiment:
    made = servo_truth(case, kind, size, samples, seed).experiment
    fault = FAULTS.get(case.name)
    return made if fault is None else replace(made, outputs=fault(made.outputs, made.time, size))


def halves(e: Experiment) -> list[Experiment]:
    """The one to fit, and the one to validate."""
    cut, n = e.n_samples // 2, e.n_samples
    parts = (part_of(e, 0, cut), part_of(e, cut, n))
    return [replace(part, name=f"{e.name} {i + 1}") for i, part in enumerate(parts)]


def one_run(task: tuple[str, int, int]) -> Run:
    name, seed, samples = task
    case = next(case for case in CASES if case.name == name)
    warnings.simplefilter("ignore")
    kind, size = EXCITATIONS[seed % 3], SIZES[seed // 3 % 3]
    own = int(np.random.SeedSequence([seed, *case.name.encode()]).generate_state(1)[0])
    first, second = halves(record(case, kind, size, samples, own))
    flat = box()
    began = time.perf_counter()
    try:
        options = DiagnoseOptions(hold="zoh", jobs=1)
        found = document(diagnose_black_box(flat, effect_library(), [first], [second], options))
    except DaestError as error:
        found = {"verdict": f"error {error.code}", "candidates": [], "screen": {"p_value": None}}
    accepted = [c for c in found["candidates"] if c["verdict"] != "rejected"]
    return Run(
        name, case.group, kind, size, seed, samples, found["verdict"],
        tuple(f"{c['effect']} at {c['at']}" for c in accepted),
        any(c["effect"] in case.names and c["at"] in case.sites for c in accepted),
        found["screen"]["p_value"], round(time.perf_counter() - began, 2),
    )  # fmt: skip


# Report -----------------------------------------------------------------------------------------------------

GROUPS = {
    "nothing": "nothing missing",
    "load": "coloured external load",
    "named": "effect at the input or an output",
    "inside": "effect between the parts",
}
CALM = ("nothing missing", "parameters off")
HONEST = (*CALM, "external disturbance", "unknown effect")


def rates(runs: Sequence[Run]) -> list[Rate]:
    """What is asked of each group that was run."""
    found: list[Rate] = []

    def ask(group: str, what: str, among: Sequence[Run], hit: Callable[[Run], bool]) -> None:
        if among:
            found.append(Rate(GROUPS[group], what, sum(map(hit, among)), len(among)))

    nothing, load, named, inside = ([r for r in runs if r.group == group] for group in GROUPS)
    ask("nothing", "other verdicts", nothing, lambda r: r.verdict not in CALM)
    ask("nothing", "an effect named", nothing, lambda r: bool(r.claimed))
    ask("load", "an effect named", load, lambda r: bool(r.claimed))
    ask("named", "right where claimed", [r for r in named if r.claimed], lambda r: r.is_right)
    for size in SIZES:
        ask("named", f"right of all, size {size}", [r for r in named if r.size == size], lambda r: r.is_right)
    ask("inside", "another law named", inside, lambda r: bool(r.claimed) and not r.is_right)
    ask("inside", "its law named, as if at the input", inside, lambda r: r.is_right)
    ask("inside", "told as nothing missing", inside, lambda r: r.verdict in CALM)
    return found


def report(runs: Sequence[Run]) -> str:
    seconds = [r.seconds for r in runs]
    lines = [f"{len(runs)} runs, {np.median(seconds):.1f} s each (median), {max(seconds):.1f} s at most"]
    group = ""
    for rate in rates(runs):
        lines += [rate.group] if rate.group != group else []
        group = rate.group
        lines.append(str(rate))
    lines.append("by case")
    for case in dict.fromkeys(r.case for r in runs):
        some = [r for r in runs if r.case == case]
        verdicts = ", ".join(f"{name} {n}" for name, n in Counter(r.verdict for r in some).most_common())
        names = Counter(name for r in some for name in r.claimed)
        told = "; ".join(f"{name} {n}" for name, n in names.most_common())
        lines.append(f"  {case}: right {sum(r.is_right for r in some)} of {len(some)}; {verdicts} [{told}]")
    return "\n".join(lines)


def table(runs: Sequence[Run]) -> dict:
    """All rates as a document."""
    return {
        "n_runs": len(runs),
        "samples": sorted({r.samples for r in runs}),
        "sizes": SIZES,
        "seconds": round(float(np.median([r.seconds for r in runs])), 1),
        "rates": [
            asdict(r) | dict(zip(("low", "high"), (round(x, 4) for x in limits(r.hits, r.runs)), strict=True))
            for r in rates(runs)
        ],
        "cases": [_row(case, [r for r in runs if r.case == case.name]) for case in CASES],
    }


def _row(case: Case, runs: Sequence[Run]) -> dict:
    return {
        "case": case.name,
        "group": GROUPS[case.group],
        "runs": len(runs),
        "right": sum(r.is_right for r in runs) if case.group == "named" else None,
        "verdicts": dict(Counter(r.verdict for r in runs).most_common()),
    }


# Command ----------------------------------------------------------------------------------------------------


def kept(path: Path | None) -> list[Run]:
    if path is None or not path.exists():
        return []
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [Run(**{**line, "claimed": tuple(line["claimed"])}) for line in lines]


def main() -> None:
    parser = arguments(__doc__, "docs/black_box_rates.json")
    options = parser.parse_args()
    cases = chosen(options.case, CASES)
    if options.list:
        print("\n".join(f"{case.group:8} {case.name}" for case in cases))
        return
    print(described(), flush=True)
    runs = kept(options.json)
    done = {run.key for run in runs}
    tasks = [
        (case.name, seed, options.samples)
        for seed in range(options.seed, options.seed + options.runs)
        for case in cases
        if (case.name, seed, options.samples) not in done
    ]
    with workers(options.jobs, None) as pool:
        runs += [o.get() for o in pool.map(one_run, tasks, arrived=partial(keep, options.json))]
    if runs:
        print(report(runs))
        if options.table:
            options.table.write_text(
                json.dumps({**table(runs), "measured": described()}, indent=1) + "\n", encoding="utf-8"
            )


if __name__ == "__main__":
    import black_box_study  # what belongs to __main__ is unknown to other processes

    black_box_study.main()
