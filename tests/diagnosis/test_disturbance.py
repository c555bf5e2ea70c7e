"""The unexplained load as a signal, against the truth of the simulator."""

from functools import cache

import numpy as np
from hidden_plants import quiet, rotor_null, rotor_record

from daest.diagnosis.null_model.null import with_noise
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.screening.disturbance import place_gains, smoothed_load


@cache
def pushed():
    record, truth = rotor_record(1000, seed=11, load=(0.2, 1.0), noise=0.0)
    return *rotor_null(record), truth


def test_load_buys_likelihood_where_there_is_one():
    null, run, _ = pushed()
    (gain,) = place_gains(null, run)
    assert gain.group == ("rotor.flange_a",) and gain.unit == "N.m"
    assert gain.log_likelihood_gain > 100.0
    assert gain.size == null.loads[0].size


def test_load_that_explains_all_noise_of_a_sensor_buys_as_much():
    null, _, _ = pushed()
    sharp = with_noise(null, null.intensity, np.array([1e-12]))
    (gain,) = place_gains(sharp, run_null(sharp))
    assert gain.log_likelihood_gain > 100.0


def test_smoothed_load_is_the_true_one():
    null, run, truth = pushed()
    load = smoothed_load(null, run, place_gains(null, run))
    error = load.values - truth["load"]
    assert np.corrcoef(load.values, truth["load"])[0, 1] > 0.8
    # The past alone gives `std`; past and future together must do better.
    assert np.sqrt(np.mean(error**2)) < load.std


def test_quiet_record_has_a_small_load():
    null, run = quiet()
    load = smoothed_load(null, run, place_gains(null, run))
    assert load is None or np.std(load.values) < 0.05
