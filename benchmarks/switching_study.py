"""How honest the intervals of fits are for machines that switch: a clutch, a sampled loop, an arm.

    python benchmarks/switching_study.py -L FOLDER [--case clutch|loop|arm] [--runs N] [--first SEED]
                                         [--json FILE]

Each recording is simulated by formulas that share nothing with daest (closed forms between the instants at
which the clutch sticks or slips, the exact discretisation of the loop, Lagrange's equations of the arm
integrated by scipy), with white measurement noise and values that differ by up to 20 % from run to run. The
fit starts from the values of the model. Told are how often the 95 % interval of an estimate holds the truth,
the root mean square of the errors over their standard errors (1 is honest), and the relative error.
FOLDER holds the Modelica Standard Library.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from daest.errors import DaestError
from daest.estimation.identify import identify
from daest.machine import described
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_text

SPREAD = 0.2  # of the true values about those of the model, as a share
NORMAL_95 = 1.959964

CLUTCH = """model Coupling "A motor and a load, joined by a clutch"
  parameter Real J(min = 0) = 0.05 annotation(__Daest(estimate = true));
  parameter Real fn(min = 0) = 15 annotation(__Daest(estimate = true));
  parameter Real d(min = 0) = 0.05 annotation(__Daest(estimate = true));
  input Real tau;
  input Real press;
  output Real w1 = motor.w annotation(__Daest(std = 0.05));
  output Real w2 = load.w annotation(__Daest(std = 0.05));
  Modelica.Mechanics.Rotational.Components.Inertia motor(J = 0.02, phi(start = 0, fixed = true),
    w(start = 0, fixed = true));
  Modelica.Mechanics.Rotational.Components.Clutch clutch(fn_max = fn, mu_pos = [0, 0.4], peak = 1,
    cgeo = 0.2);
  Modelica.Mechanics.Rotational.Components.Inertia load(J = J, phi(start = 0, fixed = true),
    w(start = 0, fixed = true));
  Modelica.Mechanics.Rotational.Components.Damper damper(d = d);
  Modelica.Mechanics.Rotational.Components.Fixed ground;
  Modelica.Mechanics.Rotational.Sources.Torque drive;
equation
  drive.tau = tau;
  clutch.f_normalized = press;
  connect(drive.flange, motor.flange_a);
  connect(motor.flange_b, clutch.flange_a);
  connect(clutch.flange_b, load.flange_a);
  connect(load.flange_b, damper.flange_a);
  connect(damper.flange_b, ground.flange);
end Coupling;
"""

LOOP = """model Loop "A motor with current dynamics under a sampled PI controller of its speed"
  parameter Real J(min = 0) = 0.02 annotation(__Daest(estimate = true));
  parameter Real d(min = 0) = 0.01 annotation(__Daest(estimate = true));
  parameter Real T(min = 0) = 0.03 annotation(__Daest(estimate = true));
  input Real r;
  output Real w annotation(__Daest(std = 0.05));
  Real tau(start = 0, fixed = true);
  discrete Real command(start = 0, fixed = true);
  discrete Real sum(start = 0, fixed = true);
initial equation
  w = 0;
equation
  J*der(w) = tau - d*w;
  T*der(tau) = command - tau;
  when sample(0, 0.04) then
    sum = pre(sum) + 0.004*(r - w);
    command = 0.2*(r - w) + sum;
  end when;
end Loop;
"""

ARM = """model Arm "Two links in a vertical plane"
  parameter Real m1(min = 0) = 1.5 annotation(__Daest(estimate = true));
  parameter Real m2(min = 0) = 1.0 annotation(__Daest(estimate = true));
  parameter Real d(min = 0) = 0.2 annotation(__Daest(estimate = true));
  input Real tau1;
  input Real tau2;
  output Real q1 = first.phi annotation(__Daest(std = 0.002));
  output Real q2 = second.phi annotation(__Daest(std = 0.002));
  inner Modelica.Mechanics.MultiBody.World world(enableAnimation = false);
  Modelica.Mechanics.MultiBody.Joints.Revolute first(useAxisFlange = true, animation = false,
    phi(start = 0, fixed = true), w(start = 0, fixed = true));
  Modelica.Mechanics.MultiBody.Joints.Revolute second(useAxisFlange = true, animation = false,
    phi(start = 0, fixed = true), w(start = 0, fixed = true));
  Modelica.Mechanics.MultiBody.Parts.Body link1(animation = false, m = m1, r_CM = {0.25, 0, 0}, I_33 = 0.01);
  Modelica.Mechanics.MultiBody.Parts.FixedTranslation bar(animation = false, r = {0.5, 0, 0});
  Modelica.Mechanics.MultiBody.Parts.Body link2(animation = false, m = m2, r_CM = {0.2, 0, 0}, I_33 = 0.008);
  Modelica.Mechanics.Rotational.Sources.Torque motor1(useSupport = false);
  Modelica.Mechanics.Rotational.Sources.Torque motor2(useSupport = false);
  Modelica.Mechanics.Rotational.Components.Damper rub1(d = d);
  Modelica.Mechanics.Rotational.Components.Damper rub2(d = d);
equation
  motor1.tau = tau1;
  motor2.tau = tau2;
  connect(world.frame_b, first.frame_a);
  connect(first.frame_b, link1.frame_a);
  connect(first.frame_b, bar.frame_a);
  connect(bar.frame_b, second.frame_a);
  connect(second.frame_b, link2.frame_a);
  connect(motor1.flange, first.axis);
  connect(motor2.flange, second.axis);
  connect(rub1.flange_a, first.support);
  connect(rub1.flange_b, first.axis);
  connect(rub2.flange_a, second.support);
  connect(rub2.flange_b, second.axis);
end Arm;
"""

Simulator = Callable[[dict[str, float], np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Machine:
    """A model with its values, period [s] and number of samples, and its simulator: (values, time, inputs
    (n_samples, n_u), held over each sample) -> outputs (n_samples, n_y)."""

    text: str
    values: dict[str, float]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    std: float
    period: float
    samples: int
    excitation: Callable[[np.random.Generator, int], np.ndarray]
    simulator: Simulator


# The clutch -------------------------------------------------------------------------------------------------

MOTOR, GRIP = 0.02, 0.4 * 0.2  # kg.m2; friction coefficient times radius [m]
NEAR = 1e-6  # share of its grip by which the clutch holds more before it slips, so that it does not chatter


def coupling(p: dict[str, float], t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Between changes the clutch sticks, slips with one sign, or is open: the speeds have closed forms."""
    w, found = (0.0, 0.0), np.zeros((t.size, 2))
    for k in range(t.size - 1):
        found[k] = w
        left = float(t[k + 1] - t[k])
        while left > 1e-13:
            w, passed = _clutch_piece(p, w, u[k, 0], max(u[k, 1], 0.0) * p["fn"] * GRIP, left)
            left -= passed
    found[-1] = w
    return found


def _clutch_piece(
    p: dict[str, float], w: tuple[float, float], tau: float, grip: float, left: float
) -> tuple[tuple[float, float], float]:
    """Both speeds after the piece, and how long it lasts: up to `left`, or until the clutch may change."""
    J, d = p["J"], p["d"]
    if abs(w[0] - w[1]) < 1e-12 and grip > 0:
        speed = 0.5 * (w[0] + w[1])
        held, total = tau / d, MOTOR + J

        def torque(h: float) -> float:
            """What the clutch carries while it sticks."""
            at = held + (speed - held) * math.exp(-d * h / total)
            return tau - MOTOR * (tau - d * at) / total

        if abs(torque(0.0)) <= grip * (1 + NEAR):
            most = grip * (1 + 2 * NEAR)
            over = [sign for sign in (1, -1) if sign * torque(left) > most]
            h = brentq(lambda h: over[0] * torque(h) - most, 0.0, left, xtol=1e-15) if over else left
            at = held + (speed - held) * math.exp(-d * h / total)
            return (at, at), max(h, 1e-12)
        sign = math.copysign(1.0, torque(0.0))
    else:
        sign = math.copysign(1.0, w[0] - w[1])
    carried = sign * grip
    end = carried / d

    def speeds(h: float) -> tuple[float, float]:
        return w[0] + (tau - carried) / MOTOR * h, end + (w[1] - end) * math.exp(-d * h / J)

    def slip(h: float) -> float:
        one, two = speeds(h)
        return sign * (one - two)

    grid = np.linspace(0, left, 9)[1:]
    meets = [h for h in grid if slip(h) < 0] if grip > 0 else []
    if not meets:
        return speeds(left), left
    low = max(meets[0] - left / 8, left * 1e-3)
    h = brentq(slip, low, meets[0], xtol=1e-15) if slip(low) > 0 else low
    at = speeds(h)[1]
    return (at, at), max(h, 1e-12)


def clutch_excitation(rng: np.random.Generator, n: int) -> np.ndarray:
    torque = np.repeat(rng.uniform(-1.5, 3.0, n // 40 + 1), 40)[:n]
    press = np.repeat(rng.choice([0.0, 0.6, 1.0, 1.5, 3.0], n // 25 + 1), 25)[:n]
    return np.column_stack([torque, press])


# The sampled loop -------------------------------------------------------------------------------------------


def loop(p: dict[str, float], t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Exact discretisation; the controller ticks at every second sample."""
    A = np.zeros((3, 3))
    A[0, :2], A[1, 1:] = (-p["d"] / p["J"], 1 / p["J"]), (-1 / p["T"], 1 / p["T"])
    step = expm(A * (t[1] - t[0]))
    x, total, found = np.zeros(3), 0.0, np.zeros((t.size, 1))
    for k in range(t.size):
        found[k] = x[0]
        if k % 2 == 0:
            total += 0.004 * (u[k, 0] - x[0])
            x[2] = 0.2 * (u[k, 0] - x[0]) + total
        x = step @ x
    return found


def loop_excitation(rng: np.random.Generator, n: int) -> np.ndarray:
    return 4 * np.repeat(rng.uniform(-1, 1, n // 30 + 1), 30)[:n, None]


# The arm ----------------------------------------------------------------------------------------------------

LENGTH, CENTRE, TURN = 0.5, (0.25, 0.2), (0.01, 0.008)  # m, m, kg.m2
GRAVITY = 9.80665


def arm(p: dict[str, float], t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Lagrange's equations of two links, the second angle relative to the first, gravity along -y."""
    m1, m2, d = p["m1"], p["m2"], p["d"]
    a, b = m2 * LENGTH * CENTRE[1], m2 * CENTRE[1] ** 2 + TURN[1]
    first = m1 * CENTRE[0] ** 2 + TURN[0] + m2 * LENGTH**2

    def rates(_: float, x: np.ndarray, torque: np.ndarray) -> np.ndarray:
        q, w = x[:2], x[2:]
        c, s = math.cos(q[1]), math.sin(q[1])
        off = b + a * c
        M = np.array([[first + b + 2 * a * c, off], [off, b]])
        moving = np.array([-a * s * (2 * w[0] * w[1] + w[1] ** 2), a * s * w[0] ** 2])
        outer = m2 * GRAVITY * CENTRE[1] * math.cos(q[0] + q[1])
        weight = np.array([(m1 * CENTRE[0] + m2 * LENGTH) * GRAVITY * math.cos(q[0]) + outer, outer])
        return np.concatenate([w, np.linalg.solve(M, torque - d * w - moving - weight)])

    x, found = np.zeros(4), np.zeros((t.size, 2))
    for k in range(t.size - 1):
        found[k] = x[:2]
        run = solve_ivp(rates, t[k : k + 2], x, "DOP853", args=(u[k],), rtol=1e-9, atol=1e-11)
        x = run.y[:, -1]
    found[-1] = x[:2]
    return found


def arm_excitation(rng: np.random.Generator, n: int) -> np.ndarray:
    held = np.array([1.5 * 0.25 + 1.0 * 0.5 + 1.0 * 0.2, 0.2]) * GRAVITY
    return np.asarray(held + np.repeat(rng.uniform(-1, 1, (n // 20 + 1, 2)), 20, axis=0)[:n] * (4.0, 1.0))


MACHINES = {
    "clutch": Machine(
        CLUTCH, {"J": 0.05, "fn": 15.0, "d": 0.05}, ("tau", "press"), ("w1", "w2"), 0.05, 0.01, 400,
        clutch_excitation, coupling,
    ),
    "loop": Machine(
        LOOP, {"J": 0.02, "d": 0.01, "T": 0.03}, ("r",), ("w",), 0.05, 0.02, 400, loop_excitation, loop
    ),
    "arm": Machine(
        ARM, {"m1": 1.5, "m2": 1.0, "d": 0.2}, ("tau1", "tau2"), ("q1", "q2"), 0.002, 0.01, 300,
        arm_excitation, arm,
    ),
}  # fmt: skip


# The study --------------------------------------------------------------------------------------------------


def recording(machine: Machine, seed: int) -> tuple[Experiment, dict[str, float]]:
    """A noisy recording, and the values behind it."""
    rng, n = np.random.default_rng(seed), machine.samples
    truth = {name: v * rng.uniform(1 - SPREAD, 1 + SPREAD) for name, v in machine.values.items()}
    t, u = np.arange(n) * machine.period, machine.excitation(rng, n)
    y = machine.simulator(truth, t, u)
    noisy = y + machine.std * rng.standard_normal(y.shape)
    return Experiment(f"run {seed}", t, u, noisy, machine.inputs, machine.outputs), truth


def runs(name: str, seeds: Sequence[int], libraries: Sequence[str]) -> list[dict]:
    machine = MACHINES[name]
    model = machine.text.split()[1]
    flat = compile_text(machine.text.encode(), Path(f"{model}.mo"), libraries=libraries)
    found = []
    for seed in seeds:
        experiment, truth = recording(machine, seed)
        began = time.process_time()
        row: dict = {"case": name, "seed": seed, "truth": truth}
        try:
            fit = identify(flat, [experiment], IdentifyOptions(method="oe", hold="zoh", seed=seed))
        except DaestError as error:
            row["refused"] = f"{error.code}: {error.what}"
        else:
            row["estimates"] = {p.name: p.value for p in fit.parameters}
            row["std_errors"] = {p.name: p.std_error for p in fit.parameters}
            simulated = fit.simulated["estimation"].rms
            row["rms"] = dict(simulated)
        row["seconds"] = time.process_time() - began
        print(json.dumps(row), flush=True)
        found.append(row)
    return found


def summary(rows: Sequence[dict]) -> list[str]:
    """One line per case and parameter."""
    lines = ["case    parameter  runs  inside 95 %  rms error/std  rms relative error"]
    for case in dict.fromkeys(row["case"] for row in rows):
        fits = [row for row in rows if row["case"] == case and "estimates" in row]
        for name in MACHINES[case].values:
            told = [row for row in fits if row["std_errors"][name] is not None]
            off = np.array([row["estimates"][name] - row["truth"][name] for row in told])
            share = off / np.array([row["truth"][name] for row in told])
            score = off / np.array([row["std_errors"][name] for row in told])
            inside = int(np.sum(np.abs(score) <= NORMAL_95))
            lines.append(
                f"{case:<8}{name:<11}{len(told):<6}{f'{inside}/{len(told)}':<13}"
                f"{_rms(score):<15.2f}{_rms(share):.4f}"
            )
        refused = sum("refused" in row for row in rows if row["case"] == case)
        lines += [f"{case}: {refused} refused"] if refused else []
    return lines


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("-L", dest="libraries", action="append", default=[], metavar="FOLDER")
    parser.add_argument("--case", choices=sorted(MACHINES), action="append")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    print(described())
    seeds = range(given.first, given.first + given.runs)
    rows = [row for case in given.case or MACHINES for row in runs(case, seeds, given.libraries)]
    print("\n".join(summary(rows)))
    if given.json is not None:
        given.json.write_text(json.dumps({"machine": described(), "runs": rows}, indent=1))


if __name__ == "__main__":
    main()
