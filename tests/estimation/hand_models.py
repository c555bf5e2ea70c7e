"""Models built by hand, independent of the Modelica compiler: the spring servo and the positioning system."""

import casadi as ca
import numpy as np

from daest.model.experiment import Experiment
from daest.model.linear import StateSpaceFamily
from daest.model.parts import NoiseInput, Output, Parameter, Variable

RIG_START = {"d": 0.02, "c": 1.5, "J1": 6.3e-6, "J2": 0.02, "k": 0.06}
REPORT_START = {"d": 5.43e-4, "c": 0.0362, "J1": 3.0e-6, "J2": 3.66e-4, "k": 0.06}


def family_from(states, inputs, noises, outputs, parameters, rhs, measured):
    """StateSpaceFamily of ẋ = rhs(x, u, w, θ), y = measured(x, u, w, θ), both affine in x, u, w.

    states [(name, unit)]; inputs, outputs: names; noises [(name, NoiseInput fields)]; parameters: Parameter.
    """
    x, u = ca.SX.sym("x", len(states)), ca.SX.sym("u", len(inputs))
    w, theta = ca.SX.sym("w", len(noises)), ca.SX.sym("theta", len(parameters))
    f, h = rhs(x, u, w, theta), measured(x, u, w, theta)
    zero = [ca.SX.zeros(x.shape), ca.SX.zeros(u.shape), ca.SX.zeros(w.shape)]
    A, B, G = ca.jacobian(f, x), ca.jacobian(f, u), ca.jacobian(f, w)
    C, D, H = ca.jacobian(h, x), ca.jacobian(h, u), ca.jacobian(h, w)
    b, d = ca.substitute([f, h], [x, u, w], zero)
    n = len(states)
    X, U, W, x0 = ca.SX.eye(n), ca.SX(n, len(inputs)), ca.SX(n, len(noises)), ca.SX(n, 1)
    matrices = [ca.densify(m) for m in (A, B, G, b, C, D, H, d, X, U, W, x0)]
    return StateSpaceFamily(
        state_names=tuple(name for name, _ in states),
        state_units=tuple(unit for _, unit in states),
        unknowns=tuple(Variable(name, unit) for name, unit in states),
        inputs=tuple(Variable(name) for name in inputs),
        input_derivatives=(),
        noises=tuple(NoiseInput(name, **fields) for name, fields in noises),
        outputs=tuple(Output(name) if isinstance(name, str) else name for name in outputs),
        parameters=tuple(parameters),
        matrices=ca.Function("matrices", [theta], matrices),
        is_affine=True,
    )


def servo(values, noise=None, outputs=("omega", "phi"), sign=1.0, estimate=("d", "c", "J1", "J2", "k")):
    """Spring servo (report section 2, data README). `noise` None, or fields of a torque noise on the disc.

    sign = -1 gives the report's convention, transfer function (10), in which k is negative.
    """
    names = ("d", "c", "J1", "J2", "R", "k", "n")
    units = ("N.m.s/rad", "N.m/rad", "kg.m2", "kg.m2", "Ohm", "N.m/A", "1")
    bounds = {"d": 0.0, "c": 0.0, "J1": 0.0, "J2": 0.0}
    parameters = [
        Parameter(name, values[name], unit, min=bounds.get(name), estimate=name in estimate)
        for name, unit in zip(names, units, strict=True)
    ]

    def rhs(x, u, w, theta):
        d, c, J1, J2, R, k, n = ca.vertsplit(theta)
        omega, twist, speed = x[0], x[2] - x[1], x[3]
        spring = c * twist + d * (speed - omega)
        motor = n * k * (sign * u[0] - n * k * omega) / R
        load = w[0] if noise is not None else 0.0
        return ca.vertcat((motor + spring) / (n**2 * J1), omega, speed, (load - spring) / J2)

    def measured(x, u, w, theta):
        return ca.vertcat(*[{"omega": x[0], "phi": x[2]}[name] for name in outputs])

    states = [("omega", "rad/s"), ("shaft.phi", "rad"), ("phi", "rad"), ("disc.w", "rad/s")]
    noises = [] if noise is None else [("load.tau", {"unit": "N.m", **noise})]
    return family_from(states, ["u"], noises, outputs, parameters, rhs, measured)


def positioning_system(mass=80.0, friction=300.0, offset=0.0, noise=False):
    """One mass with viscous friction and a constant force: M a = F + w - Fv v - offset, position measured."""
    parameters = [
        Parameter("M", mass, "kg", min=0.0, estimate=True),
        Parameter("Fv", friction, "N.s/m", min=0.0, estimate=True),
        Parameter("offset", offset, "N", nominal=10.0, estimate=True),
    ]

    def rhs(x, u, w, theta):
        load = w[0] if noise else 0.0
        return ca.vertcat(x[1], (u[0] + load - theta[1] * x[1] - theta[2]) / theta[0])

    def measured(x, u, w, theta):
        return x[0]

    noises = [("load.f", {"unit": "N"})] if noise else []
    states = [("x", "m"), ("v", "m/s")]
    return family_from(states, ["F"], noises, ["position"], parameters, rhs, measured)


def read_csv(path, time, inputs, outputs, name=""):
    """Experiment of a csv file; inputs and outputs {model name: column}."""
    with open(path) as file:
        header = file.readline().strip().split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    column = {title: table[:, i] for i, title in enumerate(header)}
    return Experiment(
        name or path.stem,
        column[time],
        np.column_stack([column[c] for c in inputs.values()]),
        np.column_stack([column[c] for c in outputs.values()]),
        tuple(inputs),
        tuple(outputs),
    )


def multisine(n_samples, period, seed, top=3.0, amplitude=6.0):
    """Sum of sinusoids up to `top` Hz, continuous in time, sampled; (n_samples,)."""
    rng = np.random.default_rng(seed)
    time = period * np.arange(n_samples)
    frequencies = np.linspace(0.05, top, 25)
    phases = rng.uniform(0, 2 * np.pi, frequencies.size)
    signal = np.sin(2 * np.pi * frequencies * time[:, None] + phases).sum(axis=1)
    return amplitude * signal / np.max(np.abs(signal))


def recording(
    model, u, measurement_std, seed, x0=None, name="simulated", inputs=("u",), outputs=("omega", "phi")
):
    """Experiment from a DiscreteModel by the plain loop, with its process noise and white measurement
    noise.
    """
    rng = np.random.default_rng(seed)
    n = model.transition.shape[0]
    x = np.zeros(n) if x0 is None else np.asarray(x0, dtype=float)
    factor = np.linalg.svd(model.process_cov)
    root = factor[0] * np.sqrt(factor[1])
    states = [x]
    for k in range(len(u) - 1):
        x = model.transition @ x + model.input_now @ u[k] + model.input_next @ u[k + 1] + model.drift
        x = x + root @ rng.standard_normal(n)
        states.append(x)
    y = np.array(states) @ model.output.T + u @ model.feedthrough.T + model.output_offset
    y = y + np.asarray(measurement_std) * rng.standard_normal(y.shape)
    time = model.period * np.arange(len(u))
    return Experiment(name, time, u, y, tuple(inputs), tuple(outputs))
