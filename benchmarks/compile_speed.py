"""Compiling and simulating models of the Standard Library, beside the compiler alone in one process.

    python benchmarks/compile_speed.py -L ~/modelica [--table FILE]

Each model in a process of its own: daest with an empty cache and with a filled one (compilation to equations
and linearisation), its simulation of one second; and the compiler that is built in, warm, which is asked for
the same class a second time, with its own simulation where it has one. Wall times in seconds, so a quiet
machine is needed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from daest.machine import described

MODELS = (
    "Modelica.Mechanics.Rotational.Examples.First",
    "Modelica.Mechanics.Rotational.Examples.CoupledClutches",
    "Modelica.Mechanics.MultiBody.Examples.Elementary.DoublePendulum",
    "Modelica.Electrical.Analog.Examples.CauerLowPassAnalog",
    "Modelica.Electrical.Analog.Examples.Rectifier",
    "Modelica.Electrical.Machines.Examples.DCMachines.DCPM_Start",
    "Modelica.Thermal.HeatTransfer.Examples.Motor",
    "Modelica.Blocks.Examples.PID_Controller",
)

_OURS = """
import json, sys, time, warnings
from pathlib import Path
import numpy as np
warnings.simplefilter("ignore")
from daest.errors import DaestError
from daest.modelica.compile import compile_text
from daest.systems.linear.linearize import linearize
from daest.systems.simulation.simulate import simulate
name, libraries = sys.argv[1], sys.argv[2:]
text = f"model Used extends {name}; end Used;".encode()
told = {}
for run in ("first", "again"):
    began = time.perf_counter()
    flat = compile_text(text, Path("Used.mo"), None, libraries)
    told[run] = time.perf_counter() - began
began = time.perf_counter()
linearize(flat)
told["linearize"] = time.perf_counter() - began
t = np.linspace(0, 1, 101)
for run in ("simulate", "simulate again"):
    began = time.perf_counter()
    simulate(flat, (t, np.zeros((t.size, len(flat.inputs)))))
    told[run] = time.perf_counter() - began
told["equations"] = flat.n
print(json.dumps(told))
"""
_COMPILER = """
import json, sys, time
import rumoca
name, libraries = sys.argv[1], sys.argv[2:]
session = rumoca.Session(roots=libraries)
told = {}
for run in ("first", "again"):
    began = time.perf_counter()
    try:
        model = session.loads(f"model {run} extends {name}; end {run};", model=run, filename=f"{run}.mo")
    except rumoca.RumocaError as problem:
        told["refused"] = str(problem).splitlines()[0][:80]
        break
    told[run] = time.perf_counter() - began
else:
    began = time.perf_counter()
    try:
        model.simulate(1.0)
        told["simulate"] = time.perf_counter() - began
    except Exception as problem:
        told["refused"] = type(problem).__name__
print(json.dumps(told))
"""


def run(script: str, arguments: list[str], **environment: str) -> dict[str, float]:
    """What a script tells in its last line; empty where it fails."""
    found = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=600,
    )
    lines = found.stdout.splitlines()
    return json.loads(lines[-1]) if found.returncode == 0 and lines else {}


def row(name: str, libraries: list[str]) -> str:
    with tempfile.TemporaryDirectory() as empty:
        ours = run(_OURS, [name, *libraries], DAEST_CACHE=empty)
    warm = run(_COMPILER, [name, *libraries])

    def told(values: dict[str, float], key: str) -> str:
        return f"{values[key]:.2f}" if key in values else "-"

    cells = [told(ours, key) for key in ("first", "again", "linearize", "simulate", "simulate again")]
    cells += [told(warm, key) for key in ("first", "again", "simulate")]
    return f"| {name.removeprefix('Modelica.')} | {ours.get('equations', '-')} | " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-L", dest="libraries", action="append", default=[], help="folder of libraries")
    parser.add_argument("--table", type=Path, help="write the table to this file")
    options = parser.parse_args()
    libraries = [str(Path(one).expanduser().resolve()) for one in options.libraries]
    lines = [
        described(("numpy", "casadi", "rumoca")),
        "",
        "| model | equations | compile, first | again | linearize | simulate, first | again "
        "| compiler alone, first | warm | its simulation |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in MODELS:
        lines.append(row(name, libraries))
        print(lines[-1], flush=True)
    if options.table:
        options.table.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
