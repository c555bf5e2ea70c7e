"""Index reduction: the explicit model must satisfy the equations that it was made from."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from dae_models import (
    FlatBuilder,
    cubic_loop,
    driven_position,
    pendulum,
    rc_pair,
    resistor_ladder,
    rigid_train,
    servo,
)

from daest.errors import ModelError
from daest.model.experiment import Experiment
from daest.model.parts import NoiseInput
from daest.modelica.compile import compile_text
from daest.modelica.flat.guesses import begun_as_recorded
from daest.systems.linear.linearize import linearize
from daest.systems.linear.noise import noise_report
from daest.systems.linear.state_space import state_space_family
from daest.systems.reduction.reduce import chosen_states, reduce_index
from daest.systems.simulation.simulate import _from_sample_to_sample, simulate

MODELS = {
    "servo": lambda: servo(with_noise=True),
    "rc_pair": rc_pair,
    "pendulum": pendulum,
    "driven": lambda: driven_position("force"),
    "cubic": cubic_loop,
    "ladder": lambda: resistor_ladder(12),
    "train": lambda: rigid_train(30),
}


def random_arguments(explicit, rng):
    x = rng.uniform(0.2, 0.7, explicit.n_states)
    u = rng.standard_normal(len(explicit.flat.inputs))
    v = rng.standard_normal(len(explicit.input_derivatives))
    w = rng.standard_normal(len(explicit.flat.noises))
    theta = explicit.flat.theta_values * rng.uniform(0.8, 1.2, len(explicit.flat.parameters))
    return x, u, v, w, theta, 0.3


def flat_residual(explicit, arguments):
    """F at the point, and the size of its terms; every derivative that F uses must be known."""
    flat = explicit.flat
    _, u, _, w, theta, t = arguments
    xi = explicit.variables(*arguments).full().ravel()
    rates = explicit.variable_derivatives(*arguments).full().ravel()
    used = sorted(set(ca.jacobian_sparsity(flat.residual, flat.derivatives).get_triplet()[1]))
    assert np.all(np.isfinite(rates[used]))
    rates[~np.isin(np.arange(flat.n), used)] = 0.0
    symbols = [flat.derivatives, flat.xi, flat.u, flat.w, flat.theta, flat.time]
    slopes = [ca.jacobian(flat.residual, symbol) for symbol in symbols[:4]]
    values = [
        value.full()
        for value in ca.Function("F", symbols, [flat.residual, *slopes])(rates, xi, u, w, theta, t)
    ]
    size = 1.0 + sum(np.abs(s) @ np.abs(p) for s, p in zip(values[1:], (rates, xi, u, w), strict=True))
    return values[0].ravel(), size


@pytest.mark.parametrize("name", MODELS)
def test_states_are_chosen_as_by_the_whole_reduction(name):
    assert chosen_states(MODELS[name]()) == reduce_index(MODELS[name]()).state_names


@pytest.mark.parametrize("name", MODELS)
def test_the_flat_equations_hold_at_random_states(name):
    explicit = reduce_index(MODELS[name]())
    rng = np.random.default_rng(7)
    for _ in range(5):
        residual, size = flat_residual(explicit, random_arguments(explicit, rng))
        assert np.max(np.abs(residual) / size) < 1e-10


@pytest.mark.parametrize("name", MODELS)
def test_states_are_variables_and_rhs_is_their_derivative(name):
    explicit = reduce_index(MODELS[name]())
    arguments = random_arguments(explicit, np.random.default_rng(3))
    names = [v.name for v in explicit.flat.unknowns]
    positions = [names.index(state) for state in explicit.state_names]
    xi, rates = (f(*arguments).full().ravel() for f in (explicit.variables, explicit.variable_derivatives))
    np.testing.assert_allclose(xi[positions], arguments[0], rtol=1e-12)
    np.testing.assert_allclose(rates[positions], explicit.rhs(*arguments).full().ravel(), rtol=1e-12)


@pytest.mark.parametrize("name", ["pendulum", "cubic"])
def test_derivatives_through_newton_iterations_match_finite_differences(name):
    explicit = reduce_index(MODELS[name]())
    assert not explicit.is_symbolic
    arguments = random_arguments(explicit, np.random.default_rng(5))
    symbols = explicit.variables.mx_in()
    jacobian = ca.Function("J", symbols, [ca.jacobian(explicit.variables(*symbols), symbols[0])])
    step = 1e-6
    for j in range(explicit.n_states):
        shift = step * np.eye(explicit.n_states)[j]
        high, low = (
            explicit.variables(arguments[0] + s, *arguments[1:]).full().ravel() for s in (shift, -shift)
        )
        np.testing.assert_allclose(
            jacobian(*arguments).full()[:, j], (high - low) / (2 * step), rtol=1e-6, atol=1e-7
        )


def test_servo_has_natural_states():
    explicit = reduce_index(servo())
    assert explicit.state_names == ("rotor.phi", "rotor.w", "disc.phi", "disc.w")
    assert explicit.state_units == ("rad", "rad/s", "rad", "rad/s")
    assert explicit.is_symbolic
    assert explicit.structural_index == 2
    assert explicit.input_derivatives == ()


def test_pendulum_counts_are_those_of_the_literature():
    explicit = reduce_index(pendulum())
    assert (explicit.structural_index, explicit.n_differentiations) == (3, 4)
    assert explicit.n_states == 2


def test_states_are_chosen_by_the_start_point():
    assert reduce_index(pendulum(0.6, -0.8)).state_names == ("x", "vx")  # fixed starts, and a good pivot
    assert reduce_index(pendulum(1.0, 0.0)).state_names == ("y", "vy")  # x would be singular here
    assert reduce_index(pendulum(0.0, -1.0)).state_names == ("x", "vx")


def coupled_masses(**attributes) -> FlatBuilder:
    """Two masses joined rigidly, the second with a lever ratio of 3; attributes of its position and speed."""
    b = FlatBuilder("Coupled")
    u = b.input("u")
    for name, more in (("a", {}), ("b", attributes)):
        b.unknown(f"{name}.s", "m", **more)
        b.unknown(f"{name}.v", "m/s", **more)
        b.unknown(f"{name}.f", "N")
        b.equation(f"{name}.v", b[f"{name}.v"], b.der(f"{name}.s"))
    b.equation("a", 2.0 * b.der("a.v"), u - b["a.f"])
    b.equation("b", 5.0 * b.der("b.v"), b["b.f"])
    b.equation("lever", b["a.s"], 3.0 * b["b.s"])
    b.equation("power", b["b.f"], 3.0 * b["a.f"])
    b.output("y", b["b.s"])
    return b


@pytest.mark.parametrize(
    ("attributes", "states"),
    [
        ({}, ("a.s", "a.v")),
        ({"state_select": "prefer"}, ("b.s", "b.v")),
        ({"state_select": "never"}, ("a.s", "a.v")),
        ({"start": 0.5}, ("b.s", "b.v")),
        ({"start": 0.5, "state_select": "avoid"}, ("a.s", "a.v")),
    ],
)
def test_state_selection_and_start_values_are_honoured(attributes, states):
    assert reduce_index(coupled_masses(**attributes).build()).state_names == states


def test_what_is_to_be_a_state_stays_one_in_any_unit():
    """A pressure in Pa beside a level in m: the smaller pivot is a matter of units."""
    b = FlatBuilder("Tank")
    u = b.input("u")
    b.unknown("h", "m", start=0.1, state_select="always")
    b.unknown("p", "Pa")
    b.unknown("z", "Pa", start=0.0)
    b.equation("widens", 0.02 * b.der("h") + 1e-9 * b["p"] * b.der("p"), u)
    b.equation("bottom", b["p"], 9787.0 * b["h"])
    b.equation("chamber", 10.0 * b.der("z"), 10.0 * b.der("p") - b["z"])
    b.output("y", b["h"])
    assert set(reduce_index(b.build()).state_names) == {"h", "z"}


def test_derivative_of_a_variable_can_be_a_state():
    b = FlatBuilder("Oscillator")
    b.unknown("s", "m")
    b.unknown("f", "N")
    b.unknown("v", "m/s", state_select="never")
    b.equation("v = der(s)", b["v"], b.der("s"))
    b.equation("f = -4*s", b["f"], -4 * b["s"])
    b.equation("der(v) = f", b.der("v"), b["f"])
    b.output("y", b["s"])
    explicit = reduce_index(b.build())
    poles = np.linalg.eigvals(
        ca.Function(
            "A",
            explicit.rhs.sx_in(),
            [ca.jacobian(explicit.rhs(*explicit.rhs.sx_in()), explicit.rhs.sx_in()[0])],
        )([0, 0], [], [], [], [], 0).full()
    )
    np.testing.assert_allclose(sorted(poles.imag), [-2, 2], rtol=1e-12)


def test_aliases_with_opposite_sign_and_alias_cycles():
    b = FlatBuilder("Signs")
    u = b.input("u")
    for name in ("a", "b", "c", "d"):
        b.unknown(name)
    b.equation("a + b = 0", b["a"], -b["b"])
    b.equation("b = c", b["b"], b["c"])
    b.equation("c = a", b["c"], b["a"])  # closes the cycle with a = -a: everything is zero
    b.equation("der(d) = u + a", b.der("d"), u + b["a"])
    explicit = reduce_index(b.build())
    values = explicit.variables([2.0], [1.0], [], [], [], 0).full().ravel()
    np.testing.assert_array_equal(values, [0, 0, 0, 2])


def test_remainder_has_the_slope_of_an_alias_but_is_none():
    b = FlatBuilder("Turns")
    for name in ("phi", "inside", "twice"):
        b.unknown(name)
    turns = ca.floor(b["phi"] / 6.0)
    b.equation("inside = mod(phi, 6)", b["inside"], b["phi"] - 6.0 * turns)
    b.equation("twice = 2*inside", b["twice"], 2.0 * b["inside"])
    b.equation("der(phi) = inside", b.der("phi"), b["inside"])
    explicit = reduce_index(b.build())
    assert explicit.state_names == ("phi",)
    for phi, inside in ((2.0, 2.0), (8.0, 2.0), (-1.0, 5.0), (6.0e6 + 1.5, 1.5)):
        values = explicit.variables([phi], [], [], [], [], 0).full().ravel()
        np.testing.assert_allclose(values, [phi, inside, 2.0 * inside], rtol=1e-12)


def test_linear_loop_is_solved_symbolically_and_right():
    flat = resistor_ladder(30)
    explicit = reduce_index(flat)
    assert explicit.is_symbolic
    assert 1 <= explicit.largest_loop < 10
    theta, x = flat.theta_values, np.array([1.0, -0.5])
    xi = explicit.variables(x, [0.4], [], [], theta, 0).full().ravel()
    matrix = ca.Function("M", [flat.theta], [ca.jacobian(flat.residual[:30], flat.xi)])(theta).full()
    nodes = np.linalg.solve(matrix[:, 2:], -matrix[:, :2] @ x)
    np.testing.assert_allclose(xi[2:], nodes, rtol=1e-11)


@pytest.mark.slow  # large models: test_split.py, test_sparse_form.py
def test_a_thousand_equations():
    explicit = reduce_index(rigid_train(270))
    assert explicit.flat.n == 1080
    assert explicit.n_states == 2 * 90
    residual, size = flat_residual(explicit, random_arguments(explicit, np.random.default_rng(1)))
    assert np.max(np.abs(residual) / size) < 1e-9


def test_input_derivatives_are_named_and_used():
    explicit = reduce_index(driven_position())
    assert [(d.index, d.order) for d in explicit.input_derivatives] == [(0, 1), (0, 2)]
    # f = m u'' - c (s2 - u)
    force = explicit.outputs([0.3, 0.0], [0.5], [0.1, 7.0], [], explicit.flat.theta_values, 0).full()[0, 0]
    assert force == pytest.approx(2.0 * 7.0 - 8.0 * (0.3 - 0.5), rel=1e-13)


def test_derivatives_that_need_more_than_the_model_has_are_nan():
    explicit = reduce_index(rc_pair())
    theta = explicit.flat.theta_values
    rates = dict(
        zip(
            ("v1", "v2", "i1", "i2"),
            explicit.variable_derivatives([1.0, 0.5], [2.0], [], [0.1], theta, 0).full().ravel(),
            strict=True,
        )
    )
    assert np.isnan(rates["i1"])  # i1 = (u - v1)/R1 needs u'
    assert rates["i2"] == pytest.approx((rates["v1"] - rates["v2"]) / 3.0, rel=1e-13)


def test_noise_may_enter_at_the_force_but_not_at_the_position():
    explicit = reduce_index(driven_position("force"))
    assert len(explicit.flat.noises) == 1
    with pytest.raises(ModelError) as caught:
        reduce_index(driven_position("position"))
    assert caught.value.code == "noise-differentiated"
    assert "noise w " in caught.value.what
    assert "s1 = u" in caught.value.what
    assert caught.value.where.line == 1


def test_structurally_singular_model_names_equations_and_unknowns():
    b = FlatBuilder("Open")
    u = b.input("u")
    for name in ("v", "i", "p"):
        b.unknown(name)
    b.equation("v = 2*i", b["v"], 2 * b["i"])
    b.equation("v = u", b["v"], u)
    b.equation("i = 3", b["i"], 3)
    with pytest.raises(ModelError) as caught:
        reduce_index(b.build())
    assert caught.value.code == "structurally-singular"
    for expected in (
        "v = 2*i",
        "v = u",
        "i = 3",
        "Open.mo:1",
        "3 equations for only 2 unknowns (v, i):",
        "1 unknown with no equation: p",
    ):
        assert expected in caught.value.what


def test_two_rigid_paths_are_reported_as_singular_after_reduction():
    b = FlatBuilder("Parallel")
    u = b.input("u")
    for name in ("s1", "s2", "v1", "v2", "f", "g", "h"):
        b.unknown(name)
    b.equation("der(s1) = v1", b.der("s1"), b["v1"])
    b.equation("der(s2) = v2", b.der("s2"), b["v2"])
    b.equation("der(v1) = u - f - g", b.der("v1"), u - b["f"] - b["g"])
    b.equation("der(v2) = f + g", b.der("v2"), b["f"] + b["g"])
    b.equation("s1 = 2*s2", b["s1"], 2 * b["s2"])
    b.equation("3*s1 = 6*s2", 3 * b["s1"], 6 * b["s2"])
    b.equation("h = f", b["h"], 2 * b["f"])
    with pytest.raises(ModelError) as caught:
        reduce_index(b.build())
    assert caught.value.code in ("singular-after-reduction", "structurally-singular")
    assert "s1 = 2*s2" in caught.value.what
    assert "3*s1 = 6*s2" in caught.value.what


def test_zero_parameter_that_makes_a_loop_singular_is_reported():
    b = FlatBuilder("Loop")
    u, g = b.input("u"), b.parameter("g", 1.0)
    for name in ("a", "b"):
        b.unknown(name)
    b.equation("a + g*b = u", b["a"] + g * b["b"], u)
    b.equation("2*a + 2*b = 1", 2 * b["a"] + 2 * b["b"], 1)
    with pytest.raises(ModelError) as caught:
        reduce_index(b.build())
    assert caught.value.code == "singular-after-reduction"
    assert "2*a + 2*b = 1" in caught.value.what


def test_noise_is_refused_exactly_where_theorem_3_1_forbids_it():
    flat = servo()
    places = noise_report(linearize(flat)).places
    refused = []
    for row in range(flat.n):
        w = ca.SX.sym("w")
        residual = ca.SX(flat.residual)
        residual[row] -= w
        try:
            reduce_index(replace(flat, noises=(NoiseInput("w", 1.0),), w=w, residual=residual))
        except ModelError as error:
            assert error.code == "noise-differentiated"
            refused.append(row)
    assert len(refused) == 10
    assert refused == [row for row, place in enumerate(places) if not place.admissible]


def coupled_capacitors():
    """A capacitor between two nodes, in the node equations of both: their sum holds no derivative."""
    b = FlatBuilder("Coupled")
    c, r, u = b.parameter("C", 2e-6), b.parameter("R", 1e3), b.input("u")
    first, second = b.unknown("v1", start=0.0), b.unknown("v2", start=0.0)
    b.equation("C*der(v1) - C*der(v2) = (u - v1)/R", c * b.der("v1") - c * b.der("v2"), (u - first) / r)
    b.equation("C*der(v2) - C*der(v1) = -v2/R", c * b.der("v2") - c * b.der("v1"), -second / r)
    b.output("y", second)
    return b.build()


def test_derivatives_that_cancel_in_a_combination_leave_a_constraint():
    explicit = reduce_index(coupled_capacitors())
    assert explicit.n_states == 1
    theta = np.array([3e-6, 2e3])
    x, u, v = 0.3, 1.0, 5.0
    variables = explicit.variables(x, u, v, [], theta, 0).full().ravel()
    rates = explicit.variable_derivatives(x, u, v, [], theta, 0).full().ravel()
    # By hand: the sum says u = v1 + v2, and the first equation drives the difference.
    np.testing.assert_allclose(variables.sum(), u, rtol=1e-12)
    np.testing.assert_allclose(rates.sum(), v, rtol=1e-12)
    np.testing.assert_allclose(3e-6 * (rates[0] - rates[1]), (u - variables[0]) / 2e3, rtol=1e-12)


def test_equal_values_alone_are_no_combination():
    """Two parameters that happen to be equal: another value makes the model regular."""
    b = FlatBuilder("Happens")
    p, q = b.parameter("p", 1.0), b.parameter("q", 1.0)
    x, y = b.unknown("x", start=0.0), b.unknown("y", start=0.0)
    b.equation("der(x) + p*der(y) = -x", b.der("x") + p * b.der("y"), -x)
    b.equation("der(x) + q*der(y) = -y", b.der("x") + q * b.der("y"), -y)
    with pytest.raises(ModelError) as caught:
        reduce_index(b.build())
    assert caught.value.code == "singular-after-reduction"


@pytest.mark.parametrize("name", ["pendulum", "cubic"])
def test_newton_iterations_from_a_point_nearby_end_at_the_same_tears(name):
    """Also from tears that are none, and from a guess at which the equations are singular or overflow."""
    explicit = reduce_index(MODELS[name]())
    rhs, outputs = explicit.near
    arguments = random_arguments(explicit, np.random.default_rng(5))
    n_tears = rhs.numel_in(6)
    _, tears = rhs(*arguments, ca.DM.nan(n_tears, 1))
    for guess in (tears, 1.01 * tears, ca.DM.zeros(n_tears), 1e200 * ca.DM.ones(n_tears)):
        value, found = rhs(*arguments, guess)
        np.testing.assert_allclose(value.full(), explicit.rhs(*arguments).full(), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.full(), tears.full(), rtol=1e-9)
        seen = outputs(*arguments, guess)[0].full()
        np.testing.assert_allclose(seen, explicit.outputs(*arguments).full(), rtol=1e-9, atol=1e-9)


def test_second_derivatives_through_newton_iterations():
    explicit = reduce_index(MODELS["cubic"]())
    arguments = random_arguments(explicit, np.random.default_rng(5))
    symbols = explicit.rhs.mx_in()
    slope = ca.jacobian(explicit.rhs(*symbols), symbols[4])
    first = ca.Function("first", symbols, [ca.densify(slope)])
    second = ca.Function("second", symbols, [ca.jacobian(ca.densify(slope), symbols[4])])
    step, exact = 1e-6, second(*arguments).full()
    for j in range(arguments[4].size):
        shift = step * np.eye(arguments[4].size)[j]
        high, low = (
            first(*arguments[:4], arguments[4] + s, arguments[5]).full().ravel("F") for s in (shift, -shift)
        )
        np.testing.assert_allclose(exact[:, j], (high - low) / (2 * step), rtol=1e-5, atol=1e-6)


COIL = """model Coil "Iron that saturates, beside a leak"
  parameter Real n = 14;
  Real Phi(start = 0, fixed = true);
  Real iron;
  Real bn = abs(iron/7.25e-4);
  Real mu(start = 1) = 1 + (1210 + 24630*bn)/(1 + 2.44*bn + bn^n);
  Real mmf;
equation
  mmf = iron*(1.3e5 + 3.3e8/mu);
  mmf = (Phi - iron)*1.2e7;
  600*der(Phi) = 325*sin(314*time + 1.57) - mmf/80;
end Coil;
"""


def test_variables_of_a_loop_are_the_same_from_sample_to_sample():
    explicit = reduce_index(compile_text(COIL.encode(), Path("Coil.mo")))
    time = np.linspace(0, 1, 11)
    columns = (
        np.linspace(0, 2e-3, 11)[None],
        *[np.zeros((0, 11))] * 3,
        explicit.flat.theta_values,
        time[None],
    )
    slopes = explicit.rhs(0.0, [], [], [], explicit.flat.theta_values, 0.0)
    assert np.isfinite(float(slopes))
    found = _from_sample_to_sample(explicit, explicit.near_variables, time, columns)
    assert found == pytest.approx(explicit.variables(*columns).full().T, rel=1e-9, abs=1e-12)


def test_a_division_by_an_unknown_without_a_start_value_is_reduced():
    """The start value zero is no point of the model; its structure is seen beside it."""
    flat = compile_text(COIL.replace("mu(start = 1)", "mu").encode(), Path("Coil.mo"))
    assert reduce_index(flat).largest_loop == 2


MEMBRANE = """model Membrane "Of the two flows that its equations allow one goes backwards"
  input Real p(unit="bar");
  output Real q(unit="l/min"{start}) "Water";
  output Real c(unit="g/l") "Its salt";
  Real V(unit="l", start=0, fixed=true);
equation
  q = 0.19*(p - 0.78*(15 - c));
  q*c = 0.041*(15 - c);
  der(V) = q;
end Membrane;
"""


def _flow(flat):
    explicit = reduce_index(flat)
    at = [*(np.zeros(explicit.variables.numel_in(i)) for i in range(6))]
    at[1] = np.array([39.0])
    at[4] = flat.theta_values
    return float(np.array(explicit.variables(*at))[flat.unknown_names.index("q")].item())


def test_the_start_of_an_unknown_tells_which_solution_of_a_loop_is_meant():
    assert _flow(
        compile_text(MEMBRANE.format(start=", start=4").encode(), Path("Membrane.mo"))
    ) == pytest.approx(5.206, abs=0.01)


def test_a_recording_tells_which_solution_of_a_loop_is_meant():
    flat = compile_text(MEMBRANE.format(start="").encode(), Path("Membrane.mo"))
    assert _flow(flat) < 0
    columns = (np.full((3, 1), 39.0), np.array([[np.nan, 0.12], [5.2, 0.12], [5.2, 0.12]]))
    recording = Experiment("run", np.arange(3.0), *columns, flat.input_names, flat.output_names)
    assert _flow(begun_as_recorded(flat, [recording])) == pytest.approx(5.206, abs=0.01)


def test_solutions_of_a_loop_follow_a_jump_of_an_input():
    """From 25 bar the iteration at 49 bar arrives at the other solution, were it not led there."""
    flat = compile_text(MEMBRANE.format(start=", start=4").encode(), Path("Membrane.mo"))
    p = np.repeat([25.0, 49.0, 25.0], 4)[:, None]
    found = simulate(flat, (np.arange(12.0), p), hold="zoh")["q"]
    assert found == pytest.approx(np.repeat([2.566, 7.101, 2.566], 4), abs=0.01)


WELL = """model Well "A pump lifts water to a tank: the flow into it is negative, its square tells no sign"
  input Real n(unit="1") "Share of the full speed";
  output Real h(unit="m") "Level of the tank";
  output Real p(unit="bar") "Pressure behind the pump";
  Real q(unit="l/min") "Flow into the pump";
  Real p_tank(unit="bar");
equation
  p = -1.2 + 6.4*n^2 - 3.3e-6*q^2;
  -q = 830*(p - p_tank);
  p_tank = 3 + 0.1*h;
  28*60000*der(h) = -q - 500;
end Well;
"""


def test_of_a_square_the_other_equations_tell_the_root():
    flat = compile_text(WELL.encode(), Path("Well.mo"))
    columns = (np.full((3, 1), 0.96), np.array([[2.0, 3.76], [2.0, 3.76], [2.0, 3.76]]))
    recording = Experiment("run", np.arange(3.0), *columns, flat.input_names, flat.output_names)
    found = simulate(begun_as_recorded(flat, [recording]), recording, x0={"h": 2.0})
    assert (found["p"][0], found["q"][0]) == pytest.approx((3.821, -515.5), rel=1e-3)


def test_matrices_are_taken_at_the_inputs_of_a_recording_where_the_model_stands_still_nowhere():
    """A pump that does not turn lifts no water: with inputs of zero the model has no solution."""
    flat = compile_text(WELL.encode(), Path("Well.mo"))
    with pytest.raises(ModelError) as caught:
        state_space_family(flat)
    assert caught.value.code == "initial-not-solved"
    columns = (np.full((3, 1), 0.96), np.array([[2.0, 3.76], [2.0, 3.76], [2.0, 3.76]]))
    recording = Experiment("run", np.arange(3.0), *columns, flat.input_names, flat.output_names)
    begun = begun_as_recorded(flat, [recording])
    family = state_space_family(begun)
    slopes = family.matrices(begun.theta_values)[0].full()
    assert slopes[0, 0] == pytest.approx(-0.1 / (1.0 / 830.0 + 6.6e-6 * 557.6) / 28.0 / 60000.0, rel=1e-3)
