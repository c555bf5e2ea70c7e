"""Distributions against those of scipy.stats, which the package itself does not load."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from daest.numerics import statistics as distributions

DEGREES = np.array([1, 2, 3, 20, 400])[:, None]
X = np.concatenate([[-1.0, 0.0], np.geomspace(1e-3, 2000.0, 60), [np.inf, np.nan]])
P = np.concatenate([[0.0, 1e-300, 1e-12], np.linspace(0.001, 0.999, 40), [1.0]])


@pytest.mark.parametrize(("name", "at"), [("sf", X), ("logsf", X), ("ppf", P), ("isf", P)])
def test_chi_squared(name, at):
    found = getattr(distributions.chi2, name)(at, DEGREES)
    np.testing.assert_allclose(found, getattr(stats.chi2, name)(at, DEGREES), rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize(("name", "at"), [("sf", np.concatenate([X, -X])), ("ppf", P), ("isf", P)])
def test_normal(name, at):
    found = getattr(distributions.norm, name)(at)
    np.testing.assert_allclose(found, getattr(stats.norm, name)(at), rtol=1e-13)


def test_beta():
    x = np.concatenate([[-0.5], np.linspace(0.0, 1.0, 60), [1.5]])
    for a, b in ((1, 1), (3, 40), (200, 7), (0.5, 0.5)):
        found = distributions.beta.sf(x, a, b)
        np.testing.assert_allclose(found, stats.beta.sf(x, a, b), rtol=1e-11, atol=1e-300)


def test_no_command_waits_for_scipy_stats():
    modules = "daest.diagnosis.improve, daest.cli.identify, daest.cli.improve, daest.cli.report"
    script = f"import sys, {modules}; print([m for m in ('scipy.stats', 'scipy.signal') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
