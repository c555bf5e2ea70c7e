"""How `daest watch` does on simulated streams: false alarms, delay by size of the effect, the right name.

    python benchmarks/watch_study.py [--streams N] [--quiet N] [--diagnosed N] [--effects NAME ...]
                                     [--seed N] [--jobs N] [--json FILE]

The servo of `examples/servo` runs for 20 s as its model says, then an effect sets in, at three sizes: dry
friction on the disc, backlash in the spring, a constant torque, drag that grows with the square of the speed,
an inertia of the disc that is larger by a share, or an accidental torque from outside with a correlation time
of 1 s, which no law names. `--quiet N` streams have none, and give the rate of false alarms. The plant is
integrated by small semi-implicit steps, which share nothing with daest. The first `--diagnosed` streams of
every effect and size are diagnosed, too, where there was an alarm.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from diagnosis_study import excitation

from daest.diagnosis.changed import diagnose_change
from daest.diagnosis.options import DiagnoseOptions
from daest.errors import DaestError
from daest.estimation.fitting.records import part_of
from daest.estimation.streaming.change import Usual, threshold_for
from daest.estimation.streaming.online_filter import online_filter
from daest.estimation.streaming.watch import QUIET, Alarm, Watch, before_change
from daest.machine import described
from daest.model.estimates import FilterOptions, Sample
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library
from daest.numerics.compiler import build_shared, pointer
from daest.numerics.parallel import workers

ROOT = Path(__file__).resolve().parents[1]
PERIOD, BEGINS, SAMPLES, QUIET_SAMPLES, WINDOW = 0.01, 2000, 4000, 10_000, 2000
SIZES = {
    "friction": (0.002, 0.01, 0.05),
    "backlash": (0.002, 0.01, 0.05),
    "constant": (0.002, 0.01, 0.05),
    "drag": (0.0005, 0.002, 0.01),
    "inertia": (0.02, 0.1, 0.3),
    "outside": (0.002, 0.01, 0.05),
}
NAMES = {
    "friction": ("CoulombFriction", "StribeckFriction", "LuGreFriction"),
    "backlash": ("Backlash",),
    "constant": ("ConstantLoad", "Offset"),
    "drag": ("QuadraticDrag",),
    "inertia": ("parameters off", "ExtraInertia"),
    "outside": ("external disturbance",),
}
OPEN = ("cannot tell", "external disturbance", "unknown effect")  # verdicts without a name
CORRELATION = 1.0  # s, of the torque from outside
AVERAGE_RUN = 20_000.0
NOMINAL = (0.02, 1.5, 6.3e-6, 0.02, 0.06)  # d, c, J1, J2, k
SUBSTEPS = 400  # of the simulator, whose steps are of first order


@cache
def model() -> Any:
    return compile_model(ROOT / "examples" / "servo" / "Servo.mo")


SOURCE = """
#include <math.h>
static double soft(double v, double t) { return v > 0 ? fmax(v - t, 0.0) : fmin(v + t, 0.0); }
/* p: d, c, J1, J2, k of the servo; the gear ratio is 30 */
void simulate(long n, long m, double period, const double *p, const double *u, const double *kicks,
              long begins, double gap, double dry_size, double push_size, double drag_size, double growth,
              double *y) {
    double d = p[0], c = p[1], J1 = 900 * p[2], J2 = p[3], torque = 30 * p[4], R = 4.31617, dt = period / m;
    double w1 = 0, a1 = 0, w2 = 0, a2 = 0;
    for (long k = 0; k < n; k++) {
        y[2 * k] = w1, y[2 * k + 1] = a2;
        double half = k < begins ? 0 : gap / 2, dry = k < begins ? 0 : dry_size;
        double push = k < begins ? 0 : push_size, drag = k < begins ? 0 : drag_size;
        if (k == begins) J2 *= 1 + growth;
        for (long j = 0; j < m; j++) {
            double x = a1 - a2, spring = c * soft(x, half) + (fabs(x) >= half ? d * (w1 - w2) : 0);
            if (half > 0 && spring * x < 0) spring = 0;
            double n1 = w1 + dt * (torque * (u[k] - torque * w1) / R - spring) / J1;
            double load = push + drag * w2 * fabs(w2);
            double n2 = soft(w2 + (dt * (spring - load) + kicks[m * k + j]) / J2, dt * dry / J2);
            a1 += dt * (w1 + n1) / 2, a2 += dt * (w2 + n2) / 2, w1 = n1, w2 = n2;
        }
    }
}
"""


@cache
def library() -> ctypes.CDLL:
    return ctypes.CDLL(str(build_shared(SOURCE, "watch_study", ("-O2",))))


def stream(
    effect: str,
    size: float,
    n: int,
    seed: int,
    *,
    parameters: Sequence[float] = NOMINAL,
    begins: int = BEGINS,
) -> Experiment:
    """The servo with an effect from sample `begins` on. The white torque is drawn for every substep."""
    rng = np.random.default_rng(seed)
    u = np.ascontiguousarray(6.0 * excitation("noise", n, PERIOD, 0.5, rng))
    kicks = rng.standard_normal((n, SUBSTEPS)) * np.sqrt(1e-6 * PERIOD / SUBSTEPS)
    if effect == "outside":
        kicks[begins:] += (PERIOD / SUBSTEPS * size * _accidental(n - begins, rng))[:, None]
    y = np.zeros((n, 2))
    named = ("backlash", "friction", "constant", "drag", "inertia")
    sizes = [size if effect == name else 0.0 for name in named]
    library().simulate(
        ctypes.c_long(n), ctypes.c_long(SUBSTEPS), ctypes.c_double(PERIOD), pointer(np.array(parameters)),
        pointer(u), pointer(kicks), ctypes.c_long(begins), *map(ctypes.c_double, sizes), pointer(y),
    )  # fmt: skip
    y += rng.standard_normal((n, 2)) * (0.02, 0.01)
    return Experiment(effect, np.arange(n) * PERIOD, u[:, None], y, ("u",), ("omega", "phi"))


def _accidental(n: int, rng: np.random.Generator) -> np.ndarray:
    """Normal values with unit variance at the samples, correlated over CORRELATION."""
    keep = np.exp(-PERIOD / CORRELATION)
    values = rng.standard_normal(n)
    values[1:] *= np.sqrt(1.0 - keep**2)
    for k in range(1, n):
        values[k] += keep * values[k - 1]
    return values


def run(task: tuple[str, float, int, bool, float]) -> dict[str, Any]:
    """One stream: alarms before the change, delay [samples] of the first after it, name of the effect."""
    effect, size, seed, names_it, threshold = task
    began = time.perf_counter()
    n = QUIET_SAMPLES if effect == "nothing" else SAMPLES
    record = stream(effect, size, n, seed)
    online = online_filter(model(), PERIOD, options=FilterOptions(hold="zoh"))
    watch = Watch(online.output_names, Usual.white(2), threshold)
    state, memory, false, delay, alarms = watch.begin(), online.begin(), 0, None, []
    for k in range(n):
        memory, estimate = online.advance(memory, Sample(k * PERIOD, record.inputs[k], record.outputs[k]))
        state, alarm = watch.look(state, estimate)
        if alarm is None:
            continue
        if k < BEGINS or effect == "nothing":
            false += 1
        else:
            alarms.append(alarm)
            delay = k - BEGINS if delay is None else delay
    found = _named(record, alarms) if names_it and alarms else None
    seconds = time.perf_counter() - began
    return {"effect": effect, "size": size, "seed": seed, "false": false, "delay": delay,
            "found": found, "seconds": seconds}  # fmt: skip


def _named(record: Experiment, alarms: Sequence[Alarm]) -> dict[str, Any]:
    """What `daest watch --diagnose` tells of the first alarm after the change."""
    began, first = time.process_time(), alarms[0]
    since = first.since
    samples = [Sample(*row) for row in zip(record.time.tolist(), record.inputs, record.outputs, strict=True)]
    usual = part_of(record, 0, len(before_change(samples, first)))
    begins = int(np.searchsorted(record.time, since))
    after = part_of(record, begins, min(begins + WINDOW, record.n_samples))
    lasts = any(alarm.time <= after.time[-1] for alarm in alarms[1:])
    options = DiagnoseOptions(hold="zoh", jobs=1, fitted={p.name: p.value for p in model().parameters})
    told: dict[str, Any] = {"since": since}
    try:
        found = diagnose_change(model(), effect_library(()), usual, after, options, lasts)
    except DaestError as problem:
        return {**told, "verdict": "cannot tell", "effect": None, "message": problem.what}
    best = next((p.candidate for p in found.proofs if p.verdict == "supported"), None)
    told |= {"verdict": found.verdict, "message": found.message}
    told["effect"] = None if best is None else best.effect.name
    told["at"] = None if best is None else best.site.name
    told["open"] = [p.candidate.label for p in found.proofs if p.verdict == "not separable"]
    return {**told, "processor_seconds": time.process_time() - began}


def judged(effect: str, found: dict[str, Any]) -> str:
    """Whether a diagnosis is right, wrong, or leaves the name open."""
    answer = found["effect"] or found["verdict"]
    if answer in NAMES[effect]:
        return "right"
    return "open" if found["effect"] is None and found["verdict"] in OPEN else "wrong"


def tasks(arguments: argparse.Namespace, threshold: float) -> Iterator[tuple[str, float, int, bool, float]]:
    for i in range(arguments.quiet):
        yield "nothing", 0.0, arguments.seed + i, False, threshold
    cells = [(effect, size) for effect in arguments.effects for size in SIZES[effect]]
    for i in range(arguments.streams):
        effect, size = cells[i % len(cells)]
        names_it = i // len(cells) < arguments.diagnosed
        yield effect, size, arguments.seed + 10_000 + i, names_it, threshold


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--streams", type=int, default=200)
    parser.add_argument("--quiet", type=int, default=50)
    parser.add_argument("--diagnosed", type=int, default=5)
    parser.add_argument("--effects", nargs="+", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    print(described(), flush=True)
    threshold = threshold_for(Usual.white(2), AVERAGE_RUN - QUIET)
    print(f"threshold {threshold:.3f} nats for {AVERAGE_RUN:g} samples between false alarms", flush=True)
    results = []
    todo = list(tasks(arguments, threshold))
    with workers(arguments.jobs) as pool:
        for outcome in pool.map(run, todo):
            results.append(outcome.get())
            if arguments.json:
                with arguments.json.open("a") as file:
                    file.write(json.dumps(results[-1]) + "\n")
    report(results)


def report(results: list[dict[str, Any]]) -> None:
    quiet = [r for r in results if r["effect"] == "nothing"]
    before = [r for r in results if r["effect"] != "nothing"]
    n = QUIET_SAMPLES * len(quiet) + BEGINS * len(before)
    print(f"false alarms: {sum(r['false'] for r in results)} in {n} samples; promised {n / AVERAGE_RUN:.1f}")
    for effect, sizes in SIZES.items():
        for size in sizes:
            cell = [r for r in before if (r["effect"], r["size"]) == (effect, size)]
            delays = [r["delay"] for r in cell if r["delay"] is not None]
            told = [r["found"] for r in cell if r["found"] is not None]
            counted = dict(Counter(judged(effect, found) for found in told))
            others = Counter(
                str(found["effect"] or found["verdict"]) for found in told if judged(effect, found) != "right"
            )
            middle = f"median delay {np.median(delays):.0f} samples" if delays else "-"
            share = f"alarm in {len(delays)} of {len(cell)}, {middle}"
            print(f"{effect} {size}: {share}; diagnosed {len(told)}: {counted} {dict(others) or ''}")


if __name__ == "__main__":
    main()
