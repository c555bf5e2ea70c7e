"""The experiment of section 3.4.2 of the report: the speed of the motor from the angle of the disc alone.

    daest identify
    python filter_experiment.py [RECORDING.csv] [-o FILE] [--fit results/fit.json] [--set NAME=VALUE]...

RECORDING (default: servo.csv of this folder) has the columns time, u, omega and phi. Parameters are those of
the fit, if one is named, then those that are set, else those of the model. Time-varying and stationary filter
run three times over it: from rest with the right initial state (figure 8 of the report), in the middle of the
motion with zero as the initial state (figure 9), and long after that (figure 10). It prints the error of the
estimated speed against the measured one.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daest.estimation.filter import run_filter
from daest.model.estimates import FilterOptions, FilterResult, InitialState
from daest.model.experiment import Experiment
from daest.model.linear import StateSpaceFamily
from daest.modelica.change import declare, with_values
from daest.modelica.compile import compile_model
from daest.systems.linear.state_space import state_space_family

# (N.m)2 s, unmodelled torques on motor and disc, at places that Theorem 3.1 admits.
NOISES = {"motor.flange_b.tau": 1e-8, "disc.flange_b.tau": 1e-7}
STD = np.array([0.02, 0.01])  # of one sample of omega [rad/s] and phi [rad]
TRANSIENT = 2.0  # s that figures 8 and 9 show
LATE = (20.0, 22.0)  # s after the start that figure 10 shows
WIDE = {"motor.phi": 60.0, "motor.w": 100.0, "disc.phi": 2.0, "disc.w": 4.0}  # std of a start nobody knows


@dataclass(frozen=True)
class Trial:
    """One figure: both filters over the same record from the same guess."""

    title: str
    experiment: Experiment
    varying: FilterResult
    stationary: FilterResult
    window: tuple[float, float]

    def error(self, result: FilterResult) -> float:
        """Root mean square of measured minus estimated speed in the window, rad/s."""
        inside = (result.time - result.time[0] >= self.window[0]) & (
            result.time - result.time[0] < self.window[1]
        )
        speed = result.values[:, result.names.index("omega")]
        return float(np.sqrt(np.nanmean((self.experiment.outputs[inside, 0] - speed[inside]) ** 2)))


def read(path: Path) -> Experiment:
    table = np.genfromtxt(path, delimiter=",", names=True)
    outputs = np.column_stack([table["omega"], table["phi"]])
    return Experiment(path.stem, table["time"], table["u"][:, None], outputs, ("u",), ("omega", "phi"))


def later(experiment: Experiment, start: float) -> Experiment:
    keep = experiment.time >= start
    return Experiment(
        experiment.name,
        experiment.time[keep],
        experiment.inputs[keep],
        experiment.outputs[keep],
        experiment.input_names,
        experiment.output_names,
    )


def fitted(path: Path) -> dict[str, float]:
    """The parameters that daest identify found."""
    found = json.loads(path.read_text(encoding="utf-8"))["parameters"]
    return {name: parameter["value"] for name, parameter in found.items()}


def model(values: dict[str, float]) -> StateSpaceFamily:
    """The report's servo with noise torques on both inertias."""
    flat = with_values(compile_model(Path(__file__).with_name("Servo.mo")), values)
    return state_space_family(declare(flat, noises=NOISES))


def trials(family: StateSpaceFamily, experiment: Experiment) -> list[Trial]:
    zero = np.zeros(len(family.state_names))
    known = InitialState.known(zero, 1e-3)
    guessed = InitialState.known(zero, np.array([WIDE[name] for name in family.state_names]))

    def both(title: str, record: Experiment, start: InitialState, window: tuple[float, float]) -> Trial:
        options = FilterOptions(measurement_cov=STD**2, measure=["phi"], initial=start, hold="zoh")
        found = [run_filter(family, record, kind, options) for kind in ("time-varying", "stationary")]
        return Trial(title, record, found[0], found[1], window)

    moving = later(experiment, experiment.time[0] + 10.0)
    return [
        both("from rest, the start is known (figure 8)", experiment, known, (0.0, TRANSIENT)),
        both("moving, the start is guessed as zero (figure 9)", moving, guessed, (0.05, TRANSIENT)),
        both("long after the wrong start (figure 10)", moving, guessed, LATE),
    ]


def draw(found: list[Trial], path: Path) -> None:
    """Left the speed, right the error of its estimates; one row per trial."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    for (values, errors), trial in zip(figure.subplots(len(found), 2), found, strict=True):
        since = trial.experiment.time - trial.experiment.time[0]
        inside = (since >= trial.window[0]) & (since < trial.window[1])
        measured = trial.experiment.outputs[inside, 0]
        values.plot(since[inside], measured, ".", color="0.6", ms=3, label="measured")
        for result, color in ((trial.stationary, "#c2501c"), (trial.varying, "#1f5fa8")):
            speed = result.values[inside, result.names.index("omega")]
            values.plot(since[inside], speed, color=color, lw=1.0, label=result.kind)
            errors.plot(since[inside], speed - measured, color=color, lw=0.8, label=result.kind)
        values.set_ylabel("omega [rad/s]")
        errors.set_ylabel("estimate - measured [rad/s]")
        values.set_title(trial.title, fontsize=9)
        values.legend(loc="upper right", fontsize=7)
    for axes in (values, errors):
        axes.set_xlabel("time since the start of the filter [s]")
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path, nargs="?", default=Path(__file__).with_name("servo.csv"))
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--fit", type=Path, help="results/fit.json of daest identify")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", dest="values")
    options = parser.parse_args()
    values = fitted(options.fit) if options.fit is not None else {}
    values |= {name: float(value) for name, value in (pair.split("=", 1) for pair in options.values)}
    found = trials(model(values), read(options.recording))
    print("error of the speed from the angle alone, rad/s      time-varying  stationary")
    for trial in found:
        print(f"{trial.title:<50} {trial.error(trial.varying):12.4f} {trial.error(trial.stationary):12.4f}")
    print(f"gain within 1 % of the stationary one after {found[1].varying.steady_after:.2f} s")
    if options.output is not None:
        draw(found, options.output)


if __name__ == "__main__":
    main()
