"""Algorithm sections that the compiler does not take, elements that a variable selects, equations with
Integer states: against closed forms."""

from pathlib import Path

import numpy as np
import pytest

from daest.errors import ModelError, NumericalError
from daest.modelica.compile import compile_text
from daest.systems.simulation.simulate import simulate

GEARS = """package Gears
  constant Real efficiency = 0.9;
  type Gear = enumeration(neutral, first, second);
  function square
    input Real x;
    output Real y;
  algorithm
    y := x*x;
  end square;
  block Shifter "state by an algorithm, loops, a constant of the package"
    parameter Integer n = 3;
    parameter Real offset = 0;
    Real w = offset + 2*time;
    Gear gear(start = Gear.neutral, fixed = true);
    Integer count(start = 0, fixed = true);
    Real sum;
    Real second;
    Real c[n];
  algorithm
    when w > 1 and pre(gear) == Gear.neutral then
      gear := Gear.first;
      count := pre(count) + 1;
    elsewhen w > 2 then
      gear := Gear.second;
      count := pre(count) + 1;
    end when;
    sum := 0;
    for i in 1:n loop
      c[i] := square(i*w);
      sum := sum + efficiency*c[i];
    end for;
    second := if gear == Gear.second then sum else 0;
  end Shifter;
  model Box
    parameter Real ratio[3] = {1, 2, 4};
    parameter Real table[3](each fixed = false);
    Shifter s[2](offset = {0, 0.5});
    Real x(start = 0, fixed = true);
    Real w(start = 0, fixed = true);
    Integer total;
  initial algorithm
    for i in 1:3 loop
      table[i] := 10^i;
    end for;
  algorithm
    total := 0;
    for i in 1:2 loop
      total := total + s[i].count;
    end for;
  equation
    der(x) = total;
    der(w) = ratio[total + 1] + table[2];
  end Box;
end Gears;
"""


def run(text: str, t: np.ndarray, name: str | None = None):
    flat = compile_text(text.encode(), Path("M.mo"), name)
    return simulate(flat, (t, np.zeros((t.size, 0))))


def test_algorithm_sections_are_read_from_the_text():
    t = np.array([0, 0.1, 0.3, 0.6, 0.9, 1.2])
    found = run(GEARS, t, "Gears.Box")
    w = np.column_stack([2 * t, 2 * t + 0.5])
    sums = np.column_stack([found[f"s[{i}].sum"] for i in (1, 2)])
    np.testing.assert_allclose(sums, 0.9 * 14 * w**2, rtol=1e-12)
    seconds = np.column_stack([found[f"s[{i}].second"] for i in (1, 2)])
    np.testing.assert_allclose(seconds, np.where(w > 2, sums, 0), rtol=1e-12)
    # The shifters count at 0.25, 0.5, 0.75 and 1 s, one each.
    steps = np.array([0.25, 0.5, 0.75, 1.0])
    x = np.maximum(t[:, np.newaxis] - steps, 0).sum(axis=1)
    np.testing.assert_allclose(found["x"], x, atol=1e-9)
    # The ratio is the element that the sum of both numbers selects, the last one beyond.
    slopes = np.interp(t, [0, 0.25, 0.5, 1.2], np.cumsum([0, 0.25, 0.5, 4 * 0.7])) + 100 * t
    np.testing.assert_allclose(found["w"], slopes, rtol=1e-9)


def test_a_switch_of_an_equation_that_chatters_is_named(monkeypatch):
    monkeypatch.setattr("daest.systems.events.hybrid.MOST_DENSE", 50)
    text = "model M Real x(start = 1, fixed = true); equation der(x) = if x < 0 then 1 else -1; end M;"
    with pytest.raises(NumericalError) as caught:
        run(text, np.linspace(0, 2, 11))
    assert caught.value.code == "events-chatter"
    assert "x < 0" in caught.value.what


FUNCTIONS = """package Functions
  record Pair
    Real p;
    Real q;
  end Pair;
  function turned "a record assigned field by field"
    input Pair s;
    output Pair d;
  algorithm
    d.p := s.q;
    d.q := -s.p;
  end turned;
  function between "a curve through points, sizes by the inputs"
    input Real x[:];
    input Real y[size(x, 1)];
    input Real u;
    output Real v;
  protected
    Integer n = size(x, 1);
  algorithm
    v := y[n];
    for i in n - 1:-1:1 loop
      if u < x[i + 1] then
        v := y[i] + (u - x[i])/(x[i + 1] - x[i])*(y[i + 1] - y[i]);
      end if;
    end for;
  end between;
  model All
    parameter Integer n = 3;
    parameter Real at[4] = {0, 1, 2, 3};
    parameter Real value[4] = {0, 1, 4, 9};
    Real curve = between(at, value, time);
    Pair s(p(start = 1, fixed = true), q(start = 0, fixed = true));
    Pair d = turned(s);
    Real T[n](start = {0, 0, 1}, each fixed = true);
  equation
    der(s.p) = d.p;
    der(s.q) = d.q;
    der(T[1]) = T[2] - T[1];
    for i in 2:n - 1 loop
      der(T[i]) = T[i - 1] - 2*T[i] + T[i + 1];
    end for;
    der(T[n]) = T[n - 1] - T[n];
  end All;
end Functions;
"""


def test_functions_of_records_and_of_arrays_of_any_size():
    t = np.array([0.25, 0.75, 1.5, 2.5])
    found = run(FUNCTIONS, np.concatenate([[0], t]), "Functions.All")
    np.testing.assert_allclose(found["curve"][1:], [0.25, 0.75, 2.5, 6.5], rtol=1e-12)
    np.testing.assert_allclose(found["s.p"][1:], np.cos(t), atol=1e-8)
    # A rod of three cells: the modes (1, 0, -1) and (1, -2, 1) decay with the rates 1 and 3.
    slow, fast = -0.5 * np.exp(-t), np.exp(-3 * t) / 6
    np.testing.assert_allclose(found["T[3]"][1:], 1 / 3 - slow + fast, rtol=1e-7)


SUPPLY = """model Supply
  parameter Real p_max = 1200; parameter Real v0 = 60; parameter Real i0 = 50;
  parameter Real limit(fixed = false); parameter Boolean is_limited(fixed = false);
  Real x(start = 0, fixed = true);
initial algorithm
  assert(v0 > 0, "no voltage");
  limit := v0*i0;
  is_limited := false;
  if limit > p_max then
    is_limited := true;
    assert(p_max > 0, "no power");
    limit := sqrt(p_max) + limit/100;
  end if;
equation
  der(x) = if is_limited then limit else -limit;
end Supply;
"""


@pytest.mark.parametrize(("p_max", "rate"), [(1200, 1200**0.5 + 30), (4000, -3000)])
def test_an_initial_algorithm_with_branches_sets_parameters(p_max, rate):
    flat = compile_text(SUPPLY.encode(), Path("M.mo"), overrides={"p_max": p_max})
    t = np.array([0.0, 1.0])
    assert simulate(flat, (t, np.zeros((2, 0))))["x"][-1] == pytest.approx(rate)


def test_an_initial_algorithm_that_assigns_on_one_way_only_is_refused():
    text = SUPPLY.replace("  is_limited := false;\n", "")
    with pytest.raises(ModelError, match="is_limited"):
        compile_text(text.encode(), Path("M.mo"))
