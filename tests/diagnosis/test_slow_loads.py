"""Laws that the unknown loads of the null stand for, one sample ahead unseen."""

from dataclasses import replace

import pytest
from hidden_plants import DAMPING, quiet, rotor_null, rotor_record, some_effects

from daest.diagnosis.built_in.slow_loads import said_by_loads
from daest.diagnosis.screening.candidates import pairs
from daest.diagnosis.screening.screen import screen
from daest.modelica.places.sites import sites

EFFECTS = ("ConstantLoad", "CoulombFriction", "QuadraticDrag", "Drift", "Unbalance", "HardeningSpring")


def said(record):
    null, run = rotor_null(record)
    found = screen(null, run, pairs(some_effects(*EFFECTS), sites(null.flat)))
    return found, said_by_loads(null, run, found)


def test_constant_torque_is_what_the_load_stands_for():
    found, trials = said(rotor_record(800, seed=14, torque=lambda w, phi: -0.05)[0])
    assert found.p_value > 0.05
    sizes = {trial.candidate.effect.name: trial.sizes for trial in trials}
    # Where only damping holds the speed, a constant torque is a drift of the angle after some seconds.
    assert sizes == {
        "ConstantLoad": pytest.approx((0.05,), rel=0.2),
        "Drift": pytest.approx((-0.05 / DAMPING,), rel=0.2),
    }


@pytest.mark.parametrize("seed", [11, pytest.param(12, marks=pytest.mark.slow)])
def test_load_that_moves_by_itself_stands_for_no_law(seed):
    assert said(rotor_record(800, seed=seed, load=(0.15, 1.0))[0])[1] == ()


def test_nothing_is_said_where_there_is_no_load():
    null, run = quiet()
    found = screen(null, run, pairs(some_effects(*EFFECTS), sites(null.flat)))
    assert said_by_loads(replace(null, loads=()), run, found) == ()


def test_loads_of_no_size_stand_for_nothing():
    null, run = quiet()
    calm = replace(null, loads=tuple(replace(load, size=0.0) for load in null.loads))
    found = screen(null, run, pairs(some_effects(*EFFECTS), sites(null.flat)))
    assert said_by_loads(calm, run, found) == ()
