"""Native code that writes to the console beside what it returns."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def native_silence() -> Iterator[None]:
    """Native code does not write to stderr inside the block: a panic of the Modelica compiler prints its own
    traceback there, CasADi the arguments of an iteration that fails, in addition to the exception."""
    try:
        saved = os.dup(2)
    except OSError:  # a program without a console has no stderr to keep quiet
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)
