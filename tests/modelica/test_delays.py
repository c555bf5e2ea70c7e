"""Delays against closed forms: sines, the method of steps, the transfer function."""

import numpy as np
import pytest

from daest.errors import ModelError
from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.flat.delays import window_dynamics
from daest.systems.linear.linearize import linearize
from daest.systems.simulation.simulate import simulate

SINES = """model Sines
  parameter Real T(unit = "s") = 0.5;
  Real x = sin(3*time), r[2], v[2] = {x, 2*x};
  output Real late = delay(x, T);
  output Real twice = delay(delay(x, 0.2), 0.3);
  output Real moving = delay(x, 0.3 + 0.1*cos(time), 0.5);
  output Real all = r[1] + r[2];
  output Real both = sum(delay(v, 1));
equation
  for i in 1:2 loop
    r[i] = delay(i*x, i*0.2);
  end for;
end Sines;
"""

LOOP = """model Loop
  Real x(start = 1, fixed = true);
  output Real y = x;
equation
  der(x) = -delay(x, 0.5);
end Loop;
"""

PLANT = """model Plant
  parameter Real T(unit = "s") = 0.4;
  input Real u;
  Real x(start = 0, fixed = true);
  output Real y = x;
equation
  der(x) = -2*x + delay(u, T);
end Plant;
"""


def simulated(flat, time, u=None):
    inputs = np.zeros((time.size, len(flat.inputs))) if u is None else u
    return simulate(flat, (time, inputs)).outputs.T


def test_sines_come_later(compiled):
    time = np.linspace(0, 4, 41)
    late, twice, moving, total, both = simulated(compiled(SINES), time)
    settled = time > 2.5  # what the start left in the windows has gone

    def sine(delay):
        return np.sin(3 * (time - delay))[settled]

    assert late[settled] == pytest.approx(sine(0.5), abs=1e-6)
    assert twice[settled] == pytest.approx(sine(0.5), abs=1e-6)
    assert moving[settled] == pytest.approx(np.sin(3 * (time - 0.3 - 0.1 * np.cos(time)))[settled], abs=1e-6)
    assert total[settled] == pytest.approx(sine(0.2) + 2 * sine(0.4), abs=1e-6)
    assert both[settled] == pytest.approx(3 * sine(1.0), abs=1e-4)


def test_before_the_start_a_signal_had_its_first_value(compiled):
    time = np.linspace(0, 1, 11)
    flat = compiled("model M\n Real x = 2 + time;\n output Real y = delay(x, 1.0);\nend M;")
    assert simulated(flat, time)[0] == pytest.approx(np.full(11, 2.0), abs=2e-2)


def test_a_loop_agrees_with_the_method_of_steps(compiled):
    """x = 1 - t up to 0.5, then the integrals of what it was 0.5 before. The corner at the start is smeared
    over a tenth of the delay."""
    time = np.array([0.0, 0.5, 1.0, 1.5])
    exact = [1.0, 0.5, 1 - 1.0 + 0.5**2 / 2, 1 - 1.5 + 1.0**2 / 2 - 0.5**3 / 6]
    assert simulated(compiled(LOOP), time)[0] == pytest.approx(exact, abs=1e-3)


def test_matrices_have_the_transfer_function_of_a_delay(compiled):
    dae = linearize(compiled(PLANT))
    for omega in (1.0, 5.0, 15.0):
        s = 1j * omega
        response = dae.C @ np.linalg.solve(s * dae.E - dae.J, dae.K) + dae.D
        assert abs(response[0, 0] - np.exp(-0.4 * s) / (s + 2)) < 1e-6


def test_the_window_is_the_same_at_rest():
    a, b = window_dynamics(10)
    assert -np.linalg.solve(a, b) == pytest.approx([1.0] + [0.0] * 9, abs=1e-12)
    assert np.linalg.eigvals(a).real.max() < 0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        ("delay(x, 0)", "`delay(x, 0)` delays by 0 s"),
        ("delay(x, -0.1)", "delays by -0.1 s"),
        ("delay(x, 1 + x)", "`1 + x` of a delay changes"),
        ("delay(x, time, -1)", "delays by -1 s"),
        ("delay(x, 0.1, 1 + x)", "`1 + x` of a delay changes"),
    ],
)
def test_times_of_a_delay_are_checked(compiled, call, words):
    with pytest.raises(ModelError) as caught:
        compiled(f"model M\n Real x = time;\n output Real y;\nequation\n y = {call};\nend M;")
    assert caught.value.code == "model-delay" and words in caught.value.what
    assert (caught.value.where.line, caught.value.where.column) == (5, 6)


def test_a_dead_time_is_identified(compiled):
    """From exact samples of a lag behind a dead time; T lies between two of them."""
    time, dead, tau = np.arange(600) * 0.05, 0.52, 1.1
    rng = np.random.default_rng(1)
    u = np.repeat(rng.normal(size=30), 20)
    fine = np.concatenate([np.full(52, u[0]), np.repeat(u, 5)])[: 600 * 5]  # of 10 ms each, and late
    x, decay = np.zeros(fine.size + 1), np.exp(-0.01 / tau)
    for k, value in enumerate(fine):
        x[k + 1] = value + (x[k] - value) * decay
    y = x[:-1:5] + 0.005 * rng.normal(size=600)
    flat = compiled(
        'model M\n parameter Real T(unit = "s") = 0.3 annotation(__Daest(estimate = true));\n'
        ' parameter Real tau(unit = "s") = 2 annotation(__Daest(estimate = true));\n'
        " input Real u;\n output Real y(start = 0, fixed = true);\n"
        "equation\n tau*der(y) + y = delay(u, T);\nend M;"
    )
    record = Experiment("made", time, u[:, None], y[:, None], ("u",), ("y",))
    fit = identify(flat, [record], IdentifyOptions(hold="zoh", method="oe"))
    for parameter, truth in zip(fit.parameters, (dead, tau), strict=True):
        assert abs(parameter.value - truth) < 4 * parameter.std_error < 0.02
