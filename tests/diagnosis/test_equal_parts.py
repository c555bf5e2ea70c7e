"""What is missing in all parts of a machine, or in one of them, is named there with its size."""

import numpy as np
import pytest
from held_inputs import diagnosed, followed, held

N_SAMPLES = 500
PIPE = b"""
model Pipe "water through a pipe in parts"
  parameter Real C(unit = "J/K", min = 0) = 90 annotation(__Daest(estimate = true));
  input Real q(unit = "W/K");
  input Real T_in(unit = "K");
  output Real y(unit = "K") = T[4];
  output Real middle(unit = "K") = T[2];
  Real T[4](each unit = "K", each start = 320);
equation
  C*der(T[1]) = q*(T_in - T[1]);
  for i in 2:4 loop
    C*der(T[i]) = q*(T[i - 1] - T[i]);
  end for;
end Pipe;
"""


def of_pipe(seed: int, losses: np.ndarray):
    """The diagnosis of a pipe whose parts lose heat [W/K] to 290 K."""
    rng = np.random.default_rng(seed)
    inputs = np.column_stack([held(rng, 100.0, 300.0, 17, N_SAMPLES), held(rng, 310.0, 340.0, 29, N_SAMPLES)])

    def rate(T, u):
        return (u[0] * (np.concatenate([u[1:], T[:-1]]) - T) - losses * (T - 290.0)) / 100.0

    T = followed(rate, [320.0] * 4, inputs)[:, [3, 1]]
    outputs = T + 0.05 * rng.standard_normal(T.shape)
    return diagnosed(PIPE, inputs, outputs, (("q", "T_in"), ("y", "middle")))


@pytest.mark.slow
@pytest.mark.parametrize(("losses", "place"), [([8.0] * 4, "each T[i]"), ([0.0, 0.0, 20.0, 0.0], "2:T[3]")])
def test_loss_of_all_parts_is_told_from_that_of_one(losses, place) -> None:
    found = of_pipe(3, np.array(losses))
    told = {p.candidate.label: p for p in found.proofs if p.verdict != "rejected"}
    assert {p.candidate.site.name for p in told.values()} == {place}, found.message
    best = told[f"HeatLoss at {place}"]
    size = next(p for p in best.told.parameters if p.name.endswith(".G"))
    assert size.value == pytest.approx(max(losses), abs=4.0 * size.std_error)


@pytest.mark.slow
def test_nothing_is_missing_in_parts_that_lack_nothing() -> None:
    assert of_pipe(4, np.zeros(4)).verdict == "nothing missing"
