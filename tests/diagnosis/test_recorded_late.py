"""Inputs that are recorded at the end of the interval in which they act."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from oscillator import OSCILLATOR, record

from daest.diagnosis.evidence.stand import without_noises
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import fit_null
from daest.diagnosis.recordings.recorded_late import (
    EarlierInputs,
    ahead,
    earlier_inputs,
    gain_of_earlier_inputs,
    simulates_better,
)
from daest.modelica.compile import compile_text


@pytest.fixture(scope="module")
def case():
    flat = compile_text(OSCILLATOR.format(extra="").encode(), Path("Oscillator.mo"))
    return without_noises(flat), record(flat, 800, 3)


def recorded_late(experiment):
    return replace(experiment, inputs=np.concatenate([experiment.inputs[:1], experiment.inputs[:-1]]))


@pytest.fixture(scope="module")
def straight(case):
    flat, experiment = case
    return fit_null(flat, load_sites(flat), [experiment], "foh")


def test_inputs_that_act_before_they_are_recorded_are_seen(case):
    flat, experiment = case
    null = fit_null(flat, load_sites(flat), [recorded_late(experiment)], None)
    assert null.hold != "zoh"
    given = fit_null(flat, load_sites(flat), [experiment], "zoh")
    told = null.fit.log_likelihood + gain_of_earlier_inputs(null)
    assert told == pytest.approx(given.fit.log_likelihood, abs=1.0)


@pytest.mark.parametrize("hold", [pytest.param(None, marks=pytest.mark.slow), "foh"])
def test_inputs_that_act_as_they_are_recorded_gain_nothing(case, straight, hold):
    """Taken on straight lines the held inputs come half a sample early, and a whole one is further off."""
    flat, experiment = case
    null = straight if hold else fit_null(flat, load_sites(flat), [experiment], None)
    assert gain_of_earlier_inputs(null) == 0.0


@pytest.mark.slow
def test_inputs_that_are_many_samples_late_are_found(case):
    """Of a machine whose command was logged by another clock a stop was supported."""
    flat, experiment = case
    late = np.concatenate([np.repeat(experiment.inputs[:1], 5, axis=0), experiment.inputs[:-5]])
    null = fit_null(flat, load_sites(flat), [replace(experiment, inputs=late)], "zoh")
    found = earlier_inputs(null)
    assert found.samples == 5 and found.names == experiment.input_names
    assert found.seconds == pytest.approx(5 * experiment.median_step) and found.gain > 50.0


def test_inputs_are_late_only_where_simulations_are_better_for_it(case, straight):
    """Of a jet in gusts, whose pilot answers them, predictions were better with the elevator of the next
    sample (log-likelihood + 86), and simulations worse."""
    _, experiment = case
    assert not simulates_better(straight, EarlierInputs(86.0))
    assert simulates_better(replace(straight, experiments=(recorded_late(experiment),)), EarlierInputs(86.0))


@pytest.mark.parametrize(("gain", "told"), [(3.0, 0.0), (30.0, 30.0), (-3.0, 0.0)])
def test_inputs_are_late_where_that_is_clearly_likelier(straight, monkeypatch, gain, told):
    likelihood = straight.fit.log_likelihood + gain
    end = SimpleNamespace(fit=replace(straight.fit, log_likelihood=likelihood))
    monkeypatch.setattr("daest.diagnosis.recordings.recorded_late.refitted", lambda *_, **__: end)
    assert gain_of_earlier_inputs(straight) == pytest.approx(told)


def test_the_last_inputs_act_to_the_end(case):
    _, experiment = case
    shifted = ahead(experiment, 1, experiment.input_names)
    assert np.array_equal(shifted.inputs[:-1], experiment.inputs[1:])
    assert np.array_equal(shifted.inputs[-1], experiment.inputs[-1])
    assert np.array_equal(ahead(experiment, 3, ()).inputs, experiment.inputs)
