"""Effects in series in the meshes of bare equations, against the motion by scipy."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from effect_rig import in_steps
from scipy.integrate import solve_ivp

from daest.errors import ModelError
from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import fits, sites
from daest.systems.simulation.simulate import simulate

HEAD = """model Motor
  parameter Real R(unit = "Ohm") = 2;
  parameter Real Ke(unit = "V.s/rad") = 0.1;
  parameter Real L(unit = "H") = 0.5;
  parameter Real J(unit = "kg.m2") = 0.01;
  input Real u(unit = "V");
  output Real y(unit = "rad/s") = w;
  Real w(unit = "rad/s", start = 0, fixed = true);
"""
REST = "\n  J*der(w) = Ke*i;\nend Motor;\n"
FORMS = {
    "sum": '  Real i(unit = "A");\nequation\n  u = R*i + Ke*w;',
    "turned": '  Real i(unit = "A");\nequation\n  Ke*w + R*i - u = 0;',
    "current": '  Real i(unit = "A");\nequation\n  i = (u - Ke*w)/R;',
    "bound": '  Real i(unit = "A") = (u - Ke*w)/R "Current";\nequation',
    "back": '  Real i(unit = "A");\n  Real e(unit = "V") = u - R*i "Back EMF";\nequation\n  e = Ke*w;',
    "coil": '  Real i(unit = "A", start = 0, fixed = true);\nequation\n  L*der(i) = u - R*i - Ke*w;',
    "rate": '  Real i(unit = "A", start = 0, fixed = true);\nequation\n  der(i) = (u - R*i - Ke*w)/L;',
}


def rate(has_coil, drop=0.0):
    def of(_, state):
        w, i = state
        back = 0.1 * w + drop * np.tanh(i / 0.3)
        if has_coil:
            return [10 * i, (5.0 - 2 * i - back) / 0.5]
        # Without the coil the current follows at once: here within 1 us.
        return [10 * i, (5.0 - 2 * i - back) / 2e-6]

    return of


@cache
def turning(has_coil, drop=0.0):
    return solve_ivp(rate(has_coil, drop), (0.0, 0.3), [0.0, 0.0], method="LSODA", rtol=1e-9, atol=1e-12).y[
        0, -1
    ]


@pytest.mark.parametrize(
    "form",
    [form if form in ("sum", "coil") else pytest.param(form, marks=pytest.mark.slow) for form in FORMS],
)
def test_voltage_drop_is_put_in_series(tmp_path, form):
    path = tmp_path / "Motor.mo"
    path.write_text(HEAD + FORMS[form] + REST)
    flat, effect = compile_model(path), find_effect("Electrical.BrushVoltageDrop")
    (site,) = [s for s in sites(flat) if s.kind == "mesh"]
    assert fits(effect, site)
    has_coil = form in ("coil", "rate")
    values = {"V_b": 1.5, "i_s": 0.3}
    drive = (np.linspace(0.0, 0.3, 31), np.full((31, 1), 5.0))
    written = extend_model(path, None, effect, site, values=values)
    for model in (attach(flat, effect, site, values=values), written.flat):
        assert simulate(model, drive).outputs[-1, 0] == pytest.approx(turning(has_coil, 1.5), rel=2e-5)
    base = tmp_path / "Base.mo"
    base.write_text(written.text)
    opened = simulate(compile_model(base, "Motor"), drive).outputs[-1, 0]
    assert opened == pytest.approx(turning(has_coil), rel=2e-5)


WRITTEN_OUT = {
    "product": "J*der(w) = Ke*(u - Ke*w)/R;",
    "turned": "-J*der(w) = Ke/R*(Ke*w - u);",
    "rate": "der(w) = (Ke*((u - Ke*w)/R))/J;",
}


SMALL = {  # the same motor in other units
    'R(unit = "Ohm") = 2': 'R(unit = "kOhm") = 0.002',
    'L(unit = "H") = 0.5': 'L(unit = "kH") = 0.0005',
    'J(unit = "kg.m2") = 0.01': 'J(unit = "g.m2") = 10',
    'i(unit = "A"': 'i(unit = "mA"',
}


@pytest.mark.parametrize("form", ["sum", "current", "coil", "rate"])
def test_voltage_drop_is_in_its_units_beside_currents_in_others(tmp_path, form):
    text = HEAD + FORMS[form] + REST
    for own, other in SMALL.items():
        text = text.replace(own, other)
    path = tmp_path / "Motor.mo"
    path.write_text(text)
    flat, effect = compile_model(path), find_effect("Electrical.BrushVoltageDrop")
    (site,) = [s for s in sites(flat) if s.kind == "mesh"]
    values = {"V_b": 1.5, "i_s": 0.3}
    drive = (np.linspace(0.0, 0.3, 31), np.full((31, 1), 5.0))
    written = extend_model(path, None, effect, site, values=values)
    for model in (attach(flat, effect, site, values=values), written.flat):
        reached = simulate(model, drive).outputs[-1, 0]
        assert reached == pytest.approx(turning(form in ("coil", "rate"), 1.5), rel=2e-5)


def test_pressure_drop_is_in_its_units_beside_bar_and_litres() -> None:
    text = b"""model Pipe
      parameter Real b(unit = "bar.min2/l2") = 1e-4; parameter Real I(unit = "bar.s.min/l") = 0.02;
      input Real p(unit = "bar"); output Real q(unit = "l/min", start = 90, fixed = true);
    equation
      I*der(q) = p - b*q^2;
    end Pipe;"""
    flat, effect = compile_text(text, Path("Pipe.mo")), find_effect("Hydraulic.Orifice")
    (site,) = [s for s in sites(flat) if s.kind == "mesh"]
    assert units_at(flat, effect, site)["k"] == "Pa.s2/m6"
    k = 5e-5 * 1e5 * 6e4**2  # 5e-5 bar.min2/l2
    drive = (np.linspace(0.0, 20.0, 201), np.full((201, 1), 1.5))
    run = simulate(attach(flat, effect, site, values={"k": k, "q_s": 1e-7}), drive)
    assert run.outputs[-1, 0] == pytest.approx(100.0, rel=1e-4)


@pytest.mark.parametrize(
    "form", [pytest.param(f, marks=pytest.mark.slow if f == "product" else ()) for f in WRITTEN_OUT]
)
@pytest.mark.parametrize(
    ("class_name", "values", "expected"),
    [("BrushVoltageDrop", {"V_b": 1.5, "i_s": 0.3}, (False, 1.5)), ("Inductance", {"L": 0.5}, (True,))],
)
def test_current_without_a_variable_is_a_place(tmp_path, form, class_name, values, expected):
    path = tmp_path / "Motor.mo"
    path.write_text(f"{HEAD}equation\n  {WRITTEN_OUT[form]}\nend Motor;\n")
    flat, effect = compile_model(path), find_effect(f"Electrical.{class_name}")
    (site,) = [s for s in sites(flat) if s.kind == "mesh"]
    assert site.name.endswith(":R")
    assert fits(effect, site)
    drive = (np.linspace(0.0, 0.3, 31), np.full((31, 1), 5.0))
    written = extend_model(path, None, effect, site, values=values)
    for model in (attach(flat, effect, site, values=values), written.flat):
        assert simulate(model, drive).outputs[-1, 0] == pytest.approx(turning(*expected), rel=2e-5)


@pytest.mark.parametrize(
    "row",
    [
        "J*der(w) = Ke*(u - Ke*w)/R + 0.01*u",  # the voltage does something else besides
        "J*der(w) = Ke*u*u/R - Ke*w",  # it is squared
        "J*der(w) = Ke*(u - 3*w)/R",  # no sum of voltages
        "J*R*der(w) = Ke*(u - Ke*w)",  # nothing is divided by the resistance
        "J*der(w) = Ke*u*w/R",  # a power
    ],
)
def test_what_holds_no_current_is_no_place(row):
    text = f"{HEAD}equation\n  {row};\nend Motor;\n"
    assert not [s for s in sites(compile_text(text.encode(), Path("Motor.mo"))) if s.kind == "mesh"]


def test_two_effects_in_one_mesh_add_up(tmp_path):
    path = tmp_path / "Motor.mo"
    path.write_text(HEAD + FORMS["current"] + REST)
    steps = [("BrushVoltageDrop", {"V_b": 1.5, "i_s": 0.3}), ("Inductance", {"L": 0.5})]
    expected, made = in_steps(tmp_path, path, "Motor", [(f"Electrical.{n}", "i", v) for n, v in steps])
    drive = (np.linspace(0.0, 0.3, 31), np.full((31, 1), 5.0))
    for one in (expected, made.flat):
        assert simulate(one, drive).outputs[-1, 0] == pytest.approx(turning(True, 1.5), rel=2e-5)


def test_currents_of_a_loop_are_refused_with_a_reason(tmp_path):
    path = tmp_path / "Coils.mo"
    path.write_text("""model Coils
  parameter Real R(unit = "Ohm") = 2;
  input Real u(unit = "V");
  output Real y(unit = "A") = i[1] + i[2];
  Real i[2](each unit = "A");
equation
  for k in 1:1:2 loop
    i[k] = k*u/R;
  end for;
end Coils;
""")
    effect = find_effect("Electrical.BrushVoltageDrop")
    site = next(s for s in sites(compile_model(path)) if s.kind == "mesh")
    with pytest.raises(ModelError, match="several equations"):
        extend_model(path, None, effect, site)


@pytest.mark.parametrize(
    "rows",
    [
        "C*der(v) = i - v/R;\n  i = i1",
        "der(v) = -v;\n  i = i1 + v/R",
        "der(v) = -v;\n  P = v*i;\n  P = 1",
    ],
)
def test_what_is_no_sum_of_voltages_is_no_mesh(rows):
    power = '  Real P(unit = "W");\n' if "P" in rows else ""
    text = f"""model Node
  parameter Real R(unit = "Ohm") = 2;
  parameter Real C(unit = "F") = 2;
  input Real i1(unit = "A");
  Real v(unit = "V", start = 1);
  Real i(unit = "A");
{power}  output Real y = v;
equation
  {rows};
end Node;
"""
    assert not [s for s in sites(compile_text(text.encode(), Path("Node.mo"))) if s.kind == "mesh"]


PIPE = """model Pipe
  parameter Real L(unit = "kg/m4") = 2e6;
  parameter Real R(unit = "Pa.s/m3") = 3e6;
  parameter Real C(unit = "m3/Pa") = 1e-7;
  parameter Real G(unit = "m3/(s.Pa)") = 2e-8;
  input Real p(unit = "Pa");
  output Real y(unit = "m3/s") = q;
  Real q(unit = "m3/s", start = 0, fixed = true);
  Real pv(unit = "Pa", start = 0, fixed = true);
equation
  L*der(q) = p - pv - R*q;
  C*der(pv) = q - G*pv;
end Pipe;
"""


PIPE_RATE = PIPE.replace("L*der(q) = p - pv - R*q", "der(q) = (p0 - pv - R*q)/L").replace(
    "equation\n", '  Real p0(unit = "Pa") = p;\nequation\n'
)


@pytest.mark.parametrize("text", [PIPE, pytest.param(PIPE_RATE, marks=pytest.mark.slow)], ids=["sum", "rate"])
def test_orifice_is_put_in_series_in_a_pipe(tmp_path, text):
    path, k = tmp_path / "Pipe.mo", 4e9
    path.write_text(text)
    flat, effect = compile_model(path), find_effect("Hydraulic.Orifice")
    (site,) = [s for s in sites(flat) if s.kind == "mesh"]
    assert (site.name.partition(":")[2], site.domain) == ("q", "hydraulic")
    assert fits(effect, site)
    assert not fits(find_effect("Electrical.BrushVoltageDrop"), site)

    def flowing(k):
        def rate(_, state):
            q, pv = state
            return [(2e5 - pv - 3e6 * q - k * q * abs(q)) / 2e6, (q - 2e-8 * pv) / 1e-7]

        return solve_ivp(rate, (0.0, 3.0), [0.0, 0.0], method="LSODA", rtol=1e-9, atol=1e-12).y[0, -1]

    drive = (np.linspace(0.0, 3.0, 301), np.full((301, 1), 2e5))
    values = {"k": k, "q_s": 1e-9}
    written = extend_model(path, None, effect, site, values=values)
    assert "Daest.Terms.PressureDrop q_term(q = q)" in written.text
    for model in (attach(flat, effect, site, values=values), written.flat):
        assert simulate(model, drive).outputs[-1, 0] == pytest.approx(flowing(k), rel=2e-5)
    base = tmp_path / "Base.mo"
    base.write_text(written.text)
    assert simulate(compile_model(base, "Pipe"), drive).outputs[-1, 0] == pytest.approx(
        flowing(0.0), rel=2e-5
    )


TUNNEL = """model Tunnel "Head in meters; the gravity has no unit where it stands"
  constant Real g = 9.80665;
  parameter Real A(unit = "m2") = 10;
  parameter Real R(unit = "s/m2") = 0.1;
  input Real z(unit = "m");
  output Real y(unit = "m3/s") = Q;
  Real Q(unit = "m3/s", start = 0, fixed = true);
  Real h(unit = "m", start = 0, fixed = true);
equation
  2400/(g*A)*der(Q) = z - h - R*Q;
  60*der(h) = Q;
end Tunnel;
"""


def test_orifice_is_put_in_series_in_a_sum_of_heads(tmp_path):
    path = tmp_path / "Tunnel.mo"
    path.write_text(TUNNEL)
    flat, effect = compile_model(path), find_effect("Hydraulic.Orifice")
    (site,) = [s for s in sites(flat) if s.kind == "mesh"]
    assert (site.name, site.domain) == ("0:Q", "hydraulic")
    assert units_at(flat, effect, site)["k"] == "m.s2/m6"

    def rate(_, state):
        Q, h = state
        return [(8.0 - h - 0.1 * Q - 0.02 * Q * abs(Q)) * 9.80665 * 10 / 2400, Q / 60]

    flowing = solve_ivp(rate, (0.0, 90.0), [0.0, 0.0], method="LSODA", rtol=1e-9, atol=1e-12).y[0, -1]
    drive = (np.linspace(0.0, 90.0, 901), np.full((901, 1), 8.0))
    values = {"k": 0.02, "q_s": 1e-4}
    for model in (
        attach(flat, effect, site, values=values),
        extend_model(path, None, effect, site, values=values).flat,
    ):
        assert simulate(model, drive).outputs[-1, 0] == pytest.approx(flowing, rel=2e-5)


def test_a_density_without_unit_hides_no_pipe(tmp_path):
    """The unit of the loss tells what that of `1000*L/A` does not."""
    path = tmp_path / "Pipe.mo"
    text = TUNNEL.replace('unit = "s/m2") = 0.1', 'unit = "Pa.s/m3") = 980')
    own, row = "2400/(g*A)*der(Q) = z - h - R*Q", "1000*240*der(Q) = 9806.65*(z - h) - R*Q"
    path.write_text(text.replace(own, row))
    (site,) = [s for s in sites(compile_model(path)) if s.kind == "mesh"]
    assert (site.name, site.domain) == ("0:Q", "hydraulic")
    assert units_at(compile_model(path), find_effect("Hydraulic.Orifice"), site)["k"] == "Pa.s2/m6"
