"""Effects at signals inside of a model, commands of controllers and laws of bare equations, against the
motion by scipy."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from effect_rig import in_steps
from scipy.integrate import solve_ivp

from daest.diagnosis.null_model.loads import load_sites
from daest.errors import ModelError
from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import find_site, fits, sites, sites_left
from daest.systems.simulation.simulate import simulate

BLOCKS = """model Loop
  import Daest.Blocks.Math;
  Daest.Blocks.Interfaces.RealInput r(unit = "rad");
  Daest.Blocks.Interfaces.RealOutput phi(unit = "rad");
  Math.Feedback error;
  Math.Gain p(k = 20);
  Math.Feedback command;
  Math.Gain v(k = 2);
  Daest.Mechanics.Rotational.Sources.Torque motor;
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = 0.05, phi(start = 0), w(start = 0));
  Daest.Mechanics.Rotational.Sensors.AngleSensor encoder;
  Daest.Mechanics.Rotational.Sensors.SpeedSensor tacho;
equation
  connect(r, error.u1);
  connect(encoder.phi, error.u2);
  connect(error.y, p.u);
  connect(p.y, command.u1);
  connect(tacho.w, v.u);
  connect(v.y, command.u2);
  connect(command.y, motor.tau);
  connect(motor.flange, rotor.flange_a);
  connect(rotor.flange_b, encoder.flange);
  connect(rotor.flange_b, tacho.flange);
  connect(encoder.phi, phi);
end Loop;
"""
EQUATIONS = """model Loop
  input Real r(unit = "rad");
  output Real phi(unit = "rad", start = 0);
  Real w(unit = "rad/s", start = 0);
  Real u(unit = "V");
equation
  u = 20*(r - phi) - 2*w;
  der(phi) = w;
  0.05*der(w) = u;
end Loop;
"""
BOUND = EQUATIONS.replace('u(unit = "V");', 'u(unit = "V") = 20*(r - phi) - 2*w "Command";').replace(
    "  u = 20*(r - phi) - 2*w;\n", ""
)
FORMS = {"blocks": (BLOCKS, "command.y"), "equations": (EQUATIONS, "u"), "bound": (BOUND, "u")}
SATURATION = {"share": 1.0, "limit": 1.5, "u_s": 1e-3}

CAR = """model Car
  input Real delta(unit = "rad");
  output Real yaw(unit = "rad/s") = r;
  Real beta(unit = "rad", start = 0);
  Real r(unit = "rad/s", start = 0);
  Real af(unit = "rad");
  Real ar(unit = "rad");
  Real Ff(unit = "N");
  Real Fr(unit = "N");
equation
  af = delta - beta - 1.2*r/25; ar = -beta + 1.5*r/25;
  Ff = 8e4*af; Fr = 9e4*ar;
  1500*25*(der(beta) + r) = Ff + Fr;
  2500*der(r) = 1.2*Ff - 1.5*Fr;
end Car;
"""


def inside(text):
    flat = compile_text(text.encode(), Path("Model.mo"))
    return {site.name for site in sites(flat) if site.kind == "signal"}


def simulated(flat, level):
    return simulate(flat, (np.linspace(0.0, 1.0, 101), np.full((101, 1), level))).outputs[:, 0]


@cache
def servo(limit):
    """The angle after a step of the reference by 1 rad, the command cut at the limit."""

    def rate(_, x):
        return [x[1], np.clip(20 * (1 - x[0]) - 2 * x[1], -limit, limit) / 0.05]

    times = np.linspace(0.0, 1.0, 101)
    return solve_ivp(rate, (0.0, 1.0), [0.0, 0.0], t_eval=times, rtol=1e-9, atol=1e-12).y[0]


@pytest.mark.parametrize("form", FORMS)
def test_command_of_a_controller_is_cut(tmp_path, form):
    text, place = FORMS[form]
    path = tmp_path / "Loop.mo"
    path.write_text(text)
    flat, effect = compile_model(path), find_effect("Signals.Saturation")
    site = find_site(flat, place, effect)
    assert site.kind == "signal" and fits(effect, site)
    assert np.max(np.abs(servo(1.5) - servo(1e9))) > 0.1
    np.testing.assert_allclose(simulated(flat, 1.0), servo(1e9), atol=1e-4)
    attached = attach(flat, effect, site, values=SATURATION)
    written = extend_model(path, None, effect, site, values=SATURATION)
    for model in (attached, written.flat):
        np.testing.assert_allclose(simulated(model, 1.0), servo(1.5), atol=1e-3)


def test_law_of_a_bare_equation_bends(tmp_path):
    """The front tyre loses a part of its force that grows with the square of it."""
    path = tmp_path / "Car.mo"
    path.write_text(CAR)
    flat, effect = compile_model(path), find_effect("Signals.QuadraticGain")
    site = find_site(flat, "Ff", effect)
    values = {"a": -5e-5, "u_s": 1.0}
    assert units_at(flat, effect, site) == {"a": "1/N", "u_s": "N"}

    def rate(_, x):
        linear = 8e4 * (0.05 - x[0] - 1.2 * x[1] / 25)
        front, rear = linear - 5e-5 * linear * np.sqrt(linear**2 + 1), 9e4 * (-x[0] + 1.5 * x[1] / 25)
        return [(front + rear) / (1500 * 25) - x[1], (1.2 * front - 1.5 * rear) / 2500]

    expected = solve_ivp(rate, (0.0, 1.0), [0.0, 0.0], t_eval=[1.0], rtol=1e-9, atol=1e-12).y[1, 0]
    assert abs(simulated(flat, 0.05)[-1] / expected - 1) > 0.1
    written = extend_model(path, None, effect, site, values=values)
    for model in (attach(flat, effect, site, values=values), written.flat):
        assert simulated(model, 0.05)[-1] == pytest.approx(expected, rel=1e-4)


def test_output_of_a_block_that_integrates_is_cut(tmp_path):
    """A drive of first order before the rotor: what the drive holds is not what its effect lets through."""
    drive = """block Drive "Of first order"
  Daest.Blocks.Interfaces.RealInput u; Daest.Blocks.Interfaces.RealOutput y(start = 0);
equation
  der(y) = (u - y)/0.05;
end Drive;
"""
    text = BLOCKS.replace("  Math.Feedback error;\n", "  Math.Feedback error;\n  Drive drive;\n")
    text = text.replace(
        "connect(command.y, motor.tau)", "connect(command.y, drive.u);\n  connect(drive.y, motor.tau)"
    )
    path = tmp_path / "Loop.mo"
    path.write_text(drive + text)
    flat, effect = compile_model(path, "Loop"), find_effect("Signals.Saturation")
    site = find_site(flat, "drive.y", effect)

    def rate(_, x):
        return [x[1], np.clip(x[2], -1.5, 1.5) / 0.05, (20 * (1 - x[0]) - 2 * x[1] - x[2]) / 0.05]

    times = np.linspace(0.0, 1.0, 101)
    expected = solve_ivp(rate, (0.0, 1.0), [0.0] * 3, t_eval=times, rtol=1e-9, atol=1e-12).y[0]
    written = extend_model(path, "Loop", effect, site, values=SATURATION)
    for model in (attach(flat, effect, site, values=SATURATION), written.flat):
        np.testing.assert_allclose(simulated(model, 1.0), expected, atol=1e-3)


def test_two_effects_follow_each_other(tmp_path):
    path = tmp_path / "Loop.mo"
    path.write_text(BLOCKS)
    steps = [("Signals.Saturation", "command.y", SATURATION), ("Signals.Offset", "encoder.phi", {"b": 0.1})]
    expected, made = in_steps(tmp_path, path, None, steps)
    np.testing.assert_allclose(simulated(made.flat, 1.0), simulated(expected, 1.0), atol=1e-6)
    assert not np.allclose(simulated(expected, 1.0), servo(1.5), atol=0.05)


def test_places_are_those_where_an_effect_does_what_it_does_nowhere_else():
    assert inside(BLOCKS) == {"command.y", "p.y", "v.y", "encoder.phi"}, "error.y is p.y in other units"
    assert inside(EQUATIONS) == {"u"}
    assert inside(CAR) == {"Ff", "Fr"}, "a slip angle is a tyre force in other units"


@pytest.mark.parametrize(
    "text",
    [
        EQUATIONS.replace("20*(r - phi) - 2*w", "20*r"),
        EQUATIONS.replace('u(unit = "V")', 'u(unit = "N.m")').replace(" - 2*w", ""),
        EQUATIONS.replace("  0.05*der(w) = u;", "  der(w) = a;\n  a = 20*u;").replace(
            "equation\n", '  Real a(unit = "rad/s2");\nequation\n'
        ).replace('Real u(unit = "V");', 'output Real u(unit = "V");'),
    ],
    ids=["input", "spring", "output and rate"],
)  # fmt: skip
def test_no_place_is_what_another_one_is_already(text):
    assert inside(text) == set()


@pytest.mark.parametrize(("speed", "signals"), [("w", {"u"}), ("(w - der(moved))", set())])
def test_command_of_a_controller_in_the_unit_of_a_force_is_a_signal_as_well(speed, signals):
    """It knows the speed of the body, and not that of the reference: a spring and damper know both."""
    text = EQUATIONS.replace('u(unit = "V")', 'u(unit = "N.m")').replace(
        "20*(r - phi) - 2*w", f"kp*(r - phi) - 2*{speed} + 3*i"
    )
    own = '  Real i;\n  parameter Real kp = 20;\n  Real moved(unit = "rad") = r;\nequation\n'
    text = text.replace("equation\n", own).replace("der(phi) = w;", "der(phi) = w;\n  der(i) = r - phi;")
    assert inside(text) == signals
    flat = compile_text(text.encode(), Path("Model.mo"))
    assert [site.name for site in sites(flat) if site.kind == "force"] == ["0:u"]


SLIPPING = """model Car
  parameter Real lf(unit = "m") = 1.2, lr(unit = "m") = 1.5;
  parameter Real cf(unit = "N/rad") = 8e4, cr(unit = "N/rad") = 9e4;
  parameter Real m(unit = "kg") = 1500, J(unit = "kg.m2") = 2500;
  parameter Real fast(unit = "m/s") = 20;
  input Real delta(unit = "rad"), v(unit = "m/s");
  output Real r(unit = "rad/s", start = 0);
  Real vy(unit = "m/s", start = 0);
  Real Ff(unit = "N"), Fr(unit = "N");
equation
  Ff = cf*(delta - (vy + lf*r)/v);
  Fr = -cr*(vy - lr*r)/v;
  m*(der(vy) + v*r) = Ff + Fr;
  J*der(r) = lf*Ff - lr*Fr;
end Car;
"""


@pytest.mark.parametrize(("speed", "signals"), [("v", {"Ff", "Fr"}), ("fast", set())])
def test_force_of_a_slip_is_a_signal_as_well(speed, signals):
    """It goes with a ratio of speeds: no relative motion of bodies tells what bends it. At a speed that is
    given it is that of a damper."""
    text = SLIPPING.replace("/v", f"/{speed}")
    assert inside(text) == signals
    flat = compile_text(text.encode(), Path("Model.mo"))
    assert [site.name for site in sites(flat) if site.kind == "force"] == ["0:Ff", "1:Fr"]


def test_polynomials_of_a_dead_time_are_no_actuators():
    text = """model Dosing
  parameter Real T(unit = "s", min = 1) = 100, k(unit = "g/s") = 0.01, V(unit = "m3") = 2;
  input Real u(unit = "1"), q(unit = "m3/s");
  output Real c(unit = "g/m3", start = 1);
  Real m(unit = "g/s");
equation
  m = k*delay(u, T, 400);
  V*der(c) = m - q*c;
end Dosing;
"""
    assert inside(text) == {"m"}


@pytest.mark.parametrize(("rate", "signals"), [("r - w", {"u"}), ("off", {"u"}), ("r", set())])
def test_command_of_a_controller_of_the_speed_is_a_signal_as_well(rate, signals):
    """With the sum of its errors it moves as a spring and damper to a shaft that is driven."""
    text = EQUATIONS.replace('u(unit = "V")', 'u(unit = "N.m")').replace(
        'r(unit = "rad")', 'r(unit = "rad/s")'
    )
    text = text.replace("20*(r - phi) - 2*w", "2*(r - w) + 20*e").replace(
        "der(phi) = w;", f"der(e) = {rate};"
    )
    text = text.replace('phi(unit = "rad"', 'e(unit = "rad"').replace("= phi", "= e")
    if rate == "off":
        text = text.replace("2*(r - w)", "2*off").replace(
            "equation\n", '  Real off(unit = "rad/s");\nequation\n'
        )
        text = text.replace("  0.05*", "  off = r - w;\n  0.05*")
    assert inside(text) == signals


def test_no_force_is_left_where_a_command_is_cut():
    """`improve` looked for friction there in the next round, and stopped."""
    text = EQUATIONS.replace('u(unit = "V")', 'u(unit = "N.m")')
    flat = compile_text(text.encode(), Path("Model.mo"))
    cut, friction = find_effect("Signals.Saturation"), find_effect("Rotational.CoulombFriction")
    bent = attach(flat, cut, find_site(flat, "u", cut), values=SATURATION)
    gone = {site.name for site in sites(flat)} - {site.name for site in sites_left(flat, bent)}
    assert gone == {"0:u"} and sites_left(flat, flat) == sites(flat)
    with pytest.raises(ModelError, match="no place of the model any more"):
        attach(bent, friction, find_site(flat, "0:u", friction))


def test_potential_of_a_connector_is_no_signal():
    """Whatever domain it is of: what passes there has a flow as well."""
    text = """package P
      connector Port Real c(unit = "mol/m3"); flow Real n(unit = "mol/s"); end Port;
      model Cell Port port; equation 2*der(port.c) = port.n; end Cell;
      model Wall Port a; Port b; equation a.n = 0.02*(a.c - b.c); a.n + b.n = 0; end Wall;
      model Feed Port port; input Real n; equation port.n = -n; end Feed;
      model Rig input Real n; output Real y = second.port.c; Cell first, second; Wall wall; Feed feed(n = n);
        equation connect(feed.port, first.port); connect(first.port, wall.a); connect(wall.b, second.port);
      end Rig;
    end P;"""
    flat = compile_text(text.encode(), Path("P.mo"), "P.Rig")
    assert not [site for site in sites(flat) if site.kind == "signal"]
    loads = [site.name.partition(":")[2] for site in load_sites(flat)]
    assert loads == ["first.port.c", "second.port.c"], "but what no unit tells may have loads"
    plain = compile_text(text.replace("2*der", "der").encode(), Path("P.mo"), "P.Rig")
    loads = [site.name.partition(":")[2] for site in load_sites(plain)]
    assert loads == ["first.port.c", "second.port.c"], "the flow is the rate itself: its sum balances"


def test_command_that_moves_as_a_spring_would_is_both(tmp_path):
    """In N.m it may be a shaft that the input twists, or the command of a controller; behind a saturation it
    is no force between the bodies any more."""
    path = tmp_path / "Loop.mo"
    path.write_text(EQUATIONS.replace('u(unit = "V")', 'u(unit = "N.m")'))
    flat, spring = compile_model(path), find_effect("Rotational.HardeningSpring")
    places = {site.kind: site for site in sites(flat) if site.name.rpartition(":")[2] == "u"}
    assert set(places) == {"force", "signal"}
    cut = attach(flat, find_effect("Signals.Saturation"), places["signal"], values=SATURATION)
    np.testing.assert_allclose(simulated(cut, 1.0), servo(1.5), atol=1e-3)
    attach(flat, spring, places["force"])
    with pytest.raises(ModelError, match="no place of the model any more"):
        attach(cut, spring, places["force"])


def test_equation_that_does_not_name_the_signal_first_is_no_place():
    assert inside(EQUATIONS.replace("u = 20*(r - phi) - 2*w", "20*(r - phi) - 2*w = u")) == set()


DRIVE = """model Drive
  parameter Real R(unit = "Ohm") = 2;
  input Real u(unit = "V");
  output Real speed(unit = "rad/s") = w;
  Real i(unit = "A");
  Real w(unit = "rad/s", start = 0);
equation
  i = (u - 0.2*w)/R;
  0.01*der(w) = 0.2*i;
end Drive;
"""
RUDDER = """model Rudder
  input Real command(unit = "deg");
  output Real turn(unit = "deg/s", start = 0);
  Real delta(unit = "deg", start = 0);
  Real rate(unit = "deg/s");
equation
  rate = (command - delta)/0.2;
  der(delta) = rate;
  0.3*der(turn) = delta - turn;
end Rudder;
"""

GATE = """model Generator
  parameter Real T(unit = "s") = 0.2;
  input Real command(unit = "MW");
  output Real f(unit = "Hz", start = 0);
  Real gate(unit = "MW", start = 0);
equation
  T*der(gate) = command - 2*f - gate;
  0.3*der(f) = gate - f;
end Generator;
"""
FILTER = """model Filter
  parameter Real T(unit = "s") = 0.2;
  input Real u(unit = "V");
  output Real y(unit = "V", start = 0);
  Real a(unit = "V", start = 0);
equation
  T*der(a) = u - a;
  1.5*T*der(y) = a - y;
end Filter;
"""


def driven(t, x, limit):
    return [0.2 * np.clip((5.0 - 0.2 * x[0]) / 2, -limit, limit) / 0.01]


def turned(t, x, limit):
    return [(x[1] - x[0]) / 0.3, np.clip((5.0 - x[1]) / 0.2, -limit, limit)]


def fed(t, x, limit):
    return [(np.clip(x[1], -limit, limit) - x[0]) / 0.3, (5.0 - 2 * x[0] - x[1]) / 0.2]


def passed(t, x, limit):
    return [(np.clip(x[1], -limit, limit) - x[0]) / 0.3, (5.0 - x[1]) / 0.2]


@pytest.mark.parametrize(
    ("text", "name", "motion"),
    [
        (DRIVE, "i", driven),
        (RUDDER, "rate", turned),
        (GATE, "gate", fed),
        (FILTER, "a", passed),
        (FILTER.replace('(unit = "s")', ""), "a", passed),
        (FILTER.replace("*T*der(y)", "*0.2*der(y)").replace("T*der(a)", "0.2*der(a)"), "a", passed),
    ],
    ids=["current", "rate", "gate", "stage of a filter", "time without a unit", "time as a number"],
)
def test_what_an_actuator_gives_may_have_a_limit_and_no_other_law(tmp_path, text, name, motion):
    """Friction beside a limit of the current had been a curve over a force."""
    path = tmp_path / "Machine.mo"
    path.write_text(text)
    flat, effect = compile_model(path), find_effect("Signals.Saturation")
    assert inside(text) == {name}
    site = find_site(flat, name, effect)
    assert fits(find_effect("Signals.OneSidedLimit"), site) and not fits(find_effect("Signals.Gain"), site)
    values = {"share": 1.0, "limit": 1.5, "u_s": 1e-3}
    written = extend_model(path, None, effect, site, values=values)
    start, times = [0.0] * (1 + (name != "i")), np.linspace(0.0, 1.0, 101)
    given = {"args": (1.5,), "t_eval": times, "rtol": 1e-9, "max_step": 0.01}
    expected = solve_ivp(motion, (0.0, 1.0), start, **given).y[0]
    for model in (attach(flat, effect, site, values=values), written.flat):
        np.testing.assert_allclose(simulated(model, 5.0), expected, atol=3e-3)


def test_a_flux_with_a_law_and_a_rate_is_one_place():
    """It was listed twice, and all effects there were searched for twice."""
    text = """model Motor
      input Real u(unit = "V"); output Real y(unit = "rad/s", start = 0);
      Real psi(unit = "Wb", start = 0); Real q(unit = "Wb", start = 0);
      Real i(unit = "A"); Real j(unit = "A");
    equation
      psi = 0.2*i + 0.1*j; q = 0.1*i + 0.2*j;
      der(psi) = u - i; der(q) = -j - y*psi;
      der(y) = psi*j - y;
    end Motor;"""
    flat = compile_text(text.encode(), Path("Motor.mo"))
    assert [site.name for site in sites(flat) if site.kind == "signal"] == ["psi"]
