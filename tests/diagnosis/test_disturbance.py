"""The unexplained load as a signal, and its curve, against the truth of the simulator."""

from functools import cache

import numpy as np
import pytest
from hidden_plants import PERIOD, quiet, rotor_null, rotor_record

from daest.diagnosis.disturbance import best_curve, internal_variables, place_gains, smoothed_load


@cache
def pushed():
    record, truth = rotor_record(1000, seed=11, load=(0.2, 1.0), noise=0.0)
    return *rotor_null(record), truth


@cache
def bumpy():
    """Friction that depends on the angle, which no effect describes."""
    record, truth = rotor_record(1000, seed=12, coulomb=lambda phi: 0.2 * (1.0 + 0.5 * np.sin(phi)))
    return *rotor_null(record), truth


def test_load_buys_likelihood_where_there_is_one():
    null, run, _ = pushed()
    (gain,) = place_gains(null, run)
    assert gain.group == ("rotor.flange_a",) and gain.unit == "N.m"
    assert gain.log_likelihood_gain > 100.0
    assert gain.size == null.loads[0].size


def test_smoothed_load_is_the_true_one():
    null, run, truth = pushed()
    load = smoothed_load(null, run, place_gains(null, run))
    error = load.values - truth["load"]
    assert np.corrcoef(load.values, truth["load"])[0, 1] > 0.8
    # The past alone gives `std`; past and future together must do better.
    assert np.sqrt(np.mean(error**2)) < load.std


def test_external_load_is_related_to_nothing():
    null, run, _ = pushed()
    _, is_related = best_curve(null, run, smoothed_load(null, run, place_gains(null, run)))
    assert not is_related


def test_curve_of_friction_matches_the_truth_within_its_band():
    null, run, truth = bumpy()
    load = smoothed_load(null, run, place_gains(null, run))
    curve, is_related = best_curve(null, run, load)
    assert is_related and curve.explained > 0.3
    assert (curve.place, curve.unit) == ("rotor.flange_a", "N.m")
    assert (curve.variable, curve.variable_unit) == ("rotor.w", "rad/s")
    w = truth["w"]
    values = {p.name: p.value for p in null.fit.parameters}
    # Refitted parameters have taken their part of the friction.
    left = -0.2 * (1 + 0.5 * np.sin(truth["phi"])) * np.tanh(w / 0.02)
    left += (values["d"] - 0.3) * w + (values["J"] - 0.5) * np.gradient(w, PERIOD)
    true = np.array([left[part].mean() for part in np.array_split(np.argsort(w), curve.x.size)])
    assert np.mean(np.abs(curve.w - true) < 3.0 * curve.std) >= 0.9
    assert np.corrcoef(curve.w, true)[0, 1] > 0.9
    assert np.median(curve.std) < 0.1


def test_variables_do_not_contain_the_load():
    null, run, _ = pushed()
    variables = internal_variables(null, run)
    assert "u" in variables and "load_1" not in variables
    assert np.std(run.observed[0].filtered[:, run.state_names.index("load_1")]) > 0.05
    # Without the load the rotor obeys J a = u - d w.
    values = {p.name: p.value for p in null.fit.parameters}
    torque = values["J"] * variables["rotor.a"] + values["d"] * variables["rotor.w"]
    assert torque == pytest.approx(variables["u"], abs=1e-9)


def test_quiet_record_has_a_small_load():
    null, run = quiet()
    load = smoothed_load(null, run, place_gains(null, run))
    if load is not None:
        assert np.std(load.values) < 0.05
        assert not best_curve(null, run, load)[1]
