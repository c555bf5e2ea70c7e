"""Models with events: against closed forms, exact discretisation and finite differences."""

from pathlib import Path

import numpy as np
import pytest

import daest
from daest.errors import ModelError, NumericalError
from daest.estimation.streaming.estimator import estimator_model
from daest.modelica.compile import compile_text
from daest.systems.events.modes import in_starting_mode
from daest.systems.events.switches import with_switches
from daest.systems.linear.linearize import linearize
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.simulate import simulate

BALL = """model Ball
  parameter Real e = 0.97;
  parameter Real g = 9.81;
  Real h(start = 1, fixed = true);
  Real v(start = 0, fixed = true);
  output Real y = h;
  Integer n(start = 0, fixed = true);
equation
  der(h) = v;
  der(v) = -g;
  when h < 0 then
    reinit(v, -e*pre(v));
    n = pre(n) + 1;
  end when;
end Ball;
"""

RELAY = """model Relay "A double integrator's rate under a relay with hysteresis"
  parameter Real width = 0.2;
  Real x(start = 0, fixed = true);
  Boolean on(start = true, fixed = true);
equation
  on = x < -width or (pre(on) and x < width);
  der(x) = (if on then 1.0 else 0.0) - x;
initial equation
  pre(on) = true;
end Relay;
"""

SAMPLED = """model Sampled "A sampled PI controller beside a first-order plant"
  parameter Real kp = 2;
  parameter Real ki = 1.5;
  parameter Real period = 0.1;
  parameter Real r = 1;
  Real x(start = 0, fixed = true);
  output Real y = x;
  discrete Real u(start = 0, fixed = true);
  discrete Real sum(start = 0, fixed = true);
equation
  der(x) = -x + u;
  when sample(0, period) then
    sum = pre(sum) + ki*period*(r - x);
    u = kp*(r - x) + sum;
  end when;
end Sampled;
"""

SWITCHED = """model Switched "Pulses, counted, and a whole part"
  Real x(start = 0, fixed = true);
  Integer n(start = 0, fixed = true);
  Real next(start = 0.25, fixed = true);
  Real stairs;
equation
  der(x) = if time >= 0.3 and time < 0.6 then 1 else 0;
  stairs = integer(2*time);
  when time >= pre(next) then
    n = pre(n) + 1;
    next = pre(next) + 0.25;
  end when;
end Switched;
"""

ALGORITHM = """model Counter "A when-clause of an algorithm, with elsewhen, edge and change"
  Real s;
  Boolean b;
  Integer up(start = 0, fixed = true);
  Integer down(start = 0, fixed = true);
  Integer any(start = 0, fixed = true);
algorithm
  when edge(b) then
    up := pre(up) + 1;
  elsewhen not b then
    down := pre(down) + 1;
  end when;
equation
  s = sin(6.283185307179586*time);
  b = s > 0;
  when change(b) then
    any = pre(any) + 1;
  end when;
end Counter;
"""


def model(text: str):
    return compile_text(text.encode(), Path("M.mo"))


@pytest.fixture(scope="module")
def ball():
    return model(BALL)


@pytest.fixture(scope="module")
def sampled():
    return model(SAMPLED)


def run(flat, end: float, n: int = 201):
    time = np.linspace(0, end, n)
    return simulate(flat, (time, np.zeros((n, len(flat.inputs)))))


def bounces(count: int, e: float = 0.97, g: float = 9.81) -> tuple[np.ndarray, np.ndarray]:
    """Instants of the bounces and speeds after them."""
    first, speed = np.sqrt(2 / g), np.sqrt(2 * g)
    after = speed * e ** np.arange(1, count + 1)
    return first + np.concatenate([[0], np.cumsum(2 * after[:-1] / g)]), after


def test_a_sample_beside_an_event_is_one_at_the_event():
    """Rounding puts samples of a recording next to the instants of events: intervals of 1e-17 s."""
    flat = model(SWITCHED)
    plain = np.linspace(0, 1, 21)
    beside = np.unique(
        np.concatenate([plain, [np.nextafter(0.3, 0), np.nextafter(0.6, 1), np.nextafter(0.25, 0)]])
    )
    found = simulate(flat, (beside, np.zeros((beside.size, 0))))
    assert found["x"] == pytest.approx(np.clip(beside - 0.3, 0, 0.3), abs=1e-9)
    assert found["n"][-1] == 4


def test_a_hundred_bounces_follow_the_closed_form(ball):
    at, after = bounces(101)
    end = 0.5 * (at[99] + at[100])
    found = run(ball, end, 1001)
    k = np.searchsorted(at, found.time, side="right") - 1
    since = found.time - np.where(k >= 0, at[k], 0.0)
    h = np.where(k >= 0, after[k] * since - 9.81 * since**2 / 2, 1 - 9.81 * since**2 / 2)
    assert found["h"] == pytest.approx(h, abs=1e-8)
    assert found["n"] == pytest.approx(k + 1)
    assert found["n"][-1] == 100


def test_a_relay_that_stays_off():
    found = run(model(RELAY), 10, 2001)
    at = -np.log(1 - 0.2)  # x = 1 - exp(-t) reaches the width, and decays: below -width it never comes
    late = found.time > at
    assert found["x"][late] == pytest.approx(0.2 * np.exp(-(found.time[late] - at)), abs=1e-9)


def test_a_thermostat_swings_in_its_exact_limit_cycle():
    text = RELAY.replace("- x;", "- 0.5;").replace("on then 1.0", "on then 1.5")
    found = run(model(text), 8, 1601)
    # Up with the slope 1 and down with 0.5 between -0.2 and 0.2: period 0.4 + 0.8, from x = 0 on.
    phase = np.mod(found.time - 0.2, 1.2)
    exact = np.where(phase < 0.8, 0.2 - 0.5 * phase, -0.2 + (phase - 0.8))
    exact = np.where(found.time < 0.2, found.time, exact)
    assert found["x"] == pytest.approx(exact, abs=1e-9)


def test_a_sampled_loop_is_its_exact_discretisation(sampled):
    found = run(sampled, 5, 51)  # samples of the record are those of the controller
    x, total = 0.0, 0.0
    for k in range(51):
        assert found["x"][k] == pytest.approx(x, abs=1e-8)
        total += 1.5 * 0.1 * (1 - x)
        u = 2 * (1 - x) + total
        assert found["u"][k] == pytest.approx(u, abs=1e-8)  # the value after the event
        x = x * np.exp(-0.1) + u * (1 - np.exp(-0.1))


def test_time_events_are_met_exactly():
    found = run(model(SWITCHED), 1, 101)
    assert found["x"] == pytest.approx(np.clip(found.time - 0.3, 0, 0.3), abs=1e-12)
    assert found["n"] == pytest.approx(np.floor(found.time / 0.25 + 1e-9))
    assert found["stairs"] == pytest.approx(np.floor(2 * found.time + 1e-9))


def test_edge_change_and_elsewhen():
    found = run(model(ALGORITHM), 3.25, 14)
    assert (found["up"][-1], found["down"][-1], found["any"][-1]) == (4, 3, 7)


@pytest.mark.parametrize("parameter", ["e", "g"])
def test_sensitivities_jump_with_the_event(ball, parameter):
    slopes_agree(ball, parameter, np.linspace(0, 2.9, 30))


@pytest.mark.parametrize("parameter", ["kp", "ki", "r", "period"])
def test_sensitivities_pass_through_samples(sampled, parameter):
    slopes_agree(sampled, parameter, np.linspace(0, 0.97, 30))


STEPPED = """model Stepped "A relation of an input and a state"
  parameter Real k = 0.8;
  input Real u;
  Real x(start = 0, fixed = true);
  Real z(start = 0, fixed = true);
  output Real y = z;
  output Real busy = if on then 1 else 0;
  Boolean on(start = false, fixed = true);
  Integer n(start = 0, fixed = true);
equation
  on = u - x > 0.4;
  der(x) = u - k*x;
  der(z) = if on then x else -z;
  when on then
    n = pre(n) + 1;
  end when;
end Stepped;
"""


def test_a_jump_of_the_input_switches_at_an_instant_that_no_parameter_moves():
    flat, time = model(STEPPED), np.arange(0, 4, 0.1)
    u = np.repeat([0.1, 1.0, 0.3, 2.0], 10)[:, None]
    slopes_agree(flat, "k", time, u)
    found = simulate(flat, (time, u), hold="zoh")
    assert found["n"][-1] == 2
    on = (u[:, 0] - found["x"]) > 0.4
    assert found["busy"] == pytest.approx(on.astype(float))  # also at the jump
    # A last sample at which the input jumps tells what follows it.
    short = simulate(flat, (time[:11], u[:11]), hold="zoh")
    assert short["busy"][-1] == 1 and short["n"][-1] == 1


def slopes_agree(flat, parameter: str, time: np.ndarray, u: np.ndarray | None = None) -> None:
    explicit = reduce_index(in_starting_mode(flat))
    u = np.zeros((time.size, 0)) if u is None else u
    engine = integrator(explicit, [parameter])
    k = [p.name for p in explicit.flat.parameters].index(parameter)
    theta = explicit.flat.theta_values
    x0 = np.array([{"h": 1.0}.get(name, 0.0) for name in explicit.state_names])

    def outputs(change: float):
        moved = theta.copy()
        moved[k] += change
        return integrate(engine, time, u, moved, x0, hold="zoh", sensitivities=True, rtol=1e-10)

    step = 1e-6
    differences = (outputs(step).outputs - outputs(-step).outputs) / (2 * step)
    found = outputs(0.0).sensitivities[:, :, 0]
    assert found == pytest.approx(differences, abs=2e-5 * max(1.0, np.abs(differences).max()))


def test_identified_from_bounces(ball):
    time = np.linspace(0, 3, 301)
    rng = np.random.default_rng(3)
    truth = simulate(ball, (time, np.zeros((301, 0))))
    record = daest.Experiment(
        name="ball",
        time=time,
        inputs=np.zeros((301, 0)),
        outputs=truth.outputs + 0.005 * rng.standard_normal(truth.outputs.shape),
        input_names=(),
        output_names=("y",),
    )
    wrong = daest.with_values(daest.declare(ball, estimate=["e"]), {"e": 0.95})
    result = daest.identify(wrong, [record])
    (found,) = [p for p in result.parameters if p.name == "e"]
    assert abs(found.value - 0.97) < 4 * found.std_error
    assert found.std_error < 1e-3
    assert any("--starts" in note for note in result.notes)


def test_linear_in_the_mode_of_the_start(sampled):
    linear = linearize(sampled)
    assert "mode" in linear.notes[0]
    assert not any(p.name.startswith("pre(") for p in linear.parameters if not p.is_memory)


def test_linear_in_the_mode_of_the_operating_point():
    """Time, states and discrete variables of the point decide; hysteresis keeps what is given."""
    stepped = model(STEPPED)
    slope = {}
    for u in (0.0, 1.0):
        found = linearize(stepped, at={"u": u, "x": 0.2, "z": 0.5})
        z = [v.name for v in found.unknowns].index("z")
        slope[u] = np.abs(found.J.toarray() if hasattr(found.J, "toarray") else found.J)[:, z].max()
        assert "of the operating point" in found.notes[0]
        assert f"u - x > 0.4: {'true' if u else 'false'}" in found.notes[0]
    assert slope == {0.0: 1.0, 1.0: 0.0}  # z fades where the switch is off, and follows x where it is on
    relay = model(RELAY)
    drives = [
        np.abs(linearize(relay, at=at).offset).max()
        for at in ({"x": 0, "on": 0}, {"x": 0, "on": 1}, {"x": 1})
    ]
    assert drives == [0.0, 1.0, 0.0]
    late = linearize(model(SWITCHED), at={"time": 0.4}).notes[0]
    assert "time < 0.6: true" in late and "time >= 0.3: true" in late


def test_what_does_not_follow_events_says_so(ball):
    with pytest.raises(ModelError) as caught:
        estimator_model(ball, 0.01)
    assert caught.value.code == "events-not-supported"


ROUGH = """model Rough "Two masses on rough ground, one pulled, one struck"
  partial block Base
    Real y;
  end Base;
  block Grip "Coulomb friction with modes"
    extends Held;
    parameter Real f0 = 0.5;
    Real v;
    Real a;
    Real f;
    Real s "force while it sticks, acceleration and force while it slides";
    Boolean forward(start = false, fixed = true);
    Boolean backward(start = false, fixed = true);
    Boolean stuck;
    Integer mode(start = 2, fixed = true);
    encapsulated partial block Held
      Integer steps(start = 0, fixed = true);
      Real y;
    end Held;
  equation
    forward = pre(mode) == 0 and s > f0 or initial() and v > 0;
    backward = pre(mode) == 0 and s < -f0 or initial() and v < 0;
    stuck = not (pre(mode) == 1 or forward or pre(mode) == -1 or backward);
    a = if stuck then 0 else if forward or pre(mode) == 1 and not backward then s - f0 else s + f0;
    f = if stuck then s else if forward or pre(mode) == 1 and not backward then f0 else -f0;
    mode = if (pre(mode) == 1 or forward) and v > 0 then 1 else if (pre(mode) == -1 or backward) and v < 0
      then -1 else 0;
    y = f;
    when change(mode) then
      steps = pre(steps) + 1;
    end when;
  end Grip;
  function limited
    input Real x;
    output Real y;
  algorithm
    if x > 1 then
      y := 1;
    else
      y := x;
    end if;
  end limited;
  parameter Real row[:, 2] = [0.5, 2];
  Grip one(f0 = row[1, 1]);
  Grip two(f0 = 0.25);
  Real v[2](start = {0, 0.5}, each fixed = true);
  Real capped[2] = limited({time, 3});
  Boolean here;
  Boolean there;
  Boolean early;
equation
  one.v = v[1];
  one.a = der(v[1]);
  der(v[1]) = sin(time) - one.f;
  two.v = v[2];
  two.a = der(v[2]);
  der(v[2]) = -two.f;
  early = time < 1;
  here = there;
  there = pre(early);
  when time > 100 then
    terminate("over");
  end when;
initial equation
  here = true;
end Rough;
"""


def test_friction_with_modes_follows_its_closed_form():
    found = run(model(ROUGH), 6, 1201)
    t, v = found.time, found["v[1]"]
    slips = np.arcsin(0.5)
    sliding = (t > slips) & (v > 0)
    expected = np.cos(slips) - np.cos(t) - 0.5 * (t - slips)
    assert np.all(v[t < slips] == 0)
    assert v[sliding] == pytest.approx(expected[sliding], abs=1e-8)
    rest = t[(t > 2) & (v <= 0)][0]  # it comes to rest while the pull is too weak, then goes backward
    assert abs(np.sin(rest)) > 0.5 or v[(t > rest + 0.01)][0] == 0
    assert found["v[2]"] == pytest.approx(np.maximum(0.5 - 0.25 * t, 0.0), abs=1e-8)
    assert found["two.steps"][-1] == 1
    assert found["capped[1]"] == pytest.approx(np.minimum(t, 1.0)) and np.all(found["capped[2]"] == 1)


def test_relations_that_jump_become_events():
    text = "model J Real x(start = 0, fixed = true); Real y; equation "
    text += "der(x) = if sin(6.283185307179586*time) > 0.5 then 1 else 0; "
    text += "y = floor(2*time) + sign(x - 0.25); end J;"
    flat = with_switches(model(text))
    assert flat is not None and flat.events is not None and len(flat.events.whole_parts) == 1
    found = run(flat, 2.05, 42)
    width = 1 / 3  # of each turn the sine is above a half
    inside = np.clip(found.time - 1 / 12, 0, width) + np.clip(found.time - 13 / 12, 0, width)
    inside += np.clip(found.time - 25 / 12, 0, width)
    assert found["x"] == pytest.approx(inside, abs=1e-9)
    clear = np.abs((2 * found.time) % 1.0 - 0.5) < 0.49
    assert found["y"][clear] == pytest.approx((np.floor(2 * found.time) + np.sign(inside - 0.25))[clear])


BANK = """package Bank
  connector In = input Boolean;
  connector Out = output Boolean;
  block And In u1; In u2; Out y; equation y = u1 and u2; end And;
  block Latch In u; Boolean off(start = true, fixed = true); Real y; equation off = pre(off) and not u;
    y = if off then 0 else 1; end Latch;
  block Gate parameter Integer n = 3; In a; In u[n]; And each_one[n]; Out y[n]; Out all[n];
  equation for i in 1:n loop connect(a, each_one[i].u2); end for; connect(u, each_one.u1);
    connect(each_one.y, y); all = each_one.y; end Gate;
  block Source parameter Integer n = 3; Out y[n]; Out on; equation on = time > 0.25;
    for i in 1:n loop y[i] = time > 0.1*i; end for; end Source;
  block Split parameter Integer n = 3; In u; Latch l[n]; equation l.u = fill(u, n); end Split;
  model Bank Source s; Gate g; Latch l[3]; Split p; Real x(start = 0, fixed = true);
  equation connect(s.y, g.u); connect(s.on, g.a); connect(g.y, l.u); connect(s.on, p.u);
    der(x) = l[1].y + 10*l[2].y + 100*l[3].y + 1000*sum(p.l.y); end Bank;
end Bank;"""


def test_elements_of_a_boolean_array_that_connections_define_one_by_one():
    """Latches close at 0.25, 0.25 and 0.3: by the definition of the first element alone two never would."""
    found = run(compile_text(BANK.encode(), Path("Bank.mo"), "Bank.Bank"), 1)
    assert found["x"][-1] == pytest.approx(11 * 0.75 + 100 * 0.7 + 3000 * 0.75)


def test_an_element_of_a_boolean_array_without_a_definition_is_told():
    text = BANK.replace("connect(s.y, g.u)", "connect(s.y[1], g.u[1])")
    with pytest.raises(ModelError, match="array of which an element has no equation"):
        compile_text(text.encode(), Path("Bank.mo"), "Bank.Bank")


def test_chattering_names_the_switch(monkeypatch):
    monkeypatch.setattr("daest.systems.events.hybrid.MOST_DENSE", 50)
    text = "model C Real x(start = 1, fixed = true); Boolean b; Integer n(start = 0, fixed = true);\n"
    text += "equation b = x > 0; der(x) = if b then -1 else 1; when b then n = pre(n) + 1; end when; end C;"
    with pytest.raises(NumericalError) as caught:
        run(model(text), 2)
    assert caught.value.code == "events-chatter" and "x > 0" in str(caught.value)


def test_no_event_makes_none_beside_other_events():
    text = "model N Real x(start = 0, fixed = true); Real c(start = 1, fixed = true); equation "
    text += "der(x) = noEvent(if x > 0.5 then 0.5 else 1); when time > 2 then c = 2; end when; end N;"
    flat = model(text)
    assert flat.events is not None and [one.text for one in flat.events.relations] == ["time > 2"]
    assert run(flat, 2)["x"][-1] == pytest.approx(0.5 + 0.5 * 1.5, abs=1e-7)


@pytest.mark.parametrize(
    "more", ["", "Real c(start = 0, fixed = true); equation when time > 1 then c = 1; end when;"]
)
@pytest.mark.parametrize("flow", ["sqrt(max(0, h))", "sqrt(2*p*max(h, 0)/4)"])
def test_a_tank_runs_empty(more, flow):
    """Torricelli: h = (1 - t/2)^2 until t = 2, then nothing flows any more."""
    text = f"model T parameter Real p = 2; Real h(start = 1, fixed = true); {more} equation der(h) = -{flow};"
    text += " end T;"
    found = run(model(text), 4)
    assert found["h"] == pytest.approx(np.maximum(1 - found.time / 2, 0) ** 2, abs=1e-6)


def test_initial_equations_of_the_elements_of_a_discrete_array():
    """The slopes by hand: 10 + 2, then 10 + 20 where nothing holds any more."""
    text = "model P Boolean a[2]; Real x(start = 0, fixed = true); parameter Real p[2] = {0.3, 0.6};\n"
    text += "discrete Integer n(start = 0, fixed = true);\n"
    text += "initial equation for i in 1:2 loop pre(a[i]) = p[i] > 0.5; end for;\n"
    text += "equation der(x) = (if a[1] then 1 else 10) + (if a[2] then 2 else 20);\n"
    text += "for i in 1:2 loop a[i] = pre(a[i]) and time <= 0.5; end for;\n"
    text += "when time > 2 then n = 1; end when; end P;"
    found = run(model(text), 1)
    assert found["x"][-1] == pytest.approx(12 * 0.5 + 30 * 0.5)
