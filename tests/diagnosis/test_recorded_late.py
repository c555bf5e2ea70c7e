"""Inputs that are recorded at the end of the interval in which they act."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from oscillator import OSCILLATOR, record

from daest.diagnosis.loads import load_sites
from daest.diagnosis.null import fit_null
from daest.diagnosis.recorded_late import gain_of_earlier_inputs, one_sample_ahead
from daest.diagnosis.stand import without_noises
from daest.modelica.compile import compile_text


@pytest.fixture(scope="module")
def case():
    flat = compile_text(OSCILLATOR.format(extra="").encode(), Path("Oscillator.mo"))
    return without_noises(flat), record(flat, 800, 3)


def recorded_late(experiment):
    return replace(experiment, inputs=np.concatenate([experiment.inputs[:1], experiment.inputs[:-1]]))


def test_inputs_that_act_before_they_are_recorded_are_seen(case):
    flat, experiment = case
    null = fit_null(flat, load_sites(flat), [recorded_late(experiment)], None)
    assert null.hold != "zoh"
    given = fit_null(flat, load_sites(flat), [experiment], "zoh")
    told = null.fit.log_likelihood + gain_of_earlier_inputs(null)
    assert told == pytest.approx(given.fit.log_likelihood, abs=1.0)


@pytest.mark.parametrize("hold", [None, "foh"])
def test_inputs_that_act_as_they_are_recorded_gain_nothing(case, hold):
    """Taken on straight lines the held inputs come half a sample early, and a whole one is further off."""
    flat, experiment = case
    assert gain_of_earlier_inputs(fit_null(flat, load_sites(flat), [experiment], hold)) == 0.0


@pytest.mark.parametrize(("gain", "told"), [(3.0, 0.0), (30.0, 30.0), (-3.0, 0.0)])
def test_inputs_are_late_where_that_is_clearly_likelier(case, monkeypatch, gain, told):
    flat, experiment = case
    null = fit_null(flat, load_sites(flat), [experiment], "foh")
    end = SimpleNamespace(fit=replace(null.fit, log_likelihood=null.fit.log_likelihood + gain))
    monkeypatch.setattr("daest.diagnosis.recorded_late.refitted", lambda *_, **__: end)
    assert gain_of_earlier_inputs(null) == pytest.approx(told)


def test_the_last_inputs_act_to_the_end(case):
    _, experiment = case
    ahead = one_sample_ahead(experiment)
    assert np.array_equal(ahead.inputs[:-1], experiment.inputs[1:])
    assert np.array_equal(ahead.inputs[-1], experiment.inputs[-1])
