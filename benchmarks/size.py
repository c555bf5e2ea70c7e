"""Time and memory of the noise verdicts of large models: the sparse form beside the dense staircase and
ordered QZ (SciPy; the generalized Schur form that the report, and descriptor toolboxes, begin with).

Each case runs in a process of its own, so that its memory is its own; times are processor time. At the end
stands the exponent of the time of each way over the sizes from 2000 equations on. `--json FILE` keeps the
numbers. The Modelica compiler takes minutes for models above 20 000 equations.
python-control has no descriptor systems of its own.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
from trains import train

import daest
from daest.machine import described

MODELS = Path(__file__).parents[1] / "tests" / "systems" / "models"
SIZES = {
    "Chain": (12, 30, 59, 118, 294, 588, 1176, 2941, 5882),
    "Ladder": (16, 42, 83, 167, 417, 833),
    "Resistors": (16, 42, 83, 167, 417, 833),
    "Grid": (4, 7, 9, 12, 18, 21, 29, 46, 66),
    "Rigid": (14, 72, 143, 286, 1428),
    "Gears": (10, 50, 99, 198, 714),
    "long chain": (118, 294, 588, 1176, 2941, 5882),
    "rigid train": (72, 143, 286, 714),
}
TRAINS = {"long chain": "Chain", "rigid train": "Rigid"}
"""Models that are written down as equations, without the Modelica compiler."""

ABOVE_FINITE = 1e9
"""Eigenvalues of a scaled pencil beyond this size count as infinite in ordered QZ: it has no better way."""

FITTED_FROM = 2000
"""Equations from which on times are fitted by a power of their number."""

RELATIVE = 1e-9
"""Part of the largest derivative that counts as none, as in `daest.systems.linear.noise`."""

SAMPLES, PERIOD = 2000, 0.02
"""Length [samples] and period [s] of the records that are filtered."""

LONGEST = 60.0
"""A way is left out where its last time, grown with the third power of the size, exceeds these seconds."""


def model(name: str, n: int) -> daest.LinearDAE:
    """A compiled model, or one of `TRAINS` as equations."""
    if name in TRAINS:
        return daest.linearize(train(TRAINS[name], n))
    return daest.linearize(daest.compile_model(MODELS / f"{name}.mo", overrides={"n": n}))


def by_sparse_form(dae: daest.LinearDAE) -> dict[str, object]:
    from daest.systems.linear.sparse_form import sparse_form

    return _verdicts(daest.noise_report(dae, sparse_form(dae)))


def by_staircase(dae: daest.LinearDAE) -> dict[str, object]:
    from daest.systems.linear.split import split

    return _verdicts(daest.noise_report(dae, split(dae)))


def by_ordered_qz(dae: daest.LinearDAE) -> dict[str, object]:
    """Report, section 2: ordered generalized Schur form, Sylvester equation, Theorem 3.1 row by row."""
    from daest.numerics.pencils import apply_scaling, equilibrate

    E, J = (sp.csr_array(part).toarray() for part in (dae.E, dae.J))
    scaling = equilibrate(E, J)
    E, J = apply_scaling(scaling, E, J)
    S, T, alpha, beta, left, _ = sla.ordqz(J, E, sort=lambda a, b: np.abs(a) < ABOVE_FINITE * np.abs(b))
    n1 = int(np.count_nonzero(np.abs(alpha) < ABOVE_FINITE * np.abs(beta)))
    J2 = S[n1:, n1:]
    P2, N = np.linalg.solve(J2, left.T[n1:]), np.linalg.solve(J2, np.triu(T[n1:, n1:], 1))
    reach = np.linalg.norm(N @ P2, axis=0)
    forbidden = np.flatnonzero(reach > RELATIVE * max(reach.max(initial=0), 1))
    return {"forbidden": forbidden.tolist(), "n_dynamic": n1}


def by_slicot(dae: daest.LinearDAE) -> dict[str, object]:
    """SLICOT's AG08BD through slycot: the staircase that descriptor toolboxes publish; modes, no verdicts."""
    import slycot

    E, J = (sp.csr_array(part).toarray() for part in (dae.E, dae.J))
    n = dae.n
    none = np.zeros((n, 1)), np.zeros((1, n)), np.zeros((1, 1))  # m = p = 0; the wrapper wants one column
    finite, *_ = slycot.ag08bd(n, n, 0, 0, J, E, *none)
    return {"forbidden": None, "n_dynamic": len(finite)}


WAYS = {
    "sparse": by_sparse_form,
    "staircase": by_staircase,
    "ordered QZ": by_ordered_qz,
    "SLICOT": by_slicot,
}


def _verdicts(report: daest.NoiseReport) -> dict[str, object]:
    forbidden = [i for i, place in enumerate(report.places) if not place.admissible]
    return {"forbidden": forbidden, "n_dynamic": report.n_dynamic, "index": report.index}


def one(name: str, n: int, way: str) -> dict[str, object]:
    """Numbers of one case, in this process; memory is the growth of its peak over that of compiling."""
    dae = model(name, n)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.process_time()
    answer = WAYS[way](dae)
    seconds = time.process_time() - started
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    memory = {"peak_gb": after / 1e6, "added_gb": (after - before) / 1e6}
    return {"n": dae.n, "seconds": seconds, **memory, **answer}


def one_filter(name: str, n_states: int, kind: str) -> dict[str, object]:
    """Numbers of one filter run in this process: noise on the input, one output, an unknown start."""
    from daest.estimation.filter import run_filter
    from daest.model.estimates import FilterOptions
    from daest.systems.linear.state_space import state_space, state_space_family

    n = n_states // 2 if name == "Chain" else n_states
    flat = daest.compile_model(MODELS / f"{name}.mo", overrides={"n": n})
    ss = state_space(state_space_family(flat), flat.theta_values)
    ss = dataclasses.replace(ss, G=ss.B[:, :1], H=ss.D[:, :1], W=ss.U[:, :1], noise_names=("noise",))
    time_, rng = PERIOD * np.arange(SAMPLES), np.random.default_rng(0)
    u, y = np.sign(np.sin(0.2 * time_))[:, None], 1e-3 * rng.standard_normal((SAMPLES, 1))
    experiment = daest.Experiment("size", time_, u, y, ss.input_names, ss.output_names)
    started = time.perf_counter()
    run_filter(
        ss,
        experiment,
        kind,
        FilterOptions(process_intensity=np.array([1e-3]), measurement_cov=np.array([1e-6])),
    )
    seconds = time.perf_counter() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return {"n_states": ss.A.shape[0], "n": flat.n, "seconds": seconds, "peak_gb": peak}


def filters(largest: int) -> None:
    """Time and memory of filters over `SAMPLES` samples, each in a process of its own."""
    for name in ("Chain", "Ladder"):
        for n_states in (n for n in (100, 300, 1000) if n <= largest):
            for kind in ("stationary", "time-varying"):
                command = [sys.executable, __file__, "--one-filter", name, str(n_states), kind]
                found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
                print(
                    f"{name:10} {found['n_states']:5} states  {kind:12} {found['seconds']:8.2f} s  "
                    f"{found['peak_gb']:5.2f} GB",
                    flush=True,
                )


def separate(name: str, n: int, way: str) -> dict[str, object] | str:
    """`one` in a process of its own; a sentence where it failed."""
    command = [sys.executable, __file__, "--one", name, str(n), way]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20 * LONGEST)
    except subprocess.TimeoutExpired:
        return "took too long"
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["failed"])[-1]
    return dict(json.loads(done.stdout))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one", nargs=3, metavar=("MODEL", "N", "WAY"))
    parser.add_argument("--one-filter", nargs=3, metavar=("MODEL", "STATES", "KIND"))
    parser.add_argument("--filters", action="store_true", help="filters in place of noise verdicts")
    parser.add_argument("--models", nargs="+", default=list(SIZES))
    parser.add_argument("--ways", nargs="+", default=list(WAYS))
    parser.add_argument("--largest", type=int, default=10**9, help="leave out larger n")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if arguments.one:
        name, n, way = arguments.one
        print(json.dumps(one(name, int(n), way)))
        return
    if arguments.one_filter:
        name, n, kind = arguments.one_filter
        print(json.dumps(one_filter(name, int(n), kind)))
        return
    print(described(), flush=True)
    if arguments.filters:
        filters(arguments.largest)
        return
    rows = []
    for name in arguments.models:
        last: dict[str, tuple[int, float]] = {}
        times: dict[str, list[tuple[int, float]]] = {}
        for n in (n for n in SIZES[name] if n <= arguments.largest):
            results = {
                way: separate(name, n, way) for way in arguments.ways if _is_worth(n, last.get(way), name)
            }
            for way, result in results.items():
                if isinstance(result, dict):
                    last[way] = n, float(str(result["seconds"]))
                    times.setdefault(way, []).append((int(str(result["n"])), last[way][1]))
                equal = isinstance(result, dict) and _forbidden(result) == _forbidden(results.get("sparse"))
                print(_line(name, n, way, result, equal), flush=True)
                rows.append({"model": name, "parameter": n, "way": way, "result": result, "equal": equal})
        for way, pairs in times.items():
            print(_exponent(name, way, pairs), end="", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows))


def _exponent(name: str, way: str, pairs: list[tuple[int, float]]) -> str:
    """A line with p of seconds ~ n^p over (n, seconds); empty with less than two large sizes."""
    large = np.log([pair for pair in pairs if pair[0] >= FITTED_FROM])
    if len(large) < 2:
        return ""
    power = np.polyfit(large[:, 0], large[:, 1], 1)[0]
    first, last = np.exp(large[[0, -1], 0])
    return f"{name:10} {way:11} exponent {power:.2f} from {first:.0f} to {last:.0f} equations\n"


def _is_worth(n: int, last: tuple[int, float] | None, name: str) -> bool:
    """Whether the next size is expected within `LONGEST`; the equations of a grid grow with n²."""
    if last is None:
        return True
    return last[1] * (n / last[0]) ** (6 if name == "Grid" else 3) < LONGEST


def _line(name: str, n: int, way: str, result: dict[str, object] | str, equal: bool) -> str:
    if isinstance(result, str):
        return f"{name:10} n = {n:4}  {way:11} {result}"
    return (
        f"{name:10} {result['n']:6} equations  {way:11} {result['seconds']:8.2f} s  "
        f"+{result['added_gb']:5.2f} GB of {result['peak_gb']:5.2f}  {result['n_dynamic']:5} modes  "
        + ("verdicts equal" if equal else "no verdicts" if result["forbidden"] is None else "verdicts differ")
    )


def _forbidden(result: dict[str, object] | str | None) -> object:
    return result.get("forbidden") if isinstance(result, dict) else None


if __name__ == "__main__":
    main()
