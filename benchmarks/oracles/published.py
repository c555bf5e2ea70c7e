"""Fits beside published ones on the same data, and beside an independent optimum where none is published.

Data of others are read from a folder (`--data`), not kept here:

- `Ornstein.csv` (t, y, u): the data set `Ornstein` of the R package ctsmTMB as in its version 1.0.1
  (`write.csv(ctsmTMB::Ornstein, "Ornstein.csv", row.names = FALSE)`). Published: the fit printed in the
  manual of `print.ctsmTMB.fit`. The package moves the moments by one Runge-Kutta step of order 4 per sample;
  its θ is translated to the exact solution by the stability function of that step.
- `Ornstein2D.csv` (t, u, y1, y2): its data set `Ornstein2D`, first 50 rows. Published: the reference data of
  its tests, method "lkf", with held inputs and with straight ones.
- `heating_system.dat`: DaISy, heating system (R. Smith). No fit of a model in continuous time is published
  with the data; the peer is scipy (`least_squares` over an exact simulation).

The example "heat dynamics of a wall" of CTSM-R comes with the values that its data were generated with, which
are used here; the data themselves could not be had, so a record is drawn by the same recipe and the peer is
`least_squares` again.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import expm
from scipy.optimize import OptimizeResult, least_squares, minimize

import daest
from daest.estimation.filter_engines.kalman import kalman_filter
from daest.estimation.identify import identify
from daest.machine import described
from daest.model.estimates import InitialState
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions, Method, NoiseChoice
from daest.systems.linear.state_space import Hold, sample, state_space, state_space_family

MODELS = Path(__file__).parent / "models"
SMALLEST = 1e-10  # of a standard deviation, as in ctsmTMB


@dataclass(frozen=True)
class Row:
    """One fit: who made it, its estimates by name and its log-likelihood (None where not told)."""

    example: str
    by: str
    estimates: Mapping[str, float]
    log_likelihood: float | None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("."), help="folder with the data of others")
    folder = parser.parse_args().data
    print(described(), flush=True)
    for name, rows in (
        ("Ornstein.csv", ornstein),
        ("Ornstein2D.csv", ornstein_2d),
        ("heating_system.dat", heating),
    ):
        if (folder / name).exists():
            show(rows(folder / name))
        else:
            print(f"{name} is not in {folder}\n")
    show(wall())


def show(rows: list[Row]) -> None:
    print(rows[0].example)
    names = list(dict.fromkeys(name for row in rows for name in row.estimates))
    print("  " + "".join(f"{name:>12}" for name in names) + f"{'log L':>16}")
    for row in rows:
        values = "".join(
            f"{row.estimates[name]:12.6g}" if name in row.estimates else f"{'':>12}" for name in names
        )
        said = "" if row.log_likelihood is None else f"{row.log_likelihood:16.7f}"
        print(f"  {values}{said or ' ' * 16}  {row.by}")
    print()


def ornstein(path: Path) -> list[Row]:
    table = np.genfromtxt(path, delimiter=",", names=True)
    experiment = _experiment(table["t"], table["u"], table["y"], ("u",), ("y",))
    published = {"theta": 5.140485, "mu": 3.005177, "sigma_x": 1.271765}
    h = float(np.median(np.diff(table["t"])))
    decay = np.polyval([1 / 24, -1 / 6, 1 / 2, -1.0, 1.0], published["theta"] * h)
    exact = {"theta": -float(np.log(decay)) / h, "mu": published["mu"]}
    start = InitialState(np.array([1.0]), np.array([[0.1]]))
    return [
        Row(
            f"Ornstein-Uhlenbeck process, {table.size} samples",
            "published, Runge-Kutta",
            published,
            -73.87879,
        ),
        Row("", "published, translated to the exact solution", exact, None),
        _by_hand("their Runge-Kutta step and start by hand", _their_filter, experiment),
        _best("Ornstein", experiment, "foh", start, {"y": 0.01}, "daest, start given as there"),
        _identified("Ornstein", experiment, "foh"),
        _by_hand("the criterion of daest identify by hand", _our_filter, experiment),
    ]


def _by_hand(by: str, criterion: Callable[[np.ndarray, Experiment], float], experiment: Experiment) -> Row:
    first = [1.0, 1.5, 1.0, float(experiment.outputs[0, 0])]
    bounds = [(1e-5, 50.0), (0.0, 5.0), (1e-10, 30.0), (-10.0, 10.0)]
    found = _minimum(lambda p: criterion(p, experiment), first, bounds)
    estimates = dict(zip(("theta", "mu", "sigma_x"), map(float, found.x), strict=False))
    return Row("", by, estimates, -float(found.fun))


def ornstein_2d(path: Path) -> list[Row]:
    table = np.genfromtxt(path, delimiter=",", names=True)[:50]
    outputs = np.column_stack([table["y1"], table["y2"]])
    experiment = _experiment(table["t"], table["u"], outputs, ("u",), ("y1", "y2"))
    start = InitialState(np.array([3.0, 3.0]), 0.1 * np.eye(2))
    names = ("theta", "mu", "alpha", "sigma_x1", "sigma_x2", "sigma_y1", "sigma_y2")
    logs: dict[Hold, tuple[list[float], float]] = {
        "zoh": (
            [1.83395528, 2.90603075, 0.46206721, 0.33367423, -0.93322187, -12.17987428, -2.02769837],
            -4.80814948,
        ),
        "foh": (
            [1.9060834, 2.92130579, 0.46618081, 0.29140215, -0.93130499, -12.81116887, -2.0306624],
            -1.75327932,
        ),
    }
    rows = []
    for hold, (values, value) in logs.items():
        told = {n: float(v if n == "mu" else np.exp(v)) for n, v in zip(names, values, strict=True)}
        rows.append(Row(f"Ornstein-Uhlenbeck process and lag, 50 samples, {hold}", "published", told, value))
        given = "daest, start given as there"
        rows.append(_best("Ornstein2D", experiment, hold, start, {}, given))
    return rows


def heating(path: Path) -> list[Row]:
    table = np.loadtxt(path)
    experiment = _experiment(table[:, 0], table[:, 1], table[:, 2], ("u",), ("y",))
    first = {"k": 15.0, "T": 100.0, "y0": 30.0}
    x0 = [float(table[0, 2]) - 30.0]
    return [
        Row(f"DaISy heating system, {len(table)} samples", "published: none", {}, None),
        _identified("Heating", experiment, "zoh", "oe"),
        _least_squares(_heating, first, x0, experiment, "zoh"),
    ]


def wall(n: int = 700, seed: int = 1) -> list[Row]:
    true = {"C1": 100.0, "C2": 50.0, "R1": 1.0, "R2": 2.0, "R3": 0.5}
    rng = np.random.default_rng(seed)
    time = np.arange(float(n))
    Te = 5.0 + 6.0 * np.sin(2 * np.pi * time / 144.0) + np.cumsum(rng.normal(0.0, 0.2, n))
    Ti = 20.0 + 5.0 * np.repeat(rng.integers(0, 2, n // 35), 35)
    inputs = np.column_stack([Te, Ti])
    A, B, C, D = _wall(np.array(list(true.values())))
    Phi, now, following = _sampled(A, B, 1.0, "foh")
    x, q = np.array([13.0, 25.0]), np.empty(n)
    for i in range(n):
        q[i] = (C @ x + D @ inputs[i])[0] + 0.01 * rng.standard_normal()
        x = Phi @ x + now @ inputs[i] + following @ inputs[min(i + 1, n - 1)]
    experiment = _experiment(time, inputs, q, ("Te", "Ti"), ("q",))
    first = {"C1": 80.0, "C2": 60.0, "R1": 1.3, "R2": 1.6, "R3": 0.6}
    return [
        Row(f"heat dynamics of a wall, recipe of CTSM-R, {n} samples", "truth", true | {"std": 0.01}, None),
        _identified("Wall", experiment, "foh", "oe"),
        _least_squares(_wall, first, [13.0, 25.0], experiment, "foh"),
    ]


def _experiment(
    time: np.ndarray, inputs: np.ndarray, outputs: np.ndarray, u: tuple[str, ...], y: tuple[str, ...]
) -> Experiment:
    shaped = [part if part.ndim == 2 else part[:, None] for part in (inputs, outputs)]
    return Experiment("published", time, shaped[0], shaped[1], u, y)


def _identified(model: str, experiment: Experiment, hold: Hold, method: Method = "pem") -> Row:
    flat = daest.compile_model(MODELS / f"{model}.mo")
    options = IdentifyOptions(method=method, hold=hold)
    if method == "pem":
        known, sought = {"y": NoiseChoice(0.01, False)}, {"w": NoiseChoice(None, True)}
        options = replace(options, measurement_noise=known, process_noise=sought)
    fit = identify(flat, [experiment], options)
    estimates = {p.name: p.value for p in fit.parameters}
    for noise in fit.noises:
        if noise.estimated:
            name, value = (
                ("sigma_x", np.sqrt(noise.value)) if noise.kind == "process" else ("std", noise.value)
            )
            estimates[name] = float(value)
    return Row("", f"daest identify, {fit.status}", estimates, fit.log_likelihood)


def _best(
    model: str, experiment: Experiment, hold: Hold, start: InitialState, std: Mapping[str, float], by: str
) -> Row:
    """The maximum of daest's likelihood with a given initial state, over parameters and noises; `std` of the
    outputs in it are given."""
    family = state_space_family(daest.compile_model(MODELS / f"{model}.mo"))
    free = [o.name for o in family.outputs if o.name not in std]
    n, n_w = len(family.parameters), len(family.noises)
    h = float(np.median(np.diff(experiment.time)))
    is_log = [p.name != "mu" for p in family.parameters] + [True] * (n_w + len(free))

    def values(z: np.ndarray) -> np.ndarray:
        return np.where(is_log, np.exp(np.where(is_log, z, 0.0)), z)

    def minus(z: np.ndarray) -> float:
        v = values(z)
        noise = iter(v[n + n_w :])
        R = np.diag([(std[o.name] if o.name in std else next(noise)) ** 2 for o in family.outputs])
        ss = state_space(family, v[:n])
        sampled = sample(ss, h, hold, np.diag(v[n : n + n_w] ** 2), R)
        return -kalman_filter(sampled, experiment, start).log_likelihood

    first = [p.value for p in family.parameters] + [1.0, 0.5][:n_w] + [0.1] * len(free)
    z = np.where(is_log, np.log(first), first)
    bounds = [(np.log(SMALLEST), np.log(50.0)) if log else (-10.0, 10.0) for log in is_log]
    found = _minimum(minus, z, bounds)
    suffix = [w.name.replace("w", "x") for w in family.noises]
    names = [p.name for p in family.parameters] + [f"sigma_{s}" for s in suffix]
    names += [f"sigma_{name}" for name in free]
    return Row("", by, dict(zip(names, map(float, values(found.x)), strict=True)), -float(found.fun))


def _minimum(
    function: Callable[[np.ndarray], float], first: Sequence[float], bounds: Sequence[tuple]
) -> OptimizeResult:
    """L-BFGS with gradients by differences, which end early, and the simplex from there."""
    found = minimize(function, first, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-15})
    fine = {"xatol": 1e-9, "fatol": 1e-11, "maxfev": 4000, "adaptive": True}
    return minimize(function, found.x, method="Nelder-Mead", bounds=bounds, options=fine)


Matrices = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _heating(p: np.ndarray) -> Matrices:
    """A, B, C, D; the last input is 1."""
    k, T, y0 = p
    return np.array([[-1 / T]]), np.array([[k / T, 0.0]]), np.eye(1), np.array([[0.0, y0]])


def _wall(p: np.ndarray) -> Matrices:
    C1, C2, R1, R2, R3 = p
    A = np.array([[-(1 / R1 + 1 / R2) / C1, 1 / (R2 * C1)], [1 / (R2 * C2), -(1 / R2 + 1 / R3) / C2]])
    B = np.array([[1 / (R1 * C1), 0.0], [0.0, 1 / (R3 * C2)]])
    return A, B, np.array([[0.0, -1 / R3]]), np.array([[0.0, 1 / R3]])


def _sampled(A: np.ndarray, B: np.ndarray, h: float, hold: Hold) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Φ and the weights of the input at both ends of an interval."""
    n, m = B.shape
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n], block[:n, n : n + m] = A * h, B * h
    block[n : n + m, n + m :] = np.eye(m)
    whole = expm(block)
    constant, ramp = whole[:n, n : n + m], whole[:n, n + m :]
    return (whole[:n, :n], constant, 0 * ramp) if hold == "zoh" else (whole[:n, :n], constant - ramp, ramp)


def _least_squares(
    matrices: Callable[[np.ndarray], Matrices],
    first: Mapping[str, float],
    x0: list[float],
    experiment: Experiment,
    hold: Hold,
) -> Row:
    """Simulation error over parameters and initial state, by scipy."""
    h = float(np.median(np.diff(experiment.time)))
    n = experiment.n_samples

    def residuals(z: np.ndarray) -> np.ndarray:
        A, B, C, D = matrices(z[: len(first)])
        u = np.hstack([experiment.inputs, np.ones((n, B.shape[1] - experiment.inputs.shape[1]))])
        Phi, now, following = _sampled(A, B, h, hold)
        states = np.empty((n, A.shape[0]))
        states[0] = z[len(first) :]
        for k in range(n - 1):
            states[k + 1] = Phi @ states[k] + now @ u[k] + following @ u[k + 1]
        return experiment.outputs[:, 0] - (states @ C.T + u @ D.T)[:, 0]

    z = np.array([*first.values(), *x0])
    found = least_squares(residuals, z, x_scale=np.abs(z), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    std = float(np.sqrt(2 * found.cost / n))
    value = -n / 2 * (np.log(2 * np.pi * std**2) + 1.0)
    estimates = dict(zip(first, map(float, found.x), strict=False)) | {"std": std}
    return Row("", "scipy least_squares", estimates, float(value))


def _our_filter(p: np.ndarray, experiment: Experiment) -> float:
    """The criterion of `daest identify` for the one-dimensional process, by hand: minus log-likelihood from
    the stationary variance around the mean p[3] of the initial state."""
    theta, mu, sigma, x = p
    h, std = float(np.median(np.diff(experiment.time))), 0.01
    u, y = experiment.inputs[:, 0], experiment.outputs
    a = np.exp(-theta * h)
    ramp = 1.0 - (1.0 - a) / (theta * h)  # of the input at the end of an interval
    q = sigma**2 * (1.0 - a * a) / (2.0 * theta)
    half = (q - (1.0 - a * a) * std**2) / 2.0
    P = half + np.sqrt(half**2 + q * std**2)
    S, total = P + std**2, 0.0
    for k in range(u.size):
        e = y[k, 0] - x
        total += (e * e / S + np.log(2 * np.pi * S)) / 2
        if k + 1 < u.size:
            x = a * (x + P / S * e) + (1.0 - a) * mu + (1.0 - a - ramp) * u[k] + ramp * u[k + 1]
    return float(total)


def _their_filter(p: np.ndarray, experiment: Experiment) -> float:
    """Minus log-likelihood from x ~ N(1, 0.1), moments moved by one Runge-Kutta step of order 4."""
    theta, mu, sigma = p[:3]
    h, std = float(np.median(np.diff(experiment.time))), 0.01
    u, y = experiment.inputs[:, 0], experiment.outputs[:, 0]
    moments, total = np.array([1.0, 0.1]), 0.0

    def rates(at: np.ndarray, drive: float) -> np.ndarray:
        return np.array([theta * (mu + drive - at[0]), sigma**2 - 2.0 * theta * at[1]])

    for k in range(u.size):
        S, e = moments[1] + std**2, y[k] - moments[0]
        total += (e * e / S + np.log(2 * np.pi * S)) / 2
        moments = np.array([moments[0] + moments[1] / S * e, moments[1] * std**2 / S])
        if k + 1 < u.size:
            middle = (u[k] + u[k + 1]) / 2
            one = rates(moments, u[k])
            two = rates(moments + h / 2 * one, middle)
            three = rates(moments + h / 2 * two, middle)
            four = rates(moments + h * three, u[k + 1])
            moments = moments + h / 6 * (one + 2 * two + 2 * three + four)
    return float(total)


if __name__ == "__main__":
    main()
