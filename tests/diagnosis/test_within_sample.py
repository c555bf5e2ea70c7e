"""A share of an input in a reading that is less than the input does within a sample: how late it acts."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import PERIOD, library, model
from test_changing_values import stand_with

from daest.diagnosis.evidence.answered_inputs import answers_output
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.screening.within_sample import acts_later, responses_within
from daest.model.diagnosis import Candidate
from daest.modelica.places.sites import sites


@cache
def run():
    return run_null(stand_with(0.0, 0.0).null)


def told(k, rms):
    """A fit with a share k of the torque in the reading of the speed, and the error of unseen data."""
    size = SimpleNamespace(name="effect_1.k", value=k)
    return SimpleNamespace(parameters=(size,), simulated={"validation": SimpleNamespace(rms={"w": rms})})


def why(k, rms=1.0, name="Crosstalk", adds_up=False):
    effect = next(e for e in library() if e.class_name == f"Daest.Effects.Signals.{name}")
    site = next(s for s in sites(model("SpeedRotor")) if s.kind == "output")
    candidate = Candidate(effect, site, "effect_1", {}, {"z": "u"})
    return acts_later(run(), candidate, told(k, rms), told(0.0, 1.0), adds_up=adds_up)


def test_an_input_moves_an_output_within_a_sample_as_the_model_says():
    J, d = (run().null.fit.theta[name] for name in ("J", "d"))
    exact = (1.0 - np.exp(-d * PERIOD / J)) / d
    assert responses_within(run())[0, 0] == pytest.approx(exact, rel=1e-6)


def test_a_small_share_that_no_simulation_shows_is_how_late_the_input_acts():
    most = responses_within(run())[0, 0]
    assert why(0.1 * most) == why(-0.9 * most) == "it does what u would do that acts a part of a sample later"
    assert why(1.1 * most) == "", "more than any part of a sample does"
    assert why(0.1 * most, rms=0.8) == "", "and so is what a simulation shows"
    assert why(0.1 * most, rms=0.8, adds_up=True) != "", "but none whose errors add up: other values do that"
    assert why(1.1 * most, rms=0.8, adds_up=True) == ""
    assert why(0.1 * most, name="Offset") == ""


@pytest.mark.parametrize("samples", [0, 1])
def test_a_share_of_the_next_input_is_the_answer_of_a_controller(samples):
    """A reading that holds a share of the input, and an input that follows what has moved the reading."""
    null = run().null
    k = 3.0 * responses_within(run())[0, 0]
    made = []
    for one in null.experiments:
        u = np.concatenate([one.inputs[samples:, 0], np.repeat(one.inputs[-1:, 0], samples)])
        made.append(replace(one, outputs=one.outputs + k * u[:, None]))
    effect = next(e for e in library() if e.class_name == "Daest.Effects.Signals.Crosstalk")
    site = next(s for s in sites(model("SpeedRotor")) if s.kind == "output")
    candidate = Candidate(effect, site, "effect_1", {}, {"z": "u"})
    mixed = replace(null, experiments=tuple(made))
    assert bool(answers_output(mixed, candidate, told(k, 1.0))) is bool(samples)
