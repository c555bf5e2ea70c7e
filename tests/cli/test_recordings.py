"""What a command takes from the command line, and what from daest.toml."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from daest.cli.options import DataOptions
from daest.data.prepare import Preparation
from daest.data.project import Project


def test_command_line_comes_before_the_project():
    project = Project(Path(), preparation=Preparation(1.0, 9.0, 0.1, "mean", 0.5))
    assert DataOptions().preparation(project) == project.preparation
    given = DataOptions(start=0.0, period=0.2, detrend="none").preparation(project)
    assert given == Preparation(0.0, 9.0, 0.2, "none", 0.5)


@pytest.mark.parametrize(
    ("options", "project", "hold"),
    [
        (DataOptions(), Project(Path()), None),
        (DataOptions(), Project(Path(), hold="zoh"), "zoh"),
        (DataOptions(hold="zoh", period=0.1), Project(Path()), "zoh"),
        # A resampled input has gone through a filter and is no longer held between its samples.
        (DataOptions(period=0.1), Project(Path(), hold="zoh"), "foh"),
        (DataOptions(), Project(Path(), hold="zoh", preparation=Preparation(period=0.1)), "foh"),
    ],
)
def test_hold(options, project, hold):
    assert options.known_hold(project, SimpleNamespace(input_names=())) == hold
