"""Rivals that are told apart, effects that are seen, sensors that would help: on a rotor whose friction law
is unknown."""

from functools import cache

import numpy as np
import pytest
from driven import flat
from scipy.stats import norm

from daest.design.design import Task, at_period, design
from daest.design.effects import Rival, leaving, rival_aim, with_effect
from daest.errors import EstimationError
from daest.model.design import Limits, Range
from daest.model.experiment import Experiment
from daest.modelica.effects.catalogue import find_effects
from daest.modelica.places.sites import find_site

PERIOD = 0.05
SIZES = {"CoulombFriction": {"tau_c": 0.2}, "ConstantLoad": {"tau_0": 0.2}, "QuadraticDrag": {"k": 0.02}}


def placed(name, place="rotor.flange_a"):
    effect = next(e for e in find_effects(name) if fits_here(e))
    return effect, find_site(flat("Rotor"), place, effect)


def fits_here(effect):
    return effect.domain in ("rotational", "signal")


@cache
def rival(name, place="rotor.flange_a", **sizes):
    effect, site = placed(name, place)
    grown = with_effect(flat("Rotor"), effect, site, sizes or SIZES[name], {})
    names = tuple(f"effect.{size}" for size in (sizes or SIZES[name]))
    return Rival(f"{name} at {place}", leaving(grown, {"w": 0.05}), ("J", "d", *names))


def limits(low=-1.2, high=1.2, **others):
    return Limits((Range("tau", "N.m", low, high),), 12.0, PERIOD, hold="zoh", **others)


def forwards(seed=0):
    """A torque that never lets the rotor turn back, (n, 1)."""
    return np.random.default_rng(seed).uniform(0.6, 1.2, 12).repeat(20)[:241, None]


def rivals(names=("CoulombFriction", "ConstantLoad"), allowed=None, recorded=(), draws=0):
    return rival_aim([rival(n) for n in names], allowed or limits(), recorded, 3.0, 0, draws)


def test_a_law_that_shows_in_reversals_alone():
    """Friction and a constant load are one law in one direction, and far apart in both."""
    aim, _ = rivals()
    inputs = np.vstack([forwards()[:120], -forwards()[:121]])
    assert aim.value(aim.merit(forwards())) < 1e-2 < 100.0 < aim.value(aim.merit(inputs))
    told = aim.expected([inputs])
    (pair,) = told.log_likelihood_ratio
    assert pair == "ConstantLoad at rotor.flange_a | CoulombFriction at rotor.flange_a"
    assert told.value == told.log_likelihood_ratio[pair] and told.power > 0.999


def test_power_is_that_of_the_normal_ratio():
    aim, _ = rivals()
    assert aim.power(8.0) == pytest.approx(norm.cdf((8.0 - 3.0) / 4.0))
    assert aim.power(0.0) == 0.0


@pytest.mark.slow
def test_expected_ratio_is_what_noisy_recordings_have_on_average():
    """Against fits of both laws by scipy to 40 noisy recordings, in which the drag is the truth."""
    from scipy.optimize import least_squares

    aim, _ = rivals(("CoulombFriction", "QuadraticDrag"))
    inputs = 0.25 * np.vstack([forwards()[:120], -forwards()[:121]])
    times = PERIOD * np.arange(241)

    def speeds(law, J, d, size, w0):
        w, result = w0, []
        for tau in inputs[:, 0]:
            result.append(w)
            for _ in range(4):  # held torque, midpoint steps
                h = PERIOD / 4
                middle = w + 0.5 * h * (tau - d * w - law(w, size)) / J
                w = w + h * (tau - d * middle - law(middle, size)) / J
        return np.array(result)

    def friction(w, size):
        return size * np.tanh(w / 0.01)

    def drag(w, size):
        return size * w * abs(w)

    truth = speeds(drag, 0.08, 0.1, 0.02, 0.0)
    started = {friction: (0.08, 0.1, 0.01, 0.0), drag: (0.08, 0.1, 0.02, 0.0)}
    rng, ratios = np.random.default_rng(5), []
    for _ in range(10):
        y = truth + 0.05 * rng.standard_normal(times.size)
        costs = [
            least_squares(
                lambda p, law=law, y=y: (speeds(law, *p) - y) / 0.05, x0, x_scale=(0.1, 0.1, 0.1, 1)
            ).cost
            for law, x0 in started.items()
        ]
        ratios.append(costs[0] - costs[1])
    made = aim.driven[1].outputs(inputs, aim.driven[1].start(inputs))
    np.testing.assert_allclose(made[:, 0], truth, atol=2e-3)
    from daest.design.explainer import distance

    expected = distance(aim.driven[0], inputs, made, np.zeros((3, 3)), 4)
    spread = np.sqrt(2.0 * expected / len(ratios))
    assert expected > 3.0
    assert abs(np.mean(ratios) - expected) < 3.5 * spread


def test_the_best_input_is_found_and_safe_for_likely_parameters():
    safe = (Range("w", "rad/s", -6.0, 6.0),)
    aim, subjects = rivals(allowed=limits(safe=safe), recorded=[forwards()], draws=2)
    found = design(Task(aim, subjects, limits(safe=safe), (forwards(),), seconds=0.8))
    best = found.families[0]
    assert best.inputs is not None and found.higher_is_better
    assert found.expected.power > 0.999 and found.present.value < 0.1
    assert found.expected.value <= found.together.value
    (told,) = found.safety
    assert -6.0 <= told.lowest < told.highest <= 6.0 and 0.0 <= told.probability <= 0.05
    assert found.inputs.min() < 0.0 < found.inputs.max()
    assert found.sensors and all(s.gain > 1.05 for s in found.sensors)
    assert not any(name.startswith("effect.") for s in found.sensors for name in s.variables)
    assert "against" in found.message


@pytest.mark.slow
def test_a_pair_that_no_input_tells_apart_does_not_decide():
    """Friction with two roundings that hardly differ, and a load: the input is the best one for the load."""
    first = rival("CoulombFriction")
    twin = Rival("rounder friction", first.flat.with_theta({"effect.w_s": 0.012}), first.names)
    aim, subjects = rival_aim([first, twin, rival("ConstantLoad")], limits(), (), 3.0, 0)
    assert len(aim.driven) == 3
    found = design(Task(aim, subjects, limits(), seconds=0.6, is_short=True))
    assert found.expected.power > 0.99
    assert all("ConstantLoad" in label for label in found.expected.log_likelihood_ratio)
    assert any("designed for the other pairs" in note and "rounder" in note for note in found.notes)


def test_rivals_that_are_one_equation():
    """A load at the rotor and an offset of the torque are the same for the speed; friction is not."""
    offset = rival("Offset", "tau", b=-0.2)
    allowed = limits()
    aim, subjects = rival_aim([rival("ConstantLoad"), offset], allowed, (), 3.0, 0)
    with pytest.raises(EstimationError, match="do the same") as problem:
        design(Task(aim, subjects, allowed, seconds=0.3))
    assert problem.value.code == "design-same-equation"
    aim, subjects = rival_aim([rival("ConstantLoad"), offset, rival("CoulombFriction")], allowed, (), 3.0, 0)
    found = design(Task(aim, subjects, allowed, seconds=0.5, is_short=True))
    assert any("Offset at tau do the same" in note for note in found.notes)
    assert list(found.expected.log_likelihood_ratio) == [
        "ConstantLoad at rotor.flange_a | CoulombFriction at rotor.flange_a"
    ]
    with pytest.raises(EstimationError) as problem:
        rival_aim([offset], allowed, (), 3.0, 0)
    assert problem.value.code == "design-no-rivals"


def test_recordings_at_the_period_of_the_design():
    times = np.array([1.0, 1.1, 1.3, 1.4])
    recording = Experiment("r", times, np.array([[0.0], [1.0], [3.0], [4.0]]), np.zeros((4, 0)), ("u",), ())
    np.testing.assert_allclose(at_period(recording, ["u"], 0.1)[:, 0], [0.0, 1.0, 2.0, 3.0, 4.0])
