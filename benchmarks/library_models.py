"""Models of libraries, one after the other: which work, which are refused and why.

    python benchmarks/library_models.py LIST -L ~/modelica -L ~/books [--tsv FILE] [--only TEXT]

LIST holds one model a line: a group (any word) and the full name of the class. Each model is compiled,
linearised and simulated for a short time in a process of its own. A refusal counts as cryptic where its
message holds words of the compiler's inside (phases of the compiler, Rust types) or no remedy.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from daest.machine import described

LIMIT = 600  # seconds a model
SAMPLES, SPAN = 51, 1.0  # of the simulation, in seconds
CRYPTIC = ("failed in ToDae", "canonical DAE", "Flat semantic", "panicked", "expression shape mismatch")

_ONE = """
import json, sys, time, warnings
from pathlib import Path
import numpy as np
warnings.simplefilter("ignore")
from daest.errors import DaestError
from daest.modelica.compile import compile_text
from daest.systems.linearize import linearize
from daest.systems.simulate import simulate
name, libraries = sys.argv[1], sys.argv[2:]
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
    linearize(flat)
    told["seconds"][step] = time.process_time() - began
    step, began = "simulate", time.process_time()
    t = np.linspace(0, SPAN, SAMPLES)
    run = simulate(flat, (t, np.zeros((t.size, len(flat.inputs)))))
    told["seconds"][step] = time.process_time() - began
    told["method"] = run.method
    step = "done"
except DaestError as error:
    told["message"] = f"error[{error.code}]: {error.what}"
    told["remedy"], told["where"] = error.remedy or "", str(error.where or "")
except Exception as error:
    told["message"] = "crash: " + repr(error)
told["reached"] = step
print(json.dumps(told))
"""


def tried(name: str, libraries: list[str]) -> dict:
    """What became of one model."""
    code = _ONE.replace("SPAN", repr(SPAN)).replace("SAMPLES", repr(SAMPLES))
    try:
        made = subprocess.run(
            [sys.executable, "-c", code, name, *libraries], capture_output=True, text=True, timeout=LIMIT
        )
        return json.loads(made.stdout.splitlines()[-1])
    except subprocess.TimeoutExpired:
        return {"reached": "compile", "message": f"took longer than {LIMIT} s", "seconds": {}}
    except (IndexError, ValueError):
        return {"reached": "compile", "message": "crash: the process died", "seconds": {}}


def verdict(told: dict) -> str:
    """works, linearizes, refused, cryptic or crash."""
    message = told.get("message", "")
    if told["reached"] == "done":
        return "works"
    if message.startswith("crash"):
        return "crash"
    if any(word in message for word in CRYPTIC) or not told.get("remedy"):
        return "cryptic"
    return "linearizes" if told["reached"] == "simulate" else "refused"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("list", type=Path)
    parser.add_argument("-L", dest="libraries", action="append", default=[])
    parser.add_argument("--tsv", type=Path)
    parser.add_argument("--only", default="")
    chosen = parser.parse_args()
    print(described(), flush=True)
    libraries = [str(Path(one).resolve()) for one in chosen.libraries]
    count: dict[str, int] = {}
    lines = ["group\tclass\tverdict\tseconds\tmessage"]
    for line in chosen.list.read_text().splitlines():
        group, _, name = line.strip().partition(" ")
        if not name or chosen.only not in name:
            continue
        began = time.monotonic()
        told = tried(name, libraries)
        found = verdict(told)
        count[found] = count.get(found, 0) + 1
        message = told.get("message", told.get("method", "")).splitlines()[0]
        lines.append(f"{group}\t{name}\t{found}\t{time.monotonic() - began:.1f}\t{message}")
        print(lines[-1], flush=True)
    if chosen.tsv:
        chosen.tsv.write_text("\n".join(lines) + "\n")
    print(", ".join(f"{n} {what}" for what, n in sorted(count.items())))


if __name__ == "__main__":
    main()
