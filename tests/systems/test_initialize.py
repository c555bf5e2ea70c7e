"""Consistent initial values against closed forms, and the messages when there are none."""

import casadi as ca
import numpy as np
import pytest
from dae_models import FlatBuilder, cubic_loop, pendulum, rc_pair, servo
from scipy.optimize import brentq

from daest.errors import ModelError
from daest.systems.reduction.initialize import begun_beside, initial_point
from daest.systems.reduction.reduce import reduce_index


def test_fixed_starts_and_dependent_variables():
    x0, xi0 = initial_point(reduce_index(rc_pair()), u0=np.array([4.0]))
    np.testing.assert_allclose(x0, [0.0, 1.0], atol=1e-14)
    np.testing.assert_allclose(xi0, [0.0, 1.0, 4.0 / 2.0, -1.0 / 3.0], rtol=1e-12, atol=1e-14)


def test_start_values_are_the_default_of_states():
    x0, _ = initial_point(reduce_index(servo()))
    np.testing.assert_array_equal(x0, 0.0)


def test_initial_equations_ask_for_the_steady_state():
    b = FlatBuilder("Steady")
    u, k = b.input("u"), b.parameter("k", 3.0)
    x, y = b.unknown("x", start=7.0), b.unknown("y")
    b.equation("der(x) = u - k*y", b.der("x"), u - k * y)
    b.equation("y = 2*x", y, 2 * x)
    b.initial_equation("der(x) = 0", b.der("x"))
    b.output("o", y)
    x0, xi0 = initial_point(reduce_index(b.build()), u0=np.array([12.0]))
    np.testing.assert_allclose(xi0, [2.0, 4.0], rtol=1e-12)
    np.testing.assert_allclose(x0, [2.0], rtol=1e-12)


def test_states_of_an_effect_begin_beside_a_recording_that_contradicts_the_model():
    b = FlatBuilder("Room")
    u, G = b.input("u"), b.parameter("G", 0.0)
    T, wall = b.unknown("T", start=280.0), b.unknown("wall")
    b.equation("der(T) = u - G*(T - wall)", b.der("T"), u - G * (T - wall))
    b.equation("der(wall) = T - wall", b.der("wall"), T - wall)
    b.initial_equation("der(T) = 0", b.der("T"))
    b.initial_equation("wall = 0.75*T + 0.25*u", wall, 0.75 * T + 0.25 * u)
    b.output("y", T)
    explicit = reduce_index(b.build())
    row = explicit.state_names.index("wall")
    begun = begun_beside(explicit, [row], np.full(2, 300.0), np.array([40.0]), np.zeros(0))
    np.testing.assert_allclose(begun, [235.0], rtol=1e-12)


def test_start_of_an_alias_counts_with_its_sign():
    b = FlatBuilder("Alias")
    b.unknown("deep.inside.x", start=1.5)
    b.unknown("x", state_select="prefer")
    b.equation("der(x) = -x", b.der("x"), -b["x"])
    b.equation("x + deep.inside.x = 0", b["x"], -b["deep.inside.x"])
    explicit = reduce_index(b.build())
    assert explicit.state_names == ("x",)
    x0, _ = initial_point(explicit)
    np.testing.assert_array_equal(x0, [-1.5])


def test_fixed_value_of_a_dependent_variable_moves_the_state():
    explicit = reduce_index(rc_pair())
    x0, xi0 = initial_point(explicit, u0=np.array([1.0]), given={"v1": 0.25, "v2": 0.5})
    np.testing.assert_allclose(x0, [0.25, 0.5], rtol=1e-13)
    assert xi0[3] == pytest.approx(-0.25 / 3.0)


def test_nonlinear_constraint_is_solved_on_the_branch_of_the_start():
    for y in (-0.8, 0.7):
        _, xi0 = initial_point(reduce_index(pendulum(0.6, y)))
        assert xi0[0] == pytest.approx(0.6, abs=1e-12)
        assert xi0[1] == pytest.approx(np.sign(y) * 0.8, abs=1e-10)


def test_state_behind_a_nonlinear_equation():
    explicit = reduce_index(cubic_loop())
    # q - 0.1 sin q = z, q + z^3 = x = 2
    q = brentq(lambda q: q + (q - 0.1 * np.sin(q)) ** 3 - 2, 0, 2, xtol=1e-14)
    _, xi0 = initial_point(explicit)
    np.testing.assert_allclose(xi0, [2.0, q - 0.1 * np.sin(q), q], rtol=1e-10)


def test_redundant_but_consistent_fixed_values_are_accepted_and_contradictions_named():
    def model(second):
        b = FlatBuilder("Twice")
        b.unknown("a", start=1.0, fixed=True)
        b.unknown("b", start=second, fixed=True)
        b.equation("der(a) = -a", b.der("a"), -b["a"])
        b.equation("b = 2*a", b["b"], 2 * b["a"])
        return reduce_index(b.build())

    x0, _ = initial_point(model(2.0))
    np.testing.assert_allclose(x0, [1.0], rtol=1e-12)
    with pytest.raises(ModelError) as caught:
        initial_point(model(5.0))
    assert caught.value.code == "initial-overdetermined"
    assert "a = 1" in caught.value.what and "b = 5" in caught.value.what
    assert "1 of the 2" in caught.value.what


def test_impossible_start_is_refused():
    with pytest.raises(ModelError) as caught:
        initial_point(reduce_index(pendulum()), given={"x": 1.7})
    assert caught.value.code == "initial-not-solved"
    assert "x = 1.7" in caught.value.what


def test_a_loop_without_a_solution_is_no_contradiction_of_the_start_values():
    """z^2 + exp(z) = -x has no solution at x = 1."""
    b = FlatBuilder("Nowhere")
    b.unknown("x", start=1.0, fixed=True)
    b.unknown("z", start=0.5)
    b.equation("der(x) = -z", b.der("x"), -b["z"])
    b.equation("z^2 + exp(z) = -x", b["z"] ** 2 + ca.exp(b["z"]), -b["x"])
    with pytest.raises(ModelError) as caught:
        initial_point(reduce_index(b.build()))
    assert caught.value.code == "initial-not-solved"
    assert "x = 1" in caught.value.what and "contradict" not in caught.value.what


def test_unknown_name_is_refused():
    with pytest.raises(ModelError) as caught:
        initial_point(reduce_index(rc_pair()), given={"v9": 1.0})
    assert caught.value.code == "unknown-variable"


def test_states_that_the_start_equations_lead_to():
    """A tank: without mass it has no temperature, but its level and temperature give mass and energy."""
    b = FlatBuilder("Tank")
    m, energy, level, heat = (b.unknown(name) for name in ("m", "energy", "level", "heat"))
    b.equation("m = 2000*level", m, 2000 * level)
    b.equation("energy = m*heat", energy, m * heat)
    b.equation("der(m) = -1", b.der("m"), -1)
    b.equation("der(energy) = -heat", b.der("energy"), -heat)
    b.initial_equation("level = 4", level - 4)
    b.initial_equation("heat = 300", heat - 300)
    explicit = reduce_index(b.build())
    assert set(explicit.state_names) == {"m", "energy"}
    _, xi0 = initial_point(explicit)
    np.testing.assert_allclose(xi0, [8000.0, 2.4e6, 4.0, 300.0], rtol=1e-12)
