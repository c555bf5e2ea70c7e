"""Balances of what belongs to no physical domain: which rows they are, and how effects are put in there."""

from pathlib import Path

import pytest
from effect_rig import characteristic, in_steps

from daest.errors import ModelError
from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import find_site, sites

TANK = """\
model Tank "Salt in two vessels, one of which fills; time in hours"
  parameter Real V(unit = "l", min = 0) = 50;
  parameter Real k(unit = "1/h", min = 0) = 0.2;
  input Real q(unit = "l/h");
  input Real c_in(unit = "mg/l");
  output Real y(unit = "mg/l") = c;
  Real c(unit = "mg/l", start = 3);
  Real A(unit = "mg", start = 2);
  Real W(unit = "l", start = 9);
  Real b(unit = "mg/l");
equation
  V*der(c) = q*(c_in - c);
  k*V*c - k*A = der(A) "in a second vessel";
  der(W) = q;
  W*der(b) = q*(c - b);
end Tank;
"""
AMOUNTS = [effect for effect in effect_library() if effect.domain == "amount"]


@pytest.fixture(scope="module")
def tank(tmp_path_factory):
    file = tmp_path_factory.mktemp("tank") / "Tank.mo"
    file.write_text(TANK)
    return file


def amounts(text):
    return [site.name for site in sites(compile_text(text.encode(), Path("M.mo"))) if site.domain == "amount"]


def test_what_belongs_to_no_domain_is_an_amount():
    assert amounts(TANK) == ["0:c", "1:A", "2:W", "3:b"]
    people = """model Epidemic
      parameter Real beta(unit = "1/d") = 0.5, T(unit = "d") = 6, N(unit = "1") = 1e5;
      input Real c(unit = "1"); output Real y(unit = "1") = I;
      Real S(unit = "1", start = 9e4), I(unit = "1", start = 200);
    equation
      der(S) = -beta*c*I*S/N;
      der(I) = beta*c*I*S/N - I/T;
    end Epidemic;"""
    assert amounts(people) == ["0:S", "1:I"]
    air = """model Air
      parameter Real V(unit = "m3") = 60, Q(unit = "m3/h") = 40;
      input Real outside(unit = "ppm"), people(unit = "1"); output Real y(unit = "ppm") = c;
      Real c(unit = "ppm", start = 500);
    equation
      V*der(c) = Q*(outside - c) + 2e4*people;
    end Air;"""
    assert amounts(air) == ["0:c"]


def test_what_has_a_domain_or_may_have_any_is_none():
    """Places, rates and flows of a machine, a valve that follows its command, and what has no unit."""
    text = """model Machine
      parameter Real m(unit = "kg") = 2, T(unit = "s") = 0.1, L(unit = "H") = 0.3, R(unit = "Ohm") = 2;
      input Real u(unit = "1"), way(unit = "m"), cry(unit = "V"); output Real y(unit = "m/s") = v;
      Real v(unit = "m/s"), e(unit = "m"), F(unit = "N"), gate(unit = "1"), i(unit = "A"), n(unit = "1/s");
      Real x, phi(unit = "deg");
    equation
      m*der(v) = F + gate - 0.3*v;
      der(e) = v - way + n;
      der(F) = 3*e - F;
      T*der(gate) = u - gate;
      L*der(i) = cry - R*i;
      der(n) = i - n;
      der(x) = v - x;
      der(phi) = 3*x - phi*gate;
    end Machine;"""
    assert amounts(text) == []
    assert amounts(text.replace("T*der(gate) = u - gate", "der(gate) = u/T - 0.3*gate")) == ["3:gate"]


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        (
            "c",
            {"r_0": "(mg/l)/h", "k": "1/h", "r_max": "(mg/l)/h", "x_h": "mg/l", "k2": "l/(mg.h)", "T": "h"},
        ),
        ("A", {"r_0": "mg/h", "k": "1/h", "r_max": "mg/h", "x_h": "mg", "k2": "1/(mg.h)", "T": "h"}),
        # What stands beside a rate behind a volume that grows is no rate of the concentration.
        ("b", {"r_0": "", "k": "", "r_max": "", "x_h": "mg/l", "k2": "", "T": "h"}),
    ],
)
def test_units_follow_from_the_amount_and_the_clock(tank, place, expected):
    flat = compile_model(tank)
    site = find_site(flat, place, AMOUNTS[0])
    found = {e.name: units_at(flat, e, site) for e in AMOUNTS}
    assert found["ConstantInflow"] == {"r_0": expected["r_0"]}
    assert found["FirstOrderLoss"] == {"k": expected["k"]}
    assert found["SaturableLoss"] == {"r_max": expected["r_max"], "x_h": expected["x_h"]}
    assert found["QuadraticLoss"] == {"k": expected["k2"]}
    assert found["HiddenStore"] == {"k": expected["k"], "T": expected["T"]}


@pytest.mark.parametrize("effect", AMOUNTS, ids=lambda effect: effect.name)
@pytest.mark.parametrize(
    ("place", "says"),
    [
        ("c", "V*der(c) + V*c_term.total = q*(c_in - c);"),
        ("A", 'k*V*c - k*A = der(A) + A_term.total "in a second vessel";'),
        ("b", "W*der(b) + b_term.total = q*(c - b);"),
    ],
)
def test_rates_of_amounts_are_written(tank, effect, place, says):
    """The text is that of the same equations as `attach` gives, in the units of the place."""
    flat = compile_model(tank)
    site = find_site(flat, place, effect)
    values = {effect.sizes[0].name: 0.3}
    made = extend_model(tank, "Tank", effect, site, values=values)
    merged = attach(flat, effect, site, values=values)
    assert says in made.text
    assert {p.name: (p.value, p.unit) for p in made.flat.parameters if p.name.count(".")} == {
        p.name: (p.value, p.unit or next(q.unit for q in effect.parameters if p.name.endswith(f".{q.name}")))
        for p in merged.parameters
        if p.name.count(".")
    }
    assert characteristic(made.flat) == pytest.approx(characteristic(merged), rel=1e-6)
    with pytest.raises(ModelError, match="already"):
        attach(merged, effect, site)


def test_effects_on_one_amount_share_its_term(tank, tmp_path):
    steps = [("ConstantInflow", "c", {"r_0": 0.2}), ("HiddenStore", "c", {"k": 0.1, "T": 3.0})]
    expected, made = in_steps(tmp_path, tank, "Tank", steps)
    assert made.text.count("Daest.Terms.Inflow") == 1
    assert characteristic(made.flat) == pytest.approx(characteristic(expected), rel=1e-6)


def test_an_amount_without_a_unit_is_told_by_the_effect():
    text = """model Pond
      parameter Real r = 0.8; input Real u; output Real y = fish; Real fish(start = 1);
    equation
      der(fish) = r*u*fish;
    end Pond;"""
    flat, effect = compile_text(text.encode(), Path("Pond.mo")), find_effect("QuadraticLoss")
    assert amounts(text) == []
    made = attach(flat, effect, find_site(flat, "fish", effect), "limit")
    assert "der(fish) + limit.port.inflow = r*u*fish" in {e.text for e in made.equations}
