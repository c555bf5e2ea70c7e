"""State-space families against the pencil of the flat model, closed forms and finite differences."""

import casadi as ca
import numpy as np
import pytest
import scipy.linalg
from dae_models import cubic_loop, driven_position, pendulum, rc_pair, resistor_ladder, servo

from daest.errors import ConfigError, ModelError
from daest.systems.linear.state_space import state_space, state_space_derivatives, state_space_family
from daest.systems.reduction.reduce import reduce_index

AFFINE = {
    "servo": lambda: servo(with_noise=True),
    "rc_pair": rc_pair,
    "driven": lambda: driven_position("force"),
    "ladder": lambda: resistor_ladder(12),
}


def pencil(flat, theta):
    """E, J, K, B, C, D of the flat equations, by differentiating the residual."""
    f, h = flat.residual, flat.output_expressions
    parts = [
        ca.jacobian(f, flat.derivatives), -ca.jacobian(f, flat.xi), -ca.jacobian(f, flat.u),
        -ca.jacobian(f, flat.w), ca.jacobian(h, flat.xi), ca.jacobian(h, flat.u),
    ]  # fmt: skip
    return [m.full() for m in ca.Function("pencil", [flat.theta], [ca.densify(p) for p in parts])(theta)]


def random_theta(flat, seed):
    return flat.theta_values * np.random.default_rng(seed).uniform(0.7, 1.4, len(flat.parameters))


@pytest.mark.parametrize("name", AFFINE)
def test_transfer_functions_equal_those_of_the_pencil(name):
    flat = AFFINE[name]()
    family = state_space_family(flat)
    assert family.is_affine
    rng = np.random.default_rng(2)
    for seed in range(3):
        theta = random_theta(flat, seed)
        ss = state_space(family, theta)
        E, J, K, B, C, D = pencil(flat, theta)
        s = complex(rng.uniform(-3, 3), rng.uniform(0.5, 30))
        from_input = np.linalg.solve(s * E - J, K)
        from_noise = np.linalg.solve(s * E - J, B)
        # ū = (u, v) with v = s^order u.
        stacked = np.vstack(
            [np.eye(K.shape[1]), *(s**o * np.eye(K.shape[1])[[i]] for i, o in ss.input_derivatives)]
        )
        resolvent = np.linalg.inv(s * np.eye(ss.A.shape[0]) - ss.A)
        by_input = (ss.X @ resolvent @ ss.B + ss.U) @ stacked
        size = np.abs(from_input).max()
        np.testing.assert_allclose(by_input, from_input, rtol=1e-9, atol=1e-12 * size)
        np.testing.assert_allclose(
            ss.X @ resolvent @ ss.G + ss.W,
            from_noise,
            rtol=1e-9,
            atol=1e-12 * np.abs(from_noise).max(initial=1),
        )
        output = (ss.C @ resolvent @ ss.B + ss.D) @ stacked
        np.testing.assert_allclose(output, C @ from_input + D, rtol=1e-9, atol=1e-12 * size)


@pytest.mark.parametrize("name", AFFINE)
def test_poles_are_the_finite_generalized_eigenvalues(name):
    flat = AFFINE[name]()
    E, J, *_ = pencil(flat, flat.theta_values)
    poles = np.linalg.eigvals(state_space(state_space_family(flat), flat.theta_values).A)
    # Each pole makes the pencil singular; the degree of det(sE - J) counts them.
    largest = np.linalg.norm(J)
    for pole in poles:
        values = scipy.linalg.svdvals(pole * E - J)
        assert values[-1] < 1e-10 * largest
    far = np.array([1e3, 1e4])
    growth = [np.linalg.slogdet(s * E - J)[1] - np.sum(np.log(np.abs(s - poles))) for s in far]
    assert growth[0] == pytest.approx(growth[1], abs=1e-6)


def test_offsets_carry_constant_loads():
    flat = cubic_loop()
    b_less = state_space(state_space_family(servo()), servo().theta_values)
    np.testing.assert_array_equal(b_less.b, 0)
    ss = state_space(state_space_family(flat), flat.theta_values)
    explicit = reduce_index(flat)
    # Exact at the operating point: x = 2, u = 0.
    at = ([2.0], [0.0], [], [], flat.theta_values, 0)
    np.testing.assert_allclose(ss.A @ [2.0] + ss.b, explicit.rhs(*at).full().ravel(), rtol=1e-12)
    np.testing.assert_allclose(ss.X @ [2.0] + ss.x0, explicit.variables(*at).full().ravel(), rtol=1e-12)


def test_derivatives_equal_the_closed_form():
    flat = rc_pair()
    family = state_space_family(flat)
    r1, r2, c1, c2 = theta = random_theta(flat, 4)
    ss = state_space(family, theta)
    np.testing.assert_allclose(
        ss.A, [[-(1 / r1 + 1 / r2) / c1, 1 / (r2 * c1)], [1 / (r2 * c2), -1 / (r2 * c2)]], rtol=1e-13
    )
    change = state_space_derivatives(family, theta, ["R1", "C2", "C1"])
    expected = np.array(
        [
            [[1 / (r1**2 * c1), 0], [0, 0]],
            [[0, 0], [-1 / (r2 * c2**2), 1 / (r2 * c2**2)]],
            [[(1 / r1 + 1 / r2) / c1**2, -1 / (r2 * c1**2)], [0, 0]],
        ]
    )
    np.testing.assert_allclose(change["A"], expected, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(
        change["B"][:, :, 0], [[-1 / (r1**2 * c1), 0], [0, 0], [-1 / (r1 * c1**2), 0]], rtol=1e-13
    )
    np.testing.assert_allclose(change["G"][:, :, 0], [[0, 0], [0, 0], [-1 / c1**2, 0]], rtol=1e-13)


@pytest.mark.parametrize("name", AFFINE)
def test_derivatives_match_finite_differences_of_every_matrix(name):
    flat = AFFINE[name]()
    family = state_space_family(flat)
    theta = random_theta(flat, 9)
    names = [p.name for p in flat.parameters]
    change = state_space_derivatives(family, theta, names)
    for i in range(len(names)):
        step = 1e-5 * theta[i]
        high, low = (state_space(family, theta + d * step * np.eye(len(names))[i]) for d in (1, -1))
        for matrix, value in change.items():
            numeric = (getattr(high, matrix) - getattr(low, matrix)) / (2 * step)
            assert value[i].shape == numeric.shape
            size = np.abs(getattr(high, matrix)).max(initial=1.0) / theta[i]
            np.testing.assert_allclose(value[i], numeric, rtol=1e-6, atol=1e-7 * size)


def test_a_hanging_pendulum_is_linearised_to_the_textbook_form():
    flat = pendulum(0.0, -1.0)
    family = state_space_family(flat)
    assert not family.is_affine
    ss = state_space(family, flat.theta_values)
    mass, length = flat.theta_values
    np.testing.assert_allclose(ss.A, [[0, 1], [-9.81 / length, -0.2 / mass]], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(ss.B[:, 0], [0, 1 / mass], rtol=1e-9)
    change = state_space_derivatives(family, flat.theta_values, ["m"])
    np.testing.assert_allclose(change["A"][0], [[0, 0], [0, 0.2 / mass**2]], rtol=1e-8, atol=1e-8)


def test_the_operating_point_can_be_given():
    flat = pendulum(0.0, -1.0)
    ss = state_space(state_space_family(flat, at={"x": 0.5, "vx": 0.0, "u": 0.1}), flat.theta_values)
    explicit = reduce_index(flat)

    def rhs(x):
        return explicit.rhs(x, [0.1], [], [], flat.theta_values, 0).full().ravel()

    step = 1e-6
    numeric = [
        (rhs([0.5 + step, 0]) - rhs([0.5 - step, 0])) / (2 * step),
        (rhs([0.5, step]) - rhs([0.5, -step])) / (2 * step),
    ]
    np.testing.assert_allclose(ss.A, np.transpose(numeric), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(ss.A @ [0.5, 0] + ss.B @ [0.1] + ss.b, rhs([0.5, 0]), atol=1e-12)


def test_names_that_do_not_exist_are_refused():
    flat = rc_pair()
    family = state_space_family(flat)
    with pytest.raises(ModelError) as caught:
        state_space_derivatives(family, flat.theta_values, ["R3"])
    assert caught.value.code == "unknown-parameter"
    assert "R1" in caught.value.remedy
    with pytest.raises(ConfigError):
        state_space_family(pendulum(), at={"z": 1.0})
