"""Nonlinear fits end at the best point: five machines with random parameters, from far starts.

    python benchmarks/oracles/nonlinear_fits.py [--runs N] [--first N] [--fit oe pem ekf ...]
                                                [--factor F] [--json FILE]

The machines are a pendulum with friction, a servo with Stribeck friction, an oscillator with a hardening
spring, two tanks and a vehicle. Their equations are integrated here (Runge-Kutta of order 4 with fine steps,
Euler-Maruyama with process noise), apart from daest. Start values are up to a factor F off (default 4; the
stiffness of the oscillator up to its square, so that its frequency is F off). The fit from there is held
against a fit that starts at the truth: it may not be worse by more than TOLERATED.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from exact import binary, keep, kept, print_table, share

from daest.errors import DaestError
from daest.estimation.identify import identify
from daest.machine import described
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import FlatModel
from daest.modelica.compile import compile_model

TOLERATED = 0.1  # in log-likelihood: twice what two integrations within their tolerance may differ by
FACTOR = 4.0
SPREAD = 2.0  # of the true values about those of the machine, a factor both ways
SUBSTEPS = 20

Equations = Callable[[np.ndarray, float, dict[str, float]], list[float]]


@dataclass(frozen=True)
class Machine:
    """Equations as Modelica and as `rates` (x, u with the load in it, parameters) -> dx/dt. `seen` are the
    numbers of the measured states. The load adds to the input."""

    values: dict[str, float]
    equations: str
    rates: Equations
    n_states: int
    seen: tuple[int, ...]
    period: float
    n_samples: int
    size: float  # of the input
    offset: float = 0.0  # of the input
    held: int = 10
    start: float = 0.0  # of every state
    squared: tuple[str, ...] = ()  # parameters that start up to F^2 off


def _pendulum(x: np.ndarray, u: float, p: dict[str, float]) -> list[float]:
    friction = p["d"] * x[1] + p["tau_c"] * np.tanh(x[1] / 0.1)
    return [x[1], (u - p["m"] * np.sin(x[0]) - friction) / p["J"]]


def _servo(x: np.ndarray, u: float, p: dict[str, float]) -> list[float]:
    w = x[2]
    dry = (p["tau_c"] + p["tau_s"] * np.exp(-((w / 0.5) ** 2))) * np.tanh(w / 0.1)
    spring = p["c"] * (x[0] - x[1]) + p["d"] * (x[2] - x[3])
    return [x[2], x[3], (u - dry - spring) / p["J1"], spring / p["J2"]]


def _oscillator(x: np.ndarray, u: float, p: dict[str, float]) -> list[float]:
    return [x[1], (u - p["c"] * x[0] - p["c3"] * x[0] ** 3 - p["d"] * x[1]) / p["m"]]


def _root(h: float) -> float:
    return float(h / np.sqrt(np.sqrt(h * h + 1e-6)))


def _tanks(x: np.ndarray, u: float, p: dict[str, float]) -> list[float]:
    between = p["a1"] * _root(x[0])
    return [(u - between) / p["A1"], (between - p["a2"] * _root(x[1])) / p["A2"]]


def _vehicle(x: np.ndarray, u: float, p: dict[str, float]) -> list[float]:
    drag = p["c_d"] * x[1] * abs(x[1]) + p["c_r"] * np.tanh(x[1] / 0.2)
    return [x[1], (x[2] - drag) / p["m"], (u - x[2]) / p["T"]]


MACHINES = {
    "pendulum": Machine(
        {"J": 0.1, "m": 1.0, "d": 0.05, "tau_c": 0.1},
        "der(x[1]) = x[2]; J*der(x[2]) = v - m*sin(x[1]) - d*x[2] - tau_c*tanh(x[2]/0.1);",
        _pendulum, 2, (0,), 0.05, 400, 0.9,
    ),
    "servo": Machine(
        {"J1": 0.02, "J2": 0.04, "c": 5.0, "d": 0.02, "tau_c": 0.2, "tau_s": 0.2},
        "der(x[1]) = x[3]; der(x[2]) = x[4]; "
        "J1*der(x[3]) = v - (tau_c + tau_s*exp(-(x[3]/0.5)^2))*tanh(x[3]/0.1) - spring; "
        "J2*der(x[4]) = spring; spring = c*(x[1] - x[2]) + d*(x[3] - x[4]);",
        _servo, 4, (1, 2), 0.02, 500, 0.8, held=15,
    ),
    "oscillator": Machine(
        {"m": 1.0, "d": 0.3, "c": 20.0, "c3": 20.0},
        "der(x[1]) = x[2]; m*der(x[2]) = v - c*x[1] - c3*x[1]^3 - d*x[2];",
        _oscillator, 2, (0,), 0.05, 500, 10.0, squared=("c",),
    ),
    "tanks": Machine(
        {"A1": 1.0, "A2": 1.5, "a1": 0.5, "a2": 0.4},
        "A1*der(x[1]) = v - f; A2*der(x[2]) = f - a2*x[2]/sqrt(sqrt(x[2]^2 + 1e-6)); "
        "f = a1*x[1]/sqrt(sqrt(x[1]^2 + 1e-6));",
        _tanks, 2, (1,), 0.5, 300, 0.25, offset=0.5, held=20, start=0.5,
    ),
    "vehicle": Machine(
        {"m": 1.0, "c_d": 0.05, "c_r": 0.3, "T": 0.4},
        "der(x[1]) = x[2]; m*der(x[2]) = x[3] - c_d*x[2]*abs(x[2]) - c_r*tanh(x[2]/0.2); "
        "T*der(x[3]) = v - x[3];",
        _vehicle, 3, (1,), 0.1, 400, 2.0, offset=0.5,
    ),
}  # fmt: skip
EXTRA = {"servo": "Real spring;", "tanks": "Real f;"}


@cache
def compiled(name: str, has_load: bool) -> FlatModel:
    machine = MACHINES[name]
    declared = [
        f"parameter Real {p}(min = 0) = {value!r} annotation(__Daest(estimate = true));"
        for p, value in machine.values.items()
    ]
    declared += ["input Real u;", "Real v;", EXTRA.get(name, "")]
    declared += [f"Real x[{machine.n_states}](each start = {machine.start});"]
    declared += ["input Real load annotation(__Daest(noise = true));"] if has_load else []
    declared += [f"output Real y{j} = x[{i + 1}];" for j, i in enumerate(machine.seen)]
    v = "v = u + load;" if has_load else "v = u;"
    text = "\n  ".join(declared) + f"\nequation\n  {v}\n  " + machine.equations.replace("; ", ";\n  ")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "Machine.mo"
        path.write_text(f"model Machine\n  {text}\nend Machine;\n")
        return compile_model(path, "Machine")


def recording(name: str, has_load: bool, truth: dict[str, float], rng: np.random.Generator) -> Experiment:
    """Held input, noise-free states (or with load), sensors with 1 to 5 % of the spread of their output."""
    machine = MACHINES[name]
    u = machine.offset + binary(machine.n_samples, machine.held, machine.size, rng)
    h = machine.period / SUBSTEPS
    # Standard deviation of the load's mean over one sample: 2 to 10 % of the input's size.
    strength = machine.size * float(np.exp(rng.uniform(np.log(0.02), np.log(0.1)))) if has_load else 0.0
    x, y = np.full(machine.n_states, machine.start), np.empty((machine.n_samples, len(machine.seen)))
    for k in range(machine.n_samples):
        y[k] = x[list(machine.seen)]
        kicks = strength * np.sqrt(SUBSTEPS) * rng.standard_normal(SUBSTEPS)
        for kick in kicks:
            x = _step(machine, x, float(u[k, 0]) + kick, truth, h)
    spread = np.std(y, axis=0)
    y = y + spread * np.exp(rng.uniform(np.log(0.01), np.log(0.05))) * rng.standard_normal(y.shape)
    time_grid = machine.period * np.arange(machine.n_samples)
    return Experiment(name, time_grid, u, y, ("u",), tuple(f"y{j}" for j in range(y.shape[1])))


def _step(machine: Machine, x: np.ndarray, v: float, p: dict[str, float], h: float) -> np.ndarray:
    rates = machine.rates
    k1 = np.array(rates(x, v, p))
    k2 = np.array(rates(x + h / 2 * k1, v, p))
    k3 = np.array(rates(x + h / 2 * k2, v, p))
    k4 = np.array(rates(x + h * k3, v, p))
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def case(name: str, fit: str, seed: int, factor: float) -> tuple[Experiment, dict[str, float], dict]:
    """Recording, truth and start values."""
    rng = np.random.default_rng([seed, list(MACHINES).index(name), fit == "oe"])
    machine = MACHINES[name]
    truth = {p: value * SPREAD ** rng.uniform(-1.0, 1.0) for p, value in machine.values.items()}
    powers = {p: 2.0 if p in machine.squared else 1.0 for p in truth}
    start = {p: value * factor ** (powers[p] * rng.uniform(-1.0, 1.0)) for p, value in truth.items()}
    return recording(name, fit != "oe", truth, rng), truth, start


def fitted(name: str, fit: str, experiment: Experiment, start: dict[str, float]) -> FitResult:
    options = IdentifyOptions(
        method="oe" if fit == "oe" else "pem",
        start=start,
        hold="zoh",
        likelihood="ekf" if fit == "ekf" else "observer",
    )
    return identify(compiled(name, fit != "oe"), [experiment], options)


def judged(name: str, fit: str, seed: int, factor: float) -> dict:
    experiment, truth, start = case(name, fit, seed, factor)
    result = {"machine": name, "fit": fit, "seed": seed, "factor": factor}
    compiled(name, fit != "oe")
    began = time.process_time()
    try:
        far = fitted(name, fit, experiment, start)
    except DaestError as error:
        return {**result, "error": error.code}
    result |= {"seconds": time.process_time() - began, "status": far.status, "notes": list(far.notes)}
    began = time.process_time()
    near = fitted(name, fit, experiment, truth)
    result |= {"near_seconds": time.process_time() - began, "near_status": near.status}
    result["gain"] = far.log_likelihood - near.log_likelihood
    result["ratios"] = {p.name: p.value / truth[p.name] for p in far.parameters}
    return result


HEADER = ["machine", "fit", "runs", "worse than from the truth", "of these converged", "lowest", "converged",
          "refused", "median seconds", "from the truth"]  # fmt: skip


def told(results: list[dict]) -> list[list[object]]:
    rows = []
    for key in sorted({(r["machine"], r["fit"]) for r in results}):
        runs = [r for r in results if (r["machine"], r["fit"]) == key]
        done = [r for r in runs if "error" not in r]
        if not done:
            continue
        worse = [r for r in done if r["gain"] < -TOLERATED]
        rows.append(
            [
                *key,
                len(runs),
                f"{len(worse)}",
                f"{sum(r['status'] == 'converged' for r in worse)}",
                f"{min(r['gain'] for r in done):.2f}",
                share(r["status"] == "converged" for r in done),
                len(runs) - len(done),
                f"{np.median([r['seconds'] for r in done]):.2f}",
                f"{np.median([r['near_seconds'] for r in done]):.2f}",
            ]
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--first", type=int, default=0, help="seed of the first recording")
    parser.add_argument("--machine", nargs="+", choices=list(MACHINES), default=list(MACHINES))
    parser.add_argument("--fit", nargs="+", choices=["oe", "pem", "ekf"], default=["oe", "pem"])
    parser.add_argument("--factor", type=float, default=FACTOR, help="by which start values are off at most")
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    print(described(), flush=True)
    done = kept(chosen.json)
    known = {(r["machine"], r["fit"], r["seed"], r["factor"]) for r in done}
    for seed in range(chosen.first, chosen.first + chosen.runs):
        for name in chosen.machine:
            for fit in chosen.fit:
                if (name, fit, seed, chosen.factor) not in known:
                    done.append(judged(name, fit, seed, chosen.factor))
                    keep(chosen.json, done[-1])
    print_table(HEADER, told(done))


if __name__ == "__main__":
    main()
