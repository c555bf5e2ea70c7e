"""Extended models as Modelica text: they compile to the equations of `attach`, and each refusal has its
message."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from effect_rig import MODELS, RIG, characteristic, examples, finite_poles, first_places, in_steps, label, rig

from daest.errors import ModelError
from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import CurveText, extend_by_curve, extend_model
from daest.modelica.places.sites import find_site, sites
from daest.systems.simulation.simulate import simulate

# Effects on amounts sit in a bare equation of the rig, whose text is opened: see test_amounts.py.
WRITABLE = [p for p in first_places() if p[1].kind not in ("parameter", "equation")]
EXAMPLES = examples(WRITABLE)
OTHERS = [p for p in WRITABLE if p not in EXAMPLES]


def extended(class_name: str, place: str, path: Path = RIG, model: str | None = None, **options):
    flat = rig() if path == RIG else compile_model(path, model)
    effect = find_effect(class_name)
    return extend_model(path, model, effect, find_site(flat, place, effect), **options)


@pytest.mark.parametrize(
    ("effect", "site"),
    [*EXAMPLES, *(pytest.param(*p, marks=pytest.mark.slow) for p in OTHERS)],
    ids=label,
)
def test_text_compiles_to_the_equations_of_attach(effect, site) -> None:
    values = {p.name: p.start for p in effect.sizes[:1]}
    merged = attach(rig(), effect, site, values=values)
    made = extend_model(RIG, None, effect, site, values=values).flat
    assert {x.name for x in made.unknowns} == {x.name for x in merged.unknowns}
    assert made.parameters[-1].name in {p.name for p in merged.parameters}
    for kind in ("parameters", "derived_parameters", "inputs", "outputs"):
        assert [(p.name, p.unit) for p in getattr(made, kind)] == [
            (p.name, p.unit) for p in getattr(merged, kind)
        ]
    assert {p.name: p.value for p in made.parameters} == {p.name: p.value for p in merged.parameters}
    laws = [Counter(e.text for e in flat.equations if e.kind == "component") for flat in (made, merged)]
    assert laws[0] == laws[1]
    assert characteristic(made) == pytest.approx(characteristic(merged), rel=1e-6)


ARRAYS = """model Ladder
  model Stage
    parameter Real C[2](each unit = "F", each min = 0) = {1e-3, 2e-3};
    input Real i(unit = "A");
    Real v(unit = "V", start = 0);
  equation
    (C[1] + C[2])*der(v) = i;
  end Stage;
  parameter Real R[2](each unit = "Ohm", each min = 0) = {10, 20};
  input Real u(unit = "V");
  output Real y(unit = "V");
  Stage stage[2];
equation
  stage[1].i = (u - stage[1].v)/R[1] - (stage[1].v - stage[2].v)/R[2];
  stage[2].i = (stage[1].v - stage[2].v)/R[2];
  y = stage[2].v;
end Ladder;
"""


def test_new_values_of_elements_are_written_as_whole_arrays(tmp_path: Path) -> None:
    file = tmp_path / "Ladder.mo"
    file.write_text(ARRAYS)
    new = {"R[2]": 25.0, "stage[1].C[2]": 3e-3}
    made = extended("Signals.Gain", "u", file, "Ladder", values={"g": 0.1}, parameters=new)
    assert "R = {10, 25}" in made.added and "C = {{0.001, 0.003}, {0.001, 0.002}}" in made.added
    values = {p.name: p.value for p in made.flat.parameters}
    assert values["R[1]"] == 10.0 and values["R[2]"] == 25.0
    assert values["stage[1].C[2]"] == 3e-3 and values["stage[2].C[2]"] == 2e-3


def test_text_is_readable_modelica() -> None:
    made = extended("Rotational.CoulombFriction", "rotor", values={"tau_c": 0.006})
    assert made.added == (
        'model Rig_CoulombFriction "Rig with CoulombFriction at rotor.flange_a"\n'
        "  extends Rig;\n"
        "  Daest.Effects.Rotational.CoulombFriction coulombFriction(tau_c = 0.006)\n"
        '    "Dry friction: a torque of constant size against the motion";\n'
        "equation\n"
        "  connect(coulombFriction.flange, rotor.flange_a);\n"
        "end Rig_CoulombFriction;\n"
    )
    assert made.text == RIG.read_text().rstrip() + "\n\n" + made.added
    series = extended("BrushVoltageDrop", "coil").added
    assert "  extends Rig(break connect(resistor.n, coil.p));\n" in series
    assert all(len(line) <= 110 for line in made.added.splitlines())


def test_annotations_and_units_stay() -> None:
    made = extended("Signals.Saturation", "way").flat
    nominal = rig()
    assert made.outputs[1].noise_std == nominal.outputs[1].noise_std == 1e-3
    assert [(y.name, y.unit, y.description) for y in made.outputs] == [
        (y.name, y.unit, y.description) for y in nominal.outputs
    ]
    assert [p for p in made.parameters if p.name == "J"] == [p for p in nominal.parameters if p.name == "J"]
    assert next(p for p in made.parameters if p.name == "saturation.share").estimate


def test_values_of_the_model_arrays_and_inputs() -> None:
    made = extended(
        "Rotational.LearnedFriction", "rotor", values={"y[2]": 0.5}, parameters={"J": 0.7, "shaft.d": 0.2}
    )
    assert "extends Rig(J = 0.7, shaft(d = 0.2));" in made.added
    assert "y = {0, 0.5, 0, 0, 0, 0, 0, 0, 0}" in made.added
    values = {p.name: p.value for p in made.flat.parameters}
    assert (values["J"], values["shaft.d"], values["learnedFriction.y[2]"]) == (0.7, 0.2, 0.5)
    sun = extended("MeasuredHeatGain", "room", inputs={"u": "G_solar"})
    assert 'RealInput G_solar(unit = "W/m2", start = 0)' in sun.added
    assert sun.flat.inputs[-1].name == "G_solar"
    signal, unit = {"u": "T_next"}, {"u": "degC"}
    beside = extended("MeasuredSurroundings", "room", inputs=signal, input_units=unit)
    assert 'RealInput T_next(unit = "degC", start = 0)' in beside.added
    assert "measuredSurroundings.u = T_next + 273.15;" in beside.added


@pytest.mark.slow
def test_chain_of_extensions(tmp_path) -> None:
    """Three rounds; the third breaks a connection of the first class."""
    path, expected = RIG, rig()
    for class_name, place in [
        ("Rotational.CoulombFriction", "rotor"),
        ("BrushVoltageDrop", "resistor.n"),
        ("Electrical.Inductance", "coil.n"),
    ]:
        effect = find_effect(class_name)
        expected = attach(expected, effect, find_site(expected, place, effect))
        made = extended(class_name, place, path)
        path = tmp_path / f"{made.class_name}.mo"
        path.write_text(made.text)
    flat = compile_model(path)
    assert flat.name == "Rig_CoulombFriction_BrushVoltageDrop_Inductance"
    assert {x.name for x in flat.unknowns} == {x.name for x in expected.unknowns}
    assert characteristic(flat) == pytest.approx(characteristic(expected), rel=1e-6)


def test_the_file_may_lie_beside_the_original(tmp_path) -> None:
    (tmp_path / "Rig.mo").write_bytes(RIG.read_bytes())
    made = extended("Rotational.Unbalance", "load", tmp_path / "Rig.mo", target=tmp_path / "Other.mo")
    (tmp_path / "Other.mo").write_text(made.text)
    assert compile_model(tmp_path / "Other.mo").name == "Rig_Unbalance"
    assert compile_model(tmp_path / "Rig.mo").n == rig().n


def test_model_inside_a_package() -> None:
    made = extended("Rotational.CoulombFriction", "load.end_a", MODELS / "Own.mo", "Machine")
    assert "model Machine_CoulombFriction" in made.added and "extends Own.Machine;" in made.added
    assert made.class_name == "Machine_CoulombFriction"
    own = extended("Rotational.ExtraCompliance", "train.out", MODELS / "Own.mo", "Machine")
    assert "break connect(train.out, load.end_a)" in own.added


def test_model_of_a_library_folder(tmp_path) -> None:
    folder = tmp_path / "Lib"
    folder.mkdir()
    (folder / "package.mo").write_text('package Lib "Library"\nend Lib;\n')
    (folder / "Rig.mo").write_text("within Lib;\n" + RIG.read_text())
    made = extended("Rotational.CoulombFriction", "rotor", folder / "Rig.mo")
    assert "extends Lib.Rig;" in made.text and made.text == made.added
    with pytest.raises(ModelError) as caught:
        extended("BrushVoltageDrop", "coil", folder / "Rig.mo")
    assert caught.value.code == "model-break"


def test_names_that_are_taken() -> None:
    again = RIG.read_text() + "\nmodel Rig_Unbalance extends Rig; end Rig_Unbalance;\n"
    flat = compile_text(again.encode(), Path("Rig.mo"), "Rig")
    assert flat.n == rig().n
    with pytest.raises(ModelError) as caught:
        extended("Rotational.Unbalance", "load", new_name="Rig")
    assert caught.value.code == "effect-name" and "`Rig` is taken" in str(caught.value)
    with pytest.raises(ModelError) as caught:
        extended("Rotational.Unbalance", "load", new_name="no name")
    assert caught.value.code == "effect-name"
    with pytest.raises(ModelError) as caught:
        extended("Rotational.Unbalance", "load", name="shaft")
    assert caught.value.code == "effect-name" and "unbalance" in str(caught.value)


def test_a_free_name_is_found(tmp_path) -> None:
    file = tmp_path / "Rig.mo"
    text = RIG.read_text().replace('"Rotor"', '"Rotor";\n  parameter Real unbalance = 1 "Taken"')
    file.write_text(text + "\nmodel Rig_Unbalance extends Rig; end Rig_Unbalance;\n")
    effect = find_effect("Unbalance")
    site = find_site(compile_model(file, "Rig"), "load", effect)
    made = extend_model(file, "Rig", effect, site)
    assert (made.class_name, made.component) == ("Rig_Unbalance2", "unbalance2")


# --- bare equations ---------------------------------------------------------------------------------

BARE = """\
model Cart "Cart and tank heater, as equations"
  parameter Real m(unit = "kg") = 2; parameter Real C(unit = "J/K") = 50; parameter Real n = 1;
  input Real F(unit = "N"); input Real P(unit = "W") "Heater";
  Real s(unit = "m", start = 0.1), v(unit = "m/s"), w[2](each unit = "rad/s");
  Real T(unit = "degC", start = 20), x(unit = "m/s"), q(unit = "m/s");
  output Real y(unit = "m"), z(unit = "degC") = T + 0*v;
equation
  der(s) = v "definition";
  F - n*v - m*der(v) = if s > 7 then 0 else 3*s "momentum" annotation(Icon());
  0 = P - 0.5*(T - 20) - C*der(T);
  for i in 1:1:2 loop
    0.3*der(w[i]) = F - w[i];
  end for;
  if n > 0.5 then
    der(x) = F - x;
  else
    x = 1;
  end if;
  (1 + m)*der(q) = sum({F, -q});
  y = max(s, -9) + 0*F;
end Cart;
model Other "Extends a class with bare equations" extends Cart(m = 3); end Other;
"""


@pytest.fixture(scope="module")
def bare(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("bare") / "Cart.mo"
    file.write_text(BARE)
    return file


@pytest.mark.parametrize(
    ("class_name", "place", "model", "says"),
    [
        (
            "Translational.CoulombFriction",
            "v",
            "Cart",
            '= (if s > 7 then 0 else 3*s) + v_term.total "momentum"',
        ),
        ("Translational.QuadraticDrag", "v", "Other", '3*s) + v_term.total "momentum" annotation(Icon());'),
        ("Thermal.ConstantHeatGain", "T", "Cart", "0 + T_term.total = P - 0.5*(T - 20) - C*der(T);"),
        ("Translational.CoulombFriction", "q", "Cart", "(1 + m)*der(q) + q_term.total = sum({F, -q});"),
        ("Signals.Saturation", "F", "Cart", "0.3*der(w[i]) = F_used - w[i];"),
        ("Signals.Lag", "y", "Cart", 'output Real y(unit = "m") = max(s, -9) + 0*F, z('),
        ("Signals.Offset", "z", "Other", "extends Other(z = offset.y);"),
    ],
)
def test_bare_equations_are_opened(bare, class_name, place, model, says) -> None:
    """The text is that of the same equations as `attach` gives, and a copy: the user's stays."""
    flat = compile_model(bare, model)
    effect = find_effect(class_name)
    site = find_site(flat, place, effect)
    values = {p.name: 0.7 * (p.start or 1.0) for p in effect.sizes[:1]}
    made = extend_model(bare, model, effect, site, values=values)
    assert says in made.text
    assert bare.read_text() == BARE
    merged = attach(flat, effect, site, values=values)
    assert {p.name: p.value for p in made.flat.parameters} == {p.name: p.value for p in merged.parameters}
    assert finite_poles(made.flat) == pytest.approx(finite_poles(merged), rel=1e-6, abs=1e-9)
    assert characteristic(made.flat) == pytest.approx(characteristic(merged), rel=1e-6)


WHEEL = """\
model Wheel "Outputs that the equations use otherwise than y = ..."
  import Daest.Units.SI;
  parameter Real m(unit = "kg") = 2;
  input Real u(unit = "N");
  output SI.Velocity v(start = 0.1, fixed = true, nominal = 2) "Speed" annotation(__Daest(std = 0.01));
  output Real a(unit = "m/s2");
  output Real b(unit = "m/s"), c(unit = "N");
  output Real g(unit = "N") = 2*u "Twice";
  Real p = v*u "power"; Real h(start = 0, fixed = true);
equation
  m*a = u - 3*v;
  a = der(v);
  b + v = 0; 2*c = u; der(h) = g;
  annotation(Documentation(info = "v is the speed"));
end Wheel;
"""


@pytest.mark.parametrize(
    ("place", "says"),
    [
        (
            "v",
            (
                'output SI.Velocity v(nominal = 2) = v_actual "Speed" annotation(__Daest(std = 0.01));',
                "SI.Velocity v_actual(start = 0.1, fixed = true, nominal = 2)",
                'Real p = v_actual*u "power";',
            ),
        ),
        ("a", ("m*a_actual = u - 3*v;", "a_actual = der(v);")),
        ("g", ('Real g_actual(unit = "N") = 2*u "g as the equations have it";', "der(h) = g_actual;")),
    ],
)
def test_output_that_is_a_state_gets_a_variable_behind_it(tmp_path, place, says) -> None:
    file = tmp_path / "Wheel.mo"
    file.write_text(WHEEL)
    flat, effect = compile_model(file), find_effect("Signals.QuadraticGain")
    site = find_site(flat, place, effect)
    made = extend_model(file, "Wheel", effect, site, values={"a": 0.3})
    assert [words for words in says if words not in made.text] == []
    assert 'info = "v is the speed"' in made.text
    merged = attach(flat, effect, site, values={"a": 0.3})
    assert characteristic(made.flat) == pytest.approx(characteristic(merged), rel=1e-6)
    assert {y.name: (y.unit, y.noise_std) for y in made.flat.outputs} == {
        y.name: (y.unit, y.noise_std) for y in flat.outputs
    }


STORE = """\
model Store "An output and an input with the names of what is modified in a component"
  input Real Q(unit = "W");
  output Real T(unit = "degC");
  Body body(T(start = 290), final C = 300);
equation
  body.Q = Q;
  T = body.T - 273.15;
end Store;
model Body
  parameter Real C(unit = "J/K") = 1;
  Real T(unit = "K");
  Real Q(unit = "W");
equation
  C*der(T) = Q - (T - 290);
end Body;
"""


@pytest.mark.parametrize(("place", "says"), [("T", "= body.T - 273.15"), ("Q", "body.Q = Q_used;")])
def test_modification_of_a_component_is_no_use_of_a_signal_of_that_name(tmp_path, place, says) -> None:
    file = tmp_path / "Store.mo"
    file.write_text(STORE)
    flat, effect = compile_model(file), find_effect("Signals.Offset")
    made = extend_model(file, "Store", effect, find_site(flat, place, effect), values={"b": 2.0})
    assert "body(T(start = 290), final C = 300)" in made.text and says in made.text, made.text


@pytest.mark.slow  # test_inner_signals.py
@pytest.mark.parametrize("place", ["v", *(pytest.param(p, marks=pytest.mark.slow) for p in ("u", "g"))])
def test_several_effects_at_one_signal_follow_each_other(tmp_path, place) -> None:
    path = tmp_path / "Wheel.mo"
    path.write_text(WHEEL)
    sizes = {"QuadraticGain": {"a": 0.3}, "Offset": {"b": 0.2}, "Lag": {"T": 0.4}}
    steps = [(f"Signals.{name}", place, size) for name, size in sizes.items()]
    expected, made = in_steps(tmp_path, path, "Wheel", steps)
    assert characteristic(made.flat) == pytest.approx(characteristic(expected), rel=1e-6)
    told, wanted = (settled(one, 0.5) for one in (made.flat, expected))
    assert told == pytest.approx(wanted, rel=1e-6)
    assert wanted != pytest.approx(settled(compile_model(tmp_path / "Wheel.mo"), 0.5), rel=0.05)


def settled(flat, u):
    """The outputs v and g of the wheel after 20 s at the force u."""
    found = simulate(flat, (np.linspace(0.0, 20.0, 41), np.full((41, 1), u)))
    names = [y.name for y in flat.outputs]
    return [float(found.outputs[-1, names.index(name)]) for name in ("v", "g")]


def test_output_that_shares_its_declaration_is_refused(tmp_path) -> None:
    file = tmp_path / "Wheel.mo"
    file.write_text(WHEEL)
    effect = find_effect("Signals.Offset")
    with pytest.raises(ModelError) as caught:
        extend_model(file, "Wheel", effect, find_site(compile_model(file), "b", effect))
    assert "nor declared in a line of its own" in str(caught.value)


@pytest.mark.slow
def test_effects_in_two_steps_share_the_opened_equation(bare, tmp_path) -> None:
    steps = [
        ("Translational.CoulombFriction", "v", {}),
        ("Thermal.ConstantHeatGain", "T", {}),
        ("Translational.QuadraticDrag", "v", {}),
    ]
    expected, made = in_steps(tmp_path, bare, "Cart", steps)
    assert made.text.count("v_term(s = s)") == made.text.count("T_term(T = ") == 1
    assert characteristic(made.flat) == pytest.approx(characteristic(expected), rel=1e-6)


def test_a_curve_is_put_into_a_bare_equation(bare) -> None:
    load = CurveText("v", "v", [-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0])
    made = extend_by_curve(bare, "Cart", load)
    assert "connect(learned.flange, v_term.flange);" in made.added


def test_a_curve_is_put_into_the_balance_of_an_amount(tmp_path) -> None:
    """A store of a fermenter had been no place where a curve could be written."""
    file = tmp_path / "Vessel.mo"
    file.write_text(
        'model Vessel\n  Real S(unit = "g/l", start = 5, fixed = true);\n  input Real D(unit = "1/h");\n'
        '  output Real y(unit = "g/l") = S;\nequation\n  der(S) = D*(20 - S);\nend Vessel;\n'
    )
    flat = compile_model(file)
    place = next(site for site in sites(flat) if site.kind == "equation")
    made = extend_by_curve(file, "Vessel", CurveText(place.name, "S", [0.0, 10.0, 20.0], [0.0, -0.5, -2.0]))
    assert "Daest.Effects.Amounts.LearnedInflow learned(" in made.added
    found = simulate(made.flat, (np.linspace(0.0, 50.0, 11), np.full((11, 1), 0.1)))
    # In the end 0.1 (20 - S) is what the curve takes away: 0.15 S - 1.
    assert found.outputs[-1, 0] == pytest.approx(12.0, abs=1e-2)


@pytest.mark.parametrize(
    ("file", "class_name", "place", "code", "says"),
    [
        ("Cart", "Rotational.CoulombFriction", "w[1]", "effect-not-writable", "several equations"),
        ("Cart", "Translational.CoulombFriction", "x", "effect-not-writable", "inside of if, for or when"),
        ("Own", "Rotational.Backlash", "train.twist", "effect-fit", "no parameter c"),
        (
            "Own",
            "Rotational.HardeningSpring",
            "train.twist",
            "effect-not-writable",
            "lies inside of a component",
        ),
        (
            "Own",
            "Rotational.LoadDependentFriction",
            "train.twist.end_a",
            "effect-not-writable",
            "no connect clause",
        ),
    ],
)
def test_what_modelica_cannot_say(bare, file, class_name, place, code, says) -> None:
    path, model = (bare, "Cart") if file == "Cart" else (MODELS / "Own.mo", "Machine")
    with pytest.raises(ModelError) as caught:
        extended(class_name, place, path, model)
    assert caught.value.code == code and says in str(caught.value)


# --- break connect ----------------------------------------------------------------------------------

LOOP = """\
model Base
  Real a; Real b;
  Daest.Blocks.Math.Gain first(k = 2); Daest.Blocks.Math.Gain second(k = 3);
  Daest.Blocks.Interfaces.RealInput u; Daest.Blocks.Interfaces.RealOutput y;
equation
  connect(u, first.u);
  connect(first.y , second.u) annotation(Line(points = {{0, 1}, {2, 3}}));
  connect(second.y, y);
  a = 1; b = 2;
end Base;
model Middle extends Base; end Middle;
"""


# Each base and each order once; the other pairs among the slow tests.
@pytest.mark.parametrize(
    ("base", "pair"),
    [
        ("Base", "first.y, second.u"),
        ("Middle", "second.u,first.y"),
        pytest.param("Base", "second.u,first.y", marks=pytest.mark.slow),
        pytest.param("Middle", "first.y, second.u", marks=pytest.mark.slow),
    ],
)
def test_broken_connections_are_gone(base, pair) -> None:
    text = (
        LOOP + f"model New\n  extends {base}(break connect({pair}));\nequation\n  second.u = 7;\nend New;\n"
    )
    flat = compile_text(text.encode(), Path("Loop.mo"), "New")
    assert "second.u = 7" in {e.text for e in flat.equations}
    assert not any("first.y" in e.text and "second.u" in e.text for e in flat.equations)
    assert flat.n == compile_text(text.encode(), Path("Loop.mo"), "Base").n
    place = next(e.place for e in flat.equations if e.text == "second.u = 7")
    assert place is not None and place.line == text.split("\n").index("  second.u = 7;") + 1


@pytest.mark.parametrize(
    ("added", "says"),
    [
        (
            "model New extends Base(break connect(first.u, second.u)); end New;",
            "has no connect(first.u, second.u)",
        ),
        ("model New extends Elsewhere(break connect(a, b)); end New;", "stands in another file"),
        (
            "model New extends Base(break connect(first.y, second.u)); Base other; end New;",
            "is a component in another",
        ),
    ],
)
def test_connections_that_cannot_be_broken(added, says) -> None:
    with pytest.raises(ModelError) as caught:
        compile_text((LOOP + added).encode(), Path("Loop.mo"), "New")
    assert caught.value.code == "model-break" and says in str(caught.value)


def test_poles_are_those_of_two_springs_in_series() -> None:
    """The whole way against a closed form: 1/c = 1/8 + e between rotor and load."""
    made = extended("Rotational.ExtraCompliance", "shaft.flange_b", values={"e": 0.05, "T": 1e-9}).flat
    undamped = np.sqrt((1 / (1 / 8 + 0.05)) / (0.5 * 1.5 / 2))
    slow = [p for p in finite_poles(made) if 0.5 < p.imag < 100]
    assert min(abs(abs(p) - undamped) for p in slow) < 0.02 * undamped


def test_held_parameter_is_final() -> None:
    """A limit that was read off the recordings is none that a later fit may move, or stumble over."""
    values = {"share": 1.0, "limit": 4.0, "u_s": 0.01}
    made = extended("Signals.Saturation", "angle", values=values, held=("share", "limit"))
    assert "final share = 1, final limit" in made.added
    assert [p.name for p in made.flat.parameters if p.name.startswith(f"{made.component}.")] == [
        "saturation.u_s"
    ]


# --- parameters that change -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("class_name", "place", "inputs", "says"),
    [
        ("General.DependentParameter", "m", {"z": "T"}, ["(1 + m_used)*der(q)", "dependentParameter.z = T;"]),
        ("General.DependentParameter", "m", {"z": "z"}, ["(1 + m_used)*der(q)", "dependentParameter.z = z;"]),
        ("General.DriftingParameter", "n", {}, ["F - n_used*v - m*der(v)", "n_used = driftingParameter.y"]),
    ],
)
def test_a_parameter_of_bare_equations_becomes_a_variable(tmp_path, class_name, place, inputs, says) -> None:
    file = tmp_path / "Cart.mo"
    file.write_text(
        BARE.replace("if n > 0.5 then\n    der(x) = F - x;\n  else\n    x = 1;\n  end if;", "x = F;")
    )
    flat = compile_model(file, "Cart")
    effect = find_effect(class_name)
    site = find_site(flat, place, effect)
    made = extend_model(file, "Cart", effect, site, values={"r": 0.02}, inputs=inputs)
    assert all(text in made.text for text in says)
    merged = attach(flat, effect, site, values={"r": 0.02}, inputs=inputs)
    drive = (np.linspace(0.0, 2.0, 21), np.tile([1.0, 30.0], (21, 1)))
    expected = simulate(merged, drive).outputs
    assert simulate(made.flat, drive).outputs == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert np.abs(simulate(flat, drive).outputs - expected).max() > 1e-4


TANKS = """\
model Tanks "Parameters of records, arrays and components"
  record Shape
    parameter Real A(unit = "m2") = 2; parameter Real b(unit = "1/(m.s)") = 0.15;
  end Shape;
  partial model Vessel
    parameter Real k(unit = "1/s") = 0.2; parameter Shape shape; Real h(unit = "m", start = 1);
  end Vessel;
  model Tank
    extends Vessel; input Real q;
  equation
    shape.A*der(h) = q - k*h - shape.b*h^2;
  end Tank;
  parameter Real k(unit = "1/s") = 0.3; parameter Real share[n] = {0.4, 0.6}; parameter Integer n = 2;
  parameter Shape basin;
  input Real u; input Real F;
  Real x(start = 0);
  Tank tank(q = share[1]*u, k = k), row[2](each q = u), other(q = share[2]*u, shape = basin);
  output Real y[4] = {tank.h, row[1].h, row[2].h + other.h, x + basin.A*u};
equation
  der(x) = -basin.b*x + k*sum(share) + F;
end Tanks;
"""


@pytest.fixture(scope="module")
def tanks(tmp_path_factory):
    file = tmp_path_factory.mktemp("tanks") / "Tanks.mo"
    file.write_text(TANKS)
    return file, compile_model(file)


@pytest.mark.parametrize(
    ("place", "says"),
    [
        ("share[2]", ["share_used = {share[1], dependentParameter.y}", "sum(share_used)"]),
        ("row[2].k", ["row(k_used = {row[1].k, dependentParameter.y})", 'k_used(unit = "1/s") = k ']),
        ("basin.b", ["basin_b_used = dependentParameter.y", "shape_b_used = dependentParameter.y"]),
        pytest.param(
            "tank.shape.A", ["tank(shape_A_used = ", "shape_A_used*der(h) = q"], marks=pytest.mark.slow
        ),
        pytest.param(
            "k", ["k_used = dependentParameter.y", "tank(k_used = ", "k = k)"], marks=pytest.mark.slow
        ),
    ],
)
def test_parameters_of_records_arrays_and_components_become_variables(tanks, place, says) -> None:
    """Those that are handed on, to components of the same file, become variables there as well."""
    file, flat = tanks
    values, inputs, own = {"r": 0.2}, {"z": "tank.h"}, {"other.k": 0.25}
    effect = find_effect("General.DependentParameter")
    site = find_site(flat, place, effect)
    made = extend_model(file, None, effect, site, values=values, inputs=inputs, parameters=own)
    assert all(text in made.text for text in says)
    merged = attach(flat, effect, site, values=values, inputs=inputs).with_theta(own)
    drive = (np.linspace(0.0, 2.0, 9), np.tile([1.0, 3.0], (9, 1)))
    expected = simulate(merged, drive).outputs
    assert simulate(made.flat, drive).outputs == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert np.abs(simulate(flat.with_theta(own), drive).outputs - expected).max() > 1e-3


def test_a_parameter_that_something_is_computed_from_stays(tmp_path) -> None:
    file, effect = tmp_path / "Tanks.mo", find_effect("General.DependentParameter")
    file.write_text(TANKS.replace("k = k)", "k = 2*k)"))
    site = find_site(compile_model(file), "k", effect)
    with pytest.raises(ModelError, match="cannot be written: a component takes it as a parameter") as caught:
        extend_model(file, None, effect, site, inputs={"z": "tank.h"})
    assert caught.value.code == "effect-not-writable"


def test_a_variable_that_a_parameter_changes_with_is_one_of_the_model(bare) -> None:
    effect, flat = find_effect("General.DependentParameter"), compile_model(bare, "Cart")
    for inputs, says in (({}, "--input z=VARIABLE"), ({"z": "TT"}, "Did you mean `T`?")):
        with pytest.raises(ModelError, match=says) as caught:
            extend_model(bare, "Cart", effect, find_site(flat, "m", effect), inputs=inputs)
        assert caught.value.code == "effect-parameter"
