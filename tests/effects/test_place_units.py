"""Units of an effect's parameters: of the signal that it sits on, and none where an equation tells none."""

from pathlib import Path

import pytest

from daest.diagnosis.null_model.loads import load_places, load_sites, with_loads
from daest.errors import ModelError
from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.flat.clock import clock_unit
from daest.modelica.flat.factors import given_value
from daest.modelica.places.balances import balances
from daest.modelica.places.place_units import balance_entry, flow_unit, units_at
from daest.modelica.places.sites import find_site, sites

MODEL = """\
model Bare
  parameter Real J(unit = "kg.m2") = 2;
  parameter Real n(unit = "1") = 3;
  parameter Real l(unit = "m") = 2;
  parameter Real m(unit = "kg") = 1;
  parameter Real k(unit = "N.m/A") = 1;
  parameter Real C(unit = "J/K") = 100;
  parameter Real C2(unit = "J/K") = 300;
  parameter Real Rth(unit = "K/W") = 2;
  parameter Real plain = 1;
  input Real u(unit = "V");
  input Real bare;
  output Real y(unit = "m/s");
  Real w1(unit = "rad/s");
  Real w2(unit = "rad/s");
  Real w3(unit = "rad/s");
  Real w4(unit = "rad/s");
  Real w5(unit = "rad/s");
  Real v(unit = "m/s");
  Real a(unit = "m/s2");
  Real T(unit = "degC");
  Real T2(unit = "K");
  Real T3(unit = "K");
  Real T4(unit = "K");
  Real T5(unit = "K");
  Real T6(unit = "K");
equation
  y = v;
  (J*n^2 + 0.5*m*l^2)*der(w1) = u - w1;
  der(w2) = (u - 0.1*w2)/J;
  plain*der(w3) = bare - w3;
  0.5*der(w4) = u - w4;
  k*der(w5) = u - w5;
  a = der(v);
  m*a = -v;
  C*der(T) = 5 - T;
  der(T2) = -T2;
  der(T3) = -(T3 - T4/l)/(0.001*2*C*n^2);
  der(T4) = 1/C*(T3 - T4) - T4/C/k;
  der(T5) = (T4 - T5)/(plain*Rth*C) - 1/(Rth*C)*T5;
  der(T6) = (T5 - T6)/(Rth*C) - T6/(Rth*C2);
end Bare;
"""


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    file = tmp_path_factory.mktemp("bare") / "Bare.mo"
    file.write_text(MODEL)
    return compile_model(file)


def units(flat, name: str, place: str) -> dict[str, str]:
    effect = find_effect(name)
    return units_at(flat, effect, find_site(flat, place, effect))


def test_equations_that_tell_the_unit_of_their_terms(flat) -> None:
    known = {"tau_c": "N.m", "b": "1", "w_st": "rad/s", "w_s": "rad/s"}
    assert units(flat, "Rotational.StribeckFriction", "0:w1") == known
    assert units(flat, "Rotational.StribeckFriction", "1:w2") == known
    assert units(flat, "Translational.ViscousFriction", "6:v")["d"] == "N.s/m"
    assert units(flat, "Thermal.ConstantHeatGain", "7:T") == {"Q_0": "W"}


def test_a_load_has_the_unit_of_the_flows_where_the_equation_tells_it(flat) -> None:
    found = {site.name: flow_unit(flat, site) for site in sites(flat) if site.kind == "equation"}
    known = {"0:w1": "N.m", "1:w2": "N.m", "6:v": "N", "7:T": "W", "9:T3": "W", "10:T4": "W", "11:T5": "W"}
    assert {name: unit for name, unit in found.items() if unit} == known and len(found) > len(known)


@pytest.mark.parametrize("place", ["2:w3", "3:w4", "4:w5"])
def test_rates_and_factors_without_a_unit_tell_none(flat, place: str) -> None:
    unknown = {"tau_c": "", "b": "1", "w_st": "rad/s", "w_s": "rad/s"}
    assert units(flat, "Rotational.StribeckFriction", place) == unknown
    assert units(flat, "Thermal.ConstantHeatGain", "8:T2") == {"Q_0": ""}


def test_flows_into_a_level_in_cm_are_in_no_known_unit(tmp_path) -> None:
    (tmp_path / "Tank.mo").write_text(
        'model Tank input Real duty; output Real y(unit = "cm"); parameter Real A(unit = "cm2") = 140;'
        ' parameter Real k(unit = "cm3/s") = 0.4; parameter Real c = 6; Real h(unit = "cm", start = 1);'
        " equation A*der(h) = k*duty - c*sqrt(h); y = h; end Tank;"
    )
    tank = compile_model(tmp_path / "Tank.mo")
    assert units(tank, "Hydraulic.ConstantFlow", "0:h") == {"q_0": ""}
    assert units(tank, "Hydraulic.Overflow", "0:h")["p_max"] == "m"


@pytest.mark.parametrize(
    ("name", "parameter", "by_signal"),
    [
        ("DeadZone", "width", {"u": "V", "y": "m/s", "bare": ""}),
        ("Offset", "b", {"u": "V", "y": "m/s", "bare": ""}),
        ("Saturation", "limit", {"u": "V", "y": "m/s", "bare": ""}),
        ("Drift", "r", {"u": "V/s", "y": "(m/s)/s", "bare": ""}),
        ("QuadraticGain", "a", {"u": "1/V", "y": "1/(m/s)", "bare": ""}),
        ("Gain", "g", {"u": "1", "y": "1", "bare": "1"}),
        ("Lag", "T", {"u": "s", "y": "s", "bare": "s"}),
    ],
)
def test_sizes_on_a_signal_have_its_unit(flat, name: str, parameter: str, by_signal: dict[str, str]) -> None:
    effect = find_effect(name)
    for signal, unit in by_signal.items():
        assert units(flat, name, signal)[parameter] == unit
        extended = attach(flat, effect, find_site(flat, signal, effect), "extra")
        assert {p.name: p.unit for p in extended.parameters}[f"extra.{parameter}"] == unit


def test_parameters_of_signal_effects_have_a_unit() -> None:
    signals = [e for e in effect_library() if e.domain == "signal"]
    without = [(e.name, p.name) for e in signals for p in e.parameters if not (p.unit or p.signal_unit)]
    assert without == [("MeasuredInput", "k"), ("Crosstalk", "k")]  # per unit of what may have none


def test_a_unit_that_is_none_is_refused(tmp_path) -> None:
    (tmp_path / "Bias.mo").write_text(
        "block Bias\n  extends Daest.Effects.Signals.Interfaces.SignalEffect;\n"
        '  parameter Real b = 1 annotation(__Daest(estimate = true, role = "size", unit = "V"));\n'
        "equation\n  y = u + b;\n"
        '  annotation(__Daest(effect = true, attach = "signal", law = "y = u + b"));\n'
        "end Bias;\n"
    )
    with pytest.raises(ModelError, match="unit of `b`") as caught:
        effect_library([tmp_path])
    assert 'Write "u"' in caught.value.remedy


HOURS = """\
model Hours
  parameter Real C(unit = "kW.h/K") = 2;
  parameter Real G(unit = "kW/K") = 0.2;
  parameter Real Tg(unit = "h") = 0.3;
  input Real u(unit = "kW");
  output Real y(unit = "degC");
  Real T(unit = "degC");
  Real q(unit = "kW");
equation
  Tg*der(q) = u - q;
  C*der(T) = {factor}q - G*T;
  y = T;
end Hours;
"""


@pytest.mark.parametrize(
    ("factor", "change", "clock"),
    [
        ("", ("", ""), "h"),
        ("0.5*", ("", ""), "h"),  # 0.5 might be a conversion: G*T tells
        ("", ("kW.h/K", "kW.d/K"), "s"),  # contradicts Tg
        ("", ('"h"', '"s"'), "s"),
    ],
)
def test_the_units_of_a_balance_tell_that_a_model_counts_time_in_hours(tmp_path, factor, change, clock):
    file = tmp_path / "Hours.mo"
    file.write_text(HOURS.format(factor=factor).replace(*change))
    flat = compile_model(file)
    assert clock_unit(flat) == clock
    at = {site.name: site for site in sites(flat)}
    assert units_at(flat, find_effect("Lag"), at["y"])["T"] == clock
    assert units_at(flat, find_effect("Drift"), at["y"])["r"] == f"degC/{clock}"
    assert units_at(flat, find_effect("HeatLoss"), at["1:T"])["G"] == "W/K"


RIVER = """\
model River
  parameter Real K(unit = "h") = 20;
  input Real p(unit = "mm/h");
  output Real Q(unit = "m3/s");
  Real S(unit = "mm");
equation
  der(S) = p - S/K;
  Q = 31.9*S/K;
end River;
"""


def test_a_flow_per_second_stays_one_in_a_model_that_counts_hours(tmp_path):
    file = tmp_path / "River.mo"
    file.write_text(RIVER)
    flat = compile_model(file)
    assert clock_unit(flat) == "h"
    discharge = next(site for site in sites(flat) if site.name == "Q")
    play = units_at(flat, find_effect("Play"), discharge)
    assert play["width"] == "m3/s" and play["T"] == "h"
    assert units_at(flat, find_effect("QuadraticGain"), discharge)["a"] == "1/(m3/s)"
    assert units_at(flat, find_effect("Drift"), discharge)["r"] == "(m3/s)/h"


GROWTH = """\
model Growth
  parameter Real mu(unit = "1/h") = 0.5;
  parameter Real K(unit = "mmol/l") = 0.1;
  parameter Real Y(unit = "l/mmol") = 0.02;
  parameter Real c = 1;
  output Real X(start = 0.02);
  Real S(unit = "mmol/l", start = 60);
  Real r;
equation
  r = mu*S/(K + S)*X;
  der(X) = r;
  der(S) = -r/Y;
end Growth;
"""


@pytest.mark.parametrize(
    ("change", "clock"),
    [
        (("", ""), "h"),
        (('"1/h"', '"1/d"'), "d"),
        (('"1/h"', '"1/min"'), "s"),  # speeds are in 1/min
        (("Real c ", 'Real c(unit = "W") '), "s"),  # a Joule a second
        (("Real c ", 'Real c(unit = "1/d") '), "s"),
        (('"1/h"', '"km/h"'), "s"),
    ],
)
def test_the_rates_of_a_model_tell_its_clock_where_no_balance_does(tmp_path, change, clock):
    file = tmp_path / "Growth.mo"
    file.write_text(GROWTH.replace(*change))
    assert clock_unit(compile_model(file)) == clock


WASHED_OUT = """\
model WashedOut
  parameter Real M(unit = "kmol") = 3;
  parameter Real a(unit = "1") = 2.4;
  input Real F(unit = "kmol/h");
  input Real z(unit = "1");
  Real x(unit = "1", start = 0.5);
  output Real y(unit = "1");
equation
  y = a*x/(1 + (a - 1)*x);
  M*der(x) = F*(z - x) - F*y;
end WashedOut;
"""


@pytest.mark.parametrize(
    ("change", "clock"),
    [
        (("", ""), "h"),
        (('"kmol/h"', '"kmol/min"'), "min"),
        (('F(unit = "kmol/h")', "F"), "s"),
        (("F*(z - x)", "F/3600*(z - x)"), "h"),  # 3600 might be a conversion: F*y tells
        (("F*(z - x) - F*y", "F/3600*(z - x)"), "s"),
        (('"kmol")', '"kg")'), "s"),
    ],
)
def test_flows_that_are_inputs_tell_the_clock_where_no_balance_of_parameters_does(tmp_path, change, clock):
    file = tmp_path / "WashedOut.mo"
    file.write_text(WASHED_OUT.replace(*change))
    assert clock_unit(compile_model(file)) == clock


OWN_UNITS = """\
model Own
  parameter Real J(unit = "kg.m2") = 2;
  parameter Real T(unit = "s") = 3;
  input Real brake(unit = "N.m");
  input Real rudder(unit = "deg");
  output Real y(unit = "rpm");
  Real n(unit = "rpm");
  Real r(unit = "deg/s");
equation
  J*der(n) = -9.5*brake - 0.1*n;
  T*der(r) = rudder - r;
  y = n;
end Own;
"""


def test_a_known_flow_tells_the_factor_of_others_be_it_driving_or_braking(tmp_path):
    file = tmp_path / "Own.mo"
    file.write_text(OWN_UNITS)
    flat = compile_model(file)
    assert factor_at(flat, "0:n") == 9.5


def test_an_effect_that_is_put_in_tells_no_unit_and_turns_no_sign(tmp_path):
    file = tmp_path / "Own.mo"
    file.write_text(OWN_UNITS)
    flat = compile_model(file)
    friction = find_effect("Rotational.CoulombFriction")
    for place in ("0:n", "1:r"):
        flat = attach(flat, friction, find_site(flat, place))
    assert factor_at(flat, "0:n") == 9.5
    assert factor_at(flat, "1:r") == 1.0 and units(flat, "Rotational.ConstantLoad", "1:r") == {"tau_0": ""}


def factor_at(flat, name: str) -> float:
    """By what a flow is multiplied in the balance of that name."""
    balance = next(one for one in balances(flat) if one.name(flat) == name)
    return given_value(flat, balance_entry(flat, balance).factor)


@pytest.mark.parametrize(
    ("unit", "of_flow", "law", "factor"),
    [
        ("J/K", "W/K", "C*der(T) = G*(u - T)", 1.0),
        ("kJ/K", "kW/K", "C*der(T) = G*(u - T)", 1e-3),
        ("kW.h/K", "kW/K", "C*der(T) = G*(u - T)", 1e-3),
        ("kJ/K", "W/K", "1000*C*der(T) = G*(u - T)", 1.0),  # the number is a conversion
    ],
)
def test_terms_in_kilowatts_tell_it_though_no_flow_stands_among_them(tmp_path, unit, of_flow, law, factor):
    file = tmp_path / "M.mo"
    file.write_text(
        f'model M parameter Real C(unit="{unit}") = 2; parameter Real G(unit="{of_flow}") = 0.2;\n'
        f'input Real u(unit="degC"); output Real T(unit="degC"); equation {law}; end M;\n'
    )
    flat = compile_model(file)
    (balance,) = balances(flat)
    assert given_value(flat, balance_entry(flat, balance).factor) == pytest.approx(factor)


def test_loads_that_stand_in_a_balance_do_not_change_its_scale() -> None:
    """What is put in after them had been taken in kW, and called W."""
    flat = compile_text(
        b'model M parameter Real C(unit = "kW.h/K") = 2; parameter Real G(unit = "kW/K") = 0.2; '
        b'input Real u(unit = "degC"); output Real y(unit = "degC") = T; Real T(unit = "degC"); '
        b"equation C*der(T) = G*(u - T); end M;",
        Path("M.mo"),
    )
    (place,) = load_places(flat, load_sites(flat))
    assert factor_at(with_loads(flat, [place], [1.0]), "0:T") == pytest.approx(1e-3)
