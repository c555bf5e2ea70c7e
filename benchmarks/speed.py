"""Speed of daest beside its peers, in one process run: the table of docs/speed.md.

    python benchmarks/speed.py [--rows N] [--repeat N] [--only PART] [--table docs/speed.md]

Figures are medians of processor time; each pair is measured in turn, so that both share the load of the
machine. Processes are measured from outside, with all that they load. The peer of a command is the
interpreter that loads numpy, scipy.linalg, scipy.sparse and casadi and does nothing. A diagnosis runs in a
process of its own, once with an empty cache of compiled code and once more with what the first run compiled;
the stages of the second are told with their shares, those of refits by their effect.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import nonlinear_speed as servo
import numpy as np
import scipy.linalg as sla

from daest.data.check import check_table
from daest.data.read import read_table
from daest.data.table import Part
from daest.estimation.filter_engines.ekf import ekf_likelihood
from daest.estimation.filter_engines.filter_task import Noise, Start, Task
from daest.estimation.filter_engines.filter_task import record as prepared
from daest.estimation.filter_engines.kalman import kalman_filter
from daest.estimation.filter_engines.particle import ContinuousPoints, run_particles, systematic
from daest.machine import described
from daest.model.estimates import InitialState
from daest.model.experiment import Experiment
from daest.model.linear import DiscreteModel
from daest.numerics.recursions import linear_recursion
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.local_linear import local_model

PERIOD = 0.01
EQUAL = 1e-9  # relative difference of two log-likelihoods of one problem
EXAMPLES = Path(__file__).parents[1] / "examples"
EXAMPLE = EXAMPLES / "servo" / "Servo.mo"
HIDDEN = EXAMPLES / "servo_hidden"
# Functions of `daest.diagnosis` that take the time of a diagnosis, where they are called, and what the table
# calls them.
STAGES = {
    ("diagnose", "begin"): "the model as it is",
    ("examine", "screen"): "screen",
    ("stages", "_dynamic"): "effects with states of their own",
    ("stages", "proof_by_attempts"): "refit with",
}
SIZES = (("Chain", 118), ("Chain", 588), ("Rigid", 286))  # models of `size.py`
# States, samples, share of the values that are missing, runs.
KALMAN = (
    (4, 1000, 0.0, 15),
    (4, 100_000, 0.0, 5),
    (4, 20_000, 0.1, 5),
    (20, 2000, 0.0, 7),
    (100, 500, 0.0, 5),
)
PARTICLES, SAMPLES = 1000, 1000
MANY = 100_000  # variables of an FMU


@dataclass(frozen=True)
class Row:
    """One line of the table: a figure and that of the peer, in `unit`, less being better unless `is_rate`."""

    step: str
    unit: str
    ours: float
    peer: str = ""
    theirs: float | None = None
    is_rate: bool = False

    def cells(self) -> tuple[str, ...]:
        theirs = "" if self.theirs is None else f"{self.theirs:.3g}"
        ratio = 0.0 if self.theirs is None else self.theirs / self.ours
        faster = "" if self.theirs is None else f"{1 / ratio if self.is_rate else ratio:.2g}"
        return self.step, f"{self.ours:.3g} {self.unit}", self.peer, theirs, faster


def chain(n: int) -> DiscreteModel:
    """n / 2 masses between damped springs; noise forces on the first and the last, which are measured."""
    m = n // 2
    K = 2 * np.eye(m) - np.eye(m, k=1) - np.eye(m, k=-1)
    A = np.block([[np.zeros((m, m)), np.eye(m)], [-100 * K, -0.5 * K - 0.1 * np.eye(m)]])
    B, C = np.zeros((n, 2)), np.zeros((2, n))
    B[m, 0] = B[n - 1, 1] = C[0, 0] = C[1, m - 1] = 1.0
    Phi = sla.expm(PERIOD * A)
    G = np.sqrt(PERIOD) * (Phi @ B).T
    none, small = np.zeros((n, 0)), np.zeros((2, 0))
    return DiscreteModel(
        transition=Phi, input_now=none, input_next=none, drift=np.zeros(n), output=C, feedthrough=small,
        output_offset=np.zeros(2), process_cov=G.T @ G, measurement_cov=1e-4 * np.eye(2),
        cross_cov=np.zeros((n, 2)), noise_cov=np.eye(2), noise_process_cov=G,
        noise_measurement_cov=np.zeros((2, 2)), period=PERIOD, hold="zoh",
    )  # fmt: skip


def record(model: DiscreteModel, n_samples: int, missing: float) -> Experiment:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((n_samples - 1, 2)) @ model.noise_process_cov
    states = linear_recursion(model.transition, noise, np.zeros(model.transition.shape[0]))
    y = states @ model.output.T + 0.01 * rng.standard_normal((n_samples, 2))
    y[rng.uniform(size=y.shape) < missing] = np.nan
    return Experiment(
        "chain", PERIOD * np.arange(n_samples), np.zeros((n_samples, 0)), y, (), ("first", "last")
    )


def statsmodels_filter(model: DiscreteModel, experiment: Experiment):
    from statsmodels.tsa.statespace.kalman_filter import KalmanFilter

    n = model.transition.shape[0]
    peer = KalmanFilter(k_endog=2, k_states=n)
    peer.bind(experiment.outputs.copy())
    peer["design"], peer["obs_cov"] = model.output, model.measurement_cov
    peer["transition"], peer["selection"], peer["state_cov"] = model.transition, np.eye(n), model.process_cov
    peer.initialize_known(np.zeros(n), np.eye(n))
    return peer


def in_turn(runs: list[Callable[[], object]], repeat: int) -> list[float]:
    """Median seconds of processor time of each; the first run of each is not counted."""
    times: list[list[float]] = [[] for _ in runs]
    for round_ in range(repeat + 1):
        for run, found in zip(runs, times, strict=True):
            start = time.process_time()
            run()
            if round_:
                found.append(time.process_time() - start)
    return [statistics.median(found) for found in times]


def kalman_rows() -> Iterator[Row]:
    for n, n_samples, missing, repeat in KALMAN:
        model = chain(n)
        experiment, known = record(model, n_samples, missing), InitialState.known(np.zeros(n), 1.0)
        peer = statsmodels_filter(model, experiment)
        if abs(kalman_filter(model, experiment, known).log_likelihood / peer.loglike() - 1.0) > EQUAL:
            raise SystemExit(f"the log-likelihoods of {n} states differ: not the same problem")
        runs = [lambda m=model, e=experiment, k=known: kalman_filter(m, e, k), peer.filter]
        ours, theirs = (1e3 * seconds for seconds in in_turn(runs, repeat))
        what = f"{n} states, {n_samples} samples" + (", 10 % missing" if missing else "")
        yield Row(f"Kalman filter, {what}", "ms", ours, "statsmodels", theirs)


def plain_bootstrap(y: np.ndarray, u: np.ndarray, theta: np.ndarray, noise: Noise) -> None:
    """A bootstrap filter as one writes it in numpy: two Runge-Kutta steps of order 4 a sample."""
    import casadi as ca

    x, v, p = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("p", 8)
    flow = ca.Function("f", [x, v, p], [servo.rates(x, v, p)]).map(PARTICLES)
    rng, h = np.random.default_rng(0), servo.PERIOD / 2
    points = 0.1 * rng.standard_normal((4, PARTICLES))
    reach = np.sqrt(noise.intensity * servo.PERIOD)[:, None] / theta[:2, None]
    for k in range(y.shape[0]):
        error = y[k][:, None] - points[[0, 3]]
        log_weight = -0.5 * np.sum(error**2 / noise.variance[:, None], axis=0)
        weight = np.exp(log_weight - log_weight.max())
        points = points[:, systematic(weight / weight.sum(), rng)]
        for _ in range(2):
            rate = lambda at, k=k: flow(at, u[k], theta).full()  # noqa: E731
            k1 = rate(points)
            k2 = rate(points + h / 2 * k1)
            k3 = rate(points + h / 2 * k2)
            points = points + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(points + h * k3))
        points[[0, 2]] += reach * rng.standard_normal((2, PARTICLES))


def nonlinear_rows() -> Iterator[Row]:
    explicit = servo.servo()
    theta = explicit.flat.theta_values
    t, u = servo.drive(SAMPLES)
    solved = integrate(integrator(explicit), t, u, theta, np.zeros(4), hold="zoh", rtol=servo.RTOL)
    y = solved.outputs + np.array([0.1, 0.01]) * np.random.default_rng(1).standard_normal((SAMPLES, 2))
    data = prepared(local_model(explicit), t, u, y, "zoh")
    model = local_model(explicit)
    noise, start = Noise(np.array([1e-4, 1e-4]), np.array([1e-2, 1e-4])), Start(np.zeros(4), 0.01 * np.eye(4))
    (seconds,) = in_turn([lambda: ekf_likelihood(model, data, theta, noise, start)], 9)
    yield Row("extended filter of a servo, a sample and state", "us", 1e6 * seconds / SAMPLES / 4)
    points = ContinuousPoints(Task.of(model, data, theta, noise, start, np.inf))
    runs = [
        lambda: run_particles(points, data.outputs, noise.variance, start, PARTICLES, 0, "bootstrap"),
        lambda: plain_bootstrap(y, u, theta, noise),
    ]
    ours, theirs = (SAMPLES * PARTICLES / 1e3 / seconds for seconds in in_turn(runs, 3))
    name = f"particle filter, {PARTICLES} particles, {SAMPLES} samples"
    yield Row(name, "particles a ms", ours, "plain numpy", theirs, is_rate=True)


def table_rows(folder: Path, n_rows: int, repeat: int) -> Iterator[Row]:
    import pyarrow as pa
    from pyarrow import csv

    rng, k, path = np.random.default_rng(0), np.arange(n_rows), folder / "long.csv"
    u = np.sin(1e-3 * k)
    signals = (1e-3 * k, u, u + 0.1 * rng.standard_normal(n_rows), np.cos(1e-4 * k))
    columns = [pa.array(np.round(values, 5)) for values in signals]
    csv.write_csv(
        pa.table(columns, ["time", "u", "omega", "phi"]), path, csv.WriteOptions(quoting_header="none")
    )
    import pandas as pd

    runs = [lambda: check_table(read_table(path)), lambda: pd.read_csv(path)]
    ours, theirs = in_turn(runs, repeat)
    yield Row(f"check of {n_rows} rows of CSV", "s", ours, "pandas reads them", theirs)
    (part,) = in_turn([lambda: read_table(path, Part(None, None, 5.0))], repeat)
    yield Row(f"the first 5000 of {n_rows} rows of CSV", "s", part)


def as_installed() -> dict[str, str]:
    """The environment of a process whose byte code is kept, as that of an installed package is."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def process(arguments: list[str], **variables: str) -> Callable[[], object]:
    return lambda: subprocess.run(
        [sys.executable, *arguments], env={**as_installed(), **variables}, capture_output=True, check=False
    )


def children(runs: list[Callable[[], object]], repeat: int) -> list[float]:
    """Median seconds of processor time of processes and all that they start."""
    times: list[list[float]] = [[] for _ in runs]
    for round_ in range(repeat + 1):
        for run, found in zip(runs, times, strict=True):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            run()
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            if round_:
                found.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return [statistics.median(found) for found in times]


def process_rows(folder: Path, repeat: int) -> Iterator[Row]:
    fmu = folder / "servo.fmu"
    process(["-m", "daest", "export", str(EXAMPLE), "-o", str(fmu)])()
    words = {"_DAEST_COMPLETE": "bash_complete", "COMP_WORDS": "daest identify --esti", "COMP_CWORD": "2"}
    linearize = ["-m", "daest", "linearize", str(fmu)]
    runs = [
        process(["-c", "import numpy, scipy.linalg, scipy.sparse, casadi"]),
        with_empty_cache(linearize, folder / "emptied"),
        process(linearize, DAEST_CACHE=str(folder / "filled")),
        process(["-m", "daest"], **words),
        process(["-m", "daest", "--help"]),
    ]
    runs.append(process(["-m", "daest", "linearize", str(with_many_variables(fmu, folder / "many.fmu"))]))
    loads, *found = children(runs, repeat)
    names = (
        "`daest linearize servo.fmu`, first",
        "`daest linearize servo.fmu`, again",
        "one Tab",
        "`daest --help`",
        f"the same FMU with {MANY} variables",
    )
    for name, seconds in zip(names, found, strict=True):
        yield Row(f"{name}, whole process", "s", seconds, "loading the libraries", loads)


def with_empty_cache(arguments: list[str], cache: Path) -> Callable[[], object]:
    """A process that finds nothing of an earlier one."""
    run = process(arguments, DAEST_CACHE=str(cache))

    def run_afresh() -> object:
        shutil.rmtree(cache, ignore_errors=True)
        return run()

    return run_afresh


def with_many_variables(fmu: Path, target: Path) -> Path:
    """The FMU with `MANY` further names of its first output."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                reference = re.search(rb'valueReference="(\d+)"[^>]*causality="output"', content)
                assert reference is not None
                row = b'<Float64 name="part[%d].x" valueReference="%s" causality="local"/>\n'
                rows = b"".join(row % (i, reference[1]) for i in range(MANY))
                content = content.replace(b"</ModelVariables>", rows + b"</ModelVariables>")
            new.writestr(name, content)
    return target


def staged(told: Path) -> None:
    """Diagnose in the current folder, one fit at a time, and write the processor time of the stages there."""
    from daest.cli.main import run

    found: dict[str, float] = defaultdict(float)

    def timed(stage: tuple[str, str], function: Callable) -> Callable:
        def run_timed(*arguments: object, **options: object) -> object:
            start = time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                which = (
                    f" {arguments[1].trial.candidate.label}"
                    if stage[0] == "stages" and stage[1] != "_dynamic"
                    else ""
                )
                found[STAGES[stage] + which] += time.process_time() - start

        return run_timed

    for stage in STAGES:
        module = import_module(f"daest.diagnosis.{stage[0]}")
        setattr(module, stage[1], timed(stage, getattr(module, stage[1])))
    try:
        run(["diagnose", "--jobs", "1"])
    finally:
        told.write_text(json.dumps({"whole": time.process_time(), **found}), encoding="utf-8")


def diagnosis_rows(folder: Path) -> Iterator[Row]:
    work, told = folder / "servo_hidden", folder / "stages.json"
    shutil.copytree(HIDDEN, work)
    variables = {**as_installed(), "DAEST_CACHE": str(folder / "cache")}
    here = [sys.executable, str(Path(__file__).resolve()), "--staged", str(told)]
    for name in ("first", "again"):
        shutil.rmtree(work / "results", ignore_errors=True)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(here, cwd=work, env=variables, capture_output=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        yield Row(f"`daest diagnose` of examples/servo_hidden, {name}", "s", seconds)
    shutil.rmtree(work / "results")
    began = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "daest", "diagnose"], cwd=work, env=variables, capture_output=True, check=False
    )
    yield Row("the same in two processes, by the clock on the wall", "s", time.perf_counter() - began)
    stages = json.loads(told.read_text(encoding="utf-8"))
    whole = stages.pop("whole")
    for stage, seconds in sorted(stages.items(), key=lambda item: -item[1]):
        yield Row(f"of it: {stage} ({100 * seconds / whole:.0f} %)", "s", seconds)


def size_rows() -> Iterator[Row]:
    import size

    for name, n in SIZES:
        dae = size.model(name, n)
        (seconds,) = in_turn([lambda dae=dae: size.by_sparse_form(dae)], 1)
        yield Row(f"noise verdict, {name}, {dae.n} equations", "s", seconds)


def markdown(rows: list[Row]) -> str:
    names = ("numpy", "scipy", "casadi", "statsmodels", "pyarrow", "pandas")
    lines = [
        "# Speed",
        "",
        "`python benchmarks/speed.py --table docs/speed.md` measures this table in one process run. Figures",
        "are medians of processor time on one core; the last column says how many times faster daest is.",
        "",
        f"{described(names)}. A load above 1 makes figures larger than on a quiet machine; ratios stay.",
        "",
        "| step | daest | peer | its figure | times faster |",
        "|---|---|---|---|---|",
    ]
    return "\n".join([*lines, *(f"| {' | '.join(row.cells())} |" for row in rows), ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=5_000_000, help="of the long CSV file")
    parser.add_argument("--repeat", type=int, default=3, help="of files and processes")
    parser.add_argument("--table", type=Path, help="write the table there as Markdown")
    parser.add_argument("--only", choices=("kalman", "nonlinear", "table", "process", "diagnosis", "size"))
    parser.add_argument("--staged", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.staged is not None:
        staged(options.staged)
        return
    print(described(), flush=True)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = {
            "kalman": kalman_rows(),
            "nonlinear": nonlinear_rows(),
            "table": table_rows(folder, options.rows, options.repeat),
            "process": process_rows(folder, options.repeat),
            "size": size_rows(),
            "diagnosis": diagnosis_rows(folder),
        }
        for part, found in parts.items():
            for row in found if options.only in (None, part) else ():
                print("  ".join(row.cells()), flush=True)
                rows.append(row)
    if options.table is not None:
        options.table.write_text(markdown(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
