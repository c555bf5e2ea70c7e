"""A parameter that changes with time is no zero that drifts."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import INERTIA, PERIOD, library, model, rotor_record, torque_steps

from daest.diagnosis.answers.changing_values import changing_value
from daest.diagnosis.evidence.proof import bic_gain
from daest.diagnosis.evidence.stand import begin, halved
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import refit
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.candidates import attached
from daest.model.diagnosis import Candidate
from daest.modelica.places.sites import sites
from daest.systems.reduction.reduce import reduce_index

DAMPING = 0.3
N = 800


@cache
def stand_with(change, drift):
    """A rotor whose damping changes by the share `change` over the record, and whose torque by `drift` [N.m]
    of a sensor."""
    u = 2.0 + torque_steps(N, 3)
    later = np.arange(N) / N
    w = np.zeros(N)
    for k in range(N - 1):
        d = DAMPING * (1.0 + change * later[k])
        to = (u[k] + drift * later[k]) / d
        w[k + 1] = to + (w[k] - to) * np.exp(-d * PERIOD / INERTIA)
    noise = 0.02 * np.random.default_rng(3).standard_normal(N)
    record = replace(rotor_record(N)[0], inputs=u[:, None], outputs=(w + noise)[:, None], output_names=("w",))
    return begin(model("SpeedRotor"), *halved((record,), ()), DiagnoseOptions(hold="zoh"))


def law(stand):
    """Drift of the torque, as what is accepted."""
    effect = next(e for e in library() if e.class_name == "Daest.Effects.Signals.Drift")
    site = next(site for site in sites(stand.declared) if site.name == "u")
    candidate = Candidate(effect, site, "effect_1")
    return SimpleNamespace(flat=attached(stand.null.flat, [candidate]), candidate=candidate)


def found_in(stand):
    return changing_value(stand, run_null(stand.null), law(stand), library())


@pytest.mark.slow
def test_a_damping_that_grows_is_told_by_its_name_and_its_share():
    found = found_in(stand_with(0.2, 0.0))
    assert found.name == "d"
    assert found.percent == pytest.approx(10.0, abs=3.0 * found.error)  # in the half that is estimated
    assert found.answer.startswith("a change of `d` with time, by ")


def test_nothing_changes_where_a_sensor_drifts_or_the_law_is_none_of_time():
    stand = stand_with(0.0, 0.0)
    assert found_in(stand) is None
    changing = stand_with(0.2, 0.0)
    steady = SimpleNamespace(flat=changing.null.flat)
    assert changing_value(changing, run_null(changing.null), steady, library()) is None


@pytest.mark.slow
def test_a_torque_that_drifts_is_likelier_than_any_change():
    stand = stand_with(0.0, 0.3)
    null, drifting = stand.null, law(stand).flat
    with_drift = refit(drifting, reduce_index(drifting), (*null.estimated, "effect_1.r"), null)
    gain = bic_gain(with_drift.log_likelihood - stand.baseline.log_likelihood, 1, null)
    assert gain > found_in(stand).delta_bic + GATES.same_bic
