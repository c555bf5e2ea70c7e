"""The experiment that a diagnosis proposes where candidates could not be told apart."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from daest.design.effects import with_effect
from daest.diagnosis.answers.next_experiment import Asked, _both_ways, computed
from daest.model.design import Range
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import find_effects
from daest.modelica.places.sites import find_site

ROTOR = Path(__file__).resolve().parents[1] / "design" / "models" / "Rotor.mo"
OTHERWISE = "Shake it."


@pytest.fixture(scope="module")
def rotor():
    return compile_model(ROTOR)


def proof(rotor, name, place, **sizes):
    effect = next(e for e in find_effects(name) if e.domain in ("rotational", "signal"))
    flat = with_effect(rotor, effect, find_site(rotor, place, effect), sizes, {}, "effect_1")
    names = ("J", "d", *(f"effect_1.{size}" for size in sizes))
    told = SimpleNamespace(
        theta={p.name: p.value for p in flat.parameters},
        parameters=[SimpleNamespace(name=n) for n in names],
        simulated={"estimation": SimpleNamespace(rms={"w": 0.05})},
    )
    candidate = SimpleNamespace(inputs={}, label=f"{name} at {place}")
    return SimpleNamespace(verdict="not separable", candidate=candidate, flat=flat, told=told)


def asked(proofs, low=0.6, hold="zoh", reach=0.0):
    time = 0.05 * np.arange(241)
    torque = np.random.default_rng(1).uniform(low, 1.2, 13).repeat(20)[:241, None]
    run = Experiment("run", time, torque, np.linspace(-reach, reach, 241)[:, None], ("tau",), ("w",))
    return Asked(proofs, (run,), hold)


@pytest.mark.slow
def test_curves_of_recordings_are_not_asked_of_what_is_played(rotor):
    left = [
        proof(rotor, "CoulombFriction", "rotor.flange_a", tau_c=0.2),
        proof(rotor, "QuadraticDrag", "rotor.flange_a", k=0.02),
    ]
    curved, straight = (computed(asked(left, -1.2, hold), OTHERWISE) for hold in ("smooth", "foh"))
    assert curved == straight and curved.startswith("Play ")


def test_input_that_tells_them_apart(rotor):
    left = [
        proof(rotor, "CoulombFriction", "rotor.flange_a", tau_c=0.2),
        proof(rotor, "QuadraticDrag", "rotor.flange_a", k=0.02),
    ]
    text = computed(asked(left, low=-1.2), OTHERWISE)
    assert text.startswith("Play ") and "tau from" in text and "N.m" in text
    assert "CoulombFriction at rotor.flange_a | QuadraticDrag at rotor.flange_a" in text
    assert "against" in text and "daest design --rivals" in text and OTHERWISE not in text
    assert ".." not in text


@pytest.mark.slow
def test_machine_is_not_driven_far_beyond_what_was_seen_of_it(rotor):
    left = [
        proof(rotor, "CoulombFriction", "rotor.flange_a", tau_c=0.2),
        proof(rotor, "QuadraticDrag", "rotor.flange_a", k=0.02),
    ]
    near, far = (computed(asked(left, low=-1.2, reach=reach), OTHERWISE) for reach in (0.1, 50.0))
    assert "tau from -1" in far and "tau from -1" not in near


def test_what_only_the_other_direction_tells(rotor):
    left = [
        proof(rotor, "CoulombFriction", "rotor.flange_a", tau_c=0.2),
        proof(rotor, "ConstantLoad", "rotor.flange_a", tau_0=0.2),
    ]
    text = computed(asked(left), OTHERWISE)
    assert text.startswith("Within the recorded range of tau no input") and "tau from -1" in text


@pytest.mark.parametrize(
    ("unit", "low"), [("N.m", -470.0), ("degC", 320.0), ("mol/m3", 320.0), ("", -470.0), ("1", 320.0)]
)
def test_temperature_or_share_that_is_asked_for_has_no_other_direction(unit, low):
    one = _both_ways(Range("u", unit, 320.0, 470.0, np.inf))
    assert (one.low, one.high) == (low, 470.0)


@pytest.mark.parametrize(("least", "most", "low", "high"), [(0.0, None, 0.0, 12.0), (None, 5.0, -12.0, 12.0)])
def test_input_that_is_asked_for_keeps_within_what_the_model_declares(least, most, low, high):
    """A wind that blows from one side; what was recorded is within the limits whatever these are."""
    one = _both_ways(Range("u", "m/s", 4.0, 12.0, np.inf), least, most)
    assert (one.low, one.high) == (low, high)


def test_what_no_input_tells_keeps_the_other_advice(rotor):
    left = [
        proof(rotor, "Offset", "tau", b=-0.2),
        proof(rotor, "ConstantLoad", "rotor.flange_a", tau_0=0.2),
    ]
    assert computed(asked(left), OTHERWISE).endswith(OTHERWISE)
    assert computed(asked(left[:1]), OTHERWISE) == OTHERWISE
