"""No fit is worse than the true parameters: random linear models, exact records, bad starts.

    python benchmarks/oracles/random_fits.py [--runs N] [--first N] [--method oe pem] [--json FILE]

A model is a chain of masses with springs and dampers, some of them tied to the ground, or a chain of heat
capacities with resistances; it has 2 to 6 states. Its records are sampled exactly; 3 to 6 parameters start
up to a factor 4 off. The log-likelihood of the fit is held against the best one that an independent Kalman
filter reaches at the true parameters, where scipy searches the noise levels: the fit has more freedom and
may not be worse by more than TOLERATED.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from exact import (
    Linear,
    best_log_likelihood,
    binary,
    keep,
    kept,
    log_likelihood,
    print_table,
    share,
    simulated,
)

from daest.errors import DaestError
from daest.estimation.identify import identify
from daest.machine import described
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_model

TOLERATED = 0.01  # in log-likelihood
FACTOR = 4.0  # by which a start value is off at most
HELD = 8  # samples


@dataclass(frozen=True)
class Case:
    """A random model: Modelica text, the linear system at the truth, the true values and the start values."""

    text: str
    system: Linear
    truth: dict[str, float]
    start: dict[str, float]
    period: float
    n_samples: int


def random_case(seed: int, method: str) -> Case:
    rng = np.random.default_rng([seed, method == "pem"])
    n_states = int(rng.integers(2, 7))
    is_mechanical = n_states % 2 == 0 and rng.random() < 0.7
    build = _masses if is_mechanical else _capacities
    lines, A, B, G, truth = build(n_states, rng)
    n_y = int(rng.integers(1, min(n_states, 3) + 1))
    measured = sorted(rng.choice(n_states, n_y, replace=False).tolist())
    C = np.eye(n_states)[measured]
    n_w = min(int(rng.integers(1, 3)), G.shape[1]) if method == "pem" else 0
    G = G[:, rng.permutation(G.shape[1])[:n_w]]
    fastest = float(np.max(np.abs(np.linalg.eigvals(A))))
    period = float(rng.uniform(0.1, 0.8)) / fastest
    n_samples = int(rng.integers(300, 1001))
    gain, scaled = float(rng.uniform(0.5, 2.0)), n_y > 1 and rng.random() < 0.5
    if scaled:  # the first output has an unknown gain besides; another tells the size
        C[0] *= gain
        truth["gain"] = gain
    u = binary(n_samples, HELD, 1.0, np.random.default_rng(seed))
    quiet = Linear(A, B, G[:, :0], C, np.zeros((n_y, 1)), np.zeros(0), np.zeros(n_y))
    clean = simulated(quiet, u, period, rng, np.zeros(n_states))
    size = np.std(clean, axis=0) + 1e-3 * np.max(np.std(clean, axis=0))
    intensity = np.ones(n_w)
    if n_w:
        noisy = Linear(A, 0 * B, G, C, np.zeros((n_y, 1)), intensity, np.zeros(n_y))
        spread = np.std(simulated(noisy, u, period, rng, np.zeros(n_states)), axis=0)
        share_of_load = np.exp(rng.uniform(np.log(0.02), np.log(1.5)))
        intensity = intensity * (share_of_load * np.min(size / spread)) ** 2
    std = size * np.exp(rng.uniform(np.log(0.005), np.log(0.3), n_y))
    system = Linear(A, B, G, C, np.zeros((n_y, 1)), intensity, std)
    searched = sorted(
        rng.choice(sorted(truth), min(len(truth), int(rng.integers(3, 7))), replace=False).tolist()
    )
    start = {name: truth[name] * FACTOR ** rng.uniform(-1.0, 1.0) for name in searched}
    text = _modelica(lines, truth, searched, measured, G, n_states, "gain" if scaled else "")
    return Case(text, system, truth, start, period, n_samples)


def _masses(
    n_states: int, rng: np.random.Generator
) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray, dict]:
    """Positions first, then speeds; a force acts on the first mass, noise forces on any."""
    n = n_states // 2
    truth = {f"m{i}": _about(1.0, rng) for i in range(n)}
    truth |= {f"c{i}": _about(20.0, rng) for i in range(1, n)} | {
        f"d{i}": _about(0.5, rng) for i in range(1, n)
    }
    truth["f"] = _about(0.5, rng)
    if rng.random() < 0.5:
        truth["c0"] = _about(10.0, rng)
    stiff, damp = np.zeros((n, n)), np.zeros((n, n))
    forces = [[] for _ in range(n)]
    forces[0] += ["u", f"- f*x[{n + 1}]"]
    damp[0, 0] += truth["f"]
    if "c0" in truth:
        stiff[0, 0] += truth["c0"]
        forces[0].append("- c0*x[1]")
    for i in range(1, n):
        for matrix, value in ((stiff, truth[f"c{i}"]), (damp, truth[f"d{i}"])):
            matrix[i - 1, i - 1] += value
            matrix[i, i] += value
            matrix[i - 1, i] -= value
            matrix[i, i - 1] -= value
        pull = f"(c{i}*(x[{i}] - x[{i + 1}]) + d{i}*(x[{n + i}] - x[{n + i + 1}]))"
        forces[i - 1].append(f"- {pull}")
        forces[i].append(f"+ {pull}")
    inverse = np.diag([1.0 / truth[f"m{i}"] for i in range(n)])
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiff, -inverse @ damp]])
    B = np.vstack([np.zeros((n, 1)), inverse[:, :1]])
    G = np.vstack([np.zeros((n, n)), inverse])
    lines = [f"der(x[{i + 1}]) = x[{n + i + 1}];" for i in range(n)]
    lines += [f"m{i}*der(x[{n + i + 1}]) = {' '.join(forces[i])} LOAD{n + i};" for i in range(n)]
    return lines, A, B, G, truth


def _capacities(
    n: int, rng: np.random.Generator
) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray, dict]:
    """Heat flows into the first capacity and out of the last one; noise flows anywhere."""
    truth = {f"K{i}": _about(1.0, rng) for i in range(n)} | {
        f"g{i}": _about(1.0, rng) for i in range(1, n + 1)
    }
    flow = np.zeros((n, n))
    sums = [[] for _ in range(n)]
    sums[0].append("u")
    for i in range(1, n):
        g = truth[f"g{i}"]
        flow[i - 1, i - 1] += g
        flow[i, i] += g
        flow[i - 1, i] -= g
        flow[i, i - 1] -= g
        sums[i - 1].append(f"- g{i}*(x[{i}] - x[{i + 1}])")
        sums[i].append(f"+ g{i}*(x[{i}] - x[{i + 1}])")
    flow[n - 1, n - 1] += truth[f"g{n}"]
    sums[n - 1].append(f"- g{n}*x[{n}]")
    inverse = np.diag([1.0 / truth[f"K{i}"] for i in range(n)])
    lines = [f"K{i}*der(x[{i + 1}]) = {' '.join(sums[i])} LOAD{i};" for i in range(n)]
    return lines, -inverse @ flow, inverse[:, :1], inverse, truth


def _about(value: float, rng: np.random.Generator) -> float:
    return float(value * 3.0 ** rng.uniform(-1.0, 1.0))


def _modelica(
    lines: list[str],
    truth: dict[str, float],
    searched: list[str],
    measured: list[int],
    G: np.ndarray,
    n_states: int,
    gain: str,
) -> str:
    declared = [
        f"parameter Real {name}(min = 0) = {value!r} "
        f"annotation(__Daest(estimate = {'true' if name in searched else 'false'}));"
        for name, value in truth.items()
    ]
    declared += ["input Real u;", f"Real x[{n_states}];"]
    declared += [f"input Real w{j} annotation(__Daest(noise = true));" for j in range(G.shape[1])]
    declared += [f"output Real y{j};" for j in range(len(measured))]
    place = {int(np.argmax(np.abs(column))): j for j, column in enumerate(G.T)}
    equations = []
    for line in lines:
        for i in range(n_states):
            line = line.replace(f" LOAD{i};", f" + w{place[i]};" if i in place else ";")
        equations.append(line)
    for j, i in enumerate(measured):
        factor = f"{gain}*" if gain and j == 0 else ""
        equations.append(f"y{j} = {factor}x[{i + 1}];")
    inside = "\n  ".join(declared) + "\nequation\n  " + "\n  ".join(equations)
    return f"model Random\n  {inside}\nend Random;\n"


def judged(seed: int, method: str, best_noise: bool = True) -> dict:
    """One random model: how much more likely its fit is than the truth, with the best noise levels or the
    true ones."""
    case = random_case(seed, method)
    rng = np.random.default_rng([seed, 7])
    u = binary(case.n_samples, HELD, 1.0, rng)
    n = case.system.A.shape[0]
    y = simulated(case.system, u, case.period, rng, np.zeros(n))
    names = tuple(f"y{j}" for j in range(y.shape[1]))
    experiment = Experiment(f"{seed}", case.period * np.arange(case.n_samples), u, y, ("u",), names)
    result = {"seed": seed, "method": method, "n": n, "p": len(case.start), "n_w": case.system.G.shape[1]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "Random.mo"
        path.write_text(case.text)
        model = compile_model(path, "Random")
    began = time.process_time()
    try:
        options = IdentifyOptions(method=method, start=case.start, hold="zoh")  # type: ignore[arg-type]
        fit = identify(model, [experiment], options)
    except DaestError as error:
        return {**result, "error": error.code}
    result |= {"seconds": time.process_time() - began, "status": fit.status}
    n_w = case.system.G.shape[1]
    truth = np.log([*case.system.intensity, *case.system.std])

    def model_at(z: np.ndarray) -> Linear:
        s = case.system
        return Linear(s.A, s.B, s.G, s.C, s.D, np.exp(z[:n_w]), np.exp(z[n_w:]))

    reference = log_likelihood(case.system, u, y, case.period)
    if best_noise:
        reference = max(reference, best_log_likelihood(model_at, truth, u, y, case.period)[0])
    result["gain"] = fit.log_likelihood - reference
    result["lost"] = [
        p.name for p in fit.parameters if abs(np.log(p.value / case.truth[p.name])) > np.log(100.0)
    ]
    return result


HEADER = ["method", "models", "worse than the truth", "lowest gain", "converged", "refused", "median seconds"]


def told(results: list[dict]) -> list[list[object]]:
    rows = []
    for method in sorted({r["method"] for r in results}):
        runs = [r for r in results if r["method"] == method]
        done = [r for r in runs if "error" not in r]
        gains = np.array([r["gain"] for r in done])
        rows.append(
            [
                method,
                len(runs),
                share(gains < -TOLERATED),
                f"{gains.min():.4f}",
                share(r["status"] == "converged" for r in done),
                len(runs) - len(done),
                f"{np.median([r['seconds'] for r in done]):.2f}",
            ]
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed of the first model")
    parser.add_argument("--method", nargs="+", choices=["oe", "pem"], default=["oe", "pem"])
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    print(described(), flush=True)
    done = kept(chosen.json)
    known = {(r["method"], r["seed"]) for r in done}
    for seed in range(chosen.first, chosen.first + chosen.runs):
        for method in chosen.method:
            if (method, seed) not in known:
                done.append(judged(seed, method))
                keep(chosen.json, done[-1])
    print_table(HEADER, told(done))


if __name__ == "__main__":
    main()
