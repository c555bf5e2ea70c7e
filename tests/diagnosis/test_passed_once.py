"""Springs on a way that no recording goes back on say nothing that friction does not."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.candidates import pairs
from daest.diagnosis.screening.passed_once import PASSED_ONCE, back_on_their_way
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library
from daest.modelica.places.sites import sites

DRUM = """model Drum "Coasts down"
  parameter Real m(unit = "kg") = 24;
  parameter Real d(unit = "N.s/m", min = 0) = 0.1 annotation(__Daest(estimate = true));
  {position}
  Real v(unit = "m/s", start = 25, fixed = false);
  output Real y(unit = "km/h");
equation
  {rate}
  m*der(v) = -d*v;
  y = 3.6*v;
end Drum;
"""
PLACES = ("CubicSpring", "EndStop", "ReturnSpring")
OTHERS = ("CoggingForce", "CoulombFriction", "LuGreFriction", "ConstantLoad")


def left(names, speeds, position="", rate=""):
    """Names of the laws at the balance that are left, and the reasons of the others."""
    flat = compile_text(DRUM.format(position=position, rate=rate).encode(), Path("Drum.mo"))
    chosen = [e for e in effect_library() if e.name in names and e.domain == "translational"]
    candidates = [c for c in pairs(chosen, sites(flat)) if c.site.kind == "equation"]
    observed = [SimpleNamespace(filtered=np.array(speed)[:, None]) for speed in speeds]
    run = SimpleNamespace(null=SimpleNamespace(flat=flat), state_names=("v",), observed=observed)
    found, others = back_on_their_way(run, candidates)
    assert {reason for _, reason in others} <= {PASSED_ONCE}
    assert len(found) + len(others) == len(candidates) == len(names)
    return {c.effect.name for c in found}


@pytest.mark.parametrize("speeds", [([25.0, 9.0, 1.0], [20.0, 3.0, 0.0]), ([25.0, 9.0, 1.0], [-20.0, -3.0])])
def test_springs_on_a_way_without_return_are_not_tried(speeds):
    assert left((*PLACES, *OTHERS), speeds) == set(OTHERS)


def test_springs_are_tried_where_the_motion_turns_back_or_the_model_has_the_position():
    names = (*PLACES, *OTHERS)
    assert left(names, ([25.0, 9.0, -1.0], [20.0, 3.0, 0.0])) == set(names)
    known = {"position": 'Real s(unit = "m", start = 0, fixed = true);', "rate": "der(s) = v;"}
    assert left(names, ([25.0, 9.0, 1.0],), **known) == set(names)


@pytest.mark.slow
def test_rolling_resistance_of_a_drum_is_no_spring():
    """m der(v) = -d v - f, noise of 0.1 km/h: from 25 m/s until it stands, and unseen from 20 m/s."""

    def recorded(name, start, seed):
        time = np.arange(0.0, 190.0, 0.5)
        v = np.maximum((start + 1.2 / 0.16) * np.exp(-0.16 / 24.0 * time) - 1.2 / 0.16, 0.05)
        y = 3.6 * v + 0.1 * np.random.default_rng(seed).standard_normal(time.size)
        return Experiment(name, time, np.empty((time.size, 0)), y[:, None], (), ("y",))

    flat = compile_text(DRUM.format(position="", rate="").encode(), Path("Drum.mo"))
    options = DiagnoseOptions(effects=("CoulombFriction", "CubicSpring", "ReturnSpring"))
    found = diagnose(
        flat, effect_library(), [recorded("one", 25.0, 1)], [recorded("other", 20.0, 2)], options=options
    )
    assert {label for label, reason in found.screen.skipped if reason == PASSED_ONCE} == {
        "CubicSpring at 0:v",
        "ReturnSpring at 0:v",
    }
    law = found.proofs[0]
    assert (found.verdict, law.candidate.label) == ("supported", "CoulombFriction at 0:v")
    size = next(p for p in law.told.parameters if p.name.endswith("f_c"))
    assert abs(size.value - 1.2) < 4.0 * size.std_error < 0.3


def test_springs_alone_are_left_where_nothing_else_was_asked_for():
    assert left(PLACES, ([25.0, 9.0, 1.0],)) == set(PLACES)
