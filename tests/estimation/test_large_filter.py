"""The filter that keeps one sample at a time: against the dense joint Gaussian with a flat prior, and against
the filter that keeps all of them."""

import numpy as np
import pytest
from dense_gaussian import DenseRecord
from numpy.testing import assert_allclose

from daest.errors import EXPLANATIONS, EstimationError
from daest.estimation.filter import run_filter
from daest.estimation.filter_engines import filter_cost as cost_module
from daest.estimation.filter_engines import large_filter as module
from daest.estimation.filter_engines.filter_cost import filter_cost, way_of_filter
from daest.estimation.filter_engines.kalman import kalman_filter, steady_sample
from daest.estimation.filter_engines.large_filter import can_stream, large_filter
from daest.estimation.filters import kalman as filter_module
from daest.model.estimates import FilterOptions
from daest.model.experiment import Experiment
from daest.model.linear import StateSpace
from daest.numerics.gaussian import marginals
from daest.systems.linear.state_space import sample

PERIOD = 0.1
INTENSITY = np.array([1.0, 0.5])


def heat_chain(n, outputs, unseen=0):
    """Cells that exchange heat, two of them disturbed; `unseen` more that none of the outputs feels. The
    second noise is part of a variable."""
    A = np.diag(np.full(n - 1, 3.0), 1) + np.diag(np.full(n - 1, 3.0), -1) - 6.5 * np.eye(n)
    A = np.block([[A, np.zeros((n, unseen))], [np.zeros((unseen, n)), -0.2 * np.eye(unseen)]])
    total, n_y = n + unseen, len(outputs)
    G, C = np.zeros((total, 2)), np.zeros((n_y, total))
    G[0, 0] = G[n // 2, 1] = 1.0
    G[n:, 0] = 0.3
    C[range(n_y), outputs] = 1.0
    W = np.zeros((total + 1, 2))
    W[-1, 1] = 1.0
    return StateSpace(
        state_names=tuple(f"T{i}" for i in range(total)),
        input_names=("q",),
        input_derivatives=(),
        noise_names=("w", "v"),
        output_names=tuple(f"y{i}" for i in outputs),
        unknown_names=(*(f"T{i}" for i in range(total)), "flow"),
        A=A, B=G[:, :1].copy(), G=G, b=np.zeros(total),
        C=C, D=np.zeros((n_y, 1)), H=np.zeros((n_y, 2)), d=np.zeros(n_y),
        X=np.vstack([np.eye(total), A[:1]]), U=np.zeros((total + 1, 1)), W=W, x0=np.zeros(total + 1),
    )  # fmt: skip


def record(ss, n_samples, seed=0):
    rng = np.random.default_rng(seed)
    model = sample(ss, PERIOD, "foh", INTENSITY, np.full(len(ss.output_names), 0.01))
    u, x, outputs = rng.standard_normal((n_samples, 1)), 3.0 * rng.standard_normal(len(ss.A)), []
    for k in range(n_samples):
        outputs.append(model.output @ x + 0.1 * rng.standard_normal(len(ss.output_names)))
        noise = model.noise_process_cov.T @ (rng.standard_normal(2) / np.sqrt(INTENSITY / PERIOD))
        x = model.transition @ x + model.input_now @ u[k] + noise
        x += model.input_next @ u[min(k + 1, n_samples - 1)]
    time = PERIOD * np.arange(n_samples)
    return model, Experiment("r", time, u, np.array(outputs), ("q",), ss.output_names)


@pytest.mark.parametrize(
    ("n", "outputs", "unseen"),
    [(6, [0, 2, 5], 0), (12, [0, 11], 0), (30, list(range(0, 30, 3)), 0), (6, [0, 3], 1)],
)
def test_it_equals_the_filter_that_keeps_all_samples(n, outputs, unseen, monkeypatch):
    monkeypatch.setattr(module, "UNKNOWN", np.inf)
    ss = heat_chain(n, outputs, unseen)
    model, experiment = record(ss, 300)
    rows = np.vstack([np.eye(n + unseen + 2), np.random.default_rng(1).standard_normal((3, n + unseen + 2))])
    wanted = kalman_filter(model, experiment)
    values, std = marginals(wanted.filtered, rows)
    found = large_filter(model, experiment, rows)
    np.testing.assert_array_equal(np.isinf(found.std), np.isinf(std))
    known = np.isfinite(std)
    assert 0 < np.count_nonzero(~known) < 0.5 * std.size
    assert np.max(np.abs((found.values - values)[known] / std[known])) < 1e-10
    assert_allclose(found.std[known], std[known], rtol=1e-10)
    assert_allclose(found.log_likelihood, wanted.log_likelihood, rtol=1e-10)
    assert_allclose(found.innovations, wanted.innovations, atol=1e-10)
    assert_allclose(found.nis, wanted.nis, atol=1e-9)
    np.testing.assert_array_equal(found.nis_dof, wanted.nis_dof)
    assert found.steady_sample == steady_sample(wanted)
    assert found.unobservable.shape[1] == unseen


def test_it_equals_the_dense_joint_gaussian_with_a_flat_prior():
    n, n_samples = 4, 12
    model, experiment = record(heat_chain(n, [0, 3]), n_samples)
    found = large_filter(model, experiment, np.eye(n + 2))
    dense = DenseRecord([model], experiment, np.zeros(n))
    for k in range(n, n_samples):
        exact = dense.condition(np.vstack([dense.states[k], dense.noises[k]]), k)
        assert_allclose(found.values[k], exact.mean + np.append(dense.state_offsets[k], [0, 0]), atol=1e-8)
        assert_allclose(found.std[k] ** 2, np.diagonal(exact.cov), rtol=1e-8)
    assert_allclose(found.log_likelihood, dense.log_likelihood(), rtol=1e-8)


def test_run_filter_takes_it_for_many_states_and_tells_of_progress(monkeypatch):
    ss = heat_chain(8, [0, 4])
    _, experiment = record(ss, 150)
    options = FilterOptions(process_intensity=INTENSITY, measurement_cov=np.full(2, 0.01))
    arguments = (ss, experiment, "time-varying", options)
    wanted = run_filter(*arguments)
    told: list[str] = []
    monkeypatch.setattr(module, "MANY_STATES", 8)
    plain = run_filter(*arguments, tell=told.append)
    assert told[:2] == ["filtering (0 of 150)", "filtering (64 of 150)"]
    vague = np.isinf(plain.std) & np.isfinite(wanted.std)
    assert np.any(vague) and np.all((wanted.std > 500.0 * wanted.std[-1])[vague])
    assert np.all(np.isnan(plain.values) == np.isinf(plain.std))
    monkeypatch.setattr(module, "UNKNOWN", np.inf)
    found = run_filter(*arguments)
    assert_allclose(found.values, wanted.values, atol=1e-9)
    assert_allclose(found.std, wanted.std, rtol=1e-9)
    assert_allclose(found.process_noise.values, wanted.process_noise.values, atol=1e-9)
    assert (found.nis.n_innovations, found.steady_after) == (wanted.nis.n_innovations, wanted.steady_after)
    assert_allclose(found.log_likelihood, wanted.log_likelihood, rtol=1e-10)


def test_gaps_uneven_steps_and_small_models_are_for_the_other_filter(monkeypatch):
    model, experiment = record(heat_chain(8, [0, 4]), 40)
    assert not can_stream(model, experiment)
    monkeypatch.setattr(module, "MANY_STATES", 8)
    assert can_stream(model, experiment) and not can_stream([model] * 39, experiment)
    assert way_of_filter("time-varying", experiment, None, False) == "streamed"
    assert way_of_filter("time-varying", experiment, None, True) == "stored"
    assert way_of_filter("stationary", experiment, None, False) == "stationary"
    experiment.outputs[7, 1] = np.nan
    assert not can_stream(model, experiment)
    assert way_of_filter("time-varying", experiment, None, False) == "stored"
    assert way_of_filter("time-varying", experiment, ["y0"], False) == "streamed"


def test_a_filter_larger_than_the_memory_is_refused_before_it_starts(monkeypatch):
    stored, streamed = (filter_cost(1000, 10000, 2000, way).bytes for way in ("stored", "streamed"))
    assert stored > 1e10 > streamed
    ss = heat_chain(8, [0, 4])
    _, experiment = record(ss, 40)
    monkeypatch.setattr(filter_module, "LARGE", 8)
    monkeypatch.setattr(cost_module, "_memory", lambda: 1e4)
    with pytest.raises(EstimationError) as caught:
        run_filter(
            ss,
            experiment,
            "time-varying",
            FilterOptions(process_intensity=INTENSITY, measurement_cov=np.full(2, 0.01)),
        )
    assert caught.value.code == "filter-too-large" in EXPLANATIONS
