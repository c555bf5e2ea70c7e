"""Effects between two balances of heat or volume written as bare equations, against scipy."""

import numpy as np
import pytest
from effect_rig import in_steps
from scipy.integrate import solve_ivp

from daest.errors import ModelError
from daest.modelica.compile import compile_model
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import find_site, fits, sites
from daest.systems.simulation.simulate import simulate

ROOMS = """model Rooms
  parameter Real C1(unit = "J/K") = 2e4;
  parameter Real C2(unit = "J/K") = 5e4;
  parameter Real G(unit = "W/K") = 3;
  input Real P(unit = "W");
  output Real T1(unit = "degC", start = 20, fixed = true);
  output Real T2(unit = "K", start = 290, fixed = true);
equation
  C1*der(T1) = P - G*(T1 - 20);
  C2*der(T2) = -G*(T2 - 290);
end Rooms;
"""
TANKS = """model Tanks
  parameter Real A1(unit = "m2") = 2;
  parameter Real A2(unit = "m2") = 3;
  input Real q(unit = "m3/s");
  output Real h1(unit = "m", start = 1, fixed = true);
  output Real h2(unit = "m", start = 0.2, fixed = true);
equation
  A1*der(h1) = q - 0.1*h1;
  A2*der(h2) = -0.3*h2;
end Tanks;
"""

GASES = """model Gases
  parameter Real V1(unit = "m3") = 2e-3;
  parameter Real V2(unit = "m3") = 5e-3;
  parameter Real RT(unit = "J/kg") = 84091;
  parameter Real C(unit = "kg/(s.Pa)") = 1e-8;
  input Real p0(unit = "Pa");
  output Real p1(unit = "Pa", start = 1e5, fixed = true);
  output Real p2(unit = "Pa", start = 3e5, fixed = true);
  Real q1(unit = "kg/s");
equation
  q1 = C*(p0 - p1);
  V1*der(p1) = RT*q1;
  V2*der(p2) = RT*C*(p0 - p2);
end Gases;
"""
LINE = find_effect("Hydraulic.LaminarLine")
OF_MASS = GASES.replace("V2*der(p2) = RT*C*(p0 - p2)", "V2/RT*der(p2) = C*(p0 - p2)")
OF_VOLUME = GASES.replace('  Real q1(unit = "kg/s");\n', "").replace("  q1 = C*(p0 - p1);\n", "")
OF_VOLUME = OF_VOLUME.replace("V1*der(p1) = RT*q1", "der(p1) = RT*C*(p0 - p1)/V1")


def rooms(_, T):
    flow = 4.0 * (T[0] + 273.15 - T[1])
    return [(500 - 3 * (T[0] - 20) - flow) / 2e4, (-3 * (T[1] - 290) + flow) / 5e4]


def tanks(_, h):
    over = h[0] - 0.5
    flow = 0.7 * (over + np.sqrt(over**2 + 0.01**2)) / 2
    return [(0.5 - 0.1 * h[0] - flow) / 2, (-0.3 * h[1] + flow) / 3]


def cascade(_, h):
    flow = 0.2 * np.sqrt((h[0] - 0.1 + np.hypot(h[0] - 0.1, 0.01)) / 2)
    return [(0.5 - 0.1 * h[0] - flow) / 2, (-0.3 * h[1] + flow) / 3]


def gases(_, p):
    leak = 3e-9 * (p[0] - p[1])
    flows = 1e-8 * (4e5 - p) + np.array([-leak, leak])
    return 84091 * flows / np.array([2e-3, 5e-3])


CASES = {
    "Rooms": (ROOMS, "Thermal.Conduction", {"G": 4.0}, 500.0, 2000.0, rooms, [20.0, 290.0]),
    "Tanks": (TANKS, "Hydraulic.Weir", {"k": 0.7, "p_max": 0.5, "p_s": 0.01}, 0.5, 5.0, tanks, [1.0, 0.2]),
    "Cascade": (
        TANKS.replace("Tanks", "Cascade"),
        "Hydraulic.Downpipe",
        {"k": 0.2, "p_0": 0.1, "p_s": 0.01},
        0.5,
        5.0,
        cascade,
        [1.0, 0.2],
    ),
    "Gases": (OF_MASS, "Hydraulic.LaminarLine", {"G": 3e-9}, 4e5, 3.0, gases, [1e5, 3e5]),
    "Volumes": (
        OF_VOLUME.replace("Gases", "Volumes"),
        "Hydraulic.LaminarLine",
        {"G": 3e-9 * 84091},
        4e5,
        3.0,
        gases,
        [1e5, 3e5],
    ),
}


@pytest.mark.parametrize(
    "name",
    [*(pytest.param(n, marks=pytest.mark.slow) for n in ("Rooms", "Tanks")), "Cascade", "Gases", "Volumes"],
)
def test_flow_leaves_one_balance_and_enters_the_other(tmp_path, name):
    text, class_name, values, u, end, rate, start = CASES[name]
    path = tmp_path / f"{name}.mo"
    path.write_text(text)
    flat, effect = compile_model(path), find_effect(class_name)
    (site,) = [s for s in sites(flat) if s.kind == "exchange"]
    assert fits(effect, site)
    expected = solve_ivp(rate, (0.0, end), start, method="LSODA", rtol=1e-9, atol=1e-12).y[:, -1]
    attached = attach(flat, effect, site, values=values)
    made = extend_model(path, None, effect, find_site(flat, site.aliases[0], effect), values=values)
    drive = (np.linspace(0.0, end, 41), np.full((41, 1), u))
    for model in (attached, made.flat):
        np.testing.assert_allclose(simulate(model, drive).outputs[-1], expected, rtol=1e-5)
    with pytest.raises(ModelError, match="effect-present"):
        attach(attached, effect, site)
    again = tmp_path / "again.mo"
    again.write_text(made.text)
    opened = compile_model(again, made.class_name)
    (there,) = [s for s in sites(opened) if s.kind == "exchange"]
    second = extend_model(again, made.class_name, effect, there, "second", values)
    assert second.text.count("Daest.Terms.") == 2


@pytest.mark.parametrize(("text", "unit"), [(OF_MASS, "kg/(s.Pa)"), (OF_VOLUME, "m3/s"), (GASES, None)])
def test_gases_that_are_balanced_alike_exchange_what_is_balanced(tmp_path, text, unit):
    path = tmp_path / "Gases.mo"
    path.write_text(text)
    flat = compile_model(path)
    found = [units_at(flat, LINE, site) for site in sites(flat) if site.kind == "exchange"]
    assert [units["G"] for units in found] == ([unit] if unit else [])


@pytest.mark.parametrize("unit", [pytest.param("K", marks=pytest.mark.slow), "degC"])
def test_heat_flows_to_surroundings_whose_temperature_is_an_input(tmp_path, unit):
    zero = 273.15 if unit == "degC" else 0.0
    path = tmp_path / "Oven.mo"
    path.write_text(
        f"""model Oven
  parameter Real C(unit = "J/K") = 4000;
  parameter Real G(unit = "W/K") = 0.8;
  input Real P(unit = "W");
  input Real T_out(unit = "{unit}");
  output Real T(unit = "{unit}", start = {293.15 - zero}, fixed = true);
equation
  C*der(T) = P - G*(T - T_out);
end Oven;
"""
    )
    flat, effect = compile_model(path), find_effect("Thermal.Radiation")
    (site,) = [s for s in sites(flat) if s.kind == "exchange"]
    assert site.aliases == ("T, T_out",)

    def rate(_, T):
        sun = 0.03 * 5.670374419e-8 * (T[0] ** 4 - 285.0**4)
        return [(700.0 - 0.8 * (T[0] - 285.0) - sun) / 4000.0]

    expected = solve_ivp(rate, (0.0, 4000.0), [293.15], rtol=1e-9, atol=1e-9).y[0, -1] - zero
    drive = (np.linspace(0.0, 4000.0, 41), np.tile([700.0, 285.0 - zero], (41, 1)))
    attached = attach(flat, effect, site, values={"Gr": 0.03})
    made = extend_model(path, None, effect, find_site(flat, "T, T_out", effect), values={"Gr": 0.03})
    for model in (attached, made.flat):
        np.testing.assert_allclose(simulate(model, drive).outputs[-1], expected, rtol=1e-6)
    with pytest.raises(ModelError, match="effect-present"):
        attach(attached, effect, site)


def test_surroundings_that_one_body_feels_are_a_place_beside_every_body(tmp_path):
    """A draught reaches the air of a room whose equations know the ambient through the wall alone."""
    path = tmp_path / "Walled.mo"
    path.write_text(
        """model Walled
  parameter Real C(unit = "J/K") = 4000;
  parameter Real Cw(unit = "J/K") = 20000;
  parameter Real G(unit = "W/K") = 0.8;
  input Real P(unit = "W");
  input Real T_out(unit = "degC");
  input Real T_wanted(unit = "degC");
  output Real T(unit = "degC", start = 20, fixed = true);
  output Real error(unit = "K") = T_wanted - T;
  Real Tw(unit = "degC", start = 15, fixed = true);
equation
  C*der(T) = P - G*(T - Tw);
  Cw*der(Tw) = G*(T - Tw) - G*(Tw - T_out);
end Walled;
"""
    )
    flat, effect = compile_model(path), find_effect("Thermal.Conduction")
    assert {s.aliases[0] for s in sites(flat) if s.kind == "exchange"} == {"T, Tw", "T, T_out", "Tw, T_out"}

    def rate(_, T):
        wall = 0.8 * (T[0] - T[1])
        return [(30 - wall - 0.5 * (T[0] - 5)) / 4000, (wall - 0.8 * (T[1] - 5)) / 20000]

    expected = solve_ivp(rate, (0.0, 9000.0), [20.0, 15.0], rtol=1e-9, atol=1e-12).y[0, -1]
    drive = (np.linspace(0.0, 9000.0, 41), np.tile([30.0, 5.0, 21.0], (41, 1)))
    site = find_site(flat, "T, T_out", effect)
    made = extend_model(path, None, effect, site, values={"G": 0.5})
    for model in (attach(flat, effect, site, values={"G": 0.5}), made.flat):
        at = model.output_names.index("T")
        np.testing.assert_allclose(simulate(model, drive).outputs[-1, at], expected, rtol=1e-6)


def test_places_of_an_output_are_those_of_the_variable_behind_it_once_a_sensor_bends_it(tmp_path):
    """What a sensor shows is no level any more: an outlet of the lower tank goes by the level itself."""
    steps = [
        ("Signals.Saturation", "h2", {"limit": 0.3}),
        ("Hydraulic.FreeOutlet", "1:h2", {"k": 0.2}),
        ("Hydraulic.Weir", "0:h1, 1:h2", {"k": 0.7, "p_max": 0.5}),
    ]
    path = tmp_path / "Tanks.mo"
    path.write_text(TANKS)
    expected, made = in_steps(tmp_path, path, "Tanks", steps)
    drive = (np.linspace(0.0, 5.0, 41), np.full((41, 1), 0.5))
    np.testing.assert_allclose(
        simulate(made.flat, drive).outputs[-1], simulate(expected, drive).outputs[-1], rtol=1e-5
    )
    with pytest.raises(ModelError, match="fits at"):
        find_site(made.flat, "1:h2", find_effect("Signals.Drift"))
