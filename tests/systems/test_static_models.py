"""Models whose outputs follow from inputs and parameters alone: nothing in them has a state."""

from pathlib import Path

import numpy as np
import pytest

from daest.diagnosis.comparison.compare import Candidate, compare_models
from daest.estimation.filter import FilterOptions, run_filter
from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.systems.linear.linearize import linearize
from daest.systems.linear.split import split

GAIN = b"""model Gain
  parameter Real a = 2 annotation(__Daest(estimate = true));
  input Real u;
  output Real y;
equation
  y = a*u;
end Gain;
"""
SQUARE = GAIN.replace(b"a*u;", b"a*u + 0.1*u^2;").replace(b"Gain", b"Square")


def recording(curvature: float = 0.0) -> Experiment:
    rng = np.random.default_rng(1)
    u = np.sin(0.3 * np.arange(200.0)) + 0.3 * rng.normal(size=200)
    y = 3.0 * u + curvature * u**2 + 0.05 * rng.normal(size=200)
    return Experiment("run", 0.1 * np.arange(200.0), u[:, None], y[:, None], ("u",), ("y",))


def test_model_whose_outputs_are_all_expressions_keeps_them_as_unknowns():
    flat = compile_text(GAIN, Path("Gain.mo"))
    dae = linearize(flat)
    assert [one.name for one in flat.unknowns] == ["y"] and dae.n == 1
    assert split(dae).n_dynamic == 0


@pytest.mark.parametrize("text, curvature", [pytest.param(GAIN, 0.0, marks=pytest.mark.slow), (SQUARE, 0.1)])
def test_model_without_states_is_identified_compared_and_filtered(text, curvature):
    """Least squares is the oracle: the errors are white and nothing has a memory."""
    flat, record = compile_text(text, Path("Gain.mo")), recording(curvature)
    fit = identify(flat, [record])
    u, y = record.inputs[:, 0], record.outputs[:, 0] - curvature * record.inputs[:, 0] ** 2
    assert fit.theta["a"] == pytest.approx(u @ y / (u @ u), rel=1e-6)
    fitted = flat.with_theta(fit.theta)
    (trial,) = compare_models([Candidate("Gain", fitted, 1, "foh")], [record]).models
    std = float(np.std(y - fit.theta["a"] * u))
    assert trial.simulation.rms["y"] == pytest.approx(std, rel=0.01)
    for kind in (None, "ukf"):
        found = run_filter(fitted, record, kind, FilterOptions(measurement_cov=np.array([std**2])))
        np.testing.assert_allclose(found.values[:, 0], fit.theta["a"] * u + curvature * u**2, atol=1e-9)
