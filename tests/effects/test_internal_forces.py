"""Effects beside the forces between the bodies of bare equations, against the motion by scipy."""

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
from daest.modelica.places.sites import find_site, fits, sites
from daest.systems.simulation.simulate import simulate

HEAD = """model Two
  parameter Real m1(unit = "kg") = 2;
  parameter Real m2(unit = "kg") = 3;
  parameter Real c(unit = "N/m") = 40;
  parameter Real d(unit = "N.s/m") = 0.5;
  input Real u(unit = "N");
  output Real y1(unit = "m") = s1;
  output Real y2(unit = "m") = s2;
  Real s1(unit = "m", start = 0, fixed = true);
  Real s2(unit = "m", start = 0, fixed = true);
  Real v1(unit = "m/s", start = 0, fixed = true);
  Real v2(unit = "m/s", start = 0, fixed = true);
"""
MOTION = "equation\n  der(s1) = v1;\n  der(s2) = v2;\n"
BALANCES = "  m1*der(v1) = u - F;\n  m2*der(v2) = F;\nend Two;\n"
SPRING = "c*(s1 - s2) + d*(v1 - v2)"
GIVEN = f'{HEAD}  Real F(unit = "N");\n{MOTION}  F = {SPRING};\n{BALANCES}'
BEHIND = f'{HEAD}  Real F(unit = "N");\n{MOTION}  {SPRING} = F;\n{BALANCES}'
BOUND = f'{HEAD}  Real F(unit = "N") = {SPRING} "Coupling";\n{MOTION}{BALANCES}'
WITHIN = f"{HEAD}{MOTION}  m1*der(v1) = u - {SPRING.replace('+', '-')};\n  m2*der(v2) = {SPRING};\nend Two;\n"
RATES = GIVEN.replace("m1*der(v1) = u - F", "der(v1) = (u - F)/m1").replace(
    "m2*der(v2) = F", "der(v2) = F/m2"
)
DIVIDED = WITHIN.replace(
    f"m1*der(v1) = u - {SPRING.replace('+', '-')}", f"der(v1) = (u - ({SPRING}))/m1"
).replace(f"m2*der(v2) = {SPRING}", f"der(v2) = 1/m2*({SPRING})")
FORMS = {
    "given": GIVEN,
    "behind": BEHIND,
    "bound": BOUND,
    "within": WITHIN,
    "rates": RATES,
    "divided": DIVIDED,
}

BELT = """model Belt
  parameter Real J1(unit = "kg.m2") = 0.2;
  parameter Real J2(unit = "kg.m2") = 0.5;
  parameter Real r1(unit = "m") = 0.1;
  parameter Real c(unit = "N/m") = 900;
  input Real u(unit = "N.m");
  output Real y1(unit = "rad/s") = w1;
  output Real y2(unit = "rad/s") = w2;
  Real e(unit = "m", start = 0, fixed = true);
  Real w1(unit = "rad/s", start = 0, fixed = true);
  Real w2(unit = "rad/s", start = 0, fixed = true);
  Real F(unit = "N");
equation
  der(e) = r1*w1 - 0.3*w2;
  F = c*e;
  J1*der(w1) = u - r1*F;
  J2*der(w2) = 0.3*F;
end Belt;
"""
SLIPPING = (
    BELT.replace('  Real e(unit = "m", start = 0, fixed = true);\n', "")
    .replace("  der(e) = r1*w1 - 0.3*w2;\n", "")
    .replace("F = c*e", "F = c*(r1*w1 - 0.3*w2)")
    .replace("N/m", "N.s/m")
)


def simulated(flat):
    """The outputs after 2 s under a force or torque of 1.5."""
    return simulate(flat, (np.linspace(0.0, 2.0, 41), np.full((41, 1), 1.5))).outputs[-1]


def both_ways(path, flat, effect, site, values):
    """The model with the effect attached, and as it is written."""
    return attach(flat, effect, site, values=values), extend_model(
        path, None, effect, site, values=values
    ).flat


@cache
def two_bodies(law):
    """The same of the two bodies with the force law(x, v) beside their spring."""

    def rate(_, state):
        s1, s2, v1, v2 = state
        force = 40 * (s1 - s2) + 0.5 * (v1 - v2) + law(s1 - s2, v1 - v2)
        return [v1, v2, (1.5 - force) / 2, force / 3]

    return solve_ivp(rate, (0.0, 2.0), [0.0] * 4, method="LSODA", rtol=1e-9, atol=1e-12).y[:2, -1]


def no_force(x, v):
    return 0.0


LAWS = {
    "Translational.ViscousFriction": ({"d": 6.0}, lambda x, v: 6.0 * v),
    "Translational.HardeningSpring": ({"c3": 4e4}, lambda x, v: 4e4 * x**3),
    "Translational.CoulombFriction": ({"f_c": 0.4, "v_s": 0.01}, lambda x, v: 0.4 * np.tanh(v / 0.01)),
}


# Every law once, in forms that the tests of a play below do not take; all pairs among the slow tests.
OTHERS = ("given", "behind", "bound", "within")
PAIRS = [
    pytest.param(form, law, marks=pytest.mark.slow if form not in OTHERS or i % len(LAWS) != j else ())
    for i, form in enumerate(FORMS)
    for j, law in enumerate(LAWS)
]


@pytest.mark.parametrize(("form", "class_name"), PAIRS)
def test_effect_beside_a_force_is_driven_by_the_relative_motion(tmp_path, form, class_name):
    values, law = LAWS[class_name]
    path = tmp_path / "Two.mo"
    path.write_text(FORMS[form])
    flat, effect = compile_model(path), find_effect(class_name)
    (site,) = [s for s in sites(flat) if s.kind == "force"]
    assert fits(effect, site)
    expected = two_bodies(law)
    assert not np.allclose(expected, two_bodies(no_force), rtol=1e-3)
    attached = simulated(attach(flat, effect, site, values=values))
    np.testing.assert_allclose(attached, expected, rtol=1e-5)
    written = extend_model(path, None, effect, site, values=values)
    np.testing.assert_allclose(simulated(written.flat), expected, rtol=1e-5)


CARRIED = """model Two
  parameter Real m1(unit = "kg") = 2;
  parameter Real m2(unit = "kg") = 3;
  parameter Real c(unit = "N/m") = 40;
  parameter Real d(unit = "N.s/m") = 0.5;
  input Real u(unit = "N");
  output Real y1(unit = "m") = s1;
  output Real y2(unit = "m") = s1 + x;
  Real s1(unit = "m", start = 0, fixed = true);
  Real x(unit = "m", start = 0, fixed = true);
  Real v1(unit = "m/s", start = 0, fixed = true);
  Real vr(unit = "m/s", start = 0, fixed = true);
equation
  der(s1) = v1;
  der(x) = vr;
  m1*der(v1) = u + c*x + d*vr;
  m2*(der(v1) + der(vr)) = -c*x - d*vr;
end Two;
"""


@pytest.mark.parametrize("class_name", LAWS)
def test_a_force_between_a_body_and_its_carrier_acts_on_both(tmp_path, class_name):
    """The speed of the second body is told relative to the first one: what acts beside their spring goes
    with that, and the first body takes it the other way. It had been a force on the second body alone."""
    values, law = LAWS[class_name]
    path = tmp_path / "Two.mo"
    path.write_text(CARRIED)
    flat, effect = compile_model(path), find_effect(class_name)
    (site,) = [s for s in sites(flat) if s.kind == "force"]
    assert (site.name, site.is_grounded) == ("3:vr, 2:v1", False)
    assert site.given == {"c": "c", "d": "d"}
    for model in both_ways(path, flat, effect, site, values):
        np.testing.assert_allclose(simulated(model), two_bodies(law), rtol=1e-5)


def test_what_stands_in_one_of_two_balances_alone_is_no_force_on_a_carrier():
    """Beside the sum of both balances in place of the first one the spring acts on the second row alone."""
    summed = CARRIED.replace("m1*der(v1) = u + c*x + d*vr", "(m1 + m2)*der(v1) + m2*der(vr) = u")
    flat = compile_text(summed.encode(), Path("Two.mo"))
    assert all(site.is_grounded for site in sites(flat) if site.kind == "force")


TWIST = GIVEN.replace(SPRING, "c*x + d*(v1 - v2)").replace(
    "equation\n", '  Real x(unit = "m", start = 0, fixed = true);\nequation\n  der(x) = v1 - v2;\n'
)


APART = (
    GIVEN.replace(f"F = {SPRING}", "F = c*(s1 - s2);\n  G = d*(v1 - v2)")
    .replace("equation\n", '  Real G(unit = "N");\nequation\n')
    .replace("u - F", "u - F - G")
    .replace("= F;\nend", "= F + G;\nend")
)


def play(x, v, gap=0.02, s_s=1e-3):
    """What a play takes away from the spring of 40 N/m and the damper of 0.5 N.s/m behind it."""
    ahead, behind = np.hypot(x - gap / 2, s_s), np.hypot(x + gap / 2, s_s)
    return 40 * (ahead - behind) / 2 + 0.5 * v * ((x - gap / 2) / ahead - (x + gap / 2) / behind) / 2


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(GIVEN, marks=pytest.mark.slow),
        pytest.param(BEHIND, marks=pytest.mark.slow),
        pytest.param(BOUND, marks=pytest.mark.slow),
        RATES,
        TWIST,
        pytest.param(WITHIN, marks=pytest.mark.slow),
        DIVIDED,
        APART,
    ],
    ids=["given", "behind", "bound", "rates", "twist", "within", "divided", "apart"],
)
def test_play_is_that_of_the_spring_and_the_damper_of_the_equation(tmp_path, text):
    path = tmp_path / "Two.mo"
    path.write_text(text)
    flat, effect = compile_model(path), find_effect("Translational.Backlash")
    (site,) = [s for s in sites(flat) if s.kind == "force"]
    assert site.given == {"c": "c", "d": "d"}
    values, expected = {"gap": 0.02, "s_s": 1e-3}, two_bodies(play)
    assert not np.allclose(expected, two_bodies(no_force), rtol=1e-3)
    for model in both_ways(path, flat, effect, site, values):
        np.testing.assert_allclose(simulated(model), expected, rtol=1e-5)


GEARED = """model Geared
  parameter Real J1(unit = "kg.m2") = 0.02;
  parameter Real J2(unit = "kg.m2") = 0.5;
  parameter Real n = 4;
  parameter Real c(unit = "N.m/rad") = 5;
  parameter Real d(unit = "N.m.s/rad") = 0.2;
  input Real u(unit = "N.m");
  output Real y1(unit = "rad") = phi1;
  output Real y2(unit = "rad") = phi2;
  Real phi1(unit = "rad", start = 0, fixed = true);
  Real phi2(unit = "rad", start = 0, fixed = true);
  Real w1(unit = "rad/s", start = 0, fixed = true);
  Real w2(unit = "rad/s", start = 0, fixed = true);
equation
  der(phi1) = w1;
  der(phi2) = w2;
  J1*der(w1) = u - (c*(phi1/n - phi2) + d*(w1/n - w2))/n;
  J2*der(w2) = c*(phi1/n - phi2) + d*(w1/n - w2);
end Geared;
"""
GEARED_RATES = (
    GEARED.replace("J1*der(w1) = u - (c*(phi1/n - phi2) + d*(w1/n - w2))/n", "der(w1) = (u - F/n)/J1")
    .replace("J2*der(w2) = c*(phi1/n - phi2) + d*(w1/n - w2)", "der(w2) = F/J2")
    .replace("equation\n", '  Real F(unit = "N.m");\nequation\n  F = c*(phi1/n - phi2) + d*(w1/n - w2);\n')
)


@pytest.mark.parametrize(
    "text", [pytest.param(GEARED, marks=pytest.mark.slow), GEARED_RATES], ids=["within", "rates"]
)
@pytest.mark.parametrize(
    ("class_name", "values", "law"),
    [
        ("Rotational.HardeningSpring", {"c3": 900.0}, lambda x, v: 900.0 * x**3),
        (
            "Rotational.Backlash",
            {"gap": 0.5, "phi_s": 1e-3},
            lambda x, v: (
                5 * (np.hypot(x - 0.25, 1e-3) - np.hypot(x + 0.25, 1e-3)) / 2
                + 0.1 * v * ((x - 0.25) / np.hypot(x - 0.25, 1e-3) - (x + 0.25) / np.hypot(x + 0.25, 1e-3))
            ),
        ),
    ],
    ids=["spring", "play"],
)
def test_effect_behind_a_gear_acts_on_either_side_by_its_ratio(tmp_path, text, class_name, values, law):
    """The ratio stands before the force in one balance alone, and over an inertia where rates are written."""
    path = tmp_path / "Geared.mo"
    path.write_text(text)
    flat, effect = compile_model(path), find_effect(class_name)
    (site,) = [s for s in sites(flat) if s.kind == "force"]
    assert site.given == {"c": "c", "d": "d"}

    def motion(law):
        def rate(_, state):
            phi1, phi2, w1, w2 = state
            x, v = phi1 / 4 - phi2, w1 / 4 - w2
            force = 5 * x + 0.2 * v + law(x, v)
            return [w1, w2, (1.5 - force / 4) / 0.02, force / 0.5]

        return solve_ivp(rate, (0.0, 2.0), [0.0] * 4, method="LSODA", rtol=1e-9, atol=1e-12).y[:2, -1]

    expected = motion(law)
    assert not np.allclose(expected, motion(no_force), rtol=1e-3)
    for model in both_ways(path, flat, effect, site, values):
        np.testing.assert_allclose(simulated(model), expected, rtol=1e-5)


def test_spring_between_a_pinion_and_its_rack_is_one_of_the_slide(tmp_path):
    """A torque on the shaft by the radius, a force on the slide: the motion between them is one in metres."""
    path = tmp_path / "Rack.mo"
    path.write_text("""model Rack
  parameter Real J(unit = "kg.m2") = 0.02;
  parameter Real m(unit = "kg") = 0.5;
  parameter Real r(unit = "m") = 0.1;
  parameter Real c(unit = "N/m") = 50;
  input Real u(unit = "N.m");
  output Real y1(unit = "rad") = phi;
  output Real y2(unit = "m") = s;
  Real phi(unit = "rad", start = 0, fixed = true);
  Real s(unit = "m", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(phi) = w;
  der(s) = v;
  J*der(w) = u - r*c*(r*phi - s);
  m*der(v) = c*(r*phi - s);
end Rack;
""")
    flat, effect = compile_model(path), find_effect("Translational.HardeningSpring")
    (site,) = [s for s in sites(flat) if s.kind == "force"]
    assert (site.domain, site.given) == ("translational", {"c": "c"})

    def motion(c3):
        def rate(_, state):
            phi, s, w, v = state
            x = 0.1 * phi - s
            force = 50 * x + c3 * x**3
            return [w, v, (1.5 - 0.1 * force) / 0.02, force / 0.5]

        return solve_ivp(rate, (0.0, 2.0), [0.0] * 4, method="LSODA", rtol=1e-9, atol=1e-12).y[:2, -1]

    assert not np.allclose(motion(9e3)[1], motion(0.0)[1], rtol=1e-3)
    for model in both_ways(path, flat, effect, site, {"c3": 9e3}):
        np.testing.assert_allclose(simulated(model), motion(9e3), rtol=1e-5)


@pytest.mark.parametrize(
    "terms",
    [
        ("- d*v1", "- d*v2"),  # the same damping on either body
        ("- d*v2", "+ d*v1"),  # gyroscopic
        ("- c*s1 + c*s2", "- 2*c*s2 + c*s1"),  # another spring with the same stiffness at one of them
    ],
    ids=["own", "gyroscopic", "shared"],
)
def test_parameters_of_two_bodies_that_are_no_force_between_them(terms):
    text = f"{HEAD}{MOTION}  m1*der(v1) = u {terms[0]};\n  m2*der(v2) = 0 {terms[1]};\nend Two;\n"
    assert not [
        s
        for s in sites(compile_text(text.encode(), Path("Two.mo")))
        if s.kind == "force" and not s.is_grounded
    ]


HUNG = """model Hung
  parameter Real m(unit = "kg") = 2;
  parameter Real c(unit = "N/m") = 40;
  parameter Real d(unit = "N.s/m") = 0.5;
  input Real u(unit = "N");
  output Real y1(unit = "m") = s;
  output Real y2(unit = "m/s") = v;
  Real s(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(s) = v;
  m*der(v) = u - c*s - d*v;
end Hung;
"""


@pytest.mark.parametrize(
    "text",
    [
        HUNG,
        pytest.param(
            HUNG.replace("m*der(v) = u - c*s - d*v", "der(v) = u/m - c/m*s - d/m*der(s)"),
            marks=pytest.mark.slow,
        ),
        HUNG.replace("m*der(v) = u - c*s - d*v", "F = u - c*s - d*v;\n  der(v) = a;\n  a = F/m").replace(
            "equation\n", '  Real F(unit = "N"), a(unit = "m/s2");\nequation\n'
        ),
    ],
    ids=["balance", "rates", "sum"],
)
def test_play_of_a_spring_that_hangs_on_what_does_not_move(tmp_path, text):
    """What acts on the body alone has its place at the body, not beside the spring."""
    path = tmp_path / "Hung.mo"
    path.write_text(text)
    flat, effect = compile_model(path), find_effect("Translational.Backlash")
    (site,) = [s for s in sites(flat) if s.kind == "force"]
    assert site.is_grounded
    assert site.given == {"c": "c", "d": "d"}
    assert not fits(find_effect("Translational.CoulombFriction"), site)
    values = {"gap": 0.02, "s_s": 1e-3}

    def rate(_, state):
        s, v = state
        return [v, (1.5 - 40 * s - 0.5 * v - play(s, v)) / 2]

    expected = solve_ivp(rate, (0.0, 2.0), [0.0] * 2, method="LSODA", rtol=1e-9, atol=1e-12).y[:, -1]
    for model in (
        attach(flat, effect, site, values=values),
        extend_model(path, None, effect, find_site(flat, site.name, effect), values=values).flat,
    ):
        np.testing.assert_allclose(simulated(model), expected, rtol=1e-5)


@pytest.mark.slow  # test_extend.py
def test_effects_at_a_body_and_beside_a_force_share_the_storage_they_are_over(tmp_path):
    """What was put into a rate is found again, with the mass that it is divided by."""
    path = tmp_path / "Two.mo"
    path.write_text(DIVIDED)
    steps = [("Translational.ViscousFriction", "v1", {"d": 2.0}), ("Translational.CoulombFriction", "v1", {})]
    expected, made = in_steps(tmp_path, path, "Two", steps)
    assert made.text.count("\n  der(v1) + v1_term.total/m1 = ") == made.text.count("Daest.Terms.") == 1
    np.testing.assert_allclose(simulated(made.flat), simulated(expected), rtol=1e-6)


def test_play_needs_the_stiffness_as_a_parameter():
    text = GIVEN.replace("c*(s1 - s2)", "c*(s1 - s2)^3")
    flat = compile_text(text.encode(), Path("Two.mo"))
    (site,) = [s for s in sites(flat) if s.kind == "force"]
    assert site.given == {"d": "d"} and not fits(find_effect("Translational.Backlash"), site)


@pytest.mark.parametrize(
    ("text", "term"), [(BELT, "Force F_term(s = e)"), (SLIPPING, "ForceOfSpeed F_term(v = r1*w1 - 0.3*w2)")]
)
def test_belt_slips_at_the_difference_of_the_rim_speeds(tmp_path, text, term):
    path = tmp_path / "Belt.mo"
    path.write_text(text)
    flat, effect = compile_model(path), find_effect("Translational.ViscousFriction")
    (site,) = [s for s in sites(flat) if s.kind == "force"]

    def rate(_, state):
        e, w1, w2 = state
        slip = 0.1 * w1 - 0.3 * w2
        force = 900 * (e if text == BELT else slip) + 20.0 * slip
        return [slip, (1.5 - 0.1 * force) / 0.2, 0.3 * force / 0.5]

    expected = solve_ivp(rate, (0.0, 2.0), [0.0] * 3, method="LSODA", rtol=1e-9, atol=1e-12).y[1:, -1]
    np.testing.assert_allclose(simulated(attach(flat, effect, site, values={"d": 20.0})), expected, rtol=1e-5)
    written = extend_model(path, None, effect, site, values={"d": 20.0})
    assert f"Daest.Terms.{term} " in written.text
    np.testing.assert_allclose(simulated(written.flat), expected, rtol=1e-5)


@pytest.mark.slow
def test_two_effects_beside_a_force_and_one_at_a_body_keep_their_places(tmp_path):
    """The second at the force joins the first; that at the body is none of them, though it stands beside."""
    path, effect = tmp_path / "Two.mo", find_effect("Translational.ViscousFriction")
    path.write_text(WITHIN)
    places = (("ViscousFriction", "v1, v2"), ("CoulombFriction", "v1, v2"), ("ViscousFriction", "v1"))
    steps = [(f"Translational.{name}", place, {}) for name, place in places]
    expected, made = in_steps(tmp_path, path, "Two", steps)
    assert made.text.count("(s = s1 - s2)") == made.text.count("(s = s1)") == 1
    np.testing.assert_allclose(simulated(made.flat), simulated(expected), rtol=1e-6)
    with pytest.raises(ModelError, match="effect-present"):
        attach(expected, effect, find_site(expected, "v1", effect))


def test_what_is_no_force_between_bodies_is_no_place():
    """A weight acts on both with one sign, a drag on one alone, and a ratio is not a force."""
    text = HEAD + MOTION
    text += "  m1*der(v1) = u - d*v1 - m1*c;\n  m2*der(v2) = -m2*c;\nend Two;\n"
    assert not [
        s
        for s in sites(compile_text(text.encode(), Path("Two.mo")))
        if s.kind == "force" and not s.is_grounded
    ]


def test_factor_that_is_no_parameter_cannot_be_written(tmp_path):
    path = tmp_path / "Belt.mo"
    path.write_text(SLIPPING.replace("r1*F", "0.1*sin(r1)/sin(0.1)*F"))
    flat, effect = compile_model(path), find_effect("Translational.ViscousFriction")
    (site,) = [s for s in sites(flat) if s.kind == "force"]
    with pytest.raises(ModelError, match="neither a number nor a parameter"):
        extend_model(path, None, effect, site)
