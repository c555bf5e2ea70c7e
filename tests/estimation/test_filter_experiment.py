"""The example of report section 3.4.2 on the rig with the report's own plant."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "examples" / "report_servo" / "filter_experiment.py"


@pytest.fixture(scope="module")
def found(shared_data):
    specification = importlib.util.spec_from_file_location("filter_experiment", SCRIPT)
    script = importlib.util.module_from_spec(specification)
    sys.modules["filter_experiment"] = script  # dataclasses look their module up
    specification.loader.exec_module(script)
    recording = shared_data / "servo_lab" / "known" / "k7_nothing_hidden_report_plant"
    values = json.loads(recording.with_suffix(".json").read_text())["parameters"]
    values["k"] = -values["k"]  # the model has the amplifier's poles reversed
    values.pop("n")
    return script, script.trials(script.model(values), script.read(recording.with_suffix(".csv")))


def test_from_rest_both_filters_are_as_good(found):
    _, (rest, _, _) = found
    assert rest.error(rest.varying) == pytest.approx(rest.error(rest.stationary), rel=0.02)


def test_after_a_wrong_start_the_time_varying_filter_wins_in_the_transient(found):
    _, (_, wrong, _) = found
    assert wrong.error(wrong.varying) < 0.85 * wrong.error(wrong.stationary)


def test_both_filters_are_equal_in_the_long_run(found):
    _, (_, _, late) = found
    assert late.error(late.varying) == pytest.approx(late.error(late.stationary), rel=1e-3)
    assert late.error(late.varying) < 0.025  # the noise of the speed sensor is 0.02 rad/s


def test_the_figure_is_written(found, tmp_path):
    script, trials = found
    script.draw(trials, tmp_path / "figures.png")
    assert (tmp_path / "figures.png").stat().st_size > 10_000
