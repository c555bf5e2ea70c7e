"""On what a figure was measured: the versions, the machine and how busy it was, in one line."""

from __future__ import annotations

import datetime
import os
import platform
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path

import daest

LIBRARIES = ("numpy", "scipy", "casadi", "rumoca")  # that decide how fast and how exact daest is


def described(libraries: Iterable[str] = LIBRARIES) -> str:
    """Version of daest, month, processor, cores, load of the last minute, system, Python and `libraries`."""
    month = f"{datetime.date.today():%B %Y}"
    return (
        f"daest {daest.__version__}, {month}, {processor()}, {os.cpu_count()} cores{_load()}, "
        f"{platform.system()} {platform.machine()}, {versions(libraries)}"
    )


def versions(libraries: Iterable[str] = LIBRARIES) -> str:
    """The versions of Python and of those `libraries` that are installed."""
    found = [f"Python {platform.python_version()}"]
    for name in libraries:
        try:
            found.append(f"{name} {version(name)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join(found)


@cache
def version(package: str) -> str:
    """The version of a package that is installed: reading it takes milliseconds. Raises
    PackageNotFoundError."""
    return metadata.version(package)


def processor() -> str:
    """The name of the processor, as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def _load() -> str:
    """The load of the last minute, where the system counts it."""
    try:
        return f", load {os.getloadavg()[0]:.1f}"
    except (AttributeError, OSError):
        return ""
