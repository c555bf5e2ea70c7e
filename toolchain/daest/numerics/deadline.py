"""A moment at which long searches give up, for all that runs inside a `with` block."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_moment: ContextVar[float] = ContextVar("deadline", default=math.inf)


class OutOfTimeError(Exception):
    """The deadline has passed in the middle of a search: it has no result. Whoever set the deadline catches
    it; it is no error of the search, which is why it is no DaestError."""


@contextmanager
def until(moment: float) -> Iterator[None]:
    """Searches in this block end with OutOfTimeError from the `moment` of `time.monotonic` on [s]; one of an
    outer block that comes first holds, too."""
    token = _moment.set(min(moment, _moment.get()))
    try:
        yield
    finally:
        _moment.reset(token)


def left() -> float | None:
    """Seconds until the deadline, at least 0; None where there is none."""
    moment = _moment.get()
    return None if moment == math.inf else max(moment - time.monotonic(), 0.0)


def check() -> None:
    """Raise OutOfTimeError once the deadline has passed."""
    if time.monotonic() >= _moment.get():
        raise OutOfTimeError
