"""Power to name an effect: friction of a rotor, beside unknown loads."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven import flat
from scipy.linalg import expm
from scipy.stats import chi2, ncf

from daest.design.design import Task, design
from daest.design.drawn import Required
from daest.design.effects import detect_aim, with_effect
from daest.design.loads import LEAST, SIZES, Evidence, Loads
from daest.diagnosis.foreseeable import beside_loads, required
from daest.model.design import Limits, Range
from daest.modelica.effects.catalogue import find_effects
from daest.modelica.places.sites import find_site

PERIOD = 0.05
LIMITS = Limits((Range("tau", "N.m", -1.2, 1.2),), 12.0, PERIOD, hold="zoh")
NO_LOADS = Loads((), 2.0, 0.25)
ANYTHING_GOES = Required(10.0, 1e-3, 50, 1e9, np.inf, 20, 5, 0.01, 1e9, 0.9, 100, 0.1, 0.95)  # on unseen data


def torque(seed=0, low=-1.2, high=1.2):
    return np.random.default_rng(seed).uniform(low, high, 12).repeat(20)[:240, None]


@cache
def seen(size=0.05, loads=None, asked=None, recorded=False):
    model, found = beside_loads(flat("Rotor"))
    effect = next(e for e in find_effects("CoulombFriction") if e.domain == "rotational")
    return detect_aim(
        model,
        effect,
        find_site(flat("Rotor"), "rotor.flange_a", effect),
        LIMITS,
        [torque(1, 0.6)] if recorded else (),
        size=size,
        required=asked or required(50),
        loads=loads or found,
    )


def grown(name, values):
    effect = next(e for e in find_effects(name) if e.domain == "rotational")
    site = find_site(flat("Rotor"), "rotor.flange_a", effect)
    model = with_effect(flat("Rotor"), effect, site, values, {}, "known")
    known = (replace(p, estimate=p.estimate and p.name in "Jd") for p in model.parameters)
    return replace(model, parameters=tuple(known))


def test_power_without_loads_is_that_of_the_likelihood_ratio():
    """The ratio is a function of a variable with Fisher's distribution."""
    aim, _ = seen(loads=NO_LOADS, asked=ANYTHING_GOES)
    inputs, n, p = torque(), 240, 4  # inertia, damping, size and initial speed
    for size in (0.005, 0.007):
        expected = aim.evidence([inputs], size).evidence
        squares = n * np.expm1(expected / n)  # the size of the noise is fitted, too
        least = np.expm1(ANYTHING_GOES.threshold(n, 1) / n) * (n - p)
        exact = 1.0 - ncf.cdf(least, 1, n - p, squares)
        assert 0.02 < exact < 0.98
        assert aim.power([inputs], size) == pytest.approx(exact, abs=4.0 * np.sqrt(exact * (1 - exact) / 400))
    assert aim.power([inputs], 1e-6) <= 0.01


def test_the_price_is_that_of_the_bic_or_of_the_search():
    assert required(1).threshold(240, 1) == pytest.approx(10.0 + np.log(240))
    assert chi2.sf(required(10**6).threshold(240, 1), 1) * 10**6 == pytest.approx(1e-3)


def test_what_a_load_follows_is_no_evidence():
    """Against the covariance of a load through the rotor, written out."""
    aim, _ = seen()
    inputs, size = torque(), 0.05
    bank, (part,) = aim._bank([inputs]), aim._shown([inputs], size)
    level = (1, 10)
    T, J, d = bank.times[1], 0.08, 0.1
    A, G = np.array([[-d / J, 1.0 / J], [0.0, -1.0 / T]]), np.diag([0.0, 2.0 / T])
    both = expm(PERIOD * np.block([[-A, G], [np.zeros((2, 2)), A.T]]))
    step, added = both[2:, 2:].T, both[2:, 2:].T @ both[:2, 2:]
    states = np.zeros((2, 2))
    states[1, 1] = 1.0
    covariance = np.zeros((240, 240))
    for k in range(240):
        reached = states
        for i in range(k, 240):
            covariance[i, k] = covariance[k, i] = reached[0, 0]
            reached = step @ reached
        states = step @ states @ step.T + added
    # The size is the one that brings about that much of an output's variance.
    variance = LEAST * SIZES ** level[1] / covariance[-1, -1]
    whole = np.eye(240) + variance * covariance
    root = np.linalg.inv(np.linalg.cholesky(whole))
    rows = np.concatenate([part.slopes, part.initial])[:, :, 0] @ root.T
    left = root @ part.errors[:, 0]
    left = left - rows.T @ np.linalg.lstsq(rows.T, left, rcond=None)[0]
    squares = left @ left + np.trace(root @ root.T)
    expected = 240 * np.log(squares / 240) + np.linalg.slogdet(whole)[1]
    found = Evidence(bank, [part])
    assert found.beside((level,)) == pytest.approx(expected, rel=0.02)
    assert aim.evidence([inputs], size).evidence <= 1.05 * expected
    assert expected < 0.5 * found.beside(bank.none())


@pytest.mark.slow
def test_smallest_size_and_loads():
    aim, _ = seen()
    inputs = torque()
    least = aim.smallest([inputs])
    assert aim.power([inputs], least) == pytest.approx(0.95, abs=0.02)
    assert aim.power([inputs], 0.8 * least) < 0.92
    assert aim.smallest([inputs, inputs]) < 0.8 * least
    alone, _ = seen(loads=NO_LOADS)
    assert alone.smallest([inputs]) < 0.97 * least  # a load follows a part of dry friction
    free, _ = seen(asked=ANYTHING_GOES)
    assert free.smallest([inputs]) < 0.95 * least  # unseen data ask for more


@pytest.mark.slow
def test_design_for_an_effect_tells_power_against_length():
    aim, subjects = seen(None, recorded=True)
    recorded = torque(1, 0.6)
    found = design(Task(aim, subjects, LIMITS, (recorded,), seconds=1.0))
    assert found.expected.smallest_size < found.present.smallest_size
    assert found.expected.value > found.present.value
    whole = {p.length: p for p in found.power if p.amplitude == 1.0}
    assert sorted(whole) == [6.0, 12.0, 24.0, 48.0]
    sizes = [whole[length].smallest_size for length in sorted(whole)]
    assert sizes == sorted(sizes, reverse=True)
    # Half of the recording validates: either half shows the effect, and what is expected is that of one.
    half = found.inputs.shape[0] // 2 + 1
    later = slice(found.inputs.shape[0] - half // 2, None)  # where the ramp from the end to the start is over
    np.testing.assert_allclose(found.inputs[later], found.inputs[later.start - half : -half], atol=1e-12)
    assert found.inputs.shape[0] == found.limits.time.size
    assert any("validation" in note for note in found.notes)
    assert found.expected.smallest_size == pytest.approx(aim.smallest([found.inputs[:half]]), rel=1e-6)


@pytest.mark.slow  # linear: the tests above
def test_nonlinear_models_have_loads_too():
    """Hardly any quadratic drag in the model: it is nonlinear, and does what the linear one does."""
    model, loads = beside_loads(grown("QuadraticDrag", {"k": 1e-4}))
    effect = next(e for e in find_effects("CoulombFriction") if e.domain == "rotational")
    site = find_site(model, "rotor.flange_a", effect)
    aim, _ = detect_aim(model, effect, site, LIMITS, (), size=0.05, required=required(50), loads=loads)
    expected, linear = aim.expected([torque()]), seen()[0].expected([torque()])
    assert expected.value == pytest.approx(linear.value, rel=0.05)
    assert expected.smallest_size == pytest.approx(linear.smallest_size, rel=0.05)
