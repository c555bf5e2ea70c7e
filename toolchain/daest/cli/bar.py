"""The line that moves on a terminal while a command works: what is done, how much of it, the time left."""

from __future__ import annotations

import re
from collections.abc import Callable

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Column
from rich.text import Text

_PART = re.compile(r" \((?P<number>\d+) of (?P<total>\d+)\)$")


class Left(ProgressColumn):
    """The time that is left, where it can be told."""

    max_refresh = 0.5

    def render(self, task: Task) -> Text:
        if task.total is None or task.time_remaining is None:
            return Text("")
        minutes, seconds = divmod(int(task.time_remaining), 60)
        return Text(f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d} left", style="progress.remaining")


def moving_bar(console: Console, clock: Callable[[], float]) -> Progress:
    """One line that goes when all is done; a step that does not fit is cut short."""
    return Progress(
        SpinnerColumn(),
        TextColumn(
            "{task.description}", markup=False, table_column=Column(overflow="ellipsis", no_wrap=True)
        ),
        BarColumn(bar_width=12),
        TimeElapsedColumn(table_column=Column(no_wrap=True)),
        Left(table_column=Column(no_wrap=True)),
        console=console,
        get_time=clock,
        transient=True,
        speed_estimate_period=3600.0,
    )


def show(bar: Progress, task: TaskID, text: str) -> None:
    """Show a step. Its number counts when it begins, so that one less is done; a bar never goes back."""
    part = _PART.search(text)
    if part is None:
        bar.reset(task, description=text)
        bar.tasks[0].total = None
        return
    done, total = int(part["number"]) - 1, int(part["total"])
    if bar.tasks[0].total != total:
        bar.reset(task, total=total)
    bar.update(task, completed=max(done, bar.tasks[0].completed), description=text)
