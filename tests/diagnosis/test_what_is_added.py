"""What is added to a signal or a store: an input that a sensor sees, a flow or a vessel nobody knew of."""

import numpy as np
import pytest
from held_inputs import diagnosed, followed, held

N_SAMPLES = 1200
SPRING = b"""
model Spring "a loaded spring whose force and travel are measured"
  parameter Real c(unit = "N/mm", min = 0) = 0.9 annotation(__Daest(estimate = true));
  parameter Real T(unit = "s", min = 0) = 0.6 annotation(__Daest(estimate = true));
  parameter Real g(unit = "mm/kN", min = 0) = 1.5 annotation(__Daest(estimate = true));
  parameter Real T2(unit = "s", min = 0) = 1 annotation(__Daest(estimate = true));
  input Real u(unit = "mm");
  input Real load(unit = "kN");
  output Real F(unit = "N") = c*x;
  output Real s(unit = "mm") = z;
  Real x(unit = "mm", start = 0);
  Real z(unit = "mm", start = 0);
equation
  T*der(x) = u - x;
  T2*der(z) = g*load - z;
end Spring;
"""
CHAMBER = b"""
model Chamber "a vacuum chamber behind a throttled pump"
  parameter Real V(unit = "m3", min = 0) = 0.01 annotation(__Daest(estimate = true));
  parameter Real G(unit = "m3/s", min = 0) = 1e-3 annotation(__Daest(estimate = true));
  input Real valve(unit = "1");
  input Real q(unit = "Pa.m3/s");
  output Real gauge(unit = "Pa") = p;
  Real p(unit = "Pa", start = 100);
equation
  V*der(p) = q - G*valve*p;
end Chamber;
"""
TANK = b"""
model Tank "a tank that runs out through a pipe"
  parameter Real A(unit = "m2", min = 0) = 1 annotation(__Daest(estimate = true));
  parameter Real k(unit = "m2/s", min = 0) = 1 annotation(__Daest(estimate = true));
  input Real q(unit = "m3/s");
  output Real level(unit = "m") = h;
  Real h(unit = "m", start = 0.7);
equation
  A*der(h) = q - k*h;
end Tank;
"""


@pytest.mark.slow
def test_a_sensor_that_sees_another_input():
    """A force sensor that answers to a load across it: an offset and some noise had been all."""
    rng = np.random.default_rng(4)
    inputs = np.column_stack([held(rng, -5.0, 5.0, 15, N_SAMPLES), held(rng, 2.0, 6.0, 23, N_SAMPLES)])
    x, z = followed(lambda x, u: [(u[0] - x[0]) / 0.5, (1.8 * u[1] - x[1]) / 0.8], [0, 0], inputs).T
    outputs = np.column_stack([1.1 * x + 0.05 * inputs[:, 1], z])
    outputs += np.array([0.05, 0.05]) * rng.standard_normal(outputs.shape)
    found = diagnosed(SPRING, inputs, outputs, (("u", "load"), ("F", "s")))
    best = found.proofs[0]
    assert (found.verdict, best.candidate.label) == ("supported", "Crosstalk (load) at F")
    size = next(p for p in best.told.parameters if p.name.endswith(".k"))
    assert abs(size.value - 0.05) < 3.0 * size.std_error


@pytest.mark.slow
def test_a_leak_into_a_vacuum_is_a_constant_flow():
    """Air comes in at the speed of sound, whatever the pressure inside: no leak or outlet of the library let
    anything in."""
    rng = np.random.default_rng(5)
    inputs = np.column_stack([held(rng, 0.2, 1.0, 40, N_SAMPLES), held(rng, 0.0, 0.2, 60, N_SAMPLES)])
    p = followed(lambda x, u: [(u[1] + 0.05 - 1.2e-3 * u[0] * x[0]) / 0.012], [120.0], inputs)
    outputs = p + 0.5 * rng.standard_normal(p.shape)
    found = diagnosed(CHAMBER, inputs, outputs, (("valve", "q"), ("gauge",)))
    names = {p.candidate.label for p in found.proofs if p.verdict != "rejected"}
    assert "ConstantFlow at 0:p" in names


@pytest.mark.slow
def test_a_vessel_behind_a_narrow_passage():
    """A standpipe beside a tank: nothing of the library had held liquid back."""
    rng = np.random.default_rng(6)
    inputs = held(rng, 0.2, 1.0, 50, N_SAMPLES)[:, None]

    def rate(x, u):
        exchanged = 0.5 * (x[0] - x[1])
        return [(u[0] - 0.9 * x[0] - exchanged) / 1.5, exchanged / 2.0]

    level = followed(rate, [0.7, 0.7], inputs)[:, :1]
    found = diagnosed(TANK, inputs, level + 0.005 * rng.standard_normal(level.shape), (("q",), ("level",)))
    best = found.proofs[0]
    assert (found.verdict, best.candidate.label) == ("supported", "HiddenVessel at 0:h"), found.message
    told = {p.name.rpartition(".")[2]: p for p in best.told.parameters}
    assert abs(told["G"].value - 0.5) < 3.0 * told["G"].std_error
    assert abs(told["T"].value - 4.0) < 3.0 * told["T"].std_error
