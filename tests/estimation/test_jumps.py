"""Equations that jump with the state are refused before a search; those that only bend are not."""

import casadi as ca
import numpy as np
import pytest
from nonlinear_models import experiment_of, explicit_from

from daest.errors import EXPLANATIONS, EstimationError
from daest.estimation.fitting.setup import check_jumps
from daest.estimation.identify import identify
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_model

MODEL = """
model M
  parameter Real J = 0.4 annotation(__Daest(estimate = true));
  parameter Real tc = 0.1 annotation(__Daest(estimate = true));
  input Real u;
  Real w(start = 0, fixed = true);
  output Real phi(start = 0, fixed = true);
equation
  w = der(phi);
  J*der(w) = u - tc*LAW;
end M;
"""
JUMPS = [
    "sign(w)",
    "(if w > 0 then 1 else -1)",
    "(if w < 0.5*phi then w else w + 1)",
    "floor(3*w)",
    "sign(der(w))",
]
BENDS = ["abs(w)", "max(-1, min(1, w/0.01))", "tanh(w/1e-6)", "(if w > 0 then w^2 else -w)", "sign(w)*w"]
ELSEWHERE = ["(if time > 2 then w else 2*w)", "sign(u)*w", "w"]


def law_of(tmp_path, law):
    path = tmp_path / "M.mo"
    path.write_text(MODEL.replace("LAW", law))
    return compile_model(path, "M")


@pytest.mark.parametrize("law", JUMPS)
def test_jump_is_named_with_its_equation_and_line(tmp_path, law):
    with pytest.raises(EstimationError) as caught:
        check_jumps(law_of(tmp_path, law))
    error = caught.value
    assert error.code == "identify-jump" and error.code in EXPLANATIONS
    assert error.what.startswith("`J*der(w) = ") and error.where.line == 10
    assert "tanh(w/width)" in error.remedy


@pytest.mark.parametrize("law", BENDS + ELSEWHERE)
def test_what_bends_or_jumps_in_time_is_allowed(tmp_path, law):
    check_jumps(law_of(tmp_path, law))


LEVELS = """
model Levels
  parameter Real k = 0.3 annotation(__Daest(estimate = true));
  input Real q;
  output Real a(start = 1, fixed = true);
  Real b(start = 1, fixed = true);
  Real d = a - b;
  Real flow_;
equation
  flow_ = k*sign(d)*LAW;
  der(a) = q - flow_;
  der(b) = flow_ - b;
end Levels;
"""


@pytest.mark.parametrize("law", ["sqrt(abs(a - b))", "sqrt(abs(a^2 - b^2))"])
def test_what_jumps_only_where_another_equation_does_not_hold_is_no_jump(tmp_path, law):
    path = tmp_path / "Levels.mo"
    path.write_text(LEVELS.replace("LAW", law))
    check_jumps(compile_model(path, "Levels"))
    path.write_text(LEVELS.replace("LAW", "sqrt(abs(a^2 - 0.9*b^2))"))
    with pytest.raises(EstimationError) as caught:
        check_jumps(compile_model(path, "Levels"))
    assert caught.value.what.startswith("`flow_ = ")


GEARED = """
package P
  function ratio
    input Real g;
    output Real r;
  algorithm
    r := if g < 1.5 then 9.6 else 4.2;
  end ratio;
  model Wheel
    input Real gear;
    input Real tau;
    parameter Real m = 3 annotation(__Daest(estimate = true));
    Real v(start = 0, fixed = true);
    Real i = ratio(WHAT);
  equation
    m*der(v) = i*tau - v;
  end Wheel;
  model Car
    input Real gear;
    input Real tau;
    output Real v = wheel.v;
    Wheel wheel;
  equation
    wheel.gear = gear;
    wheel.tau = tau;
  end Car;
end P;
"""


def test_jump_with_an_input_that_a_component_is_handed_is_allowed(tmp_path):
    path = tmp_path / "P.mo"
    path.write_text(GEARED.replace("WHAT", "gear"))
    check_jumps(compile_model(path, "P.Car"))
    path.write_text(GEARED.replace("WHAT", "gear + v"))
    with pytest.raises(EstimationError):
        check_jumps(compile_model(path, "P.Car"))


def test_identify_refuses_it_before_anything_else():
    explicit = explicit_from(
        ("phi", "w"), {"J": 0.5, "stick": 0.1},
        lambda x, u, w, p, t: [x[1], (u[0] - p[1] * ca.sign(x[1])) / p[0]], {"y": lambda x, u, p: x[0]},
    )  # fmt: skip
    time = 0.05 * np.arange(100)
    record = experiment_of(explicit, time, np.sin(time)[:, None], np.zeros((100, 1)))
    with pytest.raises(EstimationError) as caught:
        identify(explicit.flat, [record], IdentifyOptions(estimate=("J", "stick")))
    assert caught.value.code == "identify-jump"
