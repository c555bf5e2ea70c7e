"""Rows of a table of times, and how they are measured: within this process (`in_turn`), or from outside."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One line of the table: a figure and that of the peer, in `unit`, less being better unless `is_rate`."""

    step: str
    unit: str
    ours: float
    peer: str = ""
    theirs: float | None = None
    is_rate: bool = False

    def cells(self) -> tuple[str, ...]:
        theirs = "" if self.theirs is None else f"{self.theirs:.3g}"
        ratio = 0.0 if self.theirs is None else self.theirs / self.ours
        faster = "" if self.theirs is None else f"{1 / ratio if self.is_rate else ratio:.2g}"
        return self.step, f"{self.ours:.3g} {self.unit}", self.peer, theirs, faster


def in_turn(runs: list[Callable[[], object]], repeat: int) -> list[float]:
    """Median seconds of processor time of each; the first run of each is not counted."""
    times: list[list[float]] = [[] for _ in runs]
    for round_ in range(repeat + 1):
        for run, found in zip(runs, times, strict=True):
            start = time.process_time()
            run()
            if round_:
                found.append(time.process_time() - start)
    return [statistics.median(found) for found in times]


def as_installed() -> dict[str, str]:
    """The environment of a process whose byte code is kept, as that of an installed package is."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def process(arguments: list[str], **variables: str) -> Callable[[], object]:
    return lambda: subprocess.run(
        [sys.executable, *arguments], env={**as_installed(), **variables}, capture_output=True, check=False
    )


def children_of(run: Callable[[], object]) -> float:
    """Seconds of processor time of the processes that `run` starts, and of all that they start."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def children(runs: list[Callable[[], object]], repeat: int) -> list[float]:
    """Median seconds of `children_of` each; the first run of each is not counted."""
    times: list[list[float]] = [[] for _ in runs]
    for round_ in range(repeat + 1):
        for run, found in zip(runs, times, strict=True):
            seconds = children_of(run)
            if round_:
                found.append(seconds)
    return [statistics.median(found) for found in times]
