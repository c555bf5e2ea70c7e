"""Native code that works long: somebody hears how far it is, and Ctrl-C ends it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

SECONDS = 5.0  # between two looks


def watched(work: Callable[[], T], look: Callable[[], object], stop: Callable[[], object]) -> T:
    """`work()`, in a thread while this one waits and calls `look` from time to time.

    An exception here (Ctrl-C, or one of `look`) calls `stop`, which lets `work` end soon, and goes on then.
    """
    result: list[T] = []
    problem: list[BaseException] = []
    is_done = threading.Event()

    def run() -> None:
        try:
            result.append(work())
        except BaseException as caught:
            problem.append(caught)
        finally:
            is_done.set()

    thread = threading.Thread(target=run, name="daest-watched")
    thread.start()
    try:
        while not is_done.wait(SECONDS):
            look()
    except BaseException:
        stop()
        raise
    finally:
        thread.join()
    if problem:
        raise problem[0]
    return result[0]
