"""Speed of the Kalman filter beside statsmodels and filterpy: 4 states, 2 outputs, peers in the same run.

    python benchmarks/filter_speed.py [--samples N] [--rounds N] [--json]

Each figure is the fastest of several runs, in microseconds per sample. filterpy, a plain Python
loop, runs on a shorter record. Exit code 1 when a target is missed.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable

import numpy as np

from daest.estimation.kalman import kalman_filter, log_likelihood
from daest.estimation.smoother import smooth
from daest.model.estimates import InitialState
from daest.model.experiment import Experiment
from daest.model.linear import DiscreteModel
from daest.numerics.recursions import linear_recursion

PERIOD = 0.01
SHORT = 20_000  # samples for a filter that loops in Python
TARGETS = {"filter": 10.0, "log-likelihood": 3.0}  # how many times faster than statsmodels


def two_mass_model() -> DiscreteModel:
    """Two damped oscillators, both positions measured, white noise on both velocities."""
    Phi = np.zeros((4, 4))
    for i, (frequency, damping) in enumerate(((3.0, 0.3), (7.0, 0.5))):
        decay, angle = np.exp(-damping * PERIOD), frequency * PERIOD
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        Phi[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = decay * turn
    G = np.zeros((4, 2))
    G[1, 0] = G[3, 1] = 0.1
    return DiscreteModel(
        transition=Phi,
        input_now=np.zeros((4, 0)),
        input_next=np.zeros((4, 0)),
        drift=np.zeros(4),
        output=np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]]),
        feedthrough=np.zeros((2, 0)),
        output_offset=np.zeros(2),
        process_cov=G @ G.T,
        measurement_cov=0.04 * np.eye(2),
        cross_cov=np.zeros((4, 2)),
        noise_cov=np.eye(2),
        noise_process_cov=G.T.copy(),
        noise_measurement_cov=np.zeros((2, 2)),
        period=PERIOD,
        hold="zoh",
    )


def record(model: DiscreteModel, n_samples: int, seed: int = 0) -> Experiment:
    """Outputs drawn from the model, which has no input."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((n_samples, 2)) @ model.noise_process_cov
    states = linear_recursion(model.transition, noise[:-1], np.zeros(4))
    y = states @ model.output.T + 0.2 * rng.standard_normal((n_samples, 2))
    names = (), ("y1", "y2")
    return Experiment("benchmark", PERIOD * np.arange(n_samples), np.zeros((n_samples, 0)), y, *names)


def fastest(contestants: dict[str, tuple[Callable[[], object], int]], rounds: int) -> dict[str, float]:
    """Microseconds per sample of the fastest run of each; all run in every round and share the load."""
    best = dict.fromkeys(contestants, np.inf)
    for _ in range(rounds):
        for name, (run, n_samples) in contestants.items():
            start = time.perf_counter()
            run()
            best[name] = min(best[name], 1e6 * (time.perf_counter() - start) / n_samples)
    return best


def statsmodels_filter(model: DiscreteModel, experiment: Experiment):
    from statsmodels.tsa.statespace.kalman_filter import KalmanFilter

    peer = KalmanFilter(k_endog=2, k_states=4)
    peer.bind(experiment.outputs)
    peer["design"], peer["obs_cov"] = model.output, model.measurement_cov
    peer["transition"], peer["selection"] = model.transition, np.eye(4)
    peer["state_cov"] = model.process_cov
    peer.initialize_known(np.zeros(4), np.eye(4))
    return peer


def filterpy_run(model: DiscreteModel, experiment: Experiment) -> None:
    from filterpy.kalman import KalmanFilter

    peer = KalmanFilter(dim_x=4, dim_z=2)
    peer.F, peer.H, peer.Q, peer.R = model.transition, model.output, model.process_cov, model.measurement_cov
    peer.x, peer.P = np.zeros(4), np.eye(4)
    for y in experiment.outputs:
        peer.update(y)
        peer.predict()


def measure(n_samples: int, rounds: int) -> dict[str, float]:
    """Microseconds per sample of every contestant."""
    model = two_mass_model()
    experiment, short = record(model, n_samples), record(model, SHORT)
    gaps = record(model, SHORT)
    gaps.outputs[np.random.default_rng(1).uniform(size=gaps.outputs.shape) < 0.1] = np.nan
    known, kalman = InitialState.known(np.zeros(4), 1.0), statsmodels_filter(model, experiment)
    filtered = kalman_filter(model, experiment, known)
    difference = abs(filtered.log_likelihood / kalman.loglike() - 1.0)
    if difference > 1e-9:
        raise SystemExit(f"the log-likelihoods differ by {difference:.1e} relative: not the same problem")
    contestants = {
        "daest filter, stationary": (
            lambda: kalman_filter(model, experiment, known, "stationary"),
            n_samples,
        ),
        "daest filter, time-varying": (lambda: kalman_filter(model, experiment, known), n_samples),
        "daest filter, unknown start": (lambda: kalman_filter(model, experiment), n_samples),
        "daest log-likelihood": (lambda: log_likelihood(model, experiment, known), n_samples),
        "daest smoother": (lambda: smooth(filtered), n_samples),
        "daest filter, 10 % missing": (lambda: kalman_filter(model, gaps, known), SHORT),
        "statsmodels filter": (kalman.filter, n_samples),
        "statsmodels log-likelihood": (kalman.loglike, n_samples),
        "filterpy filter": (lambda: filterpy_run(model, short), SHORT),
    }
    return fastest(contestants, rounds)


def ratios(times: dict[str, float]) -> dict[str, float]:
    return {
        "filter": times["statsmodels filter"] / times["daest filter, stationary"],
        "log-likelihood": times["statsmodels log-likelihood"] / times["daest log-likelihood"],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    times = measure(options.samples, options.rounds)
    faster = ratios(times)
    if options.json:
        print(json.dumps({"microseconds_per_sample": times, "times_faster_than_statsmodels": faster}))
    else:
        print(f"{options.samples} samples, 4 states, 2 outputs; microseconds per sample")
        for name, value in times.items():
            print(f"  {name:<30} {value:8.3f}")
        for name, value in faster.items():
            print(f"{name}: {value:.1f} times faster than statsmodels (target {TARGETS[name]:.0f})")
    return 0 if all(faster[name] >= target for name, target in TARGETS.items()) else 1


if __name__ == "__main__":
    sys.exit(main())
