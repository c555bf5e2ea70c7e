"""A second look where the simulation of a model has other parameters than the model beside loads."""

from types import SimpleNamespace

import pytest

from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.refits import elsewhere
from daest.diagnosis.refits.elsewhere import is_apart, led_elsewhere

BESIDE_LOADS = {"tm": 3.4, "dw": 0.3, "load.T": 1.5}  # lag and body have changed places
ALONE = {"tm": 0.045, "dw": 0.004}


def stand(theta=BESIDE_LOADS, log_likelihood=17990.0):
    fit = SimpleNamespace(theta=theta, log_likelihood=log_likelihood)
    null = SimpleNamespace(
        fit=fit, estimated=("tm", "dw"), experiments=(), hold="zoh", recorded_hold="zoh", flat=None
    )
    return SimpleNamespace(null=null, declared=None)


def found(verdict="external disturbance", proof="rejected"):
    return SimpleNamespace(verdict=verdict, proofs=(SimpleNamespace(verdict=proof),))


@pytest.fixture
def alone(monkeypatch):
    theta = dict(ALONE)
    fit = SimpleNamespace(status="converged", theta=theta, parameters=())
    monkeypatch.setattr(elsewhere, "identify", lambda *_: fit)
    monkeypatch.setattr(elsewhere, "without_noises", lambda flat: flat)
    return theta


def test_parameters_of_a_simulation_are_tried_where_nothing_was_accepted(alone):
    options = led_elsewhere(stand(), found(), DiagnoseOptions())
    assert options.near == ALONE and options.tried == "zoh"
    assert led_elsewhere(stand(), found(), options) is None, "once"
    assert led_elsewhere(stand(), found(proof="supported"), DiagnoseOptions()) is None
    assert led_elsewhere(stand(), found("nothing missing"), DiagnoseOptions()) is None


def test_parameters_that_a_load_drags_are_not_elsewhere(alone):
    alone |= {"tm": 3.0, "dw": 0.2}
    assert led_elsewhere(stand(), found(), DiagnoseOptions()) is None


@pytest.mark.parametrize(
    ("theta", "log_likelihood", "is_asked"),
    [(ALONE, 17974.0, True), (ALONE, 17000.0, False), (BESIDE_LOADS, 17990.0, False)],
)
def test_what_is_examined_once_more_is_elsewhere_and_likely(theta, log_likelihood, is_asked):
    assert is_apart(stand(theta, log_likelihood), stand()) == is_asked
