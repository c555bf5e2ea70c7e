"""Speed on a nonlinear servo (4 states, Coulomb friction as tanh) beside scipy, CasADi's cvodes and filterpy.

    python benchmarks/nonlinear_speed.py [--samples N] [--repeat N] [--json]

One simulation with sensitivities to 8 parameters; extended, unscented and particle filters. Each figure is
the fastest of several runs; slow peers run on a shorter record and are given per sample. Exit code 1 when a
target is missed. Set OMP_NUM_THREADS=1 for repeatable figures.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable

import casadi as ca
import numpy as np

from daest.estimation.filter_engines.ekf import ekf_likelihood, run_ekf
from daest.estimation.filter_engines.filter_task import Directions, Noise, Record, Start, Task, record
from daest.estimation.filter_engines.particle import ContinuousPoints, run_particles
from daest.estimation.filter_engines.ukf import run_ukf
from daest.machine import described
from daest.model.flat import ExplicitModel, FlatModel
from daest.model.parts import Equation, NoiseInput, Output, Parameter, Variable
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.local_linear import local_model

PERIOD = 0.005
SHORT = 400  # samples for peers that loop in Python, and for particles
PARTICLES = 1000
RTOL = 1e-5  # of daest's integrator and of its peers
NAMES = ("J1", "J2", "d", "c", "k", "R", "stick", "width")
VALUES = (5.4e-3, 0.02, 0.02, 1.5, 0.06, 4.5, 0.02, 0.5)
TARGETS = {"simulation with sensitivities, s per 8000 samples": 0.2, "extended filter, us per sample": 3.0}


def rates(x: ca.SX, u: ca.SX, theta: ca.SX) -> ca.SX:
    """(omega, gear, disc, phi): motor behind a gear of 30 on a spring, friction on the motor, a disc."""
    J1, J2, d, c, k, R, stick, width = ca.vertsplit(theta)
    torque = c * (x[1] - x[3]) + d * (x[0] - x[2])
    motor = 30 * k * (u - 30 * k * x[0]) / R - 30 * stick * ca.tanh(x[0] / width)
    return ca.vertcat((motor - torque) / J1, x[0], torque / J2, x[2])


def servo() -> ExplicitModel:
    x, dx, u, w = ca.SX.sym("x", 4), ca.SX.sym("dx", 4), ca.SX.sym("u"), ca.SX.sym("w", 2)
    theta = ca.SX.sym("theta", 8)
    drive = ca.vertcat(w[0] / theta[0], 0, w[1] / theta[1], 0)
    states = ("omega", "gear", "disc", "phi")
    flat = FlatModel(
        name="Servo",
        unknowns=tuple(Variable(name, start=0.0) for name in states),
        inputs=(Variable("u"),),
        noises=(NoiseInput("motor"), NoiseInput("disc_torque")),
        parameters=tuple(Parameter(name, value) for name, value in zip(NAMES, VALUES, strict=True)),
        outputs=(Output("speed"), Output("angle")),
        equations=tuple(Equation(f"der({name})", "component", "") for name in states),
        derivatives=dx,
        xi=x,
        u=u,
        w=w,
        theta=theta,
        time=ca.SX.sym("t"),
        residual=dx - rates(x, u, theta) - drive,
        output_expressions=ca.vertcat(x[0], x[3]),
    )
    return reduce_index(flat)


def drive(n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Time and a held multi-level input."""
    levels = np.random.default_rng(0).uniform(-6, 6, n_samples // 40 + 1)
    return PERIOD * np.arange(n_samples), np.repeat(levels, 40)[:n_samples, None]


def fastest(run: Callable[[], object], repeat: int) -> float:
    """Seconds of the fastest of `repeat` runs."""
    best = np.inf
    for _ in range(repeat):
        start = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - start)
    return best


def by_scipy(t: np.ndarray, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """States by LSODA, interval by interval, since the input jumps; rates compiled by CasADi's virtual
    machine."""
    from scipy.integrate import odeint

    x, v, p = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("p", 8)
    f = ca.Function("f", [x, v, p], [rates(x, v, p)])
    states = [np.zeros(4)]
    for k in range(t.size - 1):
        rate = lambda s, _, k=k: f(s, u[k], theta).full().ravel()  # noqa: E731
        states.append(odeint(rate, states[-1], t[k : k + 2], rtol=RTOL, atol=1e-2 * RTOL)[-1])
    return np.array(states)


def by_cvodes(t: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """CasADi's cvodes over the whole grid."""
    x, v, p = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("p", 8)
    options = {"reltol": RTOL, "abstol": 1e-2 * RTOL}
    flow = ca.integrator(
        "flow", "cvodes", {"x": x, "u": v, "p": p, "ode": rates(x, v, p)}, t[0], t[1:], options
    )

    def states(u: np.ndarray, theta: np.ndarray) -> np.ndarray:
        return flow(x0=np.zeros(4), u=u[:-1].T, p=theta)["xf"].full().T

    return states


def filterpy_ukf(t: np.ndarray, u: np.ndarray, y: np.ndarray, theta: np.ndarray) -> None:
    """One Runge-Kutta step of order 4 per sample and sigma point, the cheapest that is stable here."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    x, v, p = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("p", 8)
    end = x
    for _ in range(2):
        h = PERIOD / 2
        k1 = rates(end, v, p)
        k2 = rates(end + h / 2 * k1, v, p)
        k3 = rates(end + h / 2 * k2, v, p)
        end = end + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(end + h * k3, v, p))
    step = ca.Function("step", [x, v, p], [end])
    points = MerweScaledSigmaPoints(4, 1.0, 2.0, 0.0)
    peer = UnscentedKalmanFilter(
        4, 2, PERIOD, lambda s: s[[0, 3]], lambda s, dt, u: step(s, u, theta).full().ravel(), points
    )
    peer.x, peer.P, peer.R, peer.Q = np.zeros(4), 0.01 * np.eye(4), np.diag([1e-2, 1e-4]), 1e-6 * np.eye(4)
    for k in range(t.size):
        peer.predict(u=u[k])
        peer.update(y[k])


def measure(n_samples: int, repeat: int) -> dict[str, float]:
    explicit = servo()
    theta = explicit.flat.theta_values
    t, u = drive(n_samples)
    engine = integrator(explicit, NAMES)
    solved = integrate(engine, t, u, theta, np.zeros(4), hold="zoh", rtol=RTOL)
    rng = np.random.default_rng(1)
    y = solved.outputs + np.array([0.1, 0.01]) * rng.standard_normal(solved.outputs.shape)
    states = by_cvodes(t[:SHORT])
    check(solved.states[:SHORT], by_scipy(t[:SHORT], u, theta), states(u[:SHORT], theta))
    model = local_model(explicit, NAMES, tangents=True)
    data = record(model, t, u, y, "zoh")
    noise, start = Noise(np.array([1e-4, 1e-4]), np.array([1e-2, 1e-4])), Start(np.zeros(4), 0.01 * np.eye(4))
    along = Directions(np.diag(theta), np.zeros((8, 2)), np.zeros((8, 2)), np.zeros((8, 4)))
    head = Record(*(part[:SHORT] for part in (data.time, data.u0, data.u1, data.outputs)))
    points = ContinuousPoints(Task.of(model, head, theta, noise, start, np.inf))

    def simulated(with_sensitivities: bool) -> object:
        return integrate(
            engine, t, u, theta, np.zeros(4), hold="zoh", sensitivities=with_sensitivities, rtol=RTOL
        )

    per_8000, per_sample, short = 8000 / n_samples, 1e6 / n_samples, 1e6 / SHORT
    plain = fastest(lambda: by_scipy(t[:SHORT], u, theta), 1) * 8000 / SHORT
    cvodes = fastest(lambda: states(u[:SHORT], theta), 1) * 8000 / SHORT
    return {
        "simulation, s per 8000 samples": fastest(lambda: simulated(False), repeat) * per_8000,
        "simulation with sensitivities, s per 8000 samples": fastest(lambda: simulated(True), repeat)
        * per_8000,
        "scipy (LSODA), s per 8000 samples": plain,
        "scipy with differences, as least_squares asks, s per 8000 samples": 9 * plain,
        "CasADi cvodes, s per 8000 samples": cvodes,
        "CasADi cvodes with differences, s per 8000 samples": 9 * cvodes,
        "extended filter, us per sample": fastest(
            lambda: ekf_likelihood(model, data, theta, noise, start), repeat
        )
        * per_sample,
        "extended filter with all estimates, us per sample": fastest(
            lambda: run_ekf(model, data, theta, noise, start), repeat
        )
        * per_sample,
        "its likelihood with gradient in 8 directions, us per sample": fastest(
            lambda: ekf_likelihood(model, data, theta, noise, start, np.inf, along), repeat
        )
        * per_sample,
        "unscented filter, us per sample": fastest(lambda: run_ukf(model, data, theta, noise, start), repeat)
        * per_sample,
        "filterpy's unscented filter, us per sample": fastest(lambda: filterpy_ukf(t[:SHORT], u, y, theta), 1)
        * short,
        "particle filter, us per sample and particle": fastest(
            lambda: run_particles(points, head.outputs, noise.variance, start, PARTICLES, 0), 1
        )
        * short
        / PARTICLES,
    }


def check(ours: np.ndarray, *peers: np.ndarray) -> None:
    """The contestants solve the same problem: to a hundred times the tolerance, relative to the largest
    state."""
    for peer in peers:
        difference = np.max(np.abs(ours[-peer.shape[0] :] - peer)) / np.max(np.abs(ours))
        if difference > 100 * RTOL:
            raise SystemExit(f"the simulations differ by {difference:.1e}: not the same problem")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=8000)
    parser.add_argument("--repeat", type=int, default=10)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    return told(measure(options.samples, options.repeat), TARGETS, options.json)


def told(times: dict[str, float], targets: dict[str, float], as_json: bool) -> int:
    """Print times beside their targets; 1 if a target is missed, else 0."""
    missed = [name for name, target in targets.items() if times[name] > target]
    if as_json:
        print(json.dumps({"times": times, "targets": targets, "missed": missed, "machine": described()}))
    else:
        print(described())
        for name, value in times.items():
            target = f"   (target {targets[name]:g})" if name in targets else ""
            print(f"{value:12.3f}  {name}{target}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
