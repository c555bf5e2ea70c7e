"""Speed of identification of a nonlinear servo (4 states, Coulomb friction) beside scipy.

    python benchmarks/nonlinear_identify_speed.py [--samples N] [--json]

Seven parameters from angle and speed, start values up to a third off: output error, by multiple shooting, by
prediction error with an observer, and profile likelihoods of all parameters; all must find the truth. The
peer is scipy's least_squares with finite differences over LSODA, on a shorter record, given per 8000
samples. Exit code 1 when a target is missed. Set OMP_NUM_THREADS=1 for repeatable figures.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import numpy as np
from nonlinear_speed import NAMES, VALUES, by_scipy, drive, servo, told
from scipy.optimize import least_squares

from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions, NoiseChoice
from daest.systems.simulation.integrate import integrate, integrator

SHORT = 400  # samples of scipy, which loops over them in Python
ESTIMATED = ("J1", "J2", "d", "c", "k", "stick", "width")
START = {"J1": 7e-3, "J2": 0.015, "d": 0.03, "c": 1.2, "k": 0.05, "stick": 0.015, "width": 0.4}
STD = np.array([0.05, 0.01])
WORST = 0.05  # relative error of a parameter other than the width that still is the truth
TARGETS = {"output error, s per 8000 samples": 10.0}


def recorded(n_samples: int) -> Experiment:
    explicit = servo()
    time_grid, u = drive(n_samples)
    y = integrate(integrator(explicit), time_grid, u, np.array(VALUES), np.zeros(4), hold="zoh").outputs
    y = y + STD * np.random.default_rng(0).standard_normal(y.shape)
    return Experiment("servo", time_grid, u, y, ("u",), ("speed", "angle"))


def options(method: str, **given: object) -> IdentifyOptions:
    no_noise = {name: NoiseChoice(0.0, False) for name in ("motor",)} if method == "pem" else {}
    return IdentifyOptions(
        method=method, estimate=ESTIMATED, start=START, hold="zoh", process_noise=no_noise, **given
    )  # type: ignore[arg-type]


def timed(run: Callable[[], FitResult]) -> float:
    began = time.perf_counter()
    fit = run()
    seconds = time.perf_counter() - began
    check(fit.theta)
    return seconds


def check(found: dict[str, float]) -> None:
    """The contestant found the truth."""
    for name, value in zip(NAMES, VALUES, strict=True):
        if name in found and name != "width" and abs(found[name] / value - 1.0) > WORST:
            raise SystemExit(f"{name} = {found[name]:.4g} instead of {value:.4g}")


def by_least_squares(experiment: Experiment) -> float:
    """Seconds of scipy on the first SHORT samples, from the same start."""
    rows = slice(0, SHORT)
    known = dict(zip(NAMES, VALUES, strict=True))

    def residuals(logs: np.ndarray) -> np.ndarray:
        theta = {**known, **dict(zip(ESTIMATED, np.exp(logs), strict=True))}
        states = by_scipy(experiment.time[rows], experiment.inputs, np.array([theta[n] for n in NAMES]))
        return ((states[:, [0, 3]] - experiment.outputs[rows]) / STD).ravel()

    began = time.perf_counter()
    least_squares(residuals, np.log([START[n] for n in ESTIMATED]), x_scale="jac", max_nfev=15)
    return time.perf_counter() - began


def measure(n_samples: int) -> dict[str, float]:
    experiment, flat = recorded(n_samples), servo().flat
    per_8000 = 8000 / n_samples

    def fit(method: str, **given: object) -> float:
        return timed(lambda: identify(flat, [experiment], options(method, **given))) * per_8000

    fit("oe")  # compiles
    return {
        "output error, s per 8000 samples": fit("oe"),
        "output error by multiple shooting, s per 8000 samples": fit("oe", shooting=20),
        "prediction error with an observer, s per 8000 samples": fit("pem"),
        "output error with all profiles, s per 8000 samples": fit("oe", profile=("all",)),
        "scipy least_squares with LSODA, s per 8000 samples": by_least_squares(experiment) * 8000 / SHORT,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=8000)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    return told(measure(given.samples), TARGETS, given.json)


if __name__ == "__main__":
    sys.exit(main())
