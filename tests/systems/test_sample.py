"""Sampling against scipy.signal, an independent integration of the moment equations, and closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from daest.errors import ModelError
from daest.model.linear import StateSpace
from daest.systems.linear.state_space import sample, sample_derivatives, stacked_inputs


def state_space(A, B, G, C, D, H=None, b=None, d=None, input_derivatives=()):
    n, n_u, n_w, n_y = A.shape[0], B.shape[1], G.shape[1], C.shape[0]
    return StateSpace(
        state_names=tuple(f"x{i}" for i in range(n)),
        input_names=tuple(f"u{i}" for i in range(n_u - len(input_derivatives))),
        input_derivatives=input_derivatives,
        noise_names=tuple(f"w{i}" for i in range(n_w)),
        output_names=tuple(f"y{i}" for i in range(n_y)),
        unknown_names=(),
        A=A,
        B=B,
        G=G,
        b=np.zeros(n) if b is None else b,
        C=C,
        D=D,
        H=np.zeros((n_y, n_w)) if H is None else H,
        d=np.zeros(n_y) if d is None else d,
        X=np.zeros((0, n)),
        U=np.zeros((0, n_u)),
        W=np.zeros((0, n_w)),
        x0=np.zeros(0),
    )


def random_state_space(seed, n=4, n_u=2, n_w=2, n_y=2, H=False):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) - 1.5 * np.eye(n)
    return state_space(
        A,
        rng.standard_normal((n, n_u)),
        rng.standard_normal((n, n_w)),
        rng.standard_normal((n_y, n)),
        rng.standard_normal((n_y, n_u)),
        rng.standard_normal((n_y, n_w)) if H else None,
        rng.standard_normal(n),
        rng.standard_normal(n_y),
    )


@pytest.mark.parametrize("seed", range(5))
def test_zero_order_hold_equals_scipy(seed):
    ss = random_state_space(seed)
    Ad, Bd, *_ = cont2discrete((ss.A, ss.B, ss.C, ss.D), 0.3, "zoh")
    model = sample(ss, 0.3, "zoh")
    assert np.allclose(model.transition, Ad, rtol=1e-12, atol=1e-13)
    assert np.allclose(model.input_now, Bd, rtol=1e-12, atol=1e-13)
    assert not model.input_next.any()


@pytest.mark.parametrize("seed", range(5))
def test_first_order_hold_equals_scipy(seed):
    # SciPy moves the input's next value into the state: B_scipy = Γ0 + Φ Γ1, D_scipy = D + C Γ1.
    ss = random_state_space(seed)
    Ad, Bd, _, Dd, _ = cont2discrete((ss.A, ss.B, ss.C, ss.D), 0.3, "foh")
    model = sample(ss, 0.3, "foh")
    assert np.allclose(model.input_now + Ad @ model.input_next, Bd, rtol=1e-11, atol=1e-12)
    assert np.allclose(ss.D + ss.C @ model.input_next, Dd, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_moments_equal_an_integration_of_their_equations(seed):
    ss = random_state_space(seed)
    intensity = np.array([[0.4, 0.1], [0.1, 0.9]])
    period, n = 0.7, 4
    u0, u1 = np.array([0.3, -1.0]), np.array([1.2, 0.4])
    x0 = np.array([1.0, -0.5, 0.2, 2.0])

    def moments(t, z):
        x, P = z[:n], z[n : n + n * n].reshape(n, n)
        u = u0 + (u1 - u0) * t / period
        dP = ss.A @ P + P @ ss.A.T + ss.G @ intensity @ ss.G.T
        cross = ss.A @ z[n + n * n :].reshape(n, 2) + ss.G @ intensity / period
        return np.concatenate([ss.A @ x + ss.B @ u + ss.b, dP.ravel(), cross.ravel()])

    start = np.concatenate([x0, np.zeros(n * n + 2 * n)])
    end = solve_ivp(moments, (0.0, period), start, rtol=1e-11, atol=1e-12, method="DOP853").y[:, -1]
    model = sample(ss, period, "foh", intensity)
    mean = model.transition @ x0 + model.input_now @ u0 + model.input_next @ u1 + model.drift
    assert np.allclose(mean, end[:n], rtol=1e-8, atol=1e-9)
    assert np.allclose(model.process_cov, end[n : n + n * n].reshape(n, n), rtol=1e-8, atol=1e-9)
    assert np.allclose(model.noise_process_cov.T, end[n + n * n :].reshape(n, 2), rtol=1e-8, atol=1e-9)
    assert np.allclose(model.noise_cov, intensity / period)
    assert not model.cross_cov.any()


def test_held_noise_is_the_report_s_sampled_noise():
    # (45) with the sampling interval 0.5 in place of 1: G̃ = ∫ e^(Aτ) dτ G by quadrature over fine steps.
    ss = random_state_space(2, H=True)
    period = 0.5
    nodes, weights = np.polynomial.legendre.leggauss(20)
    eigenvalues, vectors = np.linalg.eig(ss.A)
    flow = [
        (vectors * np.exp(eigenvalues * period * (x + 1) / 2)) @ np.linalg.inv(vectors) * w * period / 2
        for x, w in zip(nodes, weights, strict=True)
    ]
    held = np.real(sum(flow)) @ ss.G
    intensity = np.array([0.2, 0.6])
    R = np.diag([0.01, 0.04])
    model = sample(ss, period, "foh", intensity, R, noise="held")
    w_cov = np.diag(intensity) / period
    assert np.allclose(model.process_cov, held @ w_cov @ held.T, rtol=1e-10)
    assert np.allclose(model.cross_cov, held @ w_cov @ ss.H.T, rtol=1e-10)
    assert np.allclose(model.measurement_cov, R + ss.H @ w_cov @ ss.H.T)
    assert np.allclose(model.noise_process_cov, w_cov @ held.T, rtol=1e-10)
    assert np.allclose(model.noise_measurement_cov, w_cov @ ss.H.T)


@pytest.mark.parametrize("rate", [-1e5, -3.0, 1e-9, 2.0])
def test_scalar_covariance_has_its_closed_form(rate):
    ss = state_space(
        np.array([[rate]]), np.zeros((1, 0)), np.array([[2.0]]), np.ones((1, 1)), np.zeros((1, 0))
    )
    model = sample(ss, 0.8, "foh", np.array([0.3]))
    assert model.process_cov[0, 0] == pytest.approx(4 * 0.3 * np.expm1(2 * rate * 0.8) / (2 * rate), rel=1e-9)


def test_input_slope_enters_through_the_neighbouring_inputs():
    # ẋ = -x + u̇ with u a straight line: x(T) = e^(-T) x0 + slope (1 - e^(-T)).
    ss = state_space(
        np.array([[-1.0]]), np.array([[0.0, 1.0]]), np.zeros((1, 0)), np.ones((1, 1)), np.array([[0.0, 1.0]]),
        input_derivatives=((0, 1),),
    )  # fmt: skip
    period = 0.4
    model = sample(ss, period)
    u = np.array([0.7, 1.9])
    ubar = stacked_inputs(u[:, None], np.array([0.0, period]), ss.input_derivatives)
    slope = (u[1] - u[0]) / period
    x1 = model.transition @ [2.0] + model.input_now @ ubar[0] + model.input_next @ ubar[1]
    assert x1[0] == pytest.approx(np.exp(-period) * 2.0 + slope * (1 - np.exp(-period)), rel=1e-12)
    assert np.allclose(ubar, [[0.7, slope], [1.9, slope]])


def directions(ss, seed, p=3):
    rng = np.random.default_rng(seed)
    return {
        name: rng.standard_normal((p, *getattr(ss, name).shape))
        for name in ("A", "B", "G", "b", "C", "D", "H", "d")
    }


@pytest.mark.parametrize("noise", ["white", "held"])
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_derivatives_equal_central_differences(hold, noise):
    ss = random_state_space(11, H=noise == "held")
    change = directions(ss, 12)
    rng = np.random.default_rng(13)
    intensity = np.array([[0.5, 0.2], [0.2, 0.8]])
    dW = rng.standard_normal((3, 2, 2))
    dW = dW + dW.transpose(0, 2, 1)
    if noise == "white":
        change["H"][:] = 0.0
    exact = sample_derivatives(ss, change, 0.6, hold, intensity, dW, noise)
    step = 1e-6

    def moved(i, sign):
        matrices = {name: getattr(ss, name) + sign * step * change[name][i] for name in change}
        near = state_space(**{k: matrices[k] for k in ("A", "B", "G", "C", "D", "H", "b", "d")})
        return sample(near, 0.6, hold, intensity + sign * step * dW[i], None, noise)

    for i in range(3):
        up, down = moved(i, 1), moved(i, -1)
        for name in exact.__dataclass_fields__:
            difference = (getattr(up, name) - getattr(down, name)) / (2 * step)
            assert np.allclose(getattr(exact, name)[i], difference, rtol=1e-6, atol=1e-7), name


def test_derivatives_of_a_stiff_model_equal_central_differences():
    A = np.array([[-4000.0, 100.0], [1.0, -2.0]])
    G = np.array([[1.0], [0.5]])
    ss = state_space(A, np.ones((2, 1)), G, np.eye(2), np.zeros((2, 1)))
    change = {
        name: np.zeros((1, *getattr(ss, name).shape)) for name in ("A", "B", "G", "b", "C", "D", "H", "d")
    }
    change["A"][0] = [[-400.0, 3.0], [0.1, -0.2]]
    exact = sample_derivatives(ss, change, 0.5, "foh", np.array([0.3]))
    step = 1e-6
    up, down = (
        sample(state_space(A + s * step * change["A"][0], ss.B, G, ss.C, ss.D), 0.5, "foh", np.array([0.3]))
        for s in (1, -1)
    )
    for name in ("transition", "input_now", "input_next", "process_cov"):
        difference = (getattr(up, name) - getattr(down, name)) / (2 * step)
        assert np.allclose(getattr(exact, name)[0], difference, rtol=1e-6, atol=1e-12), name


@pytest.mark.parametrize(
    ("order", "hold", "code"), [(2, "foh", "input-derivative-order"), (1, "zoh", "input-derivative-hold")]
)
def test_input_derivatives_that_samples_do_not_give_are_refused(order, hold, code):
    ss = state_space(
        np.array([[-1.0]]), np.ones((1, 2)), np.zeros((1, 0)), np.ones((1, 1)), np.zeros((1, 2)),
        input_derivatives=((0, order),),
    )  # fmt: skip
    with pytest.raises(ModelError) as caught:
        sample(ss, 0.1, hold)
    assert caught.value.code == code
    assert "u0" in caught.value.what


def test_white_noise_in_an_output_is_refused_unless_held():
    ss = random_state_space(4, H=True)
    with pytest.raises(ModelError) as caught:
        sample(ss, 0.1, "foh", np.array([0.1, 0.1]))
    assert caught.value.code == "output-white-noise"
    assert sample(ss, 0.1, "foh", np.zeros(2)).process_cov.max() == 0.0


def test_a_model_without_states_is_sampled():
    ss = state_space(
        np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((0, 0)), np.zeros((1, 0)), np.array([[2.0]])
    )
    assert sample(ss, 0.1).feedthrough.tolist() == [[2.0]]
