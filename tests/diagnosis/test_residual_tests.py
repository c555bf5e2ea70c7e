"""Residual tests: closed forms, planted faults, and false alarms on records without fault."""

from dataclasses import replace

import numpy as np
import pytest
from oscillator import OSCILLATOR, record
from scipy.stats import beta, binom, chi2

from daest.diagnosis.comparison.compare import compare_models
from daest.diagnosis.comparison.residual_tests import RawTest, joined, judged, residual_tests
from daest.diagnosis.comparison.trial import Candidate
from daest.diagnosis.gates import GATES
from daest.modelica.compile import compile_model
from daest.numerics.statistics import ljung_box


def sequences(residuals, inputs, **changes):
    """Sequences of one recording and one output, exact parameters."""
    given = {"variables": np.zeros((len(residuals), 0)), "acts": True, "n_estimation": None, **changes}
    return joined(
        [np.asarray(residuals)[:, None]],
        [np.asarray(inputs)[:, None]],
        [given["variables"]],
        given.get("slopes", ()),
        given.get("parameter_cov"),
        acts_at_once=given["acts"],
        n_estimation=given["n_estimation"],
        known_noise=np.array([True]),
    )


def p_values(*args, **kwargs):
    tests, feedback = residual_tests(sequences(*args, **kwargs), ["y"])
    found = {kind: by_output["y"].p_value for kind, by_output in tests.items() if by_output}
    return {**found, "feedback": feedback["y"].p_value if feedback else 1.0}


def test_ljung_box_is_its_definition():
    e = np.random.default_rng(0).normal(size=50)
    r = [np.sum(e[lag:] * e[:-lag]) / np.sum(e**2) for lag in (1, 2, 3)]
    pairs = [49, 48, 47]
    # Autocorrelations as means over pairs: r (n / (n - l)), so that the weights are (n + 2) (n - l) / n.
    expected = sum((50 / m * c) ** 2 * m * 52 / 50 for c, m in zip(r, pairs, strict=True))
    assert ljung_box(e, np.ones(50, dtype=bool), 3) == pytest.approx(expected, rel=1e-12)


def test_each_fault_fails_its_own_test_and_no_other():
    rng = np.random.default_rng(3)
    n = 2000
    e, u = rng.normal(size=n), rng.normal(size=n)
    clean = p_values(e, u)
    assert min(clean.values()) > 0.01
    delayed = np.concatenate([np.zeros(3), u[:-3]])
    wrong_input = p_values((e + 0.2 * delayed) / np.sqrt(1.04), u)
    assert wrong_input["input_independence"] < 1e-6
    assert min(p for kind, p in wrong_input.items() if kind != "input_independence") > 0.01
    coloured = np.array(e)
    for k in range(1, n):
        coloured[k] += 0.3 * coloured[k - 1]
    coloured /= coloured.std()
    found = p_values(coloured, u)
    assert found["whiteness"] < 1e-10 and found["input_independence"] > 0.01 and found["nis"] > 0.01
    assert p_values(1.2 * e, u)["nis"] < 1e-6
    v = rng.normal(size=(n, 1))
    odd = p_values((e + 0.3 * np.sign(v[:, 0])) / np.sqrt(1.09), u, variables=v)
    assert odd["variable_independence"] < 1e-6 and odd["input_independence"] > 0.01


def test_feedback_is_told_apart_from_a_wrong_model():
    """A controller answers the last error: no fault of the model."""
    rng = np.random.default_rng(4)
    e = rng.normal(size=3000)
    u = rng.normal(size=3000)
    u[1:] += 0.5 * e[:-1]
    found = p_values(e, u)
    assert found["feedback"] < 1e-10 and found["input_independence"] > 0.01


def test_a_controller_without_delay_does_not_falsify():
    rng = np.random.default_rng(5)
    e = rng.normal(size=3000)
    u = rng.normal(size=3000) + 0.5 * e
    assert p_values(e, u, acts=False)["input_independence"] > 0.01


@pytest.mark.parametrize("constant", [0.0, -1.570796, 1e9 / 3])
def test_a_constant_input_tells_nothing(constant):
    """Its mean is known but for rounding, which is no input."""
    e = 1.0 + np.random.default_rng(5).normal(size=754)
    tests, feedback = residual_tests(sequences(e, np.full(754, constant)), ["y"])
    assert tests["whiteness"] and not tests["input_independence"] and not feedback


def test_uncertain_parameters_are_forgiven_as_far_as_they_are_uncertain():
    """A parameter that is off by two standard errors moves the residuals along its slope."""
    rng = np.random.default_rng(6)
    n = 2000
    u, e = rng.normal(size=n), rng.normal(size=n)
    slopes = u[None, :, None]
    std = 0.1
    off = e + 2 * std * u
    exact = p_values(off, u)["input_independence"]
    forgiven = p_values(off, u, slopes=(slopes,), parameter_cov=np.array([[std**2]]))["input_independence"]
    assert exact < 1e-6 and forgiven > 0.01


def test_recordings_do_not_touch_each_other():
    """Two recordings with a common shock at the seam: no lag crosses it."""
    e = np.zeros(100)
    e[-1] = 1.0
    other = np.zeros(100)
    other[0] = 1.0
    both = joined(
        [e[:, None], other[:, None]],
        [np.zeros((100, 1))] * 2,
        [np.zeros((100, 0))] * 2,
        (),
        None,
        acts_at_once=True,
        n_estimation=None,
        known_noise=np.array([True]),
    )
    tests, feedback = residual_tests(both, ["y"])
    assert tests["whiteness"]["y"].statistic == 0.0 and not feedback and not tests["input_independence"]


def test_too_few_values_are_not_tested():
    few = np.full(100, np.nan)
    few[:10] = 1.0
    tests, feedback = residual_tests(sequences(few, np.zeros(100)), ["y"])
    assert not any(tests.values()) and not feedback


def raw(p_value):
    return RawTest(chi2.isf(p_value, 3), p_value, lambda level: (0.0, chi2.isf(level, 3)))


def test_holm_procedure_by_hand():
    """Three tests at 1 %: 0.003 is below 0.01 / 3, then 0.004 below 0.01 / 2, then 0.02 above 0.01."""
    tests = judged({"a": {"x": raw(0.004), "y": raw(0.003)}, "b": {"x": raw(0.02)}})
    assert [tests["a"]["x"].passed, tests["a"]["y"].passed, tests["b"]["x"].passed] == [False, False, True]
    one = judged({"a": {"x": raw(0.004), "y": raw(0.3)}, "b": {"x": raw(0.02)}})
    assert all(test.passed for tests in one.values() for test in tests.values())
    assert one["a"]["x"].limit == pytest.approx(chi2.isf(GATES.residual_level / 3, 3))


def _study(tmp_path, n_records, n_samples, bootstrap=0):
    path = tmp_path / "Oscillator.mo"
    path.write_text(OSCILLATOR.format(extra=""))
    flat = compile_model(path)
    found, falsified, placed = {}, 0, 0
    for seed in range(n_records):
        experiment = record(flat, n_samples, seed, kind=seed % 3)
        trial = compare_models([Candidate("o", flat, 0, "zoh")], [experiment], bootstrap=bootstrap).models[0]
        for kind, by_output in trial.tests.items():
            for output, test in by_output.items():
                found.setdefault((kind, output), []).append(test.p_value)
        falsified += trial.verdict == "falsified"
        placed += bool(trial.where)
    return found, falsified, placed


@pytest.mark.slow
def test_records_without_fault_are_seldom_falsified(tmp_path):
    found, falsified, placed = _study(tmp_path, 20, 400)
    # At 1 % and 2 %, three of 20 have probabilities of 0.1 % and 0.7 %.
    assert falsified <= 2 and placed <= 2
    for values in found.values():
        assert np.sum(np.array(values) < 0.05) <= binom.isf(1e-3, 20, 0.05)


@pytest.mark.slow
def test_false_alarm_rate_over_200_records(tmp_path):
    found, falsified, placed = _study(tmp_path, 200, 1000)
    for count in (falsified, placed):
        assert beta.isf(0.05, count + 1, 200 - count) < 0.08  # Clopper-Pearson, 95 %
    low, high = binom.interval(0.9999, 200, 0.05)
    for key, values in found.items():
        assert low <= np.sum(np.array(values) < 0.05) <= high, key


@pytest.fixture
def recorded(tmp_path):
    """An oscillator and a recording of it."""
    path = tmp_path / "Oscillator.mo"
    path.write_text(OSCILLATOR.format(extra=""))
    flat = compile_model(path)
    return flat, record(flat, 300, 1)


@pytest.mark.slow
def test_bootstrap_agrees_with_the_tables_where_they_hold(recorded):
    flat, experiment = recorded
    candidate = Candidate("o", flat, 0, "zoh")
    table = compare_models([candidate], [experiment]).models[0]
    drawn = compare_models([candidate], [experiment], bootstrap=99, seed=1).models[0]
    assert drawn.verdict == table.verdict == "not falsified"
    for kind, by_output in table.tests.items():
        for output, test in by_output.items():
            # Three standard errors of a share of 99.
            assert abs(drawn.tests[kind][output].p_value - test.p_value) < 0.16


@pytest.mark.slow
def test_bootstrap_falsifies_a_wrong_model(recorded):
    flat, _ = recorded
    experiment = record(flat, 100, 1)
    wrong = replace(flat, parameters=tuple(replace(p, value=1.3 * p.value) for p in flat.parameters))
    found = compare_models([Candidate("w", wrong, 0, "zoh")], [experiment], bootstrap=99).models[0]
    assert found.verdict == "falsified"
