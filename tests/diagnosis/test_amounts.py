"""Balances of amounts and concentrations: what is missing there is named with its size, and nothing is where
nothing is hidden. Exact simulations of a dye in a stirred tank and of a drug in the blood."""

from collections.abc import Callable

import numpy as np
import pytest
from held_inputs import diagnosed, followed, held

N_SAMPLES = 800  # every tenth of an hour
TANK = b"""
model Tank "a dye in a stirred tank, time in hours"
  parameter Real V(unit = "l", min = 0) = 45 annotation(__Daest(estimate = true));
  input Real q(unit = "l/h");
  input Real c_in(unit = "mg/l");
  output Real y(unit = "mg/l") = c;
  Real c(unit = "mg/l", start = 0);
equation
  V*der(c) = q*(c_in - c);
end Tank;
"""
DRUG = b"""
model Drug "a drug in the blood, time in hours"
  parameter Real k(unit = "1/h", min = 0) = 0.2 annotation(__Daest(estimate = true));
  parameter Real V(unit = "l", min = 0) = 20;
  input Real u(unit = "mg/h");
  output Real y(unit = "mg/l") = A/V;
  Real A(unit = "mg", start = 0);
equation
  der(A) = u - k*A;
end Drug;
"""
Rate = Callable[[float, float], float]  # of what the store holds, and of what a second one would balance


def of_tank(seed: int, hidden: Rate, begins: float = 1.0):
    """The diagnosis of a dye [mg/l] with a hidden rate; a second store, which lags by 4 h, begins with a
    share of what is there."""
    rng = np.random.default_rng(seed)
    inputs = np.column_stack([held(rng, 5.0, 40.0, 37, N_SAMPLES), held(rng, 0.0, 12.0, 53, N_SAMPLES)])

    def rate(x, u):
        return [u[0] * (u[1] - x[0]) / 50.0 + hidden(*x), (x[0] - x[1]) / 4.0]

    c = followed(rate, [5.0, 5.0 * begins], inputs)[:, :1]
    outputs = c + 0.05 * rng.standard_normal(c.shape)
    return diagnosed(TANK, inputs, outputs, (("q", "c_in"), ("y",)))


def of_drug(seed: int, hidden: Rate):
    """The same of a drug [mg], whose clearance is estimated."""
    rng = np.random.default_rng(seed)
    inputs = held(rng, 0.0, 50.0, 41, N_SAMPLES)[:, None]

    def rate(x, u):
        return [u[0] - 0.25 * x[0] + hidden(*x), (x[0] - x[1]) / 4.0]

    A = followed(rate, [20.0, 20.0], inputs)[:, :1]
    outputs = A / 20.0 + 0.02 * rng.standard_normal(A.shape)
    return diagnosed(DRUG, inputs, outputs, (("u",), ("y",)))


def check(found, name: str, expected: dict[str, float]) -> None:
    """Whether the law is the one, supported, with its parameters within three standard errors."""
    best = found.proofs[0]
    assert (found.verdict, best.candidate.effect.name) == ("supported", name)
    for p in best.told.parameters:
        _, _, own = p.name.rpartition(".")
        if p.name.startswith(best.candidate.name) and own in expected:
            assert abs(p.value - expected.pop(own)) < 3.0 * p.std_error
    assert not expected


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("machine", [pytest.param(of_tank, marks=pytest.mark.slow), of_drug])
def test_nothing_is_missing_where_nothing_is_hidden(machine, seed):
    assert machine(seed, lambda x, z: 0.0).verdict == "nothing missing"


TANK_LAWS: dict[str, tuple[Rate, dict[str, float]]] = {
    "ConstantInflow": (lambda x, z: 0.8, {"r_0": 0.8}),
    "FirstOrderLoss": (lambda x, z: -0.15 * x, {"k": 0.15}),
    "SaturableLoss": (lambda x, z: -1.5 * x / (2.0 + x), {"r_max": 1.5, "x_h": 2.0}),
    "QuadraticLoss": (lambda x, z: -0.03 * x**2, {"k": 0.03}),
    "HiddenStore": (lambda x, z: -0.4 * (x - z), {"k": 0.4, "T": 4.0}),
}
DRUG_LAWS: dict[str, tuple[Rate, dict[str, float]]] = {
    "ConstantInflow": (lambda x, z: 8.0, {"r_0": 8.0}),
    "SaturableLoss": (lambda x, z: -15.0 * x / (20.0 + x), {"r_max": 15.0, "x_h": 20.0}),
    "QuadraticLoss": (lambda x, z: -0.003 * x**2, {"k": 0.003}),
    "HiddenStore": (lambda x, z: -0.4 * (x - z), {"k": 0.4, "T": 4.0}),
}


@pytest.mark.parametrize(
    "name",
    [
        "FirstOrderLoss",
        *(pytest.param(n, marks=pytest.mark.slow) for n in TANK_LAWS if n != "FirstOrderLoss"),
    ],
)
def test_what_a_dye_does_besides(name):
    hidden, expected = TANK_LAWS[name]
    check(of_tank(1, hidden), name, dict(expected))


@pytest.mark.slow  # the same store of a drug: below
def test_a_second_store_that_begins_empty():
    hidden, expected = TANK_LAWS["HiddenStore"]
    check(of_tank(1, hidden, begins=0.0), "HiddenStore", dict(expected))


@pytest.mark.slow  # laws of one balance: the dye above
@pytest.mark.parametrize("name", DRUG_LAWS)
def test_what_a_drug_does_besides(name):
    hidden, expected = DRUG_LAWS[name]
    check(of_drug(1, hidden), name, dict(expected))
