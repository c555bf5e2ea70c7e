"""Fisher information of a designed recording, against scipy and against the dense joint Gaussian."""

import numpy as np
import pytest
from driven import PERIOD, driven, limits
from scipy.signal import cont2discrete, dlsim

from daest.design import signals
from daest.design.explainer import Point, distance, information, likely

CART = {"m": 1.2, "b": 0.8, "c": 30.0}


def cart(force, m, b, c, x0=(0.0, 0.0)):
    """Positions of the cart under a held force, by scipy."""
    A, B = np.array([[0.0, 1.0], [-c / m, -b / m]]), np.array([[0.0], [1.0 / m]])
    system = cont2discrete((A, B, np.array([[1.0, 0.0]]), np.zeros((1, 1))), PERIOD, "zoh")
    return dlsim(system, force, x0=np.array(x0))[1][:, 0]


def by_scipy(force):
    """Information over the logarithms of the parameters, with an unknown initial state."""
    moves = []
    for name in CART:
        up, down = ({**CART, name: CART[name] * (1 + s * 1e-4)} for s in (1, -1))
        moves.append((cart(force, **up) - cart(force, **down)) / 2e-4 / 0.002)
    starts = [cart(np.zeros_like(force), **CART, x0=x0) for x0 in ((1.0, 0.0), (0.0, 1.0))]
    starts = np.linalg.qr(np.array(starts).T)[0]
    moves = np.array(moves).T
    moves = moves - starts @ (starts.T @ moves)
    return moves.T @ moves


@pytest.mark.parametrize("family", list(signals.FAMILIES))
def test_simulated_model_against_scipy(family):
    allowed = limits()
    shape = next(iter(signals.FAMILIES[family](allowed, 0)))
    force = signals.within(allowed, shape.signal, keeps_form=True)
    np.testing.assert_allclose(information(driven("Cart"), force), by_scipy(force), rtol=2e-4)


def walk(a, k, w, e, u):
    """Mean and covariance of the outputs of Walk, whose state starts from its predicted covariance."""
    n, phi = len(u), np.exp(-a * PERIOD)
    q = w * (1.0 - phi**2) / (2.0 * a)
    root = np.sqrt((q - e**2 * (1 - phi**2)) ** 2 + 4 * q * e**2)
    start = 0.5 * (q - e**2 * (1 - phi**2) + root)
    mean, cov = np.zeros(n), np.zeros((n, n))
    for i in range(1, n):
        mean[i] = phi * mean[i - 1] + k / a * (1.0 - phi) * u[i - 1]
    variance = start
    for i in range(n):
        cov[i, i:] = cov[i:, i] = variance * phi ** np.arange(n - i)
        variance = phi**2 * variance + q
    return mean, cov + e**2 * np.eye(n)


def test_noisy_model_against_the_dense_gaussian():
    """With everything unknown: rate, gain and both noises. The oracle knows the initial state, which costs a
    sample or two of 400."""
    values = {"a": 2.0, "k": 3.0, "w": 0.05, "e": 0.1}
    u = 0.2 * np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 40), 10)
    inverse = np.linalg.inv(walk(**values, u=u)[1])
    means, covs = [], []
    for name in values:
        up, down = (walk(**{**values, name: values[name] * (1 + s * 1e-4)}, u=u) for s in (1, -1))
        means.append((up[0] - down[0]) / 2e-4)
        covs.append(inverse @ (up[1] - down[1]) / 2e-4)
    expected = np.array(
        [[m @ inverse @ n + 0.5 * np.trace(c @ d) for n, d in zip(means, covs, strict=True)]
         for m, c in zip(means, covs, strict=True)]
    )  # fmt: skip
    found = information(driven("Walk", unknown_noise=True), u[:, None])
    size = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(found / np.outer(size, size), expected / np.outer(size, size), atol=0.03)


def test_noise_alone_tells_the_rate():
    model = driven("Walk", unknown_noise=True)
    found = information(model, np.zeros((400, 1)))
    assert found[0, 0] > 1.0 and found[1, 1] == pytest.approx(0.0, abs=1e-9)


def test_what_a_refit_leaves_of_another_cart():
    """A cart of another mass is found by a refit; a force that no cart knows is not."""
    allowed = limits()
    force = signals.within(allowed, next(signals.steps(allowed, 0)).signal, keeps_form=False)
    model = driven("Cart")
    other = cart(force, m=1.3, b=0.9, c=31.0)[:, None]
    none = np.zeros((3, 3))
    assert distance(model, force, other, none, steps=6) < 1e-3
    odd = other + 0.01 * np.sign(np.sin(7.0 * allowed.time))[:, None]
    assert distance(model, force, odd, none, steps=6) > 100.0
    sure = 1e12 * np.eye(3)  # parameters that nothing may move
    home = cart(force, **CART)[:, None]
    assert distance(model, force, other, sure) == pytest.approx(
        0.5 * np.sum(_without_start(other - home) ** 2) / 0.002**2, rel=1e-3
    )


def _without_start(errors):
    rest = np.zeros((errors.shape[0], 1))
    starts = np.array([cart(rest, **CART, x0=x0) for x0 in ((1.0, 0.0), (0.0, 1.0))]).T
    starts = np.linalg.qr(starts)[0]
    return errors - starts @ (starts.T @ errors)


def test_likely_parameters_spread_as_the_information_says():
    allowed, model = limits(), driven("Cart")
    force = signals.within(allowed, next(signals.steps(allowed, 0)).signal, keeps_form=False)
    drawn = np.array(likely(model, [force], 0, 400))
    cov = np.linalg.inv(information(model, force))
    np.testing.assert_allclose(np.std(drawn, axis=0), np.sqrt(np.diagonal(cov)), rtol=0.12)
    assert likely(model, [], 0, 5) == []


def test_outputs_are_those_of_scipy():
    allowed, model = limits(), driven("Cart")
    force = signals.within(allowed, next(signals.steps(allowed, 0)).signal, keeps_form=False)
    at = model.start(force)
    assert isinstance(at, Point)
    np.testing.assert_allclose(model.outputs(force, at)[:, 0], cart(force, **CART), atol=1e-9)
