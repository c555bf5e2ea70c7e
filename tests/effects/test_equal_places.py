"""Laws that sit in all equal parts of a model: the places, their equations and the Modelica text."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from effect_rig import characteristic

from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.sites import find_site, fits, sites

PIPE = """model Pipe "water through a pipe in parts"
  parameter Integer n = 4;
  parameter Real C(unit = "J/K", min = 0) = 9000 annotation(__Daest(estimate = true));
  input Real q(unit = "W/K", start = 200);
  input Real T_in(unit = "degC");
  output Real y(unit = "degC") = T[n];
  Real T[n](each unit = "degC", each start = 40);
equation
  C*der(T[1]) = q*(T_in - T[1]);
  for i in 2:n loop
    C*der(T[i]) = q*(T[i - 1] - T[i]);
  end for;
end Pipe;
"""
VECTORS = PIPE.replace(
    """  C*der(T[1]) = q*(T_in - T[1]);
  for i in 2:n loop
    C*der(T[i]) = q*(T[i - 1] - T[i]);
  end for;
""",
    "  C*der(T) = q*(cat(1, {T_in}, T[1:n - 1]) - T);\n",
)
PLATE = """package Plate
  connector Port Real T(unit = "K"); flow Real Q(unit = "W"); end Port;
  model Mass Port port; parameter Real C(unit = "J/K") = 400; equation C*der(port.T) = port.Q; end Mass;
  model Wall Port a; Port b; parameter Real G(unit = "W/K") = 1.5;
  equation a.Q = G*(a.T - b.T); a.Q + b.Q = 0; end Wall;
  model Bath Port port; input Real T(unit = "K"); equation port.T = T; end Bath;
  model Cells "on a plate whose temperature is known"
    input Real u(unit = "K", start = 295);
    output Real y(unit = "K") = cell[2].port.T;
    Mass cell[3]; Wall foot[3]; Wall gap[2]; Bath plate(T = u);
    Mass end1; Mass end2; Mass other3(C = 100);
    Wall joint1; Wall joint2; Wall joint3;
  equation
    for k in 1:3 loop
      connect(cell[k].port, foot[k].a);
      connect(foot[k].b, plate.port);
    end for;
    for k in 1:2 loop
      connect(cell[k].port, gap[k].a);
      connect(gap[k].b, cell[k + 1].port);
    end for;
    connect(end1.port, joint1.a); connect(joint1.b, cell[1].port);
    connect(end2.port, joint2.a); connect(joint2.b, cell[3].port);
    connect(other3.port, joint3.a); connect(joint3.b, cell[3].port);
  end Cells;
end Plate;
"""
TRAIN = """package Train
  connector Hook Real s(unit = "m"); flow Real f(unit = "N"); end Hook;
  model Wagon Hook a; Hook b; Real v(unit = "m/s"); parameter Real m(unit = "kg") = 4;
  equation a.s = b.s; v = der(a.s); m*der(v) = a.f + b.f; end Wagon;
  model Coupler Hook a; Hook b; parameter Real c(unit = "N/m") = 300;
  equation b.f = c*(b.s - a.s); a.f + b.f = 0; end Coupler;
  model Pull Hook p; input Real F(unit = "N"); equation p.f = -F; end Pull;
  model Train "three wagons behind a rope"
    input Real F(unit = "N"); output Real y(unit = "m/s") = wagon[3].v;
    Wagon wagon[3]; Coupler coupler[2]; Pull rope(F = F);
  equation
    connect(rope.p, wagon[1].a);
    for i in 1:2 loop
      connect(wagon[i].b, coupler[i].a);
      connect(coupler[i].b, wagon[i + 1].a);
    end for;
  end Train;
end Train;
"""


CHAIN = """model Chain "masses between springs, each behind a resistance of its drive"
  parameter Real c(unit = "N/m", min = 0) = 50 annotation(__Daest(estimate = true));
  parameter Real k(unit = "N/A", min = 0) = 2;
  input Real u(unit = "V");
  output Real y(unit = "m") = s[3];
  Real s[3](each unit = "m"), v[3](each unit = "m/s"), F[2](each unit = "N"), I[3](each unit = "A");
equation
  for i in 1:3 loop
    der(s[i]) = v[i];
    u = 3*I[i] + k*v[i];
  end for;
  for i in 1:2 loop
    F[i] = c*(s[i] - s[i + 1]);
  end for;
  2*der(v[1]) = k*I[1] - F[1];
  2*der(v[2]) = k*I[2] + F[1] - F[2];
  2*der(v[3]) = k*I[3] + F[2];
end Chain;
"""

CELLS = """model Cells "cells in series, connected in loops"
  parameter Integer n = 3;
  parameter Real R(unit = "Ohm", min = 0) = 0.1 annotation(__Daest(estimate = true));
  Daest.Blocks.Interfaces.RealInput i(unit = "A");
  Daest.Blocks.Interfaces.RealOutput U[n](each unit = "V");
  Daest.Electrical.Analog.Sources.SignalCurrent source;
  Daest.Electrical.Analog.Basic.Ground ground;
  Daest.Electrical.Analog.Basic.Resistor loss[n](each R = R);
  Daest.Electrical.Analog.Basic.Capacitor cell[n](each C = 50, v(each start = 1, each fixed = true));
  Daest.Electrical.Analog.Sensors.PotentialSensor at[n];
equation
  connect(source.i, i);
  connect(source.n, loss[1].p);
  connect(source.p, ground.p);
  for k in 1:n loop
    connect(loss[k].n, cell[k].p);
    connect(at[k].p, loss[k].p);
    connect(at[k].phi, U[k]);
  end for;
  for k in 2:n loop
    connect(cell[k - 1].n, loss[k].p);
  end for;
  connect(cell[n].n, ground.p);
end Cells;
"""

BANK = "package Bank\n{}end Bank;\n".format(
    CELLS.replace("connect(at[k].phi, U[k])", "U[k] = at[k].phi").replace(
        "equation\n", "  Real whole = sum(cell[k].v for k in 1:n);\nequation\n"
    )
)  # loops around connect clauses and equations, in a class of a package


def compiled(text: str, name: str):
    return compile_text(text.encode(), Path(f"{name}.mo"), name)


def each(flat) -> dict[str, tuple[str, ...]]:
    return {site.name: tuple(part.name for part in site.parts) for site in sites(flat) if site.parts}


def test_places_of_an_array_are_one_place_besides() -> None:
    found = each(compiled(PIPE, "Pipe"))
    assert found["each T[i]"] == ("0:T[1]", "1:T[2]", "2:T[3]", "3:T[4]")
    assert found["each T[i], T[i+1]"] == ("0:T[1], 1:T[2]", "1:T[2], 2:T[3]", "2:T[3], 3:T[4]")
    assert found["each T[i], T_in"][0] == "0:T[1], T_in"
    assert set(found) == {"each T[i]", "each T[i], T[i+1]", "each T[i], T_in"}


def test_equal_components_are_parts_and_others_are_not() -> None:
    found = each(compiled(PLATE, "Plate.Cells"))
    assert found["each cell[i].port"] == tuple(f"cell[{i}].port" for i in (1, 2, 3))
    assert found["each foot[i]"] == ("foot[1]", "foot[2]", "foot[3]")
    assert found["each end#.port"] == ("end1.port", "end2.port")
    assert found["each joint#"] == ("joint1", "joint2", "joint3")
    assert not any("other#" in name for name in found)


def test_nodes_of_a_chain_are_one_place_whatever_connector_they_are_called_by() -> None:
    """The node in the middle is called by its other end: a law had been put at the first and the last."""
    found = each(compiled(TRAIN, "Train.Train"))
    assert found["each wagon[i].a"] == ("wagon[1].a", "wagon[2].b", "wagon[3].a")
    assert found["each coupler[i]"] == ("coupler[1]", "coupler[2]")


def test_effects_with_states_stay_in_one_place() -> None:
    flat = compiled(PIPE, "Pipe")
    place = next(site for site in sites(flat) if site.name == "each T[i]")
    assert fits(find_effect("Thermal.HeatLoss"), place)
    assert not fits(find_effect("Thermal.ExtraHeatCapacity"), place)
    assert place.told == "4 times a thermal equation"


LOSS, SPRING = {"G": 5.0, "T_0": 280.0}, {"c3": 7.0}


@pytest.mark.parametrize(
    ("text", "class_name", "place", "values"),
    [
        (PIPE, "Thermal.HeatLoss", "each T[i]", LOSS),
        (PIPE, "Thermal.HeatLoss", "T[3]", LOSS),
        (VECTORS, "Thermal.HeatLoss", "T[i]", LOSS),
        (VECTORS, "Thermal.HeatLoss", "T[3]", LOSS),
        (CHAIN, "Translational.HardeningSpring", "each F[i]", SPRING),
        (CHAIN, "Translational.ConstantLoad", "each v[i]", {}),
        (CHAIN, "Electrical.BrushVoltageDrop", "each I[i]", {}),
        (CELLS, "Electrical.BrushVoltageDrop", "cell[2].p", {}),
        (CELLS, "Electrical.BrushVoltageDrop", "cell[3].n", {}),
        (CELLS, "Electrical.VoltageRelaxation", "loss[3].p", {}),
        (CELLS, "Signals.Gain", "U[2]", {}),
        (BANK, "Electrical.BrushVoltageDrop", "cell[2].p", {}),
    ],
)
def test_text_compiles_to_the_equations_of_attach(tmp_path, text, class_name, place, values) -> None:
    file = tmp_path / "Machine.mo"
    file.write_text(text)
    flat, effect = compile_model(file), find_effect(class_name)
    site = find_site(flat, place, effect)
    merged = attach(flat, effect, site, values=values)
    made = extend_model(file, None, effect, site, values=values)
    estimated = [p.name for p in made.flat.parameters if "_end." not in p.name]
    assert [p.name for p in merged.parameters] == estimated
    laws = [
        Counter(e.text for e in one.equations if e.kind == "component" and e.origin)
        for one in (made.flat, merged)
    ]
    own = {text: n for text, n in laws[0].items() if "_term" not in text and "_end" not in text}
    assert own == laws[1]
    assert characteristic(made.flat) == pytest.approx(characteristic(merged), rel=1e-6)


def test_own_connectors_of_arrays_are_joined(tmp_path) -> None:
    file = tmp_path / "Plate.mo"
    file.write_text(PLATE)
    flat, effect = compile_model(file, "Plate.Cells"), find_effect("Thermal.HeatLoss")
    made = extend_model(file, "Plate.Cells", effect, find_site(flat, "each cell[i].port", effect))
    assert "connect(heatLoss_joint2.own, cell[3].port);" in made.added
    assert made.added.count("\n  model ") == 1 and made.added.count("HeatLoss_joint heatLoss_joint") == 3
    assert characteristic(made.flat) == pytest.approx(
        characteristic(attach(flat, effect, find_site(flat, "each cell[i].port", effect))), rel=1e-6
    )


@pytest.mark.parametrize("inputs", [{"u": "T_room"}, {}])
def test_a_recorded_signal_is_one_input_of_all_parts(tmp_path, inputs) -> None:
    file = tmp_path / "Plate.mo"
    file.write_text(PLATE)
    flat, effect = compile_model(file, "Plate.Cells"), find_effect("Thermal.MeasuredSurroundings")
    site = find_site(flat, "each cell[i].port", effect)
    made = extend_model(file, "Plate.Cells", effect, site, inputs=inputs)
    (new,) = set(made.flat.input_names) - set(flat.input_names)
    assert new == inputs.get("u", "measuredSurroundings_u")
    merged = attach(flat, effect, site, inputs=inputs)
    assert merged.input_names == made.flat.input_names
    assert characteristic(made.flat) == pytest.approx(characteristic(merged), rel=1e-6)


def test_a_law_is_there_already_where_any_part_has_it() -> None:
    flat, effect = compiled(PIPE, "Pipe"), find_effect("Thermal.HeatLoss")
    grown = attach(flat, effect, find_site(flat, "T[2]", effect))
    with pytest.raises(Exception, match="contains HeatLoss at `each"):
        attach(grown, effect, find_site(grown, "each T[i]", effect))


def test_rate_limit_keeps_its_follower_beside_a_store_at_a_held_temperature() -> None:
    """The store asks for the rate of the temperature that the limit follows."""
    from daest.systems.reduction.reduce import reduce_index

    flat = compiled(PLATE, "Plate.Cells")
    limit, store = find_effect("Signals.RateLimit"), find_effect("Thermal.ExtraHeatCapacity")
    one = attach(flat, limit, find_site(flat, "u", limit), values={"share": 0.0})
    both = reduce_index(attach(one, store, find_site(one, "plate.port", store), values={"G": 0.0}))
    assert "rateLimit.x" in both.state_names
    assert not [f for f in both.rhs.find_functions() if "loop" in f.name()]
    assert np.all(np.isfinite(both.flat.theta_values))
