"""The fitted model: parameters and noises of the fit, the same as commands make of its document."""

from pathlib import Path

import pytest

import daest
from daest.cli.results import fitted
from daest.report.documents.fit import document

SERVO = Path(__file__).resolve().parents[2] / "examples" / "servo"


@pytest.mark.parametrize("method", ["oe", "pem"])
def test_fitted_model_is_that_of_the_commands(method):
    flat = daest.compile_model(SERVO / "Servo.mo")
    signals = [daest.Signal("u", "V")], [daest.Signal("omega", "rad/s"), daest.Signal("phi", "rad")]
    data = daest.read_experiments([SERVO / "servo.csv"], *signals)
    options = daest.IdentifyOptions(method=method, split=0.1, hold="zoh", second_look=False)
    fit = daest.identify(flat, data, options)
    mine, theirs = daest.fitted_model(flat, fit), fitted(flat, document(fit))
    assert mine.theta_values == pytest.approx(theirs.theta_values)
    assert mine.theta_values[list(fit.theta).index("k")] == fit.theta["k"]
    assert [w.intensity for w in mine.noises] == [w.intensity for w in theirs.noises]
    assert [y.noise_std for y in mine.outputs] == [y.noise_std for y in theirs.outputs]
    assert all(
        y.noise_std == pytest.approx(std, rel=0.2) for y, std in zip(mine.outputs, (0.02, 0.01), strict=True)
    )
    assert (mine.noises[0].intensity == 0.0) == (method == "oe")
