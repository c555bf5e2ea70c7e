"""What a command takes from the command line, and what from daest.toml."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from daest.cli.options import DataOptions
from daest.cli.recordings import training_data
from daest.data.prepare import Preparation, resample
from daest.data.project import Project
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text


def test_command_line_comes_before_the_project():
    project = Project(Path(), preparation=Preparation(1.0, 9.0, 0.1, "mean", 0.5))
    assert DataOptions().preparation(project) == project.preparation
    given = DataOptions(start=0.0, period=0.2, detrend="none").preparation(project)
    assert given == Preparation(0.0, 9.0, 0.2, "none", 0.5)


def recorded(period: float | None) -> Experiment:
    time = 0.05 * np.arange(200)
    raw = Experiment("run", time, np.sin(time)[:, None], np.cos(time)[:, None], ("u",), ("y",))
    return raw if period is None else resample(raw, period)


@pytest.mark.parametrize(
    ("options", "project", "period", "hold"),
    [
        (DataOptions(), Project(Path()), None, None),
        (DataOptions(), Project(Path(), hold="zoh"), None, "zoh"),
        (DataOptions(hold="zoh"), Project(Path()), None, "zoh"),
        # A resampled input has gone through a filter and is no longer held between its samples.
        (DataOptions(hold="zoh"), Project(Path()), 0.1, "foh"),
        (DataOptions(), Project(Path(), hold="zoh"), 0.1, "foh"),
        # Its own period leaves a recording as it is.
        (DataOptions(), Project(Path(), hold="zoh"), 0.05, "zoh"),
    ],
)
def test_hold(options, project, period, hold):
    model = SimpleNamespace(input_names=("u",))
    assert options.known_hold(project, model, [recorded(period)]) == hold
    assert options.preparation(project).hold == (options.hold or project.hold)


FIRST_ORDER = b"""
model FirstOrder
  parameter Real T(unit = "s") = 1 annotation(__Daest(estimate = true));
  input Real u;
  output Real y;
equation
  T*der(y) = u - y;
end FirstOrder;
"""


def test_a_recording_that_is_a_part_of_the_other_is_told(tmp_path, capsys):
    rows = np.column_stack([0.1 * np.arange(200), np.random.default_rng(0).normal(size=(200, 2))])
    paths = [tmp_path / "whole.csv", tmp_path / "part.csv"]
    for path, some in zip(paths, (rows, rows[:120]), strict=True):
        np.savetxt(path, some, delimiter=",", header="time,u,y", comments="")
    flat = compile_text(FIRST_ORDER, Path("FirstOrder.mo"))
    project = Project(tmp_path, preparation=Preparation(split=0.5))
    _, estimation, validation = training_data(flat, project, paths, DataOptions())
    assert [e.n_samples for e in estimation + validation] == [100, 60, 100, 60]
    told = " ".join(capsys.readouterr().err.split())
    assert "check-repeated" in told and "part: the recording has 40 of the 60 samples that validate" in told
