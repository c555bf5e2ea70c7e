"""Components of the user's own connectors: a speed as potential, or units of another scale."""

import numpy as np
import pytest
from effect_rig import characteristic
from scipy.integrate import solve_ivp

from daest.errors import ModelError
from daest.modelica.compile import compile_model
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import find_site, sites
from daest.systems.simulation.simulate import simulate

MODEL = """
package P
  connector Oil
    Real p(unit = "bar");
    flow Real q(unit = "l/min");
  end Oil;
  connector Shaft
    Real w(unit = "rad/s");
    flow Real tau(unit = "N.m");
  end Shaft;
  model Hose
    Oil port;
    parameter Real C(unit = "l/bar") = 0.004;
  equation
    C*der(port.p) = port.q/60;
  end Hose;
  model Motor
    Oil port;
    Shaft shaft;
    parameter Real D(unit = "l.min-1.s/rad") = 0.26;
  equation
    port.q = D*shaft.w;
    shaft.tau = -0.44*port.p;
  end Motor;
  model Drum
    Shaft shaft;
    parameter Real J(unit = "kg.m2") = 0.7;
    Real w(unit = "rad/s");
  equation
    w = shaft.w;
    J*der(w) = shaft.tau - 0.5*w;
  end Drum;
  model Pump
    Oil port;
    input Real q(unit = "l/min");
  equation
    port.q = -q;
  end Pump;
  model Drive
    input Real q(unit = "l/min");
    output Real n(unit = "rad/s") = drum.w;
    Pump pump;
    Hose hose;
    Motor motor;
    Drum drum;
  equation
    pump.q = q;
    connect(pump.port, hose.port);
    connect(hose.port, motor.port);
    connect(motor.shaft, drum.shaft);
  end Drive;
end P;
"""


LEAK = 3e-12  # m3/(s.Pa)
LEAK_IN_UNITS = LEAK * 6e4 * 1e5  # l/min in a bar
FLOW = 10.0  # l/min


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "P.mo"
    file.write_text(MODEL)
    return file


def settled(flat):
    """Speed of the drum, rad/s, long after the pump began."""
    time = np.arange(0.0, 60.0, 0.1)
    return simulate(flat, (time, np.full((time.size, 1), FLOW))).outputs[-1, 0]


def expected(leak=0.0, load=0.0):
    """FLOW = 0.26 w + leak p, 0.44 p = 0.5 w + load."""
    return (FLOW - leak * load / 0.44) / (0.26 + leak * 0.5 / 0.44)


def test_flow_in_other_units_is_that_of_the_law(path):
    flat, leak = compile_model(path, "P.Drive"), find_effect("Hydraulic.Leak")
    site = find_site(flat, "hose.port", leak)
    assert site.kind == "node"
    assert settled(flat) == pytest.approx(expected(), rel=1e-6)
    attached = attach(flat, leak, site, values={"G": LEAK})
    written = extend_model(path, "P.Drive", leak, site, values={"G": LEAK})
    for model in (attached, written.flat):
        assert settled(model) == pytest.approx(expected(LEAK_IN_UNITS), rel=1e-6)
    assert abs(expected(LEAK_IN_UNITS) / expected() - 1) > 0.05
    places = [one.name for one in sites(flat) if one.kind == "connector" and one.domain == "hydraulic"]
    assert places == ["pump.port", "hose.port", "motor.port"]


def test_body_whose_connector_has_a_speed_is_a_place(path):
    """Besides a leak, so that the load is not alone."""
    flat, load = compile_model(path, "P.Drive"), find_effect("Rotational.ConstantLoad")
    leaking = attach(flat, find_effect("Hydraulic.Leak"), find_site(flat, "hose.port"), values={"G": LEAK})
    (site,) = [one for one in sites(leaking) if one.domain == "rotational"]
    assert site.kind == "equation" and site.name.endswith(":drum.w")
    attached = attach(leaking, load, find_site(leaking, "drum.w", load), values={"tau_0": 2.0})
    assert settled(attached) == pytest.approx(expected(LEAK_IN_UNITS, 2.0), rel=1e-6)
    written = extend_model(path, "P.Drive", load, find_site(flat, "drum.w", load), values={"tau_0": 2.0})
    assert settled(written.flat) == pytest.approx(expected(0.0, 2.0), rel=1e-6)


def test_balance_that_lies_deeper_is_not_reached(path):
    deeper = MODEL.replace("end P;", "  model Plant\n    Drive drive(q = 10);\n  end Plant;\nend P;")
    path.write_text(deeper)
    flat, load = compile_model(path, "P.Plant"), find_effect("Rotational.ConstantLoad")
    with pytest.raises(ModelError, match=r"lies inside of the component `drive\.drum`"):
        extend_model(path, "P.Plant", load, find_site(flat, "drive.drum.w", load))


TANKS = """
package T
  connector Port Real h(unit = "UNIT"); flow Real q(unit = "FLOW"); end Port;
  model Tank
    Port port;
    parameter Real A(unit = "AREA");
  equation
    A*der(port.h) = port.q;
  end Tank;
  model Pump Port port; input Real q(unit = "FLOW"); equation port.q = -q; end Pump;
  model Pipe Port a; Port b; parameter Real k = 1; equation a.q = k*(a.h - b.h); a.q + b.q = 0; end Pipe;
  model Two
    input Real u(unit = "FLOW");
    output Real y(unit = "UNIT") = two.port.h;
    Pump pump(q = u); Tank one(A = SIZE); Tank two(A = SIZE); Pipe pipe(k = LINE);
  equation
    connect(pump.port, one.port); connect(one.port, pipe.a); connect(pipe.b, two.port);
  end Two;
end T;
"""


def test_levels_of_own_connectors_may_be_in_any_unit_of_length(tmp_path):
    effect, found = find_effect("Hydraulic.Leak"), []
    time = np.linspace(0.0, 60.0, 31)
    for unit, flow, area, size, line in (
        ("m", "m3/s", "m2", 0.01, 1e-3),
        ("cm", "cm3/s", "cm2", 100.0, 10.0),
    ):
        file, text = tmp_path / f"{unit}.mo", TANKS
        for name, value in (("UNIT", unit), ("FLOW", flow), ("AREA", area)):
            text = text.replace(name, value)
        file.write_text(text.replace("SIZE", f"{size}").replace("LINE", f"{line}"))
        flat = compile_model(file, "T.Two")
        site = find_site(flat, "two.port", effect)
        assert units_at(flat, effect, site) == {"G": "m3/(s.m)"}
        made = extend_model(file, "T.Two", effect, site, values={"G": 2e-4})
        u = np.full((31, 1), 1e-4 if unit == "m" else 1e2)
        grown = attach(flat, effect, site, values={"G": 2e-4})
        found += [simulate(one, (time, u)).outputs[:, 0] for one in (grown, made.flat)]
    first, written, other, other_written = found
    assert 0.1 < first[-1] < 0.25
    for course, scale in ((written, 1.0), (other, 100.0), (other_written, 100.0)):
        assert course == pytest.approx(scale * first, rel=1e-5)


PRESS = """
package P
  connector Oil Real p(unit = "bar"); flow Real q(unit = "l/min"); end Oil;
  model Pump Oil a; input Real q(unit = "l/min"); equation a.q = -q; end Pump;
  model Ram "A mass behind a port of oil"
    Oil a;
    Real s(unit = "m", start = 0, fixed = true);
    Real v(unit = "m/s", start = 0, fixed = true);
    Real p(unit = "bar", start = 1, fixed = true);
  equation
    der(s) = v;
    300*der(v) = 200*p - 1e5*s - 8000*v;
    1e-4*der(p) = a.q/6e4 - 2e-3*v;
    a.p = p;
  end Ram;
  model Press
    input Real q(unit = "l/min");
    output Real s(unit = "m") = ram.s;
    Pump pump(q = q);
    Ram ram;
  equation
    connect(pump.a, ram.a);
  end Press;
end P;
"""


def test_mass_inside_of_a_component_of_another_domain_is_a_place(tmp_path):
    """Its oil is reached by the connector, and is no place a second time."""
    (tmp_path / "P.mo").write_text(PRESS)
    flat, load = compile_model(tmp_path / "P.mo", "P.Press"), find_effect("Translational.ConstantLoad")
    assert [(one.kind, one.name) for one in sites(flat) if one.domain != "signal"] == [
        ("node", "ram.a"),
        ("equation", "2:ram.v"),
    ]
    site = find_site(flat, "ram.v", load)
    attached = attach(flat, load, site, values={"f_0": 500.0})
    time, u = np.linspace(0.0, 2.0, 21), np.zeros((21, 1))
    s = [simulate(model, (time, u)).outputs[-1, 0] for model in (flat, attached)]
    # The oil is closed in: 500 N move the mass against 1e5 N/m of the spring and 4e3 N/m of the oil.
    assert s[0] - s[1] == pytest.approx(500.0 / 104_000.0, rel=1e-3)


RAMS = PRESS.replace("    Ram ram;\n", "    Ram ram;\n    Ram other;\n").replace(
    "connect(pump.a, ram.a);", "connect(pump.a, ram.a);\n    connect(pump.a, other.a);"
)
PAIR = RAMS.replace("Ram ram;\n    Ram other;", "Ram ram[2];").replace("ram.a", "ram[1].a")
PAIR = PAIR.replace("other.a", "ram[2].a").replace("ram.s", "ram[1].s")

DIVIDED = PAIR.replace(
    "300*der(v) = 200*p - 1e5*s - 8000*v;", "der(v) = (200*p - 1e5*s - 8000*v)/m;"
).replace("    Oil a;\n", '    Oil a;\n    parameter Real m(unit = "kg") = 300;\n')


@pytest.mark.parametrize(
    ("text", "places"),
    [
        (PRESS, ("ram.v",)),
        (DIVIDED, ("ram[2].v",)),
        (RAMS, ("other.v",)),
        (RAMS, ("ram.v", "other.v")),
        (PAIR, ("ram[2].v",)),
        (PAIR, ("each ram[i].v",)),
    ],
)
def test_balances_inside_of_components_are_written_into_their_class(tmp_path, text, places):
    file, effect = tmp_path / "P.mo", find_effect("Translational.ReturnSpring")
    file.write_text(text)
    name, flat = "P.Press", compile_model(file, "P.Press")
    merged = flat
    for place in places:
        site = find_site(merged, place, effect)
        merged = attach(merged, effect, site, values={"c": 3e4})
        made = extend_model(
            file, name, effect, find_site(compile_model(file, name), place, effect), None, {"c": 3e4}
        )
        name = made.class_name
        file.write_text(made.text)
    assert made.text.count("Daest.Terms.Force") == 1
    assert characteristic(made.flat) == pytest.approx(characteristic(merged), rel=1e-6)
    again = extend_model(file, name, effect, find_site(made.flat, "ram.v", effect)) if text is PRESS else made
    assert again.text.count("Daest.Terms.Force") == 1


def test_sizes_where_neither_volumes_nor_masses_flow_are_told_in_what_flows(tmp_path):
    """Of a gas at low pressure, the flow is counted as pressure times volume."""
    text = MODEL.replace('flow Real q(unit = "l/min")', 'flow Real q(unit = "mbar.l/s")')
    file = tmp_path / "P.mo"
    file.write_text(text)
    flat = compile_model(file, "P.Drive")
    site = find_site(flat, "hose.port")
    told = {
        n: units_at(flat, find_effect(f"Hydraulic.{n}"), site)
        for n in ("ConstantFlow", "Leak", "WideningTank")
    }
    assert told["ConstantFlow"]["q_0"] == "mbar.l/s"
    assert told["Leak"]["G"] == "mbar.l/(s.Pa)"
    assert told["WideningTank"]["k"] == ""


CHAMBER = """
package B
  connector Tube
    Real p(unit = "mmHg");
    flow Real q(unit = "ml/s");
  end Tube;
  model Chamber
    Tube a;
    parameter Real C(unit = "ml/mmHg") = 0.9;
    Real p(unit = "mmHg", start = 10, fixed = true);
  equation
    p = a.p;
    C*der(p) = a.q;
  end Chamber;
  model Needle
    Tube a;
    parameter Real R(unit = "mmHg.s/ml") = 0.6;
  equation
    a.p = R*a.q;
  end Needle;
  model Bag
    output Real y(unit = "mmHg") = chamber.p;
    Chamber chamber;
    Needle needle;
  equation
    connect(chamber.a, needle.a);
  end Bag;
end B;
"""


def test_effect_in_series_between_connectors_in_other_units(tmp_path):
    """The drop of a hole is told in SI, whatever the connectors are in."""
    file = tmp_path / "B.mo"
    file.write_text(CHAMBER)
    flat, orifice = compile_model(file, "B.Bag"), find_effect("Hydraulic.Orifice")
    site = find_site(flat, "needle.a", orifice)
    k, mmHg, ml = 0.16, 133.322387415, 1e-6

    def rate(_, p):
        return -(-0.6 + np.sqrt(0.36 + 4.0 * k * p)) / (2.0 * k) / 0.9

    time = np.linspace(0.0, 4.0, 41)
    expected = solve_ivp(rate, (0.0, 4.0), [10.0], t_eval=time, rtol=1e-9, atol=1e-9).y[0]
    values = {"k": k * mmHg / ml**2, "q_s": 1e-10}
    attached = attach(flat, orifice, site, values=values)
    made = extend_model(file, "B.Bag", orifice, site, values=values)
    for model in (attached, made.flat):
        outputs = simulate(model, (time, np.zeros((41, 0)))).outputs[:, 0]
        np.testing.assert_allclose(outputs, expected, rtol=1e-4)
    # Where nothing changes the drop is that of the text, too.
    again = tmp_path / "again.mo"
    again.write_text(made.text)
    second = find_site(made.flat, "needle.a", orifice)
    twice = extend_model(again, made.class_name, orifice, second, "second", values=values)
    outputs = simulate(twice.flat, (time, np.zeros((41, 0)))).outputs[:, 0]
    assert np.all(outputs[1:] > expected[1:])
