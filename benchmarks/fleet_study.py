"""How `daest fleet` does on servos with spread parameters, some with dry friction, some with backlash.

    python benchmarks/fleet_study.py FOLDER [--machines N] [--friction N] [--backlash N] [--samples N]
                                            [--seed N]
    daest fleet FOLDER/machines --model examples/servo/Servo.mo --format json -o FOLDER/fleet.json
    python benchmarks/fleet_study.py FOLDER --judge FOLDER/fleet.json

The first line writes a recording for each machine and `truth.json`; the last holds the result against the
truth: recall and precision of the verdict and of the names, coverage of the parameters, seconds a machine.
The simulator is that of `watch_study`, which shares nothing with daest.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from watch_study import NAMES, NOMINAL, stream

from daest.machine import described

PARAMETERS = ("d", "c", "J1", "J2", "k")
SPREAD = (0.3, 0.1, 0.05, 0.1, 0.03)  # standard deviations of the logarithms over the fleet
SIZES = {"friction": (0.02, 0.1), "backlash": (0.02, 0.1)}  # log-uniform, N.m and rad


def write_fleet(folder: Path, wanted: argparse.Namespace) -> None:
    """The recordings as CSV in `folder`/machines; the effects are at random places of the fleet."""
    rng = np.random.default_rng(wanted.seed)
    effects = ["friction"] * wanted.friction + ["backlash"] * wanted.backlash
    effects += ["nothing"] * (wanted.machines - len(effects))
    place = folder / "machines"
    place.mkdir(parents=True, exist_ok=True)
    truth = {}
    for i, effect in enumerate(rng.permutation(effects)):
        values = np.array(NOMINAL) * np.exp(np.array(SPREAD) * rng.standard_normal(len(SPREAD)))
        low, high = np.log(SIZES.get(str(effect), (1.0, 1.0)))
        size = float(np.exp(rng.uniform(low, high))) if effect != "nothing" else 0.0
        record = stream(
            str(effect), size, wanted.samples, wanted.seed * 100_000 + i, parameters=values, begins=0
        )
        name = f"m{i:05d}"
        table = np.column_stack([record.time, record.inputs, record.outputs])
        head = "time [s],u [V],omega [rad/s],phi [rad]"
        np.savetxt(place / f"{name}.csv", table, fmt="%.7g", delimiter=",", header=head, comments="")
        truth[name] = {
            "effect": str(effect),
            "size": size,
            "parameters": dict(zip(PARAMETERS, values, strict=True)),
        }
    (folder / "truth.json").write_text(json.dumps(truth))


def judge(machines: list[dict[str, Any]], truth: dict[str, Any]) -> None:
    """Print what the fleet found beside what is true."""
    done = [m for m in machines if m["verdict"] is not None]
    print(f"{len(machines)} machines, {len(machines) - len(done)} without a verdict")
    wrong = {m["name"] for m in done if m["verdict"] != "not falsified"}
    has = {m["name"] for m in done if truth[m["name"]]["effect"] != "nothing"}
    print(f"falsified: {len(wrong)}; recall {len(wrong & has)} of {len(has)}, false {len(wrong - has)}")
    for effect in SIZES:
        true = {name for name in has if truth[name]["effect"] == effect}
        named = {m["name"] for m in done if m["effect"] in NAMES[effect]}
        right = len(true & named)
        print(f"{effect}: recall {right} of {len(true)}, precision {right} of {len(named)}")
        missed = [m for m in done if m["name"] in true - named]
        print(f"   missed: {dict(Counter(str(m['effect'] or m['verdict']) for m in missed))}")
        found = [m for m in done if m["name"] in true & named and m["size"]]
        if found:
            low, middle, high = np.quantile(
                [m["size"] / truth[m["name"]]["size"] for m in found], [0, 0.5, 1]
            )
            print(f"   size found / true: median {middle:.3f}, {low:.3f} to {high:.3f}")
    others = Counter(m["effect"] for m in done if m["effect"] and m["name"] not in has)
    print(f"named where nothing is missing: {dict(others)}")
    whole = [m for m in done if m["verdict"] == "not falsified" and m["name"] not in has]
    for name in PARAMETERS:
        pairs = [(m["parameters"][name], truth[m["name"]]["parameters"][name]) for m in whole]
        inside = np.mean([abs(p["value"] - t) < 1.96 * p["std_error"] for p, t in pairs])
        print(f"{name}: 95 % interval holds the truth in {100 * inside:.1f} %")
    seconds = {kind: [m["seconds"] for m in done if (m["name"] in wrong) == kind] for kind in (False, True)}
    for kind, values in seconds.items():
        if values:
            word = "falsified" if kind else "not falsified"
            print(f"{word}: {np.mean(values):.2f} s a machine, at most {np.max(values):.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--machines", type=int, default=1000)
    parser.add_argument("--friction", type=int, default=50)
    parser.add_argument("--backlash", type=int, default=30)
    parser.add_argument("--samples", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--judge", type=Path)
    wanted = parser.parse_args()
    print(described(), flush=True)
    if wanted.judge is None:
        write_fleet(wanted.folder, wanted)
        return
    truth = json.loads((wanted.folder / "truth.json").read_text())
    judge(json.loads(wanted.judge.read_text())["machines"], truth)


if __name__ == "__main__":
    main()
