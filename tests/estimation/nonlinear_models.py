"""Nonlinear models built by hand as explicit equations, and their recordings."""

import casadi as ca
import numpy as np

from daest.estimation.fitting.setup import Setup
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel
from daest.model.parts import Equation, NoiseInput, Output, Parameter, Variable
from daest.systems.reduction.reduce import reduce_index


def explicit_from(states, parameters, rhs, outputs, noises=(), inputs=("u",)):
    """ExplicitModel of ẋ = rhs(x, u, w, θ, t), y = outputs(x, u, θ) with x in the order of `states`.

    parameters {name: value}; rhs gives a list; outputs {name: function of (x, u, θ)}.
    """
    n = len(states)
    x, rates = ca.SX.sym("x", n), ca.SX.sym("rate", n)
    u, w = ca.SX.sym("u", len(inputs)), ca.SX.sym("w", len(noises))
    theta, t = ca.SX.sym("theta", len(parameters)), ca.SX.sym("t")
    flat = FlatModel(
        name="Model",
        unknowns=tuple(Variable(name, start=0.0) for name in states),
        inputs=tuple(Variable(name) for name in inputs),
        noises=tuple(NoiseInput(name) for name in noises),
        parameters=tuple(Parameter(name, value) for name, value in parameters.items()),
        outputs=tuple(Output(name) for name in outputs),
        equations=tuple(Equation(f"der({name}) = ...", "component", "") for name in states),
        derivatives=rates,
        xi=x,
        u=u,
        w=w,
        theta=theta,
        time=t,
        residual=rates - ca.vertcat(*rhs(x, u, w, theta, t)),
        output_expressions=ca.vertcat(*[f(x, u, theta) for f in outputs.values()]),
    )
    explicit = reduce_index(flat)
    assert explicit.state_names == tuple(states)
    return explicit


def setup_of(unknowns, experiments, method, intensity, estimate_intensity, std, options, validation=()):
    """What is fitted; measurement noises of which `std` (n_y,) has no value are estimated."""
    return Setup(
        unknowns, tuple(experiments), method, intensity, estimate_intensity, std, np.isnan(std), options,
        tuple(validation),
    )  # fmt: skip


SERVO = {"J1": 5.4e-3, "J2": 0.02, "d": 0.02, "c": 1.5, "k": 0.06, "R": 4.5, "stick": 0.02, "width": 0.5}


def friction_servo(stiffening=3.0, **values):
    """Two inertias with a (stiffening) spring and smoothed Coulomb friction; speed and angle measured."""

    def rhs(x, u, w, theta):
        J1, J2, d, c, k, R, stick, width = (theta[i] for i in range(8))
        twist = x[1] - x[3]
        torque = c * twist + stiffening * twist**3 + d * (x[0] - x[2])
        motor = 30 * k * (u[0] - 30 * k * x[0]) / R - 30 * stick * ca.tanh(x[0] / width)
        return [(motor - torque + w[0]) / J1, x[0], (torque + w[1]) / J2, x[2]]

    return explicit_from(
        ("omega", "gear", "disc", "phi"),
        {**SERVO, **values},
        lambda x, u, w, theta, t: rhs(x, u, w, theta),
        {"speed": lambda x, u, theta: x[0], "angle": lambda x, u, theta: x[3]},
        ("motor_noise", "disc_noise"),
    )


def linear_servo():
    """The same without its nonlinear parts."""
    return friction_servo(stiffening=0.0, stick=0.0)


def oscillator():
    """Duffing oscillator with white force noise, position measured."""
    return explicit_from(
        ("x", "v"),
        {"k": 4.0, "d": 0.5, "k3": 2.0},
        lambda x, u, w, theta, t: [
            x[1],
            u[0] + w[0] - theta[0] * x[0] - theta[1] * x[1] - theta[2] * x[0] ** 3,
        ],
        {"y": lambda x, u, theta: x[0]},
        ("w",),
    )


def time_grid(n_samples, period, irregular=False, seed=0):
    if not irregular:
        return period * np.arange(n_samples)
    return np.cumsum(np.random.default_rng(seed).uniform(0.2 * period, 1.8 * period, n_samples))


def random_record(n_samples, n_y, seed=0, missing=0.1):
    """Inputs (n, 1) and outputs (n, n_y) without any relation, some outputs missing: enough to compare
    filters."""
    rng = np.random.default_rng(seed)
    y = 0.1 * rng.standard_normal((n_samples, n_y))
    y[rng.uniform(size=y.shape) < missing] = np.nan
    return 3.0 * rng.standard_normal((n_samples, 1)), y


def experiment_of(explicit, time, inputs, outputs):
    flat = explicit.flat
    return Experiment(
        "record",
        time,
        inputs,
        outputs,
        tuple(v.name for v in flat.inputs),
        tuple(o.name for o in flat.outputs),
    )
