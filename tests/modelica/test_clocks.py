"""Clocked equations against closed forms and exact discretisation."""

import numpy as np
import pytest

from daest.errors import ModelError
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.balances import balances
from daest.modelica.places.sites import find_site
from daest.systems.events.modes import in_starting_mode
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.simulate import simulate

OPERATORS = """model Operators
  Clock c = Clock(1, 10);
  Real s, n(start = 0), late(start = 7), half(start = 4), early(start = 9), slow, fast;
  Real twice(start = 3), first;
  output Real y[9];
equation
  when c then
    s = sample(time);
    n = previous(n) + 1;
    twice = 2*previous(twice) - 20*interval(n);
    first = if firstTick(n) then 5 else 6;
  end when;
  late = shiftSample(n, 5, 2);
  half = shiftSample(n, 1, 2);
  early = backSample(half, 1, 2);
  slow = subSample(n, 3);
  fast = superSample(slow, 3);
  y = {hold(n), hold(late), hold(half), hold(early), hold(slow), hold(fast), hold(twice), hold(first),
       hold(s)};
end Operators;
"""

LOOP = """model Loop "A PI controller on a clock beside a lag"
  parameter Real k = 0.5;
  parameter Real Ti = 0.3;
  Clock c = Clock(0.1);
  Real x(start = 1, fixed = true), e, i(start = 0), u(start = 0);
  output Real y = x;
equation
  der(x) = hold(u) - x;
  when c then
    e = 0.4 - sample(x);
    i = previous(i) + interval(i)/Ti*e;
    u = k*(e + i);
  end when;
end Loop;
"""


def test_operators(compiled):
    time = np.concatenate([[0.0], np.arange(0.025, 1.0, 0.05)])
    found = simulate(compiled(OPERATORS), (time, np.zeros((time.size, 0)))).outputs
    tick, half_tick = np.floor(time / 0.1 + 1e-9), np.floor((time - 0.05) / 0.1 + 1e-9)
    slow = 3 * np.floor(tick / 3) + 1
    expected = [
        tick + 1,
        np.where(time < 0.25, 7, half_tick + 1),
        np.where(time < 0.05, 4, half_tick + 1),
        np.where(tick < 1, 4, tick),
        slow,
        slow,
        2.0 ** (tick + 1) + 2,
        np.where(tick < 1, 5, 6),
        0.1 * tick,
    ]
    np.testing.assert_allclose(found, np.array(expected).T, atol=1e-12)


def exact(time, k, Ti):
    x, i, states = 1.0, 0.0, []
    for tick in range(round(time[-1] / 0.1) + 1):
        e = 0.4 - x
        i += 0.1 / Ti * e
        u = k * (e + i)
        for t in time[(time >= 0.1 * tick - 1e-9) & (time < 0.1 * (tick + 1) - 1e-9)]:
            states.append(u + (x - u) * np.exp(-(t - 0.1 * tick)))
        x = u + (x - u) * np.exp(-0.1)
    return np.array(states)


def test_a_loop_is_its_exact_discretisation(compiled):
    time = np.arange(0.0, 3.01, 0.05)
    found = simulate(compiled(LOOP), (time, np.zeros((time.size, 0))), rtol=1e-10)
    np.testing.assert_allclose(found["y"], exact(time, 0.5, 0.3), rtol=0, atol=1e-9)


FORMS = {
    "clock in place": """
  when Clock(0.1) then
    e = 0.4 - sample(x);
    i = previous(i) + interval(i)/Ti*e;
    u = k*(e + i);
  end when;""",
    "sample in an expression": """
  e = 0.4 - sample(x, Clock(period));
  i = previous(i) + interval(i)/Ti*e;
  u = k*(e + i);""",
    "the same clock twice": """
  e = sample(0.4, Clock(1, 10)) - sample(x, Clock(1, 10));
  i = previous(i) + interval(i)/Ti*e;
  u = k*(e + i);""",
    "a clock that is inferred": """
  e = 0.4 - sample(x, c);
  when Clock() then
    i = previous(i) + interval(i)/Ti*e;
    u = k*(e + i);
  end when;""",
    "a sample without its clock": """
  u = k*(e + i);
  e = sample(0.4, c) - sample(x);
  i = previous(i) + interval(i)/Ti*e;""",
}


@pytest.mark.parametrize("form", FORMS)
def test_a_loop_in_other_words(compiled, form):
    clock = "Clock c = Clock(0.1);" if "Clock(" not in FORMS[form].replace("Clock()", "") else ""
    text = f"""model Loop
  parameter Real k = 0.5, Ti = 0.3, period = 0.1;
  {clock}
  Real x(start = 1, fixed = true), e, i(start = 0), u(start = 0);
  output Real y = x;
equation
  der(x) = hold(u) - x;{FORMS[form]}
end Loop;
"""
    time = np.arange(0.0, 1.01, 0.05)
    found = simulate(compiled(text), (time, np.zeros((time.size, 0))), rtol=1e-10)
    np.testing.assert_allclose(found["y"], exact(time, 0.5, 0.3), rtol=0, atol=1e-9)


def test_samples_in_declarations_and_blocks(compiled):
    text = """package P
  block Controller "A PI controller on the clock of its input"
    parameter Real k, Ti;
    input Real e;
    output Real u = k*(e + i);
    Real i(start = 0);
  equation
    when Clock() then
      i = previous(i) + interval(i)/Ti*e;
    end when;
  end Controller;
  model Loop "It closes the loop"
    Controller control(k = 0.5, Ti = 0.3);
    Real x(start = 1, fixed = true) "state";
    Real measured(unit = "1") = sample(x, Clock(1, 10)) "sampled";
    output Real y = x;
  equation
    control.e = 0.4 - measured;
    der(x) = hold(control.u) - x;
  end Loop;
end P;
"""
    time = np.arange(0.0, 1.01, 0.05)
    found = simulate(compiled(text, "P.Loop"), (time, np.zeros((time.size, 0))), rtol=1e-10)
    np.testing.assert_allclose(found["y"], exact(time, 0.5, 0.3), rtol=0, atol=1e-9)


def test_a_wrong_name_beside_a_clock_in_place_is_told_where_it_stands(compiled):
    with pytest.raises(ModelError) as caught:
        compiled("model M\n  Real y;\nequation\n  y = 2*sample(uu, Clock(0.1));\nend M;\n")
    assert caught.value.code == "model-unknown-name"
    assert str(caught.value.where).endswith(":4:16")


@pytest.mark.parametrize("parameter", ["k", "Ti"])
def test_sensitivities_of_a_clocked_loop(compiled, parameter):
    explicit = reduce_index(in_starting_mode(compiled(LOOP)))
    time = np.arange(0.0, 2.01, 0.05)
    engine, theta = integrator(explicit, [parameter]), explicit.flat.theta_values
    x0 = np.array([{"x": 1.0, "clock_tick": -1.0}.get(name, 0.0) for name in explicit.state_names])
    run = integrate(engine, time, np.zeros((time.size, 0)), theta, x0, rtol=1e-10, sensitivities=True)
    step = 1e-6
    values = {"k": 0.5, "Ti": 0.3}
    ahead, back = (exact(time, **{**values, parameter: values[parameter] + sign * step}) for sign in (1, -1))
    np.testing.assert_allclose(run.sensitivities[:, 0, 0], (ahead - back) / (2 * step), atol=1e-6)


@pytest.mark.parametrize(
    ("equations", "told"),
    [
        ("a = sample(time, c); b = sample(time, f); z = a;", "no common raster"),
        ("a = sample(time, e); b = a; z = b;", "a clock that ticks at events, is not supported"),
    ],
)
def test_what_is_refused(compiled, equations, told):
    clocks = "Clock c = Clock(0.1); Clock f = Clock(0.1001234567);"
    clocks += " Boolean trigger = time > 0.5; Clock e = Clock(trigger);" * ("e)" in equations)
    names = "Real a, b, z(start = 0); output Real y;"
    text = f"model M\n {names} {clocks}\nequation\n {equations} y = hold(z);\nend M;"
    with pytest.raises(ModelError) as caught:
        compiled(text)
    assert told in str(caught.value)
    assert caught.value.code == "model-unsupported"


def test_an_effect_is_written_into_a_model_whose_clock_has_no_name(compiled, tmp_path):
    """What the clock assigns is no place for a force, and the user's text is found although another one was
    compiled: also where that comes from the cache."""
    text = """model Cart
  input Real r(unit = "m/s");
  parameter Real m(unit = "kg") = 2;
  output Real v(unit = "m/s", start = 0, fixed = true);
  Real u(start = 0);
equation
  when Clock(0.1) then
    u = 3*(sample(r) - sample(v));
  end when;
  m*der(v) = hold(u);
end Cart;
"""
    friction = find_effect("Translational.CoulombFriction")
    for _ in range(2):
        flat = compiled(text)
        assert [one.name(flat).partition(":")[2] for one in balances(flat)] == ["v"]
        place = balances(flat)[0].name(flat)
        made = extend_model(tmp_path / "Model.mo", "Cart", friction, find_site(flat, place, friction))
        assert "when Clock(0.1) then" in made.text
        assert "hold(u)" in made.text
