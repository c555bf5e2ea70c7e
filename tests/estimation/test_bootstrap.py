"""Bootstrap of a fit against linear regression, and searches from several starts wherever they run."""

from dataclasses import replace

import numpy as np
import pytest
from nonlinear_models import explicit_from
from scipy.signal import lfilter

from daest.errors import DaestError, EstimationError
from daest.estimation import bootstrap as engine
from daest.estimation.bootstrap import with_bootstrap
from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.numerics import parallel

PERIOD, N, STD, GAIN, RATE = 0.1, 120, 0.05, 2.0, 1.5


def lag():
    """ẋ = rate (gain u - x), y = x."""
    explicit = explicit_from(
        ("x",),
        {"gain": GAIN, "rate": RATE},
        lambda x, u, w, theta, t: [theta[1] * (theta[0] * u[0] - x[0])],
        {"y": lambda x, u, theta: x[0]},
    )
    return explicit.flat


def drag():
    """ẋ = u - drag x |x| (smoothed), y = x."""
    explicit = explicit_from(
        ("x",),
        {"drag": 0.8},
        lambda x, u, w, theta, t: [u[0] - theta[0] * x[0] * (x[0] ** 2 + 0.01) ** 0.5],
        {"y": lambda x, u, theta: x[0]},
    )
    return explicit.flat


def lag_record(seed=0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(N // 8), 8)
    x, keep = np.zeros(N), np.exp(-RATE * PERIOD)
    for k in range(1, N):
        x[k] = keep * x[k - 1] + (1.0 - keep) * GAIN * u[k - 1]
    y = x + STD * rng.standard_normal(N)
    return Experiment("run", PERIOD * np.arange(N), u[:, None], y[:, None], ("u",), ("y",))


def regression_std(record, sigma):
    """Standard error of the gain where the rate is known: y is linear in gain and initial state."""
    keep = np.exp(-RATE * PERIOD)
    driven = np.zeros(N)
    for k in range(1, N):
        driven[k] = keep * driven[k - 1] + (1.0 - keep) * record.inputs[k - 1, 0]
    table = np.column_stack([driven, keep ** np.arange(N)])
    seen = np.isfinite(record.outputs[:, 0])
    return sigma * np.sqrt(np.linalg.inv(table[seen].T @ table[seen])[0, 0])


def options(**more):
    return IdentifyOptions(method="oe", hold="zoh", estimate=("gain",), fix={"rate": RATE}, **more)


@pytest.mark.slow
@pytest.mark.parametrize("gap", [slice(0, 0), slice(20, 60)])
def test_interval_of_a_linear_parameter_is_that_of_regression(gap):
    record = lag_record()
    outputs = record.outputs.copy()
    outputs[gap] = np.nan
    record = replace(record, outputs=outputs)
    fit = identify(lag(), [record], options())
    found = with_bootstrap(fit, lag(), [record], options(), 100).bootstrap
    sigma = next(n.value for n in fit.noises if n.kind == "measurement")
    std = regression_std(record, sigma)
    assert found.names == ("gain",) and found.estimates.shape == (100, 1) and found.n_failed == 0
    # Of 100 normal values the standard deviation is known to 7 %, a 2.5 % percentile to 0.27 deviations.
    assert np.std(found.estimates, ddof=1) == pytest.approx(std, rel=0.2)
    centre = fit.parameters[0].value
    assert np.mean(found.estimates) == pytest.approx(centre, abs=0.3 * std)
    assert found.lower[0] == pytest.approx(centre - 1.96 * std, abs=0.7 * std)
    assert found.upper[0] == pytest.approx(centre + 1.96 * std, abs=0.7 * std)


@pytest.mark.slow
def test_process_noise_widens_the_interval_of_a_gain():
    explicit = explicit_from(
        ("x",),
        {"gain": GAIN, "rate": RATE},
        lambda x, u, w, theta, t: [theta[1] * (theta[0] * u[0] - x[0]) + w[0]],
        {"y": lambda x, u, theta: x[0]},
        ("w",),
    )
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(N // 8), 8)
    keep, x = np.exp(-RATE * PERIOD), np.zeros(N)
    size = np.sqrt(0.05 * (1.0 - keep**2) / (2.0 * RATE))
    for k in range(1, N):
        x[k] = keep * x[k - 1] + (1.0 - keep) * GAIN * u[k - 1] + size * rng.standard_normal()
    y = x + 0.01 * rng.standard_normal(N)
    record = Experiment("run", PERIOD * np.arange(N), u[:, None], y[:, None], ("u",), ("y",))
    given = replace(options(), method="pem")
    fit = identify(explicit.flat, [record], given)
    found = with_bootstrap(fit, explicit.flat, [record], given, 100).bootstrap
    std_error = fit.parameters[0].std_error
    assert np.std(found.estimates, ddof=1) == pytest.approx(std_error, rel=0.25)
    assert std_error > 2.0 * regression_std(record, 0.01)


@pytest.mark.slow
def test_noise_that_lasts_widens_the_interval_as_it_does_the_standard_error():
    record = lag_record()
    rng = np.random.default_rng(5)
    slow = lfilter([1.0], [1.0, -0.9], 0.05 * rng.standard_normal(N))[:, None]
    record = replace(record, outputs=record.outputs + slow)
    fit = identify(lag(), [record], options())
    found = with_bootstrap(fit, lag(), [record], options(), 60).bootstrap
    std_error = fit.parameters[0].std_error
    sigma = next(n.value for n in fit.noises if n.kind == "measurement")
    assert any("account for that" in note for note in fit.notes)
    assert np.std(found.estimates, ddof=1) == pytest.approx(std_error, rel=0.35)
    assert std_error > 1.6 * regression_std(record, sigma)


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_predictions_that_miss_alike_are_told(memory):
    rng = np.random.default_rng(6)
    record = lag_record()
    noise = lfilter([1.0], [1.0, -memory], 0.05 * rng.standard_normal(N))[:, None]
    fit = identify(lag(), [replace(record, outputs=record.outputs + noise)], replace(options(), method="pem"))
    assert any("one step ahead are not white" in note for note in fit.notes) == (memory > 0.0)


def test_refits_that_fail_are_counted_and_too_many_are_an_error(monkeypatch):
    record = lag_record()
    fit = identify(lag(), [record], options())
    calls = []

    def sometimes(*given):
        calls.append(given)
        if len(calls) % 3 == 0:
            raise DaestError("identify-no-start", "nothing")
        return identify(*given)

    monkeypatch.setattr(engine, "identify", sometimes)
    found = with_bootstrap(fit, lag(), [record], options(), 9).bootstrap
    assert found.n_failed == 3 and len(found.estimates) == 6
    monkeypatch.setattr(engine, "FIT", replace(engine.FIT, least_refitted=0.9))
    with pytest.raises(EstimationError) as caught:
        with_bootstrap(fit, lag(), [record], options(), 9)
    assert caught.value.code == "bootstrap-failed" and "3 of 9" in caught.value.what


@pytest.fixture
def no_waiting(monkeypatch):
    """Processes work, however short the tasks are."""
    monkeypatch.setattr(parallel, "START_SECONDS", -np.inf)


def test_bootstrap_and_starts_in_processes_are_the_same_to_the_last_bit(no_waiting):
    record = lag_record()
    alone, beside = (
        IdentifyOptions(method="oe", hold="zoh", estimate=("gain", "rate"), starts=4, jobs=jobs)
        for jobs in (1, 2)
    )
    one, other = (identify(lag(), [record], given) for given in (alone, beside))
    assert one.theta == other.theta and one.start_log_likelihoods == other.start_log_likelihoods
    assert len(one.start_log_likelihoods) >= 4
    one = with_bootstrap(one, lag(), [record], alone, 6).bootstrap
    other = with_bootstrap(other, lag(), [record], beside, 6).bootstrap
    assert np.array_equal(one.estimates, other.estimates)


@pytest.mark.slow  # linear: the test above
def test_starts_of_a_nonlinear_model_in_processes_are_the_same_to_the_last_bit(no_waiting):
    time = PERIOD * np.arange(N)
    u, x = np.where(np.arange(N) % 40 < 20, 1.0, -0.5), np.zeros(N)
    for k in range(1, N):
        x[k] = x[k - 1] + PERIOD * (u[k - 1] - 0.8 * x[k - 1] * abs(x[k - 1]))
    record = Experiment("run", time, u[:, None], x[:, None], ("u",), ("y",))
    heard = []
    fits = [
        identify(
            drag(),
            [record],
            IdentifyOptions(method="oe", hold="zoh", estimate=("drag",), starts=3, jobs=jobs),
            tell=heard.append,
        )
        for jobs in (1, 2)
    ]
    assert fits[0].theta == fits[1].theta and len(fits[0].start_log_likelihoods) == 3
    assert fits[0].start_log_likelihoods == fits[1].start_log_likelihoods
    assert "searched from start point (3 of 3)" in heard
