"""A machine that only measures a speed: its absolute angles reach no output. Likelihood, gradient and
information are those of the same machine written with the twist alone."""

from dataclasses import replace

import casadi as ca
import hand_models as hand
import numpy as np
import pytest

from daest.estimation.fitting import identifiability
from daest.estimation.fitting.coordinates import Coordinate, Unknowns, objective, parameter_coordinate
from daest.estimation.fitting.records import make_record
from daest.estimation.linear.linear_predictors import Problem
from daest.estimation.nonlinear.observer import AverageModel, observer
from daest.model.parts import Parameter
from daest.numerics.riccati import hidden_basis
from daest.systems.linear.state_space import sample, state_space

VALUES = {"J": 0.3, "c": 20.0, "d": 0.2, "r": 3.0, "f": 0.5}
TURNED_AS = ("angles", "angles of a small unit", "twist")


def drive(states):
    """Motor (inertia 1, friction f), gear r, spring and damper, disc J; speed of the disc measured, white
    torque on the disc. `states`: both absolute angles, also in units of 1e-8 rad, or the twist."""
    parameters = [Parameter(name, value, estimate=True, min=0.0) for name, value in VALUES.items()]
    unit = 1e-8 if states == "angles of a small unit" else 1.0

    def rhs(x, u, w, theta):
        J, c, d, r, f = ca.vertsplit(theta)
        speed, turn = x[0], x[1]
        twist = x[2] if states == "twist" else unit * (x[3] - r * x[2])
        torque = c * twist + d * (turn - r * speed)
        rates = [u[0] - f * speed + r * torque, (w[0] - torque) / J]
        angles = [turn - r * speed] if states == "twist" else [speed / unit, turn / unit]
        return ca.vertcat(*rates, *angles)

    def measured(x, u, w, theta):
        return x[1]

    names = [("motor.w", "rad/s"), ("disc.w", "rad/s")]
    names += [("twist", "rad")] if states == "twist" else [("motor.phi", "rad"), ("disc.phi", "rad")]
    noise = [("load", {"intensity": 0.1, "estimate": True})]
    return hand.family_from(names, ["u"], noise, ["w"], parameters, rhs, measured)


def record_of(kind):
    family, rng = drive("twist"), np.random.default_rng(4)
    theta = np.array(list(VALUES.values()))
    model = sample(state_space(family, theta), 0.02, "foh", np.array([0.1]))
    u = hand.multisine(300, 0.02, 1)[:, None]
    experiment = hand.recording(model, u, [0.05], 2, outputs=("w",), x0=[0.0, 0.5, 0.1])
    if kind == "missing":
        return replace(experiment, outputs=np.where(rng.random((300, 1)) < 0.1, np.nan, experiment.outputs))
    if kind == "uneven":
        return replace(experiment, time=np.cumsum(rng.uniform(0.015, 0.025, 300)))
    return experiment


def problem_of(states, experiment, method):
    family = drive(states)
    theta = np.array(list(VALUES.values())) * np.array([1.1, 0.9, 1.2, 1.05, 0.8])
    coordinates = [
        parameter_coordinate(family, p.name, float(value), (p.min, p.max))
        for p, value in zip(family.parameters, theta, strict=True)
    ]
    if method == "pem":
        coordinates.append(Coordinate("load", "process", 0, 0.07, True, 1.0, 0.0, np.inf))
        coordinates.append(Coordinate("w", "measurement", 0, 0.04, True, 1.0, 0.0, np.inf))
    unknowns = Unknowns(tuple(coordinates), theta, np.array([0.07]), np.array([0.04]))
    return Problem(
        family, (make_record(experiment, family),), "foh", unknowns, np.array([True]),
        is_filtered=method == "pem",
    )  # fmt: skip


@pytest.mark.parametrize("method", ["pem", "oe"])
@pytest.mark.parametrize("states", TURNED_AS[:2])
@pytest.mark.parametrize("kind", ["complete", "missing", "uneven"])
def test_likelihood_and_slopes_are_those_without_absolute_angles(states, kind, method):
    found, plain = (
        objective(problem)(problem.unknowns.start, True)
        for problem in (problem_of(s, record_of(kind), method) for s in (states, "twist"))
    )
    assert found.value == pytest.approx(plain.value, rel=1e-9)
    size = np.sqrt(np.diagonal(plain.information))
    assert found.gradient / size == pytest.approx(plain.gradient / size, abs=1e-6)
    scaled = np.outer(size, size)
    assert found.information / scaled == pytest.approx(plain.information / scaled, abs=1e-7)


def test_hidden_direction_turns_with_the_gear():
    ss = state_space(drive("angles"), np.array(list(VALUES.values())))
    (column,) = hidden_basis(sample(ss, 0.02, "foh").transition, ss.C).T
    assert column / column[2] == pytest.approx([0.0, 0.0, 1.0, VALUES["r"]], abs=1e-9)


def test_observer_corrects_what_the_output_sees():
    theta = np.array(list(VALUES.values()))
    gains = []
    for states in ("angles", "twist"):
        ss = state_space(drive(states), theta)
        average = AverageModel(ss.A, ss.G, ss.C, 0.02)
        gains.append(observer(average, np.array([0.1]), np.array([0.05])))
    angles, twist = gains
    assert angles.innovation_cov == pytest.approx(twist.innovation_cov, rel=1e-9)
    seen = np.array([*angles.gain[:2, 0], angles.gain[3, 0] - VALUES["r"] * angles.gain[2, 0]])
    assert seen == pytest.approx(twist.gain[:, 0], rel=1e-7)


def test_directions_that_are_alike_to_rounding_are_told_once(monkeypatch):
    """The lost time constant of a lag can make a subspace of which the columns depend on each other."""
    alike = np.array([[1.0, 1.0], [0.0, 0.0], [0.5, 0.5]])
    monkeypatch.setattr(identifiability, "hidden_basis", lambda *_: alike)
    told = identifiability.unseen_directions(np.zeros((3, 3)), np.eye(1, 3), 0.1, ("a", "b", "c"))
    assert told == ("a common change of a and c (in the ratio 1 : 0.5)",)
