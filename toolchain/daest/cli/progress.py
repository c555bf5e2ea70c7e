"""What a long command is doing, on stderr: a line that moves on a terminal, else one line per step."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

import click

STDERR = 2
ASKED = ("SIGINT", "SIGTERM", "SIGHUP")  # signals that ask a program to end
INTERRUPTED = 130  # exit code of a command that Ctrl-C ends


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """A function that shows what is being done. A text that ends in `(3 of 12)` moves a bar, and the
    time that is left is told from the parts that are done.

    Ctrl-C ends the program at once: a refit in another thread would otherwise have to come to its end first.
    """
    if not sys.stderr.isatty():
        with _ending_at_once(lambda: None):
            yield lambda text: click.echo(text, err=True)
        return
    from rich.console import Console

    from daest.cli.bar import moving_bar, show

    bar = moving_bar(Console(stderr=True), time.monotonic)
    with bar, _ending_at_once(lambda: bar.console.show_cursor(True)):
        task = bar.add_task("starting", total=None)
        yield lambda text: show(bar, task, text)


@contextmanager
def _ending_at_once(tidy: Callable[[], object]) -> Iterator[None]:
    """Ctrl-C calls `tidy` and ends the program; results are written whole, so that none is left in part."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> NoReturn:
        tidy()
        if parallel := sys.modules.get("daest.numerics.parallel"):
            parallel.stop()
        # Not by click: the signal may come while the stream is being written to, which is not reentrant.
        os.write(STDERR, b"\ninterrupted; what is done is kept, the same command goes on from there\n")
        os._exit(INTERRUPTED)

    known = [getattr(signal, name) for name in ASKED if hasattr(signal, name)]
    asked = [number for number in known if signal.getsignal(number) is not signal.SIG_IGN]  # as nohup does
    before = {number: signal.signal(number, end) for number in asked}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
