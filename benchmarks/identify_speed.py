"""How long an identification takes: the spring servo, 8000 samples, 5 parameters, noises and initial
state.

python benchmarks/identify_speed.py

Simulated data of the rig (0.01 s, speed and angle measured). Prints one line per case: seconds of
computing and the number of likelihood evaluations with gradient per second. The goal is 2 s for the first
two cases.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "estimation"))

import hand_models as hand

from daest.estimation.identify import identify
from daest.machine import described
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.systems.linear.state_space import sample, state_space

TRUE = {"d": 0.0226, "c": 1.4367, "J1": 6.838e-6, "J2": 0.02054, "R": 4.316, "k": 0.0675, "n": 30.0}
FAR = {"d": 0.2, "c": 0.3, "J1": 3e-5, "J2": 0.1, "k": 0.02}
N_SAMPLES, PERIOD = 8000, 0.01


def rig_record(intensity: float) -> Experiment:
    family = hand.servo(TRUE, noise={"intensity": intensity})
    theta = np.array([TRUE[p.name] for p in family.parameters])
    model = sample(state_space(family, theta), PERIOD, "foh", np.array([intensity]))
    return hand.recording(model, hand.multisine(N_SAMPLES, PERIOD, 1)[:, None], [0.02, 0.01], 1)


def timed(label: str, method: str, experiment: Experiment, start: dict[str, float]) -> float:
    noise = {"intensity": None, "estimate": True} if method == "pem" else None
    family = hand.servo({**TRUE, **start}, noise=noise)
    began, began_cpu = time.perf_counter(), time.process_time()
    result = identify(family, [experiment], IdentifyOptions(method=method))
    seconds, cpu = time.perf_counter() - began, time.process_time() - began_cpu
    worst = max(abs(p.value / TRUE[p.name] - 1.0) for p in result.parameters)
    print(
        f"{label:52s} {method:4s} {seconds:6.2f} s ({cpu:5.2f} s cpu)  {result.n_iterations:3d} iterations  "
        f"largest error {100 * worst:.2f} %"
    )
    return seconds


def main() -> None:
    print(described(), flush=True)
    quiet, driven = rig_record(0.0), rig_record(1e-4)
    rng = np.random.default_rng(0)
    holes = np.where(rng.random(driven.outputs.shape) < 0.02, np.nan, driven.outputs)
    for method in ("oe", "pem"):
        timed("measurement noise, catalogue start values", method, quiet, hand.RIG_START)
    timed("process noise, catalogue start values", "pem", driven, hand.RIG_START)
    timed("process noise, start values off by up to 10", "pem", driven, FAR)
    timed("process noise, 2 % of the values missing", "pem", replace(driven, outputs=holes), hand.RIG_START)


if __name__ == "__main__":
    main()
