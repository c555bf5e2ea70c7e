"""The null against records with a known load."""

import numpy as np
import pytest
from hidden_plants import model, quiet, rotor_null, rotor_record

from daest.diagnosis.diagnose import without_noises
from daest.diagnosis.null import fit_null
from daest.errors import EstimationError


def test_size_and_time_constant_of_a_coloured_load():
    record, _ = rotor_record(1500, seed=4, load=(0.15, 1.0), noise=0.0)
    null, _ = rotor_null(record)
    (load,) = null.loads
    assert load.place == "rotor.flange_a"
    assert load.size == pytest.approx(0.15, rel=0.3)
    assert load.time_constant == pytest.approx(1.0, rel=0.6)
    assert null.measurement_std == pytest.approx([0.005], rel=0.1)


def test_parameters_and_their_errors_are_right_with_a_load():
    record, _ = rotor_record(1500, seed=4, load=(0.15, 1.0), noise=0.0)
    null, _ = rotor_null(record)
    found = {p.name: p for p in null.fit.parameters}
    assert null.estimated == ("J", "d")
    for name, true in (("J", 0.5), ("d", 0.3)):
        assert abs(found[name].value - true) < 3.5 * found[name].std_error
        assert found[name].std_error < 0.15 * true


def test_load_of_white_torque_is_as_strong_as_the_torque():
    null, _ = quiet()
    (load,) = null.loads
    # Spectral density of the load at low frequency, against the intensity of the white torque.
    assert 2 * load.size**2 * load.time_constant == pytest.approx(1e-4, rel=0.7)


def test_innovations_of_the_null_are_white():
    _, run = quiet()
    e = run.whitened
    correlation = [e[k:] @ e[:-k] / (e @ e) for k in range(1, 6)]
    assert np.max(np.abs(correlation)) < 3.5 / np.sqrt(e.size)
    assert e.std() == pytest.approx(1.0, rel=0.02)


def test_no_place_is_an_error():
    with pytest.raises(EstimationError) as caught:
        fit_null(without_noises(model()), [], (rotor_record(300)[0],), "zoh")
    assert caught.value.code == "diagnose-no-place"
