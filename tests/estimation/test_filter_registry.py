"""The public filter: kinds from the registry, several recordings, the model's own noise, failing requests."""

import sys
import types

import numpy as np
import pytest
from test_filter import STD, simulated_servo
from test_nonlinear_filter import linear_servo, servo_record

import daest
from daest.errors import EXPLANATIONS, EstimationError
from daest.estimation.filters import FILTERS, Filter, kalman
from daest.model.estimates import FilterOptions
from daest.systems.linear.state_space import state_space

OPTIONS = FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=STD**2)


def test_a_file_and_a_row_are_a_filter(monkeypatch):
    def estimate(case, name):
        case.tell(name)
        return kalman.estimate(case, "time-varying")

    file = types.ModuleType("daest.estimation.filters.mine")
    file.estimate = estimate
    monkeypatch.setitem(sys.modules, file.__name__, file)
    monkeypatch.setitem(FILTERS, "my filter", Filter("my filter", "mine"))
    family, experiment = simulated_servo(1, 200)
    told: list[str] = []
    found = daest.run_filter(family, experiment, "my filter", OPTIONS, told.append)
    wanted = daest.run_filter(family, experiment, options=OPTIONS)
    assert (found.kind, wanted.kind, told) == ("my filter", "time-varying", ["my filter"])
    assert np.array_equal(found.values, wanted.values, equal_nan=True) and found.nis == wanted.nis


def test_several_recordings_are_filtered_one_by_one():
    family, first = simulated_servo(1, 200)
    second = simulated_servo(2, 150)[1]
    both = daest.run_filter(family, [first, second], "stationary", OPTIONS)
    for found, experiment in zip(both, (first, second), strict=True):
        alone = daest.run_filter(family, experiment, "stationary", OPTIONS)
        assert np.array_equal(found.values, alone.values, equal_nan=True)


def test_noise_and_kind_are_those_of_the_model():
    explicit = linear_servo()
    experiment = servo_record(explicit, n=60)[1]
    flat = daest.declare(
        explicit.flat,
        noises={w.name: 1e-3 for w in explicit.flat.noises},
        noise_std={y.name: 0.01 for y in explicit.flat.outputs},
    )
    found = daest.run_filter(flat, experiment)  # its form is not affine, whatever its parameters
    sizes = FilterOptions(process_intensity=np.full(len(flat.noises), 1e-3), measurement_cov=np.full(2, 1e-4))
    wanted = daest.run_filter(explicit, experiment, "ekf", sizes)
    assert found.kind == "ekf" and np.array_equal(found.values, wanted.values, equal_nan=True)


@pytest.mark.parametrize(
    ("model", "kind", "options", "code"),
    [
        ("family", "kalmann", OPTIONS, "filter-kind-unknown"),
        ("family", "ekf", OPTIONS, "filter-linear-model"),
        ("matrices", "ukf", OPTIONS, "filter-linear-model"),
        ("matrices", None, FilterOptions(), "filter-noise-unknown"),
    ],
)
def test_requests_that_fail(model, kind, options, code):
    family, experiment = simulated_servo(1, 20)
    models = {
        "family": family,
        "matrices": state_space(family, np.array([p.value for p in family.parameters])),
    }
    with pytest.raises(EstimationError) as caught:
        daest.run_filter(models[model], experiment, kind, options)
    assert caught.value.code == code in EXPLANATIONS and caught.value.remedy


def test_correlated_noise_is_for_the_linear_filters():
    explicit = linear_servo()
    experiment = servo_record(explicit, n=20)[1]
    cov = np.array([[1.0, 0.5], [0.5, 1.0]])
    options = FilterOptions(process_intensity=np.ones(len(explicit.flat.noises)), measurement_cov=cov)
    assert np.all(np.isfinite(daest.run_filter(explicit, experiment, "time-varying", options).values[-1]))
    with pytest.raises(EstimationError) as caught:
        daest.run_filter(explicit, experiment, "ekf", options)
    assert caught.value.code == "filter-noise-correlated" in EXPLANATIONS
