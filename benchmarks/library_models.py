"""Models of libraries, one after the other: which work, which are refused and why.

    python benchmarks/library_models.py LIST -L ~/modelica -L ~/books [--references DIR] [--tsv FILE]
                                        [--only TEXT]

LIST holds one model a line: a group (any word) and the full name of the class. Each model is compiled,
linearised and simulated for a short time in a process of its own. A refusal counts as cryptic where its
message holds words of the compiler's inside (phases of the compiler, Rust types) or no remedy.

DIR holds reference results in the layout of the Modelica Association's MAP-LIB_ReferenceResults
(`A/B/Model/Model.csv` and `comparisonSignals.txt`). A model that has one is simulated over the span of its
reference, and the worst deviation of the compared signals is told in shares of each signal's range. Values
count as equal where the reference takes them within `WINDOW` of the span before or after, because references
are written at other instants than events. A signal that deviates by more than `MUCH` is another motion.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from daest.machine import described
from daest.model.experiment import Simulation

LIMIT = 600  # seconds a model
SAMPLES, SPAN = 51, 1.0  # of the simulation, in seconds
MOST_SAMPLES = 1500  # of a reference that are compared
WINDOW = 0.002  # of the span: the width of the tube of the Modelica Association's own tool
MUCH = 0.01  # of a signal's range; references were made with relative tolerances of 1e-4 to 1e-6
ZERO = 1e-9  # in a signal's own unit: what its reference does not tell from rest
CRYPTIC = ("failed in ToDae", "canonical DAE", "Flat semantic", "panicked", "expression shape mismatch")

_ONE = """
import json, sys, time, warnings
from pathlib import Path
import numpy as np
warnings.simplefilter("ignore")
from daest.errors import DaestError
from daest.modelica.compile import compile_text
from daest.systems.linear.linearize import linearize
from daest.systems.simulation.simulate import simulate
from library_models import compared
name, reference, libraries = sys.argv[1], sys.argv[2], sys.argv[3:]
short = "Use_" + name.rpartition(".")[2]
text = f"model {short}\\n  extends {name};\\nend {short};\\n".encode()
told = {"seconds": {}}
step = "compile"
try:
    began = time.process_time()
    flat = compile_text(text, Path(short + ".mo"), None, libraries)
    told["equations"], told["events"] = flat.n, flat.events is not None
    told["seconds"][step] = time.process_time() - began
    step, began = "linearize", time.process_time()
    try:
        linearize(flat)
    except DaestError as error:
        told["unlinear"] = f"error[{error.code}]: {error.what}"
    told["seconds"][step] = time.process_time() - began
    step, began = "simulate", time.process_time()
    t = np.linspace(0, SPAN, SAMPLES)
    if reference:
        table = np.genfromtxt(reference, delimiter=",", names=True, deletechars="", replace_space=" ")
        told["span"] = float(table[table.dtype.names[0]][-1])
        t = np.unique(table[table.dtype.names[0]])
        t = t[:: -(-t.size // MOST_SAMPLES)]
    run = simulate(flat, (t, np.zeros((t.size, len(flat.inputs)))))
    told["seconds"][step] = time.process_time() - began
    told["method"] = run.method
    if reference:
        told.update(compared(run, table, Path(reference).with_name("comparisonSignals.txt"), WINDOW))
    step = "done"
except DaestError as error:
    told["message"] = f"error[{error.code}]: {error.what}"
    told["remedy"], told["where"] = error.remedy or "", str(error.where or "")
except Exception as error:
    told["message"] = "crash: " + repr(error)
told["reached"] = step
print(json.dumps(told))
"""


def compared(run: Simulation, table: np.ndarray, chosen: Path, window: float) -> dict:
    """The worst deviation from a reference, of which signal, how many were compared, and which of those that
    should be are no variables of the run."""
    names = table.dtype.names
    wanted = chosen.read_text().split("\n")[1:] if chosen.exists() else names[1:]
    wanted = [name.strip() for name in wanted if name.strip() in names[1:]]
    columns = {name: run.variables[:, i] for i, name in enumerate(run.variable_names)}
    columns |= {name: run.outputs[:, i] for i, name in enumerate(run.output_names)}
    there = {name.replace(" ", ""): column for name, column in columns.items()}
    told: dict = {"deviation": 0.0, "signal": "", "compared": 0, "lacking": []}
    for name in wanted:
        if (own := there.get(name.replace(" ", ""))) is None:
            told["lacking"].append(name)
            continue
        told["compared"] += 1
        found = deviation(run.time, own, table[names[0]], table[name], window)
        if not found <= told["deviation"]:
            told["deviation"], told["signal"] = found, name
    return told


def deviation(t: np.ndarray, own: np.ndarray, when: np.ndarray, known: np.ndarray, window: float) -> float:
    """The largest distance of `own` at `t` from the values that `known` takes nearby, in shares of its
    range (of its size, where it hardly moves)."""
    width = window * (when[-1] - when[0])
    first = np.maximum(np.searchsorted(when, t - width) - 1, 0)
    last = np.minimum(np.searchsorted(when, t + width, side="right") + 1, when.size)
    low = np.array([known[a:b].min() for a, b in zip(first, last, strict=True)])
    high = np.array([known[a:b].max() for a, b in zip(first, last, strict=True)])
    span, size = float(np.ptp(known)), float(np.abs(known).max())
    scale = span if span > 1e-6 * size and span > ZERO else max(size, ZERO)
    return float(np.max(np.maximum(np.maximum(low - own, own - high), 0.0)) / scale)


def tried(name: str, libraries: list[str], references: Path | None = None) -> dict:
    """What became of one model."""
    values = {"SPAN": SPAN, "MOST_SAMPLES": MOST_SAMPLES, "SAMPLES": SAMPLES, "WINDOW": WINDOW}
    code = _ONE
    for word, value in values.items():
        code = code.replace(word, repr(value))
    last = name.rpartition(".")[2]
    reference = references / name.replace(".", "/") / f"{last}.csv" if references else None
    known = str(reference) if reference and reference.exists() else ""
    try:
        made = subprocess.run(
            [sys.executable, "-c", code, name, known, *libraries],
            capture_output=True,
            text=True,
            timeout=LIMIT,
            env=os.environ
            | {"PYTHONPATH": f"{Path(__file__).parent}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"},
        )
        return json.loads(made.stdout.splitlines()[-1])
    except subprocess.TimeoutExpired:
        return {"reached": "compile", "message": f"took longer than {LIMIT} s", "seconds": {}}
    except (IndexError, ValueError):
        return {"reached": "compile", "message": "crash: the process died", "seconds": {}}


def verdict(told: dict) -> str:
    """works, other (a motion that is not the reference's), simulates, linearizes, refused, cryptic,
    slow, crash."""
    message = told.get("message", "")
    if told["reached"] == "done" and "unlinear" in told:
        return "simulates"
    if told["reached"] == "done":
        return "other" if not told.get("deviation", 0.0) <= MUCH else "works"
    if message.startswith("crash"):
        return "crash"
    if message.startswith("took longer"):
        return "slow"
    if any(word in message for word in CRYPTIC) or not told.get("remedy"):
        return "cryptic"
    return "linearizes" if told["reached"] == "simulate" else "refused"


def against(told: dict) -> str:
    """The comparison with the reference in words."""
    if "deviation" not in told:
        return "-"
    lacking = f", without {', '.join(told['lacking'])}" if told["lacking"] else ""
    worst = f"{told['deviation']:.1e} ({told['signal']})" if told["signal"] else "0"
    return f"{worst}, {told['compared']} signals over {told['span']:g} s{lacking}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("list", type=Path)
    parser.add_argument("-L", dest="libraries", action="append", default=[])
    parser.add_argument("--references", type=Path)
    parser.add_argument("--tsv", type=Path)
    parser.add_argument("--only", default="")
    chosen = parser.parse_args()
    print(described(), flush=True)
    libraries = [str(Path(one).resolve()) for one in chosen.libraries]
    count: dict[str, int] = {}
    lines = ["group\tclass\tverdict\tseconds\tdeviation\tmessage"]
    for line in chosen.list.read_text().splitlines():
        group, _, name = line.strip().partition(" ")
        if not name or chosen.only not in name:
            continue
        began = time.monotonic()
        told = tried(name, libraries, chosen.references)
        found = verdict(told)
        count[found] = count.get(found, 0) + 1
        message = told.get("message", told.get("method", "")).splitlines()[0]
        lines.append(f"{group}\t{name}\t{found}\t{time.monotonic() - began:.1f}\t{against(told)}\t{message}")
        print(lines[-1], flush=True)
    if chosen.tsv:
        chosen.tsv.write_text("\n".join(lines) + "\n")
    print(", ".join(f"{n} {what}" for what, n in sorted(count.items())))


if __name__ == "__main__":
    main()
