"""Coverage of intervals: two masses with process noise (PEM) or without (OE), and a pendulum with friction
(EKF).

    python benchmarks/oracles/coverage.py [--case oe pem ekf ...] [--level 0.3 1 5] [--runs N] [--first N]
                                          [--start far near truth] [--profile] [--json FILE]

Recordings come from exact sampling of the linear equations, or from Euler-Maruyama with 200 substeps a
sample for the pendulum; both share nothing with daest. The likelihood ratio compares the fit with the best
likelihood of an independent Kalman filter at the true parameters (noise levels searched by scipy). `--json
FILE` keeps one line per recording; recordings that are in it are not done again.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from functools import cache, partial
from pathlib import Path

import numpy as np
from exact import Linear, best_log_likelihood, binary, keep, kept, print_table, share, simulated
from scipy.stats import chi2, kstest

from daest.errors import DaestError
from daest.estimation.identify import identify
from daest.machine import described
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import FlatModel
from daest.modelica.compile import compile_model

PERIOD, N_SAMPLES = 0.05, 400
TRUTH = {"J1": 1.0, "J2": 2.0, "c": 30.0, "d": 0.4, "f": 0.5}
STARTS = {
    "far": {"J1": 2.0, "J2": 1.0, "c": 15.0, "d": 0.8, "f": 0.25},
    "near": {"J1": 1.2, "J2": 1.7, "c": 25.0, "d": 0.5, "f": 0.4},
    "truth": TRUTH,
}
LOAD, SENSORS = 0.25, (0.01, 0.02)  # intensity at level 1 [(N.m)^2 s], standard deviations [rad, rad/s]
TWO_MASSES = """
model TwoMasses "Two masses with spring and damper; a torque acts on the first, a random load on the second"
  parameter Real J1(unit = "kg.m2", min = 0) = 1 annotation(__Daest(estimate = true));
  parameter Real J2(unit = "kg.m2", min = 0) = 2 annotation(__Daest(estimate = true));
  parameter Real c(unit = "N.m/rad", min = 0) = 30 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.4 annotation(__Daest(estimate = true));
  parameter Real f(unit = "N.m.s/rad", min = 0) = 0.5 annotation(__Daest(estimate = true));
  input Real u(unit = "N.m");
  NOISE
  output Real y1(unit = "rad") annotation(__Daest(estimate = true));
  output Real y2(unit = "rad/s") annotation(__Daest(estimate = true));
  Real phi1(unit = "rad");
  Real phi2(unit = "rad");
  Real w1(unit = "rad/s");
  Real w2(unit = "rad/s");
equation
  der(phi1) = w1;
  der(phi2) = w2;
  J1*der(w1) = u - f*w1 - c*(phi1 - phi2) - d*(w1 - w2);
  J2*der(w2) = c*(phi1 - phi2) + d*(w1 - w2) LOAD;
  y1 = phi1;
  y2 = w2;
end TwoMasses;
"""
NOISE = 'input Real load(unit = "N.m") annotation(__Daest(noise = true));'
PENDULUM = """
model RubbedPendulum "A torque and a load swing a pendulum against viscous and dry friction"
  parameter Real J(unit = "kg.m2", min = 0) = 0.1 annotation(__Daest(estimate = true));
  parameter Real m(unit = "N.m", min = 0) = 1 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.05 annotation(__Daest(estimate = true));
  parameter Real tau_c(unit = "N.m", min = 0) = 0.1 annotation(__Daest(estimate = true));
  input Real u(unit = "N.m");
  input Real load(unit = "N.m") annotation(__Daest(noise = true));
  output Real angle(unit = "rad") = phi;
  Real phi(unit = "rad");
  Real w(unit = "rad/s");
equation
  der(phi) = w;
  J*der(w) = u + load - m*sin(phi) - d*w - tau_c*tanh(w/0.1);
end RubbedPendulum;
"""
PENDULUM_TRUTH = {"J": 0.1, "m": 1.0, "d": 0.05, "tau_c": 0.1}
PENDULUM_START = {"J": 0.13, "m": 0.8, "d": 0.08, "tau_c": 0.06}
PENDULUM_LOAD, PENDULUM_STD, SUBSTEPS = 1e-3, 0.01, 200


def two_masses(theta: dict[str, float], load: float, std: np.ndarray) -> Linear:
    J1, J2, c, d, f = (theta[name] for name in TRUTH)
    A = np.zeros((4, 4))
    A[0, 2] = A[1, 3] = 1.0
    A[2] = np.array([-c, c, -d - f, d]) / J1
    A[3] = np.array([c, -c, d, -d]) / J2
    B = np.array([[0.0], [0.0], [1.0 / J1], [0.0]])
    G = np.array([[0.0], [0.0], [0.0], [1.0 / J2]])
    C = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return Linear(A, B, G, C, np.zeros((2, 1)), np.array([load]), std)


def recording(case: str, level: float, seed: int) -> Experiment:
    rng = np.random.default_rng([seed, round(10 * level), case == "oe"])
    u = binary(N_SAMPLES, 8, 3.0, rng)
    model = two_masses(TRUTH, 0.0 if case == "oe" else LOAD * level**2, level * np.array(SENSORS))
    y = simulated(model, u, PERIOD, rng, np.zeros(4))
    t = PERIOD * np.arange(N_SAMPLES)
    return Experiment(f"{case} {level} {seed}", t, u, y, ("u",), ("y1", "y2"))


def pendulum_recording(level: float, seed: int) -> Experiment:
    """Euler-Maruyama with SUBSTEPS a sample; `level` scales load and sensor noise."""
    rng = np.random.default_rng([seed, round(10 * level), 2])
    u = binary(N_SAMPLES, 10, 0.9, rng)
    t = PERIOD * np.arange(N_SAMPLES)
    J, m, d, tau_c = PENDULUM_TRUTH.values()
    h = PERIOD / SUBSTEPS
    kicks = np.sqrt(PENDULUM_LOAD * level**2 * h) * rng.standard_normal((N_SAMPLES, SUBSTEPS))
    phi, w, angle = 0.3, 0.0, np.empty(N_SAMPLES)
    for k in range(N_SAMPLES):
        angle[k] = phi
        for kick in kicks[k]:
            w += ((u[k, 0] - m * np.sin(phi) - d * w - tau_c * np.tanh(w / 0.1)) * h + kick) / J
            phi += w * h
    y = angle[:, None] + level * PENDULUM_STD * rng.standard_normal((N_SAMPLES, 1))
    return Experiment(f"pendulum {level} {seed}", t, u, y, ("u",), ("angle",))


@cache
def compiled(case: str) -> FlatModel:
    text = PENDULUM if case == "ekf" else TWO_MASSES
    text = text.replace("NOISE", "" if case == "oe" else NOISE).replace(
        "LOAD", "" if case == "oe" else "+ load"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "Model.mo"
        path.write_text(text)
        return compile_model(path, "RubbedPendulum" if case == "ekf" else "TwoMasses")


def fitted(case: str, experiment: Experiment, start: str, profile: bool) -> FitResult:
    options = IdentifyOptions(
        method="oe" if case == "oe" else "pem",
        start=(PENDULUM_TRUTH if start == "truth" else PENDULUM_START) if case == "ekf" else STARTS[start],
        hold="zoh",
        likelihood="ekf" if case == "ekf" else "observer",
        profile=("all",) if profile else (),
    )
    return identify(compiled(case), [experiment], options)


def at_truth(case: str, experiment: Experiment, level: float) -> float:
    """Best log-likelihood with the true parameters; noise levels and initial state are free."""
    n_load = 0 if case == "oe" else 1

    def model_at(z: np.ndarray) -> Linear:
        return two_masses(TRUTH, float(np.exp(z[0])) if n_load else 0.0, np.exp(z[n_load:]))

    start = np.log([*([LOAD * level**2] * n_load), *(level * np.array(SENSORS))])
    return best_log_likelihood(model_at, start, experiment.inputs, experiment.outputs, PERIOD)[0]


def judged(case: str, level: float, start: str, seed: int, profile: bool) -> dict:
    """One recording: what is inside its intervals and regions, and how likely the fit is beside the truth."""
    result = {"case": case, "level": level, "start": start, "seed": seed}
    truth = PENDULUM_TRUTH if case == "ekf" else TRUTH
    experiment = pendulum_recording(level, seed) if case == "ekf" else recording(case, level, seed)
    began = time.process_time()
    try:
        fit = fitted(case, experiment, start, profile)
    except DaestError as error:
        return {**result, "error": error.code}
    result["seconds"] = time.process_time() - began
    result |= {"status": fit.status, "log_likelihood": fit.log_likelihood}
    result["values"] = {p.name: p.value for p in fit.parameters}
    result["errors"] = {p.name: p.std_error for p in fit.parameters}
    inside = [
        p.std_error is not None and abs(p.value - truth[p.name]) <= 1.959964 * p.std_error
        for p in fit.parameters
    ]
    result["inside"] = [bool(i) for i in inside]
    result["joint"] = _joint(fit, truth)
    result["warned"] = any("quadratic" in note for note in fit.notes)
    if case != "ekf":
        result["ratio"] = 2.0 * (fit.log_likelihood - at_truth(case, experiment, level))
    if profile:
        result["profiles"] = [_holds(p, truth[p.name]) for p in fit.profiles]
    return result


def _holds(profile: object, value: float) -> bool:
    low, high = profile.lower, profile.upper  # type: ignore[attr-defined]
    return (low is None or low <= value) and (high is None or value <= high)


def _joint(fit: FitResult, truth: dict[str, float]) -> bool:
    """Whether the 95 % region of all parameters together holds the truth."""
    errors = [p.std_error for p in fit.parameters]
    if any(e is None for e in errors):
        return False
    std = np.array(errors, dtype=float)
    rows = [fit.correlation_names.index(p.name) for p in fit.parameters]
    cov = fit.correlation[np.ix_(rows, rows)] * np.outer(std, std)
    gap = np.array([p.value - truth[p.name] for p in fit.parameters])
    return bool(gap @ np.linalg.solve(cov, gap) <= chi2.ppf(0.95, gap.size))


def told(results: list[dict]) -> list[list[object]]:
    """Rows of the table: one for every case, level and start."""
    rows = []
    for key in sorted({(r["case"], r["level"], r["start"]) for r in results}):
        runs = [r for r in results if (r["case"], r["level"], r["start"]) == key]
        done = [r for r in runs if "error" not in r]
        if not done:
            continue
        ratios = np.array([r["ratio"] for r in done if "ratio" in r])
        p_value = f"{kstest(ratios, chi2(len(TRUTH)).cdf).pvalue:.3f}" if ratios.size else "-"
        lowest = f"{ratios.min():.3f}" if ratios.size else "-"
        profiles = [flag for r in done for flag in r.get("profiles", [])]
        rows.append(
            [
                *key,
                share(flag for r in done for flag in r["inside"]),
                share(r["joint"] for r in done),
                p_value,
                lowest,
                share(profiles),
                share(r["status"] == "converged" for r in done),
                share(r["warned"] for r in done),
                len(runs) - len(done),
                f"{np.median([r['seconds'] for r in done]):.2f}",
            ]
        )
    return rows


HEADER = [
    "case", "level", "start", "95 % intervals", "joint region", "ratio is chi-square: p", "lowest ratio",
    "profile intervals", "converged", "warned", "refused", "seconds",
]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", nargs="+", choices=["oe", "pem", "ekf"], default=["oe", "pem"])
    parser.add_argument("--level", nargs="+", type=float, default=[0.3, 1.0, 5.0])
    parser.add_argument("--start", nargs="+", choices=list(STARTS), default=["far"])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed of the first recording")
    parser.add_argument("--profile", action="store_true", help="profile intervals, too")
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    print(described(), flush=True)
    done = kept(chosen.json)
    known = {(r["case"], r["level"], r["start"], r["seed"], "profiles" in r or "error" in r) for r in done}
    for case in chosen.case:
        for level in chosen.level:
            for start in chosen.start:
                for seed in range(chosen.first, chosen.first + chosen.runs):
                    key = partial(lambda *parts: parts, case, level, start, seed)
                    if key(True) in known or (not chosen.profile and key(False) in known):
                        continue
                    result = judged(case, level, start, seed, chosen.profile)
                    done.append(result)
                    keep(chosen.json, result)
    print_table(HEADER, told(done))


if __name__ == "__main__":
    main()
