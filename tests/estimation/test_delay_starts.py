"""What dead times begin with."""

from pathlib import Path

import numpy as np
import pytest

from daest.estimation.identify import identify
from daest.estimation.linear.delay_starts import long_past, shapes_of_past, steady_past
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_text
from daest.systems.linear.state_space import state_space_family
from daest.systems.reduction.reduce import reduce_index

NAMES = ("x", "delay_1_memory[1]", "delay_1_memory[2]", "a.delay_2_memory[1]", "a.delay_2_memory[2]")
STEP = """
model Step "what follows its input late"
  parameter Real T(unit = "s", min = 0) = 1 annotation(__Daest(estimate = true));
  parameter Real tau(unit = "s", min = 0) = 1 annotation(__Daest(estimate = true));
  input Real u(start = 0);
  output Real y annotation(__Daest(std = 0.01));
  Real x;
equation
  tau*der(x) = delay(u, T) - x;
  y = x;
end Step;
"""


def rates(lasts):
    by_state = np.zeros((5, 5))
    by_state[1:3, 1:3] = by_state[3:, 3:] = -1.0 / lasts
    by_state[0, 1:3] = 1.0
    by_input = np.zeros((5, 2))
    by_input[1:3, 0] = by_input[3:, 1] = 1.0
    return by_state, by_input


def test_the_level_of_a_delay_is_no_shape():
    assert list(shapes_of_past(NAMES)) == [False, False, True, False, True]


def test_the_past_of_inputs_that_keep_their_values_is_a_level():
    moves, stands = np.array([0.0, 1.0, 2.0]), np.ones(3)
    by_state, by_input = rates(1.0)
    held = steady_past(NAMES, by_state != 0.0, by_input != 0.0, np.column_stack([moves, stands]))
    assert list(held) == [False, False, False, False, True]
    by_state[3, 0] = 1.0  # what the second delay keeps follows a state
    held = steady_past(NAMES, by_state != 0.0, by_input != 0.0, np.column_stack([moves, stands]))
    assert not np.any(held)


@pytest.mark.parametrize("period, is_long", [(0.05, True), (0.5, False)])
def test_a_past_is_long_where_it_holds_more_samples_than_numbers(period, is_long):
    held = long_past(NAMES, rates(1.0)[0].__matmul__, period)
    assert list(held) == [False, False, is_long, False, is_long]


@pytest.mark.slow  # in parts: the tests above
def test_a_delay_of_a_steady_input_draws_no_curve():
    """A first-order step response with noise and a bump in its first second: with ten free states behind
    the steady input the delay follows the bump, with a level alone it cannot."""
    time = 0.02 * np.arange(500)
    bump = np.where(time < 1.0, 0.3 * np.sin(2 * np.pi * time), 0.0)
    noise = 0.01 * np.random.default_rng(3).standard_normal(time.size)
    y = 1.0 - np.exp(-time) + bump + noise
    family = state_space_family(reduce_index(compile_text(STEP.encode(), Path("Step.mo"))))
    one = Experiment("step", time, np.ones((500, 1)), y[:, None], ("u",), ("y",))
    fit = identify(family, [one], IdentifyOptions(hold="zoh"))
    assert fit.simulated["estimation"].rms["y"] > 0.04, "0.010 with free states"
