"""What long commands say meanwhile: the time that is left, from the parts that are done."""

import io

import pytest
from rich.console import Console

from daest.cli.bar import moving_bar, show
from daest.cli.progress import progress


@pytest.fixture
def bar():
    """A bar on an imagined terminal, and a clock that the test moves."""
    now = [0.0]
    console = Console(file=io.StringIO(), force_terminal=True, width=60)
    return moving_bar(console, lambda: now[0]), now


def drawn(bar):
    console = Console(file=io.StringIO(), width=60)
    console.print(bar.get_renderable())
    return console.file.getvalue()


def test_time_left_is_that_of_the_parts_that_remain(bar):
    bar, now = bar
    task = bar.add_task("starting", total=None)
    show(bar, task, "fitting the model")
    assert bar.tasks[0].total is None and "left" not in drawn(bar)
    for number in (1, 2, 3):
        show(bar, task, f"refitting with X at y ({number} of 5)")
        now[0] += 10.0
    # Two parts took 10 s each: the third began at 20 s, and three remain from there.
    assert bar.tasks[0].time_remaining == pytest.approx(30.0, abs=1.0)
    text = drawn(bar)
    assert "0:00:30 left" in text and "refitting" in text
    assert all(len(line) <= 60 for line in text.splitlines())


def test_a_bar_never_goes_back_and_a_new_stage_begins_anew(bar):
    bar, _ = bar
    task = bar.add_task("starting", total=None)
    show(bar, task, "refit (4 of 5)")
    show(bar, task, "refit (2 of 5)")
    assert bar.tasks[0].completed == 3
    show(bar, task, "profile (1 of 9)")
    assert (bar.tasks[0].completed, bar.tasks[0].total) == (0, 9)
    show(bar, task, "writing")
    assert bar.tasks[0].total is None


def test_one_line_per_step_where_there_is_no_terminal(capsys):
    with progress() as tell:
        tell("refit (1 of 2)")
        tell("refit (2 of 2)")
    assert capsys.readouterr().err == "refit (1 of 2)\nrefit (2 of 2)\n"
